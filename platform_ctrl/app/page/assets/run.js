// A simulated run between its samples, and the rotations that it is shown with.
import { Quaternion, Vector3 } from "./three.module.min.js";

const nothing = new Float64Array(0);

export class Run {
  constructor(source, nodes) {
    const column = (name) => source?.get_column(name) ?? nothing;
    this.t = column("t");
    this.q = nodes.filter((node) => node.kind === "gimbal").map((_, k) => column(`q ${k}`));
    this.attitude = ["w", "x", "y", "z"].map(column);
    this.turned = new Map(nodes.filter((node) => node.kind === "rotor").map((node) => [node.name, column(`turned ${node.name}`)]));
    this.length = this.t.length;
    this.start = this.length ? this.t[0] : 0;
    this.end = this.length ? this.t[this.length - 1] : 0;
    this.first = this.length ? this.attitudeOf(0) : new Quaternion();
    this.first.conjugate();
  }

  get there() { return this.length > 1; }

  // Sample before `time`, and how far it is to the next.
  at(time) {
    if (!this.there) return [0, 0];
    let low = 0, high = this.length - 1;
    while (high - low > 1) {
      const middle = (low + high) >> 1;
      if (this.t[middle] <= time) low = middle; else high = middle;
    }
    const share = (time - this.t[low]) / (this.t[high] - this.t[low]);
    return [low, Math.min(Math.max(share, 0), 1)];
  }

  angles(time) {
    const [k, share] = this.at(time);
    return this.q.map((column) => (this.length ? between(column, k, share) : 0));
  }

  attitudeOf(k) {
    const [w, x, y, z] = this.attitude.map((column) => column[k]);
    return new Quaternion(x, y, z, w).normalize();
  }

  // From the platform's axes to those it had at the start, as a rotation vector.
  turn(time) {
    if (!this.length) return new Vector3();
    const [k, share] = this.at(time);
    const now = this.attitudeOf(k);
    if (share > 0) now.slerp(this.attitudeOf(k + 1), share);
    return vectorOf(now.premultiply(this.first));
  }

  turnedBy(node, time) {
    const column = this.turned.get(node.name);
    return column?.length ? between(column, ...this.at(time)) : node.spin * (time - this.start);
  }

  largestAngle() {
    let largest = 0;
    for (const column of this.q) for (const angle of column) largest = Math.max(largest, Math.abs(angle));
    return largest;
  }

  largestTurn() {
    let largest = 0;
    for (let k = 0; k < this.length; k += Math.ceil(this.length / 500)) {
      largest = Math.max(largest, this.turn(this.t[k]).length());
    }
    return largest;
  }
}

const between = (column, k, share) => (share > 0 ? column[k] + share * (column[k + 1] - column[k]) : column[k]);

const vectorOf = (rotation) => {
  const sign = rotation.w < 0 ? -1 : 1;
  const axis = new Vector3(rotation.x, rotation.y, rotation.z).multiplyScalar(sign);
  const sine = axis.length();
  return sine > 0 ? axis.multiplyScalar((2 * Math.atan2(sine, sign * rotation.w)) / sine) : axis;
};

export const rotationOf = (vector, out = new Quaternion()) => {
  const angle = vector.length();
  return angle > 0 ? out.setFromAxisAngle(vector.clone().divideScalar(angle), angle) : out.identity();
};

// The nearest of 1, 2, 5, 10, 20, ...
export const round125 = (number) => {
  const power = 10 ** Math.floor(Math.log10(number));
  const share = number / power;
  return power * (share < Math.SQRT2 ? 1 : share < Math.sqrt(10) ? 2 : share < Math.sqrt(50) ? 5 : 10);
};
