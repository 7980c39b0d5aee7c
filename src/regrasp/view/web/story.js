// The story of a plan as Python packed it (view/story.py): header, arrays, and values at any time.

const TYPES = { float32: Float32Array, int8: Int8Array, int32: Int32Array, uint32: Uint32Array };

async function unpacked(bytes) {
  const stream = new Blob([bytes]).stream().pipeThrough(new DecompressionStream("deflate"));
  const buffer = await new Response(stream).arrayBuffer();
  const head = new DataView(buffer).getUint32(0, true), first = 4 + head;
  const header = JSON.parse(new TextDecoder().decode(new Uint8Array(buffer, 4, head)));
  const arrays = {};
  for (const [name, { type, shape, at }] of Object.entries(header.arrays)) {
    const count = shape.reduce((a, b) => a * b, 1);
    arrays[name] = new TYPES[type](buffer, first + at, count);
    arrays[name].shape = shape;
  }
  return new Story(header, arrays);
}

class Story {
  constructor(header, arrays) {
    Object.assign(this, header);
    this.arrays = arrays;
    [this.N, this.M] = arrays.time.shape;
    this.k = this.agents.length;
    this.P = this.slots.length;
    this.supports = [...new Set(this.slots.map((slot) => slot.name))];
    this.end = arrays.time[this.N * this.M - 1];
    this.span = Math.max(this.end, this.run ? arrays.run_time[arrays.run_time.length - 1] : 0, 1e-3);
  }

  begins(j) {
    return this.arrays.time[j * this.M];
  }

  ends(j) {
    return this.arrays.time[j * this.M + this.M - 1];
  }

  /** Interval j, rows a and b of the samples around a time, and how far it is from a to b. */
  at(time) {
    const t = this.arrays.time, M = this.M;
    let low = 0, high = this.N - 1;
    while (low < high) {
      const middle = (low + high + 1) >> 1;
      if (t[middle * M] <= time + 1e-9) low = middle;
      else high = middle - 1;
    }
    const j = low, first = j * M, last = first + M - 1;
    let a = first;
    while (a + 1 < last && t[a + 1] <= time) a++;
    const step = t[a + 1] - t[a];
    return { j, a, b: a + 1, u: step > 0 ? clamp((time - t[a]) / step, 0, 1) : 1 };
  }

  /** The mixed value of an array (rows, things, width) for one thing; NaN where either row has it. */
  value(name, { a, b, u }, thing, things, width) {
    const array = this.arrays[name], out = [];
    for (let c = 0; c < width; c++) {
      const i = thing * width + c;
      out.push((1 - u) * array[a * things * width + i] + u * array[b * things * width + i]);
    }
    return out;
  }

  /** The pose of a body in the plan. */
  pose(body, { a, b, u }) {
    return between(this.arrays.pose, 7 * (a * this.bodies + body), 7 * (b * this.bodies + body), u);
  }

  /** Rows of the execution around a time. */
  record(time) {
    const t = this.arrays.run_time;
    let low = 0, high = t.length - 1;
    while (low < high) {
      const middle = (low + high + 1) >> 1;
      if (t[middle] <= time) low = middle;
      else high = middle - 1;
    }
    const b = Math.min(low + 1, t.length - 1), step = t[b] - t[low];
    return { a: low, b, u: step > 0 ? clamp((time - t[low]) / step, 0, 1) : 0 };
  }

  /** The pose of a body in the execution. */
  real(body, { a, b, u }) {
    return between(this.arrays.run_pose, 7 * (a * this.bodies + body), 7 * (b * this.bodies + body), u);
  }

  motion(j, i) {
    return this.arrays.V[j * this.k + i];
  }

  saying(code) {
    return this.motions[code].replace(/([+-])(.)$/, (_, sign, axis) => ` ${sign === "-" ? "−" : "+"}${axis}`);
  }

  /** What is wrong, with the time at which it is, null where it has none. */
  violations() {
    const findings = this.certificate ? this.certificate.findings : [];
    return findings
      .filter((finding) => !finding.passed)
      .map((finding) => ({
        ...finding,
        at: finding.time !== null ? finding.time - this.begin : finding.interval !== null ? this.begins(finding.interval) : null,
      }));
  }
}
