"""The convex-concave iterations: from a controller that stabilises to one within the limits, and on to more gain."""

from __future__ import annotations

import time
from collections.abc import Callable

import numpy as np
from numpy.typing import ArrayLike, NDArray

from platform_ctrl.analysis.arrays import ComplexArray
from platform_ctrl.arguments import real_array
from platform_ctrl.design.measured.contour import contour
from platform_ctrl.design.measured.encirclements import unstable_poles
from platform_ctrl.design.measured.limits import Bound, limits_along, ratios
from platform_ctrl.design.measured.pid import basis, controller_response
from platform_ctrl.design.measured.responses import Measured
from platform_ctrl.design.measured.restriction import Restriction, Sample
from platform_ctrl.design.measured.start import candidates
from platform_ctrl.errors import (
    ArgumentError,
    InfeasibleError,
    NotCertifiedError,
    NotStabilisableError,
    TimeLimitError,
    UnscalableError,
)
from platform_ctrl.frozen import FloatArray

# Frequencies of each plant that take part at first; those that turn out to be violated join.
_FIRST = 60
_JOINING = 10
# The gain has risen, or the miss has fallen, by less than these shares in so many steps: it is at its end.
_PROGRESS = 1e-2
_NEARER = 0.01
_PATIENCE = 2
_BROKEN = 1.03
# More than any restriction is missed by.
_ANY_MISS = 1e6
_HALVINGS = 6
_HZ = 1.0 / (2.0 * np.pi)

IndexArray = NDArray[np.intp]
Record = tuple[float, float]


class Search:
    """The plants with their limits, and the steps that improve a controller."""

    def __init__(
        self,
        plants: Measured,
        free: FloatArray,
        filter_time: float,
        asked: dict[str, Bound | None],
        unstable: int,
        integrators: int | None,
        end: float,
    ) -> None:
        self.plants, self.free, self.filter_time = plants, free, filter_time
        self.unstable, self.integrators, self.end = unstable, integrators, end
        # Why the iterations came to their end.
        self.ended = ""
        self.contours = [contour(w, P) for w, P in zip(plants.frequency, plants.response, strict=True)]
        self.samples = [
            Sample(P=path.P, actions=basis(path.s, filter_time, plants.period), limits=limits_along(path, asked))
            for path in self.contours
        ]

    def controller(self, gains: FloatArray) -> Callable[[ComplexArray], ComplexArray]:
        """Return the response of a controller over s."""
        return lambda s: controller_response(gains, basis(s, self.filter_time, self.plants.period))

    def unstable_poles(self, gains: FloatArray) -> tuple[int, ...]:
        """Unstable poles of each closed loop.

        Raises
        ------
        NotCertifiedError
            The data do not decide it.
        """
        return tuple(
            unstable_poles(path, self.controller(gains), self.unstable, self.integrators) for path in self.contours
        )

    def worst(self, gains: FloatArray) -> tuple[float, str, float]:
        """Largest ratio of all limits, which limit, and at what frequency in rad/s."""
        found = []
        for sample, path in zip(self.samples, self.contours, strict=True):
            K = controller_response(gains, sample.actions)
            for limit in sample.limits:
                ratio = ratios(limit, sample.P, K)
                k = int(ratio.argmax())
                found.append((float(ratio[k]), limit.name, float(path.frequency[k])))
        return max(found)

    def start(self, given: ArrayLike | None) -> FloatArray:
        """Return gains that stabilise every plant."""
        n = self.free.shape[-1]
        if given is not None:
            gains = real_array("measured_pid: start", given, (3, n, n))
            if np.any(gains[self.free == 0.0]):
                raise ArgumentError("measured_pid: start has gains that the pattern leaves out; expected zeros there")
            unstable = self.unstable_poles(gains)
            if any(unstable):
                raise NotStabilisableError(
                    f"measured_pid: with the given start the closed loop has {max(unstable)} unstable poles; "
                    f"expected none; "
                    "leave start out, or give weaker gains",
                    self.plants,
                )
            return gains
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
                "measured_pid: none of the weak controllers read from the data is seen to stabilise every plant; "
                "give start, the "
                f"gains (3, {n}, {n}) of one that does{why}",
                self.plants,
            )
        return best[1]

    def improved(self, gains: FloatArray, steps: int) -> tuple[FloatArray, FloatArray]:
        """Return the best gains that were reached within the limits, and the history."""
        active = [np.union1d(_spread(len(path.s), _FIRST), np.flatnonzero(path.residue)) for path in self.contours]
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
            if len(history) > steps or stalled > _PATIENCE:
                worst, name, at = self.worst(gains)
                raise InfeasibleError(
                    f"measured_pid: {name} is {worst:.3g} times its limit at {at * _HZ:.4g} Hz after "
                    f"{len(history) - 1} steps, "
                    "and no step brings every limit nearer; expected at most 1; loosen it, free more gains, or give "
                    "another start",
                    self.plants,
                )
            step = restriction.step(gains, miss=_ANY_MISS, time_limit=self._left())
            gains = self._stable_part(gains, step.gains)
            history.append(self._record(gains))
            stalled = stalled + 1 if step.miss > (1.0 - _NEARER) * last else 0
            last = min(last, step.miss)
        return gains

    def _raised(self, restriction: Restriction, gains: FloatArray, history: list[Record], steps: int) -> FloatArray:
        """Raise the integral gain of a controller that is within the limits."""
        stalled = 0
        self.ended = "no more progress"
        # A limit that breaks between the frequencies that take part ends it: they join first.
        while len(history) <= steps and stalled < _PATIENCE and history[-1][1] < _BROKEN:
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
            stalled = stalled + 1 if history[-1][0] < (1.0 + _PROGRESS) * before else 0
        if len(history) > steps:
            self.ended = "the steps are used up"
        return gains

    def _left(self) -> float:
        left = self.end - time.monotonic()
        if left <= 0.0:
            raise TimeLimitError(
                "measured_pid: the time is over; give a larger time_limit, or fewer steps", self.plants
            )
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
            f"measured_pid: no part of a step is seen to keep the loop stable: {failure}", self.plants
        )

    def _record(self, gains: FloatArray) -> Record:
        return float(np.linalg.svd(gains[1], compute_uv=False)[-1]), self.worst(gains)[0]

    def _joined(self, sample: Sample, index: IndexArray, gains: FloatArray) -> IndexArray:
        """Frequencies that take part, with the worst of those where a limit is violated."""
        worst = _worst_ratios(sample, gains)
        violated = np.flatnonzero(worst > 1.0)
        violated = violated[np.argsort(-worst[violated])][:_JOINING]
        return np.union1d(index, violated)


def _worst_ratios(sample: Sample, gains: FloatArray) -> FloatArray:
    K = controller_response(gains, sample.actions)
    return np.asarray(np.max([ratios(limit, sample.P, K) for limit in sample.limits], axis=0), dtype=np.float64)


def _spread(N: int, most: int) -> IndexArray:
    return np.asarray(np.unique(np.linspace(0, N - 1, min(N, most)).round()), dtype=np.intp)
