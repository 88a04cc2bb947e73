"""Loops that turn a floating root from within: a satellite by the wheel that it tilts, and by the wheel's speed."""

import numpy as np
import pytest

import platform_ctrl as pc
from platform_ctrl import design, simulation
from platform_ctrl.errors import InputError

JOB = {
    "schema": 2,
    "name": "satellite",
    "plant": "double_gimbal_wheel_satellite",
    "operation": {"Omega": [0.0, 0.00106, 0.0]},
    "uncertainty": {"inertia": 0.1},
    "sampling": {"rate_hz": 10, "delay": 0.02},
    "loop": [
        {
            "name": "attitude",
            "kind": "pointing",
            "gimbals": ["outer", "inner", "rim"],
            "sensors": ["roll", "yaw", "pitch"],
            "use": "classical",
            "limits": {"disk_margin_worst_case": 0.3},
            "design": [{"name": "classical", "method": "classical"}],
        }
    ],
}
TORQUERS, READINGS = ["Qouter", "Qinner", "Qrim"], ["roll", "yaw", "pitch"]


@pytest.fixture(scope="module")
def outcome():
    return design.loops(JOB)[0]


def gyrostat():
    """The satellite as a bias-momentum satellite (P. C. Hughes, Spacecraft Attitude Dynamics, 1986, ch. 11).

    Small rotations θ of the satellite, tilts α, γ of the wheel and the angle r by which it has run ahead. What tilts
    has the momentum −h e2 and turns by θ1 + α and θ3 + γ. States [θ, α, γ, r and their rates], inputs M1 to M3 and the
    torques of the satellite on outer, inner, rim; outputs θ1, θ3, θ2.
    """
    # kg m2 and m of the plant file; what tilts, 5.6 kg, lies 0.2, 0, 0.1 m from the centre of mass of the other 300 kg.
    mu, at = 300.0 * 5.6 / 305.6, np.array([0.2, 0.0, 0.1])
    Js = np.diag([60.0, 50.0, 70.0]) + mu * (at @ at * np.eye(3) - np.outer(at, at))
    outer = inner = np.full(3, 1e-3)
    rim = np.array([0.0122, 0.0202, 0.0122])
    h, d = 9.0, np.array([0.3, 0.3, 1e-5])
    # velocities u = [ω1, ω2, ω3, α', γ', r'] of satellite, outer, inner, rim
    e = np.eye(6)
    roll, pitch, yaw = e[:3]
    bodies = [
        (outer, (roll + e[3], pitch, yaw)),
        (inner, (roll + e[3], pitch, yaw + e[4])),
        (rim, (roll + e[3], pitch - e[5], yaw + e[4])),
    ]
    M = np.zeros((6, 6))
    M[:3, :3] = Js
    for inertias, rates in bodies:
        M += sum(J * np.outer(w, w) for J, w in zip(inertias, rates, strict=True))
    # The wheel's momentum −h e2 turns with θ + (α, 0, γ): its change about 1 and 3 is a torque on what tilts.
    one, three = roll + e[3], yaw + e[4]
    G = h * (np.outer(one, three) - np.outer(three, one))
    A = np.block([[np.zeros((6, 6)), np.eye(6)], [np.zeros((6, 6)), -np.linalg.solve(M, G + np.diag([0, 0, 0, *d]))]])
    B = np.vstack([np.zeros((6, 6)), np.linalg.inv(M)])
    C = np.eye(12)[[0, 2, 1]]
    return A, B, C


def sampled(A, B, C):
    """Exactly sampled at 10 Hz: torques held from 20 ms after a sample on, lag 10 ms; readings 0.1 s old."""
    from scipy.linalg import expm

    (n, m), p = B.shape, len(C)
    whole = np.zeros((n + 2 * m, n + 2 * m))
    whole[:n, : n + m] = np.hstack([A, B])
    whole[n : n + m, n:] = np.hstack([-np.eye(m), np.eye(m)]) / 0.01
    first, second = expm(whole * 0.02), expm(whole * 0.08)
    k = n + m
    # State: plant and torques, commands of the sample before, readings of the sample before.
    Ad, Bd = np.zeros((k + m + p, k + m + p)), np.zeros((k + m + p, m))
    Ad[:k, :k], Ad[:k, k : k + m] = second[:k, :k] @ first[:k, :k], second[:k, :k] @ first[:k, k:]
    Ad[k + m :, :n] = C
    Bd[:k], Bd[k : k + m] = second[:k, k:], np.eye(m)
    return Ad, Bd, np.hstack([np.zeros((p, k + m)), np.eye(p)])


def closed_poles(K, plant):
    """Poles of u = K y around a sampled plant."""
    A, B, C = plant
    at, of = [K.input_labels.index(name) for name in READINGS], [K.output_labels.index(name) for name in TORQUERS]
    BK, CK, DK = K.B[:, at], K.C[of], K.D[np.ix_(of, at)]
    return np.linalg.eigvals(np.block([[A + B @ DK @ C, B @ CK], [BK @ C, K.A]]))


def test_the_poles_are_those_of_a_bias_momentum_satellite(outcome):
    """Its equations have four roots more: those of a momentum that nothing changes, and of an angle that none reads."""
    closed = outcome.closed
    found = closed.measures.poles[0]
    A, B, C = gyrostat()
    expected = closed_poles(closed.controller, sampled(A, B[:, 3:], C))
    conserved = np.argsort(np.abs(expected - 1.0))[:4]
    assert np.abs(expected[conserved] - 1.0).max() < 1e-4
    left = np.delete(expected, conserved)
    nearest = np.abs(found[:, None] - left).min(axis=0)
    assert nearest[np.abs(left) > 0.01].max() < 1e-6
    assert np.abs(found).max() < 1.0


def test_a_run_of_the_non_linear_satellite_is_what_the_linear_one_does(outcome):
    """A constant torque of 0.1 mN m about each axis for 40 s, without noise: attitude and tilts."""
    K = outcome.closed.controller
    A, B, C = gyrostat()
    M = np.full(3, 1e-4)
    run = simulation.simulate(
        simulation.Scenario(
            platform=pc.read_platform(JOB["plant"]), mode="stabilised", duration=40.0, delay=0.02, torque=M
        ),
        [K],
        period=0.1,
        step=5e-4,
        noise=False,
    )
    # The disturbance is a state of the plant that stays as it is.
    whole = np.block([[A, B[:, :3]], [np.zeros((3, 15))]])
    step, torques, read = sampled(whole, np.vstack([B[:, 3:], np.zeros((3, 3))]), np.hstack([C, np.zeros((3, 3))]))
    x, k = np.zeros(len(step)), np.zeros(K.nstates)
    x[12:15] = M
    at, of = [K.input_labels.index(name) for name in READINGS], [K.output_labels.index(name) for name in TORQUERS]
    shown = []
    for _ in run.t:
        shown.append(x[:6])
        y = read @ x
        x = step @ x + torques @ (K.C[of] @ k + K.D[np.ix_(of, at)] @ y)
        k = K.A @ k + K.B[:, at] @ y
    shown = np.array(shown)
    for found, expected in ((run.attitude_angles, shown[:, :3]), (run.q, shown[:, 3:])):
        assert np.abs(found - expected).max(axis=0) == pytest.approx(np.zeros(3), abs=1e-3 * np.abs(expected).max())
    # What comes from outside is in the tilt of the wheel in the end: h tilt = M t.
    assert run.q[-1, 1] == pytest.approx(M[0] * 40.0 / 9.0, rel=0.01)


def test_gyros_inside_and_a_star_sensor_around_turn_the_satellite_too():
    """The rate loop does not see the attitude, which the tracking loop around it holds; both are judged together."""
    rates = {"name": "rates", "kind": "rate", "sensors": ["gyro1", "gyro3", "gyro2"], "use": "PI"}
    inner = JOB["loop"][0] | rates | {"design": [{"name": "PI", "method": "pi", "crossover_hz": 0.3}]}
    outer = {"name": "star", "kind": "tracking", "around": "rates", "sensors": READINGS, "use": "PI"}
    outer |= {"design": [{"name": "PI", "method": "pi"}], "limits": {"disk_margin_worst_case": 0.5}}
    job = pc.read_job(JOB | {"loop": [inner, outer], "coupled": {"disk_margin": 0.5}})
    result = pc.verification.check_job(job, design.loops(job))
    assert [(r.subject, r.name, r.value) for r in result.requirements if not r.passed] == []


WHEEL = {"inertia": [0.004, 0.004, 0.004]}
RIG = {
    "schema": 1,
    "name": "rig",
    "source": "assumed",
    "root": {"name": "table", "mode": "pivot", "inertia": [8.0, 9.0, 12.0]},
    "gimbal": [{"name": n, "parent": "table", "axis": list(np.eye(3)[k])} | WHEEL for k, n in enumerate("xyz")],
    "torquer": [{"gimbal": n} for n in "xyz"],
    "attitude_sensor": [{"name": f"a{n}", "body": "table", "axis": list(np.eye(3)[k])} for k, n in enumerate("xyz")],
}
LOOP = JOB["loop"][0] | {"gimbals": list("xyz"), "sensors": ["ax", "ay", "az"], "limits": {}}
RIG_JOB = JOB | {"operation": {"Omega": [0.0, 0.0, 0.0]}, "plant": RIG, "loop": [LOOP]}


def test_reaction_wheels_turn_a_table_on_an_air_bearing():
    """A torque on a wheel accelerates the table about its axis the other way: all inertia but the wheel's."""
    closed = design.loops(RIG_JOB)[0].closed
    w = np.array([0.05])
    found = closed.plants.on(w).response[0, 0] * (1j * w) ** 2
    inertias = np.array([8.0, 9.0, 12.0]) + 2 * 0.004
    assert found.real == pytest.approx(np.diag(-1.0 / inertias), rel=1e-3, abs=1e-9)
    assert closed.measures.decay.min() > 0.0


def test_a_solar_array_swings_with_a_free_root():
    """J θ'' + Γ η'' = −τ and η'' + ω² η + Γ θ'' = 0 about axis 3: below ω the table is heavier, above it lighter."""
    mode = {"name": "array", "frequency": 0.3, "damping": 0.0, "interface": "fixed", "base": [0.0, 0.0, 2.0]}
    job = pc.read_job(RIG_JOB | {"plant": RIG | {"mode": [mode]}})
    w = np.array([0.2, 0.5])
    found = design.loops(job)[0].closed.plants.on(w).response[0] * (1j * w[:, None, None]) ** 2
    inertia = 12.0 + 0.008 + 4.0 * w**2 / (0.09 - w**2)
    assert found[:, 2, 2].real == pytest.approx(-1.0 / inertia, rel=3e-3)


def test_gyros_alone_say_that_omega_is_left_out():
    """Wheels do not hold a spinning table by its rates alone: the momentum that they take up turns with it."""
    gyros = [{"name": f"r{n}", "body": "table", "axis": list(np.eye(3)[k])} for k, n in enumerate("xyz")]
    pi = {"name": "PI", "method": "pi", "crossover_hz": 0.3}
    loop = LOOP | {"kind": "rate", "sensors": ["rx", "ry", "rz"], "use": "PI", "design": [pi]}
    job = RIG_JOB | {"plant": RIG | {"rate_sensor": gyros}, "operation": {"Omega": [0.0, 0.0, 2.0]}, "loop": [loop]}
    result = pc.verification.check_job(pc.read_job(job), design.loops(job))
    assert "Omega is zero, as no loop reads the attitude of table" in result.assumptions
    job["uncertainty"] = {"inertia": 0.0}
    with pytest.raises(InputError, match="disk_margin_worst_case needs plants that differ"):
        pc.read_job(job | {"loop": [loop | {"limits": {"disk_margin_worst_case": 0.5}}]})


@pytest.mark.parametrize("root", [{"mode": "held"}, {"mode": "pivot", "gravity": [0.0, 0.0, -9.81]}])
def test_a_root_that_does_not_move_freely_is_named(root):
    with pytest.raises(InputError, match=r"ax, ay, az show 'table', which what turns on it moves only with mode"):
        design.loops(RIG_JOB | {"plant": RIG | {"root": RIG["root"] | root}})


def edited(**loop):
    return JOB | {"loop": [JOB["loop"][0] | loop]}


@pytest.mark.parametrize(
    ("job", "words"),
    [
        (JOB | {"operation": {"Omega": [0.001, 0.0, 0.0]}}, "does not turn steadily"),
        (edited(limits={"Omega_rejection": 1.0}), "which this loop moves; use torque_rejection"),
        (
            JOB
            | {
                "manoeuvre": [
                    {"name": "m", "mode": "caged", "duration": 1.0, "axis": 1, "rate": 0.1, "rise": 0.1, "hold": 0.1}
                ]
            },
            "prescribes the rate of 'satellite', which loop 'attitude' moves",
        ),
        (
            edited(
                design=[
                    {
                        "name": "classical",
                        "method": "classical",
                        "feedforward": {"sensors": ["gyro1"], "into": "torque"},
                    }
                ]
            ),
            "which this loop moves itself",
        ),
    ],
)
def test_what_is_about_a_prescribed_rate_is_refused(job, words):
    with pytest.raises(InputError, match=words):
        design.loops(job)
