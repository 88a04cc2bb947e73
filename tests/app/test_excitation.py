"""What the Disturbance plot shows: sines and commands of manoeuvres, the line of sight, the axis of the job."""

from __future__ import annotations

import math

import numpy as np
import pytest

from camera_job import camera_job
from commanded_gimbal import commanded_job
from platform_ctrl import read_job
from platform_ctrl.app.backend import Backend
from platform_ctrl.job.quantities import HZ

AMPLITUDE, SINE_HZ = 0.1, 5.0


def test_a_sine_ends_in_the_amplitude_that_the_gain_from_the_base_has_at_its_frequency() -> None:
    sine = {"kind": "rate", "axis": 2, "frequency_hz": SINE_HZ, "amplitude": AMPLITUDE}
    run = {"name": "shaken", "mode": "caged", "duration": 2.0, "sine": [sine]}
    backend = Backend(read_job(camera_job(manoeuvre=[run])))
    start = backend.start()
    shown = backend.picture(start)
    backend.close()
    assert start.axis == 2
    over_time, gain = shown.Omega_time, shown.Omega_frequency
    assert (over_time.title, over_time.units[:2]) == ("shaken", ("rad/s", "rad/s"))
    assert over_time.signals[:2] == ("los_rate1", "los_rate2")
    last = over_time.t > 1.2
    wave = np.exp(-2j * math.pi * SINE_HZ * over_time.t[last])
    design = np.stack([wave.real, -wave.imag], axis=1)
    found = [np.hypot(*np.linalg.lstsq(design, one[last], rcond=None)[0]) for one in over_time.values[:2]]
    expected = AMPLITUDE * np.interp(SINE_HZ, gain.frequency * HZ, gain.gain)
    assert np.hypot(*found) == pytest.approx(expected, rel=2e-2)


@pytest.mark.parametrize("kind", ["rate", "pointing"])
def test_a_commanded_reading_ends_at_its_command(kind: str) -> None:
    reading = "gyro" if kind == "rate" else "heading"
    job = commanded_job([{"reading": reading, "step": 0.02, "at": 0.1}], kind=kind)
    job["manoeuvre"][0]["duration"] = 4.0
    backend = Backend(read_job(job))
    shown = backend.picture(backend.start()).Omega_time
    backend.close()
    assert shown.title == "slew"
    assert not shown.values[:, shown.t < 0.1].any()
    assert shown.values[0, -1] == pytest.approx(0.02, rel=1e-2)
    assert shown.drive[-1] == 1.0


def test_a_page_starts_at_the_axis_that_the_job_is_about() -> None:
    turned = {"name": "turn", "mode": "caged", "axis": 3, "rate": 0.1, "rise": 0.1, "hold": 0.1, "duration": 1.0}
    without = camera_job(operation={"Omega": [0.0, 0.2, 0.1]})
    for job, axis in ((camera_job(manoeuvre=[turned]), 3), (without, 2)):
        backend = Backend(read_job(job))
        assert backend.start().axis == axis
        backend.close()
