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
    """Yield the largest amplitude of a gimbal in the limit cycle of each drive that has play, at the job's angles.

    What other drives add to the gimbal counts too. Loops that are unstable without play have no such result.
    """
    platform, f = job.platform, specific_force_at(job.platform)
    metric = COUPLED_METRICS["limit cycle"]
    drives = [pair for pair in zip(platform.compliances, platform.sides, strict=True) if pair[0].play]
    if not drives or any(slowest(platform, q)[0].real > STABLE.limit for q in job.trims):
        return
    motors = [motor for _, motor in platform.sides]
    value, words = [0.0] * len(drives), ["no limit cycle"] * len(drives)
    for q in job.trims:
        found = [_cycle(platform, drive, sides, q, f, slowest) for drive, sides in drives]
        swings = np.array([amplitudes for _, amplitudes in found])
        swings[:, motors] = 0.0
        for k, (load, motor) in enumerate(sides for _, sides in drives):
            most = int(np.argmax(swings[k]))
            total = float(swings[:, most].sum())
            if swings[k, most] > 0.0 and total > value[k]:
                value[k], (hertz, own) = total, found[k]
                words[k] = f"limit cycle of {hertz:.3g} Hz, the motor side by ± {quantity(own[motor], 'rad', 3)}"
                words[k] += f", gimbal {platform.gimbal_names[most]} moves most" if most != load else ""
                words[k] += ", with what other drives add" if total > 1.001 * swings[k, most] else ""
                words[k] += f", {at_angles(platform, q)}" if q.any() else ""
    for (drive, _), size, says in zip(drives, value, words, strict=True):
        evidence = f"play {quantity(drive.play, 'rad')} of the drive of gimbal {drive.gimbal}: {says}"
        wanted = Requirement.of(metric, job.coupled.limit_cycle or 0.0, f"{metric.name} of {drive.gimbal}")
        judged = wanted.judge(size, subject=subject, stage="coupled", evidence=_APPROXIMATION, method="refined")
        cure = "preload the gear, close the loop on the motor side's angle, or lower its crossover"
        yield (
            replaced(judged, {"evidence": f"{evidence}; {_APPROXIMATION}"})
            if judged.passed
            else judged.because(f"{evidence}; {cure}")
        )


def _cycle(
    platform: Platform, drive: Compliance, sides: tuple[int, int], q: FloatArray, f: FloatArray, slowest: Slowest
) -> tuple[float, FloatArray]:
    """Return frequency, Hz, and amplitudes (n,), rad, of a drive's limit cycle; `sides` are its load and motor side."""
    critical, (load, motor) = _critical(platform, drive, q, slowest), sides
    if critical is None:
        return 0.0, np.zeros(len(q))
    share, pole, angles = critical
    at = twisted(platform, q, f)
    twist = largest_amplitude(share, max(0.0, 2.0 * abs(at[motor] - at[load]) / drive.play - 1.0))
    return abs(pole.imag) * HZ, 0.5 * drive.play * twist * np.abs(angles / (angles[load] - angles[motor]))


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
