"""Rate and pointing loops of a camera gimbal against textbook formulas, over gimbal angles and with dry friction."""

import numpy as np
import pytest

import platform_ctrl as pc
from camera_job import FRICTION, J_AZIMUTH, J_ELEVATION, camera_job, camera_loop, camera_plant, tracking_loop
from given_controllers import outcomes
from platform_ctrl import analysis, design
from platform_ctrl.errors import InputError
from platform_ctrl.job.requirements import requirement
from platform_ctrl.verification import check_job

STILL = {"Omega": [0.0, 0.0, 0.0]}


def closed(**changes):
    """Return the loop's design."""
    return design.loops(pc.read_job(camera_job(**changes)))[0].closed


@pytest.fixture(scope="module")
def loop():
    return closed()


def test_a_channel_is_a_pi_over_an_inertia_with_hold_delay_and_lag(loop):
    """L = J ωc (1 + ωi/s) · 1/(J s), sampled; the two axes do not act on each other at zero elevation."""
    L = analysis.loop_transfer(loop.plants.system(), loop.controller)
    w = 2.0 * np.pi * np.array([2.0, 8.0, 30.0])
    T, delay, lag = 5e-4, 2e-4, 2e-4
    hold = np.exp(-1j * w * (delay + 0.5 * T)) * np.sinc(0.5 * w * T / np.pi) / (1.0 + 1j * w * lag)
    rolloff = 1.0 / (1.0 + 1j * w / (2.0 * np.pi * 800.0))
    wc, wi = 2.0 * np.pi * 30.0, 2.0 * np.pi * 3.0
    expected = wc / (1j * w) * (1.0 + wi / (1j * w)) * hold * rolloff
    found = analysis.frequency_response(L, w)
    # Tustin's rule and aliases: a share of (ωT)².
    for k in range(2):
        np.testing.assert_allclose(found[k, k], expected, rtol=6e-3)
    np.testing.assert_allclose(found[[0, 1], [1, 0]], 0.0, atol=1e-12)


def test_a_balanced_gimbal_without_friction_transmits_nothing():
    data = camera_plant()
    del data["friction"]
    found = closed(plant=data)
    assert found.plants.sight == ("los_rate1", "los_rate2")
    attenuation = requirement("attenuation", 40.0, frequency=60.0).check(found.plants, found.controller)
    assert attenuation.value > 200.0


def test_a_search_does_not_go_on_at_a_resonance_of_regular_plants_alone():
    """A spring acts by an angle that no gyro reads: it drifts. The classical loop meets all limits as it is."""
    limits = {"disk_margin": 0.4, "attenuation_db": 20.0, "attenuation_hz": 5.0}
    one = {"name": "s", "method": "structured", "structure": "cross-axis"}
    found = closed(
        plant=camera_plant(spring=[{"gimbal": "el", "stiffness": 2.0}]),
        loop=camera_loop(limits=limits, design=[one], use="s"),
    )
    assert found.plants.drifting == ("q_el",)
    assert found.passed
    assert found.claims["evaluations"] == 1.0


def test_dry_friction_brings_the_base_in_by_its_describing_function():
    """LOS rate/base rate = S d/(J s), d = 4 F/(π Ω): the rate loop holds the body against d times the base's rate."""
    found = closed()
    labels = found.plants.labels
    assert labels == ("nominal", "dry friction at 0.2 rad/s")
    d, w = 4.0 * FRICTION / (np.pi * 0.2), 2.0 * np.pi * 5.0
    at = requirement("attenuation", 1.0, over=("friction",), frequency=w).check(found.plants, found.controller)
    wc, wi = 2.0 * np.pi * 30.0, 2.0 * np.pi * 3.0
    s = 1j * w
    for J in (J_AZIMUTH, J_ELEVATION):
        L = wc / s * (1.0 + wi / s) * np.exp(-s * 6.5e-4) / (1.0 + s / (2.0 * np.pi * 800.0))
        ratio = d / abs(J * s * (1.0 + L) + d)
        if J == J_ELEVATION:
            # The lighter axis is the worse one, and the worst frequency the edge of the band.
            assert at.value == pytest.approx(-20.0 * np.log10(ratio), abs=0.1)
        else:
            assert at.value < -20.0 * np.log10(ratio)


def test_the_yaw_loop_loses_the_cosine_of_the_elevation_at_every_trim():
    found = closed(operation=STILL | {"angles": {"q_el": [0.6, 1.0]}})
    assert found.plants.labels == ("nominal", "q_el = 0.6 rad", "q_el = 1 rad")
    w = np.array([2.0 * np.pi * 20.0])
    nominal = found.plants.system(0)
    for k, elevation in ((1, 0.6), (2, 1.0)):
        one = analysis.frequency_response(found.plants.system(k), w)[0, 0, 0]
        # The inertia about azimuth changes with the elevation as well.
        inertia = J_AZIMUTH + (0.02 - 0.019) * np.sin(elevation) ** 2
        expected = analysis.frequency_response(nominal, w)[0, 0, 0] * np.cos(elevation) * J_AZIMUTH / inertia
        assert one == pytest.approx(expected, rel=1e-9)


def test_uncertain_inertias_count_at_every_trim():
    found = closed(operation=STILL | {"angles": {"q_el": [0.6]}}, uncertainty={"inertia": 0.2})
    assert len(found.plants.labels) == 2 * (1 + 4)
    assert {label for label in found.plants.labels if label.startswith("Jaz+20%")} == {
        "Jaz+20% Jel-20%",
        "Jaz+20% Jel+20%",
        "Jaz+20% Jel-20%, q_el = 0.6 rad",
        "Jaz+20% Jel+20%, q_el = 0.6 rad",
    }


@pytest.mark.parametrize(
    ("kind", "method", "options"),
    [
        ("rate", "hinf", {}),
        ("rate", "lqg", {}),
        ("rate", "structured", {"structure": "cross-axis", "evaluations": 40}),
        ("pointing", "classical", {"inertial_crossover_hz": 20}),
        ("pointing", "hinf", {"inertial_bandwidth_hz": 10}),
        ("pointing", "lqg", {}),
    ],
)
def test_every_method_makes_a_stable_loop_of_every_kind_it_is_for(kind, method, options):
    found = closed(loop=camera_loop(kind, method, use="one", design=[{"name": "one", "method": method} | options]))
    assert found.measures.decay.min() > 0.05
    assert found.measures.disk_margin.min() > 0.3
    assert found.controller.input_labels == (
        ["yaw_gyro", "pitch_gyro"] if kind == "rate" else ["yaw_error", "pitch_error"]
    )


def test_a_pointing_loop_keeps_integrals_of_the_rates_that_it_reads_and_drops_the_angles():
    found = closed(loop=camera_loop("pointing", "classical"))
    assert set(found.plants.states) >= {"integral_1", "integral_2", "p_q_az", "p_q_el"}
    assert "q_az" not in found.plants.states


def test_one_axis_by_itself_holds_the_other_and_the_whole_is_checked():
    loops = camera_loop(gimbals=["az"], sensors=["yaw_gyro"], name="yaw")
    loops += camera_loop(gimbals=["el"], sensors=["pitch_gyro"], name="pitch")
    job = pc.read_job(camera_job(loop=loops, operation=STILL | {"angles": {"q_el": [0.9]}}))
    made = design.loops(job)
    assert [outcome.closed.plants.sight for outcome in made] == [("los_rate2",), ("los_rate1",)]
    result = check_job(job, made)
    assert result.coupled.stable
    assert result.coupled.channels == ("Qaz", "Qel")
    margin = next(one for one in result.requirements if one.name == "simultaneous disk margin")
    assert "q_el = 0.9 rad" in margin.evidence
    stable = next(one for one in result.requirements if one.stage == "coupled" and "decay" in one.name)
    assert "nothing holds the angles q_az, q_el: they drift" in stable.evidence


def test_sensors_that_do_not_show_what_a_torquer_does_are_refused():
    job = pc.read_job(camera_job(loop=camera_loop(sensors=["pitch_gyro"])))
    with pytest.raises(InputError, match="do not show what each of the torquers Qaz, Qel does"):
        design.loops(job)


@pytest.mark.parametrize(
    ("gimbal", "gyro", "words"),
    [
        ([0, 0, 1], [0, 1, 0], "the gimbals az and el turn about parallel axes"),
        ([0, 1, 0], [0, 0, 1], "the sensors yaw_gyro and pitch_gyro measure about parallel axes"),
        ([0, 1, 0], [1, 0, 0], "pitch_gyro measures about an axis that none of them turns"),
    ],
)
def test_parallel_axes_are_named_as_such(gimbal, gyro, words):
    data = camera_job(loop=camera_loop())
    data["plant"]["gimbal"][1]["axis"], data["plant"]["rate_sensor"][0]["axis"] = gimbal, gyro
    with pytest.raises(InputError, match="do not show what each of the torquers") as caught:
        design.loops(pc.read_job(data))
    assert words in str(caught.value)


@pytest.fixture(scope="module")
def tracked():
    data = camera_plant()
    for sensor in data["attitude_sensor"]:
        sensor["delay"] = 0.01
    job = pc.read_job(
        camera_job(plant=data, loop=[*camera_loop(), tracking_loop({"disk_margin": 0.4}, crossover_hz=2.0)])
    )
    made = design.loops(job)
    return job, made, check_job(job, made)


def test_a_tracking_loop_is_an_integrator_behind_the_rate_loop_and_the_tracker(tracked):
    """Well below the rate loop's crossover: ωc (1 + ωi/s)/s · exp(−s τ) times its complementary sensitivity."""
    _, (tracking, rate), _ = tracked
    w = 2.0 * np.pi * np.array([0.5, 2.0])
    L = analysis.frequency_response(analysis.loop_transfer(tracking.closed.plant, tracking.closed.controller), w)
    T = -analysis.frequency_response(analysis.closed_loop(rate.closed.plant, rate.closed.own_controller), w)[2:, -2:]
    s = 1j * w
    for k in range(2):
        expected = 4.0 * np.pi / s * (1.0 + 0.6 * np.pi / s) * np.exp(-0.01 * s) * T[k, k]
        np.testing.assert_allclose(L[k, k], expected, rtol=0.01)


def test_the_poles_of_the_cascade_are_those_of_the_whole(tracked):
    _, (tracking, rate), result = tracked
    assert [one.spec.name for one in (tracking, rate)] == ["track", "rate"]
    assert result.coupled.stable
    slow = float(-np.log(np.abs(result.coupled.poles).max()) / 5e-4)
    assert slow == pytest.approx(tracking.closed.measures.decay[0], rel=1e-6)
    assert all(one.passed for one in result.requirements)


def test_a_cascade_is_read_back_and_measured_the_same(tracked):
    job, made, _ = tracked
    again = outcomes(job, [one.closed.controller for one in made])
    assert [one.spec.name for one in again] == [one.spec.name for one in made]
    for one, other in zip(made, again, strict=True):
        np.testing.assert_allclose(other.closed.measures.disk_margin, one.closed.measures.disk_margin, rtol=1e-9)


def test_a_cable_does_not_make_a_rate_loop_unstable():
    """J q'' + k q = Q with Q = −K q': balance at any angle, a pole at zero that is no fault of the loop."""
    cable = [{"gimbal": name, "stiffness": 0.1} for name in ("az", "el")]
    held, free = closed(plant=camera_plant(spring=cable)), closed()
    assert held.measures.free_angles == ("q_az", "q_el")
    assert held.measures.decay.min() == pytest.approx(free.measures.decay.min(), rel=0.05)
    w = 2.0 * np.pi * np.array([10.0, 30.0])
    found, expected = (analysis.frequency_response(one.plants.system(), w)[:, :2] for one in (held, free))
    # (ω₀/ω)² with ω₀² = k/J.
    np.testing.assert_allclose(found, expected, rtol=0.002, atol=1e-9)
    assert held.measures.disk_margin[0] == pytest.approx(free.measures.disk_margin[0], rel=0.01)


def test_a_loop_may_have_fewer_torquers_than_gimbals():
    loops = camera_loop(gimbals=["az", "el"], torquers=["Qel"], sensors=["pitch_gyro"])
    [outcome] = design.loops(pc.read_job(camera_job(loop=loops, operation=STILL)))
    assert outcome.closed.controller.output_labels == ["Qel"]


@pytest.mark.parametrize("spring", [0.0, 0.3])
def test_angles_that_a_pointing_loop_leaves_free_are_no_instability(spring):
    """A body is held against inertial space: its gimbals follow the base, and stay wherever it leaves them."""
    data = camera_plant() if spring == 0.0 else camera_plant(spring=[{"gimbal": "az", "stiffness": spring}])
    job = pc.read_job(camera_job(plant=data, loop=camera_loop("pointing", "classical", use="pi")))
    made = design.loops(job)
    assert made[0].closed.measures.decay.min() > 0.05
    stable = next(one for one in check_job(job, made).requirements if one.stage == "coupled" and "decay" in one.name)
    assert stable.passed
    assert "nothing holds the angles q_az, q_el: they drift" in stable.evidence


def test_the_verdict_names_what_it_rests_on_and_rows_have_the_units_of_rates():
    angles = {"Omega": [0.2, 0.2, 0.2], "angles": {"q_el": [0.6]}}
    job = pc.read_job(camera_job(operation=angles, loop=camera_loop(limits={"controller_gain": 100.0})))
    made = design.loops(job)
    words = "dry friction is a describing function at 0.2 rad/s, and that the gimbal angles are q_el = 0 and 0.6 rad"
    assert words in check_job(job, made).assumptions
    gain = next(one for one in made[0].closed.results if one.name == "gain of the controller")
    assert gain.unit == "N m/(rad/s)"
