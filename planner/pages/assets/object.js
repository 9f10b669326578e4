// The side panel of an object: its stable poses to choose from, and the command that takes one.
"use strict";

class ObjectPanel {
  constructor(root, data, viewer) {
    this.data = data;
    this.viewer = viewer;
    element("h2", "", root, "Stable poses");
    const list = element("div", "buttons column", root);
    this.buttons = data.poses.map((pose, k) => {
      const button = element("button", "", list);
      button.dataset.pose = k;
      element("strong", "", button, `pose ${k}`);
      const falls = pose.margin_deg === null ? "" : `falls when tilted by ${pose.margin_deg.toFixed(0)}°`;
      const often = pose.probability === null ? ""
        : `${(100 * pose.probability).toFixed(0)} % of drops end here`;
      element("span", "dim", button, [falls, often].filter(Boolean).join(", "));
      button.onclick = () => this.choose(k);
      return button;
    });
    const command = element("div", "command", root);
    this.command = element("code", "", command);
    this.choose(0);
  }

  choose(k) {
    this.chosen = k;
    this.viewer.setPose("object", this.data.poses[k].pose);
    this.buttons.forEach((button, i) => button.classList.toggle("chosen", i === k));
    this.command.textContent = this.data.command + (k ? ` --pose ${k}` : "");
  }
}
