// A camera that turns about a point: drag turns, right or shift drag moves, the wheel comes nearer.

class Orbit {
  constructor(element, changed) {
    this.changed = changed;
    this.pointers = new Map();
    element.addEventListener("contextmenu", (event) => event.preventDefault());
    element.addEventListener("pointerdown", (event) => {
      element.setPointerCapture(event.pointerId);
      this.pointers.set(event.pointerId, event);
    });
    for (const end of ["pointerup", "pointercancel"]) element.addEventListener(end, (event) => this.pointers.delete(event.pointerId));
    element.addEventListener("pointermove", (event) => this.move(event, element));
    element.addEventListener("wheel", (event) => {
      event.preventDefault();
      this.zoom(Math.exp(0.0012 * event.deltaY * (event.deltaMode ? 20 : 1)));
    }, { passive: false });
  }

  /** Look from a direction so that spheres [[centre, radius], …] fill the picture. */
  fit(towards, spheres, aspect) {
    const back = unit(towards), right = unit(cross([0, 0, 1], back)), up = cross(back, right);
    const low = [Infinity, Infinity, Infinity], high = [-Infinity, -Infinity, -Infinity];
    for (const [p, r] of spheres)
      [right, up, back].forEach((axis, i) => {
        low[i] = Math.min(low[i], dot(axis, p) - r);
        high[i] = Math.max(high[i], dot(axis, p) + r);
      });
    const half = high.map((h, i) => (h - low[i]) / 2), middle = high.map((h, i) => (h + low[i]) / 2);
    this.centre = [0, 1, 2].map((c) => middle[0] * right[c] + middle[1] * up[c] + middle[2] * back[c]);
    this.azimuth = Math.atan2(back[1], back[0]);
    this.elevation = Math.asin(clamp(back[2], -1, 1));
    this.distance = 0.75 * half[2] + (1.06 * Math.max(half[1], half[0] / aspect)) / Math.tan(FIELD / 2);
    this.size = Math.max(...half);
    this.changed();
  }

  get towards() {
    const c = Math.cos(this.elevation);
    return [c * Math.cos(this.azimuth), c * Math.sin(this.azimuth), Math.sin(this.elevation)];
  }

  zoom(factor) {
    this.distance = clamp(this.distance * factor, 0.05 * this.size, 60 * this.size);
    this.changed();
  }

  move(event, element) {
    const before = this.pointers.get(event.pointerId);
    if (!before) return;
    const [dx, dy] = [event.clientX - before.clientX, event.clientY - before.clientY], tall = element.clientHeight;
    const others = [...this.pointers.values()].filter((pointer) => pointer.pointerId !== event.pointerId);
    this.pointers.set(event.pointerId, event);
    if (others.length) {
      const apart = (p) => Math.hypot(p.clientX - others[0].clientX, p.clientY - others[0].clientY);
      this.zoom(apart(before) / Math.max(apart(event), 1));
    }
    if (others.length || event.buttons & 6 || event.shiftKey) {
      const back = this.towards, right = unit(cross([0, 0, 1], back)), up = cross(back, right);
      const pixel = (2 * Math.tan(FIELD / 2) * this.distance) / tall / (others.length ? 2 : 1);
      this.centre = add(add(this.centre, right, -dx * pixel), up, dy * pixel);
    } else {
      this.azimuth -= (4 * dx) / tall;
      this.elevation = clamp(this.elevation + (4 * dy) / tall, -1.5, 1.5);
    }
    this.changed();
  }

  /** {eye, view}: where the camera is, and the matrix to the picture. */
  matrices(aspect) {
    const eye = add(this.centre, this.towards, this.distance);
    const near = Math.max(0.02 * this.distance, this.distance - 12 * this.size);
    const view = times(perspective(FIELD, aspect, near, this.distance + 60 * this.size), looking(eye, this.centre, [0, 0, 1]));
    return { eye, view };
  }
}
