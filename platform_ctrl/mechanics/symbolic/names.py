"""Names of the symbols: valid and unique, however the plant's parts are called, and how they are shown."""

from __future__ import annotations

import builtins
import keyword
import unicodedata
from typing import Literal

from platform_ctrl.common.text import LETTERS, dotted, initial
from platform_ctrl.common.values import value

Kind = Literal[
    "inertia",
    "axial inertia",
    "momentum",
    "element",
    "specific force",
    "torque",
    "rate of the root",
    "acceleration of the root",
    "acceleration",
    "rate",
    "angle",
]

_DOTTED = ("{}", r"\dot{{{}}}", r"\ddot{{{}}}")
_ESCAPES = {c: f"\\{c}" for c in "&%$#_{}"} | {"\\": r"\backslash ", "~": r"\sim ", "^": r"\wedge "}
_COMMANDS = {letter: rf"\{name}" if name != "epsilon" else r"\varepsilon" for name, letter in LETTERS.items()}
# What prose in LaTeX needs; in mathematics the names of greek letters are read before.
_PROSE = (
    {c: f"\\{c}" for c in "&%$#_{}"}
    | {c: f"${command.strip()}$" for c, command in _ESCAPES.items() if c in "\\~^"}
    | {letter: rf"$\{name}$" for name, letter in LETTERS.items() if name != "epsilon"}
    | {"ε": r"$\varepsilon$", "²": "$^2$", "<": "$<$", ">": "$>$", "|": "$|$", "−": "$-$"}
)


@value
class NamedSymbol:
    """A symbol of the equations."""

    name: str  # of the SymPy symbol: an identifier that neither Python nor SymPy has taken
    # text, latex: how it is shown
    text: str
    latex: str
    kind: Kind  # what sort of quantity it is
    # meaning, unit: one line; SI
    meaning: str
    unit: str
    value: float | None = None  # the platform's number, SI; None for what changes with time


class Names:
    """Gives out names and notations, each only once."""

    def __init__(self) -> None:
        self._names: set[str] = set()
        self._texts: set[str] = set()

    def parameter(
        self, head: str, label: str, part: str, kind: Kind, meaning: str, unit: str, number: float | None
    ) -> NamedSymbol:
        """Return the symbol `head` of the part of the plant called `label`; `part` says which component."""
        digits = label.isascii() and label[:1].isdigit()
        plain = head + ("" if digits or not label else "_") + label + (f"_{part}" if part else "")
        name = self._unique(plain)
        # Head and label fall together with another symbol: the label in brackets tells them apart.
        apart = name != identifier(plain) or plain in self._texts
        shown = f"{head}({label})" + (f"_{part}" if part else "") if apart and label else plain
        text = self._shown(shown, name)
        inside = f"({_label(label)})" if apart and label else _label(label)
        below = ",".join(filter(None, (inside, part)))
        latex = f"{_head(head)}_{{{below}}}" if below else _head(head)
        return NamedSymbol(name=name, text=text, latex=latex, kind=kind, meaning=meaning, unit=unit, value=number)

    def motion(self, angle: str, dots: int, kind: Kind, meaning: str, unit: str) -> NamedSymbol:
        """Return an angle (or component of Omega) as the file names it, or its derivative."""
        name = self._unique(angle + {0: "", 1: "_dot", 2: "_ddot"}[dots])
        head, label = initial(angle)
        text = self._shown(dotted(angle, dots), name)
        below = _label(label.lstrip("_"))
        latex = _DOTTED[dots].format(_head(head)) + (f"_{{{below}}}" if below else "")
        return NamedSymbol(name=name, text=text, latex=latex, kind=kind, meaning=meaning, unit=unit)

    def _unique(self, wanted: str) -> str:
        name = identifier(wanted)
        while name in self._names:
            name += "_"
        self._names.add(name)
        return name

    def _shown(self, text: str, name: str) -> str:
        text = "_".join(text.split())
        out = text if text not in self._texts else name
        self._texts.add(out)
        return out


def identifier(wanted: str) -> str:
    """Return the nearest identifier to a name that Python, its built-in functions and SymPy leave free."""
    import sympy

    name = "".join(c if c.isalnum() else "_" for c in unicodedata.normalize("NFKC", wanted))
    name = name if name.isidentifier() else "q_" + name
    name = name if name.isidentifier() else "q_" + "_".join(str(ord(c)) for c in wanted)
    return name + "_" if keyword.iskeyword(name) or hasattr(builtins, name) or hasattr(sympy, name) else name


def _head(head: str) -> str:
    if head in LETTERS:
        return rf"\{head}" if head != "epsilon" else r"\varepsilon"
    return _COMMANDS.get(head) or (head if head.isascii() and len(head) == 1 and head.isalnum() else _word(head))


def _label(label: str) -> str:
    if not label or (label.isascii() and (label.isdigit() or (len(label) == 1 and label.isalpha()))):
        return label
    return _COMMANDS.get(label) or _word(label)


def _word(text: str) -> str:
    """Return a word in mathematics; letters that only text has stay text."""
    return rf"\mathrm{{{_escaped(text)}}}" if text.isascii() else rf"\text{{{text_in_latex(text)}}}"


def text_in_latex(text: str) -> str:
    """Return prose for text mode: LaTeX's own characters escaped, powers and Greek letters in mathematics."""
    return "".join(_PROSE.get(c, c) for c in text)


def _escaped(text: str) -> str:
    return "".join(_ESCAPES.get(c, c) for c in text).replace(" ", r"\ ")
