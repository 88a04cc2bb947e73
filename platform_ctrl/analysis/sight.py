"""Mean squares of the line of sight as a function of the controller, with derivatives, for designs.

Where all loops are computed at every sample, the mean square of a budget (see `jitter_budget`) is a quadratic form in
X = K (I − P K)⁻¹ at nodes of frequency: with the rows h of the controls and d of the disturbances in an image, and what
they do to the readings there, y,

    Σ |d + h X y|²  over an image's own disturbance  +  Σ |h X y|²  over what is aliased into it
        = c + 2 Re tr(L X) + tr(Q X Y X'),        L = Σ y d' h,  Q = Σ h' h,  Y = Σ y y' + noise.

The nodes are those of Kronrod's rule in panels of the plant alone: sharp resonances of the loop may lie between them.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from typing import TYPE_CHECKING, Protocol

import numpy as np

from platform_ctrl.analysis.response import frequency_response
from platform_ctrl.analysis.system import ComplexArray, System
from platform_ctrl.common.values import FloatArray, value

if TYPE_CHECKING:
    from platform_ctrl.analysis.jitter_budget import JitterBudget


def contrast_of(blur: float) -> float:
    """Return the contrast at ν of a Gaussian motion within an exposure, smear included, of rms `blur` = ν σ."""
    return math.exp(-2.0 * (math.pi * blur) ** 2)


def blur_of(contrast: float) -> float:
    """Return the rms `blur` that leaves a contrast."""
    return math.sqrt(-0.5 * math.log(contrast)) / math.pi


class SightBudget(Protocol):
    """The budget of the line of sight of a loop's job."""

    def exact(self, controller: System) -> Mapping[str, float]:
        """Return the limits' values, rad, with u = K y, by their keys; infinite where there is no budget."""

    def forms(self, controller: System) -> Mapping[str, tuple[MeanSquare, ...]]:
        """Return the same as forms, friction balanced for this controller: the largest root counts."""

    def in_directions(self, sense: FloatArray) -> SightBudget:
        """Return the same for controllers of combinations of the readings."""


@value
class MeanSquare:
    """A mean square as a form in the controller at N nodes; the controller of all sensors is K E + F there."""

    theta: FloatArray  # (N,): rad/s
    period: float  # s
    factor: float  # of the root
    P: ComplexArray  # (N, p, m): sampled plant with the sensors' delays
    E: ComplexArray  # (N, q, p): from sensors to what K reads
    F: ComplexArray  # (N, m, p): what else acts
    rows: tuple[int, ...]  # the controls that K sets
    constant: float
    L: ComplexArray  # (N, p, m)
    Q: ComplexArray  # (N, m, m)
    Y: ComplexArray  # (N, p, p)

    def root(self, K: ComplexArray) -> tuple[float, ComplexArray]:
        """Return the root mean square, rad, with a response K (N, k, q), and G (N, q, k): its change, Re Σ tr(G dK)."""
        whole = self.F.copy()
        whole[:, self.rows] += K @ self.E
        S = np.linalg.inv(np.eye(self.P.shape[1]) - self.P @ whole)
        X = whole @ S
        back = self.Y @ np.swapaxes(X.conj(), -1, -2) @ self.Q
        mean = self.constant + float(np.einsum("nij,nji->", X, 2.0 * self.L + back).real)
        size = self.factor * np.sqrt(max(mean, 0.0))
        G = S @ (self.L + back) @ (np.eye(len(self.Q[0])) + X @ self.P)
        slope = self.factor**2 / size if size > 0.0 else 0.0
        return float(size), slope * (self.E @ G[:, :, self.rows])

    def at(self, controller: System) -> float:
        """Return the root mean square with a controller, rad."""
        return self.root(frequency_response(controller, self.theta, -3))[0]


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
    from platform_ctrl.analysis.budget_integrals import KRONROD, between, nodes

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
