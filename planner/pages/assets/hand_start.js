"use strict";
/* Starts the side panel of a hand. */
Opposable.extensions.push((page) => {
  const root = element("div", "own-panel");
  document.getElementById("summary").after(root);
  const actor = page.stage.scene.actors.find((a) => a.name === "hand");
  page.hand = new HandPanel(root, page.extra.hand, page.stage.scene.models[actor.model], new SideView(page.stage));
});
