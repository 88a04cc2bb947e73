"""Sources of a budget over frequency, recorded logs that become them or tables of time, and what is refused."""

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
from platform_ctrl.analysis.logs import G, log_density, pieces, read_log
from platform_ctrl.common.files import toml
from platform_ctrl.errors import ArgumentError, InputError
from platform_ctrl.job.budget import Source
from platform_ctrl.job.reading import job_data
from platform_ctrl.job.spectra import (
    SPECTRA,
    HarmonicSpectrum,
    LogSpectrum,
    ProfileSpectrum,
    SineSpectrum,
    TableSpectrum,
)
from platform_ctrl.simulation import TimeTable, Vibration
from vehicle_log import FILE

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


RATE = 400.0
KNOWN = TableSpectrum(frequencies_hz=[0.5, 5.0, 40.0, 150.0], densities=[1e-3, 1e-3, 1e-5, 1e-7])


def recorded(seconds: float, jitter: float = 0.0, seed: int = 1) -> tuple[np.ndarray, np.ndarray]:
    """Return stamps and a random signal of the known density, exact at the stamps: a sum of sines."""
    random = np.random.default_rng(seed)
    shake = Vibration(kind="rate", axis=1, frequencies_hz=KNOWN.frequencies_hz, densities=KNOWN.densities, lines=2048)
    omega, amplitude = shake.amplitudes
    time = np.arange(0.0, seconds, 1.0 / RATE)
    time = time + jitter / RATE * random.uniform(-0.5, 0.5, len(time))
    phase = random.uniform(0.0, 2.0 * np.pi, len(omega))
    x = np.zeros(len(time))
    for chunk in np.array_split(np.arange(len(omega)), 64):
        x += amplitude[chunk] @ np.cos(np.outer(omega[chunk], time) + phase[chunk, None])
    return time, x


@pytest.fixture(scope="module")
def uniform() -> tuple[np.ndarray, np.ndarray]:
    return recorded(60.0)


@pytest.fixture(scope="module")
def jittered() -> tuple[np.ndarray, np.ndarray]:
    return recorded(60.0, jitter=0.6)


def write(path: Path, *lines: str) -> Path:
    path.write_text("\n".join(["time,rate", *lines]) + "\n", encoding="utf-8")
    return path


def ramp(count: int = 40) -> list[str]:
    return [f"{0.01 * k:.2f},{math.sin(k):.6f}" for k in range(count)]


def test_the_integral_of_the_density_is_the_variance(uniform: tuple[np.ndarray, np.ndarray]) -> None:
    time, x = uniform
    found = log_density(time, x, 0.5)
    assert np.trapezoid(found.densities, found.frequencies_hz) == pytest.approx(np.var(x), rel=1e-9)
    assert found.variance == pytest.approx(KNOWN.mean_square(0.0, 200.0), rel=0.1)
    assert found.lost == pytest.approx(0.0, abs=1e-9)


@pytest.mark.parametrize("clock", ["uniform", "jittered"])
def test_a_known_density_is_found_within_its_statistical_bounds(clock: str, request: pytest.FixtureRequest) -> None:
    found = log_density(*request.getfixturevalue(clock), 1.0)
    f = found.frequencies_hz
    inside = (f > 2.0) & (f < 100.0)
    ratio = found.densities[inside] / KNOWN.density(f[inside])
    # Each is a chi-squared variable of about 2 x segments degrees of freedom (fewer: segments overlap by half).
    deviation = math.sqrt(1.0 / (found.segments / 1.2))
    assert np.mean(ratio) == pytest.approx(1.0, abs=0.05)
    assert np.std(ratio) < 1.3 * deviation
    assert np.abs(ratio - 1.0).max() < 5.0 * deviation


def test_a_fine_resolution_is_averaged_over_bands_of_one_percent(uniform: tuple[np.ndarray, np.ndarray]) -> None:
    time, x = uniform
    found = log_density(time, x, 0.05)  # 20 s, 8,000 samples of a segment
    f = found.frequencies_hz
    assert f[1] == pytest.approx(0.05, rel=1e-9)
    np.testing.assert_allclose(np.diff(f)[:190], 0.05, rtol=1e-9)
    assert np.max(np.diff(f)[300:-1] / f[300:-2]) < 0.0101
    assert len(f) < 600
    spectrum = LogSpectrum(log="x", column="x", estimate=found)
    assert spectrum.mean_square(2.0, 100.0) == pytest.approx(KNOWN.mean_square(2.0, 100.0), rel=0.05)
    assert np.trapezoid(found.densities, f) == pytest.approx(np.var(x), rel=1e-9)


def test_gaps_are_left_out_and_the_share_that_is_lost_is_stated(uniform: tuple[np.ndarray, np.ndarray]) -> None:
    time, x = uniform
    kept = ~(((time > 20.0) & (time < 26.0)) | ((time > 40.0) & (time < 40.1)))
    assert [part.stop - part.start for part in pieces(time[kept])] == [8001, 5601, 7960]
    found, whole = log_density(time[kept], x[kept], 0.5), log_density(time, x, 0.5)
    assert found.lost == pytest.approx((6.0 + 0.1) / 60.0, abs=1e-4)
    inside = (whole.frequencies_hz > 2.0) & (whole.frequencies_hz < 100.0)
    here = np.interp(whole.frequencies_hz[inside], found.frequencies_hz, found.densities)
    assert np.mean(here / whole.densities[inside]) == pytest.approx(1.0, abs=0.1)
    # A lost sample is no gap: the curve is drawn through.
    single = np.delete(time, 5000), np.delete(x, 5000)
    assert len(pieces(single[0])) == 1
    assert log_density(*single, 0.5).lost == pytest.approx(0.0, abs=1e-4)


def test_a_time_table_of_a_log_with_a_gap_is_refused() -> None:
    with pytest.raises(InputError, match=r"has a gap from 3\.98\d* to 4\.30\d* s; give a part of the log without gaps"):
        TimeTable.from_log(FILE, (None, None, "gyro_z"))
    with pytest.raises(ArgumentError, match="columns must be three, not all of them None"):
        TimeTable.from_log(FILE, ("gyro_z",))


def test_a_log_without_gaps_becomes_a_time_table(tmp_path: Path) -> None:
    path = write(tmp_path / "log.csv", *(f"{5.0 + 0.01 * k:.2f},{k}" for k in range(40)))
    table = TimeTable.from_log(path, (None, "rate", None), factor=0.5)
    np.testing.assert_allclose(table.at([0.0, 0.005, 0.39]), [[0, 0, 0], [0, 0.25, 0], [0, 19.5, 0]], atol=1e-9)


def recorded_log(path: Path, time: str, seconds: float, columns: str = "rate", rate: float = 400.0) -> Path:
    """Write 2 s of values 0, 1, 2, ... on a clock whose unit is so many seconds."""
    stamps = (f"{k / rate / seconds:.9g}" for k in range(int(2.0 * rate)))
    values = (",".join(str(k) for _ in columns.split(",")) for k in range(int(2.0 * rate)))
    path.write_text("\n".join([f"{time},{columns}", *(",".join(row) for row in zip(stamps, values, strict=True))]))
    return path


@pytest.mark.parametrize(
    ("name", "unit"), [("time_s", 1.0), ("Time [ms]", 1e-3), ("time (us)", 1e-6), ("time_nsec", 1e-9), ("TimeUS", 1e-6)]
)
def test_a_column_of_time_is_read_in_the_unit_of_its_name(name: str, unit: float, tmp_path: Path) -> None:
    path = recorded_log(tmp_path / "log.csv", name, unit)
    for given_name in ({}, {"time": name}):
        table = TimeTable.from_log(path, (None, "rate", None), **given_name)
        np.testing.assert_allclose(table.t, np.arange(800) / 400.0, rtol=0.0, atol=1e-8)


def test_units_that_contradict_each_other_are_refused(tmp_path: Path) -> None:
    path = recorded_log(tmp_path / "log.csv", "time", 1.0, "a_dps,b_Nm,c_deg")
    with pytest.raises(ArgumentError, match='column "a_dps" is in deg/s by its name, and factor = 1 contradicts it'):
        TimeTable.from_log(path, ("a_dps", None, None), factor=1.0)
    with pytest.raises(InputError, match=r'column "a_dps" is in deg/s .* and column "b_Nm" is in N m'):
        TimeTable.from_log(path, ("a_dps", "b_Nm", None))
    with pytest.raises(InputError, match='column "c_deg" is in deg by its name; name a column of a rate or a torque'):
        TimeTable.from_log(path, ("c_deg", None, None))


def test_a_piece_that_is_too_short_for_the_resolution_is_refused() -> None:
    time, x = np.arange(100) * 0.01, np.sin(np.arange(100))
    with pytest.raises(ArgumentError, match=r"0\.1 Hz needs 10 s without a gap, and the longest piece is 1 s; take 1 "):
        log_density(time, x, 0.1)
    with pytest.raises(ArgumentError, match="does not vary, it is 3 throughout; choose another column"):
        log_density(time, np.full(100, 3.0), 2.0)


@pytest.mark.parametrize(
    ("line", "says"),
    [
        ("0.105,nan", "line 13: rate is nan; leave such lines out, which makes a gap of them"),
        ("0.105,", "line 13: rate is missing; leave such lines out"),
        ("0.105,x", 'line 13: rate must be a number, got "x"; leave such lines out'),
        ("0.10,1.0", "line 13: time = 0.1 stands in line 12 already; leave one of the two out"),
        ("0.05,1.0", "line 13: time = 0.05 is before the 0.1 of line 12; sort the lines by time, or cut the log"),
    ],
)
def test_lines_that_make_no_sense_are_refused_by_their_number(tmp_path: Path, line: str, says: str) -> None:
    lines = ramp()
    lines.insert(11, line)
    with pytest.raises(InputError) as error:
        read_log(write(tmp_path / "log.csv", *lines), ["rate"])
    assert says in str(error.value)
    assert "\n" not in str(error.value)
