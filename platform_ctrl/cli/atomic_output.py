"""Files that take their places together at the end, and which files in a folder an export made."""

from __future__ import annotations

import hashlib
import os
from collections.abc import Iterator, Mapping
from contextlib import ExitStack, contextmanager, suppress
from pathlib import Path

from platform_ctrl.cli.interrupts import interrupts_deferred
from platform_ctrl.common.files import UNFINISHED, unfinished_folder, write_json
from platform_ctrl.errors import InputError
from platform_ctrl.plant.source import read_json

# What a folder holds that an export made: the files that are its own.
RECORD = "export.json"


@contextmanager
def written_together(*folders: Path) -> Iterator[list[Path]]:
    """Yield a folder to write into for each; at the end their files move to `folders`, made if needed.

    If the work ends by an error or by Ctrl-C, none does.
    """
    with ExitStack() as stack:
        unfinished = [stack.enter_context(_beside(folder)) for folder in folders]
        yield unfinished
        with interrupts_deferred():
            _move_together(dict(zip(unfinished, folders, strict=True)))


@contextmanager
def _beside(folder: Path) -> Iterator[Path]:
    """Yield a folder to write into inside `folder`, which is made; without an error that stays."""
    made, inside = not folder.exists(), ""
    try:
        folder.mkdir(exist_ok=True)
        with unfinished_folder(folder) as unfinished:
            inside = str(unfinished)
            yield unfinished
        made = False
    except InputError as error:
        raise InputError(str(error).replace(inside, str(folder)) if inside else str(error)) from None
    except OSError as error:  # a full disk
        where = str(error.filename2 or error.filename or folder)
        where = where.replace(inside, str(folder)) if inside else where
        raise InputError(f"{where}: cannot be written: {error.strerror or error}") from None
    finally:
        if made:
            with suppress(OSError):
                folder.rmdir()


def _move_together(folders: Mapping[Path, Path]) -> None:
    """Move the files of unfinished folders into others, over those there: all of them, or by an error none."""
    moves = [(path, folder / path.name) for source, folder in folders.items() for path in sorted(source.iterdir())]
    kept = {path: path.parent / "before" / path.name for path, _ in moves}
    for source in folders:
        (source / "before").mkdir()
    try:
        for path, target in moves:
            if os.path.lexists(target):
                os.replace(target, kept[path])
            os.replace(path, target)
    except BaseException:
        for path, target in moves:
            if os.path.lexists(kept[path]):
                os.replace(kept[path], target)
            elif not os.path.lexists(path):
                os.unlink(target)
        raise


def expect_own(unfinished: Path, folder: Path, own: Mapping[str, str] | None = None) -> None:
    """Make sure that the files of an unfinished folder can take their places in `folder`.

    With `own`, the files of an earlier export, no others may be there.
    """
    for name in sorted(os.listdir(unfinished)):
        if (folder / name).is_dir() and not (folder / name).is_symlink():
            raise InputError(f"{folder / name}: is a folder, but must be a file or not exist")
        if own is not None and name not in own and os.path.lexists(folder / name):
            raise InputError(f"{folder / name}: is not part of an earlier export; move it elsewhere")


def own_files(option: str, folder: Path) -> dict[str, str]:
    """Return the files of an earlier export in a folder, with their SHA-256; none in one that is empty or not there."""
    if not os.path.lexists(folder):
        return {}
    if not folder.is_dir():
        raise InputError(f"{option} {folder}: is a file, but must be a folder or not exist")
    try:
        present = [path.name for path in folder.iterdir() if not path.name.startswith(UNFINISHED)]
    except OSError as error:
        raise InputError(f"{option} {folder}: cannot be read: {error.strerror or error}") from None
    if not present:
        return {}
    if RECORD not in present:
        raise InputError(f"{option} {folder}: holds files of no earlier export; name a new or empty folder")
    _, record = read_json(folder / RECORD, "the record of an export")
    files = record.get("files") if isinstance(record, dict) else None
    if not isinstance(files, dict) or not all(isinstance(item, str) for item in files.values()):
        raise InputError(f"{option} {folder}: {RECORD} there is not the record of an export; name a new folder")
    for name, known in files.items():
        # A name that leads out of the folder is not one that an export wrote.
        if Path(name).name != name:
            raise InputError(f"{option} {folder}: {RECORD} there is not the record of an export; name a new folder")
        if name in present and sha256(folder / name) != known:
            raise InputError(f"{option} {folder}: {name} was changed since it was exported; move it elsewhere")
    return {**files, RECORD: ""}


def write_folder_record(folder: Path, about: Mapping[str, object]) -> None:
    """Write which files of a folder are an export's own."""
    files = {path.name: sha256(path) for path in sorted(folder.iterdir())}
    write_json({"schema": 1, **about, "files": files}, folder / RECORD)


def sha256(path: Path) -> str:
    """Return the SHA-256 of a file."""
    try:
        return hashlib.sha256(path.read_bytes()).hexdigest()
    except OSError as error:
        raise InputError(f"{path}: cannot be read: {error.strerror or error}") from None
