"use strict";
/* Curves and bars over the scene's time, drawn as SVG, with one cursor that moves the scene. */
Opposable.Plots = class {
  constructor(parent, scene, clock) {
    this.clock = clock;
    this.scene = scene;
    this.items = [];
    for (const plot of scene.plots) this.items.push(this.figure(parent, plot, null));
    for (const bars of scene.bars) this.items.push(this.figure(parent, null, bars));
    if (!this.items.length) return;
    this.draw();
    let width = parent.clientWidth;
    new ResizeObserver(() => {
      if (parent.clientWidth !== width) {
        width = parent.clientWidth;
        this.draw();
      }
    }).observe(parent);
    clock.listen(() => this.moveCursor());
  }

  figure(parent, plot, bars) {
    const figure = document.createElement("figure");
    figure.className = "plot";
    const caption = document.createElement("figcaption");
    const title = document.createElement("strong");
    title.textContent = plot && plot.unit ? `${plot.title} (${plot.unit})` : (plot || bars).title;
    caption.appendChild(title);
    const values = [];
    if (plot) {
      for (const line of plot.lines) {
        const key = document.createElement("span"), value = document.createElement("output");
        key.className = line.dashed ? "key dashed" : "key";
        key.style.setProperty("--colour", this.colour(line));
        key.textContent = line.name;
        key.appendChild(value);
        caption.appendChild(key);
        values.push(value);
      }
    } else {
      for (const [state, colour] of Object.entries(bars.colours)) {
        const key = document.createElement("span");
        key.className = "key block";
        key.style.setProperty("--colour", colour);
        key.textContent = state;
        caption.appendChild(key);
      }
    }
    figure.appendChild(caption);
    const svg = Opposable.svg("svg", { role: "img", "aria-label": title.textContent }, figure);
    parent.appendChild(figure);
    const item = { plot, bars, svg, values, cursor: null };
    Opposable.dragTime(svg, this.clock, () => Opposable.timeScale(this.clock, svg.clientWidth));
    return item;
  }

  colour(line) { return Opposable.palette(line.group || line.name); }

  draw() {
    for (const item of this.items) {
      item.svg.replaceChildren();
      const width = Math.max(200, item.svg.clientWidth);
      if (item.plot) this.drawPlot(item, width); else this.drawBars(item, width);
    }
    this.moveCursor();
  }

  /** Bands, marks, time axis and cursor, which all figures have. */
  ground(item, width, top, bottom) {
    const { svg } = item, scale = Opposable.timeScale(this.clock, width);
    svg.setAttribute("height", bottom + 20);
    svg.setAttribute("viewBox", `0 0 ${width} ${bottom + 20}`);
    this.scene.bands.forEach((band, i) => {
      const x = scale.x(band.begin), w = Math.max(0, scale.x(band.end) - x);
      const box = Opposable.svg("rect", {
        x, y: top, width: w, height: bottom - top, class: i % 2 ? "band odd" : "band",
      }, svg);
      Opposable.svg("title", {}, box, band.name);
    });
    for (const t of Opposable.ticks(this.clock.begin, this.clock.end, width / 90)) {
      const x = scale.x(t);
      Opposable.svg("line", { x1: x, x2: x, y1: top, y2: bottom, class: "grid" }, svg);
      Opposable.svg("text", { x, y: bottom + 14, class: "tick middle" }, svg,
        `${Number(t.toPrecision(6))} s`);
    }
    for (const mark of this.scene.marks) {
      const x = scale.x(mark.time);
      const line = Opposable.svg("line", {
        x1: x, x2: x, y1: top, y2: bottom, class: `mark ${mark.kind}`,
      }, svg);
      Opposable.svg("title", {}, line, `${mark.text} (${mark.time.toFixed(2)} s)`);
    }
    return scale;
  }

  drawPlot(item, width) {
    const { plot, svg } = item, top = 6, bottom = 110;
    const scale = this.ground(item, width, top, bottom);
    let low = Infinity, high = -Infinity;
    for (const line of plot.lines) {
      for (const v of Opposable.rows(line.values).data) {
        if (v < low) low = v;
        if (v > high) high = v;
      }
    }
    if (!(low <= high)) [low, high] = [0, 1];
    // 0 belongs to the picture where it is near
    if (low > 0 && low < 0.5 * high) low = 0;
    if (high < 0 && high > 0.5 * low) high = 0;
    if (high - low < 1e-12) [low, high] = [low - 0.5 * (Math.abs(low) || 1), high + 0.5 * (Math.abs(high) || 1)];
    const room = 0.06 * (high - low), y0 = low === 0 ? 0 : low - room, y1 = high + room;
    const y = (v) => bottom - ((v - y0) / (y1 - y0)) * (bottom - top);
    const ticks = Opposable.ticks(y0, y1, 4), step = ticks.length > 1 ? ticks[1] - ticks[0] : 1;
    item.step = step / 10;
    for (const v of ticks) {
      Opposable.svg("line", {
        x1: scale.left, x2: scale.left + scale.inner, y1: y(v), y2: y(v),
        class: Math.abs(v) < 1e-9 * step ? "grid zero" : "grid",
      }, svg);
      Opposable.svg("text", { x: scale.left - 6, y: y(v) + 3.5, class: "tick end" }, svg,
        Opposable.number(v, step));
    }
    for (const line of plot.lines) {
      const path = this.path(Opposable.rows(line.values).data, scale, y);
      Opposable.svg("path", {
        d: path, class: line.dashed ? "curve dashed" : "curve", style: `stroke:${this.colour(line)}`,
      }, svg);
    }
    this.addCursor(item, top, bottom);
  }

  /** A curve with no more points than pixels can show: first, least, largest and last of each. */
  path(values, scale, y) {
    if (values.length === 1) {
      const level = y(values[0]).toFixed(1);
      return `M${scale.left} ${level}H${scale.left + scale.inner}`;
    }
    const { times } = this.clock, out = [];
    let drawing = false, column = -1, points = [];
    const put = (x, v) => {
      out.push(`${drawing ? "L" : "M"}${x.toFixed(1)} ${y(v).toFixed(1)}`);
      drawing = true;
    };
    const flush = () => {
      if (!points.length) return;
      let least = 0, most = 0;
      points.forEach(([, v], i) => {
        if (v < points[least][1]) least = i;
        if (v > points[most][1]) most = i;
      });
      const kept = [...new Set([0, least, most, points.length - 1])].sort((a, b) => a - b);
      for (const i of kept) put(...points[i]);
      points = [];
    };
    for (let i = 0; i < times.length; i++) {
      const v = values[i];
      if (!Number.isFinite(v)) {
        flush();
        drawing = false;
        continue;
      }
      const x = scale.x(times[i]), here = Math.floor(x);
      if (here !== column) flush();
      column = here;
      points.push([x, v]);
    }
    flush();
    return out.join("");
  }

  drawBars(item, width) {
    const { bars, svg } = item, rows = Object.entries(bars.rows), height = 16, top = 6;
    const bottom = top + rows.length * (height + 4);
    const scale = this.ground(item, width, top, bottom), { times } = this.clock;
    rows.forEach(([name, states], r) => {
      const y = top + r * (height + 4) + 2;
      let begin = 0;
      for (let i = 1; i <= states.length; i++) {
        if (i < states.length && states[i] === states[begin]) continue;
        if (states[begin]) {
          const x = scale.x(times[begin]), end = scale.x(i < times.length ? times[i] : this.clock.end);
          const box = Opposable.svg("rect", {
            x, y, width: Math.max(1, end - x), height, rx: 2,
            style: `fill:${bars.colours[states[begin]] || "#888"}`,
          }, svg);
          Opposable.svg("title", {}, box, `${name}: ${states[begin]}`);
        }
        begin = i;
      }
      // over the bars: names are longer than the margin
      Opposable.svg("text", { x: scale.left + 4, y: y + 12, class: "tick over" }, svg, name);
    });
    this.addCursor(item, top, bottom);
  }

  addCursor(item, top, bottom) {
    item.cursor = Opposable.svg("line", { y1: top - 4, y2: bottom + 2, class: "cursor" }, item.svg);
  }

  moveCursor() {
    const sample = this.clock.sample;
    for (const item of this.items) {
      const x = Opposable.timeScale(this.clock, Math.max(200, item.svg.clientWidth)).x(this.clock.time);
      item.cursor.setAttribute("x1", x);
      item.cursor.setAttribute("x2", x);
      item.values.forEach((output, i) => {
        const { data } = Opposable.rows(item.plot.lines[i].values);
        output.textContent = Opposable.number(data[data.length === 1 ? 0 : sample], item.step);
      });
    }
  }
};
