"""Job files as test files: every requirement is a test item."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import pytest

from platform_ctrl.errors import PlatformCtrlError
from platform_ctrl.testing.session import BaselineTest, JobSession, JobUnderTest, RequirementTest


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
            yield JobItem.from_parent(self, name=test.id, asked=test)


class JobItem(pytest.Item):
    """One requirement of a job file, or its baseline."""

    def __init__(self, *, asked: RequirementTest | BaselineTest, **keywords: object) -> None:
        super().__init__(**keywords)  # type: ignore[arg-type]  # pytest's own: name and parent
        self.asked = asked

    def runtest(self) -> None:
        """Design and check the job, unless another item did, and judge."""
        self.asked.record = lambda name, item: self.user_properties.append((name, item))
        self.asked.assert_met()

    def repr_failure(self, excinfo: pytest.ExceptionInfo[BaseException], style: object = None) -> str:
        """Return what failed, without the way there; an error that nobody raised on purpose with it."""
        if excinfo.errisinstance((AssertionError, PlatformCtrlError)):
            return str(excinfo.value)
        return str(super().repr_failure(excinfo))

    def reportinfo(self) -> tuple[Path, None, str]:
        """Return file and name for reports."""
        return self.path, None, self.name
