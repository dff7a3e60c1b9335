// Views turned by mouse, touch and keys; the views of a target turn together.
"use strict";
class Turning {
  constructor(axes) {
    this.first = axes;
    this.reset();
  }

  reset() {
    this.rows = this.first.map((row) => [...row]);
    this.zoom = 1;
    this.shift = [0, 0];
  }

  // Column by column, as WebGL expects.
  matrix() {
    return [0, 1, 2].flatMap((column) => this.rows.map((row) => row[column]));
  }

  // Turn about the axes of the screen, by angles to the right and downwards.
  turn(right, down) {
    const spin = ([first, second], angle) => {
      const [a, b] = [this.rows[first], this.rows[second]];
      const [cos, sin] = [Math.cos(angle), Math.sin(angle)];
      this.rows[first] = a.map((x, i) => cos * x + sin * b[i]);
      this.rows[second] = b.map((x, i) => cos * x - sin * a[i]);
    };
    spin([0, 2], right);
    spin([1, 2], -down);
  }

  scale(factor) {
    this.zoom = Math.min(40, Math.max(0.3, this.zoom * factor));
  }

  move(right, up) {
    this.shift = [this.shift[0] + right, this.shift[1] + up];
  }
}

class Views {
  constructor(figure, painter, scene, look) {
    this.painter = painter;
    this.scene = scene;
    this.look = look;
    this.turning = new Turning(scene.axes);
    this.canvases = [...figure.querySelectorAll("canvas")];
    this.canvases.forEach((canvas) => this.listen(canvas));
    new ResizeObserver(() => this.request()).observe(figure);
    this.request();
  }

  request() {
    if (this.pending) return;
    this.pending = requestAnimationFrame(() => {
      this.pending = 0;
      this.drawAll();
    });
  }

  drawAll() {
    this.canvases.forEach((canvas, place) => this.draw(canvas, this.scene.meshes[place]));
  }

  draw(canvas, mesh) {
    const sharp = Math.min(devicePixelRatio || 1, 2);
    const [width, height] = [canvas.clientWidth * sharp, canvas.clientHeight * sharp].map(Math.round);
    if (!width || !height) return;
    if (canvas.width !== width) canvas.width = width;
    if (canvas.height !== height) canvas.height = height;
    this.painter.draw(mesh, this.turning, canvas, this.look());
    canvas.dataset.drawn = "yes";
  }

  listen(canvas) {
    const fingers = new Map();
    const changed = (action) => {
      action();
      this.request();
    };
    canvas.addEventListener("pointerdown", (event) => {
      canvas.setPointerCapture(event.pointerId);
      fingers.set(event.pointerId, [event.clientX, event.clientY]);
    });
    canvas.addEventListener("pointermove", (event) => {
      const before = fingers.get(event.pointerId);
      if (!before) return;
      const now = [event.clientX, event.clientY];
      const other = [...fingers.entries()].find(([id]) => id !== event.pointerId)?.[1];
      fingers.set(event.pointerId, now);
      const [dx, dy] = [now[0] - before[0], now[1] - before[1]];
      const short = Math.min(canvas.clientWidth, canvas.clientHeight);
      changed(() => {
        if (other) this.turning.scale(apart(now, other) / Math.max(1, apart(before, other)));
        if (other || event.shiftKey || event.buttons === 2) this.turning.move((2 * dx) / short / (other ? 2 : 1), (-2 * dy) / short / (other ? 2 : 1));
        else this.turning.turn((dx / short) * 3, (dy / short) * 3);
      });
    });
    for (const name of ["pointerup", "pointercancel"]) {
      canvas.addEventListener(name, (event) => fingers.delete(event.pointerId));
    }
    canvas.addEventListener("contextmenu", (event) => event.preventDefault());
    canvas.addEventListener("dblclick", () => changed(() => this.turning.reset()));
    canvas.addEventListener("wheel", (event) => {
      if (document.activeElement !== canvas && !event.ctrlKey) return;
      event.preventDefault();
      changed(() => this.turning.scale(Math.exp(-event.deltaY * 0.0015)));
    }, { passive: false });
    canvas.addEventListener("keydown", (event) => {
      const action = KEYS[event.key];
      if (!action || event.ctrlKey || event.metaKey || event.altKey) return;
      event.preventDefault();
      changed(() => action(this.turning));
    });
  }
}

const KEYS = {
  ArrowLeft: (turning) => turning.turn(-0.15, 0),
  ArrowRight: (turning) => turning.turn(0.15, 0),
  ArrowUp: (turning) => turning.turn(0, -0.15),
  ArrowDown: (turning) => turning.turn(0, 0.15),
  "+": (turning) => turning.scale(1.2),
  "=": (turning) => turning.scale(1.2),
  "-": (turning) => turning.scale(1 / 1.2),
  0: (turning) => turning.reset(),
};

function apart(a, b) {
  return Math.hypot(a[0] - b[0], a[1] - b[1]);
}

function start() {
  const all = [];
  let painter;
  const ticked = (id) => document.getElementById(id)?.checked ?? false;
  const look = () => ({
    painted: ticked("show-distances"),
    edges: ticked("show-edges"),
    surface: rgb(style("--surface-3d")),
    ink: rgb(style("--edges-3d")),
  });
  const redraw = () => all.forEach((views) => views.request());
  const refuse = (error) => {
    const place = document.getElementById("no-3d");
    place.hidden = false;
    const remedy = document.getElementById("pictures") ? " The pictures above show the same meshes." : "";
    place.textContent = `3D views do not work here: ${error.message}.${remedy}`;
  };
  try {
    painter = new Painter(document.getElementById("colours").textContent.split(","));
  } catch (error) {
    refuse(error);
    return;
  }
  document.getElementById("scene-tools").hidden = false;
  for (const id of ["show-distances", "show-edges"]) document.getElementById(id)?.addEventListener("change", redraw);
  document.getElementById("reset-views").addEventListener("click", () => {
    all.forEach((views) => views.turning.reset());
    redraw();
  });
  document.addEventListener("themechange", redraw);
  // Scenes that nobody has come near to are unpacked when there is nothing else to do, so that they print.
  const waiting = [...document.querySelectorAll("[data-scene]")].map((figure) => {
    let begun;
    const begin = () => {
      begun = begun || unpack(`data-${figure.dataset.scene}`)
        .then((bytes) => all.push(new Views(figure, painter, readScene(bytes), look)))
        .catch(refuse);
      return begun;
    };
    whenNear(figure, begin);
    return begin;
  });
  const idly = window.requestIdleCallback || ((action) => setTimeout(action, 200));
  const next = () => {
    const begin = waiting.shift();
    if (begin) begin().then(() => idly(next));
  };
  idly(next);
  addEventListener("beforeprint", () => all.forEach((views) => views.drawAll()));
}

// Views that could not be drawn print as the pictures of the same meshes, which the page may have.
function drawStills() {
  for (const canvas of document.querySelectorAll("canvas:not([data-drawn])")) {
    const scene = canvas.closest("[data-scene]").dataset.scene;
    const titles = [...document.querySelectorAll(`#pictures-${scene} .picture`)];
    const picture = titles.find((shown) => shown.querySelector("b").textContent === canvas.dataset.title);
    const image = picture && picture.querySelector("img");
    if (!image || !image.complete) continue;
    const side = Math.max(image.naturalWidth, image.naturalHeight);
    canvas.width = canvas.height = side;
    const [left, top] = [(side - image.naturalWidth) / 2, (side - image.naturalHeight) / 2];
    canvas.getContext("2d").drawImage(image, left, top);
  }
}
start();
addEventListener("beforeprint", drawStills);
