"""What must fit together in a campaign: its tables, its distributions, and the numbers that can be drawn from them."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from typing import Any

from platform_ctrl.common.signatures import check_arguments
from platform_ctrl.job.faults import Fault
from platform_ctrl.job.job import Job, manoeuvre_scenario
from platform_ctrl.job.parameters import Parameter, drawn_value, nominal, parameters, unknown_parameter
from platform_ctrl.job.scenario import Scenario
from platform_ctrl.job.variation import CENTRES, DISTRIBUTION_NUMBERS, Vary
from platform_ctrl.plant.checks import number_of
from platform_ctrl.plant.entry import Entry
from platform_ctrl.plant.mistakes import Mistake, Path, given, one_line, suggestion, tables, text_of

Data = dict[str, Any]

_NUMBERS = sorted({key for keys in DISTRIBUTION_NUMBERS.values() for key in keys})
_KEYS = {"parameter", "distribution", "relative", "values", "weights", *_NUMBERS}
# Standard deviations from the mean at which a truncated normal distribution has to start at the latest: beyond, there
# is less than 1e-15 of it, and its quantiles are rounding.
FARTHEST = 8.0
# Standard deviation of a natural logarithm at most: of numbers that lie further apart, some are none any more.
WIDEST = 10.0


def campaign_mistakes(data: Data) -> Iterator[Mistake]:
    """Walk what can be said of the plain data."""
    campaign = data.get("campaign")
    if not isinstance(campaign, dict):
        return
    if not data.get("manoeuvre"):
        yield Mistake(("campaign",), "[campaign] has no manoeuvre to simulate; add a [[manoeuvre]] to the job")
    for kind, key, of in (("manoeuvre", "name", "manoeuvre"), ("fault", "fault", "fault")):
        known = [name for _, table in tables(data, of) if (name := text_of(table, "name")) is not None]
        taken: dict[str, int] = {}
        for k, table in tables(campaign, kind):
            name = text_of(table, key)
            if name is None:
                continue
            path: Path = ("campaign", kind, k)
            if name not in known:
                words = f"the name of a [[{of}]] of the job"
                yield Mistake.wrong(table, path, key, words, f"; {suggestion(name, known)}")
            elif name in taken:
                words = f"{given(name)} is in [[campaign.{kind}]] {taken[name] + 1} already; leave one of them out"
                yield Mistake((*path, key), f"{key}: {words}")
            taken.setdefault(name, k)
    for k, table in tables(campaign, "vary"):
        yield from _distribution(table, ("campaign", "vary", k))


def _distribution(table: Data, path: Path) -> Iterator[Mistake]:
    name = text_of(table, "distribution")
    keys = next((keys for known, keys in DISTRIBUTION_NUMBERS.items() if known == name), None)
    if keys is None:
        return
    choice = name == "choice"
    needed = ("values",) if choice else keys
    # A factor lies about 1 unless it is said otherwise; whether it is one is not known where that is written wrongly.
    factor = table.get("relative") is True or not isinstance(table.get("relative", False), bool) or set(table) - _KEYS
    for key in needed:
        if key not in table and not (key in CENTRES and factor):
            yield Mistake.missing(path, key, f"distribution = {given(name)} needs {', '.join(needed)}")
    for key in (*_NUMBERS, "values", "weights"):
        if key in table and key not in (("values", "weights") if choice else keys):
            takes = ", ".join((*needed, *(("weights",) if choice else ())))
            yield Mistake.useless(table, path, key, f"with distribution = {given(name)}, which takes {takes}")
    if choice:
        yield from _weights(table, path)
        return
    n = {key: number for key in keys if (number := number_of(table, key)) is not None}
    if "mean" not in n and "mean" in keys:
        n["mean"] = 1.0
    if name == "log-normal" and n.get("deviation", 0.0) > WIDEST:
        far = f": one number in six would be e^{n['deviation']:.6g} times the median or more"
        yield Mistake.wrong(table, path, "deviation", f"at most {WIDEST:g}", far)
    low, high = n.get("low"), n.get("high")
    if low is None or high is None:
        return
    if not low < high:
        yield Mistake.wrong(table, path, "high", f"above low = {given(table['low'])}")
    elif name == "log-uniform" and low <= 0.0:
        yield Mistake.wrong(table, path, "low", "a number > 0, which has a logarithm")
    elif name == "triangular" and not low <= n.get("peak", 1.0) <= high:
        words = f"peak must be from low, {low:.6g}, to high, {high:.6g}, got {given(n.get('peak', 1.0))}"
        yield Mistake((*path, "peak"), words)
    elif name == "truncated-normal" and n.get("deviation", 0.0) > 0.0:
        nearest = max(low - n["mean"], n["mean"] - high)
        if nearest > FARTHEST * n["deviation"]:
            words = f"at most {FARTHEST:g} deviations outside low and high"
            far = f", {nearest / n['deviation']:.4g} deviations outside"
            yield Mistake.wrong(n, path, "mean", words, far)


def _weights(table: Data, path: Path) -> Iterator[Mistake]:
    values, weights = table.get("values"), table.get("weights")
    if not isinstance(values, list) or not isinstance(weights, list):
        return
    numbers = [number_of({"weight": weight}, "weight") for weight in weights]
    if len(values) != len(weights):
        yield from Entry(table, path).of_length("weights", "values")
    elif all(number is not None for number in numbers):
        found = [number for number in numbers if number is not None]
        if min(found, default=0.0) < 0.0 or not any(found):
            yield Mistake.wrong(table, path, "weights", "numbers >= 0, not all of them 0")


def variation_mistakes(job: Job) -> Iterator[Mistake]:
    """Walk what a campaign varies although the job has no such number, or would not accept what may be drawn."""
    if job.campaign is None:
        return
    scenarios = [manoeuvre_scenario(job, manoeuvre) for manoeuvre, _ in job.campaign_manoeuvres]
    for k, key, line in misfits(job.campaign.vary, scenarios, job.fault_events):
        yield Mistake(("campaign", "vary", k, key), one_line(line))


@check_arguments
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
