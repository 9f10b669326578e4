"use strict";
/* Small helpers for SVG: elements, scales, ticks. */
Opposable.svg = function (name, attributes, parent, text) {
  const element = document.createElementNS("http://www.w3.org/2000/svg", name);
  for (const [key, value] of Object.entries(attributes || {})) element.setAttribute(key, value);
  if (text !== undefined) element.textContent = text;
  if (parent) parent.appendChild(element);
  return element;
};

/** Round numbers from low to high, about n of them. */
Opposable.ticks = function (low, high, n) {
  const span = high - low;
  if (!(span > 0)) return [low];
  const raw = span / n, power = 10 ** Math.floor(Math.log10(raw));
  const step = power * [1, 2, 5, 10].find((s) => s * power >= raw);
  const out = [];
  for (let i = Math.ceil(low / step - 1e-9); i * step <= high + 1e-9 * span; i++) out.push(i * step);
  return out;
};

/** A number in as few digits as tell it from its neighbours, which are this far away. */
Opposable.number = function (value, step) {
  if (!Number.isFinite(value)) return "\u2013";
  const digits = Math.max(0, Math.min(6, -Math.floor(Math.log10(step || 1) + 1e-9)));
  if (Math.abs(value) >= 1e5 || (step && step < 1e-6)) return value.toExponential(1);
  return value.toFixed(digits);
};

/** Horizontal layout that the timeline and all plots share, in pixels. */
Opposable.margins = { left: 52, right: 12 };

/** Time -> x in an element of this width, and back. */
Opposable.timeScale = function (clock, width) {
  const { left, right } = Opposable.margins, span = Math.max(1e-9, clock.end - clock.begin);
  const inner = Math.max(10, width - left - right);
  return {
    left, inner,
    x: (time) => left + ((time - clock.begin) / span) * inner,
    time: (x) => clock.begin + ((x - left) / inner) * span,
  };
};

/** Makes dragging within an element move the clock; left() is where its time axis begins. */
Opposable.dragTime = function (element, clock, scale) {
  let active = false;
  const seek = (event) => {
    const box = element.getBoundingClientRect();
    clock.seek(scale().time(event.clientX - box.left));
  };
  element.addEventListener("pointerdown", (event) => {
    if (event.button !== 0) return;
    active = true;
    element.setPointerCapture(event.pointerId);
    clock.pause();
    seek(event);
  });
  element.addEventListener("pointermove", (event) => { if (active) seek(event); });
  for (const end of ["pointerup", "pointercancel"]) {
    element.addEventListener(end, () => { active = false; });
  }
};
