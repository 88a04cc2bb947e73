"""The whole platform, free to turn, sampled: nominal, at other rates, and with all uncertain parameters changed."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from itertools import product
from typing import TYPE_CHECKING

import numpy as np

from platform_ctrl.analysis.interconnection import interconnected
from platform_ctrl.analysis.response import frequency_response
from platform_ctrl.analysis.sampling import held_input, sampled
from platform_ctrl.analysis.system import ComplexArray, System
from platform_ctrl.common.values import FloatArray, value
from platform_ctrl.design.cases import changed
from platform_ctrl.job.job import Job, LoopSpec
from platform_ctrl.mechanics.linearisation import LinearModel, linearise
from platform_ctrl.mechanics.outputs import observed
from platform_ctrl.mechanics.state_space import state_space as linear_state_space
from platform_ctrl.plant.platform import OMEGA_NAMES, ROOT_TORQUE_NAMES, Platform

if TYPE_CHECKING:
    import control

ATTITUDE = ("attitude1", "attitude2", "attitude3")
# Frequencies of the band: it needs no more to be drawn.
_BAND_POINTS = 36


@value
class FreePlants:
    """Sampled plants of the free platform: torquers → sensors, and torques on the platform → its attitude.

    `labels` are those of the N plants, the nominal one first. `arrays` are stacks (N, ...) from `torquers` to
    `sensors`; `turned` has the attitude as states and outputs too: torques M1 to M3 on the platform, held and not
    delayed, behind the torquers' inputs; ATTITUDE behind the sensors. `response` (N, F, sensors + 3, torquers + 3) is
    that of `turned` at the band's `frequency` (F,), rad/s.
    """

    labels: tuple[str, ...]
    torquers: tuple[str, ...]
    sensors: tuple[str, ...]
    arrays: System
    turned: System
    period: float
    frequency: FloatArray
    response: ComplexArray

    def only(self, k: int) -> FreePlants:
        """Return one of the plants alone, without a band."""
        part = slice(k, k + 1)
        arrays, turned = self.arrays.at(part), self.turned.at(part)
        return dataclasses.replace(
            self,
            labels=self.labels[part],
            arrays=arrays,
            turned=turned,
            frequency=self.frequency[:0],
            response=self.response[part, :0],
        )


def corners(job: Job) -> list[tuple[str, Platform, FloatArray]]:
    """Return label, platform and rate of the nominal plant, and of the corners of Omega and of the parameters.

    All inertias move together there, and all momenta: a corner for each sign of each would be hundreds.
    """
    platform, still = job.platform, np.zeros(3)
    out = [("nominal", platform, still)]
    gimbals, rotors = [g.name for g in platform.gimbals], [r.name for r in platform.rotors]
    widths = [("J", job.uncertainty.inertia, gimbals), ("L", job.uncertainty.spin, rotors)]
    widths = [one for one in widths if one[1] > 0.0 and one[2]]
    for signs in product((-1.0, 1.0), repeat=len(widths)) if widths else ():
        moved: dict[str, dict[str, float]] = {"J": {}, "L": {}}
        words = []
        for (letter, width, names), sign in zip(widths, signs, strict=True):
            moved[letter] = dict.fromkeys(names, sign * width)
            words.append(f"all {letter}{sign * width:+.0%}")
        out.append((" ".join(words), changed(platform, moved["J"], moved["L"]), still))
    axes = [(-rate, rate) if rate > 0.0 else (0.0,) for rate in map(float, job.Omega)]
    for rates in product(*axes):
        if any(rates):
            label = f"Omega = ({rates[0]:g}, {rates[1]:g}, {rates[2]:g}) rad/s"
            out.append((label, platform, np.array(rates)))
    return out


def free_plants(
    job: Job, cases: Sequence[tuple[str, Platform, FloatArray]], rates: Sequence[str], band: bool
) -> FreePlants:
    """Return the free platform, sampled, with all of its torquers, pick-offs, and the rate sensors named in `rates`.

    `cases` have label, platform and rate of the root; with a `band` there are responses on a grid.
    """
    sensors = [*(s.name for s in job.platform.pickoffs), *rates]
    torquers = job.platform.torquers
    rows = []
    for _, platform, Omega in cases:
        system = linear_state_space(linearise(platform, Omega=Omega), root="free")
        inputs, outputs = list(system.input_labels), list(system.output_labels)
        driven = [inputs.index(t.signal) for t in torquers]
        held = [inputs.index(name) for name in ROOT_TORQUE_NAMES]
        turning = [outputs.index(name) for name in OMEGA_NAMES]
        seen = observed(system, platform, sensors, Omega=Omega).C
        rows.append((system.A, system.B[:, driven], seen, system.B[:, held], system.C[turning]))
    A, B, C, B_root, C_rate = map(np.array, zip(*rows, strict=True))
    N, n, m = B.shape
    period, delay, lags = job.sampling.period, job.sampling.delay, np.array([t.lag for t in torquers])
    own = System(A, B, C, np.zeros((N, len(sensors), m)), 0.0)
    # With the attitude as states and outputs: on the sampled plant's own states lags and held torques have no effect.
    none = np.zeros((N, 3, 3))
    turned = System(
        np.block([[A, np.zeros((N, n, 3))], [C_rate, none]]),
        np.concatenate([B, np.zeros((N, 3, m))], axis=1),
        np.block([[C, np.zeros((N, len(sensors), 3))], [np.zeros((N, 3, n)), np.broadcast_to(np.eye(3), none.shape)]]),
        np.zeros((N, len(sensors) + 3, m)),
        0.0,
    )
    acting = held_input(turned.A, np.concatenate([B_root, none], axis=1), period)[1]
    turned = sampled(turned, period, delay, lags)
    both = np.zeros((N, turned.A.shape[-1], m + 3))
    both[..., :m], both[:, : n + 3, m:] = turned.B, acting
    D = np.concatenate([turned.D, np.zeros((N, len(sensors) + 3, 3))], axis=-1)
    turned = turned._replace(B=both, D=D)
    nyquist = np.pi / period
    # What oscillates: the pole b/J of a damped axis says nothing about the loop.
    fastest = float(np.abs(np.linalg.eigvals(A[0]).imag).max(initial=0.0)) or 0.1 * nyquist
    low = min(2e-3 * fastest, 0.01 * nyquist)
    grid = np.geomspace(low, 0.999 * nyquist, _BAND_POINTS) if band else np.zeros(0)
    shape = N, 0, *D.shape[-2:]
    return FreePlants(
        labels=tuple(label for label, _, _ in cases),
        torquers=tuple(t.name for t in torquers),
        sensors=tuple(sensors),
        arrays=sampled(own, period, delay, lags),
        turned=turned,
        period=period,
        frequency=grid,
        response=frequency_response(turned, grid, -3) if band else np.zeros(shape, dtype=np.complex128),
    )


@value
class StabilisedLoop:
    """All loops of a job closed around the free platform.

    `model` is the platform at rest, and `controllers` has a
    `control.StateSpace` for each loop in the job's order. `plants` is the set (the nominal plant alone without a band),
    and `shown` the plant that is shown.
    """

    job: Job
    model: LinearModel
    spec: LoopSpec
    controllers: tuple[control.StateSpace, ...]
    plants: FreePlants
    shown: FreePlants

    def joined(self, plants: FreePlants) -> tuple[System, list[int], tuple[str, ...]]:
        """Return all controllers as one, the plants' inputs that it sets, and its torquers."""
        used = {name for K in self.controllers for name in K.output_labels}
        torquers = [name for name in plants.torquers if name in used]
        K = interconnected(self.controllers, plants.sensors, torquers, plants.period)
        return K, [plants.torquers.index(name) for name in torquers], tuple(torquers)
