"""The equations in symbols, the paper's number by number. SymPy is loaded when they are derived.

Forms, terms and orders are defined here, without NumPy: the command line reads them at every start.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, Literal, get_args, overload

if TYPE_CHECKING:
    from platform_ctrl.mechanics.symbolic.derivation import Equations
    from platform_ctrl.plant.platform import Platform

Written = Literal["text", "latex", "json"]
Form = Literal[Written, "sympy"]
# As in `linearise`.
Terms = Literal["paper", "exact"]

WRITTEN: tuple[Written, ...] = get_args(Written)
TERMS: tuple[Terms, ...] = get_args(Terms)
HIGHEST_ORDER = 3


@overload
def equations(
    platform: Platform, form: Literal["text", "latex"] = ..., order: int | None = ..., terms: Terms = ...
) -> str: ...
@overload
def equations(platform: Platform, form: Literal["sympy"], order: int | None = ..., terms: Terms = ...) -> Equations: ...
@overload
def equations(
    platform: Platform, form: Literal["json"], order: int | None = ..., terms: Terms = ...
) -> dict[str, Any]: ...
def equations(
    platform: Platform, form: Form = "text", order: int | None = 1, terms: Terms = "paper"
) -> str | dict[str, Any] | Equations:
    """Return the platform's equations in symbols: the paper's (15), (19), (21) to (27).

    Parameters
    ----------
    platform
        The platform.
    form
        ``"text"``: to read; ``"latex"``: a fragment that needs amsmath; ``"sympy"``: an `Equations` value, to work on;
        ``"json"``: a dict of strings that `sympy.sympify` reads.
    order
        0 to 3: A, BᵀA_R B, G_A and G_R to this order in the angles, B to one more. None: exact, in sines and cosines
        (at most 5 gimbals, 3 deep); then these matrices leave nothing out, whatever `terms`.
    terms
        ``"paper"``: A constant, G_A from BᵀA_R B alone, and in (27) what the paper keeps. ``"exact"``: everything.

    Returns
    -------
    str, dict or Equations
        As `form` says.

    Raises
    ------
    ArgumentError
        Not a platform, unknown `form` or `terms`, `order` out of range, or None for a large tree.

    References
    ----------
    K. Magnus, Ingenieur-Archiv 1976, eqs. (15), (19), (21) to (27).

    See docs/theory/the-paper.md.
    """
    from platform_ctrl.common.arguments import one_of, whole
    from platform_ctrl.mechanics.symbolic import derivation, writing

    one_of("form", form, get_args(Form))
    one_of("terms", terms, TERMS)
    if order is not None:
        order = whole("order (or None for the exact matrices)", order, 0, HIGHEST_ORDER)
    found = derivation.derived(platform, order, terms)
    if form == "sympy":
        return found
    if form == "json":
        return writing.record_of(found)
    return writing.latex_of(found) if form == "latex" else writing.text_of(found)
