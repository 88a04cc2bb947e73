"""Spectra of disturbances: a class for each way to describe one, listed in `SPECTRA`.

Densities are one-sided and lines are sines, in the unit of the quantity u that they describe: u²/Hz and u. A new way
is a subclass of `SourceSpectrum` and a line of `SPECTRA`; reader, writer and budget take it from there.

A profile of base motion that a source may name is a table of profiles.toml, or a formula here. Breakpoints of standards
are in g²/Hz there and in SI here; tests integrate the tables and compare with the overall rms that the standards state.
"""

from __future__ import annotations

import math
import tomllib
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Annotated, Any, Literal, get_args

import numpy as np
from numpy.typing import ArrayLike

from platform_ctrl.analysis.logs import G, Log, LogDensity, log_density, read_density, read_log
from platform_ctrl.common.arguments import real_numbers
from platform_ctrl.common.values import FloatArray, input_value, replaced, value
from platform_ctrl.errors import ArgumentError, InputError
from platform_ctrl.plant import fields
from platform_ctrl.plant.mistakes import Misfit, of_length
from platform_ctrl.plant.tables import record_value

_PER_DECADE = 40  # points of a formula's table: between them it is off by less than 0.05 %


@value
class Profile:
    """A one-sided power spectral density, straight lines on logarithmic scales, zero outside of its points.

    Attributes
    ----------
    name
        What job files call it.
    kind
        What it is a density of: ``"base-rate"``, rad/s, or ``"specific-force"``, m/s².
    title
        What moves, in words.
    source
        Where the numbers are from, and whether they are published or assumed.
    points : (k, 2)
        Frequencies, increasing, Hz, and densities, (rad/s)²/Hz or (m/s²)²/Hz.
    """

    name: str
    kind: Literal["base-rate", "specific-force"]
    title: str
    source: str
    points: FloatArray


def _profiles() -> dict[str, Profile]:
    f = np.geomspace(0.01, 500.0, round(_PER_DECADE * np.log10(500.0 / 0.01)) + 1)
    olympus = Profile(
        name="olympus-satellite",
        kind="base-rate",
        title="angular micro-vibration of a large satellite: angle 160/(1 + f²) µrad²/Hz, 16 µrad rms",
        source="published: ESA, fitted to accelerations of Olympus: M. Wittig et al., Proc. SPIE 1218, 1990",
        points=np.array([f, (2.0 * np.pi * f) ** 2 * 160e-12 / (1.0 + f**2)]).T,
    )
    tables = tomllib.loads(Path(__file__).with_name("profiles.toml").read_text(encoding="utf-8"))["profile"]
    unit = {"base-rate": 1.0, "specific-force": G**2}
    return {olympus.name: olympus} | {
        one["name"]: Profile(**one | {"points": np.array(one["points"]) * (1.0, unit[one["kind"]])}) for one in tables
    }


PROFILES = _profiles()


Interpolation = Literal["logarithmic", "linear"]
# Nodes between two neighbouring frequencies: power laws of any usual slope are integrated to rounding errors.
_NODES, _WEIGHTS = np.polynomial.legendre.leggauss(16)


@value
class Lines:
    """Sines a sin(2π f t + φ).

    Attributes
    ----------
    frequencies_hz : (m,)
        f, Hz.
    amplitudes : (m,)
        a, units of the quantity.
    phases : (m,)
        φ, rad; None: random, independent of each other and of everything else.
    """

    frequencies_hz: FloatArray
    amplitudes: FloatArray
    phases: FloatArray | None = None


_NO_LINES = Lines(frequencies_hz=np.zeros(0), amplitudes=np.zeros(0))


class SourceSpectrum:
    """The interface of all descriptions of a disturbance."""

    __slots__ = ()

    @property
    def table(self) -> TableSpectrum | None:
        """Its density as a table, where it is one."""
        return None

    @property
    def knots_hz(self) -> FloatArray:
        """Frequencies (k,) at which the density has a bend or a jump, increasing, Hz; it is zero outside of them."""
        return np.zeros(0) if self.table is None else self.table.frequencies_hz

    def within(self, from_hz: float, to_hz: float) -> FloatArray:
        """Return the knots of the density between two frequencies and the ends of that band; none where it is zero."""
        knots = self.knots_hz
        if not knots.size or max(from_hz, knots[0]) >= min(to_hz, knots[-1]):
            return np.zeros(0)
        return np.unique(np.clip(knots, from_hz, to_hz))

    @property
    def lines(self) -> Lines:
        """Its sines; most descriptions have none."""
        return _NO_LINES

    def density(self, f_hz: ArrayLike) -> FloatArray:
        """Return the one-sided power spectral density.

        Parameters
        ----------
        f_hz : any shape (...)
            Frequencies, Hz.

        Returns
        -------
        (...)
            In units²/Hz.
        """
        one = self.table
        if one is None:
            return np.zeros(np.shape(f_hz))
        return interpolated(f_hz, one.frequencies_hz, one.densities, one.interpolation)

    def mean_square(self, from_hz: float, to_hz: float) -> float:
        """Return the integral of the density and the mean squares of the lines from one frequency to another.

        Parameters
        ----------
        from_hz, to_hz
            Limits, Hz.

        Returns
        -------
        float
            In units².
        """
        lines, edges = self.lines, self.within(from_hz, to_hz)
        inside = (from_hz <= lines.frequencies_hz) & (lines.frequencies_hz <= to_hz)
        total = 0.5 * float(np.sum(lines.amplitudes[inside] ** 2))
        # Over the logarithm of frequency, in which a power law is an exponential.
        half = 0.5 * np.log(edges[1:] / edges[:-1])[:, None]
        f = np.sqrt(edges[1:] * edges[:-1])[:, None] * np.exp(half * _NODES)
        return total + float(np.sum(self.density(f) * f * half * _WEIGHTS))


@record_value
class TableSpectrum(SourceSpectrum):
    """A density that is given at points; zero outside of them.

    Attributes
    ----------
    frequencies_hz : (k,)
        Increasing, Hz.
    densities : (k,)
        One-sided, units²/Hz.
    interpolation
        Straight lines between the points on logarithmic scales, as standards have them, or on linear ones, as spectra
        of measurements.
    """

    frequencies_hz: fields.Frequencies
    densities: fields.Densities
    interpolation: Annotated[Interpolation, fields.one_of(get_args(Interpolation))] = "logarithmic"

    @staticmethod
    def _misfits(table: Mapping[str, Any]) -> Iterator[Misfit]:
        yield from of_length(table, "densities", "frequencies_hz")

    @property
    def table(self) -> TableSpectrum:
        """Itself."""
        return self


@record_value
class PsdSpectrum(SourceSpectrum):
    """A density in a file; a table once the job is read.

    Attributes
    ----------
    psd
        Path of a CSV file with a header whose first two columns are frequencies, Hz, and densities, units²/Hz.
    """

    psd: fields.Text

    def read(self, folder: Path) -> TableSpectrum:
        """Return the table in the file, whose path starts at `folder`; `InputError` says what is wrong with it."""
        f, densities = read_density(folder / self.psd)
        return TableSpectrum(frequencies_hz=f, densities=densities)


def interpolated(
    f_hz: ArrayLike, frequencies_hz: FloatArray, densities: FloatArray, interpolation: Interpolation = "logarithmic"
) -> FloatArray:
    """Return a density that is given at points, at other frequencies; zero outside of the points."""
    f = real_numbers("f_hz", f_hz)
    if interpolation == "linear":
        return np.asarray(np.interp(f, frequencies_hz, densities, 0.0, 0.0))
    inside = (frequencies_hz[0] <= f) & (f <= frequencies_hz[-1])
    logarithm = np.interp(np.log(np.where(inside, f, 1.0)), np.log(frequencies_hz), np.log(densities))
    return np.asarray(np.where(inside, np.exp(logarithm), 0.0))


@record_value
class ProfileSpectrum(SourceSpectrum):
    """A standard profile that comes with the package.

    Attributes
    ----------
    profile
        Its name in `platform_ctrl.job.spectra`.
    scale
        Factor on the rms; the density has its square.
    """

    profile: Annotated[str, fields.one_of(PROFILES)]
    scale: fields.Positive = 1.0

    @property
    def table(self) -> TableSpectrum:
        """The profile's table, scaled."""
        f, densities = PROFILES[self.profile].points.T
        return TableSpectrum(frequencies_hz=f, densities=self.scale**2 * densities)


@record_value
class SineSpectrum(SourceSpectrum):
    """Sines a sin(2π f t + φ) of known phase: those of one frequency add up, whichever source they are of.

    Attributes
    ----------
    sines : (m, 3)
        Rows of f in Hz, a > 0 in units, φ in rad.
    """

    sines: Annotated[
        FloatArray,
        fields.Expected(
            "rows of three numbers: frequency > 0, Hz, amplitude > 0, phase, rad",
            fields.rows(lambda f: f > 0.0, lambda amplitude: amplitude > 0.0, lambda phase: True),
        ),
    ]

    @property
    def lines(self) -> Lines:
        """The sines."""
        f, amplitudes, phases = self.sines.T
        return Lines(frequencies_hz=f, amplitudes=amplitudes, phases=phases)


@record_value
class HarmonicSpectrum(SourceSpectrum):
    """Cogging and ripple of a turning motor: sines whose frequencies are multiples of its rate.

    At one rate these are lines of unknown phase. Where the rate may be anything in a range, each harmonic of amplitude
    a is a density a²/2 / (f2 − f1) between its lowest and its highest frequency: all rates of the range are equally
    likely.

    Attributes
    ----------
    harmonics : (m, 2)
        Rows of the order per revolution > 0 and the amplitude > 0, units.
    turning_rate
        Lowest and highest rate of the motor, rad/s; alike: one rate.
    """

    harmonics: Annotated[
        FloatArray,
        fields.Expected(
            "rows of two numbers: order per revolution > 0, amplitude > 0",
            fields.rows(lambda order: order > 0.0, lambda amplitude: amplitude > 0.0),
        ),
    ]
    turning_rate: fields.OneOrRange

    @property
    def _bands(self) -> FloatArray:
        """Lowest and highest frequency of each harmonic, (m, 2), Hz."""
        return np.outer(self.harmonics[:, 0], self.turning_rate) / (2.0 * math.pi)

    @property
    def lines(self) -> Lines:
        """The harmonics at the one rate of the motor; none where it has a range."""
        low, high = self.turning_rate
        return Lines(frequencies_hz=self._bands[:, 0], amplitudes=self.harmonics[:, 1]) if low == high else _NO_LINES

    @property
    def knots_hz(self) -> FloatArray:
        """Edges of the harmonics' bands, Hz; none at one rate."""
        return np.zeros(0) if self.turning_rate[0] == self.turning_rate[1] else np.unique(self._bands)

    def density(self, f_hz: ArrayLike) -> FloatArray:
        """Return the density; see `SourceSpectrum.density`."""
        f = real_numbers("f_hz", f_hz)[..., None]
        low, high = self._bands.T
        if self.turning_rate[0] == self.turning_rate[1]:
            return np.zeros(f.shape[:-1])
        inside = (low <= f) & (f <= high)
        return np.asarray(np.sum(inside * (0.5 * self.harmonics[:, 1] ** 2 / (high - low)), axis=-1))


@input_value
class LogSpectrum(SourceSpectrum):
    """A signal that was recorded; its density is estimated once the job is read.

    Attributes
    ----------
    log
        Path of a CSV file, relative to the job file.
    column, time
        Names of the columns with the signal, units, and with the time, s.
    estimate
        What `read` found; None before.
    """

    log: fields.Text
    column: fields.Text
    time: fields.Text = "time"
    estimate: LogDensity | None = None

    def read(self, folder: Path, resolution_hz: float) -> LogSpectrum:
        """Return the same with the density of the log.

        Parameters
        ----------
        folder
            Where a relative path starts.
        resolution_hz
            Steps of frequency at most, Hz.

        Returns
        -------
        LogSpectrum
            With its `estimate`.

        Raises
        ------
        InputError
            The file cannot be read or its values and stamps make no sense: one line says where.
        """
        return self.of(read_log(folder / self.log, [self.column], self.time), resolution_hz)

    def of(self, log: Log, resolution_hz: float) -> LogSpectrum:
        """Return the same with the density of a log that has been read."""
        try:
            estimate = log_density(log.time, log.signals[self.column], resolution_hz)
        except ArgumentError as error:
            raise InputError(f"{log.label}: {self.column}: {error}") from None
        return replaced(self, {"estimate": estimate})

    @property
    def table(self) -> TableSpectrum:
        """The estimated density from the first frequency above 0 on; `ArgumentError` before the log is read."""
        if self.estimate is None:
            raise ArgumentError(f"log {self.log!r} has not been read; read the job from a file, or call read()")
        f, densities = self.estimate.frequencies_hz[1:], self.estimate.densities[1:]
        # A bin of rounding errors, or of none, is not zero: densities are positive.
        return TableSpectrum(
            frequencies_hz=f, densities=np.maximum(densities, 1e-20 * densities.max()), interpolation="linear"
        )


# By the key of a source that says how it is described.
SPECTRA: dict[str, type[SourceSpectrum]] = {
    "frequencies_hz": TableSpectrum,
    "psd": PsdSpectrum,
    "profile": ProfileSpectrum,
    "log": LogSpectrum,
    "sines": SineSpectrum,
    "harmonics": HarmonicSpectrum,
}
