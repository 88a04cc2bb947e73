"""What must fit together about the campaign of a job file: its manoeuvres and faults, and what it varies."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

from platform_ctrl.job import Job, manoeuvre_scenario
from platform_ctrl.parameters import misfits
from platform_ctrl.reading.mistakes import Mistake, Path, given, one_line, suggestion, tables, text_of
from platform_ctrl.reading.plant_checks import number_of
from platform_ctrl.variation import CENTRES, DISTRIBUTION_NUMBERS

Data = dict[str, Any]

_NUMBERS = sorted({key for keys in DISTRIBUTION_NUMBERS.values() for key in keys})
_KEYS = {"parameter", "distribution", "relative", "values", "weights", *_NUMBERS}
# Standard deviations from the mean at which a truncated normal distribution has to begin at the latest: beyond, there
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
        yield Mistake(("campaign",), "[campaign]: the job has no manoeuvre that could be flown; expected [[manoeuvre]]")
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
                yield Mistake(
                    path, f"{wrong}: stands in [[campaign.{kind}]] {taken[name] + 1} already; expected it once"
                )
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
    scenarios = [manoeuvre_scenario(job, manoeuvre) for manoeuvre, _ in job.flown]
    for k, key, line in misfits(job.campaign.vary, scenarios, job.fault_events):
        yield Mistake(("campaign", "vary", k, key), one_line(line))
