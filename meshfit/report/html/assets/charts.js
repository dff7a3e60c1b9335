// A row of a table can be hidden in the charts of its target.
"use strict";
for (const article of document.querySelectorAll("[data-charts]")) {
  for (const key of article.querySelectorAll(".key")) {
    key.addEventListener("click", () => {
      const shown = key.getAttribute("aria-pressed") !== "true";
      key.setAttribute("aria-pressed", String(shown));
      for (const series of article.querySelectorAll(`.row-${key.dataset.row}`)) series.style.display = shown ? "" : "none";
    });
  }
}
