// <gimbal-tree>: the platform's bodies in 3-D, turning with a simulated run. Its data are those of the Bokeh model "tree".
import { AmbientLight, DirectionalLight, HemisphereLight, LineBasicMaterial, LineLoop, BufferGeometry, Quaternion, Scene, Vector3, WebGLRenderer } from "./three.module.min.js";
import { Bodies } from "./bodies.js";
import { Orbit } from "./orbit.js";
import { Run, rotationOf, round125 } from "./run.js";

const SPEEDS = [0.001, 0.002, 0.005, 0.01, 0.02, 0.05, 0.1, 0.2, 0.5, 1, 2, 5, 10];
// Ends of what the largest factor of the angles can be; the largest angle of a run at first, rad.
const LEAST = 100, MOST = 1e5, SEEN = 0.35;
// Half turns a second at which the fastest rotor is shown, and seconds that a run is shown for at first.
const SHOWN_SPIN = Math.PI, SHOWN_TIME = 8;
// Height of the view, pixels, from which bodies have their names.
const NAMED = 150;
// Radians that a platform may turn before the view makes room for it, and between two poses in which it is looked at;
// the least and the largest number of these.
const STILL = 0.02, TURN = 0.1, POSES = 24, MANY = 240;
const STYLE = `
:host { position: absolute; inset: 0; display: grid; grid-template-rows: minmax(0, 1fr) auto auto; font: 12px/1.35 system-ui, "Segoe UI", "Noto Sans", "Liberation Sans", Arial, sans-serif; font-variant-numeric: tabular-nums; color: var(--ink, #1b2430); }
.stage { position: relative; min-height: 0; overflow: hidden; }
canvas { position: absolute; inset: 0; width: 100%; height: 100%; display: block; touch-action: none; cursor: grab; border-radius: 3px; }
canvas:active { cursor: grabbing; }
canvas:focus { outline: none; }
canvas:focus-visible { outline: 2px solid var(--accent, #0b5c8f); outline-offset: -2px; }
.names span { position: absolute; left: 0; top: 0; padding: 0 3px; white-space: nowrap; pointer-events: none; border-radius: 2px; background: color-mix(in srgb, var(--page, #fff) 72%, transparent); }
.names .rotor { color: var(--muted, #5c6675); }
.names .root { color: var(--muted, #5c6675); background: none; }
.note { padding: 2px 8px 0; min-height: 17px; color: var(--muted, #5c6675); font-size: 11.5px; overflow: hidden; white-space: nowrap; text-overflow: ellipsis; }
.none { position: absolute; inset: 0; display: grid; place-content: center; padding: 24px; text-align: center; color: var(--muted, #5c6675); }
.bar { display: flex; min-width: 0; overflow: hidden; align-items: center; gap: 9px; padding: 5px 8px 3px; white-space: nowrap; color: var(--muted, #5c6675); }
.bar[inert] { display: none; }
button { display: inline-grid; place-items: center; width: 26px; height: 24px; padding: 0; color: var(--ink, #1b2430); background: var(--page, #fff); border: 1px solid var(--line, #dde1e7); border-radius: 4px; cursor: pointer; }
button svg { width: 11px; height: 11px; fill: currentColor; }
button:hover { border-color: var(--frame, #b9c0ca); background: var(--panel, #f6f7f9); }
label { display: inline-flex; align-items: center; gap: 5px; }
.time { flex: 1 1 60px; min-width: 0; }
.time input { flex: 1; min-width: 30px; width: 30px; }
.factor input { width: 66px; }
output { color: var(--ink, #1b2430); }
.time output { min-width: 50px; text-align: right; } .factor output { min-width: 32px; }
input[type="range"] { margin: 0; height: 16px; accent-color: var(--accent, #0b5c8f); }
input[type="checkbox"] { width: 13px; height: 13px; margin: 0; accent-color: var(--accent, #0b5c8f); }
select { height: 24px; font: inherit; color: var(--ink, #1b2430); background: var(--page, #fff); border: 1px solid var(--line, #dde1e7); border-radius: 4px; }
:focus-visible { outline: 2px solid var(--accent, #0b5c8f); outline-offset: 1px; }
@container (max-width: 640px) { .long { display: none; } }
@container (max-width: 480px) { .bar { gap: 6px; padding-bottom: 0; } .word, .platform { display: none; } .time { gap: 3px; } .factor { gap: 3px; } .factor input { width: 48px; } .time output { min-width: 46px; } .names { font-size: 10.5px; } .names.many .rotor { display: none; } }
:host { container-type: size; }
`;
const BODY = `
<div class="stage">
  <canvas tabindex="0" role="img" aria-label="Gimbal tree in 3-D: arrow keys go round it, + and − nearer and farther, Home back, Space plays"></canvas>
  <div class="names" aria-hidden="true"></div>
</div>
<div class="note"></div>
<div class="bar" role="group" aria-label="The run in 3-D">
  <button type="button" aria-label="Play" title="Play or pause (Space)"><svg viewBox="0 0 10 10" aria-hidden="true"><path/></svg></button>
  <label class="time"><span class="long">t</span><input type="range" min="0" max="1" step="any" value="0" aria-label="Time"><output>0 s</output></label>
  <label title="Seconds of the run in a second of yours"><span class="word">time</span> <select aria-label="Time is shown times"></select></label>
  <label class="factor" title="Angles are milliradians: this many times as large they can be seen"><span class="word">angles</span> <input type="range" min="0" max="2" step="0.01" value="0" aria-label="Angles are shown times"><output>× 1</output></label>
  <label class="platform" title="The platform’s own angles as many times too"><input type="checkbox" aria-label="Platform’s angles too"><span>platform<span class="long"> too</span></span></label>
</div>`;
const PLAY = "M1.500 0.500v9l8-4.500z", PAUSE = "M1 0.500h3v9h-3z M6 0.500h3v9h-3z";

class GimbalTree extends HTMLElement {
  connectedCallback() {
    this.model = null;
    this.time = 0;
    this.playing = false;
    this.factor = 1;
    this.speed = 1;
    this.ending = new AbortController();
    const shadow = this.shadowRoot ?? this.attachShadow({ mode: "open" });
    shadow.innerHTML = `<style>${STYLE}</style>${BODY}`;
    const one = (query) => shadow.querySelector(query);
    this.stage = one(".stage");
    this.canvas = one("canvas");
    this.note = one(".note");
    this.bar = one(".bar");
    this.controls = {
      play: one("button"), icon: one("button path"), time: one(".time input"), shown: one(".time output"), speed: one("select"),
      factor: one(".factor input"), times: one(".factor output"), platform: one(".platform input"),
    };
    for (const speed of SPEEDS) this.controls.speed.add(new Option(`× ${speed}`, speed));
    try {
      this.renderer = new WebGLRenderer({ canvas: this.canvas, antialias: true, alpha: true, powerPreference: "low-power" });
    } catch {
      this.without();
      return;
    }
    this.scene = new Scene();
    this.sky = new HemisphereLight("#ffffff", "#8a93a0", 1.6);
    this.sun = new DirectionalLight("#ffffff", 2.2);
    this.scene.add(this.sky, new AmbientLight("#ffffff", 0.5));
    this.orbit = new Orbit(this.canvas, () => this.refresh());
    this.orbit.camera.add(this.sun);
    this.sun.position.set(-3, 5, 4);
    this.scene.add(this.orbit.camera);
    this.listen();
    this.find();
  }

  disconnectedCallback() {
    this.ending?.abort();
    cancelAnimationFrame(this.frame);
    clearTimeout(this.looking);
    this.sizes?.disconnect();
    this.themes?.disconnect();
    this.forget();
    this.bodies?.dispose();
    this.ring?.geometry.dispose();
    this.ring?.material.dispose();
    this.renderer?.dispose();
    this.renderer?.forceContextLoss();
    this.bodies = this.renderer = this.run = null;
  }

  // A line in the place of the picture.
  without() {
    const line = document.createElement("p");
    line.className = "none";
    line.textContent = "This browser has no WebGL here: the gimbal tree cannot be drawn. All the rest of the page works without it.";
    this.stage.replaceChildren(line);
    this.bar.remove();
    this.note.remove();
  }

  listen() {
    const { signal } = this.ending, c = this.controls;
    c.play.addEventListener("click", () => this.play(!this.playing), { signal });
    c.time.addEventListener("input", () => { this.play(false); this.seek(Number(c.time.value)); }, { signal });
    c.speed.addEventListener("change", () => { this.speed = Number(c.speed.value); this.refresh(); }, { signal });
    c.factor.addEventListener("input", () => this.magnify(10 ** Number(c.factor.value)), { signal });
    c.platform.addEventListener("change", () => this.enclose(), { signal });
    this.canvas.addEventListener("keydown", (event) => this.key(event), { signal });
    this.canvas.addEventListener("webglcontextrestored", () => this.refresh(), { signal });
    matchMedia("(prefers-color-scheme: dark)").addEventListener("change", () => this.paint(), { signal });
    this.sizes = new ResizeObserver(() => this.fit());
    this.sizes.observe(this.stage);
    this.themes = new MutationObserver(() => this.paint());
    this.themes.observe(document.documentElement, { attributes: true, attributeFilter: ["data-theme", "class"] });
  }

  // The Bokeh model is there before its view is; should it not be, soon.
  find() {
    for (const made of window.Bokeh?.documents ?? []) this.model ??= made.get_model_by_name("tree");
    if (!this.model) {
      this.looking = setTimeout(() => this.find(), 50);
      return;
    }
    [this.source] = this.model.tags;
    this.staged = () => this.restage();
    this.ran = () => this.showRun();
    this.model.properties.tags.change.connect(this.staged);
    this.source.properties.data.change.connect(this.ran);
    this.restage();
  }

  forget() {
    this.model?.properties.tags.change.disconnect(this.staged);
    this.source?.properties.data.change.disconnect(this.ran);
    this.model = this.source = null;
  }

  restage() {
    const data = JSON.parse(this.model.tags[1]);
    this.bodies?.dispose();
    this.bodies = new Bodies(data);
    this.scene.add(this.bodies.root);
    this.fastest = Math.max(0, ...data.nodes.map((node) => Math.abs(node.spin)));
    const names = this.shadowRoot.querySelector(".names");
    this.names = data.nodes.map((node) => {
      const name = document.createElement("span");
      name.className = node.kind;
      name.textContent = node.label;
      return name;
    });
    this.thirds = [1, 2, 3].map((k) => Object.assign(document.createElement("span"), { className: "root", textContent: String(k) }));
    names.classList.toggle("many", data.nodes.length > 6);
    names.replaceChildren(...this.names, ...this.thirds);
    this.points = this.bodies.points();
    this.orbit.stage(data.camera, data.centre, data.reach, this.points);
    this.horizon(data);
    this.paint();
    this.showRun();
  }

  // A ring that stays where the platform was at the start: against it its own turn is seen.
  horizon(data) {
    this.ring?.removeFromParent();
    this.ring?.geometry.dispose();
    const plate = data.nodes[0].pieces.find((piece) => piece.looks === "plate");
    const [low, top] = plate.points.map((point) => new Vector3(...point));
    const up = top.clone().sub(low).normalize(), points = [];
    const aside = new Vector3(...data.camera[0]).projectOnPlane(up).normalize(), ahead = new Vector3().crossVectors(up, aside);
    for (let k = 0; k < 96; k += 1) {
      const angle = (2 * Math.PI * k) / 96, r = plate.radius + 0.35;
      points.push(low.clone().addScaledVector(aside, r * Math.cos(angle)).addScaledVector(ahead, r * Math.sin(angle)));
    }
    this.ring = new LineLoop(new BufferGeometry().setFromPoints(points), this.ring?.material ?? new LineBasicMaterial());
    this.scene.add(this.ring);
  }

  showRun() {
    const c = this.controls;
    this.run = new Run(this.source, this.bodies.nodes);
    this.play(false);
    this.bar.inert = !this.run.there;
    if (this.run.there) {
      c.time.min = this.run.start;
      c.time.max = this.run.end;
      const lasting = (this.run.end - this.run.start) / SHOWN_TIME;
      this.speed = SPEEDS.reduce((best, one) => (Math.abs(Math.log(one / lasting)) < Math.abs(Math.log(best / lasting)) ? one : best));
      c.speed.value = this.speed;
      const largest = this.run.largestAngle();
      const wanted = largest > 0 ? Math.min(Math.max(round125(SEEN / largest), 1), MOST) : 1;
      c.factor.max = Math.log10(Math.max(LEAST, wanted));
      this.farthest = this.run.largestTurn();
      c.platform.checked = this.farthest * Number(wanted.toPrecision(2)) < 1.2;
      this.magnify(wanted);
    } else this.enclose();
    this.seek(this.run.start);
    if (this.run.there && !matchMedia("(prefers-reduced-motion: reduce)").matches) this.play(true);
  }

  magnify(factor) {
    this.factor = Number(factor.toPrecision(2));
    this.controls.factor.value = Math.log10(this.factor);
    this.controls.times.value = `× ${this.factor}`;
    this.enclose();
  }

  // A platform that turns in the run stays in view. Its gimbals do not leave the frames that it carries them in.
  enclose() {
    const turned = this.run.there ? this.farthest * this.platformFactor : 0;
    if (turned < STILL) {
      this.orbit.enclose(this.points);
      return;
    }
    const poses = Math.min(Math.max(Math.ceil(turned / TURN), POSES), MANY), seen = [...this.points];
    for (let k = 1; k <= poses; k += 1) {
      const time = this.run.start + ((this.run.end - this.run.start) * k) / poses;
      const pose = rotationOf(this.run.turn(time).multiplyScalar(this.platformFactor));
      for (const point of this.points) seen.push(point.clone().applyQuaternion(pose));
    }
    this.orbit.enclose(seen);
  }

  play(on) {
    this.playing = on && this.run.there;
    if (this.playing && this.time >= this.run.end) this.time = this.run.start;
    this.before = null;
    this.controls.icon.setAttribute("d", this.playing ? PAUSE : PLAY);
    this.controls.play.setAttribute("aria-label", this.playing ? "Pause" : "Play");
    this.refresh();
  }

  seek(time) {
    this.time = Math.min(Math.max(time, this.run.start), this.run.end);
    this.refresh();
  }

  key(event) {
    if (event.ctrlKey || event.metaKey || event.altKey) return;
    const steps = { ",": -1, ".": 1 };
    if (event.key === " ") this.play(!this.playing);
    else if (event.key in steps) { this.play(false); this.seek(this.time + (steps[event.key] * (this.run.end - this.run.start)) / 200); }
    else if (!this.orbit.key(event.key)) return;
    event.preventDefault();
    event.stopPropagation();
  }

  get dark() {
    const { theme } = document.documentElement.dataset;
    return theme ? theme === "dark" : matchMedia("(prefers-color-scheme: dark)").matches;
  }

  paint() {
    this.bodies?.paint(this.dark ? "dark" : "light");
    this.ring?.material.color.set(this.dark ? "#4a5361" : "#b9c0ca");
    this.refresh();
  }

  fit() {
    const { clientWidth: width, clientHeight: height } = this.stage;
    if (!width || !height) return;
    this.renderer.setPixelRatio(Math.min(devicePixelRatio, 2));
    this.renderer.setSize(width, height, false);
    this.orbit.fit(width, height);
  }

  // Nothing is drawn unless something changed.
  refresh() {
    if (this.bodies && !this.frame) this.frame = requestAnimationFrame((now) => this.step(now));
  }

  step(now) {
    this.frame = 0;
    if (!this.renderer || !this.run) return;
    if (this.playing) {
      if (this.before !== null) this.time += (Math.min(now - this.before, 100) / 1000) * this.speed;
      this.before = now;
      if (this.time >= this.run.end) { this.time = this.run.end; this.play(false); } else this.refresh();
    }
    this.pose();
    this.say();
    this.renderer.render(this.scene, this.orbit.camera);
    this.label();
  }

  // Spin is shown so many times slower that a turn can be followed.
  get slower() { return this.fastest > 0 ? Math.max(1, round125((this.fastest * this.speed) / SHOWN_SPIN)) : 1; }
  get platformFactor() { return this.controls.platform.checked ? this.factor : 1; }

  pose() {
    const angles = this.run.angles(this.time).map((angle) => angle * this.factor);
    const rotors = this.bodies.nodes.filter((node) => node.kind === "rotor");
    this.turned = [...angles, ...rotors.map((node) => this.run.turnedBy(node, this.time) / this.slower)];
    this.bodies.turn(this.turned);
    rotationOf(this.run.turn(this.time).multiplyScalar(this.platformFactor), this.bodies.root.quaternion);
    this.bodies.root.updateMatrixWorld(true);
  }

  say() {
    const c = this.controls;
    c.time.value = this.time;
    c.shown.value = `${this.time.toFixed(Math.min(4, Math.max(0, 3 - Math.floor(Math.log10(Math.max(this.run.end, 1e-3))))))} s`;
    const angles = this.factor === 1 ? "angles as they are" : `angles × ${this.factor} (platform’s × ${this.platformFactor})`;
    const spin = this.fastest === 0 ? "" : this.slower === 1 ? "spin as it is" : `spin ${this.slower} times slower`;
    const words = this.run.there ? [angles, spin].filter(Boolean).join(", ") : "Simulate a manoeuvre to see it turn";
    if (this.note.textContent !== words) this.note.textContent = words;
  }

  label() {
    const { clientWidth: width, clientHeight: height } = this.stage, place = new Vector3(), taken = [];
    const put = (name, group, point, shift) => {
      place.set(...point);
      group.localToWorld(place);
      place.project(this.orbit.camera);
      const box = [name.offsetWidth, name.offsetHeight];
      if (!box[0]) return;
      const x = Math.min(Math.max((0.5 + 0.5 * place.x) * width + shift - box[0] / 2, 2), width - box[0] - 2);
      let y = (0.5 - 0.5 * place.y) * height - box[1] / 2;
      const over = () => taken.find(([ax, ay, aw]) => Math.abs(ay - y) < box[1] - 3 && x < ax + aw && ax < x + box[0]);
      for (let other = over(); other; other = over()) y = other[1] + box[1] - 2;
      taken.push([x, y, box[0]]);
      name.style.transform = `translate(${x.toFixed(1)}px, ${y.toFixed(1)}px)`;
    };
    // In a thumbnail names would hide the bodies.
    const named = height >= NAMED;
    for (const name of this.names) if (name.hidden === named) name.hidden = !named;
    this.names.forEach((name, k) => put(name, this.bodies.groups[k], this.bodies.nodes[k].tip, 0));
    const arrows = this.bodies.nodes[0].pieces.filter((piece) => piece.looks.startsWith("axis "));
    arrows.forEach((piece, k) => put(this.thirds[k], this.bodies.root, piece.points[1].map((x) => 1.03 * x), 0));
  }

  // How far from the middle of the view anything is, its edges being at 1.
  outermost() {
    return this.bodies.points().reduce((most, point) => {
      const { x, y } = point.project(this.orbit.camera);
      return Math.max(most, Math.abs(x), Math.abs(y));
    }, 0);
  }

  // What is shown, in numbers.
  state() {
    this.pose();
    const elements = (group) => {
      const turn = group.getWorldQuaternion(new Quaternion());
      return [turn.w, turn.x, turn.y, turn.z];
    };
    return {
      time: this.time, start: this.run.start, end: this.run.end, playing: this.playing, speed: this.speed, factor: this.factor,
      platformFactor: this.platformFactor, slower: this.slower, turned: this.turned,
      rotations: Object.fromEntries(this.bodies.nodes.map((node, k) => [node.name, elements(this.bodies.groups[k])])),
      places: Object.fromEntries(this.bodies.nodes.map((node, k) => [node.name, this.bodies.groups[k].getWorldPosition(new Vector3()).toArray()])),
      held: { ...this.renderer.info.memory }, dark: this.dark, azimuth: this.orbit.azimuth, outermost: this.outermost(), elevation: this.orbit.elevation, zoom: this.orbit.zoom,
    };
  }
}

customElements.define("gimbal-tree", GimbalTree);
