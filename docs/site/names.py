"""Public names: tables of them, the reference's entries, and links to these from wherever a name is set as code.

A page of docs/reference/python/ asks for the names of a public module with ``<!-- names of MODULE -->``: those of its
`__all__`, or all that it defines itself. ``<!-- entries of MODULE -->`` asks for what is defined in a module that is
not public itself. Every public class and function, and every class that one of them returns, has one entry: on the
page of the module nearest to where it is defined.
"""

from __future__ import annotations

import dataclasses
import importlib
import inspect
import re
import sys
from collections.abc import Iterator
from functools import cache
from pathlib import Path
from types import ModuleType
from typing import Any

MARK = re.compile(r"^<!-- (names|entries) of ([\w.]+) -->$", re.MULTILINE)
_PAGES = [path.read_text(encoding="utf-8") for path in sorted(Path(__file__).parents[1].glob("reference/python/*.md"))]
_MARKS = [mark for page in _PAGES for mark in MARK.findall(page)]
# The public modules.
MODULES = sorted(module for kind, module in _MARKS if kind == "names")
# Outside the reference these are the fixtures of the pytest plugin.
_FIXTURES = ("closed_loop",)
# Functions of one word are called like parameters and everyday words: only what is pointed to is led there.
_SEE = re.compile(r"\b((?:[Aa]s(?: in)?|[Ss]ee) )(?=<code>(\w+)</code>)(<code>\w+</code>)")
_PAGE = re.compile(r"(?<=<p>See )docs/([\w/-]+)\.md")
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
def public() -> dict[str, Any]:
    """Return the public classes and functions, each once, by the module that gives them and their name there."""
    found: dict[str, Any] = {}
    for module in MODULES:
        for name, item in names(module).items():
            if documented(item) and item not in found.values():
                found[f"{module}.{name}"] = item
    return found


@cache
def results() -> dict[str, type]:
    """Return the classes that users receive without a public name, by identifier: returned, or attributes of these."""
    waiting = list(public().values())
    found: dict[str, type] = {}
    while waiting:
        for kind in _given(waiting.pop()):
            if kind not in found.values() and kind not in public().values():
                found[identifier(kind)] = kind
                waiting.append(kind)
    return found


def _given(item: Any) -> Iterator[type]:
    """Yield the documented classes of the package that a function returns, or a class has as attributes or returns."""
    if not inspect.isclass(item):
        yield from _classes(item.__module__, inspect.signature(item).return_annotation)
        return
    for field in dataclasses.fields(item) if dataclasses.is_dataclass(item) else ():
        if field.name[0] != "_":
            yield from _classes(item.__module__, field.type)
    for name, member in vars(item).items():
        function = member.fget if isinstance(member, property) else member
        if name[0] != "_" and inspect.isfunction(function):
            yield from _classes(item.__module__, inspect.signature(function).return_annotation)


def _classes(module: str, annotation: object) -> Iterator[type]:
    for name in re.findall(r"\w+", str(annotation)):
        kind = getattr(sys.modules[module], name, None) or _imported_for_types(module).get(name)
        if inspect.isclass(kind) and kind.__module__.startswith("platform_ctrl") and "\nAttributes\n" in _doc(kind):
            yield kind


@cache
def _imported_for_types(module: str) -> dict[str, Any]:
    """Return what a module imports from the package for annotations only."""
    source = inspect.getsource(sys.modules[module])
    found = re.findall(r"^    from (platform_ctrl[\w.]*) import ([\w, ]+)$", source, re.MULTILINE)
    return {name: getattr(importlib.import_module(m), name, None) for m, many in found for name in many.split(", ")}


def _doc(item: Any) -> str:
    return inspect.getdoc(item) or ""


@cache
def homes() -> dict[str, str]:
    """Return for every public class and function and every result, by its identifier, the module with its entry."""
    entries = {module for kind, module in _MARKS if kind == "entries"}
    found = {}
    for name, item in _by_identifier().items():
        giving = {module for module in MODULES if item in names(module).values()}
        shown = entries | (giving or set(MODULES))
        inside = [module for module in shown if f"{item.__module__}.".startswith(f"{module}.")]
        found[name] = max(inside or giving, key=len)
    return found


def entries(kind: str, module: str) -> str:
    """Return what the reference has of a module: the table of its names, and the entries that are at home here."""
    given = names(module) if kind == "names" else {}
    here = {name: item for name, item in _by_identifier().items() if homes()[name] == module}
    given = given | {item.__qualname__: item for item in here.values() if item not in given.values()}
    rows = [f"| {_led(name, item)} | {_told(item)} |" for name, item in _sorted(given)]
    own = [f"::: {identifier(item)}" for _, item in _sorted(given) if documented(item) and identifier(item) in here]
    detail = f"## {module.removeprefix('platform_ctrl.')} in detail\n\n" if kind == "names" and own else ""
    return "| name | is |\n| --- | --- |\n" + "\n".join(rows) + "\n\n" + detail + "\n\n".join(own) + "\n"


def every() -> str:
    """Return a table of all public names and what each is for, by modules."""
    rows = [f"| `{path.removeprefix('platform_ctrl.')}` | {_told(item)} |" for path, item in public().items()]
    return "| name | is |\n| --- | --- |\n" + "\n".join(rows) + "\n"


@cache
def _by_identifier() -> dict[str, Any]:
    return {identifier(item): item for item in public().values()} | results()


def _sorted(found: dict[str, Any]) -> list[tuple[str, Any]]:
    return sorted(found.items(), key=lambda pair: pair[0].lower())


def _led(name: str, item: Any) -> str:
    if documented(item):
        return f"[`{name}`][{identifier(item)}]"
    return f"`{name}`"


def _told(item: Any) -> str:
    if documented(item) or isinstance(item, ModuleType):
        return _doc(item).partition("\n\n")[0].replace("\n", " ").replace("|", "\\|")
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
    for item in _by_identifier().values():
        found.setdefault(item.__name__, set()).add(identifier(item))
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
