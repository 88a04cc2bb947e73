"""A simulated run as the job file says it. SI units."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import field
from pathlib import Path
from typing import Annotated, Any, get_args

import numpy as np

from platform_ctrl.analysis.logs import column_unit, read_density
from platform_ctrl.analysis.metrics import RUN_METRICS
from platform_ctrl.common.values import FloatArray, input_value, read_only
from platform_ctrl.errors import InputError
from platform_ctrl.job.budget import too_large
from platform_ctrl.job.scenario import COMMANDS, Command, Mode, Sine, Start, TimeTable, Vibration
from platform_ctrl.plant import fields
from platform_ctrl.plant.drives import ROOT_TORQUE_NAMES
from platform_ctrl.plant.mistakes import Misfit, given, missing, of_length, useless, within, wrong
from platform_ctrl.plant.platform import OMEGA_NAMES
from platform_ctrl.plant.tables import Array, Key, Shape, record_value

MOST_VIBRATIONS, MOST_SINES, MOST_COMMANDS, MOST_TORQUES = 20, 100, 100, 20
_LIMITS = Shape(dict, {name: Key(fields.POSITIVE, name) for name in RUN_METRICS})
_INITIAL = Shape(dict, {}, others=("", fields.NUMBER))


def _time_table(columns: tuple[str, ...]) -> Shape:
    """Return the shape of a table of times and columns, any of which may be left out: zero."""

    def made(t: tuple[float, ...], smooth: bool = False, **given: tuple[float, ...]) -> TimeTable:
        values = np.array([given.get(column, (0.0,) * len(t)) for column in columns]).T
        return TimeTable(t=np.array(t), values=values, smooth=smooth)

    keys = {"t": Key(fields.TIMES, "t", needed=True)} | {column: Key(fields.NUMBERS, column) for column in columns}

    def back(table: TimeTable) -> dict[str, Any]:
        values = dict(zip(columns, table.values.T.tolist(), strict=True))
        return {"t": table.t.tolist(), **values, "smooth": table.smooth}

    def misfits(table: Mapping[str, Any]) -> Iterator[Misfit]:
        if not set(columns) & table.keys():
            first, second, third = columns
            yield missing(first, f"the table needs {first}, {second} or {third} beside the times")
        for column in columns:
            yield from of_length(table, column, "t")
            if columns is OMEGA_NAMES:
                yield from too_large(column, table.get(column, 0.0), "base-rate")

    return Shape(made, keys | {"smooth": Key(fields.TRUTH, "smooth")}, back=back, misfits=misfits)


# The keys that make a motion of each mode: all of them or none; and the table that adds to it or replaces it.
MOTION = {"caged": ("rate", "rise", "hold"), "stabilised": ("torque",)}
_MOTION_TABLE = {"caged": "Omega_table", "stabilised": "torque_table"}
# What may happen to a platform that is not moved: one of these is enough of a manoeuvre.
_EVENTS = ("vibration", "sine", "gimbal_torque", "command", "faults", "initial")


def _motion(table: Mapping[str, Any]) -> Iterator[Misfit]:
    """Yield what is wrong with the motion of a manoeuvre."""
    mode = table["mode"]
    keys, instead = MOTION[mode], _MOTION_TABLE[mode]
    needed = f"a {mode} manoeuvre needs {', '.join(keys)} and axis, or {instead}"
    if set(keys) & table.keys():
        yield from (missing(key, needed) for key in (*keys, "axis") if key not in table)
    elif not any(table.get(key) for key in (instead, *_EVENTS)):
        yield missing(keys[0], needed)
    for other in MOTION:
        for key in (*MOTION[other], _MOTION_TABLE[other]):
            if other != mode and key in table:
                words = f"{key} = {given(table[key])} is for a {other} manoeuvre"
                yield key, f"{words}; leave it out with mode = {given(mode)}"
    yield from too_large("rate", table.get("rate", 0.0), "base-rate")
    least = 2 * table.get("rise", 0.0) + table.get("hold", 0.0)
    if table["duration"] < least * (1 - fields.ROUNDING):
        yield wrong(table, "duration", f"at least 2 rise + hold, {least:.6g} s")


# The keys that make a torque on a gimbal: each with the keys that it needs, and those that it may have.
GIMBAL_TORQUES: dict[str, tuple[tuple[str, ...], tuple[str, ...]]] = {
    "psd": ((), ()),
    "densities": (("frequencies_hz",), ()),
    "amplitude": (("frequency_hz",), ("phase",)),
    "value": (("t",), ()),
    "log": (("column",), ("time",)),
}


@record_value
class GimbalTorque:
    """A torque from outside on a gimbal, as of wind, against its parent: random, a sine, or a course over time.

    It excites modes as the first torquer on the gimbal does.

    Attributes
    ----------
    gimbal
        Name of the gimbal.
    frequencies_hz, densities : (k,)
        As of a vibration, Hz and (N m)²/Hz.
    psd
        Path of a CSV file with a header whose first two columns are frequencies, Hz, and densities.
    frequency_hz, amplitude, phase
        amplitude sin(2π frequency_hz t + phase); Hz, N m, rad.
    t, value : (k,)
        A table over time, s and N m: straight lines between the points; before the first and after the last it stays.
    log, column, time
        Path of a recorded CSV log that is played from t = 0 on, and the names of its columns: N m, unless the name of
        the column states another unit, and s.
    """

    gimbal: fields.Text
    psd: fields.Text | None = None
    frequencies_hz: fields.Frequencies = field(default_factory=lambda: read_only(()))
    densities: fields.Densities = field(default_factory=lambda: read_only(()))
    frequency_hz: Annotated[float, fields.FREQUENCY] = 0.0
    amplitude: fields.NotZero = 0.0
    phase: fields.Number = 0.0
    t: Annotated[tuple[float, ...], fields.TIMES] = ()
    value: fields.Numbers = ()
    log: fields.Text | None = None
    column: fields.Text | None = None
    time: fields.Text = "time"

    @staticmethod
    def _misfits(table: Mapping[str, Any]) -> Iterator[Misfit]:
        made = [key for key in GIMBAL_TORQUES if key in table]
        if len(made) != 1:
            yield (), f"give exactly one of {', '.join(GIMBAL_TORQUES)}, got {' and '.join(made) or 'none of them'}"
            return
        needed, possible = GIMBAL_TORQUES[made[0]]
        yield from (missing(key, f"{made[0]} has no effect without it") for key in needed if key not in table)
        for key in sorted(table.keys() - {"gimbal", made[0], *needed, *possible}):
            yield useless(table, key, f"with {made[0]}; leave it out")
        yield from of_length(table, "densities", "frequencies_hz")
        yield from of_length(table, "value", "t")

    def read(self, folder: Path) -> GimbalTorque:
        """Return the same with the numbers of its file in place of the file's path, which starts at `folder`."""
        if self.psd is not None:
            f, densities = read_density(folder / self.psd)
            return GimbalTorque(gimbal=self.gimbal, frequencies_hz=f, densities=densities)
        if self.log is None:
            return self
        unit = column_unit(str(self.column))[1]
        if unit is not None and unit.quantity == "rate":
            raise InputError(f"column {given(self.column)} is in {unit.name} by its name; name a column of a torque")
        table = TimeTable.from_log(folder / self.log, (self.column, None, None), time=self.time)
        return GimbalTorque(gimbal=self.gimbal, t=tuple(table.t.tolist()), value=tuple(table.values[:, 0].tolist()))

    @property
    def course(self) -> tuple[tuple[str, FloatArray], ...]:
        """Its table, as a scenario has it."""
        return ((self.gimbal, np.array([self.t, self.value]).T),) if self.t else ()

    @property
    def random(self) -> tuple[Vibration, ...]:
        """What is random of it."""
        f, densities = self.frequencies_hz, self.densities
        if not densities.size:
            return ()
        return (Vibration(kind="torque", gimbal=self.gimbal, frequencies_hz=f, densities=densities),)

    @property
    def sine(self) -> tuple[Sine, ...]:
        """What is a sine of it."""
        f, a, phase = self.frequency_hz, self.amplitude, self.phase
        return (Sine(kind="torque", gimbal=self.gimbal, frequency_hz=f, amplitude=a, phase=phase),) if a else ()


@input_value
class Manoeuvre:
    """A run of the non-linear plant.

    Attributes
    ----------
    name, mode
        ``"caged"``: Omega is prescribed; ``"stabilised"``: the platform is free and a torque acts on it.
    axis
        Root axis of the rate or torque, 1 to 3.
    duration
        Length of the run, s.
    rate, rise, hold
        Caged: half-cosine rise to `rate` rad/s in `rise` s, held for `hold` s, and back in `rise` s; no rate: none.
    torque
        Stabilised: step of the torque on the platform at t = 0, N m.
    Omega_table, torque_table
        Caged: a platform rate, stabilised: a torque on the platform, over time; it adds to the above.
    vibrations, sines
        Of the base.
    gimbal_torques
        From outside, as of wind.
    commands
        What loops hold their readings at.
    faults
        Names of the faults that happen in it.
    initial
        What does not start at zero: angles and angle + ``_rate``, rad and rad/s; stabilised: Omega1 to Omega3.
    start
        ``"rest"``, or ``"equilibrium"``: from t = 0 on constant torques hold springs, unbalance and erection at the
        initial angles.
    settle
        Time after which means and rms are taken, s.
    fade
        Time over which vibrations and sines rise from zero, s; 0: they begin with a step of the base's rate.
    limits
        By the keys and in the units of `platform_ctrl.analysis.metrics.RUN_METRICS`.
    """

    name: fields.Text
    mode: Annotated[Mode, fields.one_of(get_args(Mode))]
    axis: fields.RootAxis = 1
    duration: fields.Positive
    rate: fields.NotZero = 0.0
    rise: fields.Positive = 0.0
    hold: fields.NotNegative = 0.0
    torque: fields.NotZero = 0.0
    Omega_table: Annotated[TimeTable | None, _time_table(OMEGA_NAMES)] = None
    torque_table: Annotated[TimeTable | None, _time_table(ROOT_TORQUE_NAMES)] = None
    vibrations: Annotated[tuple[Vibration, ...], Array("vibration", most=MOST_VIBRATIONS)] = ()
    sines: Annotated[tuple[Sine, ...], Array("sine", most=MOST_SINES)] = ()
    gimbal_torques: Annotated[tuple[GimbalTorque, ...], Array("gimbal_torque", most=MOST_TORQUES)] = ()
    commands: Annotated[tuple[Command, ...], Array("command", most=MOST_COMMANDS)] = ()
    faults: fields.Names = ()
    initial: Annotated[dict[str, float], _INITIAL] = field(default_factory=dict)
    start: Annotated[Start, fields.one_of(get_args(Start))] = "rest"
    settle: fields.NotNegative = 0.0
    fade: fields.NotNegative = 0.0
    limits: Annotated[dict[str, float], _LIMITS] = field(default_factory=dict)

    @staticmethod
    def _misfits(table: Mapping[str, Any]) -> Iterator[Misfit]:
        yield from _motion(table)
        for key in ("settle", "fade"):
            if table.get(key, 0.0) >= table["duration"]:
                yield wrong(table, key, f"less than duration, {table['duration']:.6g} s")
        rising = any({"psd", "densities", "amplitude"} & one.keys() for one in table.get("gimbal_torque", ()))
        if table.get("fade") and not (table.get("vibration") or table.get("sine") or rising):
            words = "fade is the time over which a vibration or a sine rises, and this manoeuvre has neither"
            yield "fade", f"{words}: leave it out"
        for key in ("vibration", "sine"):
            for k, one in enumerate(table.get(key, ())):
                if one["kind"] == "rate" and table["mode"] == "stabilised":
                    words = 'kind must be "force" with mode = "stabilised", got "rate"'
                    yield (key, k, "kind"), f"{words}: only a caged platform has a prescribed rate"
        for k, command in enumerate(table.get("command", ())):
            if not COMMANDS.keys() & command.keys():
                needed = "a command needs step, ramp, amplitude with frequency_hz, or value with t"
                yield from within(("command", k), [missing("step", needed)])
            if command.get("at", 0.0) >= table["duration"]:
                words = f"at must be before the end of the run, {table['duration']:.6g} s, got {given(command['at'])}"
                yield ("command", k, "at"), words
        if "attenuation_db" in table.get("limits", {}) and table["mode"] == "stabilised":
            words = "attenuation_db is for a caged manoeuvre, whose base moves as prescribed; leave it out"
            yield ("limits", "attenuation_db"), words
