"""What must fit together in the budget of a job file: where sources act, their units and sizes, their correlations."""

from __future__ import annotations

import contextlib
import math
from collections.abc import Iterator
from pathlib import Path as FilePath

import numpy as np

from platform_ctrl.analysis.logs import Log, read_log
from platform_ctrl.common.values import replaced
from platform_ctrl.errors import InputError
from platform_ctrl.job.budget import SOURCE_KINDS, Budget, Source, unit_mistake
from platform_ctrl.job.profiles import PROFILES
from platform_ctrl.job.spectra import SPECTRA, LogSpectrum
from platform_ctrl.plant.entry import Entry
from platform_ctrl.plant.mistakes import Mistake, Path, given
from platform_ctrl.plant.platform import Platform

# A mean specific force so near to 1 is gravity in g rather than 1 m/s².
NEAR_ONE = 0.05


def budget_mistakes(job: Entry, platform: Platform | None) -> Iterator[Mistake]:
    """Walk what can be said of the plain data; without a platform, what can be said without it."""
    budget = job.table("budget")
    low, high, limits = budget.number("from_hz"), budget.number("to_hz"), budget.table("limits")
    if low is not None and high is not None and not low < high:
        yield budget.wrong("to_hz", f"above from_hz = {given(budget.data['from_hz'])}")
    for key in ("windowed_jitter", "smear"):
        if key in limits and not budget.data.get("exposure"):
            yield limits.text_at(key, f"{key} has no effect without exposure, the exposure times in s")
    if platform is not None and platform.line_of_sight is None:
        words = "the plant has no line of sight to be limited; state its body and direction in [line_of_sight]"
        if limits.data:
            yield budget.says("limits", words)
        yield from (source.says("limit", words) for source in budget.tables("source") if "limit" in source)
    yield from budget.unique("source")
    for source in budget.tables("source"):
        yield from _source(source, platform)
    yield from _correlations(budget)


def _source(source: Entry, platform: Platform | None) -> Iterator[Mistake]:
    name, gimbal, unit = (source.text(key) for key in ("kind", "gimbal", "unit"))
    if name not in SOURCE_KINDS:
        return
    kind, of = SOURCE_KINDS[name], f"kind = {given(name)}"
    for key, words in (("axis", "the root axis, 1 to 3"), ("gimbal", "the name of the gimbal")):
        if key == kind.place and key not in source:
            yield source.missing(key, f"{of} needs {words}")
        elif key != kind.place and key in source:
            yield source.useless(key, f"with {of}, which takes {kind.place}")
    if gimbal is not None and platform is not None and gimbal not in platform.gimbal_names:
        yield source.unknown("gimbal", gimbal, "gimbal of the plant", platform.gimbal_names)
    if unit is not None and unit not in kind.units:
        yield source.wrong("unit", f"{' or '.join(map(given, kind.units))} with {of}")
    elif words := unit_mistake(name, unit, source.text("column")):
        yield source.says("column", words.removeprefix("column "))
    if name == "specific-force" and platform is not None and not platform.unbalances:
        words = "a specific force moves the line of sight by unbalance, and the plant has none; add [[unbalance]] to it"
        yield source.says("kind", words)
    profile = source.text("profile")
    if profile in PROFILES:
        if PROFILES[profile].kind != name:
            words = f"profile {given(profile)} is of kind {given(PROFILES[profile].kind)}, got {of}"
            fitting = ", ".join(given(one.name) for one in PROFILES.values() if one.kind == name) or "none"
            yield source.text_at("profile", f"{words}; profiles of this kind: {fitting}")
        if unit is not None:
            yield source.useless("unit", "with a profile, which is in SI units; use scale")
    if "harmonics" in source and name != "torque":
        yield source.says("harmonics", 'a turning motor is a torque: kind = "torque" and a gimbal')
    yield from source.of_length("densities", "frequencies_hz")


def _correlations(budget: Entry) -> Iterator[Mistake]:
    names = budget.named("source")
    taken: dict[frozenset[str], int] = {}
    for one in budget.tables("correlation"):
        between = one.names("between")
        if between != one.data.get("between"):
            continue
        pair = frozenset(between)
        unknown = next((name for name in between if name not in names), None)
        if len(between) != 2 or len(pair) != 2:
            yield one.wrong("between", "the names of two sources")
        elif unknown is not None:
            yield one.unknown("between", unknown, "[[budget.source]] of the job", names)
        elif pair in taken:
            words = f"these two are in [[budget.correlation]] {taken[pair]} already; leave one of them out"
            yield one.says("between", words)
        taken.setdefault(pair, one.place)


def with_logs(budget: Budget, folder: FilePath) -> tuple[Budget, list[Mistake]]:
    """Return a budget whose logs are read, and what is wrong with them."""
    sources, mistakes, logs = [], [], _logs(budget, folder)
    for k, source in enumerate(budget.sources):
        if isinstance(source.spectrum, LogSpectrum):
            log = logs.get((source.spectrum.log, source.spectrum.time))
            try:
                if log is None:  # which of its columns is wrong, each says for itself
                    spectrum = source.spectrum.read(folder, budget.from_hz)
                else:
                    spectrum = source.spectrum.of(log, budget.from_hz)
                source = replaced(source, {"spectrum": spectrum})
                if words := _units_of_log(source, spectrum):
                    mistakes.append(Mistake(("budget", "source", k, "unit"), words))
            except InputError as error:
                key = "column" if "there is no column" in str(error) else "log"
                mistakes.append(Mistake(("budget", "source", k, key), f"{key}: {error}"))
        sources.append(source)
    return replaced(budget, {"sources": tuple(sources)}), mistakes


def _logs(budget: Budget, folder: FilePath) -> dict[tuple[str, str], Log]:
    """Return the logs that can be read by their paths and columns of time, each read once for all of its columns."""
    columns: dict[tuple[str, str], list[str]] = {}
    for source in budget.sources:
        if isinstance(source.spectrum, LogSpectrum):
            columns.setdefault((source.spectrum.log, source.spectrum.time), []).append(source.spectrum.column)
    found = {}
    for (path, time), names in columns.items():
        with contextlib.suppress(InputError):
            found[path, time] = read_log(folder / path, names, time)
    return found


def _units_of_log(source: Source, spectrum: LogSpectrum) -> str:
    """Return what is wrong with the size of a log, its mean included, in words."""
    assert spectrum.estimate is not None
    mean, kind = spectrum.estimate.mean, SOURCE_KINDS[source.kind]
    whole = source.factor * math.hypot(mean, math.sqrt(spectrum.estimate.variance))
    if whole > kind.largest_rms:
        return too_large(source, whole)
    unstated = source.unit is None and source.stated_unit is None
    if source.kind == "specific-force" and unstated and abs(abs(mean) - 1.0) < NEAR_ONE:
        words = f"unit: the mean of {given(spectrum.column)} is {mean:.4g}, which looks like gravity in g"
        return f'{words}; write unit = "g", or unit = "m/s2" if it is meant'
    return ""


def size_mistakes(budget: Budget) -> Iterator[Mistake]:
    """Walk what the values show: sources outside of the band, sizes that cannot be meant, coherences of no signals."""
    for k, source in enumerate(budget.sources):
        path: Path = ("budget", "source", k)
        lead = next(key for key, kind in SPECTRA.items() if isinstance(source.spectrum, kind))
        edges = np.concatenate([source.knots_hz, source.lines.frequencies_hz])
        if edges.min() > budget.to_hz or edges.max() < budget.from_hz:
            words = f"{lead}: nothing of it lies in the band of the budget, {budget.from_hz:g} to {budget.to_hz:g} Hz"
            range_words = f"{edges.min():.4g} to {edges.max():.4g} Hz"
            yield Mistake((*path, lead), f"{words}, got {range_words}; widen the band or leave the source out")
        elif (rms := source.rms(float(edges.min()), float(edges.max()))) > SOURCE_KINDS[source.kind].largest_rms:
            yield Mistake((*path, lead), f"{lead}: {too_large(source, rms)}")
    smallest = float(np.linalg.eigvalsh(budget.coherences)[0]) if np.isfinite(budget.coherences).all() else 0.0
    if smallest < -1e-9:
        words = "no signals have these coherences together: their matrix has the negative eigenvalue"
        yield Mistake(("budget", "correlation"), f"correlation: {words} {smallest:.4g}; lower a coherence")


def too_large(source: Source, rms: float) -> str:
    """Return the words about a size that cannot be meant."""
    kind = SOURCE_KINDS[source.kind]
    si = next(iter(kind.units))
    named = source.unit or (source.stated_unit.name if source.stated_unit else si)
    others = ", ".join(given(unit) for unit in kind.units if unit != named)
    most = f"an rms of {rms:.4g} {si} cannot be meant, at most {kind.largest_rms:g} {si}"
    return f'{most}, with unit = "{named}"; other units: {others}'
