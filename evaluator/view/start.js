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
