"""Numbers as text: in a unit of suitable size, with the significant digits, in words where there is no number."""

from __future__ import annotations

import math
import re
from collections.abc import Sequence
from decimal import Decimal
from typing import TYPE_CHECKING

from platform_ctrl.common.text import Rounding, at_least, at_most, rounded

if TYPE_CHECKING:
    from platform_ctrl.analysis.metrics import Sense
    from platform_ctrl.common.values import FloatArray
    from platform_ctrl.job.job import Job
    from platform_ctrl.job.judging import CheckResult
    from platform_ctrl.job.manoeuvre import Manoeuvre
    from platform_ctrl.plant.platform import Platform

# Units of small torques and angles: thousandths, and millionths.
_SMALL = {"N m": ("mN m", "µN m"), "rad": ("mrad", "µrad")}

# Factors from rad/s to Hz and rpm.
HZ = 1.0 / (2.0 * math.pi)
RPM = 60.0 * HZ

MINUS, DASH = "\u2212", "\u2013"
MET, NOT_MET = "\u2713", "\u2717"
BOUND = {"at least": "\u2265", "at most": "\u2264"}

# Units that the name of a claim may end in, after a comma as on an axis.
_UNITS = frozenset({"Hz", "rad/s", "rad", "s", "1/s", "N m", "N m/rad", "rad/(N m)", "rad/(rad/s)", "N m s/rad"})
# Claims that are bounds from below and from above, by the first words of their names.
_LEAST = ("largest Omega", "gamma_optimal", "disk_margin", "damping")
_MOST = ("gamma", "limit_ratio", "goal_ratio")
# Claims whose names are not words yet.
_CLAIMED = {"gamma": "norm on the weights, γ", "gamma_optimal": "least γ of any controller"}


def handy_unit(unit: str, size: float) -> tuple[float, str]:
    """Return the factor and the unit in which a number of magnitude `size` (in `unit`) reads well."""
    if unit not in _SMALL or (math.isfinite(size) and abs(size) >= 1.0):
        return 1.0, unit
    milli, micro = _SMALL[unit]
    return (1e6, micro) if 0.0 < abs(size) < 1e-3 else (1e3, milli)


def plain(number: float, digits: int = 4, rounding: Rounding = "nearest") -> str:
    """Return `number` with `digits` significant digits and a real minus sign; ``unstable`` where it is not finite.

    A proved bound is rounded ``"down"`` or ``"up"``, to the side on which it still holds.
    """
    if not math.isfinite(number):
        return "unstable"
    if rounding != "nearest":
        whole = 1 + math.floor(math.log10(abs(number))) if 1.0 <= abs(number) < 1e6 else 0
        number = rounded(number, max(digits, whole), rounding)
    if number != 0.0 and not 1e-3 <= abs(number) < 1e6:
        mantissa, exponent = f"{number:.{max(digits - 1, 0)}e}".split("e")
        mantissa = mantissa.rstrip("0").rstrip(".") if "." in mantissa else mantissa
        return f"{mantissa}·10{_superscript(int(exponent))}".replace("-", MINUS)
    decimals = max(0, digits - 1 - math.floor(math.log10(abs(number)))) if number else 0
    text = f"{number:.{decimals}f}"
    text = text.rstrip("0").rstrip(".") if "." in text else text
    return text.replace("-", MINUS)


def quantity(
    number: float, unit: str, digits: int = 4, like: float | None = None, rounding: Rounding = "nearest"
) -> str:
    """Return `number` with its unit, in the unit that suits `like` (default: the number itself)."""
    factor, name = handy_unit(unit, number if like is None else like)
    if not math.isfinite(number):
        return "unstable"
    return f"{plain(times(factor, number), digits, rounding)} {name}".rstrip()


def times(factor: float, number: float) -> float:
    """Return a multiple, without the last digit's error that would turn 0.3 into 0.29 when rounded down."""
    exact = math.isfinite(number) and factor != 1.0
    return float(Decimal(repr(float(number))) * Decimal(factor)) if exact else number


def pessimistic_rounding(sense: Sense) -> Rounding:
    """Return the direction in which a value is rounded: it is never printed better than it is."""
    return "down" if sense == "at least" else "up"


# Values below this in the unit of their limit are shown in their own, with the limit: 3.6 µrad, not 0.0036 mrad.
_TOO_SMALL = 0.01
# Values from this on in the unit of their limit are shown in their own: 9.8 rad, not 9.8·10⁶ µrad.
_TOO_LARGE = 1e4


def _is_short(number: float) -> bool:
    return math.isclose(number, float(f"{number:.3g}"), rel_tol=1e-9)


def compared(one: CheckResult) -> tuple[str, str]:
    """Return value and limit of a requirement in the same unit, with digits enough to tell them apart."""
    factor, name = handy_unit(one.unit, one.limit)
    degrees = math.degrees(one.limit)
    if one.unit == "rad" and _is_short(degrees) and not _is_short(factor * one.limit):
        factor, name = math.degrees(1.0), "°"  # as the file has it
    if 0.0 < abs(one.value) * factor < _TOO_SMALL:
        factor, name = handy_unit(one.unit, one.value)
    shown_limit = f"{plain(times(factor, one.limit), 6)} {name}".rstrip()
    if not math.isfinite(one.value):
        # A stable loop may do these, too.
        words = {"ramp error": "unbounded", "settling time": "never"}.get(one.name.partition(",")[0], "unstable")
        return "diverged" if one.stage == "simulated" else words, shown_limit
    if abs(one.value) * factor >= _TOO_LARGE:
        factor, name = handy_unit(one.unit, one.value)
    for digits in (4, 6, 9):
        if one.value == one.limit or rounded(one.value, digits) != rounded(one.limit, digits):
            break
    shown = plain(times(factor, one.value), digits, pessimistic_rounding(one.sense))
    return f"{shown} {name}".rstrip(), shown_limit


def percent(share: float) -> str:
    """Return `share` in per cent with its sign, at most 999; a dash where it is not finite."""
    if not math.isfinite(share):
        return DASH
    if abs(share) >= 9.995:
        return "> +999 %" if share > 0.0 else f"< {MINUS}999 %"
    text = f"{100.0 * share:+.1f}" if abs(share) < 0.0995 else f"{100.0 * share:+.0f}"
    return f"{text} %".replace("-", MINUS)


def disk_words(alpha: float) -> str:
    """Return the changes in a disk margin: gain alone, phase alone, and as an example the phase left by a gain."""
    from platform_ctrl.analysis.margins import disk_phase

    gain, phase = disk_gain_or_phase(alpha)
    high = (2.0 + alpha) / (2.0 - alpha) if alpha < 2.0 else 4.0
    both = 1.0 + rounded(math.sqrt(high) - 1.0, 1, "down")
    left = at_least(math.degrees(float(disk_phase(both, alpha))), 3)
    return (
        f"{gain} alone, {phase} alone, or both together inside the disk (such as gain × {both:g} with phase ±{left}°)"
    )


def disk_gain_or_phase(alpha: float) -> tuple[str, str]:
    """Return the gain factors that a disk margin allows by themselves, and the phases."""
    from platform_ctrl.analysis.margins import disk_to_gain_phase

    low, high, phase = disk_to_gain_phase(min(alpha, 1e9))
    upper = f"to {at_least(high, 3)}" if math.isfinite(high) else "upwards"
    return f"gain × {at_most(max(low, 0.0), 3)} {upper}", f"phase ±{at_least(math.degrees(phase), 3)}°"


def claimed(name: str, number: float) -> tuple[str, str]:
    """Return a claim in words and with its unit.

    A name ends in ``, `` and a unit (``"largest Omega1 without saturation, rad/s"``), or in ``_hz`` as options do;
    otherwise the number is a plain one.
    """
    rounding: Rounding = "down" if name.startswith(_LEAST) else "up" if name.startswith(_MOST) else "nearest"
    words, _, unit = name.rpartition(", ")
    if unit not in _UNITS:
        words, unit = (name.removesuffix("_hz"), "Hz") if name.endswith("_hz") else (name, "")
    words = _CLAIMED.get(words, words.replace("_", " "))
    if not math.isfinite(number):
        return words, DASH if math.isnan(number) else "∞"
    return words, quantity(number, unit, rounding=rounding)


def count(number: int, noun: str) -> str:
    """Return ``1 loop``, ``10,000 loops``."""
    return f"{number:,} {noun if number == 1 else noun + 's'}"


def listed(words: list[str] | tuple[str, ...]) -> str:
    """Return ``a``, ``a and b``, ``a, b and c``."""
    return " and ".join([", ".join(words[:-1]), words[-1]]) if len(words) > 1 else "".join(words)


_UNTIED = re.compile(r"(?<=\d) (?=[^\W\d]|[%°/])|(?<=[≤≥]) ")


def tied(words: str) -> str:
    """Return words in which no line ends between a number and its unit, or after a sign of comparison."""
    return _UNTIED.sub("\N{NO-BREAK SPACE}", words)


def axis_text(axis: Sequence[float] | FloatArray) -> str:
    """Return +1, −3 for a body axis, otherwise its components."""
    k = max(range(3), key=lambda k: abs(axis[k]))
    if math.isclose(abs(axis[k]), 1.0, rel_tol=1e-5):
        return ("+" if axis[k] > 0.0 else MINUS) + str(k + 1)
    # Without the last digits of a rounded zero.
    return f"({', '.join(plain(round(float(x), 9) + 0.0, 3) for x in axis)})"


def met_words(results: Sequence[CheckResult]) -> str:
    """Return how many requirements are met."""
    missed = sum(not one.passed for one in results)
    if missed:
        return f"{missed} of {count(len(results), 'requirement')} not met"
    return f"all {count(len(results), 'requirement')} met" if len(results) != 1 else "the one requirement is met"


def added_words(platform: Platform) -> str:
    """Return which torquers and pick-offs the device itself does not have, to go with a verdict; or nothing."""
    named = []
    for word, parts in (("torquer", platform.torquers), ("pick-off", platform.pickoffs)):
        bodies = [part.gimbal or platform.root_name for part in parts if part.added]
        if bodies:
            named.append(f"{f'a {word}' if len(bodies) == 1 else f'{word}s'} on {listed(bodies)}")
    return f", with {listed(named)} added that the device does not have" if named else ""


def _assuming(statements: Sequence[str]) -> str:
    """Return the statements as one clause, each with its own "that": some hold lists; nothing where there are none."""
    words = [f"that {statement}" for statement in statements]
    return f"assuming {', and '.join([', '.join(words[:-1]), words[-1]][-len(words) :])}" if words else ""


def assumed_words(job: Job, free_angles: tuple[str, ...] = (), uncontrolled: tuple[str, ...] = ()) -> str:
    """Return the assumptions of the verdict in words that are printed with it; empty where there are none.

    `free_angles` are the angles that nothing holds, `uncontrolled` the gimbals on which no loop acts or depends.
    """
    words = [f"{listed(job.locked)} {'is' if len(job.locked) == 1 else 'are'} locked"] if job.locked else []
    if free_angles:
        one = len(free_angles) == 1
        words.append(
            f"nothing holds the angle{'' if one else 's'} {listed(free_angles)}, which drift{'s' if one else ''}"
        )
    if uncontrolled:
        words.append(f"no loop acts on gimbal{'' if len(uncontrolled) == 1 else 's'} {listed(uncontrolled)}")
    kinds, moving = {spec.kind for spec in job.loops}, [one for one in job.loops if one.moves_root(job.platform)]
    if moving and "stabilisation" not in kinds:
        words.append("the momentum that torques from outside bring in is unloaded outside of this job")
    read = {name for spec in job.loops for name in spec.sensors}
    if moving and job.Omega.any() and not read & job.platform.root_attitudes:
        words.append(f"Omega is zero, as no loop reads the attitude of {job.platform.root_name}")
    if job.budget is not None and (uneven := job.budget.without_motors(job.platform)):
        words.append(f"the budget of the line of sight is {uneven}")
    if not kinds & {"rate", "pointing"}:
        return _assuming(words)
    rate = float(max(job.Omega))
    if job.platform.dry_frictions:
        fed = " less what is fed forward" if any(drive.friction for drive in job.drives) else ""
        what = f"is a describing function at {plain(rate)} rad/s" if rate > 0.0 else "is left out, as Omega is zero"
        words.append(f"dry friction{fed} {what}")
    checked = [
        f"{name} = {listed([plain(x) for x in sorted({0.0, *values})])} rad"
        for name, values in job.angles.items()
        if set(values) - {0.0}
    ]
    words.append(f"the gimbal angles are {'; '.join(checked) if checked else 'all zero'}")
    return _assuming(words)


def simulated_words(job: Job, manoeuvres: Sequence[Manoeuvre]) -> str:
    """Return the assumptions of a campaign's verdict in words that are printed with it; empty where there are none."""
    bear = "the motors bear their rms currents, which a campaign does not judge"
    words = [bear] if any(one.continuous_current is not None for one in job.platform.motors) else []
    if any(one.start == "equilibrium" for one in manoeuvres):
        words.append("constant torques of the motors hold the gimbals from the start on")
    angles = set(job.platform.angle_names)
    if {spec.kind for spec in job.loops} & {"rate", "pointing"} and not any(
        angles & set(m.initial) for m in manoeuvres
    ):
        words.append("the gimbals start at the angles zero")
    return _assuming(words)


_RAISED = str.maketrans("-0123456789", "\u207b\u2070\u00b9\u00b2\u00b3\u2074\u2075\u2076\u2077\u2078\u2079")


def _superscript(exponent: int) -> str:
    return str(exponent).translate(_RAISED)


def power_of_ten(number: float) -> str:
    """Return a decade as a tick label: 0.01 to 1000 in digits, beyond that as a power of ten."""
    if number <= 0.0:
        return ""
    exponent = round(math.log10(number))
    if -2 <= exponent <= 3:
        return f"{10.0**exponent:g}"
    return f"10{_superscript(exponent)}"
