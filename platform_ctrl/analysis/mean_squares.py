"""The mean squares of a budget as forms in the controller, see `sight`, from what the budget knows of its plant."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np

from platform_ctrl.analysis.budget_integrals import KRONROD, between, nodes
from platform_ctrl.analysis.jitter_budget import JitterBudget
from platform_ctrl.analysis.sight import MeanSquare
from platform_ctrl.analysis.system import ComplexArray
from platform_ctrl.common.values import FloatArray


def mean_square(
    budget: JitterBudget,
    outputs: Sequence[int],
    weights: Sequence[int],
    factor: float,
    others: Callable[[FloatArray], tuple[ComplexArray, ComplexArray]],
    rows: Sequence[int],
) -> MeanSquare:
    """Return the mean square of some outputs of a budget together, in some of its weights.

    `others` gives E and F at frequencies; `rows` are the controls that K sets.
    """
    panels = between(budget.edges(False), 0.0, 0.5 * budget.plant.turn)
    at, half = nodes(panels)
    parts = [_at_nodes(budget, outputs, weights, at.ravel(), (KRONROD * half[:, None]).ravel() / (2.0 * np.pi))]
    for key in dict.fromkeys((one.frequency, id(one) if one.phase is None else 0) for one in budget.sines):
        lines = [one for one in budget.sines if (one.frequency, id(one) if one.phase is None else 0) == key]
        amplitude = np.sum([one.vector(budget.plant.disturbances) for one in lines], axis=0)
        parts.append(_at_nodes(budget, outputs, weights, np.array([key[0]]), np.array([0.5]), amplitude))
    theta, P, L, Q, Y = (np.concatenate([part[k] for part in parts]) for k in range(5))
    E, F = others(theta)
    return MeanSquare(
        theta=theta,
        period=budget.plant.period,
        factor=factor,
        P=P,
        E=E,
        F=F,
        rows=tuple(rows),
        constant=float(sum(np.sum(part[5]) for part in parts)),
        L=L,
        Q=Q,
        Y=Y,
    )


def _at_nodes(
    budget: JitterBudget,
    outputs: Sequence[int],
    weights: Sequence[int],
    theta: FloatArray,
    rule: FloatArray,
    line: ComplexArray | None = None,
) -> tuple[FloatArray | ComplexArray, ...]:
    """Return theta, P, L, Q, Y and the constant at nodes of the random sources, or of a line of amplitude `line`."""
    plant, images = budget.plant, np.arange(-budget.images, budget.images + 1)
    family = budget.open_loop.family(theta, images)
    every = [np.zeros((*family.frequency.shape, plant.disturbances, 0), dtype=np.complex128)]
    every += [one.columns(family.frequency, plant.disturbances) for one in budget.random if line is None]
    if line is not None:
        every.append((images == 0)[None, :, None, None] * line[:, None])
    columns = np.concatenate(every, axis=-1)
    late = np.exp(-1j * plant.period * theta[:, None] * np.array(plant.reading_delay, dtype=np.float64))
    y = late[:, None, :, None] * (family.measured @ columns)
    once = family.integral[:, :, outputs]
    d, h = (family.direct[:, :, outputs] * once) @ columns, family.held[:, :, outputs] * once
    w = budget.weights(family.frequency)[list(weights)].sum(axis=0) * rule[:, None]
    Y = np.einsum("nfac,nfbc->nab", y, y.conj(), optimize=True)
    for one in budget.noise if line is None else ():
        Y[:, one.measured, one.measured] += 2.0 * plant.period * one.rms**2
    dh = np.einsum("nf,nfqc,nfqm->nfcm", w, d.conj(), h, optimize=True)
    return (
        theta,
        late[:, :, None] * family.sampled[:, 0],
        np.einsum("nfpc,nfcm->npm", y, dh, optimize=True),
        np.einsum("nf,nfqa,nfqb->nab", w, h.conj(), h, optimize=True),
        Y,
        np.einsum("nf,nfqc->n", w, np.abs(d) ** 2, optimize=True),
    )
