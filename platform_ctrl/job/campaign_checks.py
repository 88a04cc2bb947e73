"""What a campaign can draw that the job would not accept."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence

from platform_ctrl.job.faults import Fault
from platform_ctrl.job.job import Job, manoeuvre_scenario
from platform_ctrl.job.parameters import Parameter, drawn_value, nominal, parameters, unknown_parameter
from platform_ctrl.job.scenario import Scenario
from platform_ctrl.job.variation import Vary
from platform_ctrl.plant.mistakes import Mistake, one_line


def variation_mistakes(job: Job) -> Iterator[Mistake]:
    """Walk what a campaign varies although the job has no such number, or would not accept what may be drawn."""
    if job.campaign is None:
        return
    scenarios = [manoeuvre_scenario(job, manoeuvre) for manoeuvre, _ in job.campaign_manoeuvres]
    for k, key, line in misfits(job.campaign.vary, scenarios, job.fault_events):
        yield Mistake(("campaign", "vary", k, key), one_line(line))


def misfits(
    varied: Sequence[Vary], scenarios: Sequence[Scenario], faults: Sequence[Fault]
) -> Iterator[tuple[int, str, str]]:
    """Walk what cannot be drawn.

    A value that a plant or job file would refuse is refused here if it can be drawn at all, however seldom.

    Parameters
    ----------
    varied
        What differs from run to run.
    scenarios
        The nominal runs, one for each manoeuvre that is simulated.
    faults
        What may fail in them.

    Yields
    ------
    entry, key, line
        The number of the entry of `varied`, its key that is wrong, and a line that says why.
    """
    known = parameters(scenarios, faults)
    drawn: dict[str, tuple[float, float]] = {}
    place: dict[str, int] = {}
    for k, vary in enumerate(varied):
        path = vary.parameter
        if path not in known:
            yield k, "parameter", f'parameter = "{path}": does not exist; {unknown_parameter(path, known)}'
        elif path in place:
            yield k, "parameter", f'parameter = "{path}": is varied already, in [[campaign.vary]] {place[path] + 1}'
        elif lacking := [key for key in vary.needed if key not in vary.numbers]:
            yield k, lacking[0], f'distribution = "{vary.distribution}" needs the number "{lacking[0]}"'
        elif vary.distribution == "choice" and not vary.values:
            yield k, "values", 'distribution = "choice" needs at least one value'
        else:
            place[path] = k
            line = _misfit(vary, known[path], scenarios, faults, drawn)
            if line is not None:
                yield k, "relative" if line.startswith("relative") else "distribution", line
    by_path = {vary.parameter: vary for vary in varied}
    for one, other, line in _misfit_pairs(by_path, drawn, known, scenarios[0] if scenarios else None, faults):
        yield place.get(one, place.get(other, 0)), "distribution", line


def _misfit(
    vary: Vary,
    parameter: Parameter,
    scenarios: Sequence[Scenario],
    faults: Sequence[Fault],
    drawn: dict[str, tuple[float, float]],
) -> str | None:
    low, high = vary.support
    if parameter.factor:
        if not vary.relative and parameter.key == "inertia":
            return f'relative must be true: "{vary.parameter}" is a matrix that is scaled as a whole'
    elif vary.relative:
        present = [x for one in scenarios if (x := nominal(parameter, one, faults)) is not None]
        if not any(present):
            having = "is 0 as it stands" if present else "has no value as it stands"
            return f'relative must be false, with the number itself: "{vary.parameter}" {having}'
        ends = [x * end for x in present if x for end in (low, high)]
        low, high = min(ends), max(ends)
    drawn[vary.parameter] = (low, high)
    if parameter.allowed.holds(low, high, vary.distribution != "choice"):
        return None
    bounded = " or ".join(f'"{name}"' for name in ("truncated-normal", "log-normal") if low == -math.inf)
    cure = f"; use {bounded}" if bounded else ""
    return (
        f'distribution = "{vary.distribution}": "{vary.parameter}" would be drawn between {low:.6g} and {high:.6g}; '
        f"allowed is {parameter.allowed.words}{cure}"
    )


def _misfit_pairs(
    varied: dict[str, Vary],
    drawn: dict[str, tuple[float, float]],
    known: dict[str, Parameter],
    scenario: Scenario | None,
    faults: Sequence[Fault],
) -> Iterator[tuple[str, str, str]]:
    """Walk pairs of numbers that could be drawn so that one forbids the other."""
    if scenario is None:
        return

    def reach(path: str) -> tuple[float, float] | None:
        as_it_stands = nominal(known[path], scenario, faults) if path in known else None
        return drawn.get(path, None if as_it_stands is None else (as_it_stands, as_it_stands))

    for rotor in scenario.platform.rotors:
        of = f"rotor.{rotor.name}"
        axial, transverse = f"{of}.axial_inertia", f"{of}.transverse_inertia"
        if axial in drawn or transverse in drawn:
            highest, least = reach(axial), reach(transverse)
            if highest and least and least[0] < 0.5 * highest[1] * (1.0 - 1e-9):
                line = f"would be drawn down to {least[0]:.6g} beside an axial inertia up to {highest[1]:.6g}"
                yield transverse, axial, f'"{transverse}" {line}; allowed is at least half of it'
        if f"{of}.spin" in drawn and f"{of}.angular_momentum" in drawn:
            yield (
                f"{of}.angular_momentum",
                "",
                f'"{of}.angular_momentum": "{of}.spin" is varied already; leave one of them out',
            )
    for friction in scenario.platform.frictions:
        dry, breakaway = (f"friction.{friction.gimbal}.{key}" for key in ("coulomb", "breakaway"))
        if breakaway in known and (dry in drawn or breakaway in drawn):
            highest_dry, least_breakaway = friction.coulomb, friction.breakaway
            if dry in drawn:
                highest_dry = drawn_value(friction, "coulomb", varied[dry].support[1], varied[dry].relative)
            if breakaway in drawn:
                least_breakaway = drawn_value(
                    friction, "breakaway", varied[breakaway].support[0], varied[breakaway].relative
                )
            if any(low < high for low, high in zip(least_breakaway, highest_dry, strict=True)):
                line = f"would be drawn up to {max(highest_dry):.6g} N m, above a breakaway torque"
                yield dry, breakaway, f'"{dry}" {line} of {min(least_breakaway):.6g} N m; keep it below'
    for fault in faults:
        begin, end = f"fault.{fault.name}.at", f"fault.{fault.name}.until"
        if begin in drawn or end in drawn:
            latest, earliest = reach(begin), reach(end)
            if latest and earliest and latest[1] >= earliest[0]:
                line = f"would be drawn up to {latest[1]:.6g} s, and it ends from {earliest[0]:.6g} s on"
                yield begin, end, f'"{begin}" {line}; let it begin before it ends'
