"""Plant files: TOML or dict -> Platform."""

from __future__ import annotations

import dataclasses
import os
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from platform_ctrl.plant.checks import plant_mistakes, tree_mistakes
from platform_ctrl.plant.fields import SCHEMA
from platform_ctrl.plant.mistakes import Mistake, given, report
from platform_ctrl.plant.platform import Platform
from platform_ctrl.plant.source import Document, is_shipped_name, open_file, open_mapping, open_shipped, path_of
from platform_ctrl.plant.tables import Key, Shape, made, overfull, read_table, shape
from platform_ctrl.plant.writing import plant_data


def _file(kind: type[Platform]) -> Shape:
    """Return the shape of the whole file that a platform of this class is read from."""
    own = shape(kind)
    return dataclasses.replace(own, keys={"schema": Key(SCHEMA, "schema", needed=True)} | {**own.keys})


PLANT_FILE = _file(Platform)


def read_platform(source: str | os.PathLike[str] | Mapping[str, Any] | Platform) -> Platform:
    """Read a plant.

    Parameters
    ----------
    source
        The name of a shipped model (no suffix, no path separator), the path of a TOML file, or a dict of the
        same structure, in which tuples and NumPy arrays serve as vectors. A platform, such as one that was made in
        Python, is judged as a file is.

    Returns
    -------
    Platform
        In SI units; axes of unit length; every angular momentum in place of the spin.

    Raises
    ------
    InputError
        One line: which file, table and key, what was given, what is expected.

    Examples
    --------
    >>> import platform_ctrl as pc
    >>> platform = pc.read_platform("three_gyro_platform")
    >>> platform.angle_names
    ('alpha4', 'beta5', 'beta7', 'alpha9', 'beta10')
    """
    document = open_plant(source, Path())
    platform, mistakes = judge_plant(document, type(source) if isinstance(source, Platform) else Platform)
    if platform is None:
        raise report(document.label, document.data, mistakes)
    return platform


def open_plant(source: object, folder: Path) -> Document:
    """Return the document of a plant: a platform, a dict, a shipped model, or a file whose path starts in `folder`."""
    if isinstance(source, Platform):
        return open_mapping(plant_data(source), f"platform {given(source.name)}", folder)
    if isinstance(source, Mapping):
        return open_mapping(source, "plant given as a dict", folder)
    path = path_of(source, "the name of a shipped model, a path or a dict")
    if isinstance(source, str) and is_shipped_name(source):
        return open_shipped(source)
    return open_file(folder / path)


def judge_plant(document: Document, kind: type[Platform] = Platform) -> tuple[Platform | None, list[Mistake]]:
    """Return the platform, of class `kind`, that a document describes, or None and its mistakes."""
    if "root" not in document.data and {"plant", "loop"} <= set(document.data):
        its_plant = given(document.data["plant"])
        return None, [Mistake(("plant",), f"this is a job file; give its plant instead, {its_plant}")]
    data = _axis_by_axis(document.data)
    if crowd := list(overfull(_file(kind), data)):
        return None, crowd
    read, wrong = read_table(_file(kind), data)
    if mistakes := [*document.mistakes, *wrong]:
        return None, mistakes
    del read["schema"]
    parts = made(read)
    if mistakes := tree_mistakes(kind, parts):
        return None, mistakes
    platform = kind(**parts)
    mistakes = plant_mistakes(platform)
    return (None, mistakes) if mistakes else (platform, [])


def _axis_by_axis(data: Mapping[str, Any]) -> dict[str, Any]:
    """Return a plant whose sensors with ``axis = "all"`` are three each, about the axes of the body: name + 1, 2, 3."""
    out = dict(data)
    for kind in ("rate_sensor", "attitude_sensor"):
        tables = out.get(kind)
        if not isinstance(tables, list):
            continue
        first, others = [], []
        for table in tables:
            if not (isinstance(table, dict) and table.get("axis") == "all"):
                first.append(table)
                continue
            named = isinstance(table.get("name"), str)
            axes = ([1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0])
            three = [{**table, "axis": axis} for axis in axes]
            if named:
                three = [one | {"name": f"{table['name']}{k}"} for k, one in enumerate(three, 1)]
            # The others behind all tables of the file, so that a mistake is found in the table that has it.
            first.append(three[0])
            others += three[1:]
        out[kind] = [*first, *others]
    return out
