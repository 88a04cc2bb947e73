"""A campaign on disk: ``campaign.json`` describes it, the folder ``campaign.parquet`` has a file for each part of it.

Its record has hashes of everything that its runs follow from: two campaigns with the same hashes have the same runs.

A part is put in place whole, under the numbers of its runs: a campaign that was killed goes on with what is there.
"""

from __future__ import annotations

import json
import os
import re
import shutil
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from importlib import metadata
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from platform_ctrl import __version__
from platform_ctrl.analysis.system import StateSpace
from platform_ctrl.common.arguments import short
from platform_ctrl.common.files import remove_unfinished, replaced_file, write_json
from platform_ctrl.errors import InputError
from platform_ctrl.job.reading import data_hash, job_data, job_hashes

if TYPE_CHECKING:
    from platform_ctrl.campaign.planning import Plan
    from platform_ctrl.job.job import Job

# Columns of a run besides its inputs.
RUN, MANOEUVRE, PASSED, ENDED = "run", "manoeuvre", "passed", "ended"
# How a run ended begins with one of these words.
COMPLETED, DIVERGED, NOT_SIMULATED = "completed", "diverged", "not simulated"

Array = NDArray[Any]
Columns = dict[str, Array]


def arrow() -> Any:
    """Return the module pyarrow."""
    try:
        import pyarrow
        import pyarrow.parquet
    except ImportError:
        raise InputError(
            "a campaign's table is Parquet and pyarrow is not installed: pip install 'platform_ctrl[campaign]'"
        ) from None
    return pyarrow


def read_rows(table: str | os.PathLike[str], run: int | None = None) -> Any:
    """Return a campaign's table, Parquet, or what it has of one run, as a table of pyarrow."""
    pa = arrow()
    from pyarrow import dataset

    try:
        rows = dataset.dataset(os.fspath(table), format="parquet")
        return rows.to_table(filter=None if run is None else dataset.field(RUN) == run)
    except (pa.ArrowException, OSError, ValueError) as error:
        where = short(os.fspath(table))
        raise InputError(f"{where}: cannot be read as Parquet: {str(error).splitlines()[0]}") from None


def read_columns(table: str | os.PathLike[str]) -> Columns:
    """Return the columns (N,) of a campaign's table by their names, as of `typed`."""
    found, where = read_rows(table), short(os.fspath(table))
    for name in {RUN, MANOEUVRE, PASSED, ENDED}.difference(found.column_names):
        raise InputError(f"{where}: has no column {name!r}; give the table that a campaign has written")
    return typed({name: found.column(name).to_numpy() for name in found.column_names})


def typed(columns: Mapping[str, Array]) -> Columns:
    """Return columns with numbers in float64 (`run`: int64), words as objects, yes and no in int8: −1 is neither."""
    return {name: _typed(column) for name, column in columns.items()} | {RUN: columns[RUN].astype(np.int64)}


def _typed(column: Array) -> Array:
    if column.dtype.kind in "biuf":
        return column.astype(np.int8 if column.dtype.kind == "b" else np.float64)
    if all(isinstance(item, bool | np.bool_ | None) for item in column):
        return np.fromiter((-1 if item is None else int(item) for item in column), np.int8)
    return column


def was_simulated(columns: Mapping[str, Array]) -> NDArray[np.bool_]:
    """Return which runs were simulated."""
    ended = columns[ENDED]
    return np.fromiter((not str(one).startswith(NOT_SIMULATED) for one in ended), bool, len(ended))


Identity = dict[str, Any]
# Of a job's file, what its runs follow from beside the plant; loops and requirements of the design have no part in it.
_RUN_TABLES = ("sampling", "manoeuvre", "fault", "drive", "campaign")
# Of the campaign section: on the command line, or shown as numbers of their own.
_APART = ("runs", "seed", "sampling", "step")
# Libraries that draw and simulate.
_USED = ("numpy", "scipy", "numba")


def identity(plan: Plan) -> Identity:
    """Return everything that decides how a plan's runs come out, in plain types."""
    out: Identity = {
        **source_hashes(plan.job, plan.controllers),
        "seed": int(plan.seed),
        "sampling": str(plan.sampling),
        "step": float(plan.step),
    }
    if plan.sampling == "latin-hypercube":
        out["runs"] = int(plan.runs)  # one more run moves all the others
    return out | run_versions()


def source_hashes(job: Job, controllers: Sequence[StateSpace]) -> dict[str, str]:
    """Return hashes of the plant, of what else of a job its runs follow from, and of the controllers."""
    tables = {key: item for key, item in job_data(job).items() if key in _RUN_TABLES}
    tables["campaign"] = {key: item for key, item in tables.get("campaign", {}).items() if key not in _APART}
    matrices = [[np.asarray(getattr(one, key), dtype=np.float64) for key in "ABCD"] for one in controllers]
    names = [[float(one.dt), list(one.input_labels), list(one.output_labels)] for one in controllers]
    return {
        "plant": job_hashes(job)["plant"],
        "job": data_hash(tables),
        "controllers": data_hash({"matrices": matrices, "names": names}),
    }


def run_versions() -> dict[str, str]:
    """Return the versions that runs may depend on."""
    return {"platform_ctrl": __version__} | {name: metadata.version(name) for name in _USED}


def differences(there: Mapping[str, Any], now: Mapping[str, Any]) -> list[str]:
    """Return in words what two campaigns' runs follow from and is not the same."""
    out = []
    for name in dict.fromkeys((*there, *now)):
        before, after = there.get(name), now.get(name)
        if before == after:
            continue
        if name in ("plant", "job"):
            out.append(f"another {name}")
        elif name == "controllers":
            out.append("other controllers")
        elif name != "runs":
            out.append(f"{name} {before} instead of {after}")
        elif before and after:
            words = "a Latin hypercube is made for one number of runs; sobol and random go on"
            out.append(f"{before} runs instead of {after} ({words})")
    return out


RECORD, TABLE = "campaign.json", "campaign.parquet"
SCHEMA = 2
# Number of reasons in the record for which runs were not simulated.
_REASONS = 20
_PART = re.compile(r"(\d{12})-(\d{12})\.parquet")
_CURE = "name another folder with -o, or start again with --restart"

Record = dict[str, Any]


class Store:
    """The folder of a campaign while it is simulated.

    Parameters
    ----------
    folder
        Where it lies; made if needed.
    identity
        What the runs follow from: those that are there must follow from the same.
    about
        What else the record says.
    runs
        How many runs the campaign will have: at least as many as it has.
    types
        Columns of the table, with Arrow's names of their types.
    restart
        Forget what is there.
    """

    def __init__(
        self,
        folder: Path,
        identity: Identity,
        about: Mapping[str, Any],
        runs: int,
        types: Mapping[str, str],
        restart: bool,
    ) -> None:
        self._schema = arrow().schema([*types.items()])
        self.folder, self.table, self.runs = folder, folder / TABLE, runs
        self.record: Record = {"schema": SCHEMA, **about, "runs": runs, "identity": identity, "complete": False}
        with self._writing(folder):
            if restart:
                shutil.rmtree(self.table, ignore_errors=True)
                (folder / RECORD).unlink(missing_ok=True)
            _judge(folder, self.record)
            self.table.mkdir(parents=True, exist_ok=True)
            self._parts = self._whole_parts()
            if self.gaps or not (folder / RECORD).exists():
                write_campaign_record(folder, self.record)

    @property
    def done(self) -> int:
        """How many runs are kept."""
        return sum(map(len, self._parts))

    @property
    def gaps(self) -> list[range]:
        """The runs that are missing, in order."""
        ends = [0, *(end for part in self._parts for end in (part.start, part.stop)), self.runs]
        return [range(*gap) for gap in zip(ends[::2], ends[1::2], strict=True) if gap[0] < gap[1]]

    def write(self, runs: range, columns: Columns) -> None:
        """Keep the columns of a part of the runs; a number that is no number is null."""
        pa = arrow()
        arrays = [pa.array(columns[field.name], type=field.type, from_pandas=True) for field in self._schema]
        path = self.table / f"{runs.start:012d}-{runs.stop:012d}.parquet"
        with self._writing(self.table), replaced_file(path) as file:
            pa.parquet.write_table(pa.Table.from_arrays(arrays, schema=self._schema), file)
        self._parts = sorted([*self._parts, runs], key=lambda part: part.start)

    def finish(self) -> None:
        """Write the record of a campaign that is complete."""
        import pyarrow.compute
        import pyarrow.dataset

        data = pyarrow.dataset.dataset(self.table, schema=self._schema).to_table(columns=[ENDED, PASSED])
        endings = {one["values"]: one["counts"] for one in data[ENDED].value_counts().to_pylist()}
        counts = {
            kind: sum(number for words, number in endings.items() if words.startswith(kind))
            for kind in (COMPLETED, DIVERGED, NOT_SIMULATED)
        }
        passed = pyarrow.compute.sum(data[PASSED]).as_py() or 0
        counts |= {"passed": passed, "not passed": data.num_rows - passed - counts[NOT_SIMULATED]}
        reasons = sorted(words for words in endings if words.startswith(NOT_SIMULATED))[:_REASONS]
        self.record |= {"complete": True, "counts": counts, "reasons": {words: endings[words] for words in reasons}}
        with self._writing(self.folder / RECORD):
            write_campaign_record(self.folder, self.record)

    def _whole_parts(self) -> list[range]:
        """Return the parts that are there, in order; what is no whole part of this campaign is removed."""
        pa = arrow()
        found: list[range] = []
        remove_unfinished(self.table)
        for path in sorted(self.table.glob("[!.]*")):
            named = _PART.fullmatch(path.name)
            runs = range(int(named[1]), int(named[2])) if named else range(0)
            try:
                whole = pa.parquet.read_metadata(path).num_rows == len(runs) > 0
            except (OSError, pa.ArrowException):
                whole = False
            if whole and runs.start >= (found[-1].stop if found else 0) and runs.stop <= self.runs:
                found.append(runs)
            else:
                path.unlink()
        return found

    @contextmanager
    def _writing(self, path: Path) -> Iterator[None]:
        try:
            yield
        except OSError as error:
            raise InputError(
                f"{path}: cannot be written: {error.strerror or error}; the runs simulated so far are kept: make room, "
                "and the same command goes on, or name another folder with -o"
            ) from None


def read_campaign_record(folder: Path) -> Record | None:
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


def write_campaign_record(folder: Path, record: Mapping[str, Any]) -> None:
    """Write ``campaign.json``, whole or not at all."""
    write_json(record, folder / RECORD)


def _judge(folder: Path, new: Record) -> None:
    """Refuse what is there already if it is another campaign's."""
    there = read_campaign_record(folder)
    if there is None:
        if (folder / TABLE).exists():
            raise InputError(f"{folder}: has {TABLE} but no {RECORD} that says what it belongs to; {_CURE}")
        return
    found = differences(there["identity"], new["identity"])
    if found:
        raise InputError(f"{folder / RECORD}: the campaign there was begun with {'; '.join(found)}; {_CURE}")
    if there["runs"] > new["runs"]:
        raise InputError(
            f"{folder / RECORD}: the campaign there has {there['runs']} runs, got {new['runs']}: ask for at least "
            f"as many, or {_CURE}"
        )
