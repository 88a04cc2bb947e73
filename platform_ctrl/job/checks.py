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
from platform_ctrl.plant.entry import Entry
from platform_ctrl.plant.fields import TURN
from platform_ctrl.plant.mistakes import Mistake, given, listed, suggestion
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
# Keys that have no effect in a loop, by its kind.
_NO_EFFECT = {
    "caging": ("sensors", "torquers", "around"),
    "rate": ("around",),
    "pointing": ("around",),
    "tracking": ("gimbals", "torquers"),
    "stabilisation": ("gimbals", "sensors", "torquers", "around"),
}
# Combinations of gimbal angles at most: each is a plant for every corner of the uncertainty.
MOST_TRIMS = 200


def job_mistakes(data: Data, platform: Platform | None) -> list[Mistake]:
    """Return what does not fit together in a job file; without a platform, what can be said without it."""
    job = Entry(data)
    return [
        *(mistake for key in ("loop", "manoeuvre", "fault") for mistake in job.unique(key)),
        *_sampling(job),
        *_sets(job),
        *_trims(job, platform),
        *_designs(job, platform),
        *_loops(job, platform),
        *_lists_of_names(job, platform),
        *run_mistakes(job, platform),
        *campaign_mistakes(job),
        *drive_mistakes(job),
        *budget_mistakes(job, platform),
    ]


def _sets(job: Entry) -> Iterator[Mistake]:
    """Judge what the sets of plants are made of."""
    uncertainty = job.table("uncertainty")
    if uncertainty.number("samples") and not any(uncertainty.number(key) for key in ("inertia", "spin")):
        yield uncertainty.useless("samples", "without inertia or spin > 0")


def locked_names(data: Data) -> list[str]:
    """Return the names of the gimbals that a job locks, as far as they are text."""
    return Entry(data).table("operation").names("locked")


def locked_mistakes(data: Data, platform: Platform) -> Iterator[Mistake]:
    """Walk gimbals that cannot be locked, and what is asked of locked ones; `platform` still has them."""
    operation, names = Entry(data).table("operation"), locked_names(data)
    for k, name in enumerate(names):
        if name not in platform.gimbal_names:
            yield operation.unknown("locked", name, "gimbal of the plant", platform.gimbal_names)
        elif name in names[:k]:
            yield operation.says("locked", f"{given(name)} is in the list twice; leave one of them out")
    for loop in Entry(data).tables("loop"):
        for name in loop.names("gimbals"):
            if name in names:
                words = "is locked in [operation]; leave it out here, or do not lock it"
                yield loop.says("gimbals", f"{given(name)} {words}")


def _trims(job: Entry, platform: Platform | None) -> Iterator[Mistake]:
    """Judge the gimbal angles at which the loops have to work."""
    angles, count = job.table("operation").table("angles"), 1
    if platform is None:
        return
    for name, values in angles.data.items():
        if name not in platform.angle_names:
            words = f"{name} is no angle of the plant; {suggestion(name, platform.angle_names)}"
            yield angles.text_at(name, words)
            continue
        numbers = [Entry({"x": x}).number("x") for x in values] if isinstance(values, list) else []
        low, high = platform.gimbals[platform.angle_names.index(name)].stops or (-TURN, TURN)
        outside = [x for x in numbers if x is not None and not low <= x <= high]
        if outside:
            beyond = f"outside the stops, {low:.6g} to {high:.6g} rad" if high != TURN else "more than a turn"
            degrees = f"angles are in rad: {outside[0]:g} degrees are {math.radians(outside[0]):.4g}"
            cure = degrees if abs(outside[0]) > TURN else "choose angles between them"
            yield angles.says(name, f"{outside[0]:g} rad is {beyond}; {cure}")
        count *= max(len(set(numbers)), 1)
    if count > MOST_TRIMS:
        words = f"{count} combinations of gimbal angles are more than {MOST_TRIMS}; give fewer angles"
        yield job.table("operation").says("angles", words)


def _limits(limits: Entry, kind: str | None, faults: bool, platform: Platform | None) -> Iterator[Mistake]:
    """Judge the limits or the goals of a loop."""
    known = limit_keys()
    for key in sorted(limits.data):
        if key not in known:
            yield unknown_key((*limits.path, key), limits.data[key], list(known))
        elif known[key][1] == "faults" and not faults:
            words = f"{key} needs plants with faults; add [faults] with slow_rotor or weak_torquer"
            yield limits.text_at(key, words)
    for metric in METRICS.values():
        edge, lowest = metric.frequency_key, metric.lowest_key
        of = [key for key, (name, scope) in known.items() if METRICS[name] is metric and scope in SCOPES]
        of = [key for key in of if key in limits]
        if edge and edge in limits and not of:
            yield limits.missing(metric.key, f"{edge} has no effect without it")
        elif of and metric.needs_frequency and edge not in limits:
            yield limits.missing(edge, f"{of[0]} has no effect without it")
        low, high = limits.number(lowest), limits.number(edge)
        if low is not None and high is not None and 0.0 < high <= low:
            yield limits.wrong(lowest, f"below {edge} = {given(limits.data[edge])}", "; the band begins there")
        elif low is not None and edge not in limits:
            words = f"{lowest} has no effect without {edge}, where the band ends; add it, or leave this out"
            yield limits.text_at(lowest, words)
    named = [key for key in limits.data if key.startswith("attenuation_db")]
    if named and platform is not None and kind not in _WITH_SIGNALS:
        words = f"{named[0]} is a limit of rate and pointing loops alone; leave it out of this loop"
        yield limits.text_at(named[0], words)
    elif named and platform is not None and platform.line_of_sight is None:
        yield limits.text_at(named[0], f"{named[0]} needs a line of sight; add [line_of_sight] to the plant")


def _sampling(job: Entry) -> Iterator[Mistake]:
    sampling = job.table("sampling")
    rate, delay = sampling.number("rate_hz"), sampling.number("delay")
    if rate is None or delay is None or rate <= 0.0 or delay < 0.0:
        return
    periods = rate * delay
    if not periods <= LONGEST_DELAY:
        unit, scale = ("ms", 1e-3) if periods * 1e-3 <= LONGEST_DELAY else ("µs", 1e-6)
        more = f" s, {periods:.4g} of them; give a shorter delay, in s: {delay:g} {unit} is {delay * scale:g}"
        yield sampling.wrong("delay", f"at most {LONGEST_DELAY} sample periods", more)
    yield from _rates(job, rate)


def _rates(job: Entry, rate: float) -> Iterator[Mistake]:
    """Judge the rates of loops that are not computed at every sample."""
    every: dict[str, int] = {}
    cycle = 1
    for loop in job.tables("loop"):
        own, kind = loop.number("rate_hz"), loop.text("kind")
        inner = every.get(loop.text("around") or "", 1)
        if own is None and inner > 1:
            words = f"the loop inside has {rate / inner:.6g} Hz, and one around it cannot be faster"
            yield loop.missing("rate_hz", f"{words}; give it that rate, or a whole fraction of it")
        if own is None or own <= 0.0 or kind not in get_args(LoopKind):
            continue
        if kind not in _OWN_RATES:
            slower = f"{', '.join(_OWN_RATES)} loops alone may be slower than [sampling]"
            yield loop.useless("rate_hz", f"in a {kind} loop; leave it out: {slower}")
            continue
        n = max(round(rate / own), 1)
        if abs(rate / own / n - 1.0) > _SAME_RATE:
            near = sorted({max(math.floor(rate / own), 1), math.ceil(rate / own)})
            fitting = " or ".join(f"{rate / one:.6g}" for one in near)
            words = f"{rate:.6g} Hz, the rate_hz of [sampling], over a whole number"
            yield loop.wrong("rate_hz", words, f"; the nearest: {fitting}")
            continue
        if n % inner:
            words = f"that of the loop inside, {rate / inner:.6g} Hz, over a whole number"
            yield loop.wrong("rate_hz", words, f"; try {rate / (inner * math.ceil(n / inner)):.6g}")
        every[loop.text("name") or ""], cycle = n, math.lcm(cycle, n)
        if cycle > LONGEST_CYCLE:
            words = f"rate_hz = {given(loop.data['rate_hz'])}: the computations of all loops repeat after {cycle}"
            cure = "choose rates that divide one another, or a lower rate_hz of [sampling]"
            yield loop.text_at("rate_hz", f"{words} samples, more than {LONGEST_CYCLE}; {cure}")
            return


def _designs(job: Entry, platform: Platform | None) -> Iterator[Mistake]:
    faults = bool(job.table("faults").data)
    for loop in job.tables("loop"):
        kind = loop.text("kind")
        for table in ("limits", "soft"):
            if isinstance(loop.data.get(table), dict):
                yield from _limits(loop.table(table), kind, faults, platform)
        rate = loop.number("rate_hz") or job.table("sampling").number("rate_hz")
        yield from loop.unique("design")
        for design in loop.tables("design"):
            yield from _design(design, kind, rate)
            yield from _design_signals(design, kind, platform, job)
        use, names = loop.text("use"), loop.named("design")
        if use is not None and names and len(names) == len(loop.tables("design")) and use not in names:
            yield loop.wrong("use", "the name of a design of this loop", f"; {suggestion(use, names)}")


def _design(design: Entry, kind: str | None, rate: float | None) -> Iterator[Mistake]:
    key = design.text("method")
    if key is None or key not in METHODS:
        return
    method = METHODS[key]
    known = ["name", "method", "tune", *_DESIGN_SIGNALS, *sorted(method.options), "command"]
    if method.structures:
        known.insert(2, "structure")
    if method.responses is not None:
        known.insert(2, "responses")
    for name, item in design.data.items():
        if name not in known:
            yield unknown_key((*design.path, name), item, known)
    for option in sorted(method.options):
        number = design.number(option)
        if number is not None and not number > 0:
            yield design.wrong(option, "a number > 0")
    if design.data.get("tune") is True and not method.tunes:
        tuned = ", ".join(given(name) for name in sorted(METHODS) if METHODS[name].tunes)
        words = f"tune must be false: method {given(key)} has no tuner; methods that have one: {tuned}"
        yield design.text_at("tune", words)
    if kind in get_args(LoopKind) and kind not in method.kinds:
        expected = " or ".join(given(name) for name, one in METHODS.items() if kind in one.kinds)
        yield design.wrong("method", f"one for a {kind} loop, {expected}")
    command = design.table("command")
    corner = command.number("filter_hz")
    if rate is not None and corner is not None and corner >= 0.5 * rate > 0.0:
        yield command.wrong("filter_hz", f"below half the sample rate, {0.5 * rate:g} Hz")
    if isinstance(design.data.get("command"), dict) and kind in ("caging", "stabilisation"):
        words = f"command has no effect in a {kind} loop, which holds zero; leave it out"
        yield design.text_at("command", words)


def _loops(job: Entry, platform: Platform | None) -> Iterator[Mistake]:
    caged_by: dict[str, int] = {}
    stabilisation: Entry | None = None
    for loop in job.tables("loop"):
        kind = loop.text("kind") or ""
        for key in _NO_EFFECT.get(kind, ()):
            if key in loop:
                yield loop.useless(key, f"in a {kind} loop; leave the key out")
        match kind:
            case "caging" if not loop.data.get("gimbals"):
                words = "gimbals must be the names of the gimbals that the loop cages"
                more = "" if platform is None else f"; {listed(platform.gimbal_names)}"
                yield loop.text_at("gimbals", f"{words}{more}")
            case "caging":
                if stabilisation is not None:
                    words = f"a caging loop must be before the stabilisation loop, [[loop]] {stabilisation.place}"
                    yield loop.says("kind", f"{words}, which uses the torques of the caged gyros")
                yield from _caged_gimbals(loop, caged_by, platform)
            case "rate" | "pointing":
                yield from _signals_of(loop, kind, platform)
            case "tracking":
                yield from _tracking(job, loop, platform)
            case "stabilisation":
                yield from _stabilising(loop)
                if stabilisation is not None:
                    words = f"[[loop]] {stabilisation.place} stabilises the root already; leave one of them out"
                    yield loop.says("kind", words)
                    continue
                stabilisation = loop
                axes = set() if platform is None else {torquer.root_axis for torquer in platform.torquers}
                lacking = [name for axis, name in enumerate(ROOT_TORQUE_NAMES, 1) if axis not in axes]
                if lacking and platform is not None:
                    words = f'kind = "stabilisation" needs root torquers; the plant has no {", ".join(lacking)}'
                    yield loop.text_at("kind", f"{words}; add [[torquer]] with root_axis 1, 2 and 3")


def _stabilising(loop: Entry) -> Iterator[Mistake]:
    limits, known = loop.table("limits"), limit_keys()
    fitting = ", ".join(sorted(key for key, (metric, _) in known.items() if METRICS[metric].of_torquers))
    for key in limits.data:
        if key in known and not METRICS[known[key][0]].of_torquers:
            words = f"{key} is no limit of a stabilisation loop, which is checked in the coupled system"
            yield limits.text_at(key, f"{words}; use {fitting}, or a limit of [coupled]")
    if "soft" in loop:
        words = "soft has no effect in a stabilisation loop: nothing is minimised; leave the table out"
        yield loop.text_at("soft", words)


def _signals_of(loop: Entry, kind: str, platform: Platform | None) -> Iterator[Mistake]:
    """Judge what a rate or pointing loop turns, reads and sets."""
    for key, words in (("gimbals", "the gimbals that the loop turns"), ("sensors", "what the loop reads")):
        yield from _no_names(loop, key, words, _known_names(kind, platform)[key])
    if platform is None:
        return
    torquers = {t.name: t.gimbal for t in platform.torquers if t.gimbal is not None}
    turned = loop.names("gimbals")
    for name in turned:
        if name not in platform.gimbal_names:
            yield loop.unknown("gimbals", name, "gimbal of the plant", platform.gimbal_names)
        elif "torquers" not in loop and name not in torquers.values():
            yield loop.says("gimbals", f"{given(name)} has no torquer in the plant; add a [[torquer]]")
    yield from _sensors(loop, kind, platform)
    for name in loop.names("torquers") if turned == loop.data.get("gimbals") else ():
        if torquers.get(name) not in turned:
            yield loop.unknown("torquers", name, "torquer on a gimbal of the loop", torquers)


def _tracking(job: Entry, loop: Entry, platform: Platform | None) -> Iterator[Mistake]:
    """Judge a tracking loop: what it reads, and the rate loop that it commands."""
    fitting = _known_names("tracking", platform)["sensors"]
    yield from _no_names(loop, "sensors", "what the loop reads", fitting)
    for name in loop.names("sensors") if platform is not None else ():
        if name not in fitting:
            yield loop.unknown("sensors", name, "sensor of an angle", fitting)
    before = [one for one in job.tables("loop") if one.place < loop.place and one.data.get("kind") == "rate"]
    inner, around = [one.text("name") or "" for one in before], loop.text("around")
    if around not in inner:
        yield loop.wrong("around", "the name of a rate loop before this one", f"; {suggestion(around or '', inner)}")


def _caged_gimbals(loop: Entry, caged_by: dict[str, int], platform: Platform | None) -> Iterator[Mistake]:
    names = loop.names("gimbals")
    for name in names if names == loop.data["gimbals"] else ():
        if name in caged_by:
            words = f"is caged by [[loop]] {caged_by[name]} already; leave it out of one of them"
            yield loop.says("gimbals", f"{given(name)} {words}")
        caged_by.setdefault(name, loop.place)
        if platform is None:
            continue
        if name not in platform.gimbal_names:
            yield loop.unknown("gimbals", name, "gimbal of the plant", platform.gimbal_names)
            continue
        for part, parts in (("torquer", platform.torquers), ("pick-off", platform.pickoffs)):
            if all(one.gimbal != name for one in parts):
                words = f"has no {part} in the plant; every caged gimbal needs one"
                yield loop.says("gimbals", f"{given(name)} {words}")


def _known_names(kind: str, platform: Platform | None) -> dict[str, list[str]]:
    """Return what may stand in the lists of names of a loop of this kind, by their keys."""
    if platform is None:
        return {"gimbals": [], "sensors": [], "torquers": []}
    unit = "rad/s" if kind == "rate" else "rad"
    return {
        "gimbals": list(platform.gimbal_names),
        "sensors": [sensor.name for sensor in platform.sensors if sensor.unit == unit],
        "torquers": [torquer.name for torquer in platform.torquers if torquer.gimbal is not None],
    }


def _rates_of_the_root(platform: Platform | None) -> list[str]:
    """Return the rate sensors of the root, which no torquer on a gimbal moves."""
    sensors = () if platform is None else platform.sensors
    rates = (sensor for sensor in sensors if sensor.unit == "rad/s")
    return [one.name for one in rates if platform and set(one.signals(platform)) <= set(OMEGA_NAMES)]


def _lists_of_names(job: Entry, platform: Platform | None) -> Iterator[Mistake]:
    """Walk what stands in place of a list of names; without a platform, only what needs none."""
    for loop in job.tables("loop"):
        of_loop = _known_names(loop.text("kind") or "", platform)
        for key, known in of_loop.items():
            yield from _no_list(loop, key, known)
        for design in loop.tables("design"):
            yield from _no_list(design, "sensors", of_loop["sensors"])
            yield from _no_list(design.table("feedforward"), "sensors", _rates_of_the_root(platform))
    for drive in job.tables("drive"):
        yield from _no_list(drive, "sensors", _known_names("rate", platform)["sensors"])
    for run in job.tables("manoeuvre"):
        yield from _no_list(run, "faults", job.named("fault"))
    for correlation in job.table("budget").tables("correlation"):
        yield from _no_list(correlation, "between", job.table("budget").named("source"))


def _no_list(table: Entry, key: str, known: list[str]) -> Iterator[Mistake]:
    if known and key in table and table.names(key) != table.data[key]:
        yield table.wrong(key, "a list of names", f"; {listed(known)}")


def _no_names(table: Entry, key: str, words: str, known: list[str]) -> Iterator[Mistake]:
    """Judge a list of names that is needed: whether there is one."""
    if table.data.get(key, []) == []:
        more = f"; {listed(known)}" if known else ""
        yield table.text_at(key, f"{key} must be a list of names, {words}{more}")


def _sensors(table: Entry, kind: str, platform: Platform) -> Iterator[Mistake]:
    """Judge the sensors that a rate or pointing loop, or one of its designs, reads."""
    fitting = _known_names(kind, platform)["sensors"]
    every = [sensor.name for sensor in platform.sensors]
    other, wanted = ("an angle", "rates") if kind == "rate" else ("a rate", "angles")
    for name in table.names("sensors"):
        if name not in fitting:
            what = f"measures {other}" if name in every else "is no sensor of the plant"
            words = f"{given(name)} {what}; a {kind} loop reads sensors of {wanted}; {suggestion(name, fitting)}"
            yield table.says("sensors", words)


def _design_signals(design: Entry, kind: str | None, platform: Platform | None, job: Entry) -> Iterator[Mistake]:
    """Judge the signals of a design of a loop of this kind."""
    if kind is None:
        return
    if kind not in _WITH_SIGNALS:
        for key in _DESIGN_SIGNALS:
            if key in design:
                words = f"{key} belongs to designs of rate and pointing loops alone; leave it out of this {kind} loop"
                yield design.text_at(key, words)
        return
    if platform is not None:
        yield from _sensors(design, kind, platform)
    yield from _feedforward(design.table("feedforward"), platform, job)


def _feedforward(fed: Entry, platform: Platform | None, job: Entry) -> Iterator[Mistake]:
    fitting = _rates_of_the_root(platform)
    if "sensors" in fed:
        yield from _no_names(fed, "sensors", "rate sensors of the root", fitting)
    if fed.text("into") == "reading" and "bandwidth_hz" in fed:
        yield fed.useless("bandwidth_hz", 'with into = "reading"; leave the key out')
    rate, bandwidth = job.table("sampling").number("rate_hz"), fed.number("bandwidth_hz")
    if rate is not None and bandwidth is not None and bandwidth >= 0.5 * rate > 0.0:
        yield fed.wrong("bandwidth_hz", f"below half the sample rate, {0.5 * rate:g} Hz")
    if platform is None:
        return
    every, names = [sensor.name for sensor in platform.sensors], fed.names("sensors")
    for k, name in enumerate(names):
        if name not in every:
            yield fed.unknown("sensors", name, "sensor of the plant", fitting)
        elif name not in fitting:
            words = f"{given(name)} does not measure a rate of the root alone: torquers move what it reads"
            yield fed.says("sensors", f"{words}; {suggestion(name, fitting)}")
        elif name in names[:k]:
            yield fed.says("sensors", f"{given(name)} is in the list twice; leave one of them out")
