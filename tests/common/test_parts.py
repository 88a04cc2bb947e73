"""What compiled functions call is compiled into them: there is no machine code of it alone."""

from __future__ import annotations

import math
from typing import Any

import numba
import pytest

from platform_ctrl.common.parts import PartCompiler

njit: Any = numba.njit


@pytest.fixture
def part() -> Any:
    """A function that compiled ones alone call."""

    def area(radius: float) -> float:
        return math.pi * radius * radius

    return njit(no_cpython_wrapper=True, no_cfunc_wrapper=True, pipeline_class=PartCompiler)(area)


def test_a_part_has_no_machine_code_of_its_own(part: Any) -> None:
    part.compile((numba.float64,))
    (compiled,) = part.overloads.values()
    engine = compiled.library._codegen._engine
    assert not engine.is_symbol_defined(compiled.fndesc.mangled_name)


def test_a_function_computes_what_its_parts_do(part: Any) -> None:
    @njit(pipeline_class=PartCompiler, no_cpython_wrapper=True, no_cfunc_wrapper=True)
    def volume(radius: float, height: float) -> float:
        return part(radius) * height

    @njit
    def both(radius: float, height: float) -> float:
        return volume(radius, height) + part(radius)

    assert both(2.0, 3.0) == pytest.approx(math.pi * 4.0 * 4.0)
    assert both(1.0, 0.0) == pytest.approx(math.pi)
