"""Campaigns on a Dask cluster: a scheduler and two workers, each a process of its own, on the loopback interface."""

from __future__ import annotations

import os
import signal
import socket
import subprocess
import sys
from collections.abc import Iterator
from functools import partial
from importlib import metadata
from pathlib import Path
from typing import Any

import pytest

import platform_ctrl as pc
from campaign_runs import invented_columns, planned, rows, undisturbed
from platform_ctrl.campaign import run_campaign
from platform_ctrl.errors import InputError

pytest.importorskip("pyarrow", reason="a campaign's table is Parquet")
pytest.importorskip("distributed", reason="the scheduler is Dask's: pip install 'platform_ctrl[cluster]'")

RUNS = 160


@pytest.fixture(scope="module")
def address(tmp_path_factory: pytest.TempPathFactory) -> Iterator[str]:
    """Of a scheduler with two workers that gives a task up when its worker dies once."""
    with socket.socket() as found:
        found.bind(("127.0.0.1", 0))
        where = f"tcp://127.0.0.1:{found.getsockname()[1]}"
    folder = tmp_path_factory.mktemp("cluster")
    path = os.pathsep.join([str(Path(__file__).parents[1] / "support"), str(Path(pc.__file__).parents[1])])
    environment = os.environ | {
        "PYTHONPATH": path,
        "DASK_DISTRIBUTED__SCHEDULER__ALLOWED_FAILURES": "0",
        "OPENBLAS_NUM_THREADS": "1",
    }
    alone = ["--no-dashboard", "--host", "127.0.0.1"]
    commands = [
        ["distributed.cli.dask_scheduler", "--port", where.rpartition(":")[2], *alone],
        ["distributed.cli.dask_worker", where, "--nworkers", "2", "--nthreads", "1", *alone],
    ]
    with (folder / "log").open("wb") as log:
        processes = [
            subprocess.Popen(
                [sys.executable, "-m", *command],
                cwd=folder,
                env=environment,
                stdout=log,
                stderr=log,
                start_new_session=True,
            )
            for command in commands
        ]
        try:
            yield where
        finally:
            for process in processes:
                if os.name == "posix":
                    os.killpg(process.pid, signal.SIGKILL)  # the workers' parents and the workers
                else:
                    process.terminate()
                process.wait()


def carried_out(folder: Path, address: str, runs: int = RUNS, **mishaps: Any) -> Any:
    simulate = partial(invented_columns, mishaps=mishaps)
    return run_campaign(planned(runs=runs), folder, scheduler=address, simulate=simulate)


def test_a_cluster_comes_to_the_table_of_one_process(tmp_path: Path, address: str) -> None:
    log = tmp_path / "log"
    found = carried_out(tmp_path / "cluster", address, seconds=0.005, log=str(log))
    assert rows(found) == undisturbed(planned(runs=RUNS))
    assert found.counts["completed"] == RUNS
    lines = [line.split() for line in log.read_text().splitlines()]
    assert sorted(int(run) for run, _ in lines) == list(range(RUNS))
    assert str(os.getpid()) not in {pid for _, pid in lines}


@pytest.mark.skipif(os.name != "posix", reason="SIGKILL")
def test_a_worker_that_is_killed_in_mid_campaign_costs_no_run(tmp_path: Path, address: str) -> None:
    log = tmp_path / "log"
    killed: list[int] = []

    def kill(done: int, amiss: int) -> None:
        if done > RUNS // 4 and not killed:
            killed.append(int(log.read_text().splitlines()[-1].split()[1]))
            os.kill(killed[0], signal.SIGKILL)

    simulate = partial(invented_columns, mishaps={"seconds": 0.005, "log": str(log)})
    found = run_campaign(planned(runs=RUNS), tmp_path / "cluster", scheduler=address, simulate=simulate, progress=kill)
    assert killed
    assert rows(found) == undisturbed(planned(runs=RUNS))


def test_a_worker_with_other_versions_is_refused(tmp_path: Path, address: str, monkeypatch: pytest.MonkeyPatch) -> None:
    known = metadata.version
    monkeypatch.setattr(metadata, "version", lambda name: "0.1" if name == "numba" else known(name))
    with pytest.raises(InputError, match=r"a worker of the cluster has numba [\d.]+, here it is 0.1"):
        carried_out(tmp_path, address)
