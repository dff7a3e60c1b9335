// Curves and histograms, drawn by plotly when they are looked at.
"use strict";
const CONFIG = { responsive: true, displaylogo: false, displayModeBar: false };
const hidden = new Set();
let walls, ready;

function library() {
  ready = ready || unpack("plotly").then((bytes) => {
    const script = document.createElement("script");
    script.textContent = new TextDecoder().decode(bytes);
    document.head.append(script);
  });
  return ready;
}

async function data() {
  walls = walls || JSON.parse(new TextDecoder().decode(await unpack("charts-data")));
  await library();
  return walls;
}

const colour = (row) => style(`--row-${row % 10}`);
const DASHES = ["solid", "dash", "dot", "dashdot"];
const dash = (row) => DASHES[Math.floor(row / 10) % DASHES.length];

function layout(title, x, y, extra) {
  const line = { gridcolor: style("--rule"), linecolor: style("--rule"), zeroline: false, automargin: true };
  return {
    title: { text: title, font: { size: 14 }, x: 0, xref: "paper", xanchor: "left", y: 0.97, yref: "container" },
    font: { family: style("--font"), size: 12, color: style("--ink") },
    paper_bgcolor: "rgba(0,0,0,0)",
    plot_bgcolor: "rgba(0,0,0,0)",
    margin: { l: 48, r: 10, t: 34, b: 40 },
    showlegend: false,
    hovermode: "closest",
    dragmode: matchMedia("(pointer: coarse)").matches ? false : "zoom",
    xaxis: { ...line, title: { text: x, standoff: 6 }, ...extra?.xaxis },
    yaxis: { ...line, title: { text: y, standoff: 4 }, exponentformat: "power", ...extra?.yaxis },
  };
}

function plot(place, traces, shape) {
  let chart = place.querySelector(".chart");
  if (!chart) {
    chart = document.createElement("div");
    chart.className = "chart";
    place.append(chart);
  }
  return Plotly.react(chart, traces, shape, CONFIG);
}

function panel(parent, id) {
  let found = document.getElementById(id);
  if (!found) {
    found = document.createElement("div");
    found.id = id;
    found.className = "panel";
    parent.append(found);
  }
  return found;
}

function lines(wall, term, byTime) {
  return wall.curves
    .filter((curve) => curve.values[term] && !hidden.has(curve.row) && !(byTime && curve.seconds === null))
    .map((curve) => {
      const last = curve.steps[curve.steps.length - 1] || 1;
      return {
        type: "scatter",
        mode: "lines",
        x: byTime ? curve.steps.map((step) => (step / last) * curve.seconds) : curve.steps,
        y: curve.values[term],
        name: `${wall.rows[curve.row]}, seed ${curve.seed}`,
        line: { color: colour(curve.row), width: 1.3, dash: dash(curve.row) },
        opacity: 0.75,
        hovertemplate: `%{y:.4g} at %{x:.4g}<extra>%{fullData.name}</extra>`,
      };
    });
}

function ends(wall) {
  return wall.present
    .filter((row) => !hidden.has(row))
    .map((row) => {
      const mine = wall.ends.filter((end) => end.row === row);
      return {
        type: "scatter",
        mode: "markers",
        x: mine.map((end) => end.seconds),
        y: mine.map((end) => end.value),
        text: mine.map((end) => `seed ${end.seed}`),
        name: wall.rows[row],
        marker: { color: colour(row), size: 8 },
        hovertemplate: `%{y:.4g} after %{x:.3g} s, %{text}<extra>%{fullData.name}</extra>`,
      };
    });
}

function logarithmic(wall, term) {
  const values = wall.curves.flatMap((curve) => curve.values[term] || []).filter((value) => value !== null);
  const [least, most] = values.reduce(([low, high], value) => [Math.min(low, value), Math.max(high, value)], [Infinity, 0]);
  if (!document.getElementById("log-scale").checked || !(least > 0)) return { rangemode: "tozero" };
  return { type: "log", dtick: most > 30 * least ? 1 : most > 4 * least ? "D2" : undefined };
}

async function drawCurves() {
  const wall = (await data())[document.getElementById("curve-wall").value];
  const parent = document.getElementById("curve-charts");
  const used = new Set();
  const show = (id, traces, shape) => {
    used.add(id);
    const place = panel(parent, id);
    parent.append(place);
    return plot(place, traces, shape);
  };
  keys(wall);
  note(wall);
  if (wall.nearness) {
    const axis = { yaxis: logarithmic(wall, wall.nearness) };
    await show("curve-time", lines(wall, wall.nearness, true), layout(`${wall.nearness} by time`, "seconds, spread evenly over steps", "", axis));
  }
  if (wall.ends.length) {
    const axis = { xaxis: { rangemode: "tozero" }, yaxis: { rangemode: "tozero" } };
    await show("curve-ends", ends(wall), layout(`${wall.metric}, at the end`, "seconds that the fit took", "", axis));
  }
  for (const [place, term] of wall.terms.entries()) {
    await show(`curve-${place}`, lines(wall, term, false), layout(term, "step", "", { yaxis: logarithmic(wall, term) }));
  }
  for (const old of [...parent.children]) {
    if (!used.has(old.id)) {
      if (old.querySelector(".chart")) Plotly.purge(old.querySelector(".chart"));
      old.remove();
    }
  }
}

function keys(wall) {
  const place = document.getElementById("curve-keys");
  place.replaceChildren(...wall.present.map((row) => {
    const button = document.createElement("button");
    button.type = "button";
    button.className = "key";
    button.setAttribute("aria-pressed", String(!hidden.has(row)));
    const swatch = document.createElement("span");
    swatch.className = "swatch";
    swatch.style.setProperty("--row", `var(--row-${row % 10})`);
    button.append(swatch, wall.rows[row]);
    button.addEventListener("click", () => {
      if (!hidden.delete(row)) hidden.add(row);
      drawCurves();
    });
    return button;
  }));
}

function note(wall) {
  const shown = wall.curves.length;
  const all = wall.trials;
  document.getElementById("curve-note").textContent =
    shown < all ? `${shown} of ${all} trials have a curve here; the page has room for the first seeds of each row.` : "";
}

async function drawHistograms() {
  const parent = document.getElementById("histogram-charts");
  for (const wall of await data()) {
    const { limit, rows } = wall.histogram;
    if (!rows.length) continue;
    const bins = rows[0].shares.length;
    const ends = Array.from({ length: bins + 1 }, (_, i) => (i * limit) / bins);
    const traces = rows.map(({ row, shares, beyond }) => ({
      type: "scatter",
      mode: "lines",
      line: { shape: "hv", color: colour(row), width: 1.8, dash: dash(row) },
      x: ends,
      y: [...shares, shares[bins - 1]],
      fill: "tozeroy",
      fillcolor: `${colour(row)}22`,
      name: beyond >= 0.05 ? `${wall.rows[row]} (${beyond.toFixed(1)} % beyond)` : wall.rows[row],
      hovertemplate: `%{y:.2f} % of the area from %{x:.3g} off<extra>%{fullData.name}</extra>`,
    }));
    const shape = layout(wall.title, `distance to the target (${wall.unit})`, "% of area", {
      xaxis: { range: [0, limit] },
      yaxis: { rangemode: "tozero" },
    });
    await plot(panel(parent, `histogram-${wall.key}`), traces, {
      ...shape,
      showlegend: true,
      legend: { x: 1, xanchor: "right", y: 1, bgcolor: "rgba(0,0,0,0)" },
    });
  }
}

function failed(id) {
  return (error) => {
    const place = document.createElement("p");
    place.className = "problem";
    place.textContent = `Charts cannot be drawn here: ${error.message}`;
    document.getElementById(id).append(place);
  };
}

function drawn(id, draw) {
  const act = () => draw().catch(failed(id));
  whenNear(document.getElementById(id), () => {
    act();
    document.addEventListener("themechange", act);
  });
  return act;
}

const again = drawn("curve-charts", drawCurves);
drawn("histogram-charts", drawHistograms);
document.getElementById("curve-tools").hidden = false;
for (const id of ["curve-wall", "log-scale"]) document.getElementById(id).addEventListener("change", again);
