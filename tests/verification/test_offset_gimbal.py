"""Jobs of a gimbal with offsets under gravity, root held and floating: the whole path to the verdicts."""

import json

import control
import numpy as np
import pytest
import tomlkit

from given_controllers import verdict
from platform_ctrl import linearise, read_job, state_space
from platform_ctrl.cli import main
from platform_ctrl.simulation import Scenario, simulate


def offset_job(mode):
    """Return the job of a gimbal with offsets as a dict."""
    gimbals = [
        {
            "name": "yaw",
            "parent": "airframe",
            "axis": [0, 0, 1],
            "origin": [0.05, 0, -0.04],
            "mass": 0.12,
            "centre": [-0.01, 0, -0.02],
            "inertia": [8e-5, 7e-5, 6e-5],
        },
        {
            "name": "pitch",
            "parent": "yaw",
            "axis": [0, 1, 0],
            "origin": [0.03, 0.03, -0.03],
            "mass": 0.2,
            "centre": [0.004, -0.03, 0.001],
            "inertia": [9e-5, 8e-5, 1e-4],
        },
    ]
    root = {"name": "airframe", "mode": mode, "mass": 1.5, "centre": [0, 0, 0.01], "inertia": [0.012, 0.013, 0.022]}
    plant = {
        "schema": 1,
        "name": "offset gimbal",
        "root": root | {"gravity": [0, 0, -9.81]},
        "gimbal": gimbals,
        "torquer": [{"gimbal": "yaw", "limit": 0.3}, {"gimbal": "pitch", "limit": 0.3}],
        "pickoff": [{"gimbal": "yaw"}, {"gimbal": "pitch"}],
        "friction": [{"gimbal": "yaw", "viscous": 1e-3}, {"gimbal": "pitch", "viscous": 1e-3}],
        "rotor": [
            {"name": "fan", "carrier": "pitch", "axis": [1, 0, 0], "axial_inertia": 2e-6, "transverse_inertia": 1.5e-6}
            | {"spin": 800.0, "mass": 0.01, "origin": [0, -0.03, 0]}
        ],
    }
    loop = {"name": "pointing", "kind": "caging", "gimbals": ["yaw", "pitch"], "use": "structured"}
    limits = {"bandwidth_hz": 15, "disk_margin": 0.5}
    turn = {"name": "turn", "mode": "caged", "axis": 1, "rate": 0.3, "rise": 0.3, "hold": 0.1, "duration": 0.8}
    return {
        "schema": 2,
        "name": "offsets",
        "plant": plant,
        "operation": {"Omega": [0.3, 0.3, 0.3]},
        "sampling": {"rate_hz": 2000.0, "delay": 3e-4},
        "loop": [loop | {"limits": limits, "design": [{"name": "structured", "method": "structured"}]}],
        "manoeuvre": [turn | {"start": "equilibrium", "limits": {"angle": 0.1}}],
    }


def job(mode):
    return read_job(offset_job(mode))


def loop_of(K):
    return control.StateSpace([], [], [], K, 5e-4, inputs=["q_yaw", "q_pitch"], outputs=["Qyaw", "Qpitch"])


def test_motors_hold_the_weight_at_the_start_and_a_run_stays_there():
    still = Scenario(platform=job("held").platform, mode="caged", start="equilibrium", duration=0.2, delay=0.0)
    run = simulate(still, [loop_of(np.zeros((2, 2)))], period=5e-4)
    assert run.completed
    assert np.abs(run.q).max() < 1e-9
    # Weight at 4 mm about the pitch axis; the yaw axis is vertical.
    np.testing.assert_allclose(run.torque[-1], [0.0, -0.2 * 9.81 * 0.004], atol=1e-12)


@pytest.mark.parametrize("mode", ["pivot", "floating"])
def test_a_free_root_has_its_own_poles_in_the_coupled_model_but_those_of_momenta_that_nothing_changes(mode):
    free = read_job({key: item for key, item in offset_job(mode).items() if key != "manoeuvre"})
    whole = state_space(linearise(free.platform), root="free")
    found = verdict(free, [loop_of(-np.eye(2))]).coupled
    poles, all_poles = np.linalg.eigvals(found.plant.A), np.exp(5e-4 * np.linalg.eigvals(whole.A))
    for pole in poles[np.abs(poles) > 1e-9]:
        assert np.abs(all_poles - pole).min() < 1e-5, pole


@pytest.mark.parametrize("mode", ["held", "floating"])
def test_a_gimbal_with_offsets_under_gravity_is_designed_checked_and_flown(mode, tmp_path, capsys):
    data = offset_job(mode)
    if mode == "floating":
        del data["plant"]["rotor"]  # its momentum would let the airframe nutate, undamped
    (tmp_path / "job.toml").write_text(tomlkit.dumps(data))
    assert main(["design", str(tmp_path / "job.toml"), "-o", str(tmp_path), "--json"]) == 0
    result = json.loads(capsys.readouterr().out)
    assert result["passed"]
    assert {one["stage"] for one in result["requirements"]} == {"decoupled", "coupled", "simulated"}
    kept = [one["evidence"] for one in result["requirements"] if "momentum" in one["evidence"]]
    assert bool(kept) == (mode == "floating")
