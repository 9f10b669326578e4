"use strict";
/* The camera goes around a point: drag turns, right button or shift moves, wheel or pinch nears. */
Opposable.Camera = class {
  /** element: what is dragged; focus: point looked at (THREE.Vector3); radius: of what is seen, m. */
  constructor(element, focus, radius, changed) {
    this.eye = new THREE.PerspectiveCamera(35, 1, radius / 200, radius * 200);
    this.eye.up.set(0, 0, 1);
    this.home = focus.clone();
    this.focus = focus.clone();
    this.shift = new THREE.Vector3();
    this.radius = radius;
    this.changed = changed;
    this.azimuth = -0.8;
    this.elevation = 0.45;
    this.distance = 1;
    this.pointers = new Map();
    this.look([0.75, -1, 0.62]);
    this.listen(element);
  }

  /** Looks from this direction (from the focus to the camera), at the whole scene. */
  look(direction) {
    const [x, y, z] = direction;
    this.azimuth = Math.atan2(y, x);
    this.elevation = Math.atan2(z, Math.hypot(x, y));
    this.focus.copy(this.home);
    this.fit();
  }

  /** The distance from which a ball of the scene's radius fills the picture. */
  fit() {
    const half = (this.eye.fov * Math.PI) / 360;
    const narrow = Math.min(half, Math.atan(Math.tan(half) * this.eye.aspect));
    this.distance = this.radius / Math.sin(narrow);
    this.update();
  }

  /** Goes along with something that has moved by this much (THREE.Vector3). */
  follow(shift) {
    this.shift.copy(shift);
    this.update();
  }

  resize(aspect) {
    this.eye.aspect = aspect;
    this.eye.updateProjectionMatrix();
  }

  update() {
    const limit = Math.PI / 2 - 1e-3;
    this.elevation = Math.min(limit, Math.max(-limit, this.elevation));
    this.distance = Math.min(60 * this.radius, Math.max(this.radius / 30, this.distance));
    const target = this.focus.clone().add(this.shift);
    const flat = Math.cos(this.elevation) * this.distance;
    this.eye.position.set(
      target.x + flat * Math.cos(this.azimuth),
      target.y + flat * Math.sin(this.azimuth),
      target.z + Math.sin(this.elevation) * this.distance);
    this.eye.lookAt(target);
    this.eye.updateMatrixWorld();
    this.changed();
  }

  pan(dx, dy, height) {
    const scale = (2 * this.distance * Math.tan((this.eye.fov * Math.PI) / 360)) / height;
    const right = new THREE.Vector3().setFromMatrixColumn(this.eye.matrixWorld, 0);
    const up = new THREE.Vector3().setFromMatrixColumn(this.eye.matrixWorld, 1);
    this.focus.addScaledVector(right, -dx * scale).addScaledVector(up, dy * scale);
    this.update();
  }

  get dragging() { return this.pointers.size > 0; }

  listen(element) {
    element.addEventListener("contextmenu", (event) => event.preventDefault());
    element.addEventListener("pointerdown", (event) => {
      element.setPointerCapture(event.pointerId);
      this.pointers.set(event.pointerId, [event.clientX, event.clientY]);
    });
    const release = (event) => this.pointers.delete(event.pointerId);
    element.addEventListener("pointerup", release);
    element.addEventListener("pointercancel", release);
    element.addEventListener("pointermove", (event) => {
      const old = this.pointers.get(event.pointerId);
      if (!old) return;
      const dx = event.clientX - old[0], dy = event.clientY - old[1];
      if (this.pointers.size === 2) {
        const other = [...this.pointers].find(([id]) => id !== event.pointerId)[1];
        const before = Math.hypot(old[0] - other[0], old[1] - other[1]);
        const after = Math.hypot(event.clientX - other[0], event.clientY - other[1]);
        if (after > 0) this.distance *= before / after;
        this.pan(dx / 2, dy / 2, element.clientHeight);
      } else if (event.buttons === 2 || event.buttons === 4 || event.shiftKey) {
        this.pan(dx, dy, element.clientHeight);
      } else {
        this.azimuth -= 0.008 * dx;
        this.elevation += 0.008 * dy;
        this.update();
      }
      this.pointers.set(event.pointerId, [event.clientX, event.clientY]);
    });
    element.addEventListener("wheel", (event) => {
      event.preventDefault();
      this.distance *= Math.exp(0.0012 * Math.max(-200, Math.min(200, event.deltaY)));
      this.update();
    }, { passive: false });
  }
};
