"""What a job came to, for people: the page with its figures, the same as PDF, and the terminal's tables.

Matplotlib is loaded with the first figure, not with this package.
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING

from platform_ctrl.report import tables
from platform_ctrl.report.document import page, prepared, write_page
from platform_ctrl.report.pdf_document import pdf, write_pdf

if TYPE_CHECKING:
    from platform_ctrl.report import figures

__all__ = ["figures", "page", "pdf", "prepared", "tables", "write_page", "write_pdf"]


if not TYPE_CHECKING:

    def __getattr__(name: str) -> object:
        if name != "figures":
            raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
        return import_module(f"{__name__}.figures")
