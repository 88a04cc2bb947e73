"""The plant of a synthesis, inputs [w, u], outputs [z, y]: its loop with u = K y, its units, and what it must fulfil.

In SI units a solver gets 1e-4 kg m² beside 1e4 rad/s and fails, with or without an error: matrices are brought near
one. Ranks and stabilisability are checked in these units too, and what the Riccati routes assume: D12 has full column
rank (every control costs something), D21 full row rank (every measurement is noisy), and no invariant zero of w → y or
u → z lies on the stability boundary (nothing there is left to itself). No check depends on how fast the fastest pole
is: poles are found block by block, and a rank is that of rows and columns of unit length.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from platform_ctrl.analysis.sampling import from_w_plane, to_w_plane
from platform_ctrl.analysis.system import ComplexArray, System
from platform_ctrl.common.arguments import short
from platform_ctrl.common.values import FloatArray, value
from platform_ctrl.design.sections import gain
from platform_ctrl.errors import ArgumentError, IllPosedError, NotStabilisableError, UnscalableError

if TYPE_CHECKING:
    from control import StateSpace

# Sweeps over all states that balance a plant, at most.
MOST_SWEEPS = 50
# Steps towards the unit of time of a chain of integrators; each leaves a third of the distance, in powers.
UNIT_STEPS = 30
# Singular values of D12 and D21 below this share of the largest (of unit columns or rows) count as zero.
RANK_TOLERANCE = 1e-8
# Singular values of a pencil below this share of the largest count as a loss of rank; rows smaller than this, relative
# to the unit of time, may be rounding and keep their size.
RANK_LOSS, SMALLEST_ROW = 1e-10, 1e-3
# A unit of the norm within so many powers of two is left as it is.
NEAR_UNITS = 4
# Rounding of an eigenvalue with condition 1, and the largest rounding assumed, relative to its block of A.
ROUNDING, LARGEST_ROUNDING = 1e-14, 1e-9
# Poles below this share of their block, or of A, count as zero: they give no unit of time.
ZERO_POLE, ZERO_IN_ALL = 1e-6, 1e-11
# Zeros nearer to the stability boundary than this share of their block are checked for a loss of rank.
NEAR_BOUNDARY = 1e-7
# Poles this near, relative to their block, may be copies of a defective one.
CLUSTER = 1e-3


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

    @property
    def dual(self) -> Partition:
        """The transposed plant: what holds for its controls holds for the measurements of this one."""
        return Partition(
            A=self.A.T, B1=self.C1.T, B2=self.C2.T, C1=self.B1.T, C2=self.B2.T,
            D11=self.D11.T, D12=self.D21.T, D21=self.D12.T, D22=self.D22.T, dt=self.dt,
        )  # fmt: skip


def partition(P: StateSpace, nmeas: int, ncon: int, sampled: bool = False) -> Partition:
    """Split a plant at its last `nmeas` outputs and last `ncon` inputs; `sampled`: it may have dt > 0."""
    arrays = System.of(P, "plant")
    if arrays.dt and not sampled:
        raise ArgumentError(f"plant: must be continuous, got dt = {arrays.dt} s; give the plant before it was sampled")
    for name, number, total, signals in (("nmeas", nmeas, P.noutputs, "outputs"), ("ncon", ncon, P.ninputs, "inputs")):
        if isinstance(number, bool) or not (isinstance(number, int | np.integer) and 1 <= number < total):
            raise ArgumentError(
                f"plant: {name} must be a whole number from 1 to {total - 1}, as the plant has {total} {signals}, "
                f"got {short(number)}"
            )
    if P.nstates == 0:
        raise ArgumentError("plant: has no states; a static gain needs no controller design")
    return split(arrays, P.noutputs - nmeas, P.ninputs - ncon)


def split(plant: System, nz: int, nw: int) -> Partition:
    """Split a plant behind its first `nz` outputs and first `nw` inputs."""
    A, B, C, D, dt = plant
    return Partition(
        A=A, B1=B[:, :nw], B2=B[:, nw:], C1=C[:nz], C2=C[nz:],
        D11=D[:nz, :nw], D12=D[:nz, nw:], D21=D[nz:, :nw], D22=D[nz:, nw:], dt=dt,
    )  # fmt: skip


def in_w_plane(plant: Partition) -> Partition:
    """Return a sampled plant in the w-plane, w = (2/T) (z − 1)/(z + 1), which keeps stability and H-infinity norm."""
    if plant.dt == 0.0:
        return plant
    return split(to_w_plane(whole(plant)), *plant.D11.shape)


def out_of_w_plane(K: System, period: float) -> System:
    """Return a controller of the plant that `in_w_plane` made as a sampled one; for `period` 0 as it is."""
    return K if period == 0.0 else from_w_plane(K, period)


def closed_loop(plant: Partition, K: System) -> System:
    """Return the lower linear fractional transformation of a plant and u = K y, with states [x, xK]."""
    (ncon, nmeas), (nz, nw) = K.D.shape, plant.D11.shape
    loop = whole(plant).feedback(K, range(nw, nw + ncon), range(nz, nz + nmeas))
    return loop.part(slice(ncon, ncon + nz), slice(nw))


def whole(plant: Partition) -> System:
    """Return a plant in one piece: from [w, u] to [z, y]."""
    return System(
        A=plant.A,
        B=np.hstack([plant.B1, plant.B2]),
        C=np.vstack([plant.C1, plant.C2]),
        D=np.block([[plant.D11, plant.D12], [plant.D21, plant.D22]]),
        dt=plant.dt,
    )


def controller_system(P: StateSpace, K: System) -> StateSpace:
    """Return u = K y, sampled as P is, with the names that u and y have in P."""
    ncon, nmeas = K.D.shape
    return K._replace(dt=P.dt or 0.0).to_control(P.output_labels[-nmeas:], P.input_labels[-ncon:])


def closed_loop_system(P: StateSpace, loop: System) -> StateSpace:
    """Return a `closed_loop` around P, sampled as P is, with the names that w and z have in P."""
    nz, nw = loop.D.shape
    states = [*P.state_labels, *(f"controller_{k}" for k in range(len(loop.A) - P.nstates))]
    return loop._replace(dt=P.dt or 0.0).to_control(P.input_labels[:nw], P.output_labels[:nz], states)


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

    States are balanced by Osborne's iteration on [A B; C 0]; for the unit of time see `_unit_of_time`. A sampled plant
    counts time in periods, so that poles stay where they are.
    """
    root, rate = np.sqrt(gain), 1.0 if plant.dt else _unit_of_time(plant)
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


def _unit_of_time(plant: Partition) -> float:
    """Return a unit of frequency, rad/s: the geometric mean of the poles' moduli, those at 0 left out.

    Where all are 0 the size of A in the unit itself, with controls and measurements in units of D12 and D21.
    """
    A = plant.A
    least = ZERO_IN_ALL * float(np.linalg.norm(A))
    moduli = [m for poles, _, size in blocks(A) for m in np.abs(poles) if m > max(ZERO_POLE * size, least)]
    if moduli:
        return float(np.exp(np.mean(np.log(moduli))))
    S, St = _unit_controls(plant.B2, plant.D12)[0], _unit_controls(plant.C2.T, plant.D21.T)[0]
    rate, B, C = 1.0, np.hstack([plant.B1, plant.B2 @ S]), np.vstack([plant.C1, St.T @ plant.C2])
    for _ in range(UNIT_STEPS):
        d = balance(A / rate, B / rate, C)
        size = float(np.linalg.norm(A / d[:, None] * d, 2))
        # A single integrator has the unit of its state.
        rate = size or rate
    return rate


def autoscaled_with_gain(plant: Partition) -> ScaledPlant:
    """Scale a plant, the norm too where w → x and x → z are in far larger or smaller units than u → x and x → y.

    An UnscalableError where its numbers are too far apart: LAPACK prints lines about what is not finite.
    """
    scaled = autoscale(plant)
    p = scaled.plant
    if not all(np.all(np.isfinite(M)) for M in (p.A, p.B1, p.B2, p.C1, p.C2, p.D11, p.D12, p.D21)):
        words = "the plant's numbers are so far apart that no units make all of them finite"
        raise UnscalableError(f"{words}; leave out what is faster or slower than the loop by many decades")
    disturbance = float(np.linalg.norm(p.B1) * np.linalg.norm(p.C1))
    loop = float(np.linalg.norm(p.B2) * np.linalg.norm(p.C2))
    if not (0.0 < disturbance < np.inf and 0.0 < loop < np.inf):
        return scaled
    power = np.round(0.5 * (np.log2(disturbance) - np.log2(loop)))
    return scaled if abs(power) < NEAR_UNITS else autoscale(plant, float(2.0**power))


def balance(A: FloatArray, B: FloatArray, C: FloatArray) -> FloatArray:
    """Return powers of two d, (n,), such that row i of [D⁻¹AD, D⁻¹B] and column i of [D⁻¹AD; CD] are of similar length.

    D = diag(d). Osborne's iteration, inputs and outputs fixed. A state without inputs or outputs keeps its unit.
    `analysis.system.state_scaling` does not serve: it gives B and C the size of A, and the units of z then decide on
    gamma.
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


def unscale(controller: System, scaled: ScaledPlant) -> System:
    """Return a controller of the scaled plant in the units of the plant as given."""
    A, B = scaled.rate * controller.A, scaled.rate * controller.B @ scaled.measurement
    C, D = scaled.control @ controller.C, scaled.control @ controller.D @ scaled.measurement
    # Of D22, which was left out when the controller was made, u = K (y − D22 u) is solved for u.
    ny = len(scaled.D22)
    return System(A, B, C, D).feedback(gain(-scaled.D22)).part(slice(ny, None), slice(ny))


def blocks(A: FloatArray) -> list[tuple[ComplexArray, FloatArray, float]]:
    """Return the poles, their rounding errors and the norm of each block of A whose states act on one another.

    A fast pole of one block does not blur the poles of another.
    """
    from scipy.linalg import eig

    reached = (A != 0.0) | np.eye(len(A), dtype=np.bool_)
    for _ in range(len(A).bit_length()):
        reached = reached @ reached
    out = []
    # States that reach one another have the same first one.
    first = np.argmax(reached & reached.T, axis=1)
    for k in np.unique(first):
        block = A[np.ix_(first == k, first == k)]
        size = float(np.linalg.norm(block))
        poles, left, right = eig(block, left=True, right=True)
        aligned = np.abs(np.sum(np.conj(left) * right, axis=0))
        rounding = size * np.minimum(ROUNDING * len(poles) / np.maximum(aligned, ROUNDING), LARGEST_ROUNDING)
        out.append((np.asarray(poles, dtype=np.complex128), rounding, size))
    return out


def _with_means(poles: ComplexArray, chosen: NDArray[np.bool_], size: float) -> list[complex]:
    """Return chosen poles, and the means of their clusters: copies of a defective pole scatter, their mean does not."""
    clusters = [poles[np.abs(poles - one) < CLUSTER * size] for one in poles[chosen]]
    return [*map(complex, poles[chosen]), *(complex(np.mean(some)) for some in clusters if some.size > 1)]


def _rank_margin(pole: complex, A: FloatArray, B: FloatArray, C: FloatArray, D: FloatArray) -> tuple[float, FloatArray]:
    """Return the least singular value over the largest of [A − pole I, B; C, D], and where it is, (columns,).

    Its rows and columns are in units in which they have unit length, taken from the sizes of the terms of its entries.
    """
    eye = np.eye(len(A))
    size = np.abs(np.block([[np.abs(A) + np.abs(pole) * eye, B], [C, D]]))
    rows = 1.0 / np.maximum(np.linalg.norm(size, axis=1), SMALLEST_ROW)
    columns = 1.0 / np.maximum(np.linalg.norm(size * rows[:, None], axis=0), np.finfo(np.float64).eps)
    pencil = np.block([[A - pole * eye, B], [C, D]])
    _, sigma, Vh = np.linalg.svd(pencil * rows[:, None] * columns)
    return (float(sigma[-1] / sigma[0]) if sigma[0] > 0.0 else 0.0), np.abs(Vh[-1]) * columns


def require_stabilisable(plant: Partition, P: StateSpace, where: str) -> None:
    """Raise a NotStabilisableError that names the mode which u can stabilise least from y, where it cannot at all.

    Test of Popov, Belevitch and Hautus; the pole is in rad/s, of a sampled plant in z.
    """
    scaled = autoscaled_with_gain(plant)
    p, weakest = scaled.plant, (np.inf, "", 0j)
    for word, A, B in (("stabilisable", p.A, p.B2), ("detectable", p.A.T, p.C2.T)):
        n, m = B.shape
        for poles, rounding, size in blocks(A):
            beyond = np.abs(poles) - 1.0 if p.dt else poles.real
            for pole in _with_means(poles, beyond >= -rounding, size):
                sigma, _ = _rank_margin(pole, A, B, np.zeros((0, n)), np.zeros((0, m)))
                weakest = min(weakest, (sigma, word, pole * scaled.rate), key=lambda one: one[0])
    sigma, word, pole = weakest
    if sigma < RANK_LOSS:
        verb = "no control u moves" if word == "stabilisable" else "no measurement y sees"
        at = f"z = {pole.real:.6g}{pole.imag:+.4g}j" if plant.dt else f"{pole.real:.4g}{pole.imag:+.4g}j rad/s"
        raise NotStabilisableError(
            f"{where}: the plant is not {word}: {verb} the mode at {at}; put weights with such modes inside the loop, "
            "or shift their poles to the left",
            P,
        )


def named(direction: FloatArray, labels: Sequence[str]) -> str:
    """Return the signals that make up most of a direction."""
    share = np.abs(direction) / max(float(np.abs(direction).max(initial=0.0)), np.finfo(float).tiny)
    return ", ".join(label for label, x in zip(labels, share, strict=True) if x >= 0.3)


def require_assumptions(scaled: ScaledPlant, P: StateSpace, where: str) -> None:
    """Raise an IllPosedError where D12 or D21 loses rank or an invariant zero lies on the stability boundary."""
    cure = ', or give method="lmi", which needs none of this' if where.startswith("hinf") else ""
    (ny, nu), r, s = scaled.D22.shape, scaled.control_rank, scaled.measurement_rank
    controls = named(np.abs(scaled.control[:, r:]).sum(axis=1), P.input_labels[-nu:])
    measured = named(np.abs(scaled.measurement[s:]).sum(axis=0), P.output_labels[-ny:])
    if r < nu:
        words = f"D12 must have full column rank {nu}, but has {r}: z does not contain {controls} directly"
        raise IllPosedError(f"{where}: {words}; add a small weight on every control to z{cure}", P)
    if s < ny:
        words = f"D21 must have full row rank {ny}, but has {s}: no w disturbs {measured} directly"
        raise IllPosedError(f"{where}: {words}; add a small noise on every measurement to w{cure}", P)
    if (found := zero_on_boundary(scaled.plant)) is None:
        return
    what, zero, states = found
    if scaled.plant.dt:
        place = f"the unit circle, but {what} at z = {zero.real:.4g}{zero.imag:+.4g}j"
    else:
        place = f"the imaginary axis, but {what} at {abs(zero) * scaled.rate:.4g} rad/s" + " (w-plane)" * bool(P.dt)
    words = f"there must be no zero on {place} in the states {named(states * scaled.state, P.state_labels)}"
    raise IllPosedError(f"{where}: {words}; shift the weight with that pole or zero to the left{cure}", P)


def zero_on_boundary(p: Partition) -> tuple[str, complex, FloatArray] | None:
    """Return which matrix loses rank on the stability boundary, where (scaled), and the states involved, (n,), or None.

    `p` is scaled and its D12 and D21 have orthonormal columns and rows.
    """
    for one, what in (
        (p, f"[A − {'z' if p.dt else 'jω'}I, B2; C1, D12] loses column rank"),
        (p.dual, f"[A − {'z' if p.dt else 'jω'}I, B1; C2, D21] loses row rank"),
    ):
        A, B, C, D = one.A, one.B2, one.C1, one.D12
        # D'D = I: zeros are eigenvalues of A − B D'C.
        for zeros, _, size in blocks(A - B @ D.T @ C):
            for zero in _with_means(zeros, np.ones(len(zeros), dtype=np.bool_), size):
                distance, nearest = abs(zero.real), 1j * zero.imag
                if p.dt:
                    distance, nearest = abs(abs(zero) - 1.0), zero / (abs(zero) or 1.0)
                if distance > NEAR_BOUNDARY * max(size, abs(zero)):
                    continue
                sigma, where = _rank_margin(nearest, A, B, C, D)
                if sigma < RANK_LOSS:
                    return what, nearest, where[: len(A)]
    return None
