"""The state of the page: settings, limits and sliders as frozen values, and the history of settings."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Iterator, Mapping, MutableMapping, Sequence
from dataclasses import field
from typing import Any, Literal

import numpy as np

from platform_ctrl.analysis.metrics import COUPLED_METRICS
from platform_ctrl.common.arguments import known_name, short
from platform_ctrl.common.values import value
from platform_ctrl.design.method import Family
from platform_ctrl.design.methods import METHODS
from platform_ctrl.errors import ArgumentError
from platform_ctrl.job.job import Job, LoopSpec
from platform_ctrl.job.requirements import SCOPES, limit_keys
from platform_ctrl.verification.budget_result import LINE_OF_SIGHT, budget_requirements
from platform_ctrl.verification.coupled import ALL_LOOPS

# Number, in the units of the job file, by the name of the limit: "LOOP.limits.bandwidth_hz", "coupled.disk_margin".
Limits = Mapping[str, float]


def of_loop(limits: Limits, loop: str) -> Limits:
    """Return the limits and goals of a loop."""
    return {name: x for name, x in limits.items() if name.startswith((f"{loop}.limits.", f"{loop}.soft."))}


def stated_limits(job: Job) -> dict[str, float]:
    """Return all limits that a job states."""
    tables: dict[str, Any] = {f"{one.name}.{of}": getattr(one, of) for one in job.loops for of in ("limits", "soft")}
    tables["coupled"] = dataclasses.asdict(job.coupled)
    if job.budget is not None:
        tables["budget.limits"] = dataclasses.asdict(job.budget.limits)
        tables |= {f"budget.{one.name}": {"limit": one.limit} for one in job.budget.sources}
    return {f"{table}.{key}": float(x) for table, keys in tables.items() for key, x in keys.items() if x is not None}


def with_limits(job: Job, limits: Limits) -> Job:
    """Return the job with other numbers of limits that it states."""

    def put(record: Any, table: str) -> Any:
        keys = [one.name for one in dataclasses.fields(record)]
        changes = {key: limits[f"{table}.{key}"] for key in keys if f"{table}.{key}" in limits}
        return dataclasses.replace(record, **changes) if changes else record

    loops = tuple(_limited(spec, limits) for spec in job.loops)
    budget = job.budget
    if budget is not None:
        sources = tuple(put(one, f"budget.{one.name}") for one in budget.sources)
        budget = dataclasses.replace(budget, limits=put(budget.limits, "budget.limits"), sources=sources)
    return dataclasses.replace(job, loops=loops, coupled=put(job.coupled, "coupled"), budget=budget)


def _limited(spec: LoopSpec, limits: Limits) -> LoopSpec:
    own, soft = ({key: limits[f"{spec.name}.{of}.{key}"] for key in getattr(spec, of)} for of in ("limits", "soft"))
    return dataclasses.replace(spec, limits=own, soft=soft)


def put_into(document: Any, limits: Limits) -> None:
    """Write limits into the data of a job file."""
    tables: dict[str, MutableMapping[str, Any]] = {}
    for loop in document["loop"]:
        tables |= {f"{loop['name']}.{of}": loop.get(of, {}) for of in ("limits", "soft")}
    budget = document.get("budget", {})
    tables |= {"coupled": document.get("coupled", {}), "budget.limits": budget.get("limits", {})}
    tables |= {f"budget.{one['name']}": one for one in budget.get("source", ())}
    for table, keys in tables.items():
        for key in list(keys):
            if f"{table}.{key}" in limits:
                keys[key] = number(limits[f"{table}.{key}"])


def number(x: float) -> float:
    """Return a number as a file has it: whole ones without a point."""
    return int(x) if float(x).is_integer() and abs(x) < 1e15 else x


def limits_of_rows(job: Job) -> dict[tuple[str, str], str]:
    """Return the names of the limits of results, by the results' subject and name.

    Requirements that no job file states are left out: that a loop has to be stable.
    """
    stated = stated_limits(job)
    return {row: name for row, name in _rows(job) if name in stated}


def _rows(job: Job) -> Iterator[tuple[tuple[str, str], str]]:
    keys = {of: key for key, of in limit_keys().items()}
    scopes = {over: scope for scope, over in SCOPES.items()}
    for spec in job.loops:
        for one in spec.requests:
            key = keys.get((one.kind, scopes[one.over]))
            if key is not None:
                yield (spec.name, one.name), f"{spec.name}.{'limits' if one.hard else 'soft'}.{key}"
    for metric in COUPLED_METRICS.values():
        yield (ALL_LOOPS, metric.name), f"coupled.{metric.key}"
    for (key, source), limit in budget_requirements(job.budget):
        yield (LINE_OF_SIGHT, limit.name), f"budget.{source or 'limits'}.{key}"


# Largest number that a page may be given, and steps of a slider's range.
LARGEST, STEPS = 1e50, 4000

Group = Literal["main", "gains", "lead", "notch", "lag", "design"]

# Option → number, in the units of the job file; by design; by loop.
Options = Mapping[str, float]
LoopOptions = Mapping[str, Mapping[str, Options]]


@value
class Settings:
    """All that a page is set to, as plain data that a link can hold.

    Attributes
    ----------
    loop, design
        Names of the loop and of its design that are shown. With a caging loop Omega is prescribed; with a servo on the
        platform the platform is free, and all loops are closed.
    options
        Loop → design → option → number, in the units of the job file.
    optional
        Loop → design → names of the optional parts that are on: ``"lag"``, ``"notch"``, ``"spin_notch"``.
    plant, band
        Label of the plant that is shown, and whether all plants of the set are shown around it.
    fixed
        Names of sliders that tuning does not move.
    overlays
        Names of other designs of the loop that are shown as well.
    channel, axis
        Torquer at which the loop is shown broken, and root axis of the responses, 1 to 3.
    closed
        Loop → design that is closed there while another loop is shown, and in what is saved.
    limits
        Name of a limit (`limits.stated_limits`) → number, in the units of the job file.
    """

    loop: str
    design: str
    options: LoopOptions
    optional: Mapping[str, Mapping[str, tuple[str, ...]]]
    plant: str = "nominal"
    band: bool = True
    fixed: frozenset[str] = frozenset()
    overlays: tuple[str, ...] = ()
    channel: str = ""
    axis: int = 1
    closed: Mapping[str, str] = field(default_factory=dict)
    limits: Mapping[str, float] = field(default_factory=dict)

    def but(self, **changes: Any) -> Settings:
        """Return these settings with some of them changed."""
        return dataclasses.replace(self, **changes)

    def parts_on(self, loop: str, design: str) -> tuple[str, ...]:
        """Return the optional parts of a design that are switched on."""
        return self.optional.get(loop, {}).get(design, ())

    def data(self) -> dict[str, Any]:
        """Return everything as JSON values; two settings are equal if these dicts are."""
        return {one.name: _plain(getattr(self, one.name)) for one in dataclasses.fields(self)}


def _plain(item: Any) -> Any:
    if isinstance(item, Mapping):
        return {name: _plain(one) for name, one in item.items()}
    if isinstance(item, frozenset):
        return sorted(item)
    return list(item) if isinstance(item, tuple) else item


@value
class Slider:
    """A number of the settings that a slider moves from `low` to `high`; a number beyond the ends may be typed.

    `start` is its value in the job file.

    `group` is a heading of the page; ``"design"`` has the options of a method that designs. Tuning moves a
    slider that is `tunable` and not `fixed`. `part` is the optional part that it belongs to, or empty. Moving a slider
    in the `background` requests a new design, which takes seconds. A ``"main"`` slider moves the options `along`
    together: by how many per cent each for one per cent.
    """

    name: str
    label: str
    unit: str
    group: Group
    low: float
    high: float
    value: float
    start: float
    logarithmic: bool = True
    tip: str = ""
    fixed: bool = False
    part: str = ""
    tunable: bool = False
    background: bool = False
    along: Mapping[str, float] = field(default_factory=dict)

    def place(self, x: float) -> int:
        """Return where on its range of `STEPS` it stands at `x`."""
        if self.logarithmic:
            at = math.log(max(x, self.low) / self.low) / (math.log(self.high / self.low) or 1.0)
        else:
            at = (x - self.low) / ((self.high - self.low) or 1.0)
        return round(STEPS * min(1.0, max(0.0, at)))


@value
class Part:
    """An optional part of a controller: a lag or a notch; `label` and `tip` are shown on the page."""

    name: str
    label: str
    on: bool
    tip: str = ""


# Steps that can be undone, at most.
_MOST_STEPS = 200


class History:
    """The settings of a page that can be undone and redone."""

    def __init__(self, first: Settings) -> None:
        self._steps, self._at = [first], 0
        self._gesture: object = None

    def can(self, way: int) -> bool:
        """Return whether there is a step to undo (-1) or to redo (1)."""
        return 0 <= self._at + way < len(self._steps)

    def put(self, settings: Settings, gesture: object) -> None:
        """Add a step; the steps to redo are dropped. Of a gesture the last value counts; equal settings are no step."""
        if gesture == self._gesture:
            self._steps[self._at] = settings
        elif settings.data() != self._steps[self._at].data():
            self._steps = [*self._steps[: self._at + 1], settings][-_MOST_STEPS:]
            self._at = len(self._steps) - 1
        self._gesture = gesture

    def step(self, way: int) -> Settings | None:
        """Return the settings one step back (-1) or forth (1), where they are from now on; None: there are none."""
        if not self.can(way):
            return None
        self._at, self._gesture = self._at + way, None
        return self._steps[self._at]


# Methods whose controllers the tuner makes of their options again and again.
_TUNED = ("classical", "pi", "lqg", "platform-servo")
# Range of a slider to both sides of its start, as a factor.
_REACH = 20.0
# Typed numbers may lie beyond the slider by this factor.
_BEYOND = 100.0


def option_sliders(
    method: str, options: Mapping[str, float], start: Mapping[str, float], rate_hz: float, fixed: frozenset[str]
) -> list[Slider]:
    """Return a slider for each of the `options` of a method; `start` is what sliders reach to both sides of."""
    out = []
    offered = METHODS[method]
    for name, kind in offered.options.items():
        if name not in options:
            continue
        middle = start.get(name, options[name])
        # Frequencies and amplitudes have ranges about their values.
        relative = kind.unit == "Hz" or math.isinf(kind.high)
        high = min(_REACH * middle, kind.high * rate_hz) if relative else kind.high
        low = middle / _REACH if relative else kind.low
        own = {of: getattr(kind, of) for of in ("label", "unit", "group", "logarithmic", "tip", "part")}
        out.append(
            Slider(
                name=name,
                low=min(low, high, options[name]),
                high=max(high, options[name]),
                value=options[name],
                start=middle,
                fixed=name in fixed,
                tunable=name in offered.tunable and method in _TUNED,
                background=not offered.instant,
                **own,
            )
        )
    return out


def main_sliders(method: str, options: Sequence[Slider]) -> list[Slider]:
    """Return the sliders for speed and robustness of a method that has them, from those of its options.

    Their values are those at which moving them alone, from `start` on, comes nearest to the options.
    """
    families = METHODS[method].families if METHODS[method].instant else {}
    own = {one.name: one for one in options}
    along = {name: {option: x for option, x in family.items() if option in own} for name, family in families.items()}
    if not along or not all(along.values()):
        return []
    names = sorted({option for family in along.values() for option in family})
    directions = np.array([[family.get(option, 0.0) for family in along.values()] for option in names])
    ratios = np.log([own[option].value / own[option].start for option in names])
    found = dict(zip(along, np.exp(np.linalg.lstsq(directions, ratios, rcond=None)[0]), strict=True))
    first = next(iter(along["speed"]))
    out = []
    rows: tuple[tuple[Family, str, float, float, str], ...] = (
        ("speed", "Hz", own[first].start, 10.0, "crossover, with all frequencies that go along with it"),
        ("robustness", "", 1.0, 4.0, "more lead and less integral action: disk margin; 1: as in the job"),
    )
    for name, unit, middle, reach, tip in rows:
        start, at = (float(f"{middle * share:.12g}") for share in (1.0, found[name]))
        low, high = min(middle / reach, at), max(middle * reach, at)
        more: dict[str, Any] = {"low": low, "high": high, "value": at, "start": start}
        out.append(Slider(name=name, label=name, unit=unit, group="main", tip=tip, along=along[name], **more))
    return out


def moved(settings: Settings, sliders: Mapping[str, Slider], name: str, number: float, rate_hz: float) -> Settings:
    """Return the settings with a slider at `number`; `rate_hz` is the job's sample rate."""
    known_name("slider", name, tuple(sliders))
    try:
        at = float(number) if isinstance(number, int | float) and not isinstance(number, bool) else math.nan
    except OverflowError:
        at = math.inf
    if not math.isfinite(at):
        raise ArgumentError(f"{name} must be a finite number, got {short(number)}")
    low, high, unit = sliders[name].low / _BEYOND, sliders[name].high * _BEYOND, sliders[name].unit
    if unit == "Hz":
        high = max(min(high, 0.5 * rate_hz), sliders[name].high)
    low = float(f"{low:.1g}")
    if not low <= at <= high:
        raise ArgumentError(f"{name} must be from {low:.6g} to {high:.6g}{f' {unit}' if unit else ''}, got {at:g}")
    if sliders[name].along:
        factor = at / sliders[name].value
        free = {option: x for option, x in sliders[name].along.items() if option not in settings.fixed}
        numbers = {option: sliders[option].value * factor**power for option, power in free.items()}
        # Back at the job's number it is that number, to the last digit.
        near = {name: sliders[name].start for name, x in numbers.items() if math.isclose(x, sliders[name].start)}
        return with_options(settings, numbers | near)
    whole = any(method.options[name].whole for method in METHODS.values() if name in method.options)
    return with_options(settings, {name: float(round(at)) if whole else at})


def with_options(settings: Settings, changes: Mapping[str, float]) -> Settings:
    """Return the settings with other options of the design that is worked on."""
    mine = {**settings.options[settings.loop][settings.design], **changes}
    designs = {**settings.options[settings.loop], settings.design: mine}
    return dataclasses.replace(settings, options={**settings.options, settings.loop: designs})
