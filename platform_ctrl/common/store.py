"""Results kept in a folder under the hash of everything that they depend on, so that what did not change is reused.

A file is named by the SHA-256 of what the result was computed from and of the code (`key_of`). One that is missing,
damaged or of another kind counts as not found.
"""

from __future__ import annotations

import base64
import binascii
import contextlib
import dataclasses
import functools
import hashlib
import json
import os
import platform
import sys
from collections.abc import Callable, Mapping
from importlib import metadata
from pathlib import Path
from typing import Any

import numpy as np

from platform_ctrl.common.files import write_whole
from platform_ctrl.common.values import FloatArray
from platform_ctrl.errors import InputError

# Bytes that a folder may hold; what was used least recently goes first.
MOST_BYTES = 64 * 2**20
_PACKAGES = (
    *("numpy", "scipy", "control", "cvxpy", "clarabel", "numba", "llvmlite", "python-flint", "slycot"),
    *("matplotlib", "Jinja2"),
)
# How many threads BLAS uses decides about last digits.
_THREADS = ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "MKL_NUM_THREADS")


def key_of(*items: object) -> str:
    """Return the SHA-256 of values, to the last bit and by their fields' names, and of the code that computes."""
    digest = hashlib.sha256(code_identity().encode())
    _feed(digest.update, items)
    return digest.hexdigest()


def _feed(update: Callable[[bytes], object], item: Any) -> None:
    """Hash a value: its kind, its length, what it holds. A kind that is not known here is a TypeError."""
    kind = type(item)
    if dataclasses.is_dataclass(item) and not isinstance(item, type):
        fields = [field.name for field in dataclasses.fields(item) if field.init]
        update(f"{kind.__module__}.{kind.__qualname__} {len(fields)};".encode())
        for name in fields:
            _feed(update, name)
            _feed(update, getattr(item, name))
    elif isinstance(item, np.ndarray):
        if item.dtype.hasobject:
            raise TypeError("an array of objects cannot be hashed")
        update(f"array {item.dtype.str} {item.shape};".encode())
        update(np.ascontiguousarray(item).tobytes())
    elif isinstance(item, Mapping):
        update(f"mapping {len(item)};".encode())
        for pair in item.items():
            _feed(update, pair)
    elif isinstance(item, tuple | list):
        update(f"sequence {len(item)};".encode())
        for one in item:
            _feed(update, one)
    elif isinstance(item, bool | int | str | None):
        text = repr(item).encode()
        update(f"{kind.__name__} {len(text)};".encode() + text)
    elif isinstance(item, float):
        update(f"float {float(item).hex()};".encode())
    elif isinstance(item, complex | np.generic):
        _feed(update, np.asarray(item))
    elif kind.__module__ == "control.statesp":
        # Systems without a name are numbered in the order in which they happen to be made.
        name = "" if str(item.name).startswith("sys[") else str(item.name)
        labels = (item.input_labels, item.output_labels, item.state_labels)
        _feed(update, (item.A, item.B, item.C, item.D, item.dt, name, labels))
    else:
        raise TypeError(f"{kind.__qualname__}: cannot be hashed")


@functools.cache
def code_identity() -> str:
    """Return what results depend on beside their inputs: this package's files, libraries, Python and the processor."""
    own = hashlib.sha256()
    package = Path(__file__).parents[1]
    # Templates too: captions are kept with their figures.
    for file in sorted(one for one in package.rglob("*.*") if "__pycache__" not in one.parts and one.is_file()):
        own.update(f"{file.relative_to(package)}\n".encode() + hashlib.sha256(file.read_bytes()).digest())
    versions = []
    for name in _PACKAGES:
        with contextlib.suppress(metadata.PackageNotFoundError):
            versions.append(f"{name} {metadata.version(name)}")
    simd = np.show_config(mode="dicts").get("SIMD Extensions", {})
    threads = [f"{name} {os.environ.get(name)}" for name in _THREADS]
    machine = (sys.version, platform.system(), platform.machine(), os.cpu_count(), simd, threads)
    return json.dumps([own.hexdigest(), versions, machine], sort_keys=True)


class Store:
    """Results in a folder, which is made with the first of them.

    Parameters
    ----------
    folder
        Where.
    fresh
        Whether what is there already is ignored.
    most_bytes
        That the files may have in all.
    """

    def __init__(self, folder: Path, *, fresh: bool = False, most_bytes: int = MOST_BYTES) -> None:
        self.folder = folder
        self.fresh = fresh
        self.most_bytes = most_bytes
        self.taken: list[tuple[str, str]] = []

    def find(self, key: str) -> Any:
        """Return what was kept under a key, in the types of JSON; None if it is not there or not whole."""
        file = self.folder / f"{key}.json"
        # Whatever is wrong with a file, the result can be computed.
        with contextlib.suppress(OSError, ValueError, TypeError, KeyError, RecursionError):
            if not self.fresh and file.stat().st_size <= self.most_bytes:
                read = json.loads(file.read_bytes())
                if read["key"] == key and read["sha256"] == _digest(read["content"]):
                    os.utime(file)
                    return read["content"]
        return None

    def keep(self, key: str, content: Any) -> None:
        """Keep what consists of the types of JSON; a folder that cannot be written to keeps nothing."""
        text = json.dumps({"key": key, "sha256": _digest(content), "content": content})
        with contextlib.suppress(OSError, InputError):
            self.folder.mkdir(exist_ok=True)
            write_whole(self.folder / f"{key}.json", text)
            self._drop_oldest()

    def _drop_oldest(self) -> None:
        found = [(file, file.stat()) for file in self.folder.glob("*.json")]
        total = sum(about.st_size for _, about in found)
        for file, about in sorted(found, key=lambda one: one[1].st_mtime_ns):
            if total <= self.most_bytes:
                return
            file.unlink(missing_ok=True)
            total -= about.st_size


def _digest(content: Any) -> str:
    return hashlib.sha256(json.dumps(content, sort_keys=True).encode()).hexdigest()


def array_text(array: FloatArray | None) -> list[Any] | None:
    """Return an array of doubles for a file, to the last bit."""
    if array is None:
        return None
    return [list(array.shape), base64.b64encode(np.asarray(array, dtype="<f8").tobytes()).decode()]


def array_of(item: Any) -> FloatArray | None:
    """Return the array that `array_text` has written; what is none is a ValueError."""
    if item is None:
        return None
    try:
        shape, text = item
        return np.frombuffer(base64.b64decode(text, validate=True), dtype="<f8").reshape(shape).astype(np.float64)
    except (TypeError, ValueError, binascii.Error):
        raise ValueError("this is no array") from None
