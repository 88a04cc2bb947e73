"""Torques from outside on gimbals in runs, as of wind: densities, sines, tables and recorded logs; what they excite."""

import dataclasses
from typing import Any

import numpy as np
import pytest

import platform_ctrl as pc
from platform_ctrl import simulation
from platform_ctrl.errors import InputError

J, FIRST, DAMPING, PHI, SEEN = 2.0, 9.0, 0.02, 0.8, 0.5
PLANT = {
    "schema": 1,
    "name": "mast",
    "source": "assumed",
    "root": {"name": "ground", "inertia": [9.0, 9.0, 9.0]},
    "gimbal": [{"name": "pan", "parent": "ground", "axis": [0, 0, 1], "inertia": [J, J, J], "angle": "q"}],
    "torquer": [{"gimbal": "pan"}, {"gimbal": "pan", "name": "second"}],
    "pickoff": [{"gimbal": "pan"}],
    "line_of_sight": {"body": "pan", "direction": [1, 0, 0]},
}
MODE = {
    "name": "sway",
    "frequency_hz": FIRST,
    "damping": DAMPING,
    "participation": {"Qpan": PHI, "q": SEEN, "second": 3.0},
}


DATA = {
    "schema": 2,
    "name": "wind",
    "plant": PLANT,
    "operation": {"Omega": [0.1, 0.1, 0.1]},
    "sampling": {"rate_hz": 500, "delay": 0.0},
    "loop": [
        {
            "name": "pan",
            "kind": "caging",
            "gimbals": ["pan"],
            "use": "c",
            "design": [{"name": "c", "method": "classical"}],
        }
    ],
}


def job(torque, mode=False, folder=None, **more):
    run = {"name": "wind", "mode": "caged", "duration": 2.0, "torque": torque} | more
    plant = PLANT | ({"mode": [MODE]} if mode else {})
    return pc.read_job(DATA | {"plant": plant, "manoeuvre": [run]}, folder=folder)


def run(torque, mode=False, **more):
    """A run without any loop."""
    one = job(torque, mode, **more)
    return simulation.simulate(one.scenario(one.manoeuvres[0]), [], period=0.002, step=1e-3)


def test_a_table_is_what_the_gimbal_integrates_twice():
    """J q'' = τ: 3 N m that fall to zero within 1 s are 3 t²/2 − t³/2 over J, and then go on evenly."""
    found = run([{"gimbal": "pan", "t": [0.0, 1.0], "value": [3.0, 0.0]}])
    t = np.minimum(found.t, 1.0)
    expected = (1.5 * t**2 - 0.5 * t**3) / J + 1.5 / J * np.maximum(found.t - 1.0, 0.0)
    assert np.abs(found.q[:, 0] - expected).max() < 1e-9


def test_tables_add_to_one_another_and_to_a_smooth_table_of_the_root():
    """The plant is linear about one axis: the motion is the sum of both, and Omega is the spline that was given."""
    smooth = {"t": [0.0, 0.7, 1.3, 2.0], "Omega3": [0.0, 0.05, -0.05, 0.0], "smooth": True}
    pushes = [
        {"gimbal": "pan", "t": [0.25, 0.5], "value": [0.0, 0.2]},
        {"gimbal": "pan", "t": [1.0, 1.1], "value": [0.0, -0.2]},
    ]
    both, still = run(pushes, Omega_table=smooth), run(pushes)
    turned = run([{"gimbal": "pan", "t": [0.0, 2.0], "value": [0.0, 1e-9]}], Omega_table=smooth)
    assert np.abs(both.q - still.q - turned.q).max() < 1e-9
    table = job(pushes, Omega_table=smooth).manoeuvres[0].Omega_table
    assert turned.Omega[:, 2] == pytest.approx(table.at(turned.t)[:, 2], abs=1e-12)


def test_a_log_is_played_in_the_unit_of_its_column(tmp_path):
    t = np.arange(0.0, 2.001, 0.01)
    rows = "\n".join(f"{100 + x:.2f},{1e3 * np.sin(3 * x):.9g}" for x in t)
    (tmp_path / "gust.csv").write_text(f"time,wind_mNm\n{rows}\n")
    found = run([{"gimbal": "pan", "log": "gust.csv", "column": "wind_mNm"}], folder=tmp_path)
    expected = (found.t / 3.0 - np.sin(3.0 * found.t) / 9.0) / J
    assert np.abs(found.q[:, 0] - expected).max() < 1e-4 * expected.max()
    (tmp_path / "gyro.csv").write_text(f"time,gyro_z_dps\n{rows}\n")
    with pytest.raises(InputError, match='column "gyro_z_dps" is in deg/s by its name; name a column of a torque'):
        run([{"gimbal": "pan", "log": "gyro.csv", "column": "gyro_z_dps"}], folder=tmp_path)


def test_a_density_from_a_file_is_that_of_a_vibration(tmp_path):
    (tmp_path / "wind.csv").write_text("frequency_hz,density\n0.5,1e-2\n5,1e-4\n50,1e-7\n")
    f, S = [0.5, 5.0, 50.0], [1e-2, 1e-4, 1e-7]
    found = run([{"gimbal": "pan", "psd": "wind.csv"}], folder=tmp_path)
    stated = run([{"gimbal": "pan", "frequencies_hz": f, "densities": S}])
    vibration = {"kind": "torque", "gimbal": "pan", "frequencies_hz": f, "densities": S}
    old = job([{"gimbal": "pan", "amplitude": 1.0, "frequency_hz": 1.0}], vibration=[vibration])
    scenario = dataclasses.replace(old.scenario(old.manoeuvres[0]), sines=())
    same = simulation.simulate(scenario, [], period=0.002, step=1e-3)
    assert np.array_equal(found.q, stated.q)
    assert np.array_equal(found.q, same.q)


def test_wind_excites_a_mode_as_the_first_torquer_on_its_gimbal_does():
    """A sine: η is a linear oscillator under φ τ, and the pick-off reads q + φ_s η."""
    T, f = 0.3, 4.0
    found = run([{"gimbal": "pan", "amplitude": T, "frequency_hz": f}], mode=True)
    s, w0, t = 2.0 * np.pi * f, 2.0 * np.pi * FIRST, found.t
    # Response to T sin(s t) from rest, of q and of the mode.
    q = T / J * (t / s - np.sin(s * t) / s**2)
    d, wd = DAMPING * w0, w0 * np.sqrt(1.0 - DAMPING**2)
    G = PHI * T / (w0**2 - s**2 + 2j * d * s)
    x0, v0 = -G.imag, -s * G.real
    eta = np.imag(G * np.exp(1j * s * t)) + np.exp(-d * t) * (x0 * np.cos(wd * t) + (v0 + d * x0) / wd * np.sin(wd * t))
    assert np.abs(found.q[:, 0] - q).max() < 1e-6 * np.abs(q).max()
    assert np.abs(found.reading[:, 0] - found.q[:, 0] - SEEN * eta).max() < 2e-4 * np.abs(SEEN * eta).max()


def wind_job() -> dict[str, Any]:
    """The job with a run, for the table of wrong inputs."""
    return DATA | {"manoeuvre": [{"name": "wind", "mode": "caged", "duration": 2.0, "torque": []}]}
