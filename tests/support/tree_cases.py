"""Trees of the reference file, and random trees, as Platform values."""

import dataclasses

import numpy as np
from hypothesis import strategies as st

from plant_parts import Cage, Erection, Friction, Gimbal, Rotor, Spring, Torquer, Unbalance
from platform_ctrl import Platform


def platform_of_case(tree):
    """Return the Platform of a tree in tests/data/dynamics-cases.json."""
    joints = tree["joints"]
    names = ["root"] + [joint["name"] for joint in joints]
    return Platform(
        name=tree["name"],
        root_name="root",
        root_inertia=np.array(tree["root_inertia"]),
        gimbals=tuple(
            Gimbal(
                name=joint["name"],
                parent=names[1 + joint["parent"]],
                axis=np.array(joint["axis"]) / np.linalg.norm(joint["axis"]),
                inertia=np.array(joint["inertia"]),
                angle="q_" + joint["name"],
            )
            for joint in joints
        ),
        rotors=tuple(
            Rotor(
                name=rotor["name"],
                carrier=names[1 + rotor["carrier"]],
                axis=np.array(rotor["axis"]) / np.linalg.norm(rotor["axis"]),
                axial_inertia=rotor["C"],
                transverse_inertia=rotor["A"],
                angular_momentum=rotor["C"] * rotor["rate"],
            )
            for rotor in tree["rotors"]
        ),
    )


@st.composite
def platforms(draw, max_gimbals=6, max_rotors=3, controls=("regulated", "free")):
    """Draw a platform: any tree, any axes, admissible inertias, rotors anywhere."""
    rng = np.random.default_rng(draw(st.integers(0, 2**32 - 1)))
    n = draw(st.integers(1, max_gimbals))
    parents = [draw(st.integers(-1, k - 1)) for k in range(n)]
    m = draw(st.integers(0, max_rotors))
    carriers = [draw(st.integers(-1, n - 1)) for _ in range(m)]
    kinds = [draw(st.sampled_from(controls)) for _ in range(m)]
    names = ["base"] + [f"g{k}" for k in range(n)]

    def unit():
        axis = rng.normal(size=3)
        return axis / np.linalg.norm(axis)

    def inertia(size):
        basis, _ = np.linalg.qr(rng.normal(size=(3, 3)))
        points = rng.uniform(0.2, 1.0, 3) * size
        # Principal moments from positive second moments keep the triangle inequality.
        return basis @ np.diag(points.sum() - points) @ basis.T

    gimbals = [
        Gimbal(name=names[1 + k], parent=names[1 + parents[k]], axis=unit(), inertia=inertia(0.5), angle=f"q{k}")
        for k in range(n)
    ]
    rotors = [
        Rotor(
            name=f"r{k}",
            carrier=names[1 + carriers[k]],
            axis=unit(),
            axial_inertia=0.3,
            transverse_inertia=0.2,
            angular_momentum=float(rng.normal() * 20),
            control=kinds[k],
        )
        for k in range(m)
    ]
    # The file may list gimbals in any order.
    shuffled = [gimbals[k] for k in rng.permutation(n)]
    return Platform(
        name="random tree", root_name="base", root_inertia=inertia(3.0), gimbals=tuple(shuffled), rotors=tuple(rotors)
    )


def with_torquers(platform):
    """Return the platform with a torquer on every gimbal."""
    torquers = tuple(Torquer(name=f"Q{g.name}", gimbal=g.name) for g in platform.gimbals)
    return dataclasses.replace(platform, torquers=torquers)


def state(platform, seed):
    """Return angles, velocity and acceleration of a platform, drawn at random."""
    rng = np.random.default_rng(seed)
    n = len(platform.gimbals)
    return rng.uniform(-3, 3, n), rng.normal(size=3 + n), rng.normal(size=3 + n)


def with_elements(platform, rng):
    """Return the platform with some of every force element, and specific force."""
    names = platform.gimbal_names
    return dataclasses.replace(
        platform,
        springs=(Spring(gimbal=names[0], stiffness=float(rng.normal()), rest=0.3),),
        frictions=(Friction(gimbal=names[-1], viscous=0.4),),
        cages=(Cage(gimbal=names[0], stiffness=2.0, damping=0.1, angle=-0.2),),
        unbalances=tuple(Unbalance(body=name, moment=rng.normal(size=3)) for name in (platform.root_name, names[-1])),
        erections=(Erection(gimbal=names[0], senses=names[-1], axis=np.array([0.6, 0.0, 0.8]), gain=0.7),),
        specific_force=rng.normal(size=3) * 3,
    )


def exact_slope(function, at, k):
    """Return the derivative in angle k, to rounding, of what is of second degree in its sine and cosine."""
    quarter, eighth = (
        (function(at + size * step) - function(at - size * step)) / 2
        for step in [np.eye(len(at))[k]]
        for size in (np.pi / 2, np.pi / 4)
    )
    return quarter + 2 * (eighth - quarter / np.sqrt(2))


def slope(function, at, step=1e-6):
    """Return the derivatives of a function of a vector by central differences, a column for each component."""
    columns = [(function(at + step * e) - function(at - step * e)) / (2 * step) for e in np.eye(len(at))]
    return np.stack(columns, axis=-1)
