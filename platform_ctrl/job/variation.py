"""Campaigns: what differs from run to run, and how numbers are drawn; what they reach is known without drawing."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from dataclasses import field
from typing import Annotated, Any, Literal, get_args

from platform_ctrl.common.values import input_value, value
from platform_ctrl.plant import fields
from platform_ctrl.plant.mistakes import Misfit, given, missing, of_length, takes, wrong
from platform_ctrl.plant.tables import Array, Collected

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
# Standard deviation of a natural logarithm at most: of numbers that lie further apart, some are none any more.
WIDEST = 10.0
# Centres: 1 unless given where the numbers multiply the nominal value.
CENTRES = frozenset({"mean", "median", "peak"})


def _spread(table: Mapping[str, Any], name: Distribution) -> Iterator[Misfit]:
    """Walk numbers of a distribution that do not fit one another."""
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


@input_value
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


@value
class Range:
    """Which values a number may have.

    Attributes
    ----------
    words
        As a message says it.
    low, high
        The bounds, in the parameter's unit.
    low_itself
        Whether `low` itself is allowed.
    """

    words: str
    low: float = -math.inf
    high: float = math.inf
    low_itself: bool = True

    def holds(self, low: float, high: float, continuous: bool) -> bool:
        """Return whether everything drawn between two numbers is allowed.

        Parameters
        ----------
        low, high
            Lowest and highest number that can be drawn, in the parameter's unit.
        continuous
            Whether the distribution is: then it never hits its end.

        Returns
        -------
        bool
            True if it is.
        """
        return self.low <= low and high <= self.high and (low > self.low or self.low_itself or continuous)


ANY = Range(words="any number")
POSITIVE = Range(words="a number > 0", low=0.0, low_itself=False)
NOT_NEGATIVE = Range(words="a number >= 0", low=0.0)
SHARE = Range(words="a number from 0 to 1", low=0.0, high=1.0)


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
    runs, seed
        How many; what everything random is drawn from.
    sampling
        How the runs fill the space of what varies.
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
