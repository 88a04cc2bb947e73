"""Recorded logs: read from CSV, put on a uniform clock, and turned into power spectral densities.

Names of columns may state their units by their ends: ``time_us``, ``gyro_z_dps``, ``rate (deg/s)``.
"""

from __future__ import annotations

import contextlib
import csv
import math
import re
from collections.abc import Mapping, Sequence
from itertools import islice
from pathlib import Path
from typing import Literal, NamedTuple

import numpy as np

from platform_ctrl.common.values import FloatArray, value
from platform_ctrl.errors import ArgumentError, InputError
from platform_ctrl.plant.fields import LARGEST
from platform_ctrl.plant.mistakes import given, one_line, suggestion
from platform_ctrl.plant.source import read_text

# A step of the clock of more periods than this is a gap, over which nothing is interpolated.
GAP_PERIODS = 3.0
# Steps of the clock that differ by less, relative, are alike: stamps are printed with so many digits.
ALIKE = 1e-6
LEAST_SAMPLES = 16
_CSV = "give a header and lines of numbers with commas between them"
# Mean steps of a clock that no record of motion has, s: the time is in another unit. A clock whose column does not
# state its unit is doubted earlier: 1 is the step of a 1 kHz log in ms, and of a counter of samples.
SHORTEST_STEP, LONGEST_STEP, LONGEST_UNSTATED = 4e-6, 60.0, 1.0
# Slowest logger whose clock is proposed for a column of another unit, s.
_USUAL_STEP = 0.1
# Relative width of the bands over which the density is averaged; below, bins are wider than that.
BAND = 0.01
# Segments that half overlap and are averaged, if the resolution allows as many, and samples of one at most.
SEGMENTS, LONGEST_SEGMENT = 8, 2**20


Quantity = Literal["time", "angle", "rate", "acceleration", "torque"]

G = 9.80665  # m/s², standard gravity
_TURN, _DEGREE = 2.0 * math.pi, math.pi / 180.0


class ColumnUnit(NamedTuple):
    """A unit: how it is written, what it is of, and SI units (s, rad, rad/s, m/s², N m) in it."""

    name: str
    quantity: Quantity
    factor: float


# By the end of a column's name, in small letters. A frequency is a rate: 1 Hz is 2π rad/s.
SUFFIXES: dict[str, ColumnUnit] = {
    "s": ColumnUnit("s", "time", 1.0),
    "ms": ColumnUnit("ms", "time", 1e-3),
    "us": ColumnUnit("µs", "time", 1e-6),
    "ns": ColumnUnit("ns", "time", 1e-9),
    "rad": ColumnUnit("rad", "angle", 1.0),
    "mrad": ColumnUnit("mrad", "angle", 1e-3),
    "urad": ColumnUnit("µrad", "angle", 1e-6),
    "deg": ColumnUnit("deg", "angle", _DEGREE),
    "arcmin": ColumnUnit("arcmin", "angle", _DEGREE / 60.0),
    "arcsec": ColumnUnit("arcsec", "angle", _DEGREE / 3600.0),
    "rad_s": ColumnUnit("rad/s", "rate", 1.0),
    "mrad_s": ColumnUnit("mrad/s", "rate", 1e-3),
    "urad_s": ColumnUnit("µrad/s", "rate", 1e-6),
    "deg_s": ColumnUnit("deg/s", "rate", _DEGREE),
    "dps": ColumnUnit("deg/s", "rate", _DEGREE),
    "rpm": ColumnUnit("rpm", "rate", _TURN / 60.0),
    "hz": ColumnUnit("Hz", "rate", _TURN),
    "khz": ColumnUnit("kHz", "rate", 1e3 * _TURN),
    "m_s2": ColumnUnit("m/s2", "acceleration", 1.0),
    "mps2": ColumnUnit("m/s2", "acceleration", 1.0),
    "g": ColumnUnit("g", "acceleration", G),
    "mg": ColumnUnit("mg", "acceleration", 1e-3 * G),
    "knm": ColumnUnit("kN m", "torque", 1e3),
    "nm": ColumnUnit("N m", "torque", 1.0),
    "mnm": ColumnUnit("mN m", "torque", 1e-3),
    "unm": ColumnUnit("µN m", "torque", 1e-6),
}
_SPELLINGS = {"sec": "s", "msec": "ms", "usec": "us", "nsec": "ns"}
_IN_BRACKETS = re.compile(r"(.*?)\s*[\[(]\s*([^\[\]()]+?)\s*[\])]")

# As autopilots write it: TimeUS.
_IN_CAPITALS = re.compile(r"(.*[a-z])([UMN]S)")


def column_unit(column: str) -> tuple[str, ColumnUnit | None]:
    """Return the name of a column without its unit, and the unit that it states, or None."""
    if bracketed := _IN_BRACKETS.fullmatch(column):
        end = bracketed[2].lower().replace("/", "_").replace("²", "2").replace("°", "deg")
        end = re.sub(r"[\s^·*]", "", end).replace("µ", "u")
        found = SUFFIXES.get(_SPELLINGS.get(end, end))
        return (bracketed[1].rstrip("_"), found) if found else (column, None)
    if stated := _IN_CAPITALS.fullmatch(column):
        return stated[1], SUFFIXES[stated[2].lower()]
    small = column.lower().replace("µ", "u")
    for end in sorted((*SUFFIXES, *_SPELLINGS), key=len, reverse=True):
        if small.endswith(f"_{end}") and len(column) > len(end) + 1:
            return column[: -len(end) - 1], SUFFIXES[_SPELLINGS.get(end, end)]
    return column, None


@value
class Log:
    """Signals over time, as they were recorded."""

    label: str  # the file, as messages say it
    time: FloatArray  # (N,): increasing, s
    signals: Mapping[str, FloatArray]  # by the names of the columns, (N,) each, in units of the file: see `column_unit`


@value
class LogDensity:
    """The power spectral density of a recorded signal x about its mean, and what is known of the record."""

    # (k,): from 0 to half of the sample rate: in equal steps, the resolution, as long as these are more than 1 % of the
    # frequency, then the middles of bands of 1 %, Hz.
    frequencies_hz: FloatArray
    # (k,): one-sided, units of x squared per Hz, means over the bands; the integral by trapezoids is the variance.
    densities: FloatArray
    # mean, variance: of what was used of x, units of x, and squared.
    mean: float
    variance: float
    segments: int  # how many segments were averaged: the relative standard error of a density is about 1/sqrt(segments)
    lost: float  # share of the recorded time that was not used: gaps, and pieces shorter than a segment


def read_log(path: Path, columns: Sequence[str], time: str = "time") -> Log:
    """Return columns of a CSV file, each checked; `InputError` says which line is wrong and what to do.

    The time is in s unless the name of its column states another unit: `time_us`, `t_ms`. Where there is no column
    `time`, that is the one column of this name with a unit.
    """
    label = one_line(str(path))
    wanted = list(dict.fromkeys([time, *columns]))
    values, lines = _csv(path, label, wanted)
    time = wanted[0]
    if len(values) < LEAST_SAMPLES:
        raise InputError(f"{label}: has {len(values)} samples; at least {LEAST_SAMPLES} are needed")
    for k, j in np.argwhere(~(np.abs(values) <= LARGEST))[:1]:
        words = f"line {lines[k]}: {wanted[j]} is {values[k, j]:.6g}"
        raise InputError(f"{label}: {words}; leave such lines out, which makes a gap of them")
    t = values[:, 0]
    for k in np.flatnonzero(np.diff(t) <= 0.0)[:1]:
        if t[k + 1] == t[k]:
            words = f"{time} = {t[k]:.12g} stands in line {lines[k]} already; leave one of the two out"
        else:
            words = f"{time} = {t[k + 1]:.12g} is before the {t[k]:.12g} of line {lines[k]}"
            words += "; sort the lines by time, or cut the log where its clock was set"
        raise InputError(f"{label}: line {lines[k + 1]}: {words}")
    unit = column_unit(time)[1]
    unit = unit if unit is not None and unit.quantity == "time" else None
    if words := _doubtful_clock(time, unit, t):
        raise InputError(f"{label}: {words}")
    t = t if unit is None else unit.factor * t
    return Log(label=label, time=t, signals={name: values[:, wanted.index(name)] for name in columns})


def read_density(path: Path) -> tuple[FloatArray, FloatArray]:
    """Return frequencies, Hz, and densities: the first two columns of a CSV file with a header."""
    label = one_line(str(path))
    header = [name.strip() for name in read_text(path, "a CSV file with a header").partition("\n")[0].split(",")]
    if len(header) < 2:
        raise InputError(f"{label}: needs two columns with a header, frequency in Hz and density")
    values, _ = _csv(path, label, header[:2])
    return values[:, 0], values[:, 1]


def _doubtful_clock(name: str, unit: ColumnUnit | None, t: FloatArray) -> str:
    """Return in words why a clock cannot be in the unit that its name states, or in s; empty where it may be."""
    own = SUFFIXES["s"] if unit is None else unit
    step = float(np.median(np.diff(t)))
    seconds = own.factor * step
    if SHORTEST_STEP <= seconds < (LONGEST_UNSTATED * (1.0 - 1e-9) if unit is None else LONGEST_STEP):
        return ""
    base = name if unit is None else column_unit(name)[0]
    others = {end: one for end, one in SUFFIXES.items() if one.quantity == "time" and one != own}
    near = (end for end, one in others.items() if SHORTEST_STEP <= one.factor * step <= _USUAL_STEP)
    ends = [*islice(near, 1), *(["s"] if unit is None and SHORTEST_STEP <= seconds < LONGEST_STEP else [])]
    words = f"{name}: steps of {seconds:.4g} s, {seconds * float(t[-1] - t[0]) / step:.4g} s in all, cannot be meant"
    proposed = " or ".join(f'"{base}_{end}" if it is in {SUFFIXES[end].name}' for end in ends)
    return f"{words}; {f'call the column {proposed}' if proposed else 'the time must be in s'}"


def _csv(path: Path, label: str, wanted: list[str]) -> tuple[FloatArray, Sequence[int]]:
    """Return the wanted columns and the line of the file that each row is from."""
    text = read_text(path, "a CSV file with a header").splitlines()
    try:
        header = [name.strip() for name in next(csv.reader(text[:1]), [])]
    except csv.Error as error:
        raise InputError(f"{label}: is not CSV: {one_line(str(error))}; {_CSV}") from None
    if wanted[0] not in header:  # the one column of that name with a unit of time
        stated = [(name, *column_unit(name)) for name in header]
        timed = [(name, base) for name, base, unit in stated if unit and unit.quantity == "time"]
        found = [name for name, base in timed if base.lower() == wanted[0].lower()]
        wanted[0] = found[0] if len(found) == 1 else wanted[0]
    places = [_place(label, header, name) for name in wanted]
    lines = [k for k, line in enumerate(text, 1) if k > 1 and line.strip()]
    rows = [text[k - 1] for k in lines]
    if not rows:
        return np.zeros((0, len(wanted))), lines
    try:
        return np.loadtxt(rows, delimiter=",", usecols=places, ndmin=2, comments=None, quotechar='"'), lines
    except ValueError:
        pass
    with contextlib.suppress(csv.Error):  # a cell that is too long, or a quotation mark that nothing closes
        for line, row in zip(lines, csv.reader(rows), strict=False):
            for name, place in zip(wanted, places, strict=True):
                cell = row[place].strip() if place < len(row) else ""
                if not _is_number(cell):
                    words = f"{name} must be a number, got {given(cell)}" if cell else f"{name} is missing"
                    raise InputError(f"{label}: line {line}: {words}; leave such lines out, which makes a gap of them")
    raise InputError(f"{label}: is not CSV; {_CSV}")


def _is_number(cell: str) -> bool:
    try:
        float(cell)
    except ValueError:
        return False
    return "_" not in cell


def _place(label: str, header: list[str], name: str) -> int:
    if header.count(name) == 1:
        return header.index(name)
    if name in header:
        raise InputError(f"{label}: {header.count(name)} columns are called {given(name)}; rename all but one")
    raise InputError(f"{label}: there is no column {given(name)}; {suggestion(name, header)}")


def pieces(time: FloatArray) -> list[slice]:
    """Return the parts of a record between its gaps."""
    steps = np.diff(time)
    ends = [*(np.flatnonzero(steps > GAP_PERIODS * np.median(steps)) + 1), len(time)]
    return [slice(a, b) for a, b in zip([0, *ends[:-1]], ends, strict=True)]


def log_density(time: FloatArray, x: FloatArray, resolution_hz: float) -> LogDensity:
    """Return the density of a signal by Welch's method, finer than `resolution_hz` where the record is long enough.

    Pieces between gaps are put on one uniform clock, and their segments averaged with the same weight. The mean of all
    of them is removed, not that of each segment, and the sum is scaled to the variance: slow motion counts.
    """
    import scipy.signal

    parts = [part for part in pieces(time) if part.stop - part.start > 1]
    steps = np.concatenate([np.diff(time[part]) for part in parts])
    period = float(np.mean(steps))
    length = _segment(period, [part.stop - part.start for part in parts], resolution_hz)
    clocks = [_uniform(time[part], x[part], period) for part in parts]
    clocks = [one for one in clocks if len(one) >= length]
    used = np.concatenate(clocks)
    mean, variance = float(np.mean(used)), float(np.var(used))
    if variance <= (1e-12 * abs(mean)) ** 2:
        raise ArgumentError(f"the signal does not vary, it is {mean:.6g} throughout; choose another column")
    counts = [(len(one) - length) // (length - length // 2) + 1 for one in clocks]
    found = [scipy.signal.welch(one - mean, 1.0 / period, "hann", length, detrend=False) for one in clocks]
    raw = np.average([one[1] for one in found], axis=0, weights=counts)
    # SciPy doubles what has a negative frequency: with the ends doubled, too, trapezoids give what Parseval says.
    raw[[0, -1]] *= (2.0, 1.0 if length % 2 else 2.0)
    bands = [0]  # the first bin of each: one bin, or as many as are within `BAND` of its frequency
    while (following := bands[-1] + max(1, int(BAND * bands[-1]))) < len(raw):
        bands.append(following)
    width = np.diff([*bands, len(raw)])
    f, density = np.add.reduceat(found[0][0], bands) / width, np.add.reduceat(raw, bands) / width
    return LogDensity(
        frequencies_hz=f,
        densities=density * variance / float(np.trapezoid(density, f)),
        mean=mean,
        variance=variance,
        segments=sum(counts),
        lost=max(0.0, 1.0 - period * sum(len(one) - 1 for one in clocks) / float(time[-1] - time[0])),
    )


def _segment(period: float, lengths: list[int], resolution_hz: float) -> int:
    """Return the samples of a segment: enough for the resolution, and more where the record has enough of them."""
    if period < SHORTEST_STEP or 0.5 / period < resolution_hz:
        words = f"the mean step of the clock, {period:.4g} s, is too"
        words += " short" if period < SHORTEST_STEP else f" long for {resolution_hz:.4g} Hz"
        raise ArgumentError(f"{words}; the time must be in s, or its column state the unit, as time_us does")
    least = int(np.ceil((1.0 - 1e-9) / (period * resolution_hz)))
    if least > min(max(lengths), LONGEST_SEGMENT):
        longest, most = max(lengths) * period, LONGEST_SEGMENT * period
        words = f"a resolution of {resolution_hz:.4g} Hz needs {1.0 / resolution_hz:.4g} s without a gap"
        got = (
            f"the longest piece is {longest:.4g} s" if longest < most else f"at this rate {most:.4g} s are used at most"
        )
        raise ArgumentError(f"{words}, and {got}; take {1.0 / min(longest, most):.3g} Hz or more")
    # Of pieces that are long enough the most is used, and of a long record no more than is needed to see lines.
    more = min(sum(lengths) // SEGMENTS, 4096, *(length for length in lengths if length >= least))
    return max(least, more)


def _uniform(time: FloatArray, x: FloatArray, period: float) -> FloatArray:
    """Return a piece on a uniform clock."""
    steps = np.diff(time)
    if np.ptp(steps) <= ALIKE * period and abs(float(np.mean(steps)) - period) <= ALIKE * period:
        return x
    from scipy.interpolate import CubicSpline

    count = int((time[-1] - time[0]) / period * (1.0 + 1e-12)) + 1
    return np.asarray(CubicSpline(time, x)(time[0] + period * np.arange(count)))
