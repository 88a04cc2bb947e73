"""How a metric of a loop is measured: on a grid of frequencies for a search, exactly for a verdict.

Each class has `values`, the values of some plants, on the grid where it needs one. Where a grid may miss the worst,
`exact` takes the value of one plant over all frequencies, and `holds` shows that a plant's value is no worse than a
bound without computing it. `gradient`, or the transfers, are what the structured tuner differentiates.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any, Protocol

import numpy as np

from platform_ctrl.analysis.bandwidths import LEVEL, bandwidth_of_response, bandwidth_of_sensitivity
from platform_ctrl.analysis.channel import Channel
from platform_ctrl.analysis.loop import S_INPUT, S_OUTPUT, Indices, Loop, Transfer
from platform_ctrl.analysis.norms import PEAK_TOLERANCE, WHOLE, Band, exceeds, gains, peak, refined_peak
from platform_ctrl.analysis.poles import continuous_poles, poles, resonances
from platform_ctrl.common.values import FloatArray, value

# Share of the slowest pole's frequency at which a response is at its limit for zero frequency.
_LIMIT = 1e-2
# Below this share of the sample rate a response of sampled plants is rounding.
_ROUNDING = 1e-8
# A gain that is larger by this factor at a tenth of that grows without bound towards zero.
_GROWING = 5.0
# Relative distance above a bandwidth at which S is seen to reach its level.
_ABOVE = 1e-7
_SENSITIVITIES = (S_OUTPUT, S_INPUT)


class Request(Protocol):
    """What is to be measured: a metric with its options."""

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

    @property
    def channel(self) -> Channel | None:
        """Signals between which a norm is taken."""


@value
class MetricRequest:
    """A metric with its options, without a limit."""

    kind: str
    over: tuple[str, ...] = ("nominal",)
    frequency: float | None = None
    lowest: float = 0.0
    channel: Channel | None = None


# Derivatives for the structured tuner: (its closed loops, limit in SI units, lowest ratio of interest, plants) →
# pieces, as the methods of `design.fixed_structure.loops.ClosedLoops` return them.
Gradient = Callable[[Any, float, float, Any], Any]


@value
class Direct:
    """Measured in one step, of poles or covariances."""

    # return the value of every plant, (N,), or of the controller, (1,), in SI units
    function: Callable[[Any, Request], FloatArray]
    # for the structured tuner; without it the tuner looks at this metric only when it has ended
    gradient: Gradient | None = None

    def values(self, loops: Loop, request: Request, members: Indices) -> FloatArray:
        """Return the values of some plants, (k,); of the controller alone (1,)."""
        every = self.function(loops, request)
        return every if len(every) == 1 else every[members]


@value
class Peak:
    """The largest gain over frequency of some parts of the closed loop."""

    transfers: tuple[Transfer, ...] = ()  # the parts; none: the channel of the request
    reciprocal: bool = False  # whether the metric is 1/peak
    banded: bool = False  # whether the peak is taken from the lowest up to the frequency of the request, if it has one

    def values(self, loops: Loop, request: Request, members: Indices) -> FloatArray:
        """Return the values of some plants on the grid, (k,): never worse than they are."""
        return self._of_peak(loops.grid_peaks(self._parts(request), self._band(request), members))

    def exact(self, loops: Loop, request: Request, k: int) -> tuple[float, float]:
        """Return the value of plant `k`, to 1e-9 from the worse side, and its frequency, rad/s."""
        if not loops.decay[k] > 0.0:
            return float(self._of_peak(np.array([np.inf]))[0]), 0.0
        if self.refined(loops):
            found, at = _refined(loops, self.transfers, k, self._band(request))
        else:
            parts, known = self._parts(request), loops.poles[k] if self.transfers else None
            found, at = max(peak(part, self._band(request), known) for part in loops.parts(parts, k))
        return float(self._of_peak(np.array([found]))[0]), at

    def refined(self, loops: Loop) -> bool:
        """Return whether the value is from continuous disturbances: of a grid that is refined, not exact."""
        return any(loops.between(one) for one in self.transfers)

    def holds(self, loops: Loop, request: Request, k: int, bound: float) -> bool:
        """Return whether the value of the stable plant `k` is shown to be no worse than `bound`."""
        level = 1.0 / bound if self.reciprocal else bound
        if self.refined(loops):
            return _refined(loops, self.transfers, k, self._band(request))[0] <= level
        return _below(loops, self._parts(request), k, level, self._band(request))

    def _parts(self, request: Request) -> Sequence[Transfer] | Channel:
        return self.transfers or request.channel or Channel()

    def _band(self, request: Request) -> Band:
        return (request.lowest, request.frequency) if self.banded and request.frequency is not None else WHOLE

    def _of_peak(self, peaks: FloatArray) -> FloatArray:
        if not self.reciprocal:
            return peaks
        with np.errstate(divide="ignore"):
            return np.where(np.isfinite(peaks), 1.0 / peaks, 0.0)


@value
class Bandwidth:
    """The lowest frequency, rad/s, at which the largest singular value of S reaches 1/√2; 0 of an unstable loop."""

    gradient: Gradient

    def values(self, loops: Loop, request: Request, members: Indices) -> FloatArray:
        """Return the values of some plants on the grid, rad/s, (k,)."""
        return np.array([self._on_grid(loops, int(k)) for k in members])

    def exact(self, loops: Loop, request: Request, k: int) -> tuple[float, float]:
        """Return the value of plant `k`, rad/s, from below, and a frequency at which S is seen to be that large."""
        if not loops.decay[k] > 0.0:
            return 0.0, 0.0
        at = min(bandwidth_of_sensitivity(part, loops.poles[k]) for part in loops.parts(_SENSITIVITIES, k))
        return (1.0 - PEAK_TOLERANCE) * at, (1.0 + _ABOVE) * at

    def holds(self, loops: Loop, request: Request, k: int, bound: float) -> bool:
        """Return whether S of the stable plant `k` is shown to stay below the level up to `bound`."""
        return _below(loops, _SENSITIVITIES, k, LEVEL, (0.0, bound))

    def _on_grid(self, loops: Loop, k: int) -> float:
        if not loops.decay[k] > 0.0:
            return 0.0
        frequency = loops.plants.frequency
        found = min(float(bandwidth_of_response(frequency, S[k])) for S in (loops.S_output, loops.S_input))
        w = loops.narrow.get(k, np.zeros(0))
        high = [w[gains(part, w) >= LEVEL] for part in loops.parts(_SENSITIVITIES, k)] if w.size else []
        return min([found, *(float(part.min(initial=np.inf)) for part in high)])


@value
class ControllerGain:
    """The largest gain of the controller from a frequency on."""

    def values(self, loops: Loop, request: Request, members: Indices) -> FloatArray:
        """Return the value on the grid, (1,)."""
        K, start = loops.controller, _start(loops, request)
        own = resonances(continuous_poles(poles(K.A), K.dt))
        grid = loops.plants.frequency
        w = np.concatenate([grid, own, [start, np.pi / K.dt]])
        return np.array([gains(K, w[(w >= start) & (w <= np.pi / K.dt)]).max(initial=0.0)])

    def exact(self, loops: Loop, request: Request, k: int) -> tuple[float, float]:
        """Return the value, to 1e-9 from above, and its frequency, rad/s."""
        return peak(loops.controller, (_start(loops, request), np.inf))


def _refined(loops: Loop, parts: Sequence[Transfer], k: int, band: Band) -> tuple[float, float]:
    """Return the largest gain of parts of a loop from continuous disturbances, and its frequency, rad/s.

    Infinite where it grows without bound towards zero frequency.
    """
    period, grid = loops.period, loops.plants.frequency
    s = continuous_poles(loops.poles[k], period)
    own = resonances(s[np.isfinite(s)])
    slowest = np.abs(s[np.isfinite(s) & (s != 0.0)]).min(initial=grid[0])
    low = max(min(_LIMIT * float(slowest), grid[0]), _ROUNDING / period)
    w = np.concatenate([np.geomspace(low, grid[0], 20), grid, own[own >= low]])
    sampling = 2.0 * np.pi / period
    # A disturbance may be faster than what is sampled.
    w = np.concatenate([w, *(abs(n * sampling + sign * w) for n in (1, 2) for sign in (-1.0, 1.0))])
    edges = [edge for edge in band if 0.0 < edge < np.inf]
    w = np.unique(np.concatenate([w[(w >= band[0]) & (w <= band[1]) & (w >= low)], edges]))

    def gain(at: FloatArray) -> FloatArray:
        return loops.gain_at(parts, at, k)

    if band[0] == 0.0:
        slow, slower = gain(w[0] * np.array([1.0, 0.1]))
        if slower > _GROWING * slow:
            return np.inf, 0.0
    return refined_peak(gain, w)


def _start(loops: Loop, request: Request) -> float:
    return loops.slow if request.frequency is None else request.frequency


def _below(loops: Loop, parts: Sequence[Transfer] | Channel, k: int, level: float, band: Band) -> bool:
    return not any(exceeds(part, level, loops.poles[k], band) for part in loops.parts(parts, k))
