"""Every public call with a wrong argument in turn: refused in a sentence, or a legitimate value; never anything else.

The calls are made in processes of their own (`contract_calls`), since what this finds may end the process.
"""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path

import pytest

import contract_calls
from contract_calls import FAST, Outcome, cases

# Answered although the argument is wrong at first sight, with the reason.
ANSWERED = {
    ("requirements.Requirement.judge", "measured"): "a value that is no number does not meet its limit",
    ("requirements.Requirement.ratio", "measured"): "a value that is no number does not meet its limit",
    ("analysis.sensitivities", "loop"): "a matrix that is not finite has no sensitivity, and leaves the others alone",
    ("analysis.spectral_abscissa", "poles"): "numbers are poles, whole or complex ones",
    ("linearisation.expect_model", "given"): "it judges any object",
    ("description.expect_platform", "given"): "it judges any object",
    ("certificates.proved", "problem"): "any object: it is handed on",
    ("export.write_c", "entries"): "an empty list of controllers",
}


def outcomes(names: list[str], labels: str, share: int, folder: Path, *python: str) -> list[Outcome]:
    """Return what came of every `share`-th call of the named cases, past those that end their process."""
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
            str(share),
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
        answered = (one.what == "answer" and refused) or (one.what == "nan" and "nan" in one.label.lower())
        if one.what not in ("refused", "answer", "nan") or (answered and (one.case, one.parameter) not in ANSWERED):
            bad.append(f"{one.case}({one.parameter}: {one.label}) {one.what} {one.said}")
    return "\n".join(bad)


def functions() -> list[str]:
    """Return all cases but constructors of values, whose fields are judged in `test_frozen_fields`."""
    return [name for name, case in cases().items() if not case.fields]


def test_every_public_name_has_valid_arguments_in_the_table() -> None:
    assert cases()


def test_every_argument_of_another_kind_is_refused_in_a_sentence(tmp_path: Path) -> None:
    assert wrong(outcomes(functions(), FAST, 1, tmp_path), refused=True) == ""


@pytest.mark.slow
def test_no_call_raises_anything_else_hangs_or_ends_the_process(tmp_path: Path) -> None:
    assert wrong(outcomes(functions(), "", 5, tmp_path), refused=False) == ""


@pytest.mark.slow
def test_arguments_are_refused_without_assertions_too(tmp_path: Path) -> None:
    assert wrong(outcomes(functions(), FAST, 3, tmp_path, "-O"), refused=True) == ""


ALONE = """
import numpy as np
from concurrent.futures import ThreadPoolExecutor
import platform_ctrl as pc
from platform_ctrl import analysis
system, w = pc.state_space(pc.linearise(pc.read_platform("rate_gyro"))), np.geomspace(0.1, 100.0, 50)
one = analysis.frequency_response(system, w)
with ThreadPoolExecutor(4) as pool:
    found = list(pool.map(lambda _: analysis.frequency_response(system, w), range(8)))
print(sum(np.array_equal(one, other) for other in found))
"""


@pytest.mark.parametrize("python", [(), ("-O",)], ids=["plain", "-O"])
def test_threads_agree_where_nothing_can_be_written(python: tuple[str, ...]) -> None:
    nowhere = dict.fromkeys(("HOME", "NUMBA_CACHE_DIR", "MPLCONFIGDIR", "XDG_CACHE_HOME"), f"{os.devnull}/none")
    command = [sys.executable, *python, "-c", ALONE]
    done = subprocess.run(command, env=os.environ | nowhere, capture_output=True, text=True, check=False)
    assert done.stdout == "8\n", done.stderr
