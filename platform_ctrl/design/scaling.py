"""Units in which the matrices of a synthesis are near one, the way back, and the checks that need these units.

In SI units a solver gets 1e-4 kg m² beside 1e4 rad/s and fails, with or without an error. Ranks and stabilisability are
checked in these units too, and what the Riccati routes assume, which can be added where it does not hold: D12 has full
column rank (every control costs something), D21 full row rank (every measurement is noisy), and no invariant zero of
w → y or u → z lies on the imaginary axis (nothing on the axis is left to itself).
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from platform_ctrl.analysis.arrays import StateArrays
from platform_ctrl.common.values import FloatArray, value
from platform_ctrl.design.partition import Partition, with_direct_path
from platform_ctrl.errors import IllPosedError, NotStabilisableError, UnscalableError

if TYPE_CHECKING:
    from control import StateSpace

# Sweeps over all states that balance a plant, at most.
MOST_SWEEPS = 50
# Singular values below this share of the largest (of unit columns or rows) count as zero.
RANK_TOLERANCE = 1e-8
# A unit of the norm within so many powers of two is left as it is.
NEAR_UNITS = 4
# Rounding of an eigenvalue with condition 1, and the largest rounding assumed, relative to A.
ROUNDING, LARGEST_ROUNDING = 1e-14, 1e-9
# Poles that are slow beside the norm of A, and the rounding errors of their block of a Schur form over that norm.
_SLOW, _BLOCK_ROUNDING = 1e-3, 1e-15
# Poles below this share of the fastest give no unit of time.
_SLOW_FLOOR = 1e-11
# Zeros nearer to the axis than this share of the size of A are checked for a loss of rank.
NEAR_AXIS = 1e-7
# Singular values below this share of the size of A count as a loss of rank.
RANK_LOSS = 1e-10
# A direct path below this share of D11 counts as zero.
NO_DIRECT_PATH = 1e-10
REGULARISE = "give regularise=1e-3"


def remedy(where: str) -> str:
    """Return what helps where an assumption of the Riccati equations does not hold."""
    return f'{REGULARISE}, or method="lmi", which needs none of this' if where.startswith("hinf") else REGULARISE


@value
class ScaledPlant:
    """A plant in units where its matrices are near one, and the units."""

    # The scaled plant; its D22 is zero, its D12 (D21) has orthonormal columns (rows) where it has full rank.
    plant: Partition
    state: FloatArray  # (n,): x = diag(state) x_scaled
    rate: float  # unit of frequency, rad/s
    control: FloatArray  # (nu, nu): u = control @ u_scaled
    measurement: FloatArray  # (ny, ny): y_scaled = measurement @ (y − D22 u)
    gain: float  # gamma = gain * gamma_scaled
    D22: FloatArray  # (ny, nu): the part of the plant that is undone by a loop shift
    # control_rank, measurement_rank: ranks of D12 and D21.
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

    Time is measured by the geometric mean of the poles' moduli; where all are 0 by the frequency at which a control
    costs as much as what it does to the states; of a sampled plant by its period, so that poles stay where they are.
    States are balanced by Osborne's iteration on [A B; C 0].
    """
    root = np.sqrt(gain)
    every = np.abs(np.linalg.eigvals(plant.A))
    # Poles at 0 are computed as rounding, defective ones as more: they give no unit of time.
    moduli = every[every > 1e-6 * np.max(every, initial=0.0)]
    if moduli.size < every.size and not plant.dt:
        # Beside a pole far away slow ones look like poles at 0.
        block = _slow_part(plant.A, plant.B2, 0.0)[0]
        slow = np.abs(np.linalg.eigvals(block))
        # Poles at 0 are rounding of the size of their block, too.
        floor = max(1e-6 * float(np.linalg.norm(block)), _SLOW_FLOOR * np.max(every))
        moduli = slow[slow > floor] if np.any(slow > floor) else moduli
    rate = 1.0
    if not plant.dt:
        rate = float(np.exp(np.mean(np.log(moduli)))) if moduli.size else _crossover(plant)

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


def _crossover(plant: Partition) -> float:
    """Return the frequency, rad/s, from which on u counts less in z by way of the states than directly; else 1.

    Or from which on w counts less in y by way of the states than directly, where u is not in z.
    """
    # The unit of a single integrator is that of its state.
    for one in (plant, plant.dual) if len(plant.A) > 1 else ():
        S, rank = _unit_controls(one.B2, one.D12)
        if not rank:
            continue

        def ratio(frequency: float, one: Partition = one, S: FloatArray = S) -> float:
            states = np.linalg.solve(1j * frequency * np.eye(len(one.A)) - one.A, one.B2 @ S)
            return float(np.linalg.norm(one.C1 @ states, 2))

        low, high = 1e-9, 1e9
        if not ratio(low) > 1.0 > ratio(high):
            continue
        while high > 1.1 * low:
            middle = float(np.sqrt(low * high))
            low, high = (middle, high) if ratio(middle) > 1.0 else (low, middle)
        return low
    return 1.0


def autoscaled_with_gain(plant: Partition) -> ScaledPlant:
    """Scale a plant, the norm too where w → x and x → z are in far larger or smaller units than u → x and x → y.

    An UnscalableError where its numbers are too far apart: LAPACK prints lines about what is not finite.
    """
    scaled = autoscale(plant)
    p = scaled.plant
    if not all(np.all(np.isfinite(M)) for M in (p.A, p.B1, p.B2, p.C1, p.C2, p.D11, p.D12, p.D21)):
        raise UnscalableError(
            "the plant's numbers are so far apart that no units make all of them finite; leave out what is faster or "
            "slower than the loop by many decades"
        )
    disturbance = float(np.linalg.norm(p.B1) * np.linalg.norm(p.C1))
    loop = float(np.linalg.norm(p.B2) * np.linalg.norm(p.C2))
    if not (0.0 < disturbance < np.inf and 0.0 < loop < np.inf):
        return scaled
    power = np.round(0.5 * (np.log2(disturbance) - np.log2(loop)))
    return scaled if abs(power) < NEAR_UNITS else autoscale(plant, 2.0**power)


def balance(A: FloatArray, B: FloatArray, C: FloatArray) -> FloatArray:
    """Return powers of two d, (n,), such that row i of [D⁻¹AD, D⁻¹B] and column i of [D⁻¹AD; CD] are of similar length.

    D = diag(d). Osborne's iteration, inputs and outputs fixed. A state without inputs or outputs keeps its unit.
    `arrays.state_scaling` does not serve: it gives B and C the size of A, and the units of z then decide on gamma.
    """
    n = len(A)
    d = np.ones(n)
    square = (A - np.diag(np.diag(A))) ** 2
    rows, columns = np.sum(B**2, axis=1), np.sum(C**2, axis=0)
    for _ in range(MOST_SWEEPS):
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
    weakest = (float("inf"), "", 0j)
    for word, A, B in (("stabilisable", plant.A, plant.B2), ("detectable", plant.A.T, plant.C2.T)):
        # Of the modes that are not fast and stable alone: in units of theirs, whatever the fastest pole is.
        slow, into = _slow_part(A, B, plant.dt)
        size = float(np.linalg.norm(np.hstack([slow, into]), 2)) if slow.size else 0.0
        floor = _BLOCK_ROUNDING * float(np.linalg.norm(A, 2))
        for pole in (one for one in not_stable(slow, size, plant.dt, floor) if np.isfinite(one)):
            pencil = np.hstack([slow - pole * np.eye(len(slow)), into])
            sigma = float(np.linalg.svd(pencil, compute_uv=False)[-1]) / size if size > 0.0 else 0.0
            if sigma < weakest[0]:
                weakest = (sigma, word, pole * scaled.rate)
    return weakest


def _slow_part(A: FloatArray, B: FloatArray, dt: float) -> tuple[FloatArray, FloatArray]:
    """Return the motion of the modes that are unstable, or stable and slow beside the fastest, and what drives it."""
    from scipy.linalg import schur

    if not len(A) or not np.isfinite(A).all():
        return A, B
    edge = _SLOW * float(np.linalg.norm(A, 2))

    def chosen(real: float, imaginary: float) -> bool:
        return bool(dt) or np.hypot(real, imaginary) <= edge or real >= -edge

    T, Z, count = schur(A.T, sort=chosen)
    return np.asarray(T[:count, :count].T), np.asarray(Z[:, :count].T @ B)


def not_stable(A: FloatArray, size: float, dt: float, floor: float = 0.0) -> list[complex]:
    """Return poles that are not stable by more than rounding, at least `floor`, and the means of their clusters."""
    from scipy.linalg import eig

    poles, left, right = eig(A, left=True, right=True)
    aligned = np.abs(np.sum(np.conj(left) * right, axis=0))
    rounding = size * np.minimum(ROUNDING * len(poles) / np.maximum(aligned, ROUNDING), LARGEST_ROUNDING) + floor
    found = (np.abs(poles) - 1.0 if dt else poles.real) >= -rounding
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
            f"{remedy(where)}",
            P,
        )
    if scaled.measurement_rank < ny:
        lost = np.abs(scaled.measurement[scaled.measurement_rank :]).sum(axis=0)
        raise IllPosedError(
            f"{where}: D21 must have full row rank {ny}, but has {scaled.measurement_rank}: no w disturbs "
            f"{named(lost, P.output_labels[-ny:])} directly; add a small noise on every measurement to w, or "
            f"{remedy(where)}",
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
            # In units of the zero, not of the fastest pole.
            own = max(1.0, abs(zero)) + _BLOCK_ROUNDING / RANK_LOSS * size
            if abs(zero.real) > NEAR_AXIS * own:
                continue
            shifted = A - 1j * zero.imag * np.eye(len(A))
            _, sigma, Vh = np.linalg.svd(np.block([[shifted, B], [C, D]]))
            if sigma[-1] < RANK_LOSS * own:
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
        f"{remedy(where)}",
        P,
    )


def without_direct_path(plant: Partition, P: StateSpace, where: str) -> tuple[Partition, FloatArray]:
    """Return the plant with the gain D_K closed that cancels D11, and D_K; D12 and D21 are orthonormal or zero."""
    gain = -plant.D12.T @ plant.D11 @ plant.D21.T
    closed = plant.with_gain(gain)
    rest = closed.D11
    if np.linalg.norm(rest) > NO_DIRECT_PATH * np.linalg.norm(plant.D11):
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


def regularised(scaled: ScaledPlant, size: float) -> tuple[ScaledPlant, float, float]:
    """Return a scaled plant that fulfils the assumptions, and what was added or 0: ε, and a shift of A, rad/s.

    It has rows ε u in z for the controls, and columns ε in w for the measurements, that D12 and D21 left out (relative
    to scaled signals), and A + shift in place of A where a zero was on the axis. Every closed-loop norm from the old w
    to the old z is at most that of this plant (maximum modulus).
    """
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
    return changed, size if r < nu or s < ny else 0.0, shift * scaled.rate


def regularised_and_report(
    scaled: ScaledPlant, size: float | None, what: str, least: Callable[[ScaledPlant], float]
) -> tuple[ScaledPlant, dict[str, float]]:
    """Return the regularised plant, and what was added with the `least` norm that a tenth of it would give."""
    if size is None:
        return scaled, {}
    changed, added, shift = regularised(scaled, size)
    if not (added or shift):
        return changed, {}
    return changed, {
        "regularisation of controls and measurements": added,
        "regularisation by a shift of A, rad/s": shift,
        f"least {what} at a tenth of it": least(regularised(scaled, 0.1 * size)[0]),
    }
