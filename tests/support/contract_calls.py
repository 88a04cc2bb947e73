"""Calls of public names with one wrong argument each, run in a process of its own: `python contract_calls.py NAME ...`.

A line of JSON a call goes to the descriptor that the environment's CONTRACT_REPORT names: one before it, and one with
what came of it. Who reads them sees which call ended the process, and starts another one behind it.
"""

from __future__ import annotations

import dataclasses
import functools
import inspect
import itertools
import json
import os
import resource
import signal
import sys
import traceback
import warnings
import zlib
from collections.abc import Callable, Iterator, Mapping
from types import FrameType
from typing import Any, NamedTuple, NoReturn

import numpy as np

from contract_cases import FUNCTIONS, INSTANCES, METHODS, STRUCTURES, model, one, platform
from platform_ctrl.errors import PlatformCtrlError
from public_modules import described, methods, public

# CPU time that a call may take, s, what it compiles included, and memory that a process may have, bytes.
SECONDS, MEMORY = 100, 12 << 30


class Case(NamedTuple):
    """What is called, and its valid arguments, made anew by each call."""

    name: str
    function: Callable[..., Any]
    arguments: dict[str, Callable[[], Any]]
    fields: bool = False


def short_name(path: str) -> str:
    """Return a public name with the last part of its module's name."""
    return ".".join(path.removeprefix("platform_ctrl.").split(".")[-2:])


def cases() -> dict[str, Case]:
    """Return every public function, constructor and method that takes an argument, with its valid ones.

    Raises
    ------
    KeyError
        A public name has no entry in `contract_cases`.
    """
    found: dict[str, Case] = {}
    for path, item in public().items():
        name = short_name(path)
        if name in UNTAKEN or (inspect.isclass(item) and issubclass(item, BaseException)):
            continue
        if name in FUNCTIONS or not inspect.isclass(item):
            found[name] = Case(name, item, FUNCTIONS[name])
        elif fields := _fields(item):
            made = {field: functools.partial(_field, name, field) for field in fields}
            found[name] = Case(name, item, made, fields=True)
    for path, item in described().items():
        name = short_name(path)
        for method, member in methods(item) if inspect.isclass(item) else ():
            label = f"{name}.{method}"
            if isinstance(member, property) or not taken(member) or method in STRUCTURES:
                continue
            if path in public() or label in METHODS:
                found[label] = Case(label, functools.partial(_method, name, method), METHODS[label])
    return found


def taken(function: Callable[..., Any]) -> dict[str, inspect.Parameter]:
    """Return the parameters of a function that have names of their own."""
    found = inspect.signature(function).parameters
    return {
        k: p for k, p in found.items() if k not in ("self", "cls") and p.kind not in (p.VAR_KEYWORD, p.VAR_POSITIONAL)
    }


def _fields(cls: type) -> tuple[str, ...]:
    if dataclasses.is_dataclass(cls):
        return tuple(field.name for field in dataclasses.fields(cls) if field.init)
    return tuple(getattr(cls, "_fields", ()))


# What takes any number of figures, and what takes nothing.
UNTAKEN = ("figures.show", "shipped_models")


def _field(name: str, field: str) -> Any:
    return getattr(instance(name), field)


@functools.cache
def instance(name: str) -> Any:
    """Return the value of a class that is kept."""
    return INSTANCES[name]()


def _method(cls: str, method: str, /, **given: Any) -> Any:
    on = instance(f"{cls}.{method}" if f"{cls}.{method}" in INSTANCES else cls)
    return getattr(on, method)(**given)


@functools.cache
def _classes() -> dict[str, type]:
    return {short_name(path): item for path, item in described().items() if inspect.isclass(item)}


def signature(case: Case) -> dict[str, inspect.Parameter]:
    """Return the parameters of what is called."""
    function = case.function
    if isinstance(function, functools.partial):
        cls, method = function.args
        function = getattr(_classes()[cls], method)
    return taken(function)


class Thing:
    """An object that is nothing of what anybody expects."""


def foreign() -> dict[str, Callable[[], Any]]:
    """Return values of wrong kinds that fit no argument, or hardly one."""
    import control

    nonlinear = functools.partial(
        control.NonlinearIOSystem,
        lambda t, x, u, _: u - x**3,
        lambda t, x, u, _: x,
        inputs=1,
        outputs=1,
        states=1,
    )
    return {
        "None": lambda: None,
        "text": lambda: "no such name",
        "bytes": lambda: b"bytes",
        "texts": lambda: ["a", "b"],
        "mapping": lambda: {"a": 1},
        "objects": lambda: np.array([Thing(), None], dtype=object),
        "thing": Thing,
        "kind": lambda: Thing,
        "call": lambda: lambda: None,
        "True": lambda: True,
        "1j": lambda: 1j,
        "nan": lambda: float("nan"),
        "inf": lambda: float("inf"),
        "-1": lambda: -1,
        "-10^30": lambda: -(10**30),
        "10^30": lambda: 10**30,
        "10^400": lambda: 10**400,
        "2.5": lambda: 2.5,
        "[]": list,
        "empty": lambda: np.zeros(0),
        "(0, 0)": lambda: np.zeros((0, 0)),
        "0-d": lambda: np.array(1.0),
        "1-d": lambda: np.ones(7),
        "3-d": lambda: np.ones((2, 3, 4)),
        "ragged": lambda: [[1.0, 2.0], [3.0]],
        "nested": lambda: [[[[[None]]]]],
        "tf": lambda: control.tf([1.0], [1.0, 1.0]),
        "frd": lambda: control.FRD(np.ones(3, dtype=complex), np.array([1.0, 2.0, 3.0])),
        "nonlinear": nonlinear,
        "sampled": lambda: one(0.37),
        "unsampled": lambda: one(True),  # type: ignore[arg-type]
        "static": lambda: control.ss([], [], [], [[1.0]]),
        "no outputs": lambda: one()[[], :],
        "platform": platform,
        "model": model,
    }


def bent(base: Any) -> Iterator[tuple[str, Callable[[], Any]]]:
    """Yield what a valid array becomes: of other shapes, other types, and with a number that is none."""
    try:
        array = np.asarray(base)
    except Exception:
        return
    if array.dtype.kind not in "iufc":
        return
    if array.ndim == 0:
        yield "as an array of one", lambda: array[None]
        return
    yield "an axis more", lambda: array[None]
    yield "transposed", lambda: array.T
    for axis in range(array.ndim):
        if array.size:
            yield f"axis {axis} longer", lambda axis=axis: np.concatenate([array, array.take([0], axis)], axis)
        yield f"axis {axis} shorter", lambda axis=axis: array.take(range(array.shape[axis] - 1), axis)
    yield "of text", lambda: array.astype(str)
    yield "of objects", lambda: np.where(np.ones(array.shape, bool), Thing(), None)
    yield "of bool", lambda: array.astype(bool)
    yield "complex", lambda: array + 1j
    for label, number in (("with NaN", np.nan), ("with inf", np.inf), ("with 1e308", 1e308)):
        if array.size:
            yield label, functools.partial(_with, array, number)


def _with(array: Any, number: float) -> Any:
    out = np.array(array, dtype=np.result_type(array, float))
    out.flat[-1] = number
    return out


class Call(NamedTuple):
    """One argument replaced."""

    case: str
    parameter: str
    label: str
    wrong: Callable[[], Any]


def calls(case: Case) -> Iterator[Call]:
    """Yield all calls of a case."""
    for name in signature(case):
        for label, wrong in foreign().items():
            yield Call(case.name, name, label, wrong)
        if name in case.arguments:
            yield from (Call(case.name, name, label, wrong) for label, wrong in bent(case.arguments[name]()))


# What fits no argument at all, and what fits by its kind and hardly by its shape or size.
SHAPES = (
    "an axis more;transposed;axis 0 longer;axis 0 shorter;axis 1 longer;axis 1 shorter;as an array of one;with 1e308;"
    "-1;-10^30;10^30;10^400;inf;[];empty;(0, 0);0-d;1-d;3-d;ragged;complex;of text;of bool;sampled;static;no outputs"
)
FAST = "bytes;thing;objects;nonlinear;nested;of objects;with NaN"


class Outcome(NamedTuple):
    """What came of a call."""

    case: str
    parameter: str
    label: str
    what: str
    said: str


class Hung(BaseException):
    """A call took longer than it may."""


def _alarm(_: int, __: FrameType | None) -> NoReturn:
    raise Hung


def nan_in(answer: Any, depth: int = 0) -> bool:
    """Whether an answer holds NaN."""
    if isinstance(answer, float | complex | np.ndarray | np.generic):
        array = np.asarray(answer)
        return array.dtype.kind in "fc" and bool(np.isnan(array).any())
    if depth > 3 or isinstance(answer, str | bytes):
        return False
    if isinstance(answer, tuple | list):
        return any(nan_in(item, depth + 1) for item in answer[:50])
    if isinstance(answer, Mapping):
        return any(nan_in(item, depth + 1) for item in list(answer.values())[:50])
    if hasattr(answer, "__dataclass_fields__"):
        return any(nan_in(getattr(answer, name, None), depth + 1) for name in answer.__dataclass_fields__)
    return (
        nan_in([answer.A, answer.B, answer.C, answer.D])
        if hasattr(answer, "nstates") and hasattr(answer, "A")
        else False
    )


def outcome(case: Case, parameter: str, wrong: Callable[[], Any]) -> tuple[str, str]:
    """Return what comes of a call: "refused", "answer", "nan", "hung", or "raised" with the line that says it."""
    try:
        given = {name: make() for name, make in case.arguments.items()} | {parameter: wrong()}
    except Exception as error:
        return "unmade", repr(error)
    signal.setitimer(signal.ITIMER_PROF, SECONDS)
    try:
        with warnings.catch_warnings(), np.errstate(all="ignore"):
            warnings.simplefilter("ignore")
            answer = case.function(**given)
            if inspect.isgenerator(answer):
                answer = list(answer)
    except PlatformCtrlError as error:
        text = str(error)
        clear = len(text) > 10 and "\n" not in text.rstrip() and "object at 0x" not in text
        return ("refused" if clear else "unclear"), text
    except Hung:
        return "hung", ""
    except BaseException as error:
        if isinstance(error, AssertionError) and case.name.startswith("testing."):
            return "refused", str(error)
        frames = [frame for frame in traceback.extract_tb(error.__traceback__) if "platform_ctrl" in frame.filename]
        where = f"{frames[-1].filename.rpartition('platform_ctrl/')[2]}:{frames[-1].lineno}" if frames else ""
        return "raised", f"{type(error).__name__}: {' '.join(str(error).split())[:150]} [{where}]"
    finally:
        signal.setitimer(signal.ITIMER_PROF, 0)
    return ("nan" if nan_in(answer) else "answer"), type(answer).__name__


def chosen(names: list[str], labels: str, count: int) -> Iterator[tuple[Case, Call]]:
    """Yield `count` calls of each case that scatter over its parameters; those of the `labels` where there are any."""
    every, among = cases(), labels.split(";")
    for name in names:
        found = [call for call in calls(every[name]) if not labels or call.label in among]
        for call in sorted(found, key=lambda call: zlib.crc32(" ".join(call[:3]).encode()))[:count]:
            yield every[name], call


def main(names: list[str], labels: str, count: int, skip: int) -> None:
    """Run the chosen calls but the first `skip`."""
    report = os.fdopen(int(os.environ["CONTRACT_REPORT"]), "w", buffering=1)
    signal.signal(signal.SIGPROF, _alarm)
    resource.setrlimit(resource.RLIMIT_AS, (MEMORY, MEMORY))
    for case, call in itertools.islice(chosen(names, labels, count), skip, None):
        used = sum(resource.getrusage(resource.RUSAGE_SELF)[:2])
        resource.setrlimit(resource.RLIMIT_CPU, (int(used) + 4 * SECONDS, resource.RLIM_INFINITY))
        report.write(json.dumps(call[:3]) + "\n")
        report.write(json.dumps([*call[:3], *outcome(case, call.parameter, call.wrong)]) + "\n")


if __name__ == "__main__":
    main(json.loads(sys.argv[1]), sys.argv[2], int(sys.argv[3]), int(sys.argv[4]))
