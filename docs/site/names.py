"""Public names: tables of them, the reference's entries, and links to these from wherever a name is set as code.

A module's names are those of its `__all__`, or all that it defines itself. Every class and function has one entry, on
the page of the module nearest to where it is defined; other modules that give it too have a row that leads there.
"""

from __future__ import annotations

import importlib
import inspect
import re
import sys
from functools import cache
from types import ModuleType
from typing import Any

# The modules that have their names on a page, as the pages ask for them.
MODULES: list[str] = []
MARK = re.compile(r"^<!-- names of ([\w.]+) -->$", re.MULTILINE)
# Outside the reference these are the fixtures of the pytest plugin.
_FIXTURES = ("assert_baseline", "closed_loop")
# Functions of one word are called like parameters and everyday words: only what is pointed to is led there.
_SEE = re.compile(r"\b((?:[Aa]s(?: in)?|[Ss]ee) )(?=<code>(\w+)</code>)(<code>\w+</code>)")
_PAGE = re.compile(r"(?<=<p>See )docs/([\w-]+)\.md")
_CODE = re.compile(
    r"<pre.*?</pre>|<h[1-6].*?</h[1-6]>|<a [^>]*>.*?</a>|<autoref.*?</autoref>|<code>([\w.]+)(?:\(\))?</code>",
    re.DOTALL,
)


@cache
def names(module: str) -> dict[str, Any]:
    """Return the public names of a module and what they stand for."""
    importlib.import_module(module)
    found = sys.modules[module]
    own = [name for name, item in vars(found).items() if name[0] != "_" and getattr(item, "__module__", "") == module]
    return {name: getattr(found, name) for name in getattr(found, "__all__", own)}


def documented(item: Any) -> bool:
    """Whether an object has an entry: classes and functions do."""
    return inspect.isclass(item) or inspect.isroutine(item)


def identifier(item: Any) -> str:
    """Return what the entry of a class or function is called: where it is defined."""
    return f"{item.__module__}.{item.__qualname__}"


@cache
def homes() -> dict[str, str]:
    """Return for every class and function by its identifier the module under which it has its entry."""
    out: dict[str, str] = {}
    for module in MODULES:
        for item in names(module).values():
            if documented(item):
                before = out.get(identifier(item))
                if before is None or _nearness(module, item) > _nearness(before, item):
                    out[identifier(item)] = module
    return out


def _nearness(module: str, item: Any) -> int:
    return len(module) if f"{item.__module__}.".startswith(f"{module}.") and module != "platform_ctrl" else 0


def entries(module: str) -> str:
    """Return what the reference has of a module: the table of its names, and the entries that are at home here."""
    rows, own = [], []
    for name, item in sorted(names(module).items(), key=lambda pair: pair[0].lower()):
        rows.append(f"| {_led(name, item)} | {_told(item)} |")
        if documented(item) and homes()[identifier(item)] == module:
            own.append(f"::: {identifier(item)}")
    return "| name | is |\n| --- | --- |\n" + "\n".join(rows) + "\n\n" + "\n\n".join(own) + "\n"


def _led(name: str, item: Any) -> str:
    if documented(item):
        return f"[`{name}`][{identifier(item)}]"
    return f"`{name}`"


def _told(item: Any) -> str:
    if documented(item) or isinstance(item, ModuleType):
        return (inspect.getdoc(item) or "").partition("\n\n")[0].replace("\n", " ").replace("|", "\\|")
    return f"`{item!r}`".replace("|", "\\|")


@cache
def _target(name: str) -> str | None:
    """Return the identifier of a name as pages write it (`pc.linearise`, `design.hinf`, `LinearModel`), or None."""
    head, _, rest = name.partition(".")
    if not rest:
        return _alone().get(name)
    try:
        item: Any = importlib.import_module("platform_ctrl")
        for part in (rest if head in ("pc", "platform_ctrl") else name).split("."):
            item = getattr(item, part)
    except AttributeError:
        return None
    return identifier(item) if documented(item) and item.__module__.startswith("platform_ctrl") else None


@cache
def _alone() -> dict[str, str]:
    """Return names that mean one thing wherever they stand: those of classes, and functions of several words."""
    functions = _functions()
    return {name: target for name, target in functions.items() if "_" in name or name[0].isupper()}


@cache
def _functions() -> dict[str, str]:
    """Return the names of classes and functions that no other public class or function has."""
    found: dict[str, set[str]] = {}
    for module in MODULES:
        for name, item in names(module).items():
            if documented(item):
                found.setdefault(name, set()).add(identifier(item))
    return {name: meant.pop() for name, meant in found.items() if len(meant) == 1}


def pages_linked(content: str, up: str) -> str:
    """Return a page's HTML with links where docstrings name a page of docs/, which is at `up`."""
    return _PAGE.sub(rf'<a href="{up}\1.html">\1</a>', content)


def linked(content: str, reference: bool) -> str:
    """Return a page's HTML with names of the package, set as code, led to the reference."""

    def link(found: re.Match[str]) -> str:
        target = _target(found[1]) if found[1] and (reference or found[1] not in _FIXTURES) else None
        return found[0] if target is None else f'<autoref identifier="{target}" optional>{found[0]}</autoref>'

    return _SEE.sub(_function_linked, _CODE.sub(link, content))


def _function_linked(found: re.Match[str]) -> str:
    target = _functions().get(found[2])
    return found[0] if target is None else f'{found[1]}<autoref identifier="{target}" optional>{found[3]}</autoref>'
