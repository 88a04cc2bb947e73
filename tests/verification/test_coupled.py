"""The coupled check: poles by python-control, a torquer that is too weak, loops without that of the platform."""

import dataclasses

import control
import numpy as np
import pytest

from platform_ctrl import design, linearise, read_job
from platform_ctrl.verification.coupled import coupled_check
from platform_ctrl.verification.coupled_plant import coupled_plant
from platform_ctrl.verification.simulated import simulate_manoeuvre


@pytest.fixture(scope="module")
def job():
    """The main job with its classical designs as they stand in the file."""
    job = read_job("examples/three_gyro_platform.toml")
    chosen = [next(d for d in spec.designs if d.method in ("classical", "platform-servo")) for spec in job.loops]
    loops = tuple(
        dataclasses.replace(spec, designs=(dataclasses.replace(one, tune=False),), use=one.name)
        for spec, one in zip(job.loops, chosen, strict=True)
    )
    return dataclasses.replace(job, loops=loops)


@pytest.fixture(scope="module")
def controllers(job):
    return [outcome.closed.controller for outcome in design.loops(job)]


def test_coupled_poles_are_python_controls(job, controllers):
    model = linearise(job.platform)
    found = coupled_check(job, model, controllers)
    loop = control.feedback(coupled_plant(job, model, controllers).system, found.controller, sign=1)
    ours, theirs = np.sort(np.abs(found.poles)), np.sort(np.abs(control.poles(loop)))
    np.testing.assert_allclose(ours[-6:], theirs[-6:], atol=1e-7)
    assert found.stable


def test_a_weak_torquer_loses_the_gyro_and_the_verdict_says_so(job, controllers):
    """0.05 N m holds 0.33 rad/s at most: at 1 rad/s the gimbal runs away, and no requirement hides it."""
    weak = dataclasses.replace(
        job.platform,
        torquers=tuple(dataclasses.replace(t, limit=0.05 if t.gimbal else t.limit) for t in job.platform.torquers),
    )
    job = dataclasses.replace(job, platform=weak)
    run = simulate_manoeuvre(job, job.manoeuvres[0], controllers)
    assert not any(r.passed for r in run.results)
    assert run.largest["torque_share"][0] > 1.0


def test_without_a_platform_loop_the_platform_is_carried(job, controllers):
    """Caging loops alone: Omega given, no coupling to pay for; one loop alone leaves the other gyros out."""
    model = linearise(job.platform)
    both = coupled_check(job, model, controllers[:2])
    assert both.stable
    assert both.plant.input_labels == ["Q4", "Q5", "Q7", "Q9", "Q10"]
    np.testing.assert_array_equal(both.cost, 0.0)
    lone = coupled_check(job, model, [controllers[1]])
    assert lone.stable
    assert lone.plant.output_labels == ["alpha9", "beta10"]
    np.testing.assert_allclose(lone.coupled, both.coupled[3:], rtol=1e-7)


@pytest.mark.parametrize("mode", ["floating", "pivot"])
def test_a_light_root_that_reacts_on_an_encoders_loop_is_a_cost_and_said_to_be_held(mode):
    """Between payload J and root J0 a torque shows 1 + J/J0 times: the margin is that of so much more gain, held."""
    J, J0 = 1.0, 0.5
    body = {"mass": 10.0, "centre": [0.0, 0.0, 0.0]}
    plant = {
        "schema": 1,
        "name": "bus",
        "root": {"name": "bus", "mode": mode, "inertia": [J0] * 3, **body},
        "gimbal": [{"name": "g", "angle": "angle", "parent": "bus", "axis": [0, 0, 1], "inertia": [J] * 3, **body}],
        "torquer": [{"gimbal": "g"}],
        "pickoff": [{"gimbal": "g"}],
    }
    loop = {"name": "antenna", "kind": "pointing", "gimbals": ["g"], "sensors": ["angle"], "use": "c"}
    data = {
        "schema": 2,
        "name": "antenna",
        "plant": plant,
        "operation": {"Omega": [0.0, 0.0, 0.0]},
        "sampling": {"rate_hz": 100, "delay": 0.0},
        "loop": [loop | {"design": [{"name": "c", "method": "classical", "crossover_hz": 4}]}],
        "coupled": {"coupling_cost": 0.1},
        "manoeuvre": [
            {
                "name": "turn",
                "mode": "caged",
                "duration": 0.3,
                "axis": 3,
                "rate": 0.1,
                "rise": 0.1,
                "hold": 0.1,
                "limits": {"angle": 1},
            }
        ],
    }
    job = read_job(data)
    [outcome] = design.loops(job)
    assert all("; held: bus" in one.evidence for one in outcome.closed.results)
    K = outcome.closed.controller
    found = coupled_check(job, linearise(job.platform), [K])
    margins = []
    for gain in (1.0, 1.0 + J / J0):
        P = control.ss([[1.0, 0.01], [0.0, 1.0]], [[5e-5], [0.01]], [[gain / J, 0.0]], 0.0, 0.01)
        margins.append(control.disk_margins(-control.ss(K.A, K.B, K.C, K.D, K.dt) * P, np.geomspace(0.1, 314.0, 20000)))
    (held, *_), (real, *_) = margins
    assert [found.decoupled[0], found.coupled[0]] == pytest.approx([held, real], rel=1e-3)
    [cost] = [one for one in found.results if one.name == "disk margin lost by coupling"]
    assert cost.value == pytest.approx(1.0 - real / held, rel=1e-3)
    assert not cost.passed
    assert "; the rate of bus is prescribed" in simulate_manoeuvre(job, job.manoeuvres[0], [K]).results[0].evidence
