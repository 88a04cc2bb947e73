"""The tree of a platform as arrays, and where it is at angles q: rotations, axes, joints, mass centres, Jacobians."""

from __future__ import annotations

from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from platform_ctrl.common.arguments import instance
from platform_ctrl.common.values import FloatArray, value
from platform_ctrl.errors import ArgumentError
from platform_ctrl.plant.platform import Platform


@value
class Topology:
    """The tree of bodies as arrays (R. Featherstone, Rigid Body Dynamics Algorithms, 2008, ch. 4).

    Body 0 is the root, body k + 1 is the body of gimbal k.
    """

    order: tuple[int, ...]  # indices of the n gimbals, every parent before its children
    parents: NDArray[np.intp]  # (n,): index of the parent gimbal, −1 for the root
    # (1 + n, n) bool: ``on_path[b, j]``: gimbal j lies between the root and body b (b's own gimbal included)
    on_path: NDArray[np.bool_]
    above: NDArray[np.bool_]  # (n, n) bool: ``above[j, i]``: turning gimbal j turns the axis of gimbal i
    carriers: NDArray[np.intp]  # (m,): body that each of the m rotors spins in
    # axes, spin_axes: (n, 3), (m, 3): of gimbals in the parents' axes, of rotors in body axes; unit vectors
    axes: FloatArray
    # Bodies with their rotors, whose axial inertia C is left out, in body axes: (1 + n,) masses, kg; (1 + n, 3) centres
    # of mass from the body's joint, m; (1 + n, 3, 3) inertias about these, kg m² (mass 0: of the rotation alone).
    masses: FloatArray
    centres: FloatArray
    inertias: FloatArray
    joints: FloatArray  # (n, 3): from the parent's joint, in the parent's axes, m
    floating: bool  # whether the root is free to move, not only to turn
    spin_axes: FloatArray
    # C, L: (m,): axial inertias, kg m²; relative (regulated) or total axial (free) angular momenta, N m s
    C: FloatArray
    L: FloatArray
    # (m,) bool: whether the rotor's relative spin is regulated (a servo rotor counts as regulated)
    regulated: NDArray[np.bool_]
    # Geared rotors: (g,) gimbals that they turn, gears N, and inertias J about the joints' axes, kg m².
    geared: NDArray[np.intp]
    gears: FloatArray
    gear_inertias: FloatArray

    @property
    def mass(self) -> float:
        """M of all bodies, kg."""
        return float(self.masses.sum())


def topology(platform: Platform) -> Topology:
    """Return the tree of a platform as arrays, in the file's order of gimbals and rotors."""
    return _topology(instance("platform", platform, Platform))


@lru_cache(maxsize=8)  # a linearisation needs that of its platform ten times
def _topology(platform: Platform) -> Topology:
    parents, carriers = platform.parents, 1 + platform.carriers
    order = _parents_first(platform.name, parents)
    n, rotors = len(parents), platform.rotors
    on_path = np.zeros((1 + n, n), dtype=bool)
    for k in order:
        on_path[1 + k] = on_path[1 + parents[k]]
        on_path[1 + k, k] = True
    above = on_path[1:].T.copy()
    np.fill_diagonal(above, False)
    bodies = list(platform.bodies)
    for carrier, rotor in zip(carriers.tolist(), rotors, strict=True):
        bodies[carrier] |= rotor.body
    masses, centres, inertias = (np.array(one, dtype=np.float64) for one in zip(*bodies, strict=True))
    return Topology(
        order=order,
        parents=parents,
        on_path=on_path,
        above=above,
        carriers=carriers,
        axes=np.array([g.axis for g in platform.gimbals]).reshape(n, 3),
        masses=masses,
        centres=centres,
        inertias=inertias,
        joints=np.array([g.origin for g in platform.gimbals]).reshape(n, 3),
        floating=platform.mode == "floating",
        spin_axes=np.array([r.axis for r in rotors]).reshape(len(rotors), 3),
        C=np.array([r.axial_inertia for r in rotors], dtype=np.float64),
        L=np.array([r.angular_momentum for r in rotors], dtype=np.float64),
        regulated=np.array([r.control != "free" for r in rotors], dtype=bool),
        geared=np.array([platform.gimbal(one.gimbal) for one in platform.motors], dtype=np.intp),
        gears=np.array([one.gear for one in platform.motors], dtype=np.float64),
        gear_inertias=np.array([one.rotor_inertia for one in platform.motors], dtype=np.float64),
    )


def _parents_first(name: str, parents: NDArray[np.intp]) -> tuple[int, ...]:
    depths = np.zeros(len(parents), dtype=int)
    for _ in parents:
        depths = np.where(parents < 0, 0, 1 + depths[parents])
    if np.any(depths >= len(parents)):
        raise ArgumentError(f"platform {name!r}: the gimbals' parents must form a tree, they form a ring")
    return tuple(np.argsort(depths, kind="stable").tolist())


@value
class Kinematics:
    """Directions and places in root axes, from the root's origin, at given angles."""

    tree: Topology  # the tree that is turned
    rotations: FloatArray  # (1 + n, 3, 3): from body axes to root axes, dimensionless
    axes: FloatArray  # (n, 3): gimbal axes, unit vectors
    spin_axes: FloatArray  # (m, 3): rotor axes, unit vectors
    jacobians: FloatArray  # W, (1 + n, 3, 3 + n): body rates: ω_b = W_b @ [Omega, q̇]; dimensionless
    origins: FloatArray  # (1 + n, 3): of the bodies: the root's origin, then the joints r_k, m
    centres: FloatArray  # x, (1 + n, 3): centres of mass, m
    velocities: (
        FloatArray  # V, (1 + n, 3, 3 + n): of the centres of mass against the root's origin: V_b @ [Omega, q̇], m
    )
    gears: FloatArray  # b, (g, 3 + n): rates of geared rotors about their axes: b @ [Omega, q̇]; dimensionless

    @property
    def momentum(self) -> FloatArray:
        """P = Σ m V, (3, 3 + n), kg m: the momentum against the root's origin is P u; P = [−[S]×, ∂S/∂q]."""
        return np.asarray(np.einsum("b,bij->ij", self.tree.masses, self.velocities))

    @property
    def moment(self) -> FloatArray:
        """S = Σ m x, (3,), kg m."""
        return np.asarray(self.tree.masses @ self.centres)

    def centre_curvature(self) -> FloatArray:
        """Return ∂²x_b/∂q_j∂q_k, (n, n, 1 + n, 3), m: a_j × (a_k × (x_b − r_k)), j the gimbal nearer the root."""
        turned = np.einsum("jac,bck->jkba", cross_matrix(self.axes), self.velocities[:, :, 3:])
        inner = turned * self.tree.above[:, :, None, None]
        return np.asarray(inner + inner.swapaxes(0, 1) + turned * np.eye(len(self.axes))[:, :, None, None])


def cross_matrix(vector: FloatArray) -> FloatArray:
    """Return the matrices of ``vector ×``, (..., 3, 3)."""
    out = np.zeros((*vector.shape, 3))
    out[..., 0, 1], out[..., 0, 2], out[..., 1, 2] = -vector[..., 2], vector[..., 1], -vector[..., 0]
    out[..., 1, 0], out[..., 2, 0], out[..., 2, 1] = vector[..., 2], -vector[..., 1], vector[..., 0]
    return out


def kinematics(platform: Platform, q: FloatArray) -> Kinematics:
    """Return the directions of everything at gimbal angles q (n,), rad, in root axes."""
    tree = topology(platform)
    n = len(tree.parents)
    if q.shape != (n,):
        raise ArgumentError(f"kinematics: q must be ({n},), got {q.shape}")
    turned = cross_matrix(tree.axes)
    sine, cosine = np.sin(q)[:, None, None], np.cos(q)[:, None, None]
    own = np.eye(3) + sine * turned + (1.0 - cosine) * (turned @ turned)
    rotations = np.empty((1 + n, 3, 3))
    rotations[0] = np.eye(3)
    origins = np.zeros((1 + n, 3))
    for k in tree.order:
        above = 1 + tree.parents[k]
        rotations[1 + k] = rotations[above] @ own[k]
        origins[1 + k] = origins[above] + rotations[above] @ tree.joints[k]
    # An axis is fixed in the gimbal as well as in its parent.
    axes = np.einsum("kij,kj->ki", rotations[1:], tree.axes)
    jacobians = np.zeros((1 + n, 3, 3 + n))
    jacobians[:, :, :3] = np.eye(3)
    jacobians[:, :, 3:] = tree.on_path[:, None, :] * axes.T
    spin_axes = np.einsum("rij,rj->ri", rotations[tree.carriers], tree.spin_axes)
    centres = origins + np.einsum("bij,bj->bi", rotations, tree.centres)
    velocities = np.zeros((1 + n, 3, 3 + n))
    velocities[:, :, :3] = -cross_matrix(centres)
    arms = centres[:, None, :] - origins[1:]
    turned = np.einsum("kac,bkc->bak", cross_matrix(axes), arms)  # a_k × (x_b − r_k)
    velocities[:, :, 3:] = turned * tree.on_path[:, None, :]
    gears = np.einsum("ga,gax->gx", axes[tree.geared], jacobians[1 + tree.parents[tree.geared]])
    gears[np.arange(len(tree.gears)), 3 + tree.geared] += tree.gears
    return Kinematics(
        tree=tree,
        rotations=rotations,
        axes=axes,
        spin_axes=spin_axes,
        jacobians=jacobians,
        origins=origins,
        centres=centres,
        velocities=velocities,
        gears=gears,
    )
