// The page: transport, the matrix V, findings, layers, keys; one story at a time, one clock.

const $ = (id) => document.getElementById(id);
const SPEEDS = [0.1, 0.25, 0.5, 1, 2, 4, 8];
const LAYERS = {
  forces: ["forces", true], cones: ["friction cones", false], frames: ["contact frames", true], paths: ["contact paths", true],
  goal: ["goal", true], route: ["subgoals", false], lines: ["body axes", true], labels: ["labels", true], shells: ["planning shapes", false],
};

class Page {
  constructor() {
    this.painter = new Painter($("canvas"));
    this.stage = new Stage(this.painter);
    this.orbit = new Orbit($("canvas"), () => (this.dirty = true));
    this.layers = Object.fromEntries(Object.entries(LAYERS).map(([name, [, on]]) => [name, on]));
    this.time = 0;
    this.speed = 1;
    this.playing = false;
    this.rough = false;
    /** ms without a change after which a rough picture becomes a good one. */
    this.patience = 250;
    this.controls();
    new ResizeObserver(() => this.resize()).observe($("view"));
    requestAnimationFrame((now) => this.tick(now));
  }

  controls() {
    $("play").onclick = () => this.play(!this.playing);
    $("back").onclick = () => this.step(-1);
    $("forth").onclick = () => this.step(1);
    $("speed").innerHTML = SPEEDS.map((speed) => `<option value="${speed}"${speed === 1 ? " selected" : ""}>${speed}×</option>`).join("");
    $("speed").onchange = () => (this.speed = +$("speed").value);
    $("reset").onclick = () => this.fit();
    for (const element of document.querySelectorAll("button, select")) element.addEventListener("change", () => element.blur());
    for (const element of document.querySelectorAll("button")) element.addEventListener("click", () => element.blur());
    $("layers").innerHTML = Object.entries(LAYERS)
      .map(([name, [words, on]]) => `<label id="layer-${name}"><input type="checkbox" name="${name}"${on ? " checked" : ""}>${words}</label>`).join("");
    $("layers").onchange = ({ target }) => {
      this.layers[target.name] = target.checked;
      this.dirty = true;
      target.blur();
    };
    const scrub = (event) => {
      const { left, width } = $("cells").getBoundingClientRect();
      this.seek(this.timeAt(clamp((event.clientX - left) / width, 0, 1) * this.story.N));
    };
    $("track").onpointerdown = (event) => {
      $("track").setPointerCapture(event.pointerId);
      scrub(event);
    };
    $("track").onpointermove = (event) => event.buttons && scrub(event);
    $("cells").onclick = ({ target }) => {
      if (target.dataset.j === undefined) return;
      this.choose(+target.dataset.j, target.dataset.i === undefined ? null : +target.dataset.i);
    };
    $("names").onclick = ({ target }) => {
      const row = target.closest("[data-i]");
      if (row) this.select(+row.dataset.i);
    };
    $("findings").onclick = ({ target }) => {
      const row = target.closest("[data-at]");
      if (row) this.seek(+row.dataset.at);
    };
    addEventListener("keydown", (event) => this.key(event));
  }

  key(event) {
    if (event.ctrlKey || event.metaKey || event.altKey || event.target.tagName === "SELECT") return;
    const keys = {
      " ": () => this.play(!this.playing),
      ArrowLeft: () => this.step(-1, event.shiftKey), ArrowRight: () => this.step(1, event.shiftKey),
      ArrowUp: () => this.hurry(1), ArrowDown: () => this.hurry(-1),
      Home: () => this.seek(0), End: () => this.seek(this.story.end), f: () => this.fit(),
    };
    if (!keys[event.key]) return;
    event.preventDefault();
    keys[event.key]();
  }

  hurry(by) {
    this.speed = SPEEDS[clamp(SPEEDS.indexOf(this.speed) + by, 0, SPEEDS.length - 1)];
    $("speed").value = this.speed;
  }

  /** Take another story; the first one also sets the camera. */
  show(story) {
    const first = !this.story;
    this.story = story;
    this.stage.show(story);
    this.time = Math.min(this.time, story.span);
    for (const [name, colour] of Object.entries(story.colours)) document.documentElement.style.setProperty(`--${name}`, colour);
    document.title = `${story.name} · regrasp`;
    $("name").textContent = story.name;
    $("words").textContent = story.words;
    $("remarks").innerHTML = story.remarks.map((remark) => `<li>${escaped(remark)}</li>`).join("");
    $("layer-shells").hidden = !story.shapes.some((shape) => shape.shell);
    $("legend").innerHTML = this.legend();
    $("labels").replaceChildren(...story.agents.map((agent) => {
      const label = document.createElement("div");
      label.className = "label";
      label.style.setProperty("--own", agent.colour);
      return label;
    }));
    this.grid();
    this.charts = new Charts($("charts"), story, (time) => this.seek(time));
    this.selected = Math.min(this.selected ?? 0, story.k - 1);
    this.resize();
    this.judge(story.certificate);
    if (first) this.fit();
    this.seek(this.time);
    if (story.draft && story.N > 1) this.play(true);
  }

  legend() {
    const entries = [["force", this.story.colours.force, "force of an agent"]];
    if (this.story.P) entries.push(["force", this.story.colours.support, "force of a support"]);
    if (this.story.run) entries.push(["force", "#4D4D4D", "planned force"], ["ghost", "#4D4D4D", "planned object"]);
    entries.push(["ghost", "#4A6FA5", "goal"]);
    return entries.map(([kind, colour, words]) => `<span class="${kind}" style="--own:${colour}">${words}</span>`).join("");
  }

  /** The matrix V: agents in rows, intervals in columns, supports below. */
  grid() {
    const { story } = this, rows = [...story.agents.map((agent) => agent.name), ...story.supports];
    $("names").innerHTML = rows.map((name, i) => i < story.k
      ? `<div data-i="${i}" title="show its joints"><i style="background:${story.agents[i].colour}"></i>${escaped(name)}</div>`
      : `<div><i class="support"></i>${escaped(name)}</div>`).join("");
    $("cells").style.gridTemplateColumns = `repeat(${story.N}, minmax(5px, 1fr))`;
    const cells = [], wide = $("cells").clientWidth / story.N > 15;
    rows.forEach((name, i) => {
      for (let j = 0; j < story.N; j++) {
        if (i < story.k) {
          const code = story.motion(j, i), words = story.motions[code], sign = /[+-].$/.test(words) ? words.slice(-2).replace("-", "−") : "";
          cells.push(`<div class="cell ${words.split(/[+-]/)[0]}" data-j="${j}" data-i="${i}" title="${escaped(story.agents[i].name)}, interval ${j + 1}: ${story.saying(code)}">${wide ? sign : ""}</div>`);
        } else {
          const modes = story.slots.map((slot, s) => slot.name === name ? story.arrays.support_mode[j * story.P + s] : 0), mode = Math.max(...modes);
          cells.push(`<div class="cell ${["bare", "stick", "slip"][mode]}" data-j="${j}" title="${escaped(name)}, interval ${j + 1}: ${["no contact", "sticks", "slides"][mode]}"></div>`);
        }
      }
    });
    $("cells").innerHTML = cells.join("");
  }

  /** Show the findings of `check`, or that there are none yet. */
  judge(certificate) {
    const { story } = this;
    story.certificate = certificate;
    const violations = story.violations(), verdict = $("verdict");
    verdict.className = !certificate ? "waiting" : certificate.passed ? "passed" : "refused";
    verdict.textContent = !certificate ? (story.draft ? "being planned" : "being checked…")
      : certificate.passed ? `✓ certified: ${certificate.findings.length} points measured` : `✗ refused: ${violations.length} violation${violations.length === 1 ? "" : "s"}`;
    const number = (v) => (v === null ? "not a number" : +v.toPrecision(3));
    $("findings").innerHTML = violations.map((v) => `<li ${v.at === null ? "" : `data-at="${v.at}"`}><b>${escaped(v.name)}</b> ${escaped(v.who)}
      <span>${escaped(v.text)}: ${number(v.value)} exceeds ${number(v.tolerance)} ${escaped(v.unit)}</span>
      <time>${v.at === null ? "" : `${v.at.toFixed(2)} s`}</time></li>`).join("");
    $("marks").innerHTML = violations.filter((v) => v.at !== null)
      .map((v) => `<i style="left:${(100 * this.axis(v.at)) / story.N}%" title="${escaped(v.name)}"></i>`).join("");
    this.charts.draw();
    this.charts.mark(this.time, this.segment());
  }

  /** Where a time is on the axis of intervals, 0 … N; and back. */
  axis(time) {
    const { j } = this.story.at(time), begin = this.story.begins(j), end = this.story.ends(j);
    return j + clamp(end > begin ? (time - begin) / (end - begin) : 1, 0, 1);
  }

  timeAt(place) {
    const j = Math.min(Math.floor(place), this.story.N - 1), begin = this.story.begins(j);
    return begin + (place - j) * (this.story.ends(j) - begin);
  }

  segment() {
    return this.story.arrays.segment[this.story.at(this.time).j];
  }

  choose(j, i) {
    if (i !== null) this.select(i);
    this.seek(this.story.begins(j) + 1e-6);
  }

  select(i) {
    this.selected = i;
    this.charts.choose(i);
    this.seek(this.time);
  }

  play(on) {
    if (on && this.time >= this.story.span - 1e-6) this.time = 0;
    this.playing = on;
    $("play").classList.toggle("playing", on);
    $("play").setAttribute("aria-label", on ? "pause" : "play");
  }

  /** One sample, or the begin of the next interval. */
  step(by, whole = false) {
    this.play(false);
    const { time } = this.story.arrays, { M } = this.story, { j, a, b, u } = this.story.at(this.time);
    if (whole) {
      const there = by > 0 ? j + 1 : this.time > this.story.begins(j) + 1e-4 ? j : j - 1;
      this.seek(there < this.story.N ? this.story.begins(Math.max(there, 0)) + 1e-6 : this.story.end);
    } else if (by > 0) this.seek(u > 1 - 1e-4 ? time[Math.min(b + 1, time.length - 1)] : time[b]);
    else this.seek(u > 1e-4 ? time[a] : a % M ? time[a - 1] : j ? time[a - 2] : 0);
  }

  seek(time) {
    this.time = clamp(time, 0, this.story.span);
    this.dirty = true;
  }

  fit() {
    const { clientWidth, clientHeight } = $("view");
    this.orbit.fit(this.story.view.towards, this.stage.interest(), clientWidth / clientHeight);
  }

  /** Give the canvas the pixels that it has, or half as many in a rough picture. */
  measure() {
    const { clientWidth, clientHeight } = $("view"), ratio = (devicePixelRatio || 1) * (this.rough ? 0.5 : 1);
    Object.assign($("canvas"), { width: clientWidth * ratio, height: clientHeight * ratio });
  }

  resize() {
    this.measure();
    if (!this.story) return;
    this.charts.draw();
    this.charts.mark(this.time, this.segment());
    this.dirty = true;
  }

  tick(now) {
    const passed = (now - (this.last ?? now)) / 1000;
    this.last = now;
    if (this.playing) {
      this.seek(this.time + this.speed * passed);
      // What is still being searched is shown over and over.
      if (this.time >= this.story.span) this.story.draft ? this.seek(0) : this.play(false);
    }
    // Where a processor draws, what moves is drawn roughly, and well as soon as it stands still.
    if (this.dirty && this.story) {
      this.draw(this.painter.slow);
      this.drawn = now;
    } else if (this.rough && now - this.drawn > this.patience) this.draw(false);
    requestAnimationFrame((next) => this.tick(next));
  }

  draw(rough) {
    this.dirty = false;
    if (this.rough !== rough) {
      this.rough = rough;
      this.measure();
    }
    const { story } = this, { width, height } = $("canvas");
    const camera = { ...this.orbit.matrices(width / height), pixel: (devicePixelRatio || 1) * (rough ? 0.5 : 1) };
    const picture = this.stage.picture(this.time, this.layers, camera);
    this.painter.draw(picture, rough);
    this.name(picture);
    const place = this.axis(this.time), { j } = story.at(this.time);
    $("head").style.left = $("handle").style.left = `${(100 * place) / story.N}%`;
    $("clock").textContent = `${this.time.toFixed(2)} s`;
    $("where").textContent = `interval ${j + 1} of ${story.N}`;
    $("track").setAttribute("aria-valuenow", this.time.toFixed(2));
    this.charts.mark(this.time, this.segment());
    this.now(j);
  }

  /** Where on the page a point of the world is, px. */
  place(p) {
    const { clientWidth, clientHeight } = $("view"), m = this.orbit.matrices(clientWidth / clientHeight).view;
    const w = m[3] * p[0] + m[7] * p[1] + m[11] * p[2] + m[15], [x, y] = through(m, p);
    return [(0.5 + (0.5 * x) / w) * clientWidth, (0.5 - (0.5 * y) / w) * clientHeight];
  }

  /** Labels beside the fingertips: who does what. */
  name(picture) {
    const { story } = this, { clientWidth, clientHeight } = $("view"), { j } = story.at(this.time);
    const project = (p) => this.place(p);
    const middle = project(through(picture.object, [0, 0, 0])), taken = [];
    [...$("labels").children].forEach((label, i) => {
      const tip = this.stage.shapes.find((shape) => shape.tip && shape.agent === i);
      label.hidden = !this.layers.labels || !tip;
      if (label.hidden) return;
      const at = project(through(times(picture.poses[tip.body], tip.local), [0, 0, 0]));
      const away = [at[0] - middle[0], at[1] - middle[1]], far = Math.hypot(...away) || 1;
      const code = story.motion(j, i), text = `${story.agents[i].name} · ${story.saying(code)}`;
      if (label.textContent !== text) label.textContent = text;
      label.classList.toggle("idle", story.motions[code] === "off");
      const half = [label.offsetWidth / 2, label.offsetHeight / 2];
      let x = at[0] + (away[0] / far) * (34 + half[0]), y = at[1] + (away[1] / far) * (34 + half[1]);
      for (const [ox, oy, w, h] of taken)
        if (Math.abs(x - ox) < w + half[0] && Math.abs(y - oy) < h + half[1] + 3) y = oy + (y >= oy ? 1 : -1) * (h + half[1] + 3);
      taken.push([x, y, ...half]);
      label.style.transform = `translate(${clamp(x - half[0], 4, clientWidth - 2 * half[0] - 4)}px, ${clamp(y - half[1], 4, clientHeight - 2 * half[1] - 4)}px)`;
    });
  }

  /** What every agent does now, in numbers; the selected one in a sentence. */
  now(j) {
    const { story } = this, instant = story.at(this.time), percent = (v) => (Number.isNaN(v) ? "–" : `${Math.round(100 * v)} %`);
    const rows = story.agents.map((agent, i) => {
      const force = length(story.value("force", instant, i, story.k, 3)), code = story.motion(j, i);
      const [friction, joint] = ["friction_margin", "joint_margin"].map((name) => story.value(name, instant, i, story.k, 1)[0]);
      return `<tr data-i="${i}" class="${i === this.selected ? "selected" : ""}"><td><i style="background:${agent.colour}"></i>${escaped(agent.name)}</td>
        <td>${story.saying(code)}</td><td>${force ? force.toFixed(2) : "–"}</td><td>${percent(friction)}</td><td>${percent(joint)}</td></tr>`;
    });
    $("now").innerHTML = `<table><thead><tr><th>agent</th><th>motion</th><th>N</th><th>friction</th><th>joints</th></tr></thead><tbody>${rows.join("")}</tbody></table>
      <p id="told">${this.told(j, this.selected)}</p>`;
  }

  /** What an agent does in an interval, and what it gains. */
  told(j, i) {
    const { story } = this, agent = story.agents[i], code = story.motion(j, i), name = story.motions[code];
    const first = j * story.M, last = first + story.M - 1, at = (array, row) => story.arrays[array][row * story.k + i];
    const turn = story.arrays.twist.subarray(4 * (j * story.k + i), 4 * (j * story.k + i) + 4), percent = (v) => `${Math.round(100 * v)} %`;
    const rolled = `${((Math.hypot(turn[0], turn[1]) * 180) / Math.PI).toFixed(1)}°`, slid = `${(1e3 * Math.hypot(turn[2], turn[3])).toFixed(1)} mm`;
    const still = Math.hypot(...turn) < 1e-4 && /roll|slide/.test(name);
    const doing = still ? `waits while forces are handed over (${story.saying(code)})` : { stay: "keeps its contact", relocate: "goes to another place on the object", off: "is away from the object" }[name]
      ?? (name.startsWith("roll") ? `rolls by ${rolled} (${story.saying(code)})` : `slides by ${slid} (${story.saying(code)})`);
    const room = [at("joint_margin", first), at("joint_margin", last)];
    const gained = Number.isNaN(room[0]) ? "" : `; room to its joints' limits ${percent(room[0])} → ${percent(room[1])}`;
    return `<b>${escaped(agent.name)}</b> ${doing}, ${story.begins(j).toFixed(2)}–${story.ends(j).toFixed(2)} s, segment ${story.arrays.segment[j] + 1}${gained}.`;
  }
}

/** The bytes of base64 text. */
const decoded = (text) => Uint8Array.from(atob(text), (c) => c.charCodeAt(0));

const page = new Page();
globalThis.regrasp = page;
const ready = unpacked(decoded($("story").textContent.trim())).then((story) => {
  page.show(story);
  document.body.classList.add("ready");
});
