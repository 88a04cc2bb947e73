"""Judging the arguments of Python calls: shape, finiteness, names. One line says what was given and expected."""

from __future__ import annotations

import difflib
import math
from collections.abc import Iterable, Mapping, Sequence
from numbers import Real
from typing import TypeVar

import numpy as np
from numpy.typing import ArrayLike, NDArray

from platform_ctrl.errors import ArgumentError

T = TypeVar("T")

# Characters of a given value that a message shows.
LONGEST = 60
# No whole number beyond what compiled code and random generators take.
LARGEST = 2**63


def short(given: object) -> str:
    """Return an argument as a line that fits a message."""
    text = " ".join(repr(given).split())
    if len(text) <= LONGEST and " at 0x" not in text:
        return text
    if isinstance(given, np.ndarray):
        return f"an array of shape {given.shape}{'' if given.dtype.kind in 'biufc' else ' of ' + given.dtype.name}"
    if " at 0x" in text or not isinstance(given, str | bytes | list | tuple | Mapping):
        return f"the class {given.__name__}" if isinstance(given, type) else f"a {type(given).__name__}"
    return text[: LONGEST - 3] + "..."


# Where a value comes from that users often replace by its name or by the value before it.
_SOURCES = {"Platform": ", for example from read_platform", "LinearModel": ", from linearise(platform)"}


def instance(name: str, given: object, kind: type[T]) -> T:
    """Return `given`, which must be of a class."""
    if isinstance(given, kind):
        return given
    words = f"a{'n' if kind.__name__[0] in 'AEIOU' else ''} {kind.__name__}{_SOURCES.get(kind.__name__, '')}"
    raise ArgumentError(f"{name} must be {words}, got {short(given)}")


def real_array(
    name: str, given: ArrayLike | None, shape: tuple[int, ...], default: float | None = None
) -> NDArray[np.float64]:
    """Return `given` as a finite float64 array of `shape`."""
    if given is None and default is not None:
        return np.full(shape, default)
    array = np.array(real_numbers(name, given, f" of shape {shape}"))
    if array.shape != shape:
        raise ArgumentError(f"{name} must have shape {shape}, got {array.shape}")
    if not np.all(np.isfinite(array)):
        raise ArgumentError(f"{name} must be finite numbers of shape {shape}, got one that is not")
    return array


def unit_quaternions(given: ArrayLike | None, shape: tuple[int, ...]) -> NDArray[np.float64]:
    """Return unit quaternions w, x, y, z of `shape`, the identity if `given` is None."""
    if given is None:
        return np.array(np.broadcast_to([1.0, 0.0, 0.0, 0.0], shape))
    attitude = real_array("attitude", given, shape)
    norm = np.linalg.norm(attitude, axis=-1, keepdims=True)
    if np.abs(norm - 1.0).max(initial=0.0) > 1e-6:
        worst = norm.flat[np.abs(norm - 1.0).argmax()]
        raise ArgumentError(f"attitude must be a unit quaternion w, x, y, z, got a norm of {worst:.6g}")
    return np.asarray(attitude / norm)


def real_numbers(name: str, given: object, more: str = "") -> NDArray[np.float64]:
    """Return `given` as a float64 array of any shape, `given` itself if it is one; finite or not."""
    try:
        array = np.asarray(given)
        if array.dtype.kind in "iuf":
            return array.astype(np.float64, copy=False)
    except Exception:  # what numpy calls to read an object of another library may raise anything
        pass
    raise ArgumentError(f"{name} must be real numbers{more}, got {short(given)}")


def number(name: str, given: object, finite: bool = True) -> float:
    """Return a (finite) float of a Python or numpy number or an array without axes, not of a complex one or a bool."""
    real = isinstance(given, Real) and not isinstance(given, bool)
    if not real and not (isinstance(given, np.ndarray) and given.ndim == 0 and given.dtype.kind in "iuf"):
        raise ArgumentError(f"{name} must be a number, got {short(given)}")
    try:
        out = float(given)  # type: ignore[arg-type]
    except OverflowError:
        raise ArgumentError(f"{name} must be a finite number, got one too large for floating point") from None
    if finite and not math.isfinite(out):
        raise ArgumentError(f"{name} must be a finite number, got {given!r}")
    return out


def positive(name: str, given: float, zero: bool = False) -> float:
    """Return a finite float above zero (or, with `zero`, not below it)."""
    out = number(name, given, finite=False)
    if not math.isfinite(out) or out < 0.0 or (out == 0.0 and not zero):
        raise ArgumentError(f"{name} must be a finite number {'>=' if zero else '>'} 0, got {given!r}")
    return out


def within(name: str, given: float, least: float, most: float) -> float:
    """Return a float from `least` to `most`."""
    out = number(name, given)
    if not least <= out <= most:
        raise ArgumentError(f"{name} must be a number from {least:g} to {most:g}, got {out:g}")
    return out


def not_negative(name: str, given: ArrayLike, size: int) -> NDArray[np.float64]:
    """Return `size` finite numbers >= 0, all alike where one is given."""
    array = real_numbers(name, given)
    if array.shape not in ((), (size,)) or not np.isfinite(array).all() or (array < 0.0).any():
        raise ArgumentError(f"{name} must be {size} finite numbers >= 0, or one for all, got {short(given)}")
    return np.full(size, array)


def whole(name: str, given: object, least: int, most: int | None = None) -> int:
    """Return a whole number from `least` to `most`; None: what 64 bits hold."""
    number = int(given) if isinstance(given, int | np.integer) and not isinstance(given, bool) else None
    if number is None or not least <= number <= (LARGEST - 1 if most is None else most):
        expected = f">= {least}" if most is None else f"from {least} to {most}"
        raise ArgumentError(f"{name} must be a whole number {expected}, got {short(given)}")
    return number


def one_of(name: str, given: object, options: Sequence[str]) -> None:
    """Judge a word that selects something."""
    if not isinstance(given, str) or given not in options:
        *first, last = map(repr, options)
        raise ArgumentError(f"{name} must be {', '.join(first)} or {last}, got {short(given)}")


def known_name(kind: str, given: str, known: Sequence[str]) -> int:
    """Return the index of `given` in `known`."""
    if given in known:
        return list(known).index(given)
    near = nearest(str(given), known)
    hint = "" if near is None else f"; did you mean {near!r}?"
    raise ArgumentError(f"{kind} must be one of {', '.join(map(repr, known)) or 'none at all'}, got {given!r}{hint}")


def known_names(kind: str, given: Sequence[str], known: Sequence[str]) -> list[int]:
    """Return the indices of names in `known`, in its order, each once."""
    if isinstance(given, str):
        raise ArgumentError(f"{kind} must be a sequence of names, such as ({given!r},), got the string {given!r}")
    try:
        names = list(given)
    except TypeError:
        raise ArgumentError(f"{kind} must be a sequence of names, which are strings, got {short(given)}") from None
    for name in names:
        if not isinstance(name, str):
            raise ArgumentError(
                f"{kind} must be a sequence of names, such as {known[:1]}, got {short(name)} among them"
            )
    return sorted({known_name(kind, name, known) for name in names})


def distinct(kind: str, names: Sequence[str]) -> list[str]:
    """Return the names of signals as a list, each of its own."""
    for name in names:
        if list(names).count(name) > 1:
            raise ArgumentError(
                f"{kind}: {name!r} would name two of them; give angles and torquers different names in the plant"
            )
    return list(names)


# Other words for what plants, jobs and their keys are made of.
_MEANT = {
    **dict.fromkeys(("actuator", "torque_motor"), "torquer"),
    **dict.fromkeys(("gyro", "rate_gyro", "gyroscope", "tachometer", "imu"), "rate_sensor"),
    **dict.fromkeys(("encoder", "resolver", "potentiometer"), "angle_sensor"),
    **dict.fromkeys(("tracker", "star_sensor", "star_tracker"), "attitude_sensor"),
    **dict.fromkeys(("wheel", "flywheel", "reaction_wheel"), "rotor"),
    **dict.fromkeys(("joint", "hinge", "frame", "ring", "link", "body"), "gimbal"),
    **dict.fromkeys(("bearing", "damper", "damping"), "friction"),
    **dict.fromkeys(("cable", "stiffness"), "spring"),
    **dict.fromkeys(("imbalance", "mass", "weight"), "unbalance"),
    **dict.fromkeys(("camera", "los", "boresight"), "line_of_sight"),
    **dict.fromkeys(("base", "platform"), "root"),
    **dict.fromkeys(("run", "scenario", "simulation"), "manoeuvre"),
    **dict.fromkeys(("controller", "controllers"), "loop"),
    "monte_carlo": "campaign",
    **dict.fromkeys(("disturbance", "disturbances"), "budget"),
}
# Least likeness of a word to the one that was meant, and of long words, which are alike by chance.
_ALIKE, _ALIKE_IF_LONG, _LONG = 0.6, 0.7, 5


def nearest(word: str, known: Iterable[str]) -> str | None:
    """Return the known word that `word` was probably meant to be, or None."""
    by_lower = {name.lower(): name for name in known}
    given = word.lower()[:LONGEST]
    begun = [name for name in by_lower if len(given) > 2 and name.startswith(given)]
    parts = [name for name in by_lower if name.endswith(f"_{given}") or given.endswith(f"_{name}")]
    if begun:
        return by_lower[begun[0]]
    if len(given) > 2 and len(parts) == 1:
        return by_lower[parts[0]]
    if _MEANT.get(given) in by_lower:
        return by_lower[_MEANT[given]]
    close = difflib.get_close_matches(given, by_lower, n=1, cutoff=_ALIKE if len(given) < _LONG else _ALIKE_IF_LONG)
    return by_lower[close[0]] if close else None
