"""The plant of a synthesis: inputs [w, u], outputs [z, y], and the loop that u = K y closes around it."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from platform_ctrl.analysis.sampled import from_w_plane, to_w_plane
from platform_ctrl.errors import ArgumentError
from platform_ctrl.frozen import FloatArray, value
from platform_ctrl.signatures import short

if TYPE_CHECKING:
    from control import StateSpace


@value
class Partition:
    """The matrices of a plant with inputs [w, u] and outputs [z, y], and its period `dt` (0: continuous)."""

    A: FloatArray
    B1: FloatArray
    B2: FloatArray
    C1: FloatArray
    C2: FloatArray
    D11: FloatArray
    D12: FloatArray
    D21: FloatArray
    D22: FloatArray
    dt: float = 0.0


@value
class Realisation:
    """A state-space realisation as bare matrices."""

    A: FloatArray
    B: FloatArray
    C: FloatArray
    D: FloatArray


def partition(P: StateSpace, nmeas: int, ncon: int, sampled: bool = False) -> Partition:
    """Split a plant at its last `nmeas` outputs and last `ncon` inputs.

    Parameters
    ----------
    P, nmeas, ncon
        As in `design.synthesis.hinf`.
    sampled
        Whether a plant with dt > 0 is taken, too.

    Raises
    ------
    ArgumentError
        P is not such a state-space system with finite matrices, or the numbers do not fit.
    """
    from control import StateSpace

    if not isinstance(P, StateSpace):
        raise ArgumentError(f"plant: given a {type(P).__name__}; expected a control.StateSpace")
    if P.dt is True:
        raise ArgumentError("plant: sampled without a period (dt=True); expected the period in s")
    if P.dt and not sampled:
        raise ArgumentError(
            f"plant: sampled (dt = {P.dt}); expected a continuous plant, for example in the bilinear w-plane"
        )
    for name, number, total, what in (("nmeas", nmeas, P.noutputs, "outputs"), ("ncon", ncon, P.ninputs, "inputs")):
        if isinstance(number, bool) or not (isinstance(number, int | np.integer) and 1 <= number < total):
            raise ArgumentError(
                f"plant: {name} = {short(number)} of {total} {what}; expected a whole number from 1 to {total - 1}"
            )
    if P.nstates == 0:
        raise ArgumentError("plant: no states; expected a dynamic plant")
    A, B, C, D = (np.asarray(m, dtype=np.float64) for m in (P.A, P.B, P.C, P.D))
    for name, m in zip("ABCD", (A, B, C, D), strict=True):
        if not np.all(np.isfinite(m)):
            raise ArgumentError(f"plant: matrix {name} is not finite; expected finite entries")
    nz, nw = P.noutputs - nmeas, P.ninputs - ncon
    return Partition(
        A=A, B1=B[:, :nw], B2=B[:, nw:], C1=C[:nz], C2=C[nz:],
        D11=D[:nz, :nw], D12=D[:nz, nw:], D21=D[nz:, :nw], D22=D[nz:, nw:],
        dt=float(P.dt or 0.0),
    )  # fmt: skip


def in_w_plane(plant: Partition) -> Partition:
    """Return a sampled plant in the w-plane, w = (2/T) (z − 1)/(z + 1), where it is continuous; others as they are.

    The map is exact: stability and the H-infinity norm of every loop are kept.

    Raises
    ------
    ArgumentError
        The plant has a pole at z = −1.
    """
    if plant.dt == 0.0:
        return plant
    nz, nw = plant.D11.shape
    one = whole(plant)
    A, B, C, D = to_w_plane(one.A, one.B, one.C, one.D, plant.dt)
    return Partition(
        A=A, B1=B[:, :nw], B2=B[:, nw:], C1=C[:nz], C2=C[nz:],
        D11=D[:nz, :nw], D12=D[:nz, nw:], D21=D[nz:, :nw], D22=D[nz:, nw:],
    )  # fmt: skip


def out_of_w_plane(K: Realisation, period: float) -> Realisation:
    """Return a controller of the plant that `in_w_plane` made as a sampled one; for `period` 0 as it is.

    Raises
    ------
    ArgumentError
        The controller has a pole at 2/`period`.
    """
    if period == 0.0:
        return K
    A, B, C, D = from_w_plane(K.A, K.B, K.C, K.D, period)
    return Realisation(A=A, B=B, C=C, D=D)


def with_direct_path(K: Realisation, D22: FloatArray) -> Realisation:
    """Return the controller u = K y for a plant whose D22 was left out when K was made: K (y − D22 u), solved for u.

    Raises
    ------
    numpy.linalg.LinAlgError
        The loop around D22 is not well posed.
    """
    shift = np.linalg.inv(np.eye(len(K.D)) + K.D @ D22)
    return Realisation(
        A=K.A - K.B @ D22 @ shift @ K.C,
        B=K.B @ (np.eye(K.B.shape[1]) - D22 @ shift @ K.D),
        C=shift @ K.C,
        D=shift @ K.D,
    )


def closed_loop(plant: Partition, K: Realisation) -> Realisation:
    """Lower linear fractional transformation of a plant and u = K y, states [x, xK].

    Raises
    ------
    numpy.linalg.LinAlgError
        The loop is not well posed.
    """
    E = np.linalg.inv(np.eye(len(K.D)) - K.D @ plant.D22)
    # u = E (D_K y0 + C_K xK), y0 = C2 x + D21 w;  y = y0 + D22 u
    Ux, Uk, Uw = E @ K.D @ plant.C2, E @ K.C, E @ K.D @ plant.D21
    return Realisation(
        A=np.block(
            [
                [plant.A + plant.B2 @ Ux, plant.B2 @ Uk],
                [K.B @ (plant.C2 + plant.D22 @ Ux), K.A + K.B @ plant.D22 @ Uk],
            ]
        ),
        B=np.vstack([plant.B1 + plant.B2 @ Uw, K.B @ (plant.D21 + plant.D22 @ Uw)]),
        C=np.hstack([plant.C1 + plant.D12 @ Ux, plant.D12 @ Uk]),
        D=plant.D11 + plant.D12 @ Uw,
    )


def whole(plant: Partition) -> Realisation:
    """Return a plant in one piece: from [w, u] to [z, y]."""
    return Realisation(
        A=plant.A,
        B=np.hstack([plant.B1, plant.B2]),
        C=np.vstack([plant.C1, plant.C2]),
        D=np.block([[plant.D11, plant.D12], [plant.D21, plant.D22]]),
    )


def controller_system(P: StateSpace, K: Realisation) -> StateSpace:
    """Return u = K y, sampled as P is, with the names that u and y have in P."""
    import control

    ncon, nmeas = K.D.shape
    return control.StateSpace(
        K.A, K.B, K.C, K.D, P.dt or 0.0,
        inputs=P.output_labels[-nmeas:], outputs=P.input_labels[-ncon:], remove_useless_states=False,
    )  # fmt: skip


def closed_loop_system(P: StateSpace, loop: Realisation) -> StateSpace:
    """Return a `closed_loop` around P, sampled as P is, with the names that w and z have in P."""
    import control

    nz, nw = loop.D.shape
    return control.StateSpace(
        loop.A, loop.B, loop.C, loop.D, P.dt or 0.0,
        states=[*P.state_labels, *(f"controller_{k}" for k in range(len(loop.A) - P.nstates))],
        inputs=P.input_labels[:nw], outputs=P.output_labels[:nz], remove_useless_states=False,
    )  # fmt: skip
