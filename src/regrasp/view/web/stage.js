// What stands on the stage at a time: the story's bodies, forces, contacts and ways as a picture for the painter.

const OBJECT = rgb("#D9CBB4"), STATIC = rgb("#C3C8CC"), PALE = rgb("#E3E4E4"), BACK = rgb("#F6F6F3"), FLOOR = rgb("#E9E8E3");
const GOAL = rgb("#4A6FA5"), PLANNED = rgb("#4D4D4D"), WAY = rgb("#8A8A8A");
const FIELD = 0.42;

class Stage {
  constructor(painter) {
    this.painter = painter;
    this.common = { shaft: painter.mesh(SOLIDS.cylinder([1, 0.5])), head: painter.mesh(SOLIDS.cone([1, 1])), floor: null };
    const square = { points: [-1, -1, 0, 1, -1, 0, 1, 1, 0, -1, 1, 0], normals: [0, 0, 1, 0, 0, 1, 0, 0, 1, 0, 0, 1], faces: [0, 1, 2, 0, 2, 3] };
    this.common.floor = painter.mesh(square);
    this.kept = new Map();
    this.passing = [];
    this.own = [];
  }

  /** Take a story: meshes of its shapes, ways of its contacts. */
  show(story) {
    this.own.forEach((each) => this.painter.forget(each));
    this.story = story;
    this.meshes = [];
    for (let i = 0; i < story.meshes; i++) {
      const [points, faces, normals] = ["vertices", "faces", "normals"].map((name) => story.arrays[name + i]);
      this.meshes.push(this.painter.mesh(normals.length ? { points, normals, faces } : creased(points, faces)));
    }
    this.shapes = story.shapes.map((shape) => ({
      ...shape,
      mesh: this.meshOf(shape),
      local: posed(shape.pose.slice(0, 3), shape.pose.slice(3)),
      colour: this.colourOf(shape),
    }));
    this.planes = this.shapes.filter((shape) => shape.kind === "plane");
    this.solids = this.shapes.filter((shape) => shape.kind !== "plane");
    this.ways = story.agents.map((agent, i) => this.painter.strokes(this.contactWays(i)));
    this.way = this.painter.strokes([this.objectWay()]);
    this.own = [...this.meshes, ...this.ways, this.way];
    this.low = this.lowest();
  }

  meshOf(shape) {
    if (shape.kind === "mesh") return this.meshes[shape.mesh];
    if (shape.kind === "plane") return this.common.floor;
    const key = `${shape.kind} ${shape.size}`;
    if (!this.kept.has(key)) this.kept.set(key, this.painter.mesh(SOLIDS[shape.kind](shape.size)));
    return this.kept.get(key);
  }

  colourOf(shape) {
    if (shape.role === "object") return OBJECT;
    if (shape.role === "static") return STATIC;
    if (shape.agent < 0) return PALE;
    const own = rgb(this.story.agents[shape.agent].colour);
    return shape.tip ? own : mix(PALE, own, 0.32);
  }

  /** Where an agent's contact goes on the object: polylines in O, of points [x, y, z, time]. */
  contactWays(i) {
    const { p_O, n_O, time } = this.story.arrays, k = this.story.k, lift = 0.006 * this.story.radius;
    const out = [[]];
    for (let row = 0; row < time.length; row++) {
      const at = 3 * (row * k + i);
      if (Number.isNaN(p_O[at])) {
        if (out.at(-1).length) out.push([]);
      } else out.at(-1).push([0, 1, 2].map((c) => p_O[at + c] + lift * n_O[at + c]).concat(time[row]));
    }
    return out.filter((way) => way.length > 1);
  }

  objectWay() {
    const { pose, time } = this.story.arrays, { bodies, object } = this.story;
    return Array.from(time, (t, row) => {
      const at = 7 * (row * bodies + object);
      return [pose[at], pose[at + 1], pose[at + 2], t];
    });
  }

  /** Height of the lowest point of all, where no floor is given. */
  lowest() {
    let low = Infinity;
    const instant = this.story.at(0);
    for (const shape of this.solids) {
      if (shape.shell) continue;
      const p = through(times(this.poseOf(shape.body, instant), shape.local), [0, 0, 0]);
      const s = shape.size, reach = { sphere: s[0], capsule: s[0] + s[1], cylinder: Math.max(s[0], s[1]) }[shape.kind] ?? Math.hypot(...s);
      low = Math.min(low, p[2] - (Number.isFinite(reach) ? reach : 0));
    }
    return low;
  }

  poseOf(body, instant) {
    if (body < 0) return UNMOVED;
    const pose = this.story.pose(body, instant);
    return posed(pose.slice(0, 3), pose.slice(3));
  }

  /** Points and radii that a view should hold: object, tips, goal. */
  interest() {
    const story = this.story, out = [[story.goal.slice(0, 3), story.radius]];
    const tips = this.shapes.filter((shape) => shape.tip);
    for (let s = 0; s <= 12; s++) {
      const instant = story.at((story.end * s) / 12);
      out.push([story.pose(story.object, instant).slice(0, 3), 1.15 * story.radius]);
      const object = this.poseOf(story.object, instant);
      for (const { p, f } of this.contacts(instant, object)) out.push([add(p, f, -story.reach), 0.05 * story.radius]);
      for (const tip of tips) out.push([through(times(this.poseOf(tip.body, instant), tip.local), [0, 0, 0]), 3 * Math.max(...tip.size, 0)]);
    }
    return out;
  }

  /** Contacts that bear force at a time: {p, n, x, f, mu, colour, of} in W; the object is where `object` has it. */
  contacts(instant, object) {
    const story = this.story, out = [];
    for (let i = 0; i < story.k; i++) {
      const p = story.value("p_O", instant, i, story.k, 3);
      if (Number.isNaN(p[0])) continue;
      const [n, x] = ["n_O", "x_O"].map((name) => unit(through(object, story.value(name, instant, i, story.k, 3), 0)));
      const agent = story.agents[i];
      out.push({ p: through(object, p), n, x, f: story.value("force", instant, i, story.k, 3), mu: agent.mu, colour: rgb(story.colours.force), own: rgb(agent.colour), agent: i });
    }
    for (let s = 0; s < story.P; s++) {
      if (!story.arrays.support_mode[instant.j * story.P + s]) continue;
      const p = through(object, story.value("support_p_O", instant, s, story.P, 3));
      const n = scaled(unit(story.value("support_n_W", instant, s, story.P, 3)), -1);
      out.push({ p, n, x: null, f: story.value("support_force", instant, s, story.P, 3), mu: story.slots[s].mu, colour: rgb(story.colours.support), own: rgb(story.colours.support), agent: -1 });
    }
    return out;
  }

  /** An arrow of a force whose head is at p. */
  arrow(p, f, colour, width = 1) {
    const story = this.story, long = story.reach * length(f), thick = 0.022 * story.radius * width;
    if (long < thick) return [];
    const along = unit(f), head = Math.min(9 * thick, 0.7 * long), colours = { colour };
    const tail = add(p, along, -long);
    const parts = [{ mesh: this.common.head, pose: facing(p, scaled(along, -1)), scale: [3.2 * thick, 3.2 * thick, head], ...colours }];
    const shaft = long - 0.9 * head;
    parts.push({ mesh: this.common.shaft, pose: facing(add(tail, along, 0.5 * shaft), along), scale: [thick, thick, shaft], ...colours });
    return parts;
  }

  /** The picture at a time, for the layers that are on. */
  picture(time, layers, camera) {
    const story = this.story;
    this.pixel = camera.pixel;
    this.passing.forEach((strokes) => this.painter.forget(strokes));
    this.passing = [];
    const instant = story.at(Math.min(time, story.end)), record = story.run ? story.record(time) : null;
    const poses = [];
    for (let body = 0; body < story.bodies; body++) {
      const pose = record ? story.real(body, record) : story.pose(body, instant);
      poses.push(posed(pose.slice(0, 3), pose.slice(3)));
    }
    const object = poses[story.object], planned = this.poseOf(story.object, instant);
    const solids = [], ghosts = [], shells = [], marks = [], strokes = [], tops = [];
    for (const shape of this.solids) {
      const pose = shape.body < 0 ? UNMOVED : poses[shape.body];
      const lined = layers.lines && (shape.role === "object" || shape.tip) ? 1 : 0;
      // The object's lines are those of its own frame; a tip's those of the tip.
      const frame = shape.role === "object" ? { pose, local: shape.local } : { pose: times(pose, shape.local) };
      const each = { mesh: shape.mesh, colour: shape.colour, lined, front: shape.tip, ...frame };
      if (!shape.shell) solids.push(each);
      else if (layers.shells) shells.push({ ...each, lined: 0, alpha: 0.3 });
    }
    const ghost = (pose, colour, alpha) =>
      this.solids.filter((shape) => shape.role === "object" && !shape.shell)
        .map((shape) => ({ mesh: shape.mesh, pose, local: shape.local, colour, alpha, lined: 0.5 }));
    if (layers.goal) ghosts.push(ghost(posed(story.goal.slice(0, 3), story.goal.slice(3)), GOAL, 0.2));
    if (layers.route || story.draft) {
      for (const pose of story.route.slice(1, -1)) ghosts.push(ghost(posed(pose.slice(0, 3), pose.slice(3)), WAY, 0.12));
      strokes.push({ ...this.brief(story.route, WAY, 2.5), alpha: 0.7 });
    }
    if (record) ghosts.push(ghost(planned, PLANNED, 0.3));
    if (shells.length) ghosts.push(shells);
    const contacts = this.contacts(instant, object);
    if (layers.cones) {
      const tall = 0.55 * story.radius;
      for (const { p, n, mu, own } of contacts)
        ghosts.push([{ mesh: this.common.head, pose: facing(p, n), scale: [mu * tall, mu * tall, tall], colour: own, alpha: 0.34 }]);
    }
    if (layers.forces) {
      for (const { p, f, colour, agent } of contacts) {
        const measured = record && agent >= 0 ? this.measured(record, agent) : null;
        marks.push(...this.arrow(p, measured ?? f, colour));
        if (measured) marks.push(...this.arrow(p, f, PLANNED, 0.45));
      }
    }
    if (layers.frames) {
      const long = 0.3 * story.radius;
      for (const { p, n, x } of contacts.filter((contact) => contact.x))
        for (const [axis, colour] of [[x, [0.1, 0.1, 0.1]], [cross(n, x), [0.55, 0.55, 0.55]], [n, [1, 1, 1]]])
          tops.push(this.brief([p, add(p, axis, long)], colour, 3));
    }
    if (layers.paths)
      this.ways.forEach((way, i) =>
        strokes.push({ strokes: way, pose: object, colour: scaled(rgb(story.agents[i].colour), 0.78), width: 3 * camera.pixel, now: time, later: 0.25 }));
    if (layers.paths) strokes.push({ strokes: this.way, colour: WAY, alpha: 0.8, width: 1.6 * camera.pixel, now: time, later: 0.45 });
    return { ...camera, ...this.light(), back: BACK, solids, ghosts, marks, strokes, tops, contacts, object, poses };
  }

  measured(record, agent) {
    const { k } = this.story, force = this.story.arrays.run_force;
    return [0, 1, 2].map((c) => (1 - record.u) * force[3 * (record.a * k + agent) + c] + record.u * force[3 * (record.b * k + agent) + c]);
  }

  brief(points, colour, width) {
    const strokes = this.painter.strokes([points]);
    this.passing.push(strokes);
    return { strokes, colour, width: width * this.pixel };
  }

  /** Light from above, and the floors that it falls on. */
  light() {
    const { centre, radius, towards } = this.story.view, far = 6 * radius;
    // From above, from the left of and behind the camera as it is at first.
    const right = unit(cross([0, 0, 1], towards)), level = unit(cross(right, [0, 0, 1]));
    const sun = unit(add(add([0, 0, 1.5], right, -0.55), level, 0.75));
    const view = looking(add(centre, sun, far), centre, [0, 0, 1]);
    const wide = { mesh: this.common.floor, scale: [20 * radius, 20 * radius, 1], colour: FLOOR };
    const floors = this.planes.length
      ? this.planes.map((plane) => ({ ...wide, pose: this.floorPose(plane) }))
      : [{ ...wide, pose: facing([centre[0], centre[1], this.low], [0, 0, 1]) }];
    return {
      sun, light: times(parallel(2.2 * radius, 0.1 * far, 3 * far), view), grounds: floors,
      ground: { centre, fade: 3.4 * radius, cell: roundStep(radius, 3) },
    };
  }

  /** A plane has no end: what is drawn of it lies below the middle of the scene. */
  floorPose(plane) {
    const { centre } = this.story.view;
    const n = plane.local.slice(8, 11), p = plane.local.slice(12, 15);
    return facing(add(centre, n, dot(add(p, centre, -1), n)), n);
  }
}
