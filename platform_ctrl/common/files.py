"""Files, written whole or not at all: first in a folder of a random name, where no link can wait; JSON, TOML.

JSON has plain types, a key a line and a row of a matrix a line, so that files can be read and compared.
"""

from __future__ import annotations

import json
import math
import os
import re
import shutil
import tempfile
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any

from platform_ctrl.errors import InputError

if TYPE_CHECKING:
    from jinja2 import Environment

UNFINISHED = ".unfinished-"
_BARE = re.compile(r"[A-Za-z0-9_-]+")  # a key of a TOML file without quotes


def write_whole(path: str | os.PathLike[str], content: str | bytes) -> Path:
    """Write `content`, text as UTF-8, to `path` and return it: the old file stays until the new one is complete."""
    target = Path(path)
    if target.exists() and not target.is_file():
        # A device or a pipe would be gone.
        raise InputError(f"{target}: cannot be written: it is no regular file; name a file, or a new path")
    try:
        with replaced_file(target) as file:
            file.write_bytes(content.encode() if isinstance(content, str) else content)
    except OSError as error:
        words = f"{target}: cannot be written: {error.strerror or error}"
        raise InputError(f"{words}; name a path in a folder that exists and is writable") from None
    return target


def templates(package: str, **options: bool) -> Environment:
    """Return the templates of a package; a word that is not given is an error."""
    from jinja2 import Environment, PackageLoader, StrictUndefined

    loader = PackageLoader(package)
    return Environment(loader=loader, undefined=StrictUndefined, trim_blocks=True, lstrip_blocks=True, **options)  # type: ignore[arg-type]


@contextmanager
def replaced_file(path: Path) -> Iterator[Path]:
    """Yield where to write a file that takes the place of `path` when it is complete."""
    # In the same folder, so that putting it in place is one step of the file system.
    with unfinished_folder(path.parent) as folder:
        yield folder / path.name
        os.replace(folder / path.name, path)


@contextmanager
def unfinished_folder(folder: Path) -> Iterator[Path]:
    """Yield a new folder inside `folder`, which is removed at the end; what killed processes left there goes."""
    remove_unfinished(folder)
    prefix = f"{UNFINISHED}{os.getpid()}-"
    with tempfile.TemporaryDirectory(prefix=prefix, dir=folder, ignore_cleanup_errors=True) as made:
        yield Path(made)


def remove_unfinished(folder: Path) -> None:
    """Remove what processes that have ended left unfinished in a folder."""
    for left in folder.glob(f"{UNFINISHED}*"):
        if not left.is_symlink() and not _runs(left.name.removeprefix(UNFINISHED).partition("-")[0]):
            shutil.rmtree(left, ignore_errors=True)


def _runs(number: str) -> bool:
    """Return whether a process of this number may still run."""
    if os.name != "posix" or not number.isdecimal():
        return os.name != "posix"
    try:
        os.kill(int(number), 0)
    except ProcessLookupError:
        return False
    except OSError:
        pass
    return True


def plain_types(item: Any) -> Any:
    """Return data in plain types; a number that is not finite is None."""
    if hasattr(item, "tolist"):  # of NumPy
        item = item.tolist()
    match item:
        case Mapping():
            return {str(key): plain_types(entry) for key, entry in item.items()}
        case list() | tuple():
            return [plain_types(entry) for entry in item]
        case float():
            return item if math.isfinite(item) else None
    return item


def json_text(item: Any) -> str:
    """Return data as JSON text; numbers that are not finite are null."""
    return _laid_out(plain_types(item), "")


def write_json(item: Any, path: str | os.PathLike[str]) -> Path:
    """Write data as a JSON file, whole or not at all."""
    return write_whole(path, json_text(item) + "\n")


def _laid_out(item: Any, indent: str) -> str:
    inner = indent + "  "
    if isinstance(item, dict) and item:
        lines = [f"{inner}{json.dumps(key)}: {_laid_out(entry, inner)}" for key, entry in item.items()]
        return "{\n" + ",\n".join(lines) + f"\n{indent}}}"
    if isinstance(item, list) and any(isinstance(entry, list | dict) for entry in item):
        return "[\n" + ",\n".join(inner + _laid_out(entry, inner) for entry in item) + f"\n{indent}]"
    return json.dumps(item, allow_nan=False)


def toml(data: Mapping[str, Any], header: str = "") -> str:
    """Return `data` as TOML: plain values first, then tables, then arrays of tables, every number exact."""
    lines, tables = [], []
    for key, item in data.items():
        name = key if _BARE.fullmatch(key) else _literal(key)
        path = f"{header}.{name}" if header else name
        if isinstance(item, Mapping):
            tables.append(f"\n[{path}]\n{toml(item, path)}" if item else "")
        elif isinstance(item, Sequence) and item and isinstance(item[0], Mapping):
            tables += [f"\n[[{path}]]\n{toml(one, path)}" for one in item]
        elif not (isinstance(item, Sequence) and not isinstance(item, str) and not item):
            lines.append(f"{name} = {_literal(item)}\n")
    return "".join(lines + tables)


def _literal(item: Any) -> str:
    if isinstance(item, bool):
        return "true" if item else "false"
    if isinstance(item, str):
        # JSON's escapes are TOML's, which wants DEL escaped, too.
        return json.dumps(item, ensure_ascii=False).replace("\x7f", "\\u007f")
    if isinstance(item, Sequence):
        return f"[{', '.join(_literal(one) for one in item)}]"
    return repr(item.item() if hasattr(item, "item") else item)  # of NumPy
