"""Loops that read angles and rates, of either side of a drive: published values, closed forms, plants lifted."""

import json
import math
import tomllib
from pathlib import Path

import numpy as np
import pytest
from scipy.linalg import expm

import platform_ctrl as pc
from cli.test_cli import leave_out_figures
from given_controllers import outcomes, verdict
from one_axis import one_axis
from platform_ctrl import design
from platform_ctrl.cli import main
from platform_ctrl.errors import DesignError
from platform_ctrl.verification import check_job

DATA = Path(__file__).parents[1] / "data" / "state_feedback"
JOB = tomllib.loads((DATA / "job.toml").read_text(encoding="utf-8"))
J, VISCOUS, LAG, T = 0.039, 0.3, 0.002, 0.001
STATE_SPACE = {"method": "structured", "structure": "state-space", "order": 3, "evaluations": 1500}


def with_design(method, **changes):
    """Return the job of the yaw axis with a design of its own."""
    loop = JOB["loop"][0] | {"use": "own", "design": [{"name": "own", "method": method}]} | changes
    return JOB | {"loop": [loop], "manoeuvre": []}


def lifted(A, B, C, lag=0.0, queue=1):
    """Return the plant sampled with a lag of its torque, held for T, and `queue` periods of delay; by hand."""
    n = len(A)
    if lag:
        A = np.block([[A, B], [np.zeros((1, n)), np.array([[-1.0 / lag]])]])
        B, C, n = np.eye(n + 1)[:, n:] / lag, np.hstack([C, np.zeros((len(C), 1))]), n + 1
    held = expm(T * np.block([[A, B], [np.zeros((1, n + 1))]]))
    Ad = np.zeros((n + queue, n + queue))
    Ad[:n, : n + 1], Ad[n:-1, n + 1 :] = held[:n], np.eye(queue - 1)
    return Ad, np.eye(n + queue)[:, -1:], np.hstack([C, np.zeros((len(C), queue))])


def closed(plant, K):
    """Return the closed loop's matrices from noise of the readings and torques to torques and readings."""
    A, B, C = plant
    a, b, c, d = K
    A = np.block([[A + B @ d @ C, B @ c], [b @ C, a]])
    into = np.block([[B @ d, B], [b, np.zeros((len(a), 1))]])
    return A, into, np.block([[d @ C, c], [C, np.zeros((len(C), len(a)))]])


def margins(plant, K):
    """Return 1/max|S - 1/2| of the loop broken at each reading, then at the torque, the others closed."""
    A, B, C = plant
    a, b, c, d = K
    out = []
    for w in np.geomspace(0.1, np.pi / T, 5000):
        z = np.exp(1j * w * T)
        P = C @ np.linalg.solve(z * np.eye(len(A)) - A, B)
        L = d + c @ np.linalg.solve(z * np.eye(len(a)) - a, b)
        S = np.linalg.inv(np.eye(len(C)) - P @ L)
        out.append(np.abs([*np.diag(S) - 0.5, 1.0 / (1.0 - (L @ P)[0, 0]) - 0.5]))
    return 1.0 / np.max(out, axis=0)


def of(K):
    return tuple(np.asarray(getattr(K, name)) for name in "ABCD")


@pytest.mark.parametrize(
    ("share", "radii"),
    [
        (0.75, (0.997822087, 0.997822104, 1.005935140)),
        (1.0, (0.997822269, 0.997822285, 0.997982761)),
        (1.25, (0.997822451, 0.997822466, 0.997822484)),
    ],
)
def test_an_lqr_with_extended_state_observer_has_its_published_poles_at_every_delay(share, radii):
    plant = JOB["plant"] | {"gimbal": [JOB["plant"]["gimbal"][0] | {"inertia": [share * J] * 3}]}
    given = json.loads((DATA / "controllers.json").read_text(encoding="utf-8"))
    for delay, radius in zip((0.001, 0.005, 0.01), radii, strict=True):
        sampling = JOB["sampling"] | {"delay": delay}
        job = pc.read_job(JOB | {"plant": plant, "sampling": sampling, "manoeuvre": []})
        result = verdict(job, given | {"controllers": [given["controllers"][0] | {"delay": delay}]})
        assert np.abs(result.coupled.poles).max() == pytest.approx(radius, abs=1e-9)
        decay = next(one for one in result.requirements if one.stage == "coupled" and "decay" in one.name)
        assert decay.value == pytest.approx(-math.log(radius) / T, abs=1e-6)
        assert decay.passed == (radius < 1.0)


def test_check_takes_such_a_controller_from_a_file_and_runs_it(tmp_path, monkeypatch, capsys):
    leave_out_figures(monkeypatch)
    command = ["check", str(DATA / "job.toml"), "--controllers", str(DATA / "controllers.json")]
    assert main([*command, "-o", str(tmp_path), "-q", "--json"]) == 0
    found = {one["name"]: one for one in json.loads(capsys.readouterr().out)["requirements"]}
    assert found["largest error behind a commanded angle"]["stage"] == "simulated"


DRIVE = one_axis(
    [0.05, 0.05, 0.05],
    torquer=[{"gimbal": "g"}],
    pickoff=[{"gimbal": "g"}],
    angle_sensor=[{"name": "encoder", "gimbal": "g_motor"}],
    rate_sensor=[{"name": "motor", "gimbal": "g_motor"}],
    compliance=[{"gimbal": "g", "stiffness": 300.0, "damping": 0.04, "inertia": 0.02}],
)


def test_a_cascade_of_the_encoders_on_both_sides_of_a_drive_is_that_of_two_inertias_on_a_shaft():
    """u = −Kd (rate of the motor's side + Kp angle of the load)."""
    J1, J2, k, c, Kd, Kp = 0.02, 0.05, 300.0, 0.04, 1.5, 8.0
    loop = {"gimbals": ["g_motor"], "sensors": ["motor", "q"]}
    job = pc.read_job(with_design("lqg", **loop) | {"plant": DRIVE})
    given = {"name": "yaw", "dt": T, "delay": T, "inputs": ["motor", "q"], "outputs": ["Qg"]}
    given |= {"A": [], "B": [], "C": [[]], "D": [[-Kd, -Kd * Kp]]}
    [outcome] = outcomes(job, {"schema": 1, "controllers": [given]})
    A = np.array([[0, 1, 0, 0], [-k / J2, -c / J2, k / J2, c / J2], [0, 0, 0, 1], [k / J1, c / J1, -k / J1, -c / J1]])
    own = lifted(A, np.array([[0], [0], [0], [1 / J1]]), np.array([[0.0, 0, 0, 1], [1, 0, 0, 0]]))
    K = np.zeros((0, 0)), np.zeros((0, 2)), np.zeros((1, 0)), np.array([[-Kd, -Kd * Kp]])
    coupled = check_job(job, [outcome]).coupled
    np.testing.assert_allclose(
        np.sort(np.abs(coupled.poles)), np.sort(np.abs(np.linalg.eigvals(closed(own, K)[0]))), atol=1e-9
    )
    motor, load, torque = margins(own, K)
    assert coupled.coupled[0] == pytest.approx(torque, rel=1e-4)
    assert outcome.closed.measures.disk_margin[0] == pytest.approx(min(motor, load, torque), rel=1e-4)
    # The load is kept, so a step is one of its angle, which the shaft turns behind the motor.
    assert outcome.closed.plants.angles == ("q", "motor")
    assert outcome.closed.plants.kept == 1


def test_a_command_of_the_load_is_one_of_the_other_encoder_and_not_of_rates():
    run = {"name": "step", "mode": "caged", "duration": 3.0, "settle": 2.5}
    run |= {"command": [{"reading": "q", "at": 0.1, "step": 0.01}], "limits": {"angle_following_error": 1e-5}}
    loop = {"gimbals": ["g_motor"], "sensors": ["q", "motor", "encoder"], "limits": {"steady_error": 1e-9}}
    job = pc.read_job(with_design("lqg", **loop) | {"plant": DRIVE, "manoeuvre": [run]})
    made = design.loops(job)
    assert made[0].closed.controller.input_labels == ["q", "motor", "encoder", "q_command"]
    np.testing.assert_allclose(made[0].closed.plants.commanded, [[1.0], [0.0], [1.0]], atol=1e-9)
    result = check_job(job, made)
    assert result.passed
    assert {one.stage for one in result.requirements} == {"decoupled", "coupled", "simulated"}


def test_an_lqg_loop_reads_both_and_its_verdict_follows_from_plant_and_controller_by_hand():
    limits = {"disk_margin": 0.4, "torque_noise": 0.1, "damping": 0.3, "sensitivity_peak": 2.1}
    found = design.loops(pc.read_job(with_design("lqg", limits=limits)))[0].closed
    assert found.controller.input_labels == ["angle", "rate"]
    A = np.array([[0.0, 1.0], [0.0, -VISCOUS / J]])
    own, K = lifted(A, np.array([[0.0], [1.0 / J]]), np.eye(2), lag=LAG), of(found.controller)
    Acl, into, out = closed(own, K)
    np.testing.assert_allclose(
        np.sort(np.abs(found.measures.poles[0])), np.sort(np.abs(np.linalg.eigvals(Acl))), atol=1e-8
    )
    assert found.measures.disk_margin[0] == pytest.approx(margins(own, K).min(), rel=1e-4)
    noise = np.array([7e-5, 0.01]) * math.sqrt(0.5)  # half of the density's 1000 Hz passes
    x, answers = into[:, :2] * noise, [K[3] * noise]
    for _ in range(5000):
        answers.append(out[:1] @ x)
        x = Acl @ x
    assert found.measures.torque_noise[0] == pytest.approx(np.linalg.norm(answers), rel=1e-6)
    assert all(one.passed for one in found.results)
    # With the rate beside the angle the same margin costs less torque noise.
    alone = design.loops(pc.read_job(with_design("lqg", sensors=["angle"])))[0].closed
    assert alone.measures.disk_margin[0] < found.measures.disk_margin[0]


@pytest.mark.parametrize("method", ["classical", "measured"])
def test_methods_that_work_axis_by_axis_refuse_angles_beside_rates(method):
    with pytest.raises(DesignError, match="yaw, own: the method works axis by axis on angles or on rates"):
        design.loops(pc.read_job(with_design(method)))


@pytest.mark.parametrize(
    "method",
    [
        {"method": "hinf"},
        {"method": "lmi", "backoff": 0.07},
        {"method": "structured"},
        pytest.param(STATE_SPACE, marks=pytest.mark.slow),
    ],
)
def test_other_designs_have_the_rate_beside_the_angle_too(method):
    limits = {"disk_margin": 0.62, "damping": 0.4}
    one = {"limits": limits, "soft": {"torque_rejection": 1e-3}, "design": [{"name": "own"} | method]}

    def designed(*sensors):
        return design.loops(pc.read_job(with_design("", **one, sensors=[*sensors])))[0].closed

    with_rate = designed("angle", "rate")
    assert with_rate.passed
    if method is STATE_SPACE:  # what the rate adds is less deviation behind a torque within the same limits
        assert with_rate.goals[0].value < 0.9 * designed("angle").goals[0].value
    A = np.array([[0.0, 1.0], [0.0, -VISCOUS / J]])
    own = lifted(A, np.array([[0.0], [1.0 / J]]), np.eye(2), lag=LAG)
    assert with_rate.measures.disk_margin[0] == pytest.approx(margins(own, of(with_rate.controller)).min(), rel=1e-4)
