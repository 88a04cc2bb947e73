"""Importance sampling where splitting has been: weighted runs from the density that is nearest to the violating points.

The density is a mixture of Gaussians in standard normal space, the nearest one in the sense of cross-entropy
(Rubinstein and Kroese, The Cross-Entropy Method, Springer 2004): that of greatest likelihood for points that have the
distribution of violating inputs. Splitting delivers such points; climbing by weights from level to level instead loses
the way with twenty inputs, or one of two branches. Noise is drawn afresh for every run and needs no weight.
"""

from __future__ import annotations

import numpy as np

from platform_ctrl.frozen import FloatArray, value

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
