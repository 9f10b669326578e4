"use strict";
/* Small pictures of many grasps by one renderer: the hand and the objects are built once, and only
   joints and places change from picture to picture. */
Opposable.Thumbnailer = class {
  /** data: {hand: model, objects: {label: {model, pose}}}, radius of the hand in m; size in pixels. */
  constructor(data, width, height) {
    this.data = data;
    this.size = [width, height];
    this.world = new THREE.Scene();
    this.eye = new THREE.PerspectiveCamera(30, width / height, 0.01, 20);
    this.eye.up.set(0, 0, 1);
    this.world.add(new THREE.HemisphereLight(0xffffff, 0xb0a899, 0.75));
    this.light = new THREE.DirectionalLight(0xfff6ea, 0.75);
    this.world.add(this.light, this.light.target);
    const canvas = document.createElement("canvas");
    this.renderer = new THREE.WebGLRenderer({ canvas, antialias: true, alpha: true, preserveDrawingBuffer: true });
    this.renderer.outputEncoding = THREE.sRGBEncoding;
    this.renderer.setPixelRatio(1);
    this.renderer.setSize(width, height, false);
    this.geometries = new Map();
    this.hand = this.body("hand", data.hand);
    this.objects = new Map();
    this.shown = null;
  }

  body(name, model) {
    const actor = { name, pose: [0, 0, 0, 1, 0, 0, 0], q: model.joints.map(() => 0), layer: null, opacity: 1 };
    const body = new Opposable.Body(actor, model, this.geometries, 1);
    const seen = ["hand", "pads", "object"];
    body.show(Object.fromEntries(["frames", "collision", "field", "regions", ...seen].map((l) => [l, seen.includes(l)])));
    this.world.add(body.base);
    return body;
  }

  object(label) {
    if (!this.objects.has(label)) this.objects.set(label, this.body(label, this.data.objects[label].model));
    return this.objects.get(label);
  }

  /** A canvas with the picture of a grasp: {object, base: pose in the object's frame, q}. */
  draw({ object, base, q }) {
    const body = this.object(object);
    if (this.shown && this.shown !== body) this.shown.base.visible = false;
    this.shown = body;
    body.base.visible = true;
    Opposable.place(body.base, this.data.objects[object].pose); // as it stands on its table
    this.world.add(this.hand.base);
    body.base.updateMatrix();
    Opposable.place(this.hand.base, base);
    this.hand.base.applyMatrix4(body.base.matrix);
    this.hand.bend(q);
    this.world.updateMatrixWorld(true);
    this.aim(body);
    this.renderer.render(this.world, this.eye);
    const picture = document.createElement("canvas");
    [picture.width, picture.height] = this.size;
    picture.getContext("2d").drawImage(this.renderer.domElement, 0, 0);
    return picture;
  }

  /** From the side of the hand and a little above, so that neither hides the other. */
  aim(body) {
    const box = new THREE.Box3(), part = new THREE.Box3(), ball = new THREE.Sphere();
    for (const mesh of [...this.hand.meshes, ...body.meshes]) {
      if (!mesh.visible) continue;
      if (!mesh.geometry.boundingBox) mesh.geometry.computeBoundingBox();
      box.union(part.copy(mesh.geometry.boundingBox).applyMatrix4(mesh.matrixWorld));
    }
    box.getBoundingSphere(ball);
    const across = this.hand.base.position.clone().sub(body.base.position).setZ(0);
    if (across.length() < 0.2 * ball.radius) across.set(0, 1, 0);
    const from = new THREE.Vector3(-across.y, across.x, 0).normalize();
    if (from.x + from.y < 0) from.negate();
    from.addScaledVector(across.normalize(), -0.35).setZ(0.5).normalize();
    const distance = 0.8 * ball.radius / Math.sin((this.eye.fov * Math.PI) / 360);
    this.eye.position.copy(ball.center).addScaledVector(from, distance);
    this.eye.lookAt(ball.center);
    this.light.position.copy(this.eye.position).add(new THREE.Vector3(0, 0, ball.radius));
    this.light.target.position.copy(ball.center);
  }
};
