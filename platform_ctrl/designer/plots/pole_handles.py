"""Poles as rings that are dragged over the s-plane."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import numpy as np
from bokeh.models.annotations.geometry import BoxAnnotation

from platform_ctrl.designer.pictures import Locus
from platform_ctrl.designer.plots.columns import column
from platform_ctrl.designer.plots.panel import Theme
from platform_ctrl.designer.plots.pulling import Pulling
from platform_ctrl.designer.plots.sources import Sources
from platform_ctrl.designer.plots.widths import inner_height, inner_width

# Rings that there are, and half their size, pixels.
NUMBER, _HALF = 12, 9.0


class PoleHandles:
    """Rings around poles.

    Parameters
    ----------
    plot
        The s-plane, rad/s.
    theme
        Colours.
    sources
        Where the data of all plots stand; the source ``pulled`` shows where a pole and its conjugate are wanted.
    ended
        Called after a drag.
    """

    def __init__(self, plot: Any, theme: Theme, sources: Sources, ended: Callable[[], None]) -> None:
        self.callbacks: list[Callable[[complex, complex], None]] = []
        self._plot, self._sources, self._then = plot, sources, ended
        # Ring → pole. A ring keeps its pole from picture to picture.
        self._poles: dict[int, complex] = {}
        # While a ring is dragged: which, where its pole stands in the last picture, and where it was wanted then.
        self._caught: tuple[int, complex] | None = None
        self._wanted = 0j
        # Where each was put last; while the document holds its events, news of that comes later.
        self._put: dict[int, list[float]] = {}
        self._putting = False
        self.boxes = []
        for k in range(NUMBER):
            box: Any = BoxAnnotation(
                left=0.0, right=1.0, bottom=0.0, top=1.0, editable=True, movable="both", resizable="none",
                visible=False, name=f"pole-handle-{k}", fill_alpha=0.10,
                hover_fill_alpha=0.40, line_alpha=0.55, hover_line_alpha=1.0, hover_line_width=1, propagate_hover=True,
            )  # fmt: skip
            box.border_radius = int(_HALF)
            theme.paint(
                box, fill_color="series-1", hover_fill_color="series-1", line_color="series-1", hover_line_color="ink"
            )
            plot.add_layout(box)
            for name in ("left", "right", "bottom", "top"):
                box.on_change(name, self._mover(k))
            self.boxes.append(box)
        self.pulling: Pulling[complex] = Pulling(plot, self._pulled, self._ended)
        for one in (plot.x_range, plot.y_range):
            one.on_change("start", self._zoomed)
            one.on_change("end", self._zoomed)
        plot.on_change("inner_width", self._zoomed)
        plot.on_change("inner_height", self._zoomed)

    def show(self, locus: Locus) -> None:
        """Stand around the poles that may be dragged, the slowest ones where there are too many."""
        poles = locus.present[locus.draggable & np.isfinite(locus.present)]
        left = [complex(pole) for pole in poles[np.argsort(np.abs(poles), kind="stable")[:NUMBER]]]
        kept: dict[int, complex] = {}
        if self._caught is not None and left:
            # It has come some part of the way: of all poles it is the one nearest to both ends of that way.
            k, before = self._caught
            kept[k] = min(left, key=lambda pole: abs(pole - before) + abs(pole - self._wanted))
            self._caught = (k, kept[k])
            left.remove(kept[k])
        others = [k for k in self._poles if k not in kept]
        if others and left:
            from scipy.optimize import linear_sum_assignment

            away = np.abs(np.subtract.outer([self._poles[k] for k in others], left))
            rows, columns = linear_sum_assignment(away)
            kept |= {others[i]: left[j] for i, j in zip(rows, columns, strict=True)}
            left = [pole for j, pole in enumerate(left) if j not in columns]
        free = (k for k in range(NUMBER) if k not in kept)
        self._poles = kept | dict(zip(free, left, strict=False))
        self._place()

    def _place(self) -> None:
        wide, high = self._sizes()
        for k, box in enumerate(self.boxes):
            if self._caught is not None and self._caught[0] == k:
                continue
            if k not in self._poles:
                box.visible = False
                continue
            x, y = self._poles[k].real, self._poles[k].imag
            left, right, bottom, top = self._put[k] = [x - wide, x + wide, y - high, y + high]
            self._putting = True
            box.update(left=left, right=right, bottom=bottom, top=top, visible=True)
            self._putting = False

    def _sizes(self) -> tuple[float, float]:
        """Return half the size of a ring in rad/s across and up."""
        x, y = self._plot.x_range, self._plot.y_range
        spans = [float(one.end) - float(one.start) for one in (x, y)]
        if not all(math.isfinite(span) and span > 0.0 for span in spans):
            return 1.0, 1.0
        return spans[0] * _HALF / inner_width(self._plot), spans[1] * _HALF / inner_height(self._plot)

    def _zoomed(self, name: str, old: object, new: object) -> None:
        self._place()

    def _mover(self, k: int) -> Callable[[str, object, object], None]:
        def moved(name: str, old: object, new: object) -> None:
            box = self.boxes[k]
            edges = [box.left, box.right, box.bottom, box.top]
            if self._putting or edges == self._put.get(k):
                return
            if not all(isinstance(edge, int | float) and math.isfinite(edge) for edge in edges):
                return
            left, right, bottom, top = map(float, edges)
            middle = complex(0.5 * (left + right), 0.5 * (bottom + top))
            if self._caught is None or self._caught[0] != k:
                if k not in self._poles or abs(middle - self._poles[k]) < 1e-9 * (right - left):
                    return
                self._caught = (k, self._poles[k])
                self._wanted = self._caught[1]
            # The lower half plane is the upper one's mirror: the pole wanted is the upper of the pair.
            target = complex(middle.real, abs(middle.imag))
            self._mark(self._caught[1], target)
            self.pulling.move(target)

        return moved

    def _mark(self, pole: complex, target: complex) -> None:
        self._sources.put(
            "pulled",
            x0=column([pole.real, pole.real]),
            y0=column([pole.imag, -pole.imag]),
            x1=column([target.real, target.real]),
            y1=column([target.imag, -target.imag]),
        )

    def _pulled(self, target: complex) -> None:
        if self._caught is None:
            return
        pole, self._wanted = self._caught[1], target
        for callback in self.callbacks:
            callback(pole, target)

    def _ended(self) -> None:
        self._caught = None
        self._sources.put("pulled", **{name: column([]) for name in ("x0", "y0", "x1", "y1")})
        self._place()
        self._then()
