"""Names that a docstring lists together have each its own type and default; griffe takes those of the first for all."""

from __future__ import annotations

from typing import Any

from griffe import DocstringSectionAttributes, DocstringSectionParameters, Extension


class OwnTypes(Extension):
    """Corrects what griffe read of docstrings where it took a type or a default from the code."""

    def on_package(self, *, pkg: Any, loader: Any, **kwargs: Any) -> None:
        """Correct every function and class of a package that is loaded."""
        if pkg.name == "platform_ctrl":
            _correct(pkg)


def _correct(item: Any) -> None:
    if item.is_alias:
        return
    if item.docstring is not None and item.is_function:
        _parameters(item)
    elif item.docstring is not None and item.is_class:
        _attributes(item)
    for member in item.members.values():
        _correct(member)


def _parameters(function: Any) -> None:
    """Give each listed parameter the annotation and the default of its own."""
    declared = {parameter.name: parameter for parameter in function.parameters}
    for section in function.docstring.parsed:
        if isinstance(section, DocstringSectionParameters):
            for listed in section.value:
                own = declared.get(listed.name)
                if own is not None:
                    if any(listed.annotation is other.annotation for other in declared.values()):
                        listed.annotation = own.annotation
                    listed.value = own.default


def _attributes(cls: Any) -> None:
    """Split attributes that are listed together."""
    for section in cls.docstring.parsed:
        if isinstance(section, DocstringSectionAttributes):
            section.value = [one for listed in section.value for one in _apart(listed, cls)]


def _apart(listed: Any, cls: Any) -> list[Any]:
    out = []
    for name in listed.name.split(", "):
        own = cls.all_members[name].annotation if name in cls.all_members else None
        annotation = own if listed.annotation is None else listed.annotation
        out.append(type(listed)(name=name, annotation=annotation, description=listed.description))
    return out
