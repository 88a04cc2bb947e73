"""Linear systems as files have them: state spaces with units, delay and a note; and as JSON, as in result.json."""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from platform_ctrl.analysis.arrays import StateArrays, named_system, state_arrays
from platform_ctrl.analysis.plant_set import COMMAND
from platform_ctrl.common.arguments import positive
from platform_ctrl.common.json_text import write_json
from platform_ctrl.common.signatures import check_arguments, short
from platform_ctrl.common.values import FloatArray, value
from platform_ctrl.errors import ArgumentError, InputError
from platform_ctrl.plant.fields import finite_number
from platform_ctrl.plant.mistakes import given, one_line
from platform_ctrl.plant.platform import FORCE_NAMES, OMEGA_NAMES, ROOT_TORQUE_NAMES, Platform
from platform_ctrl.plant.sensors import gimbal_rate
from platform_ctrl.plant.source import path_of, read_json
from platform_ctrl.verification.result_file import SCHEMA

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


@check_arguments
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
    if isinstance(systems, SystemRecord) or not all(isinstance(one, SystemRecord) for one in systems):
        raise ArgumentError(f"{where}: systems must be a list of SystemRecord, for example from system_record")
    if not 0 < len(systems) <= MOST_SYSTEMS:
        raise ArgumentError(f"{where}: there must be 1 to {MOST_SYSTEMS} systems, got {len(systems)}")


@check_arguments
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


@check_arguments
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
        In the file's order; what has no names gets u1, y1, x1 and so on.

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
    return tuple(_entry(f"{label}: {key} {number}", entry) for number, entry in enumerate(entries, 1))


def _entry(where: str, data: object) -> SystemRecord:
    if not isinstance(data, Mapping):
        raise InputError(f"{where}: must be a table with name, dt, A, B, C, D, ..., got {given(data)}")
    return system_of(where, data)


def system_of(where: str, data: Mapping[str, Any]) -> SystemRecord:
    """Return the system that a file describes; `where` is the file and the entry, for messages.

    ``A`` to ``D`` are arrays or lists of rows; ``delay``, names, units and ``note`` may be missing.
    """
    D = _rows(where, "D", data)
    A = _rows(where, "A", data)
    B, C = _rows(where, "B", data), _rows(where, "C", data)
    n = 0 if A.size == 0 else len(A)
    p = max(len(C) if C.size else 0, len(D) if D.size else 0)
    m = max(B.shape[1] if B.size else 0, D.shape[1] if D.size else 0)
    if max(n, m, p) > MOST:
        raise InputError(f"{where}: has {n} states, {m} inputs and {p} outputs; at most {MOST} of each are possible")
    shapes = {"A": (n, n), "B": (n, m), "C": (p, n), "D": (p, m)}
    arrays = {}
    for key, item in (("A", A), ("B", B), ("C", C), ("D", D)):
        wanted = shapes[key]
        if item.size == 0 and 0 in wanted:
            item = np.zeros(wanted)
        if item.shape != wanted:
            raise InputError(
                f"{where}: {key}: must be {wanted[0]} x {wanted[1]}, got {item.shape[0]} x {item.shape[1]}"
            )
        arrays[key] = item
    if not p or not m:
        raise InputError(f"{where}: has {m} inputs and {p} outputs; it needs at least one of each")
    dt, delay = (_time(where, key, data) for key in ("dt", "delay"))
    return SystemRecord(
        **arrays,
        name=_text(where, "name", data) or "system",
        dt=dt,
        delay=delay,
        inputs=_names(where, "inputs", data, m, "u"),
        outputs=_names(where, "outputs", data, p, "y"),
        states=_names(where, "states", data, n, "x"),
        input_units=_names(where, "input_units", data, m, None),
        output_units=_names(where, "output_units", data, p, None),
        note=_text(where, "note", data),
    )


def _rows(where: str, key: str, data: Mapping[str, Any]) -> FloatArray:
    """Return a matrix; one without elements has the shape (0, 0)."""
    item = data.get(key)
    if item is None:
        raise InputError(f'{where}: the matrix "{key}" is missing')
    if isinstance(item, np.ndarray):
        if item.dtype.kind not in "iufb" or item.ndim != 2:
            raise InputError(f"{where}: {key}: must be a matrix of real numbers")
        array = item.astype(np.float64)
    else:
        if not isinstance(item, list) or not all(isinstance(row, list) for row in item):
            raise InputError(f"{where}: {key}: must be a list of rows, got {given(item)}")
        widths = {len(row) for row in item}
        if len(widths) > 1 or max([len(item), *widths]) > MOST:
            raise InputError(
                f"{where}: {key}: has {len(item)} rows of {sorted(widths)[:3]} numbers; rows must have the same "
                f"length, at most {MOST} rows of at most {MOST} numbers"
            )
        numbers = [[finite_number(element) for element in row] for row in item]
        array = np.array([[np.nan if x is None else x for x in row] for row in numbers], dtype=np.float64)
    if array.size == 0:
        return np.zeros((0, 0))
    if not np.isfinite(array).all():
        i, j = np.argwhere(~np.isfinite(array))[0]
        raise InputError(f"{where}: {key}: element ({i + 1}, {j + 1}) must be a finite number")
    return array


def _time(where: str, key: str, data: Mapping[str, Any]) -> float:
    item = data.get(key, 0.0)
    number = finite_number(item)
    if number is None or number < 0.0:
        raise InputError(f"{where}: {key}: must be a finite number >= 0, s, got {given(item)}")
    return number


def _text(where: str, key: str, data: Mapping[str, Any]) -> str:
    item = data.get(key, "")
    if not isinstance(item, str) or not item.isprintable():
        raise InputError(f"{where}: {key}: must be text in one line, got {given(item)}")
    return item


def _names(where: str, key: str, data: Mapping[str, Any], count: int, default: str | None) -> tuple[str, ...]:
    """Return names of signals, each once; units (`default` None) may be alike, and are "" where there are none."""
    item = data.get(key) or []
    if not isinstance(item, Sequence) or isinstance(item, str) or not all(isinstance(name, str) for name in item):
        raise InputError(f"{where}: {key}: must be a list of names, got {given(item)}")
    if not any(item):
        return ("",) * count if default is None else tuple(f"{default}{k}" for k in range(1, count + 1))
    if len(item) != count:
        raise InputError(f"{where}: {key}: has {len(item)} names, but the matrices have {count} signals or states")
    for k, name in enumerate(item):
        if not name.isprintable() or (default is not None and (not name.strip() or name in item[:k])):
            wrong = f"name {k + 1} is {given(name)}"
            raise InputError(one_line(f"{where}: {key}: {wrong}; each name must be unique, in one line"))
    return tuple(item)
