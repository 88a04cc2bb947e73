"""What the Riccati routes assume of a plant, checked on the scaled plant, and what can be added where it does not hold.

D12 has full column rank: every control costs something. D21 has full row rank: every measurement is noisy. No invariant
zero of w → y or u → z lies on the imaginary axis: nothing on the axis is left to itself.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING

import numpy as np

from platform_ctrl.common.values import FloatArray, value
from platform_ctrl.design.partition import Partition
from platform_ctrl.design.scaling import ScaledPlant, clustered
from platform_ctrl.errors import IllPosedError

if TYPE_CHECKING:
    from control import StateSpace

# Zeros nearer to the axis than this share of the size of A are checked for a loss of rank.
NEAR_AXIS = 1e-7
# Singular values below this share of the size of A count as a loss of rank.
LOST = 1e-10
# A direct path below this share of D11 counts as zero.
DIRECT = 1e-10
ALTERNATIVES = 'give method="lmi", which needs none of this, or regularise=1e-3'


@value
class Regularised:
    """A scaled plant that fulfils the assumptions, and what was added.

    Attributes
    ----------
    scaled
        With rows ε u in z for the controls, and columns ε in w for the measurements, that D12 and D21 left out, and
        A + shift in place of A where a zero was on the axis. Every closed-loop norm from the old w to the old z is at
        most that of this plant (maximum modulus).
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
    """Raise an IllPosedError where D12 or D21 does not have full rank."""
    nu, ny = scaled.plant.B2.shape[1], scaled.plant.C2.shape[0]
    if scaled.control_rank < nu:
        lost = np.abs(scaled.control[:, scaled.control_rank :]).sum(axis=1)
        raise IllPosedError(
            f"{where}: D12 must have full column rank {nu}, but has {scaled.control_rank}: z does not contain "
            f"{named(lost, P.input_labels[-nu:])} directly; add a small weight on every control to z, or "
            f"{ALTERNATIVES}",
            P,
        )
    if scaled.measurement_rank < ny:
        lost = np.abs(scaled.measurement[scaled.measurement_rank :]).sum(axis=0)
        raise IllPosedError(
            f"{where}: D21 must have full row rank {ny}, but has {scaled.measurement_rank}: no w disturbs "
            f"{named(lost, P.output_labels[-ny:])} directly; add a small noise on every measurement to w, or "
            f"{ALTERNATIVES}",
            P,
        )


def zero_on_axis(p: Partition) -> tuple[str, float, FloatArray] | None:
    """Return which matrix loses rank on the axis, the frequency (scaled) and the states involved, (n,), or None.

    `p` is scaled and its D12 and D21 have orthonormal columns and rows.
    """
    size = max(1.0, float(np.linalg.norm(p.A, 2)))
    for one, what in (
        (p, "[A − jωI, B2; C1, D12] loses column rank"),
        (p.dual, "[A − jωI, B1; C2, D21] loses row rank"),
    ):
        A, B, C, D = one.A, one.B2, one.C1, one.D12
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
    """Raise an IllPosedError that names an invariant zero on the imaginary axis."""
    found = zero_on_axis(scaled.plant)
    if found is None:
        return
    what, frequency, states = found
    place = f"{frequency * scaled.rate:.4g} rad/s"
    if P.dt:
        place += " (w-plane)"
    raise IllPosedError(
        f"{where}: there must be no zero on the imaginary axis, but {what} at {place} in the states "
        f"{named(states * scaled.state, P.state_labels)}; shift the weight with that pole or zero to the left, or "
        f"{ALTERNATIVES}",
        P,
    )


def without_direct_path(plant: Partition, P: StateSpace, where: str) -> tuple[Partition, FloatArray]:
    """Return the plant with the gain D_K closed that cancels D11, and D_K; D12 and D21 are orthonormal or zero."""
    gain = -plant.D12.T @ plant.D11 @ plant.D21.T
    closed = plant.with_gain(gain)
    rest = closed.D11
    if np.linalg.norm(rest) > DIRECT * np.linalg.norm(plant.D11):
        z, w = np.unravel_index(int(np.argmax(np.abs(rest))), rest.shape)
        raise IllPosedError(
            f"{where}: the H2 norm is infinite: no gain from y to u cancels the direct path D11 from "
            f"{P.input_labels[int(w)]} to {P.output_labels[int(z)]}; put a low-pass on that w or z",
            P,
        )
    return dataclasses.replace(closed, D11=np.zeros_like(rest)), gain


def widened(p: Partition, rows: FloatArray, columns: FloatArray) -> Partition:
    """Return the plant with further outputs `rows` u in z, and further inputs of w that enter y by `columns`."""
    n, more_z, more_w = len(p.A), len(rows), columns.shape[1]
    return dataclasses.replace(
        p,
        B1=np.hstack([p.B1, np.zeros((n, more_w))]),
        C1=np.vstack([p.C1, np.zeros((more_z, n))]),
        D11=np.pad(p.D11, ((0, more_z), (0, more_w))),
        D12=np.vstack([p.D12, rows]),
        D21=np.hstack([p.D21, columns]),
    )


def regularised(scaled: ScaledPlant, size: float) -> Regularised:
    """Return the nearest plant, in the sense of `size`, that fulfils the assumptions."""
    p, r, s = scaled.plant, scaled.control_rank, scaled.measurement_rank
    nu, ny = p.B2.shape[1], p.C2.shape[0]
    # The left-out controls are counted in units of 1/ε, so that D12 keeps orthonormal columns.
    into, out = np.ones(nu), np.ones(ny)
    into[r:], out[s:] = 1.0 / size, 1.0 / size
    rows, columns = np.eye(nu)[r:], np.eye(ny)[:, s:]
    plant = widened(dataclasses.replace(p, B2=p.B2 * into, C2=p.C2 * out[:, None]), rows, columns)
    shift = size if zero_on_axis(plant) is not None else 0.0
    if shift:
        plant = dataclasses.replace(plant, A=p.A + shift * np.eye(len(p.A)))
    changed = dataclasses.replace(
        scaled, plant=plant, control=scaled.control * into, measurement=scaled.measurement * out[:, None],
        control_rank=nu, measurement_rank=ny,
    )  # fmt: skip
    return Regularised(scaled=changed, size=size if r < nu or s < ny else 0.0, shift=shift * scaled.rate)


def regularised_and_report(
    scaled: ScaledPlant, size: float | None, what: str, least: Callable[[ScaledPlant], float]
) -> tuple[ScaledPlant, dict[str, float]]:
    """Return the regularised plant, and what was added with the `least` norm that a tenth of it would give."""
    if size is None:
        return scaled, {}
    changed = regularised(scaled, size)
    if not (changed.size or changed.shift):
        return changed.scaled, {}
    return changed.scaled, {
        "regularisation of controls and measurements": changed.size,
        "regularisation by a shift of A, rad/s": changed.shift,
        f"least {what} at a tenth of it": least(regularised(scaled, 0.1 * size).scaled),
    }
