"""The metrics of the closed loops of a controller and a plant set."""

from __future__ import annotations

from collections.abc import Sequence
from typing import get_args

import numpy as np

from platform_ctrl.analysis.loop import Indices, Loop
from platform_ctrl.analysis.measuring import MetricRequest, RequestedMetric, torque_noise
from platform_ctrl.analysis.metrics import METRICS
from platform_ctrl.analysis.plant_set import BoolArray, Group, PlantSet, members
from platform_ctrl.analysis.system import ComplexArray, System
from platform_ctrl.common.values import FloatArray, value
from platform_ctrl.errors import ArgumentError

# Metrics that `measure` always measures: of every plant, but bandwidth and torque noise of the nominal one.
ALWAYS_MEASURED = ("stability", "bandwidth", "disk margin", "damping", "torque noise")
_BANDWIDTH, _TORQUE_NOISE = MetricRequest(kind="bandwidth"), MetricRequest(kind="torque noise")

Key = tuple[str, tuple[str, ...], float, float | None]


@value
class LoopMetrics:
    """Metrics of a controller closed around a plant set, in SI units."""

    # (N,): 1/‖(S − T)/2‖, all channels at once, the smaller of input and output, dimensionless; 0 where the loop is
    # unstable.
    disk_margin: FloatArray
    damping: FloatArray  # (N,): smallest damping ratio of the closed-loop poles
    decay: FloatArray  # (N,): decay rate of the slowest closed-loop pole, 1/s; negative where the loop is unstable
    poles: ComplexArray  # (N, n): closed-loop poles in z, without those of equilibria that no sensor sees
    groups: tuple[Group, ...]  # what each plant represents, as in `PlantSet`
    # Whether peaks, bandwidths and margins are taken over all frequencies: the worst of every group of plants that a
    # request is about is then exact, and the others are no worse than it. Else they are the largest at the frequencies
    # of a grid.
    exact: bool
    # Names of the angles that nothing holds: a loop is in balance wherever they are.
    free_angles: tuple[str, ...]
    requested: dict[Key, FloatArray]  # other metrics, by request: arrays (k,) in SI units, see `values`

    @property
    def bandwidth(self) -> float:
        """Nominal: the lowest frequency at which σ(S), at the input or the output, reaches 1/sqrt(2), rad/s."""
        return float(self.values(_BANDWIDTH)[0])

    @property
    def torque_noise(self) -> FloatArray:
        """Nominal rms of the torques from pick-off noise, N m, (m,); infinite where the loop is unstable."""
        return self.values(_TORQUE_NOISE)

    def of(self, groups: Sequence[str]) -> BoolArray:
        """Return which plants belong to `groups`, truth values (N,); other names have no members."""
        return members(self.groups, groups)

    def values(self, request: RequestedMetric) -> FloatArray:
        """Return a metric, in SI units, of every plant that `request` is about, (k,).

        Nominal torque noise is that of every torquer. A metric that was not measured is an `ArgumentError`.
        """
        own = {"stability": self.decay, "damping": self.damping, "disk margin": self.disk_margin}
        if request.kind in own:
            return np.asarray(own[request.kind][self.of(request.over)])
        if _key(request) not in self.requested:
            raise ArgumentError(f"{request.kind}: was not measured; give measure() this requirement among its requests")
        return self.requested[_key(request)]


def measure(
    plants: PlantSet,
    controller: System,
    requests: Sequence[RequestedMetric] = (),
    *,
    exact: bool = True,
    loops: Loop | None = None,
) -> LoopMetrics:
    """Measure a controller, u = K y in the set's order of angles and torques, with its sample period, on every plant.

    What `LoopMetrics` names is always measured, other metrics where `requests` (requirements) name them. `exact`:
    peaks, margins and bandwidths are taken over all frequencies; the worst value of each group of plants is exact (to
    1e-9, from the worse side), and the other plants of the group are shown to be no worse. Else, for a search: at the
    frequencies of the set's grid and of closed-loop poles that are narrower than its spacing alone. `loops` are the
    closed loops of this controller and these plants, where they exist already.
    """
    loops = Loop(plants, controller) if loops is None else loops
    every = get_args(Group)
    damping, margin = (measured(loops, MetricRequest(kind=kind, over=every)) for kind in ("damping", "disk margin"))
    if exact:
        # Of every group by itself, whatever is requested.
        for group in dict.fromkeys(plants.groups):
            one = MetricRequest(kind="disk margin", over=(group,))
            chosen = np.flatnonzero(plants.of(one.over))
            margin[chosen] = worst_exact(loops, one, margin[chosen], chosen)
    requested: dict[Key, FloatArray] = {}
    for request in (_BANDWIDTH, _TORQUE_NOISE, *requests):
        if request.kind not in ("stability", "damping", "disk margin") and _key(request) not in requested:
            requested[_key(request)] = measured(loops, request, exact=exact)
    return LoopMetrics(
        disk_margin=margin,
        damping=damping,
        decay=loops.decay,
        poles=loops.poles,
        groups=plants.groups,
        exact=exact,
        free_angles=loops.free_angles,
        requested=requested,
    )


def measured(loops: Loop, request: RequestedMetric, *, exact: bool = False) -> FloatArray:
    """Return one metric of every plant that `request` is about, (k,), as `LoopMetrics.values` does."""
    if _key(request) == _key(_TORQUE_NOISE):
        return np.asarray(torque_noise(loops, slice(1))[0])
    chosen = np.flatnonzero(loops.plants.of(request.over))
    if not chosen.size and METRICS[request.kind].of != "controller":
        return np.zeros(0)
    values: FloatArray = METRICS[request.kind].measure.values(loops, request, chosen)
    return worst_exact(loops, request, values, chosen) if exact else values


def _key(request: RequestedMetric) -> Key:
    return request.kind, tuple(request.over), request.lowest, request.frequency


def worst_exact(loops: Loop, request: RequestedMetric, values: FloatArray, members: Indices) -> FloatArray:
    """Return values on the grid (k,) with the worst of them exact: none of the plants is worse than that.

    The plant that is worst on the grid gets its exact value. Every other one is shown to be no worse, or gets its own.
    """
    out = values.copy()
    metric = METRICS[request.kind]
    if not metric.searched:
        return out
    if metric.of == "controller":
        out[0] = metric.measure.exact(loops, request, 0)
        return out
    if not np.all(loops.decay[members] > 0.0):
        # Nothing is worse than a loop that is not stable.
        return out
    at_least = metric.sense == "at least"
    level: float | None = None
    for i in map(int, np.argsort(values if at_least else -values, kind="stable")):
        k = int(members[i])
        shown = level is not None and ((at_least and level <= 0.0) or metric.measure.holds(loops, request, k, level))
        if not shown:
            out[i] = metric.measure.exact(loops, request, k)
            level = out[i] if level is None else (min if at_least else max)(level, out[i])
    return out
