"use strict";
/* Starts the side panel of an object. */
Opposable.extensions.push((page) => {
  const root = element("div", "own-panel");
  document.getElementById("summary").after(root);
  page.object = new ObjectPanel(root, page.extra.object, new SideView(page.stage));
});
