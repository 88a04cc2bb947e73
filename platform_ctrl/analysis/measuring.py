"""How a metric of a loop is measured: on a grid of frequencies for a search, exactly for a verdict.

Each class has `values`, the values of some plants, on the grid where it needs one. Where a grid may miss the worst,
`exact` takes the value of one plant over all frequencies, and `holds` shows that a plant's value is no worse than a
bound without computing it.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Protocol

import numpy as np

from platform_ctrl.analysis.loop import Indices, Loop
from platform_ctrl.analysis.margins import margins_of_channel
from platform_ctrl.analysis.norms import LEVEL, WHOLE, Band, bandwidth_of_response, drifting_rms, gains, noise_rms
from platform_ctrl.analysis.poles import continuous_poles, poles, resonances
from platform_ctrl.analysis.sight import contrast_of
from platform_ctrl.analysis.system import System
from platform_ctrl.analysis.transfers import SENSITIVITIES, Parts
from platform_ctrl.common.values import FloatArray, value


class RequestedMetric(Protocol):
    """A metric to be measured, with its options."""

    @property
    def kind(self) -> str:
        """Key of `METRICS`."""

    @property
    def over(self) -> Sequence[str]:
        """Groups of plants."""

    @property
    def frequency(self) -> float | None:
        """Edge of a band, rad/s."""

    @property
    def lowest(self) -> float:
        """Where a band that ends there begins, rad/s."""


@value
class MetricRequest:
    """A metric with its options, without a limit."""

    kind: str
    over: tuple[str, ...] = ("nominal",)
    frequency: float | None = None
    lowest: float = 0.0


class Measure:
    """How a metric is measured."""

    def values(self, loops: Loop, request: RequestedMetric, members: Indices) -> FloatArray:
        """Return the values of some plants, (k,), in SI units, or of the controller alone, (1,), for a search."""
        raise NotImplementedError

    def exact(self, loops: Loop, request: RequestedMetric, k: int) -> float:
        """Return the value of plant `k` over all frequencies, to 1e-9 from the worse side, in SI units."""
        return float(self.values(loops, request, np.array([k]))[0])

    def holds(self, loops: Loop, request: RequestedMetric, k: int, bound: float) -> bool:
        """Return whether the value of the stable plant `k` is shown to be no worse than a bound."""
        return False


@value
class Direct(Measure):
    """Measured in one step, of poles or covariances."""

    # return the value of every plant, (N,), or of the controller, (1,), in SI units
    function: Callable[[Loop], FloatArray]

    def values(self, loops: Loop, request: RequestedMetric, members: Indices) -> FloatArray:
        """Return the values of some plants, (k,); of the controller alone (1,)."""
        every = self.function(loops)
        return every if len(every) == 1 else every[members]


@value
class Peak(Measure):
    """The largest gain over frequency of some parts of the closed loop."""

    transfers: Parts  # the parts
    reciprocal: bool = False  # whether the metric is 1/peak
    banded: bool = False  # whether the peak is taken from the lowest up to the frequency of the request, if it has one

    def values(self, loops: Loop, request: RequestedMetric, members: Indices) -> FloatArray:
        """Return the values of some plants on the grid, (k,): never worse than they are."""
        return self._of_peak(loops.grid_peaks(*self._of(request), members))

    def exact(self, loops: Loop, request: RequestedMetric, k: int) -> float:
        """Return the value of plant `k` over all frequencies."""
        return float(self._of_peak(np.array([loops.peak(*self._of(request), k)[0]]))[0])

    def holds(self, loops: Loop, request: RequestedMetric, k: int, bound: float) -> bool:
        """Return whether the value of the stable plant `k` is shown to be no worse than a bound."""
        return loops.below(*self._of(request), k, 1.0 / bound if self.reciprocal else bound)

    def _of(self, request: RequestedMetric) -> tuple[Parts, Band]:
        band = (request.lowest, request.frequency) if self.banded and request.frequency is not None else WHOLE
        return self.transfers, band

    def _of_peak(self, peaks: FloatArray) -> FloatArray:
        if not self.reciprocal:
            return peaks
        with np.errstate(divide="ignore"):
            return np.where(np.isfinite(peaks), 1.0 / peaks, 0.0)


@value
class Bandwidth(Measure):
    """The lowest frequency, rad/s, at which the largest singular value of S reaches 1/√2; 0 of an unstable loop."""

    def values(self, loops: Loop, request: RequestedMetric, members: Indices) -> FloatArray:
        """Return the values of some plants on the grid, rad/s, (k,)."""
        return np.array([self._on_grid(loops, int(k)) for k in members])

    def exact(self, loops: Loop, request: RequestedMetric, k: int) -> float:
        """Return the value of plant `k`, rad/s, from below."""
        return loops.bandwidth(k)

    def holds(self, loops: Loop, request: RequestedMetric, k: int, bound: float) -> bool:
        """Return whether S of the stable plant `k` is shown to stay below the level up to `bound`."""
        return loops.below(SENSITIVITIES, (0.0, bound), k, LEVEL)

    def _on_grid(self, loops: Loop, k: int) -> float:
        if not loops.decay[k] > 0.0:
            return 0.0
        frequency = loops.plants.frequency
        found = min(bandwidth_of_response(frequency, S[k]) for S in loops.sensitivities)
        w = loops.narrow.get(k, np.zeros(0))
        high = [w[gains(part, w) >= LEVEL] for part in loops.parts(SENSITIVITIES, k)] if w.size else []
        return min([found, *(float(part.min(initial=np.inf)) for part in high)])


@value
class ControllerGain(Measure):
    """The largest gain of the controller from a frequency on."""

    def values(self, loops: Loop, request: RequestedMetric, members: Indices) -> FloatArray:
        """Return the value on the grid, (1,)."""
        K, start = loops.controller, self._start(loops, request)
        own = resonances(continuous_poles(poles(K.A), K.dt))
        w = np.concatenate([loops.plants.frequency, own, [start, np.pi / K.dt]])
        return np.array([gains(K, w[(w >= start) & (w <= np.pi / K.dt)]).max(initial=0.0)])

    def exact(self, loops: Loop, request: RequestedMetric, k: int) -> float:
        """Return the value over all frequencies."""
        return loops.controller_peak(self._start(loops, request))

    def _start(self, loops: Loop, request: RequestedMetric) -> float:
        return loops.slow if request.frequency is None else request.frequency


@value
class Sight(Measure):
    """Rms of the line of sight in the budget of the loop's job, rad, or contrast; infinite or 0 of an unstable loop."""

    key: str  # of the budget's limit
    worst: float  # of an unstable loop; 0 of a contrast, of which the forms are those of `contrast_of`

    def values(self, loops: Loop, request: RequestedMetric, members: Indices) -> FloatArray:
        """Return the value with the friction of another controller, (1,); of plants without forms the exact one."""
        forms = loops.plants.sight_forms
        if forms is None or not loops.decay[0] > 0.0:
            return np.array([self.exact(loops, request, 0)])
        found = max(one.at(loops.controller) for one in forms[self.key])
        return np.array([contrast_of(found) if self.worst == 0.0 else found])

    def exact(self, loops: Loop, request: RequestedMetric, k: int) -> float:
        """Return the value of the budget itself."""
        return loops.sight.get(self.key, self.worst)


def of_following(function: Callable[[System], FloatArray]) -> Callable[[Loop], FloatArray]:
    """Return the measure of the worst channel of each plant; infinite of an unstable loop."""
    return _worst(lambda loops, k: function(loops.settled(loops.following.at(k).part(slice(loops.kept), slice(None)))))


def of_steps(function: Callable[[FloatArray, FloatArray], FloatArray]) -> Callable[[Loop], FloatArray]:
    """Return the same of a function of the responses to steps: times (N,) and responses (p, N)."""
    return _worst(lambda loops, k: function(*loops.steps(k)))


def _worst(measured: Callable[[Loop, int], FloatArray]) -> Callable[[Loop], FloatArray]:
    def worst(loops: Loop) -> FloatArray:
        out = np.full(len(loops.plants.labels), np.inf)
        for k in np.flatnonzero(loops.decay > 0.0):
            out[k] = float(measured(loops, int(k)).max(initial=0.0))
        return out

    return worst


def of_margins(which: int) -> Callable[[Loop], FloatArray]:
    """Return the measure of the gain margin, a factor (0), or of the phase margin, rad (1), of the worst channel."""

    def measured(loops: Loop) -> FloatArray:
        out = np.full(len(loops.plants.labels), 1.0 - which)
        for k in np.flatnonzero(loops.decay > 0.0):
            alone = [loops.settled(loops.own_arrays.at(k).part([i], [i])) for i in range(loops.m)]
            out[k] = min(margins_of_channel(one._replace(D=one.D + 1.0))[which] for one in alone)
        return out

    return measured


def torque_noise(loops: Loop, plants: slice = slice(None)) -> FloatArray:
    """Return the rms of every torque from the noise of the sensors, N m, (k, m); infinite of an unstable loop."""
    m, everything = loops.m, slice(None)
    to_torque = loops.own_arrays.at(plants).part(slice(m), everything)
    read, turning = to_torque.part(everything, slice(m, None)), loops.plants.turning
    if turning is not None:
        read = read._replace(B=read.B @ turning[plants], D=read.D @ turning[plants])
    out = _rms(loops, read, loops.plants.noise)
    fed = loops.plants.feedforward
    if fed is not None:
        out = np.hypot(out, _rms(loops, fed.noise_of_torques(to_torque), np.ones(len(fed.sensors))))
    return out


def _rms(loops: Loop, systems: System, rms: FloatArray) -> FloatArray:
    """Return the rms (k, m) of outputs from white samples, of a loop that drifts after an hour."""
    if not loops.plants.drifting:
        return noise_rms(systems, rms)
    return np.array([drifting_rms(systems.at(k), rms) for k in range(len(systems.A))])
