"use strict";
/* Switches of layers, camera buttons, legend of forces, saving a picture or the numbers. */
Opposable.button = function (parent, text, title, action) {
  const button = document.createElement("button");
  button.type = "button";
  button.textContent = text;
  button.title = title;
  button.addEventListener("click", action);
  parent.appendChild(button);
  return button;
};

Opposable.save = function (blob, name) {
  const link = document.createElement("a");
  link.href = URL.createObjectURL(blob);
  link.download = name;
  link.click();
  setTimeout(() => URL.revokeObjectURL(link.href), 1000);
};

/** A name for a saved file out of the page's title. */
Opposable.fileName = function (ending) {
  const plain = document.title.replace(/[^A-Za-z0-9_.+-]+/g, "-").replace(/^-+|-+$/g, "").slice(0, 80);
  return `${plain || "opposable"}${ending}`;
};

Opposable.panel = function (scene, stage, clock) {
  const layers = document.getElementById("layers");
  for (const [layer, on] of Object.entries(stage.layers)) {
    const label = document.createElement("label"), box = document.createElement("input");
    box.type = "checkbox";
    box.checked = on;
    box.dataset.layer = layer;
    box.addEventListener("change", () => {
      stage.set(layer, box.checked);
      legend();
    });
    label.append(box, ` ${layer}`);
    layers.appendChild(label);
  }

  const cameras = document.getElementById("cameras");
  const views = [
    ...scene.views.filter((v) => v.name !== "start"),
    { name: "front", direction: [1, 0, 0] },
    { name: "side", direction: [0, -1, 0] },
    { name: "top", direction: [0, 0, 1] },
  ];
  Opposable.button(cameras, "home", "Where the page opened (double click)", () =>
    stage.camera.look(stage.opening));
  for (const view of views) {
    Opposable.button(cameras, view.name, `Look from ${view.name}`, () =>
      stage.camera.look(view.direction));
  }

  const tools = document.getElementById("tools");
  if (scene.follow !== null && clock.moves) {
    const follow = Opposable.button(tools, "follow", `The camera goes along with the ${scene.follow}`, () => {
      stage.following = !stage.following;
      follow.setAttribute("aria-pressed", stage.following);
      stage.goAlong();
    });
    follow.setAttribute("aria-pressed", stage.following);
  }
  if (stage.renderer) {
    Opposable.button(tools, "save picture", "The scene as it stands, as PNG", async () =>
      Opposable.save(await stage.picture(), Opposable.fileName(".png")));
  }

  const legend = () => {
    const element = document.getElementById("legend");
    element.replaceChildren();
    const fingers = [...new Set(scene.contacts.flatMap((set) => set.fingers))];
    for (const finger of fingers) {
      const key = document.createElement("span");
      key.className = "key block";
      key.style.setProperty("--colour", Opposable.palette(finger));
      key.textContent = finger;
      element.appendChild(key);
    }
    if (fingers.length && stage.layers.forces) {
      const note = document.createElement("span");
      note.textContent = `longest force arrow ${stage.newtons.toPrecision(3)} N`;
      element.appendChild(note);
    }
  };
  legend();
};

/** What the summary's buttons do, and the colours of its fingers. */
Opposable.summary = function (clock) {
  for (const button of document.querySelectorAll("[data-seek]")) {
    button.addEventListener("click", () => {
      clock.pause();
      clock.seek(Number(button.dataset.seek));
    });
  }
  for (const cell of document.querySelectorAll("[data-finger]")) {
    cell.classList.add("key", "block");
    cell.style.setProperty("--colour", Opposable.palette(cell.dataset.finger));
  }
  for (const button of document.querySelectorAll("[data-copy]")) {
    button.addEventListener("click", () => {
      const code = button.previousElementSibling, range = document.createRange();
      range.selectNodeContents(code);
      getSelection().removeAllRanges();
      getSelection().addRange(range);
      if (navigator.clipboard) navigator.clipboard.writeText(code.textContent).catch(() => {});
      button.textContent = "Copied";
    });
  }
  const numbers = document.getElementById("save-numbers");
  if (document.getElementById("opposable-data")) {
    numbers.hidden = false;
    numbers.addEventListener("click", async () => {
      const bytes = await Opposable.unpack("opposable-data");
      Opposable.save(new Blob([bytes], { type: "application/json" }), Opposable.fileName(".json"));
    });
  }
};
