"""Every entry of a legend looks as its curve does; a signal has one colour in all plots."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import control
import pytest
from matplotlib.colors import to_hex
from matplotlib.figure import Figure

import platform_ctrl as pc
from legend_entries import without_a_curve
from platform_ctrl.plant.drawing import signal_series
from platform_ctrl.plant.platform import Platform
from platform_ctrl.report import figures
from platform_ctrl.report.style import SERIES
from single_runs import simulated

# A loop with delay-like lag, the same with less gain, and a plant of two inputs and outputs.
FAST = control.ss(control.tf([40.0, 80.0], [1.0, 12.0, 20.0, 0.0]))
SLOW = control.ss(control.tf([15.0, 40.0], [1.0, 12.0, 20.0, 0.0]))
LOOPS = {"fast": FAST, "slow": SLOW}
STABLE = {"one": control.ss(control.tf([1.0, 3.0], [1.0, 2.0, 5.0])), "two": control.ss(control.tf([2.0], [1.0, 1.0]))}
PID = control.ss(control.tf([1.0, 2.0], [0.01, 1.0]))
PLANT = control.ss(control.tf([20.0], [1.0, 2.0, 1.0]))


@pytest.fixture(scope="module")
def platform() -> Platform:
    return pc.read_platform("three_gyro_platform")


PLOTS: dict[str, Callable[[], Any]] = {
    "nichols": lambda: figures.nichols(LOOPS),
    "disk margin": lambda: figures.disk_margin_region(LOOPS),
    "root locus": lambda: figures.root_locus(PLANT, PID),
}


def figure_of(plot: Any) -> Figure:
    return plot if isinstance(plot, Figure) else plot.figure


@pytest.mark.parametrize("name", PLOTS)
def test_every_legend_entry_of_a_plot_looks_like_a_curve_that_is_drawn(name: str) -> None:
    drawn = figure_of(PLOTS[name]())
    assert drawn.legends
    assert without_a_curve(drawn) == []


def test_each_signal_has_one_colour_and_a_torque_that_of_its_angle(platform: Platform) -> None:
    series = signal_series(platform)
    for gimbal in platform.gimbal_names:
        assert series[platform.torquer_on(gimbal).name] == series[platform.angle_names[platform.gimbal(gimbal)]]
    places = [series[name] for name in (*platform.angle_names, "attitude1", "attitude2", "attitude3")]
    assert len(set(places)) == len(places) == 8
    assert [series[f"M{k}"] for k in (1, 2, 3)] == [series[f"attitude{k}"] for k in (1, 2, 3)]


def test_a_recorded_run_has_the_colours_of_its_signals_in_every_panel(platform: Platform) -> None:
    series = signal_series(platform)
    run = simulated(
        platform,
        [],
        period=1e-3,
        delay=0.0,
        duration=0.01,
        mode="stabilised",
        torque=[0.01, 0.0, 0.0],
        noise=False,
    )
    drawn = figures.time_run(run, platform)
    seen: dict[str, str] = {}
    for axes in drawn.axes:
        legend = axes.get_legend()
        if legend is None:
            continue
        for text, line in zip(legend.get_texts(), legend.get_lines(), strict=True):
            seen[text.get_text()] = to_hex(line.get_color())
    assert {name: seen[name] for name in platform.angle_names} == {
        name: SERIES[series[name]] for name in platform.angle_names
    }
    assert seen["θ₂"] == seen["Ω₂"] == seen["M2"] == SERIES[series["M2"]]
    assert without_a_curve(drawn) == []


def test_a_sensor_on_a_body_has_the_colour_of_the_gimbal_that_turns_it_about_its_axis() -> None:
    camera = pc.read_platform("camera_gimbal")
    series = signal_series(camera)
    assert series["yaw_rate"] == series["azimuth"] != series["elevation"] == series["pitch_rate"]
    tracker = signal_series(pc.read_platform("seeker_head"))
    assert tracker["track_pitch"] == tracker["pitch"] != tracker["yaw"] == tracker["gyro_yaw"]
