"""Random plants as they are built against MuJoCo and Pinocchio, where every rotor is a body."""

import numpy as np
import pytest

from offset_oracles import Motion, Solver, by_bodies, by_mujoco, by_pinocchio
from offset_trees import MODES, offset_platform, turned
from platform_ctrl import forward_dynamics, inverse_dynamics, matrices

ORACLES = {"mujoco": by_mujoco, "pinocchio": by_pinocchio}
DAILY, ALL = 50, 1000


def differences(seed: int, solver: Solver) -> dict[str, float]:
    """Return the largest differences of a random motion, relative to the largest number of each kind."""
    rng = np.random.default_rng(10_000 + seed)
    platform = offset_platform(rng, MODES[seed % 3])
    n = len(platform.gimbals)
    q, u, change = rng.uniform(-np.pi, np.pi, n), rng.normal(size=3 + n), rng.normal(size=3 + n)
    f = rng.normal(size=3) * 9.81
    force, _, A = by_bodies(platform, Motion(q, u, change, f, turned(rng)), solver)
    m = matrices(platform, q, u)
    newton = inverse_dynamics(platform, q, u, change, specific_force=f)
    magnus = m.A_star @ change + (m.G_A + m.G_R + m.G_root) @ u + m.P.T @ f * (platform.mode != "floating")
    moved = forward_dynamics(platform, q, u, force, specific_force=f)
    still = forward_dynamics(platform, q, u, np.zeros(3 + n), specific_force=f)
    # What a floating root's elimination takes away counts as well.
    size = np.abs(force).max() + np.abs(m.A_star).max()
    return {
        "inverse dynamics": float(np.abs(newton - force).max() / size),
        "(11)": float(np.abs(magnus - force).max() / size),
        "A*": float(np.abs(m.A_star - A).max() / np.abs(A).max()),
        "forward dynamics": float(np.abs(moved - change).max() / (np.abs(change).max() + np.abs(still).max())),
    }


@pytest.mark.parametrize(
    "seeds",
    [range(DAILY), pytest.param(range(DAILY, ALL), marks=pytest.mark.slow)],
    ids=lambda seeds: f"{len(seeds)} trees",
)
@pytest.mark.parametrize("oracle", ORACLES)
def test_random_plants_move_as_the_oracle_says(oracle, seeds):
    pytest.importorskip(oracle, reason=f"{oracle} is not installed")
    for seed in seeds:
        for name, difference in differences(seed, ORACLES[oracle]).items():
            assert difference < 1e-9, (seed, name)
