"""The campaign engine: one row a run whatever happens on the way. The runs are quick ones, made up of the inputs."""

from __future__ import annotations

import errno
import json
import os
import signal
import subprocess
import sys
import time
import tomllib
import tracemalloc
import types
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import platform_ctrl as pc
from campaign_runs import JOB, columns_here, invented_columns, planned, rows, undisturbed
from platform_ctrl.campaign import workers
from platform_ctrl.campaign.engine import CampaignResult, run_campaign
from platform_ctrl.campaign.planning import Plan, plan
from platform_ctrl.campaign.single_run import inputs_of
from platform_ctrl.campaign.store import locked
from platform_ctrl.campaign.workers import Chunks
from platform_ctrl.errors import ArgumentError, InputError, SimulationError
from platform_ctrl.job.reading import read_job
from platform_ctrl.plant.source import platform_source

pytest.importorskip("pyarrow", reason="a campaign's table is Parquet")

RUNS = 200


def carried_out(made: Plan, folder: Path, **options: Any) -> CampaignResult:
    return run_campaign(made, folder, **{"workers": 1, "simulate": invented_columns} | options)


@pytest.fixture
def mishaps(monkeypatch: pytest.MonkeyPatch) -> Callable[..., None]:
    """Tell the runs, in this process and in those it starts, what goes wrong."""

    def tell(**what: Any) -> None:
        monkeypatch.setenv("CAMPAIGN_MISHAPS", json.dumps(what))

    return tell


@pytest.fixture
def here(monkeypatch: pytest.MonkeyPatch) -> None:
    """Simulate in this process: quicker, where nothing is said about processes."""
    monkeypatch.setattr("platform_ctrl.campaign.engine.columns_by_processes", columns_here)


def stopped_halfway(made: Plan, folder: Path) -> int:
    """Run a campaign until a good part of it is kept, then stop as after a Ctrl-C; return how many runs are kept."""
    kept = 0

    def interrupt(done: int, amiss: int) -> None:
        nonlocal kept
        kept = done
        if done > made.runs // 3:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        carried_out(made, folder, progress=interrupt)
    return kept


def parts(folder: Path) -> list[Path]:
    return sorted((folder / "campaign.parts").glob("[0-9]*.parquet"))


def test_one_row_a_run_in_order_whatever_the_number_of_workers(tmp_path: Path) -> None:
    made = planned(runs=RUNS)
    found = carried_out(made, tmp_path / "one"), carried_out(made, tmp_path / "two", workers=2)
    assert rows(found[0]) == rows(found[1]) == undisturbed(made)
    assert sorted(path.name for path in (tmp_path / "two").iterdir()) == [
        ".campaign.lock",
        "campaign.json",
        "campaign.parquet",
    ]
    assert found[0].table.read_bytes() == found[1].table.read_bytes()
    record = json.loads((tmp_path / "one" / "campaign.json").read_text())
    assert record == found[0].record
    assert record["counts"]["completed"] == record["runs"] == RUNS
    assert record["counts"]["passed"] + record["counts"]["not passed"] == RUNS
    assert not found[0].passed


@pytest.mark.usefixtures("here")
def test_pandas_and_duckdb_read_the_table(tmp_path: Path) -> None:
    pandas, duckdb = pytest.importorskip("pandas"), pytest.importorskip("duckdb")
    made = planned(runs=16)
    path = carried_out(made, tmp_path).table
    frame = pandas.read_parquet(path)
    expected = undisturbed(made)
    assert frame["run"].tolist() == list(range(16))
    assert frame["rotor.11.spin"].tolist() == [row["rotor.11.spin"] for row in expected]
    assert frame["passed"].dtype == bool
    query = f"select manoeuvre, count(*), max(angle) from '{path}' where torque_share_passed is null group by manoeuvre"
    steps = [row for row in expected if row["manoeuvre"] == "step"]
    assert duckdb.sql(query).fetchall() == [("step", len(steps), max(row["angle"] for row in steps))]


DRIVER = """
import sys
from pathlib import Path
from campaign_runs import invented_columns, planned
from platform_ctrl.campaign.engine import run_campaign
run_campaign(planned(runs=int(sys.argv[1])), Path(sys.argv[2]), workers=2, simulate=invented_columns)
"""


@pytest.mark.skipif(os.name != "posix", reason="SIGKILL")
def test_killed_at_any_moment_it_goes_on_and_no_run_is_lost_or_simulated_twice(
    tmp_path: Path, mishaps: Callable[..., None]
) -> None:
    made, folder, log = planned(runs=RUNS), tmp_path / "out", tmp_path / "log"
    mishaps(seconds=0.01, log=str(log))
    path = os.pathsep.join([str(Path(__file__).parents[1] / "support"), str(Path(pc.__file__).parents[1])])
    process = subprocess.Popen(
        [sys.executable, "-c", DRIVER, str(RUNS), str(folder)], env=os.environ | {"PYTHONPATH": path}
    )
    deadline = time.monotonic() + 60.0
    while len(parts(folder)) < 4 and time.monotonic() < deadline:
        time.sleep(0.01)
    process.send_signal(signal.SIGKILL)
    process.wait()
    assert process.returncode == -signal.SIGKILL
    kept = {run for path in parts(folder) for run in range(int(path.name[:12]), int(path.name[13:25]))}
    assert 0 < len(kept) < RUNS
    assert not (folder / "campaign.parquet").exists()

    # Its workers go with it: none of them is at work any more.
    done = [int(line.split()[1]) for line in log.read_text().splitlines()]
    for pid in set(done):
        while _alive(pid) and time.monotonic() < deadline:
            time.sleep(0.02)
        assert not _alive(pid)

    mishaps(log=str(log))
    log.unlink()
    found = carried_out(made, folder)
    again = [int(line.split()[0]) for line in log.read_text().splitlines()]
    assert sorted(again) == sorted(set(range(RUNS)) - kept)
    assert rows(found) == undisturbed(made)
    assert not (folder / "campaign.parts").exists()


def _alive(pid: int) -> bool:
    # Orphans that are dead may not have been waited for yet: where there is /proc it tells.
    state = Path(f"/proc/{pid}/stat")
    with suppress(OSError):
        return state.read_text().rpartition(")")[2].split()[0] not in "ZX"
    try:
        os.kill(pid, 0)
    except ProcessLookupError:
        return False
    return True


def test_a_run_that_workers_die_of_is_isolated_and_the_others_are_simulated(
    tmp_path: Path, mishaps: Callable[..., None]
) -> None:
    made = planned(runs=64)
    expected = undisturbed(made)
    mishaps(dies=[37])
    found = carried_out(made, tmp_path, workers=2)
    [lost] = [row for row in rows(found) if row["ended"] != "completed"]
    assert lost["run"] == 37
    assert lost["ended"] == "not simulated: worker died"
    assert lost["rotor.11.spin"] == expected[37]["rotor.11.spin"]
    assert lost["angle"] is lost["passed"] is lost["stop_contacts"] is None
    assert [row for row in rows(found) if row["run"] != 37] == [row for row in expected if row["run"] != 37]
    assert found.reasons == {"not simulated: worker died": 1}
    assert not found.passed


def test_a_worker_that_dies_once_costs_no_run(tmp_path: Path, mishaps: Callable[..., None]) -> None:
    made = planned(runs=24)
    expected = undisturbed(made)
    mishaps(dies_once={"run": 17, "marker": str(tmp_path / "died")})
    assert rows(carried_out(made, tmp_path / "out")) == expected
    assert (tmp_path / "died").exists()


@pytest.mark.usefixtures("here")
def test_runs_that_diverge_or_raise_have_rows_that_say_so(tmp_path: Path, mishaps: Callable[..., None]) -> None:
    made = planned(runs=40)
    expected = undisturbed(made)
    mishaps(raises=[3, 11], diverges=[5])
    amiss = []
    found = carried_out(made, tmp_path, progress=lambda done, number: amiss.append(number))
    got = rows(found)
    assert [row["ended"] for row in got if row["run"] in (3, 11)] == ["not simulated: the sensors are not there"] * 2
    assert got[5]["ended"] == "diverged at t = 0.01 s"
    assert got[5]["angle"] == np.inf
    assert got[5]["passed"] is False
    others = [k for k in range(40) if k not in (3, 5, 11)]
    assert [got[k] for k in others] == [expected[k] for k in others]
    assert found.counts["not simulated"] == 2
    assert found.counts["diverged"] == 1
    assert amiss[-1] == 3


@pytest.mark.usefixtures("here")
def test_a_damaged_part_is_simulated_again(tmp_path: Path) -> None:
    made = planned(runs=RUNS)
    kept = stopped_halfway(made, tmp_path)
    first, _, third, *_ = parts(tmp_path)
    damaged = bytearray(first.read_bytes())
    damaged[len(damaged) // 2] ^= 1
    first.write_bytes(bytes(damaged))
    third.write_bytes(third.read_bytes()[:100])
    (tmp_path / "campaign.parts" / ".half.1.tmp").write_bytes(b"PAR1")
    seen: list[int] = []
    found = carried_out(made, tmp_path, progress=lambda done, amiss: seen.append(done))
    lost = sum(int(path.name[13:25]) - int(path.name[:12]) for path in (first, third))
    assert seen[0] == kept - lost > 0
    assert seen[-1] == RUNS
    assert rows(found) == undisturbed(made)


@pytest.mark.usefixtures("here")
def test_a_table_that_is_damaged_or_not_followed_by_its_record_is_no_loss(tmp_path: Path) -> None:
    made = planned(runs=24)
    found = carried_out(made, tmp_path)
    whole = found.table.read_bytes()
    # Killed after the table was in place and before the record said so, with parts still there.
    record = json.loads((tmp_path / "campaign.json").read_text())
    (tmp_path / "campaign.json").write_text(json.dumps(record | {"complete": False, "counts": {}}))
    (tmp_path / "campaign.parts").mkdir()
    (tmp_path / "campaign.parts" / f"{0:012d}-{8:012d}.{'0' * 32}.parquet").write_bytes(b"left behind")
    seen: list[int] = []
    again = carried_out(made, tmp_path, progress=lambda done, amiss: seen.append(done))
    assert seen == [24]
    assert again.record == record
    assert not (tmp_path / "campaign.parts").exists()
    found.table.write_bytes(whole[:200] + bytes([whole[200] ^ 255]) + whole[201:])
    assert carried_out(made, tmp_path).table.read_bytes() == whole


@pytest.mark.usefixtures("here")
def test_a_finished_campaign_is_made_longer(tmp_path: Path, mishaps: Callable[..., None]) -> None:
    for sampling in ("sobol", "random"):
        carried_out(planned(runs=21, sampling=sampling), tmp_path / sampling)
        seen: list[int] = []
        longer = planned(runs=50, sampling=sampling)
        found = carried_out(longer, tmp_path / sampling, progress=lambda done, amiss, to=seen: to.append(done))
        assert seen[0] == 21
        assert rows(found) == undisturbed(longer)
        with pytest.raises(InputError, match="has 50 runs, got 40: ask for at least as many"):
            carried_out(planned(runs=40, sampling=sampling), tmp_path / sampling)


@pytest.mark.usefixtures("here")
def test_a_latin_hypercube_is_not_made_longer(tmp_path: Path) -> None:
    carried_out(planned(runs=16, sampling="latin-hypercube"), tmp_path)
    with pytest.raises(InputError, match=r"16 runs instead of 32 \(a Latin hypercube is made for one number of runs"):
        carried_out(planned(runs=32, sampling="latin-hypercube"), tmp_path)


@pytest.mark.usefixtures("here")
def test_another_campaign_is_refused_in_one_line_that_says_what_differs(tmp_path: Path) -> None:
    import control

    carried_out(planned(runs=8), tmp_path)
    before = (tmp_path / "campaign.parquet").read_bytes()
    names = {"inputs": ["alpha9"], "outputs": ["Q9"]}
    controller = control.StateSpace([[0.5]], [[1.0]], [[1.0]], [[0.0]], 5e-4, **names)
    turned = [manoeuvre | ({"rate": 0.3} if "rate" in manoeuvre else {}) for manoeuvre in JOB["manoeuvre"]]
    heavier = tomllib.loads(platform_source("three_gyro_platform"))
    heavier["rotor"][0]["axial_inertia"] *= 1.1
    other: dict[str, Plan] = {
        "seed 7 instead of 8": planned(runs=8, seed=8),
        "sampling sobol instead of random": planned(runs=8, sampling="random"),
        "other controllers": plan(read_job(JOB), [controller], runs=8),
        "other manoeuvres": plan(read_job(JOB | {"manoeuvre": turned}), (), runs=8),
        "another plant": plan(read_job(JOB | {"plant": heavier}), (), runs=8),
    }
    for words, made in other.items():
        with pytest.raises(InputError) as raised:
            carried_out(made, tmp_path)
        message = str(raised.value)
        assert f"campaign.json: the campaign there was begun with {words}; name another folder" in message
        assert "\n" not in message
    assert (tmp_path / "campaign.parquet").read_bytes() == before
    found = carried_out(planned(runs=8, seed=8), tmp_path, restart=True)
    assert rows(found) == undisturbed(planned(runs=8, seed=8))


@pytest.mark.usefixtures("here")
def test_comments_and_what_only_the_design_uses_are_no_difference(tmp_path: Path) -> None:
    carried_out(planned(runs=8), tmp_path)
    job = JOB | {"name": "renamed", "coupled": {"disk_margin": 0.3}}
    assert carried_out(plan(read_job(job), (), runs=8), tmp_path).counts["completed"] == 8


@pytest.mark.usefixtures("here")
def test_files_of_nobody_are_not_overwritten(tmp_path: Path) -> None:
    (tmp_path / "campaign.parquet").write_bytes(b"somebody's")
    with pytest.raises(InputError, match=r"has campaign.parquet but no campaign.json"):
        carried_out(planned(runs=8), tmp_path)
    (tmp_path / "campaign.json").write_text("{")
    with pytest.raises(InputError, match=r"campaign.json: .*cannot be read"):
        carried_out(planned(runs=8), tmp_path)
    assert (tmp_path / "campaign.parquet").read_bytes() == b"somebody's"


@pytest.mark.usefixtures("here")
def test_two_processes_do_not_share_a_folder(tmp_path: Path) -> None:
    with locked(tmp_path), pytest.raises(InputError, match="another process is at work on the campaign there"):
        carried_out(planned(runs=8), tmp_path)
    assert carried_out(planned(runs=8), tmp_path).counts["completed"] == 8


@contextmanager
def files_of_at_most(size: int) -> Iterator[None]:
    resource = pytest.importorskip("resource", reason="limits of POSIX")
    soft, hard = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (size, hard))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, (soft, hard))


@pytest.mark.usefixtures("here")
def test_when_nothing_more_can_be_written_what_is_there_is_kept(tmp_path: Path) -> None:
    made = planned(runs=RUNS)
    kept = stopped_halfway(made, tmp_path)
    there = parts(tmp_path)
    with (
        files_of_at_most(4096),
        pytest.raises(InputError, match=rf"cannot be written: .*; the {kept} runs simulated"),
    ):
        carried_out(made, tmp_path)
    assert parts(tmp_path) == there
    # Room for parts, none for the table of them all.
    largest = max(path.stat().st_size for path in there)
    with (
        files_of_at_most(largest + 2048),
        pytest.raises(InputError, match=rf"the {RUNS} runs simulated so far"),
    ):
        carried_out(made, tmp_path)
    assert not list(tmp_path.glob(".*.tmp"))
    found = carried_out(made, tmp_path)
    assert rows(found) == undisturbed(made)


@pytest.mark.usefixtures("here")
def test_a_full_disk_is_one_line(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def full(handle: int) -> None:
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    monkeypatch.setattr("os.fsync", full)
    with pytest.raises(
        InputError, match=r"No space left on device; the 0 runs simulated so far are kept: make room"
    ) as one:
        carried_out(planned(runs=8), tmp_path)
    assert "\n" not in str(one.value)
    assert parts(tmp_path) == []


def test_workers_that_cannot_begin_are_told_at_once(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]
) -> None:
    nowhere = types.ModuleType("only_here")
    exec("def simulate(plan, runs, *, threads=1): ...", nowhere.__dict__)
    nowhere.simulate.__module__ = "only_here"
    monkeypatch.setitem(sys.modules, "only_here", nowhere)
    with pytest.raises(SimulationError, match=r"a worker process ended before it began \(exit code 1\)"):
        carried_out(planned(runs=8), tmp_path, simulate=nowhere.simulate)
    assert "only_here" in capfd.readouterr().err


def test_a_worker_that_is_killed_while_it_begins_is_replaced(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    begun: list[int] = []

    class Killed(workers.TaskProcess):
        def __init__(self, *given: Any, **options: Any) -> None:
            super().__init__(*given, **options)
            begun.append(self.process.pid)
            if len(begun) == 1:
                self.process.kill()

    monkeypatch.setattr(workers, "TaskProcess", Killed)
    made = planned(runs=8)
    assert rows(carried_out(made, tmp_path)) == undisturbed(made)
    assert len(begun) == 2


def test_workers_that_die_of_everything_stop_the_campaign(
    tmp_path: Path, mishaps: Callable[..., None], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("platform_ctrl.campaign.workers._MAX_DEATHS", 3)
    mishaps(dies=list(range(RUNS)))
    with pytest.raises(SimulationError, match="3 worker processes died without a run finished in between"):
        carried_out(planned(runs=RUNS), tmp_path, workers=2)


def test_wrong_arguments_are_told(tmp_path: Path) -> None:
    with pytest.raises(ArgumentError, match="workers must be at least one, got 0"):
        carried_out(planned(runs=8), tmp_path, workers=0)


def test_pieces_take_about_a_second_and_cover_every_run_once() -> None:
    chunks, done = Chunks([range(3, 40), range(100, 30000)], crew=2), []
    while (chunk := chunks.next()) is not None:
        done.append(chunk)
        chunks.finished(chunk, len(chunk) / 500.0)  # 500 runs a second
    assert [run for chunk in done for run in chunk] == [*range(3, 40), *range(100, 30000)]
    assert all(chunk.start % 8 == 0 for chunk in done if chunk.start not in (3, 100))
    assert max(map(len, done)) == 496
    assert len(done[-2]) <= 64


def test_a_piece_whose_worker_died_is_cut_until_the_run_is_alone() -> None:
    chunks = Chunks([range(4096)], crew=1)
    guilty, found, deaths, done = 3456, None, 0, []
    while (chunk := chunks.next()) is not None:
        if guilty in chunk:
            deaths += 1
            found = chunks.died(chunk)
        else:
            done += chunk
            chunks.finished(chunk, 1e-9)
    assert found == guilty
    assert sorted([*done, guilty]) == list(range(4096))
    assert deaths <= 6


def test_inputs_are_drawn_for_the_runs_of_a_piece_alone() -> None:
    asked = []

    def inputs(first: int, last: int) -> dict[str, Any]:
        asked.append((first, last))
        return {"x": np.arange(first, last, dtype=np.float64)}

    stand_in: Any = types.SimpleNamespace(inputs=inputs)
    assert inputs_of(stand_in, [1003, 1001])["x"].tolist() == [1003.0, 1001.0]
    assert inputs_of(stand_in, [])["x"].size == 0
    assert asked == [(1001, 1004), (0, 0)]


@pytest.mark.usefixtures("here")
def test_memory_does_not_grow_with_the_campaign(tmp_path: Path) -> None:
    import pyarrow

    carried_out(planned(runs=20_000, sampling="random"), tmp_path / "first")
    peaks = []
    for runs in (20_000, 80_000):
        tracemalloc.start()
        carried_out(planned(runs=runs, sampling="random"), tmp_path / str(runs))
        peaks.append(tracemalloc.get_traced_memory()[1])
        tracemalloc.stop()
    assert peaks[1] < 1.5 * peaks[0]
    assert pyarrow.total_allocated_bytes() < 1 << 20
