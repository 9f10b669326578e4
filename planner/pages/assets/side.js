// Pieces of side panels.
"use strict";

function element(tag, style, parent, text) {
  const made = document.createElement(tag);
  if (style) made.className = style;
  if (text !== undefined) made.textContent = text;
  if (parent) parent.append(made);
  return made;
}

// Named sections of which one is shown; the first is, to begin with.
function tabbed(root, names) {
  const bar = element("div", "tabs", root), sections = {};
  const show = (chosen) => names.forEach((name, k) => {
    sections[name].hidden = name !== chosen;
    bar.children[k].classList.toggle("chosen", name === chosen);
  });
  for (const name of names) {
    const button = element("button", "", bar, name);
    button.dataset.tab = name;
    button.onclick = () => show(name);
    sections[name] = element("section", "", root);
  }
  show(names[0]);
  return sections;
}

// What side panels do to the scene.
class SideView {
  constructor(stage) { this.stage = stage; }

  setJoints(actor, q) {
    this.stage.bodies.get(actor).bend(q);
    this.stage.changed();
  }

  setPose(actor, pose) {
    Opposable.place(this.stage.bodies.get(actor).base, pose);
    this.stage.changed();
  }

  // Makes what joints carry glow, or their pads alone; no joints: nothing glows.
  highlight(actor, joints, pads) {
    for (const mesh of this.stage.bodies.get(actor).meshes) {
      const part = mesh.userData.part;
      const on = joints.includes(part.joint) && (!pads || part.layer === "pads");
      mesh.material.emissive.setHex(on ? 0xc46a00 : 0x000000);
    }
    this.stage.changed();
  }
}
