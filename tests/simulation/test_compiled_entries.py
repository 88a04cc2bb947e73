"""Compiled code trusts shapes: every public way into it judges them first, and no call ends the process."""

from __future__ import annotations

import os
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from platform_ctrl import analysis
from platform_ctrl.analysis.norms import noise_rms
from platform_ctrl.analysis.system import System
from platform_ctrl.errors import ArgumentError
from platform_ctrl.simulation.batch import compile_kernel
from platform_ctrl.simulation.compilation import is_compiled

W = np.array([1.0, 2.0])
ENTRIES: dict[str, Callable[[System], Any]] = {
    "frequency_response": lambda system: analysis.frequency_response(system, W),
    "hinf_norm": analysis.hinf_norm,
    "noise_rms": lambda system: noise_rms(system, np.ones(1)),
}


def arrays() -> list[np.ndarray]:
    """Return A, B, C, D of a stable system, continuous and sampled, of two states, an input and an output."""
    return [0.1 * np.array([[-1.0, 1.0], [0.0, -2.0]]), np.ones((2, 1)), np.ones((1, 2)), np.zeros((1, 1))]


@pytest.mark.parametrize("name", ENTRIES)
def test_arrays_that_do_not_fit_one_another_or_are_not_finite_are_refused(name: str) -> None:
    function = ENTRIES[name]
    function(System(*arrays(), dt=0.1))
    for place in range(4):
        shape = arrays()[place].shape
        misfits = [np.zeros(one) for one in ((), (2,), (3, 3), (1, 3), (3, 1), (5, 5), (0, 0), (2, 3, 3))]
        for wrong in misfits + [np.full(shape, one) for one in (np.nan, np.inf, 1j, "1", None)]:
            given: list[Any] = arrays()
            given[place] = wrong
            with pytest.raises(ArgumentError):
                function(System(*given, dt=0.1))


KEPT = {
    "inner.py": (
        "from platform_ctrl.common.compiling import internal\n@internal\ndef inner(x):\n    return {factor} * x\n"
    ),
    "outer.py": (
        "from inner import inner\nfrom platform_ctrl.common.compiling import compiled\n"
        "@compiled\ndef outer(x):\n    return inner(x) + 1.0\n"
    ),
}
CALL = "from outer import outer; print(outer(1.0), *map(len, (outer.stats.cache_hits, outer.stats.cache_misses)))"


def test_what_is_kept_is_compiled_again_when_a_neighbouring_file_changes(tmp_path: Path) -> None:
    """Numba looks at the function's own file alone; that others count, too, goes through names that it may change."""
    found = []
    for factor in (2.0, 2.0, 30.0):
        for name, text in KEPT.items():
            written, path = text.format(factor=factor), tmp_path / name
            if not path.exists() or path.read_text(encoding="utf-8") != written:
                path.write_text(written, encoding="utf-8")
        environment = os.environ | {"NUMBA_CACHE_DIR": str(tmp_path / "cache")}
        command = [sys.executable, "-c", CALL]
        done = subprocess.run(command, cwd=tmp_path, env=environment, capture_output=True, text=True, check=False)
        assert done.returncode == 0, done.stderr
        found.append(done.stdout.split())
    # The value, how often it was found in the cache, how often it was not.
    assert found == [["3.0", "0", "1"], ["3.0", "1", "0"], ["31.0", "0", "1"]]


def test_whether_the_kernel_is_compiled_is_read_off_numbas_files() -> None:
    compile_kernel()
    assert is_compiled()
