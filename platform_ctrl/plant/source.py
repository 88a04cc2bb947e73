"""Where the text comes from: a shipped model, a file, or a dict."""

from __future__ import annotations

import contextlib
import json
import os
import shlex
import tomllib
from collections.abc import Mapping
from dataclasses import dataclass
from importlib import resources
from importlib.resources.abc import Traversable
from pathlib import Path
from typing import Any

from platform_ctrl.common.arguments import nearest
from platform_ctrl.errors import InputError
from platform_ctrl.plant.mistakes import Mistake, given, one_line, plain, suggestion

# Bytes of a file at most; TOML takes seconds to read and to judge where it has more.
MOST_OF_ANY, MOST_OF_TOML = 64 * 2**20, 2**20


@dataclass(frozen=True)
class InputData:
    """An input in plain types, what it is called in messages, and the folder that its paths start from."""

    label: str
    data: dict[str, Any]
    mistakes: list[Mistake]
    folder: Path


def shipped_models() -> tuple[str, ...]:
    """Return the names of the plants that come with the package, sorted.

    Returns
    -------
    tuple of str
        What `read_platform` takes as names.
    """
    return tuple(sorted(_shipped_files()))


def platform_source(name: str) -> str:
    """Return the TOML text of a shipped plant: what to copy in order to describe another one.

    Parameters
    ----------
    name
        Of a shipped model.

    Returns
    -------
    str
        TOML, comments included.

    Raises
    ------
    InputError
        There is no shipped model of that name.
    """
    if not isinstance(name, str):
        raise InputError(f"the name of a shipped model must be a string, got {given(name)}")
    files = _shipped_files()
    if name not in files:
        hint = f'; a file of that name is read as "./{name}"' if os.path.isfile(name) else ""
        raise InputError(f"there is no shipped model {given(name)}; {suggestion(name, sorted(files))}{hint}")
    return files[name].read_text(encoding="utf-8")


def example_source(name: str) -> str:
    """Return the text of a file of the folder examples, which an installed package has inside."""
    return (_folder("examples") / f"{name}.toml").read_text(encoding="utf-8")


def is_shipped_name(source: str) -> bool:
    """Return whether `source` is meant as a shipped name: no suffix and no path separator."""
    separators = {"/", os.sep, os.altsep or os.sep}
    return not any(separator in source for separator in separators) and not Path(source).suffix


def open_shipped(name: str) -> InputData:
    """Return a shipped plant."""
    return _document(f"shipped model {name}", platform_source(name), Path())


def open_file(path: Path) -> InputData:
    """Return the file at `path`."""
    label, text = one_line(str(path)), read_text(path, "a TOML file (platform-ctrl new writes one)", MOST_OF_TOML)
    if text.lstrip().startswith("<"):  # as no TOML
        made = shlex.join(["platform-ctrl", "import", label, "-o", "plant.toml"])
        raise InputError(f"{label}: is XML; a robot description (URDF, MJCF, SDF) becomes a plant file by {made}")
    return _document(label, text, path.parent)


def read_text(path: Path, expected: str, most: int = MOST_OF_ANY) -> str:
    """Return the text of the file at `path`, which should be `expected` of at most `most` bytes."""
    label = one_line(str(path))
    try:
        with path.open("rb") as file:  # or a device, which may never end
            data = file.read(most + 1)
        if len(data) > most:
            raise InputError(f"{label}: is larger than {most // 2**20} MiB; give {expected} of at most that")
        # utf-8-sig: some editors put a byte order mark at the head, which neither TOML nor JSON knows.
        return data.decode("utf-8-sig")
    except FileNotFoundError:
        raise InputError(f"{label}: there is no such file; {_meant(path) or f'give {expected}'}") from None
    except IsADirectoryError:
        raise InputError(f"{label}: is a directory; give {expected}") from None
    except UnicodeDecodeError as error:
        raise InputError(f"{label}: is not UTF-8 text (byte {error.start}); give {expected}") from None
    except OSError as error:
        raise InputError(f"{label}: cannot be read: {one_line(error.strerror or str(error))}") from None
    except InputError:
        raise
    except ValueError as error:  # a path that no file can have
        raise InputError(f"{label}: cannot be read: {one_line(str(error))}") from None


def _meant(path: Path) -> str:
    """Return the name of the file beside it that `path` was probably meant to be, as the end of a message."""
    with contextlib.suppress(OSError):
        stems = {one.stem: one.name for one in path.parent.iterdir() if one.suffix == path.suffix}
        close = nearest(path.stem, stems)
        return "" if close is None else f"did you mean {given(stems[close])}?"
    return ""


def read_json(path: str | os.PathLike[str], expected: str) -> tuple[str, object]:
    """Return a file's name for messages, and what it holds."""
    file = Path(path)
    label, text = one_line(str(file)), read_text(file, expected)
    try:
        return label, json.loads(text)
    except json.JSONDecodeError as error:
        where = f"(line {error.lineno}, column {error.colno})"
        raise InputError(f"{label}: is not JSON: {error.msg} {where}; give {expected}") from None
    except RecursionError:
        raise InputError(f"{label}: is not JSON that can be read: nested too deeply") from None
    except ValueError as error:  # more digits than Python reads
        raise InputError(f"{label}: cannot be read: {one_line(str(error))}") from None


def open_mapping(source: Mapping[str, Any], label: str, folder: Path) -> InputData:
    """Return a dict given in Python, in plain types."""
    data, mistakes = plain(source)
    return InputData(label, data, mistakes, folder)


def path_of(source: object, expected: str) -> Path:
    """Return the path that a caller gave."""
    if not isinstance(source, str | os.PathLike) or not os.fspath(source):
        raise InputError(f"the argument must be {expected}, got {given(source)}")
    return Path(os.fsdecode(source))


def _document(label: str, text: str, folder: Path) -> InputData:
    try:
        parsed = tomllib.loads(text)
    except tomllib.TOMLDecodeError as error:
        more = "; texts are in quotes" if str(error).startswith("Invalid value") else ""
        raise InputError(f"{label}: is not TOML: {one_line(str(error))}{more}") from None
    except ValueError:  # the digits of an integer are limited by Python itself
        raise InputError(f"{label}: is not TOML: an integer has too many digits") from None
    except RecursionError:
        raise InputError(f"{label}: is not TOML: arrays or tables are nested too deeply") from None
    return open_mapping(parsed, label, folder)


def _shipped_files() -> dict[str, Traversable]:
    return {
        file.name.removesuffix(".toml"): file for file in _folder("models").iterdir() if file.name.endswith(".toml")
    }


def _folder(name: str) -> Traversable:
    """Return a folder with files of the package: within it once it is installed, beside it in a checkout."""
    folder = resources.files("platform_ctrl") / name
    return folder if folder.is_dir() else Path(__file__).parents[2] / name
