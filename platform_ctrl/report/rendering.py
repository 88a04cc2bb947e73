"""Pages out of templates: every expression is escaped, and one that does not exist is an error."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any


def rendered(template: str, content: Mapping[str, Any]) -> str:
    """Return a page.

    Parameters
    ----------
    template
        Name of a file in ``templates``.
    content
        What its expressions find.
    """
    from jinja2 import Environment, PackageLoader, StrictUndefined, select_autoescape

    environment = Environment(
        loader=PackageLoader("platform_ctrl.report"),
        autoescape=select_autoescape(default=True, default_for_string=True),
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    return environment.get_template(template).render(content)
