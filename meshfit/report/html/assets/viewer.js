// Meshes drawn by WebGL. One context draws all views, since browsers allow only a few contexts per page.
"use strict";
class Painter {
  constructor(colours) {
    this.canvas = document.createElement("canvas");
    const gl = this.canvas.getContext("webgl2", { antialias: true, preserveDrawingBuffer: true, alpha: true });
    if (!gl) throw new Error("this browser has no WebGL 2");
    this.gl = gl;
    this.program = program(gl, VERTEX, FRAGMENT);
    this.places = {};
    for (const name of ["view", "zoom", "shift", "painted", "flatness", "ink", "surface"]) {
      this.places[name] = gl.getUniformLocation(this.program, name);
    }
    this.ramp = ramp(gl, colours);
  }

  // Draw a mesh in the state of a Turning onto a canvas of the page.
  draw(mesh, state, onto, look) {
    const { gl, places } = this;
    const width = onto.width, height = onto.height;
    if (this.canvas.width < width) this.canvas.width = width;
    if (this.canvas.height < height) this.canvas.height = height;
    mesh.buffers = mesh.buffers || upload(gl, mesh);
    gl.viewport(0, 0, width, height);
    gl.clearColor(0, 0, 0, 0);
    gl.clear(gl.COLOR_BUFFER_BIT | gl.DEPTH_BUFFER_BIT);
    gl.enable(gl.DEPTH_TEST);
    gl.enable(gl.POLYGON_OFFSET_FILL);
    gl.polygonOffset(1, 1);
    gl.useProgram(this.program);
    const short = Math.min(width, height);
    gl.uniformMatrix3fv(places.view, false, state.matrix());
    gl.uniform3f(places.zoom, (state.zoom * short) / width, (state.zoom * short) / height, state.zoom);
    gl.uniform2f(places.shift, (state.shift[0] * short) / width, (state.shift[1] * short) / height);
    gl.uniform3fv(places.surface, look.surface);
    gl.uniform3fv(places.ink, look.ink);
    gl.uniform1f(places.painted, mesh.values && look.painted ? 1 : 0);
    gl.uniform1f(places.flatness, 0);
    gl.bindVertexArray(mesh.buffers.array);
    gl.bindBuffer(gl.ELEMENT_ARRAY_BUFFER, mesh.buffers.faces);
    const type = mesh.faces instanceof Uint16Array ? gl.UNSIGNED_SHORT : gl.UNSIGNED_INT;
    gl.drawElements(gl.TRIANGLES, mesh.faces.length, type, 0);
    if (look.edges) {
      gl.uniform1f(places.flatness, 1);
      gl.bindBuffer(gl.ELEMENT_ARRAY_BUFFER, edgesOf(gl, mesh));
      gl.drawElements(gl.LINES, mesh.buffers.edgeCount, gl.UNSIGNED_INT, 0);
    }
    const paper = onto.getContext("2d");
    paper.clearRect(0, 0, width, height);
    paper.drawImage(this.canvas, 0, this.canvas.height - height, width, height, 0, 0, width, height);
  }
}

const VERTEX = `#version 300 es
in vec3 position; in vec3 normal; in float value;
uniform mat3 view; uniform vec3 zoom; uniform vec2 shift;
out vec3 towards; out float shown;
void main() {
  vec3 seen = view * position;
  towards = view * normal;
  shown = value;
  gl_Position = vec4(seen.xy * zoom.xy + shift, -seen.z * 0.2, 1.0);
}`;

const FRAGMENT = `#version 300 es
precision highp float;
in vec3 towards; in float shown;
uniform float painted; uniform float flatness; uniform vec3 surface; uniform vec3 ink; uniform sampler2D colours;
out vec4 colour;
void main() {
  vec3 n = normalize(towards);
  if (n.z < 0.0) n = -n;
  float light = 0.34 + 0.42 * max(dot(n, normalize(vec3(0.0, 0.2, 1.0))), 0.0)
    + 0.34 * max(dot(n, normalize(vec3(-0.9, 1.1, 1.0))), 0.0) + 0.1 * max(dot(n, normalize(vec3(1.0, 0.1, 0.6))), 0.0);
  vec3 base = mix(surface, texture(colours, vec2(shown, 0.5)).rgb, painted);
  colour = vec4(mix(base * min(light, 1.08), ink, flatness * 0.85), 1.0);
}`;

function program(gl, vertex, fragment) {
  const made = gl.createProgram();
  for (const [kind, text] of [[gl.VERTEX_SHADER, vertex], [gl.FRAGMENT_SHADER, fragment]]) {
    const shader = gl.createShader(kind);
    gl.shaderSource(shader, text);
    gl.compileShader(shader);
    if (!gl.getShaderParameter(shader, gl.COMPILE_STATUS)) throw new Error(gl.getShaderInfoLog(shader));
    gl.attachShader(made, shader);
  }
  ["position", "normal", "value"].forEach((name, place) => gl.bindAttribLocation(made, place, name));
  gl.linkProgram(made);
  if (!gl.getProgramParameter(made, gl.LINK_STATUS)) throw new Error(gl.getProgramInfoLog(made));
  return made;
}

function ramp(gl, colours) {
  const pixels = new Uint8Array(colours.flatMap((colour) => [...rgb(colour).map((part) => part * 255), 255]));
  const texture = gl.createTexture();
  gl.bindTexture(gl.TEXTURE_2D, texture);
  gl.texImage2D(gl.TEXTURE_2D, 0, gl.RGBA, colours.length, 1, 0, gl.RGBA, gl.UNSIGNED_BYTE, pixels);
  gl.texParameteri(gl.TEXTURE_2D, gl.TEXTURE_MIN_FILTER, gl.LINEAR);
  gl.texParameteri(gl.TEXTURE_2D, gl.TEXTURE_WRAP_S, gl.CLAMP_TO_EDGE);
  gl.texParameteri(gl.TEXTURE_2D, gl.TEXTURE_WRAP_T, gl.CLAMP_TO_EDGE);
  return texture;
}

function rgb(colour) {
  return [1, 3, 5].map((place) => parseInt(colour.slice(place, place + 2), 16) / 255);
}

function upload(gl, mesh) {
  const array = gl.createVertexArray();
  gl.bindVertexArray(array);
  const attribute = (place, data, size, type, normalised) => {
    gl.bindBuffer(gl.ARRAY_BUFFER, gl.createBuffer());
    gl.bufferData(gl.ARRAY_BUFFER, data, gl.STATIC_DRAW);
    gl.enableVertexAttribArray(place);
    gl.vertexAttribPointer(place, size, type, normalised, 0, 0);
  };
  attribute(0, mesh.verts, 3, gl.FLOAT, false);
  attribute(1, normalsOf(mesh), 3, gl.FLOAT, false);
  attribute(2, mesh.values || new Uint8Array(mesh.verts.length / 3), 1, gl.UNSIGNED_BYTE, true);
  const faces = gl.createBuffer();
  gl.bindBuffer(gl.ELEMENT_ARRAY_BUFFER, faces);
  gl.bufferData(gl.ELEMENT_ARRAY_BUFFER, mesh.faces, gl.STATIC_DRAW);
  return { array, faces };
}

// The normal of each vertex: the area-weighted sum of those of its faces.
function normalsOf({ verts, faces }) {
  const normals = new Float32Array(verts.length);
  const at = (index, axis) => verts[3 * index + axis];
  for (let i = 0; i < faces.length; i += 3) {
    const [a, b, c] = [faces[i], faces[i + 1], faces[i + 2]];
    const u = [0, 1, 2].map((axis) => at(b, axis) - at(a, axis));
    const v = [0, 1, 2].map((axis) => at(c, axis) - at(a, axis));
    const n = [u[1] * v[2] - u[2] * v[1], u[2] * v[0] - u[0] * v[2], u[0] * v[1] - u[1] * v[0]];
    for (const vert of [a, b, c]) for (let axis = 0; axis < 3; axis++) normals[3 * vert + axis] += n[axis];
  }
  return normals;
}

function edgesOf(gl, mesh) {
  if (!mesh.buffers.edges) {
    const seen = new Set();
    const found = [];
    const count = mesh.verts.length / 3;
    for (let i = 0; i < mesh.faces.length; i++) {
      const a = mesh.faces[i], b = mesh.faces[i % 3 === 2 ? i - 2 : i + 1];
      const key = Math.min(a, b) * count + Math.max(a, b);
      if (!seen.has(key)) {
        seen.add(key);
        found.push(a, b);
      }
    }
    mesh.buffers.edges = gl.createBuffer();
    mesh.buffers.edgeCount = found.length;
    gl.bindBuffer(gl.ELEMENT_ARRAY_BUFFER, mesh.buffers.edges);
    gl.bufferData(gl.ELEMENT_ARRAY_BUFFER, new Uint32Array(found), gl.STATIC_DRAW);
  }
  return mesh.buffers.edges;
}

// Read a scene: the length of a JSON text, that text, and the arrays whose offsets it contains.
function readScene(buffer) {
  const length = new DataView(buffer).getUint32(0, true);
  const scene = JSON.parse(new TextDecoder().decode(new Uint8Array(buffer, 4, length)));
  const part = (Type, [begin, bytes]) => new Type(buffer, 4 + length + begin, bytes / Type.BYTES_PER_ELEMENT);
  for (const mesh of scene.meshes) {
    const steps = part(Uint16Array, mesh.arrays.verts);
    mesh.verts = new Float32Array(steps.length);
    for (let i = 0; i < steps.length; i++) {
      const place = mesh.low[i % 3] + (steps[i] / 65535) * mesh.extent;
      mesh.verts[i] = (place - scene.centre[i % 3]) / scene.radius;
    }
    mesh.faces = part(mesh.wide ? Uint32Array : Uint16Array, mesh.arrays.faces);
    mesh.values = mesh.arrays.values && part(Uint8Array, mesh.arrays.values);
  }
  return scene;
}
