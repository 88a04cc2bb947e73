"""Moving a controller's parameters until the hard requirements hold and the soft ones are as small as they can be.

The largest ratio of a requirement over plants, frequencies and poles has kinks; each candidate by itself is smooth in
the controller. So a requirement is the largest of smooth functions, its pieces: only pieces near the worst are
computed, and the optimiser takes several at once. With the whole controller in one matrix

    M = [[A_K, B_K], [C_K, D_K]]

every piece f has a gradient of the form ∂f/∂M = Σ Re(a bᵀ):

* a singular value of S, T, (S − T)/2, P S or K with singular vectors u, v: dS_output = S_output P dK S_output,
  dS_input = S_input dK P S_input, dK = [C_K R, I] dM [R B_K; I] with R = (zI − A_K)⁻¹;
* a pole λ with eigenvectors y, x (yᴴx = 1): dλ = yᴴ dA x of the closed loop;
* the variance of a torque: X = A X Aᵀ + B Bᵀ and its adjoint.

A peak between grid points is followed to its top. `minimax.minimise` minimises the pieces: hard ones are its limits,
and only pieces of one requirement and plant continue each other. The bandwidth has no smooth pieces of its own where S
lies along the level; so the problem is reversed: S is at most 1/√2 up to ω_b, and log ω_b is one more variable.

A search is on the active plants, the nominal one and the worst of each requirement. A step must leave all plants
stable, and every few steps all are measured: those that exceed a limit become active. Where angles drift the search is
on regular plants, in which they decay slowly; its result is checked exactly on the plants as given.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from platform_ctrl.analysis.loop import Loop
from platform_ctrl.analysis.loop_metrics import measure
from platform_ctrl.analysis.measuring import ControllerGain, Peak, Sight
from platform_ctrl.analysis.norms import LEVEL
from platform_ctrl.analysis.plant_set import PlantSet
from platform_ctrl.analysis.poles import tuning_grid
from platform_ctrl.analysis.sight import blur_of
from platform_ctrl.analysis.singular_values import largest_singular_values
from platform_ctrl.analysis.transfers import CONTROLLER, maps_of
from platform_ctrl.common.values import FloatArray, value
from platform_ctrl.design.fixed_structure import maps as transfers
from platform_ctrl.design.fixed_structure.loops import LoopGradients
from platform_ctrl.design.fixed_structure.minimax import Effort, Evaluation, Minimum, minimise
from platform_ctrl.design.fixed_structure.structures import Parametrised
from platform_ctrl.job.requirements import LoopRequirement

# An unstable loop is worse than anything else.
_UNSTABLE = 1e6
# Price of the largest excess of a hard piece.
_PENALTY = 5.0
# Pieces below this ratio are not computed; plants are ranked by their excess over the second number.
_FLOOR, _RANKED = 0.8, 0.5
# Active plants of each requirement at first; unstable ones that join them at a step; steps until all are measured.
_FIRST, _MORE, _STEPS = 2, 3, 12
# Share of the reserve that is left in the end: plants that are not active, and peaks between grid points, take some.
_SPARED = 0.8
# How often a search goes on without a decrease by more than the second number, and how often on a finer grid.
_TRIES, _WORTH, _FINER = 2, 1e-3, 10
# Trust region at first, and where a search starts once more.
_RADIUS, _CLOSE = 0.05, 0.02
# Goals count as met a little before they are, and are set as much higher.
_TARGET = 1.001
# How often a search whose goals are missed starts again from about its best point, and how far from it: a search may
# end at a kink from which no quadratic program leads on, and which kink that is depends on rounding.
_AGAIN, _SCATTER = 2, 0.1
# S at the wanted frequency is required this much below the level, and the frequency wanted this share higher:
# the bandwidth must be reached when it is measured exactly.
_TIGHT, _BEYOND = 1e-4, 1.003
# Weight of the excess of S over the level, without goals, and its largest value where a bandwidth is accepted.
_STEEP, _FAR = 5.0, 0.02
# A bandwidth means something if S keeps falling below it: at a tenth of it, at most this.
_TENTH = 0.15


@value
class Found:
    """Where a search ended."""

    x: FloatArray  # (d,): parameters
    # hard, soft: largest hard piece over all plants, at most 1 where every requirement is met; largest soft ratio, 0
    # without any.
    hard: float
    soft: float
    at: Evaluation  # all plants there
    evaluations: int = 0  # how often pieces were computed

    def better_than(self, other: Found | None, reserve: float) -> bool:
        """Whether this one meets more, or the same with smaller soft ratios."""
        if other is None:
            return True
        allowed = 1.0 - _SPARED * reserve
        return (max(self.hard, allowed), self.soft) < (max(other.hard, allowed), other.soft)


class _Part(NamedTuple):
    """The pieces of a requirement."""

    number: int  # of the requirement, or what else it is: below
    pieces: transfers.Pieces
    hard: bool
    slope: FloatArray | float = 0.0  # along log(bandwidth)


_LEVEL, _BELOW, _WANTED, _GROWTH, _LIMIT, _UNSEEN = -1, -2, -3, -4, -5, -6


class Search:
    """Searches among plants, the nominal one first.

    Without a soft requirement the largest hard piece is made small. Hard pieces end below 1 − reserve. `progress` is
    called with the largest hard piece and the largest soft ratio; infinite where a loop is not stable yet.
    """

    def __init__(
        self,
        plants: PlantSet,
        requirements: Sequence[LoopRequirement],
        reserve: float,
        progress: Callable[[float, float], None],
    ) -> None:
        # Where nothing is required of a plant, not even stability, it is of no interest.
        requested = [k for k, group in enumerate(plants.groups) if k == 0 or any(group in r.over for r in requirements)]
        plants = plants.only(requested)
        if any(one.metric.disturbed_by for one in requirements):
            plants = plants.with_disturbances()
        self._given, self._plants = plants, finer(plants.regular())
        self._regular = bool(plants.drifting)
        self._limits = [r for r in requirements if r.hard]
        bands = [r for r in requirements if r.kind == "bandwidth"]
        self._limit = max((r.limit for r in bands if r.hard), default=None)
        self._wanted = max((_BEYOND * r.limit for r in bands if not r.hard), default=None)
        self._moving = len(bands) > 0
        self._requirements = [r for r in requirements if r.kind != "bandwidth"]
        self._soft = any(not r.hard for r in requirements)
        # Where nothing is required of slow motion, a wanted bandwidth could be bought with a flat S.
        slow = {"tracking", "Omega rejection", "torque rejection"}
        self._guarded = self._wanted is not None and not any(r.kind in slow for r in requirements)
        self._reserve, self._left, self._progress = reserve, 0, progress
        self._view = np.zeros(1, dtype=np.intp)
        self._chosen = self._view[:0], self._plants

    def run(self, family: Parametrised, evaluations: int, sketch: bool = False) -> Found:
        """Return the best parameters of `family`.

        The search ends when the soft requirements are met too, or after so many evaluations. Of a `sketch` peaks
        between the grid's points may exceed limits.
        """
        self._left = evaluations
        best = self._run(family, family.start, sketch)
        rng = np.random.default_rng(0)
        for _ in range(_AGAIN):
            if self._left <= 0 or self._enough(best):
                break
            x = best.x + _SCATTER * rng.uniform(-1.0, 1.0, len(best.x))
            found = self._run(family, np.clip(x, family.lower, family.upper), sketch)
            best = found if found.better_than(best, self._reserve) else best
        return dataclasses.replace(best, evaluations=evaluations - self._left)

    def _run(self, family: Parametrised, start: FloatArray, sketch: bool) -> Found:
        """Return where the search from one start ends."""
        x = np.append(start, np.log(self._bandwidth(family, start))) if self._moving else start
        best = self._all(family, x)
        self._tell(best)
        for _ in range(_FINER):
            best = self._searched(family, best)
            missed = None if sketch else self._missed(family, best)
            if missed is None:
                break
            # Between the grid's points a limit is exceeded: they join the grid, and the search goes on from there.
            self._plants = self._plants.finer(missed)
            self._chosen = self._view[:0], self._plants
            best = self._all(family, best.x)
        return dataclasses.replace(best, x=best.x[: len(family.start)])

    def _missed(self, family: Parametrised, found: Found) -> FloatArray | None:
        """Return the frequencies at which a limit is exceeded that seems to be met; None where none is, exactly.

        Of the nominal plant and the worst ones.
        """
        if found.hard > 1.0:
            return None
        K = family.block(found.x[: len(family.start)])
        plants = self._given.on(self._plants.frequency) if self._regular else self._plants
        plants = plants.only(list(self._worst(found.at, _FIRST, -np.inf)))
        loops = Loop(plants, K)
        measures = measure(plants, K, self._limits, loops=loops)
        met = all(np.all(limit.ratios(measures) <= 1.0) for limit in self._limits)
        more = np.setdiff1d(loops.peak_frequencies, plants.frequency)
        return None if met or not len(more) else more

    def _searched(self, family: Parametrised, best: Found) -> Found:
        """Return where a search on the present grid ends that starts from `best`."""
        at, self._view = best, self._worst(best.at, _FIRST, -np.inf)
        H, radius, tries = np.eye(len(best.x)), _RADIUS, 0
        while self._left > 0 and tries < _TRIES and not self._enough(best):
            seen = len(self._view)
            found, ended = self._descended(family, at, H, radius)
            H, radius = found.hessian, found.radius
            before, at = at, self._all(family, self._honest(family, found.x))
            gained = at.hard < before.hard - _WORTH or at.soft < before.soft - _WORTH
            # Plants out of view that have become the worst.
            self._view = np.union1d(self._view, self._worst(at.at, 1, 1.0))
            tries = 0 if gained or len(self._view) > seen else tries + 1
            if at.better_than(best, self._reserve):
                best = at
                self._tell(best)
            if ended or not gained:
                at, H, radius = best, np.eye(len(best.x)), _CLOSE
        return best

    def _worst(self, at: Evaluation, count: int, floor: float) -> NDArray[np.intp]:
        """Return the nominal plant and the worst ones of each hard requirement from `floor` on, numbers (k,)."""
        chosen = np.zeros(1, dtype=np.intp)
        counted = at.hard | (not self._soft) | (not at.stable)
        for number in np.unique(at.owner[:, 0]):
            own = np.flatnonzero((at.owner[:, 0] == number) & counted & (at.values >= floor))
            order = at.owner[own[np.argsort(-at.values[own], kind="stable")], 1]
            _, first = np.unique(order, return_index=True)
            chosen = np.union1d(chosen, order[np.sort(first)[:count]])
        return chosen

    def _tell(self, found: Found) -> None:
        unstable = found.hard >= _UNSTABLE
        self._progress(np.inf if unstable else found.hard, np.inf if unstable else found.soft)

    def _enough(self, found: Found) -> bool:
        return found.hard <= 1.0 - _SPARED * self._reserve and found.soft <= _TARGET

    def _bandwidth(self, family: Parametrised, x: FloatArray) -> float:
        """Return the bandwidth in Hz, roughly, as a start for the wanted one."""
        loop = Loop(self._plants.only([0]), family.block(x[: len(family.start)]))
        sizes = np.maximum(*(largest_singular_values(S[0]) for S in loop.sensitivities))
        above = np.flatnonzero(sizes >= LEVEL)
        k = int(above[0]) if above.size else len(sizes) - 1
        return float(self._plants.frequency[max(k - 1, 0)]) / (2.0 * np.pi)

    def _honest(self, family: Parametrised, x: FloatArray) -> FloatArray:
        """Return the parameters with the bandwidth that is there, where the one that they claim is far from it."""
        if not self._moving:
            return x
        loops = LoopGradients(self._plants.only([0]), family.block(x[: len(family.start)]))
        level = loops.level(2.0 * np.pi * float(np.exp(x[-1])), 0.8)[0].ratio.max()
        there = np.log(self._bandwidth(family, x)) if level > 1.0 + _FAR else x[-1]
        return np.append(x[:-1], min(x[-1], there))

    def _all(self, family: Parametrised, x: FloatArray) -> Found:
        """Return what there is with all plants."""
        found = self._evaluated(family, x, np.arange(len(self._plants.labels)), _RANKED)
        largest = _ratio(float(found.values[found.hard].max(initial=0.0))) - self._reserve
        others = _ratio(float(found.values[~found.hard].max(initial=0.0)))
        if not found.stable:
            hard, soft = _UNSTABLE + float(found.values.max()), _UNSTABLE
        elif self._soft:
            hard, soft = largest, others
        else:
            hard, soft = max(others, largest), 0.0
        return Found(x=x, hard=hard, soft=soft, at=found)

    def _evaluated(self, family: Parametrised, x: FloatArray, view: NDArray[np.intp], floor: float) -> Evaluation:
        """Return all pieces of the plants in view; hard ones with the reserve added, so that 1 is their limit.

        Where a loop with any plant is not stable, its growth is all that counts, and the plant comes into view.
        """
        self._left -= 1
        own = x[: len(family.start)]
        K = family.block(own)
        unstable = LoopGradients(self._plants, K).unstable()
        view = np.union1d(view, unstable[:_MORE])
        self._view = np.union1d(self._view, unstable[:_MORE])
        if not np.array_equal(view, self._chosen[0]):
            self._chosen = view, self._plants.only(list(view))
        loops = LoopGradients(self._chosen[1], K, self._regular)
        if len(unstable):
            parts = [_Part(_GROWTH, loops.decay(0.0, np.arange(len(view))), False)]
            stable = False
        else:
            parts, stable = [], True
            for number, requirement in enumerate(self._requirements):
                hard = requirement.hard and self._soft
                found = pieces(loops, requirement, floor)
                parts.append(_Part(number, found.raised(self._reserve * hard) if hard else found.times(_TARGET), hard))
            parts += self._bandwidth_parts(loops, float(np.exp(x[-1])), floor) if self._moving else []
        hards = np.concatenate([np.full(len(one.pieces.ratio), one.hard) for one in parts])
        if np.all(hards):
            # Goals of which nothing is to be seen, such as torques without a limit.
            parts.append(_Part(_UNSEEN, loops.constant(0.0), False))
            hards = np.append(hards, False)
        ratios = np.concatenate([one.pieces.ratio for one in parts])
        derivative = family.jacobian(own)
        gradients = np.concatenate(
            [np.tensordot(one.pieces.gradient, derivative, axes=([1, 2], [0, 1])) for one in parts]
        )
        if self._moving:
            slopes = [np.broadcast_to(one.slope, len(one.pieces.ratio)) for one in parts]
            gradients = np.column_stack([gradients, np.concatenate(slopes)])
        owner = [np.column_stack([np.full(len(one.pieces.ratio), one.number), view[one.pieces.plant]]) for one in parts]
        # Far from met, ratios grow like 1/margin; their logarithm is nearer to a straight line.
        beyond = np.maximum(ratios, 1.0)
        return Evaluation(
            values=np.where(ratios > 1.0, 1.0 + np.log(beyond), ratios),
            gradients=np.nan_to_num(gradients / beyond[:, None], posinf=0.0, neginf=0.0),
            hard=hards,
            owner=np.concatenate(owner).astype(np.intp),
            stable=stable,
        )

    def _bandwidth_parts(self, loops: LoopGradients, bandwidth: float, floor: float) -> list[_Part]:
        """Return what requires S to stay below its level up to `bandwidth`, Hz, and a bandwidth as wanted."""
        frequency = 2.0 * np.pi * bandwidth
        found, slope = loops.level(frequency, floor)
        # Far above the bandwidth S is hardly larger than its level: what is beyond it counts several times.
        steep = np.where(found.ratio > 1.0, 1.0 if self._soft else _STEEP, 1.0)
        level = transfers.Pieces(
            ratio=1.0 + steep * (found.ratio - 1.0) + _TIGHT,
            gradient=steep[:, None, None] * found.gradient,
            plant=found.plant,
        )
        parts = [_Part(_LEVEL, level, True, steep * slope)]
        if self._guarded:
            found, slope = loops.level(0.1 * frequency, np.inf)
            share = LEVEL / _TENTH
            parts.append(_Part(_BELOW, found.times(share), True, share * slope))
        for number, least, hard in ((_WANTED, self._wanted, False), (_LIMIT, self._limit, self._soft)):
            if least is not None:
                share = least / bandwidth
                parts.append(_Part(number, loops.constant(share + self._reserve * hard), hard, -share))
        return parts

    def _descended(self, family: Parametrised, start: Found, H: FloatArray, radius: float) -> tuple[Minimum, bool]:
        """Return the result of some steps on the active plants, and whether the search has ended without its goals."""
        lower, upper = family.lower, family.upper
        if self._moving:
            lower, upper = np.append(lower, -np.inf), np.append(upper, np.inf)
        effort = Effort(
            evaluations=max(self._left, 1),
            steps=_STEPS,
            target=_TARGET if self._soft else 1.0 - self._reserve,
            excess=0.1 * self._reserve,
            tolerance=1e-4,
            unit=1.0,
            penalty=_PENALTY,
            radius=radius,
            least=1e-7,
            # Smaller factors than for norms: fewer of 27 jobs miss their limits.
            larger=2.0,
            smaller=0.4,
            hessian=H,
            start=start.at.only(np.isin(start.at.owner[:, 1], self._view)),
        )
        found = minimise(lambda y: self._evaluated(family, y, self._view, _FLOOR), start.x, (lower, upper), effort)
        at = found.at
        met = at.stable and at.largest(hard=False) <= effort.target and at.largest(hard=True) <= 1.0 + effort.excess
        return found, found.finished and not met


def _ratio(value: float) -> float:
    """Return the ratio that a piece was made of."""
    return float(np.exp(value - 1.0)) if value > 1.0 else value


def finer(plants: PlantSet) -> PlantSet:
    """Return the set on a grid on which no resonance of its closed loops hides between two points."""
    return plants.on(tuning_grid(plants.nutation, plants.period, fine=True))


def pieces(loops: LoopGradients, requirement: LoopRequirement, floor: float = 0.8) -> transfers.Pieces:
    """Return the pieces of a requirement whose ratio is at least `floor`, and the worst.

    A requirement is met where all its pieces are at most 1. Most are its ratios; "bandwidth" requires S at most 1/√2 up
    to its limit, "stability" counts decay rates in a share of the nutation frequency. Metrics without a gradient
    have no pieces.
    """
    plants, metric = loops.plants, requirement.metric
    limit, measure = metric.in_SI(requirement.limit), metric.measure
    members = np.flatnonzero([group in requirement.over for group in plants.groups])
    if not len(members):
        return loops.none()
    if isinstance(measure, Peak):
        below, factor = (floor / limit, limit) if measure.reciprocal else (floor * limit, 1.0 / limit)
        edges = [w for w in (requirement.lowest, requirement.frequency) if w]
        band = (requirement.lowest, requirement.frequency or np.inf)
        maps = [of for transfer in measure.transfers for of in maps_of(transfer, plants)]
        found = [loops.peaks(of, below, members, band) for of in maps]
        found += [loops.edge(of, edge, members) for of in maps for edge in edges]
        return transfers.joined([loops.none(), *found]).times(factor)
    if isinstance(measure, ControllerGain):
        nominal = np.zeros(1, dtype=np.intp)
        low = 0.1 * plants.nutation if requirement.frequency is None else requirement.frequency
        inside = loops.peaks(CONTROLLER, floor * limit, nominal, (low, np.inf))
        return transfers.joined([inside, loops.edge(CONTROLLER, low, nominal)]).times(1.0 / limit)
    if isinstance(measure, Sight):
        forms = (plants.sight_forms or {}).get(measure.key, ())
        return loops.sight(forms, blur_of(limit) if measure.worst == 0.0 else limit) if forms else loops.none()
    match requirement.kind:
        case "stability":
            return loops.decay(limit, members)
        case "bandwidth":
            return loops.level(limit, floor)[0]
        case "damping":
            return loops.damping(floor, limit, members)
        case "fastest pole":
            return loops.fastest(floor, limit, members)
        case "torque noise":
            return loops.noise(limit, members)
        case "fastest controller pole":
            return loops.controller_poles(floor, limit)
    return loops.none()
