"""The gimbal tree of the page: every body is drawn, turns about its own axis, and follows a run."""

from __future__ import annotations

import json
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from platform_ctrl.app.pictures import run_data, tree_data
from platform_ctrl.plant.reading import read_platform
from platform_ctrl.plant.source import shipped_models


@pytest.mark.parametrize("model", shipped_models())
def test_every_body_is_drawn_and_turns_about_its_own_axis(model: str) -> None:
    platform = read_platform(model)
    data = tree_data(platform)
    assert json.loads(json.dumps(data)) == data
    bodies = data["bodies"]
    assert len(bodies) == len(data["labels"]) == len(platform.gimbals) + len(platform.rotors)
    names = [platform.root_name, *platform.gimbal_names]
    for body, gimbal in zip(bodies, platform.gimbals, strict=False):
        assert names[body["parent"] + 1] == gimbal.parent
        np.testing.assert_allclose(body["axis"], gimbal.axis, atol=1e-4)
    for k, body in enumerate(bodies):
        # Arrows lie on the axis that the body turns about.
        (arrow,) = (one["points"] for one in data["shapes"] if one["body"] == k and one["kind"] in ("axis", "spin"))
        away = np.subtract(arrow, body["pivot"])
        assert np.abs(np.cross(away, body["axis"])).max() < 1e-3
    assert np.isfinite([point for one in data["shapes"] for point in one["points"]]).all()


def test_a_run_is_thinned_and_turns_from_its_first_attitude() -> None:
    t = np.linspace(0.0, 2.0, 1001)
    first = Rotation.from_euler("xyz", [0.3, -0.2, 0.1])
    attitude = np.roll((first * Rotation.from_rotvec(np.outer(t, [0.0, 0.5, 0.0]))).as_quat(), 1, axis=1)
    run: Any = SimpleNamespace(t=t, q=np.column_stack([np.sin(t), t]), attitude=attitude)
    data = run_data(run)
    shown = np.array(data["t"])
    assert len(shown) <= 400
    np.testing.assert_allclose(data["angles"], np.column_stack([np.sin(shown), shown]), atol=1e-8)
    np.testing.assert_allclose(data["turns"], np.outer(shown, [0.0, 0.5, 0.0]), atol=1e-8)
