"""Sampled loops seen in continuous time: norms that include what happens between the samples.

::

        w(t) ──►┌───┐──► z(t)
                │ P │
    u(t) ──────►└───┘──► y(t) ──► sampler, period T ──► K ──► hold ──► delay ──► u(t)

A discrete norm looks at the samples alone and can be blind: a ripple at the sample frequency is zero there. Here the
signals of one period are one (infinite-dimensional) sample: the loop is *lifted* and becomes time-invariant. For a
level γ the period is replaced by an equivalent finite-dimensional step, whose norm is below one exactly where the norm
of the sampled-data loop is below γ (Bamieh and Pearson, Systems & Control Letters 18, 1992; Kabamba and Hara, IEEE
Trans. Autom. Control 38, 1993; Chen and Francis, Optimal Sampled-Data Control Systems, 1995).
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np

from platform_ctrl.analysis.arrays import StateArrays, state_arrays, state_scaling
from platform_ctrl.analysis.feedback import performance_loop
from platform_ctrl.analysis.lifting import (
    PeriodExceedsLevel,
    SampledPlant,
    lifted_plant,
    period_noise,
    sampled_plant,
)
from platform_ctrl.analysis.norms import hinf_norm, stationary_covariance
from platform_ctrl.analysis.poles import poles, spectral_radius
from platform_ctrl.common.arguments import within
from platform_ctrl.common.signatures import check_arguments
from platform_ctrl.errors import ArgumentError

if TYPE_CHECKING:
    import control

# ln of the finite number that replaces an infinite norm in the search.
_BEYOND = 50.0


@check_arguments
def intersample_norm(
    P: control.StateSpace,
    K: control.StateSpace,
    nmeas: int,
    ncon: int,
    delay: float = 0.0,
    tolerance: float = 1e-8,
) -> tuple[float, float | None]:
    """Return the L2-induced norm from w(t) to z(t) of a sampled loop, and the frequency where it is reached.

    Parameters
    ----------
    P
        Continuous plant, inputs [w, u], outputs [z, y], the last `ncon` and `nmeas` of them.
    K
        Discrete controller, u = K y, its ``dt`` the sample period; a zero-order hold follows.
    nmeas, ncon
        Number of measurements y and of controls u.
    delay
        From the sample to the time at which the hold's output acts, s; any number >= 0, also a fraction of a period.
    tolerance
        Relative error that is allowed.

    Returns
    -------
    norm, frequency
        The norm in the units of z per unit of w. The frequency, rad/s, lies between 0 and π/T: w and z hold it and all
        its aliases. None where the norm belongs to the inside of a single period, as that of a direct term D11 does.

    Raises
    ------
    ArgumentError
        The loop is not stable, y has a direct path from w (a sampler has no finite norm on L2 without an anti-alias
        filter), or the arguments make no sense.

    References
    ----------
    B. Bamieh, J. B. Pearson, Systems & Control Letters 18, 1992.

    P. T. Kabamba, S. Hara, IEEE Trans. Automatic Control 38, 1993.

    T. Chen, B. A. Francis, Optimal Sampled-Data Control Systems, 1995.
    """
    tolerance = within("intersample_norm: tolerance", tolerance, 1e-12, 0.1)
    plant, controller = _arguments(P, K, nmeas, ncon, delay, "intersample_norm")
    _require_stable(plant, controller, "intersample_norm")
    return norm_of_stable_loop(plant, controller, tolerance)


def norm_of_stable_loop(
    plant: SampledPlant, controller: StateArrays, tolerance: float = 1e-8
) -> tuple[float, float | None]:
    """Return what `intersample_norm` returns for a stable loop of arrays."""
    if plant.B1.shape[1] == 0 or plant.C1.shape[0] == 0:
        return 0.0, 0.0
    peak: dict[float, float] = {}

    def excess(log_level: float) -> float:
        """Ln of the equivalent norm at a level: negative above the norm."""
        level = math.exp(log_level)
        try:
            lifted = lifted_plant(plant, level)
        except PeriodExceedsLevel:
            return _BEYOND
        A, B, C, D, _ = performance_loop(lifted, controller)
        if not np.all(np.isfinite(A)) or not float(spectral_radius(poles(A))) < 1.0:
            return _BEYOND
        norm, frequency = hinf_norm(StateArrays(A, B, C, D, plant.period), True, 1e-10)
        peak[log_level] = frequency
        return min(max(math.log(norm), -_BEYOND), _BEYOND) if norm > 0.0 else -_BEYOND

    # Far above the norm the equivalent norm is proportional to 1/level.
    direct = float(np.linalg.norm(plant.D11, 2))
    size = direct + _size(plant)
    if size == 0.0:
        return 0.0, 0.0
    high = math.log(size)
    while (value := excess(high)) >= 0.0:
        high += min(value, 3.0) + 0.1
    if value <= -_BEYOND and direct == 0.0:
        return 0.0, 0.0
    floor = math.log(direct) if direct > 0.0 else -math.inf
    low, step = high, max(-value, 1e-3)
    while (below := excess(low := max(low - 1.05 * step, floor - 1e-12))) < 0.0:
        high, step = low, max(-below, 1e-3)
        if low < math.log(size) - 600.0:
            return 0.0, 0.0
        if low <= floor:
            return direct, None
    from scipy.optimize import brentq

    root = float(brentq(excess, low, high, xtol=0.25 * tolerance, rtol=8.9e-16))
    # Reported from above, at a level that passes the test.
    for _ in range(60):
        if excess(root) < 0.0:
            break
        root += 0.25 * tolerance
    # Inside a period the equivalent norm jumps from below one to beyond all bounds.
    inside = excess(root - 2.0 * tolerance) >= _BEYOND
    return math.exp(root), None if inside else peak[root]


def intersample_h2(P: control.StateSpace, K: control.StateSpace, nmeas: int, ncon: int, delay: float = 0.0) -> float:
    """Return the H2 norm from w(t) to z(t) of a sampled loop: rms of z in time under white noise of unit density.

    The loop repeats itself with the period: the norm is the mean over the instants of an impulse within it
    (Bamieh and Pearson, IEEE Trans. Autom. Control 37, 1992).

    Parameters
    ----------
    P, K, nmeas, ncon, delay
        As in `intersample_norm`; the delay in s.

    Returns
    -------
    float
        In the units of z per unit of w, times s^-1/2.

    Raises
    ------
    ArgumentError
        As there, and if z has a direct path from w: its norm is infinite.

    References
    ----------
    B. Bamieh, J. B. Pearson, IEEE Trans. Automatic Control 37, 1992.
    """
    plant, controller = _arguments(P, K, nmeas, ncon, delay, "intersample_h2")
    if np.any(plant.D11):
        raise ArgumentError("intersample_h2: D11 must be zero, otherwise the norm from w to z is infinite")
    _require_stable(plant, controller, "intersample_h2")
    # At an infinite level w gains nothing by what it sees: Q and G become the Gramians of the period.
    lifted = lifted_plant(plant, math.inf)
    A, B, C, _, _ = performance_loop(lifted, controller)
    X = stationary_covariance(A, B)
    own = period_noise(plant)
    return math.sqrt(max(0.0, (float(np.trace(C @ X @ C.T)) + own) / plant.period))


def _arguments(
    P: control.StateSpace, K: control.StateSpace, nmeas: int, ncon: int, delay: float, where: str
) -> tuple[SampledPlant, StateArrays]:
    controller = state_arrays(K, f"{where} (K)")
    if not controller.dt > 0.0:
        raise ArgumentError(
            f"{where}: K must be discrete, with the sample period as its dt; design it for the sampled loop"
        )
    plant = sampled_plant(P, nmeas, ncon, controller.dt, delay, where)
    if controller.D.shape != (ncon, nmeas):
        raise ArgumentError(
            f"{where}: K must have nmeas = {nmeas} inputs and ncon = {ncon} outputs, "
            f"got {controller.D.shape[1]} and {controller.D.shape[0]}"
        )
    return plant, controller


def _require_stable(plant: SampledPlant, controller: StateArrays, where: str) -> None:
    try:
        lifted = lifted_plant(plant, math.inf)
    except PeriodExceedsLevel:
        raise ArgumentError(f"{where}: within a period the plant moves too far; take a shorter period") from None
    radius = float(spectral_radius(poles(performance_loop(lifted, controller).A)))
    if not radius < 1.0:
        raise ArgumentError(f"{where}: the sampled loop must be stable, it has a pole at |z| = {radius:.6g}")


def _size(plant: SampledPlant) -> float:
    """A first guess of the norm: what one period does, in balanced states."""
    s = state_scaling(plant.A, plant.B1, plant.C1)
    return float(np.linalg.norm(plant.C1 * s) * np.linalg.norm(plant.B1 / s[:, None])) * plant.period
