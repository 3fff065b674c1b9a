"use strict";
const filter = document.querySelector(".filter");
if (filter) {
  const buttons = filter.querySelectorAll("[data-show]");
  const press = (button, on) => button.setAttribute("aria-pressed", String(on));
  buttons.forEach((button) => button.addEventListener("click", () => {
    const label = button.dataset.show;
    buttons.forEach((other) => press(other, other === button));
    document.querySelectorAll("article").forEach((card) => { card.hidden = label !== "" && card.dataset.label !== label; });
  }));
  const films = filter.querySelector(".films");
  if (films) films.addEventListener("click", () => {
    const open = films.getAttribute("aria-pressed") !== "true";
    press(films, open);
    document.querySelectorAll("article details").forEach((film) => { film.open = open; });
  });
  filter.hidden = false;
}
