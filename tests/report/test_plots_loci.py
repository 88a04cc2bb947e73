"""Plots of linear systems for scripts: loci, Nyquist plots, pole maps and step responses say what the loop does."""

from __future__ import annotations

import math

import control
import numpy as np
import pytest

import platform_ctrl as pc
import report_jobs
from platform_ctrl.analysis.poles import continuous_poles, is_stable, pole_branches, spectral_radius
from platform_ctrl.errors import ArgumentError
from platform_ctrl.report import figures
from platform_ctrl.report.style import LIMIT

PERIOD, DELAY = 0.0005, 0.0005
NUMBERS = {"crossover_hz": 70, "integral_hz": 2, "damping_hz": 78, "damping2_hz": 92, "lead_hz": 7, "rolloff_hz": 900}
ANGLES, TORQUES = ["alpha9", "beta10"], ["Q9", "Q10"]


def ss(A, B, C, D=0.0, dt=0):
    return control.ss(A, B, C, D, dt)


UNIT = ss([[-1.0]], [[1.0]], [[1.0]])
MINUS = ss(np.zeros((0, 0)), np.zeros((0, 1)), np.zeros((1, 0)), [[-1.0]])
THIRD = control.ss(control.tf([1.0], [1.0, 6.0, 5.0, 0.0]))  # 1/(s (s + 1) (s + 5)): stable below a gain of 30
OSCILLATOR = ss([[0.0, 1.0], [-4.0, 0.0]], [[0.0], [1.0]], [[1.0, 0.0]])


@pytest.fixture(scope="module")
def job():
    design = {"name": "classical", "method": "classical", **NUMBERS}
    return pc.read_job(report_jobs.job(operation={"Omega": [0.0, 0.0, 0.0]}, loop=[report_jobs.caging(design)]))


@pytest.fixture(scope="module")
def controller(job):
    return pc.design.loops(job)[0].closed.controller


def gyro(platform):
    return pc.state_space(pc.linearise(platform), gimbals=("9", "10"))[ANGLES, TORQUES]


@pytest.fixture(scope="module")
def plant(job):
    lag = [torquer.lag for torquer in job.platform.torquers if torquer.gimbal in ("9", "10")]
    return pc.analysis.sampled(gyro(job.platform), PERIOD, DELAY, lag)


@pytest.fixture(scope="module")
def over_gain(plant, controller):
    return figures.root_locus(plant, controller)


@pytest.fixture(scope="module")
def over_spin(job, controller):
    return figures.root_locus_over_spin(job.platform, ("9", "10"), controller, period=PERIOD, delay=DELAY)


def nearest(found, expected):
    """Largest distance from an expected pole to the nearest found one."""
    return np.abs(np.asarray(expected)[:, None] - np.asarray(found)[None, :]).min(axis=1).max()


def texts(axes):
    return [text.get_text() for text in axes.texts]


def markers(axes, marker, colour=None):
    """Points of the lines that are drawn with a marker."""
    lines = [x for x in axes.lines if x.get_marker() == marker and colour in (None, x.get_color())]
    return np.concatenate([np.zeros(0), *(np.asarray(x.get_xdata()) + 1j * np.asarray(x.get_ydata()) for x in lines)])


def test_at_gain_1_the_locus_passes_through_the_poles_of_the_closed_loop(over_gain, plant, controller):
    locus = over_gain.locus
    at = int(np.flatnonzero(locus.values == 1.0)[0])
    closed = pc.analysis.closed_loop(plant, controller).poles()
    assert nearest(locus.branches[at], closed) < 1e-9
    rings = markers(over_gain.axes[0, 0], "o", "#d55e00")
    s = continuous_poles(closed, PERIOD)
    assert nearest(s, rings) < 1e-6 * np.abs(s).max()


def test_at_gain_0_the_locus_begins_at_the_poles_of_plant_and_controller(over_gain, plant, controller):
    z = np.concatenate([plant.poles(), controller.poles()])
    # Multiple poles: their computed places differ by the square root of rounding.
    assert nearest(over_gain.locus.branches[0], z) < 1e-6
    assert nearest(z, over_gain.locus.branches[0]) < 1e-6


def test_branches_are_continuous_and_fine_where_they_run(over_gain):
    locus = over_gain.locus
    s = locus.s
    inside = (np.abs(s[1:]) < 2.0 * locus.view.reach) & (np.abs(s[:-1]) < 2.0 * locus.view.reach)
    assert np.abs(np.diff(s, axis=0))[inside].max() < 0.03 * locus.view.reach


def test_followed_poles_keep_their_column_when_they_overtake_each_other():
    t = np.linspace(0.0, 1.0, 60)
    lines = np.array([t - 0.5 + 0.2j, 0.5 - t - 0.2j, 0.1 + 0.9j * t]).T
    shuffled = np.array([np.random.default_rng(k).permutation(row) for k, row in enumerate(lines)])
    out = pole_branches(shuffled)
    assert sorted(map(tuple, out.T.tolist()), key=str) == sorted(map(tuple, lines.T.tolist()), key=str)


def test_the_edge_of_stability_is_where_the_spectral_radius_crosses_1(over_gain, plant, controller):
    [edge] = over_gain.locus.edges

    def radius(gain):
        closed = pc.analysis.closed_loop(plant, gain * controller)
        return float(spectral_radius(closed.poles()))

    low, high = 1.0, 2.5
    for _ in range(50):
        middle = 0.5 * (low + high)
        low, high = (middle, high) if radius(middle) < 1.0 else (low, middle)
    assert edge == pytest.approx(low, rel=1e-6)
    assert over_gain.locus.stable_ranges == [(0.0, pytest.approx(edge))]
    axes = over_gain.axes[0, 0]
    assert axes.get_title(loc="left") == "gain 0 to 2.5: stable below 2.18"
    assert "gain 2.18" in texts(axes)
    [diamond] = markers(axes, "D", LIMIT)
    assert diamond.real == pytest.approx(0.0, abs=1e-6)


def test_the_edge_is_routh_s_for_three_poles():
    locus = figures.root_locus(THIRD, MINUS, gains=[0.0, 100.0]).locus
    assert locus.edges == pytest.approx([30.0], rel=1e-6)
    # s³ + 6 s² + 5 s + 30 = (s² + 5)(s + 6)
    at = int(np.argmin(np.abs(locus.values - 30.0)))
    assert np.abs(locus.branches[at].imag).max() == pytest.approx(math.sqrt(5.0), rel=1e-6)


def test_the_edge_is_found_where_stability_begins_at_the_end_of_the_range():
    # s³ + 2ζ s² + s + k, with an integrator: stable for 0 < k < 2ζ, much closer to 0 than the first points.
    lightly_damped = control.ss(control.tf([1.0], [1.0, 2e-3, 1.0, 0.0]))
    locus = figures.root_locus(lightly_damped, MINUS).locus
    assert locus.edges == pytest.approx([2e-3], rel=1e-5)
    assert locus.stable_ranges == [(0.0, pytest.approx(2e-3, rel=1e-5))]


def test_a_first_order_loop_moves_along_the_real_axis_with_its_gain():
    locus = figures.root_locus(UNIT, MINUS, gains=[0.0, 3.0]).locus
    assert locus.branches[:, 0] == pytest.approx(-1.0 - locus.values)
    assert not locus.edges.size
    assert locus.stable.all()


def test_a_loop_without_damping_at_the_start_of_the_range_has_no_edge_there():
    damper = control.ss(control.tf([-1.0, 0.0], [0.01, 1.0]))
    plot = figures.root_locus(OSCILLATOR, damper, gains=[0.0, 2.0])
    assert not plot.locus.edges.size
    assert plot.locus.stable_ranges == [(0.0, 2.0)]


def test_numbers_along_the_branches_do_not_lie_on_each_other(over_gain):
    figure, axes = over_gain.figure, over_gain.axes[0, 0]
    figure.canvas.draw()
    boxes = [text.get_window_extent() for text in axes.texts]
    pairs = [(a, b) for k, a in enumerate(boxes) for b in boxes[:k] if a.overlaps(b)]
    assert len(boxes) > 12
    assert not pairs


def test_the_z_plane_shows_the_same_loop(plant, controller, over_gain):
    plot = figures.root_locus(plant, controller, plane="z")
    assert plot.locus.edges == pytest.approx(over_gain.locus.edges)
    [diamond] = markers(plot.axes[0, 0], "D", LIMIT)
    assert abs(diamond) == pytest.approx(1.0, abs=1e-6)


def test_over_spin_the_nominal_poles_are_those_of_the_loop(over_spin, plant, controller):
    closed = pc.analysis.closed_loop(plant, controller).poles()
    assert nearest(over_spin.locus.nominal, closed) < 1e-8


def test_over_spin_the_plant_is_the_linearised_one_at_every_speed(job, controller):
    from platform_ctrl.design.cases import changed

    Omega = (0.3, -0.2, 0.5)
    plot = figures.root_locus_over_spin(
        job.platform, None, controller, spins=[0.5, 1.37], period=PERIOD, delay=DELAY, rotors=("11",), Omega=Omega
    )
    faster = changed(job.platform, {}, {"11": 0.37})
    system = pc.state_space(pc.linearise(faster, Omega=Omega))[ANGLES, TORQUES]
    lag = [torquer.lag for torquer in job.platform.torquers if torquer.gimbal in ("9", "10")]
    sampled = pc.analysis.sampled(system, PERIOD, DELAY, lag)
    closed = pc.analysis.closed_loop(sampled, controller).poles()
    assert nearest(plot.locus.branches[-1], closed) < 1e-5
    assert nearest(closed, plot.locus.branches[-1]) < 1e-5


def test_over_spin_stability_ends_where_the_poles_say(over_spin, job, controller):
    from platform_ctrl.design.cases import changed

    [edge] = over_spin.locus.edges
    assert 0.6 < edge < 0.8
    lag = [torquer.lag for torquer in job.platform.torquers if torquer.gimbal in ("9", "10")]
    for share, stable in ((edge * 1.001, True), (edge * 0.999, False)):
        plant = pc.analysis.sampled(gyro(changed(job.platform, {}, {"11": share - 1.0})), PERIOD, DELAY, lag)
        assert is_stable(pc.analysis.closed_loop(plant, controller)) is stable


def test_a_nyquist_curve_is_the_loop_transfer_with_the_other_channel_closed(plant, controller):
    plot = figures.nyquist(pc.analysis.loop_transfer(plant, controller))
    assert plot.axes.shape == (1, 2)
    hz = 100.0
    S = pc.analysis.gang(plant, controller, [2.0 * np.pi * hz]).S_input[:, :, 0]
    for k, axes in enumerate(plot.axes[0]):
        line = plot.lines[0, k][0]
        curve = np.asarray(line.get_xdata()) + 1j * np.asarray(line.get_ydata())
        own = 1.0 / S[k, k] - 1.0
        assert nearest(curve, [own]) < 0.02
        assert axes.get_title(loc="left").startswith(f"{TORQUES[k]}: disk margin ")


def test_the_nyquist_disk_is_touched_and_not_entered(plant, controller):
    plot = figures.nyquist(pc.analysis.loop_transfer(plant, controller))
    margins = pc.analysis.loop_margins(plant, controller)
    for k, alpha in enumerate(margins.alpha):
        line = plot.lines[0, k][0]
        curve = np.asarray(line.get_xdata()) + 1j * np.asarray(line.get_ydata())
        low, high = -(2.0 + alpha) / (2.0 - alpha), -(2.0 - alpha) / (2.0 + alpha)
        clear = np.nanmin(np.abs(curve - 0.5 * (low + high))) - 0.5 * (high - low)
        assert -1e-3 < clear < 0.02


def test_the_arc_of_an_integrator_turns_half_a_circle_on_the_rim():
    plot = figures.nyquist(control.ss(control.tf([1.0], [1.0, 1.0, 0.0])))
    line = plot.lines[0, 0][0]
    curve = np.asarray(line.get_xdata()) + 1j * np.asarray(line.get_ydata())
    curve = curve[np.isfinite(curve)]
    assert np.abs(curve).max() == pytest.approx(3.0)
    # From the positive real axis clockwise: s = r exp(jθ), L about 1/s.
    assert curve[0] == pytest.approx(3.0)
    far = np.unwrap(np.angle(curve[np.abs(curve) > 2.999]))
    assert np.all(np.diff(far) < 1e-12)
    assert far[-1] == pytest.approx(-0.5 * np.pi, abs=0.4)


@pytest.mark.parametrize(("gain", "unstable"), [(29.0, False), (31.0, True)])
def test_the_closed_nyquist_curve_turns_round_minus_1_as_often_as_poles_are_unstable(gain, unstable):
    plot = figures.nyquist(gain * THIRD)
    line = plot.lines[0, 0][0]
    half = np.asarray(line.get_xdata()) + 1j * np.asarray(line.get_ydata())
    whole = np.concatenate([half[::-1].conj(), half])
    turns = np.diff(np.unwrap(np.angle(whole[np.isfinite(whole)] + 1.0)))
    # Both ends lie on the real axis; the open loop has no unstable pole: clockwise turns are unstable poles.
    assert round(-turns.sum() / (2.0 * np.pi)) == (2 if unstable else 0)
    title = plot.axes[0, 0].get_title(loc="left")
    assert title.startswith("2 unstable poles" if unstable else "disk margin")


def test_nyquist_draws_data_as_they_are():
    w = np.geomspace(0.1, 100.0, 80)
    response = 1.0 / (1j * w + 1.0) ** 2
    plot = figures.nyquist(control.frd(response, w))
    line = plot.lines[0, 0][0]
    assert np.asarray(line.get_xdata()) + 1j * np.asarray(line.get_ydata()) == pytest.approx(response)


def test_the_pole_map_writes_damping_and_frequency_of_the_least_damped_pole():
    damped = control.ss(control.tf([1.0], [1.0, 2.0 * 0.12 * 40.0, 1600.0]))
    plot = figures.pole_map([damped, OSCILLATOR], labels=["damped", "not"])
    told = texts(plot.axes[0, 0])
    assert "damping 0.12, 6.37 Hz" in told
    assert "undamped, 0.318 Hz" in told
    assert len(markers(plot.axes[0, 0], "x")) == 1


def test_the_pole_map_shows_a_sampled_system_where_the_continuous_one_is():
    damped = control.ss(control.tf([1.0], [1.0, 8.0, 1600.0]))
    sampled = pc.analysis.sampled(damped, 0.01, 0.0)
    plot = figures.pole_map({"continuous": damped, "sampled": sampled})
    first, second = (np.asarray(x.get_xdata()) + 1j * np.asarray(x.get_ydata()) for x in plot.lines[0, 0])
    assert second == pytest.approx(first)


def test_zeros_are_those_of_the_transfer_function_and_the_rest_is_counted():
    system = control.ss(control.tf([1.0, 3.0], [1.0, 11.0, 10.0]))
    plot = figures.pole_map(system, zeros=True)
    assert markers(plot.axes[0, 0], "o") == pytest.approx([-3.0])
    far = figures.pole_map(system, reach=1.0)
    assert "1 faster pole beyond the view" in texts(far.axes[0, 0])


@pytest.mark.parametrize("ratio", [0.02, 0.7])
def test_little_damping_is_stretched_until_it_can_be_seen(ratio):
    plot = figures.pole_map(control.ss(control.tf([1.0], [1.0, 2.0 * ratio * 40.0, 1600.0])))
    axes = plot.axes[0, 0]
    left = axes.get_xlim()[0]
    assert -ratio * 40.0 / left > 0.1
    up = axes.transData.transform([(0.0, 0.0), (0.0, 1.0), (1.0, 0.0)])
    scales = up[1, 1] - up[0, 1], up[2, 0] - up[0, 0]
    assert bool(scales[1] > 2.0 * scales[0]) == (ratio == 0.02)
    # The rays are stretched alike: the pole lies where its damping says.
    rays = [line for line in axes.lines if len(line.get_xdata()) == 2 and line.get_xdata()[1] < 0.0]
    slopes = sorted(-line.get_xdata()[1] / line.get_ydata()[1] for line in rays)
    assert slopes[1] == pytest.approx(0.1 / math.sqrt(0.99))


def test_unstable_poles_are_labelled_with_their_growth():
    plot = figures.pole_map(control.ss(control.tf([1.0], [1.0, -0.2, 4.0])))
    assert any(text.startswith("grows by 0.1/s") for text in texts(plot.axes[0, 0]))


def test_a_step_response_is_the_exact_one_and_its_end_is_drawn():
    plot = figures.step_response(2.0 * UNIT)
    [line] = plot.lines[0, 0]
    t, y = np.asarray(line.get_xdata()), np.asarray(line.get_ydata())
    assert y == pytest.approx(2.0 * (1.0 - np.exp(-t)), abs=1e-12)
    assert t[-1] == pytest.approx(6.0)
    assert 2.0 in [float(other.get_ydata()[0]) for other in plot.axes[0, 0].lines if other is not line]


def test_a_sampled_step_response_is_a_staircase_over_the_continuous_one():
    plot = figures.step_response({"continuous": UNIT, "sampled": pc.analysis.sampled(UNIT, 0.25, 0.0)}, duration=3.0)
    smooth, stairs = plot.lines[0, 0]
    assert stairs.get_drawstyle() == "steps-post"
    t = np.asarray(stairs.get_xdata())
    assert np.diff(t) == pytest.approx(0.25)
    assert np.asarray(stairs.get_ydata()) == pytest.approx(
        np.interp(t, smooth.get_xdata(), smooth.get_ydata()), abs=1e-4
    )


def test_a_growing_response_is_shown_until_it_has_grown():
    plot = figures.step_response(control.ss(control.tf([1.0], [1.0, -2.0])))
    [line] = plot.lines[0, 0]
    assert np.asarray(line.get_xdata())[-1] == pytest.approx(1.5)
    assert np.isfinite(line.get_ydata()).all()


@pytest.mark.parametrize("pole", [1.0, 1.0 - 1e-16, 1.0 - 1e-12, 1.0 - 1e-9])
def test_a_sampled_integrator_however_rounded_is_drawn_over_a_time_that_can_be_drawn(pole):
    plot = figures.step_response(control.tf([0.1], [1.0, -pole], 0.1))
    [line] = plot.lines[0, 0]
    t, y = np.asarray(line.get_xdata()), np.asarray(line.get_ydata())
    assert len(t) <= 200_001
    assert y == pytest.approx(t, rel=1e-3)
    two = figures.step_response(control.sample_system(control.ss(control.tf([100.0], [1.0, 1.0, 0.0])), 0.01))
    assert np.isfinite(two.lines[0, 0][0].get_ydata()).all()


def test_a_response_that_grows_beyond_all_numbers_is_drawn_as_far_as_it_can_be():
    plot = figures.step_response(control.tf([1.0], [1.0, -1.5], 0.1), duration=1000.0)
    plot.figure.draw_without_rendering()
    y = np.asarray(plot.lines[0, 0][0].get_ydata())
    assert np.nanmax(y) > 1e99
    assert np.isnan(y[-1])


def test_a_loop_that_is_nothing_has_a_nyquist_plot_too():
    [line, *_] = figures.nyquist(control.tf(0.0, 1.0)).lines[0, 0]
    assert np.nanmax(np.abs(line.get_ydata())) == 0.0


@pytest.mark.parametrize(
    ("draw", "says"),
    [
        (lambda: figures.root_locus(UNIT, MINUS, gains=[1.0]), "gains must be at least two"),
        (lambda: figures.root_locus(UNIT, MINUS, gains=[2.0, 1.0]), "gains must be .*increasing"),
        (lambda: figures.root_locus(UNIT, MINUS, plane="w"), "plane must be 's' or 'z', got 'w'"),
        (lambda: figures.root_locus(UNIT, MINUS, plane="z"), "needs a sampled loop"),
        (lambda: figures.root_locus(UNIT, MINUS, reach=0.0), "reach"),
        (lambda: figures.root_locus(MINUS, MINUS), "neither the plant nor the controller"),
        (lambda: figures.root_locus("plant", MINUS), "plant: .*got 'plant'"),
        (
            lambda: figures.root_locus(UNIT, ss([[0.5]], [[1.0]], [[1.0]], 0.0, 0.1)),
            "loop_transfer: plant and controller must have the same sample period, got 0.0 s and 0.1 s; see ",
        ),
        (
            lambda: figures.root_locus_over_spin("plant", None, MINUS),
            "platform must be a Platform, for example from read_platform, got 'plant'",
        ),
        (lambda: figures.nyquist(ss([[-1.0]], [[1.0, 1.0]], [[1.0]])), "square"),
        (lambda: figures.nyquist(UNIT, margin=3.0), "margin must be below 2, .*got 3.0"),
        (lambda: figures.nyquist(UNIT, reach=0.5), "reach must be above 1, .*got 0.5"),
        (lambda: figures.nyquist([UNIT, control.append(UNIT, UNIT)]), "different numbers of channels"),
        (lambda: figures.pole_map([]), "give at least one"),
        (lambda: figures.pole_map(UNIT, plane="z"), "plane 'z'"),
        (lambda: figures.pole_map(ss([[-1.0]], [[1.0, 1.0]], [[1.0]]), zeros=True), "as many inputs as outputs"),
        (lambda: figures.step_response(UNIT, duration=-1.0), "duration"),
        (lambda: figures.step_response(control.tf(1, [1, -0.5], 0.1), duration=1e9), "at most 20000 s, 200000 samples"),
        (lambda: figures.step_response([UNIT, control.append(UNIT, UNIT)]), "the same shape"),
        (lambda: figures.two_sided_nyquist(UNIT), "must be a TwoSidedNyquist"),
    ],
)
def test_wrong_input_is_one_line(draw, says):
    with pytest.raises(ArgumentError, match=says) as raised:
        draw()
    assert "\n" not in str(raised.value)


def test_the_two_sided_nyquist_plot_takes_the_loop_or_its_curve():
    from platform_ctrl.design.classical.complex_coordinates import complex_plant
    from platform_ctrl.design.classical.complex_shaping import complex_loop

    model = pc.linearise(pc.read_platform("three_gyro_platform"))
    plant = complex_plant(model, ("9", "10"), period=PERIOD, delay=DELAY, balance=True)
    loop = complex_loop(plant, crossover_hz=40.0, integral_hz=2.0, damping_hz=50.0, lead_hz=7.0, rolloff_hz=900.0)
    for given in (loop, loop.nyquist):
        figure = figures.two_sided_nyquist(given)
        assert [text.get_text() for text in figure.legends[0].get_texts()][-1].startswith("disk margin 0.58")
