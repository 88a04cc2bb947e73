"""Formulas as browsers show them: bold Greek letters, and the number of an equation beside it."""

from __future__ import annotations

import re

_BOLD = re.compile(r'<mi mathvariant="bold-italic">(?:&#x([0-9A-Fa-f]+);|(\w))</mi>')
_BLOCK = re.compile(
    r'(?:<p>\((?P<number>[0-9]+[a-z]?)\)</p>\s*)?(?P<formula><math display="block".*?</math>)', re.DOTALL
)
# Of MathML's letter styles browsers know only the upright one; bold letters are characters of their own.
_ALPHABETS = ((0x3B1, 0x3C9, 0x1D736), (0x391, 0x3A9, 0x1D71C), (0x61, 0x7A, 0x1D482), (0x41, 0x5A, 0x1D468))


def shown(html: str) -> str:
    """Return a page's HTML with its formulas made fit to be shown."""
    return _BLOCK.sub(_equation, _BOLD.sub(_bold, html))


def _bold(found: re.Match[str]) -> str:
    code = int(found[1], 16) if found[1] else ord(found[2])
    for first, last, bold in _ALPHABETS:
        if first <= code <= last:
            return f"<mi>&#x{bold + code - first:X};</mi>"
    return found[0]


def _equation(found: re.Match[str]) -> str:
    number = f'<span class="number">({found["number"]})</span>' if found["number"] else ""
    return f'<div class="equation"><div class="formula">{found["formula"]}</div>{number}</div>'
