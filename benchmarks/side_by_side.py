"""Timing ours beside theirs: in one process, taking turns, after both gave the same answer.

A section of `benchmarks/engine.py` is a function that yields comparisons:

    def frequency_response() -> Iterator[Comparison]:
        yield Comparison(
            name="16 states, 1,000 frequencies",
            ours=lambda: analysis.frequency_response(system, w),
            theirs={"control": lambda: system(1j * w)},
            target=40.0,
            check=close(1e-9),
        )

    SECTIONS = {"frequency-response": frequency_response}

This module imports nothing that has threads: `engine.py` pins those before anything else is loaded.
"""

from __future__ import annotations

import gc
import importlib.metadata
import platform
import statistics
import time
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Literal

# A timing shorter than this is that of several calls, s.
SHORTEST = 5e-3

Section = Callable[[], Iterable["Comparison"]]


class DisagreementError(Exception):
    """The sides that are compared gave different answers: their times mean nothing."""


def agreed(ours: Any, theirs: Mapping[str, Any]) -> str:
    """Find nothing to compare: for sides whose answers are judged elsewhere."""
    del ours, theirs
    return ""


@dataclass(frozen=True, kw_only=True)
class Comparison:
    """One figure: how many times as fast ours is as theirs.

    Attributes
    ----------
    name
        What is computed, with its size.
    ours
        Our side, called without arguments.
    theirs
        The others by name, each called without arguments. An empty mapping gives a time without a ratio.
    target
        How many times as fast ours should be as `against`; None where nothing was promised.
    against
        The name in `theirs` that the target speaks of; default the fastest of them.
    check
        Called with our answer and theirs by name before anything is timed: returns a few words on how they agree
        (for instance the deviation), or raises `DisagreementError`. One of `theirs` that raises is shown with what it
        said; it has no answer here and is not timed.
    unit
        ``"ms"``: time a call. Anything else, such as ``"steps/s"``: `work` of them in a call over its time.
    work, their_work
        Units of work in a call of ours, and of those of theirs that do another amount than ours. Ratios are then of
        rates.
    clock
        ``"wall"``, or ``"cpu"``: seconds of the processor in all threads.
    rounds
        At most so many, where one takes long.
    note
        Called after the timing: a line below the row, for what a ratio does not tell.
    """

    name: str
    ours: Callable[[], Any]
    theirs: Mapping[str, Callable[[], Any]]
    target: float | None = None
    against: str | None = None
    check: Callable[[Any, Mapping[str, Any]], str] = agreed
    unit: str = "ms"
    work: float = 1.0
    their_work: Mapping[str, float] = field(default_factory=dict)
    clock: Literal["wall", "cpu"] = "wall"
    rounds: int = 1000
    note: Callable[[], str] | None = None


@dataclass(frozen=True, kw_only=True)
class Outcome:
    """What a comparison came to: medians of seconds a unit of work, and of the ratios within each round."""

    comparison: Comparison
    agreement: str
    ours: float
    theirs: dict[str, float]
    ratios: dict[str, float]
    failures: dict[str, str]
    note: str

    @property
    def judged(self) -> float | None:
        """The ratio that the target speaks of."""
        if self.comparison.against is not None:
            return self.ratios.get(self.comparison.against)
        return min(self.ratios.values(), default=None)

    @property
    def reached(self) -> bool | None:
        """Whether the target is reached; None without a target or without anything to compare with."""
        judged, target = self.judged, self.comparison.target
        return None if judged is None or target is None else judged >= target


def measured(comparison: Comparison, rounds: int) -> Outcome:
    """Return what a comparison comes to in `rounds` rounds in which all sides take turns.

    Raises
    ------
    DisagreementError
        The sides give different answers.
    """
    ours = comparison.ours()  # also compiles and fills caches
    answers, failures = {}, {}
    for name, call in comparison.theirs.items():
        try:
            answers[name] = call()
        except Exception as error:  # whatever another library raises is its answer
            failures[name] = f"{type(error).__name__}: {error}".splitlines()[0]
    agreement = comparison.check(ours, answers)
    del ours
    sides = {"": comparison.ours, **{name: comparison.theirs[name] for name in answers}}
    answers.clear()
    clock = time.perf_counter if comparison.clock == "wall" else time.process_time
    calls = {name: _calls(call, clock) for name, call in sides.items()}
    work = {name: comparison.their_work.get(name, comparison.work) for name in sides}
    taken: dict[str, list[float]] = {name: [] for name in sides}
    gc.collect()
    gc.disable()
    try:
        for k in range(min(rounds, comparison.rounds)):
            order = list(sides)
            for name in order if k % 2 == 0 else reversed(order):
                began = clock()
                for _ in range(calls[name]):
                    sides[name]()
                taken[name].append((clock() - began) / (calls[name] * work[name]))
    finally:
        gc.enable()
    return Outcome(
        comparison=comparison,
        agreement=agreement,
        ours=statistics.median(taken[""]),
        theirs={name: statistics.median(taken[name]) for name in sides if name},
        ratios={
            # Within a round: a machine that slows down half-way slows both.
            name: statistics.median(b / a for a, b in zip(taken[""], taken[name], strict=True))
            for name in sides
            if name
        },
        failures=failures,
        note="" if comparison.note is None else comparison.note(),
    )


def _calls(call: Callable[[], Any], clock: Callable[[], float]) -> int:
    """Return how many calls make a timing that is long enough."""
    began = clock()
    call()
    return max(1, min(1000, int(SHORTEST / max(clock() - began, 1e-7))))


def close(tolerance: float, of: Callable[[Any], Any] | None = None) -> Callable[[Any, Mapping[str, Any]], str]:
    """Return a check that arrays agree to `tolerance` times the largest entry; `of` takes them out of the answers.

    Axes of length one do not count.
    """

    def check(ours: Any, theirs: Mapping[str, Any]) -> str:
        import numpy as np

        mine = np.squeeze(np.asarray(ours if of is None else of(ours)))
        words = []
        for name, answer in theirs.items():
            other = np.squeeze(np.asarray(answer if of is None else of(answer)))
            if other.shape != mine.shape:
                raise DisagreementError(f"{name}: shape {other.shape}, ours {mine.shape}")
            deviation = float(np.abs(mine - other).max(initial=0.0) / (np.abs(mine).max(initial=0.0) or 1.0))
            if not deviation <= tolerance:
                raise DisagreementError(f"{name}: differs by {deviation:.1e}, expected at most {tolerance:.0e}")
            words.append(f"{deviation:.0e}")
        return ", ".join(words)

    return check


def versions(names: Iterable[str]) -> str:
    """Return Python, the named packages and the processor in one line; nothing that names the machine."""
    words = [f"Python {platform.python_version()}"]
    for name in names:
        try:
            words.append(f"{name} {importlib.metadata.version(name)}")
        except importlib.metadata.PackageNotFoundError:
            words.append(f"{name} absent")
    return ", ".join([*words, processor()])


def processor() -> str:
    """Return the processor's model as its maker calls it."""
    try:
        for line in Path("/proc/cpuinfo").read_text(encoding="utf-8").splitlines():
            key, _, value = line.partition(":")
            if key.strip() == "model name":
                return value.strip()
    except OSError:
        pass
    return platform.processor() or platform.machine()


def quantity(seconds: float, unit: str) -> str:
    """Return seconds a unit of work as a time (``"ms"``) or as a rate."""
    return f"{1e3 * seconds:.3g} ms" if unit == "ms" else f"{1.0 / seconds:,.0f} {unit}"
