"""The result of a jitter budget, and how it is put together from integrals over panels."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from platform_ctrl.analysis.disturbances import Disturbance, RandomDisturbance, SampleNoise
from platform_ctrl.analysis.frequency_grids import UP_TO
from platform_ctrl.analysis.hybrid_plant import HybridPlant
from platform_ctrl.common.values import FloatArray, value

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
        return self._replace(
            panels=self.panels[good],
            variance=self.variance[good],
            error=self.error[good],
            remaining=self.remaining[good],
            steps=[one for one, kept in zip(self.steps, good, strict=False) if kept],
        )


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
        # What the sum of the lines has beyond the sum of their squares.
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
        Window(
            exposure=one,
            displacement=whole[3 * k + 1],
            smear=whole[3 * k + 2],
            jitter=whole[3 * k + 3],
        )
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
