"""The structured caging loop: a controller of fixed structure, tuned on the loop's own requirements over its plants.

The requirements themselves are optimised, without weights: limits are hard, goals are soft. The search starts from
physics and goes up in steps: the cross-axis loop of the classical design, its numbers moved; a full PID with filter;
from there, if requested, every matrix entry of a controller of fixed order behind a PI in every channel.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable, Sequence

import numpy as np

from platform_ctrl.analysis.arrays import StateArrays
from platform_ctrl.analysis.plant_set import PlantSet
from platform_ctrl.design.classical.caging import TUNABLE, classical_controller, starting_values, upper_bounds
from platform_ctrl.design.loop import Designed, LoopProblem, completed
from platform_ctrl.design.partition import Channels
from platform_ctrl.design.riccati.weighted_loop import hinf_design
from platform_ctrl.design.structured.descent import Found, Search
from platform_ctrl.design.structured.families import Family, Named, Pid, StateSpace, of_order, without_integrators
from platform_ctrl.errors import DesignError
from platform_ctrl.job.job import DesignSpec, Structure
from platform_ctrl.job.requirements import LoopRequirement, hard_and_soft, requirement

# Share of the integral rate that the slowest closed-loop pole keeps: integral action that does not act is none.
_INTEGRAL_KEPT = 0.5
# Shares of the evaluations on the way from one structure to the next.
# Options of some structures alone, options that count something, and the largest count.
_STRUCTURES: dict[str, tuple[Structure, ...]] = {
    "order": ("state-space",),
    "starts": ("pid", "state-space"),
    "rolloff_hz": ("pid", "state-space"),
}
_COUNTS, _MOST = {"order", "starts", "evaluations"}, 1e6
_DEFAULT: Structure = "pid"
_SHARES = {"cross-axis": 0.2, "pid": 0.3, "state-space": 0.5}


def structured_design(problem: LoopProblem) -> Designed:
    """Return the structured loop of a job: its limits as constraints, its goals minimised."""
    spec, design, channel, plants = problem.spec, problem.design, problem.channel, problem.plants
    structure = design.structure or _DEFAULT
    options = default_options(design, channel, plants.nutation, plants.period)
    first = starting_values({"integral_hz": options["integral_hz"]}, channel, plants.nutation, plants.period)
    cross_axis = Named(
        lambda trial: classical_controller(trial, channel, plants.period), first, TUNABLE, upper_bounds(plants.period)
    )
    full_order = dataclasses.replace(problem, design=DesignSpec(name=design.name, method="hinf", options={}))
    hard, soft = hard_and_soft(spec.limits, spec.soft)

    def progress(limits: float, goals: float) -> None:
        ratios = f"limits at {limits:.0%}" + (f", goals at {goals:.0%}" if soft else "")
        problem.say(
            f"{spec.name}: {design.name}, {ratios if math.isfinite(limits) else 'not stable with all plants yet'}"
        )

    others = [lambda: hinf_design(full_order, "riccati").controller]
    return tuned_controller(options, structure, cross_axis, channel, plants, (*hard, *soft), others, progress)


def default_options(design: DesignSpec, channel: Channels, nutation: float, period: float) -> dict[str, float]:
    """Return all options of a structure, those not given from rules of thumb."""
    given, structure = design.options, design.structure or _DEFAULT
    defaults = {
        "order": 3.0 * len(channel.basis),
        "starts": 1.0,
        "integral_hz": 0.024 * nutation / (2.0 * np.pi),
        "rolloff_hz": 0.4 / period,
        "reserve": 0.01,
        "evaluations": 400.0,
    }
    own = {name: x for name, x in defaults.items() if structure in _STRUCTURES.get(name, (structure,))}
    out = completed(f'structured, structure = "{structure}"', given, own)
    for name in sorted(_COUNTS & set(out)):
        if not (float(out[name]).is_integer() and out[name] <= _MOST):
            raise DesignError(f"structured: {name} = {out[name]:g}; expected a whole number from 1 to {_MOST:g}")
    bounds = {"reserve": (1.0, ""), "integral_hz": (0.5 / period, " Hz, half the sample rate")}
    for name, (bound, text) in (bounds | {"rolloff_hz": bounds["integral_hz"]}).items():
        if not out.get(name, 0.0) < bound:
            raise DesignError(f"structured: {name} = {out[name]:g}; expected less than {bound:g}{text}")
    return out


def tuned_controller(
    options: dict[str, float],
    structure: Structure,
    cross_axis: Named,
    channel: Channels,
    plants: PlantSet,
    requirements: Sequence[LoopRequirement],
    others: Sequence[Callable[[], StateArrays]],
    progress: Callable[[float, float], None],
) -> Designed:
    """Return a controller of the given structure that meets the requirements, or comes nearest.

    Parameters
    ----------
    options
        Complete (see `default_options`). ``order``: states of "state-space" beside the integrators; ``integral_hz``:
        of the PI, kept; ``rolloff_hz``: where the PID's filter starts; ``starts``: how many starting points there are.
    structure
        ``"cross-axis"``, ``"pid"`` or ``"state-space"``.
    cross_axis
        The classical loop, where every search starts.
    channel, plants
        Directions and plants, the nominal one first.
    requirements
        Limits and goals.
    others
        Further starting points, tried in turn where ``starts`` asks for more than one.
    progress
        Called with the largest ratio of a limit and of a goal; infinite where a loop is not stable yet.
    """
    integral = 2.0 * np.pi * options["integral_hz"]
    kept = _INTEGRAL_KEPT * integral
    requested = [dataclasses.replace(r, limit=max(r.limit, kept)) if r.kind == "stability" else r for r in requirements]
    if not any(r.kind == "stability" for r in requested):
        requested.append(requirement("stability", kept))
    spent = 0

    def search(family: Family, share: float) -> Found:
        nonlocal spent
        most = int(share * options["evaluations"])
        found = Search(plants, requested, options["reserve"], most, progress).run(family)
        spent += found.evaluations
        return found

    first = search(cross_axis, 1.0 if structure == "cross-axis" else _SHARES["cross-axis"])
    best: tuple[Found, Family] = first, cross_axis
    starts: list[Callable[[], StateArrays]] = [lambda: cross_axis.block(first.x), *others]
    starts = starts[: int(options["starts"])] if structure != "cross-axis" else []
    for start in starts:
        try:
            block = start()
        except DesignError:
            # Another method that finds nothing is no reason to give up the first start.
            continue
        rolloff = min(2.0 * np.pi * options["rolloff_hz"], 0.8 * np.pi / plants.period)
        pid = Pid(block, channel, plants.period, plants.nutation, integral, rolloff)
        found = search(pid, _SHARES["pid"] if structure == "state-space" else 1.0 - _SHARES["cross-axis"])
        if found.better_than(best[0], options["reserve"]):
            best = found, pid
        if structure == "state-space":
            inner = without_integrators(pid.block(found.x), channel, integral, plants.period)
            if inner is None:
                continue
            inner = of_order(inner, int(options["order"]), plants.nutation * plants.period)
            free = StateSpace(inner, channel, plants.period, plants.nutation, integral)
            found = search(free, _SHARES["state-space"])
            if found.better_than(best[0], options["reserve"]):
                best = found, free
    found, family = best
    controller = family.block(found.x)
    claims = {
        "parameters": float(len(family.start)),
        "order": float(len(controller.A)),
        "starts": float(max(1, len(starts))),
        "evaluations": float(spent),
    }
    if structure == "cross-axis":
        options = options | cross_axis.values(found.x)
    return Designed(controller=controller, options=options, claims=claims)
