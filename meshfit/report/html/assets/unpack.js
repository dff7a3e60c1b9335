// Compressed data of the page, unpacked when its section comes near the visible part of the page.
"use strict";
async function unpack(id) {
  const text = document.getElementById(id).textContent.trim();
  const bytes = Uint8Array.from(atob(text), (letter) => letter.charCodeAt(0));
  const stream = new Blob([bytes]).stream().pipeThrough(new DecompressionStream("gzip"));
  return new Response(stream).arrayBuffer();
}

function whenNear(element, action) {
  const watch = new IntersectionObserver(
    (entries) => {
      if (entries.some((entry) => entry.isIntersecting)) {
        watch.disconnect();
        action();
      }
    },
    { rootMargin: "600px" },
  );
  watch.observe(element);
}

function style(name) {
  return getComputedStyle(document.documentElement).getPropertyValue(name).trim();
}
