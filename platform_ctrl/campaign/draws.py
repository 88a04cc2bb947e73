"""Points that fill the unit cube, and what distributions make of them; any run's without those before it."""

from __future__ import annotations

import functools

import numpy as np
from scipy import stats
from scipy.stats import qmc

from platform_ctrl.errors import ArgumentError
from platform_ctrl.frozen import FloatArray, read_only
from platform_ctrl.job import Points
from platform_ctrl.variation import Vary

# SciPy's Sobol points have 30 bits: this many runs differ, and this is half of the smallest step.
MOST_RUNS = 2**30
_HALF_STEP = 0.5**31
# Of a Latin hypercube, which every process holds as a whole: 2 GiB.
_MOST_NUMBERS = 2**28


def expect_points(sampling: Points, runs: int, dimensions: int) -> None:
    """Refuse points that cannot be made.

    Raises
    ------
    ArgumentError
        A Latin hypercube of more numbers than memory should hold, or more dimensions than Sobol's points have.
    """
    if sampling == "latin-hypercube" and runs * dimensions > _MOST_NUMBERS:
        raise ArgumentError(
            f"runs: given {runs} of 'latin-hypercube', which is made in one piece; expected at most "
            f"{_MOST_NUMBERS // dimensions} with {dimensions} numbers a run; 'sobol' and 'random' need no memory"
        )
    if sampling == "sobol" and dimensions > qmc.Sobol.MAXDIM:
        raise ArgumentError(f"sampling: given 'sobol' for {dimensions} numbers a run; expected 'random' beyond 21201")


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
            return _random(seed, dimensions, first, last)


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


def _random(seed: int, dimensions: int, first: int, last: int) -> FloatArray:
    # A step of the counter makes four numbers; every run begins at a step of its own.
    steps = -(-dimensions // 4)
    generator = np.random.Philox(key=seed)
    generator.advance(first * steps)
    raw = generator.random_raw((last - first) * steps * 4).reshape(last - first, 4 * steps)[:, :dimensions]
    return (raw >> np.uint64(11)).astype(np.float64) * 0.5**53 + 0.5**54


def quantiles(vary: Vary, points: FloatArray) -> FloatArray:
    """Return what a parameter is drawn as at points of (0, 1): the quantiles of its distribution, of any shape."""
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
