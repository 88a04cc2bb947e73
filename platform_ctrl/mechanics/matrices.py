"""The matrices of the method: A, B, A* = A + BᵀA_R B (12), G_A (13), G_R (14), with exact derivatives in q."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike

from platform_ctrl.common.arguments import real_array
from platform_ctrl.common.values import FloatArray, value
from platform_ctrl.errors import MechanicsError
from platform_ctrl.mechanics.kinematics import Kinematics, cross_matrix, kinematics, topology
from platform_ctrl.plant.platform import Platform


@value
class MagnusMatrices:
    """The matrices of eq. (11) at a state: A* u̇ + (G_A + G_R + G_root) u = Q − Pᵀf with u = [Omega, q̇].

    Of a floating root A and A* are without PᵀP/m, and f, the specific force of its origin, is not there.

    Attributes
    ----------
    A : (3 + n, 3 + n)
        Mass matrix without the rotors' axial inertia, kg m².
    A_R : (m, m)
        diag(C), kg m².
    B : (m, 3 + n)
        Direction cosines between rotor axes and generalised velocities, eq. (3), dimensionless.
    A_star : (3 + n, 3 + n)
        A plus the axial inertia of the regulated rotors, eq. (12), kg m².
    L : (m,)
        Relative angular momenta (8); for free rotors the cyclic momenta p (4). N m s.
    G_A, G_R : (3 + n, 3 + n)
        Coriolis (13) and gyroscopic (14) matrix, N m s; the root columns count as rates of cyclic coordinates.
    G_root : (3 + n, 3 + n)
        −[∂T/∂Omega]× in the root block, N m s: the Boltzmann-Hamel term, because Omega is no derivative of coordinates.
    P : (3, 3 + n)
        P u is the linear momentum against the root's origin, kg m; P = [−[S]×, ∂S/∂q].
    S : (3,)
        First moment Σ m x of all bodies with a mass about the root's origin, kg m.

    References
    ----------
    K. Magnus, Ingenieur-Archiv 1976, eqs. (1) to (4), (8), (11) to (14).

    See docs/theory/the-paper.md.
    """

    A: FloatArray
    A_R: FloatArray
    B: FloatArray
    A_star: FloatArray
    L: FloatArray
    G_A: FloatArray
    G_R: FloatArray
    G_root: FloatArray
    P: FloatArray
    S: FloatArray


@value
class Derivatives:
    """First derivatives in q at given angles."""

    A_star: FloatArray  # (n, 3 + n, 3 + n): ∂A*/∂q_j
    B: FloatArray  # (n, m, 3 + n): ∂B/∂q_j
    P: FloatArray  # (n, 3, 3 + n): ∂P/∂q_j


def body_inertias(at: Kinematics) -> FloatArray:
    """Return the bodies' inertias in root axes without C, (1 + n, 3, 3)."""
    return np.asarray(at.rotations @ at.tree.inertias @ at.rotations.transpose(0, 2, 1))


def world_inertias(at: Kinematics) -> FloatArray:
    """Return the bodies' inertias in root axes, C of regulated rotors included, (1 + n, 3, 3)."""
    tree, inertias = at.tree, body_inertias(at)
    for rotor in np.flatnonzero(tree.regulated):
        axis = at.spin_axes[rotor]
        inertias[tree.carriers[rotor]] += tree.C[rotor] * np.outer(axis, axis)
    return inertias


def mass_matrix(at: Kinematics, inertias: FloatArray) -> FloatArray:
    """Return Σ (Wᵀ I W + m Vᵀ V) over the bodies and Σ J bᵀ b over geared rotors, (3 + n, 3 + n).

    A floating root's translation is a cyclic coordinate, eliminated as in (5): − PᵀP/m.
    """
    tree, W, V = at.tree, at.jacobians, at.velocities
    out: FloatArray = np.einsum("bij,bik->jk", W, inertias @ W)
    out += np.einsum("bij,bik->jk", V, tree.masses[:, None, None] * V)
    out += at.gears.T @ (tree.gear_inertias[:, None] * at.gears)
    if tree.floating:
        out -= at.momentum.T @ at.momentum / tree.mass
    return 0.5 * (out + out.T)


def directions(at: Kinematics) -> FloatArray:
    """Return B (3), (m, 3 + n)."""
    out: FloatArray = np.einsum("ri,rij->rj", at.spin_axes, at.jacobians[at.tree.carriers])
    return out


def derivatives(at: Kinematics) -> Derivatives:
    """Return ∂A*/∂q, ∂B/∂q and ∂P/∂q, exact: each axis and each arm turns with the gimbals above it."""
    tree, inertias = at.tree, world_inertias(at)
    n = len(tree.parents)
    cross = cross_matrix(at.axes)
    # Column i of every Jacobian turns with gimbal j if j carries gimbal i.
    turned_axes = np.einsum("jab,ib->jai", cross, at.axes) * tree.above[:, None, :]
    d_jacobians = np.zeros((n, 1 + n, 3, 3 + n))
    d_jacobians[..., 3:] = turned_axes[:, None] * tree.on_path[None, :, None, :]
    product = np.einsum("jab,kbc->jkac", cross, inertias)
    d_inertias = (product + product.transpose(0, 1, 3, 2)) * tree.on_path.T[:, :, None, None]
    half = np.tensordot(d_jacobians, inertias @ at.jacobians, ((1, 2), (0, 1)))
    whole = np.tensordot(d_inertias @ at.jacobians, at.jacobians, ((1, 2), (0, 1))).transpose(0, 2, 1)
    d_velocities = np.empty((n, 1 + n, 3, 3 + n))
    d_velocities[..., :3] = -cross_matrix(at.velocities[:, :, 3:].transpose(2, 0, 1))  # ∂x_b/∂q_j × Omega
    d_velocities[..., 3:] = at.centre_curvature().transpose(0, 2, 3, 1)
    half += np.tensordot(d_velocities, tree.masses[:, None, None] * at.velocities, ((1, 2), (0, 1)))
    behind = 1 + tree.parents[tree.geared]
    d_gears = np.einsum("jag,gax->jgx", turned_axes[:, :, tree.geared], at.jacobians[behind])
    d_gears += np.einsum("ga,jgax->jgx", at.axes[tree.geared], d_jacobians[:, behind])
    half += np.einsum("jgx,g,gy->jxy", d_gears, tree.gear_inertias, at.gears)
    d_P = np.einsum("k,jkax->jax", tree.masses, d_velocities)
    if tree.floating:
        half -= np.einsum("jax,ay->jxy", d_P, at.momentum) / tree.mass
    d_spin = np.einsum("jab,rb->jra", cross, at.spin_axes) * tree.on_path[tree.carriers].T[:, :, None]
    d_B = np.einsum("jra,rax->jrx", d_spin, at.jacobians[tree.carriers])
    d_B += np.einsum("ra,jrax->jrx", at.spin_axes, d_jacobians[:, tree.carriers])
    return Derivatives(A_star=half + half.transpose(0, 2, 1) + whole, B=d_B, P=d_P)


def matrices(platform: Platform, q: ArrayLike | None = None, velocity: ArrayLike | None = None) -> MagnusMatrices:
    """Return the matrices of the method at a state.

    Parameters
    ----------
    platform
        The platform.
    q : (n,)
        Gimbal angles in the file's order, rad; default zero.
    velocity : (3 + n,)
        [Omega, q̇], rad/s; default zero. Only G_A and G_root depend on it.

    Returns
    -------
    MagnusMatrices
        All matrices at that state.

    References
    ----------
    K. Magnus, Ingenieur-Archiv 1976, eqs. (3), (11) to (14).

    See docs/theory/mechanics.md.

    Examples
    --------
    >>> import platform_ctrl as pc
    >>> m = pc.matrices(pc.read_platform("three_gyro_platform"))
    >>> m.L.round(3)
    array([0.15, 0.15, 0.15])
    """
    tree = topology(platform)
    n = len(tree.parents)
    u = real_array("velocity", velocity, (3 + n,), 0.0)
    at = kinematics(platform, real_array("q", q, (n,), 0.0))
    C, L, regulated = tree.C, tree.L, tree.regulated
    A = mass_matrix(at, body_inertias(at))
    B = directions(at)  # (3)
    A_star = A + B.T @ np.diag(C * regulated) @ B  # (12)
    change = derivatives(at)
    momentum_slope, spin_slope = np.zeros((3 + n, 3 + n)), np.zeros((3 + n, 3 + n))
    momentum_slope[:, 3:] = (change.A_star @ u).T  # ∂(A* u)/∂q
    spin_slope[:, 3:] = np.einsum("jrx,r->xj", change.B, L)  # ∂(Bᵀ L)/∂q
    G_root = np.zeros((3 + n, 3 + n))
    G_root[:3, :3] = -cross_matrix((A_star @ u + B.T @ L)[:3])
    return MagnusMatrices(
        A=A,
        A_R=np.diag(C),
        B=B,
        A_star=A_star,
        L=L,
        G_A=momentum_slope - 0.5 * momentum_slope.T,  # (13)
        G_R=spin_slope - spin_slope.T,  # (14)
        G_root=G_root,
        P=at.momentum,
        S=at.moment,
    )


# A mass matrix whose unit-diagonal form is worse conditioned than this leaves no correct digits in u̇.
_SINGULAR = 1e-13


def solved_inertia(mass: FloatArray, momenta: FloatArray, names: Sequence[str]) -> FloatArray:
    """Return M⁻¹ times a vector or the columns of a matrix (k, ...).

    `mass` is A*, or the part of it that belongs to the coordinates `names`, which the message mentions.
    """
    diagonal = np.diag(mass)
    if np.any(diagonal <= 0.0):
        still = names[int(np.argmin(diagonal))]
        raise MechanicsError(f"A* is singular: {still} moves no inertia; give its body some, or what it carries")
    scale = 1.0 / np.sqrt(diagonal)
    unit = scale[:, None] * mass * scale
    values, vectors = np.linalg.eigh(unit)
    if values.size and values[0] < _SINGULAR * values[-1]:
        # What moves in the null direction, by its share of the scaled motion.
        joint = [name for name, part in zip(names, np.abs(vectors[:, 0]), strict=True) if part > 0.3]
        words = f"A* is singular at these angles: {', '.join(joint)} can move without moving any inertia (gimbal lock)"
        raise MechanicsError(f"{words}; choose other angles, or add inertia about that axis")
    # Elimination keeps more digits of rows of very different size than the eigenvectors do.
    return np.asarray((scale * np.linalg.solve(unit, (scale * momenta.T).T).T).T)


def inverse_inertia(mass: FloatArray, names: Sequence[str]) -> FloatArray:
    """Return M⁻¹, symmetric."""
    inverse = solved_inertia(mass, np.eye(len(mass)), names)
    return np.asarray(0.5 * (inverse + inverse.T))
