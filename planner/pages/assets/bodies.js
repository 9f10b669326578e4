"use strict";
/* Models as trees of THREE groups, one group per joint: three.js computes the kinematics. A joint's
   group has its placement as its own matrix; a turning or sliding group inside it carries what
   moves with the joint. */

/** Corners sharper than this stay sharp in the shading of a smooth part, rad. */
const CREASE = (40 * Math.PI) / 180;

/** A part's geometry: coordinates out of 16-bit steps, normals averaged up to the crease. */
function partGeometry(part) {
  const steps = part.vertices.data, triangles = part.triangles.data;
  const corners = new Float32Array(3 * triangles.length);
  for (let c = 0; c < triangles.length; c++) {
    for (let k = 0; k < 3; k++) {
      corners[3 * c + k] = part.low[k] + (steps[3 * triangles[c] + k] / 65535) * part.size[k];
    }
  }
  const geometry = new THREE.BufferGeometry();
  geometry.setAttribute("position", new THREE.BufferAttribute(corners, 3));
  geometry.setAttribute("normal", new THREE.BufferAttribute(
    cornerNormals(corners, triangles, part.vertices.length, part.smooth), 3));
  return geometry;
}

function cornerNormals(corners, triangles, nVertices, smooth) {
  const nFaces = triangles.length / 3, faces = new Float32Array(3 * nFaces);
  const units = new Float32Array(3 * nFaces), normals = new Float32Array(3 * triangles.length);
  for (let f = 0; f < nFaces; f++) {
    const o = 9 * f;
    const ax = corners[o + 3] - corners[o], ay = corners[o + 4] - corners[o + 1], az = corners[o + 5] - corners[o + 2];
    const bx = corners[o + 6] - corners[o], by = corners[o + 7] - corners[o + 1], bz = corners[o + 8] - corners[o + 2];
    const n = [ay * bz - az * by, az * bx - ax * bz, ax * by - ay * bx];
    const length = Math.hypot(...n) || 1;
    for (let k = 0; k < 3; k++) {
      faces[3 * f + k] = n[k];
      units[3 * f + k] = n[k] / length;
    }
  }
  // the faces at each vertex, as one list with starts
  const starts = new Uint32Array(nVertices + 1), at = new Uint32Array(triangles.length);
  if (smooth) {
    for (const v of triangles) starts[v + 1]++;
    for (let v = 0; v < nVertices; v++) starts[v + 1] += starts[v];
    const filled = starts.slice();
    for (let c = 0; c < triangles.length; c++) at[filled[triangles[c]]++] = (c / 3) | 0;
  }
  const limit = Math.cos(CREASE);
  for (let c = 0; c < triangles.length; c++) {
    const f = (c / 3) | 0, v = triangles[c];
    let x = 0, y = 0, z = 0;
    const end = smooth ? starts[v + 1] : 0;
    for (let i = smooth ? starts[v] : 0; i < end; i++) {
      const g = at[i];
      const along = units[3 * f] * units[3 * g] + units[3 * f + 1] * units[3 * g + 1] + units[3 * f + 2] * units[3 * g + 2];
      if (along < limit) continue;
      x += faces[3 * g]; y += faces[3 * g + 1]; z += faces[3 * g + 2];
    }
    const length = Math.hypot(x, y, z);
    if (length > 0) normals.set([x / length, y / length, z / length], 3 * c);
    else normals.set(units.subarray(3 * f, 3 * f + 3), 3 * c);
  }
  return normals;
}

function partMaterial(part, opacity) {
  const [red, green, blue, alpha] = part.colour;
  const seen = alpha * opacity;
  const material = new THREE.MeshStandardMaterial({
    color: new THREE.Color(red, green, blue).convertSRGBToLinear(),
    roughness: part.layer === "table" ? 0.95 : 0.55,
    metalness: 0.0,
    opacity: seen,
    transparent: seen < 1,
    depthWrite: seen >= 0.99,
    side: part.layer === "pads" ? THREE.DoubleSide : THREE.FrontSide,
  });
  if (part.layer === "pads") {
    material.polygonOffset = true;
    material.polygonOffsetFactor = -2;
  }
  return material;
}

/** Sets a group's place from x, y, z, qw, qx, qy, qz. */
Opposable.place = function (group, pose) {
  group.position.set(pose[0], pose[1], pose[2]);
  group.quaternion.set(pose[4], pose[5], pose[6], pose[3]);
};

/** The three coloured axes of a frame, of this length in m. */
Opposable.axes = function (length) {
  const axes = new THREE.AxesHelper(length);
  axes.material.depthTest = false;
  axes.material.transparent = true;
  axes.renderOrder = 5;
  axes.raycast = () => {};
  return axes;
};

Opposable.Body = class {
  /** actor and model as in planner/pages/scene.py; geometries: cache by part; radius: m. */
  constructor(actor, model, geometries, radius) {
    this.name = actor.name;
    this.actor = actor;
    this.model = model;
    this.base = new THREE.Group();
    this.joints = [];
    this.meshes = [];
    this.frames = [];
    for (const joint of model.joints) {
      const fixed = new THREE.Group(), moving = new THREE.Group();
      Opposable.place(fixed, joint.placement);
      fixed.add(moving);
      (joint.parent < 0 ? this.base : this.joints[joint.parent].moving).add(fixed);
      this.joints.push({ ...joint, moving, direction: new THREE.Vector3(...joint.axis) });
    }
    for (const part of model.parts) {
      if (!geometries.has(part)) geometries.set(part, partGeometry(part));
      const mesh = new THREE.Mesh(geometries.get(part), partMaterial(part, actor.opacity));
      const casts = part.layer !== "collision" && part.layer !== "pads" && actor.opacity > 0.6;
      mesh.castShadow = casts && part.layer !== "table";
      mesh.receiveShadow = casts;
      mesh.userData = { part, text: `${part.name} (${actor.name})` };
      (part.joint < 0 ? this.base : this.joints[part.joint].moving).add(mesh);
      this.meshes.push(mesh);
    }
    for (const group of [this.base, ...this.joints.map((j) => j.moving)]) {
      const axes = Opposable.axes(0.12 * radius);
      group.add(axes);
      this.frames.push(axes);
    }
    this.move(actor.pose, Opposable.rows(actor.q).data);
  }

  move(pose, q) {
    Opposable.place(this.base, pose);
    this.bend(q);
  }

  bend(q) {
    this.q = q;
    this.joints.forEach((joint, i) => {
      const value = q[i] || 0;
      if (joint.kind === "hinge") joint.moving.quaternion.setFromAxisAngle(joint.direction, value);
      else joint.moving.position.copy(joint.direction).multiplyScalar(value);
    });
  }

  /** Layers: name -> whether on. */
  show(layers) {
    const whole = !this.actor.layer || layers[this.actor.layer];
    for (const mesh of this.meshes) mesh.visible = whole && layers[mesh.userData.part.layer];
    for (const axes of this.frames) axes.visible = whole && layers.frames;
  }

  /** World pose [x, y, z, qw, qx, qy, qz] of a joint's body, of the base for null. */
  pose(jointName) {
    let group = this.base;
    if (jointName !== null && jointName !== undefined) {
      const joint = this.joints.find((j) => j.name === jointName);
      if (!joint) throw new Error(`${this.name} has no joint ${jointName}`);
      group = joint.moving;
    }
    group.updateWorldMatrix(true, false);
    const position = new THREE.Vector3(), turn = new THREE.Quaternion(), scale = new THREE.Vector3();
    group.matrixWorld.decompose(position, turn, scale);
    return [position.x, position.y, position.z, turn.w, turn.x, turn.y, turn.z];
  }
};
