// A row of a table can be hidden in the charts of its target; what is folded is unfolded in print.
"use strict";
let folded = [];
addEventListener("beforeprint", () => {
  folded = [...document.querySelectorAll("details:not([open])")];
  for (const details of folded) details.open = true;
});
addEventListener("afterprint", () => {
  for (const details of folded) details.open = false;
});
for (const article of document.querySelectorAll("[data-charts]")) {
  for (const key of article.querySelectorAll(".key")) {
    key.addEventListener("click", () => {
      const shown = key.getAttribute("aria-pressed") !== "true";
      key.setAttribute("aria-pressed", String(shown));
      for (const series of article.querySelectorAll(`.row-${key.dataset.row}`)) series.style.display = shown ? "" : "none";
    });
  }
}
