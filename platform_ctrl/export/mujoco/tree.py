"""A compiled MuJoCo model as the tree of bodies that it is at its reference angles, in the root's axes."""

from __future__ import annotations

import dataclasses
from typing import Any

import numpy as np

from platform_ctrl.common.values import FloatArray
from platform_ctrl.errors import InputError
from platform_ctrl.plant.mistakes import given, one_line

# Lengths that count as zero, over the distance of the farthest joint or centre of mass.
NEAR = 1e-6

# No place, mass or inertia in whatever units is as large.
_LARGEST = 1e50

FREE, BALL, HINGE = 0, 1, 3


@dataclasses.dataclass
class Body:
    """A body with all that is fixed to it."""

    # name, number, parent: Name, number in the model, and the index of its carrier in the list of bodies; −1: none
    name: str
    number: int
    parent: int
    joint: int  # Number of its hinge in the model; −1: it has none
    # axis, anchor: (3,): Of its hinge
    axis: FloatArray
    anchor: FloatArray
    # mass, moment, inertia: Mass, its first moment and inertia about the origin, kg, kg m, kg m² (3, 3)
    mass: float
    moment: FloatArray
    inertia: FloatArray

    def about(self, point: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return first moment and inertia about a point."""
        r, m, s = point, self.mass, self.moment
        shift = 2.0 * (r @ s) * np.eye(3) - np.outer(r, s) - np.outer(s, r)
        return s - m * r, self.inertia - shift + m * point_inertia(r)

    def take(self, mass: float, at: FloatArray) -> None:
        """Add a mass point."""
        self.mass += mass
        self.moment = self.moment + mass * at
        self.inertia = self.inertia + mass * point_inertia(at)


def point_inertia(offset: FloatArray) -> FloatArray:
    """Inertia of a unit mass at `offset`, (3, 3)."""
    out: FloatArray = float(offset @ offset) * np.eye(3) - np.outer(offset, offset)
    return out


def bodies_of(model: Any, data: Any, label: str) -> tuple[list[Body], int, float]:
    """Return the bodies, the root first and parents before children; the root's joint or −1; and their size, m."""
    for count, what in ((model.neq, "equality constraints"), (model.ntendon, "tendons"), (model.nplugin, "plugins")):
        if count:
            raise InputError(f"{label}: has {what}, but may have only bodies on hinges; remove them")
    read = (data.xpos, data.xmat, data.xipos, data.ximat, data.xaxis, data.xanchor, model.body_mass, model.body_inertia)
    if any(not np.all(np.abs(numbers) < _LARGEST) for numbers in read):
        raise InputError(f"{label}: has a position, mass or inertia that is huge or not finite; correct it")
    root = _root_of(model, label)
    turn, origin = data.xmat[root].reshape(3, 3), data.xpos[root]
    out: list[Body] = []
    place = {0: -1}
    root_joint = -1
    for k in range(root, model.nbody):
        parent = int(model.body_parentid[k])
        if k != root and (parent not in place or place[parent] < 0):
            continue  # beside the root
        name = one_line(model.body(k).name) or f"body{k}"
        joints = [int(model.body_jntadr[k]) + j for j in range(int(model.body_jntnum[k]))]
        mass = float(model.body_mass[k])
        centre = turn.T @ (data.xipos[k] - origin)
        axes = turn.T @ data.ximat[k].reshape(3, 3)
        inertia = axes @ np.diag(model.body_inertia[k]) @ axes.T + mass * point_inertia(centre)
        body = Body(name, k, -1, -1, np.zeros(3), np.zeros(3), mass, mass * centre, inertia)
        if k == root:
            root_joint = joints[0] if joints else -1
            if root == 0:  # the world: it does not move, whatever its inertia
                body.mass, body.moment, body.inertia = 0.0, np.zeros(3), np.eye(3)
        elif not joints:
            carrier = out[place[parent]]
            place[k] = place[parent]
            if not (root == 0 and place[k] == 0):
                carrier.mass += body.mass
                carrier.moment, carrier.inertia = carrier.moment + body.moment, carrier.inertia + body.inertia
            continue
        elif len(joints) > 1 or model.jnt_type[joints[0]] != HINGE:
            raise InputError(
                f"{label}: body {given(name)} must hang on exactly one hinge; split its joints over several bodies"
            )
        else:
            body.parent, body.joint = place[parent], joints[0]
            body.axis, body.anchor = turn.T @ data.xaxis[joints[0]], turn.T @ (data.xanchor[joints[0]] - origin)
        place[k] = len(out)
        out.append(body)
    return out, root_joint, _size(out)


def _size(bodies: list[Body]) -> float:
    lengths = [np.linalg.norm(one.anchor) for one in bodies]
    lengths += [np.linalg.norm(one.moment) / one.mass for one in bodies if one.mass > 0.0]
    lengths += [np.sqrt(np.trace(one.inertia) / one.mass) for one in bodies if one.mass > 0.0]
    return float(max(lengths, default=1.0)) or 1.0


def _root_of(model: Any, label: str) -> int:
    """Return the one body on the world that carries hinges and is fixed or in a ball or free joint, else the world."""
    # body_rootid: the body on the world under which a body is.
    carriers = sorted({int(model.body_rootid[k]) for k in range(1, model.nbody) if model.body_jntnum[k]})
    if not carriers:
        raise InputError(f"{label}: has no gimbal; it needs a root body that carries bodies on hinges")
    first = carriers[0]
    may_turn = model.body_jntnum[first] == 0 or model.jnt_type[model.body_jntadr[first]] in (BALL, FREE)
    return first if len(carriers) == 1 and may_turn else 0


@dataclasses.dataclass
class Chains:
    """Root and gimbals; what is fixed to them, and their rotors, are with them already."""

    # bodies, gimbals: All bodies, the root first, and which of them are gimbals
    bodies: list[Body]
    gimbals: list[int]
    size: float  # Of the device, m
    label: str  # Of the file, for messages

    def about_centres(self, root: FloatArray) -> tuple[dict[int, FloatArray], dict[int, FloatArray]]:
        """Return inertia and first moment of root and gimbals about the point where the axes meet.

        A balanced subtree whose axes meet elsewhere counts as one mass point of its carrier.
        """
        bodies = self.bodies
        inertias: dict[int, FloatArray] = {}
        moments: dict[int, FloatArray] = {}
        centre = {0: root}
        apart = []
        for k in self.gimbals:
            body, above = bodies[k], centre[bodies[k].parent]
            mass, moment = self._subtree(k)
            own = moment / mass
            meets = np.linalg.norm(np.cross(body.axis, above - body.anchor)) <= NEAR * self.size
            if meets and (np.linalg.norm(own - above) <= NEAR * self.size or not self._balanced(k)):
                centre[k] = above
                continue
            centre[k] = own
            apart.append((k, mass))
            if not self._on_axis(k, own):
                words = "turns about an axis that meets neither that of its carrier nor its own centre of mass"
                raise self._wrong(k, f"{words}; all axes must meet at one point, or the gimbal must be balanced")
        for k, mass in reversed(apart):
            bodies[bodies[k].parent].take(mass, centre[k])
        for k in [0, *self.gimbals]:
            moments[k], inertias[k] = bodies[k].about(centre[k])
            balanced = np.linalg.norm(moments[k]) <= NEAR * self.size * bodies[k].mass
            if not balanced and any(self._within(k, top) for top, _ in apart):
                raise self._wrong(
                    k, "is out of balance and its axis does not meet the others; only one of both is possible"
                )
        return inertias, moments

    def root_centre(self) -> FloatArray:
        """Return the centre of a root that does not move: where all axes meet, else the centre of mass.

        The axis of a balanced gimbal may lie anywhere: if it does not meet the others, it takes no part in the search.
        """
        if not self.gimbals:
            return np.zeros(3)
        unbalanced = [k for k in self.gimbals if not self._balanced(k)]
        for gimbals in (self.gimbals, unbalanced):
            point = _nearest_point([self.bodies[k] for k in gimbals]) if gimbals else self.whole_centre()
            if all(self._on_axis(k, point) for k in gimbals):
                return point
        return self.bodies[unbalanced[0]].anchor  # an axis that does not meet this one is refused

    def whole_centre(self) -> FloatArray:
        """Return the centre of mass; rotors are with their carriers already."""
        whole = [self.bodies[k] for k in (0, *self.gimbals)]
        centre: FloatArray = np.sum([one.moment for one in whole], axis=0) / sum(one.mass for one in whole)
        return centre

    def _balanced(self, k: int) -> bool:
        """Whether a gimbal, with all that it carries, and whatever it carries itself, rest at any angle."""
        mass, moment = self._subtree(k)
        carried = [j for j in self.gimbals if self.bodies[j].parent == k]
        return self._on_axis(k, moment / mass) and all(self._balanced(j) for j in carried)

    def _on_axis(self, k: int, point: FloatArray) -> bool:
        body = self.bodies[k]
        return bool(np.linalg.norm(np.cross(body.axis, point - body.anchor)) <= NEAR * self.size)

    def _subtree(self, k: int) -> tuple[float, FloatArray]:
        inside = [self.bodies[j] for j in self.gimbals if self._within(j, k)]
        return sum(body.mass for body in inside), np.sum([body.moment for body in inside], axis=0)

    def _within(self, k: int, top: int) -> bool:
        while k > top:
            k = self.bodies[k].parent
        return k == top

    def _wrong(self, k: int, words: str) -> InputError:
        return InputError(f"{self.label}: body {given(self.bodies[k].name)} {words}")


def _nearest_point(hinges: list[Body]) -> FloatArray:
    """Return the point nearest to all axes; where they are parallel the first hinge's own."""
    across = [np.eye(3) - np.outer(one.axis, one.axis) for one in hinges]
    normal = np.sum(across, axis=0)
    if np.linalg.eigvalsh(normal)[0] < 1e-6:
        return hinges[0].anchor
    moment = np.sum([P @ one.anchor for P, one in zip(across, hinges, strict=True)], axis=0)
    return np.asarray(np.linalg.solve(normal, moment))
