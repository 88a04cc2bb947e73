"""Documents as HTML: every expression is escaped, and one that does not exist is an error."""

from __future__ import annotations

from platform_ctrl.report.content import Document


def html(document: Document) -> str:
    """Return a document as a page that needs nothing else."""
    from jinja2 import Environment, PackageLoader, StrictUndefined, select_autoescape

    environment = Environment(
        loader=PackageLoader("platform_ctrl.report"),
        autoescape=select_autoescape(default=True, default_for_string=True),
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    return environment.get_template("page.html").render(document=document)
