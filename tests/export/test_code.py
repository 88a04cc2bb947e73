"""Controllers as C: compiled, and compared sample by sample with the simulated ones and a model of their limits."""

from __future__ import annotations

import ctypes
import dataclasses
import re
import subprocess
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from generated_c import Machine, classical_entry, compiled, compiler, entry, flat, gyro_entry, state_space
from platform_ctrl import simulation
from platform_ctrl.errors import ArgumentError, InputError, UnscalableError
from platform_ctrl.export import write_c

TYPES = {"double": ctypes.c_double, "float": ctypes.c_float}
PREFIXES = ("caging_4_5_7", "caging_9_10", "stabilisation")
SHA = "0123456789abcdef" * 4


@pytest.fixture(scope="module")
def written(job: Any, entries: list[dict[str, Any]], tmp_path_factory: pytest.TempPathFactory) -> dict[str, list[Path]]:
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


def noise(inputs: int, size: float, samples: int = 600) -> np.ndarray:
    """Readings that wander."""
    steps = np.random.default_rng(7).standard_normal((samples, inputs))
    return size * (steps + np.cumsum(steps, axis=0) / 10.0)


@pytest.mark.parametrize("name", ["g++", "clang"])
def test_other_compilers_and_cpp_have_no_warning_either(
    name: str, written: dict[str, list[Path]], tmp_path: Path
) -> None:
    for number, files in written.items():
        compiled(files, tmp_path / f"{number}.so", name)


def test_commands_are_those_of_the_simulated_controllers_sample_by_sample(
    job: Any, entries: list[dict[str, Any]], recorded: Any, libraries: dict[str, Path]
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


def test_at_its_limits_too_it_is_the_simulated_controller(
    job: Any, entries: list[dict[str, Any]], tmp_path: Path
) -> None:
    files = write_c(job, entries[:2], tmp_path).files
    scenario = job.scenario(job.manoeuvres[0])
    scenario = dataclasses.replace(
        scenario, duration=0.25, profile=dataclasses.replace(scenario.profile, rate=4.0, rise=0.2)
    )
    controllers = [state_space(one) for one in entries[:2]]
    run = simulation.simulate(scenario, controllers, period=job.sampling.period)
    torquers = ["Q4", "Q5", "Q7", "Q9", "Q10"]
    columns = [run.torquer_names.index(name) for name in torquers]
    assert run.saturated[columns].max() > 100
    library = compiled(files, tmp_path / "limited.so")
    controller = Machine(library, "three_gyro_platform", run.pickoff_names, torquers, ctypes.c_double, PREFIXES[:2])
    made, _ = controller.run(run.reading)
    expected = run.command[:, columns]
    size = np.abs(expected).max()
    assert np.abs(made - np.clip(expected, -0.25, 0.25)).max() <= 1e-12 * size
    # Without what anti-windup feeds back the controllers by themselves ask for another torque.
    differs = []
    for K in controllers:
        x, alone, own = np.zeros(K.nstates), [], [run.torquer_names.index(name) for name in K.output_labels]
        for y in run.reading[:, [run.pickoff_names.index(name) for name in K.input_labels]]:
            alone.append(K.C @ x + K.D @ y)
            x = K.A @ x + K.B @ y
        differs.append(np.abs(np.array(alone) - run.command[:, own]).max())
    assert max(differs) > 0.1


@pytest.mark.parametrize("number", ["double", "float"])
@pytest.mark.parametrize("bad", [np.nan, -np.inf, 1e308])
def test_an_input_that_is_not_finite_holds_everything(
    bad: float, number: str, job: Any, entries: list[dict[str, Any]], libraries: dict[str, Path]
) -> None:
    outputs = [*entries[0]["outputs"], *(f"{name}_commanded" for name in entries[0]["outputs"])]
    controller = Machine(libraries[number], "caging_4_5_7", entries[0]["inputs"], outputs, TYPES[number])
    readings = noise(3, 1e-5, 40)
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


def test_the_page_shows_what_is_written_and_code_that_compiles(job: Any, tmp_path: Path) -> None:
    page = (Path(__file__).parents[2] / "docs" / "how-to" / "generated-code.md").read_text()
    *shown, calls = re.findall(r"^```c\n(.*?)^```", page, flags=re.DOTALL | re.MULTILINE)
    files = write_c(job, [classical_entry(job, ("9", "10"))], tmp_path).files
    code = (tmp_path / "caging_9_10.c").read_text()
    assert all(part in code for part in shown)
    counts = re.search(r"(\d+)\s+multiplications, (\d+) additions and at most (\d+) comparisons for a classical", page)
    stated = flat(tmp_path / "caging_9_10.h")
    assert (
        "takes {} multiplications, {} additions and subtractions, and at most {} comp".format(*counts.groups())
        in stated
    )
    caller = tmp_path / "caller.c"
    caller.write_text(calls)
    compiled([*files, caller], tmp_path / "page.so")


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


@pytest.mark.parametrize(
    ("radius", "angle", "direct"),
    # Poles at 1.6 mHz, as one block: each coefficient must have 1 - r = 5e-6. A resonance at 0.1 rad a sample with a
    # half-width of 1.5e-6: float moves it by a part of that.
    [(1.0 - 5e-6, 0.0, 0.0), (1.0 - 1.5e-6, 0.1, 1.0)],
    ids=["slow", "sharp"],
)
def test_poles_that_single_precision_moves_are_refused(
    radius: float, angle: float, direct: float, job: Any, tmp_path: Path
) -> None:
    A = np.array([[2.0 * radius * np.cos(angle), -(radius**2)], [1.0, 0.0]])
    controller = gyro_entry(job, A, 1e-5 * np.eye(2), np.eye(2), direct * np.eye(2))
    with pytest.raises(UnscalableError, match="use double"):
        write_c(job, [controller], tmp_path, number="float")
    assert write_c(job, [controller], tmp_path).files


def test_numbers_that_no_float_holds_are_refused(job: Any, tmp_path: Path) -> None:
    tiny = gyro_entry(job, [], [], [], 1e-60 * np.eye(2))
    with pytest.raises(UnscalableError, match="the response changes by 1 of its size,"):
        write_c(job, [tiny], tmp_path, number="float")
    with pytest.raises(UnscalableError, match="does not fit a float"):
        write_c(job, [tiny | {"D": [[1e60, 0.0], [0.0, 1.0]]}], tmp_path, number="float")
    with pytest.raises(ArgumentError, match=r"number must be .* got 'half'"):
        write_c(job, [tiny], tmp_path, number="half")  # type: ignore[arg-type]
    (tmp_path / "file").write_text("")
    with pytest.raises(InputError, match="name a folder"):
        write_c(job, [tiny], tmp_path / "file" / "x")


def test_sections_that_are_not_the_matrices_are_left_out_with_a_note(job: Any, tmp_path: Path) -> None:
    e = classical_entry(job, ("9", "10"))
    e["D"][0][0] *= 1.0 + 1e-6
    [note] = write_c(job, [e], tmp_path).notes
    assert note == "caging 9-10: its sections are not its matrices, which are written instead"
    assert "state equations of the controller" in (tmp_path / "caging_9_10.c").read_text()
    e["sections"][1]["inputs"] = ["z"]
    with pytest.raises(InputError, match="inputs: 'z' is neither an input nor an output of a section"):
        write_c(job, [e], tmp_path)
    e = classical_entry(job, ("9", "10"))
    e["sections"][1]["outputs"] = ["direction_1"]
    with pytest.raises(InputError, match="exists already; rename it"):
        write_c(job, [e], tmp_path)


def test_controllers_of_one_name_do_not_overwrite_each_other(job: Any, tmp_path: Path) -> None:
    gains = np.zeros((0, 0)), np.zeros((0, 2)), np.zeros((2, 0)), np.eye(2)
    one, other = entry(job, "Gyro 9.", gains, ("9", "10")), entry(job, "gyro 9", gains, ("5", "7"))
    files = write_c(job, [one, other, other | {"outputs": ["Q4", "M1"]}], tmp_path).files
    assert [f.stem for f in files[::2]] == ["gyro_9", "gyro_9_2", "gyro_9_3", "three_gyro_platform"]
    compiled(files, tmp_path / "lib.so")


def test_hostile_names_become_identifiers_and_comments(job: Any, tmp_path: Path) -> None:
    """Identifiers of a job that are meant to break out of identifiers and comments; -ffast-math does not compile."""
    e = classical_entry(job, ("9", "10"))
    wild = ["*/ #error x /*", "int", "NULL", "??/", "limited Q9", "π/2", "9 lives", "while", "x\\"]
    rename = dict(zip([s["outputs"][0] for s in e["sections"][:-2]], wild, strict=False))
    for section in e["sections"]:
        section |= {key: [rename.get(one, one) for one in section[key]] for key in ("inputs", "outputs")}
        section |= {"name": f"*/ int {section['name']}; /*", "note": "??/ \\ */ // #error ¿qué? π"}
    e |= {"design": "*/ main() { } /*", "method": "/*"}
    files = write_c(job, [e], tmp_path, command="a */ b", versions={"*/": "??/"}).files
    assert all(file.read_text().isascii() for file in files)
    compiled(files, tmp_path / "lib.so", "g++")
    command = [compiler(), "-ffast-math", "-fsyntax-only", str(files[1])]
    done = subprocess.run(command, capture_output=True, text=True, timeout=60, check=False)
    assert "compile without" in done.stderr


def test_integrals_that_no_limited_output_determines_have_a_note(job: Any, tmp_path: Path) -> None:
    rng = np.random.default_rng(4)
    B, C, D = (rng.standard_normal(shape) for shape in ((3, 2), (2, 3), (2, 2)))

    def said(A: object, B: object = B, C: object = C, D: object = D) -> tuple[tuple[str, ...], str]:
        done = write_c(job, [gyro_entry(job, A, B, C, D)], tmp_path)
        return done.notes, flat(tmp_path / "caging_9_10.h")

    assert "1 of 3 integrating states are not protected against windup" in said(np.eye(3))[0][0]
    assert "no state integrates" in said(np.diag([0.5, 0.2, 0.1]))[1]
    # A double integral, as of a PI with a second one, is not left behind.
    double = [[1.0, 1.0], [0.0, 1.0]], np.eye(2), 0.1 * np.eye(2), np.eye(2)
    assert said(*double)[0] == ()
