"""Linear equations in the gimbal angles, eq. (19), about any constant platform rate.

About angles q0 at rest in the platform and a constant rate Omega0 the gimbal rows are

    M q̈ + (G − ∂Q/∂q̇) q̇ + (K − ∂Q/∂q) q + M_Omega ω' + G_Omega ω = Q − Q0

with ω the deviation of Omega. The left side without ∂Q follows from T = T2 + T1 alone: with p(q, Omega) = ∂T/∂q̇ at
q̇ = 0, G = ∂p/∂q − (∂p/∂q)ᵀ and K = −∂²T/∂q², so that G is skew and K symmetric. ∂Q belongs to springs, friction,
cages, unbalance and erection, and to the weight −Pᵀf of bodies with a mass, P = [−[S]×, ∂S/∂q], under the specific
force f of the root's origin; Q on the right is what the torquers do.
"""

from __future__ import annotations

from typing import Literal

import numpy as np
from numpy.typing import ArrayLike

from platform_ctrl.common.arguments import one_of, real_array
from platform_ctrl.common.values import FloatArray, value
from platform_ctrl.errors import ArgumentError
from platform_ctrl.mechanics.forces import ForceElements, specific_force_at
from platform_ctrl.mechanics.kinematics import Kinematics, Topology, cross_matrix, kinematics, topology
from platform_ctrl.mechanics.matrices import derivatives, directions, mass_matrix, world_inertias
from platform_ctrl.plant.platform import Platform

Terms = Literal["exact", "paper"]


@value
class LinearModel:
    """Linear equations of the gimbals, and of the root when it is free.

    Attributes
    ----------
    platform, terms
        What was linearised, and which terms were kept.
    q0 : (n,)
        Angles of the trim, rad.
    Omega0, specific_force : (3,)
        Constant platform rate, rad/s, and specific force, m/s², of the trim.
    Q0 : (n,)
        Torques that the torquers need to hold the trim, N m.
    M, G, K : (n, n)
        Inertia (symmetric), kg m², gyroscopic (skew), N m s, and stiffness (symmetric) matrix, N m/rad.
    M_Omega, G_Omega : (n, 3)
        Coefficients of ω', kg m², and ω, N m s: the deviation of the platform's rate from `Omega0`.
    M_Omega_q : (n, 3, n)
        Coefficient of Omega'_a q_j in row i, ``[i, a, j]``, kg m²: for rates that change during a manoeuvre.
    root_inertia : (3, 3)
        A* of the root rows, kg m².
    root_momentum : (3,)
        ∂T/∂Omega at the trim, N m s (``terms="paper"``: the rotors' part h₀ alone).
    Q_angle, Q_rate : (n, n)
        ∂Q/∂q, N m/rad, and ∂Q/∂q̇, N m s, of the force elements and of weight.
    Q_force, M_force
        ∂Q/∂f and ∂M/∂f, N m per m/s² of specific force: what masses and unbalance make of vibration and manoeuvres.
        Shapes (n, 3), (3, 3).
    M_angle : (3, n)
        ∂M/∂q, the root's rows, N m/rad.

    References
    ----------
    K. Magnus, Ingenieur-Archiv 1976, eqs. (19), (27).
    """

    platform: Platform
    terms: Terms
    q0: FloatArray
    Omega0: FloatArray
    specific_force: FloatArray
    Q0: FloatArray
    M: FloatArray
    G: FloatArray
    K: FloatArray
    M_Omega: FloatArray
    G_Omega: FloatArray
    M_Omega_q: FloatArray
    root_inertia: FloatArray
    root_momentum: FloatArray
    Q_angle: FloatArray
    Q_rate: FloatArray
    Q_force: FloatArray
    M_force: FloatArray
    M_angle: FloatArray

    @property
    def damping(self) -> FloatArray:
        """G − ∂Q/∂q̇, (n, n), N m s: the coefficient of q̇ in (19)."""
        return np.asarray(self.G - self.Q_rate)

    @property
    def stiffness(self) -> FloatArray:
        """K − ∂Q/∂q, (n, n), N m/rad: the coefficient of q in (19)."""
        return np.asarray(self.K - self.Q_angle)

    @property
    def gimbal_names(self) -> tuple[str, ...]:
        """Names of the gimbals, in the order of the rows."""
        return self.platform.gimbal_names

    @property
    def angle_names(self) -> tuple[str, ...]:
        """Names of the coordinates."""
        return self.platform.angle_names


def linearise(
    platform: Platform,
    Omega: ArrayLike = (0.0, 0.0, 0.0),
    terms: Terms = "exact",
    q: ArrayLike | None = None,
    specific_force: ArrayLike | None = None,
    rate_amplitude: ArrayLike | None = None,
) -> LinearModel:
    """Linearise in the gimbal angles about a constant platform rate.

    Parameters
    ----------
    platform
        The platform.
    Omega : (3,)
        Constant rate of the root in its own axes, rad/s.
    terms
        ``"exact"``: every term linear in the angles. ``"paper"``: the rule behind (27): A constant, BᵀA_R B and G_R to
        first order, G_A dropped; what is left out is of the order J Omega against L.
    q : (n,)
        Angles of the trim, rad; default zero.
    specific_force : (3,)
        f of the trim in root axes, m/s²; default the platform's own, with gravity as in the file: the root at the
        identity attitude.
    rate_amplitude : (n,)
        Amplitudes of the gimbal rates, rad/s, > 0, at which dry friction is replaced by its describing function.
        Default: dry friction has no slope at rest and is left out.

    Returns
    -------
    LinearModel
        The matrices of (19) at the trim, and those of the root's rows.

    Raises
    ------
    ArgumentError
        Wrong shape, not finite, or unknown `terms`.

    References
    ----------
    K. Magnus, Ingenieur-Archiv 1976, eqs. (19), (27).

    See docs/theory/the-paper.md.

    Examples
    --------
    >>> import platform_ctrl as pc
    >>> model = pc.linearise(pc.read_platform("three_gyro_platform"))
    >>> model.G[3:, 3:].round(3)  # gimbals 9 and 10: the gyroscopic matrix of one rotor
    array([[ 0.  ,  0.15],
    [-0.15,  0.  ]])
    """
    tree = topology(platform)
    n = len(tree.parents)
    Omega0 = real_array("Omega", Omega, (3,))
    q0 = real_array("q", q, (n,), 0.0)
    one_of("terms", terms, ("exact", "paper"))
    f = specific_force_at(platform, specific_force)
    amplitude = None if rate_amplitude is None else real_array("rate_amplitude", rate_amplitude, (n,))
    if amplitude is not None and not np.all(amplitude > 0.0):
        raise ArgumentError(f"rate_amplitude: must be {n} numbers > 0, rad/s, got {amplitude.tolist()}")
    at = kinematics(platform, q0)
    inertias = world_inertias(at)
    A_star, B = mass_matrix(at, inertias), directions(at)  # (12), (3)
    change, P = derivatives(at), at.momentum * (not tree.floating)  # free in space, bodies have no weight
    elements = ForceElements(platform, at, f)
    slopes = elements.slopes(q0, amplitude)
    # T1 = uᵀBᵀL: ∂(BᵀL)/∂q, ∂T1/∂q and ∂²T1/∂q² at u = [Omega0, 0].
    momentum_slope = np.einsum("jrx,r->xj", change.B, tree.L)
    energy_slope = np.einsum("jra,r,a->j", change.B[:, :, :3], tree.L, Omega0)
    # ∂²T1/∂q² = ∂²(Lᵀ B_Omega Omega)/∂q²: the gyroscopic restraint L Omega.
    curvature = np.zeros((len(at.axes), len(at.axes)))
    for L, axis, body in zip(tree.L, at.spin_axes, tree.carriers, strict=True):
        curvature += L * _axis_curvature(at, axis, body) @ Omega0
    root_momentum = (B.T @ tree.L)[:3]
    if terms == "exact":
        # T2 = ½ uᵀA*u.
        momentum_slope = momentum_slope + np.einsum("jxa,a->xj", change.A_star[:, :, :3], Omega0)
        energy_slope = energy_slope + 0.5 * np.einsum("a,jab,b->j", Omega0, change.A_star[:, :3, :3], Omega0)
        curvature = curvature + _inertia_curvature(at, inertias, Omega0) + _motion_curvature(at, Omega0)
        root_momentum = root_momentum + A_star[:3, :3] @ Omega0
        M_Omega_q = np.einsum("jia->iaj", change.A_star[:, 3:, :3])
    else:
        A_R = tree.C * tree.regulated
        half = np.einsum("jri,r,ra->iaj", change.B[:, :, 3:], A_R, B[:, :3])
        M_Omega_q = half + np.einsum("ri,r,jra->iaj", B[:, 3:], A_R, change.B[:, :, :3])
    return LinearModel(
        platform=platform,
        terms=terms,
        q0=q0,
        Omega0=Omega0,
        specific_force=f,
        Q0=-energy_slope - elements.forces(q0, np.zeros(n))[3:] + P[:, 3:].T @ f,
        M=A_star[3:, 3:],
        G=momentum_slope[3:] - momentum_slope[3:].T,
        K=-curvature,
        M_Omega=A_star[3:, :3],
        G_Omega=-momentum_slope[:3].T,
        M_Omega_q=M_Omega_q,
        root_inertia=A_star[:3, :3],
        root_momentum=root_momentum,
        Q_angle=slopes.angle[3:] - np.einsum("a,jak->kj", f, change.P[:, :, 3:]) * (not tree.floating),
        Q_rate=slopes.rate,
        Q_force=slopes.force[3:] - P[:, 3:].T,
        M_force=slopes.force[:3] - P[:, :3].T,
        M_angle=slopes.angle[:3] + cross_matrix(f) @ P[:, 3:],
    )


def _axis_curvature(at: Kinematics, axis: FloatArray, body: int) -> FloatArray:
    """∂²axis/∂q_i∂q_j of an axis that is fixed in a body, (n, n, 3)."""
    turning = cross_matrix(at.axes)
    # The outer gimbal i turns what the inner one j, or itself, has turned.
    once = (turning @ axis) * at.tree.on_path[body][:, None]
    out = np.einsum("iab,jb->ija", turning, once) * at.tree.on_path[1:].T[:, :, None]
    return np.asarray(np.where(at.tree.above[:, :, None], out, out.swapaxes(0, 1)))


def _inertia_curvature(at: Kinematics, inertias: FloatArray, Omega: FloatArray) -> FloatArray:
    """∂²T2/∂q² = ∂²(½ Omegaᵀ A*_OmegaOmega Omega)/∂q², (n, n)."""
    turning = cross_matrix(at.axes)
    carried = np.einsum("bj,bxy->jxy", at.tree.on_path, inertias)  # inertia that gimbal j turns
    # In body axes Omega changes by −a_j × Omega, and twice by a_j × (a_i × Omega), i above j or j itself.
    once = turning @ Omega
    turned = (carried @ once[:, :, None])[:, :, 0] - (turning @ (carried @ Omega)[:, :, None])[:, :, 0]
    out = once @ turned.T * at.tree.on_path[1:].T
    return np.asarray(out + out.T - np.diag(np.diag(out)))


def _motion_curvature(at: Kinematics, Omega: FloatArray) -> FloatArray:
    """∂²T2/∂q² of what moves with masses and geared rotors, ½ Σ m |Omega × x|² + ½ Σ J (a · Omega)², (n, n)."""
    tree, turn = at.tree, cross_matrix(Omega)
    moving = turn @ at.velocities[:, :, 3:]  # Omega × ∂x/∂q
    second = at.centre_curvature()
    out = np.einsum("b,bai,baj->ij", tree.masses, moving, moving)
    out += np.einsum("b,ba,ijba->ij", tree.masses, at.centres @ turn.T, second @ turn.T)
    for k, J in zip(tree.geared, tree.gear_inertias, strict=True):
        axis, parent = at.axes[k], 1 + int(tree.parents[k])
        first = np.cross(at.axes, axis) @ Omega * tree.on_path[parent]
        out += J * (np.outer(first, first) + (axis @ Omega) * _axis_curvature(at, axis, parent) @ Omega)
    if tree.floating:  # − ½ |Omega × S|²/m
        first_moment = turn @ at.momentum[:, 3:]
        out -= first_moment.T @ first_moment / tree.mass
        out -= np.einsum("b,ijba,a->ij", tree.masses, second @ turn.T, turn @ at.moment) / tree.mass
    return np.asarray(out)


# Rounding of a sum over the tree, relative to the sum of the sizes of its terms.
_ROUNDING = 256 * np.finfo(float).eps


def connected(coupled: ArrayLike) -> list[list[int]]:
    """Return the indices, sorted, of each group that the entries of a square bool matrix connect."""
    from scipy.sparse.csgraph import connected_components

    number, group = connected_components(np.asarray(coupled, dtype=bool), directed=False)
    return [np.flatnonzero(group == k).tolist() for k in range(number)]


def beyond(part: FloatArray, rounding: FloatArray) -> FloatArray:
    """Return an array without the entries that are no larger than rounding makes them."""
    return np.where(np.abs(part) > rounding, part, 0.0)


def inertia_rounding(tree: Topology) -> FloatArray:
    """Return the rounding to expect in what inertias give gimbals i and j, (n, n): only what both carry enters it."""
    size = np.trace(tree.inertias, axis1=1, axis2=2) + tree.masses * _reach(tree) ** 2
    np.add.at(size, tree.carriers, tree.C * tree.regulated)
    np.add.at(size, 1 + tree.geared, tree.gear_inertias * (1.0 + np.abs(tree.gears)) ** 2)
    out = _carried_by_both(tree, size)
    if tree.floating:
        moments = (tree.masses * _reach(tree)) @ tree.on_path
        out += _ROUNDING * np.outer(moments, moments) / tree.mass
    return out


def _reach(tree: Topology) -> FloatArray:
    """Return bounds of the distances of the bodies' centres from the root's origin, (1 + n,), m."""
    return np.asarray(np.linalg.norm(tree.centres, axis=1) + tree.on_path @ np.linalg.norm(tree.joints, axis=1))


def momentum_rounding(tree: Topology) -> FloatArray:
    """Return the rounding to expect in what rotors' L gives gimbals i and j, (n, n)."""
    size = np.zeros(len(tree.on_path))
    np.add.at(size, tree.carriers, np.abs(tree.L))
    return _carried_by_both(tree, size)


def force_rounding(platform: Platform, tree: Topology, specific_force: float) -> FloatArray:
    """Return the rounding to expect in what elements' torques on gimbal i owe to angle j, (n, n).

    Springs, friction and cages act on the diagonal alone and have none.
    """
    moments = tree.masses * _reach(tree) * (not tree.floating)
    for unbalance in platform.unbalances:
        moments[platform.body(unbalance.body)] += np.linalg.norm(unbalance.moment)
    out = specific_force * _carried_by_both(tree, moments)
    for device in platform.erections:
        out[platform.gimbal(device.gimbal)] += _ROUNDING * abs(device.gain) * tree.on_path[platform.body(device.senses)]
    return out


def _carried_by_both(tree: Topology, size: FloatArray) -> FloatArray:
    on_path = tree.on_path.astype(np.float64)
    return np.asarray(_ROUNDING * np.einsum("bi,bj,b->ij", on_path, on_path, size))
