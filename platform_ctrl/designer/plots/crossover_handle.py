"""The crossover as a bar that is dragged along the frequency axis."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

from bokeh.models.annotations.geometry import BoxAnnotation, Span

from platform_ctrl.designer.plots.panel import Theme
from platform_ctrl.designer.plots.pulling import Pulling
from platform_ctrl.designer.plots.widths import inner_width

# Half the width of the bar, pixels: wide enough to be caught.
_HALF = 6.0
RAD_PER_S = 2.0 * math.pi


class CrossoverHandle:
    """A bar over the crossover, to be dragged along the frequency axis.

    Parameters
    ----------
    plot
        Magnitude over frequency, Hz.
    theme
        Colours.
    """

    def __init__(self, plot: Any, theme: Theme) -> None:
        self.callbacks: list[Callable[[float], None]] = []
        self._plot = plot
        self._shown: float | None = None
        # Where it was put last; while the document holds its events, news of that comes later.
        self._put: tuple[float, float] | None = None
        self.box: Any = BoxAnnotation(
            left=1.0, right=2.0, editable=True, movable="x", resizable="none", visible=False, name="crossover-handle",
            fill_alpha=0.14, hover_fill_alpha=0.38, line_alpha=0.0, hover_line_alpha=0.0, propagate_hover=True,
        )  # fmt: skip
        theme.paint(self.box, fill_color="series-1", hover_fill_color="series-1")
        plot.add_layout(self.box)
        self.line: Any = Span(dimension="height", location=None, line_width=1.2)
        theme.paint(self.line, line_color="series-1")
        plot.add_layout(self.line)
        self.pulling: Pulling[float] = Pulling(plot, self._pulled, self._place)
        for name in ("left", "right"):
            self.box.on_change(name, self._moved)
        for name in ("start", "end"):
            plot.x_range.on_change(name, self._zoomed)
        plot.on_change("inner_width", self._zoomed)

    def show(self, frequency: float | None) -> None:
        """Stand at the crossover, Hz, or nowhere; a bar that is being dragged stays under the mouse."""
        self._shown = frequency if frequency is not None and math.isfinite(frequency) and frequency > 0.0 else None
        self.line.location = self._shown
        if not self.pulling.active:
            self._place()

    def _place(self) -> None:
        if self._shown is None:
            self.box.visible = False
            return
        half = self._half()
        left, right = self._put = self._shown / half, self._shown * half
        self.box.update(left=left, right=right, visible=True)

    def _half(self) -> float:
        """Return the factor that half the bar's width is on the axis."""
        low, high = self._plot.x_range.start, self._plot.x_range.end
        if not (isinstance(low, int | float) and isinstance(high, int | float) and 0.0 < low < high < math.inf):
            return 1.05
        return math.exp(math.log(high / low) * min(_HALF / inner_width(self._plot), 0.2))

    def _zoomed(self, name: str, old: object, new: object) -> None:
        if not self.pulling.active:
            self._place()

    def _moved(self, name: str, old: object, new: object) -> None:
        left, right = self.box.left, self.box.right
        if not all(isinstance(end, int | float) and 0.0 < end < math.inf for end in (left, right)):
            return
        if self._put is not None and (left == self._put[0] or right == self._put[1]):
            return
        if name == "right":  # both ends come one after the other, this one last
            self.pulling.move(math.sqrt(left * right))

    def _pulled(self, frequency: float) -> None:
        for callback in self.callbacks:
            callback(RAD_PER_S * frequency)
