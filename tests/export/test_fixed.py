"""Controllers in fixed point: the C is the model in Python's integers, and what is proved of both holds."""

from __future__ import annotations

import ctypes
import dataclasses
import random
import subprocess
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import flint
import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

import platform_ctrl as pc
from generated_c import LANGUAGES, WARNINGS, Machine, classical_entry, compiled, compiler, flat, pair
from integer_machine import IntegerMachine
from platform_ctrl.analysis.certificates.intervals import balls
from platform_ctrl.common.text import at_most
from platform_ctrl.design.plants import loop_plants
from platform_ctrl.errors import ArgumentError, InfeasibleError, InputError, SimulationError, UnscalableError
from platform_ctrl.export import write_c
from platform_ctrl.export.c99.c_text import field_names
from platform_ctrl.export.c99.from_design import entries_of, scheme_of, with_excess
from platform_ctrl.export.c99.scheme import Row, Scheme, Section, Term, arrays
from platform_ctrl.export.c99.windup import back_calculation
from platform_ctrl.export.fixed_point.bounds import gains
from platform_ctrl.export.fixed_point.integer_files import IntegerFiles
from platform_ctrl.export.fixed_point.lowering import fixed_point
from platform_ctrl.export.fixed_point.model import FixedPoint
from platform_ctrl.export.fixed_point.splitting import input_ranges
from platform_ctrl.job.job import Job
from platform_ctrl.simulation.closed_loop import Trajectory

NUMBERS = ("q31", "q15")
CLASSICAL = {"name": "classical", "method": "classical"}
LOOP = {"name": "caging 9-10", "kind": "caging", "gimbals": ["9", "10"], "use": "classical", "design": [CLASSICAL]}
JOB = pc.read_job(
    {
        "schema": 2,
        "name": "gyro 9-10",
        "plant": "three_gyro_platform",
        "operation": {"Omega": [1.0, 1.0, 1.0]},
        "sampling": {"rate_hz": 2000, "delay": 0.0005},
        "loop": [LOOP],
    }
)


def terms(**weights: float) -> tuple[Term, ...]:
    return tuple(Term(coefficient=weight, source=name) for name, weight in weights.items())


def scheme(*sections: Section, **changes: Any) -> Scheme:
    """A scheme from y to Q; `limit` is that of Q."""
    limit = changes.pop("limit", np.inf)
    plain = {"name": "test", "inputs": ("y",), "input_units": ("rad",), "outputs": ("Q",), "output_units": ("N m",)}
    return Scheme(**(plain | {"period": 1e-3, "delay": 0.0} | changes), sections=sections, torque_limits=(limit,))


def lag(pole: float, gain: float = 1.0, name: str = "lag", source_name: str = "y", target: str = "Q") -> Section:
    """Return target = gain (1 − pole)/(z − pole) source."""
    return Section(
        name=name,
        kind="lag",
        signals=(Row(target=target, terms=terms(**{f"{name}_x": gain})),),
        states=(Row(target=f"{name}_x", terms=terms(**{f"{name}_x": pole, source_name: 1.0 - pole})),),
    )


def resonance(radius: float, angle: float) -> Scheme:
    """Return a scheme with a pair of poles in direct form, which is what coefficients of few digits do worst."""
    states = (
        Row(target="a", terms=terms(a=2.0 * radius * np.cos(angle), b=-(radius**2), y=1.0)),
        Row(target="b", terms=terms(a=1.0)),
    )
    signals = (Row(target="Q", terms=terms(a=1.0)),)
    return scheme(Section(name="resonance", kind="states", signals=signals, states=states))


def integrator(gain: float, limit: float = 0.5, excess: float = 0.0) -> Scheme:
    """Return Q = x + y, x⁺ = x + gain y + excess (limited Q − Q)."""
    section = Section(
        name="PI",
        kind="integral",
        signals=(Row(target="Q", terms=terms(x=1.0, y=1.0)),),
        states=(Row(target="x", terms=terms(x=1.0, y=gain)),),
    )
    return scheme(section, limit=limit, excess=(Row(target="x", terms=terms(Q=excess)),) if excess else ())


def odd() -> Scheme:
    """Return a scheme with a signal that nothing reads, a limited output that a state reads, and its excess there."""
    section = Section(
        name="odd",
        kind="states",
        signals=(
            Row(target="unread", terms=terms(y=3.0)),
            Row(target="within", terms=terms(y=-0.7, x=1.0)),
            Row(target="Q", terms=terms(within=2.0, y=0.1)),
        ),
        states=(Row(target="x", terms=terms(x=0.6, Q=0.05, y=1.0)),),
    )
    return scheme(section, limit=1.0, excess=(Row(target="x", terms=terms(Q=0.3)),))


@pytest.fixture(scope="module")
def classical() -> Scheme:
    [entry] = entries_of(JOB, [classical_entry(JOB, ("9", "10"))])
    made = scheme_of(JOB, entry)
    return with_excess(made, back_calculation(made).gain)


@pytest.fixture(scope="module")
def programmes(classical: Scheme) -> dict[str, FixedPoint]:
    ranges = input_ranges(classical.inputs, JOB)
    out = {f"classical_{number}": fixed_point(classical, ranges, number=number) for number in NUMBERS}
    out |= {f"pi_{number}": fixed_point(integrator(1e-4, excess=0.01), {"y": 2.0}, number=number) for number in NUMBERS}
    cascade = scheme(lag(0.9, 3.0, "fast", target="v"), lag(-0.4, 0.7, "ring", source_name="v"))
    out |= {f"lags_{number}": fixed_point(cascade, {"y": 0.3}, number=number) for number in NUMBERS}
    out |= {f"odd_{number}": fixed_point(odd(), {"y": 1.0}, number=number) for number in NUMBERS}
    return out


def files_of(fixed: FixedPoint, name: str) -> IntegerFiles:
    signals = {signal: signal for signal in (*fixed.scheme.inputs, *fixed.scheme.outputs)}
    return IntegerFiles(scheme=fixed.scheme, fixed=fixed, prefix=name, signals=signals)


@pytest.fixture(scope="module")
def runner(programmes: dict[str, FixedPoint], tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Compile all programmes into one, that takes a name and counts and gives counts; undefined behaviour ends it."""
    gcc = compiler()
    folder = tmp_path_factory.mktemp("fixed")
    main, calls = ["#include <stdio.h>", "#include <string.h>"], []
    for name, fixed in programmes.items():
        pair(files_of(fixed, name), folder)
        bits = fixed.formats[fixed.scheme.inputs[0]].bits
        first = fixed.scheme.inputs[0]
        reading = [f'if (scanf("%lld", &x) != 1) return 0; in.{one} = (int{bits}_t)x;' for one in fixed.scheme.inputs]
        printing = [f'printf("%lld ", (long long)out.{one});' for one in fixed.scheme.outputs]
        main += [
            f'#include "{name}.h"',
            f"static int run_{name}(void) {{ {name}_state state; {name}_in in; {name}_out out; long long x;",
            f"{name}_reset(&state); for (;;) {{ {' '.join(reading)} {name}_step(&state, &in, &out);",
            f"{' '.join(printing)} }} }}",
            f"static int count_{name}(void) {{ double x;",
            'while (scanf("%lf", &x) == 1)',
            f'    printf("%lld ", (long long){name}_count_{first}(x));',
            "return 0; }",
        ]
        calls += [f'if (strcmp(argv[1], "{name}") == 0) return run_{name}();']
        calls += [f'if (strcmp(argv[1], "count_{name}") == 0) return count_{name}();']
    main += ["int main(int argc, char **argv) {", "(void)argc;", *calls, "return 1; }"]
    (folder / "main.c").write_text("\n".join(main) + "\n", encoding="ascii")
    sources = [f"{name}.c" for name in programmes]
    command = [gcc, LANGUAGES["gcc"], *WARNINGS, *sources, "main.c", "-o", "run"]
    checked = ["-fsanitize=undefined", "-fno-sanitize-recover=undefined"]
    built = subprocess.run([*command, *checked], cwd=folder, capture_output=True, text=True)
    if "cannot find" in built.stderr:
        # A compiler without its sanitizers' libraries.
        built = subprocess.run(command, cwd=folder, capture_output=True, text=True)
    assert built.returncode == 0, built.stderr
    return folder / "run"


def run(runner: Path, name: str, numbers: Sequence[object]) -> list[int]:
    done = subprocess.run([runner, name], input=" ".join(map(str, numbers)), capture_output=True, text=True)
    assert not done.returncode, done.stderr
    assert not done.stderr
    return [int(word) for word in done.stdout.split()]


def worst_case(fixed: FixedPoint, target: str, samples: int) -> list[int]:
    """Return the input that drives a signal or state farthest: the sign of its impulse response, backwards."""
    K = arrays(dataclasses.replace(fixed.scheme, outputs=(target,), output_units=("",), torque_limits=(np.inf,)))
    response, x = [K.D[0, 0]], K.B[:, 0]
    for _ in range(samples - 1):
        response.append(float(K.C[0] @ x))
        x = K.A @ x
    largest = fixed.formats["y"].largest
    return [largest if h >= 0 else -largest for h in reversed(response)]


def test_l1_norms_are_bounded_from_above_and_closely() -> None:
    def norm(A: list[list[float]], B: list[list[float]], C: list[list[float]]) -> float:
        return float(gains(*(balls(np.array(M)) for M in (A, B, C)), balls(np.zeros((1, 1)))).signals[0, 0])

    for pole in (0.5, -0.9, 0.9999):
        exact = 1 / (1 - abs(flint.arb(pole)))
        assert flint.arb(norm([[pole]], [[1.0]], [[1.0]])) >= exact
        assert norm([[pole]], [[1.0]], [[1.0]]) <= 1.000001 * float(exact)
    r, angle = 0.995, 0.3
    A = [[2 * r * np.cos(angle), -(r**2)], [1.0, 0.0]]
    # The impulse response of the direct form, r^k sin((k + 1) φ)/sin φ, summed.
    k = np.arange(20000)
    total = np.abs(r**k * np.sin((k + 1) * angle) / np.sin(angle)).sum()
    assert total <= norm(A, [[1.0], [0.0]], [[1.0, 0.0]]) <= 1.000001 * total


@pytest.mark.parametrize("number", NUMBERS)
@pytest.mark.parametrize("kind", ["classical", "pi", "lags", "odd"])
def test_the_compiled_code_is_the_model_bit_for_bit(
    kind: str, number: str, programmes: dict[str, FixedPoint], runner: Path
) -> None:
    fixed = programmes[f"{kind}_{number}"]
    dice, full = random.Random(7), 2 ** (fixed.formats[fixed.scheme.inputs[0]].bits - 1)
    counts = [
        [
            # Noise over the whole word, its ends for long, slow ramps, and around zero.
            dice.randrange(-full, full)
            if k < 600
            else dice.choice([-full, full - 1])
            if k < 800
            else full - 1
            if k < 1300
            else -full + (k - 1300) * full // 400
            if k < 2000
            else dice.randrange(-3, 4)
            for _ in fixed.scheme.inputs
        ]
        for k in range(2400)
    ]
    counts = [[min(max(count, -full), full - 1) for count in row] for row in counts]
    machine = IntegerMachine(fixed)
    wanted = [count for row in counts for count in machine.step(row)]
    assert run(runner, f"{kind}_{number}", [count for row in counts for count in row]) == wanted
    assert len(set(wanted)) > 100


def test_the_code_is_cpp_as_well(programmes: dict[str, FixedPoint], runner: Path) -> None:
    warnings = [flag for flag in WARNINGS if flag != "-Wstrict-prototypes"]
    sources = ["classical_q31.c", "classical_q15.c", "pi_q15.c"]
    command = [compiler("g++"), LANGUAGES["g++"], "-fsyntax-only", *warnings, "-x", "c++", *sources]
    built = subprocess.run(command, cwd=runner.parent, capture_output=True, text=True)
    assert built.returncode == 0, built.stderr


@pytest.mark.parametrize("number", NUMBERS)
def test_values_become_the_nearest_counts_and_stay_in_range(
    number: str, programmes: dict[str, FixedPoint], runner: Path
) -> None:
    form = programmes[f"lags_{number}"].formats["y"]
    given_values = ["0.1", "-0.1", "0.3", "-0.3", "1e300", "-1e300", "nan", "inf", "-inf", "0"]
    wanted = [round(float(x) / form.bit) if abs(float(x)) < 0.3 else 0 for x in given_values]
    for k in (2, 4, 7):
        wanted[k] = form.largest
    for k in (3, 5, 8):
        wanted[k] = -form.largest
    assert run(runner, f"count_lags_{number}", given_values) == wanted
    assert abs(form.range - 0.3) <= form.bit


@pytest.mark.parametrize("number", NUMBERS)
@pytest.mark.parametrize(("radius", "angle"), [(0.98, 0.5), (0.9, 2.5), (0.7, 1.0)])
def test_the_worst_input_comes_near_the_bound_and_needs_every_bit_of_the_format(
    number: str, radius: float, angle: float
) -> None:
    fixed = fixed_point(resonance(radius, angle), {"y": 1.0}, number=number, accuracy=1.0)
    form = fixed.formats["Q"]
    machine, reached = IntegerMachine(fixed), 0
    for count in worst_case(fixed, "Q", 1500):
        reached = max(reached, abs(machine.step([count])[0]))
    assert 0.98 * form.largest < reached <= form.largest < 2 ** (form.bits - 1)
    # One integer bit less holds half of the counts.
    assert reached >= 2 ** (form.bits - 2)


def test_the_model_raises_at_an_overflow_where_a_word_is_too_short() -> None:
    fixed = fixed_point(resonance(0.98, 0.5), {"y": 1.0}, number="q31")
    narrow = dataclasses.replace(fixed.formats["Q"], bits=31)
    machine = IntegerMachine(dataclasses.replace(fixed, formats=fixed.formats | {"Q": narrow}))

    def run_worst_case() -> None:
        for count in worst_case(fixed, "Q", 1500):
            machine.step([count])

    with pytest.raises(SimulationError, match="'Q' reaches"):
        run_worst_case()


def in_real_arithmetic(
    fixed: FixedPoint, counts: Iterator[Sequence[int]]
) -> Iterator[tuple[dict[str, float], dict[str, int]]]:
    """Run in doubles and in integers with the same inputs and equal integrals; yield values and counts."""
    machine, made = IntegerMachine(fixed), fixed.scheme
    x = dict.fromkeys(made.states, 0.0)
    for row in counts:
        for name, shift in machine.integrals.items():
            x[name] = machine.registers[name] * 2.0**-shift * fixed.formats[name].bit
        machine.step(row)
        value = {name: machine.counts[name] * fixed.formats[name].bit for name in made.inputs} | x
        for section in made.sections:
            for one in section.signals:
                value[one.target] = sum(term.coefficient * value[term.source] for term in one.terms)
        x = {
            one.target: sum(term.coefficient * value[term.source] for term in one.terms)
            for section in made.sections
            for one in section.states
        }
        yield value, machine.counts


@pytest.mark.parametrize("name", ["lags_q31", "lags_q15", "pi_q31", "pi_q15"])
def test_the_error_stays_within_its_bound_and_the_bound_is_not_idle(
    name: str, programmes: dict[str, FixedPoint]
) -> None:
    fixed = programmes[name]
    dice, largest = np.random.default_rng(3), fixed.formats["y"].largest
    counts = iter([[int(c)] for c in dice.integers(-largest, largest + 1, 3000)])
    worst = max(
        abs(value["Q"] - count["Q"] * fixed.formats["Q"].bit) for value, count in in_real_arithmetic(fixed, counts)
    )
    assert 0.05 * fixed.error["Q"] < worst <= fixed.error["Q"]


@pytest.mark.parametrize("number", NUMBERS)
def test_the_classical_loop_in_integers_is_that_in_doubles(
    number: str, classical: Scheme, programmes: dict[str, FixedPoint]
) -> None:
    fixed = programmes[f"classical_{number}"]
    plants = loop_plants(JOB, ("9", "10"))
    A, B, C = plants.A[0], plants.B[0], plants.C[0]
    K = arrays(classical)
    push = np.array([0.05, -0.03])  # N m, on the gimbals from the first sample on
    limit = np.array(classical.torque_limits)
    bits = [fixed.formats[name].bit for name in (*classical.inputs, *classical.outputs)]
    machine = IntegerMachine(fixed)
    plant = [np.zeros(len(A)), np.zeros(len(A))]
    x = np.zeros(len(K.A))
    difference, torque = 0.0, np.zeros(2)
    for _ in range(2000):
        angle = [C @ state for state in plant]
        wanted = K.C @ x + K.D @ angle[0]
        assert np.all(np.abs(wanted) < limit)
        x = K.A @ x + K.B @ angle[0]
        torque = np.array(machine.step([round(y / bit) for y, bit in zip(angle[1], bits[:2], strict=True)])) * bits[2:]
        difference = max(difference, np.abs(torque - wanted).max())
        plant = [A @ state + B @ (u + push) for state, u in zip(plant, (wanted, torque), strict=True)]
    # The integral cancels the push; the torques are alike before.
    assert np.abs(torque + push).max() < (1e-6 if number == "q31" else 1e-3)
    assert difference < 2.0 * max(fixed.error[name] + fixed.conversion[name] for name in classical.outputs)


@pytest.mark.parametrize(("number", "kind", "allowed"), [("q31", ctypes.c_int32, 2e-6), ("q15", ctypes.c_int16, 0.02)])
def test_the_generated_job_commands_what_the_simulated_controllers_do(
    number: str,
    kind: type,
    allowed: float,
    job: Job,
    entries: list[dict[str, Any]],
    recorded: Trajectory,
    tmp_path: Path,
) -> None:
    """Two caging loops and the servo, whose inputs are their commands in its own format, from recorded readings."""
    torquers = ["Q4", "Q5", "Q7", "Q9", "Q10", "M1", "M2", "M3"]
    command = recorded.command[:, [recorded.torquer_names.index(name) for name in torquers]]
    limits = np.array([0.25] * 5 + [2.0] * 3)
    done = write_c(job, entries, tmp_path, number=number, accuracy=0.05)  # type: ignore[arg-type]
    names = [file.stem for file in done.files[:-2:2]]
    library = compiled(done.files, tmp_path / "job.so")
    machine = Machine(library, "three_gyro_platform", recorded.pickoff_names, torquers, kind, names)
    bits = 2.0**-37 if number == "q31" else 2.0**-21
    out, status = machine.run(np.rint(recorded.reading / bits).astype(np.int64))
    assert set(status) == {0}
    torque = out * (limits / (2.0**30 if number == "q31" else 2.0**14))
    assert np.all(np.abs(torque - command).max(axis=0) <= allowed * limits)
    assert "So in real arithmetic" in flat(done.files[0])  # of anti-windup


@pytest.mark.parametrize("size", [4.0, 0.02], ids=["coarser", "finer"])
def test_commands_are_converted_to_the_format_of_the_next_controller(
    size: float, job: Job, entries: list[dict[str, Any]], tmp_path: Path
) -> None:
    ranges = {"Q9": size, "Q10": size}
    done = write_c(job, entries, tmp_path, number="q31", anti_windup="none", ranges=ranges, accuracy=1e3)
    schemes = [scheme_of(job, entry) for entry in entries_of(job, entries)[1:]]
    first, second = (
        fixed_point(one, input_ranges(one.inputs, job, ranges), number="q31", accuracy=1e3) for one in schemes
    )
    inputs, outputs = job.platform.angle_names, ["Q4", "Q5", "Q7", *first.scheme.outputs, *second.scheme.outputs]
    library = compiled(done.files, tmp_path / "job.so")
    prefixes = ["caging_4_5_7", "caging_9_10", "stabilisation"]
    run = Machine(library, "three_gyro_platform", inputs, outputs, ctypes.c_int32, prefixes)
    one, other = IntegerMachine(first), IntegerMachine(second)
    for angles in np.random.default_rng(1).integers(-(2**24), 2**24, (50, 2)).tolist():
        counts = dict(zip(first.scheme.outputs, one.step(angles), strict=True)) | {"Q5": 0, "Q7": 0}
        for name in first.scheme.outputs:
            more = second.formats[name].fraction - first.formats[name].fraction
            assert (more > 0) == (size < 0.1)
            counts[name] = counts[name] << more if more > 0 else (counts[name] + (1 << (-more - 1))) >> -more
        out, _ = run.step([0, 0, 0, *angles])
        assert tuple(out[5:]) == other.step([counts[name] for name in second.scheme.inputs])


@st.composite
def stable_schemes(draw: st.DrawFn) -> tuple[Scheme, float]:
    """Return a cascade of sections with poles inside the circle or at 1, gains over six decades, and a range."""
    sections, before = [], ["y"]
    size = st.floats(-3.0, 3.0).map(lambda decades: 10.0**decades)
    weight = st.floats(0.1, 2.0).map(lambda w: round(w, 3)) | st.floats(-2.0, -0.1)
    for k in range(draw(st.integers(1, 4))):
        radius = draw(st.sampled_from([0.0, 0.3, 0.9, 0.99, 0.998]))
        order = draw(st.sampled_from(["static", "real", "pair", "integral"]))
        names = {"static": [], "real": [f"x{k}"], "pair": [f"x{k}", f"z{k}"], "integral": [f"x{k}"]}[order]
        angle = draw(st.floats(0.05, 3.0))
        own = {
            "static": {},
            "real": {f"x{k}": {f"x{k}": draw(st.sampled_from([1.0, -1.0])) * radius}},
            "pair": {
                f"x{k}": {f"x{k}": radius * np.cos(angle), f"z{k}": radius * np.sin(angle)},
                f"z{k}": {f"x{k}": -radius * np.sin(angle), f"z{k}": radius * np.cos(angle)},
            },
            "integral": {f"x{k}": {f"x{k}": 1.0}},
        }[order]
        gain, source_name = draw(size), draw(st.sampled_from(before))
        shown = {name: draw(weight) for name in names} | {source_name: gain * draw(weight)}
        sections.append(
            Section(
                name=f"section {k}",
                kind="states",
                signals=(Row(target=f"s{k}", terms=terms(**shown)),),
                states=tuple(
                    Row(target=name, terms=terms(**row, **{source_name: gain * draw(weight)}))
                    for name, row in own.items()
                ),
            )
        )
        before.append(f"s{k}")
    out = Section(name="out", kind="mix", signals=(Row(target="Q", terms=terms(**{before[-1]: 1.0})),))
    return scheme(*sections, out, limit=draw(size)), draw(size)


@pytest.mark.parametrize("number", NUMBERS)
@settings(max_examples=20, deadline=None, suppress_health_check=[HealthCheck.too_slow])
@given(case=stable_schemes(), seed=st.integers(0, 2**32 - 1))
def test_whatever_is_lowered_keeps_its_bounds(number: str, case: tuple[Scheme, float], seed: int) -> None:
    made, size = case
    try:
        fixed = fixed_point(made, {"y": size}, number=number, accuracy=1e9, limits=dict.fromkeys(_integrals(made), 5.0))
    except InfeasibleError as error:
        refusal = str(error)
    else:
        refusal = ""
    if refusal:
        assert "section" in refusal
        return
    dice, largest = random.Random(seed), fixed.formats["y"].largest
    counts = [[dice.choice([-largest, largest]) if k < 60 else dice.randrange(-largest, largest)] for k in range(120)]
    for value, count in in_real_arithmetic(fixed, iter(counts)):
        for name, form in fixed.formats.items():
            assert abs(count[name]) <= (fixed.commanded["Q"] if name == "Q" else form.largest)
        wrong = abs(value["Q"] - count["Q"] * fixed.formats["Q"].bit)
        assert wrong <= fixed.error["Q"] + 1e-9 * abs(value["Q"])


def _integrals(made: Scheme) -> list[str]:
    rows = [row for section in made.sections for row in section.states]
    return [row.target for row in rows if any(t.source == row.target and t.coefficient == 1.0 for t in row.terms)]


def test_names_that_the_code_itself_has_are_no_obstacle(tmp_path: Path) -> None:
    names = ("int16_t", "within", "excess of Q", "noise of Q", "limited Q", "next x", "k Q from within", "shifted64")
    taken = {name: 0.1 + 0.01 * k for k, name in enumerate(names)}
    section = Section(
        name="all",
        kind="states",
        signals=(Row(target="Q", terms=terms(x=1.0, **taken)),),
        states=(Row(target="x", terms=terms(x=0.6, **taken)),),
    )
    back = (Row(target="x", terms=terms(Q=0.1)),)
    made = scheme(section, name="names", inputs=names, input_units=("rad",) * len(names), limit=0.5, excess=back)
    fixed = fixed_point(made, dict.fromkeys(names, 1.0))
    signals = field_names([*names, "Q"])
    unit = IntegerFiles(scheme=fixed.scheme, fixed=fixed, prefix="names", signals=signals)
    files = pair(unit, tmp_path)
    compiled(files, tmp_path / "cpp.so", "g++")
    library = compiled(files, tmp_path / "c.so")
    machine = IntegerMachine(fixed)
    # The command before its limit stands behind Q, as wide as it may be.
    run = Machine(library, "names", [signals[name] for name in names], ["Q", "a", "b", "c"], ctypes.c_int32)
    for _ in range(3):
        out, _ = run.step([2**28 + 1] * len(names))
        assert tuple(out[:1]) == machine.step([2**28 + 1] * len(names))


def test_beyond_its_range_an_input_counts_as_the_end_of_the_range(programmes: dict[str, FixedPoint]) -> None:
    for fixed in programmes.values():
        one, other = IntegerMachine(fixed), IntegerMachine(fixed)
        end = [fixed.formats[name].largest for name in fixed.scheme.inputs]
        for _ in range(20):
            assert one.step([2**62 for _ in end]) == other.step(end)


@pytest.mark.parametrize("number", NUMBERS)
def test_an_integral_loses_nothing_however_little_it_gains(number: str) -> None:
    fixed = fixed_point(integrator(1e-4), {"y": 1.0}, number=number)
    machine = IntegerMachine(fixed)
    samples = 20000 if number == "q15" else 3000
    for _ in range(samples):
        machine.step([1])
    gained = machine.registers["x"] * 2.0 ** -machine.integrals["x"] * fixed.formats["x"].bit
    assert gained == pytest.approx(samples * 1e-4 * fixed.formats["y"].bit, rel=2.0**-14 if number == "q15" else 1e-8)


def test_an_integral_ends_at_its_limit_and_anti_windup_brings_it_back() -> None:
    saturated = fixed_point(integrator(1e-2), {"y": 1.0})
    unwound = fixed_point(integrator(1e-2, excess=0.05), {"y": 1.0})
    ends = {}
    for name, fixed in (("saturated", saturated), ("unwound", unwound)):
        machine, form = IntegerMachine(fixed), fixed.formats["x"]
        for _ in range(1000):
            machine.step([fixed.formats["y"].largest])
        ends[name] = machine.counts["x"] * form.bit
        assert abs(machine.counts["x"]) <= form.largest
    # Twice the torque's limit without anti-windup; with it where 0.01 y + 0.05 (0.5 − x − y) = 0.
    assert ends["saturated"] == pytest.approx(1.0, rel=1e-6)
    assert ends["unwound"] == pytest.approx(-0.3, rel=1e-6)


def test_few_digits_that_move_a_pole_out_of_the_circle_are_refused_by_section() -> None:
    # Ringing at the Nyquist frequency: at z = −1 the polynomial is (1 − r)² + φ², less than a digit.
    ringing = resonance(0.999, np.pi - 0.001)
    with pytest.raises(InfeasibleError, match=r"section 'resonance': rounded coefficients move a pole of a, b .*q31"):
        fixed_point(ringing, {"y": 1e-6}, number="q15", accuracy=1e9)
    assert fixed_point(ringing, {"y": 1e-6}, number="q31", accuracy=1e9).poles["resonance"] < 1.0


def test_slow_poles_in_direct_form_keep_their_place_as_differences() -> None:
    # The polynomial at 1 is 2e-6; stored as they are, 15 bits of a1 and a2 would lose it.
    slow = fixed_point(resonance(0.999, 0.001), {"y": 1e-3}, number="q15", accuracy=1e9)
    assert slow.poles["resonance"] == pytest.approx(0.999, abs=1e-7)
    assert set(slow.formats) == {"y", "Q", "a_less_b", "b"}


def test_a_slow_pole_keeps_its_place_in_16_bits() -> None:
    # Stored as it is, with 15 bits, 1 − 1e-4 would be 1 − 0.92e-4.
    slow = fixed_point(scheme(lag(1.0 - 1e-4)), {"y": 1.0}, number="q15")
    assert slow.poles["lag"] == pytest.approx(1.0 - 1e-4, abs=1e-8)


@pytest.mark.parametrize(("pole", "match"), [(1.01, "magnitude 1.01"), (-1.0, "magnitude 1 ")])
def test_poles_outside_of_the_circle_are_refused(pole: float, match: str) -> None:
    with pytest.raises(InfeasibleError, match=f"section 'lag': a pole has the {match}"):
        fixed_point(scheme(lag(pole)), {"y": 1.0})


@pytest.mark.parametrize(
    ("made", "error", "match"),
    [
        (scheme(lag(0.5, 1e200)), UnscalableError, "'Q' has the bound 1e"),
        (scheme(lag(0.5, 1e-200)), UnscalableError, "'Q' has the bound 1e"),
        (scheme(lag(1.0 - 1e-8)), InfeasibleError, "'lag': it settles too slowly"),
        (integrator(1e-3, excess=1e12), InfeasibleError, "'PI': what the integral 'x' may gain"),
        (
            scheme(*(lag(0.5, 1e60, f"l{k}", f"v{k - 1}" if k else "y", f"v{k}") for k in range(7)), lag(0.5)),
            UnscalableError,
            "beyond 1e308",
        ),
    ],
    ids=["huge", "tiny", "slow", "windup", "chain"],
)
@pytest.mark.parametrize("number", NUMBERS)
def test_what_cannot_be_counted_is_refused(made: Scheme, error: type[Exception], match: str, number: str) -> None:
    with pytest.raises(error, match=match):
        fixed_point(made, {"y": 1.0}, number=number)


@pytest.mark.parametrize("number", NUMBERS)
def test_zeros_and_limits_out_of_reach_are_no_obstacle(number: str) -> None:
    nothing = Section(name="none", kind="mix", signals=(Row(target="Q", terms=()),))
    assert IntegerMachine(fixed_point(scheme(nothing), {"y": 1.0}, number=number)).step([5]) == (0,)
    # The format follows from what is reached, not from the limit.
    free = fixed_point(scheme(lag(0.5), limit=1e9), {"y": 1.0}, number=number)
    assert free.formats["Q"].range < 1.01
    assert free.error["Q"] < 1e-3


def test_too_coarse_is_refused_with_the_section_that_makes_it_so() -> None:
    cascade = scheme(lag(0.5, 1000.0, "coarse", target="v"), lag(0.5, 0.001, "fine", source_name="v"))
    with pytest.raises(InfeasibleError, match=r"section '(coarse|fine)': the error of Q may reach .*number = 'q31'"):
        fixed_point(cascade, {"y": 1.0}, number="q15", accuracy=1e-5)
    assert fixed_point(cascade, {"y": 1.0}, number="q31", accuracy=1e-5).error["Q"] < 1e-5


def test_ranges_come_from_the_plant_or_must_be_given_by_name() -> None:
    stop = np.deg2rad(0.5)
    found = input_ranges(("alpha9", "Q9", "Omega1"), JOB)
    assert found == {"alpha9": pytest.approx(1.1 * stop), "Q9": 0.275, "Omega1": pytest.approx(1.1)}
    assert input_ranges(("alpha9",), JOB, {"alpha9": 0.002}) == {"alpha9": 0.002}
    with pytest.raises(InputError, match="no range is known for 'alpha9_rate'"):
        input_ranges(("alpha9_rate",), JOB)
    with pytest.raises(ArgumentError, match="ranges"):
        input_ranges(("alpha9",), JOB, {"alpha9": -1.0})


def test_an_integral_without_a_torque_limit_needs_its_own() -> None:
    free = integrator(1e-3, limit=np.inf)
    with pytest.raises(InfeasibleError, match=r"'PI'.*limits.*--integral-limit x=NUMBER"):
        fixed_point(free, {"y": 1.0})
    assert fixed_point(free, {"y": 1.0}, limits={"x": 3.0}).formats["x"].range == pytest.approx(3.0)


def test_the_header_states_every_format_and_the_proof(programmes: dict[str, FixedPoint], classical: Scheme) -> None:
    for name, fixed in programmes.items():
        text = files_of(fixed, name).header()
        line = " ".join(text.replace("*", "").split())
        for form in fixed.formats.values():
            assert f"{form.name} int{form.bits} {form.q}, bit {form.bit:.6g}" in line
            assert f"({'+-'}{form.largest})" in line
        for output in fixed.scheme.outputs:
            assert f"Error: {output} at most {at_most(fixed.error[output], 3)} N m" in line
        assert "No overflow:" in line
        assert max(map(len, text.splitlines())) <= 120
        assert text == files_of(fixed, name).header()


def test_sums_fit_and_every_count_fits_its_word(programmes: dict[str, FixedPoint]) -> None:
    for fixed in programmes.values():
        for section in fixed.sections:
            for row in (*section.signals, *section.states):
                assert row.largest < 2 ** (row.accumulator - 1)
        assert all(form.largest < 2 ** (form.bits - 1) for form in fixed.formats.values())
    widths = {row.accumulator for one in programmes["lags_q15"].sections for row in (*one.signals, *one.states)}
    assert 64 in widths
