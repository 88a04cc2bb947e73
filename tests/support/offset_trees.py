"""Random plants as they are built: masses, offsets, products of inertia, rotors and geared motors, three root modes."""

from __future__ import annotations

from typing import Any

import numpy as np

from platform_ctrl import Platform, read_platform

MODES = ("held", "pivot", "floating")


def direction(rng: np.random.Generator) -> np.ndarray:
    """Return a unit vector, now and then along an axis."""
    if rng.random() < 0.3:
        return np.asarray(np.eye(3)[rng.integers(3)] * rng.choice([-1.0, 1.0]))
    vector = rng.normal(size=3)
    return np.asarray(vector / np.linalg.norm(vector))


def body(rng: np.random.Generator, size: float) -> dict[str, Any]:
    """Return a body of point masses: `inertia` about its centre of mass, with products of inertia."""
    points, masses = size * rng.normal(size=(8, 3)), rng.uniform(0.05, 0.5, 8)
    centre = masses @ points / masses.sum()
    arms = points - centre
    squares = np.einsum("p,pi,pj->ij", masses, arms, arms)
    inertia = np.trace(squares) * np.eye(3) - squares
    return {"mass": masses.sum(), "centre": centre.tolist(), "inertia": (0.5 * (inertia + inertia.T)).tolist()}


def offset_plant(rng: np.random.Generator, mode: str | None = None, gimbals: int | None = None) -> dict[str, Any]:
    """Return a random plant file; the order of the gimbals is not always parents first."""
    n = int(rng.integers(1, 7)) if gimbals is None else gimbals
    mode = mode or str(rng.choice(MODES))
    tree = []
    for k in range(n):
        parent = "base" if k == 0 or rng.random() < 0.2 else f"g{rng.integers(k)}"
        own = {"name": f"g{k}", "parent": parent, "axis": direction(rng).tolist(), "origin": rng.uniform(-0.3, 0.3, 3)}
        tree.append(own | body(rng, 0.15))
    bodies = ["base", *(f"g{k}" for k in range(n))]
    rotors: list[dict[str, Any]] = []
    for k in range(int(rng.integers(0, 3))):
        C = 10 ** rng.uniform(-4, -2)
        rotors.append(
            {
                "name": f"r{k}",
                "carrier": str(rng.choice(bodies)),
                "axis": direction(rng).tolist(),
                "axial_inertia": C,
                "transverse_inertia": C * rng.uniform(0.55, 1.5),
                "spin": rng.uniform(-300, 300),
                "control": str(rng.choice(["regulated", "free"])),
            }
        )
        if rng.random() < 0.6:
            rotors[-1] |= {"mass": rng.uniform(0.1, 1.0), "origin": rng.uniform(-0.2, 0.2, 3).tolist()}
    root = {"name": "base", "mode": mode, "gravity": rng.normal(size=3) * 9.81} | body(rng, 0.3)
    inertias = {one["name"]: one["inertia"] for one in (root, *tree)}
    motors = []
    for k in range(n):
        if rng.random() < 0.4:
            # Its transverse inertia is part of the parent's.
            J = 10 ** rng.uniform(-3, -1.5) * np.linalg.eigvalsh(inertias[tree[k]["parent"]])[0]
            motors.append({"gimbal": f"g{k}", "gear": float(rng.choice([1.0, -3.5, 40.0])), "rotor_inertia": J})
    return {
        "schema": 1,
        "name": "as it is built",
        "root": root,
        "gimbal": [tree[k] for k in rng.permutation(n)],
        "rotor": rotors,
        "motor": motors,
    }


def offset_platform(rng: np.random.Generator, mode: str | None = None, gimbals: int | None = None) -> Platform:
    """Return `offset_plant` as read."""
    return read_platform(offset_plant(rng, mode, gimbals))


def turned(rng: np.random.Generator) -> np.ndarray:
    """Return a random attitude, w, x, y, z."""
    quaternion = rng.normal(size=4)
    return np.asarray(quaternion / np.linalg.norm(quaternion))
