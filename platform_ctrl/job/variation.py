"""What of the plant is uncertain and may fail, for designs, and in campaigns what differs from run to run.

How campaigns draw numbers is here as well; what they reach is known without drawing.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import field
from itertools import product
from typing import Annotated, Any, Literal, get_args

from platform_ctrl.common.values import input_value, replaced
from platform_ctrl.job import parameters as places
from platform_ctrl.job.faults import Fault
from platform_ctrl.job.scenario import Scenario
from platform_ctrl.plant import fields
from platform_ctrl.plant.fields import Expected, Unfit
from platform_ctrl.plant.flexible import MODE_NUMBERS
from platform_ctrl.plant.force_elements import Friction
from platform_ctrl.plant.gimbals import Rotor
from platform_ctrl.plant.mistakes import Misfit, given, missing, of_length, takes, useless, wrong
from platform_ctrl.plant.tables import Array, Collected, record_value, shape, written

_SHARE = get_args(fields.Share)[1]


def _shares(item: object) -> float | dict[str, float]:
    """Return a share, or shares by name."""
    return (
        {str(name): _SHARE.judge(one) for name, one in item.items()} if isinstance(item, dict) else _SHARE.judge(item)
    )


_OfModes = Annotated[
    float | Mapping[str, float], Expected("a number from 0 to 0.9, or a table of such numbers by names", _shares)
]


@input_value
class Uncertainty:
    """How far the parameters lie from their nominal values.

    Attributes
    ----------
    inertia, spin
        Relative half-widths: of J about every gimbal axis, of L of every rotor.
    mode_frequency, mode_damping, mode_participation
        Relative half-widths of ω, ζ and φ of modes, and of ω and ζ of drives that give way: of all, or of each by the
        name of the mode or of the drive's gimbal.
    samples
        Number of plants taken from inside this box, beside its corners.
    """

    inertia: fields.Share = 0.0
    spin: fields.Share = 0.0
    mode_frequency: _OfModes = 0.0
    mode_damping: _OfModes = 0.0
    mode_participation: _OfModes = 0.0
    samples: fields.Samples = 0

    @staticmethod
    def _misfits(table: Mapping[str, Any]) -> Iterator[Misfit]:
        if table.get("samples") and not any(table.get(key) for key in shape(Uncertainty).keys if key != "samples"):
            yield useless(table, "samples", "without inertia, spin or another parameter > 0")

    def of_mode(self, name: str) -> dict[str, float]:
        """Return the half-widths of a mode, or of the drive of a gimbal, by what they are of."""
        widths = {what: getattr(self, f"mode_{what}") for what in MODE_NUMBERS}
        return {what: one.get(name, 0.0) if isinstance(one, Mapping) else one for what, one in widths.items()}


@input_value
class Faults:
    """What may fail, one part at a time; None where nothing does.

    Attributes
    ----------
    slow_rotor
        Share of its L that a rotor keeps; 0: it has stopped.
    weak_torquer
        Share of its torque that a torquer keeps.
    """

    slow_rotor: fields.Part | None = None
    weak_torquer: fields.SomePart | None = None


Points = Literal["sobol", "latin-hypercube", "random"]
Distribution = Literal["uniform", "normal", "truncated-normal", "log-uniform", "log-normal", "triangular", "choice"]

# The numbers that each distribution is made of.
DISTRIBUTION_NUMBERS: dict[Distribution, tuple[str, ...]] = {
    "uniform": ("low", "high"),
    "normal": ("mean", "deviation"),
    "truncated-normal": ("mean", "deviation", "low", "high"),
    "log-uniform": ("low", "high"),
    "log-normal": ("median", "deviation"),
    "triangular": ("low", "peak", "high"),
    "choice": (),
}
_NUMBERS = Collected(
    dict.fromkeys(("low", "high", "mean", "peak"), fields.NUMBER)
    | dict.fromkeys(("median", "deviation"), fields.POSITIVE)
)
# Standard deviations from the mean at which a truncated normal distribution has to start at the latest: beyond, there
# is less than 1e-15 of it, and its quantiles are rounding.
FARTHEST = 8.0
# Standard deviation of a natural logarithm at most: numbers that lie further apart overflow.
WIDEST = 10.0
# Centres: 1 unless given where the numbers multiply the nominal value.
CENTRES = frozenset({"mean", "median", "peak"})


def _spread(table: Mapping[str, Any], name: Distribution) -> Iterator[Misfit]:
    """Yield numbers of a distribution that do not fit one another."""
    deviation = table.get("deviation", 0.0)
    if name == "log-normal" and deviation > WIDEST:
        far = f": one number in six would be e^{deviation:.6g} times the median or more"
        yield wrong(table, "deviation", f"at most {WIDEST:g}", far)
    if not {"low", "high"} <= table.keys():
        return
    low, high = table["low"], table["high"]
    if not low < high:
        yield wrong(table, "high", f"above low = {given(low)}")
    elif name == "log-uniform" and low <= 0.0:
        yield wrong(table, "low", "a number > 0, which has a logarithm")
    elif name == "triangular" and not low <= table["peak"] <= high:
        yield wrong(table, "peak", f"from low, {low:.6g}, to high, {high:.6g}")
    elif name == "truncated-normal" and deviation > 0.0:
        farthest = max(low - table["mean"], table["mean"] - high) / deviation
        if farthest > FARTHEST:
            words = f"at most {FARTHEST:g} deviations outside low and high"
            yield wrong(table, "mean", words, f", {farthest:.4g} deviations outside")


@record_value
class Vary:
    """A parameter that differs from run to run.

    Attributes
    ----------
    parameter
        Its path, as `platform_ctrl.job.parameters` knows it.
    distribution
        What it is drawn from.
    numbers
        What the distribution is made of, in the parameter's unit: ``low``, ``high``, ``mean``, ``median``, ``peak``;
        ``deviation`` is the standard deviation (before truncation), of the natural logarithm for ``"log-normal"``.
        The mean, median or peak of a relative variation is 1 by default.
    values, weights
        ``"choice"``: what is chosen from, in the parameter's unit, and how often, relative to one another; no weights:
        all alike.
    relative
        Whether what is drawn multiplies the nominal value instead of taking its place.
    """

    parameter: fields.Text
    distribution: Annotated[Distribution, fields.one_of(get_args(Distribution))]
    numbers: Annotated[dict[str, float], _NUMBERS] = field(default_factory=dict)
    values: fields.Numbers = ()
    weights: fields.Numbers = ()
    relative: fields.Truth = False

    @staticmethod
    def _misfits(table: Mapping[str, Any]) -> Iterator[Misfit]:
        name: Distribution = table["distribution"]
        of, keys = f"distribution = {given(name)}", DISTRIBUTION_NUMBERS[name]
        needed, more = (("values",), ("weights",)) if name == "choice" else (keys, ())
        for key in needed:
            # A factor lies about 1 unless it is said otherwise.
            if key not in table and not (key in CENTRES and table.get("relative")):
                yield missing(key, f"{of} needs {', '.join(needed)}")
        yield from takes(table, of, (), (*needed, *more), (*_NUMBERS.keys, "values", "weights"))
        yield from of_length(table, "weights", "values")
        weights = table.get("weights", (1.0,))
        if min(weights) < 0.0 or not any(weights):
            yield wrong(table, "weights", "numbers >= 0, not all of them 0")
        yield from _spread({"mean": 1.0, "peak": 1.0, **table}, name)

    def __post_init__(self) -> None:
        """Order the numbers; the centre of factors is 1 unless given."""
        centre = dict.fromkeys(CENTRES, 1.0) if self.relative else {}
        numbers = centre | self.numbers
        ordered = {key: numbers[key] for key in self.needed if key in numbers}
        object.__setattr__(self, "numbers", ordered | self.numbers)

    @property
    def needed(self) -> tuple[str, ...]:
        """Names of the numbers that the distribution is made of."""
        return DISTRIBUTION_NUMBERS[self.distribution]

    @property
    def support(self) -> tuple[float, float]:
        """Lowest and highest number that can be drawn, in the parameter's unit; infinite where there is none."""
        match self.distribution:
            case "normal":
                return -math.inf, math.inf
            case "log-normal":
                return 0.0, math.inf
            case "choice":
                weights = self.weights or (1.0,) * len(self.values)
                drawn = [x for x, weight in zip(self.values, weights, strict=True) if weight > 0.0]
                return min(drawn), max(drawn)
            case _:
                return self.numbers["low"], self.numbers["high"]


@input_value
class CampaignManoeuvre:
    """A manoeuvre of a campaign.

    Attributes
    ----------
    name
        Of a manoeuvre of the job.
    weight
        How often it is simulated, relative to the others.
    """

    name: fields.Text
    weight: fields.Positive = 1.0


@input_value
class CampaignFault:
    """A fault of the job that happens in some runs.

    Attributes
    ----------
    fault
        Its name.
    probability
        That it happens in a run: probability from 0 to 1.
    """

    fault: fields.Text
    probability: fields.Part


@input_value
class Campaign:
    """Many runs that differ.

    Attributes
    ----------
    runs
        Number of runs.
    seed
        Of all random numbers; default that of the job.
    sampling
        Sobol points with Owen's scrambling, a Latin hypercube (of all runs together, so it depends on `runs`), or
        independent points.
    step
        Longest integration step, s.
    manoeuvres
        Which are simulated; none: all of the job's, equally often.
    vary, faults
        What differs from run to run, and what may fail.
    """

    runs: fields.Runs = 1000
    seed: fields.Seed = 0
    sampling: Annotated[Points, fields.one_of(get_args(Points))] = "sobol"
    step: fields.Positive = 1e-4
    manoeuvres: Annotated[tuple[CampaignManoeuvre, ...], Array("manoeuvre", unique=("name",))] = ()
    vary: Annotated[tuple[Vary, ...], Array("vary")] = ()
    faults: Annotated[tuple[CampaignFault, ...], Array("fault", unique=("fault",))] = ()


def campaign_misfits(
    varied: Sequence[Vary], scenarios: Sequence[Scenario], faults: Sequence[Fault]
) -> Iterator[tuple[int, str, str]]:
    """Yield what cannot be drawn.

    A value that a plant or job file would refuse is refused here if it can be drawn at all, however seldom.

    Parameters
    ----------
    varied
        What differs from run to run.
    scenarios
        The nominal runs, one for each manoeuvre that is simulated.
    faults
        What may fail in them.

    Yields
    ------
    entry, key, line
        The number of the entry of `varied`, its key that is wrong, and a line that says why.
    """
    scenarios = [replaced(one, {"faults": tuple(faults)}) for one in scenarios]
    known, rules = places.parameters(scenarios, faults), places.allowed(scenarios, faults)
    drawn: set[str] = set()
    place: dict[str, int] = {}
    for k, vary in enumerate(varied):
        path = vary.parameter
        if path not in known:
            yield k, "parameter", f'parameter = "{path}": does not exist; {places.unknown_parameter(path, known)}'
        elif path in place:
            yield k, "parameter", f'parameter = "{path}": is varied already, in [[campaign.vary]] {place[path] + 1}'
        else:
            place[path] = k
            line = _misfit(vary, known[path], rules[path], scenarios, drawn)
            if line is not None:
                yield k, "relative" if line.startswith("relative") else "distribution", line
    by_path = {vary.parameter: vary for vary in varied if vary.parameter in drawn}
    for path, words in _misfits_together(by_path, known, scenarios[0]) if scenarios else ():
        yield place[path], "distribution", f'"{path}" would be drawn so that {words}'


def _misfit(
    vary: Vary, parameter: places.RunParameter, expected: Expected, scenarios: Sequence[Scenario], drawn: set[str]
) -> str | None:
    low, high = vary.support
    if parameter.factor:
        if not vary.relative and parameter.key.endswith("inertia"):
            return f'relative must be true: "{vary.parameter}" is a matrix that is scaled as a whole'
    elif vary.relative:
        present = [x for one in scenarios if (x := places.nominal(parameter, one)) is not None]
        if not any(present):
            having = "is 0 as it stands" if present else "has no value as it stands"
            return f'relative must be false, with the number itself: "{vary.parameter}" {having}'
        ends = [x * end for x in present if x for end in (low, high)]
        low, high = min(ends), max(ends)
    drawn.add(vary.parameter)
    if _fits(expected, low, high, vary.distribution != "choice"):
        return None
    bounded = " or ".join(f'"{name}"' for name in ("truncated-normal", "log-normal") if low == -math.inf)
    cure = f"; use {bounded}" if bounded else ""
    return (
        f'distribution = "{vary.distribution}": "{vary.parameter}" would be drawn between {low:.6g} and {high:.6g}; '
        f"allowed is {expected.words}{cure}"
    )


def _fits(expected: Expected, low: float, high: float, continuous: bool) -> bool:
    """Return whether all that is drawn is expected; a continuous distribution never hits its ends."""
    tiny = fields.SMALLEST if continuous else 0.0
    try:
        for end in (low or tiny, high or -tiny):
            expected.judge(min(max(end, -fields.LARGEST), fields.LARGEST))
    except Unfit:
        return False
    return True


def _misfits_together(
    varied: dict[str, Vary], known: dict[str, places.RunParameter], scenario: Scenario
) -> Iterator[tuple[str, str]]:
    """Yield numbers of one part that could be drawn so that its record would refuse them together, by their path."""
    parts: dict[tuple[object, ...], dict[str, str]] = {}
    for path in varied:
        parts.setdefault(known[path].place[:-1], {})[known[path].key] = path
    for paths in parts.values():
        part = places.part_of(known[next(iter(paths.values()))], scenario)
        if not isinstance(part, Rotor | Friction | Fault):
            continue
        if {"spin", "angular_momentum"} <= paths.keys():
            yield paths["angular_momentum"], f'"{paths["spin"]}" gives it another number; leave one of them out'
            continue
        judge, table = shape(type(part)).misfits, written(part)
        usual = {key for key, _ in judge(table)}
        for ends in product(*(varied[path].support for path in paths.values())):
            drawn = (
                (key, places.drawn_value(getattr(part, key), end, varied[path].relative))
                for (key, path), end in zip(paths.items(), ends, strict=True)
            )
            changed = table | {key: list(x) if isinstance(x, tuple) else x for key, x in drawn}
            for key, words in judge(changed):
                if key not in usual:
                    yield next(iter(paths.values())), words
                    break
