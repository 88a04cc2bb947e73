"""Readings in joint axes: the Jacobian against MuJoCo's, the secant of two axes, the limit near the keyhole."""

from __future__ import annotations

import mujoco
import numpy as np
import pytest

from driven_gimbal import resolved_job
from platform_ctrl import read_job
from platform_ctrl.job.resolve import Resolver, resolver
from platform_ctrl.plant.reading import read_platform


def unit(rng: np.random.Generator) -> list[float]:
    axis = rng.normal(size=3)
    return (axis / np.linalg.norm(axis)).tolist()


@pytest.mark.parametrize("seed", range(4))
@pytest.mark.parametrize("order", [(0, 1, 2), (2, 0, 1), (3, 1)])
def test_the_jacobian_is_mujocos_for_axes_in_any_direction_and_order(seed: int, order: tuple[int, ...]) -> None:
    rng = np.random.default_rng(seed)
    axes, sensing = [unit(rng) for _ in range(4)], [unit(rng) for _ in order]
    bodies = [f"g{rng.integers(max(order), 4)}", *("g3" for _ in order[1:])]
    tree = ""
    for k in reversed(range(4)):
        joint = f'<joint type="hinge" axis="{" ".join(map(str, axes[k]))}"/><geom size=".1"/>'
        tree = f'<body name="g{k}">{joint}{tree}</body>'
    model = mujoco.MjModel.from_xml_string(f"<mujoco><worldbody>{tree}</worldbody></mujoco>")
    data = mujoco.MjData(model)
    q = data.qpos[:] = rng.uniform(-2.0, 2.0, 4)
    mujoco.mj_forward(model, data)
    expected = []
    for body, axis in zip(bodies, sensing, strict=True):
        rate = np.zeros((3, 4))
        mujoco.mj_jacBody(model, data, None, rate, model.body(body).id)
        expected.append(data.body(body).xmat.reshape(3, 3) @ axis @ rate)
    platform = read_platform(
        {
            "schema": 1,
            "name": "tree",
            "root": {"name": "base", "inertia": [1, 1, 1]},
            "gimbal": [
                {"name": f"g{k}", "parent": f"g{k - 1}" if k else "base", "axis": axes[k], "inertia": [1, 1, 1]}
                for k in range(4)
            ],
            "pickoff": [{"gimbal": f"g{k}"} for k in range(4)],
            "rate_sensor": [
                {"name": f"s{i}", "body": body, "axis": axis}
                for i, (body, axis) in enumerate(zip(bodies, sensing, strict=True))
            ],
        }
    )
    law = resolver(platform, [f"g{k}" for k in order], [f"s{i}" for i in range(len(order))], 1e6)
    np.testing.assert_allclose(np.linalg.inv(law.matrix(q)), np.array(expected)[:, order], rtol=0.0, atol=1e-9)


def two_axes() -> Resolver:
    (law,) = read_job(resolved_job()).resolvers
    return law


def test_of_two_axes_it_is_the_secant() -> None:
    law = two_axes()
    assert (law.names, law.encoders) == (("yaw_resolved_rate", "pitch_resolved_rate"), ("pitch",))
    for elevation in (-1.3, -0.5, 0.0, 1.0, 1.36):
        q = np.array([0.7, elevation])
        np.testing.assert_allclose(law.matrix(q), np.diag([1.0 / np.cos(elevation), 1.0]), rtol=1e-13)
        assert not law.limited(q)


def test_near_the_keyhole_the_gain_is_limited_and_changes_its_sign_at_it() -> None:
    law = two_axes()
    elevations = np.linspace(-np.pi, np.pi, 2001)
    gains = np.array([law.matrix(np.array([0.0, one])) for one in elevations])
    azimuth, elevation = gains[:, 0, 0], gains[:, 1, 1]
    assert 4.98 < np.abs(azimuth).max() <= 5.0
    assert np.abs(np.diff(azimuth)).max() < 0.2  # no jump
    assert np.all(azimuth * np.cos(elevations) >= 0.0)
    assert elevation.min() >= 0.96
    assert law.matrix(np.array([0.0, np.pi / 2]))[0, 0] == pytest.approx(0.0, abs=1e-9)
    assert law.limited(np.array([0.0, 1.4]))
