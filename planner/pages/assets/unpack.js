"use strict";
/* Everything of ours lives in one object. This file turns the page's compressed parts into data:
   JSON in which {"$": [type, shape, offset]} stands for an array (see planner/pages/payload.py). */
const Opposable = { errors: [], extensions: [] };

window.addEventListener("error", (event) => Opposable.errors.push(String(event.message)));
window.addEventListener("unhandledrejection", (event) =>
  Opposable.errors.push(String(event.reason)));

/** The unpacked bytes of the element with this id, as an ArrayBuffer; null if there is none. */
Opposable.unpack = async function (id) {
  const element = document.getElementById(id);
  if (!element) return null;
  const packed = atob(element.textContent);
  const bytes = new Uint8Array(packed.length);
  for (let i = 0; i < packed.length; i++) bytes[i] = packed.charCodeAt(i);
  const stream = new Blob([bytes]).stream().pipeThrough(new DecompressionStream("gzip"));
  return new Response(stream).arrayBuffer();
};

/** An array with a shape: {data, shape}; row(i) is a view of what the first index i holds. */
class NumberArray {
  constructor(data, shape) {
    this.data = data;
    this.shape = shape;
    this.stride = shape.slice(1).reduce((a, b) => a * b, 1);
  }
  get length() { return this.shape[0]; }
  row(i) { return this.data.subarray(i * this.stride, (i + 1) * this.stride); }
}

/** Data out of the bytes that planner.pages.payload packed. */
Opposable.decode = function (buffer) {
  const types = {
    f4: Float32Array, f8: Float64Array, u1: Uint8Array, u2: Uint16Array, u4: Uint32Array,
  };
  const length = new DataView(buffer).getUint32(0, true);
  const text = new TextDecoder().decode(new Uint8Array(buffer, 4, length));
  const start = 4 + length;
  return JSON.parse(text, (key, value) => {
    if (value === null || typeof value !== "object" || !("$" in value)) return value;
    const [type, shape, offset] = value.$;
    const count = shape.reduce((a, b) => a * b, 1);
    return new NumberArray(new types[type](buffer, start + offset, count), shape);
  });
};

/** Numbers as an array with rows, whether they came as JSON or as bytes. */
Opposable.rows = function (value) {
  return value instanceof NumberArray ? value : new NumberArray(Float64Array.from(value), [value.length]);
};

/** Runs a script's text in this page. */
Opposable.run = function (text) {
  const element = document.createElement("script");
  element.textContent = text;
  document.head.appendChild(element);
};

/** A colour for each finger, in the order in which they are first named; the same everywhere. */
Opposable.palette = (function () {
  const colours = ["#d55e00", "#0072b2", "#009e73", "#cc79a7", "#56b4e9", "#e69f00", "#7570b3", "#666666"];
  const known = new Map();
  return function (name) {
    if (!known.has(name)) known.set(name, colours[known.size % colours.length]);
    return known.get(name);
  };
})();
