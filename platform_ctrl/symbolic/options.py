"""What may be asked of the equations. Light: the command line reads it before anything else is loaded."""

from __future__ import annotations

from typing import Literal, get_args

Written = Literal["text", "latex", "json"]
Form = Literal[Written, "sympy"]
# As in linearisation, which stands beside this package and is not imported by it.
Terms = Literal["paper", "exact"]

WRITTEN: tuple[Written, ...] = get_args(Written)
FORMS: tuple[Form, ...] = get_args(Form)
TERMS: tuple[Terms, ...] = get_args(Terms)
HIGHEST_ORDER = 3
