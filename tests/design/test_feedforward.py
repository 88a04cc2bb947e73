"""Feedforward of the base rate in rate and pointing loops against textbook formulas of one axis, and the simulation."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import platform_ctrl as pc
from camera_job import J_AZIMUTH, J_ELEVATION, camera_job, camera_plant
from platform_ctrl import analysis, design
from platform_ctrl.analysis.loop import Loop
from platform_ctrl.analysis.measuring import torque_noise
from platform_ctrl.analysis.system import System
from platform_ctrl.design.feedforward import rate_feedforward
from platform_ctrl.design.loop import Design, LoopOutcome, closed_loop_poles
from platform_ctrl.errors import ArgumentError
from platform_ctrl.job.drive import Feedforward
from platform_ctrl.job.job import Job
from platform_ctrl.job.requirements import requirement
from platform_ctrl.job.scenario import Scenario, TimeTable
from platform_ctrl.mechanics.linearisation import linearise
from platform_ctrl.mechanics.outputs import observed
from platform_ctrl.mechanics.state_space import state_space
from platform_ctrl.plant.sensors import RateSensor
from platform_ctrl.simulation.closed_loop import simulate
from platform_ctrl.verification.budget import line_of_sight_budget
from platform_ctrl.verification.controllers import outcomes_from, read_controllers
from platform_ctrl.verification.result_file import result_record
from platform_ctrl.verification.verdict import check_job
from sighted_gimbal import sighted, skewed

T, DELAY, LAG = 5e-4, 2e-4, 2e-4
VISCOUS, STIFFNESS = 0.02, 0.3
BASE = ["Omega1", "Omega2", "Omega3"]
# Readings are a period late; scale factors of base gyros and tachometers are wrong.
GYRO: dict[str, Any] = {"noise_density": 2e-5, "delay": T, "bandwidth_hz": 300.0}
BASE_ERROR, OWN_ERROR = 5e-4, 1e-3


def job(designs: list[dict[str, Any]], kind: str = "rate", errors: bool = False, **changes: Any) -> Job:
    """Return the camera's job with friction and springs, base gyros, tachometers and encoders."""
    base, own = (BASE_ERROR, OWN_ERROR) if errors else (0.0, 0.0)
    plant = camera_plant()
    plant["friction"] = [{"gimbal": name, "viscous": VISCOUS} for name in ("az", "el")]
    plant["spring"] = [{"gimbal": name, "stiffness": STIFFNESS} for name in ("az", "el")]
    plant["rate_sensor"] += [{"root_axis": axis, "scale_error": base} | GYRO for axis in (1, 2, 3)]
    plant["rate_sensor"] += [{"gimbal": name, "scale_error": own} | GYRO for name in ("az", "el")]
    plant["angle_sensor"] = [{"name": f"encoder_{name}", "gimbal": name} for name in ("az", "el")]
    data = camera_job(plant=plant, **changes)
    loop = data["loop"][0]
    first = loop["design"][0] | ({} if kind == "rate" else {"method": "classical"})
    loop["sensors"] = loop["sensors"] if kind == "rate" else ["yaw_error", "pitch_error"]
    first = first if kind == "rate" else {"name": "pi", "method": "classical", "inertial_crossover_hz": 30}
    loop |= {"kind": kind, "design": [first, *(first | one for one in designs)]}
    loop["limits"] |= {"torque_limit": 1.0, "torque_limit_hz": 10.0, "torque_noise": 1.0}
    return pc.read_job(data)


DIRECT = {"name": "direct", "feedforward": {"sensors": BASE, "bandwidth_hz": 500}}
RATES = ["q_az_rate", "q_el_rate"]
INDIRECT = {"name": "indirect", "sensors": RATES, "feedforward": {"sensors": BASE, "into": "reading"}}


@pytest.fixture(scope="module")
def outcome() -> LoopOutcome:
    return design.loops(job([DIRECT, INDIRECT], errors=True))[0]


@pytest.fixture(scope="module")
def perfect() -> LoopOutcome:
    return design.loops(job([DIRECT, INDIRECT]))[0]


def of(outcome: LoopOutcome, name: str) -> Design:
    return next(one for one in outcome.designs if one.name == name)


def sight_per_base(one: Design, hz: float) -> np.ndarray:
    """Return the closed loop's response from Omega2, Omega3 to the rates across the line of sight."""
    plants = one.plants
    m, p = len(plants.torques), len(plants.angles)
    loop = plants.whole.at(0).feedback(plants.joined(one.controller), range(m), range(p))
    return analysis.frequency_response(loop.part([m + p, m + p + 1], [3, 4]), [2.0 * np.pi * hz])[..., 0]


def loop_gain(J: float, s: complex) -> complex:
    """L = J ωc (1 + ωi/s) · 1/(J s) with hold, delay, lag and roll-off."""
    wc, wi = 2.0 * np.pi * 30.0, 2.0 * np.pi * 3.0
    hold = np.exp(-s * (DELAY + 0.5 * T)) / (1.0 + s * LAG)
    return wc / s * (1.0 + wi / s) * hold / (1.0 + s / (2.0 * np.pi * 800.0))


def sensor_lag(s: complex) -> complex:
    w = 2.0 * np.pi * GYRO["bandwidth_hz"]
    return np.exp(-s * T) * w**2 / (s**2 + np.sqrt(2.0) * w * s + w**2)


@pytest.mark.parametrize("hz", [1.0, 3.0, 8.0])
def test_what_is_left_of_friction_and_spring_is_what_the_feedforward_comes_too_late_for(perfect, hz):
    """J ω' = u + (d + k/s)(Ω − ω), u_ff = −(d + k/s) Ω: of the torque that the base brings 1 − delay is left."""
    s = 2j * np.pi * hz
    late = sensor_lag(s) * np.exp(-s * (DELAY + 0.5 * T)) / (1.0 + s * LAG)
    bare, fed = (sight_per_base(of(perfect, name), hz) for name in ("pi", "direct"))
    for k, J in ((0, J_ELEVATION), (1, J_AZIMUTH)):
        brought = VISCOUS + STIFFNESS / s
        ratio = brought / (J * s * (1.0 + loop_gain(J, s)) + brought)
        assert abs(bare[k, k]) == pytest.approx(abs(ratio), rel=0.02)
        # The integral of the rate, by which the spring's torque is known, forgets at 0.2 1/s.
        left = 1.0 - late * (VISCOUS + STIFFNESS / (s + 0.2)) / brought
        assert fed[k, k] / bare[k, k] == pytest.approx(left, rel=0.08)
        assert abs(fed[k, k]) < 0.12 * abs(bare[k, k])


def test_indirect_stabilisation_leaves_what_the_scale_factors_differ_by(outcome, perfect):
    """y = (1 + e_r) q̇ + (1 + e_b) Ω: a perfect loop holds y at zero, so that ω = q̇ + Ω ≈ (e_r − e_b) Ω."""
    hz = 0.8
    exact, wrong = (sight_per_base(of(one, "indirect"), hz) for one in (perfect, outcome))
    s = 2j * np.pi * hz
    for k, J in ((0, J_ELEVATION), (1, J_AZIMUTH)):
        L = loop_gain(J, s) * sensor_lag(s)
        brought = (VISCOUS + STIFFNESS / s) / (J * s)
        # The signs of the errors that hurt most.
        error = BASE_ERROR + OWN_ERROR
        expected = (brought + L * error) / (1.0 + L + brought)
        assert abs(exact[k, k]) == pytest.approx(abs(brought / (1.0 + L + brought)), rel=0.02)
        assert abs(wrong[k, k] - exact[k, k]) == pytest.approx(abs(expected - brought / (1.0 + L + brought)), rel=0.02)
    plants = of(outcome, "indirect").plants
    attenuation = requirement("attenuation", 1.0, frequency=2.0 * np.pi * hz).check(
        plants, of(outcome, "indirect").controller
    )
    assert attenuation.value == pytest.approx(-20.0 * np.log10(np.abs(wrong).max()), abs=0.5)


def test_feedforward_moves_no_pole_and_no_margin(outcome):
    bare, fed = of(outcome, "pi"), of(outcome, "direct")
    before = closed_loop_poles(bare.plants, bare.own_controller)[0]
    after = closed_loop_poles(fed.plants, fed.own_controller)[0]
    added = np.linalg.eigvals(fed.plants.feedforward.from_rate.A)
    assert len(after) == len(before) + len(added)
    for one in (*before, *added):
        nearest = np.argmin(np.abs(after - one))
        # Delays are defective at z = 0.
        assert abs(after[nearest] - one) < (1e-9 if abs(one) > 0.05 else 1e-2)
        after = np.delete(after, nearest)
    np.testing.assert_allclose(fed.measures.disk_margin, bare.measures.disk_margin, rtol=1e-9)
    assert fed.measures.bandwidth == pytest.approx(bare.measures.bandwidth, rel=1e-9)


def test_the_delivered_controller_reads_the_base(outcome):
    w = np.array([3.0, 40.0, 700.0])
    for name, own in (("direct", ["yaw_gyro", "pitch_gyro"]), ("indirect", RATES)):
        one = of(outcome, name)
        assert one.controller.input_labels == [*own, *BASE]
        K = analysis.frequency_response(one.own_controller, w)
        F = analysis.frequency_response(one.plants.feedforward.path, w)
        whole = analysis.frequency_response(one.controller, w)
        np.testing.assert_allclose(whole[:, :2], K, rtol=1e-9, atol=1e-12)
        added = F if name == "direct" else np.einsum("ijw,jkw->ikw", K, F)
        np.testing.assert_allclose(whole[:, 2:], added, rtol=1e-9, atol=1e-12)
    # Inertial rates about 3 and 2.
    np.testing.assert_allclose(of(outcome, "indirect").plants.feedforward.path.D, [[0, 0, 1], [0, 1, 0]], atol=1e-12)


def test_torque_and_noise_count_the_feedforward(outcome):
    """With the loop open the torque is F G alone; its noise that of white samples through F."""
    fed = of(outcome, "direct")
    plants = fed.plants
    silent = System(np.zeros((0, 0)), np.zeros((0, 2)), np.zeros((2, 0)), np.zeros((2, 2)), T)
    loops = Loop(plants, silent)
    share = requirement("torque limit", 1.0, frequency=60.0).check(plants, silent)
    w = np.linspace(0.5, 60.0, 400)
    F = analysis.frequency_response(plants.feedforward.from_rate, w)
    by_hand = max(np.linalg.norm(F[j] * 0.2 / 2.0, axis=0).max() for j in range(2))
    assert share.value >= 0.99 * by_hand
    noise = 2e-5 * np.sqrt(0.5 / T)
    rms = [noise * analysis.h2_norm(plants.feedforward.path.part([k], slice(None))) for k in range(2)]
    np.testing.assert_allclose(torque_noise(loops)[0], rms, rtol=1e-9)
    indirect, bare = of(outcome, "indirect"), of(outcome, "pi")
    own = np.abs(bare.measures.torque_noise)
    # Two gyros of twice the noise each instead of one.
    assert np.all(indirect.measures.torque_noise > 2.0 * own)


@pytest.mark.parametrize("kind", ["direct", "indirect"])
def test_the_budget_of_a_sine_of_the_base_is_the_rms_of_the_simulation(kind):
    """The linear prediction is exact for small motion: a continuous base, sensors with errors, sampled feedforward."""
    hz, amplitude = 4.0, 1e-3
    source = {"name": "base", "kind": "base-rate", "axis": 3, "sines": [[hz, amplitude, 0.0]]}
    one = job([DIRECT, INDIRECT], errors=True, budget={"from_hz": 1.0, "to_hz": 100.0, "source": [source]})
    K = of(design.loops(one)[0], kind).controller
    found = line_of_sight_budget(one, [K])
    t = np.arange(0.0, 4.0005, 1e-3)
    rate = np.minimum(1.0, t) * amplitude * np.sin(2.0 * np.pi * hz * t)
    table = TimeTable(t=t, values=np.outer(rate, [0.0, 0.0, 1.0]), smooth=True)
    run = Scenario(platform=one.platform, mode="caged", duration=4.0 - T, delay=DELAY, Omega_table=table)
    shown = simulate(run, [K], period=T, step=1e-4, noise=False)
    rms = shown.line_of_sight[shown.t > 3.0 - 1e-9][: round(1.0 / T), 4].std()
    assert found.rms[0, 1] == pytest.approx(rms, rel=1e-3)
    # Of the base's own motion they differ by far less.
    assert abs(found.rms[0, 1] - rms) < 1e-6 * amplitude / (2.0 * np.pi * hz)


def test_a_job_with_feedforward_is_checked_and_read_back(outcome):
    data = job([DIRECT, INDIRECT], errors=True)
    for name in ("direct", "indirect"):
        used = replace(data, loops=(replace(data.loops[0], use=name),))
        result = check_job(used, design.loops(used))
        # A base that keeps turning winds up the cable: its torque grows without bound towards zero frequency.
        assert [one.name for one in result.requirements if not one.passed] == ["torque at full Omega over its limit"]
        record = result_record(result)
        K, others = (read_controllers(record, used, key) for key in ("controllers", "alternatives"))
        again = outcomes_from(used, K, others)[0]
        first = of(outcome, name)
        np.testing.assert_allclose(again.closed.measures.disk_margin, first.measures.disk_margin, rtol=1e-9)
        assert {len(one.plants.named_inputs()) for one in again.designs} == {2, 5}
        entry = record["controllers"][0]
        entry["D"][0][4] += 0.1
        with pytest.raises(ArgumentError, match="its feedforward from Omega1, Omega2, Omega3 is not the one"):
            outcomes_from(used, read_controllers({"schema": record["schema"], "controllers": [entry]}, used))


def test_encoders_and_base_gyros_point_as_a_tracker_does():
    """The angle against inertial space is that of the gimbal and the base's, which is the integral of its rate."""
    fed = {"sensors": BASE, "into": "reading"}
    one = job(
        [{"name": "indirect", "sensors": ["encoder_az", "encoder_el"], "feedforward": fed}],
        kind="pointing",
    )
    found = design.loops(one)[0]
    hz = 1.0
    direct, indirect = (sight_per_base(of(found, name), hz) for name in ("pi", "indirect"))
    caged = sight_per_base(
        design.loops(job([{"name": "a", "sensors": ["encoder_az", "encoder_el"]}], "pointing"))[0].designs[1], hz
    )
    assert abs(caged[0, 0]) > 0.9
    assert abs(indirect[0, 0]) < 0.12
    assert abs(direct[0, 0]) < 0.12


@settings(max_examples=20, deadline=None)
@given(seed=st.integers(0, 10**6))
def test_the_torque_keeps_what_is_read_at_zero_on_skewed_gimbals(seed):
    """Q = C1 Ω' + C0 Ω + C−1 ∫Ω inserted in the platform's own equations: T q̇ + c Ω vanishes at any frequency."""
    rng = np.random.default_rng(seed)
    frictions = [{"gimbal": name, "viscous": float(rng.uniform(0.0, 0.1))} for name in ("yaw", "pitch")]
    springs = [{"gimbal": name, "stiffness": float(rng.uniform(0.0, 1.0))} for name in ("yaw", "pitch")]
    heavy = [{"body": "pitch", "moment": list(rng.normal(size=3) * 0.03)}]
    plant = replace(skewed(sighted(friction=frictions, spring=springs, unbalance=heavy)), gravity=9.81 * np.ones(3))
    gyros = tuple(replace(one, misalignment=None) for one in plant.rate_sensors)
    base = [RateSensor(name=name, root_axis=axis) for axis, name in enumerate(BASE, 1)]
    plant = replace(plant, rate_sensors=(*gyros, *base))
    data = pc.read_job(
        camera_job(
            plant="seeker_head",
            loop=[
                {
                    "name": "rate",
                    "kind": "rate",
                    "gimbals": ["outer"],
                    "sensors": ["gyro_pitch"],
                    "use": "pi",
                    "design": [{"name": "pi", "method": "pi"}],
                }
            ],
        )
    )
    fed = Feedforward(sensors=tuple(BASE), bandwidth_hz=4e4)
    spec = replace(data.loops[0], gimbals=("yaw", "pitch"), sensors=("gyro2", "gyro3"))
    one = replace(spec.designs[0], feedforward=fed)
    data = replace(data, platform=plant, sampling=replace(data.sampling, period=1e-5))
    F = rate_feedforward(data, spec, one).path
    w = np.array([40.0])
    system = observed(state_space(linearise(plant)), plant, ["gyro2", "gyro3"])
    H = analysis.frequency_response(system, w)[..., 0]
    names = system.input_labels
    torques = [names.index(f"Q{name}") for name in ("yaw", "pitch")]
    rates = [names.index(name) for name in BASE]
    left = H[:, rates] + H[:, torques] @ analysis.frequency_response(F, w)[..., 0]
    # The filtered derivative and the forgetting integral are off by 0.2 in 40.
    assert np.abs(left).max() < 0.01 * np.abs(H[:, rates]).max()
