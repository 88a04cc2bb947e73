"""The modes of the uncontrolled gimbals, and what kind each of them is."""

from __future__ import annotations

import dataclasses

import numpy as np
from numpy.typing import ArrayLike

from platform_ctrl.analysis.arrays import ComplexArray
from platform_ctrl.check.verdict import JobResult
from platform_ctrl.design.channels import channels
from platform_ctrl.design.plants import changed, rows_of
from platform_ctrl.frozen import FloatArray, value
from platform_ctrl.linearisation import LinearModel, linearise
from platform_ctrl.state_space import state_space

# A pole this small against the fastest of its group counts as zero: multiple zeros come out that large in floats.
_ZERO = 1e-5


@value
class Mode:
    """A group of poles of the uncontrolled gimbals.

    Attributes
    ----------
    gimbals
        The subsystem.
    kind
        ``nutation``, ``precession``, ``inertial`` (a direction that no gyro stiffens).
    poles
        How many.
    frequency
        Of the oscillation, |Im s|, rad/s; 0 where there is none.
    growth
        Largest real part, 1/s; 0 where nothing grows.
    """

    gimbals: tuple[str, ...]
    kind: str
    poles: int
    frequency: float
    growth: float


def gimbal_poles(model: LinearModel, gimbals: tuple[str, ...]) -> ComplexArray:
    """Return the poles of the uncontrolled gimbals with Omega given, fastest first, rad/s."""
    s = np.asarray(np.linalg.eigvals(state_space(model, gimbals=gimbals).A), dtype=np.complex128)
    return s[np.argsort(-np.abs(s), kind="stable")]


def modes(model: LinearModel, gimbals: tuple[str, ...]) -> tuple[Mode, ...]:
    """Return the modes of a subsystem at the model's trim, fastest first.

    Every gyroscopic pair has a nutation and a precession; the directions that no gyro stiffens are plain inertias.
    """
    s = gimbal_poles(model, gimbals)
    pairs = len(channels(model, rows_of(model, gimbals)).momenta)
    out = []
    for k in range(pairs):
        pair = s[2 * k : 2 * k + 2]
        out.append(_mode(gimbals, "nutation", pair, s))
    slow = s[2 * pairs :]
    inertial = len(gimbals) - 2 * pairs
    if not slow.size:
        return tuple(out)
    if np.abs(slow).max() <= _ZERO * np.abs(s).max(initial=0.0) or np.abs(s).max(initial=0.0) == 0.0:
        if pairs:
            out.append(_mode(gimbals, "precession", np.zeros(2 * pairs, dtype=np.complex128), s))
        if inertial:
            out.append(_mode(gimbals, "inertial", np.zeros(2 * inertial, dtype=np.complex128), s))
        return tuple(out)
    # With a platform rate the restraint mixes precession and inertial directions.
    kind = "precession" if not inertial else "precession and inertial"
    out += [_mode(gimbals, kind, slow[k : k + 2], s) for k in range(0, len(slow), 2)]
    return tuple(out)


def _mode(gimbals: tuple[str, ...], kind: str, s: ComplexArray, every: ComplexArray) -> Mode:
    small = _ZERO * float(np.abs(every).max(initial=0.0))
    frequency, growth = float(np.abs(s.imag).max(initial=0.0)), float(s.real.max(initial=0.0))
    return Mode(
        gimbals=gimbals,
        kind=kind,
        poles=len(s),
        frequency=frequency if frequency > small else 0.0,
        growth=growth if growth > small else 0.0,
    )


def modes_at(result: JobResult, Omega: ArrayLike) -> tuple[Mode, ...]:
    """Return the modes of all subsystems at a constant platform rate, rad/s."""
    model = linearise(result.job.platform, Omega=Omega)
    return tuple(mode for group in result.subsystems for mode in modes(model, group))


def nutation_over_speed(result: JobResult, speed: FloatArray) -> list[tuple[tuple[str, ...], FloatArray]]:
    """Return (gimbals, frequencies in rad/s over `speed`), one for every nutation at rest; `speed` 1 is nominal.

    At rest the inertias do not depend on the rotors' momenta and the gyroscopic matrix is proportional to them, so
    two linearisations give every speed.
    """
    platform = result.job.platform
    still = linearise(changed(platform, {}, {rotor.name: -1.0 for rotor in platform.rotors}))
    turning = result.model
    out = []
    for group in result.subsystems:
        pairs = len(channels(turning, rows_of(turning, group)).momenta)
        if not pairs:
            continue
        at = []
        for share in speed:
            model = dataclasses.replace(turning, G=still.G + share * (turning.G - still.G))
            at.append(np.abs(gimbal_poles(model, group))[: 2 * pairs : 2])
        out += [(group, line) for line in np.array(at).T]
    return out
