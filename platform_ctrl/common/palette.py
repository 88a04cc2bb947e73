"""The colours of pages and figures by their role, for a light and a dark page."""

from __future__ import annotations

from collections.abc import Mapping
from types import MappingProxyType
from typing import Literal

Theme = Literal["light", "dark"]


def _roles(page: str, figure: str, series: str) -> Mapping[str, str]:
    roles = ("page", "panel", "line", "accent", "good-track", "good", "good-back", "bad", "bad-back")
    drawn = ("ink", "muted", "grid", "frame", "limit", "beyond", "band", "reference")
    numbered = {f"series-{k}": colour for k, colour in enumerate(series.split(), 1)}
    return MappingProxyType(
        dict(zip(roles, page.split(), strict=True)) | dict(zip(drawn, figure.split(), strict=True)) | numbered
    )


# The series are Okabe and Ito's colours, yellow left out: it vanishes on white.
PALETTE: Mapping[Theme, Mapping[str, str]] = MappingProxyType(
    {
        "light": _roles(
            "#ffffff #f6f7f9 #dde1e7 #0b5c8f #b9ddcf #0b6b4f #e5f3ee #a1221b #fbe9e7",
            "#1b2430 #5c6675 #e4e7ec #b9c0ca #b3261e #fbebe9 #dfe7f1 #8a93a0",
            "#0072b2 #d55e00 #009e73 #cc79a7 #e69f00 #56b4e9 #7a7a00 #6a5acd",
        ),
        "dark": _roles(
            "#14181e #1c2129 #303742 #6bb8e8 #1f5a48 #5fd0a8 #12352b #ff8f85 #43201d",
            "#e6e9ee #a0a9b6 #272d37 #4a5361 #ff7a6e #3a2223 #222c3a #7d8795",
            "#4aa8e6 #f58a3c #2fc799 #e8a0c6 #f3bd4e #93d1f5 #c9c94a #a79bf0",
        ),
    }
)


def declarations(colours: Mapping[str, str]) -> str:
    """Return colours as declarations of CSS variables."""
    return ";".join(f"--{role}:{colour}" for role, colour in colours.items())
