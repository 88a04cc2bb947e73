"""Any controller as C: random ones, clustered and defective poles, hostile names, torques without limits."""

from __future__ import annotations

import ctypes
import dataclasses
import subprocess
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from generated_c import Machine, classical_entry, compiled, compiler, entry, gyro_entry, pair
from platform_ctrl.analysis.arrays import StateArrays
from platform_ctrl.analysis.response import frequency_response
from platform_ctrl.common.values import FloatArray
from platform_ctrl.errors import ArgumentError, InputError
from platform_ctrl.export import write_c
from platform_ctrl.export.c99.c_text import FILES, Names, comment, field_names, identifier
from platform_ctrl.export.c99.floating_files import FloatingFiles
from platform_ctrl.export.c99.from_design import entries_of, same_response, scheme_of, with_excess
from platform_ctrl.export.c99.scheme import Entry, Provenance, Row, Scheme, Section, Term, arrays, excess_gain
from platform_ctrl.export.c99.windup import back_calculation, integrating
from platform_ctrl.job.job import Job

PERIOD = 0.0005


def controller(A: FloatArray, seed: int = 0, size: float = 1.0) -> Entry:
    """Some controller of gimbals 9 and 10 with these poles."""
    rng = np.random.default_rng(seed)
    n = len(A)
    B, C, D = rng.standard_normal((n, 2)), size * rng.standard_normal((2, n)), size * rng.standard_normal((2, 2))
    return Entry(
        loop="caging 9-10", arrays=StateArrays(A, B, C, D, PERIOD), inputs=("alpha9", "beta10"), outputs=("Q9", "Q10")
    )


def turned(A: FloatArray, seed: int) -> FloatArray:
    """The same matrix in other, badly scaled states."""
    T = np.random.default_rng(seed).standard_normal(A.shape) * np.logspace(-3, 3, len(A))
    return np.linalg.solve(T, A @ T)


@st.composite
def stable(draw: st.DrawFn) -> tuple[FloatArray, int]:
    """A stable matrix with real poles, pairs, integrators, repeated poles and chains of them."""
    blocks = []
    for _ in range(draw(st.integers(1, 4))):
        kind = draw(st.sampled_from(["real", "pair", "integrator", "chain", "zero"]))
        z = draw(st.floats(-0.95, 0.95))
        if kind == "pair":
            radius, angle = draw(st.floats(0.05, 0.99)), draw(st.floats(0.05, 3.0))
            re, im = radius * np.cos(angle), radius * np.sin(angle)
            blocks.append(np.array([[re, im], [-im, re]]))
        elif kind == "chain":
            blocks.append(np.array([[z, 1.0], [0.0, z]]))
        else:
            blocks.append(np.array([[{"real": z, "integrator": 1.0, "zero": 0.0}[kind]]]))
    n = sum(map(len, blocks))
    A, k = np.zeros((n, n)), 0
    for block in blocks:
        A[k : k + len(block), k : k + len(block)] = block
        k += len(block)
    return A, draw(st.integers(0, 2**20))


@given(case=stable())
@settings(max_examples=30, deadline=None)
def test_whatever_is_written_out_is_the_same_controller(job: Job, case: tuple[FloatArray, int]) -> None:
    A, seed = case
    given_one = controller(turned(A, seed), seed)
    scheme = scheme_of(job, given_one)
    made, own = arrays(scheme), given_one.arrays
    w = np.array([3.0, 60.0, 700.0, 3000.0, 6000.0])
    a, b = (frequency_response(StateArrays(*K[:4], PERIOD), w, -3) for K in (made, own))
    assert np.linalg.norm(a - b) <= 1e-7 * np.linalg.norm(b)
    # With back-calculation no integral winds up, or there is a note.
    windup = back_calculation(scheme)
    if not windup.notes:
        assert np.abs(np.linalg.eigvals(made.A - windup.gain @ made.C)).max() < 1.0 + 1e-9


def test_poles_apart_are_sections_of_one_or_two_states_and_a_chain_stays_together(job: Job) -> None:
    A = np.zeros((7, 7))
    A[0, 0], A[1, 1] = 1.0, 0.4
    A[2:4, 2:4] = [[0.6, 0.3], [-0.3, 0.6]]
    A[4:7, 4:7] = [[0.9, 1.0, 0.0], [0.0, 0.9, 1.0], [0.0, 0.0, 0.9]]
    scheme = scheme_of(job, controller(turned(A, 5), 5))
    sizes = {section.name: (len(section.states), section.kind, section.note) for section in scheme.sections}
    assert sorted(size for size, _, _ in sizes.values()) == [0, 1, 1, 2, 3]
    assert sizes["mode_1"][1:] == ("integral", "integrator")
    notes = " ".join(note for _, _, note in sizes.values())
    assert "lie close together" in notes
    assert f"pole at {-np.log(0.4) / PERIOD / (2 * np.pi):.4f}"[:12] in notes


def test_a_cluster_that_cannot_be_split_is_still_the_same_controller(job: Job) -> None:
    # Nearly defective: eigenvectors would be worth no digit.
    A = np.diag(0.9 + 1e-9 * np.arange(6)) + np.diag(np.ones(5), 1)
    one = controller(A, 2)
    scheme = scheme_of(job, one)
    assert same_response(arrays(scheme), one.arrays)


def test_options_that_do_not_give_the_matrices_are_not_used(job: Job) -> None:
    e = classical_entry(job, ("9", "10"))
    e["options"] = e["options"] | {"crossover_hz": 71.0}
    scheme = scheme_of(job, entries_of(job, [e])[0])
    assert {section.kind for section in scheme.sections} >= {"states", "integral"}
    own = [np.array(e[name]) for name in "ABCD"]
    assert same_response(arrays(scheme), StateArrays(*own, dt=PERIOD))
    right = classical_entry(job, ("9", "10"), spin_notch_hz=190.0, spin_notch_depth=0.1, spin_notch_width=0.1)
    kinds = [section.kind for section in scheme_of(job, entries_of(job, [right])[0]).sections]
    assert kinds.count("notch") == 4
    assert "states" not in kinds


@pytest.mark.parametrize("lead", [0.0, -7.0, 1e308, 1e-308, float("nan")])
def test_options_that_are_nonsense_are_not_used_either(job: Job, lead: float) -> None:
    e = classical_entry(job, ("9", "10"))
    e["options"] = e["options"] | {"lead_hz": lead, "rolloff_hz": lead}
    made = entries_of(job, [e])[0]
    scheme = scheme_of(job, made)
    assert scheme.sections[0].name == "mode_1"
    assert same_response(arrays(scheme), made.arrays)


def test_controllers_of_one_name_do_not_overwrite_each_other(job: Job, tmp_path: Path) -> None:
    gains = np.zeros((0, 0)), np.zeros((0, 2)), np.zeros((2, 0)), np.eye(2)
    one, other = entry(job, "Gyro 9.", gains, ("9", "10")), entry(job, "gyro 9", gains, ("5", "7"))
    others = [other, other | {"outputs": ["Q4", "M1"]}]
    files = write_c(job, [one, *others], tmp_path).files
    assert [f.stem for f in files[::2]] == ["gyro_9", "gyro_9_2", "gyro_9_3", "three_gyro_platform"]
    compiled(files, tmp_path / "lib.so")


def test_random_controllers_compiled_are_what_their_matrices_say(job: Job, tmp_path: Path) -> None:
    files, cases = [], []
    rng = np.random.default_rng(11)
    for k in range(5):
        n = 1 + 2 * k
        A = rng.standard_normal((n, n))
        A *= 0.97 / np.abs(np.linalg.eigvals(A)).max()
        scheme = scheme_of(job, controller(A, k, size=10.0))
        number = "double" if k % 2 else "float"
        signals = {name: name for name in (*scheme.inputs, *scheme.outputs)}
        unit = FloatingFiles(scheme=scheme, number=number, prefix=f"c{k}", signals=signals)
        files += pair(unit, tmp_path)
        cases.append((scheme, A, number))
    library = compiled(files, tmp_path / "lib.so")
    for k, (scheme, A, number) in enumerate(cases):
        own = controller(A, k, size=10.0).arrays
        fields = ["Q9", "Q10", "Q9_commanded", "Q10_commanded"]
        made = Machine(library, f"c{k}", scheme.inputs, fields, getattr(ctypes, f"c_{number}"))
        readings = 1e-3 * rng.standard_normal((200, 2))
        x, expected = np.zeros(len(A)), []
        for y in readings:
            expected.append(own.C @ x + own.D @ y)
            x = own.A @ x + own.B @ y
        out, _ = made.run(readings)
        size = np.abs(expected).max()
        assert np.abs(out[:, 2:] - expected).max() <= (1e-10 if number == "double" else 1e-4) * size


def hostile() -> Scheme:
    """A scheme whose names are meant to break out of identifiers and comments."""
    inputs = (
        "int", "π/2", "a b", "a-b", "9 lives", "*/ #error x /*", "Q_commanded", "NULL", "x\\", "??/", "excess Q",
        "k Q from int",
    )  # fmt: skip
    outputs = ("Q", "class", "last", "limited Q", "DBL_MAX")
    terms = tuple(Term(coefficient=0.5 + k, source=name) for k, name in enumerate(inputs))
    weights = tuple(Term(coefficient=0.5, source=name, name="*/") for name in ("while", "last state"))
    section = Section(
        name="*/ int x; /*", kind="states", note="??/ \\ */ // \n#error \u202e bidi /* ¿qué? π",
        signals=tuple(Row(target=name, terms=terms + weights) for name in outputs),
        states=(Row(target="while", terms=weights), Row(target="last state", terms=(*weights, terms[0]))),
    )  # fmt: skip
    return Scheme(
        name="*/ main() { } /* for \n while", inputs=inputs, input_units=("*/",) * 12, outputs=outputs,
        output_units=("N m",) * 5, sections=(section,), torque_limits=(0.5, np.inf, 2.0, np.inf, 1.0),
        excess=(Row(target="while", terms=(Term(coefficient=0.1, source="Q"),)),), period=0.001, delay=0.00025,
        provenance=Provenance(job="*/ x ??/", plant="\n#error", loop="π", design="/*", method="*/", command="a \\\n b"),
    )  # fmt: skip


@pytest.mark.parametrize("name", ["gcc", "g++"])
def test_hostile_names_become_identifiers_and_comments(name: str, tmp_path: Path) -> None:
    scheme = hostile()
    signals = field_names([*scheme.inputs, *scheme.outputs])
    assert len({s.lower() for s in signals.values()}) == 17
    files = []
    for number in ("double", "float"):
        unit = FloatingFiles(scheme=scheme, number=number, prefix=f"for_{number}", signals=signals)
        files += pair(unit, tmp_path)
    library = compiled(files, tmp_path / "lib.so", name)
    if name == "gcc":
        for flag in ("-ffast-math", "-ffinite-math-only"):
            command = [compiler(), flag, "-fsyntax-only", str(files[1])]
            done = subprocess.run(command, capture_output=True, text=True, timeout=60, check=False)
            assert done.returncode != 0
            assert "compile without" in done.stderr
        fields = [signals[n] for n in scheme.outputs]
        made = Machine(
            library,
            "for_double",
            [signals[n] for n in scheme.inputs],
            [*fields, *(f"{field}_commanded" for field in fields)],
            ctypes.c_double,
        )
        out, status = made.step([1e-2] * 12)
        total = 1e-2 * sum(0.5 + k for k in range(12))
        assert out == pytest.approx([total if total < 0.5 else 0.5] + [total] * 9)
        assert status == int(total > 0.5)


def test_identifiers_and_comments_are_safe() -> None:
    assert identifier("caging 4-5-7") == "caging_4_5_7"
    assert identifier("α9") == "alpha9"
    assert identifier("int") == "int_n"
    assert identifier("int16_t") == "int16_t_n"
    assert Names(24, FILES)["stdint"] == "stdint_2"
    names = Names()
    assert names["limited", "Q"] != names["limited Q"]
    assert names["limited", "Q"] == names["limited", "Q"]
    assert identifier("5") == "n5"
    assert identifier("***") == "n"
    assert identifier("__x__") == "x"
    assert identifier("three-gyro platform: caging and stabilisation", 24) == "three_gyro_platform"
    assert len(identifier("x" * 500)) == 48
    assert comment("a */ b /* c ??/ d\\\n\te") == "a * / b / * c ? ?/ d/ e"
    assert "??" not in comment("?" * 9)
    assert comment("kg m² μ") == "kg m2 mu"


def test_a_controller_without_states_or_limits_is_written_too(job: Job, tmp_path: Path) -> None:
    [one] = entries_of(job, [gyro_entry(job, [], [], [], [[0.0, -1.0], [2.0, 0.0]])])
    scheme = dataclasses.replace(scheme_of(job, one), torque_limits=(np.inf, np.inf))
    assert "none" in back_calculation(scheme).remark
    signals = {name: name for name in (*one.inputs, *one.outputs)}
    unit = FloatingFiles(scheme=scheme, number="double", prefix="gain", signals=signals)
    made = Machine(
        compiled(pair(unit, tmp_path), tmp_path / "lib.so"),
        "gain",
        one.inputs,
        ["Q9", "Q10", "a", "b"],
        ctypes.c_double,
    )
    assert made.step([3.0, 5.0]) == ([-5.0, 6.0, -5.0, 6.0], 0)


def test_integrals_that_no_limited_output_determines_have_a_note(job: Job) -> None:
    one = controller(np.eye(3), 4)
    windup = back_calculation(scheme_of(job, one))
    assert "1 of 3 integrating states" in windup.notes[0]
    none = controller(np.diag([0.5, 0.2]), 4)
    assert "no state integrates" in back_calculation(scheme_of(job, none)).remark
    V, own = integrating(one.arrays)
    assert V.shape == (3, 3)
    assert np.allclose(one.arrays.A @ V, V @ own)


@pytest.mark.parametrize("size", [1e300, 1.0, 1e-300])
def test_responses_of_any_size_are_distinguished(size: float) -> None:
    one = np.ones((1, 1))
    K = StateArrays(A=0.5 * one, B=one, C=size * one, D=size * one, dt=0.001)
    assert same_response(K, K)
    for change in (1.0 + 1e-6, -1.0):
        assert not same_response(K._replace(B=change * one), K)


def test_schemes_that_make_no_sense_are_refused(job: Job) -> None:
    scheme = scheme_of(job, controller(np.diag([0.5]), 1))
    unknown = Section(name="x", kind="mix", signals=(Row(target="y", terms=(Term(coefficient=1.0, source="z"),)),))
    with pytest.raises(ArgumentError, match="uses 'z'"):
        arrays(dataclasses.replace(scheme, sections=(unknown, *scheme.sections)))
    with pytest.raises(ArgumentError, match="exists twice"):
        arrays(dataclasses.replace(scheme, sections=(*scheme.sections, scheme.sections[-1])))
    with pytest.raises(ArgumentError, match="'M1' has no signal"):
        arrays(dataclasses.replace(scheme, outputs=("Q9", "M1")))
    with pytest.raises(ArgumentError, match="the same name"):
        arrays(dataclasses.replace(scheme, inputs=("alpha9", "mode_1")))
    bad = Row(target="mode_1", terms=(Term(coefficient=1.0, source="M1"),))
    with pytest.raises(ArgumentError, match="excess of 'M1'"):
        excess_gain(dataclasses.replace(scheme, excess=(bad,)))
    assert np.array_equal(excess_gain(with_excess(scheme, np.array([[3.0, 0.0]]))), [[3.0, 0.0]])


def test_entries_are_checked_as_those_of_a_result_file(job: Job) -> None:
    good = classical_entry(job, ("9", "10"))
    with pytest.raises(ArgumentError, match="list of controllers"):
        entries_of(job, good)  # type: ignore[arg-type]
    with pytest.raises(InputError, match="list of controllers"):
        entries_of(job, [])
    with pytest.raises(InputError, match="dt"):
        entries_of(job, [good | {"dt": 0.001}])
    added = {"inputs": [*good["inputs"], "excess_Q9", "excess_Q10"], "B": np.ones((8, 4)).tolist()}
    with pytest.raises(InputError, match="acts on an output of the same step"):
        entries_of(job, [good | added | {"D": np.ones((2, 4)).tolist()}])
