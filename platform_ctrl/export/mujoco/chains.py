"""Gimbals of a MuJoCo model and the points that they turn about: one in a platform; balanced gimbals have their own."""

from __future__ import annotations

import dataclasses

import numpy as np

from platform_ctrl.errors import InputError
from platform_ctrl.export.mujoco.tree import NEAR, Body
from platform_ctrl.frozen import FloatArray
from platform_ctrl.reading.mistakes import given


@dataclasses.dataclass
class Chains:
    """Root and gimbals; what is fixed to them, and their rotors, are with them already.

    Attributes
    ----------
    bodies, gimbals
        All bodies, the root first, and which of them are gimbals.
    size
        Of the device, m.
    label
        Of the file, for messages.
    """

    bodies: list[Body]
    gimbals: list[int]
    size: float
    label: str

    def about_centres(self, root: FloatArray) -> tuple[dict[int, FloatArray], dict[int, FloatArray]]:
        """Return inertia and first moment of root and gimbals about the point where the axes meet.

        A balanced subtree whose axes meet elsewhere counts as one mass point of its carrier.

        Raises
        ------
        InputError
            An axis does not meet the others, and what turns about it is out of balance.
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
                raise self._wrong(k, f"{words}; expected all axes to meet at one point, or balanced gimbals")
        for k, mass in reversed(apart):
            bodies[bodies[k].parent].take(mass, centre[k])
        for k in [0, *self.gimbals]:
            moments[k], inertias[k] = bodies[k].about(centre[k])
            balanced = np.linalg.norm(moments[k]) <= NEAR * self.size * bodies[k].mass
            if not balanced and any(self._within(k, top) for top, _ in apart):
                raise self._wrong(k, "is out of balance, and its axis does not meet the others; expected one of both")
        return inertias, moments

    def root_centre(self) -> FloatArray:
        """Where a root that stands still has its centre: where all axes meet, else the centre of mass."""
        hinges = [self.bodies[k] for k in self.gimbals]
        if not hinges:
            return np.zeros(3)
        # The point nearest to all axes; where they are parallel the first hinge's own.
        across = [np.eye(3) - np.outer(one.axis, one.axis) for one in hinges]
        normal = np.sum(across, axis=0)
        if np.linalg.eigvalsh(normal)[0] < 1e-6:
            return hinges[0].anchor
        point = np.linalg.solve(normal, np.sum([P @ one.anchor for P, one in zip(across, hinges, strict=True)], axis=0))
        if all(np.linalg.norm(np.cross(one.axis, point - one.anchor)) <= NEAR * self.size for one in hinges):
            return np.asarray(point)
        return self.whole_centre()

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
