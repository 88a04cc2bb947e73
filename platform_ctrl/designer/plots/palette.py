"""Colours, lines and type of the plots: those of the report's style sheet, light and dark."""

from __future__ import annotations

import re
from functools import cache
from importlib import resources

# Dashes of the k-th design in pixels; empty is a solid line.
DASHES: tuple[tuple[int, ...], ...] = ((), (8, 3), (2, 3), (9, 3, 2, 3), (9, 3, 2, 3, 2, 3), (5, 2), (14, 4), (4, 4))
# Dashes of what the job asks for, pixels.
ASKED = (6, 3)
FONT = 'system-ui, -apple-system, "Segoe UI", "Helvetica Neue", "Noto Sans", "Liberation Sans", Arial, sans-serif'
SMALL, NORMAL = "11px", "12px"

_BLOCK = re.compile(r":root\s*\{([^}]*)\}")
_VARIABLE = re.compile(r"--([\w-]+):\s*(#[0-9a-fA-F]{6})\s*;")


@cache
def _themes() -> tuple[dict[str, str], dict[str, str]]:
    text = resources.files("platform_ctrl.report").joinpath("templates/report.css").read_text(encoding="utf-8")
    light, dark = (dict(_VARIABLE.findall(block)) for block in _BLOCK.findall(text)[:2])
    return light, dark


def colours(dark: bool) -> dict[str, str]:
    """Return the colours of a theme by what they are for: ``ink``, ``muted``, ``grid``, ``limit``, ``series-1``, ...

    Parameters
    ----------
    dark
        Which theme.

    Returns
    -------
    dict
        Name → ``#rrggbb``, as in the report's style sheet.

    References
    ----------
    M. Okabe, K. Ito, Color Universal Design, 2008.
    """
    light_colours, dark_colours = _themes()
    return dict(dark_colours if dark else light_colours)


def series(k: int) -> str:
    """Return the name of the colour of the k-th of several curves."""
    return f"series-{1 + k % 8}"


def dashes(k: int) -> tuple[int, ...]:
    """Return the dashes of the k-th of several designs, pixels."""
    return DASHES[k % len(DASHES)]
