// A grid of grasps: thumbnails of the rows on the screen alone, filters, sorting, and a panel for the
// grasp that is clicked. Data: /rows (columns), /poses (places of hands), /details/N, /grasp/N.
"use strict";

const CARD = { width: 176, height: 196, gap: 10 };
const CAPTION = 46; // height of the words below a picture
const KEPT = 2000; // pictures that are kept

// Which operators a column of a type has, and what they ask.
const OPERATORS = {
  number: { "≥": (a, b) => a >= b, "≤": (a, b) => a <= b, "=": (a, b) => a === b, "≠": (a, b) => a !== b },
  text: {
    contains: (a, b) => a.toLowerCase().includes(b.toLowerCase()),
    is: (a, b) => a === b, "is not": (a, b) => a !== b,
  },
  boolean: { is: (a, b) => a === b },
};

class Rows {
  constructor(data) {
    this.columns = data.columns;
    this.units = data.units;
    this.names = Object.keys(data.columns);
    this.count = data.count;
    this.types = Object.fromEntries(this.names.map((n) => [n, typeOf(data.columns[n])]));
    this.filters = [];
    this.sortedBy = this.names.includes("epsilon") ? "epsilon" : this.names[0];
    this.ascending = false;
    this.update();
  }

  // A filter from what a person typed; throws an Error with a sentence.
  addFilter(column, operator, text) {
    const type = this.types[column], test = (OPERATORS[type] || {})[operator];
    if (!test) throw new Error(`${column} has no ${operator}`);
    let value = text;
    if (type === "number") {
      value = Number(text);
      if (text.trim() === "" || !Number.isFinite(value)) throw new Error(`${text || "nothing"} is not a number`);
    }
    if (type === "boolean") value = ["true", "yes", "1"].includes(text.toLowerCase());
    this.filters.push({ column, operator, text, passes: (v) => v !== null && test(v, value) });
    this.update();
  }

  removeFilter(k) { this.filters.splice(k, 1); this.update(); }

  sortBy(column, ascending) { [this.sortedBy, this.ascending] = [column, ascending]; this.update(); }

  // The order in which rows are shown: those that pass all filters, sorted; missing values last.
  update() {
    const shown = [];
    for (let i = 0; i < this.count; i++) {
      if (this.filters.every((f) => f.passes(this.columns[f.column][i]))) shown.push(i);
    }
    const values = this.columns[this.sortedBy], sign = this.ascending ? 1 : -1;
    shown.sort((a, b) => {
      const x = values[a], y = values[b];
      if (x === null || y === null) return (x === null) - (y === null) || a - b;
      return (x < y ? -sign : x > y ? sign : 0) || a - b;
    });
    this.shown = shown;
  }
}

function typeOf(values) {
  const first = values.find((v) => v !== null);
  return typeof first === "number" ? "number" : typeof first === "boolean" ? "boolean" : "text";
}

// Pictures of rows, drawn one after the other between frames; `draw(pose)` gives a canvas.
class Thumbnails {
  constructor(draw, ready) {
    this.draw = draw;
    this.ready = ready;
    this.pictures = new Map();
    this.poses = new Map();
    this.asked = new Set();
    this.waiting = [];
    this.busy = false;
  }

  get(row) {
    const picture = this.pictures.get(row);
    if (picture) { this.pictures.delete(row); this.pictures.set(row, picture); } // used last
    return picture;
  }

  // Only what is on the screen now is worth drawing.
  async want(rows) {
    if (!this.draw) return; // no WebGL
    this.waiting = rows.filter((r) => !this.pictures.has(r));
    const missing = this.waiting.filter((r) => !this.poses.has(r) && !this.asked.has(r));
    missing.forEach((r) => this.asked.add(r));
    if (missing.length) {
      const answer = await fetch(`poses?rows=${missing.join(",")}`);
      missing.forEach((r) => this.asked.delete(r));
      if (!answer.ok) return;
      for (const [row, pose] of Object.entries(await answer.json())) this.poses.set(Number(row), pose);
    }
    this.work();
  }

  async work() {
    if (this.busy) return;
    this.busy = true;
    for (;;) {
      const row = this.waiting.find((r) => this.poses.has(r) && !this.pictures.has(r));
      if (row === undefined) break;
      const picture = await this.draw(this.poses.get(row));
      this.pictures.set(row, picture);
      if (this.pictures.size > KEPT) this.pictures.delete(this.pictures.keys().next().value);
      this.ready(row);
      await new Promise((resolve) => setTimeout(resolve, 0)); // scrolling comes first
    }
    this.busy = false;
  }
}

class Grid {
  constructor(root, data, draw) {
    this.rows = new Rows(data);
    this.thumbnails = new Thumbnails(draw, (row) => this.paint(row));
    this.cards = new Map();
    this.selected = -1;
    this.build(root);
    this.refresh();
  }

  build(root) {
    this.bar = element("div", "grid-bar", root);
    this.body = element("div", "grid-body", root);
    this.scroll = element("div", "grid-scroll", this.body);
    this.space = element("div", "grid-space", this.scroll);
    this.panel = element("aside", "grid-panel", this.body);
    this.panel.hidden = true;
    this.scroll.addEventListener("scroll", () => this.lay());
    new ResizeObserver(() => this.lay()).observe(this.scroll);
    document.addEventListener("keydown", (event) => {
      if (event.target.tagName === "INPUT" || event.target.tagName === "SELECT") return;
      if (event.key === "Escape") this.close();
      if (event.key === "ArrowRight") this.step(1);
      if (event.key === "ArrowLeft") this.step(-1);
    });
    this.buildBar();
  }

  buildBar() {
    this.count = element("strong", "grid-count", this.bar);
    const sort = element("label", "", this.bar, "sort by ");
    this.sorting = options(sort, this.rows.names, this.rows.sortedBy);
    this.sorting.id = "sort-column";
    this.direction = element("button", "", this.bar);
    this.direction.id = "sort-direction";
    this.sorting.onchange = () => this.sort(this.sorting.value, this.rows.ascending);
    this.direction.onclick = () => this.sort(this.rows.sortedBy, !this.rows.ascending);
    const form = element("form", "grid-filter", this.bar);
    const column = options(element("label", "", form, "show where "), this.rows.names, this.rows.sortedBy);
    column.id = "filter-column";
    const operator = options(form, []);
    operator.id = "filter-operator";
    const value = element("input", "", form);
    value.id = "filter-value";
    const adapt = () => {
      const type = this.rows.types[column.value];
      operator.replaceChildren(...Object.keys(OPERATORS[type]).map((name) => new Option(name)));
      value.placeholder = type === "boolean" ? "yes or no" : type;
    };
    column.onchange = adapt;
    adapt();
    element("button", "", form, "add").id = "filter-add";
    this.complaint = element("span", "grid-complaint", form);
    form.onsubmit = (event) => {
      event.preventDefault();
      try {
        this.rows.addFilter(column.value, operator.value, value.value);
        this.complaint.textContent = "";
        value.value = "";
        this.refresh();
      } catch (error) { this.complaint.textContent = error.message; }
    };
    this.chips = element("span", "grid-chips", this.bar);
  }

  sort(column, ascending) { this.rows.sortBy(column, ascending); this.refresh(); }

  // After another order or other filters.
  refresh() {
    const rows = this.rows;
    this.count.textContent = rows.shown.length === rows.count
      ? `${rows.count} rows` : `${rows.shown.length} of ${rows.count} rows`;
    this.sorting.value = rows.sortedBy;
    this.direction.textContent = rows.ascending ? "▲ smallest first" : "▼ largest first";
    this.chips.replaceChildren(...rows.filters.map((f, k) => {
      const chip = element("button", "chip", null, `${f.column} ${f.operator} ${f.text} ✕`);
      chip.title = "take this filter away";
      chip.onclick = () => { rows.removeFilter(k); this.refresh(); };
      return chip;
    }));
    for (const card of this.cards.values()) card.remove();
    this.cards.clear();
    this.scroll.scrollTop = 0;
    this.lay();
  }

  // Cards for what is on the screen and a little around it; the others do not exist.
  lay() {
    const across = this.across();
    const pitch = CARD.height + CARD.gap, shown = this.rows.shown;
    this.space.style.height = `${Math.ceil(shown.length / across) * pitch + CARD.gap}px`;
    const first = Math.max(0, Math.floor(this.scroll.scrollTop / pitch) - 1) * across;
    const last = Math.min(shown.length,
      (Math.ceil((this.scroll.scrollTop + this.scroll.clientHeight) / pitch) + 1) * across);
    const here = new Map();
    for (let place = first; place < last; place++) here.set(shown[place], place);
    for (const [row, card] of this.cards) {
      if (!here.has(row)) { card.remove(); this.cards.delete(row); }
    }
    for (const [row, place] of here) {
      let card = this.cards.get(row);
      if (!card) { card = this.card(row); this.cards.set(row, card); this.space.append(card); }
      const x = CARD.gap + (place % across) * (CARD.width + CARD.gap);
      const y = CARD.gap + Math.floor(place / across) * pitch;
      card.style.transform = `translate(${x}px, ${y}px)`;
    }
    const found = this.rows.columns.found;
    this.thumbnails.want([...here.keys()].filter((row) => found[row]));
  }

  card(row) {
    const columns = this.rows.columns, card = element("div", "card");
    card.dataset.row = row;
    if (row === this.selected) card.classList.add("selected");
    if (columns.found[row]) {
      const canvas = element("canvas", "picture", card);
      [canvas.width, canvas.height] = [CARD.width, CARD.height - CAPTION];
    } else {
      card.classList.add("failed");
      element("div", "picture reason", card, columns.reason[row] || "no grasp was found");
    }
    element("div", "caption", card, `${row}: ${columns.object[row]}`);
    const value = columns[this.rows.sortedBy][row];
    element("div", "value", card, `${this.rows.sortedBy} ${said(value)} ${this.rows.units[this.rows.sortedBy] || ""}`);
    card.onclick = () => this.open(row);
    this.paint(row, card);
    return card;
  }

  paint(row, card = this.cards.get(row)) {
    const picture = this.thumbnails.get(row), canvas = card && card.querySelector("canvas");
    if (!picture || !canvas) return;
    canvas.getContext("2d").drawImage(picture, 0, 0, canvas.width, canvas.height);
    card.classList.add("painted");
  }

  step(by) {
    const place = this.rows.shown.indexOf(this.selected) + by;
    if (this.selected >= 0 && place >= 0 && place < this.rows.shown.length) this.open(this.rows.shown[place]);
  }

  close() {
    this.panel.hidden = true;
    this.mark(-1);
    this.lay();
  }

  mark(row) {
    this.selected = row;
    for (const [other, card] of this.cards) card.classList.toggle("selected", other === row);
  }

  // Scrolls as little as brings a row onto the screen.
  reveal(row) {
    const card = CARD.height + CARD.gap, across = this.across();
    const top = Math.floor(this.rows.shown.indexOf(row) / across) * card;
    const seen = this.scroll.clientHeight - card - CARD.gap;
    if (top >= 0) this.scroll.scrollTop = Math.min(top, Math.max(this.scroll.scrollTop, top - seen));
    this.lay();
  }

  across() {
    return Math.max(1, Math.floor((this.scroll.clientWidth - CARD.gap) / (CARD.width + CARD.gap)));
  }

  // The panel of a row: its grasp in three dimensions, its numbers, near-duplicates and attempts.
  async open(row) {
    this.mark(row);
    this.panel.hidden = false;
    this.reveal(row);
    const columns = this.rows.columns;
    this.panel.replaceChildren();
    const head = element("div", "panel-head", this.panel);
    element("h2", "", head, `row ${row}: ${columns.object[row]}`);
    if (columns.found[row]) {
      const link = element("a", "", head, "own page");
      [link.href, link.target] = [`grasp/${row}`, "_blank"];
    }
    const close = element("button", "", head, "✕");
    close.title = "close (Escape)";
    close.onclick = () => this.close();
    if (columns.found[row]) {
      const frame = element("iframe", "", this.panel);
      frame.src = `grasp/${row}`;
      frame.title = `grasp of row ${row}`;
    }
    const body = element("div", "panel-body", this.panel);
    const answer = await fetch(`details/${row}`);
    if (this.selected !== row) return; // another one was clicked meanwhile
    if (!answer.ok) { element("p", "grid-complaint", body, await answer.text()); return; }
    this.fill(body, await answer.json());
  }

  fill(body, details) {
    const v = details.values;
    if (!v.found) element("p", "grid-complaint", body, v.reason);
    const near = details.duplicates;
    element("h3", "", body, near.length ? `near-duplicates (${near.length})` : "no near-duplicates");
    if (near.length) {
      const strip = element("div", "strip", body);
      const places = new Map();
      for (const { row, apart } of near.slice(0, 12)) {
        const card = element("button", "small", strip);
        const canvas = element("canvas", "", card);
        [canvas.width, canvas.height] = [CARD.width / 2, (CARD.height - CAPTION) / 2];
        element("span", "", card, `row ${row}`);
        card.title = `largest difference ${apart.toFixed(2)} of its tolerance`;
        card.onclick = () => this.open(row);
        places.set(row, canvas);
      }
      this.drawInto(places);
    }
    const failed = details.attempts.filter((a) => a.reason);
    element("h3", "", body, failed.length ? `failed attempts (${failed.length} of ${details.attempts.length})`
      : `no failed attempts (of ${details.attempts.length})`);
    const list = element("ol", "attempts", body);
    for (const a of failed) {
      const item = element("li", "", list, a.reason);
      item.value = a.attempt + 1;
      element("span", "dim", item, ` ${(1e3 * a.cpu_s).toFixed(0)} ms`);
    }
    element("h3", "", body, "numbers");
    const table = element("table", "", body);
    details.fingers.forEach((finger, k) => line(table, `force of ${finger}`, `${said(details.forces_N[k])} N`));
    for (const name of this.rows.names) {
      if (v[name] !== null && v[name] !== undefined && v[name] !== "") line(table, name, `${said(v[name])} ${this.rows.units[name] || ""}`);
    }
    element("p", "dim", body, "as a plan file: ");
    element("code", "", body.lastChild, `opposable batch FOLDER --extract ${details.row}`);
  }

  async drawInto(places) {
    await this.thumbnails.want([...places.keys(), ...this.thumbnails.waiting]);
    const paint = () => {
      for (const [row, canvas] of places) {
        const picture = this.thumbnails.get(row);
        if (!picture) continue;
        canvas.getContext("2d").drawImage(picture, 0, 0, canvas.width, canvas.height);
        places.delete(row);
      }
      if (places.size && !this.panel.hidden) setTimeout(paint, 100);
    };
    paint();
  }
}

function said(value) {
  if (value === null || value === undefined) return "–";
  if (typeof value === "boolean") return value ? "yes" : "no";
  if (typeof value !== "number" || Number.isInteger(value)) return String(value);
  return Math.abs(value) >= 1e-3 ? String(Number(value.toPrecision(4))) : value.toExponential(1);
}

function line(table, name, value) {
  const row = element("tr", "", table);
  element("th", "", row, name);
  element("td", "", row, value);
}

function options(parent, names, chosen) {
  const made = element("select", "", parent);
  made.replaceChildren(...names.map((name) => new Option(name)));
  if (chosen) made.value = chosen;
  return made;
}
