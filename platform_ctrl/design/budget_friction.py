"""Dry friction in the budget of a loop: its equivalent gains at the rates that the budget itself finds, and its noise.

In the loop that is balanced each drive has a hold of its own, whose output is the rate w that it finds, as it acts on
the bearing: read, held, late and lagging as its torque is. Times the equivalent gain it is the drive's torque.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from platform_ctrl.analysis.budget_integrals import BudgetResult
from platform_ctrl.analysis.dry_friction import (
    FrictionBalance,
    FrictionGains,
    friction_balance,
)
from platform_ctrl.analysis.dry_torques import FedFriction, about_mean
from platform_ctrl.analysis.friction_noise import FoundRate, friction_noise
from platform_ctrl.analysis.hybrid_plant import Density, HybridPlant, RandomDisturbance
from platform_ctrl.analysis.interconnection import MultiRate
from platform_ctrl.analysis.jitter_budget import JitterBudget
from platform_ctrl.analysis.poles import poles
from platform_ctrl.analysis.system import System
from platform_ctrl.common.values import FloatArray, replaced
from platform_ctrl.design.budget_loop import BudgetLoop
from platform_ctrl.errors import ArgumentError, NotFoundError

# Relative error of variances of a verdict.
TOLERANCE = 1e-5
# Relative error of the rates that friction is balanced with.
_FRICTION_TOLERANCE = 1e-4
# Share of dry friction below which its noise is none.
_NO_REMAINDER = 1e-9
# Noise of dry friction in a cycle of several samples counts up to so many sample frequencies, or of the fastest mode.
_SAMPLING, _MODES = 1.0, 4.0


class Balanced(NamedTuple):
    """Gimbal angles (n,), and the replacement of dry friction there: damping, feedforward, noise of the rest."""

    q: FloatArray
    friction: FrictionBalance
    rest: tuple[RandomDisturbance, ...]


def balanced(loop: BudgetLoop, q: FloatArray, near: FrictionBalance | None = None) -> Balanced:
    """Return the replacement of dry friction at gimbal angles (n,); `near` is the balance at others."""
    if not loop.dry:
        return Balanced(q, friction_balance((), lambda gains: gains.viscous), ())
    driven = [k for k, law in enumerate(loop.laws) if law is not None]
    # Between what the budget counts and what the loop samples.
    corner = 2.0 * math.pi * math.sqrt(loop.budget.from_hz * 0.5 / loop.job.sampling.period)
    controller = _with_finders(loop, q)

    def found(gains: FrictionGains, spectra: bool) -> BudgetResult:
        plant = _balancing_plant(loop, gains, q, corner if spectra else None)
        return loop.prepared(plant, loop.together, ()).of(controller, TOLERANCE, over_frequency=spectra)

    def rates(gains: FrictionGains) -> FloatArray:
        try:
            total = found(gains, False).total
        except ArgumentError as error:
            if not any(one.any() for one in (gains.viscous, gains.fed, gains.share)):
                raise
            raise NotFoundError(
                "budget: with the damping that dry friction has at these rates the loop is not stable: bearings stick "
                "and slip; say in [budget.turning] how fast they turn, or limit the line of sight in a manoeuvre"
            ) from error
        return np.asarray(total[[*loop.bearings, *range(loop.behind, len(total)), *range(loop.bent, loop.behind)]])

    drives = tuple(
        None if law is None else FedFriction(friction=law.friction, friction_rate=law.friction_rate)
        for law in loop.laws
    )
    start = None if near is None else np.concatenate([near.rate, near.measured[driven]])
    balance = friction_balance(loop.dry, rates, start, _FRICTION_TOLERANCE, drives, loop.turning)
    moved = found(balance.gains, True)
    of_drives = dict(zip(driven, moved.total_cumulative[loop.behind :].reshape(-1, 3, len(moved.edges)), strict=True))
    lowest = 2.0 * math.pi * loop.budget.from_hz
    left, rest, highest = np.zeros(len(drives)), [], _highest(loop, balance, q)
    for k, (one, drive, at) in enumerate(zip(loop.dry, drives, loop.bearings, strict=True)):
        if balance.remainder[k] <= _NO_REMAINDER * max(one.breakaway):
            continue  # it turns all the time
        of_drive, less = None, 1.0
        if drive is not None:
            alone, together, filtered = of_drives[k]
            of_drive = FoundRate(
                drive=drive,
                rms=float(balance.measured[k]),
                alone=alone,
                together=together,
                filtered=filtered,
                corner=corner,
            )
        elif k in loop.elastic:
            at, less = loop.bent + loop.elastic.index(k), float(balance.bristles[2, k])
        noise = friction_noise(
            about_mean(one, float(loop.turning[k])),
            float(balance.rate[k]),
            moved.edges,
            moved.total_cumulative[at],
            lowest,
            of_drive,
        )
        if noise is not None:
            left[k] = less * noise.rms
            at_gimbal, spectrum = (loop.torque_on(one.gimbal),), _within(noise.spectrum, highest, less)
            rest.append(RandomDisturbance(name=f"dry friction of {one.gimbal}", inputs=at_gimbal, spectra=(spectrum,)))
    return Balanced(q, replaced(balance, {"remainder": left}), tuple(rest))


def balanced_at_trims(loop: BudgetLoop) -> list[Balanced]:
    """Return the replacement of dry friction at each of the job's gimbal angles."""
    nominal, *others = loop.job.trims
    first = balanced(loop, nominal)
    return [first, *(balanced(loop, q, first.friction) for q in others)]


def _highest(loop: BudgetLoop, balance: FrictionBalance, q: FloatArray) -> float:
    """Return the frequency, rad/s, up to which the noise of dry friction counts.

    In a long cycle each harmonic of the bearing has many images. Beyond the sampler's reach and above all modes inertia
    leaves nothing of them.
    """
    if loop.cycle == 1:
        return math.inf
    plant = loop.damped(balance.gains, q)
    modes = np.abs(poles(plant.plant.A)).max(initial=0.0)
    return min(max(_SAMPLING * plant.sample_frequency, _MODES * float(modes)), plant.highest)


def _within(spectrum: Density, highest: float, share: float) -> Density:
    """Return a share of a noise up to a frequency, in a long cycle, whose images lie on one another, as a whole."""
    density = spectrum.density
    spectrum = replaced(spectrum, {"density": lambda w: share**2 * density(w)})
    if math.isinf(highest):
        return spectrum
    ends = spectrum.knots[[0, -1]]
    return replaced(spectrum, {"knots": np.minimum(ends, [0.5 * highest, highest])})


def _with_finders(loop: BudgetLoop, q: FloatArray) -> MultiRate:
    """Return the loop's controllers with the rates that drives find behind the torques."""
    weights = np.array([loop.weights(law) for law in loop.laws if law is not None]).reshape(-1, len(loop.sensors))
    controller = loop.controllers_of(loop.given, q)
    A, B, C, D, dt = controller.fast
    m = len(loop.torquers)
    C = np.insert(C, m, np.zeros((len(weights), len(A))), axis=0)
    D = np.insert(D, m, np.pad(weights, ((0, 0), (0, controller.held))), axis=0)
    return controller._replace(fast=System(A, B, C, D, dt))


def _balancing_plant(loop: BudgetLoop, gains: FrictionGains, q: FloatArray, corner: float | None) -> HybridPlant:
    """Return the model with a further control for each drive, whose input is the rate that it finds.

    Further outputs for each drive: the rate that it finds, as it acts on the bearing; with a `corner` also its sums
    with the bearing's own rate, and with that behind a low-pass.
    """
    pairs = zip(loop.laws, loop.dry, gains.fed, strict=True)
    laws = [(law, one.gimbal, fed) for law, one, fed in pairs if law is not None]
    base = loop.damped(gains, q)
    A, B, C, D, _ = base.plant
    n, m = len(A), base.controls
    columns = [fed * B[:, m + loop.torque_on(gimbal)] for _, gimbal, fed in laws]
    B = np.insert(B, m, np.array(columns).reshape(-1, n), axis=1)
    D = np.insert(D, m, np.zeros((len(laws), len(D))), axis=1)
    own = np.eye(len(laws), B.shape[1], m)
    if corner is None:
        C, D = np.vstack([C, np.zeros((len(laws), n))]), np.vstack([D, own])
    else:
        for row, (_, gimbal, _) in zip(own, laws, strict=True):
            rate = loop.job.platform.gimbal(gimbal)
            seen, direct = A[rate], B[rate]
            behind = np.eye(1, len(A) + 1, len(A))
            C = np.vstack([np.pad(C, ((0, 0), (0, 1))), np.zeros(len(A) + 1), np.append(seen, 0.0), behind])
            A = np.vstack([np.pad(A, ((0, 0), (0, 1))), np.append(corner * seen, -corner)])
            B = np.vstack([B, corner * direct])
            D = np.vstack([D, row, row + direct, row])
    tilted = base.of_integral
    changes = {
        "plant": System(A, B, C, D),
        "controls": m + len(laws),
        "lag": np.append(base.lag, [base.lag[loop.torquers.index(law.torquer)] for law, *_ in laws]),
        "integrated": base.integrated + (False,) * (len(C) - base.measured - base.outputs),
        "of_integral": None if tilted is None else np.pad(tilted, ((0, len(A) - n), (0, 0))),
    }
    return replaced(base, changes)


def prepared(loop: BudgetLoop, at: Balanced) -> tuple[JitterBudget, JitterBudget]:
    """Return the budgets of the sources as if independent and as they are, one where that is the same."""
    plant = loop.damped(at.friction.gains, at.q)
    together = loop.prepared(plant, [*loop.together, *at.rest], loop.budget.exposure)
    if loop.together is loop.apart:
        return together, together
    return loop.prepared(plant, [*loop.apart, *at.rest], loop.budget.exposure), together
