"""Which accelerations of a subsystem may be dropped: candidates, each held against the full equations."""

from __future__ import annotations

import numpy as np

from platform_ctrl.frozen import FloatArray, value
from platform_ctrl.precession.reduction import ComplexArray, Reduction, Scaled, full_poles
from platform_ctrl.precession.restraint import holds, is_regular, least_opposed_first, slowest
from platform_ctrl.precession.trial import Trial, tried


@value
class Choice:
    """The pure model of a subsystem, and the one that cures it.

    Attributes
    ----------
    scaled
        The equations that both are made of.
    held
        Whether momentum, dampers or springs oppose motion in every direction, so that none needs its inertia.
    pure
        The model without momenta, or None where it has no unique solution.
    cured
        The one with as few momenta as it takes; the pure one where that is none.
    trial
        Of the pure model; where not all directions are held, of the one that keeps the momenta of the others.
    """

    scaled: Scaled
    held: bool
    pure: Reduction | None
    cured: Reduction
    trial: Trial


def chosen(at: Scaled, null: FloatArray, turning: bool, loop_frequency: float, required: float) -> Choice:
    """Return the models of a subsystem whose G leaves the directions `null` alone, and which has a rotor `turning`."""
    n, none = len(at.D), null[:, :0]
    poles = full_poles(at)
    # What gives way first stands first.
    order = least_opposed_first(at, null)
    unopposed = null.shape[1] if turning else n
    fast = required * loop_frequency
    # Without a rotor nothing precesses, and without a loop there is nothing that a restraint has to be faster than.
    restrainable = turning and fast > 0.0
    damped = unopposed == 0 or slowest(null.T @ at.D @ null) > fast
    least = 0 if restrainable and damped else unopposed
    # Springs do not stand in for a gyroscopic pair: without any motion there is no precession.
    most = n if unopposed == n else n - 1
    candidates = [
        Reduction(N=none, H=order[:, :h])
        for h in range(least, most + 1)
        if restrainable and holds(at, order[:, :h], order[:, h:], fast)
    ]
    trials = [tried(at, candidate, poles, loop_frequency) for candidate in candidates]
    if trials:
        good = next((k for k, trial in enumerate(trials) if not trial.obstacles(required)), 0)
        pure: Reduction | None = candidates[good]
        trial, cured = trials[good], candidates[good]
    else:
        pure = Reduction(N=none, H=none) if is_regular(at, np.eye(n)) else None
        cured = Reduction(N=order[:, :least], H=none)
        trial = tried(at, cured, poles, loop_frequency)
    if not trials or trial.obstacles(required):
        cured = _cured(at, order, max(least, 1), poles, loop_frequency, required)
    return Choice(scaled=at, held=bool(trials), pure=pure, cured=cured, trial=trial)


def _cured(
    at: Scaled, order: FloatArray, least: int, poles: ComplexArray, loop_frequency: float, required: float
) -> Reduction:
    """Return the model with the fewest momenta, at least `least`, that nothing speaks against."""
    for k in range(least, len(order)):
        kept = Reduction(N=order[:, :k], H=order[:, :0])
        if is_regular(at, order[:, k:]) and not tried(at, kept, poles, loop_frequency).obstacles(required):
            return kept
    # With all momenta nothing is dropped.
    return Reduction(N=order, H=order[:, :0])
