"""The plant of a synthesis: inputs [w, u], outputs [z, y], and the loop that u = K y closes around it."""

from __future__ import annotations

import dataclasses
from typing import TYPE_CHECKING

import numpy as np

from platform_ctrl.analysis.feedback import performance_loop
from platform_ctrl.analysis.sampling import from_w_plane, to_w_plane
from platform_ctrl.analysis.system import System
from platform_ctrl.common.arguments import short
from platform_ctrl.common.values import FloatArray, value
from platform_ctrl.errors import ArgumentError
from platform_ctrl.mechanics.linearisation import LinearModel

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

    @property
    def dual(self) -> Partition:
        """The transposed plant: what holds for its controls holds for the measurements of this one."""
        return Partition(
            A=self.A.T, B1=self.C1.T, B2=self.C2.T, C1=self.B1.T, C2=self.B2.T,
            D11=self.D11.T, D12=self.D21.T, D21=self.D12.T, D22=self.D22.T, dt=self.dt,
        )  # fmt: skip

    def with_gain(self, gain: FloatArray) -> Partition:
        """Return the plant with u = gain y + u' closed, for D22 = 0."""
        into, out = self.B2 @ gain, self.D12 @ gain
        return dataclasses.replace(
            self,
            A=self.A + into @ self.C2,
            B1=self.B1 + into @ self.D21,
            C1=self.C1 + out @ self.C2,
            D11=self.D11 + out @ self.D21,
        )


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


def with_direct_path(K: System, D22: FloatArray) -> System:
    """Return the controller u = K y for a plant whose D22 was left out when K was made: K (y − D22 u), solved for u."""
    shift = np.linalg.inv(np.eye(len(K.D)) + K.D @ D22)
    return System(
        A=K.A - K.B @ D22 @ shift @ K.C,
        B=K.B @ (np.eye(K.B.shape[1]) - D22 @ shift @ K.D),
        C=shift @ K.C,
        D=shift @ K.D,
    )


def closed_loop(plant: Partition, K: System) -> System:
    """Return the lower linear fractional transformation of a plant and u = K y, with states [x, xK]."""
    try:
        return performance_loop(whole(plant), K)
    except ArgumentError as error:
        raise np.linalg.LinAlgError(str(error)) from None


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


def first_order(b1: float, b0: float, a1: float, a0: float, period: float) -> System:
    """Return (b1 s + b0)/(a1 s + a0), sampled by Tustin's rule."""
    two = 2.0 / period
    lead, last = a1 * two + a0, a0 - a1 * two
    high, low = b1 * two + b0, b0 - b1 * two
    pole = -last / lead
    direct = high / lead
    return System(
        np.array([[pole]]), np.array([[1.0]]), np.array([[low / lead + direct * pole]]), np.array([[direct]]), period
    )


def notch(frequency: float, depth: float, width: float, period: float) -> System:
    """Return (s² + 2 depth width f s + f²)/(s² + 2 width f s + f²), by Tustin's rule prewarped at f = `frequency`."""
    f2, damping = frequency**2, 2.0 * width * frequency
    return _prewarped((1.0, depth * damping, f2), (1.0, damping, f2), frequency, period)


def low_pass(frequency: float, damping: float, period: float, order: int = 0) -> System:
    """Return sᵏ f²/(s² + 2 damping f s + f²), k = `order`, by Tustin's rule prewarped at f = `frequency`, rad/s."""
    f2 = frequency**2
    numerator = ((0.0, 0.0, f2), (0.0, f2, 0.0), (f2, 0.0, 0.0))[order]
    return _prewarped(numerator, (1.0, 2.0 * damping * frequency, f2), frequency, period)


def _prewarped(
    numerator: tuple[float, float, float], denominator: tuple[float, float, float], frequency: float, period: float
) -> System:
    """Return (b2 s² + b1 s + b0)/(a2 s² + a1 s + a0), by Tustin's rule prewarped at `frequency`, rad/s."""
    two = frequency / np.tan(0.5 * frequency * period)
    b, a = (
        np.array([c2 * two**2 + c1 * two + c0, 2.0 * (c0 - c2 * two**2), c2 * two**2 - c1 * two + c0])
        for c2, c1, c0 in (numerator, denominator)
    )
    a, b = a / a[0], b / a[0]
    return System(
        np.array([[-a[1], -a[2]], [1.0, 0.0]]),
        np.array([[1.0], [0.0]]),
        np.array([[b[1] - b[0] * a[1], b[2] - b[0] * a[2]]]),
        np.array([[b[0]]]),
        period,
    )


def gain(matrix: FloatArray | float) -> System:
    """Return a static gain: `dt` is 0, whatever it is joined with."""
    D = np.atleast_2d(np.asarray(matrix, dtype=np.float64))
    return System(np.zeros((0, 0)), np.zeros((0, D.shape[1])), np.zeros((D.shape[0], 0)), D)


def side_by_side(*systems: System) -> System:
    """Return one system of several, each with its own inputs and outputs."""
    from scipy.linalg import block_diag

    A, B, C, D = (block_diag(*(system[k] for system in systems)) for k in range(4))
    return System(A, B, C, D, systems[0].dt)


def between(first: FloatArray, system: System, last: FloatArray) -> System:
    """Return last · system · first, with matrices for the other signals."""
    A, B, C, D, dt = system
    return System(A, B @ first, last @ C, last @ D @ first, dt)


# A pair whose h is this small against the largest is not gyroscopic.
_NO_GYRO = 1e-9


@value
class Channels:
    """Gyroscopic pairs and inertial directions of some gimbals."""

    # (n, n): orthogonal; rows are directions: y = basis @ q. First the pairs, then the inertial directions.
    basis: FloatArray
    momenta: FloatArray  # (pairs,): h of each pair, N m s
    inertias: FloatArray  # (n,): inertia in each direction, kg m²
    spins: FloatArray  # (rotors,): spin of the rotors that the gimbals carry, rad/s, without those that stand still
    order: int = 2  # 2 where the inertial directions measure angles, 1 where rates: a torque shows in that derivative
    # (n, p): of loops that read other sensors than pick-offs: from their readings to the directions. Design methods
    # then get plants whose outputs are the directions already; None: they take the gimbals' angles there by `basis`.
    sense: FloatArray | None = None
    # (n,): viscous friction, N m s, and stiffness, N m/rad, against motion in each direction; None: not needed.
    damping: FloatArray | None = None
    stiffness: FloatArray | None = None
    noise: FloatArray | None = None  # (n,): rms of a sample of each direction, from its sensors; None: not known

    @property
    def inertial(self) -> int:
        """Number of directions without gyroscopic action."""
        return len(self.basis) - 2 * len(self.momenta)


def channels(model: LinearModel, rows: list[int]) -> Channels:
    """Return the pairs and inertial directions of the gimbals in `rows`."""
    from scipy.linalg import schur

    part = np.ix_(rows, rows)
    carriers = {model.gimbal_names[k] for k in rows}
    M, G = model.M[part], model.G[part]
    block, vectors = schur(0.5 * (G - G.T), output="real")
    largest = np.abs(G).max(initial=0.0)
    pairs: list[tuple[float, FloatArray, FloatArray]] = []
    single: list[FloatArray] = []
    k = 0
    while k < len(rows):
        h = float(block[k, k + 1]) if k + 1 < len(rows) else 0.0
        if abs(h) > _NO_GYRO * largest and largest > 0.0:
            pairs.append((abs(h), *_oriented(h, vectors[:, k], vectors[:, k + 1])))
            k += 2
        else:
            single.append(_upright(vectors[:, k]))
            k += 1
    pairs.sort(key=lambda pair: -pair[0])
    basis = np.array([direction for _, first, second in pairs for direction in (first, second)] + single)
    return Channels(
        basis=basis,
        momenta=np.array([h for h, _, _ in pairs]),
        inertias=np.einsum("ki,ij,kj->k", basis, M, basis),
        spins=np.array([abs(r.spin) for r in model.platform.rotors if r.carrier in carriers and r.spin != 0.0]),
    )


def _oriented(h: float, first: FloatArray, second: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Turn a pair within its plane so that it lies along the gimbal axes where it can, with h > 0."""
    plane = np.array([first, second])
    # The gimbal axis that lies in the plane best becomes the first direction.
    along = plane.T @ plane
    lead = int(np.argmax(np.diag(along)))
    first_new = along[:, lead] / np.linalg.norm(along[:, lead])
    rotated = np.array([plane @ first_new])
    second_new = np.array([-rotated[0, 1], rotated[0, 0]]) @ plane
    return (first_new, second_new) if h > 0.0 else (first_new, -second_new)


def _upright(direction: FloatArray) -> FloatArray:
    return direction if direction[np.argmax(np.abs(direction))] > 0.0 else -direction


def augmented(plant: Partition, order: int) -> Partition:
    """Return the plant with the controller's `order` integrators beside it: u = [xK', u], y = [xK, y]."""
    if order == 0:
        return plant
    n, own = len(plant.A), np.eye(order)
    return Partition(
        A=np.pad(plant.A, (0, order)),
        B1=np.pad(plant.B1, ((0, order), (0, 0))),
        B2=np.block([[np.zeros((n, order)), plant.B2], [own, np.zeros((order, plant.B2.shape[1]))]]),
        C1=np.pad(plant.C1, ((0, 0), (0, order))),
        C2=np.block([[np.zeros((order, n)), own], [plant.C2, np.zeros((len(plant.C2), order))]]),
        D11=plant.D11,
        D12=np.pad(plant.D12, ((0, 0), (order, 0))),
        D21=np.pad(plant.D21, ((order, 0), (0, 0))),
        D22=np.pad(plant.D22, ((order, 0), (order, 0))),
    )
