"""What the values of a budget show: logs that cannot be read, sizes that cannot be meant, coherences of no signals."""

from __future__ import annotations

import contextlib
import math
from collections.abc import Iterator
from pathlib import Path as FilePath

import numpy as np

from platform_ctrl.analysis.logs import Log, read_log
from platform_ctrl.common.values import replaced
from platform_ctrl.errors import InputError
from platform_ctrl.job.budget import SOURCE_KINDS, Budget, Source
from platform_ctrl.job.spectra import SPECTRA, LogSpectrum
from platform_ctrl.plant.mistakes import Mistake, Path, given

# A mean specific force so near to 1 is gravity in g rather than 1 m/s².
NEAR_ONE = 0.05


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
