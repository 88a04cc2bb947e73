"""Linear systems in files: JSON as in result.json, with units, delay and a note, and MATLAB data.

A system in a MAT file is a struct of A, B, C, D, Ts and names, as MATLAB's and Octave's ``ss`` take them.
"""

from __future__ import annotations

import io
import os
import re
from collections.abc import Mapping, Sequence
from importlib import import_module
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from platform_ctrl.analysis.interconnection import COMMAND
from platform_ctrl.analysis.system import StateSpace, System
from platform_ctrl.common.arguments import positive, short
from platform_ctrl.common.files import write_json, write_whole
from platform_ctrl.common.text import unused
from platform_ctrl.errors import ArgumentError, InputError
from platform_ctrl.plant import fields
from platform_ctrl.plant.drives import ROOT_TORQUE_NAMES
from platform_ctrl.plant.mistakes import one_line
from platform_ctrl.plant.platform import FORCE_NAMES, OMEGA_NAMES, Platform
from platform_ctrl.plant.sensors import gimbal_rate
from platform_ctrl.plant.source import MOST_OF_ANY, path_of, read_json
from platform_ctrl.verification.result_file import MOST_STATES, SCHEMA, JSONTable


class ExportedSystem(NamedTuple):
    """A linear system, the time by which its outputs act later than by its matrices, s, and what it is, in a line."""

    system: StateSpace
    delay: float = 0.0
    note: str = ""


def signal_units(platform: Platform, readings: Mapping[str, str]) -> dict[str, str]:
    """Return the units of everything that a plant's signals can be, by name, and those of further `readings`."""
    readings = {sensor.name: sensor.unit for sensor in platform.sensors} | dict(readings)
    units = dict.fromkeys(platform.angle_names, "rad")
    units |= dict.fromkeys([*map(gimbal_rate, platform.angle_names), *OMEGA_NAMES], "rad/s")
    units |= {f"{name}{COMMAND}": unit for name, unit in readings.items()}
    units |= readings | dict.fromkeys(FORCE_NAMES, "m/s^2")
    return units | dict.fromkeys(ROOT_TORQUE_NAMES, "N m") | {t.name: t.unit for t in platform.torquers}


def write_entries(systems: Sequence[ExportedSystem], path: str | os.PathLike[str], units: Mapping[str, str]) -> Path:
    """Write systems as JSON, with the units of their signals."""
    return write_json({"schema": SCHEMA, "systems": [_entry(one, units) for one in systems]}, path)


def _entry(one: ExportedSystem, units: Mapping[str, str]) -> dict[str, Any]:
    """Return a system in plain types."""
    *matrices, dt = System.of(one.system, "systems")
    if max(*matrices[0].shape, *matrices[3].shape) > MOST_STATES:
        raise ArgumentError(f"systems: {one.system.name!r} has more than {MOST_STATES} states or signals")
    inputs, outputs = list(one.system.input_labels), list(one.system.output_labels)
    return {
        "name": str(one.system.name),
        "note": one.note,
        "dt": dt,
        "delay": one.delay,
        "inputs": inputs,
        "input_units": [units.get(name, "") for name in inputs],
        "outputs": outputs,
        "output_units": [units.get(name, "") for name in outputs],
        "states": list(one.system.state_labels),
        **dict(zip("ABCD", matrices, strict=True)),
    }


def write_systems(
    systems: Sequence[StateSpace], path: str | os.PathLike[str], *, platform: Platform | None = None
) -> Path:
    """Write systems as JSON, whole or not at all.

    Parameters
    ----------
    systems
        Continuous or sampled, with names.
    path
        Of the file; its folder is there.
    platform
        Whose signals these are: they get their units.

    Returns
    -------
    Path
        Of the file.

    Raises
    ------
    ArgumentError
        One is no state space, is not finite, or has more than 1000 states or signals.
    InputError
        The file cannot be written there.
    """
    if not isinstance(systems, list | tuple):
        raise ArgumentError(f"write_systems: systems must be a list of control.StateSpace, got {short(systems)}")
    units = {} if platform is None else signal_units(platform, {})
    return write_entries([ExportedSystem(one) for one in systems], path, units)


def write_controllers(controllers: Sequence[StateSpace], path: str | os.PathLike[str], *, delay: float) -> Path:
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
        Of the file, for ``--controllers``.

    Raises
    ------
    ArgumentError
        One is no state space, or `delay` is negative.
    InputError
        The file cannot be written there.
    """
    late = positive("write_controllers: delay", delay, zero=True)
    keys = ("name", "dt", "delay", "inputs", "outputs", *"ABCD")
    entries = [{key: _entry(ExportedSystem(K, late), {})[key] for key in keys} for K in controllers]
    return write_json({"schema": SCHEMA, "controllers": entries}, path)


def read_systems(path: str | os.PathLike[str]) -> list[StateSpace]:
    """Read systems from JSON: a file of `write_systems`, a ``result.json``, or one with its controllers alone.

    Parameters
    ----------
    path
        Of the file, at most 64 MiB.

    Returns
    -------
    list of control.StateSpace
        In the file's order, with their names; units, delay and note stay in the file.

    Raises
    ------
    InputError
        The file, the system and the key, what is wrong, and what it must be, in one line.
    """
    table = JSONTable(*read_json(path_of(path, "the path of a JSON file"), "a JSON file with systems or controllers"))
    table.value("schema", fields.SCHEMA)
    key = "systems" if "systems" in table.data else "controllers"
    return [system_of(one) for one in table.tables(key, "systems")]


_PERIOD = fields.Expected("a finite number >= 0, s", fields.where(lambda dt: dt >= 0.0, fields.finite))


def system_of(table: JSONTable) -> StateSpace:
    """Return the system that a table of a file describes: ``A`` to ``D`` are lists of rows."""
    inputs, outputs = table.names("inputs"), table.names("outputs")
    arrays = table.arrays(len(inputs), len(outputs), table.value("dt", _PERIOD))
    states = table.names("states") if table.data.get("states") else None
    if states is not None and len(states) != len(arrays.A):
        raise InputError(f"{table.where}: states: has {len(states)} names, but A has {len(arrays.A)} rows")
    return arrays.to_control(inputs, outputs, states, name=table.value("name", fields.TEXT))


# The text at the head of the file, in place of the date that would make every file another one.
_HEAD = b"MATLAB 5.0 MAT-file, written by platform_ctrl".ljust(116)
_LONGEST = 63  # MATLAB's namelengthmax
_NAMES = {"inputs": "InputName", "outputs": "OutputName", "states": "StateName"}
_READABLE = "structs of A, B, C, D, Ts, InputName, OutputName and StateName, with -v7"


def write_mat(systems: Sequence[StateSpace], path: str | os.PathLike[str]) -> Path:
    """Write systems as a MATLAB 5 file, whole or not at all.

    Every system is a struct with ``A``, ``B``, ``C``, ``D``, ``Ts``, ``InputName``, ``OutputName`` and ``StateName``,
    named as the system as far as MATLAB allows.

    Parameters
    ----------
    systems
        Continuous or sampled, with names.
    path
        Of the file; its folder is there.

    Returns
    -------
    Path
        Of the file.

    Raises
    ------
    ArgumentError
        One is no state space, or is not finite.
    InputError
        The file cannot be written there.
    """
    structs: dict[str, dict[str, Any]] = {}
    for one in systems:
        plain = re.sub(r"[^A-Za-z0-9]+", "_", str(one.name)).strip("_") or "system"
        name = unused((plain if plain[0].isalpha() else f"s_{plain}")[: _LONGEST - 5], structs)
        labels = {"InputName": one.input_labels, "OutputName": one.output_labels, "StateName": one.state_labels}
        matrices = dict(zip(("A", "B", "C", "D", "Ts"), System.of(one, "write_mat"), strict=True))
        structs[name] = matrices | {key: np.array([names], dtype=object).T for key, names in labels.items()}
    content = io.BytesIO()
    import_module("scipy.io").savemat(content, structs)
    return write_whole(path, _HEAD + content.getvalue()[len(_HEAD) :])


def read_mat(path: str | os.PathLike[str]) -> list[StateSpace]:
    """Read systems from a MATLAB file: every struct with ``A``, ``B``, ``C`` and ``D``.

    Parameters
    ----------
    path
        Of the file of `write_mat`, or of MATLAB's or Octave's ``save -v7``, at most 64 MiB. SciPy reads it: take files
        from sources that you trust.

    Returns
    -------
    list of control.StateSpace
        In the file's order; what has no names gets u1, y1, x0 and so on, what has no ``Ts`` is continuous.

    Raises
    ------
    InputError
        The file cannot be read, holds no such struct, or a struct holds something else too.
    """
    file = path_of(path, "the path of a MAT file")
    label = one_line(str(file))
    try:
        if file.stat().st_size > MOST_OF_ANY:
            raise ValueError(f"it is larger than {MOST_OF_ANY // 2**20} MiB")
        variables = import_module("scipy.io").loadmat(str(file), appendmat=False)
    except Exception as error:  # of broken bytes scipy raises whatever came up
        raise InputError(f"{label}: cannot be read: {one_line(str(error))[:200]}; save {_READABLE}") from None
    structs = {name: item for name, item in variables.items() if getattr(item, "dtype", np.dtype(float)).names}
    found = [_system(f"{label}: {one_line(name)}", name, item) for name, item in structs.items()]
    if not found:
        raise InputError(f"{label}: holds no structs; save {_READABLE}")
    return found


def _system(where: str, name: str, item: np.ndarray[Any, Any]) -> StateSpace:
    fields = {key: item.ravel()[0][key] for key in item.dtype.names or ()} if item.size == 1 else {}
    texts = {key: fields.pop(field, np.zeros(0)) for key, field in _NAMES.items()}
    period = fields.pop("Ts", np.zeros((1, 1)))
    if (
        set(fields) - {*"ABCD"}
        or period.size != 1
        or any(one.size and one.dtype.kind not in "OU" for one in texts.values())
    ):
        raise InputError(f"{where}: is not one plain linear system; save {_READABLE}")
    names = {key: [str(np.squeeze(text)) for text in cell.ravel()] for key, cell in texts.items()}
    shape = np.shape(fields.get("D", np.zeros(0)))
    for key, letter, count in zip(("outputs", "inputs"), "yu", shape, strict=False):
        names[key] = names[key] or [f"{letter}{k + 1}" for k in range(count)]
    matrices = {key: item.tolist() for key, item in fields.items()}
    return system_of(JSONTable(where, {**matrices, **names, "name": name, "dt": period.item()}))
