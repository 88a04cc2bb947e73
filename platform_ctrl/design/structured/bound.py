"""What a controller of full order can do: the bound beside which a simple one is priced."""

from __future__ import annotations

import contextlib
from typing import TYPE_CHECKING

from platform_ctrl.design.lower_bounds import h2_lower_bound, hinf_lower_bound
from platform_ctrl.design.partition import Partition, Realisation, whole
from platform_ctrl.design.synthesis import Synthesis, hinf
from platform_ctrl.errors import DesignError, TimeLimitError
from platform_ctrl.frozen import value

if TYPE_CHECKING:
    from control import StateSpace

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
    controllers: tuple[Realisation, ...]
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


def _controllers(plant: Partition, power: bool, time_limit: float) -> tuple[tuple[Realisation, ...], bool]:
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
        return (_realised(found), *more), cut
    return () if power else _simpler(P, plant, 1e-2), cut


def _designed(P: StateSpace, plant: Partition, power: bool, method: str, time_limit: float) -> Synthesis:
    ny, nu = plant.C2.shape[0], plant.B2.shape[1]
    if power:
        from platform_ctrl.design.h2 import h2

        return h2(P, ny, nu, method=method, time_limit=time_limit)  # type: ignore[arg-type]
    return hinf(P, ny, nu, method=method, backoff=_BACKOFFS[0], time_limit=time_limit)  # type: ignore[arg-type]


def _realised(found: Synthesis) -> Realisation:
    K = found.controller
    return Realisation(A=K.A, B=K.B, C=K.C, D=K.D)


def _simpler(P: StateSpace, plant: Partition, regularise: float | None) -> tuple[Realisation, ...]:
    """Return controllers farther from the least norm; of the regularised plant where its assumptions do not hold."""
    out = []
    for backoff in _BACKOFFS[1:]:
        with contextlib.suppress(DesignError):
            found = hinf(
                P, plant.C2.shape[0], plant.B2.shape[1], method="riccati", backoff=backoff, regularise=regularise
            )
            out.append(_realised(found))
    return tuple(out)


def _system(plant: Partition) -> StateSpace:
    import control

    one = whole(plant)
    return control.StateSpace(one.A, one.B, one.C, one.D, remove_useless_states=False)
