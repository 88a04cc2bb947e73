"""Frequency plots for scripts: what is drawn is what is true of the systems."""

import io
import math
import subprocess
import sys

import control
import numpy as np
import pytest

import platform_ctrl as pc
from platform_ctrl import analysis
from platform_ctrl.analysis.disks import disk_phase, disk_to_gain_phase
from platform_ctrl.report import figures
from platform_ctrl.report.plots.curves import channels, curve, loop_phase, margins
from platform_ctrl.report.plots.nichols import exclusion
from platform_ctrl.report.plots.systems import drawn_systems, grid, ratio_unit, unit

HZ = 1.0 / (2.0 * math.pi)
s = control.tf("s")


def coupled_loop(dt=0.0):
    """A stable 2 x 2 loop with integrators and cross-coupling."""
    A = np.array([[0.0, 0.0, 0.0], [0.0, 0.0, 0.0], [1.0, 0.5, -4.0]])
    B = np.array([[3.0, 1.0], [-0.8, 2.0], [0.3, 0.2]])
    C = np.array([[1.0, 0.2, 0.4], [-0.3, 1.0, 0.1]])
    system = control.ss(A, B, C, np.zeros((2, 2)), inputs=["Q1", "Q2"], outputs=["Q1", "Q2"])
    return system if dt == 0.0 else analysis.sampled(system, dt, dt)


def gyro():
    """Gimbals 9 and 10 of the shipped platform at rest: a nutation without any damping."""
    return pc.state_space(pc.linearise(pc.read_platform("three_gyro_platform")), gimbals=("9", "10"))


def drawn_png(plot):
    out = io.BytesIO()
    plot.figure.savefig(out, format="png", dpi=50)
    return out.tell()


def texts(axes):
    return [text.get_text() for text in axes.texts]


def legend_texts(plot):
    return [text.get_text() for text in plot.legend.get_texts()]


# Grid and curves


@pytest.mark.parametrize("damping", [1e-2, 1e-5, 1e-8])
def test_a_resonance_has_its_whole_shape_however_sharp(damping):
    plot = figures.bode(control.ss(1.0 / (s**2 + 2.0 * damping * s + 1.0)), margins=False)
    f, gain = plot.lines[0, 0][0].get_data()
    assert gain.max() == pytest.approx(0.5 / damping, rel=1e-4)
    assert np.count_nonzero(gain > 0.5 * gain.max()) >= 7
    # Joined by straight lines on the logarithmic scales, nothing is far from the truth.
    middle = np.sqrt(f[1:] * f[:-1])
    true = np.abs(1.0 / (1.0 - (middle / HZ) ** 2 + 2j * damping * middle / HZ))
    assert np.max(np.abs(np.log(true / np.sqrt(gain[1:] * gain[:-1])))) < 0.35


def test_a_plant_without_damping_is_finite_everywhere_and_its_peak_has_flanks():
    plant = gyro()[["alpha9", "beta10"], ["Q9", "Q10"]]
    plot = figures.bode(plant)
    nutation = np.abs(plant.poles()).max() * HZ
    for axes in plot.axes[0]:
        for line in axes.get_lines():
            f, gain = line.get_data()
            assert np.isfinite(gain).all()
            left, right = gain[f < nutation][-8:], gain[f > nutation][:8]
            assert np.all(np.diff(left) > 0.0)
            assert np.all(np.diff(right) < 0.0)
            # The peak runs out of the panel, and no point of it stands alone.
            assert left[-1] > axes.get_ylim()[1]
            assert right[0] > 0.5 * left[-1]


def test_the_grid_comes_close_to_zeros_too():
    [system] = drawn_systems("bode", (s**2 + 2e-7 * s + 4.0) / (s**2 + 0.1 * s + 1.0) / (s + 5.0))
    w, H = system.along(grid([system]))
    assert np.abs(H[0, 0]).min() == pytest.approx(abs(2e-7 * 2.0 / ((-3.0 + 0.2j) * (5.0 + 2.0j))), rel=1e-3)
    assert np.count_nonzero(np.abs(w - 2.0) < 1e-6) > 5


def test_the_phase_falls_at_undamped_poles_and_rises_at_undamped_zeros():
    plot = figures.bode((s**2 + 4.0) * (s**2 + 25.0) / ((s**2 + 1.0) * (s**2 + 9.0) * s), margins=False)
    f, phase = plot.lines[1, 0][0].get_data()
    expected = {0.5: -90.0, 1.5: -270.0, 2.5: -90.0, 4.0: -270.0, 8.0: -90.0}
    for w, angle in expected.items():
        assert np.interp(w, f / HZ, phase) == pytest.approx(angle, abs=1e-6)


def test_the_phase_with_no_damping_is_the_limit_of_little_damping():
    def phase(damping):
        system = (s**2 + 2 * damping * 3 * s + 9.0) / (
            s * (s**2 + 2 * damping * s + 1.0) * (s**2 + 2 * damping * 7 * s + 49.0)
        )
        f, angle = figures.bode(control.ss(system), margins=False).lines[1, 0][0].get_data()
        return np.interp([0.5, 2.0, 5.0, 20.0], f / HZ, angle)

    assert phase(0.0) == pytest.approx(phase(1e-7), abs=1e-3)


def test_an_unstable_resonance_turns_the_phase_the_other_way():
    plot = figures.bode(1.0 / (s**2 - 2e-4 * s + 1.0), margins=False)
    assert plot.lines[1, 0][0].get_ydata()[-1] == pytest.approx(180.0, abs=0.1)


@pytest.mark.parametrize(
    ("system", "begins"),
    [
        (5.0 / s, -90.0),
        (2.0 / s**2, -180.0),
        (1.0 / s**3, -270.0),
        (-3.0 / (s + 1.0), -180.0),
        (-1.0 / s, 90.0),
        (s, 90.0),
    ],
)
def test_the_phase_begins_where_the_integrators_put_it(system, begins):
    phase = figures.bode(system, margins=False).lines[1, 0][0].get_ydata()
    assert phase[0] == pytest.approx(begins, abs=7.0)


def test_a_delay_in_data_turns_the_phase_on_and_on():
    w = np.geomspace(1.0, 400.0, 300)
    plot = figures.bode(control.frd(np.exp(-0.05j * w) / (1.0 + 0.1j * w), w), margins=False)
    expected = np.degrees(-0.05 * w - np.arctan(0.1 * w))
    assert plot.lines[1, 0][0].get_ydata() == pytest.approx(expected, abs=1e-9)


def test_data_may_come_unsorted_and_with_gaps():
    w = np.array([3.0, 1.0, 2.0, 0.0, 5.0])
    plot = figures.bode(control.frd(np.array([3.0, 1.0, np.nan, 7.0, 5.0]) + 0j, w), margins=False)
    f, gain = plot.lines[0, 0][0].get_data()
    assert f / HZ == pytest.approx([1.0, 2.0, 3.0, 5.0])
    assert gain == pytest.approx([1.0, math.nan, 3.0, 5.0], nan_ok=True)
    # The point before the gap has no line to be seen by.
    assert plot.lines[0, 0][0].get_markevery() == [0]
    assert drawn_png(plot)


def test_sampled_systems_end_at_their_nyquist_frequency_which_is_marked():
    slow = analysis.sampled(control.ss(10.0 / (s * (s + 1.0))), 0.05)
    fast = analysis.sampled(control.ss(10.0 / (s * (s + 1.0))), 0.001)
    plot = figures.bode([slow, fast])
    ends = [line.get_xdata()[-1] for line in plot.lines[0, 0]]
    assert ends == pytest.approx([10.0, 500.0], rel=1e-3)
    assert [text for text in texts(plot.axes[0, 0]) if "Nyquist" in text] == ["Nyquist 10 Hz", "Nyquist 500 Hz"]


def test_transfer_functions_have_the_response_of_their_polynomials_improper_ones_too():
    w = np.geomspace(0.1, 50.0, 30)
    proper = control.tf([[[1.0, 2.0], [3.0]]], [[[1.0, 0.3, 4.0], [1.0, 1.0]]])
    improper = control.tf([1.0, 2.0, 3.0], [0.1, 1.0])
    sampled = control.tf([0.2, 0.1], [1.0, -1.5, 0.6], 0.02)
    for system in (proper, improper, sampled):
        [drawn] = drawn_systems("bode", system)
        point = np.exp(1j * w * 0.02) if system.dt else 1j * w
        for j in range(system.ninputs):
            own = np.polyval(system.num_list[0][j], point) / np.polyval(system.den_list[0][j], point)
            assert drawn.response(w)[0, j] == pytest.approx(own, rel=1e-9)


# Margins


@pytest.mark.parametrize(
    "loop",
    [
        3.0 / (s * (s + 1.0) * (0.2 * s + 1.0)),
        20.0 * (s + 1.0) ** 2 / s**3 / (0.02 * s + 1.0) ** 2,
        control.c2d(control.ss(2.0 / (s * (0.3 * s + 1.0))), 0.1),
    ],
)
def test_margins_are_those_of_python_control(loop):
    [system] = drawn_systems("bode", loop)
    found = margins(curve(system, grid([system], loops=True), "L"))
    gain_margin, phase_margin, w_phase, w_gain = control.margin(loop)
    assert found.phase_margin == pytest.approx((phase_margin, w_gain), rel=1e-6)
    nearest = [item for item in (found.highest_gain, found.lowest_gain) if item is not None]
    assert any(item == pytest.approx((gain_margin, w_phase), rel=1e-6) for item in nearest)


def test_the_margins_written_at_the_crossovers_are_the_loops():
    plot = figures.bode(3.0 / (s * (s + 1.0) * (0.2 * s + 1.0)))
    gain_margin, phase_margin, w_phase, w_gain = control.margin(3.0 / (s * (s + 1.0) * (0.2 * s + 1.0)))
    assert f"{phase_margin:.0f}° at {w_gain * HZ:.3g} Hz" in texts(plot.axes[1, 0])
    assert f"× {gain_margin:.2g} at {w_phase * HZ:.3g} Hz" in texts(plot.axes[0, 0])
    alpha = analysis.disk_margin(control.ss(3.0 / (s * (s + 1.0) * (0.2 * s + 1.0)))).alpha
    assert f"disk margin {alpha:.2g}" in legend_texts(plot)[0]


def test_every_crossing_of_a_gain_of_1_is_found_between_points_of_the_grid():
    loop = control.ss(0.02 * (s + 0.5) / (s**2 * (s**2 + 0.002 * s + 1.0)) * (s**2 + 0.002 * s + 4.0))
    [system] = drawn_systems("bode", loop)
    found = margins(curve(system, grid([system], loops=True), "L"))
    assert len(found.gain_crossovers) >= 3
    assert np.abs(analysis.frequency_response(loop, found.gain_crossovers)[0, 0]) == pytest.approx(1.0, rel=1e-9)
    critical = found.gain_margins * analysis.frequency_response(loop, found.phase_crossovers)[0, 0]
    assert critical == pytest.approx(-np.ones(len(critical)), abs=1e-6)


@pytest.mark.parametrize("dt", [0.0, 0.02])
def test_channels_are_drawn_with_the_others_closed(dt):
    loop = coupled_loop(dt)
    plot = figures.bode(loop)
    for k, line in enumerate(plot.lines[0, 0]):
        f, gain = line.get_data()
        S = np.linalg.inv(np.eye(2) + np.moveaxis(analysis.frequency_response(loop, f / HZ), -1, 0))
        assert gain == pytest.approx(np.abs(1.0 / S[:, k, k] - 1.0), rel=1e-6)
    assert [text.split(":")[0] for text in legend_texts(plot)] == ["at Q1", "at Q2"]


def test_the_disk_margins_of_channels_are_those_of_the_loop_broken_there():
    plant = coupled_loop()
    controller = control.ss([], [], [], -np.eye(2), inputs=["Q1", "Q2"], outputs=["Q1", "Q2"])
    expected = analysis.loop_margins(plant, controller).alpha
    [system] = drawn_systems("bode", analysis.loop_transfer(plant, controller))
    parts = channels("bode", system)
    found = [margins(curve(part, grid(parts, loops=True), "")).disk.alpha for part in parts]
    assert found == pytest.approx(expected, rel=1e-6)


def test_channels_of_data_are_those_of_the_system():
    loop, w = coupled_loop(), np.geomspace(0.1, 100.0, 50)
    data = control.frd(analysis.frequency_response(loop, w), w)
    [system], [measured] = drawn_systems("bode", loop), drawn_systems("bode", data)
    for own, part in zip(channels("bode", system), channels("bode", measured), strict=True):
        assert part.along(w)[1] == pytest.approx(own.along(w)[1], rel=1e-8)


def test_a_loop_that_is_not_stable_is_called_so():
    assert "not stable" in legend_texts(figures.bode(0.5 / (s - 1.0)))[0]
    assert "not stable" in legend_texts(figures.nichols(0.5 / (s - 1.0)))[0]
    assert "not stable" in legend_texts(figures.disk_margin_region(0.5 / (s - 1.0)))[0]


def test_a_plant_with_units_is_no_loop():
    plot = figures.bode(gyro()["alpha9", "Q9"])
    assert plot.legend is None
    assert plot.axes[0, 0].get_ylabel() == "gain, rad/(N m)"
    assert not texts(plot.axes[1, 0])


def test_chosen_entries_are_drawn_and_rounding_is_no_response():
    plot = figures.bode(gyro(), outputs=["beta10"], inputs=["Q10", "Omega2"])
    assert plot.axes.shape == (2, 2)
    assert [axes.get_title("left") for axes in plot.axes[0]] == ["from Q10 to β10", "from Ω2 to β10"]
    assert np.isfinite(plot.lines[0, 0][0].get_ydata()).all()
    assert np.isnan(plot.lines[0, 1][0].get_ydata()).all()
    assert "no response" in texts(plot.axes[0, 1])


def test_decibels_are_twenty_times_the_logarithm():
    system = 5.0 / (s + 1.0)
    plain, dB = (figures.bode(system, dB=dB).lines[0, 0][0].get_ydata() for dB in (False, True))
    assert dB == pytest.approx(20.0 * np.log10(plain))


# Nichols and disk margins


@pytest.mark.parametrize(("alpha", "skew"), [(0.4, 0.0), (1.2, 0.3), (0.7, -0.6)])
def test_nichols_regions_end_where_the_balanced_sensitivity_is_1_over_alpha(alpha, skew):
    L = exclusion(alpha, skew)
    S = 1.0 / (1.0 + L)
    # (S - T)/2 = S - 1/2 for skew 0.
    assert np.abs(S + 0.5 * (skew - 1.0)) == pytest.approx(1.0 / alpha, rel=1e-9)
    plot = figures.nichols(1.0 / (s * (s + 1.0)), disk_margins=alpha, skew=skew)
    [region] = [patch for patch in plot.axes[0, 0].patches if len(patch.get_xy()) > 100]
    phase, level = region.get_xy()[:-1].T
    drawn = 10.0 ** (level / 20.0) * np.exp(1j * np.radians(phase))
    assert np.abs(1.0 / (1.0 + drawn) + 0.5 * (skew - 1.0)) == pytest.approx(1.0 / alpha, rel=1e-6)


def test_the_region_of_a_loops_own_margin_is_touched_by_its_curve():
    loop = control.ss(3.0 / (s * (s + 1.0) * (0.2 * s + 1.0)))
    alpha = analysis.disk_margin(loop).alpha
    phase, level = figures.nichols(loop, disk_margins=alpha).lines[0, 0][0].get_data()
    L = 10.0 ** (level / 20.0) * np.exp(1j * np.radians(phase))
    assert np.max(np.abs((1.0 - L) / (1.0 + L) / 2.0)) == pytest.approx(1.0 / alpha, rel=2e-3)


def test_m_circles_have_their_complementary_sensitivity():
    plot = figures.nichols(1.0 / (s * (s + 1.0)), T_peaks=(1.5,))
    [circle] = [line for line in plot.axes[0, 0].get_lines() if len(line.get_xdata()) == 721]
    L = 10.0 ** (circle.get_ydata() / 20.0) * np.exp(1j * np.radians(circle.get_xdata()))
    assert np.abs(L / (1.0 + L)) == pytest.approx(1.5, rel=1e-6)


@pytest.mark.parametrize(("alpha", "skew"), [(0.5, 0.0), (1.0, 0.4), (0.8, -0.5), (1.9, 0.7)])
def test_the_safe_region_holds_what_the_disk_holds(alpha, skew):
    rng = np.random.default_rng(3)
    radius, turn = np.sqrt(rng.random(4000)), 2.0 * np.pi * rng.random(4000)
    delta = radius * np.exp(1j * turn)
    factor = (1.0 + 0.5 * alpha * (1.0 - skew) * delta) / (1.0 - 0.5 * alpha * (1.0 + skew) * delta)
    room = disk_phase(np.abs(factor), alpha, skew)
    assert np.all(np.abs(np.angle(factor)) <= room + 1e-10)
    low, high, phase = disk_to_gain_phase(alpha, skew)
    assert disk_phase(1.0, alpha, skew) == pytest.approx(phase)
    assert np.isnan(disk_phase(0.999 * low, alpha, skew))
    if math.isfinite(high):
        assert np.isnan(disk_phase(1.001 * high, alpha, skew))


def test_the_safe_region_carries_its_classical_margins():
    plot = figures.disk_margin_region({"asked": 0.5})
    assert legend_texts(plot) == ["asked: disk margin 0.5: gain × 0.6 to 1.66 or phase ±28°"]
    assert {"× 0.6", "× 1.66", "28°"} <= set(texts(plot.axes[0, 0]))
    gain, phase = plot.lines[0, 0][0].get_data()
    low, high, top = disk_to_gain_phase(0.5)
    assert (gain[0], gain[-1]) == pytest.approx((low, high))
    assert (phase[0], phase[-1]) == (0.0, 0.0)
    assert np.interp(1.0, gain, phase) == pytest.approx(math.degrees(top), rel=1e-4)


def test_what_destabilises_a_loop_touches_its_region_and_stays_outside():
    loop = control.ss(3.0 / (s * (s + 1.0) * (0.2 * s + 1.0)))
    plot = figures.disk_margin_region(loop)
    [dotted] = [
        line for line in plot.axes[0, 0].get_lines() if len(line.get_xdata()) > 200 and line.get_linewidth() == 1.0
    ]
    gain, phase = dotted.get_data()
    room = np.degrees(disk_phase(gain, analysis.disk_margin(loop).alpha))
    inside = np.isfinite(room)
    assert np.all(phase[inside] >= room[inside] - 1e-6)
    assert np.min(phase[inside] - room[inside]) < 0.05


# Singular values, gang of four, platform rate


def test_singular_values_are_those_of_the_response():
    system = gyro()[["alpha9", "beta10"], ["Q9", "Q10"]]
    plot = figures.singular_values(system, frequency=[1.0, 10.0, 100.0])
    H = np.moveaxis(analysis.frequency_response(system, [1.0, 10.0, 100.0]), -1, 0)
    drawn = np.array([line.get_ydata() for line in plot.lines[0, 0]]).T
    assert drawn == pytest.approx(np.linalg.svd(H, compute_uv=False))


def test_the_gang_of_four_is_that_of_the_closed_loop():
    plant, controller = control.ss(1.0 / (s**2 + 1e-9 * s + 1.0)), control.ss(-(2.0 + s) / (0.05 * s + 1.0))
    plot = figures.gang_of_four(plant, controller)
    f = plot.lines[0, 0][0].get_xdata()
    P, K = (analysis.frequency_response(system, f / HZ)[0, 0] for system in (plant, controller))
    S = 1.0 / (1.0 - P * K)
    for line, expected in zip((lines[0] for lines in plot.lines.flat), (S, 1.0 - S, P * S, K * S), strict=True):
        assert line.get_ydata() == pytest.approx(np.abs(expected), rel=1e-5)


def test_the_gang_of_four_shows_input_and_output_and_their_peaks():
    plant = analysis.sampled(coupled_loop(), 0.02)
    plant = control.ss(plant.A, plant.B, plant.C, plant.D, 0.02, inputs=["Q1", "Q2"], outputs=["alpha", "beta"])
    controller = control.ss(
        [], [], [], [[-2.0, 0.3], [0.0, -1.0]], 0.02, inputs=["alpha", "beta"], outputs=["Q1", "Q2"]
    )
    plot = figures.gang_of_four(plant, controller, S_limit=2.0)
    assert legend_texts(plot) == ["at the plant's input", "at the plant's output"]
    assert [axes.get_ylabel() for axes in plot.axes[1]] == ["gain, rad/(N m)", "gain, N m/rad"]
    own = plot.lines[0, 0]
    for line, at in zip(own, ("input", "output"), strict=True):
        L = analysis.loop_transfer(plant, controller, at=at)
        S = control.feedback(control.ss(np.zeros((0, 0)), np.zeros((0, 2)), np.zeros((2, 0)), np.eye(2), 0.02), L)
        assert line.get_ydata().max() == pytest.approx(analysis.hinf_norm(S)[0], rel=2e-3)
    assert "limit 2" in texts(plot.axes[0, 0])


def test_sensitivity_to_the_platform_rate_is_that_of_the_closed_loop():
    plant = gyro()
    controller = control.ss([], [], [], [[-5.0, 0.3], [-0.3, -5.0]], inputs=["alpha9", "beta10"], outputs=["Q9", "Q10"])
    plot = figures.Omega_sensitivity(plant, controller, limit=0.01, rates=["Omega1", "Omega3"])
    assert plot.axes.shape == (2, 2)
    closed = analysis.closed_loop(plant, controller)["alpha9", "Omega3"]
    without, controlled = plot.lines[0, 1]
    for line, system in ((without, plant["alpha9", "Omega3"]), (controlled, closed)):
        f, gain = line.get_data()
        assert gain == pytest.approx(np.abs(analysis.frequency_response(system, f / HZ)[0, 0]), rel=1e-9)
    # Proportional control takes the integral away: the angle no longer grows with 1/frequency.
    assert controlled.get_ydata()[0] < 0.1 * without.get_ydata()[0]


def test_rates_and_angles_that_have_nothing_to_do_with_each_other_are_left_out():
    plot = figures.Omega_sensitivity(gyro())
    assert [axes.get_title("left") for axes in plot.axes.flat if "Ω2" in axes.get_title("left")] == []


def test_a_controller_without_signal_names_is_joined_by_position():
    named = control.ss([], [], [], -5.0 * np.eye(2), inputs=["alpha9", "beta10"], outputs=["Q9", "Q10"])
    nameless = control.ss([], [], [], -5.0 * np.eye(2))
    one, other = (
        figures.Omega_sensitivity(gyro(), K, rates=["Omega1"], angles=["beta10"]).lines[0, 0][1]
        for K in (named, nameless)
    )
    assert one.get_ydata() == pytest.approx(other.get_ydata())


def test_limits_are_shaded_up_to_the_edge():
    plot = figures.singular_values(5.0 / (s + 1.0), upper=([0.5, 5.0], [20.0, 2.0]), dB=True)
    [area] = plot.axes[0, 0].collections
    low, high = area.get_datalim(plot.axes[0, 0].transData).intervaly
    assert low == pytest.approx(20.0 * np.log10(2.0))
    assert high == pytest.approx(plot.axes[0, 0].get_ylim()[1])


def test_units_come_from_signal_names():
    assert [unit(name) for name in ("alpha9", "q_roll", "Q9", "M1", "Omega2", "f3", "noise_beta10", "y[0]")] == [
        *("rad", "rad", "N m", "N m", "rad/s", "m/s²", "rad", "")
    ]
    assert ratio_unit("rad", "N m") == "rad/(N m)"
    assert ratio_unit("rad", "rad/s") == "rad per rad/s"


# What every plot does


def every_plot():
    loop = coupled_loop(0.02)
    plant = gyro()
    return [
        lambda: figures.bode([3.0 / (s * (s + 1.0)), control.c2d(3.0 / (s * (s + 1.0)), 0.1)]),
        lambda: figures.bode([k / (s * (s + 1.0) * (0.1 * s + 1.0)) for k in range(1, 13)]),
        lambda: figures.bode(control.ss([], [], [], [[-2.0]])),
        lambda: figures.bode(plant),
        lambda: figures.bode({"_$x^2$": loop, "漢字\n<b>": 0.5 * loop}, loops=True, dB=True),
        lambda: figures.nichols([loop, 0.5 * loop]),
        lambda: figures.nichols(1.0 / (s**2 + 1.0)),
        lambda: figures.singular_values([loop, plant], upper=100.0),
        lambda: figures.gang_of_four(loop, control.ss([], [], [], -np.eye(2)), S_limit=2.0),
        lambda: figures.Omega_sensitivity(plant, limit=([1.0, 10.0], [0.1, 0.01])),
        lambda: figures.disk_margin_region([0.3, loop, 2.0 / (s * (s + 1.0))], skew=0.2),
        lambda: figures.root_locus(1.0 / (s + 1.0), control.ss([], [], [], [[-1.0]])),
        lambda: figures.pole_map(plant),
        lambda: figures.nyquist([loop, 0.5 * loop]),
        lambda: figures.step_response(1.0 / (s + 1.0)),
    ]


@pytest.mark.parametrize("k", range(15))
def test_plots_are_control_plots_that_pyplot_does_not_know(k):
    import matplotlib.pyplot as plt

    plot = every_plot()[k]()
    assert isinstance(plot, control.ControlPlot)
    assert plot.axes.ndim == 2
    assert plot.lines.shape == plot.axes.shape
    assert all(line.axes is axes for axes, own in zip(plot.axes.flat, plot.lines.flat, strict=True) for line in own)
    # Warnings are errors: letters that no font has, logarithms of nothing.
    assert drawn_png(plot) > 1000
    assert plt.get_fignums() == []


def test_curves_differ_without_colour():
    lines = every_plot()[1]().lines[0, 0]
    looks = {(line.get_linestyle(), str(line._dash_pattern), line.get_marker()) for line in lines}
    assert len(looks) == len(lines) == 12


def test_importing_the_plots_does_not_load_pyplot():
    code = "import sys; import platform_ctrl.report.figures; sys.exit('matplotlib.pyplot' in sys.modules)"
    assert subprocess.run([sys.executable, "-c", code], check=False).returncode == 0


@pytest.mark.parametrize(
    ("call", "words"),
    [
        (lambda: figures.bode([]), "give at least one"),
        (lambda: figures.bode("P"), "a control.StateSpace"),
        (lambda: figures.bode(control.tf([1], [1, 0], True)), "sample period"),
        (lambda: figures.bode(1 / s, labels=["a", "b"]), "labels must be 1, one for each, got 2"),
        (lambda: figures.bode(1 / s, frequency=[3.0, 2.0, 1.0]), "ascending"),
        (lambda: figures.bode(1 / s, frequency="fast"), "real numbers"),
        (lambda: figures.bode(1 / s, frequency=0.0), "ascending numbers"),
        (
            lambda: figures.bode(control.c2d(1 / s, 1.0), frequency=[10.0, 20.0]),
            "is outside the range of the system, 0 to 3.14159 rad/s",
        ),
        (lambda: figures.bode(gyro(), outputs=["alpha8"]), "did you mean"),
        (lambda: figures.bode(gyro(), inputs=[7]), "numbers below 5"),
        (lambda: figures.bode(gyro(), loops=True), "a square loop transfer is needed"),
        (lambda: figures.bode([gyro(), 1 / s]), "have different shapes"),
        (lambda: figures.nichols(gyro()), "a square loop transfer is needed"),
        (lambda: figures.nichols(1 / s, disk_margins=2.5), "must be numbers between 0 and 2, got 2.5"),
        (lambda: figures.nichols(1 / s, T_peaks=(0.5,)), "must be numbers above 1, got"),
        (lambda: figures.nichols(1 / s, skew=math.nan), "skew must be a number, got nan"),
        (lambda: figures.singular_values(1 / s, upper=-1.0), "must be a number > 0"),
        (lambda: figures.singular_values(1 / s, upper=([1.0, 2.0], [1.0, 2.0, 3.0])), "must be a number > 0"),
        (lambda: figures.gang_of_four(control.frd([1.0 + 0j], [1.0]), 1 / s), "data cannot be used here"),
        (
            lambda: figures.gang_of_four(control.ss(1 / s), control.c2d(control.ss(1 / s), 0.1)),
            "the same sample period",
        ),
        (lambda: figures.gang_of_four(1 / s, -(1 + s)), "improper"),
        (lambda: figures.Omega_sensitivity(1 / s), "needs Omega1"),
        (lambda: figures.disk_margin_region(-0.1), ">= 0"),
        (lambda: figures.disk_margin_region([]), "give at least one"),
        (lambda: figures.disk_margin_region(0.5, labels=3), "labels must be a sequence of names or None, got 3"),
        (lambda: figures.disk_margin_region(gyro()), "a square loop transfer is needed"),
    ],
)
def test_wrong_input_is_one_line(call, words):
    with pytest.raises(pc.PlatformCtrlError) as told:
        call()
    assert words in str(told.value)
    assert "\n" not in str(told.value)


def test_the_phase_of_a_loop_is_that_next_to_the_critical_point_whatever_turn_it_begins_in() -> None:
    w = np.geomspace(0.01, 100.0, 400)
    loop = 1.0 / (1j * w * (1.0 + 0.3j * w))
    expected = -90.0 - np.degrees(np.arctan(0.3 * w))
    np.testing.assert_allclose(loop_phase(w, loop), expected, atol=1e-9)
    # Two more integrators with their leads turn by nothing at the crossover, but by half a turn far below it.
    more = ((1.0 + 1j * w / 0.05) / (1j * w / 0.05)) ** 2
    at_crossover = np.interp(1.0, w, loop_phase(w, loop * more))
    assert at_crossover == pytest.approx(np.interp(1.0, w, expected), abs=7.0)
    assert loop_phase(w, loop * more)[0] < expected[0] - 150.0
