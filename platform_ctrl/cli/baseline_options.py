"""The options --baseline and --update-baseline: checked before the work, compared, drawn or updated after it."""

from __future__ import annotations

import os
import tempfile
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from platform_ctrl.errors import InputError

if TYPE_CHECKING:
    from platform_ctrl.verification import JobResult
    from platform_ctrl.verification.baselines.comparison import Change, Comparison
    from platform_ctrl.verification.baselines.record import Baseline


@dataclass(frozen=True)
class Outcome:
    """The result of a comparison: text for the terminal, plain data for JSON."""

    comparison: Comparison | None = None
    words: str = ""
    record: dict[str, Any] | None = None

    @property
    def passed(self) -> bool:
        """Whether nothing is worse than it was accepted."""
        return self.comparison is None or self.comparison.passed


@dataclass(frozen=True)
class BaselineOptions:
    """A baseline's file, and whether it is to be updated."""

    file: Path | None
    update: bool
    baseline: Baseline | None = None

    @classmethod
    def given(cls, file: Path | None, update: bool) -> BaselineOptions:
        """Check the options before the work."""
        if file is None:
            if update:
                raise InputError("--update-baseline: needs --baseline FILE, the file to write")
            return cls(None, False)
        from platform_ctrl.verification.baselines import read_baseline

        if update:
            writable("--baseline", file)
        elif not os.path.exists(file):
            raise InputError(f"{file}: there is no such file; --update-baseline writes it")
        return cls(file, update, read_baseline(file) if file.exists() else None)

    def outcome(self, result: JobResult) -> Outcome:
        """Compare and plot changes beside the file, or update the file."""
        if self.file is None:
            return Outcome()
        from platform_ctrl.verification.baselines import compare, update_baseline
        from platform_ctrl.verification.baselines.file import plot_beside, remove_plot

        plot = plot_beside(self.file)
        if self.update or self.baseline is None:
            made = update_baseline(result, self.file)
            remove_plot(plot)
            before = made.comparison.changes if made.comparison is not None else ()
            record = _record(self.file, before, passed=True, updated=made.written)
            return Outcome(None, f"baseline: {made.summary}", record)
        comparison = compare(result, self.baseline)
        from platform_ctrl.report.failures import failure_text, moved_text

        if comparison.passed:
            remove_plot(plot)
            record = _record(self.file, comparison.changes, passed=True, updated=False)
            return Outcome(comparison, f"baseline {moved_text(comparison, str(self.file))}", record)
        accept = "the same command with --update-baseline"
        words, drawn = failure_text(comparison, result.job.name, self.file, plot, accept)
        shown = None if drawn is None else str(drawn)
        record = _record(self.file, comparison.changes, passed=False, updated=False, plot=shown)
        return Outcome(comparison, f"baseline {words}", record)


def writable(option: str, file: Path, others: Iterable[Path | None] = ()) -> None:
    """Make the folder of a file and try to write there: before the work, not after it.

    None of `others` may be that file: the command reads or writes them.
    """
    try:
        if file.is_dir():
            raise InputError(f"{option} {file}: is a folder, but must be a file")
        if file.exists() and not file.is_file():
            raise InputError(f"{option} {file}: is a device or a pipe, but must be a file or not exist")
        expect_no_file_above(option, file)
        if file.resolve() in [other.resolve() for other in others if other is not None]:
            raise InputError(f"{option} {file}: the command reads or writes this file for something else; name another")
        file.parent.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryFile(dir=file.parent):
            pass
    except OSError as error:
        raise InputError(f"{option} {file}: cannot be written: {error.strerror or error}") from None


def expect_no_file_above(option: str, target: Path) -> None:
    """Make sure that nothing on the way to a target is a file."""
    blocked = next((part for part in target.parents if part.exists() and not part.is_dir()), None)
    if blocked is not None:
        raise InputError(f"{option} {target}: {blocked} is a file, but must be a folder or not exist")


def _record(
    file: Path, changes: tuple[Change, ...], *, passed: bool, updated: bool, plot: str | None = None
) -> dict[str, Any]:
    names = ("subject", "name", "unit", "sense", "before", "now", "allowed", "limit", "state")
    entries = [{name: getattr(change, name) for name in names} for change in changes]
    found = {"file": str(file), "passed": passed, "updated": updated, "plot": plot, "figures": entries}
    return {"baseline": found}
