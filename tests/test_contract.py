"""Every public call with a wrong argument in turn: refused in a sentence, or a legitimate value; never anything else.

The calls are made in processes of their own (`contract_calls`), since what this finds may end the process.
"""

from __future__ import annotations

import ast
import json
import os
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest

import contract_calls
import platform_ctrl
from contract_calls import FAST, SHAPES, Outcome, cases

# More calls than a case has.
ALL = 10**6
# The long sweeps go by packages; "others" are all that are not named before.
PARTS = ("analysis", "campaign", "design", "export", "report", "others")
# Answered although the argument is wrong at first sight, with the reason.
ANSWERED = {
    ("analysis.Channel", "input_weight"): "kinds of systems are told apart where it is used",
    ("analysis.Channel", "output_weight"): "kinds of systems are told apart where it is used",
    ("export.write_c", "entries"): "an empty list of controllers",
}


def outcomes(names: list[str], labels: str, count: int, folder: Path, *python: str) -> list[Outcome]:
    """Return what came of `count` calls of each of the named cases, past those that end their process."""
    found: list[Outcome] = []
    environment = os.environ | {"OPENBLAS_NUM_THREADS": "1", "MPLBACKEND": "agg"}
    while True:
        read, write = os.pipe()
        command = [
            sys.executable,
            *python,
            contract_calls.__file__,
            json.dumps(names),
            labels,
            str(count),
            str(len(found)),
        ]
        with subprocess.Popen(
            command,
            pass_fds=[write],
            env=environment | {"CONTRACT_REPORT": str(write)},
            cwd=folder,
            stdout=subprocess.DEVNULL,
            stderr=subprocess.PIPE,
            text=True,
        ) as child:
            os.close(write)
            begun = None
            with os.fdopen(read) as lines:
                for line in lines:
                    entry = json.loads(line)
                    if len(entry) == 3:
                        begun = entry
                    else:
                        found.append(Outcome(*entry))
                        begun = None
            _, said = child.communicate()
        if child.returncode == 0:
            return found
        assert begun is not None, said
        found.append(Outcome(*begun, "died", f"exit code {child.returncode}"))


def wrong(found: list[Outcome], refused: bool) -> str:
    """Return the calls that did what none may do; with `refused`, answers count as well."""
    bad = []
    for one in found:
        if one.label in ("kind", "call") and one.said.startswith("TypeError") and " takes " in one.said:
            continue  # a function that was given and takes other arguments
        answered = (one.what == "answer" and refused) or (one.what == "nan" and "nan" in one.label.lower())
        if one.what not in ("refused", "answer", "nan") or (answered and (one.case, one.parameter) not in ANSWERED):
            bad.append(f"{one.case}({one.parameter}: {one.label}) {one.what} {one.said}")
    return "\n".join(bad)


def functions() -> list[str]:
    """Return all cases but constructors of values."""
    return [name for name, case in cases().items() if not case.fields]


def inputs() -> list[str]:
    """Return the constructors of values that users make; those of results are for the package alone."""
    kinds: dict[str, Any] = {name: case.function for name, case in cases().items() if case.fields}
    return [name for name, kind in kinds.items() if hasattr(kind, "_settled") and kind._settled != kind.__post_init__]


def part(name: str) -> list[str]:
    """Return the cases of one of PARTS."""
    first = [(every, every.split(".")[0]) for every in functions() + inputs()]
    return [every for every, package in first if (package if package in PARTS else "others") == name]


def test_every_public_name_has_valid_arguments_in_the_table() -> None:
    assert cases()


def test_every_argument_of_another_kind_is_refused_in_a_sentence(tmp_path: Path) -> None:
    assert wrong(outcomes(functions() + inputs(), FAST, ALL, tmp_path), refused=True) == ""


def test_some_wrong_shapes_and_sizes_of_each_function_end_in_a_sentence_or_an_answer(tmp_path: Path) -> None:
    assert wrong(outcomes(functions() + inputs(), SHAPES, 4, tmp_path), refused=False) == ""


@pytest.mark.slow
@pytest.mark.parametrize("package", PARTS)
def test_no_call_raises_anything_else_hangs_or_ends_the_process(package: str, tmp_path: Path) -> None:
    assert wrong(outcomes(part(package), "", 25, tmp_path), refused=False) == ""


@pytest.mark.slow
@pytest.mark.parametrize("package", PARTS)
def test_arguments_are_refused_without_assertions_too(package: str, tmp_path: Path) -> None:
    assert wrong(outcomes(part(package), FAST, 4, tmp_path, "-O"), refused=True) == ""


# What answered otherwise than in a sentence once: case, parameter, argument.
FOUND = (
    ("parameter_varying.ParameterVaryingModel.grid", "points", "sampled"),
    ("parameter_varying.ParameterVaryingModel.rhs", "Omega_dot", "frd"),
    ("result.Precession.error", "frequency", "with 1e308"),
    ("analysis.hinf_norm", "tolerance", "10^30"),
    ("design.from_crossover_and_margin", "gimbals", "[]"),
    ("design.limited_loop", "lag", "empty"),
    ("design.limited_loop", "limits", "3-d"),
    ("design.lqe", "R1", "with 1e308"),
    ("design.measured_pid", "sensitivity_peak", "inf"),
    ("design.sampled_hinf", "period", "10^30"),
    ("design.structured", "seed", "-1"),
    ("figures.nyquist", "labels", "sampled"),
    ("simulation.TimeTable.at", "t", "1j"),
)


@pytest.mark.parametrize(("name", "parameter", "label"), FOUND)
def test_what_was_not_judged_once_is_refused_in_a_sentence(name: str, parameter: str, label: str) -> None:
    case = cases()[name]
    call = next(one for one in contract_calls.calls(case) if (one.parameter, one.label) == (parameter, label))
    assert contract_calls.outcome(case, parameter, call.wrong)[0] == "refused"


def test_assertions_only_tell_the_type_checker_what_is_known() -> None:
    # Without assertions (-O) the same arguments are refused: none of them judges a value.
    found = []
    for path in Path(platform_ctrl.__file__).parent.rglob("*.py"):
        for node in ast.walk(ast.parse(path.read_text())):
            if isinstance(node, ast.Assert):
                said = ast.unparse(node.test)
                if not (said.endswith(" is not None") or said.startswith("isinstance(")):
                    found.append(f"{path.name}:{node.lineno}: {said}")
    assert found == []


ALONE = """
import sys
import numpy as np
from concurrent.futures import ThreadPoolExecutor
from numba.core import caching
def refuse(self): raise OSError("a folder that cannot be written")
if "no cache" in sys.argv:
    caching.InTreeCacheLocator.ensure_cache_path = caching.UserWideCacheLocator.ensure_cache_path = refuse
import platform_ctrl as pc
from platform_ctrl import analysis, simulation
platform, w = pc.read_platform("rate_gyro"), np.geomspace(0.1, 100.0, 50)
system, n = pc.state_space(pc.linearise(platform)), len(platform.gimbals)
v = np.full((3, n + 3), 0.1)
calls = [lambda: analysis.frequency_response(system, w)]
if "no cache" not in sys.argv:
    calls += [
        lambda: analysis.hinf_norm(system[:1, :1], allow_unstable=True)[0],  # its place is known to 1e-8 only
        lambda: pc.matrices(platform).A,
        lambda: simulation.rollout(platform, np.zeros((3, n)), v, step=1e-4, steps=20).q,
    ]
with ThreadPoolExecutor(4) as pool:
    for call in calls:
        one = call()
        # To a few last digits only: those of BLAS depend on where arrays lie in memory.
        agree = (np.allclose(one, other, rtol=1e-9, atol=1e-12) for other in pool.map(lambda _: call(), range(8)))
        print(sum(agree), end=" ")
"""


@pytest.mark.parametrize(
    ("python", "more"),
    [
        pytest.param((), (), id="plain"),
        pytest.param(("-O",), (), id="-O", marks=pytest.mark.slow),
        pytest.param((), ("no cache",), id="package not writable", marks=pytest.mark.slow),
    ],
)
def test_threads_agree_where_nothing_can_be_written(python: tuple[str, ...], more: tuple[str, ...]) -> None:
    nowhere = dict.fromkeys(("HOME", "MPLCONFIGDIR", "XDG_CACHE_HOME"), f"{os.devnull}/none")
    environment = {name: item for name, item in os.environ.items() if name != "NUMBA_CACHE_DIR"} | nowhere
    command = [sys.executable, *python, "-c", ALONE, *more]
    done = subprocess.run(command, env=environment, capture_output=True, text=True, check=False)
    assert done.stdout == ("8 " if more else "8 8 8 8 "), done.stderr
