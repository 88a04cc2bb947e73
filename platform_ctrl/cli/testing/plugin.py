"""The fixture ``closed_loop``; pytest loads this module into every run, nothing heavy before a test uses a job."""

from __future__ import annotations

import inspect
import os
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pytest

if TYPE_CHECKING:
    from platform_ctrl.verification.verdict import JobResult


@pytest.fixture(scope="session")
def closed_loop() -> Callable[..., JobResult]:
    """Close the loops of a job: ``result = closed_loop("gyros.toml", baseline="accepted.json")``.

    Called with a job (path, dict or Job), with `controllers` if they exist already (path of a result.json, or
    control.StateSpace; without them every loop is designed), and with an accepted result.json as `baseline`, than which
    no value may be worse. Returns a JobResult, as of ``platform-ctrl check``. Relative paths start at the folder of the
    file that calls. The same job with the same controllers is computed once in a session.
    """
    done: dict[str, JobResult] = {}

    def closed(job: Any, controllers: Any = None, *, baseline: str | os.PathLike[str] | None = None) -> JobResult:
        __tracebackhide__ = True
        from platform_ctrl.campaign.store import source_hashes
        from platform_ctrl.design import loops
        from platform_ctrl.design.methods import read_job
        from platform_ctrl.job.job import Job
        from platform_ctrl.job.reading import job_hashes
        from platform_ctrl.verification import check_job
        from platform_ctrl.verification.controllers import outcomes_from, read_controllers

        folder = _folder_of_caller()
        if not isinstance(job, Job):
            job = read_job(job, folder=folder) if isinstance(job, Mapping) else read_job(folder / job)
        if isinstance(controllers, str | os.PathLike | Mapping):
            source = controllers if isinstance(controllers, Mapping) else folder / controllers
            controllers = read_controllers(source, job)
        key = job_hashes(job)["job"] + ("" if controllers is None else source_hashes(job, controllers)["controllers"])
        if key not in done:
            done[key] = check_job(job, loops(job) if controllers is None else outcomes_from(job, controllers))
        if baseline is not None:
            _assert_no_worse(done[key], folder / baseline)
        return done[key]

    return closed


def _assert_no_worse(result: JobResult, file: Path) -> None:
    __tracebackhide__ = True
    from platform_ctrl.cli.terminal import changes_text
    from platform_ctrl.verification.comparison import compare
    from platform_ctrl.verification.result_file import read_record, result_record

    comparison = compare(result_record(result, bounds=False), read_record(file), result.job.tolerance)
    if not comparison.passed:
        file = file.relative_to(Path.cwd()) if file.is_relative_to(Path.cwd()) else file
        raise AssertionError(changes_text(comparison, str(file)))


def _folder_of_caller() -> Path:
    """Return the folder of the file in which a fixture's function is called."""
    frame = inspect.currentframe()
    caller = frame.f_back.f_back if frame is not None and frame.f_back is not None else None
    file = None if caller is None else caller.f_globals.get("__file__")
    return Path(file).parent if file else Path()
