"""Motors with winding and current loop: bandwidth, back-EMF, cogging, against closed form and MuJoCo's dcmotor."""

import control
import numpy as np
import pytest
from scipy.integrate import solve_ivp

import platform_ctrl as pc
from one_axis import job_of, loop_of, one_axis
from platform_ctrl import analysis, design, simulation
from platform_ctrl.verification import check_job

J, N, JM, K, R, L, SUPPLY = 0.02, 20.0, 1e-5, 0.05, 2.1, 1.2e-3, 48.0
LOOP = {"bandwidth_hz": 1500.0, "rate_hz": 20e3}


def drive(loop=LOOP, **motor):
    """A load, a geared motor, an encoder."""
    own = {"gimbal": "g", "gear": N, "rotor_inertia": JM, "torque_constant": K, "resistance": R, "inductance": L}
    motors = [own | {"supply": SUPPLY, "current_loop": loop} | motor]
    friction = [{"gimbal": "g", "viscous": 0.05}]
    return one_axis([J, J, J], {"mode": "held"}, pickoff=[{"gimbal": "g"}], friction=friction, motor=motors)


@pytest.mark.parametrize("rate_hz", [15e3, 20e3, 1e6])
def test_current_is_3_db_down_at_the_bandwidth_and_follows_the_sampled_loop(rate_hz):
    platform = pc.read_platform(drive(LOOP | {"rate_hz": rate_hz}, torque_constant=1e-9))
    system = pc.state_space(pc.linearise(platform), currents=True)
    w = 2 * np.pi * np.array([1.0, 200.0, 1500.0])
    [(_, winding)] = platform.windings
    shown = control.StateSpace(system.A, system.B[:, :1], [[0, 0, winding.per_ampere, 0, 0]], 0)
    found = analysis.frequency_response(shown, w)[0, 0]
    assert np.abs(found) == pytest.approx([1.0, np.abs(found[1]), np.sqrt(0.5)], rel=1e-4)
    # The loop as it is: PI that cancels the winding's pole, a sample of delay, z² − z + κ = 0.
    z, kappa = np.exp(1j * w / rate_hz), winding.proportional / L / rate_hz
    sampled = kappa / (z**2 - z + kappa)
    np.testing.assert_allclose(found[:2], sampled[:2], rtol=0.02)
    np.testing.assert_allclose(found[2], sampled[2], rtol=0.1)


def test_a_run_within_the_supply_is_that_of_the_exact_matrices():
    platform = pc.read_platform(drive())
    period, k = 1e-3, 5.0
    law = control.StateSpace([], [], [], [[-k]], period, inputs=["q"], outputs=["Qg"])
    at = simulation.Scenario(platform=platform, mode="caged", duration=0.3, delay=0.0, q=[0.1])
    run = simulation.simulate(at, [law], period=period, step=2.5e-5, noise=False)
    system = pc.state_space(pc.linearise(platform), currents=True)
    sampled = control.sample_system(system, period, method="zoh")
    x, expected = np.array([0.1, 0.0, 0.0, 0.0, 0.0]), []
    for _ in run.t:
        expected.append(x[[0, 2]] * [1.0, N * K])
        x = sampled.A @ x - sampled.B[:, 0] * k * x[0]
    np.testing.assert_allclose(np.c_[run.q, run.torque], expected, rtol=0, atol=2e-8)


def test_the_supply_ends_the_rate_at_its_back_emf():
    platform = pc.read_platform(drive())
    law = control.StateSpace([], [], [], [[-1e6]], 1e-3, inputs=["q"], outputs=["Qg"])
    at = simulation.Scenario(platform=platform, mode="caged", duration=2.0, delay=0.0, q=[-1e3])
    run = simulation.simulate(at, [law], period=1e-3, step=5e-5, noise=False)
    # N K (supply − N K rate)/R = 0.05 rate
    rate = N * K * SUPPLY / R / (0.05 + (N * K) ** 2 / R)
    assert run.rate[-1, 0] == pytest.approx(rate, rel=1e-4)
    assert run.torque[-1, 0] == pytest.approx(0.05 * rate, rel=1e-3)


def test_a_motor_turns_as_dcmotor_of_mujoco_with_bristles_and_cogging():
    mujoco = pytest.importorskip("mujoco", reason="MuJoCo (package mujoco) is not installed")
    from scipy.integrate import solve_ivp

    inertia, torque, rate, seconds = 1e-3, 0.02, 3.0, 10.0
    stiffness, damping, viscous, coulomb, breakaway, stribeck = 20.0, 0.05, 1e-3, 0.01, 0.015, 0.1
    # Without gains the loop leaves the winding shorted; a torque on the joint turns it, over the teeth.
    data = drive({"proportional": 1e-12, "integral": 0.0, "rate_hz": 1e4}, cogging=[[7.0, 0.004, 0.3]])
    data["motor"][0] |= {"gear": 1.0, "rotor_inertia": 0.0}
    data["gimbal"][0]["inertia"] = [inertia] * 3
    data["root"] = {"name": "base", "inertia": [1e9] * 3}
    bristles = {"bristle_stiffness": stiffness, "bristle_damping": damping, "viscous": viscous}
    data["friction"] = [
        bristles | {"gimbal": "g", "coulomb": coulomb, "breakaway": breakaway, "stribeck_rate": stribeck}
    ]
    out = simulation.rollout(
        pc.read_platform(data),
        [[0.0]],
        [[0, 0, 0, rate]],
        step=1e-4,
        steps=round(seconds / 1e-4),
        force=[[0, 0, 0, torque]],
    )
    # The activations' derivatives are those over a step of MuJoCo: a short one.
    model = mujoco.MjModel.from_xml_string(
        f"""<mujoco><option timestep="1e-9" gravity="0 0 0"/><worldbody><body><joint name="j" axis="0 0 1"/>
        <inertial pos="0 0 0" mass="1" diaginertia="{inertia} {inertia} {inertia}"/></body></worldbody>
        <actuator><dcmotor joint="j" motorconst="{K}" resistance="{R}" inductance="{L}" cogging="0.004 7 0.3"
        damping="{viscous}" lugre="{stiffness} {damping} {coulomb} {breakaway} {stribeck}"/></actuator></mujoco>"""
    )
    there = mujoco.MjData(model)
    there.qfrc_applied[0] = torque

    def slope(_: float, x: np.ndarray) -> list[float]:
        there.qpos[0], there.qvel[0], there.act[:] = x[0], x[1], x[2:]
        mujoco.mj_forward(model, there)
        return [x[1], there.qacc[0], *there.act_dot]

    begin = [0.0, rate, coulomb / stiffness, 0.0]
    whole = solve_ivp(slope, (0.0, seconds), begin, method="LSODA", rtol=1e-10, atol=1e-13)
    assert out.q[0, 0] == pytest.approx(whole.y[0, -1], abs=1e-6)
    assert out.q[0, 0] > 30.0


def test_a_job_with_a_winding_passes_and_says_what_current_its_motor_bears():
    loop = {"name": "L", "kind": "pointing", "gimbals": ["g"], "sensors": ["q"], "use": "d"}
    turn = {"name": "turn", "mode": "caged", "duration": 1.0, "axis": 3, "rate": 0.5, "rise": 0.2, "hold": 0.2}
    job = {
        "schema": 2,
        "name": "drive",
        "operation": {"Omega": [0.1, 0.1, 0.5]},
        "sampling": {"rate_hz": 2000, "delay": 1e-4},
        "loop": [loop | {"limits": {"disk_margin": 0.4}, "design": [{"name": "d", "method": "classical"}]}],
        "manoeuvre": [turn | {"limits": {"angle": 0.2}}],
    }
    found, lag = [], {"thermal_time": 0.2}
    for motor in ({"continuous_current": 1.0}, {"continuous_current": 1e-3}, {"continuous_current": 1.0} | lag):
        read = pc.read_job(job | {"plant": drive(**motor)})
        result = check_job(read, design.loops(read))
        [heat] = [one for one in result.requirements if one.name.startswith("rms current")]
        assert result.passed == heat.passed == (motor["continuous_current"] == 1.0)
        found.append(heat.value * motor["continuous_current"])
    squares, warm = (result.runs[0].trajectory.torque[:, 0] / (N * K)) ** 2, [0.0]
    for square in squares:
        warm.append(square + (warm[-1] - square) * np.exp(-1.0 / 2000 / 0.2))
    assert found == pytest.approx([*[np.sqrt(np.mean(squares))] * 2, np.sqrt(max(warm))])


def test_a_run_from_equilibrium_begins_with_the_heat_of_what_holds_it():
    """1 N m of weight takes 1 A for ever; in 0.3 s a cold motor of 40 s would show 0.09 A."""
    plant = drive(continuous_current=0.9, thermal_time=40.0) | {"unbalance": [{"body": "g", "moment": [0.1, 0.0, 0.0]}]}
    plant["root"] = plant["root"] | {"specific_force": [0.0, -10.0, 0.0]}
    design_ = {"name": "d", "method": "classical", "inertial_crossover_hz": 30.0, "integral_hz": 0.2}
    run = {"name": "m", "mode": "caged", "start": "equilibrium", "axis": 1, "rate": 1e-6, "rise": 0.1, "hold": 0.1}
    run |= {"duration": 0.3, "limits": {"angle": 0.2}}
    read = pc.read_job(job_of(plant, loop_of("g", "q", design=design_), rate_hz=1000.0, delay=2e-4, manoeuvre=[run]))
    [heat] = [one for one in check_job(read, design.loops(read)).requirements if one.name.startswith("rms current")]
    assert heat.value == pytest.approx(1.0 / 0.9, rel=1e-6)
    assert not heat.passed


def decay_and_run(plant, crossover_hz):
    """The coupled decay rate of a loop around a motor, and the last second of a run from a small angle."""
    own = {"name": "d", "method": "classical", "inertial_crossover_hz": crossover_hz, "integral_hz": 0.2}
    own |= {"inertial_lead_hz": crossover_hz / 3, "inertial_rolloff_hz": 10 * crossover_hz}
    job = pc.read_job(job_of(plant, loop_of("g", "q", design=own), rate_hz=1000.0, delay=2e-4, coupled={}))
    outcomes = design.loops(job)
    [found] = [one for one in check_job(job, outcomes).coupled.results if one.name == "minimum decay rate"]
    at = simulation.Scenario(platform=job.platform, mode="caged", duration=5.0, delay=2e-4, q=[1e-4])
    run = simulation.simulate(at, [outcomes[0].closed.controller], period=1e-3, step=2.5e-5, noise=False)
    return found, run.q[-1000:]


@pytest.mark.parametrize(("crossover_hz", "holds"), [(3.0, False), (30.0, True)])
def test_a_loop_that_is_weaker_than_cogging_does_not_pass(crossover_hz, holds):
    # 0.4 N m and 120 periods a turn at the joint: a spring of up to ± 48 N m/rad. A loop of 30 Hz has 600 N m/rad.
    found, q = decay_and_run(drive(cogging=[[6.0, 0.02, 0.0]]), crossover_hz)
    assert found.passed == holds
    assert holds or "cogging pushes away" in found.evidence
    assert (np.abs(q).max() < 1e-4) == holds


@pytest.mark.parametrize(("crossover_hz", "holds"), [(3.0, False), (30.0, True)])
def test_a_loop_that_is_weaker_than_ripple_under_load_does_not_pass(crossover_hz, holds):
    # 1 N m of weight, 5 % of it 720 times a turn at the joint: a spring of up to ± 36 N m/rad.
    plant = drive(ripple=[[36.0, 0.05, 0.0]]) | {"unbalance": [{"body": "g", "moment": [0.1, 0.0, 0.0]}]}
    plant["root"] = plant["root"] | {"specific_force": [0.0, -10.0, 0.0]}
    found, q = decay_and_run(plant, crossover_hz)
    assert found.passed == holds
    assert holds or "ripple under load pushes away" in found.evidence
    assert (np.ptp(q) < 1e-4) == holds


def test_ripple_is_a_share_of_what_the_current_does():
    rows = [[7.0, 0.2, 0.3], [14.0, 0.1, 0.0]]
    platform, period, k = pc.read_platform(drive(ripple=rows)), 1e-3, 5.0
    law = control.StateSpace([], [], [], [[-k]], period, inputs=["q"], outputs=["Qg"])
    at = simulation.Scenario(platform=platform, mode="caged", duration=0.06, delay=0.0, q=[0.1])
    run = simulation.simulate(at, [law], period=period, step=1e-5, noise=False)
    [(_, winding)] = platform.windings
    A, B = winding.matrices

    def moved(_, x, wanted):
        q, rate, *currents = x
        share = 1.0 + sum(r * np.sin(order * N * q + phase) for order, r, phase in rows)
        turning = (N * K * currents[0] * share - 0.05 * rate) / (J + N**2 * JM)
        return [rate, turning, *(A @ currents + B @ [wanted / (N * K), rate])]

    x, expected = np.array([0.1, 0.0, 0.0, 0.0, 0.0]), []
    for _ in run.t:
        expected.append(x[0])
        x = solve_ivp(moved, (0.0, period), x, args=(-k * x[0],), rtol=1e-10, atol=1e-13).y[:, -1]
    np.testing.assert_allclose(run.q[:, 0], expected, rtol=0, atol=1e-7)


def test_words_of_data_sheets_stand_for_values():
    data = drive(motor_constant=K / np.sqrt(R), peak_torque=10.0 * K, continuous_torque=3.0 * K)
    del data["motor"][0]["resistance"]
    [motor] = pc.read_platform(data).motors
    assert [motor.resistance, motor.current_limit, motor.continuous_current] == pytest.approx([R, 10.0, 3.0])
    data["motor"][0]["kv"] = 60.0 / (2.0 * np.pi * data["motor"][0].pop("torque_constant"))
    assert pc.read_platform(data).motors[0].resistance == pytest.approx(R)


def test_a_current_loop_that_is_not_stable_is_refused_with_words_of_data_sheets_too():
    gains = {"proportional": 100.0, "integral": 1e4, "rate_hz": 20e3}
    data = drive(loop=gains, motor_constant=K / np.sqrt(R), kv=60.0 / (2.0 * np.pi * K))
    for key in ("torque_constant", "resistance"):
        del data["motor"][0][key]
    with pytest.raises(pc.PlatformCtrlError, match="current_loop is not stable"):
        pc.read_platform(data)


def test_a_speed_constant_stands_for_the_torque_constant():
    data = drive(kv=60.0 / (2.0 * np.pi * K))
    del data["motor"][0]["torque_constant"]
    assert pc.read_platform(data).torquers[0].stall == pytest.approx(N * K * SUPPLY / R, rel=1e-12)
