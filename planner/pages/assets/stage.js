"use strict";
/* The scene in three dimensions: bodies, contacts, lights, camera. Drawn only when something
   changed, so that a page at rest costs nothing. */
Opposable.Stage = class {
  /** scene as in planner/pages/scene.py; elements of the page by id. */
  constructor(scene, clock) {
    this.scene = scene;
    this.clock = clock;
    this.frames = 0;
    this.world = new THREE.Scene();
    this.layers = this.usedLayers();
    this.bodies = new Map();
    const geometries = new Map();
    for (const actor of scene.actors) {
      const body = new Opposable.Body(actor, scene.models[actor.model], geometries, scene.radius);
      this.bodies.set(actor.name, body);
      this.world.add(body.base);
    }
    this.newtons = this.largestForce();
    this.contacts = scene.contacts.map((set) => new Opposable.ContactView(
      set, set.actor ? this.bodies.get(set.actor).base : this.world, scene.radius, this.newtons));
    this.origin = Opposable.axes(0.35 * scene.radius);
    this.world.add(this.origin);
    this.view = document.getElementById("view");
    this.canvas = document.getElementById("canvas");
    this.camera = new Opposable.Camera(
      this.canvas, new THREE.Vector3(...scene.focus), scene.radius, () => this.changed());
    this.following = scene.follow !== null;
    this.addLights();
    this.renderer = this.newRenderer();
    this.listen();
    this.moveTo(0);
    this.start = this.bodies.has(scene.follow)
      ? this.bodies.get(scene.follow).base.position.clone() : new THREE.Vector3();
    this.showLayers();
    const opening = scene.views.find((v) => v.name === "start");
    this.opening = opening ? opening.direction : [0.75, -1, 0.62];
    this.resize();
    this.camera.look(this.opening);
  }

  /** Layers that have something in them -> whether on. */
  usedLayers() {
    const used = new Set();
    for (const actor of this.scene.actors) {
      if (actor.layer) used.add(actor.layer);
      for (const part of this.scene.models[actor.model].parts) used.add(part.layer);
    }
    for (const set of this.scene.contacts) {
      for (const layer of [set.layer, "normals", "cones", "forces"]) used.add(layer);
    }
    if (this.scene.actors.length) used.add("frames");
    const order = ["hand", "pads", "object", "table", "obstacles", "planned contacts",
      "measured contacts", "normals", "cones", "forces", "alternatives", "regions", "field",
      "collision", "frames"];
    const names = [...order.filter((l) => used.has(l)), ...[...used].filter((l) => !order.includes(l))];
    return Object.fromEntries(names.map((l) => [l, !this.scene.off.includes(l)]));
  }

  largestForce() {
    let most = 0;
    for (const set of this.scene.contacts) {
      const data = set.forces.data;
      for (let i = 0; i + 2 < data.length; i += 3) {
        const force = Math.hypot(data[i], data[i + 1], data[i + 2]);
        if (force > most) most = force;
      }
    }
    return most || 1;
  }

  newRenderer() {
    let renderer;
    try {
      const context = this.canvas.getContext("webgl2", { antialias: true, alpha: true }) ||
        this.canvas.getContext("webgl", { antialias: true, alpha: true });
      if (!context) throw new Error("no WebGL");
      renderer = new THREE.WebGLRenderer({ canvas: this.canvas, context, antialias: true, alpha: true });
    } catch (error) {
      Opposable.notice("This browser has no WebGL, so the scene is not drawn; words, numbers and " +
        "plots are complete. Switch on hardware or software rendering in its settings.");
      return null;
    }
    renderer.outputEncoding = THREE.sRGBEncoding;
    renderer.shadowMap.enabled = true;
    renderer.shadowMap.type = THREE.PCFShadowMap;
    return renderer;
  }

  addLights() {
    const r = this.scene.radius;
    this.world.add(new THREE.HemisphereLight(0xf6f8ff, 0xb9b0a4, 0.46));
    this.lights = [
      { light: new THREE.DirectionalLight(0xfff4e6, 0.52), from: [1.1, -0.9, 3.2] },
      { light: new THREE.DirectionalLight(0xdce8ff, 0.24), from: [-2, -1.2, 1.0] },
      { light: new THREE.DirectionalLight(0xffffff, 0.26), from: [0.4, 2.4, 0.9] },
    ];
    for (const { light } of this.lights) this.world.add(light, light.target);
    const key = this.lights[0].light, area = key.shadow.camera;
    key.castShadow = true;
    key.shadow.mapSize.set(2048, 2048);
    key.shadow.bias = -0.0004;
    key.shadow.normalBias = 0.004 * r;
    key.shadow.radius = 5;
    area.left = area.bottom = -1.8 * r;
    area.right = area.top = 1.8 * r;
    area.near = 0.1 * r;
    area.far = 9 * r;
    this.aimLights(new THREE.Vector3(...this.scene.focus));
  }

  /** Lights shine at a point, so that shadows go along with what the camera follows. */
  aimLights(focus) {
    for (const { light, from } of this.lights) {
      light.target.position.copy(focus);
      light.position.copy(focus).addScaledVector(new THREE.Vector3(...from), this.scene.radius);
    }
  }

  listen() {
    new ResizeObserver(() => this.resize()).observe(this.view);
    this.clock.listen(() => this.moveTo(this.clock.sample));
    const tooltip = document.getElementById("tooltip");
    let waiting = false;
    this.canvas.addEventListener("pointermove", (event) => {
      tooltip.hidden = true;
      if (waiting || this.camera.dragging || event.pointerType === "touch") return;
      waiting = true;
      setTimeout(() => {
        waiting = false;
        const text = this.camera.dragging ? "" : this.textAt(event.offsetX, event.offsetY);
        tooltip.hidden = !text;
        tooltip.textContent = text;
        const right = event.offsetX > this.canvas.clientWidth / 2;
        tooltip.style.left = right ? "auto" : `${event.offsetX + 14}px`;
        tooltip.style.right = right ? `${this.canvas.clientWidth - event.offsetX + 14}px` : "auto";
        tooltip.style.top = `${event.offsetY + 14}px`;
      }, 60);
    });
    this.canvas.addEventListener("pointerleave", () => { tooltip.hidden = true; });
    this.canvas.addEventListener("dblclick", () => this.camera.look(this.opening));
  }

  /** What there is at a place of the canvas, in words; "" for nothing. */
  textAt(x, y) {
    const ray = new THREE.Raycaster(), { clientWidth: w, clientHeight: h } = this.canvas;
    ray.setFromCamera({ x: (2 * x) / w - 1, y: 1 - (2 * y) / h }, this.camera.eye);
    for (const view of this.contacts) {
      const hit = ray.intersectObjects(view.meshes.filter((m) => m.visible), false)[0];
      if (hit) return view.text(hit.object);
    }
    const meshes = [...this.bodies.values()].flatMap((b) => b.meshes.filter((m) => m.visible));
    const hit = ray.intersectObjects(meshes, false)[0];
    return hit ? hit.object.userData.text : "";
  }

  resize() {
    const width = this.view.clientWidth, height = this.view.clientHeight;
    if (!width || !height) return;
    this.camera.resize(width / height);
    if (this.renderer) {
      this.renderer.setPixelRatio(Math.min(2, window.devicePixelRatio || 1));
      this.renderer.setSize(width, height, false);
    }
    this.changed();
  }

  /** Moves every actor and contact to a sample. */
  moveTo(sample) {
    for (const motion of this.scene.motions) {
      this.bodies.get(motion.actor).move(motion.pose.row(sample), motion.q.row(sample));
    }
    for (const view of this.contacts) {
      view.update(sample);
      view.show(this.layers);
    }
    if (this.start) this.goAlong(); else this.changed();
  }

  goAlong() {
    const body = this.following && this.bodies.get(this.scene.follow);
    const shift = body ? body.base.position.clone().sub(this.start) : new THREE.Vector3();
    this.aimLights(new THREE.Vector3(...this.scene.focus).add(shift));
    this.camera.follow(shift);
  }

  set(layer, on) {
    if (!(layer in this.layers)) throw new Error(`there is no layer ${layer} here`);
    this.layers[layer] = on;
    this.showLayers();
  }

  showLayers() {
    for (const body of this.bodies.values()) body.show(this.layers);
    for (const view of this.contacts) view.show(this.layers);
    this.origin.visible = Boolean(this.layers.frames);
    this.changed();
  }

  changed() {
    if (this.waiting || !this.renderer) return;
    this.waiting = true;
    requestAnimationFrame(() => { if (this.waiting) this.draw(); });
  }

  draw() {
    this.waiting = false;
    if (!this.renderer) return;
    this.renderer.render(this.world, this.camera.eye);
    this.frames++;
  }

  /** The picture as it stands, on the page's background, as a PNG's Blob. */
  picture() {
    this.draw();
    const copy = document.createElement("canvas");
    copy.width = this.canvas.width;
    copy.height = this.canvas.height;
    const pen = copy.getContext("2d");
    pen.fillStyle = getComputedStyle(this.view).backgroundColor;
    pen.fillRect(0, 0, copy.width, copy.height);
    pen.drawImage(this.canvas, 0, 0);
    return new Promise((done) => copy.toBlob(done, "image/png"));
  }
};

/** One line over the scene. */
Opposable.notice = function (text) {
  const element = document.getElementById("notice");
  element.textContent = text;
  element.hidden = !text;
};
