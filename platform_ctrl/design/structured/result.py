"""What a structured synthesis comes to."""

from __future__ import annotations

from dataclasses import field
from typing import TYPE_CHECKING

import numpy as np

from platform_ctrl.analysis.arrays import ComplexArray, StateArrays, state_arrays
from platform_ctrl.certificates import Certificate, norm_certificate, stability_certificate
from platform_ctrl.design.structured.structures import Structure
from platform_ctrl.frozen import FloatArray, value
from platform_ctrl.requirements import CheckResult

if TYPE_CHECKING:
    from control import StateSpace


@value
class SearchRecord:
    """How the search from one starting point went.

    Attributes
    ----------
    value
        What it reached: the worst norm, or with requirements the largest ratio; inf where no loop became stable.
    evaluations, seconds
        What it took.
    finished
        Whether it ended by itself.
    """

    value: float
    evaluations: int
    seconds: float
    finished: bool


@value
class StructuredDesign:
    """A controller of fixed structure with the evidence that it does what is claimed.

    Attributes
    ----------
    plants, nmeas, ncon
        The problem.
    structure
        What was asked for.
    controller
        K, u = K y; sampled where the plants are.
    parameters
        Every number of the structure by name, in its unit; for sampled plants those of the w-plane controller.
    closed_loops
        From w to z, one a plant.
    gammas : (plants,)
        H-infinity norm of each closed loop, in units of z per w, recomputed from it; with requirements the largest
        ratio of each plant.
    gamma
        The largest of them, in the same units.
    gamma_optimal
        What no controller of any order can undercut, in the same units: the largest full-order bound over the plants;
        0 where nothing is shown.
    bound
        Where that bound comes from.
    poles
        Closed-loop poles, one array (n,) a plant: rad/s, or in z (dimensionless).
    searches
        One record for every start that had its turn, in their order.
    finished
        Whether every start had its turn and ended by itself, not by its evaluations or by the time limit, or one came
        to `gamma_optimal`, less than which there is not.
    cut
        Whether the time limit ended the search: at another load of the machine the result is another one.
    infimum
        Where the search saw that no controller reaches the infimum, or that it is zero: a sentence that says so.
    outcomes
        The requirements held against every closed loop, where any were given; those of the first plant first.

    References
    ----------
    As `structured`.
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
    bound: str
    poles: tuple[ComplexArray, ...]
    searches: tuple[SearchRecord, ...]
    finished: bool
    cut: bool
    infimum: str
    outcomes: tuple[CheckResult, ...] = ()
    _made: list[Certificate] = field(init=False, repr=False, default_factory=list)

    @property
    def price(self) -> float:
        """What the structure costs at most: ratio of gamma to the full-order bound; inf where that is 0."""
        return self.gamma / self.gamma_optimal if self.gamma_optimal > 0.0 else float("inf")

    @property
    def passed(self) -> bool:
        """Whether every hard requirement is met by every plant."""
        return all(one.passed for one in self.outcomes if one.hard)

    @property
    def certificates(self) -> tuple[Certificate, ...]:
        """Proofs in interval arithmetic, one a plant: stable, and the norm of w to z bounded; made at the first use.

        With requirements the proof is of stability.

        Raises
        ------
        NotCertifiedError
            No proof was found.
        """
        if not self._made:
            for k, P in enumerate(self.plants):
                given = state_arrays(P, "plant")
                K = StateArrays(*state_arrays(self.controller, "controller")[:4], dt=given.dt)
                label = f"plant {k + 1}"
                if self.outcomes:
                    A, B, C, D, dt = given
                    made = stability_certificate(A, dt, B=B, C=C, D=D, controller=K, label=label)
                else:
                    made = norm_certificate(*given, controller=K, norm=float(self.gammas[k]), label=label)
                self._made.append(made)
        return tuple(self._made)

    @property
    def certificate(self) -> Certificate:
        """The proof for the worst plant; see `certificates`."""
        return self.certificates[int(np.argmax(self.gammas))]
