"""The MuJoCo model of a gimbal whose payload has gyros, a tracker and a line of sight."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from platform_ctrl.export import import_robot, write_mjcf
from platform_ctrl.simulation import Scenario, simulate
from sighted_gimbal import sighted


def test_the_mujoco_model_says_where_its_readings_are_and_reads_back(tmp_path: Path) -> None:
    platform = sighted()
    notes = write_mjcf(platform, tmp_path / "m.xml")
    assert "rate sensor gyro2, gyro3: from the sensor pitch_Omega" in notes
    assert "attitude sensor tracker: from the sensor pitch_attitude" in notes
    assert "line of sight of pitch: from the sensors pitch_Omega and pitch_attitude" in notes
    pytest.importorskip("mujoco")
    back = import_robot(tmp_path / "m.xml").platform
    assert [one.name for one in back.angle_sensors] == ["encoder"]
    assert len(back.pickoffs) == len(platform.pickoffs)


def test_mujocos_gyro_on_the_payload_reads_its_inertial_rate(tmp_path: Path) -> None:
    mujoco = pytest.importorskip("mujoco")
    platform = sighted()
    write_mjcf(platform, tmp_path / "m.xml")
    model = mujoco.MjModel.from_xml_path(str(tmp_path / "m.xml"))
    data = mujoco.MjData(model)
    q, rate, Omega = np.array([0.3, -0.4]), np.array([0.8, -1.1]), np.array([0.3, -0.7, 0.5])
    data.qpos[4:], data.qvel[:3], data.qvel[3:] = q, Omega, rate
    mujoco.mj_forward(model, data)
    start = Scenario(
        platform=platform, mode="stabilised", duration=0.0, delay=0.0, q=q, rate=rate, Omega=Omega
    )  # fmt: skip
    run = simulate(start, [], period=1e-3)
    reading = dict(zip(run.pickoff_names, run.reading[0], strict=True))
    assert data.sensor("pitch_Omega").data[1] == pytest.approx(reading["gyro2"], abs=1e-12)
    np.testing.assert_allclose(
        platform.line_of_sight.across @ data.sensor("pitch_Omega").data, run.line_of_sight[0, :3], atol=1e-12
    )
