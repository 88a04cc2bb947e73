"""Systems as MATLAB data: a struct each of A, B, C, D, Ts and names, as MATLAB's and Octave's ``ss`` take them."""

from __future__ import annotations

import io
import os
import re
from collections.abc import Sequence
from importlib import import_module
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from platform_ctrl.analysis.system import System
from platform_ctrl.common.files import write_whole
from platform_ctrl.errors import InputError
from platform_ctrl.export.systems import system_of
from platform_ctrl.plant.mistakes import one_line
from platform_ctrl.plant.source import MOST_OF_ANY, path_of
from platform_ctrl.verification.result_file import JSONTable

if TYPE_CHECKING:
    import control

# The text at the head of the file, in place of the date that would make every file another one.
_HEAD = b"MATLAB 5.0 MAT-file, written by platform_ctrl".ljust(116)
_LONGEST = 63  # MATLAB's namelengthmax
_NAMES = {"inputs": "InputName", "outputs": "OutputName", "states": "StateName"}
_READABLE = "structs of A, B, C, D, Ts, InputName, OutputName and StateName, with -v7"


def write_mat(systems: Sequence[control.StateSpace], path: str | os.PathLike[str]) -> Path:
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
        name = plain = (plain if plain[0].isalpha() else f"s_{plain}")[: _LONGEST - 5]
        while name in structs:
            name = f"{plain}_{len(structs) + 1}"
        labels = {"InputName": one.input_labels, "OutputName": one.output_labels, "StateName": one.state_labels}
        matrices = dict(zip(("A", "B", "C", "D", "Ts"), System.of(one, "write_mat"), strict=True))
        structs[name] = matrices | {key: np.array([names], dtype=object).T for key, names in labels.items()}
    content = io.BytesIO()
    import_module("scipy.io").savemat(content, structs)
    return write_whole(path, _HEAD + content.getvalue()[len(_HEAD) :])


def read_mat(path: str | os.PathLike[str]) -> list[control.StateSpace]:
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


def _system(where: str, name: str, item: np.ndarray[Any, Any]) -> control.StateSpace:
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
