"""Designs from measured responses: the file, the Nyquist count, the convex-concave design, against known plants."""

import io
import itertools

import control
import numpy as np
import pytest

import platform_ctrl as pc
from platform_ctrl import analysis
from platform_ctrl.design.convex_step import actions, controller_response, realisation
from platform_ctrl.design.measured_pid import candidates, measured_pid
from platform_ctrl.design.responses import contour, read_measurement, unstable_poles
from platform_ctrl.errors import DesignError, InfeasibleError, InputError, NotCertifiedError

PERIOD, DELAY, LAG = 5e-4, 5e-4, 2e-4
ANGLES, TORQUES = ["alpha9", "beta10"], ["Q9", "Q10"]
L, J9, J10 = 0.15, 5e-4, 2e-4
NUTATION = L / np.sqrt(J9 * J10)


@pytest.fixture(scope="module")
def gyro():
    """Torques to angles of 9-10, continuous."""
    return pc.state_space(pc.linearise(pc.read_platform("three_gyro_platform")), gimbals=("9", "10"))[ANGLES, TORQUES]


@pytest.fixture(scope="module")
def plant(gyro):
    return analysis.sampled(gyro, PERIOD, DELAY, [LAG, LAG])


def measurement(plant, noise=0.01, points=90, low=0.5, seed=0):
    w = 2.0 * np.pi * np.geomspace(low, 990.0, points)
    H = analysis.frequency_response(plant, w)
    rng = np.random.default_rng(seed)
    H = H * (1.0 + noise * (rng.standard_normal(H.shape) + 1j * rng.standard_normal(H.shape)) / np.sqrt(2.0))
    return control.FRD(H, w, plant.dt, inputs=plant.input_labels, outputs=plant.output_labels)


@pytest.fixture(scope="module")
def measured(plant):
    return measurement(plant)


LIMITS = {"sensitivity_peak": 2.0, "disk_margin": 0.5, "torque_per_noise": 400.0, "resonance_damping": 0.05}


def pid(*measurements, limits=LIMITS, **more):
    data = [(one.omega, np.moveaxis(one.frdata, -1, 0)) for one in measurements]
    return measured_pid(data, PERIOD, limits, filter_time=0.4 * PERIOD, **more)


@pytest.fixture(scope="module")
def design(measured):
    return pid(measured)


@pytest.fixture(scope="module")
def controller(design):
    return design.controller.to_control(ANGLES, TORQUES)


# The file


CSV = """\
# torques to angles
frequency_hz, a/P re, a/P im, a/Q magnitude, a/Q phase_deg
1.0, 0.5, -0.25, 2.0, 90
2.0, 0.4, -0.20, 1.0, -90

4.0, 0.3, -0.10, 0.5, 0
"""


def test_a_file_is_read_with_units_names_and_both_forms():
    found = read_measurement(io.StringIO(CSV))
    np.testing.assert_allclose(found.omega, 2.0 * np.pi * np.array([1.0, 2.0, 4.0]))
    assert (found.input_labels, found.output_labels, found.dt) == (["P", "Q"], ["a"], 0.0)
    np.testing.assert_allclose(found.frdata[0], [[0.5 - 0.25j, 0.4 - 0.2j, 0.3 - 0.1j], [2j, -1j, 0.5]], atol=1e-15)
    in_decibels = CSV.replace("frequency_hz", "frequency_rad_s").replace("magnitude", "magnitude_db").replace(",", ";")
    quoted = in_decibels.replace("frequency_rad_s", '"frequency_rad_s"').replace(" a/P re", '"a/P re"')
    other = read_measurement(io.StringIO(quoted), period=0.1)
    np.testing.assert_allclose(other.omega, [1.0, 2.0, 4.0])
    assert other.frdata[0, 1, 0] == pytest.approx(10.0**0.1 * 1j)
    assert other.dt == 0.1


MISTAKES = {
    "no such file": (None, "nowhere.csv: there is no such file"),
    "empty": ("# nothing\n", "is empty; write a header"),
    "frequency": (CSV.replace("frequency_hz", "f"), "line 2: the first column must be frequency_hz or"),
    "part": (CSV.replace("a/P re", "a/P real"), 'holds "real": did you mean "re"?'),
    "half": (
        CSV.replace("a/P im", "a/Q im"),
        "line 2: every pair of output and input must have re and im, or",
    ),
    "pair missing": (CSV.replace("a/P", "b/P"), "phase_deg, but b/Q is missing"),
    "word": (CSV.replace("0.4", "zero"), 'line 4: a/P re must be a finite number, got "zero"'),
    "short line": (CSV.replace(", 1.0, -90", ""), "line 4: must have 5 columns as the header, got 3"),
    "falling": (CSV.replace("4.0, 0.3", "1.5, 0.3"), "line 6: frequency_hz must be > 0 and rise, got 1.5 after 2"),
    "few": (CSV.partition("2.0, 0.4")[0], "at least 3 frequencies, got 1"),
    "negative size": (CSV.replace("1.0, -90", "-1.0, -90"), "line 4: a/Q is not finite, or its magnitude is below 0"),
    "beyond Nyquist": (
        CSV.replace("4.0, 0.3", "40.0, 0.3"),
        "line 6: frequency_hz must not exceed half the sample rate, 10, got 40",
    ),
}


@pytest.mark.parametrize("name", MISTAKES)
def test_a_mistake_in_a_file_is_one_line_that_says_where(name, tmp_path):
    text, message = MISTAKES[name]
    file = tmp_path / ("nowhere.csv" if text is None else "measured.csv")
    if text is not None:
        file.write_text(text, encoding="utf-8")
    with pytest.raises(InputError) as caught:
        read_measurement(file, period=0.05)
    assert message in str(caught.value)
    assert "\n" not in str(caught.value)


# The controller


def test_the_realised_controller_answers_like_its_actions():
    gains = np.random.default_rng(1).standard_normal((3, 2, 2)) * np.array([1.0, 50.0, 0.02])[:, None, None]
    w = np.geomspace(1.0, 5000.0, 30)
    K = realisation(gains, 1e-3, PERIOD).to_control(ANGLES, TORQUES)
    expected = np.moveaxis(controller_response(gains, actions(1j * w, 1e-3, PERIOD)), 0, -1)
    np.testing.assert_allclose(analysis.frequency_response(K, w), expected, rtol=1e-9)
    assert K.nstates == 4


# Stability from data


def test_the_nyquist_count_is_that_of_the_poles_for_all_kinds_of_controllers(plant, measured):
    """Weak and strong, right and wrong signs: wherever the data decide, they decide as the true plant does."""
    w, P = measured.omega, np.moveaxis(measured.frdata, -1, 0)
    path, rng = contour(w, P), np.random.default_rng(5)
    decided = {}
    for gains in itertools.islice(candidates(w, P), 30):
        for size in (0.1, 1.0, 4.0):
            trial = gains * size * (1.0 + 0.5 * rng.standard_normal(gains.shape))
            K = realisation(trial, 2e-4, PERIOD).to_control(ANGLES, TORQUES)
            true = int(np.sum(np.abs(analysis.closed_loop(plant, K).poles()) > 1.0))
            try:
                found = unstable_poles(path, lambda s, g=trial: controller_response(g, actions(s, 2e-4, PERIOD)))
            except NotCertifiedError:
                continue
            assert found == true
            decided[true] = decided.get(true, 0) + 1
    assert len(decided) >= 3
    assert sum(decided.values()) >= 40


def test_an_unstable_plant_needs_its_encirclements():
    """1/(s − 1) under PI, against the roots; taken for stable, the count is off by its pole."""
    w = np.geomspace(1e-3, 1e3, 200)
    path = contour(w, (1.0 / (1j * w - 1.0))[:, None, None])
    for gain, count in ((2.0, 0), (0.5, 2)):
        assert np.sum(np.roots([1.0, gain - 1.0, 0.01 * gain]).real > 0.0) == count
        gains = -np.array([gain, 0.01 * gain, 0.0]).reshape(3, 1, 1)

        def controller(s, gains=gains):
            return controller_response(gains, actions(s, 1e-3, 1e-4))

        assert unstable_poles(path, controller, unstable=1) == count
        assert unstable_poles(path, controller) == count - 1


def test_an_unresolved_resonance_is_found_between_its_neighbours(measured):
    path = contour(measured.omega, np.moveaxis(measured.frdata, -1, 0))
    inserted = path.s[path.residue > 0.0]
    assert inserted.real.max() > 0.0
    assert inserted[inserted.real.argmax()].imag == pytest.approx(NUTATION, rel=2e-3)
    assert np.all(np.diff(path.frequency) > 0.0)


def test_data_that_do_not_decide_stability_say_what_is_missing(measured):
    P = np.moveaxis(measured.frdata, -1, 0)
    gains = next(itertools.islice(candidates(measured.omega, P), 4, None))

    def controller(s, factor=1.0):
        return controller_response(factor * gains, actions(s, 2e-4, PERIOD))

    for low, high, missing in ((70, None, "measure lower frequencies"), (0, 60, "measure higher frequencies")):
        with pytest.raises(NotCertifiedError, match=missing):
            unstable_poles(contour(measured.omega[low:high], P[low:high]), lambda s: controller(s, 10.0))
    w = np.geomspace(0.01, 100.0, 40)
    delayed = (30.0 * np.exp(-1j * w) / (1j * w + 1.0))[:, None, None]
    with pytest.raises(NotCertifiedError, match="measure more frequencies there"):
        unstable_poles(contour(w, delayed), lambda s: controller_response(-np.ones((3, 1, 1)), actions(s, 1.0, 1e-3)))


# The design


def test_the_design_is_stable_on_the_true_plant_and_keeps_its_limits_within_the_noise(plant, measured, controller):
    loop = analysis.closed_loop(plant, controller)
    damping = analysis.damping(loop)
    assert np.all(damping.poles.real < 0.0)
    assert damping.ratio.min() > 0.04
    margins = [analysis.loop_transfer(plant, controller, at) for at in ("input", "output")]
    assert min(analysis.disk_margin(margin).unstructured for margin in margins) > 0.5 * 0.95
    noise = np.moveaxis(analysis.frequency_response(loop, measured.omega)[:2, 2:], -1, 0)
    assert np.linalg.norm(noise, 2, axis=(1, 2)).max() < 400.0 * 1.05


def test_every_limit_is_kept_at_every_measured_frequency(measured, design, controller):
    P, eye = np.moveaxis(measured.frdata, -1, 0), np.eye(2)
    K = np.moveaxis(analysis.frequency_response(controller, measured.omega), -1, 0)
    S, S_input = np.linalg.inv(eye - P @ K), np.linalg.inv(eye - K @ P)

    def peak(X):
        return np.linalg.norm(X, 2, axis=(1, 2)).max()

    assert design.unstable_poles == (0,)
    ratios = [peak(X) / 2.0 for X in (S, S_input)] + [peak(X - 0.5 * eye) * 0.5 for X in (S, S_input)]
    ratios.append(peak(K @ S) / 400.0)
    # A limit is what stops the gain.
    assert 0.99 < max(ratios) <= 1.0
    assert design.peaks["torque_per_noise"] == pytest.approx(peak(K @ S), rel=1e-6)
    assert design.peaks["complementary_sensitivity_peak"] == pytest.approx(peak(eye - S), rel=1e-6)


def test_an_angle_after_a_torque_step_is_the_inverse_of_the_integral_gain(plant, design, controller):
    """‖P S‖ → ω ‖Ki⁻¹‖: what is maximised is the rejection of slow disturbances."""
    w = np.array([1e-3])
    slow = analysis.frequency_response(analysis.closed_loop(plant, controller), w)[2:, :2, 0]
    assert np.linalg.norm(slow, 2) / w[0] == pytest.approx(1.0 / design.objective, rel=1e-3)


# What cannot be


def test_limits_that_cannot_be_met_are_named_with_their_frequency(measured):
    with pytest.raises(
        InfeasibleError,
        match=r"measured_pid: (sensitivity_peak|resonance_damping) is [\d.]+ times its limit at [\d.]+ Hz",
    ) as caught:
        pid(measured, limits={"sensitivity_peak": 2.0, "resonance_damping": 0.9}, steps=12)
    assert caught.value.problem is not None


def test_limits_that_make_no_sense_are_errors(measured):
    with pytest.raises(DesignError, match=r"disk_margin must be between 0 and 2, got 2\.5"):
        pid(measured, limits=LIMITS | {"disk_margin": 2.5})
