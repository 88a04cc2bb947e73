"""What must fit together in a job file: loops, their designs, the plant's gimbals.

Like the checks of the plant, these read the plain data and pass over what the structure check refuses.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator, Mapping
from typing import Any

from platform_ctrl.description import ROOT_TORQUE_NAMES, Platform
from platform_ctrl.job import LoopLimits
from platform_ctrl.reading.campaign_checks import campaign_mistakes
from platform_ctrl.reading.mistakes import Mistake, Path, given, suggestion, tables, text_of, unique_names
from platform_ctrl.reading.plant_checks import number_of
from platform_ctrl.reading.run_checks import run_mistakes
from platform_ctrl.reading.structure import unknown_key

Data = dict[str, Any]

# Every other method designs a caging loop.
STABILISING = frozenset({"platform-servo"})

# Methods that are told what the controller is made of.
STRUCTURED = frozenset({"structured"})

# Methods whose numbers can be moved to meet the loop's limits.
TUNED = frozenset({"classical"})

LOOP_LIMITS = frozenset(field.name for field in dataclasses.fields(LoopLimits))
# What a stabilisation loop is judged by; it has no plants of its own, so the other limits mean nothing there.
STABILISATION_LIMITS = frozenset({"torque_noise"})

# Limits that mean nothing without another one: (given, needed).
NEEDED_BESIDE = (("tracking", "tracking_hz"), ("tracking_hz", "tracking"), ("torque_limit_hz", "torque_limit"))

# Sample periods from sample to torque at most: each is a state of every torquer in every plant.
LONGEST_DELAY = 100


def job_mistakes(data: Data, platform: Platform | None, options: Mapping[str, frozenset[str]]) -> list[Mistake]:
    """Return what does not fit together in a job file; without a platform, what can be said without it."""
    return [
        *unique_names(data, (), "loop"),
        *unique_names(data, (), "manoeuvre"),
        *unique_names(data, (), "fault"),
        *_sampling(data),
        *_sets(data),
        *_designs(data, options),
        *_loops(data, platform),
        *run_mistakes(data, platform),
        *campaign_mistakes(data),
    ]


def _sets(data: Data) -> Iterator[Mistake]:
    """Judge what the sets of plants are made of."""
    spread = data.get("spread")
    samples = number_of(spread, "samples") if isinstance(spread, dict) else None
    if isinstance(spread, dict) and samples and not any(number_of(spread, key) for key in ("inertia", "spin")):
        wrong = f"samples = {given(spread['samples'])}: neither inertia nor spin has a spread"
        yield Mistake(("spread", "samples"), f"{wrong}; expected inertia or spin > 0 beside it")
    faults = data.get("faults")
    for i, loop in tables(data, "loop"):
        for table in ("limits", "soft"):
            limits = loop.get(table)
            if not isinstance(limits, dict):
                continue
            path: Path = ("loop", i, table)
            for key in sorted(limits):
                if key in LOOP_LIMITS and key.endswith("_faults") and not (isinstance(faults, dict) and faults):
                    wrong = f"{key}: the job has no plants with faults"
                    yield Mistake((*path, key), f"{wrong}; expected [faults] with slow_rotor or weak_torquer")
            for key, other in NEEDED_BESIDE:
                if key in limits and other not in limits:
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


def _designs(data: Data, options: Mapping[str, frozenset[str]]) -> Iterator[Mistake]:
    for i, loop in tables(data, "loop"):
        path: Path = ("loop", i)
        yield from unique_names(loop, path, "design")
        names = []
        for k, design in tables(loop, "design"):
            names.append(text_of(design, "name"))
            yield from _design(design, (*path, "design", k), text_of(loop, "kind"), options)
        use = text_of(loop, "use")
        known = [name for name in names if name is not None]
        if use is not None and known and len(known) == len(names) and use not in known:
            wrong = f"use = {given(use)}: no design of this loop has that name"
            yield Mistake((*path, "use"), f"{wrong}; {suggestion(use, known)}")


def _design(design: Data, path: Path, kind: str | None, options: Mapping[str, frozenset[str]]) -> Iterator[Mistake]:
    method = text_of(design, "method")
    if method is None or method not in options:
        return
    known = ["name", "method", "tune", *sorted(options[method])]
    if method in STRUCTURED:
        known.insert(2, "structure")
    yield from (unknown_key((*path, key), item, known) for key, item in design.items() if key not in known)
    for key in options[method]:
        value = number_of(design, key)
        if value is not None and not value > 0:
            yield Mistake((*path, key), f"{key} = {given(value)}: expected a number > 0")
    if design.get("tune") is True and method not in TUNED:
        tuned = ", ".join(given(name) for name in sorted(TUNED))
        yield Mistake((*path, "tune"), f"tune = true: method {given(method)} has no tuner; expected one of {tuned}")
    if kind in ("caging", "stabilisation") and (method in STABILISING) != (kind == "stabilisation"):
        fitting = [name for name in options if (name in STABILISING) == (kind == "stabilisation")]
        expected = " or ".join(given(name) for name in fitting)
        yield Mistake((*path, "method"), f"method = {given(method)}: does not make a {kind} loop; expected {expected}")


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
                for key in limits if isinstance(limits, dict) else ():
                    if key in LOOP_LIMITS - STABILISATION_LIMITS:
                        fitting = ", ".join(sorted(STABILISATION_LIMITS))
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
