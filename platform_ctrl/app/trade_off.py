"""From robustness to speed along precomputed designs, for designs that a method has to make."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from typing import Any, Literal

import numpy as np

from platform_ctrl.app.background import IsCancelled
from platform_ctrl.app.caged import loop_metrics
from platform_ctrl.app.closed_loops import ClosedLoops, with_conditions
from platform_ctrl.app.controllers import built_directly
from platform_ctrl.app.designs import Designs
from platform_ctrl.app.plants import Bounded
from platform_ctrl.app.settings import Conditions, Settings, with_options
from platform_ctrl.common.values import value
from platform_ctrl.design.loop import limits_and_goals
from platform_ctrl.errors import ArgumentError
from platform_ctrl.job.quantities import HZ

# The bandwidths of the weights over those of the job; the reserve with which limits are met: from robust to fast.
_BANDWIDTHS, _RESERVES = (0.6, 0.77, 1.0, 1.3, 1.7), (0.3, 0.2, 0.1, 0.05)
# Designs that stay measured: those of several plants.
_ROOM = 64

PointState = Literal["missing", "pending", "failed", "ready"]


@value
class TradeOffPoint:
    """A design of the trade-off: `settings` select it.

    One that is ready has the loop's `bandwidth`, Hz, the disk margin `disk` of the worst plant, and how many limits are
    `missed`; it is `dominated` where another one is faster and more robust. `line` says why one failed.
    """

    settings: Settings
    state: PointState
    line: str = ""
    bandwidth: float = 0.0
    disk: float = 0.0
    missed: int = 0
    dominated: bool = False


class TradeOff:
    """The trade-offs of a job's designs, which all its pages share."""

    def __init__(self, loops: ClosedLoops, designs: Designs) -> None:
        self._loops, self._designs = loops, designs
        self._measured: Bounded[tuple[float, float, int]] = Bounded(_ROOM)

    def points(self, settings: Settings) -> tuple[TradeOffPoint, ...]:
        """Return the designs from robust to fast; none for a design that its sliders shape at once."""
        return _with_dominated([self._point(k, one) for k, one in enumerate(self._settings(settings))])

    def prepare(self, settings: Settings) -> int:
        """Have the designs that are missing made, one after another, and return how many there are."""
        missing = [
            (k, one.settings) for k, one in enumerate(self.points(settings)) if one.state in ("missing", "pending")
        ]
        for k, there in missing:
            loop, name, conditions = self._request(k, there)

            def make(cancelled: IsCancelled, there: Settings = there) -> None:
                self._designs.make(there, *self._loops.design(there), cancelled)
                # Here, not while the page waits.
                self._measure(there)

            self._designs.queue.request(loop, name, conditions, make)
        return len(missing)

    def _settings(self, settings: Settings) -> list[Settings]:
        spec, design = self._loops.design(settings)
        if built_directly(design):
            return []
        start = self._loops.start.options[spec.name][design.name]
        bandwidths = {name: x for name, x in start.items() if name.endswith("bandwidth_hz")}
        if bandwidths:
            options = [{name: float(f"{x * f:.4g}") for name, x in bandwidths.items()} for f in _BANDWIDTHS]
        elif "reserve" in start:
            reserves = (*(one for one in _RESERVES if one > start["reserve"]), start["reserve"])
            options = [{"reserve": one} for one in reserves]
        else:
            return []
        plain = with_conditions(settings, spec.name, design.name, None)
        return [with_options(plain, one) for one in options]

    def _request(self, k: int, settings: Settings) -> tuple[str, str, Conditions]:
        """Return loop, name and key of the request for a point: other points do not replace it."""
        spec, design = self._loops.design(settings)
        return spec.name, f"{design.name}, point {k + 1}", self._loops.conditions(settings, spec, design)

    def _point(self, k: int, settings: Settings) -> TradeOffPoint:
        request, queue = self._request(k, settings), self._designs.queue
        if self._loops.found(settings.loop, settings.design, request[2]) is None:
            line = queue.failure(*request)
            state: PointState = "failed" if line else "pending" if queue.is_requested(*request) else "missing"
            return TradeOffPoint(settings=settings, state=state, line=line)
        bandwidth, disk, missed = self._measure(settings)
        return TradeOffPoint(settings=settings, state="ready", bandwidth=bandwidth, disk=disk, missed=missed)

    def _measure(self, settings: Settings) -> tuple[float, float, int]:
        spec, design = self._loops.design(settings)

        def measured() -> tuple[float, float, int]:
            with np.errstate(all="ignore"):
                loop, _ = self._loops.caged(settings)
                metrics = self._loops.cached_metrics(settings, loop)(lambda: loop_metrics(loop))
            limits, _ = limits_and_goals(spec, design.name, loop.plants, metrics)
            missed = sum(not one.passed for one in limits)
            return HZ * float(metrics.bandwidth), float(metrics.disk_margin.min()), missed

        loops = self._loops
        key = (loops.plants_key(settings, spec, design), loops.conditions(settings, spec, design))
        return self._measured.get(key, measured)


def _with_dominated(points: Sequence[TradeOffPoint]) -> tuple[TradeOffPoint, ...]:
    ready = [(one.bandwidth, one.disk) for one in points if one.state == "ready"]

    def dominated(one: TradeOffPoint) -> bool:
        own = one.bandwidth, one.disk
        better = (other for other in ready if other != own)
        return one.state == "ready" and any(fast >= own[0] and robust >= own[1] for fast, robust in better)

    return tuple(dataclasses.replace(one, dominated=dominated(one)) for one in points)


def front(points: Sequence[TradeOffPoint]) -> tuple[int, ...]:
    """Return the indices of the points that no other one surpasses in both, from robust to fast.

    Those that are unstable with a plant of the set are left out.
    """
    there = [k for k, one in enumerate(points) if one.state == "ready" and not one.dominated and one.disk > 0.0]
    return tuple(sorted(there, key=lambda k: points[k].bandwidth))


def chosen_point(points: Sequence[TradeOffPoint], k: int) -> TradeOffPoint:
    """Return a point of a trade-off that is available."""
    if not 0 <= k < len(points) or points[k].state != "ready":
        raise ArgumentError("speed: this design is not available yet; compute the trade-off first")
    return points[k]


def trade_off_data(points: Sequence[TradeOffPoint], settings: Settings) -> dict[str, Any] | None:
    """Return the designs from robust to fast as the page shows them, or None where there is no such choice.

    `stops` are the designs that the slider stops at, `at` which of them is shown or -1, `words` what is shown, `line`
    what is known of the others.
    """
    if not points:
        return None
    mine = settings.options[settings.loop][settings.design]
    own = next((k for k, one in enumerate(points) if one.settings.options[settings.loop][settings.design] == mine), -1)
    stops = front(points)
    return {
        "stops": [{"k": k, "words": _point_words(points[k])} for k in stops],
        "at": stops.index(own) if own in stops else -1,
        "words": "other options than those of the trade-off" if own < 0 else _point_words(points[own]),
        "line": _trade_off_line(points),
        "missing": any(one.state == "missing" for one in points),
    }


def _point_words(one: TradeOffPoint) -> str:
    if one.state != "ready":
        return one.line or "not designed yet"
    missed = f", {one.missed} missed" if one.missed else ""
    beaten = "; another one is faster and more robust" if one.dominated else ""
    return f"{one.bandwidth:.3g} Hz, disk margin {one.disk:.2f}{missed}{beaten}"


def _trade_off_line(points: Sequence[TradeOffPoint]) -> str:
    """Return how far the designs from robust to fast have come, and which are left out."""
    of = {state: [one for one in points if one.state == state] for state in ("ready", "pending", "failed")}
    ready, pending, failed = of["ready"], of["pending"], of["failed"]
    left_out = len(ready) - len(front(points))
    words = [f"{len(ready)} of {len(points)} designed"]
    words += ["the next is being designed"] if pending else []
    words += [f"{left_out} left out: slower and less robust than another"] if left_out else []
    words += [f"{len(failed)} failed: {failed[0].line}"] if failed else []
    return "; ".join(words)
