"""All loops of a job closed around the free platform, and what all that is measured of them rests on."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from platform_ctrl.analysis.arrays import ComplexArray, StateArrays
from platform_ctrl.analysis.feedback import closed_loop_arrays
from platform_ctrl.analysis.joining import joined_arrays
from platform_ctrl.analysis.peaks import peak
from platform_ctrl.analysis.poles import continuous_poles, pole_arrays
from platform_ctrl.analysis.response import ON_A_GRID, AxisResponse
from platform_ctrl.analysis.sensitivity import sensitivities
from platform_ctrl.designer.curves import arrays_of, dense_grid
from platform_ctrl.designer.free_plants import FreePlants
from platform_ctrl.designer.parts import EDGE
from platform_ctrl.frozen import FloatArray, value
from platform_ctrl.job import Job, LoopSpec
from platform_ctrl.linearisation import LinearModel

if TYPE_CHECKING:
    import control


@value
class StabilisedLoop:
    """All loops of a job closed around the free platform.

    Attributes
    ----------
    job
        With the settings' spins, sampling and range of Omega.
    model
        At rest.
    spec
        The stabilisation loop.
    controllers
        `control.StateSpace` of each loop, in the job's order.
    plants, shown
        The set (the nominal plant alone without a band), and the plant that is shown.
    """

    job: Job
    model: LinearModel
    spec: LoopSpec
    controllers: tuple[control.StateSpace, ...]
    plants: FreePlants
    shown: FreePlants

    def joined(self, plants: FreePlants) -> tuple[StateArrays, list[int], tuple[str, ...]]:
        """Return all controllers as one, the plants' inputs that it sets, and its torquers."""
        used = {name for K in self.controllers for name in K.output_labels}
        torquers = [name for name in plants.torquers if name in used]
        K = joined_arrays(self.controllers, plants.sensors, torquers, plants.period)
        return K, [plants.torquers.index(name) for name in torquers], tuple(torquers)


def used_arrays(arrays: StateArrays, k: int, at: list[int]) -> StateArrays:
    """Return one plant of a stack with the inputs `at` that controllers set."""
    A, B, C, D, dt = arrays_of(arrays, k)
    return StateArrays(A, B[:, at], C, D[:, at], dt)


def loop_grid(P: StateArrays, s: ComplexArray) -> FloatArray:
    """Return frequencies at which to look at a plant and a loop with the poles `s`, (F,), rad/s."""
    nyquist = math.pi / P.dt
    finite = s[np.isfinite(s)]
    slowest = float(np.abs(finite).min(initial=nyquist))
    low = max(min(0.1 * slowest, 0.01 * nyquist), 1e-5 * nyquist)
    own = continuous_poles(pole_arrays(P.A), P.dt)
    # Free poles at z = 1 are integrators, no resonances.
    return dense_grid(np.concatenate([s, own]), low, EDGE * nyquist)


class Sensitivity:
    """S at the plant's input over frequency; what does not depend on the frequency is worked out once."""

    def __init__(self, P: StateArrays, K: StateArrays) -> None:
        self._P, self._K = AxisResponse(P, ON_A_GRID), AxisResponse(K, ON_A_GRID)

    def at(self, w: FloatArray) -> ComplexArray:
        """Return S at `w` (F,), rad/s, complex (F, m, m)."""
        return sensitivities(-self._K.at(w) @ self._P.at(w))[0]


def disk_margins(P: StateArrays, K: StateArrays, channels: Sequence[int]) -> FloatArray:
    """Return 1/max |S_ii - 1/2| over all frequencies of channels of a stable loop, broken one at a time."""
    A, B, C, D = closed_loop_arrays(*P[:4], *K[:4])
    # From a torque disturbance to the torque the closed loop is S - 1.
    parts = [StateArrays(A, B[:, [i]], C[[i]], D[[i]][:, [i]] + 0.5, P.dt) for i in channels]
    return np.array([1.0 / peak(part)[0] for part in parts])
