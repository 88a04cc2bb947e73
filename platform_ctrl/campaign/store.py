"""A campaign on disk: parts while it runs, one table in run order when it is done. Killed at any moment it is whole.

``campaign.json`` describes the campaign; ``campaign.parts/`` holds a Parquet file for each chunk of runs, with the
digest of its bytes in its name; ``campaign.parquet`` is put in place once it is complete, and the parts are removed
after that.
"""

from __future__ import annotations

import hashlib
import json
import re
from collections import Counter
from collections.abc import Iterator, Mapping
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any

import numpy as np

from platform_ctrl.campaign.identity import Identity
from platform_ctrl.campaign.table import (
    COMPLETED,
    DIVERGED,
    ENDED,
    NOT_SIMULATED,
    PASSED,
    RUN,
    Columns,
    Kind,
    arrow,
    schema_of,
    table_of,
    with_current_endings,
)
from platform_ctrl.common.files import replaced_file
from platform_ctrl.common.json_text import write_json
from platform_ctrl.errors import InputError

RECORD, TABLE, PARTS, LOCK = "campaign.json", "campaign.parquet", "campaign.parts", ".campaign.lock"
SCHEMA = 1
# Rows that are written to the table at a time, and kept in memory while it is made.
ROWS = 1 << 14
# Reasons for which runs were not simulated that the record tells, and that are counted apart.
_REASONS, _COUNTED = 20, 1000
_PART = re.compile(r"(\d{12})-(\d{12})\.([0-9a-f]{32})\.parquet")
# Under which key the table says what its runs follow from.
_KEY = "platform_ctrl.campaign"

Record = dict[str, Any]


class Store:
    """The folder of a campaign while it is simulated; made by `opened`.

    Attributes
    ----------
    folder
        Where it lies.
    runs
        How many runs it will have.
    """

    def __init__(self, folder: Path, record: Record, kinds: Mapping[str, Kind]) -> None:
        self.folder, self.record, self.runs = folder, record, int(record["runs"])
        about = {"identity": record["identity"], "versions": record["versions"]}
        self._stamp = json.dumps(about, sort_keys=True)
        self._schema = schema_of(kinds, {_KEY: self._stamp})
        self._parts: dict[range, Path] = {}
        self._base = self._kept_runs = 0

    @property
    def table(self) -> Path:
        """Path of the complete table."""
        return self.folder / TABLE

    @property
    def done(self) -> int:
        """How many runs are kept."""
        return self._kept_runs

    @property
    def gaps(self) -> list[range]:
        """The runs that are missing, in order."""
        out, reached = [], self._base
        for part in sorted(self._parts, key=lambda part: part.start):
            out.append(range(reached, part.start))
            reached = part.stop
        return [gap for gap in (*out, range(reached, self.runs)) if gap]

    def load(self) -> None:
        """Find what earlier processes left, a table or whole parts; damaged ones are removed and simulated again."""
        for unfinished in (*self.folder.glob(f".{TABLE}.*.tmp"), *self.folder.glob(f"{PARTS}/.*.tmp")):
            unfinished.unlink(missing_ok=True)
        self._base = self._kept_runs = self._whole_rows()
        reached = self._base
        for path in sorted((self.folder / PARTS).glob("*")):
            named = _PART.fullmatch(path.name)
            if named is None:
                continue
            runs = range(int(named[1]), int(named[2]))
            fits = reached <= runs.start < runs.stop <= self.runs
            if fits and _digest(path.read_bytes()) == named[3]:
                self._parts[runs] = path
                self._kept_runs += len(runs)
                reached = runs.stop
            else:
                path.unlink()

    def write(self, runs: range, columns: Columns) -> None:
        """Keep the columns of a chunk of runs."""
        pa = arrow()
        out = pa.BufferOutputStream()
        pa.parquet.write_table(table_of(columns, self._schema), out)
        content = out.getvalue().to_pybytes()
        folder = self.folder / PARTS
        path = folder / f"{runs.start:012d}-{runs.stop:012d}.{_digest(content)}.parquet"
        with self._telling(folder):
            folder.mkdir(exist_ok=True)
            with replaced_file(path, synced=True) as file:
                file.write(content)
        self._parts[runs] = path
        self._kept_runs += len(runs)

    def finish(self) -> None:
        """Make the table of all runs, in their order, write the record, and remove the parts."""
        counts: Counter[str] = Counter()
        if self._parts or self._base < self.runs:
            with self._telling(self.table):
                self._merge(counts)
        else:
            for table in self._base_tables():
                _count(counts, table)
        names = (COMPLETED, DIVERGED, NOT_SIMULATED, "passed", "not passed")
        # Not the times at which runs diverged: as many as there are runs.
        reasons = sorted(name for name in counts if name.startswith(f"{NOT_SIMULATED}: "))[:_REASONS]
        self.record |= {
            "complete": True,
            "counts": {name: counts[name] for name in names},
            "reasons": {name: counts[name] for name in reasons},
        }
        with self._telling(self.folder / RECORD):
            write_record(self.folder, self.record)
        with suppress(OSError):  # what cannot be removed is recognised next time
            for path in self._parts.values():
                path.unlink(missing_ok=True)
            (self.folder / PARTS).rmdir()

    def _merge(self, counts: Counter[str]) -> None:
        pa = arrow()
        with (
            replaced_file(self.table, synced=True) as file,
            pa.parquet.ParquetWriter(file, self._schema, write_page_checksum=True) as writer,
        ):
            waiting: list[Any] = []
            for table in self._tables():
                _count(counts, table)
                waiting.append(table)
                while sum(one.num_rows for one in waiting) >= ROWS:
                    rows = pa.concat_tables(waiting).combine_chunks()
                    writer.write_table(rows.slice(0, ROWS))
                    waiting = [rows.slice(ROWS)]
            rows = pa.concat_tables(waiting)
            if rows.num_rows:
                writer.write_table(rows)

    def _tables(self) -> Iterator[Any]:
        pa = arrow()
        if self._base:
            yield from self._base_tables()
        for runs in sorted(self._parts, key=lambda part: part.start):
            with pa.parquet.ParquetFile(pa.BufferReader(self._parts[runs].read_bytes())) as file:
                yield with_current_endings(file.read().cast(self._schema))

    def _base_tables(self) -> Iterator[Any]:
        pa = arrow()
        with pa.parquet.ParquetFile(self.table, page_checksum_verification=True) as file:
            for batch in file.iter_batches(batch_size=ROWS):
                yield with_current_endings(pa.Table.from_batches([batch]).cast(self._schema))

    def _whole_rows(self) -> int:
        """Return the rows of the table that is there, 0 if it is damaged or another campaign's."""
        pa = arrow()
        try:
            rows, metadata = 0, pa.parquet.read_schema(self.table).metadata or {}
            if metadata.get(_KEY.encode(), b"").decode() != self._stamp:
                return 0
            for table in self._base_tables():
                numbers = table.column(RUN).to_numpy()
                if not np.array_equal(numbers, np.arange(rows, rows + len(numbers))):
                    return 0
                rows += len(numbers)
        except (OSError, ValueError, pa.ArrowException):
            return 0
        return rows if rows <= self.runs else 0

    @contextmanager
    def _telling(self, path: Path) -> Iterator[None]:
        try:
            yield
        except OSError as error:
            raise InputError(
                f"{path}: cannot be written: {error.strerror or error}; the {self.done} runs simulated so far are "
                "kept: make room, and the same command goes on"
            ) from None


@contextmanager
def opened(
    folder: Path,
    identity: Identity,
    about: Mapping[str, Any],
    runs: int,
    versions: dict[str, str],
    kinds: Mapping[str, Kind],
    restart: bool = False,
) -> Iterator[Store]:
    """Lock a campaign's folder and open what is there, or begin.

    Parameters
    ----------
    folder
        Made if needed.
    identity, versions
        What the runs follow from: those that are there must follow from the same.
    about
        What else the record says.
    runs
        How many runs the campaign will have: at least as many as it has.
    kinds
        Columns of the table.
    restart
        Forget what is there.
    """
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise InputError(f"{folder}: cannot be made a folder: {error.strerror or error}") from None
    with locked(folder):
        if restart:
            _forget(folder)
        record = {
            "schema": SCHEMA,
            **about,
            "runs": runs,
            "identity": identity,
            "versions": versions,
            "complete": False,
            "counts": {},
        }
        _judge(folder, record)
        store = Store(folder, record, kinds)
        try:
            store.load()
        except OSError as error:
            raise InputError(f"{folder}: cannot be read: {error.strerror or error}") from None
        if store.gaps or not (folder / RECORD).exists():
            write_record(folder, record)
        yield store


@contextmanager
def locked(folder: Path) -> Iterator[None]:
    """Hold the campaign's folder: a lock of the operating system, released when the process ends, however it ends."""
    from filelock import FileLock, Timeout

    lock = FileLock(folder / LOCK, timeout=0)
    try:
        lock.acquire()
    except Timeout:
        raise InputError(
            f"{folder}: another process is at work on the campaign there; wait for it, or name another folder with -o"
        ) from None
    except OSError as error:
        raise InputError(f"{folder}: cannot be written to: {error.strerror or error}") from None
    try:
        yield
    finally:
        lock.release()


def read_record(folder: Path) -> Record | None:
    """Return the record of the campaign in a folder, None where there is none."""
    path = folder / RECORD
    try:
        record = json.loads(path.read_text(encoding="utf-8"))
    except (FileNotFoundError, NotADirectoryError):
        return None
    except (OSError, ValueError) as error:
        raise InputError(f"{path}: the record of the campaign cannot be read: {error}") from None
    if not isinstance(record, dict) or record.get("schema") != SCHEMA or not isinstance(record.get("identity"), dict):
        raise InputError(f"{path}: is no record of a campaign that this version reads; name another folder with -o")
    return record


def write_record(folder: Path, record: Mapping[str, Any]) -> None:
    """Write ``campaign.json``, whole or not at all."""
    write_json(record, folder / RECORD)


def _judge(folder: Path, new: Record) -> None:
    """Refuse what is there already if it is another campaign's."""
    cure = "name another folder with -o, or start again with --restart"
    there = read_record(folder)
    if there is None:
        taken = [name for name in (TABLE, PARTS) if (folder / name).exists()]
        if taken:
            raise InputError(f"{folder}: has {taken[0]} but no {RECORD} that says what it belongs to; {cure}")
        return
    found = differences(there, new)
    if found:
        raise InputError(f"{folder / RECORD}: the campaign there was begun with {'; '.join(found)}; {cure}")
    if there["runs"] > new["runs"]:
        raise InputError(
            f"{folder / RECORD}: the campaign there has {there['runs']} runs, got {new['runs']}: ask for at least "
            f"as many, or {cure}"
        )


def differences(there: Record, new: Record) -> list[str]:
    """Return in words what two campaigns' runs follow from and is not the same."""
    out = []
    for name in {**there["identity"], **new["identity"]}:
        before, now = there["identity"].get(name), new["identity"].get(name)
        if before == now:
            continue
        if name == "runs" and before and now:
            out.append(
                f"{before} runs instead of {now} (a Latin hypercube is made for one number of runs; sobol and random "
                "go on)"
            )
        elif name in ("seed", "sampling", "step"):
            out.append(f"{name} {before} instead of {now}")
        elif name != "runs":
            out.append(f"another {name}" if name == "plant" else f"other {name}")
    for name, now in new["versions"].items():
        before = there.get("versions", {}).get(name)
        if before != now:
            out.append(f"{name} {before} instead of {now}")
    return out


def _forget(folder: Path) -> None:
    # The record last: what is left without it would be nobody's.
    try:
        (folder / TABLE).unlink(missing_ok=True)
        for path in (folder / PARTS).glob("*"):
            path.unlink()
        with suppress(FileNotFoundError):
            (folder / PARTS).rmdir()
        (folder / RECORD).unlink(missing_ok=True)
    except OSError as error:
        raise InputError(f"{folder}: cannot be emptied: {error.strerror or error}") from None


def _count(counts: Counter[str], table: Any) -> None:
    import pyarrow.compute

    number = pyarrow.compute.sum
    ended, passed = table.column(ENDED), table.column(PASSED)
    missing = pyarrow.compute.starts_with(ended, NOT_SIMULATED)
    found = {
        COMPLETED: number(pyarrow.compute.equal(ended, COMPLETED)).as_py(),
        NOT_SIMULATED: number(missing).as_py(),
        "passed": number(passed).as_py() or 0,
    }
    found[DIVERGED] = table.num_rows - found[COMPLETED] - found[NOT_SIMULATED]
    found["not passed"] = table.num_rows - found["passed"] - found[NOT_SIMULATED]
    counts.update(found)
    for entry in ended.filter(missing).value_counts().to_pylist() if found[NOT_SIMULATED] else ():
        if entry["values"] in counts or len(counts) < _COUNTED:
            counts[entry["values"]] += entry["counts"]


def _digest(content: bytes) -> str:
    return hashlib.blake2b(content, digest_size=16).hexdigest()
