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
