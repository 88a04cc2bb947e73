"""The measured plants, and the convex-concave iterations on them.

From a controller that stabilises to one within the limits, and on to more gain.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Sequence
from itertools import product
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from platform_ctrl.analysis.system import ComplexArray
from platform_ctrl.common.arguments import short
from platform_ctrl.common.values import FloatArray, value
from platform_ctrl.design.measured.responses import contour, unstable_poles
from platform_ctrl.design.measured.restriction import (
    Restriction,
    Sample,
    basis,
    controller_response,
    limits_along,
    ratios,
)
from platform_ctrl.errors import (
    ArgumentError,
    InfeasibleError,
    NotCertifiedError,
    NotStabilisableError,
    TimeLimitError,
    UnscalableError,
)

if TYPE_CHECKING:
    import control

FEWEST_POINTS = 10


@value
class MeasuredPlants:
    """Frequency responses of one plant, or of several that one controller has to serve."""

    frequency: tuple[FloatArray, ...]  # tuple of (N_k,): rad/s, rising, of every plant
    response: tuple[ComplexArray, ...]  # tuple of complex (N_k, n, n): torques to angles, dead time and hold included
    # torques, angles: names of the signals.
    torques: tuple[str, ...]
    angles: tuple[str, ...]
    period: float  # of the controller, s


def measured_plants(measurement: control.FRD | Sequence[control.FRD]) -> MeasuredPlants:
    """Return the responses of sampled plants as the controller sees them."""
    several: list[Any] = list(measurement) if isinstance(measurement, list | tuple) else [measurement]
    frequency, response = [], []
    for k, one in enumerate(several, 1):
        where = "measured_pid: the measurement" if len(several) == 1 else f"measured_pid: measurement {k}"
        w, H, dt = _arrays(one, where)
        first = several[0]
        names = (list(one.input_labels), list(one.output_labels), dt)
        if names != (list(first.input_labels), list(first.output_labels), float(first.dt)):
            raise ArgumentError(f"{where} must have the inputs, outputs and period of the first one")
        if H.shape[1] != H.shape[2]:
            raise ArgumentError(f"{where} must have as many outputs as inputs, got {H.shape[1]} and {H.shape[2]}")
        inside = w <= np.pi / dt * (1.0 + 1e-9)
        w, H = w[inside], H[inside]
        if len(w) < FEWEST_POINTS:
            raise ArgumentError(
                f"{where} must have {FEWEST_POINTS} or more frequencies below half the sample rate, got {len(w)}"
            )
        if not np.all(np.abs(H).max(axis=(1, 2)) > 0.0):
            raise ArgumentError(f"{where} must have a response in rad/(N m) that is not zero at any frequency")
        frequency.append(w)
        response.append(H)
    return MeasuredPlants(
        frequency=tuple(frequency),
        response=tuple(response),
        torques=tuple(several[0].input_labels),
        angles=tuple(several[0].output_labels),
        period=dt,
    )


def _arrays(one: control.FRD, where: str) -> tuple[FloatArray, ComplexArray, float]:
    try:
        H, w, dt = np.asarray(one.frdata), np.asarray(one.omega, dtype=np.float64), one.dt
    except AttributeError:
        raise ArgumentError(
            f"{where} must be a control.FRD, see read_measurement, got {short(type(one).__name__)}"
        ) from None
    if dt is True or not dt:
        raise ArgumentError(f"{where} must be that of the sampled plant, its hold included; give its period dt in s")
    if not (np.all(np.isfinite(H)) and np.all(np.isfinite(w)) and np.all(np.diff(w) > 0.0) and w[0] >= 0.0):
        raise ArgumentError(f"{where} must be finite, with frequencies that rise from >= 0")
    kept = w > 0.0
    return w[kept], np.asarray(np.moveaxis(H[:, :, kept], -1, 0), dtype=np.complex128), float(dt)


_DELAYS = 60
# d over the largest rate that dead time and data allow; ωc over d; ωi over ωc.
_RATES = np.geomspace(1.0, 1e-3, 10)
_CROSSOVERS = (0.4, 0.2, 0.1)
_INTEGRAL = 0.1


@value
class Mechanics:
    """M q̈ + G q̇ + K q = Q delayed by `dead_time`, fitted."""

    # M, G, K: (n, n): inertia, gyroscopic action with friction, stiffness.
    M: FloatArray
    G: FloatArray
    K: FloatArray
    dead_time: float  # s
    error: float  # rms of P P_fit⁻¹ − I


def fitted_mechanics(frequency: FloatArray, P: ComplexArray) -> Mechanics:
    """Return the mechanics fitted to P (N, n, n), by least squares of the relative error."""
    inside = frequency <= 0.5 * frequency[-1]
    w, H = frequency[inside], P[inside]
    return min(
        (_fit(w, H, tau) for tau in np.linspace(0.0, 2.0 * np.pi / frequency[-1], _DELAYS)), key=lambda m: m.error
    )


def _fit(w: FloatArray, H: ComplexArray, dead_time: float) -> Mechanics:
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
    error = float(np.linalg.norm(A @ found - b) / np.sqrt(len(w) * n))
    M, G, K = found[:n] / unit**2, found[n : 2 * n] / unit, found[2 * n :]
    return Mechanics(M=0.5 * (M + M.T), G=G, K=K, dead_time=dead_time, error=error)


def candidates(frequency: FloatArray, P: ComplexArray) -> Iterator[FloatArray]:
    """Yield gains (3, n, n) that may stabilise, strong ones first."""
    fit = fitted_mechanics(frequency, P)
    fastest = 1.0 / max(fit.dead_time, 3.0 / frequency[-1])
    for rate, share in product(_RATES, _CROSSOVERS):
        d = rate * fastest
        crossover = share * d
        slow = (fit.G + d * fit.M) * crossover
        yield np.array([-slow, -_INTEGRAL * crossover * (slow + fit.K), -d * fit.M])
    # A plant at rest under integral action alone.
    at_rest = np.linalg.pinv(P[0].real)
    for rate in _RATES:
        yield np.array([0.0 * at_rest, -rate * frequency[-1] * at_rest, 0.0 * at_rest])


# Number of frequencies of each plant in the first problem, and of those with violated limits that are added at a time.
_FIRST_FREQUENCIES = 60
_ADDED_FREQUENCIES = 10
# The search ends where the gain rises, or the violation falls, by less than these shares in so many steps.
_LEAST_GAIN_RISE = 1e-2
_LEAST_MISS_FALL = 0.01
_STALLED_STEPS = 2
# A violation between the frequencies above which these are added before the search goes on.
_VIOLATED = 1.03
# More than any violation.
_LARGEST_MISS = 1e6
_HALVINGS = 6
_HZ = 1.0 / (2.0 * np.pi)

IndexArray = NDArray[np.intp]
Record = tuple[float, float]


class PIDSearch:
    """The plants with their limits, and the steps that improve a controller."""

    def __init__(
        self,
        plants: MeasuredPlants,
        free: FloatArray,
        filter_time: float,
        requested: dict[str, float],
        unstable: int,
        end: float,
    ) -> None:
        self.plants, self.free, self.filter_time = plants, free, filter_time
        self.unstable, self.end = unstable, end
        # Why the iterations ended.
        self.ended = ""
        self.contours = [contour(w, P) for w, P in zip(plants.frequency, plants.response, strict=True)]
        self.samples = [
            Sample(P=path.P, actions=basis(path.s, filter_time, plants.period), limits=limits_along(path, requested))
            for path in self.contours
        ]

    def controller(self, gains: FloatArray) -> Callable[[ComplexArray], ComplexArray]:
        """Return the response of a controller over s."""
        return lambda s: controller_response(gains, basis(s, self.filter_time, self.plants.period))

    def unstable_poles(self, gains: FloatArray) -> tuple[int, ...]:
        """Return the number of unstable poles of each closed loop."""
        return tuple(unstable_poles(path, self.controller(gains), self.unstable) for path in self.contours)

    def worst(self, gains: FloatArray) -> tuple[float, str, float]:
        """Return the largest ratio of all limits, the limit's name, and the frequency in rad/s."""
        found = []
        for sample, path in zip(self.samples, self.contours, strict=True):
            K = controller_response(gains, sample.actions)
            for limit in sample.limits:
                ratio = ratios(limit, sample.P, K)
                k = int(ratio.argmax())
                found.append((float(ratio[k]), limit.name, float(path.frequency[k])))
        return max(found)

    def start(self) -> FloatArray:
        """Return gains that stabilise every plant."""
        n = self.free.shape[-1]
        best: tuple[float, FloatArray] | None = None
        undecided: NotCertifiedError | None = None
        for w, P in zip(self.plants.frequency, self.plants.response, strict=True):
            for candidate in candidates(w, P):
                gains = candidate * self.free
                if np.linalg.matrix_rank(gains[1]) < n:
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
                self.plants,
            )
        return best[1]

    def improved(self, gains: FloatArray, steps: int) -> tuple[FloatArray, FloatArray]:
        """Return the best gains that were reached within the limits, and the history."""
        active = [
            np.union1d(_spread(len(path.s), _FIRST_FREQUENCIES), np.flatnonzero(path.residue)) for path in self.contours
        ]
        history = [self._record(gains)]
        while True:
            chosen = [sample.only(index) for sample, index in zip(self.samples, active, strict=True)]
            restriction = Restriction(chosen, self.free, self.plants)
            gains = self._within(restriction, chosen, gains, history, steps)
            gains = self._raised(restriction, gains, history, steps)
            joined = [self._joined(sample, index, gains) for sample, index in zip(self.samples, active, strict=True)]
            if all(len(new) == len(old) for new, old in zip(joined, active, strict=True)):
                return gains, np.array(history)
            active = joined

    def _within(
        self, restriction: Restriction, chosen: list[Sample], gains: FloatArray, history: list[Record], steps: int
    ) -> FloatArray:
        """Bring a controller within the limits."""
        stalled, last = 0, np.inf
        while max(float(_worst_ratios(sample, gains).max()) for sample in chosen) > 1.0:
            if len(history) > steps or stalled > _STALLED_STEPS:
                worst, name, at = self.worst(gains)
                raise InfeasibleError(
                    f"measured_pid: {name} is {worst:.3g} times its limit at {at * _HZ:.4g} Hz after "
                    f"{len(history) - 1} steps, and no step reduces it; loosen it, or free more gains",
                    self.plants,
                )
            step = restriction.step(gains, miss=_LARGEST_MISS, time_limit=self._left())
            gains = self._stable_part(gains, step.gains)
            history.append(self._record(gains))
            stalled = stalled + 1 if step.miss > (1.0 - _LEAST_MISS_FALL) * last else 0
            last = min(last, step.miss)
        return gains

    def _raised(self, restriction: Restriction, gains: FloatArray, history: list[Record], steps: int) -> FloatArray:
        """Raise the integral gain of a controller that is within the limits."""
        stalled = 0
        self.ended = "no more progress"
        # A limit that breaks between the frequencies that take part ends it: they join first.
        while len(history) <= steps and stalled < _STALLED_STEPS and history[-1][1] < _VIOLATED:
            before = history[-1][0]
            try:
                found = restriction.step(gains, miss=0.0, time_limit=self._left()).gains
            except UnscalableError:
                # The present controller is within the limits: it stays, if the gain was raised at all.
                if len(history) == 1:
                    raise
                self.ended = "the solver gave up"
                return gains
            gains = self._stable_part(gains, found)
            history.append(self._record(gains))
            stalled = stalled + 1 if history[-1][0] < (1.0 + _LEAST_GAIN_RISE) * before else 0
        if len(history) > steps:
            self.ended = "the steps are used up"
        return gains

    def _left(self) -> float:
        left = self.end - time.monotonic()
        if left <= 0.0:
            raise TimeLimitError("measured_pid: time_limit is exceeded; give a larger one, or fewer steps", self.plants)
        return left

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
        raise NotCertifiedError(
            f"measured_pid: no part of a step provably keeps the loop stable: {failure}", self.plants
        )

    def _record(self, gains: FloatArray) -> Record:
        return float(np.linalg.svd(gains[1], compute_uv=False)[-1]), self.worst(gains)[0]

    def _joined(self, sample: Sample, index: IndexArray, gains: FloatArray) -> IndexArray:
        """Frequencies that take part, with the worst of those where a limit is violated."""
        worst = _worst_ratios(sample, gains)
        violated = np.flatnonzero(worst > 1.0)
        violated = violated[np.argsort(-worst[violated])][:_ADDED_FREQUENCIES]
        return np.union1d(index, violated)


def _worst_ratios(sample: Sample, gains: FloatArray) -> FloatArray:
    K = controller_response(gains, sample.actions)
    return np.asarray(np.max([ratios(limit, sample.P, K) for limit in sample.limits], axis=0), dtype=np.float64)


def _spread(N: int, most: int) -> IndexArray:
    return np.asarray(np.unique(np.linspace(0, N - 1, min(N, most)).round()), dtype=np.intp)
