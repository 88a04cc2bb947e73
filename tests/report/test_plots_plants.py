"""Plots of plants and runs for scripts: Campbell diagram, simulated runs, campaigns, windows."""

from __future__ import annotations

import dataclasses

import control
import numpy as np
import pytest
from matplotlib.colors import to_hex

import platform_ctrl as pc
from plant_parts import Spring
from platform_ctrl.campaign.statistics import statistics
from platform_ctrl.job.manoeuvre import Manoeuvre
from platform_ctrl.report import figures, style
from platform_ctrl.report.style import BEYOND, LIMIT, SERIES
from single_runs import simulated

HZ = 1.0 / (2.0 * np.pi)
RPM = 60.0 * HZ


@pytest.fixture(autouse=True)
def no_figures_of_other_tests():
    from matplotlib import pyplot

    pyplot.close("all")


@pytest.fixture(scope="module")
def three():
    return pc.read_platform("three_gyro_platform")


@pytest.fixture(scope="module")
def gyro():
    return pc.read_platform("gimballed_gyro")


def on_springs(platform, stiffness=200.0):
    return dataclasses.replace(
        platform, springs=tuple(Spring(gimbal=name, stiffness=stiffness) for name in platform.gimbal_names)
    )


def curves(figure):
    """Lines of the modes by the words of the legend."""
    [legend] = figure.legends
    [axes] = figure.axes
    by_colour = {
        line.get_color(): (np.asarray(line.get_xdata()), np.asarray(line.get_ydata()))
        for line in axes.lines
        if line.get_color() in SERIES and len(line.get_xdata()) > 10
    }
    return {
        text.get_text(): by_colour[handle.get_color()]
        for text, handle in zip(legend.get_texts(), legend.legend_handles, strict=True)
    }


def diamonds(axes):
    return [(float(line.get_xdata()[0]), float(line.get_ydata()[0])) for line in axes.lines if line.get_marker() == "D"]


def written(figure):
    return [text.get_text() for axes in figure.axes for text in axes.texts]


def test_nutation_at_nominal_speed_is_the_model_s_pole(three):
    found = curves(figures.campbell(three))
    for group in (("4", "5", "7"), ("9", "10")):
        fastest = np.abs(pc.state_space(pc.linearise(three), gimbals=group).poles()).max()
        [(name, (rpm, hz))] = [item for item in found.items() if item[0].startswith(f"nutation of {'-'.join(group)}:")]
        assert np.interp(1250.0 * RPM, rpm, hz) == pytest.approx(fastest * HZ, rel=1e-4)
        assert f"{fastest * HZ:.3g} Hz at nominal speed" in name


def test_every_mode_of_a_chart_is_a_pole_of_the_model_at_that_speed(gyro):
    sprung = on_springs(gyro)
    for share in (0.4, 1.3):
        [rotor] = sprung.rotors
        slower = dataclasses.replace(
            sprung, rotors=(dataclasses.replace(rotor, angular_momentum=share * rotor.angular_momentum),)
        )
        poles = np.abs(pc.state_space(pc.linearise(slower)).poles().imag) * HZ
        for rpm, hz in curves(figures.campbell(sprung)).values():
            assert np.abs(poles - np.interp(share * rotor.spin * RPM, rpm, hz)).min() < 0.01


def test_a_spin_line_meets_a_mode_where_frequency_is_a_multiple_of_the_speed(gyro):
    sprung = on_springs(gyro)
    figure = figures.campbell(sprung, orders=(1, 2))
    [axes] = figure.axes
    met = diamonds(axes)
    assert len(met) == 4
    for rpm, hz in met:
        order = hz * 60.0 / rpm
        assert min(abs(order - 1.0), abs(order - 2.0)) < 1e-9
        away = [abs(np.interp(rpm, x, y) - hz) for x, y in curves(figure).values()]
        assert min(away) < 1e-3 * hz
    assert sum(text.endswith(" rpm") for text in written(figure)) == 4


@pytest.fixture(scope="module")
def flown(gyro):
    turn = pc.simulation.HalfCosine(axis=1, rate=0.01, rise=0.01, hold=0.0)
    return simulated(gyro, [], period=0.001, delay=0.0, duration=0.05, mode="caged", profile=turn, noise=False)


def shaded(axes):
    """The edges of the shaded regions that are not at infinity."""
    edges = []
    for patch in axes.patches:
        if to_hex(patch.get_facecolor()) == BEYOND:
            bottom, top = patch.get_y(), patch.get_y() + patch.get_height()
            edges.append(min((bottom, top), key=abs))
    return sorted(edges)


def test_a_run_is_shaded_beyond_the_limits_of_its_manoeuvre(flown, gyro):
    from platform_ctrl.verification.simulated import Run

    limit = 1.5 * float(np.abs(flown.q).max())
    manoeuvre = Manoeuvre(name="turn", mode="caged", duration=0.05, limits={"angle": limit})
    figure = figures.time_run(Run(manoeuvre=manoeuvre, trajectory=flown, results=()), gyro)
    scale = {"mrad": 1e3, "µrad": 1e6}[figure.axes[0].get_ylabel()]
    assert shaded(figure.axes[0]) == pytest.approx([-scale * limit, scale * limit])
    assert figure.axes[0].get_xlim() == (0.0, 0.05)


def table(runs=200):
    rng = np.random.default_rng(3)
    angle = 1e-3 * (1.0 + 0.2 * rng.standard_normal(runs))
    return {
        "run": np.arange(runs),
        "manoeuvre": np.array(["turn"] * runs, dtype=object),
        "angle": angle,
        "attitude": np.zeros(runs),
        "torque_share": np.full(runs, 0.5),
        "angle_passed": angle <= 1.2e-3,
        "passed": angle <= 1.2e-3,
        "ended": np.array(["completed"] * runs, dtype=object),
    }


LIMITS = {"turn": {"angle": 1.2e-3}}


def test_histograms_count_every_run_and_colour_those_beyond_the_limit():
    columns = table()
    beyond = int(np.count_nonzero(columns["angle"] > 1.2e-3))
    figure = figures.campaign_histograms(statistics(columns, LIMITS))
    [axes] = [axes for axes in figure.axes if axes.get_visible()]
    stairs = {to_hex(patch.get_facecolor()): patch.get_data() for patch in axes.patches if hasattr(patch, "get_data")}
    assert stairs[SERIES[0]].values.sum() == 200
    assert abs(stairs[LIMIT].values.sum() - beyond) <= 1
    assert f"{beyond} beyond" in written(figure)
    [start] = [patch.get_x() for patch in axes.patches if to_hex(patch.get_facecolor()) == BEYOND]
    assert start == pytest.approx(1.2)


def test_pyplot_knows_the_plots_of_scripts_and_those_of_pages_not(gyro):
    from matplotlib import pyplot

    assert pyplot.get_fignums() == []
    loop = figures.nichols(control.tf([1.0], [1.0, 1.0])).figure
    assert [pyplot.figure(number) for number in pyplot.get_fignums()] == [loop]
    bode = figures.bode(control.tf([1.0], [1.0, 1.0])).figure
    assert bode is not loop
    with style.settings():
        figures.campbell(gyro)
    assert len(pyplot.get_fignums()) == 2
