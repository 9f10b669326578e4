"use strict";
/* The list of other grasps of a plan's task: pointing at one makes its ghost glow, a click shows it
   alone or all again. */
Opposable.extensions.push((page) => {
  const { plans, failed } = page.extra.alternatives, view = new SideView(page.stage);
  const root = element("div", "own-panel");
  (document.querySelector(".verdict") || document.getElementById("summary")).after(root);
  element("h2", "", root, `Other grasps of this task (${plans.length})`);
  const table = element("table", "", root), head = element("tr", "", element("thead", "", table));
  for (const name of ["", "epsilon", "min-weight", "strongest (N)"]) element("th", "", head, name);
  const body = element("tbody", "", table);
  let alone = null;
  const rows = plans.map((plan) => {
    const row = element("tr", "clickable", body);
    row.dataset.actor = plan.actor;
    row.title = "click: this one alone, or all again";
    element("th", "", row, plan.actor);
    for (const value of [plan.epsilon.toFixed(4), plan.min_weight.toFixed(3), plan.strongest_N.toFixed(2)]) {
      element("td", "", row, value);
    }
    const all = page.stage.bodies.get(plan.actor).model.joints.map((_, k) => k);
    row.onpointerenter = () => view.highlight(plan.actor, [-1, ...all], false);
    row.onpointerleave = () => view.highlight(plan.actor, [], false);
    row.onclick = () => {
      alone = alone === plan.actor ? null : plan.actor;
      for (const other of plans) {
        page.stage.bodies.get(other.actor).base.visible = alone === null || other.actor === alone;
      }
      rows.forEach((r) => r.classList.toggle("chosen", r.dataset.actor === alone));
      page.stage.changed();
    };
    return row;
  });
  for (const text of failed) element("p", "dim", root, text);
});
