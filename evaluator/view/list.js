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
