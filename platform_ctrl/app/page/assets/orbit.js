// The viewer: goes round the platform by mouse, fingers and keys, and comes nearer.
import { Matrix4, PerspectiveCamera, Quaternion, Vector3 } from "./three.module.min.js";

const FIELD = 24, STEP = Math.PI / 36, MARGIN = 1.08;
const clamp = (x, low, high) => Math.min(Math.max(x, low), high);

export class Orbit {
  constructor(canvas, changed) {
    this.camera = new PerspectiveCamera(FIELD, 1, 0.1, 500);
    this.canvas = canvas;
    this.changed = changed;
    this.fingers = new Map();
    this.frame = new Quaternion();
    this.centre = new Vector3();
    canvas.addEventListener("pointerdown", (event) => this.down(event));
    canvas.addEventListener("pointermove", (event) => this.move(event));
    for (const end of ["pointerup", "pointercancel"]) canvas.addEventListener(end, (event) => this.fingers.delete(event.pointerId));
    canvas.addEventListener("wheel", (event) => this.wheel(event), { passive: false });
    canvas.addEventListener("dblclick", () => this.home());
  }

  // Rows: to the right, up and toward the viewer; centre and reach: middle and radius of what is seen; its points.
  stage(rows, centre, reach, points) {
    const [right, up, toward] = rows.map((row) => new Vector3(...row));
    const k = [0, 1, 2].reduce((best, one) => (Math.abs(up.getComponent(one)) > Math.abs(up.getComponent(best)) ? one : best), 0);
    const pole = new Vector3().setComponent(k, Math.sign(up.getComponent(k)));
    const aside = right.clone().addScaledVector(pole, -right.dot(pole)).normalize();
    this.frame.setFromRotationMatrix(new Matrix4().makeBasis(aside, pole, new Vector3().crossVectors(aside, pole)));
    this.start = Math.asin(clamp(toward.dot(pole), -1, 1));
    this.least = reach;
    this.middle = new Vector3(...centre);
    this.enclose(points);
    this.home();
  }

  // Has all these points in view, from where the platform is seen at first.
  enclose(points) {
    this.points = points;
    this.centre.copy(this.middle);
    for (const way of this.across()) {
      let low = Infinity, high = -Infinity;
      for (const point of points) {
        const along = point.dot(way);
        low = Math.min(low, along);
        high = Math.max(high, along);
      }
      this.centre.addScaledVector(way, 0.5 * (low + high) - this.centre.dot(way));
    }
    this.reach = points.reduce((most, point) => Math.max(most, point.distanceTo(this.centre)), this.least);
    this.away = this.distance();
    this.place();
  }

  home() {
    this.azimuth = 0;
    this.elevation = this.start ?? 0.5;
    this.zoom = 1;
    this.place();
  }

  fit(width, height) {
    this.camera.aspect = width / height;
    this.away = this.distance();
    this.place();
  }

  place() {
    const distance = this.away / this.zoom;
    this.camera.position.copy(this.toward(this.azimuth, this.elevation)).multiplyScalar(distance);
    this.camera.up.set(0, 1, 0).applyQuaternion(this.frame);
    this.camera.near = Math.max(0.05, distance - 2 * this.reach);
    this.camera.far = distance + 4 * this.reach;
    this.camera.position.add(this.centre);
    this.camera.lookAt(this.centre);
    this.camera.updateProjectionMatrix();
    this.camera.updateMatrixWorld();
    this.changed();
  }

  toward(azimuth, elevation) {
    const ce = Math.cos(elevation);
    return new Vector3(ce * Math.sin(azimuth), Math.sin(elevation), ce * Math.cos(azimuth)).applyQuaternion(this.frame);
  }

  // Right and up as the platform is seen at first, and the way to the viewer.
  across(all = false) {
    const toward = this.toward(0, this.start ?? 0.5), pole = new Vector3(0, 1, 0).applyQuaternion(this.frame);
    const right = new Vector3().crossVectors(pole, toward).normalize();
    return [right, new Vector3().crossVectors(toward, right), ...(all ? [toward] : [])];
  }

  // From where everything is just seen.
  distance() {
    const [right, up, toward] = this.across(true);
    const high = Math.tan((FIELD * Math.PI) / 360), wide = high * this.camera.aspect;
    let distance = 1;
    for (const point of this.points ?? []) {
      const from = point.clone().sub(this.centre), near = from.dot(toward);
      distance = Math.max(distance, near + Math.abs(from.dot(right)) / wide, near + Math.abs(from.dot(up)) / high);
    }
    return MARGIN * distance;
  }

  turn(azimuth, elevation) {
    this.azimuth += azimuth;
    this.elevation = clamp(this.elevation + elevation, -1.5, 1.5);
    this.place();
  }

  scale(factor) {
    this.zoom = clamp(this.zoom * factor, 0.3, 8);
    this.place();
  }

  down(event) {
    this.canvas.setPointerCapture(event.pointerId);
    this.fingers.set(event.pointerId, [event.clientX, event.clientY]);
  }

  move(event) {
    const before = this.fingers.get(event.pointerId);
    if (!before) return;
    const spread = () => {
      const [[ax, ay], [bx, by]] = [...this.fingers.values()];
      return Math.hypot(ax - bx, ay - by);
    };
    const apart = this.fingers.size === 2 ? spread() : 0;
    this.fingers.set(event.pointerId, [event.clientX, event.clientY]);
    if (this.fingers.size === 2) this.scale(spread() / Math.max(apart, 1));
    else this.turn(-0.008 * (event.clientX - before[0]), 0.008 * (event.clientY - before[1]));
  }

  wheel(event) {
    event.preventDefault();
    this.scale(Math.exp(-0.0015 * clamp(event.deltaY, -200, 200)));
  }

  // Whether the key was one of the viewer's.
  key(key) {
    const turns = { ArrowLeft: [-STEP, 0], ArrowRight: [STEP, 0], ArrowUp: [0, STEP], ArrowDown: [0, -STEP] };
    if (key in turns) this.turn(...turns[key]);
    else if (key === "+" || key === "=") this.scale(1.15);
    else if (key === "-") this.scale(1 / 1.15);
    else if (key === "Home" || key === "0") this.home();
    else return false;
    return true;
  }
}
