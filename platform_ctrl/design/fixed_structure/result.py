"""What a structured synthesis comes to: the controller, measured on the plants as given, beside full order."""

from __future__ import annotations

import contextlib
from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from platform_ctrl.analysis.norms import hinf_norm
from platform_ctrl.analysis.poles import continuous_poles, poles, spectral_abscissa
from platform_ctrl.analysis.system import ComplexArray, System
from platform_ctrl.common.values import FloatArray, value
from platform_ctrl.design.fixed_structure.structures import Structure
from platform_ctrl.design.partition import (
    Partition,
    closed_loop,
    closed_loop_system,
    controller_system,
    out_of_w_plane,
    whole,
)
from platform_ctrl.design.synthesis import hinf
from platform_ctrl.errors import DesignError, NotCertifiedError

if TYPE_CHECKING:
    from control import StateSpace

# Matrix inequalities of more states than this take minutes.
_LMI_STATES = 20
# Back-offs of the controllers that starts are fitted to: near the least norm they have needlessly fast poles, and far
# from it they are simple. What is added to the plant where the Riccati equations' assumptions do not hold.
_BACKOFFS, _REGULARISED = (0.1, 0.5, 2.0), 1e-2
# What the recomputed norm may exceed that of the search by, relative.
_AGREEMENT = 1e-3


@value
class StructuredDesign:
    """A controller of fixed structure with the evidence that it does what is claimed.

    Attributes
    ----------
    plants, nmeas, ncon
        The problem.
    structure
        What was requested.
    controller
        K, u = K y; sampled where the plants are.
    parameters
        Every number of the structure by name, in its unit; for sampled plants those of the w-plane controller.
    closed_loops
        From w to z, one a plant.
    gammas : (plants,)
        H-infinity norm of each closed loop, in units of z per w, recomputed from it.
    gamma
        The largest of them, in the same units.
    gamma_optimal
        Least norm of a full-order controller, in the same units: the largest over the plants; 0 where none was found.
    poles
        Closed-loop poles, one array (n,) a plant: rad/s, or in z (dimensionless).
    reached : (starts,)
        The norm that the search from each start found; inf where it found no stable loop.
    finished
        Whether the search ended by itself, not by its evaluations.
    """

    plants: tuple[StateSpace, ...]
    nmeas: int
    ncon: int
    structure: Structure
    controller: StateSpace
    parameters: dict[str, float]
    closed_loops: tuple[StateSpace, ...]
    gammas: FloatArray
    gamma: float
    gamma_optimal: float
    poles: tuple[ComplexArray, ...]
    reached: FloatArray
    finished: bool

    @property
    def price(self) -> float:
        """What the structure costs at most: ratio of gamma to the full-order bound; inf where that is 0."""
        return self.gamma / self.gamma_optimal if self.gamma_optimal > 0.0 else float("inf")


def full_order(plant: Partition) -> tuple[float, list[System]]:
    """Return the least norm of a continuous plant, 0 where none is found, and controllers of several back-offs.

    By matrix inequalities where the Riccati equations have no solution; of the regularised plant where those find
    none either.
    """
    import control

    A, B, C, D, _ = whole(plant)
    P = control.StateSpace(A, B, C, D, remove_useless_states=False)
    nmeas, ncon = plant.C2.shape[0], plant.B2.shape[1]
    least, controllers, regularise = 0.0, [], None
    try:
        found = hinf(P, nmeas, ncon, method=None if len(plant.A) <= _LMI_STATES else "riccati", backoff=_BACKOFFS[0])
        least, controllers = found.gamma_optimal, [System.of(found.controller, "structured")]
    except DesignError:
        regularise = _REGULARISED
    for backoff in _BACKOFFS[1:]:
        with contextlib.suppress(DesignError):
            found = hinf(P, nmeas, ncon, method="riccati", backoff=backoff, regularise=regularise)
            controllers.append(System.of(found.controller, "structured"))
    return least, controllers


def controller_of(M: FloatArray, P: StateSpace, part: Partition) -> StateSpace:
    """Return M = [A_K, B_K; C_K, D_K], in the w-plane where the plant is sampled, as a controller of the plant."""
    k = len(M) - part.B2.shape[1]
    return controller_system(P, out_of_w_plane(System(M[:k, :k], M[:k, k:], M[k:, :k], M[k:, k:]), part.dt))


def abscissa(part: Partition, K: StateSpace) -> float:
    """Return the largest real part, rad/s, of a loop's continuous(-equivalent) poles."""
    loop = closed_loop(part, System.of(K, "controller"))
    return float(spectral_abscissa(continuous_poles(poles(loop.A), part.dt)))


def measured(
    given: Sequence[StateSpace], parts: Sequence[Partition], controller: StateSpace, promised: float
) -> tuple[list[StateSpace], FloatArray]:
    """Return the loops closed with the plants as given, and their norms, which must be what the search promised."""
    loops = [closed_loop(part, System.of(controller, "controller")) for part in parts]
    for k, part in enumerate(parts, 1):
        if not abscissa(part, controller) < 0.0:
            raise NotCertifiedError(f"structured: the closed loop of plant {k} is not stable; give other starts", given)
    systems = [closed_loop_system(P, loop) for P, loop in zip(given, loops, strict=True)]
    gammas = np.array([float(hinf_norm(one)[0]) for one in systems])
    if not gammas.max() <= (1.0 + _AGREEMENT) * promised + 1e-9:
        raise NotCertifiedError(
            f"structured: the closed loops have the norm {gammas.max():.6g}, the search promised {promised:.6g}; "
            "bound the structure's numbers: gains this large are at the limit of floating point",
            given,
        )
    return systems, gammas
