"use strict";
const { about, recorded } = JSON.parse(document.getElementById("data").textContent);
const $ = (id) => document.getElementById(id);
const PIECE = 100; // rows of one request
const make = (tag, attributes = {}, ...children) => {
  const element = document.createElement(tag);
  for (const [name, value] of Object.entries(attributes)) {
    if (name === "class") element.className = value;
    else if (name.startsWith("on")) element.addEventListener(name.slice(2), value);
    else if (value === true) element.setAttribute(name, "");
    else if (value !== false && value !== null && value !== undefined) element.setAttribute(name, value);
  }
  element.append(...children.filter((child) => child !== null)); // strings become text, never markup
  return element;
};
const words = (name) => String(name).replaceAll("_", " ");
const many = (count, one) => `${count.toLocaleString("en")} ${one}${count === 1 ? "" : "s"}`;
const shown = (value) => {
  if (value === null || value === undefined) return "";
  if (typeof value !== "number" || Number.isInteger(value)) return String(value);
  return Math.abs(value) < 0.0005 ? "0" : String(Number(value.toPrecision(4)));
};
const number = (field) => field.type !== "text" && !field.values;
const verdict = (row) => {
  const kind = row.success ?? row.outcome;
  if (kind === true || kind === "success") return ["success", "good"];
  return kind === null || kind === "not measured" ? ["not measured", "mild"] : [words(row.failure ?? "failed"), "poor"];
};
const faultBox = (fault) => {
  const box = make("div", { class: "fault" }, fault.error);
  if (fault.hint) box.append(make("code", {}, fault.hint));
  return box;
};

// What is asked: of the server, or of what the page brought along.
const ask = async (path, parameters) => {
  if (recorded) return local(path, Object.fromEntries(parameters));
  let answer;
  try {
    answer = await fetch(`/api/${path}?${new URLSearchParams(parameters)}`);
  } catch {
    throw { error: "The server does not answer.", hint: "start it again: rema view" };
  }
  const content = await answer.json();
  if (!answer.ok) throw content;
  return content;
};
const fault = (thrown) => (thrown.error ? thrown : { error: `The page failed: ${thrown}`, hint: "report it" });
const pictureOf = (name, step, what) => {
  if (recorded) return recorded.pictures[`${name} ${step} ${what}`];
  return `/api/picture?${new URLSearchParams({ episode: name, step, what, of: about.identity })}`;
};

// A page without a server selects in the same way as the server does (evaluator/view/table.py).
const SIGNS = { ">=": (a, b) => a >= b, "<=": (a, b) => a <= b, "!=": (a, b) => a !== b, ">": (a, b) => a > b, "<": (a, b) => a < b, "=": (a, b) => a === b };
const field = (name) => {
  const found = about.fields.find((one) => one.name === name);
  if (!found) throw { error: `there is no column ${name}`, hint: `the columns are ${about.fields.map((one) => one.name).join(", ")}` };
  return found;
};
const matches = (word) => {
  const compared = /^([a-z][a-z0-9_]*)(>=|<=|!=|>|<|=)(.+)$/.exec(word);
  if (!compared) {
    const low = word.toLowerCase();
    return (row) => about.fields.some((one) => {
      const value = row[one.name];
      if (value === null) return false;
      return one.type === "text" ? value.toLowerCase().includes(low) : one.type === "whole" && /^\d+$/.test(low) && value === Number(low);
    });
  }
  const [, name, sign, text] = compared;
  const as = field(name).type === "text" ? (value) => String(value).toLowerCase() : Number;
  const bound = as(text);
  if (Number.isNaN(bound)) throw { error: `'${text}' is not a number`, hint: "compare a measurement like this: lift_m>0.05" };
  return (row) => row[name] !== null && SIGNS[sign](as(row[name]), bound);
};
const localRows = (asked) => {
  const { filters, q, sort } = asked;
  const terms = q.split(/\s+/).filter(Boolean).map(matches);
  for (const [name, chosen] of filters) {
    const values = field(name).values ?? [];
    const unknown = [...chosen].filter((value) => !values.includes(value));
    if (unknown.length) throw { error: `no episode has ${name} ${unknown.join(", ")}`, hint: `there are: ${values.join(", ")}` };
  }
  const kept = recorded.rows.filter((row) => terms.every((term) => term(row)));
  const passes = (row, except) => [...filters].every(([name, chosen]) => name === except || chosen.has(String(row[name])));
  const counts = {};
  for (const one of about.fields.filter((each) => each.values)) {
    counts[one.name] = Object.fromEntries(one.values.map((value) => [value, 0]));
    for (const row of kept) if (row[one.name] !== null && passes(row, one.name)) counts[one.name][row[one.name]] += 1;
  }
  const rows = kept.filter((row) => passes(row));
  const name = sort.replace(/^-/, "");
  const turn = sort.startsWith("-") ? -1 : 1;
  if (name && field(name)) {
    const rank = name === "id" ? new Map(recorded.rows.map((row, at) => [row, at])) : null;
    const key = (row) => (rank ? rank.get(row) : row[name]);
    rows.sort((a, b) => {
      const [x, y] = [key(a), key(b)];
      if (x === null || y === null) return (x === null) - (y === null);
      return x < y ? -turn : x > y ? turn : 0;
    });
  }
  return { rows, counts };
};
const local = (path, asked) => {
  const known = path === "rows" || recorded.episodes[asked.episode];
  if (!known) {
    throw { error: `there is no episode '${asked.episode}' in this page`, hint: `it has ${many(recorded.rows.length, "episode")} of ${about.name}; see all of them: rema view ${about.name}` };
  }
  if (path === "episode") return recorded.episodes[asked.episode];
  const { rows, counts } = localRows(state);
  const position = asked.around ? rows.findIndex((row) => row.id === asked.around) : -1;
  const offset = position < 0 ? Number(asked.offset ?? 0) : Math.floor(position / PIECE) * PIECE;
  return { total: rows.length, offset, position: position < 0 ? null : position, rows: rows.slice(offset, offset + PIECE), counts };
};
