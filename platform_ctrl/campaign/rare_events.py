"""Probabilities too small to be counted: importance splitting towards the limit, repeated to know how sure it is.

Subset simulation (Au and Beck, Probabilistic Engineering Mechanics 16, 2001): the runs with the largest metrics are
where the next runs start from, by Markov chains that keep the distribution of the inputs; each level leaves a tenth.
Candidates move by the rule that needs no tuning by dimension, here called Crank-Nicolson's, as Papaioannou, Betz,
Zwirglmaier and Straub do (same journal, 41, 2015).

Noise is one more random input, infinitely many numbers: the run's number represents them all. A candidate keeps its
predecessor's noise or draws a fresh one, each in half of the moves. Both leave the distribution as it is, hence their
mixture too. Fresh noise alone would seldom be accepted where the noise matters; kept noise alone would never leave the
few realisations that the first level happened to draw. Noise that decides more than the inputs do cannot be led to the
limit step by step: `RareResult.noise_decides` tells.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from platform_ctrl.campaign.probability import (
    CONFIDENCE,
    RareMethod,
    RarePoint,
    RareResult,
    Repetition,
    clopper_pearson,
)
from platform_ctrl.common.arguments import one_of
from platform_ctrl.common.signatures import check_arguments, short
from platform_ctrl.common.values import FloatArray, value
from platform_ctrl.errors import ArgumentError, SimulationError

# Part of the runs that is drawn from the inputs' own density: no weight exceeds its inverse.
_DEFENSIVE = 0.1
# Points for each number of a mean before there are two Gaussians.
_FEWEST_POINTS = 8
_STEPS = 30
_LEAST_DEVIATION = 0.1


@value
class Mixture:
    """Gaussians with shares (k,), means (k, d), and lower Cholesky factors (k, d, d) of their covariances."""

    shares: FloatArray
    means: FloatArray
    factors: FloatArray

    def draw(self, number: int, generator: np.random.Generator) -> FloatArray:
        """Return points (number, d), a tenth of them from the inputs' own density."""
        own = generator.random(number) < _DEFENSIVE
        which = generator.choice(len(self.shares), number, p=self.shares)
        z = generator.standard_normal((number, self.means.shape[1]))
        moved = self.means[which] + np.einsum("nij,nj->ni", self.factors[which], z)
        return np.where(own[:, None], z, moved)

    def weights(self, z: FloatArray) -> FloatArray:
        """Return the inputs' density over the one that is drawn from."""
        own = -0.5 * (z**2).sum(axis=1)
        parts = np.vstack([np.log1p(-_DEFENSIVE) + self._logarithms(z), np.log(_DEFENSIVE) + own[None, :]])
        return np.asarray(np.exp(own - np.logaddexp.reduce(parts, axis=0)))

    def memberships(self, z: FloatArray) -> FloatArray:
        """Return how probable it is that each point belongs to each Gaussian, (k, N)."""
        logarithms = self._logarithms(z)
        return np.asarray(np.exp(logarithms - np.logaddexp.reduce(logarithms, axis=0)))

    def _logarithms(self, z: FloatArray) -> FloatArray:
        """Return the logarithms of share times density, without the factor (2π)^(−d/2)."""
        out = []
        for share, mean, factor in zip(self.shares, self.means, self.factors, strict=True):
            residual = np.linalg.solve(factor, (z - mean).T)
            out.append(np.log(share) - 0.5 * (residual**2).sum(axis=0) - np.log(np.diag(factor)).sum())
        return np.array(out)


def nearest_mixture(z: FloatArray) -> Mixture:
    """Return the mixture of greatest likelihood for points (N, d), by expectation and maximisation.

    Covariances lean towards the inputs' own, the more the fewer points there are for each number in them.
    """
    N, d = z.shape
    centred = z - z.mean(axis=0)
    # Start from two halves along the direction in which the points lie farthest apart.
    direction = np.linalg.svd(centred, full_matrices=False)[2][0] if d else np.zeros(0)
    side = centred @ direction > 0.0
    halves = _FEWEST_POINTS * (d + 1) < N and bool(side.any()) and not bool(side.all())
    member = np.array([side, ~side], dtype=np.float64) if halves else np.ones((1, N))
    mixture = _maximised(z, member)
    for _ in range(_STEPS if halves else 0):
        mixture = _maximised(z, mixture.memberships(z))
    return mixture


def _maximised(z: FloatArray, member: FloatArray) -> Mixture:
    d = z.shape[1]
    number = member.sum(axis=1)
    shares = np.maximum(number / number.sum(), 1e-3)
    means, factors = [], []
    for row, points in zip(member, number, strict=True):
        share = row / max(float(points), 1e-12)
        mean = share @ z
        covariance = (z - mean).T @ ((z - mean) * share[:, None])
        # Points of a chain are alike: one in ten counts.
        lean = d / (d + 0.1 * float(points)) if d else 0.0
        covariance = (1.0 - lean) * covariance + (lean + _LEAST_DEVIATION**2) * np.eye(d)
        means.append(mean)
        factors.append(np.linalg.cholesky(covariance))
    return Mixture(shares=shares / shares.sum(), means=np.array(means), factors=np.array(factors))


RunNumbers = NDArray[np.int64]
# Points of the unit cube (N, d) and the numbers of their noise (N,) to metrics over their limits (N,).
Ratios = Callable[[FloatArray, RunNumbers], FloatArray]

# A run violates when its metric over the limit is above 1.
VIOLATED = float(np.nextafter(1.0, 2.0))
# What Crank-Nicolson steps should be accepted at, for the fastest chains.
_ACCEPTANCE = 0.44
_FRESH_NOISE = 0.5
_SHARE = 0.1
_MOST_LEVELS = 15
_KEPT = 10
FEWEST_SAMPLES = 50


@check_arguments
def rare_event(  # noqa: PLR0913 - options by keyword
    ratios: Ratios,
    dimension: int,
    *,
    samples: int = 1000,
    repetitions: int = 8,
    method: RareMethod = "splitting",
    confidence: float = CONFIDENCE,
    seed: int = 0,
    first_run: int = 0,
    say: Callable[[str], None] = lambda line: None,
) -> RareResult:
    """Return the probability that a metric exceeds its limit, where counting would take too many runs.

    Parameters
    ----------
    ratios
        From points of the unit cube, (N, d), and the numbers of their noise, (N,), to metrics over their limits, (N,):
        above 1 means violated. Called with many points at once.
    dimension
        d; 0 if the noise alone is random.
    samples
        Runs a level.
    repetitions
        Independent estimates, at least 2.
    method
        ``"splitting"``: subset simulation; ``"cross-entropy"``: after it, as many weighted runs from the Gaussian
        mixture nearest to the violating points. With ten inputs or fewer the scatter is several times smaller for a
        fifth more runs; what splitting did not find it does not see either.
    confidence
        Probability of the interval.
    seed
        The same seed, the same result.
    first_run
        Numbers from here on stand for noise.
    say
        Called with a line before each repetition.

    Returns
    -------
    RareResult
        The mean of the repetitions with its interval, and the points that violate.

    Raises
    ------
    ArgumentError
        Too few samples or repetitions.
    SimulationError
        A metric is not a number: a run could not be carried out.

    References
    ----------
    S. K. Au, J. L. Beck, Probabilistic Engineering Mechanics 16, 2001.

    I. Papaioannou, W. Betz, K. Zwirglmaier, D. Straub, Probabilistic Engineering Mechanics 41, 2015.

    R. Y. Rubinstein, D. P. Kroese, The Cross-Entropy Method, 2004.

    U. Olsson, Journal of Statistics Education 13, 2005.
    """
    one_of("method", method, ("splitting", "cross-entropy"))
    if samples < FEWEST_SAMPLES or repetitions < 2 or dimension < 0:
        raise ArgumentError(
            f"rare event: there must be at least {FEWEST_SAMPLES} samples and 2 repetitions of 0 or more inputs, got "
            f"{samples}, {repetitions} and {dimension}"
        )
    evaluator = Evaluator(ratios, first_run)
    estimates, points = [], []
    for number in range(repetitions):
        generator = np.random.default_rng([seed, number])
        say(f"rare event: repetition {number + 1} of {repetitions}")
        estimate, found = _split(evaluator, dimension, samples, generator)
        if method == "cross-entropy" and estimate.levels.size > 1 and found.y.size:
            estimate, found = _weighted(evaluator, estimate, found, samples, generator)
        estimates.append(estimate)
        points.append(found)
    return _together(method, tuple(estimates), points, samples, confidence)


class Cloud:
    """Points in standard normal space with the numbers of their noise and their metrics."""

    __slots__ = ("run", "y", "z")

    def __init__(self, z: FloatArray, run: RunNumbers, y: FloatArray) -> None:
        self.z, self.run, self.y = z, run, y

    def at(self, rows: NDArray[np.intp] | NDArray[np.bool_]) -> Cloud:
        """Return some of the points."""
        return Cloud(self.z[rows], self.run[rows], self.y[rows])

    @staticmethod
    def joined(clouds: list[Cloud]) -> Cloud:
        """Return all points of several clouds."""
        return Cloud(
            np.concatenate([one.z for one in clouds]),
            np.concatenate([one.run for one in clouds]),
            np.concatenate([one.y for one in clouds]),
        )


class Evaluator:
    """Evaluates points of standard normal space; counts them, and numbers the noise."""

    def __init__(self, ratios: Ratios, first_run: int) -> None:
        self.ratios, self.next_run, self.evaluations = ratios, first_run, 0

    def fresh(self, number: int) -> RunNumbers:
        """Return numbers whose noise nobody had before."""
        self.next_run += number
        return np.arange(self.next_run - number, self.next_run, dtype=np.int64)

    def evaluate(self, z: FloatArray, run: RunNumbers) -> Cloud:
        """Return the points with their metrics."""
        from scipy.special import ndtr

        # The end points of the unit cube are nobody's inputs: many distributions are infinite there.
        u = np.clip(ndtr(z), np.finfo(float).tiny, 1.0 - np.finfo(float).epsneg)
        y = np.asarray(self.ratios(u, run), dtype=np.float64)
        if y.shape != run.shape:
            raise ArgumentError(f"ratios must have the shape {run.shape}, one for each point, got {y.shape}")
        missing = np.isnan(y)
        if missing.any():
            raise SimulationError(
                f"rare event: {missing.sum()} of {len(y)} runs could not be simulated, for example inputs "
                f"{short(u[missing][0].tolist())}"
            )
        self.evaluations += len(y)
        return Cloud(z, run, y)


def _split(
    evaluator: Evaluator, dimension: int, samples: int, generator: np.random.Generator
) -> tuple[Repetition, Cloud]:
    before = evaluator.evaluations
    cloud = evaluator.evaluate(generator.standard_normal((samples, dimension)), evaluator.fresh(samples))
    probability, variance = 1.0, 0.0
    levels: list[float] = []
    # The points of the first level are independent: each is a chain.
    chains = samples
    while True:
        violated = cloud.y >= VIOLATED
        if violated.mean() >= _SHARE or len(levels) == _MOST_LEVELS:
            break
        level = _next_level(cloud.y)
        if level is None:
            violated = np.zeros_like(violated)
            break
        survived = cloud.y >= level
        probability *= float(survived.mean())
        variance += _variance(survived, chains)
        levels.append(level)
        cloud, chains = _moved(evaluator, cloud.at(survived), level, samples, generator)
    last = float(violated.mean())
    if last > 0.0:
        levels.append(1.0)
        variance += _variance(violated, chains)
    # Where nothing violates, chains tell less than independent runs: their number is what is counted on.
    below = probability * (last if last > 0.0 else clopper_pearson(0, chains).high)
    estimate = Repetition(
        probability=probability * last,
        below=below,
        levels=np.array(levels),
        variation=float(np.sqrt(variance)),
        evaluations=evaluator.evaluations - before,
        noises=len(np.unique(cloud.run[violated])),
    )
    return estimate, cloud.at(violated)


def _weighted(
    evaluator: Evaluator, before: Repetition, violating: Cloud, samples: int, generator: np.random.Generator
) -> tuple[Repetition, Cloud]:
    """Return the estimate of weighted runs where `violating` lie, and the violating points of both."""
    mixture = nearest_mixture(violating.z)
    cloud = evaluator.evaluate(mixture.draw(samples, generator), evaluator.fresh(samples))
    violated = cloud.y >= VIOLATED
    weights = np.where(violated, mixture.weights(cloud.z), 0.0)
    probability = float(weights.mean())
    estimate = Repetition(
        probability=probability,
        below=max(probability, before.below),
        levels=before.levels,
        variation=float(weights.std()) / np.sqrt(samples) / probability if probability else 0.0,
        evaluations=before.evaluations + samples,
        noises=before.noises,
    )
    return estimate, violating


def _next_level(y: FloatArray) -> float | None:
    """Return the metric that a tenth of the points reach, the limit at most; None if all points are alike.

    On a plateau more of them reach it; if all do, the level is whatever lies above the plateau.
    """
    level = min(float(np.partition(y, -max(int(_SHARE * len(y)), 1))[-max(int(_SHARE * len(y)), 1)]), VIOLATED)
    if (y >= level).all():
        above = y[y > level]
        return float(above.min()) if above.size else None
    return level


def _variance(hit: NDArray[np.bool_], chains: int) -> float:
    """Return the squared coefficient of variation of a share, with what neighbours in a chain have in common."""
    steps = len(hit) // chains
    share = hit.mean()
    if share in (0.0, 1.0):
        return 0.0
    own = hit.reshape(steps, chains) - share
    power = share * (1.0 - share)
    lags = np.arange(1, steps)
    correlation = np.array([(own[k:] * own[:-k]).mean() / power for k in lags])
    common = 2.0 * float(((1.0 - lags / steps) * correlation).sum()) if steps > 1 else 0.0
    return float((1.0 - share) / (share * len(hit)) * max(1.0 + common, 0.0))


def _moved(
    evaluator: Evaluator, seeds: Cloud, level: float, samples: int, generator: np.random.Generator
) -> tuple[Cloud, int]:
    """Return chains from the seeds, side by side, and how many: points that all reach the level."""
    order = generator.permutation(len(seeds.y))
    now = seeds.at(order)
    chains, dimension = now.z.shape
    steps = max(-(-samples // chains), 2)
    spread = np.minimum(now.z.std(axis=0), 1.0) if chains > 1 else np.ones(dimension)
    chain, scale = [now], 0.6
    for step in range(1, steps):
        width = np.minimum(scale * np.maximum(spread, 0.05), 1.0)
        noise = np.where(generator.random(chains) < _FRESH_NOISE, evaluator.fresh(chains), now.run)
        z = np.sqrt(1.0 - width**2) * now.z + width * generator.standard_normal(now.z.shape)
        candidate = evaluator.evaluate(z, noise)
        accepted = candidate.y >= level
        now = Cloud(
            np.where(accepted[:, None], candidate.z, now.z),
            np.where(accepted, candidate.run, now.run),
            np.where(accepted, candidate.y, now.y),
        )
        chain.append(now)
        scale *= float(np.exp((accepted.mean() - _ACCEPTANCE) / np.sqrt(step)))
    return Cloud.joined(chain), chains


def _together(
    method: RareMethod, estimates: tuple[Repetition, ...], points: list[Cloud], samples: int, confidence: float
) -> RareResult:
    found = np.array([one.probability for one in estimates])
    mean = float(found.mean())
    low, high, variation = _interval(estimates, found, samples, confidence)
    nearest, shift = _nearest(Cloud.joined(points))
    return RareResult(
        method=method,
        probability=mean,
        low=low,
        high=high,
        confidence=confidence,
        variation=variation,
        repetitions=estimates,
        evaluations=sum(one.evaluations for one in estimates),
        violations=nearest,
        shift=shift,
    )


def _interval(
    estimates: tuple[Repetition, ...], found: FloatArray, samples: int, confidence: float
) -> tuple[float, float, float]:
    """Return bounds and coefficient of variation of the mean."""
    from scipy import stats

    mean, number = float(found.mean()), len(found)
    if mean == 0.0:
        return 0.0, max(one.below for one in estimates), float("inf")
    if all(one.evaluations == samples for one in estimates):
        # Frequent enough to be counted at once.
        counted = clopper_pearson(round(mean * samples * number), samples * number, confidence)
        return counted.low, counted.high, float(np.sqrt((1.0 - mean) / (mean * samples * number)))
    own = np.array([one.variation for one in estimates])
    within = float(np.mean((own * found) ** 2))
    variation = float(np.sqrt(max(found.var(ddof=1), within) / number)) / mean
    # A product of shares scatters in its logarithm: Cox's interval of a log-normal mean with Student's t (Olsson, J. of
    # Statistics Education 13, 2005), which grows as it should where the mean rests on a few large estimates. Either
    # scatter may be the larger: few repetitions agree by chance, and one alone does not see what all of it missed.
    logarithms = np.log([one.probability or one.below for one in estimates])
    scatter = max(float(logarithms.var(ddof=1)), float(np.log1p(np.mean(own[found > 0.0] ** 2))))
    quantile = float(stats.t.ppf(0.5 + 0.5 * confidence, number - 1))
    half = quantile * np.sqrt(scatter / number + scatter**2 / (2.0 * (number - 1)))
    middle = float(logarithms.mean()) + 0.5 * scatter
    low, high = float(np.exp(middle - half)), min(float(np.exp(min(middle + half, 0.0))), 1.0)
    if not found.all():
        # Nothing is known of the logarithm of zero; by Markov's inequality the mean is seldom so many times the truth.
        low = 0.5 * (1.0 - confidence) * mean
    return min(low, mean), max(high, mean), variation


def _nearest(violating: Cloud) -> tuple[tuple[RarePoint, ...], FloatArray]:
    from scipy.special import ndtr

    if not violating.y.size:
        return (), np.zeros(violating.z.shape[1])
    distance = np.linalg.norm(violating.z, axis=1)
    _, first = np.unique(np.column_stack([violating.z, violating.run]), axis=0, return_index=True)
    chosen = first[np.lexsort((violating.run[first], distance[first]))[:_KEPT]]
    points = tuple(
        RarePoint(
            u=ndtr(violating.z[k]),
            run=int(violating.run[k]),
            ratio=float(violating.y[k]),
            distance=float(distance[k]),
        )
        for k in chosen
    )
    return points, violating.z.mean(axis=0)
