"""What has moved since a baseline was accepted."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from typing import Any, Literal

import numpy as np

from platform_ctrl.common.signatures import check_arguments
from platform_ctrl.common.values import FloatArray, value
from platform_ctrl.errors import InputError
from platform_ctrl.job.judging import Sense
from platform_ctrl.plant.fields import finite_number
from platform_ctrl.plant.mistakes import given, one_line, suggestion
from platform_ctrl.verification import JobResult
from platform_ctrl.verification.baselines.figures import Figure, figures_of
from platform_ctrl.verification.baselines.record import AcceptedFigure, Baseline, LoopMatrices, loops_of

State = Literal["within", "worse", "better", "missing", "new"]


@value
class Change:
    """One figure, before and now.

    Attributes
    ----------
    subject, name, unit, sense
        Which; see `Figure`.
    before, now
        The accepted value and the measured one, in `unit`; None where there is none.
    allowed
        How far `now` may be worse than `before`, in `unit`.
    state
        ``"within"`` the tolerance, ``"worse"`` or ``"better"`` by more than it, ``"missing"``: accepted once and
        measured no more, ``"new"``: measured and not in the baseline.
    limit
        What the job asks, in `unit`; None where it asks nothing.
    """

    subject: str
    name: str
    unit: str
    sense: Sense
    before: float | None
    now: float | None
    allowed: float
    state: State
    limit: float | None = None

    @property
    def loss(self) -> float:
        """How much worse it has become, in `unit`: negative where it is better, infinite where it is no number now."""
        before, now = (math.inf if number is None else number for number in (self.before, self.now))
        if math.isfinite(before) and math.isfinite(now):
            return before - now if self.sense == "at least" else now - before
        if math.isfinite(before):
            return math.inf
        return -math.inf if math.isfinite(now) else 0.0

    @property
    def share(self) -> float:
        """The change as a share of the accepted value, with its sign; not a number where it cannot be said."""
        if self.before is None or self.now is None or not math.isfinite(self.before) or self.before == 0.0:
            return math.nan
        return (self.now - self.before) / abs(self.before)

    @property
    def of_tolerance(self) -> float:
        """The ratio of `loss` to `allowed`: above 1 where it is worse beyond its tolerance."""
        if self.loss == 0.0:
            return 0.0
        return self.loss / self.allowed if self.allowed > 0.0 else math.copysign(math.inf, self.loss)


@value
class Comparison:
    """A job held against its baseline.

    Attributes
    ----------
    changes
        One for every figure: those of the job in its order, then those that are missing.
    before, now
        The closed loops, by the same name where both have it.
    """

    changes: tuple[Change, ...]
    before: tuple[LoopMatrices, ...]
    now: tuple[LoopMatrices, ...]

    def of(self, *states: State) -> tuple[Change, ...]:
        """Return the changes in one of a few states.

        Parameters
        ----------
        *states
            As of `Change.state`.

        Returns
        -------
        tuple of Change
            In the order of `changes`.
        """
        return tuple(change for change in self.changes if change.state in states)

    @property
    def failed(self) -> tuple[Change, ...]:
        """What is worse beyond its tolerance, or no longer measured."""
        return self.of("worse", "missing")

    @property
    def passed(self) -> bool:
        """Whether nothing is worse and nothing missing; what is better or new is no failure."""
        return not self.failed

    @property
    def pairs(self) -> tuple[tuple[LoopMatrices, LoopMatrices], ...]:
        """The loops that both have, before and now."""
        found = {loop.loop: loop for loop in self.before}
        return tuple((found[loop.loop], loop) for loop in self.now if loop.loop in found)


@check_arguments
def compare(result: JobResult, baseline: Baseline) -> Comparison:
    """Hold the figures of a job against accepted ones.

    Parameters
    ----------
    result
        From `verification.check_job`.
    baseline
        From `read_baseline`, or `accepted`.

    Returns
    -------
    Comparison
        `Comparison.passed` unless a figure is worse beyond its tolerance, or no longer there. A figure that was a
        finite number and is none now (an unstable loop, a run that diverged) is worse whatever its tolerance.
    """
    known = {figure.key: figure for figure in baseline.figures}
    measured = figures_of(result)
    changes = [_change(figure, known.get(figure.key), baseline) for figure in measured]
    seen = {figure.key for figure in measured}
    changes += [_missing(figure) for figure in baseline.figures if figure.key not in seen]
    return Comparison(changes=tuple(changes), before=baseline.loops, now=loops_of(result))


def _change(figure: Figure, before: AcceptedFigure | None, baseline: Baseline) -> Change:
    def made(state: State, value: float | None, allowed: float) -> Change:
        return Change(
            subject=figure.subject,
            name=figure.name,
            unit=figure.unit,
            sense=figure.sense,
            before=value,
            now=figure.value,
            allowed=allowed,
            state=state,
            limit=figure.limit,
        )

    if before is None:
        return made("new", None, 0.0)
    tolerance = before.tolerance or baseline.tolerance
    allowed = tolerance.allowed(before.value) if math.isfinite(before.value) else 0.0
    loss = made("within", before.value, allowed).loss
    # A figure at its tolerance is within it, whatever the last bit says.
    edge = allowed * (1.0 + 1e-9) + 1e-9 * abs(before.value) if math.isfinite(before.value) else 0.0
    return made("worse" if loss > edge else "better" if loss < -edge else "within", before.value, allowed)


def _missing(figure: AcceptedFigure) -> Change:
    return Change(
        subject=figure.subject,
        name=figure.name,
        unit=figure.unit,
        sense=figure.sense,
        before=figure.value,
        now=None,
        allowed=0.0,
        state="missing",
    )


class Table:
    """A table of the file, and where it stands."""

    def __init__(self, where: str, data: object, known: Sequence[str]) -> None:
        if not isinstance(data, Mapping):
            raise InputError(f"{where} must be a table, got {given(data)}")
        self.where, self.data = where, data
        for key in data:
            if key not in known:
                raise self.mistake(f"unknown key {given(key)}; {suggestion(str(key), known)}")

    def mistake(self, text: str) -> InputError:
        """Return the error that says `text` of this table."""
        return InputError(one_line(f"{self.where}: {text}"))

    def item(self, key: str, expected: str) -> Any:
        """Return what stands under `key`."""
        if key not in self.data:
            raise self.mistake(f'the key "{key}" is missing; it must be {expected}')
        return self.data[key]

    def text(self, key: str, expected: str, *, empty: bool = False) -> str:
        """Return a printable text."""
        item = self.item(key, expected)
        if not isinstance(item, str) or not item.isprintable() or not (item.strip() or empty):
            raise self.mistake(f"{key} must be {expected}, got {given(item)}")
        return item

    def one_of(self, key: str, options: Sequence[str]) -> str:
        """Return one of a few words."""
        expected = " or ".join(f'"{option}"' for option in options)
        item = self.text(key, expected)
        if item not in options:
            raise self.mistake(f"{key} must be {expected}, got {given(item)}")
        return item

    def number(self, key: str, expected: str) -> float:
        """Return a finite number."""
        out = finite_number(self.item(key, expected))
        if out is None:
            raise self.mistake(f"{key} must be {expected}, got {given(self.data[key])}")
        return out

    def positive(self, key: str, expected: str) -> float:
        """Return a number >= 0."""
        out = self.number(key, expected)
        if out < 0.0:
            raise self.mistake(f"{key} must be {expected}, got {given(self.data[key])}")
        return out

    def names(self, key: str) -> tuple[str, ...]:
        """Return signal names, each once."""
        item = self.item(key, "a list of signal names")
        if (
            not isinstance(item, list)
            or not item
            or not all(isinstance(name, str) and name for name in item)
            or len(set(item)) < len(item)
        ):
            raise self.mistake(f"{key} must be a list of signal names, each once, got {given(item)}")
        return tuple(item)

    def matrix(self, key: str, rows: int, columns: int) -> FloatArray:
        """Return a matrix of a known size."""
        item = self.item(key, "a matrix as a list of rows")
        out = np.zeros((rows, columns))
        if rows * columns == 0 and isinstance(item, list) and all(row == [] for row in item):
            return out
        if not isinstance(item, list) or len(item) != rows:
            raise self.mistake(f"{key} must be a {rows} x {columns} matrix as a list of rows, got {given(item)}")
        for i, row in enumerate(item):
            numbers = [finite_number(entry) for entry in row] if isinstance(row, list) else []
            if len(numbers) != columns or any(number is None for number in numbers):
                raise self.mistake(f"{key}: row {i + 1} must be {columns} finite numbers, got {given(row)}")
            out[i] = np.array(numbers, dtype=np.float64)
        return out

    def tables(self, key: str, expected: str, known: Sequence[str]) -> Iterator[Table]:
        """Walk a list of tables."""
        item = self.item(key, expected)
        if not isinstance(item, list):
            raise self.mistake(f"{key} must be {expected}, got {given(item)}")
        for number, entry in enumerate(item, 1):
            name = entry.get("name", entry.get("loop")) if isinstance(entry, Mapping) else None
            title = f" {given(name)}" if isinstance(name, str) else ""
            yield Table(f"{self.where}: {key} {number}{title}", entry, known)
