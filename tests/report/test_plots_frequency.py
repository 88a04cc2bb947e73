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
from platform_ctrl.report.plots.systems import drawn_systems, grid

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


def test_the_grid_comes_close_to_zeros_too():
    [system] = drawn_systems("bode", (s**2 + 2e-7 * s + 4.0) / (s**2 + 0.1 * s + 1.0) / (s + 5.0))
    w, H = system.along(grid([system]))
    assert np.abs(H[0, 0]).min() == pytest.approx(abs(2e-7 * 2.0 / ((-3.0 + 0.2j) * (5.0 + 2.0j))), rel=1e-3)
    assert np.count_nonzero(np.abs(w - 2.0) < 1e-6) > 5


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
    k = np.argmin(np.abs(found.phase_margins))
    assert (found.phase_margins[k], found.gain_crossovers[k]) == pytest.approx((phase_margin, w_gain), rel=1e-6)
    pairs = zip(found.gain_margins, found.phase_crossovers, strict=True)
    assert any(item == pytest.approx((gain_margin, w_phase), rel=1e-6) for item in pairs)


def test_every_crossing_of_a_gain_of_1_is_found_between_points_of_the_grid():
    loop = control.ss(0.02 * (s + 0.5) / (s**2 * (s**2 + 0.002 * s + 1.0)) * (s**2 + 0.002 * s + 4.0))
    [system] = drawn_systems("bode", loop)
    found = margins(curve(system, grid([system], loops=True), "L"))
    assert len(found.gain_crossovers) >= 3
    assert np.abs(analysis.frequency_response(loop, found.gain_crossovers)[0, 0]) == pytest.approx(1.0, rel=1e-9)
    critical = found.gain_margins * analysis.frequency_response(loop, found.phase_crossovers)[0, 0]
    assert critical == pytest.approx(-np.ones(len(critical)), abs=1e-6)


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


# What every plot does


def test_importing_the_plots_does_not_load_pyplot():
    code = "import sys; import platform_ctrl.report.figures; sys.exit('matplotlib.pyplot' in sys.modules)"
    assert subprocess.run([sys.executable, "-c", code], check=False).returncode == 0


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
