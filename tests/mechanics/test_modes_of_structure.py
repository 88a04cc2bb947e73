"""Modes of the structure in linear models and runs, against closed forms: two inertias on a shaft, a shaken base."""

import control
import numpy as np
import pytest

import platform_ctrl as pc
from one_axis import one_axis
from platform_ctrl import analysis, simulation
from sensed import sensed

J1, J2, K, C = 0.02, 0.05, 300.0, 0.04
OMEGA = np.sqrt(K * (1 / J1 + 1 / J2))
ZETA = 0.5 * C / K * OMEGA
MOTOR, LOAD = np.sqrt(J2 / (J1 * (J1 + J2))), -np.sqrt(J1 / (J2 * (J1 + J2)))


def drive(**mode):
    """A motor and a load on a shaft as one rigid gimbal and its mode; encoders on both sides, a gyro on the load."""
    shapes = {"Q": MOTOR, "motor": MOTOR, "load": LOAD, "gyro": LOAD}
    return one_axis(
        [0.05, 0.05, J1 + J2],
        torquer=[{"gimbal": "g", "name": "Q"}],
        angle_sensor=[{"name": "motor", "gimbal": "g"}, {"name": "load", "gimbal": "g"}],
        rate_sensor=[{"name": "gyro", "body": "g", "axis": [0, 0, 1]}],
        mode=[{"name": "shaft", "frequency": OMEGA, "damping": ZETA, "participation": shapes} | mode],
    )


def locked(**mode):
    """The same drive by the mode of its load on the shaft with the joint locked at the motor."""
    own = {"interface": "fixed", "frequency": np.sqrt(K / J2), "damping": 0.5 * C / np.sqrt(K * J2)}
    shares = {"participation": {"load": J2**-0.5, "gyro": J2**-0.5}, "joints": {"g": J2**0.5}}
    return drive(**{**own, **shares, "base": [0.0, 0.0, J2**0.5], **mode})


def response(platform, outputs, inputs, w, **options):
    system = sensed(platform, outputs, **options)
    return analysis.frequency_response(system, w)[:, [system.input_labels.index(name) for name in inputs]]


def test_a_drive_with_two_inertias_is_its_rigid_body_and_a_mode():
    w = np.array([1.0, 30.0, 122.0, OMEGA, 1000.0])
    s = 1j * w
    shaft = C * s + K
    whole = J1 * J2 * s**4 + (J1 + J2) * shaft * s**2
    found = response(pc.read_platform(drive()), ["motor", "load", "gyro"], ["Q"], w)[:, 0]
    np.testing.assert_allclose(found[0], (J2 * s**2 + shaft) / whole, rtol=1e-9)  # collocated: a zero before the pole
    np.testing.assert_allclose(found[1], shaft / whole, rtol=1e-9)  # non-collocated: none
    np.testing.assert_allclose(found[2], s * shaft / whole, rtol=1e-9)


def test_a_drive_is_the_same_by_its_free_and_by_its_fixed_mode():
    w, names = np.array([1.0, 30.0, np.sqrt(K / J2) * 1.02, OMEGA, 1000.0]), ["motor", "load", "gyro"]
    free, fixed = (pc.read_platform(one) for one in (drive(), locked()))
    for root in ("prescribed", "free"):
        inputs = ["Q", "Omega3" if root == "prescribed" else "M3"]
        one, other = (response(of, [*names, "Omega3"], inputs, w, root=root) for of in (free, fixed))
        np.testing.assert_allclose(other, one, rtol=1e-8, atol=1e-14)


@pytest.mark.parametrize("mode", ["caged", "stabilised"])
def test_runs_of_a_drive_are_the_same_by_its_free_and_by_its_fixed_mode(mode):
    runs = []
    for plant in (drive(), locked()):
        gains = control.StateSpace([], [], [], [[-4.0, -0.25]], 2e-3, inputs=["motor", "gyro"], outputs=["Q"])
        options = {"platform": pc.read_platform(plant), "mode": mode, "duration": 0.3, "delay": 0.0}
        options |= {"q": [0.01], "rate": [0.4]} | ({"Omega": [0.1, 0.0, 0.2]} if mode == "stabilised" else {})
        runs.append(simulation.simulate(simulation.Scenario(**options), [gains], period=2e-3, step=1e-4, noise=False))
    free, fixed = runs
    np.testing.assert_allclose(fixed.reading, free.reading, rtol=0, atol=2e-6)
    assert np.ptp(free.reading[:, 1] - free.reading[:, 2]) > 1e-4


def test_a_motor_that_bounces_off_a_stop_keeps_the_energy_of_its_load_on_a_shaft():
    plant = locked(damping=0.0)
    plant["gimbal"][0] |= {"stops": [-0.3, 0.012], "restitution": 1.0}
    idle = control.StateSpace([], [], [], [[0.0]], 1e-3, inputs=["motor"], outputs=["Q"])
    one = {"platform": pc.read_platform(plant), "mode": "caged", "duration": 0.1, "delay": 0.0, "rate": [0.4]}
    run = simulation.simulate(simulation.Scenario(**one), [idle], period=1e-3, step=2e-5, noise=False)
    gyro, motor, load = run.reading.T
    energy = 0.5 * (J1 * run.rate[:, 0] ** 2 + J2 * gyro**2 + K * (motor - load) ** 2)
    assert run.rate.min() < -0.1
    np.testing.assert_allclose(energy, energy[0], rtol=2e-3)


def test_a_beam_on_a_joint_has_the_frequencies_of_a_pinned_beam():
    """Modes of the clamped beam: λ from cos λ cosh λ = −1, Γ = 2 L √m/λ²; pinned and free: tan λ = tanh λ."""
    m, L, bending = 1.2, 0.8, 40.0
    clamped = [1.875104068711961, 4.694091132974175, 7.854757438237613, 10.995540734875467, 14.13716839104647]
    modes = [
        {
            "name": f"beam{k}",
            "frequency": x**2 * np.sqrt(bending / (m * L**3)),
            "damping": 0.0,
            "interface": "fixed",
            "joints": {"g": 2.0 * L * np.sqrt(m) / x**2},
        }
        for k, x in enumerate(clamped)
    ]
    plant = drive() | {"mode": modes}
    plant["gimbal"][0]["inertia"] = [0.3, 0.3, m * L**2 / 3.0]
    poles = np.linalg.eigvals(pc.state_space(pc.linearise(pc.read_platform(plant))).A)
    found = np.sort(poles.imag[poles.imag > 1.0])[:2]
    pinned = np.array([3.926602312047919, 7.068582745628732]) ** 2 * np.sqrt(bending / (m * L**3))
    assert found == pytest.approx(pinned, rel=5e-3)


@pytest.mark.parametrize("of", [drive, locked])
def test_a_free_root_with_modes_keeps_its_angular_momentum_in_a_run(of):
    platform = pc.read_platform(of(**({"base": [0.1, -0.05, 0.1]} if of is drive else {})))
    push = control.StateSpace([], [], [], [[5.0]], 1e-3, inputs=["motor"], outputs=["Q"])
    one = {"platform": platform, "mode": "stabilised", "duration": 0.3, "delay": 0.0, "q": [0.2], "rate": [2.0]}
    scenario = simulation.Scenario(**one, Omega=[0.5, -0.3, 0.4])
    run = simulation.simulate(scenario, [push], period=1e-3, step=1e-4, noise=False)
    [mode] = platform.modes
    swing = (run.reading[:, 0] - run.Omega[:, 2] - run.rate[:, 0]) / mode.participation["gyro"]
    u = np.hstack([run.Omega, run.rate])
    own = np.array([pc.matrices(platform, q).A_star[:3] @ rates for q, rates in zip(run.q, u, strict=True)])
    momentum = np.linalg.norm(own + swing[:, None] * mode.base, axis=1)
    assert np.ptp(swing) > 0.05
    np.testing.assert_allclose(momentum, momentum[0], rtol=1e-6)


def test_a_shaken_base_excites_a_mode_by_its_acceleration():
    # Of the motion of the base q + Γ η' is what the load sees: here a pendulum mass on a spring, free of the joint.
    base = [0.0, 0.0, 0.3]
    platform = pc.read_platform(drive(base=base))
    w = np.array([5.0, 100.0, 400.0])
    found = response(platform, ["load"], ["Omega3"], w)[0, 0]
    s = 1j * w
    np.testing.assert_allclose(found, -1 / s - LOAD * 0.3 * s / (s**2 + 2 * ZETA * OMEGA * s + OMEGA**2), rtol=1e-9)


def test_on_a_free_root_a_mode_pushes_back_and_momentum_is_kept():
    platform = pc.read_platform(drive(base=[0.0, 0.0, 0.1]))
    w = np.array([10.0, 100.0])
    rates = sensed(platform, ["shaft_rate", "q_rate", "Omega3"], root="free")
    swing, rate, Omega = analysis.frequency_response(rates, w)[:, 0]
    # The joint's torque is an inner one.
    momentum = (1.0 + J1 + J2) * Omega + (J1 + J2) * rate + 0.1 * swing
    np.testing.assert_allclose(np.abs(momentum), 0.0, atol=1e-12)
    assert np.abs(swing).min() > 0.0


def test_a_run_of_a_sampled_loop_is_that_of_the_exact_matrices():
    platform = pc.read_platform(drive())
    period, k, d = 2e-3, 4.0, 0.25
    names = ["motor", "gyro"]
    K = control.StateSpace([], [], [], [[-k, -d]], period, inputs=names, outputs=["Q"])
    one = simulation.Scenario(platform=platform, mode="caged", duration=0.4, delay=0.0, q=[0.01])
    run = simulation.simulate(one, [K], period=period, step=1e-4, noise=False)
    system = sensed(platform, names)
    sampled = control.sample_system(system, period, method="zoh")
    x, expected = np.array([0.01, 0.0, 0.0, 0.0]), []
    for _ in run.t:
        y = system.C @ x
        expected.append(y)
        x = sampled.A @ x + sampled.B[:, 0] * (np.array([-k, -d]) @ y)
    np.testing.assert_allclose(run.reading[:, [1, 0]], expected, rtol=0, atol=1e-7)  # rate sensors come first
    assert np.abs(np.array(expected)[:, 1]).max() > 1e-3


def test_a_run_on_a_shaken_base_is_that_of_the_linear_model():
    platform = pc.read_platform(drive(base=[0.0, 0.0, 0.3]))
    K = control.StateSpace([], [], [], [[0.0]], 1e-3, inputs=["load"], outputs=["Q"])
    t = np.linspace(0.0, 0.5, 501)
    Omega = np.zeros((len(t), 3))
    Omega[:, 2] = 0.02 * np.sin(2.0 * np.pi * 12.0 * t) ** 3
    table = simulation.TimeTable(t=t, values=Omega)
    one = simulation.Scenario(platform=platform, mode="caged", duration=0.5, delay=0.0, Omega_table=table)
    run = simulation.simulate(one, [K], period=1e-3, step=1e-4, noise=False)
    system = sensed(platform, ["motor", "load"])
    inputs = np.zeros((4, len(t)))
    inputs[1:] = Omega.T
    expected = control.forced_response(system, t, inputs).outputs.T
    np.testing.assert_allclose(run.reading[:, 1:], expected[: len(run.t)], rtol=0, atol=2e-6)
    assert np.ptp(expected[:, 0] - expected[:, 1]) > 1e-4


def table(tmp_path, text):
    """A plant whose modes are in a file."""
    (tmp_path / "modes.csv").write_text(text, encoding="utf-8")
    plant = {key: one for key, one in drive().items() if key != "mode"} | {"modes": str(tmp_path / "modes.csv")}
    return pc.read_platform(plant)


def test_modes_in_a_table_are_those_of_the_plant_file(tmp_path):
    head = "# free\nname, frequency_hz, damping, Q, gyro, base3, base_force1\n"
    platform = table(tmp_path, f"{head}a, 20, 0.01, 1.5, -2, , 0.1\n\nb, 50, 0.02, , 3, 0.2,\n")
    a, b = platform.modes
    assert (a.name, a.damping, dict(a.participation)) == ("a", 0.01, {"Q": 1.5, "gyro": -2.0})
    assert a.frequency == pytest.approx(40.0 * np.pi)
    assert (a.base.tolist(), a.base_force.tolist()) == ([0, 0, 0], [0.1, 0, 0])
    assert (dict(b.participation), b.base.tolist()) == ({"gyro": 3.0}, [0, 0, 0.2])
    [locked] = table(tmp_path, "name,frequency,damping,load,joint.g\na,30,0,2,0.1\n").modes
    assert (locked.interface, dict(locked.joints), locked.frequency) == ("fixed", {"g": 0.1}, 30.0)


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("", 'there is no column "name"'),
        ("name,frequncy_hz,damping,Q\na,1,2,3\n", 'no column "frequency_hz"; is "frequncy_hz" meant'),
        ("name,frequency_hz,Q\na,1,2\n", 'no column "damping"'),
        ("name,frequency_hz,damping,Q,Q\n", 'column "Q" is there twice'),
        ("name,frequency_hz,damping,Q\na,1,0.1\n", "modes.csv, line 2: has 3 cells, and the header 4 columns"),
        ("name,frequency_hz,damping,Q\na,1,0.1,much\n", 'line 2: Q must be a number, got "much"'),
        ("name,frequency_hz,damping,lod\na,1,0.1,1\n", '"lod" is no torquer, sensor .* did you mean "load"'),
        ("name,frequency_hz,damping,Q\na,1,-0.1,1\n", "damping must be a number >= 0"),
    ],
)
def test_a_table_of_modes_that_cannot_be_is_refused(tmp_path, text, words):
    with pytest.raises(pc.PlatformCtrlError, match=words):
        table(tmp_path, text)


def test_a_table_of_modes_that_is_not_there_is_refused(tmp_path):
    with pytest.raises(pc.PlatformCtrlError, match="there is no such file"):
        pc.read_platform(drive() | {"modes": str(tmp_path / "none.csv")})


def test_a_mode_is_written_as_it_was_read():
    platform = pc.read_platform(drive())
    import tomllib

    again = pc.read_platform(tomllib.loads(platform.to_toml()))
    assert again.to_toml() == platform.to_toml()
