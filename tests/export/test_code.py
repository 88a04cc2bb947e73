"""Controllers as C: compiled, and compared sample by sample with the simulated ones and a model of their limits."""

from __future__ import annotations

import ctypes
import dataclasses
import re
from pathlib import Path
from typing import Any

import control
import numpy as np
import pytest

from generated_c import Machine, classical_entry, compiled, compiler, flat, gyro_entry, state_space
from platform_ctrl import simulation
from platform_ctrl.common.values import FloatArray
from platform_ctrl.errors import ArgumentError, InputError, UnscalableError
from platform_ctrl.export import write_c
from platform_ctrl.export.c99.from_design import entries_of, scheme_of, with_excess
from platform_ctrl.export.c99.scheme import Scheme, arrays, excess_gain
from platform_ctrl.export.c99.windup import back_calculation
from platform_ctrl.job.job import Job, manoeuvre_scenario
from platform_ctrl.simulation.closed_loop import Trajectory

TYPES = {"double": ctypes.c_double, "float": ctypes.c_float}
PREFIXES = ("caging_4_5_7", "caging_9_10", "stabilisation")
SHA = "0123456789abcdef" * 4


@pytest.fixture(scope="module")
def written(job: Job, entries: list[dict[str, Any]], tmp_path_factory: pytest.TempPathFactory) -> dict[str, list[Path]]:
    folder = tmp_path_factory.mktemp("c")
    out = {}
    for number in TYPES:
        done = write_c(
            job, entries, folder / number, number=number, sha256=SHA, command="platform-ctrl export JOB --c DIR"
        )  # type: ignore[arg-type]
        assert done.notes == ()
        out[number] = list(done.files)
    return out


@pytest.fixture(scope="module")
def libraries(written: dict[str, list[Path]], tmp_path_factory: pytest.TempPathFactory) -> dict[str, Path]:
    folder = tmp_path_factory.mktemp("lib")
    return {number: compiled(files, folder / f"{number}.so") for number, files in written.items()}


def machine(library: Path, scheme: Scheme, prefix: str, number: str) -> Machine:
    outputs = [*scheme.outputs, *(f"{name}_commanded" for name in scheme.outputs)]
    return Machine(library, prefix, scheme.inputs, outputs, TYPES[number])


def schemes(job: Job, entries: list[dict[str, Any]]) -> list[Scheme]:
    out = [scheme_of(job, one) for one in entries_of(job, entries)]
    return [with_excess(scheme, back_calculation(scheme).gain) for scheme in out]


def limited_run(scheme: Scheme, readings: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Commands and limited commands of a controller with its anti-windup, in plain matrices."""
    K, E, limits = arrays(scheme), excess_gain(scheme), np.array(scheme.torque_limits)
    x = np.zeros(len(K.A))
    commands, given = [], []
    for y in readings:
        u = K.C @ x + K.D @ y
        v = np.clip(u, -limits, limits)
        x = K.A @ x + K.B @ y + E @ (v - u)
        commands.append(u)
        given.append(v)
    return np.array(commands), np.array(given)


def noise(scheme: Scheme, size: float, samples: int = 600) -> FloatArray:
    """Readings that wander."""
    steps = np.random.default_rng(7).standard_normal((samples, len(scheme.inputs)))
    return size * (steps + np.cumsum(steps, axis=0) / 10.0)


@pytest.mark.parametrize("name", ["g++", "clang"])
def test_other_compilers_and_cpp_have_no_warning_either(
    name: str, written: dict[str, list[Path]], tmp_path: Path
) -> None:
    for number, files in written.items():
        compiled(files, tmp_path / f"{number}.so", name)


def test_commands_are_those_of_the_simulated_controllers_sample_by_sample(
    job: Job, entries: list[dict[str, Any]], recorded: Trajectory, libraries: dict[str, Path]
) -> None:
    torquers = ["Q4", "Q5", "Q7", "Q9", "Q10", "M1", "M2", "M3"]
    command = recorded.command[:, [recorded.torquer_names.index(name) for name in torquers]]
    size = np.abs(command).max(axis=0)
    assert np.all(size > 1e-3)
    made = {
        number: Machine(library, "three_gyro_platform", recorded.pickoff_names, torquers, TYPES[number], PREFIXES).run(
            recorded.reading
        )
        for number, library in libraries.items()
    }
    assert set(made["double"][1]) == {0}
    # The simulation sums in another order.
    assert np.all(np.abs(made["double"][0] - command) <= 1e-13 * size)
    assert np.all(np.abs(made["float"][0] - command) <= 1e-3 * size)


def test_without_limits_it_is_what_python_control_computes(
    job: Job, entries: list[dict[str, Any]], libraries: dict[str, Path]
) -> None:
    scheme = schemes(job, entries)[1]
    readings = noise(scheme, 1e-6)
    expected = control.forced_response(state_space(entries[1]), inputs=readings.T).outputs.T
    out, status = machine(libraries["double"], scheme, "caging_9_10", "double").run(readings)
    assert set(status) == {0}
    assert np.allclose(out[:, 2:], expected, rtol=0.0, atol=1e-12 * np.abs(expected).max())


def test_without_anti_windup_it_is_the_simulated_controller_at_the_limits_too(
    job: Job, entries: list[dict[str, Any]], tmp_path: Path
) -> None:
    # The simulation limits torques without anti-windup.
    files = write_c(job, entries[:2], tmp_path, anti_windup="none").files
    scenario = manoeuvre_scenario(job, job.manoeuvres[0])
    scenario = dataclasses.replace(
        scenario, duration=0.25, profile=dataclasses.replace(scenario.profile, rate=4.0, rise=0.2)
    )
    controllers = [state_space(one) for one in entries[:2]]
    run = simulation.simulate(scenario, controllers, period=job.sampling.period)
    torquers = ["Q4", "Q5", "Q7", "Q9", "Q10"]
    columns = [run.torquer_names.index(name) for name in torquers]
    assert run.saturated[columns].max() > 100
    library = compiled(files, tmp_path / "none.so")
    controller = Machine(library, "three_gyro_platform", run.pickoff_names, torquers, ctypes.c_double, PREFIXES[:2])
    made, _ = controller.run(run.reading)
    limited = np.clip(run.command[:, columns], -0.25, 0.25)
    assert np.abs(made - limited).max() <= 1e-12 * np.abs(run.command[:, columns]).max()


@pytest.mark.parametrize("which", [0, 1, 2])
def test_at_its_limits_it_is_the_model_with_anti_windup(
    which: int, job: Job, entries: list[dict[str, Any]], libraries: dict[str, Path]
) -> None:
    scheme = schemes(job, entries)[which]
    prefix = PREFIXES[which]
    # Into the limits for most of the time, then zero.
    readings = np.vstack([noise(scheme, 3e-3 if which < 2 else 1.0), np.zeros((200, len(scheme.inputs)))])
    command, given = limited_run(scheme, readings)
    limits = np.array(scheme.torque_limits)
    assert np.mean(np.abs(command) > limits) > 0.2
    out, status = machine(libraries["double"], scheme, prefix, "double").run(readings)
    m = len(scheme.outputs)
    assert np.allclose(out[:, m:], command, rtol=0.0, atol=1e-12 * np.abs(command).max())
    assert np.allclose(out[:, :m], given, rtol=0.0, atol=1e-12 * np.abs(command).max())
    assert np.all(np.abs(out[:, :m]) <= limits)
    assert status == [int(np.any(np.abs(row) > limits)) for row in out[:, m:]]
    single, _ = machine(libraries["float"], scheme, prefix, "float").run(readings)
    assert np.allclose(single[:, :m], given, rtol=0.0, atol=1e-4 * limits.min())


def test_integrals_follow_what_acts_with_the_stated_time_constant(job: Job, entries: list[dict[str, Any]]) -> None:
    scheme = schemes(job, entries)[0]
    none = with_excess(scheme, np.zeros_like(excess_gain(scheme)))
    held = np.full((8000, 3), 2e-3)
    runs = {name: limited_run(one, held)[0] for name, one in (("with", scheme), ("without", none))}
    # Without, commands go on for ever; with it, they come to rest where the integral loses what it gains.
    assert np.all(np.abs(runs["without"][-1] - runs["without"][-2]) > 1e-6)
    assert np.all(np.abs(runs["with"][-1] - runs["with"][-2]) < 1e-9)
    remark = back_calculation(scheme).remark
    seconds, pole = (
        float(re.search(pattern, remark)[1].rstrip(".")) for pattern in (r"constant ([\d.]+) s", r"= ([\d.]+)")
    )
    assert pole == pytest.approx(1.0 - job.sampling.period / seconds, abs=1e-5)


@pytest.mark.parametrize("number", ["double", "float"])
@pytest.mark.parametrize("bad", [np.nan, np.inf, -np.inf, 1e308])
def test_an_input_that_is_not_finite_holds_everything(
    bad: float, number: str, job: Job, entries: list[dict[str, Any]], libraries: dict[str, Path]
) -> None:
    scheme = schemes(job, entries)[0]
    controller = machine(libraries[number], scheme, "caging_4_5_7", number)
    readings = noise(scheme, 1e-5, 40)
    before, _ = controller.run(readings[:20])
    for place in range(3):
        values, status = controller.step([bad if k == place else 1e-5 for k in range(3)])
        assert status == 2
        assert values == before[-1].tolist()
    after, status = controller.run(readings[20:])
    assert set(status) == {0}
    controller.reset()
    whole, _ = controller.run(readings)
    assert np.array_equal(after, whole[20:])


def test_the_header_states_origin_signals_limits_and_errors(written: dict[str, list[Path]]) -> None:
    text = flat(next(f for f in written["float"] if f.name == "caging_4_5_7.h"))
    for part in (
        "three-gyro platform: caging and stabilisation", "Design: classical (method classical)", SHA,
        "platform-ctrl export",
        "2000 Hz", "act 0.0005 s after the sample", "alpha4 [rad]", "Q5 [N m], limited to +-0.25 N m",
        "positive feedback, u = +K y",
        "back-calculation", "Float against double", "not finite", "of type float",
    ):  # fmt: skip
        assert part in text
    code = next(f for f in written["double"] if f.name == "caging_4_5_7.c").read_text()
    for part in (
        "(s + wz)/(s/wr + 1), zero at 5 Hz, pole at 880 Hz", "1 + wi/s, corner at 2 Hz",
        "zero at 4 Hz, pole at 2.66667 Hz", "Anti-windup",
    ):  # fmt: skip
        assert part in code
    for text in (file.read_text() for files in written.values() for file in files):
        assert text.isascii()
        assert "malloc" not in text
        assert not re.search(r"\b(for|while|goto)\b \(", text)


def test_the_stated_operations_are_those_in_the_code(written: dict[str, list[Path]]) -> None:
    for name in PREFIXES:
        header, source = (next(f for f in written["double"] if f.name == f"{name}.{end}") for end in "hc")
        code = source.read_text()
        body = re.sub(r"/\*.*?\*/", "", code[code.index("_step(") :], flags=re.DOTALL).replace("*out = ", "")
        body = body[body.index("{") :]
        stated = [int(x) for x in re.search(r"takes (\d+) multi\D+(\d+) addi\D+?(\d+)", flat(header)).groups()]
        assert body.count(" * ") == stated[0]
        assert body.count(" + ") + body.count(" - ") == stated[1]
        # usable: two comparisons; limited: two more at most.
        assert body.count("_usable(") * 2 + body.count("_limited(") * 2 + len(re.findall(r" [<>] ", body)) == stated[2]


def test_the_same_arguments_give_the_same_bytes(
    job: Job, entries: list[dict[str, Any]], written: dict[str, list[Path]], tmp_path: Path
) -> None:
    again = write_c(job, entries, tmp_path, sha256=SHA, command="platform-ctrl export JOB --c DIR").files
    assert [f.read_bytes() for f in again] == [f.read_bytes() for f in written["double"]]


def test_the_page_shows_what_is_written_and_code_that_compiles(job: Job, tmp_path: Path) -> None:
    page = (Path(__file__).parents[2] / "docs" / "generated-code.md").read_text()
    *shown, calls = re.findall(r"^```c\n(.*?)^```", page, flags=re.DOTALL | re.MULTILINE)
    files = write_c(job, [classical_entry(job, ("9", "10"))], tmp_path).files
    code = (tmp_path / "caging_9_10.c").read_text()
    assert all(part in code for part in shown)
    counts = re.search(r"(\d+) multiplications, (\d+) additions and at most (\d+) comparisons for a classical", page)
    stated = flat(tmp_path / "caging_9_10.h")
    assert (
        "takes {} multiplications, {} additions and subtractions, and at most {} comp".format(*counts.groups())
        in stated
    )
    caller = tmp_path / "caller.c"
    caller.write_text(calls)
    compiled([*files, caller], tmp_path / "page.so")


def test_where_anti_windup_cannot_be_proved_it_is_back_calculation_with_a_note(
    job: Job, entries: list[dict[str, Any]], tmp_path: Path
) -> None:
    gains = [one | {"A": [], "B": [], "C": [[] for _ in one["outputs"]]} for one in entries[:2]]
    done = write_c(job, [*gains, entries[2]], tmp_path, anti_windup="proved")
    assert len(done.notes) == 1
    assert "stabilisation: back-calculation: proofs" in done.notes[0]
    assert "no state integrates" in flat(tmp_path / "caging_4_5_7.h")
    assert "back-calculation" in (tmp_path / "stabilisation.h").read_text()
    write_c(job, [entries[0]], tmp_path, anti_windup="none")
    assert "none, as requested" in (tmp_path / "caging_4_5_7.h").read_text()
    assert "excess" not in (tmp_path / "caging_4_5_7.c").read_text()


@pytest.mark.slow
def test_proved_anti_windup_is_the_gain_of_the_design_with_its_region(job: Job, tmp_path: Path) -> None:
    from platform_ctrl.design.antiwindup.compensator import anti_windup
    from platform_ctrl.design.caging_claims import caging_loop_limits

    e = classical_entry(job, ("9", "10"))
    K = state_space(e)
    found = anti_windup(caging_loop_limits(job, K, 1))
    assert write_c(job, [e], tmp_path, anti_windup="proved").notes == ()
    text = flat(tmp_path / "caging_9_10.h")
    assert f"up to {found.reach:.4g} N m s" in text
    code = (tmp_path / "caging_9_10.c").read_text()
    numbers = [float(x) for x in re.findall(r"_from_excess_\w+ = (\S+);", code)]
    assert np.allclose(sorted(numbers), sorted(found.gain[found.gain != 0.0]), rtol=1e-6)


DRIVER = """
#include "three_gyro_platform.h"
#include <math.h>
#include <stdio.h>
int main(void)
{
    static three_gyro_platform_state state;
    three_gyro_platform_in in;
    three_gyro_platform_out out;
    double x = 0.0, sum = 0.0;
    unsigned int seen = 0U;
    int k;
    three_gyro_platform_reset(&state);
    for (k = 0; k < 4000; k++) {
        x = fmod(x * 997.0 + 0.123, 1.0);
        in.alpha4 = (k == 500) ? (double)NAN : 0.01 * (x - 0.5);
        in.beta5 = (k == 600) ? (double)INFINITY : 0.02 * (x - 0.4);
        in.beta7 = (k == 700) ? 1e308 : -0.01 * x;
        in.alpha9 = 1e-6 * x;
        in.beta10 = (k > 2000) ? 1e300 : 1e-3;
        seen |= three_gyro_platform_step(&state, &in, &out);
        sum += out.Q4 + out.M3;
    }
    printf("%u %.17g\\n", seen, sum);
    return 0;
}
"""


def test_sanitizers_find_nothing(written: dict[str, list[Path]], tmp_path: Path) -> None:
    import subprocess

    compiler()
    driver = tmp_path / "driver.c"
    driver.write_text(DRIVER)
    folder = written["double"][0].parent
    flags = ("-fsanitize=undefined,address", "-fno-sanitize-recover=all", "-g", f"-I{folder}", "-lm")
    probe = tmp_path / "probe.c"
    probe.write_text("int main(void) { return 0; }\n")
    try:
        subprocess.run(
            [compiler(), *flags[:2], "-o", str(tmp_path / "probe"), str(probe)], check=True, capture_output=True
        )
    except subprocess.CalledProcessError:
        pytest.skip("gcc has no sanitizers here")
    program = compiled([*written["double"], driver], tmp_path / "driver", "gcc", *flags)
    done = subprocess.run([str(program)], capture_output=True, text=True, timeout=60, check=False)
    assert done.returncode == 0, done.stderr
    seen, total = done.stdout.split()
    assert seen == "3"
    assert np.isfinite(float(total))


def test_gains_of_design_anti_windup_go_into_the_code(job: Job, tmp_path: Path) -> None:
    from platform_ctrl.design.antiwindup.compensator import with_excess as controller_with_excess

    e = classical_entry(job, ("9", "10"))
    K = state_space(e)
    own = scheme_of(job, entries_of(job, [e])[0])
    gain = 2.0 * back_calculation(own).gain
    gain[3] = [1e-4, -2e-4]
    # As design.anti_windup gives it, without options: in modes; and the entry of result.json, in its own blocks.
    made = entries_of(job, [controller_with_excess(K, gain)])[0]
    plain = with_excess(own, gain)
    modal = scheme_of(job, made)
    readings = noise(plain, 2e-3, 300)
    expected, _ = limited_run(plain, readings)
    found, _ = limited_run(modal, readings)
    assert np.allclose(found, expected, rtol=0.0, atol=1e-9 * np.abs(expected).max())
    done = write_c(job, [controller_with_excess(K, gain)], tmp_path)
    assert "came with the controller" in flat(tmp_path / "caging_9_10.h")
    out, _ = machine(compiled(done.files, tmp_path / "x.so"), modal, "caging_9_10", "double").run(readings)
    assert np.allclose(out[:, 2:], expected, rtol=0.0, atol=1e-9 * np.abs(expected).max())


@pytest.mark.parametrize(
    ("radius", "angle", "direct"),
    # Poles at 1.6 mHz, as one block: each coefficient must have 1 - r = 5e-6. A resonance at 1 rad a sample with a
    # half-width of 1.5e-6: float moves it by a part of that.
    [(1.0 - 5e-6, 0.0, 0.0), (1.0 - 1.5e-6, 1.0, 1.0)],
    ids=["slow", "sharp"],
)
def test_poles_that_single_precision_moves_are_refused(
    radius: float, angle: float, direct: float, job: Job, tmp_path: Path
) -> None:
    A = np.array([[2.0 * radius * np.cos(angle), -(radius**2)], [1.0, 0.0]])
    controller = gyro_entry(job, A, 1e-5 * np.eye(2), np.eye(2), direct * np.eye(2))
    with pytest.raises(UnscalableError, match="use double"):
        write_c(job, [controller], tmp_path, number="float")
    assert write_c(job, [controller], tmp_path).files


def test_numbers_that_no_float_holds_are_refused(job: Job, tmp_path: Path) -> None:
    tiny = gyro_entry(job, [], [], [], 1e-60 * np.eye(2))
    with pytest.raises(UnscalableError, match="the response changes by 1,"):
        write_c(job, [tiny], tmp_path, number="float")
    with pytest.raises(UnscalableError, match="does not fit a float"):
        write_c(job, [tiny | {"D": [[1e60, 0.0], [0.0, 1.0]]}], tmp_path, number="float")
    with pytest.raises(ArgumentError, match=r"number must be .* got 'half'"):
        write_c(job, [tiny], tmp_path, number="half")  # type: ignore[arg-type]
    with pytest.raises(ArgumentError, match="anti_windup"):
        write_c(job, [tiny], tmp_path, anti_windup="yes")  # type: ignore[arg-type]
    (tmp_path / "file").write_text("")
    with pytest.raises(InputError, match="name a folder"):
        write_c(job, [tiny], tmp_path / "file" / "x")


def test_doubtful_effects_of_float_are_notes(job: Job, tmp_path: Path) -> None:
    across = np.array([[0.0, -1.0], [1.0, 0.0]])
    # A pole at 4 mHz, half way between two floats.
    slow = gyro_entry(job, np.eye(2) * (1.0 - 218.5 * 2.0**-24), np.eye(2), across, across)
    notes = write_c(job, [slow], tmp_path, number="float").notes
    assert any("of its distance from z = 1" in note for note in notes)
    assert write_c(job, [slow], tmp_path).notes == ()


def test_a_controller_that_is_unstable_by_itself_is_written_with_a_remark(job: Job, tmp_path: Path) -> None:
    rng = np.random.default_rng(2)
    B, C, D = (rng.standard_normal(shape) for shape in ((3, 2), (2, 3), (2, 2)))
    wild = gyro_entry(job, np.diag([1.3, 1.0, 1e-300]), B, C, D)
    assert write_c(job, [wild], tmp_path, number="float").notes == ()
    text = flat(tmp_path / "caging_9_10.h")
    assert "slowest pole is |z| = 0.9" in text
