"""How the budget of a loop is put together: powers of its controls, and integrals over panels of frequency.

Integrals are taken by Gauss and Kronrod's rule of 21 nodes, over many panels at once.

Over a window of length T a motion x(t) is split by least squares into its mean (displacement), a linear trend (smear)
and the rest (jitter). The parts are orthogonal. Of a component at the frequency ω, averaged over its phase, they hold
the shares, with a = ωT/2 and the spherical Bessel functions j_n,

    displacement j₀(a)²,        smear 3 j₁(a)²,        jitter Σ (2 n + 1) j_n(a)²,  n = 2, 3, ...,

the coefficients of exp(jωt) in Legendre polynomials; they add up to one. Its jitter, one minus the other two, loses all
digits for short windows (the share is a⁴/45); the sum does not.

References
----------
S. W. Sirlin, A. M. San Martin, A new definition of pointing stability, JPL EM 343-1189, 1990.

R. L. Lucke, S. W. Sirlin, A. M. San Martin, New definitions of pointing stability: ac and dc effects, Journal of the
Astronautical Sciences 40, 1992.

M. E. Pittelkau, W. G. McKinley, Optical transfer functions, weighting functions, and metrics for images with
two-dimensional line-of-sight motion, Optical Engineering 55, 2016.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.polynomial import legendre
from numpy.typing import ArrayLike, NDArray

from platform_ctrl.analysis.hybrid_plant import Disturbance, HybridPlant, RandomDisturbance, SampleNoise
from platform_ctrl.analysis.interconnection import Modulator
from platform_ctrl.analysis.system import ComplexArray
from platform_ctrl.common.arguments import positive, real_numbers
from platform_ctrl.common.values import FloatArray, value


def _kronrod() -> tuple[FloatArray, FloatArray]:
    """Return the 21 nodes of Kronrod's rule, every second one a node of Gauss's of ten, and their weights.

    The others are the zeros of Stieltjes's polynomial P₁₁ + Σ c_k P_k, orthogonal to P₁₀ P_j for j < 10 (Monegato, SIAM
    Review 24, 1982).
    """
    x, weights = legendre.leggauss(16)
    P, odd = legendre.legvander(x, 11), np.arange(1, 10, 2)
    triple = np.einsum("n,nj,nk->jk", weights * P[:, 10], P, P)
    stieltjes = np.eye(12)[11]
    stieltjes[odd] = np.linalg.solve(triple[np.ix_(odd, odd)], -triple[odd, 11])
    nodes = np.sort(np.concatenate([legendre.leggauss(10)[0], legendre.legroots(stieltjes).real]))
    nodes = 0.5 * (nodes - nodes[::-1])
    return nodes, np.linalg.solve(legendre.legvander(nodes, 20).T, 2.0 * np.eye(21)[0])


NODES, KRONROD = _kronrod()
GAUSS = np.zeros(21)
GAUSS[1::2] = legendre.leggauss(10)[1]

# Integrals of a polynomial through the nodes, from -1 to each node and to 1, in terms of its values there.
_DEGREES = legendre.legvander(NODES, len(NODES) - 1)
_INTEGRALS = legendre.legvander(np.append(NODES, 1.0), len(NODES)) @ legendre.legint(np.eye(len(NODES)), lbnd=-1.0)
UP_TO = np.linalg.solve(_DEGREES.T, _INTEGRALS.T).T

Panel = tuple[float, float]
# Relative distance of edges of panels below which they are one.
_SAME = 1e-9


def nodes(panels: list[Panel]) -> tuple[FloatArray, FloatArray]:
    """Return the nodes of each panel (P, 21) and half the width of each (P,)."""
    ends = np.array(panels).reshape(-1, 2)
    half = 0.5 * (ends[:, 1] - ends[:, 0])
    return ends[:, :1] + half[:, None] * (1.0 + NODES), half


def between(edges: FloatArray, low: float, high: float) -> list[Panel]:
    """Return the panels between `low`, the `edges` inside, and `high`; edges that hardly differ are one."""
    inside = np.unique(edges[(edges > low) & (edges < high)])
    kept = [low]
    for one in inside:
        if one - kept[-1] > _SAME * one and high - one > _SAME * high:
            kept.append(float(one))
    return list(zip(kept, [*kept[1:], high], strict=True))


def halves(panel: Panel) -> list[Panel]:
    """Return both halves; of a panel over more than a factor of four, the parts beside its geometric mean."""
    low, high = panel
    middle = float(np.sqrt(low * high)) if 0.0 < 4.0 * low < high else 0.5 * (low + high)
    if low == 0.0:
        middle = high / 16.0
    return [(low, middle), (middle, high)]


# Poles with less damping than this have panels of their own, unless panels around are within so many of their widths.
_SHARP, WIDE = 0.1, 30.0


def edges_around(s: ComplexArray) -> FloatArray:
    """Return edges around the resonances of poles."""
    sharp = (s.imag > 0.0) & (np.abs(s.real) < _SHARP * np.abs(s))
    centre, width = s[sharp].imag, np.maximum(np.abs(s[sharp].real), 1e-6 * s[sharp].imag)
    edges = [np.abs(s[np.isfinite(s)]), *(centre + k * width for k in (-12.0, -3.0, 0.0, 3.0, 12.0))]
    out: FloatArray = np.concatenate(edges)
    return out[out > 0.0]


class NodeResponses(NamedTuple):
    """Responses at the nodes of some panels, weighted by the roots of the densities; images with sources are `inside`.

    theta (N,), frequency (N, F), direct (N, I, q, c), measured (N, I, p, c), held (N, I, q, m), outer (N, F, q, m²),
    rest (N, R, q, m²), sampled (N, R, p, m), weights (W, N, F); R: samples of a cycle, c: columns of random sources.
    """

    theta: FloatArray
    frequency: FloatArray
    inside: tuple[int, ...]
    direct: ComplexArray
    measured: ComplexArray
    held: ComplexArray
    outer: FloatArray
    rest: FloatArray
    sampled: ComplexArray
    weights: FloatArray

    def rows(self, rows: slice) -> NodeResponses:
        """Return those at some of the nodes."""
        return self._replace(**{name: getattr(self, name)[rows] for name in _BY_NODE}, weights=self.weights[:, rows])


# Fields whose first axis is that of the nodes.
_BY_NODE = tuple(name for name in NodeResponses._fields if name not in ("inside", "weights"))


def joined(blocks: list[NodeResponses]) -> NodeResponses:
    """Return the responses at the nodes of all blocks."""
    if len(blocks) == 1:
        return blocks[0]
    fields = {name: np.concatenate([getattr(one, name) for one in blocks]) for name in _BY_NODE}
    weights = np.concatenate([one.weights for one in blocks], axis=1)
    return NodeResponses(**fields, inside=blocks[0].inside, weights=weights)


# Below this a the jitter is summed; above it one minus the other two has lost less than a digit.
_SUMMED = 2.0
# Terms of the sum: the next one is below 1e-20 of the first.
_ORDERS = np.arange(2, 14)


class WindowShares(NamedTuple):
    """Shares of a component's mean square that are displacement, smear and jitter; each has the frequencies' shape."""

    displacement: FloatArray
    smear: FloatArray
    jitter: FloatArray


def window_shares(frequency: ArrayLike, exposure: float) -> WindowShares:
    """Return a component's shares of mean square in displacement, smear and jitter in a window of length `exposure`, s.

    At frequencies in rad/s, of any shape; each share is right to rounding. The smear is the mean square of the fitted
    line about its middle: a line of extent E, end to end, has E²/12.
    """
    from scipy.special import spherical_jn

    a = (
        0.5
        * positive("window_shares: exposure", exposure)
        * np.abs(real_numbers("window_shares: frequency", frequency))
    )
    displacement, smear = spherical_jn(0, a) ** 2, 3.0 * spherical_jn(1, a) ** 2
    jitter = 1.0 - displacement - smear
    short = a < _SUMMED
    if np.any(short):
        orders = _ORDERS.reshape(-1, *(1,) * np.ndim(a[short]))
        jitter[short] = np.sum((2 * orders + 1) * spherical_jn(orders, a[short]) ** 2, axis=0)
    return WindowShares(displacement, smear, jitter)


def motion_transfer(spatial_frequency: ArrayLike, jitter: float, smear: float = 0.0) -> FloatArray:
    """Return the modulation transfer function of image motion along one axis; 1 at ν = 0.

    `spatial_frequency` ν is in cycles per radian, of any shape. Gaussian jitter of rms σ, rad: the factor exp(−2 π² σ²
    ν²). `smear` is the rms of the fitted line within the window, rad: its extent is Gaussian with the standard
    deviation √12 `smear`, and the mean factor over many exposures is E[sin(πνE)/(πνE)] = √(2π)/k erf(k/√8), k = 2 πν
    √12 `smear` (Pittelkau and McKinley, Optical Engineering 55, 2016).
    """
    from scipy.special import erf

    nu = np.abs(real_numbers("motion_transfer: spatial_frequency", spatial_frequency))
    k = 2.0 * math.pi * math.sqrt(12.0) * smear * nu
    # Below, the next term of 1 − k²/24 is under rounding.
    with np.errstate(divide="ignore", invalid="ignore"):
        drawn = np.where(k > 1e-4, math.sqrt(2.0 * math.pi) / k * erf(k / math.sqrt(8.0)), 1.0 - k * k / 24.0)
    return np.asarray(np.exp(-2.0 * (math.pi * jitter * nu) ** 2) * drawn)


@value
class Window:
    """Displacement, smear and jitter within an exposure; root mean squares over its instants and over exposures."""

    exposure: float  # s
    # displacement, smear, jitter: (q,): of all sources together, in the outputs' units.
    displacement: FloatArray
    smear: FloatArray
    jitter: FloatArray


@value
class BudgetResult:
    """What each of G sources does to each of q outputs."""

    names: tuple[str, ...]  # of the sources
    rms: FloatArray  # (G, q): in the outputs' units
    total: FloatArray  # (q,): of all sources together; sines that add coherently are not the root of the sum of squares
    lowest: float  # motion below this frequency, rad/s, does not count in `rms`, `total` and displacements
    windows: tuple[Window, ...]  # one for each exposure
    edges: FloatArray  # (E,): frequencies, rad/s, rising, up to which `cumulative` sums
    cumulative: FloatArray  # (G, q, E): variance of each source up to the edges, sines included
    total_cumulative: FloatArray  # (q, E): the same of all sources
    error: float  # bound on the error of integration, the largest relative to a variance
    # Bound on the share of an integrated output's variance that images beyond those kept would add; what they add to
    # other outputs is included.
    remaining: float


# Edges of cumulative variances that are nearer to each other than this, relative, are one where there are many images.
_NEAR = 1e-3


# Upper ends (N,) of intervals of frequency, rad/s, and integrals over them (N, G, q).
Steps = tuple[FloatArray, FloatArray]


class Contribution(NamedTuple):
    """Integrals over P panels for G sources, q outputs and W weights, or the lines of sines."""

    panels: FloatArray  # (P, 2): ends, rad/s
    # variance, error: (P, W, G, q): integrals over all images that are kept, and bounds on their errors.
    variance: FloatArray
    error: FloatArray
    remaining: FloatArray  # (P, G, q): of the images that are not kept, before integration of an output
    steps: list[Steps]  # of each panel, for the first weight; none where they are not wanted
    sines: tuple[str, ...] = ()  # names of the sines whose lines these are; the last of the G sources is their sum

    def chosen(self, good: NDArray[np.bool_]) -> Contribution:
        """Return those of some panels."""
        steps = [one for one, kept in zip(self.steps, good, strict=False) if kept]
        return self._replace(**{name: getattr(self, name)[good] for name in _BY_PANEL}, steps=steps)

    @staticmethod
    def joined(parts: list[Contribution]) -> Contribution:
        """Return the contributions of the panels of all parts."""
        arrays: dict[str, Any] = {name: np.concatenate([getattr(one, name) for one in parts]) for name in _BY_PANEL}
        return parts[0]._replace(**arrays, steps=[step for one in parts for step in one.steps])


# Fields whose first axis is that of the panels.
_BY_PANEL = ("panels", "variance", "error", "remaining")


def assembled(
    plant: HybridPlant,
    sources: Sequence[Disturbance],
    exposures: Sequence[float],
    lowest: float,
    found: list[Contribution],
    lines: list[Contribution],
    images: int,
) -> BudgetResult:
    """Return the budget of panels of random sources and of lines of sines, with so many images on each side."""
    names = tuple(one.name for one in sources)
    order = [
        names.index(one.name) for kind in (RandomDisturbance, SampleNoise) for one in sources if isinstance(one, kind)
    ]
    G, q, W = len(names), plant.outputs, 1 + 3 * len(exposures)
    integrated = np.array(plant.integrated, dtype=np.bool_)
    variance, rest, error = np.zeros((W, G, q)), np.zeros((G, q)), np.zeros((W, G, q))
    for one in found:
        variance[:, order] += one.variance.sum(axis=0)
        error[:, order] += one.error.sum(axis=0)
        rest[order] += one.remaining.sum(axis=0)
    coherent, more = np.zeros((W, q)), np.zeros(q)
    for one in lines:
        rows = [names.index(name) for name in one.sines]
        variance[:, rows] += one.variance[0, :, :-1]
        rest[rows] += one.remaining[0, :-1]
        # Cross terms: the square of the sum of the lines less the sum of their squares.
        coherent += one.variance[0, :, -1] - one.variance[0, :, :-1].sum(axis=1)
        more += one.remaining[0, -1] - one.remaining[0, :-1].sum(axis=0)
    highest = max([0.5 * plant.turn, *(float(one.panels[0, 0]) for one in lines)])
    beyond = (1.0 + images) * plant.turn - highest if found or lines else 1.0
    bound = np.where(integrated, rest / beyond**2, 0.0)
    added, joint = np.where(integrated, 0.0, rest), np.where(integrated, 0.0, more)
    # All that is beyond is jitter.
    for k in [0, *range(3, W, 3)]:
        variance[k] += added
        coherent[k] += joint
    total = variance.sum(axis=1) + coherent
    with np.errstate(divide="ignore", invalid="ignore"):
        share = bound.sum(axis=0) / total[0]
        relative = error / (variance + 1e-6 * total[:, None])
    root = np.sqrt(np.maximum(variance, 0.0))
    whole = np.sqrt(np.maximum(total, 0.0))
    windows = tuple(
        Window(exposure=one, displacement=whole[3 * k + 1], smear=whole[3 * k + 2], jitter=whole[3 * k + 3])
        for k, one in enumerate(exposures)
    )
    edges, cumulative, together = _cumulated(plant, found, lines, names, order)
    return BudgetResult(
        names=names,
        rms=root[0],
        total=whole[0],
        lowest=lowest,
        windows=windows,
        edges=edges,
        cumulative=cumulative,
        total_cumulative=together,
        error=float(np.nanmax(relative, initial=0.0)),
        remaining=float(np.nanmax(share, initial=0.0)),
    )


def _cumulated(
    plant: HybridPlant, found: list[Contribution], lines: list[Contribution], names: tuple[str, ...], order: list[int]
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return edges, the variance up to them by source, and of all: panels with their images lie beside each other."""
    G, q = len(names), plant.outputs
    # The last one is all of them together.
    upper, steps = [np.zeros(1)], [np.zeros((1, G + 1, q))]
    for one in [*found, *lines]:
        rows = [names.index(name) for name in one.sines] or order
        for ends, parts in one.steps:
            step = np.zeros((len(ends), G + 1, q))
            step[:, rows] = parts[:, : len(rows)]
            step[:, -1] = parts[:, -1] if one.sines else parts.sum(axis=1)
            upper.append(ends)
            steps.append(step)
    edges, every = np.concatenate(upper), np.concatenate(steps)
    if plant.cycle > 1:
        edges, every = thinned(edges, every, plant.turn)
    else:
        rising = np.argsort(edges, kind="stable")
        edges, every = edges[rising], every[rising]
    cumulative = np.cumsum(every, axis=0).transpose(1, 2, 0)
    return edges, cumulative[:-1], cumulative[-1]


def thinned(ends: FloatArray, parts: FloatArray, turn: float) -> Steps:
    """Return intervals in rising order with those joined whose ends (N,) are near to each other."""
    rising = np.argsort(ends, kind="stable")
    ends, parts = ends[rising], parts[rising]
    near = np.floor(np.log(np.maximum(ends, 1e-12 * turn)) / _NEAR)
    first = np.flatnonzero(np.append(True, near[1:] > near[:-1]))
    return ends[np.append(first[1:], len(ends)) - 1], np.add.reduceat(parts, first, axis=0)


def between_nodes(
    panel: tuple[float, float], frequency: FloatArray, density: FloatArray, members: FloatArray, turn: float
) -> Steps:
    """Return the upper ends of the intervals between neighbouring nodes of a panel's images, and integrals over them.

    `frequency` (21, F), `density` (21, F, G, q), and over the whole of each image `members` (F, G, q).
    """
    _, F, G, q = density.shape
    ends = np.abs(np.array(panel) + (np.arange(F) - (F - 1) // 2)[:, None] * turn)
    at = np.concatenate([ends[None, :, 0], frequency, ends[None, :, 1]])
    rising = np.diff(UP_TO, axis=0, prepend=0.0) @ density.reshape(21, F * G * q)
    parts = np.maximum(rising, 0.0).reshape(22, F, G, q)
    every = parts.sum(axis=0)
    parts *= np.divide(members, every, out=np.zeros_like(every), where=every > 0.0)
    return np.maximum(at[1:], at[:-1]).ravel(), parts.reshape(-1, G, q)


def packed(matrices: ComplexArray) -> FloatArray:
    """Return Hermitian matrices (..., m, m) as m² real numbers whose sums of products are traces of products."""
    row, column = np.triu_indices(matrices.shape[-1], 1)
    upper = math.sqrt(2.0) * matrices[..., row, column]
    diagonal = np.diagonal(matrices, axis1=-2, axis2=-1)
    return np.concatenate([diagonal.real, upper.real, upper.imag], axis=-1)


def outer(V: ComplexArray) -> FloatArray:
    """Return V V' of columns (..., m), packed (..., m²)."""
    return packed(V[..., :, None] * V.conj()[..., None, :])


def exclusive(each: NDArray[Any], axis: int) -> NDArray[Any]:
    """Return the sums over all others along an axis, without a subtraction."""
    each = np.moveaxis(each, axis, 0)
    before, after = np.zeros_like(each), np.zeros_like(each)
    before[1:] = np.cumsum(each, axis=0)[:-1]
    after[:-1] = np.cumsum(each[::-1], axis=0)[-2::-1]
    return np.moveaxis(before + after, 0, axis)


def alike(M: Modulator) -> list[tuple[NDArray[np.intp], NDArray[np.intp]]]:
    """Return the places of what the slower loops hold, and the components that share them."""
    if not M.place.size:
        return []
    places, group = np.unique(M.place, axis=0, return_inverse=True)
    return [(place, np.flatnonzero(group.ravel() == k)) for k, place in enumerate(places)]


def through(held: ComplexArray, signals: ComplexArray) -> FloatArray:
    """Return packed powers (N, m², R, G) of controls, `held` (N, R, m, h) of signals with powers (N, R, h, h, G)."""
    found = np.einsum("nrah,nrhkg->nragk", held, signals) @ held.conj().swapaxes(-1, -2)[:, :, None]
    return np.moveaxis(packed(found.swapaxes(2, 3)), -1, 1)


def moved_by_samples(M: Modulator, measured: int) -> FloatArray:
    """Return the effect of white samples of a reading on the controls (N, m², R): all components alike and apart."""
    N, R, m, _ = M.held.shape
    signal, u = M.heard[..., measured], np.array(M.own[..., measured])
    out = np.zeros((N, m * m, R))
    for place, some in alike(M):
        seen = signal[..., place]
        others = exclusive(seen[..., :, None] * seen[..., None, :].conj(), 1)
        out[:, :, some] = through(M.held[:, some], others[:, some, ..., None])[..., 0]
        u[:, some] += (M.held[:, some] @ seen[:, some, :, None])[..., 0]
    return out + np.moveaxis(outer(u), -1, 1)


def aliased(held: FloatArray, moved: FloatArray) -> FloatArray:
    """Return densities (N, F, G, q) of rows (N, F, q, m²), packed, and what moves the controls (N, m², F or 1, G)."""
    N, F, q, size = held.shape
    if moved.shape[2] == 1:
        return (held.reshape(N, F * q, size) @ moved[:, :, 0]).reshape(N, F, q, -1).swapaxes(-1, -2)
    return (held @ moved.swapaxes(1, 2)).swapaxes(-1, -2)
