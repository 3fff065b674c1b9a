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

// The address says what is shown: filters, search, order, episode and step.
let state = null;
const read = () => {
  const text = location.hash.slice(1);
  const pairs = new URLSearchParams(text.includes("=") ? text : text && `episode=${text}`);
  const found = { filters: new Map(), q: "", sort: "", episode: null, step: null };
  for (const [name, value] of pairs) {
    if (name === "q" || name === "sort" || name === "episode") found[name] = value;
    else if (name === "step") found.step = Number(value);
    else found.filters.set(name, (found.filters.get(name) ?? new Set()).add(value));
  }
  return found;
};
const queryOf = (from) => {
  const pairs = [];
  for (const [name, values] of from.filters) for (const value of values) pairs.push([name, value]);
  if (from.q) pairs.push(["q", from.q]);
  if (from.sort) pairs.push(["sort", from.sort]);
  return pairs;
};
const go = (changes, push = false) => {
  const next = { ...state, ...changes };
  const pairs = queryOf(next);
  if (next.episode) pairs.push(["episode", next.episode]);
  if (next.episode && next.step !== null) pairs.push(["step", next.step]);
  const hash = `#${new URLSearchParams(pairs).toString().replaceAll("%2F", "/")}`;
  if (push) location.hash = hash;
  else location.replace(hash);
};

// The list: as high as all its rows, of which those in view are there.
const listed = about.fields.filter((one) => one.listed);
let pieces = new Map(); // number of a piece to its rows, or to null while they are asked for
let total = 0;
let position = null; // of the episode that is open, in the list
const rowHeight = () => parseFloat(getComputedStyle(document.documentElement).getPropertyValue("--row"));
const rowAt = (at) => pieces.get(Math.floor(at / PIECE))?.[at % PIECE];
const load = async (parameters) => {
  const mine = pieces;
  const pairs = queryOf(state);
  const answer = await ask("rows", [...pairs, ["limit", PIECE], ...parameters]);
  if (mine !== pieces) return null; // of a query that nobody asks any more
  pieces.set(Math.floor(answer.offset / PIECE), answer.rows);
  return answer;
};
const need = (piece) => {
  if (pieces.has(piece) || piece < 0 || piece * PIECE >= total) return;
  pieces.set(piece, null);
  load([["offset", piece * PIECE]]).then(paint, (thrown) => $("list-fault").replaceChildren(faultBox(fault(thrown))));
};
const stretch = () => { $("body").style.height = `${total * rowHeight()}px`; };
const paint = () => {
  const height = rowHeight();
  const view = $("table");
  const first = Math.max(0, Math.floor(view.scrollTop / height) - 8);
  const last = Math.min(total, Math.ceil((view.scrollTop + view.clientHeight) / height) + 8);
  stretch();
  const rows = [];
  for (let at = first; at < last; at += 1) {
    const row = rowAt(at);
    if (!row) need(Math.floor(at / PIECE));
    else rows.push(rowElement(row, at, height));
  }
  $("body").replaceChildren(...rows);
};
const rowElement = (row, at, height) => {
  const cells = listed.map((one) => {
    const [text, tone] = one.name === "outcome" ? verdict(row) : [shown(row[one.name]), ""];
    return make("span", { role: "cell", class: `${one.name} ${number(one) ? "number" : ""} ${tone}` }, text);
  });
  const open = row.id === state.episode;
  const element = make("div", { role: "row", class: "row", "aria-rowindex": at + 2, "aria-current": open && "true", onclick: () => openAt(at, true) }, ...cells);
  element.style.transform = `translateY(${at * height}px)`;
  return element;
};
const renew = async () => {
  pieces = new Map();
  $("list-fault").replaceChildren();
  try {
    const answer = await load(state.episode ? [["around", state.episode]] : []);
    if (!answer) return;
    total = answer.total;
    position = answer.position;
    $("count").textContent = total === about.episodes ? many(total, "episode") : `${many(total, "episode")} of ${about.episodes.toLocaleString("en")}`;
    $("table").setAttribute("aria-rowcount", total + 1);
    countFilters(answer.counts);
    stretch();
    $("table").scrollTop = 0;
    if (position !== null) reveal(position, true);
  } catch (thrown) {
    if (recorded === null && String(thrown.error).startsWith("there is no episode")) return renewWithout(); // the episode says so
    total = 0;
    position = null;
    $("count").textContent = "";
    $("list-fault").replaceChildren(faultBox(fault(thrown)));
  }
  paint();
  placeText();
};
const renewWithout = async () => {
  const { episode } = state;
  state.episode = null;
  const done = renew();
  state.episode = episode;
  await done;
};
const reveal = (at, middle = false) => {
  const view = $("table");
  const height = rowHeight();
  const head = $("head").offsetHeight;
  const top = at * height;
  if (top < view.scrollTop || top + height + head > view.scrollTop + view.clientHeight) {
    view.scrollTop = middle ? top - view.clientHeight / 2 : top < view.scrollTop ? top : top + height + head - view.clientHeight;
  }
};
const openAt = async (at, push = false) => {
  if (at < 0 || at >= total) return;
  position = at;
  reveal(at);
  if (!rowAt(at)) {
    pieces.delete(Math.floor(at / PIECE));
    try {
      await load([["offset", Math.floor(at / PIECE) * PIECE]]);
    } catch (thrown) {
      $("list-fault").replaceChildren(faultBox(fault(thrown)));
      return;
    }
  }
  if (position === at && rowAt(at)) go({ episode: rowAt(at).id, step: null }, push);
};
const move = (by) => openAt(position === null ? 0 : position + by);
const placeText = () => {
  $("position").textContent = position === null || !total ? "" : `${(position + 1).toLocaleString("en")} of ${total.toLocaleString("en")}`;
  $("previous").disabled = !total || position === 0;
  $("next").disabled = !total || position === total - 1;
};

// Filters
const buildFilters = () => {
  for (const one of about.fields.filter((each) => each.values && each.values.length > 1)) {
    const choices = one.values.map((value) => {
      const box = make("input", { type: "checkbox", value, name: one.name, onchange: () => {
        const filters = new Map(state.filters);
        const chosen = new Set(filters.get(one.name));
        if (box.checked) chosen.add(value);
        else chosen.delete(value);
        if (chosen.size) filters.set(one.name, chosen);
        else filters.delete(one.name);
        go({ filters });
      } });
      return make("label", { class: "choice" }, box, make("span", {}, words(value)), make("small", {}));
    });
    $("groups").append(make("fieldset", { title: one.meaning }, make("legend", {}, words(one.name)), make("div", { class: "choices" }, ...choices)));
  }
};
const boxes = () => $("groups").querySelectorAll("input");
const showFilters = () => {
  boxes().forEach((box) => { box.checked = state.filters.get(box.name)?.has(box.value) ?? false; });
  if (document.activeElement !== $("text")) $("text").value = state.q;
  $("clear").hidden = !(state.q || state.filters.size);
  for (const cell of $("head").children) {
    if (state.sort.replace(/^-/, "") === cell.dataset.name) cell.setAttribute("aria-sort", state.sort.startsWith("-") ? "descending" : "ascending");
    else cell.removeAttribute("aria-sort");
    const arrow = { ascending: " \u2191", descending: " \u2193" }[cell.getAttribute("aria-sort")] ?? "";
    cell.firstChild.textContent = cell.dataset.title + arrow;
  }
};
const countFilters = (counts) => {
  boxes().forEach((box) => {
    const count = counts[box.name][box.value];
    box.parentElement.classList.toggle("none", count === 0);
    box.parentElement.lastChild.textContent = count.toLocaleString("en");
  });
};
const buildHead = () => {
  for (const one of listed) {
    const title = words(one.name === "id" ? "episode" : one.name.replace(/_(m|n|rad)$/, "")) + (one.unit ? `, ${one.unit}` : "");
    const next = () => {
      const order = [one.name, `-${one.name}`, ""];
      return order[(order.indexOf(state.sort) + 1) % 3];
    };
    const button = make("button", { type: "button", title: `${one.meaning}: sort by it`, onclick: () => go({ sort: next() }) }, title);
    const cell = make("span", { role: "columnheader", class: number(one) ? "number" : "" }, button);
    cell.dataset.name = one.name;
    cell.dataset.title = title;
    $("head").append(cell);
  }
  const labels = about.fields.find((one) => one.name === "failure")?.width ?? 0; // shown in place of "failed"
  const wide = (one) => `${Math.max(one.width, one.name === "outcome" ? labels : 0) * (one.name === "id" ? 1 : 0.8) + 2.6}ch`;
  $("table").style.setProperty("--columns", listed.map(wide).join(" "));
};

// The episode that is open
const known = new Map(); // answers about episodes, a few hundred
const played = new Map(); // what was played again, by episode and step
const episodeOf = async (name) => {
  if (!known.has(name)) {
    known.set(name, ask("episode", [["episode", name]]).catch((thrown) => { known.delete(name); throw thrown; }));
    if (known.size > 300) known.delete(known.keys().next().value);
  }
  return known.get(name);
};
let soon = 0;
const showEpisode = async () => {
  const name = state.episode;
  document.body.dataset.view = name ? "episode" : "list";
  document.title = name ? `${name} - ${about.name}` : `${about.name} - rema view`;
  placeText();
  if (!name) {
    $("shown").replaceChildren(make("p", { class: "wait" }, "Choose an episode in the list."));
    return;
  }
  try {
    const episode = await episodeOf(name);
    if (name !== state.episode) return;
    $("shown").replaceChildren(...episodeElements(name, episode));
  } catch (thrown) {
    if (name === state.episode) $("shown").replaceChildren(faultBox(fault(thrown)));
  }
  clearTimeout(soon);
  soon = setTimeout(prefetch, 150);
};
const prefetch = () => {
  if (position === null || recorded) return;
  for (const at of [position + 1, position - 1]) {
    const row = rowAt(at);
    if (row) episodeOf(row.id).then((episode) => { if (episode.steps.length) new Image().src = pictureOf(row.id, episode.steps.at(-1).step, "scene"); }, () => {});
  }
};
const stepOf = (episode) => episode.steps.find((step) => step.step === state.step) ?? episode.steps.at(-1);
const episodeElements = (name, episode) => {
  const [text, tone] = verdict(episode.row);
  const title = make("div", { class: "title" }, make("h2", {}, name), make("span", { class: `pill ${tone}` }, text));
  if (!episode.steps.length) return [title, faultBox({ error: `No step of it is recorded: the episode was ${text}.`, hint: episode.row.infra_error ?? "" })];
  const step = stepOf(episode);
  if (state.step !== null && step.step !== state.step) {
    return [title, faultBox({ error: `${name} has no step ${state.step}`, hint: `its steps are, from 0: ${episode.steps.map((one) => one.step).join(", ")}` })];
  }
  const tabs = make("nav", { class: "steps", "aria-label": "Steps" }, ...episode.steps.map((one) => make(
    "button", { type: "button", "aria-pressed": String(one === step), onclick: () => go({ step: one.step }) }, `${one.short}: ${verdict(one)[0]}`,
  )));
  return [title, episode.of > 1 ? tabs : null, ...stepElements(name, step)].filter(Boolean);
};
const drawing = (name, step, what, alt, caption, size) => {
  const image = make("img", { src: pictureOf(name, step.step, what), alt, width: size, height: size, decoding: "async" });
  const figure = make("figure", {}, image, make("figcaption", {}, caption));
  image.addEventListener("error", async () => {
    let said = { error: `${alt} cannot be shown`, hint: "" };
    try {
      const answer = await fetch(image.src);
      if (!answer.ok) said = await answer.json();
    } catch { said.hint = "the server does not answer: start it again"; }
    figure.replaceChildren(faultBox(said));
  });
  return figure;
};
const stepElements = (name, step) => {
  const found = [];
  const [text, tone] = verdict(step);
  if (step.action) {
    const hands = [1, 2].map((one) => drawing(name, step, `ee${one}`, `End-effector map, state ${one}, of step ${step.step + 1} of ${name}`, `end effector, state ${one}`, 200));
    found.push(
      make("div", { class: "maps" }, drawing(name, step, "scene", step.alt, "scene height map and the action", 384), make("div", { class: "hands" }, ...hands)),
      make("p", { class: "legend" }, ...about.legend.map(([colour, says]) => {
        const key = make("i");
        key.style.background = colour;
        return make("span", {}, key, says);
      })),
    );
  }
  const facts = [["step", step.title], ["action", step.action ?? "the policy gave none"], ["may touch the target", step.touching]];
  facts.push(["outcome", make("span", { class: tone }, step.why ? `${text}: ${step.why}` : text)]);
  if (step.measured) facts.push(["measured", step.measured]);
  found.push(make("dl", { class: "facts" }, ...facts.flatMap(([key, value]) => [make("dt", {}, key), make("dd", {}, value)])));
  if (step.action) found.push(playElement(name, step));
  found.push(table("evidence", step.evidence), make("details", {}, make("summary", {}, "all recorded columns"), table("", step.columns)));
  return found;
};
const table = (caption, cells) => make("table", {}, make("caption", {}, caption), make("tbody", {}, ...cells.map((cell) => make(
  "tr", {}, make("th", { scope: "row" }, cell.name),
  make("td", { class: typeof cell.value === "number" ? "number" : "", title: cell.value }, shown(cell.value)),
  make("td", { class: "unit" }, cell.unit), make("td", { class: "says" }, cell.meaning),
))));

// A step that is carried out again
const AGREES = {
  identical: ["This time everything was as recorded, to the last digit.", "mild"],
  "same label": ["This time it ended with the same label, with slightly different measurements.", "mild"],
  different: ["This time it ended differently: the pictures show what happened here, not what was recorded.", "poor"],
};
const playElement = (name, step) => {
  const key = `${name} ${step.step}`;
  const kept = recorded ? recorded.plays[key] : played.get(key);
  const place = make("div");
  const buttons = recorded ? null : make("div", { class: "buttons" },
    make("button", { type: "button", id: "stills", title: "simulate this step again (p)", onclick: () => play("stills", name, step, place) }, "photographs"),
    make("button", { type: "button", id: "film", title: "simulate this step again (f)", onclick: () => play("film", name, step, place) }, "film"),
    make("span", { class: "wait", role: "status" }, "simulates the step again"));
  const box = make("div", { class: "play" }, buttons, place);
  if (kept) showPlayed(place, kept, key);
  return box;
};
const play = async (what, name, step, place) => {
  const key = `${name} ${step.step}`;
  if (what === "film" && !played.get(key)?.before) await play("stills", name, step, place);
  const status = $("shown").querySelector(".wait[role]");
  if (played.get(key)?.failed || what in (played.get(key) ?? {})) return;
  if (status) status.textContent = what === "film" ? "drawing the film, some seconds ..." : "simulating ...";
  try {
    const answer = await ask(what, [["episode", name], ["step", step.step]]);
    played.set(key, { ...played.get(key), ...answer });
    if (played.size > 20) played.delete(played.keys().next().value);
    showPlayed(place, played.get(key), key);
  } catch (thrown) {
    place.replaceChildren(faultBox(fault(thrown)));
  }
  if (status) status.textContent = "";
};
const showPlayed = (place, kept, key) => {
  const picture = (source, caption, size, kind) => make("figure", { class: kind }, make("img", { src: source, alt: `${caption} of step ${key}`, width: size[0], height: size[1] }), make("figcaption", {}, caption));
  const pictures = [picture(kept.before, "before", [480, 360], "")];
  if (kept.after) pictures.push(picture(kept.after, `after: ${words(kept.again)}`, [480, 360], ""));
  if (kept.film) pictures.push(picture(kept.film, "film", [360, 270], "film"));
  const [says, tone] = AGREES[kept.agreement];
  const nothing = kept.after ? null : make("p", { class: "wait" }, "No arm could move, so there is nothing after.");
  place.replaceChildren(make("div", { class: "played" }, ...pictures), make("p", { class: tone }, says));
  if (nothing) place.append(nothing);
};

// Keys
const typing = (target) => target.matches("input[type=search]");
const stepBy = async (by) => {
  if (!state.episode) return;
  const { steps } = await episodeOf(state.episode);
  const at = steps.indexOf(stepOf({ steps })) + by;
  if (at >= 0 && at < steps.length) go({ step: steps[at].step });
};
const KEYS = {
  j: () => move(1), ArrowDown: () => move(1), k: () => move(-1), ArrowUp: () => move(-1),
  ArrowRight: () => stepBy(1), ArrowLeft: () => stepBy(-1),
  PageDown: () => move(20), PageUp: () => move(-20), Home: () => openAt(0), End: () => openAt(total - 1),
  p: () => $("stills")?.click(), f: () => $("film")?.click(),
  "/": () => $("text").focus(), Escape: () => go({ episode: null, step: null }),
};
addEventListener("keydown", (event) => {
  if (event.ctrlKey || event.metaKey || event.altKey) return;
  if (typing(event.target)) {
    if (event.key === "Escape" || event.key === "Enter") $("table").focus();
    return;
  }
  if (event.key.startsWith("Page") && !$("table").contains(event.target) && event.target !== document.body) return;
  const act = KEYS[event.key];
  if (!act) return;
  event.preventDefault();
  act();
});

const apply = () => {
  const before = state;
  state = read();
  showFilters();
  const same = before && queryOf(before).join() === queryOf(state).join();
  const elsewhere = state.episode && rowAt(position ?? -1)?.id !== state.episode;
  if (!same || elsewhere) renew();
  else paint();
  if (!before || before.episode !== state.episode || before.step !== state.step) showEpisode().catch(() => {});
};
const start = () => {
  $("name").textContent = about.name;
  $("under").textContent = recorded ? `${many(about.episodes, "episode")} of ${recorded.of.toLocaleString("en")}` : many(about.episodes, "episode");
  $("facts").append(...about.facts.flatMap(([name, value]) => [make("dt", {}, name), make("dd", {}, value)]));
  $("notices").append(...about.notices.map(faultBox));
  $("made").textContent = `rema view, rema ${about.rema}`;
  $("play-keys").hidden = Boolean(recorded);
  $("facets").open = innerWidth > 1180;
  buildFilters();
  buildHead();
  $("table").addEventListener("scroll", () => requestAnimationFrame(paint), { passive: true });
  addEventListener("resize", paint);
  addEventListener("hashchange", apply);
  let typed = 0;
  $("text").addEventListener("input", () => { clearTimeout(typed); typed = setTimeout(() => go({ q: $("text").value.trim() }), 150); });
  $("filters").addEventListener("submit", (event) => event.preventDefault());
  $("clear").addEventListener("click", () => { $("text").value = ""; go({ filters: new Map(), q: "" }); });
  $("previous").addEventListener("click", () => move(-1));
  $("next").addEventListener("click", () => move(1));
  $("back").addEventListener("click", () => go({ episode: null, step: null }));
  apply();
};
start();
