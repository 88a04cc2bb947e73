"""Other designs over the one that is worked on: a colour and dashes each, the same in all plots."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

from platform_ctrl.designer.pictures import Overlay
from platform_ctrl.designer.plots.columns import column, decibels
from platform_ctrl.designer.plots.palette import dashes, series
from platform_ctrl.designer.plots.panel import Key, Theme
from platform_ctrl.designer.plots.sources import Sources
from platform_ctrl.frozen import FloatArray

_WIDTH = 1.5


class OverlayCurves:
    """Loop transfers of other designs, for the Bode and the Nichols diagram.

    Parameters
    ----------
    sources
        Where their data go: the source ``overlays``.
    theme
        Colours.
    """

    def __init__(self, sources: Sources, theme: Theme) -> None:
        self._sources, self._theme = sources, theme
        self._source = sources.new("overlays", lists=("xs", "gains", "phases", "colour", "dash", "name"))

    def draw(self, plot: Any, x: str, y: str) -> Any:
        """Draw two of the columns against one another."""
        return plot.multi_line(x, y, source=self._source, line_color="colour", line_dash="dash", line_width=_WIDTH)

    def show(self, overlays: Sequence[Overlay], frequency: FloatArray) -> None:
        """Follow the overlays of a picture; `frequency` in rad/s."""
        f = column(frequency / math.tau)
        self._sources.put(
            "overlays",
            xs=[f] * len(overlays),
            gains=[decibels(one.magnitude) for one in overlays],
            phases=[column(one.phase) for one in overlays],
            colour=[self._theme.colours[series(1 + k)] for k in range(len(overlays))],
            dash=[list(dashes(1 + k)) for k in range(len(overlays))],
            name=[one.design for one in overlays],
        )


def overlay_keys(overlays: Sequence[Overlay]) -> list[Key]:
    """Return the keys of other designs: name, colour, dashes, width."""
    return [(one.design, series(1 + k), dashes(1 + k), _WIDTH) for k, one in enumerate(overlays)]
