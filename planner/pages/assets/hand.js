// The side panel of a hand: sliders of its joints, postures, the lines of its description with their
// reasons, and what was found out about it. Expects `handData` and a viewer of the page.
"use strict";

class HandPanel {
  constructor(root, data, model, viewer) {
    this.data = data;
    this.joints = model.joints;
    const [rows, values] = model.couplings || [[], []];
    this.rows = Array.from({ length: rows.length }, (_, k) => Array.from(rows.row(k)));
    this.values = Array.from(Opposable.rows(values).data);
    this.viewer = viewer;
    this.q = Array.from(data.q);
    this.lower = this.joints.map((j) => j.lower);
    this.upper = this.joints.map((j) => j.upper);
    this.sliders = [];
    const tabs = tabbed(root, ["joints", "description", "findings"]);
    this.buildJoints(tabs.joints);
    this.buildLines(tabs.description);
    this.buildFindings(tabs.findings);
    this.show();
  }

  buildJoints(parent) {
    const buttons = element("div", "buttons", parent);
    for (const [name, q] of Object.entries(this.data.postures)) {
      const button = element("button", "", buttons, name);
      button.dataset.posture = name;
      button.onclick = () => this.set(q);
    }
    for (const group of this.data.groups) {
      const box = element("fieldset", "", parent);
      element("legend", "", box, group.name);
      for (const k of group.joints) this.slider(box, k);
    }
    if (this.rows.length) {
      element("p", "dim", parent, "Moving a coupled joint moves those that a coupling ties to it, as far " +
        "as their ranges allow.");
    }
  }

  slider(parent, k) {
    const joint = this.joints[k], tied = this.rows.some((row) => row[k] !== 0);
    const label = element("label", "joint", parent);
    const name = element("span", "name", label);
    element("span", "", name, this.data.labels[k]).title = joint.name;
    if (tied) element("span", "tied", name, "coupled");
    const input = element("input", "", label);
    Object.assign(input, { type: "range", min: joint.lower, max: joint.upper, step: "any" });
    input.dataset.joint = joint.name;
    const value = element("output", "", label);
    input.title = `${this.said(k, joint.lower)} to ${this.said(k, joint.upper)}`;
    input.oninput = () => this.move(k, Number(input.value));
    label.onpointerenter = () => this.viewer.highlight("hand", [k], false);
    label.onpointerleave = () => this.viewer.highlight("hand", [], false);
    this.sliders[k] = { input, value };
  }

  said(k, value) {
    return this.joints[k].kind === "hinge"
      ? `${(value * 180 / Math.PI).toFixed(1)}°` : `${(1e3 * value).toFixed(1)} mm`;
  }

  // Move one joint; those that are coupled to it follow.
  move(k, value) {
    this.set(movedTogether(this.q, k, value, this.lower, this.upper, this.rows, this.values));
  }

  set(q) { this.q = Array.from(q); this.show(); }

  show() {
    this.sliders.forEach(({ input, value }, k) => {
      input.value = this.q[k];
      value.textContent = this.said(k, this.q[k]);
    });
    this.viewer.setJoints("hand", this.q);
  }

  buildLines(parent) {
    for (const question of this.data.questions) element("p", "finding warning", parent, `to do: ${question}`);
    for (const item of this.data.lines) {
      const row = element("div", "described", parent);
      element("code", "", row, item.key);
      element("span", "", row, ` ${item.value}`);
      if (item.why) element("p", "dim", row, item.why);
      this.points(row, item.joints, item.pads);
      if (item.posture) {
        row.classList.add("clickable");
        row.title = "show this posture";
        row.onclick = () => this.set(this.data.postures[item.posture]);
      }
    }
  }

  buildFindings(parent) {
    if (!this.data.findings.length) element("p", "", parent, "check-hand found nothing that stands in the way.");
    for (const item of this.data.findings) {
      const row = element("div", `finding ${item.level}`, parent);
      element("strong", "", row, item.level);
      element("span", "", row, ` ${item.what}`);
      element("p", "dim", row, item.what_to_do);
      this.points(row, item.joints, false);
    }
    for (const text of this.data.facts) element("p", "dim", parent, text);
  }

  // Pointing at a row highlights what it is about.
  points(row, joints, pads) {
    if (!joints.length) return;
    row.tabIndex = 0;
    for (const name of ["pointerenter", "focus"]) row.addEventListener(name, () => this.viewer.highlight("hand", joints, pads));
    for (const name of ["pointerleave", "blur"]) row.addEventListener(name, () => this.viewer.highlight("hand", [], false));
  }
}
