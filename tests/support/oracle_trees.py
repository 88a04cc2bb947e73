"""Random trees with everything that is nasty."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from plant_parts import Friction, Gimbal, Rotor, Spring, Unbalance
from platform_ctrl import Platform

DEPTH = 6  # longest chain of gimbals
FASTEST = 2000.0  # fastest rotor, rad/s


@dataclass(frozen=True)
class Motion:
    """A platform in motion; `rng` for whatever else a statement needs."""

    platform: Platform
    q: np.ndarray
    velocity: np.ndarray
    acceleration: np.ndarray
    attitude: np.ndarray
    rng: np.random.Generator


def for_all(strategy: st.SearchStrategy[Any], examples: int) -> Callable[..., Any]:
    """Turn a statement about one drawn value into a test of so many examples."""
    effort = settings(max_examples=examples, deadline=None, suppress_health_check=list(HealthCheck))
    return lambda statement: effort(given(strategy)(statement))


def turn(axis: np.ndarray, angle: float) -> np.ndarray:
    """Return the rotation about a unit axis, (3, 3)."""
    matrix: np.ndarray = Rotation.from_rotvec(np.asarray(axis) * angle).as_matrix()
    return matrix


def rotation(quaternion: np.ndarray) -> np.ndarray:
    """Return the rotation of a quaternion w, x, y, z, (3, 3)."""
    matrix: np.ndarray = Rotation.from_quat(np.roll(quaternion, -1)).as_matrix()
    return matrix


@st.composite
def motions(draw, controls=("regulated", "free"), max_rotors=4, min_size=1e-6):
    """Draw a platform in motion.

    Chains to depth 6 and bushes of up to 8 gimbals, listed in any order. Axes: any, a coordinate axis, the parent's,
    its negative, nearly parallel to it, or the one that locks with the grandparent's at the parent's angle, to within
    1e-9 to 1e-2 rad. Inertias from `min_size` to 1 kg m² side by side, flat and rod-like bodies among them. Rotors on
    any body and about any axis, at rest or to 2000 rad/s, regulated or free.
    """
    rng = np.random.default_rng(draw(st.integers(0, 2**32 - 1)))
    n = draw(st.integers(1, 8))
    shape = draw(st.sampled_from(["chain", "bush", "any"]))
    parents, depths = [], []
    for k in range(n):
        able = [j for j in range(k) if depths[j] < DEPTH]
        if shape == "chain" and able:
            parent = max(able, key=lambda j: depths[j])
        elif shape == "bush":
            parent = draw(st.integers(-1, min(k - 1, 1)))
        else:
            parent = draw(st.sampled_from([-1, *able]))
        parents.append(parent)
        depths.append(1 + (depths[parent] if parent >= 0 else 0))
    q = rng.uniform(-np.pi, np.pi, n)
    q[[draw(st.integers(0, 3)) == 0 for _ in range(n)]] = 0.0
    axes: list[np.ndarray] = []
    for parent in parents:
        kinds = ["any", "coordinate"]
        if parent >= 0:
            kinds += ["parallel", "antiparallel", "nearly parallel"]
            kinds += ["lock"] * 2 * (parents[parent] >= 0)
        kind = draw(st.sampled_from(kinds))
        sign = 1.0 if draw(st.booleans()) else -1.0
        if kind == "any":
            axis = _unit(rng)
        elif kind == "coordinate":
            axis = sign * np.eye(3)[draw(st.integers(0, 2))]
        elif kind == "lock":
            away = sign * 10 ** rng.uniform(-9, -2)
            axis = sign * turn(axes[parent], q[parent] + away).T @ axes[parents[parent]]
        else:
            axis = {"parallel": 1.0, "antiparallel": -1.0, "nearly parallel": sign}[kind] * axes[parent]
            if kind == "nearly parallel":
                axis = axis + 10 ** rng.uniform(-9, -2) * _unit(rng)
        axes.append(axis / np.linalg.norm(axis))
    names = ["root", *(f"g{k}" for k in range(n))]

    def size() -> float:
        # The ends are the hard cases.
        low = np.log10(min_size)
        return float(10 ** draw(st.sampled_from([0.0, low, rng.uniform(low, 0.0)])))

    gimbals = [
        Gimbal(
            name=names[1 + k], parent=names[1 + parents[k]], axis=axes[k], inertia=_inertia(rng, size()), angle=f"q{k}"
        )
        for k in range(n)
    ]
    rotors = []
    for k in range(draw(st.integers(0, max_rotors))):
        carrier = draw(st.integers(-1, n - 1))
        kind = draw(st.sampled_from(["any", "coordinate", "own axis"]))
        if kind == "own axis" and carrier >= 0:
            axis = axes[carrier] * rng.choice([-1.0, 1.0])
        else:
            axis = _unit(rng) if kind == "any" else np.eye(3)[draw(st.integers(0, 2))]
        axial = 0.3 * size()
        spin = draw(st.sampled_from([0.0, FASTEST, -FASTEST, rng.uniform(-FASTEST, FASTEST), rng.normal()]))
        rotors.append(
            Rotor(
                name=f"r{k}",
                carrier=names[1 + carrier],
                axis=axis,
                axial_inertia=axial,
                transverse_inertia=float(axial * rng.uniform(0.5, 2.0)),
                angular_momentum=axial * spin,
                control=draw(st.sampled_from(controls)),
            )
        )
    order = rng.permutation(n)
    platform = Platform(
        name="random tree",
        root_name="root",
        root_inertia=_inertia(rng, size()),
        gimbals=tuple(gimbals[k] for k in order),
        rotors=tuple(rotors),
    )
    quick, hard = 10 ** rng.uniform(-3, 1, 2)
    return Motion(
        platform=platform,
        q=q[order],
        velocity=quick * rng.normal(size=3 + n),
        acceleration=hard * rng.normal(size=3 + n),
        attitude=_unit(rng, 4),
        rng=rng,
    )


def _unit(rng: np.random.Generator, size: int = 3) -> np.ndarray:
    vector = rng.normal(size=size)
    return vector / np.linalg.norm(vector)


def _inertia(rng: np.random.Generator, size: float) -> np.ndarray:
    # Principal moments from positive second moments keep the triangle inequality.
    spread = 10 ** rng.uniform(-rng.choice([0.3, 3.0]), 0, 3)
    basis, _ = np.linalg.qr(rng.normal(size=(3, 3)))
    inertia = basis @ np.diag(spread.sum() - spread) @ basis.T * size
    return 0.5 * (inertia + inertia.T)


def unbalanced(motion: Motion) -> tuple[Platform, np.ndarray, np.ndarray, np.ndarray]:
    """Move the centres of mass: what leaves the bodies' inertia about the fixed point as it is."""
    platform, rng = motion.platform, motion.rng
    inertias = [platform.root_inertia, *(g.inertia for g in platform.gimbals)]
    offsets = rng.normal(size=(len(inertias), 3)) * 10 ** rng.uniform(-2, -1)
    # About the centre of mass there has to be a body left: m r² takes a quarter of the smallest second moment.
    least = np.array([0.5 * np.trace(inertia) - np.linalg.eigvalsh(inertia)[-1] for inertia in inertias])
    masses = 0.25 * least * rng.uniform(0.1, 1.0, len(least)) / np.sum(offsets**2, axis=1)
    gravity = rng.normal(size=3) * 9.81
    unbalances = tuple(
        Unbalance(body=name, moment=mass * offset)
        for name, mass, offset in zip((platform.root_name, *platform.gimbal_names), masses, offsets, strict=True)
    )
    return replace(platform, unbalances=unbalances), masses, offsets, gravity


def sprung(motion: Motion) -> Motion:
    """Give every gimbal a spring (some drive it away) and viscous friction, both slow beside the motion."""
    platform, rng = motion.platform, motion.rng
    bodies = np.array([np.linalg.eigvalsh(g.inertia)[0] for g in platform.gimbals])
    rate = np.linalg.norm(motion.velocity)
    springs = tuple(
        Spring(gimbal=name, stiffness=float(size * rate**2 * rng.normal()), rest=float(rng.normal()))
        for name, size in zip(platform.gimbal_names, bodies, strict=True)
    )
    frictions = tuple(
        Friction(gimbal=name, viscous=float(size * rate * rng.uniform()))
        for name, size in zip(platform.gimbal_names, bodies, strict=True)
    )
    return replace(motion, platform=replace(platform, springs=springs, frictions=frictions))
