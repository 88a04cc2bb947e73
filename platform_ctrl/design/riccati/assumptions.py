"""What the Riccati routes assume of a plant, judged on the scaled plant, and a stated way out where it does not hold.

D12 has full column rank: every control costs something. D21 has full row rank: every measurement is noisy. No invariant
zero of w → y or u → z lies on the imaginary axis: nothing on the axis is left to itself.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from platform_ctrl.common.values import FloatArray, value
from platform_ctrl.design.partition import Partition
from platform_ctrl.design.scaling import ScaledPlant, clustered
from platform_ctrl.errors import IllPosedError

if TYPE_CHECKING:
    from control import StateSpace

# Zeros nearer to the axis than this share of the size of A are looked at.
NEAR_AXIS = 1e-7
# Singular values below this share of the size of A mean that rank is lost.
LOST = 1e-10
# A direct path that is left over, relative to D11, counts as none.
DIRECT = 1e-10
WAYS_OUT = 'give method="lmi", which needs none of this, or regularise=1e-3'


@value
class Regularised:
    """A scaled plant that fulfils the assumptions, and what was added.

    Attributes
    ----------
    scaled
        With rows ε u in z for the controls, and columns ε in w for the measurements, that D12 and D21 left out, and
        A + shift in place of A where a zero lay on the axis. Every closed-loop norm from the old w to the old z is at
        most that of this plant: rows and columns only add to it, and a norm along a line to the left of the axis only
        exceeds that on the axis (maximum modulus).
    size
        ε, relative to scaled controls and measurements; 0 where nothing was added.
    shift
        rad/s.
    """

    scaled: ScaledPlant
    size: float
    shift: float


def named(direction: FloatArray, labels: Sequence[str]) -> str:
    """Return the signals that make up most of a direction."""
    share = np.abs(direction) / max(float(np.abs(direction).max(initial=0.0)), np.finfo(float).tiny)
    return ", ".join(label for label, x in zip(labels, share, strict=True) if x >= 0.3)


def require_full_rank(scaled: ScaledPlant, P: StateSpace, where: str) -> None:
    """Judge the ranks of D12 and D21."""
    nu, ny = scaled.plant.B2.shape[1], scaled.plant.C2.shape[0]
    if scaled.control_rank < nu:
        lost = np.abs(scaled.control[:, scaled.control_rank :]).sum(axis=1)
        raise IllPosedError(
            f"{where}: D12 has column rank {scaled.control_rank}; expected full column rank {nu}: z does not see "
            f"{named(lost, P.input_labels[-nu:])} directly; add a small weight on every control in z, or {WAYS_OUT}",
            P,
        )
    if scaled.measurement_rank < ny:
        lost = np.abs(scaled.measurement[scaled.measurement_rank :]).sum(axis=0)
        quiet = named(lost, P.output_labels[-ny:])
        raise IllPosedError(
            f"{where}: D21 has row rank {scaled.measurement_rank}; expected full row rank {ny}: no w disturbs {quiet} "
            f"directly; add a small noise on every measurement in w, or {WAYS_OUT}",
            P,
        )


def zero_on_axis(p: Partition) -> tuple[str, float, FloatArray] | None:
    """Return which matrix loses rank on the axis, the frequency (scaled) and the states involved, (n,), or None.

    `p` is scaled and its D12 and D21 have orthonormal columns and rows.
    """
    size = max(1.0, float(np.linalg.norm(p.A, 2)))
    for A, B, C, D, what in (
        (p.A, p.B2, p.C1, p.D12, "[A − jωI, B2; C1, D12] loses column rank"),
        (p.A.T, p.C2.T, p.B1.T, p.D21.T, "[A − jωI, B1; C2, D21] loses row rank"),
    ):
        # D'D = I: zeros are eigenvalues of A − B D'C.
        for zero in clustered(np.linalg.eigvals(A - B @ D.T @ C), size):
            if abs(zero.real) > NEAR_AXIS * size:
                continue
            shifted = A - 1j * zero.imag * np.eye(len(A))
            _, sigma, Vh = np.linalg.svd(np.block([[shifted, B], [C, D]]))
            if sigma[-1] < LOST * size:
                return what, abs(zero.imag), np.abs(Vh[-1, : len(A)])
    return None


def require_no_zero_on_axis(scaled: ScaledPlant, P: StateSpace, where: str) -> None:
    """Judge the invariant zeros."""
    found = zero_on_axis(scaled.plant)
    if found is None:
        return
    what, frequency, states = found
    place = f"{frequency * scaled.rate:.4g} rad/s"
    if P.dt:
        place += " (w-plane)"
    raise IllPosedError(
        f"{where}: {what} at {place} in the states {named(states * scaled.state, P.state_labels)}; expected no zero on "
        f"the imaginary axis; shift the weight with that pole or zero to the left, or {WAYS_OUT}",
        P,
    )


def without_direct_path(plant: Partition, P: StateSpace, where: str) -> tuple[Partition, FloatArray]:
    """Return the plant with the gain D_K closed that cancels D11, and D_K.

    The columns of D12 and rows of D21 are orthonormal or zero.
    """
    p = plant
    if not np.any(p.D11):
        return p, np.zeros((p.D12.shape[1], p.D21.shape[0]))
    gain = -p.D12.T @ p.D11 @ p.D21.T
    rest = p.D11 + p.D12 @ gain @ p.D21
    if np.linalg.norm(rest) > DIRECT * np.linalg.norm(p.D11):
        z, w = np.unravel_index(int(np.argmax(np.abs(rest))), rest.shape)
        raise IllPosedError(
            f"{where}: D11 has a direct path from {P.input_labels[int(w)]} to {P.output_labels[int(z)]} that no gain "
            "from y to u cancels, so that the norm is infinite; expected D11 = 0; put a low-pass on that w or z",
            P,
        )
    return (
        Partition(
            A=p.A + p.B2 @ gain @ p.C2,
            B1=p.B1 + p.B2 @ gain @ p.D21,
            B2=p.B2,
            C1=p.C1 + p.D12 @ gain @ p.C2,
            C2=p.C2,
            D11=np.zeros_like(p.D11),
            D12=p.D12,
            D21=p.D21,
            D22=p.D22,
        ),
        gain,
    )


def regularised(scaled: ScaledPlant, size: float) -> Regularised:
    """Return the nearest plant, in the sense of `size`, that fulfils the assumptions."""
    p, r, s = scaled.plant, scaled.control_rank, scaled.measurement_rank
    nu, ny = p.B2.shape[1], p.C2.shape[0]
    # The left-out controls are counted in units of 1/ε, so that D12 keeps orthonormal columns.
    into, out = np.ones(nu), np.ones(ny)
    into[r:], out[s:] = 1.0 / size, 1.0 / size
    rows, columns = np.eye(nu)[r:], np.eye(ny)[:, s:]
    plant = Partition(
        A=p.A,
        B1=np.hstack([p.B1, np.zeros((len(p.A), ny - s))]),
        B2=p.B2 * into,
        C1=np.vstack([p.C1, np.zeros((nu - r, len(p.A)))]),
        C2=p.C2 * out[:, None],
        D11=np.block([[p.D11, np.zeros((len(p.D11), ny - s))], [np.zeros((nu - r, p.D11.shape[1] + ny - s))]]),
        D12=np.vstack([p.D12, rows]),
        D21=np.hstack([p.D21, columns]),
        D22=p.D22,
    )
    shift = size if zero_on_axis(plant) is not None else 0.0
    if shift:
        plant = Partition(
            A=p.A + shift * np.eye(len(p.A)), B1=plant.B1, B2=plant.B2, C1=plant.C1, C2=plant.C2,
            D11=plant.D11, D12=plant.D12, D21=plant.D21, D22=plant.D22,
        )  # fmt: skip
    return Regularised(
        scaled=ScaledPlant(
            plant=plant, state=scaled.state, rate=scaled.rate, control=scaled.control * into,
            measurement=scaled.measurement * out[:, None], gain=scaled.gain, D22=scaled.D22,
            control_rank=nu, measurement_rank=ny,
        ),
        size=size if r < nu or s < ny else 0.0,
        shift=shift * scaled.rate,
    )  # fmt: skip
