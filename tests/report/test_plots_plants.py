"""The Campbell diagram, against the poles of the model at each speed."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

import platform_ctrl as pc
from plant_parts import Spring
from platform_ctrl.report import figures

HZ = 1.0 / (2.0 * np.pi)
RPM = 60.0 * HZ


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
        if line.get_color() in {handle.get_color() for handle in legend.legend_handles} and len(line.get_xdata()) > 10
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
