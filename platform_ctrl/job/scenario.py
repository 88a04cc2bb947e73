"""A run of the non-linear plant as values: start, motion of the platform, faults and their times. SI units."""

from __future__ import annotations

import math
import os
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import field
from typing import Annotated, Any, Literal, get_args

import numpy as np
from numpy.typing import ArrayLike

from platform_ctrl.analysis.logs import column_unit, pieces, read_log
from platform_ctrl.common.arguments import number, real_array, real_numbers, short
from platform_ctrl.common.values import FloatArray, input_value, read_only
from platform_ctrl.errors import ArgumentError, InputError
from platform_ctrl.job.budget import misplaced, too_large
from platform_ctrl.job.drive import DriveLaw
from platform_ctrl.job.faults import Fault
from platform_ctrl.job.resolve import Resolver, reading_units
from platform_ctrl.job.spectra import interpolated
from platform_ctrl.mechanics.forces import specific_force_at, twisted
from platform_ctrl.plant import fields
from platform_ctrl.plant.mistakes import Misfit, given, missing, of_length, useless
from platform_ctrl.plant.platform import Platform
from platform_ctrl.plant.source import path_of
from platform_ctrl.plant.tables import record_value

Mode = Literal["caged", "stabilised"]
VibrationKind = Literal["rate", "force", "torque"]
Start = Literal["rest", "equilibrium"]
# Substeps to a period of a sine of the base at least: an error of 1e-4 of its amplitude.
_STEPS_TO_A_PERIOD = 6.0


@record_value
class HalfCosine:
    """A platform rate that rises to `rate` about a root axis along half a cosine, is held, and falls back.

    Attributes
    ----------
    axis
        Root axis, 1 to 3.
    rate
        Rate that is held, rad/s.
    rise, hold
        Length of the rise (and of the fall), and of the time between, s.
    """

    axis: fields.RootAxis
    rate: fields.Number
    rise: fields.NotNegative
    hold: fields.NotNegative


def _scales(label: str, columns: Sequence[str | None], factor: float | None) -> dict[str, float]:
    """Return SI units in a unit of each column of rates or torques, by the names of the columns or by `factor`."""
    out, quantities = {}, {}
    for name in filter(None, columns):
        unit = column_unit(name)[1]
        if unit is None or unit.quantity == "time":  # which no signal is: its name ends in s
            out[name] = 1.0 if factor is None else factor
            continue
        words = f"column {given(name)} is in {unit.name} by its name"
        if unit.quantity not in ("rate", "torque"):
            if factor is None:
                raise InputError(f"{label}: {words}; name a column of a rate or a torque, or give factor")
        elif factor is not None and not math.isclose(abs(factor), unit.factor, rel_tol=1e-6):
            words = f"{words}, and factor = {factor:.6g} contradicts it"
            raise ArgumentError(f"TimeTable.from_log: {words}; leave factor out, or rename the column")
        out[name], quantities[unit.quantity] = unit.factor if factor is None else factor, words
    if factor is None and len(quantities) > 1:
        raise InputError(f"{label}: {' and '.join(quantities.values())}; name columns of rates, or of torques")
    return out


@input_value
class TimeTable:
    """Three numbers over time, given at points; before the first and after the last point they stay as there.

    Attributes
    ----------
    t : (k,)
        Times of the points, increasing, s.
    values : (k, 3)
        Of a rate, rad/s, or a torque, N m, in root axes.
    smooth
        Between the points: a cubic spline with natural ends, or straight lines.
    scale
        Factor on all of the values.
    """

    t: FloatArray
    values: FloatArray
    smooth: bool = False
    scale: float = 1.0

    def __post_init__(self) -> None:
        """Check the points, and keep them read-only."""
        points = np.size(self.t)
        for name, shape in (("t", (points,)), ("values", (points, 3))):
            given = real_array(f"TimeTable: {name}", getattr(self, name), shape)
            object.__setattr__(self, name, read_only(given))
        if points < (2 if self.smooth else 1) or np.any(np.diff(self.t) <= 0.0):
            least = "two times or more" if self.smooth else "times"
            raise ArgumentError(f"TimeTable: t must be {least} that increase, s, got {short(self.t.tolist())}")
        number("TimeTable: scale", self.scale)

    @classmethod
    def from_log(
        cls,
        path: str | os.PathLike[str],
        columns: Sequence[str | None],
        *,
        time: str = "time",
        factor: float | None = None,
    ) -> TimeTable:
        """Return a recorded log as a table that begins at t = 0.

        Parameters
        ----------
        path
            Of a CSV file with a header.
        columns
            Names of the three columns; None: zero.
        time
            Name of the column with the time: in s, or in the unit that it states (``time_us``). Where there is no
            column ``time``, the one column of this name with a unit.
        factor
            SI units in a unit of the log; None: 1, or as the names of the columns state (``gyro_z_dps``).

        Returns
        -------
        TimeTable
            With all samples of the log.

        Raises
        ------
        InputError
            A line makes no sense, the clock cannot be in its unit, the columns are in units of different quantities,
            or the log has a gap.
        ArgumentError
            The columns are not three, or `factor` contradicts the unit that one of them states.
        """
        if len(columns) != 3 or not any(columns):
            raise ArgumentError(
                f"TimeTable.from_log: columns must be three, not all of them None, got {short(columns)}"
            )
        log = read_log(path_of(path, "the path of a log"), [name for name in columns if name is not None], time)
        if len(parts := pieces(log.time)) > 1:
            words = f"{log.label}: has a gap from {log.time[parts[0].stop - 1]:.6g} to {log.time[parts[1].start]:.6g} s"
            raise InputError(f"{words}; give a part of the log without gaps")
        scales = _scales(log.label, columns, None if factor is None else number("TimeTable.from_log: factor", factor))
        zero = np.zeros(len(log.time))
        values = [zero if name is None else scales[name] * log.signals[name] for name in columns]
        return cls(t=log.time - log.time[0], values=np.stack(values, axis=1))

    @property
    def pieces(self) -> FloatArray:
        """Coefficients (k − 1, 3, 4) of each piece in powers 0 to 3 of the time since its first point.

        SI units, unscaled. A table of one point is one piece.
        """
        if self.smooth:
            from scipy.interpolate import CubicSpline

            # SciPy's order: highest power first, (power, piece, component).
            spline = CubicSpline(self.t, self.values, bc_type="natural")
            return np.ascontiguousarray(spline.c[::-1].transpose(1, 2, 0))
        out = np.zeros((max(len(self.t) - 1, 1), 3, 4))
        out[:, :, 0] = self.values[: len(out)]
        out[: len(self.t) - 1, :, 1] = np.diff(self.values, axis=0) / np.diff(self.t)[:, None]
        return out

    def at(self, t: ArrayLike) -> FloatArray:
        """Return the three numbers at given times.

        Parameters
        ----------
        t : any shape (...)
            Times, s.

        Returns
        -------
        (..., 3)
            In the units of `values`, scaled.
        """
        times = np.clip(real_numbers("TimeTable.at: t", t), self.t[0], self.t[-1])
        piece = np.clip(np.searchsorted(self.t, times, side="right") - 1, 0, max(len(self.t) - 2, 0))
        c, s = self.scale * self.pieces[piece], (times - self.t[piece])[..., None]
        return np.asarray(c[..., 0] + s * (c[..., 1] + s * (c[..., 2] + s * c[..., 3])))


# What shakes in a run, and what the sources of a budget call it.
SOURCE_KIND: dict[VibrationKind, str] = {"rate": "base-rate", "force": "specific-force", "torque": "torque"}


def _shaking(table: Mapping[str, Any]) -> Iterator[Misfit]:
    """Yield what is wrong with a vibration or a sine."""
    kind = SOURCE_KIND[table["kind"]]
    yield from misplaced(table, kind)
    yield from too_large("amplitude", table.get("amplitude", 0.0), kind)
    yield from of_length(table, "densities", "frequencies_hz")


@record_value
class Vibration:
    """Random vibration of the base, or torque on a gimbal, with a one-sided power spectral density.

    Simulated as a sum of `lines` sinusoids at the centres of equal intervals of logarithmic frequency, with phases
    drawn from the run's seed (Shinozuka, J. Acoust. Soc. Am. 49, 1971).

    Attributes
    ----------
    kind
        ``"rate"`` adds to the prescribed Omega (only caged); ``"force"`` adds to the specific force; ``"torque"`` acts
        on a gimbal, against its parent.
    axis, gimbal
        Root axis, 1 to 3; of a torque the gimbal's name.
    frequencies_hz : (k,)
        Increasing, Hz.
    densities : (k,)
        One-sided, (rad/s)²/Hz, (m/s²)²/Hz or (N m)²/Hz. Straight lines between the points on logarithmic scales, zero
        outside.
    lines
        Number of sinusoids.

    References
    ----------
    M. Shinozuka, Journal of the Acoustical Society of America 49, 1971.
    """

    kind: Annotated[VibrationKind, fields.one_of(get_args(VibrationKind))]
    axis: fields.RootAxis | None = None
    gimbal: fields.Text | None = None
    frequencies_hz: fields.Frequencies
    densities: fields.Densities
    lines: fields.Lines = 64
    _misfits = staticmethod(_shaking)

    @property
    def amplitudes(self) -> tuple[FloatArray, FloatArray]:
        """Frequencies of the lines, rad/s, and their amplitudes sqrt(2 S(f) Δf), rad/s or m/s²; each (lines,)."""
        low, high = math.log(self.frequencies_hz[0]), math.log(self.frequencies_hz[-1])
        edges = np.exp(np.linspace(low, high, self.lines + 1))
        middle = np.sqrt(edges[:-1] * edges[1:])
        density = np.zeros(self.lines)
        if self.densities.any():  # else it has been scaled to nothing
            density = interpolated(middle, self.frequencies_hz, self.densities)
        return 2.0 * math.pi * middle, np.sqrt(2.0 * density * np.diff(edges))


@record_value
class Sine:
    """A sinusoidal motion of the base, or torque on a gimbal: amplitude sin(2π frequency_hz t + phase).

    Attributes
    ----------
    kind, axis, gimbal
        As of a vibration.
    frequency_hz
        Frequency of the sine, Hz.
    amplitude
        Peak value, rad/s, m/s² or N m.
    phase
        At t = 0, rad.
    """

    kind: Annotated[VibrationKind, fields.one_of(get_args(VibrationKind))]
    axis: fields.RootAxis | None = None
    gimbal: fields.Text | None = None
    frequency_hz: Annotated[float, fields.FREQUENCY]
    amplitude: fields.NotZero
    phase: fields.Number = 0.0
    _misfits = staticmethod(_shaking)


# The keys that make a command: each with the keys that it needs, and those that it may have.
COMMANDS: dict[str, tuple[str, ...]] = {"step": (), "ramp": (), "amplitude": ("frequency_hz",), "value": ("t",)}
_BESIDE = {
    "at": ("step", "ramp"),
    "frequency_hz": ("amplitude",),
    "phase": ("amplitude",),
    "t": ("value",),
    "smooth": ("value",),
}


@record_value
class Command:
    """What a loop holds one of its readings at in a run: the sum of what is given, and of all commands of the reading.

    Attributes
    ----------
    reading
        Name of the sensor: its loop computes u = K (y − command). Amounts are in the sensor's unit, rad or rad/s.
    step, ramp
        From `at` on: a constant, and its change per second.
    at
        When they begin, s.
    frequency_hz, amplitude, phase
        amplitude sin(2π frequency_hz t + phase); Hz, the reading's unit, rad.
    t, value : (k,)
        A table over time; before the first and after the last point it stays as there. t in s.
    smooth
        Between the points of the table: a cubic spline with natural ends, or straight lines.
    """

    reading: fields.Text
    step: fields.NotZero = 0.0
    ramp: fields.NotZero = 0.0
    at: fields.NotNegative = 0.0
    frequency_hz: Annotated[float, fields.FREQUENCY] = 0.0
    amplitude: fields.NotZero = 0.0
    phase: fields.Number = 0.0
    t: Annotated[tuple[float, ...], fields.TIMES] = ()
    value: fields.Numbers = ()
    smooth: fields.Truth = False

    @staticmethod
    def _misfits(table: Mapping[str, Any]) -> Iterator[Misfit]:
        made = [key for key in COMMANDS if key in table]
        for key in made:
            yield from (missing(one, f"{key} has no effect without it") for one in COMMANDS[key] if one not in table)
        for key, of in _BESIDE.items():
            if made and key in table and not any(one in table for one in of):
                yield useless(table, key, f"without {' or '.join(of)}; add it, or leave the key out")
        yield from of_length(table, "value", "t")


@input_value
class Scenario:
    """One run: the plant as it is in this run, how it begins, its excitation, its faults and its limits.

    Noise and random phases depend on (`seed`, `run`), the sample and the channel alone.

    Attributes
    ----------
    platform
        The plant, tolerances included.
    mode
        ``"caged"``: Omega is prescribed; ``"stabilised"``: the platform is free.
    duration, delay
        Length of the run, and from the sample to the torque, s.
    profile, Omega_table
        Caged: what Omega is the sum of, rates of vibrations and sines included; none of them: zero.
    torque : (3,)
        Stabilised: constant torque on the platform in its own axes, N m; `torque_table` adds to it.
    torque_table
        Stabilised: a torque over time, or None.
    vibrations, sines
        Of the base, and torques on gimbals.
    gimbal_torques
        Torques on gimbals over time: name of the gimbal, and rows of time, s, and torque, N m, (k, 2).
    fade
        Time over which vibrations and sines rise from zero by a half-cosine, s; 0: they are there from t = 0 on, as a
        step of the platform's rate.
    commands
        What loops hold their readings at; others hold them at zero.
    filters
        Time constant τ of the reference filter, s, by the names of readings whose loops have one, 1/(τ s + 1)². What
        the run sends there of ramps, sines and tables is advanced, 2 r(t + τ) − r(t), so that the path is not late.
    drives
        What torquers do besides what the controllers command; one for each torquer at most.
    resolvers
        What turns readings to the axes of gimbals: their names are readings as well.
    faults
        What fails. Of several on one part: a weak torquer is weak, then stuck, then dead; a sensor drifts, then loses
        samples, then is stuck, then dead.
    q, rate : (n,)
        Gimbal angles and their rates at t = 0, rad and rad/s; empty: all zero.
    Omega : (3,)
        Platform rate at t = 0 (stabilised alone), rad/s.
    attitude : (4,)
        Unit quaternion w, x, y, z of the platform at t = 0, dimensionless.
    spin : (servo rotors,)
        Spins against the carriers at t = 0, rad/s; None: the nominal ones of `platform`.
    start
        ``"rest"``: the torquers give what the controllers command alone. ``"equilibrium"``: from before t = 0 on a
        constant torque of each torquer holds springs, weight and erection at the initial angles, as that of a motor
        whose loop has settled; the controllers' commands add to it, and it counts against the limits.
    seed, run
        What the noise is drawn from.
    settle
        Time before the mean and the rms of rates and line of sight begin, s.
    limits
        As in `platform_ctrl.job.job.Manoeuvre`.
    """

    platform: Platform
    mode: Mode
    duration: float
    delay: float
    profile: HalfCosine | None = None
    Omega_table: TimeTable | None = None
    torque: FloatArray = field(default_factory=lambda: read_only((0.0, 0.0, 0.0)))
    torque_table: TimeTable | None = None
    vibrations: tuple[Vibration, ...] = ()
    sines: tuple[Sine, ...] = ()
    gimbal_torques: tuple[tuple[str, FloatArray], ...] = ()
    commands: tuple[Command, ...] = ()
    filters: dict[str, float] = field(default_factory=dict)
    drives: tuple[DriveLaw, ...] = ()
    resolvers: tuple[Resolver, ...] = ()
    faults: tuple[Fault, ...] = ()
    q: FloatArray = field(default_factory=lambda: read_only(()))
    rate: FloatArray = field(default_factory=lambda: read_only(()))
    Omega: FloatArray = field(default_factory=lambda: read_only((0.0, 0.0, 0.0)))
    attitude: FloatArray = field(default_factory=lambda: read_only((1.0, 0.0, 0.0, 0.0)))
    spin: FloatArray | None = None
    start: Start = "rest"
    seed: int = 0
    run: int = 0
    settle: float = 0.0
    fade: float = 0.0
    limits: dict[str, float] = field(default_factory=dict)

    @property
    def units(self) -> dict[str, str]:
        """Units of all readings by their names: sensors in the plant's order, then resolved ones."""
        return reading_units(self.platform, self.resolvers)

    @property
    def longest_step(self) -> float:
        """The longest substep, s, that follows what shakes the base."""
        fastest = [one.frequency_hz for one in self.sines] + [one.frequencies_hz[-1] for one in self.vibrations]
        return 1.0 / (_STEPS_TO_A_PERIOD * max(fastest)) if fastest else math.inf

    def __post_init__(self) -> None:
        """Fill in the angles and rates that were left out."""
        n = len(self.platform.gimbals)
        for name in ("q", "rate", "torque", "Omega", "attitude", "spin"):
            if getattr(self, name) is not None:
                given = getattr(self, name)
                left_out = name in ("q", "rate") and not given.size
                object.__setattr__(self, name, read_only(np.zeros(n) if left_out else given))
        if self.start == "equilibrium" and self.platform.compliances:
            f = specific_force_at(self.platform, attitude=self.attitude)
            object.__setattr__(self, "q", read_only(twisted(self.platform, self.q, f)))
