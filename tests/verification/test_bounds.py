"""What bounds the bandwidth of a loop, against asymptotes: a delay, the peak of a mode, noise."""

import pytest

import platform_ctrl as pc
from platform_ctrl import design
from platform_ctrl.report.job_page import write_page
from platform_ctrl.verification.bounds import loop_bounds
from platform_ctrl.verification.result_file import result_record

J, RATE = 0.07, 2000.0


def job(delay=0.0, noise=0.0, modes=(), crossover=1.0, uncertainty=None, **limits):
    """A rate loop, almost pure gain over an inertia."""
    gimbal = {"name": "g", "parent": "base", "axis": [0, 0, 1], "inertia": [0.05, 0.05, J], "angle": "q"}
    plant = {
        "schema": 1,
        "name": "one axis",
        "root": {"name": "base", "inertia": [1.0, 1.0, 1.0]},
        "gimbal": [gimbal],
        "torquer": [{"gimbal": "g", "name": "Q", "limit": 1.0}],
        "rate_sensor": [{"name": "gyro", "body": "g", "axis": [0, 0, 1], "noise_rms": noise}],
        "mode": list(modes),
    }
    options = {"crossover_hz": crossover, "integral_hz": 1e-3, "rolloff_hz": 0.44 * RATE}
    loop = {"name": "rate", "kind": "rate", "gimbals": ["g"], "sensors": ["gyro"], "use": "pi", "limits": limits}
    loop["design"] = [{"name": "pi", "method": "pi", **options}]
    data = {"schema": 2, "name": "one axis", "plant": plant, "operation": {"Omega": [0.0, 0.0, 0.0]}, "loop": [loop]}
    return pc.read_job(data | {"sampling": {"rate_hz": RATE, "delay": delay}, "uncertainty": uncertainty or {}})


def bounds_of(one):
    [outcome] = design.loops(one)
    return loop_bounds(one, outcome)


def test_a_delay_alone_bounds_the_bandwidth_by_its_inverse():
    # 40 samples of delay; the hold adds half a sample and the low-pass a third of one.
    found = bounds_of(job(delay=0.02, disk_margin=0.8))
    [one] = found.bounds
    assert (one.parameter, found.requirement) == ("delay", "disk margin")
    assert one.sensitivity == pytest.approx(-1.0, abs=0.04)
    # Of the loop g/s e^(-sT) the margin 0.8 allows g T of a bit less than 0.6.
    again = bounds_of(job(delay=0.02, disk_margin=0.8, crossover=found.gain))
    assert again.gain == pytest.approx(1.0, abs=2e-3)


def test_the_peak_of_a_mode_bounds_the_bandwidth_by_its_frequency():
    mode = {"name": "arm", "frequency": 200.0, "damping": 0.01, "participation": {"Q": 2.0, "gyro": -2.0}}
    found = bounds_of(job(modes=[mode], disk_margin=0.5))
    [one] = found.bounds
    assert one.parameter == "frequency of arm"
    assert one.sensitivity == pytest.approx(1.0, abs=0.1)


def test_noise_bounds_the_bandwidth_by_its_limit(tmp_path):
    one = job(noise=1e-4, disk_margin=0.1, torque_noise=1e-4, delay=1e-4)
    found = bounds_of(one)
    by_name = {bound.parameter: bound.sensitivity for bound in found.bounds}
    assert found.bounds[0].parameter == "noise"
    assert by_name["noise"] == pytest.approx(-1.0, abs=0.05)
    assert abs(by_name["delay"]) < 0.1
    result = pc.verification.check_job(one, design.loops(one))
    record = result_record(result)["controllers"][0]["bounds"]
    assert record["of"][0]["parameter"] == "noise"
    assert record["requirement"].startswith("torque noise")
    shown = write_page(result, tmp_path / "report.html").read_text(encoding="utf-8")
    assert "What bounds the bandwidth" in shown
    assert "The noise changes it most" in shown


def test_a_bound_holds_for_plants_that_are_worst_at_another_gain():
    # A slow loop is worst with a small inertia, a fast one with one of the modes at an end of its range.
    def at(crossover):
        sizes = {"a": (179.0, 0.016, 1.2, -1.0), "b": (776.0, 0.01, 1.0, 1.0)}
        modes = [
            {"name": name, "frequency": w, "damping": zeta, "participation": {"Q": phi, "gyro": phi * sign}}
            for name, (w, zeta, phi, sign) in sizes.items()
        ]
        uncertain = {"mode_frequency": 0.2, "inertia": 0.2}
        return job(1.9e-4, 0.0, modes, crossover, uncertain, disk_margin=0.3, disk_margin_worst_case=0.3)

    gain = 1.95 * bounds_of(at(1.95)).gain
    met = [all(r.passed for r in design.loops(at(share * gain))[0].closed.results) for share in (0.98, 1.02)]
    assert met == [True, False]


def test_a_loop_that_misses_its_limits_is_bounded_below_its_gain():
    found = bounds_of(job(delay=0.02, disk_margin=0.8, crossover=12.0))
    assert 0.2 < found.gain < 0.8
