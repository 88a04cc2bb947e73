"""Disturbances of the line of sight as values of the job file: sources, their correlations, the band and the limits."""

from __future__ import annotations

import contextlib
import math
from collections.abc import Iterator, Mapping
from dataclasses import field
from pathlib import Path as FilePath
from typing import Annotated, Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from platform_ctrl.analysis.logs import ColumnUnit, G, Log, Quantity, column_unit, read_log
from platform_ctrl.common.values import FloatArray, input_value, replaced, value
from platform_ctrl.errors import ArgumentError, InputError
from platform_ctrl.job.spectra import (
    PROFILES,
    SPECTRA,
    HarmonicSpectrum,
    Lines,
    LogSpectrum,
    PsdSpectrum,
    SourceSpectrum,
)
from platform_ctrl.plant import fields
from platform_ctrl.plant import mistakes as mistake
from platform_ctrl.plant.platform import Platform
from platform_ctrl.plant.tables import TABLE, Array, OneOf, Shape, record_value

MOST_SOURCES = 100


@value
class SourceKind:
    """A quantity that disturbs.

    Attributes
    ----------
    quantity
        What it is, as units of columns say it.
    units
        Units in which a file may give it, with their factors to SI; the first is the SI unit.
    place
        The key that says where it acts: ``"axis"`` or ``"gimbal"``.
    largest
        More than this cannot be meant, SI units: most likely the numbers are in another unit.
    """

    quantity: Quantity
    units: Mapping[str, float]
    place: str
    largest: float = math.inf


SOURCE_KINDS: dict[str, SourceKind] = {
    # 200 rad/s is 32 turns a second, more than projectiles that carry a seeker have; 1000 m/s² is 100 g.
    "base-rate": SourceKind(
        quantity="rate", units={"rad/s": 1.0, "deg/s": math.pi / 180.0}, place="axis", largest=200.0
    ),
    "specific-force": SourceKind(quantity="acceleration", units={"m/s2": 1.0, "g": G}, place="axis", largest=1000.0),
    "torque": SourceKind(quantity="torque", units={"N m": 1.0, "mN m": 1e-3}, place="gimbal"),
}
UNITS = tuple(unit for kind in SOURCE_KINDS.values() for unit in kind.units)


def too_large(key: str, numbers: ArrayLike, kind: str, unit: str | None = None) -> Iterator[mistake.Misfit]:
    """Yield numbers in SI units of a kind of source that are larger than can be meant; `unit` is that of the file."""
    known = list(SOURCE_KINDS[kind].units)
    worst, most = float(np.abs(numbers).max(initial=0.0)), SOURCE_KINDS[kind].largest
    if worst > most:
        cure = f"write it in {known[0]}" if unit is None else f'with unit = "{unit}"; units: {", ".join(known)}'
        yield key, f"{key}: {worst:.4g} {known[0]} cannot be meant, at most {most:g} {known[0]}; {cure}"


def misplaced(table: Mapping[str, Any], kind: str) -> Iterator[mistake.Misfit]:
    """Yield what is wrong with the place where a kind of source, which the table may call otherwise, acts."""
    of, place = f"kind = {mistake.given(table['kind'])}", SOURCE_KINDS[kind].place
    for key, words in (("axis", "the root axis, 1 to 3"), ("gimbal", "the name of the gimbal")):
        if key == place and key not in table:
            yield mistake.missing(key, f"{of} needs {words}")
        elif key != place and key in table:
            yield mistake.useless(table, key, f"with {of}, which takes {place}")


def unit_mistake(kind: str, unit: str | None, column: str | None) -> str:
    """Return in words how the unit that the name of a log's column states contradicts kind or unit of a source."""
    stated = None if column is None else column_unit(column)[1]
    if stated is None or stated.quantity == "time":  # a signal is no time: its name ends in s
        return ""
    own = SOURCE_KINDS[kind]
    words = f'column: "{column}" is in {stated.name} by its name'
    if stated.quantity != own.quantity:
        known = " or ".join(f'"{one}"' for one in own.units)
        wanted = f'kind = "{kind}" needs {own.quantity}; name another column, or state unit = {known}'
        return "" if unit is not None else f"{words}, and {wanted}"
    if unit is not None and not math.isclose(own.units[unit], stated.factor, rel_tol=1e-9):
        return f'{words}, and unit = "{unit}" contradicts it; leave unit out, or rename the column'
    return ""


# Limits of the motion within an exposure.
WINDOWED = {"windowed_jitter", "smear", "contrast"}


@input_value
class BudgetLimits:
    """What the line of sight has to keep, rad but for `contrast`; None: no requirement.

    Attributes
    ----------
    jitter, jitter_per_axis
        Rms in the band of the budget: of both axes together (root of the sum of squares), and of either one.
    windowed_jitter, smear
        Rms within an exposure about its mean, and of the extent of the line that fits it best, from end to end: both
        axes together, for the exposure where it is largest.
    contrast
        Least modulation transfer function of the motion within an exposure, of both axes and all spatial frequencies.
    """

    jitter: fields.Positive | None = None
    jitter_per_axis: fields.Positive | None = None
    windowed_jitter: fields.Positive | None = None
    smear: fields.Positive | None = None
    contrast: fields.InsidePart | None = None


@record_value
class Source:
    """One disturbance.

    Attributes
    ----------
    name
        Its name in tables and plots.
    kind
        ``"base-rate"``: rate of the base about a root axis; ``"specific-force"``: along a root axis, which acts on
        unbalance; ``"torque"``: on a gimbal, against its parent.
    axis, gimbal
        Root axis, 1 to 3, of a base rate or specific force; name of the gimbal of a torque.
    unit
        Of what `spectrum` says; None: SI, but of a log the unit that the name of its column states.
    limit
        Largest rms of the line of sight from this source alone, rad; None: no requirement.
    spectrum
        What it is over frequency: one of `platform_ctrl.job.spectra`, in units of `unit`.
    """

    name: fields.Text
    kind: Annotated[str, fields.one_of(SOURCE_KINDS)]
    axis: fields.RootAxis | None = None
    gimbal: fields.Text | None = None
    unit: Annotated[str, fields.one_of(UNITS)] | None = None
    limit: fields.Positive | None = None
    spectrum: Annotated[SourceSpectrum, OneOf(SPECTRA)]

    @staticmethod
    def _misfits(table: Mapping[str, Any]) -> Iterator[mistake.Misfit]:
        kind, of, unit = SOURCE_KINDS[table["kind"]], f"kind = {mistake.given(table['kind'])}", table.get("unit")
        yield from misplaced(table, table["kind"])
        if unit is not None and unit not in kind.units:
            yield mistake.wrong(table, "unit", f"{' or '.join(map(mistake.given, kind.units))} with {of}")
        elif contradiction := unit_mistake(table["kind"], unit, table.get("column")):
            yield "column", contradiction
        if "profile" in table:
            profile = PROFILES[table["profile"]]
            if profile.kind != table["kind"]:
                words = f"profile {mistake.given(profile.name)} is of kind {mistake.given(profile.kind)}, got {of}"
                fitting = (
                    ", ".join(mistake.given(one.name) for one in PROFILES.values() if one.kind == table["kind"])
                    or "none"
                )
                yield "profile", f"{words}; profiles of this kind: {fitting}"
            if unit is not None:
                yield mistake.useless(table, "unit", "with a profile, which is in SI units; use scale")
        if "harmonics" in table and table["kind"] != "torque":
            yield "harmonics", 'harmonics: a turning motor is a torque: kind = "torque" and a gimbal'
        yield from mistake.of_length(table, "densities", "frequencies_hz")

    @property
    def factor(self) -> float:
        """SI units in a unit of `spectrum`, dimensionless."""
        if self.unit is not None:
            return SOURCE_KINDS[self.kind].units[self.unit]
        return 1.0 if self.stated_unit is None else self.stated_unit.factor

    @property
    def stated_unit(self) -> ColumnUnit | None:
        """The unit that the name of a log's column states, where `unit` does not say it; None: none."""
        if self.unit is not None or not isinstance(self.spectrum, LogSpectrum):
            return None
        stated = column_unit(self.spectrum.column)[1]
        return stated if stated is not None and stated.quantity == SOURCE_KINDS[self.kind].quantity else None

    @property
    def lines(self) -> Lines:
        """Its sines, SI units."""
        own = self.spectrum.lines
        return Lines(frequencies_hz=own.frequencies_hz, amplitudes=self.factor * own.amplitudes, phases=own.phases)

    def density(self, f_hz: ArrayLike) -> FloatArray:
        """Return the one-sided power spectral density.

        Parameters
        ----------
        f_hz : any shape (...)
            Frequencies, Hz.

        Returns
        -------
        (...)
            (rad/s)²/Hz, (m/s²)²/Hz or (N m)²/Hz.
        """
        return self.factor**2 * self.spectrum.density(f_hz)

    def rms(self, from_hz: float, to_hz: float) -> float:
        """Return the rms between two frequencies.

        Parameters
        ----------
        from_hz, to_hz
            Limits, Hz.

        Returns
        -------
        float
            rad/s, m/s² or N m.
        """
        return self.factor * math.sqrt(self.spectrum.mean_square(from_hz, to_hz))


@input_value
class Correlation:
    """How much two sources have in common: E[conj(a) b] is sqrt(coherence S_a S_b) exp(j phase).

    Attributes
    ----------
    between
        Names of the two sources a and b.
    coherence
        Magnitude-squared coherence |S_ab|²/(S_a S_b), dimensionless, at all frequencies; 1: one is the other, filtered.
    phase
        By which b leads a, rad.
    """

    between: fields.Names
    coherence: fields.Part
    phase: fields.Number = 0.0


@input_value
class BudgetSpec:
    """What disturbs the line of sight, and how much of that it may follow.

    Attributes
    ----------
    from_hz, to_hz
        Band of the budget, Hz.
    exposure
        Exposure times for windowed jitter and smear, s.
    spatial_frequencies
        At which the modulation transfer function is wanted, cycles/rad.
    runs
        How many runs of the non-linear plant are simulated beside the linear budget; None: none.
    turning
        Mean rates of gimbals by the names of their angles, rad/s: dry friction is that of bearings that turn so.
    limits
        What the line of sight has to keep.
    sources, correlations
        What disturbs; sources are independent unless a correlation says otherwise.
    """

    from_hz: fields.Positive
    to_hz: fields.Positive
    exposure: fields.Positives = ()
    spatial_frequencies: fields.Positives = ()
    runs: fields.SeveralRuns | None = None
    turning: Annotated[dict[str, float], Shape(dict, {}, others=("", fields.NUMBER))] = field(default_factory=dict)
    limits: Annotated[BudgetLimits, TABLE] = field(default_factory=BudgetLimits)
    sources: Annotated[tuple[Source, ...], Array("source", least=1, most=MOST_SOURCES, unique=("name",))]
    correlations: Annotated[tuple[Correlation, ...], Array("correlation")] = ()

    @staticmethod
    def _misfits(table: Mapping[str, Any]) -> Iterator[mistake.Misfit]:
        if not table["from_hz"] < table["to_hz"]:
            yield mistake.wrong(table, "to_hz", f"above from_hz = {mistake.given(table['from_hz'])}")
        for key in WINDOWED & table.get("limits", {}).keys():
            if "exposure" not in table:
                yield ("limits", key), f"{key} has no effect without exposure, the exposure times in s"
            elif key == "contrast" and "spatial_frequencies" not in table:
                yield ("limits", key), f"{key} has no effect without spatial_frequencies, in cycles/rad"

    @property
    def coherences(self) -> NDArray[np.complex128]:
        """Complex coherences of E[u conj(u)ᵀ], (sources, sources), dimensionless; Hermitian, ones on the diagonal."""
        names = [source.name for source in self.sources]
        out = np.eye(len(names), dtype=np.complex128)
        for one in self.correlations:
            a, b = (names.index(name) for name in one.between)
            out[a, b] = math.sqrt(one.coherence) * np.exp(-1j * one.phase)
            out[b, a] = out[a, b].conjugate()
        return out

    @property
    def has_sines(self) -> bool:
        """Whether there are sines within the band."""
        lines = np.concatenate([one.lines.frequencies_hz for one in self.sources])
        return bool(np.any((self.from_hz <= lines) & (lines <= self.to_hz)))

    def without_motors(self, platform: Platform) -> str:
        """Return the words that cogging and ripple of motors are no part of it; none where harmonics stand for them."""
        stated = {one.gimbal for one in self.sources if isinstance(one.spectrum, HarmonicSpectrum)}
        uneven = (one for one in platform.motors if one.cogging is not None or one.ripple is not None)
        names = [one.name or one.gimbal for one in uneven if one.gimbal not in stated]
        return f"without cogging and ripple of {', '.join(names)}, which runs show" if names else ""


# A mean specific force so near to 1 is gravity in g rather than 1 m/s².
NEAR_ONE = 0.05


def with_files(budget: BudgetSpec, folder: FilePath) -> tuple[BudgetSpec, list[mistake.Mistake]]:
    """Return a budget whose files are read, and what is wrong with them."""
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
                if words := _gravity_in_g(source, spectrum):
                    mistakes.append(mistake.Mistake(("budget", "source", k, "unit"), words))
            except InputError as error:
                key = "column" if "there is no column" in str(error) else "log"
                mistakes.append(mistake.Mistake(("budget", "source", k, key), f"{key}: {error}"))
        elif isinstance(source.spectrum, PsdSpectrum):
            try:
                source = replaced(source, {"spectrum": source.spectrum.read(folder)})
            except (InputError, ArgumentError) as error:
                mistakes.append(mistake.Mistake(("budget", "source", k, "psd"), f"psd: {error}"))
        sources.append(source)
    return replaced(budget, {"sources": tuple(sources)}), mistakes


def _logs(budget: BudgetSpec, folder: FilePath) -> dict[tuple[str, str], Log]:
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


def _gravity_in_g(source: Source, spectrum: LogSpectrum) -> str:
    """Return the words about a log of a specific force whose mean looks like gravity in g; none where it does not."""
    assert spectrum.estimate is not None
    mean, unstated = spectrum.estimate.mean, source.unit is None and source.stated_unit is None
    if source.kind != "specific-force" or not unstated or abs(abs(mean) - 1.0) >= NEAR_ONE:
        return ""
    words = f"unit: the mean of {mistake.given(spectrum.column)} is {mean:.4g}, which looks like gravity in g"
    return f'{words}; write unit = "g", or unit = "m/s2" if it is meant'


def value_mistakes(budget: BudgetSpec) -> Iterator[mistake.Mistake]:
    """Yield what the values show: sources outside of the band, coherences of no signals."""
    for k, source in enumerate(budget.sources):
        path: mistake.Path = ("budget", "source", k)
        lead = next(key for key, kind in SPECTRA.items() if isinstance(source.spectrum, kind))
        edges = np.concatenate([source.spectrum.knots_hz, source.lines.frequencies_hz])
        shaken = (budget.from_hz <= source.lines.frequencies_hz) & (source.lines.frequencies_hz <= budget.to_hz)
        if not source.spectrum.within(budget.from_hz, budget.to_hz).size and not shaken.any():
            words = f"{lead}: nothing of it lies in the band of the budget, {budget.from_hz:g} to {budget.to_hz:g} Hz"
            range_words = f"{edges.min():.4g} to {edges.max():.4g} Hz"
            yield mistake.Mistake((*path, lead), f"{words}, got {range_words}; widen the band or leave the source out")
        stated = source.stated_unit
        unit = source.unit or (stated.name if stated else next(iter(SOURCE_KINDS[source.kind].units)))
        size = source.rms(float(edges.min()), float(edges.max()))
        if isinstance(source.spectrum, LogSpectrum) and source.spectrum.estimate is not None:
            size = math.hypot(size, source.factor * source.spectrum.estimate.mean)
        yield from mistake.at(path, too_large(lead, size, source.kind, unit))
    smallest = float(np.linalg.eigvalsh(budget.coherences)[0]) if np.isfinite(budget.coherences).all() else 0.0
    if smallest < -1e-9:
        words = "no signals have these coherences together: their matrix has the negative eigenvalue"
        yield mistake.Mistake(("budget", "correlation"), f"correlation: {words} {smallest:.4g}; lower a coherence")


def sight_misfits(
    limits: Mapping[str, float], budget: BudgetSpec | None, platform: Platform, apart: bool
) -> Iterator[mistake.Misfit]:
    """Yield limits or goals of a loop on the budget of the line of sight that the job does not have.

    `apart`: whether all loops are computed at every sample, each with plants of its own and none within another.
    """
    for key in sorted({"jitter", "jitter_per_axis", *WINDOWED} & {*limits}):
        if budget is None or platform.line_of_sight is None:
            yield key, f"{key} needs a budget of the line of sight; add [budget], and [line_of_sight] to the plant"
        elif key in WINDOWED and not budget.exposure:
            yield key, f"{key} has no effect without exposure of [budget], the exposure times in s"
        elif key == "contrast" and not budget.spatial_frequencies:
            yield key, f"{key} has no effect without spatial_frequencies of [budget], in cycles/rad"
        elif key == "contrast" and limits[key] >= 1.0:
            yield mistake.wrong(limits, key, "a share between 0 and 1")
        elif not apart:
            words = f"{key} is a limit of a loop where all loops are computed at every sample and none is a tracking or"
            yield key, f"{words} stabilisation loop; else use [budget.limits]"


def budget_misfits(budget: BudgetSpec, platform: Platform) -> Iterator[mistake.Misfit]:
    """Yield what does not fit together in a budget, and with the plant."""
    if platform.line_of_sight is None:
        words = "the plant has no line of sight to be limited; state its body and direction in [line_of_sight]"
        if any(getattr(budget.limits, name) is not None for name in budget.limits.__dataclass_fields__):
            yield "limits", f"limits: {words}"
        limited = [k for k, source in enumerate(budget.sources) if source.limit is not None]
        yield from ((("source", k, "limit"), f"limit: {words}") for k in limited)
    yield from mistake.strange("turning", budget.turning, "angle of a gimbal", platform.angle_names)
    moved = platform.weighs or any(one.base_force.any() for one in platform.modes)
    for k, source in enumerate(budget.sources):
        gimbals = platform.gimbal_names
        yield from mistake.within(
            ("source", k), mistake.strange("gimbal", [source.gimbal], "gimbal of the plant", gimbals)
        )
        if source.kind == "specific-force" and not moved:
            words = "a specific force moves the line of sight by unbalance, and the plant has none; add [[unbalance]]"
            yield ("source", k, "kind"), f"kind: {words} to it, or the masses of its bodies"
    names = [source.name for source in budget.sources]
    taken: dict[frozenset[str], int] = {}
    for k, one in enumerate(budget.correlations):
        pair = frozenset(one.between)
        if len(pair) != 2:
            yield from mistake.within(("correlation", k), [mistake.wrong(one, "between", "the names of two sources")])
        elif not pair <= set(names):
            misfits = mistake.strange("between", one.between, "[[budget.source]] of the job", names)
            yield from mistake.within(("correlation", k), misfits)
        elif taken.setdefault(pair, k) != k:
            words = f"these two are in [[budget.correlation]] {taken[pair] + 1} already; leave one of them out"
            yield ("correlation", k, "between"), f"between: {words}"
