"""Units in which the matrices of a synthesis are near one, the way back, and the checks that need these units.

In SI units a solver gets 1e-4 kg m² beside 1e4 rad/s and fails, with or without an error. Ranks and stabilisability are
checked in these units too.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from platform_ctrl.analysis.arrays import StateArrays
from platform_ctrl.common.values import FloatArray, value
from platform_ctrl.design.partition import Partition, with_direct_path
from platform_ctrl.errors import NotStabilisableError

if TYPE_CHECKING:
    from control import StateSpace

# Singular values below this share of the largest (of unit columns or rows) count as zero.
RANK_TOLERANCE = 1e-8
# A unit of the norm within so many powers of two is left as it is.
NEAR_UNITS = 4
# Rounding of an eigenvalue with condition 1, and the largest rounding assumed, relative to A.
ROUNDING, LARGEST_ROUNDING = 1e-14, 1e-9


@value
class ScaledPlant:
    """A plant in units where its matrices are near one, and the units.

    Attributes
    ----------
    plant
        The scaled plant; its D22 is zero, its D12 (D21) has orthonormal columns (rows) where it has full rank.
    state : (n,)
        x = diag(state) x_scaled.
    rate
        Unit of frequency, rad/s.
    control : (nu, nu)
        u = control @ u_scaled.
    measurement : (ny, ny)
        y_scaled = measurement @ (y − D22 u).
    gain
        gamma = gain * gamma_scaled.
    D22 : (ny, nu)
        The part of the plant that is undone by a loop shift.
    control_rank, measurement_rank
        Ranks of D12 and D21.
    """

    plant: Partition
    state: FloatArray
    rate: float
    control: FloatArray
    measurement: FloatArray
    gain: float
    D22: FloatArray
    control_rank: int
    measurement_rank: int


def _unit_controls(B2: FloatArray, D12: FloatArray) -> tuple[FloatArray, int]:
    """Return S in u = S u' that makes the columns of D12 S orthonormal, or zero where D12 loses rank; and the rank."""
    ncon = D12.shape[1]
    size = np.linalg.norm(D12, axis=0)
    size[size == 0] = 1.0
    S = np.diag(1 / size)
    _, sigma, Vt = np.linalg.svd(D12 @ S, full_matrices=True)
    rank = int(np.sum(sigma > RANK_TOLERANCE))
    S = S @ Vt.T
    # A control that is not in z directly gets its unit from its effect on the states.
    sigma = np.concatenate([sigma[:rank], np.linalg.norm(B2 @ S[:, rank:], axis=0)])
    sigma[sigma == 0] = 1.0
    return S / sigma[:ncon], rank


def autoscale(plant: Partition, gain: float = 1.0) -> ScaledPlant:
    """Scale a plant: D22 shifted out, D12 and D21 to unit columns and rows, time, states; the norm scales by `gain`.

    Time is measured by the geometric mean of the poles' moduli (of a sampled plant by its period, so that poles stay
    where they are), states by Osborne's balancing of [A B; C 0].
    """
    root = np.sqrt(gain)
    moduli = np.abs(np.linalg.eigvals(plant.A))
    # Poles at 0 are computed as rounding, defective ones as more: they give no unit of time.
    moduli = moduli[moduli > 1e-6 * np.max(moduli, initial=0.0)]
    rate = float(np.exp(np.mean(np.log(moduli)))) if moduli.size and not plant.dt else 1.0

    A, B1, C1 = plant.A / rate, plant.B1 / rate / root, plant.C1 / root
    S, control_rank = _unit_controls(plant.B2 / rate, plant.D12 / root)
    St, measurement_rank = _unit_controls(plant.C2.T, plant.D21.T / root)
    B2, D12 = plant.B2 / rate @ S, plant.D12 / root @ S
    C2, D21 = St.T @ plant.C2, St.T @ plant.D21 / root
    # Exactly: what is below the rank tolerance is rounding.
    D12[:, control_rank:] = 0.0
    D21[measurement_rank:] = 0.0

    d = balance(A, np.hstack([B1, B2]), np.vstack([C1, C2]))
    return ScaledPlant(
        plant=Partition(
            A=A / d[:, None] * d, B1=B1 / d[:, None], B2=B2 / d[:, None], C1=C1 * d, C2=C2 * d,
            D11=plant.D11 / gain, D12=D12, D21=D21, D22=np.zeros_like(plant.D22),
            dt=plant.dt,
        ),
        state=d, rate=rate, control=S, measurement=St.T, gain=gain, D22=plant.D22,
        control_rank=control_rank, measurement_rank=measurement_rank,
    )  # fmt: skip


def autoscaled_with_gain(plant: Partition) -> ScaledPlant:
    """Scale a plant, the norm too where w → x and x → z are in far larger or smaller units than u → x and x → y."""
    scaled = autoscale(plant)
    p = scaled.plant
    disturbance = float(np.linalg.norm(p.B1) * np.linalg.norm(p.C1))
    loop = float(np.linalg.norm(p.B2) * np.linalg.norm(p.C2))
    if not (0.0 < disturbance < np.inf and 0.0 < loop < np.inf):
        return scaled
    power = np.round(0.5 * (np.log2(disturbance) - np.log2(loop)))
    return scaled if abs(power) < NEAR_UNITS else autoscale(plant, 2.0**power)


def balance(A: FloatArray, B: FloatArray, C: FloatArray, sweeps: int = 50) -> FloatArray:
    """Return powers of two d, (n,), such that row i of [D⁻¹AD, D⁻¹B] and column i of [D⁻¹AD; CD] are of similar length.

    D = diag(d). Osborne's iteration, inputs and outputs fixed. A state without inputs or outputs keeps its unit.
    `arrays.state_scaling` does not serve: it gives B and C the size of A, and the units of z then decide on gamma.
    """
    n = len(A)
    d = np.ones(n)
    square = (A - np.diag(np.diag(A))) ** 2
    rows, columns = np.sum(B**2, axis=1), np.sum(C**2, axis=0)
    for _ in range(sweeps):
        moved = False
        for i in range(n):
            row = (square[i] @ d**2 + rows[i]) / d[i] ** 2
            column = ((1 / d**2) @ square[:, i] + columns[i]) * d[i] ** 2
            if row == 0 or column == 0:
                continue
            factor = 2.0 ** np.round(0.25 * np.log2(row / column))
            if factor != 1.0:
                d[i] *= factor
                moved = True
        if not moved:
            break
    return d


def unscale(controller: StateArrays, scaled: ScaledPlant) -> StateArrays:
    """Return a controller of the scaled plant in the units of the plant as given."""
    A, B = scaled.rate * controller.A, scaled.rate * controller.B @ scaled.measurement
    C, D = scaled.control @ controller.C, scaled.control @ controller.D @ scaled.measurement
    return with_direct_path(StateArrays(A=A, B=B, C=C, D=D), scaled.D22)


def require_stabilisable(
    plant: Partition, P: StateSpace, where: str = "hinf", scaled: ScaledPlant | None = None
) -> None:
    """Raise a NotStabilisableError that names a mode which u cannot stabilise from y.

    The plant may be in the w-plane of a sampled P; `scaled` is the same plant, if it is available.
    """
    sigma, word, pole = weakest_mode(scaled or autoscaled_with_gain(plant))
    if word and sigma < 1e-10:
        verb = "no control u moves" if word == "stabilisable" else "no measurement y sees"
        at = f"{pole.real:.4g}{pole.imag:+.4g}j rad/s"
        if P.dt:
            z = pole if plant.dt else (1 + 0.5 * P.dt * pole) / (1 - 0.5 * P.dt * pole)
            at = f"z = {z.real:.6g}{z.imag:+.4g}j"
        raise NotStabilisableError(
            f"{where}: the plant is not {word}: {verb} the mode at {at}; put weights with such modes inside the loop, "
            "or shift their poles to the left",
            P,
        )


def weakest_mode(scaled: ScaledPlant) -> tuple[float, str, complex]:
    """Return the unstable mode that is hardest to stabilise: smallest singular value relative to A, property, pole.

    The pole is in rad/s, of a sampled plant in z. Test of Popov, Belevitch and Hautus; ``(inf, "", 0)`` where every
    pole is stable.
    """
    plant = scaled.plant
    size = max(1.0, float(np.linalg.norm(plant.A, 2)))
    weakest = (float("inf"), "", 0j)
    for pole in not_stable(plant, size):
        shifted = plant.A - pole * np.eye(len(plant.A))
        for word, pencil in (
            ("stabilisable", np.hstack([shifted, plant.B2])),
            ("detectable", np.vstack([shifted, plant.C2])),
        ):
            sigma = float(np.linalg.svd(pencil, compute_uv=False)[-1]) / size
            if sigma < weakest[0]:
                weakest = (sigma, word, pole * scaled.rate)
    return weakest


def not_stable(plant: Partition, size: float) -> list[complex]:
    """Return poles that are not stable by more than rounding, and the means of their clusters."""
    from scipy.linalg import eig

    poles, left, right = eig(plant.A, left=True, right=True)
    aligned = np.abs(np.sum(np.conj(left) * right, axis=0))
    rounding = size * np.minimum(ROUNDING * len(poles) / np.maximum(aligned, ROUNDING), LARGEST_ROUNDING)
    found = (np.abs(poles) - 1.0 if plant.dt else poles.real) >= -rounding
    return clustered(poles, size, found)


def clustered(poles: NDArray[Any], size: float, chosen: NDArray[np.bool_] | None = None) -> list[complex]:
    """Return poles, and the means of their clusters: a defective pole scatters, the mean of its copies is accurate."""
    those = poles if chosen is None else poles[chosen]
    out = [complex(p) for p in those]
    for p in those:
        near = poles[np.abs(poles - p) < 1e-3 * size]
        if near.size > 1:
            out.append(complex(np.mean(near)))
    return out
