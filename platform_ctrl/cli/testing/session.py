"""The jobs of a test session: each is designed and checked once, whatever the number of its tests."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pytest

from platform_ctrl.analysis.run_metrics import RUN_METRICS
from platform_ctrl.cli.testing.assertions import assert_baseline, assert_met
from platform_ctrl.design import loops
from platform_ctrl.errors import PlatformCtrlError
from platform_ctrl.job.job import Job
from platform_ctrl.job.judging import CheckResult
from platform_ctrl.job.reading import read_job
from platform_ctrl.job.requirements import loop_requirements
from platform_ctrl.report.failures import margin_text
from platform_ctrl.verification import JobResult, check_job, read_controllers
from platform_ctrl.verification.baselines.comparison import Comparison
from platform_ctrl.verification.baselines.file import Update
from platform_ctrl.verification.controllers import outcomes_from
from platform_ctrl.verification.coupled import coupled_requirements

if TYPE_CHECKING:
    import control

Subject = tuple[str, str]


def requirements_of(job: Job) -> tuple[Subject, ...]:
    """Return subject and name of every requirement that the verdict on `job` will rest on, in its order."""
    out: list[Subject] = []
    for spec in job.loops:
        if spec.has_plants:
            out += [(spec.name, one.name) for one in loop_requirements(spec.limits)]
    out += [(subject, one.name) for subject, one in coupled_requirements(job)]
    out += [(manoeuvre.name, RUN_METRICS[key].name) for manoeuvre in job.manoeuvres for key in manoeuvre.limits]
    return tuple(out)


JobSource = Job | str | os.PathLike[str] | Mapping[str, Any]
ControllerSource = str | os.PathLike[str] | Mapping[str, Any] | Sequence["control.StateSpace"] | None
Recorder = Callable[[str, object], None]


class JobSession:
    """The jobs of a test session, and its options ``--update-baselines`` and ``--platform-plots``."""

    def __init__(self, update: bool, plots: Path | None) -> None:
        self.update, self.plots = update, plots
        self._notes: dict[Path, str] = {}
        self._done: dict[str, JobResult | PlatformCtrlError] = {}

    @property
    def notes(self) -> list[str]:
        """A line for every baseline that was written, or that could be."""
        return list(self._notes.values())

    def closed(self, source: JobSource, controllers: ControllerSource = None, folder: Path | None = None) -> JobResult:
        """Return the result of a job; the same job with the same controllers is computed once.

        Relative paths start at `folder`.
        """
        __tracebackhide__ = True
        start = folder or Path()
        job = _job(source, start)
        given = _controllers(controllers, job, start)
        from platform_ctrl.campaign.identity import source_hashes  # loads what only campaigns need
        from platform_ctrl.job.writing import job_hashes

        key = job_hashes(job)["job"] + ("" if given is None else source_hashes(job, given)["controllers"])
        if key not in self._done:
            try:
                self._done[key] = check_job(job, loops(job) if given is None else outcomes_from(job, given))
            except PlatformCtrlError as error:
                self._done[key] = error
        found = self._done[key]
        if isinstance(found, PlatformCtrlError):
            # Where in the library it was found out is of no use to who reads a failed test.
            raise found.with_traceback(None) from None
        return found

    def compare(self, result: JobResult, file: Path) -> Comparison | Update:
        """Compare a result with its baseline, or update that; note what is shown at the end."""
        __tracebackhide__ = True
        here = Path.cwd()
        file = file.relative_to(here) if file.is_relative_to(here) else file
        found = assert_baseline(result, file, update=self.update, plots=self.plots)
        if isinstance(found, Update):
            if found.written or file not in self._notes:
                self._notes[file] = found.summary
        else:
            counts = {state: len(found.of(state)) for state in ("better", "new")}
            if any(counts.values()):
                words = [f"{number} {state}" for state, number in counts.items() if number]
                self._notes[file] = f"{file}: {', '.join(words)}; pytest --update-baselines accepts this"
        return found


class JobUnderTest:
    """A job and its tests; `baseline` is the file of accepted values, None without comparison."""

    def __init__(
        self, session: JobSession, source: JobSource, controllers: ControllerSource, folder: Path, baseline: Path | None
    ) -> None:
        self.session, self.controllers, self.folder, self.baseline = session, controllers, folder, baseline
        # Read once: what the tests are called and what they measure belongs together.
        self.job = _job(source, folder)

    @property
    def result(self) -> JobResult:
        """The result of the job, designed and checked on first use."""
        __tracebackhide__ = True
        return self.session.closed(self.job, self.controllers, self.folder)

    def tests(self) -> tuple[RequirementTest | BaselineTest, ...]:
        """Return a test for every requirement, and one for the baseline."""
        own = [RequirementTest(self, test) for test in requirements_of(self.job)]
        return (*own, *([] if self.baseline is None else [BaselineTest(self, self.baseline)]))


class RequirementTest:
    """One requirement of a job as a test."""

    def __init__(self, job: JobUnderTest, test: Subject) -> None:
        self._job = job
        self.subject, self.name = test
        self.record: Recorder | None = None

    def __repr__(self) -> str:
        return f"<requirement {self.id!r} of {self._job.job.name!r}>"

    @property
    def id(self) -> str:
        """What the test is called."""
        return f"{self.subject}: {self.name}"

    @property
    def result(self) -> CheckResult:
        """The requirement with its value."""
        __tracebackhide__ = True
        results = self._job.result.requirements
        found = next((one for one in results if (one.subject, one.name) == (self.subject, self.name)), None)
        if found is None:
            raise AssertionError(f"{self._job.job.name}: {self.id}: cannot be checked: the closed loop is not stable")
        return found

    def assert_met(self) -> None:
        """Assert that it is met; the message has value, limit, margin and evidence."""
        __tracebackhide__ = True
        one = self.result
        if self.record is not None:
            for name in ("value", "limit", "unit", "sense"):
                self.record(name, getattr(one, name))
            self.record("margin", margin_text(one))
        assert_met(one)


class BaselineTest:
    """The baseline of a job as a test: no value is worse than accepted."""

    id = "baseline"

    def __init__(self, job: JobUnderTest, file: Path) -> None:
        self._job, self.file = job, file
        self.record: Recorder | None = None

    def __repr__(self) -> str:
        return f"<baseline {self.file.name!r} of {self._job.job.name!r}>"

    def assert_met(self) -> None:
        """Assert that nothing is worse; with ``--update-baselines`` accept what there is."""
        __tracebackhide__ = True
        self._job.session.compare(self._job.result, self.file)


def _job(source: JobSource, folder: Path) -> Job:
    """Return a job; relative paths start at `folder`, and so does the plant of a job given as a dict."""
    if isinstance(source, Job):
        return source
    return read_job(source, folder=folder) if isinstance(source, Mapping) else read_job(folder / source)


def _controllers(given: ControllerSource, job: Job, folder: Path) -> list[control.StateSpace] | None:
    if given is None:
        return None
    if isinstance(given, str | os.PathLike):
        return read_controllers(folder / given, job)
    return read_controllers(given, job) if isinstance(given, Mapping) else list(given)


class JobFile(pytest.File):
    """A job file; the plugin collects those that ``--platform-jobs`` names, or the command line itself."""

    jobs: JobSession

    def collect(self) -> Iterator[pytest.Item]:
        """Read the job and walk its requirements; nothing is designed yet."""
        baseline: Path | None = self.path.with_name(f"{self.path.stem}.baseline.json")
        if baseline is not None and not (self.jobs.update or baseline.exists()):
            baseline = None
        try:
            job = JobUnderTest(self.jobs, self.path, None, self.path.parent, baseline)
        except PlatformCtrlError as error:
            raise self.CollectError(str(error)) from None
        for test in job.tests():
            yield JobItem.from_parent(self, name=test.id, test=test)


class JobItem(pytest.Item):
    """One requirement of a job file, or its baseline."""

    def __init__(self, *, test: RequirementTest | BaselineTest, **keywords: object) -> None:
        super().__init__(**keywords)  # type: ignore[arg-type]  # pytest's own: name and parent
        self.test = test

    def runtest(self) -> None:
        """Design and check the job, unless another item did."""
        self.test.record = lambda name, item: self.user_properties.append((name, item))
        self.test.assert_met()

    def repr_failure(self, excinfo: pytest.ExceptionInfo[BaseException], style: object = None) -> str:
        """Return the message of a failure; the traceback only of unexpected errors."""
        if excinfo.errisinstance((AssertionError, PlatformCtrlError)):
            return str(excinfo.value)
        return str(super().repr_failure(excinfo))

    def reportinfo(self) -> tuple[Path, None, str]:
        """Return file and name for reports."""
        return self.path, None, self.name
