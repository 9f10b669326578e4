"use strict";
/* Contacts of one set: points, normals, friction cones and force arrows, each in its own layer. All
   are drawn over what would hide them, since contacts lie between a finger and the object. */
Opposable.ContactView = class {
  /** set as in planner/pages/scene.py; parent: the group whose frame it is in; radius: m; newtons:
      the largest force of the page, N. */
  constructor(set, parent, radius, newtons) {
    this.set = set;
    this.layer = set.layer;
    this.unit = radius;
    this.newtons = newtons;
    this.group = new THREE.Group();
    parent.add(this.group);
    const planned = set.name === "planned";
    this.items = set.fingers.map((finger) => this.build(finger, planned));
    this.update(0);
  }

  build(finger, planned) {
    const colour = new THREE.Color(Opposable.palette(finger)).convertSRGBToLinear();
    const over = { depthTest: false, depthWrite: false, transparent: true, color: colour };
    const size = this.unit;
    const mesh = (geometry, opacity, order) => {
      const made = new THREE.Mesh(geometry, new THREE.MeshBasicMaterial({ ...over, opacity }));
      made.renderOrder = order;
      this.group.add(made);
      return made;
    };
    // a planned point is a ring's ball, a measured one a full ball
    const point = mesh(new THREE.SphereGeometry(0.019 * size, 20, 14), planned ? 0.55 : 0.95, 9);
    const height = 0.2 * size, wide = height * this.set.mu;
    const coneShape = new THREE.ConeGeometry(wide, height, 40, 1, true);
    coneShape.translate(0, -height / 2, 0);
    coneShape.rotateX(Math.PI);  // apex at the contact, open along +y
    const cone = mesh(coneShape, 0.22, 6);
    cone.material.side = THREE.DoubleSide;
    const rim = new THREE.LineLoop(
      new THREE.BufferGeometry().setFromPoints(
        Array.from({ length: 48 }, (_, i) => new THREE.Vector3(
          wide * Math.cos((i * Math.PI) / 24), height, wide * Math.sin((i * Math.PI) / 24)))),
      new THREE.LineBasicMaterial({ ...over, opacity: 0.7 }));
    rim.renderOrder = 7;
    rim.raycast = () => {};
    cone.add(rim);
    const normalShape = new THREE.CylinderGeometry(0.005 * size, 0.005 * size, height, 8);
    normalShape.translate(0, height / 2, 0);
    const normal = mesh(normalShape, 0.8, 8);
    const shaftShape = new THREE.CylinderGeometry(1, 1, 1, 14);
    shaftShape.translate(0, 0.5, 0);
    const shaft = mesh(shaftShape, planned ? 0.6 : 0.95, 8);
    const headShape = new THREE.ConeGeometry(0.032 * size, 0.075 * size, 18);
    headShape.translate(0, 0.0375 * size, 0);
    const head = mesh(headShape, planned ? 0.6 : 0.95, 8);
    return { finger, point, cone, normal, shaft, head, there: false, pushes: false };
  }

  /** Moves everything to a sample; a set that does not change has one. */
  update(sample) {
    const { set } = this, m = Math.min(sample, set.points.length - 1);
    const up = new THREE.Vector3(0, 1, 0), at = new THREE.Vector3(), along = new THREE.Vector3();
    this.items.forEach((item, i) => {
      const read = (array) => array.row(m).subarray(3 * i, 3 * i + 3);
      const p = read(set.points), n = read(set.normals), f = read(set.forces);
      item.there = Number.isFinite(p[0]);
      item.pushes = item.there && Number.isFinite(f[0]) && Math.hypot(...f) > 1e-9;
      if (!item.there) return;
      at.set(...p);
      item.point.position.copy(at);
      along.set(...n);
      for (const part of [item.cone, item.normal]) {
        part.position.copy(at);
        part.quaternion.setFromUnitVectors(up, along);
      }
      const force = Math.hypot(...f), normalForce = n[0] * f[0] + n[1] * f[1] + n[2] * f[2];
      item.text = `${set.name} contact of ${item.finger}`;
      if (!item.pushes) return;
      const sideways = Math.sqrt(Math.max(0, force * force - normalForce * normalForce));
      const used = (100 * sideways) / Math.max(1e-9, set.mu * normalForce);
      item.text += `: ${force.toFixed(2)} N, normal ${normalForce.toFixed(2)} N, ` +
        `tangential ${used.toFixed(0)} % of the cone`;
      along.set(...f).divideScalar(force);
      const length = (force / this.newtons) * 0.6 * this.unit;
      for (const part of [item.shaft, item.head]) part.quaternion.setFromUnitVectors(up, along);
      const thin = 0.012 * this.unit;
      item.shaft.position.copy(at);
      item.shaft.scale.set(thin, length, thin);
      item.head.position.copy(at).addScaledVector(along, length);
    });
  }

  show(layers) {
    const on = layers[this.layer];
    for (const item of this.items) {
      item.point.visible = item.there && on;
      item.normal.visible = item.there && on && layers.normals;
      item.cone.visible = item.there && on && layers.cones;
      item.shaft.visible = item.head.visible = item.pushes && on && layers.forces;
    }
  }

  /** What is said of a mesh that is pointed at, if it is one of these. */
  text(mesh) {
    const item = this.items.find((i) => Object.values(i).includes(mesh));
    return item && item.text;
  }

  get meshes() { return this.items.flatMap((i) => [i.point, i.shaft, i.head]); }
};
