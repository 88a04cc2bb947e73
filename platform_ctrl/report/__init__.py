"""What a job came to, for people: the page with its figures, and the tables that the terminal shows too."""

from __future__ import annotations

from platform_ctrl.report.document import page, write_page

__all__ = ["page", "write_page"]
