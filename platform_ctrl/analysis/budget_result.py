"""The result of a jitter budget, and how it is put together from integrals over panels."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from platform_ctrl.analysis.disturbances import Disturbance, RandomDisturbance, SampleNoise
from platform_ctrl.analysis.frequency_grids import UP_TO
from platform_ctrl.analysis.hybrid_plant import HybridPlant
from platform_ctrl.common.values import FloatArray, value

# Edges of cumulative variances that are nearer to each other than this, relative, are one where there are many images.
_NEAR = 1e-3


@value
class Contribution:
    """Integrals over P panels for G sources, q outputs and W weights, or the lines of sines."""

    panels: FloatArray  # (P, 2): ends, rad/s
    # variance, error: (P, W, G, q): integrals over all images that are kept, and bounds on their errors.
    variance: FloatArray
    error: FloatArray
    members: FloatArray  # (P, F, G, q): those of the first weight for each image
    remaining: FloatArray  # (P, G, q): of the images that are not kept, before integration of an output
    frequency: FloatArray  # (P, K, F): of the nodes, rad/s
    density: FloatArray  # (P, K, F, G, q): one-sided, per Hz
    sines: tuple[str, ...] = ()  # names of the sines whose lines these are; the last of the G sources is their sum

    def chosen(self, good: NDArray[np.bool_]) -> Contribution:
        """Return those of some panels."""
        return Contribution(
            panels=self.panels[good],
            variance=self.variance[good],
            error=self.error[good],
            members=self.members[good],
            remaining=self.remaining[good],
            frequency=self.frequency[good],
            density=self.density[good],
        )


def variance_shares(rms: FloatArray, total: FloatArray) -> FloatArray:
    """Return the variance of each source over that of all, (G, q) of rms (G, q) and total (q,); zero without any."""
    every = total**2
    return np.asarray(np.divide(rms**2, every, out=np.zeros_like(rms), where=every > 0.0))


@value
class Window:
    """Displacement, smear and jitter within an exposure; root mean squares over its instants and over exposures."""

    exposure: float  # s
    # displacement, smear, jitter: (G, q): of each source, in the outputs' units.
    displacement: FloatArray
    smear: FloatArray
    jitter: FloatArray
    # total_displacement, total_smear, total_jitter: (q,): of all sources.
    total_displacement: FloatArray
    total_smear: FloatArray
    total_jitter: FloatArray


@value
class Budget:
    """What each of G sources does to each of q outputs."""

    names: tuple[str, ...]  # of the sources
    rms: FloatArray  # (G, q): in the outputs' units
    total: FloatArray  # (q,): of all sources together; sines that add coherently are not the root of the sum of squares
    lowest: float  # motion below this frequency, rad/s, does not count in `rms`, `total` and displacements
    windows: tuple[Window, ...]  # one for each exposure
    frequency: FloatArray  # (K,): rad/s, rising
    density: FloatArray  # (G, q, K): one-sided densities of the outputs, per Hz, without the lines of sines
    edges: FloatArray  # (E,): frequencies, rad/s, rising, up to which `cumulative` sums
    cumulative: FloatArray  # (G, q, E): variance of each source up to the edges, sines included
    total_cumulative: FloatArray  # (q, E): the same of all sources
    error: float  # bound on the error of integration, the largest relative to a variance
    # Bound on the share of an integrated output's variance that images beyond those kept would add; what they add to
    # other outputs is included.
    remaining: float

    @property
    def shares(self) -> FloatArray:
        """Variance of each source over that of all (G, q); zero where there is none."""
        return variance_shares(self.rms, self.total)


def assembled(
    plant: HybridPlant,
    sources: Sequence[Disturbance],
    exposures: Sequence[float],
    lowest: float,
    found: list[Contribution],
    lines: list[Contribution],
    over_frequency: bool,
) -> Budget:
    """Return the budget of panels of random sources and of lines of sines; not `over_frequency`: sums alone."""
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
        # What the sum of the lines has beyond the sum of their squares.
        coherent += one.variance[0, :, -1] - one.variance[0, :, :-1].sum(axis=1)
        more += one.remaining[0, -1] - one.remaining[0, :-1].sum(axis=0)
    highest = max([0.5 * plant.turn, *(float(one.panels[0, 0]) for one in lines)])
    beyond = (1.0 + _kept(found, lines)) * plant.turn - highest if found or lines else 1.0
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
        Window(
            exposure=one,
            displacement=root[3 * k + 1],
            smear=root[3 * k + 2],
            jitter=root[3 * k + 3],
            total_displacement=whole[3 * k + 1],
            total_smear=whole[3 * k + 2],
            total_jitter=whole[3 * k + 3],
        )
        for k, one in enumerate(exposures)
    )
    seen, drawn = (found, lines) if over_frequency else ([], [])
    frequency, density = _spectrum(seen, order, G, q)
    edges, cumulative, together = _cumulated(plant, seen, drawn, names, order)
    return Budget(
        names=names,
        rms=root[0],
        total=whole[0],
        lowest=lowest,
        windows=windows,
        frequency=frequency,
        density=density,
        edges=edges,
        cumulative=cumulative,
        total_cumulative=together,
        error=float(np.nanmax(relative, initial=0.0)),
        remaining=float(np.nanmax(share, initial=0.0)),
    )


def _kept(found: list[Contribution], lines: list[Contribution]) -> int:
    return int(next(iter([*found, *lines])).members.shape[1] - 1) // 2


def _spectrum(found: list[Contribution], order: list[int], G: int, q: int) -> tuple[FloatArray, FloatArray]:
    if not found:
        return np.zeros(0), np.zeros((G, q, 0))
    frequency = np.concatenate([one.frequency.ravel() for one in found])
    density = np.concatenate([one.density.reshape(-1, len(order), q) for one in found])
    rising = np.argsort(frequency)
    out = np.zeros((G, q, len(frequency)))
    out[order] = density[rising].transpose(1, 2, 0)
    return frequency[rising], out


def _cumulated(
    plant: HybridPlant, found: list[Contribution], lines: list[Contribution], names: tuple[str, ...], order: list[int]
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return edges, the variance up to them by source, and of all: panels with their images lie beside each other."""
    G, q = len(names), plant.outputs
    upper, steps, together = [np.zeros(1)], [np.zeros((1, G, q))], [np.zeros((1, q))]
    for one in found:
        ends, parts = _between_nodes(one, plant.turn)
        step = np.zeros((len(ends), G, q))
        step[:, order] = parts
        upper.append(ends)
        steps.append(step)
        together.append(parts.sum(axis=1))
    for one in lines:
        step = np.zeros((one.members.shape[1], G, q))
        step[:, [names.index(name) for name in one.sines]] = one.members[0, :, :-1]
        upper.append(one.frequency[0, 0])
        steps.append(step)
        together.append(one.members[0, :, -1])
    edges = np.concatenate(upper)
    rising = np.argsort(edges, kind="stable")
    edges = edges[rising]
    cumulative = np.cumsum(np.concatenate(steps)[rising], axis=0).transpose(1, 2, 0)
    of_all = np.cumsum(np.concatenate(together)[rising], axis=0).T
    if plant.cycle > 1:
        # Every image has the nodes that any of them needs: of near ones the last.
        near = np.floor(np.log(np.maximum(edges, 1e-12 * plant.turn)) / _NEAR)
        kept = np.append(near[1:] > near[:-1], True)
        return edges[kept], cumulative[..., kept], of_all[:, kept]
    return edges, cumulative, of_all


def _between_nodes(one: Contribution, turn: float) -> tuple[FloatArray, FloatArray]:
    """Return the upper ends (N,) of the intervals between neighbouring nodes, and the integrals over them (N, G, q)."""
    P, _, F, G, q = one.density.shape
    ends = np.abs(one.panels[:, None, :] + (np.arange(F) - (F - 1) // 2)[:, None] * turn)
    at = np.concatenate([ends[:, None, :, 0], one.frequency, ends[:, None, :, 1]], axis=1)
    rising = np.diff(UP_TO, axis=0, prepend=0.0) @ one.density.reshape(P, 21, F * G * q)
    parts = np.maximum(rising, 0.0).reshape(P, 22, F, G, q)
    every = parts.sum(axis=1)
    parts *= np.divide(one.members, every, out=np.zeros_like(every), where=every > 0.0)[:, None]
    return np.maximum(at[:, 1:], at[:, :-1]).ravel(), parts.reshape(-1, G, q)
