"""Recorded logs: their density is that of the signal, whatever the clock did, and what makes no sense is refused."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest

from platform_ctrl.analysis.logs import log_density, pieces, read_log
from platform_ctrl.errors import ArgumentError, InputError
from platform_ctrl.job.spectra import LogSpectrum, TableSpectrum
from platform_ctrl.simulation import TimeTable, Vibration
from vehicle_log import FILE

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
