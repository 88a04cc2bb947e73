"""Linear models in state space with momentum states: exact and proper, without the derivative of Omega.

With p = M q̇ + M_Omega ω the gimbal rows become

    q̇ = M⁻¹ (p − M_Omega ω),        ṗ = Q − (G − ∂Q/∂q̇) q̇ − (K − ∂Q/∂q) q − G_Omega ω.

With a free root the momenta of the root rows, P = J ω + M_Omegaᵀ q̇, are states as well. Under gravity, which is fixed
in space, so are the small rotations θ of a root on a pivot or held, θ' = ω − Omega0 × θ: δf = θ × gravity.

Precession theory (15) is (19) without M q̈. Directions V that G leaves alone keep the momenta π = Vᵀ (M q̇ + M_Omega ω):

    along U   Uᵀ (D q̇ + S q + G_Omega ω − Q) = 0          without inertia
    along V   π' = Vᵀ (Q − D q̇ − S q − G_Omega ω)         with it

with D = G − ∂Q/∂q̇, S = K − ∂Q/∂q and Uᵀ M V = 0: whatever Uᵀ M V is left would be dropped with the inertia of U.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray

from platform_ctrl.common.arguments import distinct, instance, known_names, one_of
from platform_ctrl.common.values import FloatArray, portable
from platform_ctrl.errors import ArgumentError, MechanicsError
from platform_ctrl.mechanics.kinematics import cross_matrix, topology
from platform_ctrl.mechanics.linearisation import (
    LinearModel,
    beyond,
    connected,
    force_rounding,
    inertia_rounding,
    momentum_rounding,
)
from platform_ctrl.mechanics.matrices import inverse_inertia
from platform_ctrl.plant.drives import ROOT_TORQUE_NAMES
from platform_ctrl.plant.platform import FORCE_NAMES, OMEGA_NAMES, Platform
from platform_ctrl.plant.sensors import ROOT_ROTATIONS

if TYPE_CHECKING:
    import control


__all__ = ["state_space", "subsystems"]

# States of a free root: its momenta.
ROOT_MOMENTA = ("P1", "P2", "P3")

ComplexArray = NDArray[np.complex128]
# A, B, C and the names of the states.
Parts = tuple[FloatArray, FloatArray, FloatArray, list[str]]


class NamedMatrices(NamedTuple):
    """A continuous system with named signals; not yet a `control.StateSpace`: python-control takes a second to load."""

    A: FloatArray
    B: FloatArray
    C: FloatArray
    D: FloatArray
    input_labels: list[str]
    output_labels: list[str]
    state_labels: list[str]

    @property
    def nstates(self) -> int:
        """The number of states."""
        return len(self.state_labels)

    @property
    def ninputs(self) -> int:
        """The number of inputs."""
        return len(self.input_labels)

    def state_space(self) -> control.StateSpace:
        """Return the system as users have it."""
        import control

        A, B, C, D, inputs, outputs, states = self
        names = {"inputs": inputs, "outputs": outputs, "states": states}
        return portable(control.StateSpace(A, B, C, D, remove_useless_states=False, **names))


def subsystems(model: LinearModel) -> tuple[tuple[str, ...], ...]:
    """Return the groups of gimbals whose equations are coupled while Omega stays constant, in the file's order.

    Found from the entries of M, G, K and ∂Q at the model's trim that are more than rounding of what both gimbals carry;
    not from the tree. What Omega' multiplies (`M_Omega_q`) couples nothing at a constant rate, and in small deviations
    from one it is of second order.

    Parameters
    ----------
    model
        From `linearise`.

    Returns
    -------
    tuple of tuples
        Names of the gimbals of each group.

    References
    ----------
    K. Magnus, Ingenieur-Archiv 1976, eq. (27).

    Examples
    --------
    >>> import platform_ctrl as pc
    >>> pc.subsystems(pc.linearise(pc.read_platform("three_gyro_platform")))
    (('4', '5', '7'), ('9', '10'))
    """
    return subsystems_of_all([instance("model", model, LinearModel)])


def coupled_while_changing(model: LinearModel) -> tuple[tuple[str, str], ...]:
    """Return pairs of gimbals of different subsystems that act on one another only while Omega changes.

    What Omega' multiplies in the linear equations is `M_Omega_q`.
    """
    names, rounding = model.gimbal_names, inertia_rounding(topology(model.platform))
    either = np.abs(model.M_Omega_q).max(axis=1, initial=0.0) > rounding
    together = {(a, b) for group in subsystems(model) for a in group for b in group}
    pairs = [(names[i], names[j]) for i, j in zip(*np.nonzero(np.triu(either | either.T, 1)), strict=True)]
    return tuple(pair for pair in pairs if pair not in together)


def subsystems_of_all(models: Sequence[LinearModel]) -> tuple[tuple[str, ...], ...]:
    """Return the groups of gimbals whose equations are coupled in any of several models of the same gimbals."""
    names = {model.gimbal_names for model in models}
    if len(names) != 1:
        given = "; ".join(", ".join(gimbals) for gimbals in sorted(names)) or "none"
        raise ArgumentError(f"models: must be one or more models of the same gimbals, got {given}")
    # A gimbal's row contains another's angle or its derivatives.
    coupled = np.any([part != 0.0 for model in models for part in _coefficients(model)], axis=0)
    return tuple(tuple(models[0].gimbal_names[k] for k in group) for group in connected(coupled))


def _coefficients(model: LinearModel) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return M, the damping and the stiffness of (19), zero where entries are no larger than rounding makes them."""
    platform, rate = model.platform, float(np.linalg.norm(model.Omega0))
    tree = topology(platform)
    inertia, momentum = inertia_rounding(tree), momentum_rounding(tree)
    forces = force_rounding(platform, tree, float(np.linalg.norm(model.specific_force)))
    gyroscopic = momentum + inertia * rate
    stiffness = beyond(model.K, gyroscopic * rate) - beyond(model.Q_angle, forces)
    return beyond(model.M, inertia), beyond(model.G, gyroscopic) - model.Q_rate, stiffness


def state_space(
    model: LinearModel,
    root: Literal["prescribed", "free"] = "prescribed",
    gimbals: Sequence[str] | None = None,
    specific_force: bool = False,
    others: Literal["coupled", "held"] = "coupled",
    currents: bool = False,
) -> control.StateSpace:
    """Return the linear model as a state-space system.

    Parameters
    ----------
    model
        From `linearise`.
    root
        ``"prescribed"``: Omega is an input, the gimbals do not react on the platform. ``"free"``: the platform reacts.
    gimbals
        Names of the gimbals of one or several subsystems; default all. With a free root only where others are held.
    specific_force
        Whether the specific force is an input as well, for platforms with masses or unbalance: f1 to f3 behind the
        others, m/s².
    others
        What becomes of gimbals that are not named: ``"held"`` at their angles of the trim, or ``"coupled"``: they must
        not be, `gimbals` have to be whole subsystems.
    currents
        Whether current, integral and voltage of current loops with `rate_hz` are states, the last ones; else ideal.

    Returns
    -------
    control.StateSpace
        States: angles, then their momenta ``p_`` + angle (free root: then the root's momenta P1 to P3), and the root's
        rotations theta1 to theta3 where gravity acts on what turns with it.
        Inputs: the torquers in the file's order, then Omega1 to Omega3 (free root: the gimbals' torquers, then M1 to
        M3). Outputs: the angles in the file's order (free root: then Omega1 to Omega3). All deviate from the trim.

    Raises
    ------
    ArgumentError
        Unknown gimbal or `root`; `gimbals` cuts through a subsystem, or is given with a free root and others coupled.
    MechanicsError
        A* is singular at the trim (gimbal lock).

    References
    ----------
    K. Magnus, Ingenieur-Archiv 1976, eqs. (19), (27).

    See docs/theory/mechanics.md.

    Examples
    --------
    >>> import platform_ctrl as pc
    >>> model = pc.linearise(pc.read_platform("three_gyro_platform"))
    >>> pc.state_space(model, gimbals=("9", "10")).input_labels
    ['Q9', 'Q10', 'Omega1', 'Omega2', 'Omega3']
    """
    instance("model", model, LinearModel)
    one_of("root", root, ("prescribed", "free"))
    one_of("others", others, ("coupled", "held"))
    if root == "free":
        if gimbals is not None and others == "coupled":
            raise ArgumentError(
                "gimbals: given with root='free'; a free platform couples them all: leave it out, or hold the others"
            )
        return free_system(model, gimbals, specific_force, currents=currents).state_space()
    return linear_system(model, gimbals, specific_force, others, currents, turning=True).state_space()


def linear_system(
    model: LinearModel,
    gimbals: Sequence[str] | None = None,
    specific_force: bool = False,
    others: Literal["coupled", "held"] = "coupled",
    currents: bool = False,
    turning: bool = False,
) -> NamedMatrices:
    """Return the result of `state_space` with a prescribed root; gravity turns with it if not `turning`."""
    rows = whole_subsystems(model, gimbals) if others == "coupled" else named_rows(model, gimbals)
    torquers, torque_map = gimbal_torquers(model, [model.gimbal_names[k] for k in rows])
    names, (M, G, K), (M_Omega, G_Omega, Q_force), torque_map = _with_modes(
        model, rows, _coefficients(model), torquers, torque_map
    )
    n = len(names)
    mobility = inverse_inertia(M, names)
    A = np.block([[np.zeros((n, n)), mobility], [-K, -G @ mobility]])
    of_rates = [np.zeros((n, len(torquers))), -mobility @ M_Omega, np.zeros((n, 3))]
    B = np.block([of_rates, [torque_map, G @ mobility @ M_Omega - G_Omega, Q_force]])
    C = np.eye(len(rows), 2 * n)
    inputs = [*torquers, *OMEGA_NAMES, *FORCE_NAMES]
    states = [*names, *(f"p_{name}" for name in names)]
    falling = tilting(B, model.platform)
    if turning and falling.any():
        A = np.block([[A, falling], [np.zeros((3, 2 * n)), -cross_matrix(model.Omega0)]])
        B, C = np.vstack([B, np.eye(3, B.shape[1], len(torquers))]), np.pad(C, ((0, 0), (0, 3)))
        states += ROOT_ROTATIONS
    parts = _modes_last(A, B, C, states, len(rows), n)
    parts = with_currents(parts, inputs, model) if currents else parts
    return _named(parts, inputs, names[: len(rows)], specific_force)


def _with_modes(
    model: LinearModel, rows: list[int], square: Sequence[FloatArray], torquers: list[str], torque_map: FloatArray
) -> tuple[list[str], list[FloatArray], list[FloatArray], FloatArray]:
    """Return names, M, damping and stiffness, what Omega and the specific force do, and torques, modes behind gimbals.

    A mode is one more coordinate: unit mass, 2 ζ ω and ω², Γ in M and M_Omega, −Γ_f in Q_force and φ in the torques.
    """
    names, gimbals = [model.angle_names[k] for k in rows], [model.gimbal_names[k] for k in rows]
    square = [one[np.ix_(rows, rows)] for one in square]
    wide = (model.M_Omega[rows], model.G_Omega[rows], model.Q_force[rows])
    modes = [m for m in model.platform.modes if m.excited(torquers, gimbals)]
    k = len(modes)
    frequency = np.array([m.frequency for m in modes])
    own = (np.ones(k), 2.0 * np.array([m.damping for m in modes]) * frequency, frequency**2)
    shared = np.array([m.inertial(gimbals)[3:] for m in modes]).reshape(k, len(names)).T
    corners = (shared, 0.0 * shared, 0.0 * shared)
    squares = [
        np.block([[one, corner], [corner.T, np.diag(diagonal)]])
        for one, corner, diagonal in zip(square, corners, own, strict=True)
    ]
    if shared.any() and np.linalg.eigvalsh(square[0] - shared @ shared.T).min() <= 0.0:
        words = "with their joints they have more inertia than the gimbals have (A* − ΓΓᵀ is not positive definite)"
        cure = "give smaller joints or, of an uncertain plant, a smaller mode_participation or inertia of [uncertainty]"
        raise MechanicsError(f"modes {', '.join(m.name for m in modes if m.joints)}: {words}; {cure}")
    more = [np.array([m.base for m in modes]), np.zeros((k, 3)), -np.array([m.base_force for m in modes])]
    wides = [np.vstack([one, row.reshape(k, 3)]) for one, row in zip(wide, more, strict=True)]
    shapes = np.array([m.of(torquers) for m in modes]).reshape(k, len(torquers)) * torque_map.sum(axis=0)
    return [*names, *(m.name for m in modes)], squares, wides, np.vstack([torque_map, shapes])


def _modes_last(A: FloatArray, B: FloatArray, C: FloatArray, states: list[str], gimbals: int, n: int) -> Parts:
    """Return a system whose n angles and modes and their momenta are states: angles, momenta, others, then modes."""
    order = [*range(gimbals), *range(n, n + gimbals), *range(2 * n, len(states))]
    order += [at + k for k in range(gimbals, n) for at in (0, n)]
    return A[np.ix_(order, order)], B[order], C[:, order], [states[k] for k in order]


def free_system(
    model: LinearModel,
    gimbals: Sequence[str] | None = None,
    specific_force: bool = False,
    isolated: bool = False,
    currents: bool = False,
) -> NamedMatrices:
    """Return the result of `state_space` with a free root, gimbals that are not named held.

    An `isolated` floating root has no torques from outside: M1 to M3 do nothing. The momentum of the whole keeps its
    direction in space, P − G_Omegaᵀ q − p0 × θ = 0, so that the rotations theta1 to theta3 are states in place of P.
    """
    rows = named_rows(model, gimbals)
    torquers, torque_map = gimbal_torquers(model, [model.gimbal_names[k] for k in rows])
    square = (model.M, model.damping, model.stiffness)
    names, (M, damping, stiffness), (M_Omega, G_Omega, Q_force), torque_map = _with_modes(
        model, rows, square, torquers, torque_map
    )
    n = len(names)
    to_rates = inverse_inertia(np.block([[M, M_Omega], [M_Omega.T, model.root_inertia]]), (*names, *OMEGA_NAMES))
    q_dot, omega = to_rates[:n], to_rates[n:]
    turn = cross_matrix(model.Omega0)
    # Root rows: δp = P − G_Omegaᵀ q, and d(δp)/dt + Omega0 × δp + ω × p0 = δM.
    root_rates = G_Omega.T @ q_dot + cross_matrix(model.root_momentum) @ omega
    if model.terms == "exact":  # else J Omega Omega is dropped with G_A: the root's momentum P turns no further
        root_rates -= turn @ np.eye(3, n + 3, n)
    root_angles = turn @ G_Omega.T + np.pad(model.M_angle[:, rows], ((0, 0), (0, n - len(rows))))
    gimbal_rates = -damping @ q_dot - G_Omega @ omega
    A = np.block([[np.zeros((n, n)), q_dot], [-stiffness, gimbal_rates], [root_angles, root_rates]])
    still, m = np.zeros((n, 3)), len(torquers)
    B = np.block([[np.zeros((n, m + 6))], [torque_map, still, Q_force], [np.zeros((3, m)), np.eye(3), model.M_force]])
    C = np.vstack([np.eye(len(rows), 2 * n + 3), np.pad(omega, ((0, 0), (n, 0)))])
    states = [*names, *(f"p_{name}" for name in names), *ROOT_MOMENTA]
    falling = tilting(B, model.platform)
    if isolated or falling.any():
        A = np.block([[A, falling], [np.zeros((3, n)), omega, -turn]])
        B, C = np.pad(B, ((0, 3), (0, 0))), np.pad(C, ((0, 0), (0, 3)))
        states += ROOT_ROTATIONS
    if isolated:
        kept = [*range(2 * n), *range(2 * n + 3, 2 * n + 6)]
        T = np.eye(2 * n + 6)[:, kept]
        T[2 * n : 2 * n + 3] = np.hstack([G_Omega.T, np.zeros((3, n)), cross_matrix(model.root_momentum)])
        A, B, C, states = A[kept] @ T, B[kept], C @ T, [states[k] for k in kept]
    inputs, outputs = [*torquers, *ROOT_TORQUE_NAMES, *FORCE_NAMES], [*names[: len(rows)], *OMEGA_NAMES]
    parts = _modes_last(A, B, C, states, len(rows), n)
    return _named(with_currents(parts, inputs, model) if currents else parts, inputs, outputs, specific_force)


def tilting(B: FloatArray, platform: Platform) -> FloatArray:
    """Return columns (..., n, 3) of small rotations θ of the root: δf = θ × gravity is the last three inputs of B."""
    return np.asarray(B[..., -3:] @ -cross_matrix(platform.gravity))


def named_rows(model: LinearModel, gimbals: Sequence[str] | None) -> list[int]:
    """Return the rows of the named gimbals, default all, in the file's order."""
    known = instance("model", model, LinearModel).gimbal_names
    return list(range(len(known))) if gimbals is None else known_names("gimbals", gimbals, known)


def whole_subsystems(model: LinearModel, gimbals: Sequence[str] | None) -> list[int]:
    """Return the rows of the named gimbals (default all); an error where they cut through a subsystem."""
    if gimbals is None:
        return named_rows(model, None)
    chosen = set(named_rows(model, gimbals))
    for group in subsystems(model):
        members = {model.gimbal_names.index(name) for name in group}
        if members & chosen and not members <= chosen:
            inside = ", ".join(model.gimbal_names[k] for k in sorted(members & chosen))
            outside = ", ".join(model.gimbal_names[k] for k in sorted(members - chosen))
            rate = " rad/s, ".join(f"{name} = {x:g}" for name, x in zip(OMEGA_NAMES, model.Omega0, strict=True) if x)
            at = f" at {rate} rad/s" if rate else ""
            raise ArgumentError(f"gimbals: {inside} and {outside} are coupled{at}; give whole subsystems, here {group}")
    return sorted(chosen)


def gimbal_torquers(model: LinearModel, gimbals: Sequence[str]) -> tuple[list[str], FloatArray]:
    """Return the torquers on the named gimbals: names in the file's order, and their torques on each gimbal, (g, t).

    A row is a gimbal, in the order given; 1 where a torquer turns it, of a servo the torque for a unit of its command.
    """
    torquers = [t for t in model.platform.torquers if t.gimbal in gimbals]
    torque_map = np.array([[t.gain if t.gimbal == name else 0.0 for t in torquers] for name in gimbals])
    return [t.name for t in torquers], torque_map.reshape(len(gimbals), len(torquers))


def _named(parts: Parts, inputs: list[str], outputs: list[str], specific_force: bool) -> NamedMatrices:
    """Put names to A, B, C and states of a system whose last three inputs are the specific force, wanted or not."""
    A, B, C, states = parts
    if not specific_force:
        B, inputs = B[:, :-3], inputs[:-3]
    D = np.zeros((len(C), B.shape[1]))
    return NamedMatrices(
        A, B, C, D, distinct("inputs", inputs), distinct("outputs", outputs), distinct("states", states)
    )


def with_currents(parts: Parts, inputs: Sequence[str], model: LinearModel) -> Parts:
    """Return A, B, C and states of a system that torques act on with currents of motors and loops as last states."""
    A, B, C, states = parts
    for torquer in model.platform.torquers:
        winding = torquer.winding
        if winding is None or torquer.name not in inputs:
            continue
        own, driven = winding.matrices
        column, n = inputs.index(torquer.name), len(A)
        rate = states.index(model.angle_names[model.platform.gimbal(str(torquer.gimbal))])
        torque = np.outer(B[:, column], [winding.swell * winding.per_ampere, 0.0, 0.0])
        B = B.copy()
        B[:, column] = 0.0
        A = np.block([[A, torque], [np.outer(driven[:, 1], A[rate]), own]])
        B = np.vstack([B, np.outer(driven[:, 1], B[rate])])
        B[n:, column] = driven[:, 0] / winding.per_ampere
        C = np.pad(C, ((0, 0), (0, 3)))
        states = [*states, *(f"{part}_{torquer.name}" for part in ("current", "integral", "voltage"))]
    return A, B, C, states
