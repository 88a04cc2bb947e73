"""The campaign engine: one row a run whatever happens on the way. The runs are quick ones, made up of the inputs."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import time
import tomllib
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import platform_ctrl as pc
from campaign_runs import JOB, invented_columns, planned, processes_here, rows, undisturbed
from platform_ctrl import platform_source, read_job
from platform_ctrl.campaign import plan, run_campaign
from platform_ctrl.errors import InputError

pytest.importorskip("pyarrow", reason="a campaign's table is Parquet")

RUNS = 120


def carried_out(made: Any, folder: Path, **options: Any) -> Any:
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
    monkeypatch.setattr("platform_ctrl.campaign.engine.processes_here", processes_here)


def stopped_halfway(made: Any, folder: Path) -> int:
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
    return sorted((folder / "campaign.parquet").glob("[0-9]*.parquet"))


def test_one_row_a_run_in_order_of_several_workers_as_without_any(tmp_path: Path) -> None:
    made = planned(runs=RUNS)
    found = carried_out(made, tmp_path, workers=2)
    assert rows(found) == undisturbed(made)
    assert sorted(path.name for path in tmp_path.iterdir()) == ["campaign.json", "campaign.parquet"]
    record = json.loads((tmp_path / "campaign.json").read_text())
    assert record == found.record
    assert record["counts"]["completed"] == record["runs"] == RUNS
    assert record["counts"]["passed"] + record["counts"]["not passed"] == RUNS
    assert not found.passed


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
    made = planned(runs=10)
    expected = undisturbed(made)
    # One worker more dies of another run, once: that costs nothing.
    mishaps(dies=[9], dies_once={"run": 7, "marker": str(tmp_path / "died")})
    found = carried_out(made, tmp_path / "out", workers=2)
    assert (tmp_path / "died").exists()
    [lost] = [row for row in rows(found) if row["ended"] != "completed"]
    assert lost["run"] == 9
    assert lost["ended"] == "not simulated: worker died"
    assert lost["rotor.11.spin"] == expected[9]["rotor.11.spin"]
    assert lost["angle"] is lost["passed"] is lost["stop_contacts"] is None
    assert rows(found)[:9] == expected[:9]
    assert found.reasons == {"not simulated: worker died": 1}
    assert not found.passed


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
    _, _, third, *_ = parts(tmp_path)
    third.write_bytes(third.read_bytes()[:100])
    (tmp_path / "campaign.parquet" / ".unfinished-999999999-left").mkdir()
    seen: list[int] = []
    found = carried_out(made, tmp_path, progress=lambda done, amiss: seen.append(done))
    assert seen[0] == kept - 8 > 0
    assert seen[-1] == RUNS
    assert rows(found) == undisturbed(made)
    assert not list((tmp_path / "campaign.parquet").glob(".*"))


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
    carried_out(planned(runs=16, sampling="latin-hypercube"), tmp_path)
    with pytest.raises(InputError, match=r"16 runs instead of 32 \(a Latin hypercube is made for one number of runs"):
        carried_out(planned(runs=32, sampling="latin-hypercube"), tmp_path)


@pytest.mark.usefixtures("here")
def test_another_campaign_is_refused_in_one_line_that_says_what_differs(tmp_path: Path) -> None:
    import control

    carried_out(planned(runs=8), tmp_path)
    names = {"inputs": ["alpha9"], "outputs": ["Q9"]}
    controller = control.StateSpace([[0.5]], [[1.0]], [[1.0]], [[0.0]], 5e-4, **names)
    turned = [manoeuvre | ({"rate": 0.3} if "rate" in manoeuvre else {}) for manoeuvre in JOB["manoeuvre"]]
    heavier = tomllib.loads(platform_source("three_gyro_platform"))
    heavier["rotor"][0]["axial_inertia"] *= 1.1
    other: dict[str, Any] = {
        "seed 7 instead of 8": planned(runs=8, seed=8),
        "sampling sobol instead of random": planned(runs=8, sampling="random"),
        "other controllers": plan(read_job(JOB), [controller], runs=8),
        "another job": plan(read_job(JOB | {"manoeuvre": turned}), (), runs=8),
        "another plant": plan(read_job(JOB | {"plant": heavier}), (), runs=8),
    }
    for words, made in other.items():
        with pytest.raises(InputError) as raised:
            carried_out(made, tmp_path)
        message = str(raised.value)
        assert f"campaign.json: the campaign there was begun with {words}; name another folder" in message
        assert "\n" not in message
    assert len(parts(tmp_path)) == 1
    found = carried_out(planned(runs=8, seed=8), tmp_path, restart=True)
    assert rows(found) == undisturbed(planned(runs=8, seed=8))


@pytest.mark.usefixtures("here")
def test_files_of_nobody_are_not_overwritten(tmp_path: Path) -> None:
    (tmp_path / "campaign.parquet").write_bytes(b"somebody's")
    with pytest.raises(InputError, match=r"has campaign.parquet but no campaign.json"):
        carried_out(planned(runs=8), tmp_path)
    (tmp_path / "campaign.json").write_text("{")
    with pytest.raises(InputError, match=r"campaign.json: .*cannot be read"):
        carried_out(planned(runs=8), tmp_path)
    assert (tmp_path / "campaign.parquet").read_bytes() == b"somebody's"
