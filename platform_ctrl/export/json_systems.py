"""Controllers and models as JSON: the form of result.json's controllers, with units and the names of states."""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from platform_ctrl.common.json_text import write_json
from platform_ctrl.common.signatures import check_arguments
from platform_ctrl.errors import InputError
from platform_ctrl.export.system_records import MOST_SYSTEMS, SystemRecord, expect_systems, system_of, system_record
from platform_ctrl.plant.mistakes import given
from platform_ctrl.plant.source import path_of, read_json
from platform_ctrl.verification.records import SCHEMA

if TYPE_CHECKING:
    import control

_EXPECTED = "a JSON file with systems or controllers"


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
    return write_json({"schema": SCHEMA, "systems": [_entry(one) for one in systems]}, path)


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
    return tuple(_system(f"{label}: {key} {number}", entry) for number, entry in enumerate(entries, 1))


def _entry(one: SystemRecord) -> dict[str, Any]:
    first = ("name", "note", "dt", "delay", "inputs", "input_units", "outputs", "output_units", "states")
    return {key: getattr(one, key) for key in (*first, "A", "B", "C", "D")}


def _system(where: str, entry: object) -> SystemRecord:
    if not isinstance(entry, Mapping):
        raise InputError(f"{where}: must be a table with name, dt, A, B, C, D, ..., got {given(entry)}")
    return system_of(where, entry)
