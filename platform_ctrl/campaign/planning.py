"""The runs of a campaign: each is the same, whichever others are simulated and in which order."""

from __future__ import annotations

import functools
from collections.abc import Mapping, Sequence
from typing import Any, Literal, get_args

import numpy as np
from numpy.typing import NDArray
from scipy import stats
from scipy.stats import qmc

from platform_ctrl.analysis.system import StateSpace
from platform_ctrl.common.arguments import known_name, one_of, positive, whole
from platform_ctrl.common.values import FloatArray, read_only, value
from platform_ctrl.errors import ArgumentError
from platform_ctrl.job.faults import Fault
from platform_ctrl.job.job import Job
from platform_ctrl.job.parameters import RunParameter, parameters, varied_scenario
from platform_ctrl.job.scenario import Scenario
from platform_ctrl.job.variation import Campaign, Points, Vary, campaign_misfits

# SciPy's Sobol points have 30 bits: this many runs differ, and this is half of the smallest step.
MOST_RUNS = 2**30
_HALF_STEP = 0.5**31
# Of a Latin hypercube, which every process holds as a whole: 2 GiB.
_MOST_NUMBERS = 2**28


def expect_points(sampling: Points, runs: int, dimensions: int) -> None:
    """Refuse points that cannot be made."""
    if sampling == "latin-hypercube" and runs * dimensions > _MOST_NUMBERS:
        raise ArgumentError(
            f"runs must be at most {_MOST_NUMBERS // dimensions} with {dimensions} numbers a run, since a "
            f"'latin-hypercube' is made in one piece, got {runs}; 'sobol' and 'random' need no memory"
        )
    if sampling == "sobol" and dimensions > qmc.Sobol.MAXDIM:
        raise ArgumentError(f"sampling must be 'random' beyond 21201 numbers a run, got 'sobol' for {dimensions}")


def unit_points(sampling: Points, seed: int, runs: int, dimensions: int, first: int, last: int) -> FloatArray:
    """Return the points of runs `first` to `last` − 1 of `runs`, (last − first, dimensions), inside (0, 1).

    A Sobol sequence with Owen's scrambling (Sobol 1967, Owen 1998), a Latin hypercube (McKay, Beckman, Conover 1979),
    or independent numbers of the counter-based generator Philox (Salmon et al. 2011). A Latin hypercube depends on
    `runs` and is made in one piece: its memory, 8 bytes a number, grows with the campaign's length.
    """
    expect_points(sampling, runs, dimensions)
    if dimensions == 0 or first == last:
        return np.empty((last - first, dimensions))
    match sampling:
        case "sobol":
            return _sobol(seed, dimensions, first, last)
        case "latin-hypercube":
            return _latin_hypercube(seed, runs, dimensions)[first:last]
        case _:
            # A step of the counter makes four numbers; every run begins at another step.
            steps = -(-dimensions // 4)
            generator = np.random.Philox(key=seed)
            generator.advance(first * steps)
            return np.random.Generator(generator).random((last - first, 4 * steps))[:, :dimensions] + 0.5**54


def _sobol(seed: int, dimensions: int, first: int, last: int) -> FloatArray:
    engine = qmc.Sobol(dimensions, scramble=True, seed=np.random.default_rng(seed))
    if first > 0:  # SciPy does not skip nothing
        engine.fast_forward(first)
    # SciPy warns of a first draw that is no power of two: one is.
    points = [engine.random(1)]
    if last - first > 1:
        points.append(engine.random(last - first - 1))
    # The middles of the smallest cells, so that 0 is not among them: it would be minus infinity of a normal number.
    return np.concatenate(points) + _HALF_STEP


@functools.lru_cache(maxsize=1)
def _latin_hypercube(seed: int, runs: int, dimensions: int) -> FloatArray:
    points = qmc.LatinHypercube(dimensions, seed=np.random.default_rng(seed)).random(runs)
    return read_only(np.clip(points, 0.5**54, 1.0 - 0.5**53))


def quantiles(vary: Vary, points: FloatArray) -> FloatArray:
    """Return drawn values of a parameter at points of (0, 1): the quantiles of its distribution, of any shape."""
    n = vary.numbers
    match vary.distribution:
        case "uniform":
            return np.asarray(n["low"] * (1.0 - points) + n["high"] * points)
        case "log-uniform":
            low, high = np.log(n["low"]), np.log(n["high"])
            return np.asarray(np.clip(np.exp(low * (1.0 - points) + high * points), n["low"], n["high"]))
        case "normal":
            return np.asarray(stats.norm.ppf(points, n["mean"], n["deviation"]))
        case "log-normal":
            with np.errstate(over="ignore"):
                return np.asarray(stats.lognorm.ppf(points, n["deviation"], scale=n["median"]))
        case "truncated-normal":
            low, high = ((n[end] - n["mean"]) / n["deviation"] for end in ("low", "high"))
            drawn = stats.truncnorm.ppf(points, low, high, n["mean"], n["deviation"])
            return np.asarray(np.clip(drawn, n["low"], n["high"]))
        case "triangular":
            width = n["high"] - n["low"]
            return np.asarray(stats.triang.ppf(points, (n["peak"] - n["low"]) / width, n["low"], width))
        case _:
            return np.asarray(vary.values)[chosen(vary.weights or (1.0,) * len(vary.values), points)]


def chosen(weights: tuple[float, ...], points: FloatArray) -> np.ndarray[tuple[int, ...], np.dtype[np.intp]]:
    """Return which of several things is chosen at points of (0, 1), each as often as its weight says."""
    bounds = np.cumsum(weights) / np.sum(weights)
    # Rounding may leave the last bound below 1; what has no weight is never chosen.
    last = int(np.flatnonzero(weights)[-1])
    return np.minimum(np.searchsorted(bounds, points, side="right"), last)


Columns = dict[str, NDArray[Any]]


@value
class Plan:
    """A campaign before it is simulated: what every run is.

    Attributes
    ----------
    job, controllers
        What is simulated: the job with its `Job.campaign`, and the controllers that are closed together.
    runs, seed, sampling, step
        As in `platform_ctrl.job.variation.Campaign`; the step in s.
    nominal, weights
        The manoeuvres that are simulated, on the nominal plant, and how often each, relative to one another.
    varied
        What differs, in the order of the campaign's entries.
    failing
        What may fail beside the faults of the manoeuvres themselves, in the order of the campaign's entries.
    noise_seed
        The key of noise and random phases, together with a run's number; derived from `seed`.
    """

    job: Job
    controllers: tuple[StateSpace, ...]
    runs: int
    seed: int
    sampling: Points
    step: float
    nominal: tuple[Scenario, ...]
    weights: tuple[float, ...]
    varied: tuple[RunParameter, ...]
    failing: tuple[Fault, ...]
    noise_seed: int

    @property
    def campaign(self) -> Campaign:
        """The job's campaign; without one nothing but the noise differs from run to run."""
        return self.job.campaign or Campaign()

    @property
    def input_names(self) -> tuple[str, ...]:
        """Columns of the inputs: ``manoeuvre``, a number for each varied parameter, whether each fault happens."""
        return (
            "manoeuvre",
            *(one.parameter for one in self.campaign.vary),
            *(f"fault.{one.fault}" for one in self.campaign.faults),
        )

    @property
    def dimensions(self) -> int:
        """How many numbers in (0, 1) a run is made of: one for each of `input_names`."""
        return len(self.input_names)

    def inputs(self, first: int, last: int) -> Columns:
        """Return the inputs of runs `first` to `last` − 1: columns (N,) by `input_names`, in SI units.

        The number of a relative parameter is the factor; the column of a fault says whether it happens.
        """
        first = whole("first run", first, 0, self.runs)
        last = whole("end of the runs", last, first, self.runs)
        points = unit_points(self.sampling, _seed_of(self.seed, "inputs"), self.runs, self.dimensions, first, last)
        names = np.array([one.name for one, _ in self.job.campaign_manoeuvres], dtype=np.str_)
        columns: Columns = {"manoeuvre": names[chosen(self.weights, points[:, 0])]}
        for k, vary in enumerate(self.campaign.vary, 1):
            columns[vary.parameter] = quantiles(vary, points[:, k])
        for k, fault in enumerate(self.campaign.faults, 1 + len(self.campaign.vary)):
            columns[f"fault.{fault.fault}"] = points[:, k] < fault.probability
        return columns

    def scenarios_with(self, inputs: Mapping[str, NDArray[Any]], runs: Sequence[int]) -> list[Scenario]:
        """Return the scenarios of given inputs, columns as of `inputs`; noise depends on the numbers of the `runs`."""
        place = {manoeuvre.name: k for k, (manoeuvre, _) in enumerate(self.job.campaign_manoeuvres)}
        # Python's numbers: a dataclass keeps what it is given.
        columns = [inputs[name].tolist() for name in self.input_names]
        relative = [one.relative for one in self.campaign.vary]
        out = []
        for run, (manoeuvre, *row) in zip(runs, zip(*columns, strict=True), strict=True):
            numbers, happens = row[: len(relative)], row[len(relative) :]
            base = self.nominal[place[manoeuvre]]
            more = tuple(fault for fault, yes in zip(self.failing, happens, strict=True) if yes)
            faults = base.faults + tuple(fault for fault in more if fault not in base.faults)
            drawn = list(zip(self.varied, numbers, relative, strict=True))
            out.append(varied_scenario(base, drawn, faults=faults, seed=self.noise_seed, run=int(run)))
        return out

    def scenarios(self, first: int, last: int) -> list[Scenario]:
        """Return runs `first` to `last` − 1 of the campaign as they are simulated."""
        return self.scenarios_with(self.inputs(first, last), range(first, last))

    def scenario(self, run: int) -> Scenario:
        """Return one run of the campaign as it is simulated: the same whichever others are."""
        run = whole("run", run, 0, self.runs - 1)
        return self.scenarios(run, run + 1)[0]


def plan(
    job: Job,
    controllers: Sequence[StateSpace],
    *,
    runs: int | None = None,
    seed: int | None = None,
    sampling: Points | None = None,
) -> Plan:
    """Return the plan of a campaign's runs.

    Parameters
    ----------
    job
        With a campaign; without one its manoeuvres are simulated equally often and only the noise differs.
    controllers
        Those that are closed together.
    runs, seed, sampling
        In place of those of the job's campaign.

    Returns
    -------
    Plan
        Every run, by its number alone.

    Raises
    ------
    ArgumentError
        There is no manoeuvre; a number is out of range, or more than a Latin hypercube can have; a parameter that is
        varied does not exist, or could be drawn as something that a plant or job file refuses.

    References
    ----------
    I. M. Sobol, USSR Computational Mathematics and Mathematical Physics 7, 1967.

    A. B. Owen, Journal of Complexity 14, 1998.

    M. D. McKay, R. J. Beckman, W. J. Conover, Technometrics 21, 1979.

    J. K. Salmon et al., SC 2011.

    See docs/how-to/campaign.md.
    """
    campaign = job.campaign or Campaign(seed=job.seed)
    if not job.manoeuvres:
        raise ArgumentError(f"job {job.name!r} has no [[manoeuvre]], which runs are made of")
    for one in campaign.manoeuvres:
        known_name("manoeuvre of the campaign", one.name, [manoeuvre.name for manoeuvre in job.manoeuvres])
    for failing in campaign.faults:
        known_name("fault of the campaign", failing.fault, [fault.name for fault in job.fault_events])
    chosen_sampling = campaign.sampling if sampling is None else sampling
    one_of("sampling", chosen_sampling, get_args(Points))
    nominal = tuple(job.scenario(manoeuvre) for manoeuvre, _ in job.campaign_manoeuvres)
    for _, _, line in campaign_misfits(campaign.vary, nominal, job.fault_events):
        raise ArgumentError(line)
    known = parameters(nominal, job.fault_events)
    by_name = {fault.name: fault for fault in job.fault_events}
    number = whole("seed", campaign.seed if seed is None else seed, 0, 2**63 - 1)
    made = Plan(
        job=job,
        controllers=tuple(controllers),
        runs=whole("runs", campaign.runs if runs is None else runs, 1, MOST_RUNS),
        seed=number,
        sampling=chosen_sampling,
        step=positive("step", campaign.step),
        nominal=nominal,
        weights=tuple(weight for _, weight in job.campaign_manoeuvres),
        varied=tuple(known[one.parameter] for one in campaign.vary),
        failing=tuple(by_name[one.fault] for one in campaign.faults),
        noise_seed=_seed_of(number, "noise"),
    )
    expect_points(made.sampling, made.runs, made.dimensions)
    return made


def _seed_of(seed: int, use: Literal["inputs", "noise"]) -> int:
    """Return a seed of 63 bits for one use: inputs and noise are drawn from different ones."""
    return int(
        np.random.SeedSequence((seed, ("inputs", "noise").index(use))).generate_state(1, np.uint64)[0] >> np.uint64(1)
    )
