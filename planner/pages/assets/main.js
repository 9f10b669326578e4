"use strict";
/* Starts the page. window.opposable is for tests and for whoever wants to drive a page:
     seek(t)             moves the page to a time, s
     time()              the time, s
     pose(actor, joint)  [x, y, z, qw, qx, qy, qz] in the world, as drawn; joint null: the base
     layers              name -> whether on;  set(layer, on) switches one
     frames              how many pictures were drawn;  draw() draws one now
     errors              messages of everything that went wrong
     ready               whether the page has started */
window.opposable = {
  ready: false,
  errors: Opposable.errors,
  get frames() { return Opposable.stage ? Opposable.stage.frames : 0; },
  get layers() { return { ...Opposable.stage.layers }; },
  seek(time) {
    Opposable.clock.pause();
    Opposable.clock.seek(time);
  },
  time() { return Opposable.clock.time; },
  pose(actor, joint) {
    const body = Opposable.stage.bodies.get(actor);
    if (!body) throw new Error(`there is no actor ${actor}`);
    return body.pose(joint);
  },
  set(layer, on) {
    Opposable.stage.set(layer, on);
    const box = document.querySelector(`[data-layer="${layer}"]`);
    if (box) box.checked = on;
  },
  draw() { Opposable.stage.draw(); },
};

Opposable.main = async function () {
  if (typeof DecompressionStream === "undefined") {
    const text = "This browser cannot unpack the scene; use one from 2023 or later.";
    if (document.getElementById("notice")) Opposable.notice(text);
    return;
  }
  Opposable.clock = new Opposable.Clock([]);
  if (document.getElementById("opposable-scene")) {
    const [packed, three] = await Promise.all(
      [Opposable.unpack("opposable-scene"), Opposable.unpack("opposable-three")]);
    Opposable.run(new TextDecoder().decode(three));
    const { scene, extra } = Opposable.decode(packed);
    Opposable.extra = extra;
    for (const set of scene.contacts) for (const finger of set.fingers) Opposable.palette(finger);
    const clock = new Opposable.Clock(scene.time.data);
    Opposable.clock = clock;
    Opposable.stage = new Opposable.Stage(scene, clock);
    Opposable.timeline(scene, clock);
    Opposable.plots = new Opposable.Plots(document.getElementById("plots"), scene, clock);
    Opposable.panel(scene, Opposable.stage, clock);
    clock.seek(scene.start);
    Opposable.stage.draw();
  }
  Opposable.summary(Opposable.clock);
  for (const extend of Opposable.extensions) await extend(Opposable);
  window.opposable.ready = true;
};

Opposable.main();
