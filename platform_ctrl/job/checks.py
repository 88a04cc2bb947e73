"""What must fit together in a job file: loops, their designs, the plant's gimbals.

Like the checks of the plant, these read the plain data and pass over what the structure check refuses.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import Any, get_args

from platform_ctrl.analysis.metrics import METRICS
from platform_ctrl.job.budget_checks import budget_mistakes
from platform_ctrl.job.campaign_checks import campaign_mistakes
from platform_ctrl.job.drive_checks import drive_mistakes
from platform_ctrl.job.methods import METHODS, LoopKind
from platform_ctrl.job.requirements import SCOPES, limit_keys
from platform_ctrl.job.run_checks import run_mistakes
from platform_ctrl.plant.checks import number_of
from platform_ctrl.plant.entry import Entry
from platform_ctrl.plant.fields import TURN
from platform_ctrl.plant.mistakes import Mistake, Path, given, listed, suggestion, tables, text_of, unique_names
from platform_ctrl.plant.platform import OMEGA_NAMES, ROOT_TORQUE_NAMES, Platform
from platform_ctrl.plant.tables import unknown_key

Data = dict[str, Any]

# Sample periods from sample to torque at most: each is a state of every torquer in every plant.
LONGEST_DELAY = 100
# Kinds of loops that may be computed at every n-th sample, samples after which all repeats, and how well rates fit.
_OWN_RATES = ("rate", "pointing", "tracking")
LONGEST_CYCLE = 1000
_SAME_RATE = 1e-5
# Keys of a design that are about signals, and the loops whose designs have them.
_DESIGN_SIGNALS = ("sensors", "feedforward")
_WITH_SIGNALS = ("rate", "pointing")


def job_mistakes(data: Data, platform: Platform | None) -> list[Mistake]:
    """Return what does not fit together in a job file; without a platform, what can be said without it."""
    return [
        *unique_names(data, (), "loop"),
        *unique_names(data, (), "manoeuvre"),
        *unique_names(data, (), "fault"),
        *_sampling(data),
        *_sets(data),
        *_trims(data, platform),
        *_sight(data, platform),
        *_designs(data, platform),
        *_loops(data, platform),
        *_lists_of_names(data, platform),
        *run_mistakes(Entry(data), platform),
        *campaign_mistakes(data),
        *drive_mistakes(data),
        *budget_mistakes(data, platform),
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
        yield Mistake.useless(uncertainty, ("uncertainty",), "samples", "without inertia or spin > 0")
    faults = data.get("faults")
    for i, loop in tables(data, "loop"):
        for table in ("limits", "soft"):
            limits = loop.get(table)
            if not isinstance(limits, dict):
                continue
            yield from _limits(limits, ("loop", i, table), isinstance(faults, dict) and bool(faults))


def locked_names(data: Data) -> list[str]:
    """Return the names of the gimbals that a job locks, as far as they are text."""
    operation = data.get("operation")
    return _names_of(operation, "locked") if isinstance(operation, dict) else []


def locked_mistakes(data: Data, platform: Platform) -> Iterator[Mistake]:
    """Walk gimbals that cannot be locked, and what is asked of locked ones; `platform` still has them."""
    path: Path = ("operation", "locked")
    names = locked_names(data)
    for k, name in enumerate(names):
        if name not in platform.gimbal_names:
            yield Mistake(
                path, f"locked: {given(name)} is no gimbal of the plant; {suggestion(name, platform.gimbal_names)}"
            )
        elif name in names[:k]:
            yield Mistake(path, f"locked: {given(name)} is in the list twice; leave one of them out")
    for i, loop in tables(data, "loop"):
        for name in _names_of(loop, "gimbals"):
            if name in names:
                words = f"gimbals: {given(name)} is locked in [operation]; leave it out here, or do not lock it"
                yield Mistake(("loop", i, "gimbals"), words)


# Combinations of gimbal angles at most: each is a plant for every corner of the uncertainty.
MOST_TRIMS = 200


def _trims(data: Data, platform: Platform | None) -> Iterator[Mistake]:
    """Judge the gimbal angles at which the loops have to work."""
    operation = data.get("operation")
    angles = operation.get("angles") if isinstance(operation, dict) else None
    if not isinstance(angles, dict) or platform is None:
        return
    count = 1
    for name, values in angles.items():
        path: Path = ("operation", "angles", name)
        if name not in platform.angle_names:
            yield Mistake(path, f"{name} is no angle of the plant; {suggestion(name, platform.angle_names)}")
            continue
        numbers = [number_of({"x": x}, "x") for x in values] if isinstance(values, list) else []
        stops = platform.gimbals[platform.angle_names.index(name)].stops or (-TURN, TURN)
        outside = [x for x in numbers if x is not None and not stops[0] <= x <= stops[1]]
        if outside:
            words = f"{name}: {outside[0]:g} rad is outside the stops, {stops[0]:.6g} to {stops[1]:.6g} rad"
            if stops[1] == TURN:
                words = f"{name}: {outside[0]:g} rad is more than a turn"
            yield Mistake(path, f"{words}; {_in_rad(outside[0]) or 'choose angles between them'}")
        count *= max(len(set(numbers)), 1)
    if count > MOST_TRIMS:
        words = f"angles: {count} combinations of gimbal angles are more than {MOST_TRIMS}; give fewer angles"
        yield Mistake(("operation", "angles"), words)


def _in_rad(angle: float) -> str:
    """Return in words what an angle is in rad if it is beyond a turn, and so may be in degrees."""
    return f"angles are in rad: {angle:g} degrees are {math.radians(angle):.4g}" if abs(angle) > TURN else ""


def _sight(data: Data, platform: Platform | None) -> Iterator[Mistake]:
    """Walk limits on the line of sight of loops that move none."""
    for i, loop in tables(data, "loop"):
        for table in ("limits", "soft"):
            limits = loop.get(table)
            named = [key for key in limits if key.startswith("attenuation_db")] if isinstance(limits, dict) else []
            if not named or platform is None:
                continue
            key = named[0]
            if text_of(loop, "kind") not in ("rate", "pointing"):
                words = f"{key} is a limit of rate and pointing loops alone; leave it out of this loop"
                yield Mistake(("loop", i, table, key), words)
            elif platform.line_of_sight is None:
                words = f"{key} needs a line of sight; add [line_of_sight] to the plant"
                yield Mistake(("loop", i, table, key), words)


def _limits(limits: Data, path: Path, faults: bool) -> Iterator[Mistake]:
    known = limit_keys()
    for key in sorted(limits):
        if key not in known:
            yield unknown_key((*path, key), limits[key], list(known))
        elif known[key][1] == "faults" and not faults:
            words = f"{key} needs plants with faults; add [faults] with slow_rotor or weak_torquer"
            yield Mistake((*path, key), words)
    for metric in METRICS.values():
        edge = metric.frequency_key
        keys = [key for key, (kind, scope) in known.items() if METRICS[kind] is metric and scope in SCOPES]
        of = [key for key in keys if key in limits]
        if edge and edge in limits and not of:
            yield Mistake.missing(path, metric.key, f"{edge} has no effect without it")
        elif of and metric.needs_frequency and edge not in limits:
            yield Mistake.missing(path, edge, f"{of[0]} has no effect without it")
        low, high = number_of(limits, metric.lowest_key), number_of(limits, edge)
        if low is not None and high is not None and 0.0 < high <= low:
            words = f"below {edge} = {given(limits[edge])}"
            yield Mistake.wrong(limits, path, metric.lowest_key, words, "; the band begins there")
        elif low is not None and edge not in limits:
            words = f"{metric.lowest_key} has no effect without {edge}, where the band ends; add it, or leave this out"
            yield Mistake((*path, metric.lowest_key), words)


def _sampling(data: Data) -> Iterator[Mistake]:
    table = data.get("sampling")
    if not isinstance(table, dict):
        return
    rate, delay = number_of(table, "rate_hz"), number_of(table, "delay")
    if rate is None or delay is None or rate <= 0.0 or delay < 0.0:
        return
    periods = rate * delay
    if not periods <= LONGEST_DELAY:
        unit, scale = ("ms", 1e-3) if periods * 1e-3 <= LONGEST_DELAY else ("µs", 1e-6)
        more = f" s, {periods:.4g} of them; give a shorter delay, in s: {delay:g} {unit} is {delay * scale:g}"
        yield Mistake.wrong(table, ("sampling",), "delay", f"at most {LONGEST_DELAY} sample periods", more)
    yield from _rates(data, rate)


def _rates(data: Data, rate: float) -> Iterator[Mistake]:
    """Judge the rates of loops that are not computed at every sample."""
    every: dict[str, int] = {}
    cycle = 1
    for i, loop in tables(data, "loop"):
        own, kind, path = number_of(loop, "rate_hz"), text_of(loop, "kind"), ("loop", i)
        inner = every.get(text_of(loop, "around") or "", 1)
        if own is None and inner > 1:
            words = f"the loop inside has {rate / inner:.6g} Hz, and one around it cannot be faster"
            yield Mistake.missing(path, "rate_hz", f"{words}; give it that rate, or a whole fraction of it")
        if own is None or own <= 0.0:
            continue
        if kind not in get_args(LoopKind):
            continue
        if kind not in _OWN_RATES:
            slower = f"{', '.join(_OWN_RATES)} loops alone may be slower than [sampling]"
            yield Mistake.useless(loop, path, "rate_hz", f"in a {kind} loop; leave it out: {slower}")
            continue
        n = max(round(rate / own), 1)
        if abs(rate / own / n - 1.0) > _SAME_RATE:
            near = sorted({max(math.floor(rate / own), 1), math.ceil(rate / own)})
            fitting = " or ".join(f"{rate / one:.6g}" for one in near)
            words = f"{rate:.6g} Hz, the rate_hz of [sampling], over a whole number"
            yield Mistake.wrong(loop, path, "rate_hz", words, f"; the nearest: {fitting}")
            continue
        if n % inner:
            words = f"that of the loop inside, {rate / inner:.6g} Hz, over a whole number"
            yield Mistake.wrong(loop, path, "rate_hz", words, f"; try {rate / (inner * math.ceil(n / inner)):.6g}")
        every[text_of(loop, "name") or ""], cycle = n, math.lcm(cycle, n)
        if cycle > LONGEST_CYCLE:
            words = f"rate_hz = {given(loop['rate_hz'])}: the computations of all loops repeat after {cycle} samples"
            cure = "choose rates that divide one another, or a lower rate_hz of [sampling]"
            yield Mistake((*path, "rate_hz"), f"{words}, more than {LONGEST_CYCLE}; {cure}")
            return


def _designs(data: Data, platform: Platform | None) -> Iterator[Mistake]:
    sampling = data.get("sampling")
    all_loops = number_of(sampling, "rate_hz") if isinstance(sampling, dict) else None
    for i, loop in tables(data, "loop"):
        path: Path = ("loop", i)
        rate = number_of(loop, "rate_hz") or all_loops
        yield from unique_names(loop, path, "design")
        names = []
        for k, design in tables(loop, "design"):
            names.append(text_of(design, "name"))
            yield from _design(design, (*path, "design", k), text_of(loop, "kind"), rate)
            yield from _design_signals(design, (*path, "design", k), text_of(loop, "kind"), platform, data)
        use = text_of(loop, "use")
        known = [name for name in names if name is not None]
        if use is not None and known and len(known) == len(names) and use not in known:
            yield Mistake.wrong(loop, path, "use", "the name of a design of this loop", f"; {suggestion(use, known)}")


def _design(design: Data, path: Path, kind: str | None, rate: float | None) -> Iterator[Mistake]:
    key = text_of(design, "method")
    if key is None or key not in METHODS:
        return
    method = METHODS[key]
    known = ["name", "method", "tune", *_DESIGN_SIGNALS, *sorted(method.options), "command"]
    if method.structures:
        known.insert(2, "structure")
    if method.responses is not None:
        known.insert(2, "responses")
    yield from (unknown_key((*path, name), item, known) for name, item in design.items() if name not in known)
    yield from _shaping(design.get("command"), (*path, "command"), kind, rate)
    for option in sorted(method.options):
        number = number_of(design, option)
        if number is not None and not number > 0:
            yield Mistake.wrong(design, path, option, "a number > 0")
    if design.get("tune") is True and not method.tunes:
        tuned = ", ".join(given(name) for name in sorted(METHODS) if METHODS[name].tunes)
        yield Mistake(
            (*path, "tune"), f"tune must be false: method {given(key)} has no tuner; methods that have one: {tuned}"
        )
    if kind in get_args(LoopKind) and kind not in method.kinds:
        expected = " or ".join(given(name) for name, one in METHODS.items() if kind in one.kinds)
        yield Mistake.wrong(design, path, "method", f"one for a {kind} loop, {expected}")


def _shaping(command: object, path: Path, kind: str | None, rate: float | None) -> Iterator[Mistake]:
    """Judge what a design does with commands in a loop with a sample rate, Hz."""
    corner = number_of(command, "filter_hz") if isinstance(command, dict) else None
    if isinstance(command, dict) and rate is not None and corner is not None and corner >= 0.5 * rate > 0.0:
        yield Mistake.wrong(command, path, "filter_hz", f"below half the sample rate, {0.5 * rate:g} Hz")
    if isinstance(command, dict) and kind in ("caging", "stabilisation"):
        words = f"command has no effect in a {kind} loop, which holds zero; leave it out"
        yield Mistake(path, words)


def _loops(data: Data, platform: Platform | None) -> Iterator[Mistake]:
    caged_by: dict[str, int] = {}
    stabilisation = None
    for i, loop in tables(data, "loop"):
        path: Path = ("loop", i)
        match text_of(loop, "kind"):
            case "caging" if "gimbals" not in loop or loop["gimbals"] == []:
                words = "gimbals must be the names of the gimbals that the loop cages"
                more = "" if platform is None else f"; {listed(platform.gimbal_names)}"
                yield Mistake((*path, "gimbals"), f"{words}{more}")
            case "caging":
                if stabilisation is not None:
                    words = f"a caging loop must be before the stabilisation loop, [[loop]] {stabilisation + 1}"
                    yield Mistake((*path, "kind"), f"kind: {words}, which uses the torques of the caged gyros")
                yield from _caged_gimbals(loop["gimbals"], (*path, "gimbals"), i, caged_by, platform)
                yield from _useless(loop, path, "caging", ("sensors", "torquers", "around"))
            case "rate" | "pointing" as kind:
                yield from _useless(loop, path, kind, ("around",))
                yield from _signals_of(loop, path, kind, platform)
            case "tracking":
                yield from _useless(loop, path, "tracking", ("gimbals", "torquers"))
                yield from _tracking(data, loop, path, i, platform)
            case "stabilisation":
                yield from _useless(loop, path, "stabilisation", ("gimbals", "sensors", "torquers", "around"))
                limits = loop.get("limits")
                known = limit_keys()
                fitting = ", ".join(sorted(key for key, (metric, _) in known.items() if METRICS[metric].of_torquers))
                for key in limits if isinstance(limits, dict) else ():
                    if key in known and not METRICS[known[key][0]].of_torquers:
                        words = f"{key} is no limit of a stabilisation loop, which is checked in the coupled system"
                        yield Mistake((*path, "limits", key), f"{words}; use {fitting}, or a limit of [coupled]")
                if "soft" in loop:
                    words = "soft has no effect in a stabilisation loop: nothing is minimised; leave the table out"
                    yield Mistake((*path, "soft"), words)
                if stabilisation is not None:
                    yield Mistake(
                        (*path, "kind"),
                        f"kind: [[loop]] {stabilisation + 1} stabilises the root already; leave one of them out",
                    )
                else:
                    stabilisation = i
                    yield from _root_torquers((*path, "kind"), platform)


def _useless(loop: Data, path: Path, kind: str, keys: tuple[str, ...]) -> Iterator[Mistake]:
    for key in keys:
        if key in loop:
            yield Mistake.useless(loop, path, key, f"in a {kind} loop; leave the key out")


def _signals_of(loop: Data, path: Path, kind: str, platform: Platform | None) -> Iterator[Mistake]:
    """Judge what a rate or pointing loop turns, reads and sets."""
    for key, words in (("gimbals", "the gimbals that the loop turns"), ("sensors", "what the loop reads")):
        yield from _no_names(loop, key, path, words, _known_names(kind, platform)[key])
    if platform is None:
        return
    torquers = {t.name: t.gimbal for t in platform.torquers if t.gimbal is not None}
    for name in _names_of(loop, "gimbals"):
        if name not in platform.gimbal_names:
            yield Mistake.unknown_name(path, "gimbals", name, "gimbal of the plant", platform.gimbal_names)
        elif "torquers" not in loop and name not in torquers.values():
            yield Mistake((*path, "gimbals"), f"gimbals: {given(name)} has no torquer in the plant; add a [[torquer]]")
    yield from _sensors(loop, path, kind, platform)
    turned = _names_of(loop, "gimbals")
    for name in _names_of(loop, "torquers") if turned == loop.get("gimbals") else ():
        if torquers.get(name) not in turned:
            yield Mistake.unknown_name(path, "torquers", name, "torquer on a gimbal of the loop", torquers)


def _tracking(data: Data, loop: Data, path: Path, number: int, platform: Platform | None) -> Iterator[Mistake]:
    """Judge a tracking loop: what it reads, and the rate loop that it commands."""
    fitting = _known_names("tracking", platform)["sensors"]
    yield from _no_names(loop, "sensors", path, "what the loop reads", fitting)
    if platform is not None:
        for name in _names_of(loop, "sensors"):
            if name not in fitting:
                yield Mistake.unknown_name(path, "sensors", name, "sensor of an angle", fitting)
    inner = [text_of(one, "name") or "" for k, one in tables(data, "loop") if k < number and one.get("kind") == "rate"]
    around = text_of(loop, "around")
    if around not in inner:
        words, more = "the name of a rate loop before this one", f"; {suggestion(around or '', inner)}"
        yield Mistake.wrong(loop, path, "around", words, more)


def _caged_gimbals(
    gimbals: object, path: Path, loop: int, caged_by: dict[str, int], platform: Platform | None
) -> Iterator[Mistake]:
    if not isinstance(gimbals, list) or not all(isinstance(name, str) for name in gimbals):
        return
    for name in gimbals:
        wrong = f"gimbals: {given(name)}"
        if name in caged_by:
            yield Mistake(
                path, f"{wrong} is caged by [[loop]] {caged_by[name] + 1} already; leave it out of one of them"
            )
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
                yield Mistake(path, f"{wrong} has no {part} in the plant; every caged gimbal needs one")


def _root_torquers(path: Path, platform: Platform | None) -> Iterator[Mistake]:
    if platform is None:
        return
    there = {torquer.root_axis for torquer in platform.torquers}
    lacking = [name for axis, name in enumerate(ROOT_TORQUE_NAMES, 1) if axis not in there]
    if lacking:
        words = f'kind = "stabilisation" needs root torquers; the plant has no {", ".join(lacking)}'
        yield Mistake(path, f"{words}; add [[torquer]] with root_axis 1, 2 and 3")


def _unit_of(kind: str) -> str:
    """Return the unit of what a loop of this kind reads."""
    return "rad/s" if kind == "rate" else "rad"


def _known_names(kind: str, platform: Platform | None) -> dict[str, list[str]]:
    """Return what may stand in the lists of names of a loop of this kind, by their keys."""
    if platform is None:
        return {"gimbals": [], "sensors": [], "torquers": []}
    return {
        "gimbals": list(platform.gimbal_names),
        "sensors": [sensor.name for sensor in platform.sensors if sensor.unit == _unit_of(kind)],
        "torquers": [torquer.name for torquer in platform.torquers if torquer.gimbal is not None],
    }


def _rates_of_the_root(platform: Platform | None) -> list[str]:
    """Return the rate sensors of the root, which no torquer on a gimbal moves."""
    sensors = () if platform is None else platform.sensors
    rates = (sensor for sensor in sensors if sensor.unit == "rad/s")
    return [one.name for one in rates if platform and set(one.signals(platform)) <= set(OMEGA_NAMES)]


def _lists_of_names(data: Data, platform: Platform | None) -> Iterator[Mistake]:
    """Walk what stands in place of a list of names; without a platform, only what needs none."""
    for i, loop in tables(data, "loop"):
        kind = text_of(loop, "kind") or ""
        of_loop = _known_names(kind, platform)
        for key, known in of_loop.items():
            yield from _no_list(loop, key, ("loop", i), known)
        for k, design in tables(loop, "design"):
            path: Path = ("loop", i, "design", k)
            yield from _no_list(design, "sensors", path, of_loop["sensors"])
            fed = design.get("feedforward")
            if isinstance(fed, dict):
                yield from _no_list(fed, "sensors", (*path, "feedforward"), _rates_of_the_root(platform))
    for k, drive in tables(data, "drive"):
        yield from _no_list(drive, "sensors", ("drive", k), _known_names("rate", platform)["sensors"])
    for k, manoeuvre in tables(data, "manoeuvre"):
        faults = [name for _, fault in tables(data, "fault") if (name := text_of(fault, "name")) is not None]
        yield from _no_list(manoeuvre, "faults", ("manoeuvre", k), faults)
    budget = data.get("budget")
    for k, correlation in tables(budget, "correlation") if isinstance(budget, dict) else ():
        sources = [name for _, source in tables(budget, "source") if (name := text_of(source, "name")) is not None]
        yield from _no_list(correlation, "between", ("budget", "correlation", k), sources)


def _no_list(table: Data, key: str, path: Path, known: list[str]) -> Iterator[Mistake]:
    names = table.get(key, [])
    if known and not (isinstance(names, list) and all(isinstance(name, str) for name in names)):
        yield Mistake.wrong(table, path, key, "a list of names", f"; {listed(known)}")


def _no_names(table: Data, key: str, path: Path, words: str, known: list[str]) -> Iterator[Mistake]:
    """Judge a list of names that is needed: whether there is one."""
    if table.get(key, []) == []:
        more = f"; {listed(known)}" if known else ""
        yield Mistake((*path, key), f"{key} must be a list of names, {words}{more}")


def _names_of(table: Data, key: str) -> list[str]:
    """Return the names that stand under a key, as far as they are text."""
    names = table.get(key, [])
    return [name for name in names if isinstance(name, str)] if isinstance(names, list) else []


def _sensors(table: Data, path: Path, kind: str, platform: Platform) -> Iterator[Mistake]:
    """Judge the sensors that a rate or pointing loop, or one of its designs, reads."""
    unit = _unit_of(kind)
    fitting = _known_names(kind, platform)["sensors"]
    every = [sensor.name for sensor in platform.sensors]
    for name in _names_of(table, "sensors"):
        if name in fitting:
            continue
        what = (
            f"measures {'an angle' if unit == 'rad/s' else 'a rate'}" if name in every else "is no sensor of the plant"
        )
        wanted = f"a {kind} loop reads sensors of {'rates' if unit == 'rad/s' else 'angles'}"
        yield Mistake((*path, "sensors"), f"sensors: {given(name)} {what}; {wanted}; {suggestion(name, fitting)}")


def _design_signals(
    design: Data, path: Path, kind: str | None, platform: Platform | None, data: Data
) -> Iterator[Mistake]:
    """Judge the signals of a design of a loop of this kind."""
    if kind is None:
        return
    if kind not in _WITH_SIGNALS:
        for key in _DESIGN_SIGNALS:
            if key in design:
                words = f"{key} belongs to designs of rate and pointing loops alone; leave it out of this {kind} loop"
                yield Mistake((*path, key), words)
        return
    if platform is not None:
        yield from _sensors(design, path, kind, platform)
    fed = design.get("feedforward")
    if isinstance(fed, dict):
        yield from _feedforward(fed, (*path, "feedforward"), platform, data)


def _feedforward(fed: Data, path: Path, platform: Platform | None, data: Data) -> Iterator[Mistake]:
    fitting = _rates_of_the_root(platform)
    if "sensors" in fed:
        yield from _no_names(fed, "sensors", path, "rate sensors of the root", fitting)
    if text_of(fed, "into") == "reading" and "bandwidth_hz" in fed:
        yield Mistake.useless(fed, path, "bandwidth_hz", 'with into = "reading"; leave the key out')
    sampling = data.get("sampling")
    rate = number_of(sampling, "rate_hz") if isinstance(sampling, dict) else None
    bandwidth = number_of(fed, "bandwidth_hz")
    if rate is not None and bandwidth is not None and bandwidth >= 0.5 * rate > 0.0:
        yield Mistake.wrong(fed, path, "bandwidth_hz", f"below half the sample rate, {0.5 * rate:g} Hz")
    if platform is None:
        return
    sensors = {sensor.name: sensor for sensor in platform.sensors}
    names = _names_of(fed, "sensors")
    for k, name in enumerate(names):
        if name not in sensors:
            yield Mistake.unknown_name(path, "sensors", name, "sensor of the plant", fitting)
        elif name not in fitting:
            words = f"sensors: {given(name)} does not measure a rate of the root alone: torquers move what it reads"
            yield Mistake((*path, "sensors"), f"{words}; {suggestion(name, fitting)}")
        elif name in names[:k]:
            yield Mistake((*path, "sensors"), f"sensors: {given(name)} is in the list twice; leave one of them out")
