"""Names that a docstring lists together have each its own type and default; griffe takes those of the first for all."""

from __future__ import annotations

from typing import Any

from griffe import DocstringSectionAttributes, DocstringSectionParameters, Extension


class OwnTypes(Extension):
    """Corrects what griffe read of docstrings where it took a type or a default from the code."""

    def on_function(self, *, func: Any, loader: Any, **kwargs: Any) -> None:
        """Give each listed parameter the annotation and the default of its own."""
        if func.docstring is None:
            return
        declared = {parameter.name: parameter for parameter in func.parameters}
        for section in func.docstring.parsed:
            if isinstance(section, DocstringSectionParameters):
                for listed in section.value:
                    own = declared.get(listed.name)
                    if own is not None:
                        if any(listed.annotation is other.annotation for other in declared.values()):
                            listed.annotation = own.annotation
                        listed.value = own.default

    def on_class(self, *, cls: Any, loader: Any, **kwargs: Any) -> None:
        """Split attributes that are listed together."""
        if cls.docstring is None:
            return
        for section in cls.docstring.parsed:
            if isinstance(section, DocstringSectionAttributes):
                section.value = [one for listed in section.value for one in _apart(listed, cls)]


def _apart(listed: Any, cls: Any) -> list[Any]:
    out = []
    for name in listed.name.split(", "):
        own = cls.members[name].annotation if name in cls.members else None
        annotation = own if listed.annotation is None else listed.annotation
        out.append(type(listed)(name=name, annotation=annotation, description=listed.description))
    return out
