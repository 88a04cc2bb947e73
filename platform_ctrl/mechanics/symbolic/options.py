"""Forms, terms and orders of the equations. Without SymPy: the command line reads them at every start."""

from __future__ import annotations

from typing import Literal, get_args

Written = Literal["text", "latex", "json"]
Form = Literal[Written, "sympy"]
# As in `linearise`.
Terms = Literal["paper", "exact"]

WRITTEN: tuple[Written, ...] = get_args(Written)
TERMS: tuple[Terms, ...] = get_args(Terms)
HIGHEST_ORDER = 3
