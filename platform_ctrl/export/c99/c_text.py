"""Text of generated C: identifiers and comments, whatever the names in a job are, and the templates of the files."""

from __future__ import annotations

import re
import textwrap
import unicodedata
from collections.abc import Iterable, Sequence
from functools import cache
from typing import TYPE_CHECKING

from platform_ctrl.common.files import templates
from platform_ctrl.common.text import LETTERS

if TYPE_CHECKING:
    from jinja2 import Environment

# Columns of generated code.
WIDTH = 100

_LATIN = {letter: name for name, letter in LETTERS.items()} | {"−": "-", "·": ".", "°": "deg", "ß": "ss", "ø": "o"}
# Keywords of C (to C23) and C++ (to C++23), what common headers and compilers define, and what generated code uses.
_WORDS = """
    alignas alignof and and_eq asm atomic_cancel atomic_commit atomic_noexcept auto bitand bitor bool break case catch
    char char8_t char16_t char32_t class co_await co_return co_yield compl complex concept const const_cast consteval
    constexpr constinit continue decltype default delete do double dynamic_cast else enum explicit export extern false
    final float for friend goto if imaginary import inline int long module mutable namespace new noexcept not not_eq
    nullptr operator or or_eq override private protected public reflexpr register reinterpret_cast requires restrict
    return short signed sizeof static static_assert static_cast struct switch synchronized template this thread_local
    throw true try typedef typeid typename typeof typeof_unqual union unsigned using virtual void volatile wchar_t while
    xor xor_eq near far huge interrupt fortran NULL NAN INFINITY I EOF errno main linux unix i386 vax arm assert
    in out state status last
"""
_RESERVED = frozenset(_WORDS.split())
# Headers of the standard libraries, which a file of that name would hide, and what Windows keeps for devices.
_FILES = """
    assert ccomplex complex ctype errno fenv float inttypes iso646 limits locale math setjmp signal stdalign stdarg
    stdatomic stdbool stdckdint stddef stdint stdio stdlib stdnoreturn string tgmath threads time uchar wchar wctype
    malloc memory poll pthread sched strings unistd new version aux con nul prn com1 com2 com3 com4 com5 com6 com7
    com8 com9 lpt1 lpt2 lpt3 lpt4 lpt5 lpt6 lpt7 lpt8 lpt9
"""
FILES = tuple(_FILES.split())
# What generated code appends to a signal's name.
_ENDINGS = ("_commanded", "_status")


class Identifiers:
    """Unique identifiers for names, at most `longest` characters; the same name gets the same identifier."""

    def __init__(self, longest: int, taken: tuple[str, ...] = ()) -> None:
        self._longest = longest
        # Compared without case: identifiers become file names and macros too.
        self._used = {name.lower() for name in taken}
        self._known: dict[str | tuple[str, ...], str] = {}

    def __getitem__(self, name: str | tuple[str, ...]) -> str:
        """Return the identifier of `name`; a tuple of words is a name that differs from all strings."""
        if name not in self._known:
            self._known[name] = self.new(name if isinstance(name, str) else " ".join(name))
        return self._known[name]

    def new(self, name: str) -> str:
        """Return an identifier that resembles `name` and was not given before."""
        base = identifier(name, self._longest)
        out, count = base, 1
        while out.lower() in self._used:
            count += 1
            out = f"{base[: self._longest - len(str(count)) - 1]}_{count}"
        self._used.add(out.lower())
        return out


def field_names(signals: Iterable[str]) -> dict[str, str]:
    """Return identifiers for the signals of a job, each a different one."""
    names = Identifiers(40)
    return {name: names[f"{name} n" if identifier(name).endswith(_ENDINGS) else name] for name in signals}


def identifier(name: str, longest: int = 48) -> str:
    """Return a C and C++ identifier that resembles `name`: ASCII, no keyword, not reserved."""
    out = re.sub(r"[^A-Za-z0-9]+", "_", "".join(_ascii(c) for c in name)).strip("_")
    if len(out) > longest:
        # A word is not cut where the words before it are long enough.
        head, _, last = out[: longest + 1].rpartition("_")
        out = head if len(head) > longest // 2 and last else out[:longest].rstrip("_")
    if not out or out[0].isdigit():
        out = f"n{out}"[:longest]
    # Macros are written in capitals, types of systems end in _t.
    if out in _RESERVED or out.lower() in _RESERVED or ("_" in out and out.isupper()) or out.lower().endswith("_t"):
        out = f"{out[: longest - 2]}_n"
    return out


def comment(text: str) -> str:
    """Return a text that may be part of a comment: printable ASCII on one line that neither ends nor nests it."""
    out = " ".join("".join(_ascii(c) if ord(c) > 126 else c if c.isprintable() else " " for c in text).split())
    # A trigraph would end a line in a backslash; three marks in a row hold two trigraphs' heads.
    return out.replace("*/", "* /").replace("/*", "/ *").replace("??", "? ?").replace("??", "? ?").replace("\\", "/")


def _ascii(c: str) -> str:
    if ord(c) < 127:
        return c
    if c in _LATIN:
        return _LATIN[c]
    plain = unicodedata.normalize("NFKD", c).encode("ascii", "ignore").decode()
    return plain if plain.strip() else f" U{ord(c):04X} "


def block(text: str) -> str:
    """Return a comment of several paragraphs, a line of `text` each."""
    lines = ["/*"]
    for paragraph in text.splitlines():
        # The padding behind a label is kept.
        label, _, rest = paragraph.partition(":")
        plain = comment(paragraph)
        if rest[:2] == "  ":
            plain = f"{comment(label)}:{' ' * (len(rest) - len(rest.lstrip()))}{comment(rest)}"
        lines += [f" * {line}".rstrip() for line in textwrap.wrap(plain, WIDTH - 3, subsequent_indent="  ") or [""]]
    return "\n".join([*lines, " */\n"])


def remark(text: str, indent: str) -> str:
    """Return a short comment."""
    lines = textwrap.wrap(comment(text), WIDTH - len(indent) - 6)
    return indent + "/* " + f"\n{indent} * ".join(lines) + " */"


def joined(head: str, parts: Sequence[str], between: str, tail: str) -> str:
    """Return a statement with operands and the operator between them, an operand a line if one line is too long."""
    line = f"{head}{f' {between} '.join(parts)}{tail}"
    if len(line) > WIDTH:
        indent = " " * (len(head) - len(head.lstrip()) + 4)
        line = f"{head}{f'{chr(10)}{indent}{between} '.join(parts)}{tail}"
    return line.replace("+ -", "- ")


def field(kind: str, name: str, what: str) -> str:
    """Return a field of a struct with a comment."""
    return f"    {kind} {name}; /* {comment(what)} */"


def signature(prefix: str, end: str = "") -> str:
    """Return the head of a step function, an argument a line where they do not fit on one."""
    head = f"unsigned int {prefix}_step("
    arguments = [f"{prefix}_state *state", f"const {prefix}_in *in", f"{prefix}_out *out"]
    line = f"{head}{', '.join(arguments)}){end}"
    return line if len(line) <= WIDTH else f"{head}\n    {f',{chr(10)}    '.join(arguments)}){end}"


@cache
def _environment() -> Environment:
    environment = templates("platform_ctrl.export.c99", keep_trailing_newline=True)
    environment.filters |= {"block": block, "comment": comment, "repr": repr}
    environment.globals |= {"signature": signature, "remark": remark, "joined": joined}
    return environment


def rendered(template: str, **words: object) -> str:
    """Return the text of a file."""
    return _environment().get_template(template).render(words)
