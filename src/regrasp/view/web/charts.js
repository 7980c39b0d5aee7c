// Curves over time with the current time marked; a click goes to its time.

const INK = "#2b2b2b", MUTED = "#7a7a76", FAINT = "#e6e6e1";

/** A colour dark enough for a thin line on white. */
const strong = (colour) => `rgb(${scaled(rgb(colour), 255 * 0.84).map(Math.round)})`;

/** The round step (1, 2, 5 times a power of ten) that cuts a range into at most so many parts. */
function roundStep(range, parts) {
  const least = range / parts, power = 10 ** Math.floor(Math.log10(least));
  return [1, 2, 5, 10].map((digit) => digit * power).find((step) => step >= least * (1 - 1e-9));
}

class Chart {
  /** curves: {x, y, colour, dash, width}; options: low, high, log, marks (x of violations), seek (x chosen). */
  constructor(parent, heading, note, seek) {
    this.box = document.createElement("figure");
    this.box.className = "chart";
    this.box.innerHTML = `<figcaption></figcaption><div class="plot"><canvas></canvas><div class="playhead" hidden></div></div>`;
    this.box.querySelector("figcaption").innerHTML = `<b>${heading}</b> <span>${note}</span>`;
    this.plot = this.box.querySelector(".plot");
    this.canvas = this.box.querySelector("canvas");
    this.playhead = this.box.querySelector(".playhead");
    parent.append(this.box);
    if (seek) {
      this.plot.classList.add("seekable");
      const go = (event) => {
        const { left } = this.plot.getBoundingClientRect();
        seek(clamp((event.clientX - left - this.left) / this.width, 0, 1) * (this.until - this.since) + this.since);
      };
      this.plot.addEventListener("pointerdown", (event) => {
        this.plot.setPointerCapture(event.pointerId);
        go(event);
      });
      this.plot.addEventListener("pointermove", (event) => event.buttons && go(event));
    }
  }

  draw({ curves, since = 0, until, low, high, log = false, marks = [], band = null }) {
    const ratio = devicePixelRatio || 1, wide = this.plot.clientWidth, tall = this.plot.clientHeight;
    Object.assign(this, { since, until, left: 36, width: wide - 42 });
    Object.assign(this.canvas, { width: wide * ratio, height: tall * ratio });
    const g = this.canvas.getContext("2d");
    g.scale(ratio, ratio);
    const top = 6, bottom = tall - 16;
    const level = (v) => (log ? Math.log10(Math.max(v, low)) : v);
    const [a, b] = [level(low), level(high)];
    const X = (x) => this.left + (this.width * (x - since)) / (until - since || 1);
    const Y = (y) => bottom - ((bottom - top) * (clamp(level(y), a, b) - a)) / (b - a || 1);
    if (band) {
      g.fillStyle = "#f1efe6";
      g.fillRect(X(band[0]), top, Math.max(X(band[1]) - X(band[0]), 2), bottom - top);
    }
    g.font = "10px system-ui, sans-serif";
    g.lineWidth = 1;
    const ticks = [];
    if (log) for (let e = Math.ceil(a); e <= b + 1e-9; e++) ticks.push(10 ** e);
    if (ticks.length < 2) {
      ticks.length = 0;
      const step = roundStep(high - low, 3);
      for (let y = Math.ceil(low / step - 1e-9) * step; y <= high + 1e-9 * step; y += step) ticks.push(+y.toPrecision(6));
    }
    g.textAlign = "right";
    g.textBaseline = "middle";
    for (const y of ticks) {
      g.strokeStyle = FAINT;
      g.beginPath();
      g.moveTo(this.left, Y(y));
      g.lineTo(this.left + this.width, Y(y));
      g.stroke();
      g.fillStyle = MUTED;
      g.fillText(`${y}`.replace("-", "−"), this.left - 5, Y(y));
    }
    g.textAlign = "center";
    const pace = roundStep(until - since, Math.max(2, this.width / 56));
    for (let x = Math.ceil(since / pace) * pace; x <= until + 1e-9; x += pace)
      g.fillText(`${+x.toPrecision(6)}`, clamp(X(x), this.left, this.left + this.width - 4), tall - 7);
    for (const { x, y, colour, width = 1.5, dash = [] } of curves) {
      g.strokeStyle = colour;
      g.lineWidth = width;
      g.setLineDash(dash);
      g.beginPath();
      let drawing = false;
      for (let i = 0; i < x.length; i++) {
        if (Number.isNaN(y[i])) drawing = false;
        else {
          drawing ? g.lineTo(X(x[i]), Y(y[i])) : g.moveTo(X(x[i]), Y(y[i]));
          drawing = true;
        }
      }
      g.stroke();
    }
    g.setLineDash([]);
    g.fillStyle = INK;
    for (const x of marks) {
      g.beginPath();
      g.moveTo(X(x), bottom - 7);
      g.lineTo(X(x) - 4, bottom);
      g.lineTo(X(x) + 4, bottom);
      g.fill();
    }
  }

  /** Move the mark of the current time; null hides it. */
  mark(x) {
    this.playhead.hidden = x === null;
    if (x !== null) this.playhead.style.transform = `translateX(${this.left + (this.width * (x - this.since)) / (this.until - this.since || 1)}px)`;
  }
}

/** All charts of a story. */
class Charts {
  constructor(parent, story, seek) {
    parent.replaceChildren();
    this.story = story;
    this.agent = 0;
    const chart = (heading, note, seeks = true) => new Chart(parent, heading, note, seeks && seek);
    if (!story.draft) {
      this.forces = chart("Forces", "N, of each agent" + (story.P ? "; supports together, dashed" : ""));
      this.friction = chart("Friction margin", "0: on the cone's edge");
    }
    this.joints = chart("Joint-limit margin", "0: at a limit");
    this.angles = chart("Joints", "");
    this.off = story.run ? chart("Off the plan", "in physics, mm and ° (dashed)") : null;
    if (story.arrays.energy.length > 1) this.energy = chart("Energy E(V)", "over the V's tried; shaded: the current segment", false);
  }

  column(name, i, things, change = (v) => v) {
    const array = this.story.arrays[name], rows = this.story.N * this.story.M;
    return Float32Array.from({ length: rows }, (_, row) => change(array[row * things + i], row));
  }

  sizes(name, i, things) {
    const array = this.story.arrays[name], rows = this.story.N * this.story.M;
    return Float32Array.from({ length: rows }, (_, row) => Math.hypot(...array.subarray(3 * (row * things + i), 3 * (row * things + i) + 3)));
  }

  draw() {
    const { story } = this, { time } = story.arrays, { k, P } = story;
    const marks = story.violations().filter((v) => v.at !== null).map((v) => v.at), common = { until: story.span, marks };
    const each = (make) => story.agents.map((agent, i) => ({ x: time, y: make(i), colour: strong(agent.colour) }));
    const forces = each((i) => this.sizes("force", i, k));
    if (P) {
      const slots = story.slots.map((_, s) => this.sizes("support_force", s, P));
      forces.push({ x: time, y: time.map((_, row) => slots.reduce((sum, slot) => sum + slot[row], 0)), colour: story.colours.support, dash: [4, 3] });
    }
    const most = forces.reduce((high, { y }) => y.reduce((a, b) => Math.max(a, b), high), 1e-3);
    this.forces?.draw({ ...common, curves: forces, low: 0, high: 1.05 * most });
    this.friction?.draw({ ...common, curves: each((i) => this.column("friction_margin", i, k)), low: 0, high: 1 });
    this.joints.draw({ ...common, curves: each((i) => this.column("joint_margin", i, k)), low: 0, high: 1 });
    this.choose(this.agent);
    if (this.off) {
      const { run_time, run_off } = story.arrays;
      const column = (c, unit) => run_time.map((_, row) => unit * run_off[2 * row + c]);
      const curves = [{ x: run_time, y: column(0, 1e3), colour: INK }, { x: run_time, y: column(1, 180 / Math.PI), colour: INK, dash: [4, 3] }];
      const high = curves.reduce((h, { y }) => y.reduce((a, b) => Math.max(a, b), h), 1e-3);
      this.off.draw({ ...common, curves, low: 0, high: 1.05 * high });
    }
    this.segment = -1;
  }

  /** Show the joints of one agent. */
  choose(i) {
    const { story } = this, agent = story.agents[i], arm = story.arms[agent.arm], nq = story.arrays.joints.shape[2];
    this.agent = i;
    const limbs = [{ ...agent, colour: strong(agent.colour) }, ...(arm ? [{ ...arm, colour: MUTED }] : [])];
    const slides = limbs.flatMap((limb) => limb.slides), unit = slides.every((s) => s) ? "m" : slides.some((s) => s) ? "° or m" : "°";
    const words = `${escaped(agent.name)}, ${unit}, base first: solid, then finer dashes${arm ? "; its arm's grey" : ""}`;
    this.angles.box.querySelector("figcaption").innerHTML = `<b>Joints</b> <span>of <i style="background:${agent.colour}"></i>${words}</span>`;
    const dashes = [[], [9, 3], [6, 3], [4, 2], [2, 2], [1, 2]];
    const curves = limbs.flatMap(({ first, slides, colour }) => slides.map((straight, c) => ({
      x: story.arrays.time, colour, dash: dashes[Math.min(c, 5)],
      y: this.column("joints", first + c, nq, (v) => (straight ? v : (v * 180) / Math.PI)),
    })));
    let low = Infinity, high = -Infinity;
    for (const { y } of curves) for (const v of y) [low, high] = [Math.min(low, v), Math.max(high, v)];
    const room = 0.05 * (high - low) || 1;
    this.angles.draw({ until: story.span, curves, low: low - room, high: high + room });
  }

  mark(time, segment) {
    for (const chart of [this.forces, this.friction, this.joints, this.angles, this.off]) chart?.mark(time);
    if (segment !== this.segment) this.history(segment);
  }

  /** The energy, with one segment shaded and its best V marked. */
  history(segment) {
    this.segment = segment;
    if (!this.energy) return;
    const { energy, energy_segment } = this.story.arrays, first = energy_segment.indexOf(segment), last = energy_segment.lastIndexOf(segment);
    let low = Infinity, high = -Infinity, best = first;
    energy.forEach((v, i) => {
      [low, high] = [Math.min(low, v), Math.max(high, v)];
      if (i >= first && i <= last && v < energy[best]) best = i;
    });
    const log = low > 0 && high / low > 20, curves = [{ x: energy.map((_, i) => i), y: energy, colour: INK, width: 1 }];
    const room = 0.05 * (high - low) || 1;
    this.energy.draw({
      curves, until: Math.max(energy.length - 1, 1), log, low: log ? low : low - room, high: log ? high : high + room, band: [first, last],
    });
    this.energy.mark(first < 0 ? null : best);
  }
}

const escaped = (text) => text.replace(/[&<>"]/g, (c) => `&#${c.charCodeAt(0)};`);
