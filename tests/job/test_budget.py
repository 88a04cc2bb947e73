"""The budget of a job file: what its sources say over frequency, and what is refused."""

from __future__ import annotations

import math
import tomllib
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy import integrate

from every_key import HERE, every_job_key
from platform_ctrl import read_job
from platform_ctrl.analysis.logs import G
from platform_ctrl.common.files import toml
from platform_ctrl.errors import InputError
from platform_ctrl.job.budget import Source
from platform_ctrl.job.reading import job_data
from platform_ctrl.job.spectra import (
    SPECTRA,
    HarmonicSpectrum,
    ProfileSpectrum,
    SineSpectrum,
    TableSpectrum,
)

TABLE = TableSpectrum(frequencies_hz=[1.0, 10.0, 100.0], densities=[1.0, 0.01, 0.02])
ROLL, PITCH, ENGINE, MOTOR, YAW = range(5)


def base_rate(spectrum: Any, unit: str | None = None) -> Source:
    return Source(name="base", kind="base-rate", axis=1, unit=unit, spectrum=spectrum)


def refusal(change: dict[str, Any], source: int | None = None, *without: str) -> str:
    """Return the message about a job whose budget, or a source of it, has other values."""
    data = every_job_key()
    table = data["budget"] if source is None else data["budget"]["source"][source]
    for key in without:
        del table[key]
    table |= change
    with pytest.raises(InputError) as error:
        read_job(data, folder=HERE)
    message = str(error.value)
    assert "\n" not in message
    return message


def test_a_table_is_straight_on_logarithmic_scales_and_zero_outside() -> None:
    np.testing.assert_allclose(TABLE.density([1.0, math.sqrt(10.0), 10.0, 100.0]), [1.0, 0.1, 0.01, 0.02], rtol=1e-12)
    assert TABLE.density([0.999, 100.1]).tolist() == [0.0, 0.0]
    linear = TableSpectrum(frequencies_hz=[1.0, 3.0], densities=[2.0, 4.0], interpolation="linear")
    assert linear.density(2.0) == 3.0
    assert linear.mean_square(0.0, 10.0) == pytest.approx(6.0, rel=1e-12)


@pytest.mark.parametrize("spectrum", [TABLE, ProfileSpectrum(profile="jet-fuselage", scale=0.5)])
def test_the_mean_square_is_the_integral_of_the_density(spectrum: Any) -> None:
    knots = spectrum.knots_hz
    low, high = 1.5 * knots[0], 0.7 * knots[-1]
    integral, _ = integrate.quad(spectrum.density, low, high, points=knots[1:-1], epsrel=1e-12, limit=200)
    assert spectrum.mean_square(low, high) == pytest.approx(integral, rel=1e-9)


def test_sines_have_half_their_squared_amplitude() -> None:
    sines = SineSpectrum(sines=[[10.0, 3.0, 0.1], [20.0, 4.0, 0.0]])
    assert sines.mean_square(0.0, 15.0) == 4.5
    assert sines.mean_square(0.0, 30.0) == 12.5
    assert not sines.density([10.0]).any()


def test_harmonics_of_a_motor_keep_their_mean_square_where_its_rate_has_a_range() -> None:
    rows = [[6.0, 2.0], [7.0, 1.0]]
    steady = HarmonicSpectrum(harmonics=rows, turning_rate=(10.0, 10.0))
    np.testing.assert_allclose(steady.lines.frequencies_hz, [60.0 / (2 * math.pi), 70.0 / (2 * math.pi)])
    assert steady.lines.phases is None
    assert not steady.knots_hz.size
    turning = HarmonicSpectrum(harmonics=rows, turning_rate=(8.0, 12.0))  # their bands overlap
    assert not turning.lines.frequencies_hz.size
    assert turning.mean_square(0.0, 100.0) == pytest.approx(steady.mean_square(0.0, 100.0), rel=1e-12) == 2.5
    assert turning.density(np.array([40.0, 90.0]) / (2 * math.pi)).tolist() == [0.0, 0.0]


def test_a_unit_scales_amplitudes_and_densities() -> None:
    degrees, radians = base_rate(TABLE, "deg/s"), base_rate(TABLE)
    np.testing.assert_allclose(degrees.density([2.0]), radians.density([2.0]) * math.radians(1.0) ** 2, rtol=1e-12)
    assert degrees.rms(1.0, 50.0) == pytest.approx(math.radians(radians.rms(1.0, 50.0)), rel=1e-12)
    sines = base_rate(SineSpectrum(sines=[[1.0, 180.0, 0.0]]), "deg/s")
    assert sines.lines.amplitudes[0] == pytest.approx(math.pi, rel=1e-15)


# Overall rms, g, that standards state with these tables.
STATED = {"vertical": 1.04, "transverse": 0.204, "longitudinal": 0.740}
STATED = {f"highway-truck-{axis}": rms for axis, rms in STATED.items()} | {"jet-fuselage": 1.48}


@pytest.mark.parametrize("profile", STATED)
def test_a_profile_has_the_rms_that_its_standard_states(profile: str) -> None:
    table = ProfileSpectrum(profile=profile)
    assert math.sqrt(table.mean_square(0.0, 1e4)) == pytest.approx(STATED[profile] * G, rel=6e-3)


def test_the_micro_vibration_of_olympus_is_16_microradians_of_angle() -> None:
    spectrum = ProfileSpectrum(profile="olympus-satellite")
    f = np.geomspace(0.011, 499.0, 400)
    np.testing.assert_allclose(spectrum.density(f) / (2 * np.pi * f) ** 2, 160e-12 / (1 + f**2), rtol=5e-4)
    angle = math.sqrt(integrate.quad(lambda x: 160.0 / (1.0 + x * x), 0.0, math.inf)[0])
    assert angle == pytest.approx(16.0, rel=0.01)


def test_a_budget_is_written_back_to_the_last_bit() -> None:
    data = job_data(read_job(every_job_key(), folder=HERE))
    assert job_data(read_job(tomllib.loads(toml(data)))) == data
    assert {len(set(source) & set(SPECTRA)) for source in data["budget"]["source"]} == {1}


def test_a_density_from_a_file_is_the_table_in_it(tmp_path: Path) -> None:
    (tmp_path / "wind.csv").write_text("frequency_hz,density\n0.5,1e-2\n5,1e-4\n50,1e-7\n", encoding="utf-8")
    data = every_job_key() | {"plant": "every_plant_key.toml"}
    own = {"name": "wind", "kind": "base-rate", "axis": 3, "psd": str(tmp_path / "wind.csv")}
    data["budget"] = {"from_hz": 1.0, "to_hz": 50.0, "source": [own]}
    job = read_job(data, folder=HERE)
    assert job.budget is not None
    table = TableSpectrum(frequencies_hz=[0.5, 5.0, 50.0], densities=[1e-2, 1e-4, 1e-7])
    assert job.budget.sources[0].rms(1.0, 50.0) == math.sqrt(table.mean_square(1.0, 50.0))
    data["budget"]["source"] = [own | {"psd": "none.csv"}]
    with pytest.raises(InputError, match=r'source\]\] 1 "wind": psd: .*none.csv: there is no such file'):
        read_job(data, folder=HERE)


def logged(tmp_path: Path, mean: float, amplitude: float, column: str = "x", **source: Any) -> str:
    """Return the message about a budget of one log: 5 s of a sine of 3 Hz about a mean."""
    t = np.arange(500) * 0.01
    x = mean + amplitude * np.sin(2 * np.pi * 3.0 * t)
    lines = [f"{one:.2f},{value:.9g}" for one, value in zip(t, x, strict=True)]
    (tmp_path / "log.csv").write_text("\n".join([f"time,{column}", *lines]) + "\n", encoding="utf-8")
    data = every_job_key() | {"plant": "every_plant_key.toml"}
    own = {"name": "log", "axis": 3, "log": str(tmp_path / "log.csv"), "column": column}
    data["budget"] = {"from_hz": 1.0, "to_hz": 50.0, "source": [own | source]}
    try:
        job = read_job(data, folder=HERE)
    except InputError as error:
        return str(error)
    again = read_job(tomllib.loads(toml(job_data(job))))
    assert job.budget is not None
    assert again.budget is not None
    found = job.budget.sources[0].rms(0.5, 50.0)
    assert again.budget.sources[0].rms(0.5, 50.0) == pytest.approx(found, rel=1e-12)
    return f"{found:.4g}"


def test_a_log_becomes_its_spectrum_when_the_job_is_read(tmp_path: Path) -> None:
    assert logged(tmp_path, 0.2, 2.0, kind="base-rate") == f"{math.sqrt(2.0):.4g}"
    assert logged(tmp_path, 0.2, 2.0, kind="base-rate", unit="deg/s") == f"{math.radians(math.sqrt(2.0)):.4g}"
    assert logged(tmp_path, 1.0, 0.1, kind="specific-force", unit="g") == f"{0.1 * G / math.sqrt(2.0):.4g}"


@pytest.mark.parametrize(
    ("column", "source", "size"),
    [
        ("x_dps", {"kind": "base-rate"}, math.pi / 180.0),
        ("x_g", {"kind": "specific-force"}, G),
        ("x_g", {"kind": "base-rate", "unit": "rad/s"}, 1.0),  # whoever states a unit knows better
    ],
)
def test_a_column_of_a_log_has_the_unit_of_its_name(
    column: str, source: dict[str, Any], size: float, tmp_path: Path
) -> None:
    assert logged(tmp_path, 1.0, 2.0, column, **source) == f"{size * math.sqrt(2.0):.4g}"


def test_a_column_in_another_unit_than_its_source_is_refused(tmp_path: Path) -> None:
    twice = logged(tmp_path, 0.2, 2.0, "x_dps", kind="base-rate", unit="rad/s")
    assert 'column: "x_dps" is in deg/s by its name, and unit = "rad/s" contradicts it' in twice
    wrong = logged(tmp_path, 0.2, 2.0, "x_g", kind="base-rate")
    assert 'column: "x_g" is in g by its name, and kind = "base-rate" needs rate' in wrong


def test_gravity_in_g_is_not_taken_for_si(tmp_path: Path) -> None:
    gravity = logged(tmp_path, -1.0, 0.1, kind="specific-force")
    assert (
        'unit: the mean of "x" is -1, which looks like gravity in g; write unit = "g", or unit = "m/s2" if' in gravity
    )
    assert logged(tmp_path, -1.0, 0.1, kind="specific-force", unit="m/s2") == "0.07071"


def test_what_is_wrong_with_a_log_is_said_at_its_key(tmp_path: Path) -> None:
    assert "needs 10 s without a gap, and the longest piece is" in refusal({"from_hz": 0.1})
    assert "the signal does not vary" in logged(tmp_path, 0.5, 0.0, kind="base-rate")


def test_a_specific_force_without_unbalance_is_refused() -> None:
    data = job_data(read_job(every_job_key(), folder=HERE))
    plant = data["plant"]
    plant["unbalance"], plant["mode"] = [], []
    for part in (plant["root"], *plant["gimbal"], *plant["rotor"]):
        for key in ("mass", "centre", "origin"):
            part.pop(key, None)
    with pytest.raises(InputError, match="moves the line of sight by unbalance, and the plant has none; add"):
        read_job(data)


def test_correlations_that_no_signals_have_are_refused() -> None:
    pairs = (("vehicle roll", "engine"), ("vehicle pitch", "engine"), ("vehicle roll", "vehicle pitch"))
    phases = (0.0, 0.0, math.pi)
    table = [
        {"between": list(pair), "coherence": 1.0, "phase": phase} for pair, phase in zip(pairs, phases, strict=True)
    ]
    assert "no signals have these coherences together" in refusal({"correlation": table})
