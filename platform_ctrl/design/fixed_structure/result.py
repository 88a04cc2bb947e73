"""What a structured synthesis comes to."""

from __future__ import annotations

import contextlib
from dataclasses import field
from typing import TYPE_CHECKING

import numpy as np

from platform_ctrl.analysis.arrays import ComplexArray, StateArrays, state_arrays
from platform_ctrl.analysis.certificates import Certificate
from platform_ctrl.analysis.certificates.makers import norm_certificate, stability_certificate
from platform_ctrl.common.values import FloatArray, value
from platform_ctrl.design.fixed_structure.structures import Structure
from platform_ctrl.design.lower_bounds import h2_lower_bound, hinf_lower_bound
from platform_ctrl.design.partition import Partition, whole
from platform_ctrl.design.synthesis import Synthesis, hinf
from platform_ctrl.errors import DesignError, TimeLimitError
from platform_ctrl.job.judging import CheckResult

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
        What it took; time in s.
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
        What was requested.
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


# Matrix inequalities of more states than this take minutes.
_LMI_STATES = 20
# Back-offs of the controllers that starts are fitted to: near the least norm they have needlessly fast poles, and far
# from it they are simple.
_BACKOFFS = (0.1, 0.5, 2.0)


@value
class Bound:
    """What is known of controllers of full order for one plant.

    Attributes
    ----------
    gamma
        What no controller of any order can undercut; 0 where nothing is shown.
    source
        How it was found.
    controllers
        Some near it and some far from it, in the w-plane where the plant is sampled; none where none are fitted.
    cut
        Whether the time limit ended a computation.
    """

    gamma: float
    source: str
    controllers: tuple[StateArrays, ...]
    cut: bool = False


def least_norm(plant: Partition, power: bool) -> float:
    """Return what no controller of any order undercuts with a continuous (or w-plane) plant, in H2 where `power`."""
    return h2_lower_bound(plant) if power else hinf_lower_bound(plant)


def full_order(plant: Partition, power: bool, time_limit: float, fitted: bool) -> Bound:
    """Return the bound of a continuous (or w-plane) plant, with controllers where some are to be `fitted`."""
    gamma, norm = least_norm(plant, power), "H2" if power else "H-infinity"
    source = f"{norm} norm of any controller, by duality" if gamma > 0.0 else f"no {norm} bound above 0 shown"
    controllers, cut = _controllers(plant, power, time_limit) if fitted else ((), False)
    return Bound(gamma=gamma, source=source, controllers=controllers, cut=cut)


def _controllers(plant: Partition, power: bool, time_limit: float) -> tuple[tuple[StateArrays, ...], bool]:
    """Return controllers of full order, and whether the time limit ended a computation."""
    P = _system(plant)
    cut = False
    for method in ("riccati", "lmi"):
        if method == "lmi" and len(plant.A) > _LMI_STATES:
            continue
        try:
            found = _designed(P, plant, power, method, time_limit)
        except DesignError as error:
            cut = cut or isinstance(error, TimeLimitError)
            continue
        more = () if power or method == "lmi" else _simpler(P, plant, None)
        return (state_arrays(found.controller, "structured"), *more), cut
    return () if power else _simpler(P, plant, 1e-2), cut


def _designed(P: StateSpace, plant: Partition, power: bool, method: str, time_limit: float) -> Synthesis:
    ny, nu = plant.C2.shape[0], plant.B2.shape[1]
    if power:
        from platform_ctrl.design.riccati.h2 import h2

        return h2(P, ny, nu, method=method, time_limit=time_limit)  # type: ignore[arg-type]
    return hinf(P, ny, nu, method=method, backoff=_BACKOFFS[0], time_limit=time_limit)  # type: ignore[arg-type]


def _simpler(P: StateSpace, plant: Partition, regularise: float | None) -> tuple[StateArrays, ...]:
    """Return controllers farther from the least norm; of the regularised plant where its assumptions do not hold."""
    out = []
    for backoff in _BACKOFFS[1:]:
        with contextlib.suppress(DesignError):
            found = hinf(
                P, plant.C2.shape[0], plant.B2.shape[1], method="riccati", backoff=backoff, regularise=regularise
            )
            out.append(state_arrays(found.controller, "structured"))
    return tuple(out)


def _system(plant: Partition) -> StateSpace:
    import control

    one = whole(plant)
    return control.StateSpace(one.A, one.B, one.C, one.D, remove_useless_states=False)
