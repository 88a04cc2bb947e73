// The bodies as three.js draws them: a group for each node of the tree, its pieces inside.
import {
  CircleGeometry, ConeGeometry, Curve, CylinderGeometry, DoubleSide, Group, LatheGeometry, Mesh, MeshStandardMaterial,
  Quaternion, SphereGeometry, TubeGeometry, Vector2, Vector3,
} from "./three.module.min.js";

const UP = new Vector3(0, 1, 0);
const vector = (point) => new Vector3(...point);

// Colours by theme: those of the report's view of the axes.
const COLOURS = {
  light: {
    levels: ["#46515f", "#6a5acd", "#7a7a00", "#cc79a7", "#8a93a0"], rotor: "#0072b2", mark: "#dfe7f1", root: "#b9c0ca",
    plate: "#e4e7ec", bearing: "#5c6675", torquer: "#d55e00", ink: "#1b2430",
  },
  dark: {
    levels: ["#c3cad4", "#a99cf5", "#b5b53c", "#e39cc4", "#8a93a0"], rotor: "#4aa8e6", mark: "#14202e", root: "#5a6472",
    plate: "#272d37", bearing: "#a0a9b6", torquer: "#f58a3c", ink: "#e6e9ee",
  },
};

class Path extends Curve {
  constructor(points) {
    super();
    this.points = [...points, points[0]];
    this.lengths = [0];
    for (let k = 1; k < this.points.length; k += 1) {
      this.lengths.push(this.lengths[k - 1] + this.points[k].distanceTo(this.points[k - 1]));
    }
  }

  getPoint(share, out = new Vector3()) {
    const along = share * this.lengths.at(-1);
    let k = 1;
    while (k < this.lengths.length - 1 && this.lengths[k] < along) k += 1;
    const part = (along - this.lengths[k - 1]) / (this.lengths[k] - this.lengths[k - 1]);
    return out.lerpVectors(this.points[k - 1], this.points[k], part);
  }

  getPointAt(share, out) { return this.getPoint(share, out); }
}

// Upper half of a wheel's section, from the hub to the rim: radius, height in parts of half its thickness.
const SECTION = [[1e-4, 1.35], [0.2, 1.35], [0.24, 1.1], [0.26, 0.42], [0.66, 0.42], [0.7, 0.92], [0.76, 1], [0.96, 1], [1, 0.8]];
const section = (half) => [...SECTION, ...SECTION.toReversed().map(([r, y]) => [r, -y])].map(([r, y]) => new Vector2(r, y * half));

const rim = ([start, end], radius) => {
  const turn = new Quaternion().setFromUnitVectors(UP, end.clone().sub(start).normalize());
  return Array.from({ length: 12 }, (_, k) => new Vector3(radius * Math.cos((k * Math.PI) / 6), 0, radius * Math.sin((k * Math.PI) / 6)).applyQuaternion(turn).add(start));
};

export class Bodies {
  constructor(scene) {
    this.nodes = scene.nodes;
    this.kept = [];
    this.looks = new Map();
    this.groups = this.nodes.map((node) => {
      const group = new Group();
      group.position.set(...node.pivot);
      for (const piece of node.pieces) this.put(group, node, piece);
      return group;
    });
    this.nodes.forEach((node, k) => { if (node.parent >= 0) this.groups[node.parent].add(this.groups[k]); });
    this.axes = this.nodes.map((node) => vector(node.axis));
  }

  get root() { return this.groups[0]; }

  // Angles of the gimbals and of the rotors, each in the order of the nodes.
  turn(angles) {
    for (let k = 1; k < this.nodes.length; k += 1) this.groups[k].quaternion.setFromAxisAngle(this.axes[k], angles[k - 1]);
  }

  // Where everything is as the angles are now.
  points() {
    this.root.updateMatrixWorld(true);
    return this.nodes.flatMap((node, k) => node.pieces.flatMap((piece) => {
      const points = piece.points.map(vector);
      return (piece.kind === "disc" ? rim(points, piece.radius) : points).map((point) => this.groups[k].localToWorld(point));
    }));
  }

  paint(theme) {
    const colours = COLOURS[theme];
    for (const [look, material] of this.looks) {
      const level = /^level (\d+)$/.exec(look);
      material.color.set(level ? colours.levels[(level[1] - 1) % colours.levels.length] : colours[look]);
    }
  }

  dispose() {
    for (const geometry of this.kept) geometry.dispose();
    for (const material of this.looks.values()) material.dispose();
    this.root.removeFromParent();
  }

  material(look) {
    if (!this.looks.has(look)) {
      const plain = look === "mark" || look === "plate";
      this.looks.set(look, new MeshStandardMaterial({ roughness: plain ? 0.9 : 0.45, metalness: plain ? 0 : 0.25, side: look === "rotor" ? DoubleSide : 0 }));
    }
    return this.looks.get(look);
  }

  mesh(group, geometry, look) {
    this.kept.push(geometry);
    const mesh = new Mesh(geometry, this.material(look));
    group.add(mesh);
    return mesh;
  }

  // A mesh that was made about the axis y, laid from one point to another.
  between(mesh, start, end) {
    mesh.position.copy(start).add(end).multiplyScalar(0.5);
    const along = end.clone().sub(start);
    if (along.lengthSq() > 0) mesh.quaternion.copy(new Quaternion().setFromUnitVectors(UP, along.normalize()));
    return mesh;
  }

  put(group, node, piece) {
    const points = piece.points.map(vector), [start] = points, end = points.at(-1);
    const own = node.kind === "root" ? "root" : node.kind === "rotor" ? "rotor" : `level ${node.level}`;
    const length = start.distanceTo(end);
    if (piece.kind === "loop") {
      this.mesh(group, new TubeGeometry(new Path(points), 120, piece.radius, 10, true), own);
    } else if (piece.kind === "tube") {
      const geometry = new CylinderGeometry(piece.radius, piece.radius, length, 16);
      this.between(this.mesh(group, geometry, piece.looks === "frame" ? own : piece.looks), start, end);
    } else if (piece.kind === "ball") {
      this.mesh(group, new SphereGeometry(piece.radius, 16, 12), piece.looks).position.copy(start);
    } else if (piece.kind === "arrow") {
      this.arrow(group, start, end, piece.radius, piece.looks.startsWith("axis ") ? "ink" : own);
    } else if (piece.looks === "plate") {
      this.between(this.mesh(group, new CylinderGeometry(piece.radius, piece.radius, length, 72), "plate"), start, end);
    } else {
      this.wheel(group, start, end, piece.radius);
    }
  }

  arrow(group, start, end, radius, look) {
    const along = end.clone().sub(start).normalize(), head = 5 * radius;
    const neck = end.clone().addScaledVector(along, -head);
    this.between(this.mesh(group, new CylinderGeometry(radius, radius, start.distanceTo(neck), 10), look), start, neck);
    this.between(this.mesh(group, new ConeGeometry(2.4 * radius, head, 16), look), neck, end);
  }

  wheel(group, start, end, radius) {
    const half = 0.5 * start.distanceTo(end), body = new Group();
    this.mesh(body, new LatheGeometry(section(half), 64), "rotor").scale.set(radius, 1, radius);
    // Marks on both faces, one of them larger: without them nobody would see it turn.
    for (let k = 0; k < 5; k += 1) {
      for (const side of [1, -1]) {
        const mark = this.mesh(body, new CircleGeometry((k === 0 ? 0.19 : 0.11) * radius, 24), "mark");
        const angle = (2 * Math.PI * k) / 5;
        mark.position.set(0.47 * radius * Math.cos(angle), side * (0.42 * half + 0.004), 0.47 * radius * Math.sin(angle));
        mark.rotation.x = (-side * Math.PI) / 2;
      }
    }
    group.add(this.between(body, start, end));
  }
}
