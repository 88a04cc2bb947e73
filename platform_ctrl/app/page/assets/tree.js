// The gimbal tree: lines in space drawn as one SVG, which turns with a simulated run.
import { byId, on } from "./messages.js";

// Duration of a shown run, s; its largest drawn angle, rad; size of the labels, pixels.
const SHOWN = 8, SEEN = 0.35, TEXT = 11;
// Places of a label about its own, in widths to the right and heights down.
const BESIDE = [[0, 0], [0, -0.8], [0, 0.8], [0.6, 0], [-0.6, 0], [0.6, -0.8], [-0.6, 0.8], [0, -1.6], [0, 1.6]];
const panel = byId("panel-tree"), svg = panel.querySelector(".plot svg"), scene = JSON.parse(panel.dataset.scene);
const [play, slider, time, note] = [".play", ".controls input", ".controls output", ".note"].map((one) => panel.querySelector(one));

const drawn = (tag, attributes, text = "") => {
  const element = document.createElementNS("http://www.w3.org/2000/svg", tag);
  for (const [name, value] of Object.entries(attributes)) element.setAttribute(name, value);
  element.textContent = text;
  svg.append(element);
  return element;
};
const paths = scene.shapes.map(({ kind, series }) => drawn("path", { class: kind, ...(series && { style: `stroke: var(--series-${series})` }) }));
const texts = scene.labels.map(({ text }) => drawn("text", {}, text));

const dot = (a, b) => a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
// About a unit vector through the origin, by Rodrigues.
const turned = (v, [x, y, z], angle) => {
  const c = Math.cos(angle), s = Math.sin(angle), d = (1 - c) * dot(v, [x, y, z]);
  return [c * v[0] + s * (y * v[2] - z * v[1]) + d * x, c * v[1] + s * (z * v[0] - x * v[2]) + d * y, c * v[2] + s * (x * v[1] - y * v[0]) + d * z];
};
const placed = (point, body, angles, turn) => {
  let at = point;
  for (let k = body; k >= 0; k = scene.bodies[k].parent) {
    const { pivot, axis } = scene.bodies[k];
    at = turned(at.map((x, i) => x - pivot[i]), axis, angles[k] ?? 0).map((x, i) => x + pivot[i]);
  }
  const size = Math.hypot(...turn);
  if (size > 0) at = turned(at, turn.map((x) => x / size), size);
  return [dot(scene.rows[0], at), -dot(scene.rows[1], at)];
};
const pose = (angles = [], turn = [0, 0, 0]) => {
  for (const [k, { body, points }] of scene.shapes.entries()) {
    const line = points.map((point) => placed(point, body, angles, turn).map((x) => x.toFixed(3)).join(" "));
    paths[k].setAttribute("d", `M${line.join("L")}${line.length > 1 ? "" : "h0"}`);
  }
  // A label is at the tip of its arrow, or beside it where another label is.
  const size = parseFloat(svg.style.fontSize) || 0, taken = [];
  for (const [k, { body, at, text }] of scene.labels.entries()) {
    const [x, y] = placed(at, body, angles, turn), width = 0.62 * size * text.length;
    const free = ([right, down]) => taken.every(([a, b, w]) => Math.abs(x + right * width - a) >= 0.5 * (width + w) || Math.abs(y + down * size - b) >= size);
    const [right, down] = BESIDE.find(free) ?? BESIDE[0];
    taken.push([x + right * width, y + down * size, width]);
    texts[k].setAttribute("x", x + right * width);
    texts[k].setAttribute("y", y + down * size);
  }
};

pose();
const all = scene.shapes.flatMap(({ body, points }) => points.map((point) => placed(point, body, [], [0, 0, 0])));
const [xs, ys] = [0, 1].map((k) => all.map((point) => point[k])), [left, top] = [Math.min(...xs) - 0.6, Math.min(...ys) - 0.6];
svg.setAttribute("viewBox", [left, top, Math.max(...xs) + 0.6 - left, Math.max(...ys) + 0.6 - top].join(" "));
new ResizeObserver(() => {
  const scale = svg.getScreenCTM()?.a;
  if (!scale) return;
  svg.style.fontSize = `${TEXT / scale}px`;
  if (run) show();
  else pose();
}).observe(svg);

let run = null, factor = 1, playing = false, before = 0, now = 0;
const between = (columns, k, share) => columns[k].map((x, j) => x + share * ((columns[k + 1] ?? columns[k])[j] - x));
const show = () => {
  const { t } = run, k = Math.max(0, t.findLastIndex((one) => one <= now));
  const share = k + 1 < t.length ? (now - t[k]) / (t[k + 1] - t[k]) : 0;
  pose(between(run.angles, k, share).map((angle) => angle * factor), between(run.turns, k, share));
  slider.value = now;
  time.value = `${now.toPrecision(3)} s`;
};
const start = (on) => {
  playing = on;
  play.textContent = on ? "Pause" : "Play";
  before = performance.now();
  if (on) requestAnimationFrame(step);
};
const step = (stamp) => {
  if (!playing) return;
  now += (Math.max(0, stamp - before) / 1000) * run.t.at(-1) / SHOWN;
  before = stamp;
  if (now >= run.t.at(-1)) {
    now = run.t.at(-1);
    start(false);
  } else requestAnimationFrame(step);
  show();
};
play.addEventListener("click", () => {
  if (!playing && now >= run.t.at(-1)) now = 0;
  start(!playing);
});
slider.addEventListener("input", () => {
  start(false);
  now = Number(slider.value);
  show();
});
on("run", (given) => {
  run = given;
  const largest = Math.max(1e-9, ...run.angles.flat().map(Math.abs));
  factor = Math.max(1, Number((SEEN / largest).toPrecision(1)));
  note.textContent = factor > 1 ? `angles × ${factor}` : "";
  slider.max = run.t.at(-1);
  panel.classList.add("ran");
  now = 0;
  show();
  start(!matchMedia("(prefers-reduced-motion: reduce)").matches);
});
