"""Single values of an input file: units by the suffixes of keys, and checks, each with the words of its message."""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Annotated, Any

import numpy as np

from platform_ctrl.common.values import FloatArray, read_only
from platform_ctrl.plant.mistakes import given

_TURN = 2.0 * math.pi

# What a suffix is a unit of, and that unit in SI.
SUFFIXES: dict[str, tuple[str, float]] = {
    "deg": ("angle", _TURN / 360.0),
    "arcsec": ("angle", _TURN / 360.0 / 3600.0),
    "bits": ("angle", _TURN),  # of a turn divided into 2^bits steps
    "deg_s": ("rate", _TURN / 360.0),
    "rpm": ("rate", _TURN / 60.0),
    "ms": ("time", 1e-3),
    "us": ("time", 1e-6),
}
# How many an encoder may have.
BITS = range(1, 65)
# Keys by what they are, in whatever table they are numbers.
_QUANTITIES = {
    "angle": """rest angle angle_between_stops clearance play limit_cycle phase misalignment attitude
        angle_following_error los_angle_rms jitter jitter_per_axis windowed_jitter smear""",
    "rate": """spin coulomb_rate stribeck_rate friction_rate turning_rate gimbal_rate rate_following_error
        los_rate_rms rate Omega Omega1 Omega2 Omega3""",
    "time": "lag delay duration rise hold settle fade at until time_constant exposure t",
}
_OF_KEY = {key: quantity for quantity, keys in _QUANTITIES.items() for key in keys.split()}
# Keys of a sensor that are in the unit of its reading.
_OF_READING = ("noise_rms", "quantisation", "bias")


def base_key(key: str, known: Mapping[str, Any], reading: str) -> tuple[str, str] | None:
    """Return the key that `key` is with a suffix, and the suffix; None where there is no such key among the known.

    `reading` is the SI unit of a sensor's reading, or empty.
    """
    for suffix, (quantity, _) in SUFFIXES.items():
        base = key.removesuffix(f"_{suffix}")
        if base == key or base not in known:
            continue
        own = {"rad": "angle", "rad/s": "rate"}.get(reading) if base in _OF_READING else _OF_KEY.get(base)
        if own == quantity and (suffix != "bits" or base == "quantisation"):
            return base, suffix
    return None


def units_of(key: str, known: Iterable[str]) -> list[str]:
    """Return the known key that `key` is with another ending, and that key with each unit it may have; none without."""
    base = max((one for one in known if one in _OF_KEY and key.startswith(f"{one}_")), key=len, default="")
    fitting = [one for one, (quantity, _) in SUFFIXES.items() if quantity == _OF_KEY.get(base) and one != "bits"]
    return [base, *(f"{base}_{suffix}" for suffix in fitting)] if base else []


def in_si(item: Any, suffix: str) -> Any:
    """Return a number, or the numbers of a list, in SI; anything else as it is, to be refused."""
    if isinstance(item, list):
        return [in_si(one, suffix) for one in item]
    if isinstance(item, bool) or not isinstance(item, int | float):
        return item
    unit = SUFFIXES[suffix][1]
    try:
        return unit / 2.0**item if suffix == "bits" else item * unit
    except OverflowError:  # an integer beyond all floats
        return item


# Relative rounding that a printed number may carry: symmetry, the triangle inequality, C = 2 A.
ROUNDING = 1e-9

# By how much the length of a vector that was divided by its length may differ from 1.
UNIT_ROUNDING = 1e-15

# No platform has numbers beyond these, and products of a few of them neither overflow nor vanish.
SMALLEST, LARGEST = 1e-50, 1e50

# Largest angle that is taken for one in rad, with rounding: a turn. Beyond it degrees may be meant.
TURN = 2.0 * math.pi * (1.0 + ROUNDING)


class Unfit(Exception):
    """A value is refused; the text says what is wrong with it beyond not being what was expected."""


@dataclass(frozen=True, eq=False)
class Expected:
    """Mark of a field: `judge` returns the value of its key or raises `Unfit`; `words` name what is expected."""

    words_now: str | Callable[[], str]
    judge: Callable[[Any], Any]

    @property
    def words(self) -> str:
        """What is expected, as messages say it."""
        return self.words_now if isinstance(self.words_now, str) else self.words_now()


@dataclass(frozen=True, eq=False)
class Refers:
    """Mark of a field that names a gimbal or, with `root`, any body.

    `hint`: what to write in its place where the root is meant.
    """

    root: bool = False
    hint: str = ""


def number(item: object) -> float:
    """Return a float that is 0 or of a magnitude that something can have."""
    out = finite(item)
    if abs(out) > LARGEST:
        raise Unfit(f"larger than {LARGEST:g}")
    if 0.0 < abs(out) < SMALLEST:
        raise Unfit(f"smaller than {SMALLEST:g} and not 0")
    return out


def finite(item: object) -> float:
    """Return a finite float."""
    if isinstance(item, bool) or not isinstance(item, int | float):
        raise Unfit
    try:
        out = float(item)
    except OverflowError:
        raise Unfit("too large for a floating-point number") from None
    if not math.isfinite(out):
        raise Unfit("not finite")
    return out


def finite_number(item: object) -> float | None:
    """Return `item` as a finite float; None where it is not one."""
    try:
        return finite(item)
    except Unfit:
        return None


def where(fits: Callable[[Any], bool], judge: Callable[[object], Any] = number) -> Callable[[object], Any]:
    """Return the judge of what another judge, by itself that of a number, accepts and that fits."""

    def judged(item: object) -> Any:
        out = judge(item)
        if not fits(out):
            raise Unfit
        return out

    return judged


def integer(lowest: int, highest: int) -> Callable[[object], int]:
    """Return the judge of an integer between two bounds."""

    def judge(item: object) -> int:
        if isinstance(item, bool) or not isinstance(item, int) or not lowest <= item <= highest:
            raise Unfit
        return item

    return judge


def _each(items: list[Any], judge: Callable[[Any], Any], words: Callable[[int, Any, str], str]) -> list[Any]:
    """Return what a judge makes of every item; `words` of the number, from 1 on, and of the item say which is wrong."""
    out = []
    for k, item in enumerate(items, 1):
        try:
            out.append(judge(item))
        except Unfit as error:
            raise Unfit(words(k, item, str(error))) from None
    return out


def numbers(item: object, count: int, judge: Callable[[object], float] = number) -> list[float]:
    """Return `count` floats that a judge accepts."""
    if not isinstance(item, list):
        raise Unfit
    if len(item) != count:
        raise Unfit(f"has {len(item)} element{'' if len(item) == 1 else 's'}")
    return _each(item, judge, lambda k, entry, why: f"element {k}, {given(entry)}, is {why or 'not a number'}")


def _rows(item: list[Any], count: int) -> list[list[float]]:
    """Return rows of `count` numbers."""
    return _each(item, lambda row: numbers(row, count), lambda k, row, why: f"row {k} {why or 'is no list'}")


def _list(least: int, fits: Callable[[tuple[float, ...]], bool]) -> Callable[[object], tuple[float, ...]]:
    """Return the judge of `least` numbers or more that fit together."""

    def judge(item: object) -> tuple[float, ...]:
        found = tuple(numbers(item, len(item) if isinstance(item, list) else 0))
        if len(found) < least:
            raise Unfit(f"has {len(found)} element{'' if len(found) == 1 else 's'}")
        return found

    return where(fits, judge)


def _increasing(found: Sequence[float]) -> bool:
    return all(x < y for x, y in itertools.pairwise(found))


def text(item: object) -> str:
    """Return a line of text that is not empty."""
    if not isinstance(item, str):
        raise Unfit
    if not item.strip():
        raise Unfit("empty")
    if not item.isprintable():
        raise Unfit("holds characters that cannot be printed")
    return item


def _of(kind: type) -> Callable[[object], Any]:
    """Return the judge of what is of a class."""
    return where(lambda item: isinstance(item, kind), lambda item: item)


def _system_name(item: object) -> str:
    """Return a text that may name a `control.StateSpace`."""
    name = text(item)
    if "." in name:
        raise Unfit("has a full stop, which no controller's name may have")
    return name


def one_of(names: Collection[str]) -> Expected:
    """Return the annotation of a key that takes one of a few words; names that are added later count, too."""
    judge = where(lambda item: isinstance(item, str) and item in names, lambda item: item)
    return Expected(lambda: " or ".join(f'"{name}"' for name in names), judge)


def vector(item: object) -> FloatArray:
    """Return a vector, which may be zero."""
    return read_only(numbers(item, 3))


def zero_vector() -> FloatArray:
    """Return three zeros, the default of a vector."""
    return read_only((0.0, 0.0, 0.0))


def one_or_two(item: object) -> tuple[float, float]:
    """Return two numbers, of one both times."""
    first, second = numbers(item, 2) if isinstance(item, list) else (number(item), number(item))
    return first, second


def coulomb(item: object) -> tuple[float, float]:
    """Return the dry friction against negative and against positive rates."""
    low, high = one_or_two(item)
    if min(low, high) < 0:
        raise Unfit("negative")
    return low, high


def axis(item: object) -> FloatArray:
    """Return a unit vector."""
    given_axis = numbers(item, 3, finite)
    largest = max(map(abs, given_axis))
    if largest == 0:
        raise Unfit("of length zero")
    if abs(math.hypot(*given_axis) - 1.0) <= UNIT_ROUNDING:  # what was written back is read as it was
        return read_only(given_axis)
    scaled = [entry / largest for entry in given_axis]  # its length neither overflows nor vanishes
    return read_only([entry / math.hypot(*scaled) for entry in scaled])


def inertia(item: object) -> FloatArray:
    """Return the 3 x 3 inertia matrix of a body that can exist."""
    if isinstance(item, list) and item and all(isinstance(row, list) for row in item):
        if len(item) != 3:
            raise Unfit(f"has {len(item)} row{'' if len(item) == 1 else 's'}")
        matrix = np.array(_rows(item, 3))
        # A singular matrix has eigenvalues of rounding size, not zero.
        zero = 1e-12
    else:
        matrix = np.diag(numbers(item, 3))
        zero = 0.0
    largest = np.abs(matrix).max()
    if largest == 0:
        raise Unfit("not positive definite (for a frame without mass take a millionth of what it carries)")
    scaled = matrix / largest
    for i, j in ((0, 1), (0, 2), (1, 2)):
        if abs(scaled[i, j] - scaled[j, i]) > ROUNDING:
            raise Unfit(f"not symmetric, element ({i + 1}, {j + 1}) differs from ({j + 1}, {i + 1})")
    symmetric = (scaled + scaled.T) / 2
    low, middle, high = np.sort(np.diag(symmetric)) if zero == 0 else np.linalg.eigvalsh(symmetric)
    if low <= zero:
        raise Unfit(f"not positive definite, its smallest principal moment is {low * largest:.4g}")
    if high > (low + middle) * (1 + ROUNDING):
        raise Unfit(
            f"no body has it, the principal moment {high * largest:.4g} exceeds the sum of the others, "
            f"{low * largest:.4g} + {middle * largest:.4g}"
        )
    return read_only(matrix / 2 + matrix.T / 2)


def stops(item: object) -> tuple[float, float]:
    """Return the lowest and the highest angle."""
    low, high = numbers(item, 2)
    if not low < high:
        raise Unfit("the lower is not below the upper")
    if not low <= 0 <= high:
        raise Unfit("0 is not between them")
    return low, high


def _stops_in_radians(item: object) -> tuple[float, float]:
    """Return the lowest and the highest angle, which are no degrees."""
    ends = stops(item)
    if max(map(abs, ends)) > TURN:
        degrees = ", ".join(f"{end:.10g}" for end in stops_in_degrees(ends))
        raise Unfit(f"more than a turn; is it in degrees? then write stops_deg, else stops_deg = [{degrees}]")
    return ends


def stops_in_degrees(ends: Sequence[float]) -> list[float]:
    """Return stops in degrees, of which `math.radians` makes the same ones, as far as there are such numbers."""
    out = []
    for angle in ends:
        near = math.degrees(angle)
        tried = (near, math.nextafter(near, math.inf), math.nextafter(near, -math.inf))
        out.append(next((one for one in tried if math.radians(one) == angle), near))
    return out


def stops_written(ends: Sequence[float]) -> dict[str, list[float]]:
    """Return the key of a plant file for stops, and its value: beyond a turn a file has to state that it means it."""
    wide = max(map(abs, ends)) > TURN
    return {"stops_deg": stops_in_degrees(ends)} if wide else {"stops": list(ends)}


def rows(*fits: Callable[[float], bool]) -> Callable[[object], FloatArray]:
    """Return the judge of one or more rows of numbers: what each number of a row has to be."""

    def judge(item: object) -> FloatArray:
        if not isinstance(item, list) or not item:
            raise Unfit
        found = _rows(item, len(fits))
        for k, row in enumerate(found):
            if not all(fit(x) for fit, x in zip(fits, row, strict=True)):
                raise Unfit(f"row {k + 1} is {given(item[k])}")
        return read_only(found)

    return judge


def _names(item: object) -> tuple[str, ...]:
    if not isinstance(item, list) or not all(isinstance(name, str) for name in item):
        raise Unfit
    for k, name in enumerate(item):
        if name in item[:k]:
            raise Unfit(f"{given(name)} is listed twice; leave one of them out")
    return tuple(item)


def default_angle(gimbal: str) -> str:
    """Return the name of a gimbal's angle where none is given."""
    return f"q_{gimbal}"


def default_torquer(gimbal: str | None, root_axis: object) -> str:
    """Return the name of a torquer where none is given."""
    return f"Q{gimbal}" if gimbal is not None else f"M{root_axis}"


NUMBER = Expected("a number", number)
POSITIVE = Expected("a number > 0", where(lambda x: x > 0))
NOT_NEGATIVE = Expected("a number >= 0", where(lambda x: x >= 0))
FREQUENCY = Expected("a number > 0, Hz", where(lambda x: x > 0))
NUMBERS = Expected("one or more numbers", _list(1, lambda found: True))
POSITIVES = Expected("one or more numbers > 0", _list(1, lambda found: min(found) > 0))
TIMES = Expected("two or more times that increase, s", _list(2, _increasing))
PLANT = Expected(
    "the name of a shipped model, a path relative to this file, or a table",
    lambda item: item if isinstance(item, dict) else text(item),
)
TEXT = Expected("a line of text that is not empty", text)
TRUTH = Expected("true or false", _of(bool))
SCHEMA = Expected("1, the format that this version reads", integer(1, 1))
STOPS = Expected("[lower, upper] with 0 between them", _stops_in_radians)
STOPS_DEG = Expected(STOPS.words, stops)

Number = Annotated[float, NUMBER]
Positive = Annotated[float, POSITIVE]
NotNegative = Annotated[float, NOT_NEGATIVE]
Text = Annotated[str, TEXT]
SystemName = Annotated[str, Expected("a line of text that is not empty, without full stops", _system_name)]
AnyText = Annotated[str, Expected("a text", _of(str))]
Truth = Annotated[bool, TRUTH]
RootAxis = Annotated[int, Expected("1, 2 or 3", integer(1, 3))]
Axis = Annotated[FloatArray, Expected("a vector of three numbers that is not zero", axis)]
Vector = Annotated[FloatArray, Expected("three numbers", vector)]
Coulomb = Annotated[
    tuple[float, float], Expected("a torque >= 0, N m, or two: against negative and positive rates", coulomb)
]
Inertia = Annotated[FloatArray, Expected("three principal moments > 0 or a symmetric 3 x 3 matrix, kg m2", inertia)]
Stops = Annotated[tuple[float, float], STOPS]
NotZero = Annotated[float, Expected("a number other than 0", where(lambda x: x != 0))]
AtLeastOne = Annotated[float, Expected("a number >= 1", where(lambda x: x >= 1))]
Share = Annotated[float, Expected("a number from 0 to 0.9", where(lambda x: 0 <= x <= 0.9))]
Part = Annotated[float, Expected("a share from 0 to 1", where(lambda x: 0 <= x <= 1))]
# Teeth with more play do not mesh: a number meant in another unit.
Play = Annotated[
    float,
    Expected(
        "an angle from 0 to 0.2 rad (arc seconds: play_arcsec, degrees: play_deg)", where(lambda x: 0 <= x <= 0.2)
    ),
]
InsidePart = Annotated[float, Expected("a share between 0 and 1", where(lambda x: 0 < x < 1))]
SomePart = Annotated[float, Expected("a share > 0, up to 1", where(lambda x: 0 < x <= 1))]
Samples = Annotated[int, Expected("a whole number from 0 to 1000", integer(0, 1000))]
GridPoints = Annotated[int, Expected("a whole number from 2 to 9", integer(2, 9))]
Seed = Annotated[int, Expected("a whole number >= 0", integer(0, 2**63 - 1))]
Rates = Annotated[
    FloatArray,
    Expected(
        "the largest rate about each root axis, three numbers >= 0, rad/s", where(lambda found: min(found) >= 0, vector)
    ),
]
Numbers = Annotated[tuple[float, ...], NUMBERS]
Frequencies = Annotated[
    FloatArray,
    Expected(
        "two or more frequencies > 0 that increase, Hz", _list(2, lambda found: found[0] > 0 and _increasing(found))
    ),
]
Densities = Annotated[FloatArray, Expected("a density > 0 for each frequency", _list(1, lambda found: min(found) > 0))]
Positives = Annotated[tuple[float, ...], POSITIVES]
OneOrRange = Annotated[
    tuple[float, float],
    Expected("a number > 0, or two: lowest and highest", where(lambda ends: 0 < ends[0] <= ends[1], one_or_two)),
]
Lines = Annotated[int, Expected("a whole number from 1 to 4096", integer(1, 4096))]
Runs = Annotated[int, Expected("a whole number from 1 to 2^30", integer(1, 2**30))]
SeveralRuns = Annotated[int, Expected("a whole number from 2 to 100000", integer(2, 100_000))]
NAMES = Expected("a list of names", _names)
Names = Annotated[tuple[str, ...], NAMES]
