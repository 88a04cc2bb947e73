"""The PID matrices with the largest integral gain within limits at every frequency of measured responses.

The least singular value of Ki is maximised: at low frequencies the angle answers a torque disturbance with ‖P S‖ → ω
‖Ki⁻¹‖, whatever the plant. Convex-concave procedure (Boyd, Hast and Åström, Int. J. Robust Nonlinear Control 26, 2016):
from a controller that stabilises first the limits are approached, then the gain is raised, each step a convex problem
within the limits (see `convex_step`). The result is a local optimum.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from itertools import product
from typing import Any

import numpy as np

from platform_ctrl.analysis.feedback import sensitivities_of_plants
from platform_ctrl.analysis.singular_values import largest_singular_values
from platform_ctrl.analysis.system import ComplexArray, System
from platform_ctrl.common.values import FloatArray, value
from platform_ctrl.design.convex_step import OF_ANGLE, Sample, actions, controller_response, convex_step, realisation
from platform_ctrl.design.responses import Contour, Controller, contour, unstable_poles
from platform_ctrl.errors import DesignError, InfeasibleError, NotCertifiedError, NotStabilisableError, UnscalableError

_HZ = 1.0 / (2.0 * np.pi)
# Between which values limits make sense.
_RANGES = {
    "sensitivity_peak": (1.0, np.inf),
    "complementary_sensitivity_peak": (1.0, np.inf),
    "disk_margin": (0.0, 2.0),
    "torque_per_noise": (0.0, np.inf),
    "resonance_damping": (0.0, 1.0),
}
# Longest time of one convex problem, s.
_TIME_LIMIT = 300.0

# Starts: dead times that are tried; d over the largest rate that dead time and data allow; ωc over d; ωi over ωc.
_DELAYS = 60
_RATES = np.geomspace(1.0, 1e-3, 10)
_CROSSOVERS = (0.4, 0.2, 0.1)
_INTEGRAL = 0.1
# Number of frequencies of each plant in the first problem, and of those with violated limits that are added at a time.
_FIRST_FREQUENCIES = 60
_ADDED_FREQUENCIES = 10
# The search ends where the gain rises, or the violation falls, by less than these shares in so many steps.
_LEAST_GAIN_RISE = 1e-2
_LEAST_MISS_FALL = 0.01
_STALLED_STEPS = 2
# A violation between the frequencies above which these are added before the search goes on; more than any violation.
_VIOLATED, _LARGEST_MISS = 1.03, 1e6
_HALVINGS = 6


@value
class MeasuredDesign:
    """A controller designed from measured responses, and what it does there."""

    controller: System  # u = K y, sampled
    gains: FloatArray  # (3, n, n): Kp, N m/rad, Ki, N m/(rad s), and Kd, N m s/rad
    steps: int  # convex problems that were solved
    unstable_poles: tuple[int, ...]  # of the closed loop with each plant, by the generalised Nyquist criterion: all 0
    # Largest ‖K S‖, N m/rad, and ‖T‖ at the measured frequencies, by the names of their limits.
    peaks: dict[str, float]

    @property
    def objective(self) -> float:
        """Least singular value of Ki, N m/(rad s)."""
        return _least(self.gains[1])


def measured_pid(
    data: Sequence[tuple[FloatArray, ComplexArray]],
    period: float,
    limits: Mapping[str, float],
    *,
    filter_time: float,
    unstable: int = 0,
    steps: int = 100,
) -> MeasuredDesign:
    """Return the PID controller with the largest integral gain that keeps every limit at every measured frequency.

    Parameters
    ----------
    data
        Of each plant that the controller has to serve the frequencies (N,), rad/s, rising to at most half the sample
        rate, and its response there (N, n, n), from torques to angles, as the sampled controller sees it.
    period
        Of the controller, s.
    limits
        ``sensitivity_peak``, always, and ``complementary_sensitivity_peak``, ``disk_margin``, ``torque_per_noise``, the
        largest ‖K S‖, N m/rad, ``resonance_damping``: the damping ratio that a resonance that the data do not resolve
        gets. Without it nothing keeps the controller from cancelling nutation by a zero in place of damping it.
    filter_time
        Of the rate action, s.
    unstable
        Number of unstable poles of each plant.
    steps
        Most convex problems to be solved.

    Raises
    ------
    DesignError
        A limit makes no sense.
    NotStabilisableError
        No stabilising start was found.
    InfeasibleError
        The procedure does not get within the limits; the message says which one fails, and where.
    NotCertifiedError
        The data do not decide whether the loop is stable.
    TimeLimitError
        A convex problem takes too long.
    """
    for name, limit in limits.items():
        least, most = _RANGES[name]
        if not least < limit < most:
            raise DesignError(f"measured_pid: {name} must be between {least:g} and {most:g}, got {limit:g}", data)
    search = _Search(data, period, limits, filter_time, unstable)
    gains, taken = search.improved(search.start(), steps)
    worst, name, at = search.worst(gains)
    counts = search.unstable_poles(gains)
    if worst > 1.0 or any(counts):
        words = f"{name} is {worst:.6g} times its limit at {at * _HZ:.4g} Hz, with {max(counts)} unstable poles"
        raise NotCertifiedError(f"measured_pid: {words}; give more steps", data)
    noise, T = [], []
    for path, sample in zip(search.contours, search.samples, strict=True):
        measured = sample.only(np.flatnonzero(path.residue == 0.0))
        K = controller_response(gains, measured.actions)
        S = sensitivities_of_plants(measured.P, K)[0]
        noise.append(largest_singular_values(K @ S).max())
        T.append(largest_singular_values(np.eye(S.shape[-1]) - S).max())
    return MeasuredDesign(
        controller=realisation(gains, filter_time, period),
        gains=gains,
        steps=taken,
        unstable_poles=counts,
        peaks={"torque_per_noise": float(max(noise)), "complementary_sensitivity_peak": float(max(T))},
    )


def candidates(frequency: FloatArray, P: ComplexArray) -> Iterator[FloatArray]:
    """Yield gains (3, n, n) that may stabilise, strong ones first: weak cross-axis loops for the mechanics in P.

    M q̈ + G q̇ + K q = Q behind a dead time is fitted to P (N, n, n) by least squares of the relative error.
    """
    inside = frequency <= 0.5 * frequency[-1]
    w, H = frequency[inside], P[inside]
    dead_times = np.linspace(0.0, 2.0 * np.pi / frequency[-1], _DELAYS)
    _, (dead_time, M, G, K) = min((_mechanics(w, H, tau) for tau in dead_times), key=lambda one: one[0])
    fastest = 1.0 / max(dead_time, 3.0 / frequency[-1])
    for rate, share in product(_RATES, _CROSSOVERS):
        d = rate * fastest
        crossover = share * d
        slow = (G + d * M) * crossover
        yield np.array([-slow, -_INTEGRAL * crossover * (slow + K), -d * M])
    # A plant at rest under integral action alone.
    at_rest = np.linalg.pinv(P[0].real)
    for rate in _RATES:
        yield np.array([0.0 * at_rest, -rate * frequency[-1] * at_rest, 0.0 * at_rest])


def _mechanics(w: FloatArray, H: ComplexArray, dead_time: float) -> tuple[float, tuple[float, Any, Any, Any]]:
    """Return the error of the fit with a dead time, relative rms, and the dead time with M, G (gyros, friction), K."""
    n = H.shape[-1]
    turned = H * np.exp(1j * w * dead_time)[:, None, None]
    # P e^{jωτ} (−ω² M + jω G + K) = I, column by column of the unknown matrices; ω in units of the highest.
    unit = w[-1]
    x = (w / unit)[:, None, None]
    rows = np.concatenate([-(x**2) * turned, 1j * x * turned, turned], axis=-1).reshape(-1, 3 * n)
    right = np.tile(np.eye(n), (len(w), 1))
    A = np.concatenate([rows.real, rows.imag])
    b = np.concatenate([right, np.zeros_like(right)])
    size = np.linalg.norm(A, axis=0)
    found = np.linalg.lstsq(A / size, b, rcond=None)[0] / size[:, None]
    M, G, K = found[:n] / unit**2, found[n : 2 * n] / unit, found[2 * n :]
    return float(np.linalg.norm(A @ found - b)), (dead_time, 0.5 * (M + M.T), G, K)


def _limits_along(path: Contour, limits: Mapping[str, float]) -> dict[str, FloatArray]:
    """Return the limits along the contour of a plant; of disk margins their inverse, as of ‖S − I/2‖."""
    out = {}
    for name, m in limits.items():
        bound = np.full(len(path.s), 1.0 / m if name == "disk_margin" else m)
        if name == OF_ANGLE:
            bound = np.where(path.residue > 0.0, path.residue / (m * path.frequency), np.inf)
        if np.isfinite(bound).any():
            out[name] = bound
    return out


class _Search:
    """The plants with their limits, and the steps that improve a controller."""

    def __init__(
        self,
        data: Sequence[tuple[FloatArray, ComplexArray]],
        period: float,
        limits: Mapping[str, float],
        filter_time: float,
        unstable: int,
    ) -> None:
        self.data, self.period, self.filter_time, self.unstable = data, period, filter_time, unstable
        self.n = data[0][1].shape[-1]
        self.contours = [contour(w, P) for w, P in data]
        self.samples = [
            Sample(P=path.P, actions=actions(path.s, filter_time, period), limits=_limits_along(path, limits))
            for path in self.contours
        ]

    def unstable_poles(self, gains: FloatArray) -> tuple[int, ...]:
        """Return the number of unstable poles of each closed loop."""
        K: Controller = lambda s: controller_response(gains, actions(s, self.filter_time, self.period))  # noqa: E731
        return tuple(unstable_poles(path, K, self.unstable) for path in self.contours)

    def worst(self, gains: FloatArray) -> tuple[float, str, float]:
        """Return the largest ratio of all limits, the limit's name, and the frequency in rad/s."""
        found = []
        for sample, path in zip(self.samples, self.contours, strict=True):
            for name, ratio in sample.ratios(gains).items():
                k = int(ratio.argmax())
                found.append((float(ratio[k]), name, float(path.frequency[k])))
        return max(found)

    def start(self) -> FloatArray:
        """Return gains that stabilise every plant."""
        best: tuple[float, FloatArray] | None = None
        undecided: NotCertifiedError | None = None
        for gains in (gains for w, P in self.data for gains in candidates(w, P)):
            if np.linalg.matrix_rank(gains[1]) < self.n:
                continue
            worst = self.worst(gains)[0]
            if best is not None and worst >= best[0]:
                continue
            try:
                if not any(self.unstable_poles(gains)):
                    best = (worst, gains)
            except NotCertifiedError as error:
                undecided = undecided or error
        if best is None:
            why = f"; for the strongest one: {undecided}" if undecided else ""
            raise NotStabilisableError(
                f"measured_pid: no weak controller derived from the data provably stabilises every plant{why}",
                self.data,
            )
        return best[1]

    def improved(self, gains: FloatArray, steps: int) -> tuple[FloatArray, int]:
        """Return the best gains that were reached within the limits, and the number of steps."""
        active = []
        for path in self.contours:
            first = np.unique(np.linspace(0, len(path.s) - 1, min(len(path.s), _FIRST_FREQUENCIES)).round())
            active.append(np.union1d(first.astype(np.intp), np.flatnonzero(path.residue)))
        taken = 0
        while True:
            chosen = [sample.only(index) for sample, index in zip(self.samples, active, strict=True)]
            gains, taken = self._within(chosen, gains, taken, steps)
            gains, taken = self._raised(chosen, gains, taken, steps)
            # The worst frequencies at which a limit is violated take part from now on.
            before, active = active, []
            for sample, index in zip(self.samples, before, strict=True):
                worst = sample.worst(gains)
                violated = np.flatnonzero(worst > 1.0)
                active.append(np.union1d(index, violated[np.argsort(-worst[violated])][:_ADDED_FREQUENCIES]))
            if all(len(new) == len(old) for new, old in zip(active, before, strict=True)):
                return gains, taken

    def _within(self, chosen: Sequence[Sample], gains: FloatArray, taken: int, steps: int) -> tuple[FloatArray, int]:
        """Bring a controller within the limits."""
        stalled, last = 0, np.inf
        while max(float(sample.worst(gains).max()) for sample in chosen) > 1.0:
            if taken >= steps or stalled > _STALLED_STEPS:
                worst, name, at = self.worst(gains)
                raise InfeasibleError(
                    f"measured_pid: {name} is {worst:.3g} times its limit at {at * _HZ:.4g} Hz after {taken} steps, "
                    "and no step reduces it; loosen it",
                    self.data,
                )
            new, miss = self._step(chosen, gains, _LARGEST_MISS)
            gains, taken = self._stable_part(gains, new), taken + 1
            stalled = stalled + 1 if miss > (1.0 - _LEAST_MISS_FALL) * last else 0
            last = min(last, miss)
        return gains, taken

    def _raised(self, chosen: Sequence[Sample], gains: FloatArray, taken: int, steps: int) -> tuple[FloatArray, int]:
        """Raise the integral gain of a controller that is within the limits."""
        stalled = 0
        # A limit that breaks between the frequencies that take part ends it: they join first.
        while taken < steps and stalled < _STALLED_STEPS and self.worst(gains)[0] < _VIOLATED:
            try:
                new = self._step(chosen, gains, 0.0)[0]
            except UnscalableError:
                # The present controller is within the limits: it stays, if the gain was raised at all.
                if not taken:
                    raise
                return gains, taken
            before, gains, taken = _least(gains[1]), self._stable_part(gains, new), taken + 1
            stalled = stalled + 1 if _least(gains[1]) < (1.0 + _LEAST_GAIN_RISE) * before else 0
        return gains, taken

    def _step(self, chosen: Sequence[Sample], gains: FloatArray, miss: float) -> tuple[FloatArray, float]:
        return convex_step(chosen, gains, miss=miss, time_limit=_TIME_LIMIT, problem=self.data)

    def _stable_part(self, old: FloatArray, new: FloatArray) -> FloatArray:
        """Go from `old` as far towards `new` as the loop stays stable between the frequencies that take part."""
        failure = ""
        for k in range(_HALVINGS):
            trial = old + 0.5**k * (new - old)
            try:
                if not any(self.unstable_poles(trial)):
                    return trial
                failure = "the closed loop is unstable"
            except NotCertifiedError as error:
                failure = str(error)
        raise NotCertifiedError(f"measured_pid: no part of a step provably keeps the loop stable: {failure}", self.data)


def _least(matrix: FloatArray) -> float:
    """Return the least singular value."""
    return float(np.linalg.svd(matrix, compute_uv=False)[-1])
