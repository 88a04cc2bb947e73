"""Files and folders that take their places together: all of them complete, or none."""

from __future__ import annotations

import hashlib
import os
import shutil
import tempfile
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path

from platform_ctrl.cli.interrupts import interrupts_deferred
from platform_ctrl.common.json_text import write_json
from platform_ctrl.errors import InputError
from platform_ctrl.plant.source import read_json

# What a folder holds that an export made: the files that are its own.
RECORD = "export.json"
_UNFINISHED = ".unfinished-"


class Stage:
    """Where files are written before they take their places."""

    def __init__(self) -> None:
        self._folders: list[Path] = []
        self._moves: list[tuple[Path, Path]] = []
        self._whole: list[tuple[Path, Path, Mapping[str, str] | None]] = []

    def file(self, target: Path) -> Path:
        """Return where a file is to be written that takes its place at `target`; the folder is there."""
        unfinished = self._beside(target, target.parent)
        self._moves.append((unfinished / target.name, target))
        return unfinished / target.name

    def folder(self, target: Path, own: Mapping[str, str] | None = None) -> Path:
        """Return a folder to write into whose files take their places in `target`.

        Those of an earlier export, `own`, go away; whatever else is there stays. Without `own` the folder is there, and
        what it holds may be written over.
        """
        # A folder that is there may be another file system.
        unfinished = self._beside(target, target if own is None or target.is_dir() else target.parent)
        self._whole.append((unfinished, target, own))
        return unfinished

    def named(self, message: str) -> str:
        """Return a message about what is written as one about where it was to be."""
        for source, target in self._moves:
            message = message.replace(str(source), str(target))
        for source, target, _ in self._whole:
            message = message.replace(str(source), str(target))
        return message

    def place(self) -> None:
        """Put everything in its place."""
        undo: list[tuple[Path | None, Path]] = []  # what was there, and where
        try:
            for unfinished, target, own in self._whole:
                names = sorted(path.name for path in unfinished.iterdir())
                for name in names:
                    if own is not None and name not in own and os.path.lexists(target / name):
                        raise InputError(f"{target / name}: is not part of an earlier export; move it elsewhere")
                if not target.exists():
                    target.mkdir()
                    undo.append((None, target))
                self._moves += [(unfinished / name, target / name) for name in names]
                for name in (own or {}).keys() - names:
                    self._aside(target / name, undo)
            for source, target in self._moves:
                self._aside(target, undo)
                os.replace(source, target)
                undo.append((None, target))
        except (OSError, InputError) as error:
            self._undo(undo)
            if isinstance(error, InputError):
                raise
            where = self.named(str(error.filename2 or error.filename or ""))
            raise InputError(f"{where}: cannot be written: {error.strerror or error}") from None

    def clear(self) -> None:
        """Remove what is unfinished."""
        for folder in self._folders:
            shutil.rmtree(folder, ignore_errors=True)

    def _beside(self, target: Path, folder: Path) -> Path:
        with interrupts_deferred():
            try:
                # In the same folder, so that putting a file in place is one step of the file system.
                unfinished = Path(tempfile.mkdtemp(prefix=_UNFINISHED, dir=folder))
            except OSError as error:
                raise InputError(f"{target}: cannot be written to: {error.strerror or error}") from None
            self._folders.append(unfinished)
        return unfinished

    def _aside(self, target: Path, undo: list[tuple[Path | None, Path]]) -> None:
        if target.is_dir() and not target.is_symlink():
            raise InputError(f"{target}: is a folder, but must be a file or not exist")
        if os.path.lexists(target):
            before = self._beside(target, target.parent)
            os.replace(target, before / target.name)
            undo.append((before / target.name, target))

    @staticmethod
    def _undo(undo: list[tuple[Path | None, Path]]) -> None:
        for before, target in reversed(undo):
            if before is not None:
                os.replace(before, target)
            elif target.is_dir():
                target.rmdir()
            else:
                target.unlink()


@contextmanager
def all_or_none() -> Iterator[Stage]:
    """Yield a stage to write on; at the end everything takes its place.

    If the work ends by an error or by Ctrl-C, everything is as it was. A Ctrl-C while files move takes effect when they
    have moved.
    """
    stage = Stage()
    try:
        try:
            yield stage
        except InputError as error:
            raise InputError(stage.named(str(error))) from None
        except OSError as error:  # a full disk
            where = stage.named(str(error.filename or "export"))
            raise InputError(f"{where}: cannot be written: {error.strerror or error}") from None
        with interrupts_deferred():
            stage.place()
    finally:
        with interrupts_deferred():
            stage.clear()


@contextmanager
def written_together(folder: Path) -> Iterator[Path]:
    """Yield a folder to write into; at the end all its files move to `folder`, over those there, or none does."""
    with all_or_none() as stage:
        yield stage.folder(folder)


def own_files(option: str, folder: Path) -> dict[str, str]:
    """Return the files of an earlier export in a folder, with their SHA-256; none in one that is empty or not there."""
    if not os.path.lexists(folder):
        return {}
    if not folder.is_dir():
        raise InputError(f"{option} {folder}: is a file, but must be a folder or not exist")
    try:
        present = [path.name for path in folder.iterdir() if not path.name.startswith(_UNFINISHED)]
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
