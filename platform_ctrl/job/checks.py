"""What must fit together in a job file: loops, their designs, the plant's gimbals.

Like the checks of the plant, these read the plain data and pass over what the structure check refuses.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

from platform_ctrl.analysis.metrics import METRICS
from platform_ctrl.job.job import Job, manoeuvre_scenario
from platform_ctrl.job.methods import METHODS
from platform_ctrl.job.parameter_limits import misfits
from platform_ctrl.job.requirements import limit_keys
from platform_ctrl.job.run_checks import run_mistakes
from platform_ctrl.job.variation import CENTRES, DISTRIBUTION_NUMBERS
from platform_ctrl.plant.checks import number_of
from platform_ctrl.plant.mistakes import Mistake, Path, given, one_line, suggestion, tables, text_of, unique_names
from platform_ctrl.plant.platform import ROOT_TORQUE_NAMES, Platform
from platform_ctrl.plant.tables import unknown_key

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
        yield Mistake(("campaign",), "[campaign]: the job has no manoeuvre to simulate; expected [[manoeuvre]]")
    for kind, key, of in (("manoeuvre", "name", "manoeuvre"), ("fault", "fault", "fault")):
        known = [name for _, table in tables(data, of) if (name := text_of(table, "name")) is not None]
        taken: dict[str, int] = {}
        for k, table in tables(campaign, kind):
            name = text_of(table, key)
            if name is None:
                continue
            wrong = f"{key} = {given(name)}"
            path: Path = ("campaign", kind, k, key)
            if name not in known:
                yield Mistake(path, f"{wrong}: is no [[{of}]] of the job; {suggestion(name, known)}")
            elif name in taken:
                yield Mistake(path, f"{wrong}: is in [[campaign.{kind}]] {taken[name] + 1} already; expected it once")
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
            wrong = f"distribution = {given(name)} needs {', '.join(needed)}"
            yield Mistake((*path, key), f'missing key "{key}": {wrong}')
    for key in (*_NUMBERS, "values", "weights"):
        if key in table and key not in (("values", "weights") if choice else keys):
            wrong = f"{key} = {given(table[key])}: means nothing for distribution = {given(name)}"
            yield Mistake((*path, key), f"{wrong}; expected {', '.join((*needed, *(('weights',) if choice else ())))}")
    if choice:
        yield from _weights(table, path)
        return
    n = {key: number for key in keys if (number := number_of(table, key)) is not None}
    if "mean" not in n and "mean" in keys:
        n["mean"] = 1.0
    if name == "log-normal" and n.get("deviation", 0.0) > WIDEST:
        wrong = (
            f"deviation = {given(table['deviation'])}: one in six is e^{n['deviation']:.6g} times the median or more"
        )
        yield Mistake((*path, "deviation"), f"{wrong}; expected at most {WIDEST:g}")
    low, high = n.get("low"), n.get("high")
    if low is None or high is None:
        return
    if not low < high:
        yield Mistake(
            (*path, "high"),
            f"high = {given(table['high'])}: not above low = {given(table['low'])}; expected a larger number",
        )
    elif name == "log-uniform" and low <= 0.0:
        yield Mistake((*path, "low"), f"low = {given(table['low'])}: has no logarithm; expected a number > 0")
    elif name == "triangular" and not low <= n.get("peak", 1.0) <= high:
        wrong = f"peak = {given(n.get('peak', 1.0))}: not between low and high"
        yield Mistake((*path, "peak"), f"{wrong}; expected {low:.6g} to {high:.6g}")
    elif name == "truncated-normal" and n.get("deviation", 0.0) > 0.0:
        nearest = max(low - n["mean"], n["mean"] - high)
        if nearest > FARTHEST * n["deviation"]:
            wrong = f"mean = {given(n['mean'])}: lies {nearest / n['deviation']:.4g} deviations outside low and high"
            yield Mistake((*path, "mean"), f"{wrong}; expected at most {FARTHEST:g}")


def _weights(table: Data, path: Path) -> Iterator[Mistake]:
    values, weights = table.get("values"), table.get("weights")
    if not isinstance(values, list) or not isinstance(weights, list):
        return
    numbers = [number_of({"weight": weight}, "weight") for weight in weights]
    if len(values) != len(weights):
        wrong = f"weights = {given(weights)}: has {len(weights)} element{'' if len(weights) == 1 else 's'}"
        yield Mistake((*path, "weights"), f"{wrong}; expected {len(values)}, as values has")
    elif all(number is not None for number in numbers):
        found = [number for number in numbers if number is not None]
        if min(found, default=0.0) < 0.0 or not any(found):
            yield Mistake((*path, "weights"), f"weights = {given(weights)}: expected numbers >= 0, not all of them 0")


def variation_mistakes(job: Job) -> Iterator[Mistake]:
    """Walk what a campaign varies although the job has no such number, or would not accept what may be drawn."""
    if job.campaign is None:
        return
    scenarios = [manoeuvre_scenario(job, manoeuvre) for manoeuvre, _ in job.campaign_manoeuvres]
    for k, key, line in misfits(job.campaign.vary, scenarios, job.fault_events):
        yield Mistake(("campaign", "vary", k, key), one_line(line))


# Sample periods from sample to torque at most: each is a state of every torquer in every plant.
LONGEST_DELAY = 100


def job_mistakes(data: Data, platform: Platform | None) -> list[Mistake]:
    """Return what does not fit together in a job file; without a platform, what can be said without it."""
    return [
        *unique_names(data, (), "loop"),
        *unique_names(data, (), "manoeuvre"),
        *unique_names(data, (), "fault"),
        *_sampling(data),
        *_sets(data),
        *_designs(data),
        *_loops(data, platform),
        *run_mistakes(data, platform),
        *campaign_mistakes(data),
    ]


def _sets(data: Data) -> Iterator[Mistake]:
    """Judge what the sets of plants are made of."""
    uncertainty = data.get("uncertainty")
    samples = number_of(uncertainty, "samples") if isinstance(uncertainty, dict) else None
    if (
        isinstance(uncertainty, dict)
        and samples
        and not any(number_of(uncertainty, key) for key in ("inertia", "spin"))
    ):
        wrong = f"samples = {given(uncertainty['samples'])}: neither inertia nor spin is uncertain"
        yield Mistake(("uncertainty", "samples"), f"{wrong}; expected inertia or spin > 0 beside it")
    faults = data.get("faults")
    for i, loop in tables(data, "loop"):
        for table in ("limits", "soft"):
            limits = loop.get(table)
            if not isinstance(limits, dict):
                continue
            yield from _limits(limits, ("loop", i, table), isinstance(faults, dict) and bool(faults))


def _limits(limits: Data, path: Path, faults: bool) -> Iterator[Mistake]:
    known = limit_keys()
    for key in sorted(limits):
        if key not in known:
            yield unknown_key((*path, key), limits[key], list(known))
        elif known[key][1] == "faults" and not faults:
            wrong = f"{key}: the job has no plants with faults"
            yield Mistake((*path, key), f"{wrong}; expected [faults] with slow_rotor or weak_torquer")
    for metric in METRICS.values():
        edge = metric.frequency_key
        for key, other in ((edge, metric.key), (metric.key, edge if metric.needs_frequency else "")):
            if other and key in limits and other not in limits:
                yield Mistake((*path, other), f'missing key "{other}": {key} means nothing without it')


def _sampling(data: Data) -> Iterator[Mistake]:
    table = data.get("sampling")
    if not isinstance(table, dict):
        return
    rate, delay = number_of(table, "rate_hz"), number_of(table, "delay")
    if rate is None or delay is None or rate <= 0.0 or delay < 0.0:
        return
    periods = rate * delay
    if not periods <= LONGEST_DELAY:
        wrong = f"delay = {given(delay)}: is {periods:.4g} sample periods"
        yield Mistake(("sampling", "delay"), f"{wrong}; expected at most {LONGEST_DELAY}, or a lower rate_hz")


def _designs(data: Data) -> Iterator[Mistake]:
    for i, loop in tables(data, "loop"):
        path: Path = ("loop", i)
        yield from unique_names(loop, path, "design")
        names = []
        for k, design in tables(loop, "design"):
            names.append(text_of(design, "name"))
            yield from _design(design, (*path, "design", k), text_of(loop, "kind"))
        use = text_of(loop, "use")
        known = [name for name in names if name is not None]
        if use is not None and known and len(known) == len(names) and use not in known:
            wrong = f"use = {given(use)}: no design of this loop has that name"
            yield Mistake((*path, "use"), f"{wrong}; {suggestion(use, known)}")


def _design(design: Data, path: Path, kind: str | None) -> Iterator[Mistake]:
    key = text_of(design, "method")
    if key is None or key not in METHODS:
        return
    method = METHODS[key]
    known = ["name", "method", "tune", *sorted(method.options)]
    if method.structures:
        known.insert(2, "structure")
    yield from (unknown_key((*path, name), item, known) for name, item in design.items() if name not in known)
    for option in sorted(method.options):
        number = number_of(design, option)
        if number is not None and not number > 0:
            yield Mistake((*path, option), f"{option} = {given(number)}: expected a number > 0")
    if design.get("tune") is True and not method.tunes:
        tuned = ", ".join(given(name) for name in sorted(METHODS) if METHODS[name].tunes)
        yield Mistake((*path, "tune"), f"tune = true: method {given(key)} has no tuner; expected one of {tuned}")
    if kind in ("caging", "stabilisation") and method.kind != kind:
        expected = " or ".join(given(name) for name in METHODS if METHODS[name].kind == kind)
        yield Mistake((*path, "method"), f"method = {given(key)}: does not make a {kind} loop; expected {expected}")


def _loops(data: Data, platform: Platform | None) -> Iterator[Mistake]:
    caged_by: dict[str, int] = {}
    stabilisation = None
    for i, loop in tables(data, "loop"):
        path: Path = ("loop", i)
        match text_of(loop, "kind"):
            case "caging" if "gimbals" not in loop or loop["gimbals"] == []:
                yield Mistake((*path, "gimbals"), "gimbals: expected the names of the gimbals that the loop cages")
            case "caging":
                if stabilisation is not None:
                    wrong = f"[[loop]] {stabilisation + 1} stabilises the root with the torques of the caged gyros"
                    yield Mistake((*path, "kind"), f"kind: {wrong}; expected the caging loops before it")
                yield from _caged_gimbals(loop["gimbals"], (*path, "gimbals"), i, caged_by, platform)
            case "stabilisation":
                if "gimbals" in loop:
                    wrong = f"gimbals = {given(loop['gimbals'])}: a stabilisation loop turns the root"
                    yield Mistake((*path, "gimbals"), f"{wrong}; leave the key out")
                limits = loop.get("limits")
                known = limit_keys()
                fitting = ", ".join(sorted(key for key, (metric, _) in known.items() if METRICS[metric].of_root))
                for key in limits if isinstance(limits, dict) else ():
                    if key in known and not METRICS[known[key][0]].of_root:
                        wrong = f"{key}: a stabilisation loop is judged in the coupled system"
                        yield Mistake((*path, "limits", key), f"{wrong}; expected {fitting}, or a limit of [coupled]")
                if "soft" in loop:
                    wrong = "soft: no method of a stabilisation loop minimises anything"
                    yield Mistake((*path, "soft"), f"{wrong}; leave the table out")
                if stabilisation is not None:
                    yield Mistake((*path, "kind"), f"kind: [[loop]] {stabilisation + 1} stabilises the root already")
                else:
                    stabilisation = i
                    yield from _root_torquers((*path, "kind"), platform)


def _caged_gimbals(
    gimbals: object, path: Path, loop: int, caged_by: dict[str, int], platform: Platform | None
) -> Iterator[Mistake]:
    if not isinstance(gimbals, list) or not all(isinstance(name, str) for name in gimbals):
        return
    for name in gimbals:
        wrong = f"gimbals = {given(gimbals)}: {given(name)}"
        if name in caged_by:
            yield Mistake(path, f"{wrong} is caged by [[loop]] {caged_by[name] + 1} already; expected it once")
        caged_by.setdefault(name, loop)
        if platform is None:
            continue
        if name not in platform.gimbal_names:
            yield Mistake(path, f"{wrong} is no gimbal of the plant; {suggestion(name, platform.gimbal_names)}")
            continue
        have = {
            "torquer": any(torquer.gimbal == name for torquer in platform.torquers),
            "pick-off": any(pickoff.gimbal == name for pickoff in platform.pickoffs),
        }
        for part, there in have.items():
            if not there:
                yield Mistake(path, f"{wrong} has no {part} in the plant; expected one on every caged gimbal")


def _root_torquers(path: Path, platform: Platform | None) -> Iterator[Mistake]:
    if platform is None:
        return
    there = {torquer.root_axis for torquer in platform.torquers}
    lacking = [name for axis, name in enumerate(ROOT_TORQUE_NAMES, 1) if axis not in there]
    if lacking:
        wrong = f'kind = "stabilisation": the plant has no root torquer {", ".join(lacking)}'
        yield Mistake(path, f"{wrong}; expected [[torquer]] with root_axis 1, 2 and 3")
