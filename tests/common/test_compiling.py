"""What compiled functions call is compiled into them, without machine code of it alone; processes compile once."""

from __future__ import annotations

import math
import os
import subprocess
import sys
from pathlib import Path
from typing import Any

import numba
import pytest

from platform_ctrl.common.compiling import internal

njit: Any = numba.njit


@pytest.fixture
def part() -> Any:
    """A function that compiled ones alone call."""

    def area(radius: float) -> float:
        return math.pi * radius * radius

    return internal(area)


def test_a_part_has_no_machine_code_of_its_own(part: Any) -> None:
    part.compile((numba.float64,))
    (compiled,) = part.overloads.values()
    engine = compiled.library._codegen._engine
    assert not engine.is_symbol_defined(compiled.fndesc.mangled_name)


def test_a_function_computes_what_its_parts_do(part: Any) -> None:
    @internal
    def volume(radius: float, height: float) -> float:
        return part(radius) * height

    @njit
    def both(radius: float, height: float) -> float:
        return volume(radius, height) + part(radius)

    assert both(2.0, 3.0) == pytest.approx(math.pi * 4.0 * 4.0)
    assert both(1.0, 0.0) == pytest.approx(math.pi)


COMPILED = """
from platform_ctrl.common.compiling import compiled

@compiled
def square(x):
    return x * x
"""
CALLED = "from squares import square; square(2.0); print(sum(square.stats.cache_misses.values()))"


def test_of_two_processes_that_need_a_function_one_compiles_it(tmp_path: Path) -> None:
    pytest.importorskip("fcntl", reason="locks of files are those of POSIX")
    (tmp_path / "squares.py").write_text(COMPILED)
    environment = os.environ | {"NUMBA_CACHE_DIR": str(tmp_path / "cache"), "PYTHONPATH": str(tmp_path)}
    command = [sys.executable, "-c", CALLED]
    processes = [subprocess.Popen(command, env=environment, stdout=subprocess.PIPE, text=True) for _ in range(2)]
    assert sorted(process.communicate()[0].strip() for process in processes) == ["0", "1"]
