"""Options of a design: moved until the worst requirement is met with a reserve; what each does, which is best moved."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import field

import numpy as np
from numpy.typing import NDArray

from platform_ctrl.analysis.loop import Loop
from platform_ctrl.analysis.loop_metrics import LoopMetrics, measure
from platform_ctrl.analysis.plant_set import PlantSet
from platform_ctrl.analysis.system import System
from platform_ctrl.common.values import FloatArray, replaced, value
from platform_ctrl.errors import DesignError, PlatformCtrlError, reason
from platform_ctrl.job.judging import CheckResult
from platform_ctrl.job.quantities import compared
from platform_ctrl.job.requirements import LoopRequirement

BoolArray = NDArray[np.bool_]
Builder = Callable[[dict[str, float]], System]

# How far options may move, as a factor: where nothing gets better the search would go on to infinity.
_LARGEST_FACTOR = 1e6
# Other starts, tried where a search does not meet the limits: crossovers between these shares of the sample rate, so
# many a decade, and how many of them are searched from.
_SLOWEST, _FASTEST, _A_DECADE, _MOST_STARTS = 1e-6, 0.2, 3, 2
# Ratio up to which a ratio counts as it is. Larger ones are compressed to below 10, from where on a loop is unstable.
_LARGE = 5.0
# Number of active plants of a search, the worst ones. All plants are measured after each search.
_MOST_PLANTS = 8


def over_decades(options: dict[str, float], together: Iterable[str], period: float) -> list[dict[str, float]]:
    """Return `options` with those that go `together` scaled, so that the largest of them is at crossovers over decades.

    They are frequencies in Hz.
    """
    scaled = [name for name in together if name in options]
    if not scaled:
        return []
    largest = max(options[name] for name in scaled)
    count = round(_A_DECADE * math.log10(_FASTEST / _SLOWEST)) + 1
    crossovers = np.geomspace(_SLOWEST, _FASTEST, count) / period
    return [options | {name: options[name] * float(hz) / largest for name in scaled} for hz in crossovers]


def worst_ratio(controller: System, plants: PlantSet, requirements: Sequence[LoopRequirement]) -> float:
    """Return the largest ratio of all requirements, compressed to below 10; beyond it for an unstable loop.

    The ratio of an unstable loop is the larger the faster it diverges.
    """
    return _worst(_on_grid(controller, plants, requirements), plants, requirements)


def _on_grid(controller: System, plants: PlantSet, requirements: Sequence[LoopRequirement]) -> LoopMetrics:
    return measure(plants, controller._replace(dt=plants.period), requirements, exact=False)


def _worst(measures: LoopMetrics, plants: PlantSet, requirements: Sequence[LoopRequirement]) -> float:
    growth = -float(measures.decay[_stable(measures, requirements)].min())
    if not growth < 0.0:
        return 10.0 + min(growth / plants.nutation, 1e6) * 100.0
    ratios = (r.ratios(measures).max() for r in requirements)
    largest = float(max(ratios, default=0.0))
    return largest if largest <= _LARGE else 2.0 * _LARGE - _LARGE**2 / largest


def limiting(measures: LoopMetrics, plants: PlantSet, requirements: Sequence[LoopRequirement]) -> str:
    """Return words about what is unstable, or which requirement is nearest to its limit or farthest beyond it."""
    stable = _stable(measures, requirements)
    decay = np.where(stable, measures.decay, np.inf)
    worst = int(decay.argmin())
    if not decay[worst] > 0.0:
        return f"unstable: {plants.labels[worst]} grows at {-decay[worst]:.3g} 1/s"
    results = [one.result(plants, measures) for one in requirements]
    if not results:
        return "stable"
    one = max(results, key=lambda one: one.ratio)
    found, limit = compared(one)
    return f"limited by {one.name}: {found}, {one.sense} {limit}"


def of_sight(requirements: Iterable[LoopRequirement]) -> bool:
    """Return whether any of some requirements is about the budget of the line of sight."""
    return any(one.metric.of_sight for one in requirements)


def with_sight(plants: PlantSet, controller: System, other: Callable[[], System]) -> PlantSet:
    """Return plants with the forms of their budget for a controller or, where it is not stable, for another one."""
    try:
        return plants.with_sight(plants.feedback(controller))
    except PlatformCtrlError:
        pass
    try:
        return plants.with_sight(plants.feedback(other()))
    except PlatformCtrlError as error:
        raise DesignError(f"the budget of the line of sight has no start: {reason(error)}") from error


@value
class Tuner:
    """A search for options with which the worst ratio of all requirements is at most 1 − reserve, or least.

    A simplex search over the logarithms (Nelder and Mead, adaptive), on the nominal plant and the worst few of the set,
    repeated until the active plants are the worst of all. Options that meet the limits on the grid of frequencies are
    measured exactly; where that exceeds a limit, the frequencies at which the values are reached join the grid.
    Deterministic.

    Attributes
    ----------
    movable
        Options that it changes.
    build
        Makes the sampled controller of all options.
    plants, requirements
        On which plants, and what is required of the loops.
    upper
        Largest values of options, positive.
    reserve
        Share by which limits are met.
    evaluations
        Most evaluations of a search.
    progress
        Called with the worst ratio so far and what limits it.
    """

    movable: Sequence[str]
    build: Builder
    plants: PlantSet
    requirements: Sequence[LoopRequirement]
    upper: Mapping[str, float] = field(default_factory=dict)
    reserve: float = 0.05
    evaluations: int = 1500
    progress: Callable[[float, str], None] = lambda ratio, line: None

    def run(self, start: dict[str, float], starts: Sequence[dict[str, float]] = ()) -> dict[str, float]:
        """Return `start`, all positive, with the movable options changed.

        Where limits are not met, the search is repeated from the best of the other `starts`.
        """
        if of_sight(self.requirements) and self.plants.sight_budget and self.plants.sight_forms is None:

            def without_budget() -> System:
                rest = [one for one in self.requirements if not one.metric.of_sight]
                return self.build(replaced(self, {"requirements": rest}).run(start, starts))

            plants = with_sight(self.plants, self.build(start), without_budget)
            return replaced(self, {"plants": plants}).run(start, starts)
        plants, told = self.plants, np.inf
        if any(one.metric.disturbed_by for one in self.requirements):
            plants = plants.with_disturbances()

        def tell(ratio: float, line: str) -> None:
            nonlocal told
            if ratio <= told:
                told = ratio
                self.progress(ratio, line)

        best, ratio = self._searched(start, plants, tell)
        for other in self._best(starts, plants) if ratio > 1.0 else ():
            found, reached = self._searched(other, plants, tell)
            if reached < ratio:
                best, ratio = found, reached
            if ratio <= 1.0:
                break
        return best

    def _best(self, starts: Sequence[dict[str, float]], plants: PlantSet) -> list[dict[str, float]]:
        """Return the best of the starts, of neighbours the better one."""
        within = [{name: min(x, self.upper.get(name, np.inf)) for name, x in one.items()} for one in starts]
        ratios = []
        for one in within:
            try:
                ratios.append(worst_ratio(self.build(one), plants, self.requirements))
            except PlatformCtrlError:
                ratios.append(np.inf)
        edged = [np.inf, *ratios, np.inf]
        valleys = [k for k, x in enumerate(ratios) if x < np.inf and x <= edged[k] and x < edged[k + 2]]
        return [within[k] for k in sorted(valleys, key=ratios.__getitem__)[:_MOST_STARTS]]

    def _searched(
        self, start: dict[str, float], plants: PlantSet, tell: Callable[[float, str], None]
    ) -> tuple[dict[str, float], float]:
        """Return the options that a search from `start` ends with, and their worst ratio."""
        from scipy.optimize import minimize

        bounds = np.array([np.log(self.upper.get(name, np.inf)) for name in self.movable])
        best = np.minimum(np.log([start[name] for name in self.movable]), bounds)
        lower, bounds = best - np.log(_LARGEST_FACTOR), np.minimum(bounds, best + np.log(_LARGEST_FACTOR))

        def built(x: FloatArray) -> System:
            return self.build(self._moved(start, np.clip(x, lower, bounds)))

        def beyond(x: FloatArray) -> float:
            return float(np.maximum(np.maximum(x - bounds, lower - x), 0.0).max(initial=0.0))

        def ratio(x: FloatArray, on: PlantSet) -> float:
            return worst_ratio(built(x), on, self.requirements) + beyond(x)

        def stop(intermediate_result: object) -> None:
            if getattr(intermediate_result, "fun", np.inf) <= 0.995 * (1.0 - self.reserve):
                raise StopIteration

        view, left, best_ratio, line, current = [0], self.evaluations, np.inf, "", best
        while left > 0:
            measures, finer, overall = self._looked(built(current), plants, beyond(current))
            if overall < best_ratio:
                best, best_ratio, line = current, overall, limiting(measures, finer, self.requirements)
            tell(best_ratio, line)
            if best_ratio <= 1.0 - self.reserve:
                break
            refined, plants = finer is not plants, finer
            added = [k for k in _worst_plants(measures, self.requirements) if k not in view]
            if current is not best and not added and not refined:
                break
            view = sorted({*view, *added[:_MOST_PLANTS]})
            most = min(left, 60 * len(self.movable))
            found = minimize(
                ratio,
                current,
                args=(plants.only(view),),
                method="Nelder-Mead",
                callback=stop,
                options={"maxfev": most, "adaptive": True, "xatol": 2e-3, "fatol": 2e-4},
            )
            left -= int(found.nfev) + 1
            current = np.asarray(found.x, dtype=np.float64)
        return self._moved(start, np.clip(best, lower, bounds)), best_ratio

    def _moved(self, start: dict[str, float], x: FloatArray) -> dict[str, float]:
        """Return `start` with the movable options at these logarithms; what has not moved keeps its last digit."""
        ratios = np.exp(x - [math.log(start[name]) for name in self.movable])
        return start | {name: start[name] * float(one) for name, one in zip(self.movable, ratios, strict=True)}

    def _looked(self, controller: System, plants: PlantSet, beyond: float) -> tuple[LoopMetrics, PlantSet, float]:
        """Return metrics of all plants on the grid, the plants, and the worst ratio, `beyond` added.

        The deciding plants are measured exactly. Where that exceeds a limit that is met on the grid, the plants are on
        a grid that shows it.
        """
        measures = _on_grid(controller, plants, self.requirements)
        overall = _worst(measures, plants, self.requirements) + beyond
        if overall > 1.0:
            return measures, plants, overall
        chosen = plants.only(deciding(measures, self.requirements))
        loops = Loop(chosen, controller._replace(dt=plants.period))
        exact = measure(chosen, loops.controller, self.requirements, loops=loops)
        exactly = _worst(exact, chosen, self.requirements)
        if exactly > 1.0:
            plants = plants.finer(loops.peak_frequencies)
            return _on_grid(controller, plants, self.requirements), plants, exactly + beyond
        return measures, plants, overall


def _worst_plants(measures: LoopMetrics, requirements: Sequence[LoopRequirement]) -> list[int]:
    """Return plant numbers, the worst first."""
    decay = np.where(_stable(measures, requirements), measures.decay, np.inf)
    if not np.all(decay > 0.0):
        return [int(k) for k in np.argsort(decay)]
    ratios = np.zeros(len(decay))
    for requirement in requirements:
        if requirement.beyond_nominal and requirement.metric.of != "controller":
            requested = measures.of(requirement.over)
            ratios[requested] = np.maximum(ratios[requested], requirement.ratios(measures))
    return [int(k) for k in np.argsort(-ratios)]


def _stable(measures: LoopMetrics, requirements: Sequence[LoopRequirement]) -> BoolArray:
    """Return which plants have to be stable, (N,): those with a fault only where something is required of them."""
    if any("faults" in requirement.over for requirement in requirements):
        return np.ones(len(measures.groups), dtype=np.bool_)
    return np.asarray(np.logical_not(measures.of(("faults",))))


# Share of its value by which an option is moved to see what it does.
SHARE = 0.05
# Relative moves of an option that are considered, and how many are tried after the estimate.
MOVES, _TRIED = (-0.2, -0.1, -0.05, -0.025, 0.025, 0.05, 0.1, 0.2), 4
# Least loss of margin that is called a cost.
_COST = 1e-3

# How bad ratios (R,) are: of two moves the one with the smaller number is better.
Score = Callable[[FloatArray], float]


@value
class OptionValue:
    """An option that may be moved between `low` and `high`, in the units of the job file; `value` is not zero."""

    name: str
    value: float
    low: float = 0.0
    high: float = np.inf

    def moved(self, after: float, part: float) -> float:
        """Return the value after a part of the move to `after`."""
        return float(f"{self.value * (after / self.value) ** part:.3g}")


@value
class OptionEffects:
    """The effect of each option on each requirement.

    `ratios` (R,) are those of the `requirements`, at most 1 where met. `change` (R, K) is the change of a ratio for an
    option that is 5 % larger: negative is better, inf where the loop becomes unstable, nan where it is already.
    """

    options: tuple[str, ...]
    requirements: tuple[str, ...]
    ratios: FloatArray
    change: FloatArray


@value
class ResultChange:
    """A requirement before and after a move."""

    before: CheckResult
    after: CheckResult


def option_effects(
    options: Sequence[str], requirements: Sequence[str], before: FloatArray, after: Sequence[Callable[[], FloatArray]]
) -> OptionEffects:
    """Return the effects of `options`; `after` computes the ratios (R,) with each of them 5 % larger."""
    change = np.full((len(before), len(options)), np.nan)
    for k, ratios in enumerate(after):
        try:
            moved = ratios()
        except PlatformCtrlError:
            continue
        with np.errstate(invalid="ignore"):
            change[:, k] = moved - before
    return OptionEffects(options=tuple(options), requirements=tuple(requirements), ratios=before, change=change)


def largest(ratios: FloatArray) -> float:
    """Return the largest ratio, the score of a design as a whole."""
    return float(ratios.max())


def candidates(
    effects: OptionEffects, options: Sequence[OptionValue], score: Score = largest, moves: Sequence[float] = MOVES
) -> list[tuple[str, float]]:
    """Return the names of options with new values, those first that are expected to help most.

    All ratios are taken to be linear in the option; of each option the best of the relative `moves` counts.
    """
    column = {name: k for k, name in enumerate(effects.options)}
    found = []
    for option in options:
        slope = effects.change[:, column[option.name]] / SHARE
        if not np.all(np.isfinite(slope)):
            continue
        for move in moves:
            after = float(f"{option.value * (1.0 + move):.4g}")
            expected = score(effects.ratios + slope * move)
            if option.low <= after <= option.high and np.isfinite(expected):
                found.append((expected, option.name, after))
    found.sort(key=lambda one: one[0])
    out: dict[str, tuple[str, float]] = {}
    for _, name, after in found:
        out.setdefault(name, (name, after))
    return list(out.values())[:_TRIED]


def largest_loss(before: Sequence[CheckResult], after: Sequence[CheckResult]) -> ResultChange | None:
    """Return the requirement that loses most margin, those with more than 100 % apart; None where none loses any."""
    losses = [min(a.margin, 1.0) - min(b.margin, 1.0) for a, b in zip(before, after, strict=True)]
    dearest = int(np.argmax(losses))
    return ResultChange(before=before[dearest], after=after[dearest]) if losses[dearest] > _COST else None


def deciding(measures: LoopMetrics, requests: Sequence[LoopRequirement]) -> list[int]:
    """Return the nominal plant and the two that are worst for each requirement."""
    out = {0}
    for one in requests:
        ratios = one.ratios(measures)
        if one.metric.of != "controller" and one.beyond_nominal and len(ratios):
            plants = np.flatnonzero(measures.of(one.over))
            out |= {int(plants[k]) for k in np.argsort(-ratios)[:2]}
    return sorted(out)


def largest_ratios(measures: LoopMetrics, requests: Sequence[LoopRequirement]) -> FloatArray:
    """Return the largest ratio of each requirement (k,)."""
    return np.array([float(one.ratios(measures).max(initial=0.0)) for one in requests])
