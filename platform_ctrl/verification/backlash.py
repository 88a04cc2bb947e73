"""Limit cycles that the play of a gear makes in closed loops, by its describing function.

With the twist B + A sin ωt of a drive with play, stiffness and damping work as if they were κ times as large (A. Gelb,
W. E. Vander Velde, Multiple-Input Describing Functions, 1968, ch. 2, 6); the bias B follows from the torque that the
drive holds at rest. Large oscillations have κ near 1. Where the loops are unstable with a smaller κ than κ*, and stable
from there to 1, an oscillation settles at the amplitude of κ*.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator

import numpy as np

from platform_ctrl.analysis.metrics import COUPLED_METRICS
from platform_ctrl.analysis.system import ComplexArray
from platform_ctrl.common.values import FloatArray, replaced
from platform_ctrl.design.cases import at_angles
from platform_ctrl.job.job import Job
from platform_ctrl.job.judging import STABLE, CheckResult, Requirement
from platform_ctrl.job.quantities import HZ, quantity
from platform_ctrl.mechanics.forces import specific_force_at, twisted
from platform_ctrl.plant.flexible import Compliance
from platform_ctrl.plant.platform import Platform

# The pole of all loops that decays most slowly, 1/s, with a platform at angles of its gimbals; its part of the angles.
Slowest = Callable[[Platform, FloatArray], tuple[complex, ComplexArray]]

_APPROXIMATION = "by describing function, other gears closed, without dry friction"
# Shares of the stiffness at which instability is looked for. A stiff gear lets its load swing as slowly as the loop
# crosses over only with a very small one: its teeth then hardly touch.
_SHARES = np.geomspace(1.0, 1e-8, 60)
# Amplitudes of a twist in half plays, and phases, at which the describing function is computed.
_AMPLITUDES, _PHASES = np.geomspace(1e-2, 1e4, 600), np.pi * (np.arange(400) + 0.5) / 200


def limit_cycle_results(job: Job, slowest: Slowest, subject: str) -> Iterator[CheckResult]:
    """Yield the largest amplitude of a limit cycle of each load whose drive has play, at the job's angles.

    Loops that are unstable without play have no such result.
    """
    platform, f = job.platform, specific_force_at(job.platform)
    wanted = Requirement.of(COUPLED_METRICS["limit cycle"], job.coupled.limit_cycle or 0.0)
    for drive, (load, motor) in zip(platform.compliances, platform.sides, strict=True):
        value, words = 0.0, "no limit cycle"
        if not drive.play or any(slowest(platform, q)[0].real > STABLE.limit for q in job.trims):
            continue
        for q in job.trims:
            critical = _critical(platform, drive, q, slowest)
            if critical is None:
                continue
            share, pole, angles = critical
            at = twisted(platform, q, f)
            twist = largest_amplitude(share, max(0.0, 2.0 * abs(at[motor] - at[load]) / drive.play - 1.0))
            own, other = 0.5 * drive.play * twist * np.abs(angles[[load, motor]] / (angles[load] - angles[motor]))
            if own > value:
                value = float(own)
                words = f"limit cycle of {abs(pole.imag) * HZ:.3g} Hz, the motor side by ± {quantity(other, 'rad', 3)}"
                words += f", {at_angles(platform, q)}" if q.any() else ""
        evidence = f"play {quantity(drive.play, 'rad')} of the drive of gimbal {drive.gimbal}: {words}"
        found = wanted.judge(value, subject=subject, stage="coupled", evidence=_APPROXIMATION, method="refined")
        cure = "preload the gear, close the loop on the motor side's angle, or lower its crossover"
        yield (
            replaced(found, {"evidence": f"{evidence}; {_APPROXIMATION}"})
            if found.passed
            else found.because(f"{evidence}; {cure}")
        )


def _critical(
    platform: Platform, drive: Compliance, q: FloatArray, slowest: Slowest
) -> tuple[float, complex, ComplexArray] | None:
    """Return the largest share of a drive's stiffness with which the loops are unstable, and their pole there."""

    def weaker(share: float) -> tuple[complex, ComplexArray]:
        less = {"stiffness": share * drive.strength, "damping": share * drive.damping}
        own = [replaced(one, less) if one is drive else one for one in platform.compliances]
        return slowest(replaced(platform, {"compliances": tuple(own)}), q)

    above = 1.0
    for below in _SHARES[1:]:
        if weaker(below)[0].real > STABLE.limit:
            break
        above = below
    else:
        return None
    for _ in range(12):
        middle = math.sqrt(above * below)
        above, below = (above, middle) if weaker(middle)[0].real > 0.0 else (middle, below)
    return below, *weaker(below)


def largest_amplitude(share: float, preload: float = 0.0) -> float:
    """Return the largest amplitude of a twist at which play leaves a share of the stiffness.

    Parameters
    ----------
    share
        Of the stiffness, 0 to 1, dimensionless.
    preload
        Torque that the drive holds at rest, over stiffness times half the play.

    Returns
    -------
    float
        Over half the play; 0 where the torque keeps the teeth together so that no amplitude leaves so little.
    """
    # Bias whose mean torque is the preload, by bisection.
    sine, low, high = np.sin(_PHASES), np.zeros(len(_AMPLITUDES)), np.full(len(_AMPLITUDES), 1.0 + preload)
    for _ in range(40 if preload else 0):
        bias = 0.5 * (low + high)
        more = _beyond(bias, sine).mean(axis=1) < preload
        low, high = np.where(more, bias, low), np.where(more, high, bias)
    left = 2.0 * (_beyond(low, sine) @ sine) / len(sine) / _AMPLITUDES
    weak = np.flatnonzero(left < share)
    if not len(weak):
        return 0.0
    pair = slice(weak[-1], weak[-1] + 2)
    return float(np.exp(np.interp(share, left[pair], np.log(_AMPLITUDES[pair]))))


def _beyond(bias: FloatArray, sine: FloatArray) -> FloatArray:
    """Return what of a twist about a bias (amplitudes,) is beyond half the play, (amplitudes, phases)."""
    twist = bias[:, None] + _AMPLITUDES[:, None] * sine
    return np.asarray(twist - np.clip(twist, -1.0, 1.0))
