"""Linear systems as files have them: state spaces with units, delay and a note; and as JSON, as in result.json."""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from platform_ctrl.analysis.arrays import StateArrays, named_system, state_arrays
from platform_ctrl.analysis.plant_set import COMMAND
from platform_ctrl.common.arguments import positive, short
from platform_ctrl.common.json_text import write_json
from platform_ctrl.common.values import FloatArray, value
from platform_ctrl.errors import ArgumentError, InputError
from platform_ctrl.plant.mistakes import given
from platform_ctrl.plant.platform import FORCE_NAMES, OMEGA_NAMES, ROOT_TORQUE_NAMES, Platform
from platform_ctrl.plant.sensors import gimbal_rate
from platform_ctrl.plant.source import path_of, read_json
from platform_ctrl.verification.result_file import SCHEMA, JSONTable

if TYPE_CHECKING:
    import control

# States and signals of a system: with as many its matrices have a million elements.
MOST = 1000
# Systems in a file.
MOST_SYSTEMS = 1000
_EXPECTED = "a JSON file with systems or controllers"
# Keys of an entry in a JSON file.
_KEYS = (
    "name", "note", "dt", "delay", "inputs", "input_units", "outputs", "output_units", "states", "A", "B", "C", "D",
)  # fmt: skip


@value
class SystemRecord:
    """A state space for other tools."""

    name: str  # What it is called
    # A, B, C, D: x' = A x + B u, y = C x + D u; sampled: x[k+1] = ... In the units of the signals. Shapes (n, n), (n,
    # m), (p, n), (p, m).
    A: FloatArray
    B: FloatArray
    C: FloatArray
    D: FloatArray
    dt: float  # Sample period, s; 0: continuous
    # inputs, outputs, states: Names
    inputs: tuple[str, ...]
    outputs: tuple[str, ...]
    states: tuple[str, ...]
    # input_units, output_units: Units of the signals, "" where none is known
    input_units: tuple[str, ...]
    output_units: tuple[str, ...]
    # Time by which the outputs act later than by the matrices, s: of a controller from sample to torque
    delay: float = 0.0
    note: str = ""  # What it is, in a line

    @property
    def state_space(self) -> control.StateSpace:
        """The system for python-control; its delay is not in it."""
        arrays = StateArrays(self.A, self.B, self.C, self.D, self.dt)
        return named_system(arrays, self.inputs, self.outputs, self.states, name=self.name)


def system_record(
    system: control.StateSpace,
    name: str | None = None,
    *,
    platform: Platform | None = None,
    delay: float = 0.0,
    note: str = "",
) -> SystemRecord:
    """Return a state space with names, units, delay and note for other tools.

    Parameters
    ----------
    system
        Continuous or sampled.
    name
        What it is called; default its own name.
    platform
        Whose signals these are: they get their units.
    delay
        Time by which the outputs act later than by the matrices, s.
    note
        What it is, in a line.

    Returns
    -------
    SystemRecord
        With the names of its signals and states.

    Raises
    ------
    ArgumentError
        It is no state space, is not finite, or has more than 1000 states or signals.
    """
    where = "system_record"
    A, B, C, D, dt = state_arrays(system, where)
    if max(*A.shape, *D.shape) > MOST:
        raise ArgumentError(
            f"{where}: has {len(A)} states, {D.shape[1]} inputs and {D.shape[0]} outputs; at most {MOST}"
        )
    units = {} if platform is None else signal_units(platform)
    inputs, outputs = tuple(map(str, system.input_labels)), tuple(map(str, system.output_labels))
    title = str(system.name) if name is None else name
    for kind, text in (("name", title), ("note", note)):
        if not isinstance(text, str) or not text.isprintable() or (kind == "name" and not text.strip()):
            raise ArgumentError(f"{where}: {kind} must be text in one line, got {short(text)}")
    return SystemRecord(
        name=title,
        A=A,
        B=B,
        C=C,
        D=D,
        dt=dt,
        delay=positive(f"{where}: delay", delay, zero=True),
        inputs=inputs,
        outputs=outputs,
        states=tuple(map(str, system.state_labels)),
        input_units=tuple(units.get(one, "") for one in inputs),
        output_units=tuple(units.get(one, "") for one in outputs),
        note=note,
    )


def signal_units(platform: Platform) -> dict[str, str]:
    """Return the units of everything that a plant's signals can be, by name."""
    units = dict.fromkeys(platform.angle_names, "rad")
    units |= dict.fromkeys([*map(gimbal_rate, platform.angle_names), *OMEGA_NAMES], "rad/s")
    units |= {f"{sensor.name}{COMMAND}": sensor.unit for sensor in platform.sensors}
    units |= {sensor.name: sensor.unit for sensor in platform.sensors} | dict.fromkeys(FORCE_NAMES, "m/s^2")
    return units | dict.fromkeys([*(t.name for t in platform.torquers), *ROOT_TORQUE_NAMES], "N m")


def expect_systems(systems: Sequence[SystemRecord], where: str) -> None:
    """Check a list of systems."""
    if not isinstance(systems, list | tuple) or not all(isinstance(one, SystemRecord) for one in systems):
        raise ArgumentError(f"{where}: systems must be a list of SystemRecord, for example from system_record")
    if not 0 < len(systems) <= MOST_SYSTEMS:
        raise ArgumentError(f"{where}: there must be 1 to {MOST_SYSTEMS} systems, got {len(systems)}")


def write_systems(systems: Sequence[SystemRecord], path: str | os.PathLike[str]) -> Path:
    """Write systems as JSON, whole or not at all.

    Parameters
    ----------
    systems
        As from `system_record`, `controller_systems` or `model_systems`.
    path
        Of the file; its folder is there.

    Returns
    -------
    Path
        Of the file.

    Raises
    ------
    ArgumentError
        There are none, or more than 1000.
    InputError
        The file cannot be written there.
    """
    expect_systems(systems, "write_systems")
    return write_json(
        {"schema": SCHEMA, "systems": [{key: getattr(one, key) for key in _KEYS} for one in systems]}, path
    )


def write_controllers(controllers: Sequence[control.StateSpace], path: str | os.PathLike[str], *, delay: float) -> Path:
    """Write controllers as ``check``, ``simulate`` and ``campaign`` read them, whole or not at all.

    Parameters
    ----------
    controllers
        u = K y, sampled, in the order in which they are computed.
    path
        Of the file; its folder is there.
    delay
        From the sample to the torque, s.

    Returns
    -------
    Path
        Of the file: ``read_controllers`` of `platform_ctrl.verification` reads it.

    Raises
    ------
    ArgumentError
        There are none, one is no state space, or `delay` is negative.
    InputError
        The file cannot be written there.
    """
    systems = [system_record(K, delay=delay) for K in controllers]
    expect_systems(systems, "write_controllers")
    keys = ("name", "dt", "A", "B", "C", "D", "inputs", "outputs", "delay")
    entries = [{key: getattr(one, key) for key in keys} for one in systems]
    return write_json({"schema": SCHEMA, "controllers": entries}, path)


def read_systems(path: str | os.PathLike[str]) -> tuple[SystemRecord, ...]:
    """Read systems from JSON: a file of `write_systems`, a ``result.json``, or one with its controllers alone.

    Parameters
    ----------
    path
        Of the file, at most 64 MiB.

    Returns
    -------
    tuple of SystemRecord
        In the file's order.

    Raises
    ------
    InputError
        The file, the system and the key, what is wrong, and what it must be, in one line.
    """
    label, data = read_json(path_of(path, "the path of a JSON file"), _EXPECTED)
    if not isinstance(data, Mapping):
        raise InputError(f"{label}: must be {_EXPECTED}, got {given(data)}")
    schema = data.get("schema")
    if isinstance(schema, bool) or schema != SCHEMA:
        raise InputError(f'{label}: "schema" is {given(schema)}, but this version reads {SCHEMA}')
    key = "systems" if "systems" in data else "controllers"
    entries = data.get(key)
    if not isinstance(entries, list) or not 0 < len(entries) <= MOST_SYSTEMS:
        raise InputError(f'{label}: "{key}" must be a list of 1 to {MOST_SYSTEMS} systems, got {given(entries)}')
    return tuple(system_of(f"{label}: {key} {number}", entry) for number, entry in enumerate(entries, 1))


def system_of(where: str, data: object) -> SystemRecord:
    """Return the system that a file describes; `where` is the file and the entry, for messages.

    ``A`` to ``D`` are lists of rows; ``delay``, names of states, units and ``note`` may be missing.
    """
    table = JSONTable(where, data)
    inputs, outputs = table.names("inputs"), table.names("outputs")
    arrays = table.arrays(len(inputs), len(outputs), table.number("dt", "a finite number >= 0, s", least=0.0))
    states = table.names("states") if table.data.get("states") else tuple(f"x{k + 1}" for k in range(len(arrays.A)))
    if len(states) != len(arrays.A):
        raise table.mistake(f"states: has {len(states)} names, but A has {len(arrays.A)} rows")
    units = {key: tuple(map(str, table.data.get(key) or ())) for key in ("input_units", "output_units")}
    return SystemRecord(
        A=arrays.A,
        B=arrays.B,
        C=arrays.C,
        D=arrays.D,
        dt=arrays.dt,
        name=table.text("name", "a name"),
        delay=table.number("delay", "a finite number >= 0, s", least=0.0) if "delay" in table.data else 0.0,
        inputs=inputs,
        outputs=outputs,
        states=states,
        input_units=units["input_units"] or ("",) * len(inputs),
        output_units=units["output_units"] or ("",) * len(outputs),
        note=table.text("note", "text in one line", empty=True) if "note" in table.data else "",
    )
