"""Handles on the plots that the mouse drags: the crossover and the poles."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any, Generic, TypeVar

import numpy as np
from bokeh.events import PanEnd, PanStart
from bokeh.models import Model
from bokeh.models.annotations.geometry import BoxAnnotation, Span
from bokeh.models.annotations.labels import Label

from platform_ctrl.app.pictures import Locus
from platform_ctrl.app.plots.data import FONT, HZ, Sources, assign, column, inner_size
from platform_ctrl.app.plots.panel import Theme

Place = TypeVar("Place")

# Milliseconds between two places that are passed on; without movement after which a drag is over if the browser does
# not say so; and that the browser gets for what it sent while the server was busy.
EVERY, REST, LATE = 40, 400, 150


class Drag(Generic[Place]):
    """Passes on where a handle is dragged, at most every `EVERY` ms, and always the last place.

    A drag lasts from mouse down to mouse up, however long the mouse is held still. If the browser does not report mouse
    up, the drag ends after `REST` ms without movement.

    Parameters
    ----------
    figure
        With the handle; it reports the mouse, and its document has the timer. Without a document every place is passed
        on at once.
    dragged
        Called with the place.
    ended
        Called when the drag is over.
    """

    def __init__(self, figure: Model, dragged: Callable[[Place], None], ended: Callable[[], None]) -> None:
        self._figure, self._dragged, self._ended = figure, dragged, ended
        self._mouse_down = False
        figure.on_event(PanStart, self._pan_started)
        figure.on_event(PanEnd, self._pan_ended)
        self._place: Place | None = None
        self._waiting: Any = None
        self._resting: Any = None
        self.active = False
        # Number of drags so far.
        self.count = 0

    def move(self, place: Place) -> None:
        """Take a new place."""
        self.count += not self.active
        self.active = True
        self._place = place
        document = self._figure.document
        if document is None or document.session_context is None:
            self._pass_on()
            return
        if self._waiting is None:
            self._waiting = document.add_timeout_callback(self._pass_on, EVERY)
        if self._resting is not None:
            document.remove_timeout_callback(self._resting)
            self._resting = None
        if not self._mouse_down:
            self._resting = document.add_timeout_callback(self._rested, REST)

    def _pan_started(self, event: object) -> None:
        if self.active:
            self.end()
        self._mouse_down = True

    def _pan_ended(self, event: object) -> None:
        self._mouse_down = False
        if self.active:
            self.end()

    def end(self) -> None:
        """End the drag now; the last place is passed on."""
        document = self._figure.document
        if document is not None:
            for waiting in (self._waiting, self._resting):
                if waiting is not None and waiting in document.session_callbacks:
                    document.remove_timeout_callback(waiting)
        self._waiting = self._resting = None
        self._pass_on()
        self.active = False
        self._ended()

    def _rested(self) -> None:
        document = self._figure.document
        if document is not None:
            self._resting = document.add_timeout_callback(self.end, LATE)

    def _pass_on(self) -> None:
        self._waiting = None
        place, self._place = self._place, None
        if place is not None:
            self._dragged(place)


def _on_changes(changed: Callable[[], None], *models: tuple[Model, str]) -> None:
    for model, name in models:
        model.on_change(name, lambda attr, old, new: changed())


def _zoom(plot: Any) -> list[tuple[Model, str]]:
    """Return the properties of a figure that change the size of a pixel."""
    ends = [(one, end) for one in (plot.x_range, plot.y_range) for end in ("start", "end")]
    return [*ends, (plot, "inner_width"), (plot, "inner_height")]


# Half the width of the crossover's bar, pixels: wide enough to be caught.
_HALF_BAR = 6.0


class CrossoverHandle:
    """A bar over the crossover that is dragged along the frequency axis; `callbacks` get the frequency, rad/s.

    `ended` is called after a drag.
    """

    name, role, alpha = "crossover-handle", "series-1", 0.14
    dash: tuple[int, ...] = ()

    def __init__(self, plot: Any, theme: Theme, ended: Callable[[], None] = lambda: None) -> None:
        self.callbacks: list[Callable[[float], None]] = []
        self._plot = plot
        self._shown: float | None = None
        self._movable = True
        # Where the server put it last: the browser's news of that comes later, and is no drag.
        self._put: tuple[float, float] | None = None
        self.box: Any = BoxAnnotation(
            left=1.0, right=2.0, editable=True, movable="x", resizable="none", visible=False, name=self.name,
            fill_alpha=self.alpha, hover_fill_alpha=0.38, line_alpha=0.0, hover_line_alpha=0.0, propagate_hover=True,
        )  # fmt: skip
        theme.paint(self.box, fill_color=self.role, hover_fill_color=self.role)
        self.line: Any = Span(dimension="height", location=None, line_width=1.2, line_dash=list(self.dash))
        theme.paint(self.line, line_color=self.role)
        plot.add_layout(self.box)
        plot.add_layout(self.line)
        self.drag: Drag[float] = Drag(plot, self._dragged, self._end)
        self._after = ended
        for name in ("left", "right"):
            self.box.on_change(name, self._moved)
        _on_changes(self._place_at_rest, *(one for one in _zoom(plot) if one[0] is not plot.y_range))

    def show(self, frequency: float | None, movable: bool = True) -> None:
        """Mark the crossover, Hz, or nothing, with a bar where it is movable; one that is dragged stays in place."""
        self._movable = movable
        self._shown = frequency if frequency is not None and math.isfinite(frequency) and frequency > 0.0 else None
        assign(self.line, location=self._shown)
        self._place_at_rest()

    def _place_at_rest(self) -> None:
        if not self.drag.active:
            self._place()

    def _place(self) -> None:
        if self._shown is None or not self._movable:
            assign(self.box, visible=False)
            return
        half = self._half()
        left, right = self._put = self._shown / half, self._shown * half
        assign(self.box, left=left, right=right, visible=True)

    def _end(self) -> None:
        self._place()
        self._after()

    def _half(self) -> float:
        """Return half the bar's width as a factor on the axis."""
        low, high = self._plot.x_range.start, self._plot.x_range.end
        if not (isinstance(low, int | float) and isinstance(high, int | float) and 0.0 < low < high < math.inf):
            return 1.05
        return math.exp(math.log(high / low) * min(_HALF_BAR / inner_size(self._plot)[0], 0.2))

    def _moved(self, name: str, old: object, new: object) -> None:
        left, right = self.box.left, self.box.right
        if not all(isinstance(end, int | float) and 0.0 < end < math.inf for end in (left, right)):
            return
        if self._put is not None and (left == self._put[0] or right == self._put[1]):
            return
        if name == "right":  # both ends come one after the other, this one last
            self.drag.move(math.sqrt(left * right))

    def _dragged(self, frequency: float) -> None:
        for callback in self.callbacks:
            callback(frequency / HZ)


class SliderHandle(CrossoverHandle):
    """A bar at the frequency of a slider, a lead zero or a notch say, with its words."""

    name, role, alpha = "slider-handle", "muted", 0.0
    dash = (2, 3)

    def __init__(self, plot: Any, theme: Theme) -> None:
        super().__init__(plot, theme)
        self.slider = ""
        self.label: Any = Label(
            x=1.0, y=3, y_units="screen", x_offset=3, text="", text_font=FONT, text_font_size="10px", visible=False
        )
        theme.paint(self.label, text_color="muted")
        plot.add_layout(self.label)

    def mark(self, slider: str, words: str, frequency: float | None) -> None:
        """Stand for a slider at a frequency, Hz, or for none."""
        self.slider = slider
        self.show(frequency)
        assign(self.label, x=frequency or 1.0, text=words, visible=frequency is not None)


# Most poles with a handle, and half the handle's size, pixels.
POLE_HANDLES, _HALF_RING = 12, 9.0


class PoleHandles:
    """Rings around poles; `callbacks` get the pole and where it is dragged to, rad/s.

    Parameters
    ----------
    plot
        The s-plane, rad/s.
    theme, sources
        Of the page; the source ``dragged`` shows the targets of a pole and its conjugate.
    ended
        Called after a drag.
    """

    def __init__(self, plot: Any, theme: Theme, sources: Sources, ended: Callable[[], None]) -> None:
        self.callbacks: list[Callable[[complex, complex], None]] = []
        self._plot, self._sources, self._after = plot, sources, ended
        # Ring → pole. A ring keeps its pole from picture to picture.
        self._poles: dict[int, complex] = {}
        # While a ring is dragged: which, the pole in the last picture, and its target then.
        self._caught: tuple[int, complex] | None = None
        self._target = 0j
        # Where the server put each last: the browser's news of that comes later, and is no drag.
        self._put: dict[int, list[float]] = {}
        self._putting = False
        self.boxes = [self._box(k, theme) for k in range(POLE_HANDLES)]
        self.drag: Drag[complex] = Drag(plot, self._dragged, self._ended)
        _on_changes(self._place, *_zoom(plot))

    def _box(self, k: int, theme: Theme) -> Any:
        box: Any = BoxAnnotation(
            left=0.0, right=1.0, bottom=0.0, top=1.0, editable=True, movable="both", resizable="none",
            visible=False, name=f"pole-handle-{k}", fill_alpha=0.10,
            hover_fill_alpha=0.40, line_alpha=0.55, hover_line_alpha=1.0, hover_line_width=1, propagate_hover=True,
        )  # fmt: skip
        box.border_radius = int(_HALF_RING)
        theme.paint(
            box, fill_color="series-1", hover_fill_color="series-1", line_color="series-1", hover_line_color="ink"
        )
        self._plot.add_layout(box)
        _on_changes(lambda: self._moved(k), *((box, name) for name in ("left", "right", "bottom", "top")))
        return box

    def show(self, locus: Locus) -> None:
        """Put a ring around each draggable pole; of too many, around the slowest."""
        poles = locus.present[locus.draggable & np.isfinite(locus.present)]
        left = [complex(pole) for pole in poles[np.argsort(np.abs(poles), kind="stable")[:POLE_HANDLES]]]
        kept: dict[int, complex] = {}
        if self._caught is not None and left:
            # It has moved part of the way: of all poles it is the one nearest to both ends of that way.
            k, before = self._caught
            kept[k] = min(left, key=lambda pole: abs(pole - before) + abs(pole - self._target))
            self._caught = (k, kept[k])
            left.remove(kept[k])
        others = [k for k in self._poles if k not in kept]
        if others and left:
            from scipy.optimize import linear_sum_assignment

            distance = np.abs(np.subtract.outer([self._poles[k] for k in others], left))
            rows, columns = linear_sum_assignment(distance)
            kept |= {others[i]: left[j] for i, j in zip(rows, columns, strict=True)}
            left = [pole for j, pole in enumerate(left) if j not in columns]
        free = (k for k in range(POLE_HANDLES) if k not in kept)
        self._poles = kept | dict(zip(free, left, strict=False))
        self._place()

    def _place(self) -> None:
        wide, high = self._half_sizes()
        for k, box in enumerate(self.boxes):
            if self._caught is not None and self._caught[0] == k:
                continue
            if k not in self._poles:
                assign(box, visible=False)
                continue
            x, y = self._poles[k].real, self._poles[k].imag
            left, right, bottom, top = self._put[k] = [x - wide, x + wide, y - high, y + high]
            self._putting = True
            assign(box, left=left, right=right, bottom=bottom, top=top, visible=True)
            self._putting = False

    def _half_sizes(self) -> tuple[float, float]:
        """Return half the size of a ring across and up, rad/s."""
        spans = [float(one.end) - float(one.start) for one in (self._plot.x_range, self._plot.y_range)]
        if not all(math.isfinite(span) and span > 0.0 for span in spans):
            return 1.0, 1.0
        width, height = inner_size(self._plot)
        return spans[0] * _HALF_RING / width, spans[1] * _HALF_RING / height

    def _moved(self, k: int) -> None:
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
            self._target = self._caught[1]
        # The lower half plane is the mirror of the upper one: the pole is the upper of the pair.
        target = complex(middle.real, abs(middle.imag))
        self._mark(self._caught[1], target)
        self.drag.move(target)

    def _mark(self, pole: complex, target: complex) -> None:
        x0, y0, x1, y1 = (
            column([one, sign * one])
            for one, sign in ((pole.real, 1), (pole.imag, -1), (target.real, 1), (target.imag, -1))
        )
        self._sources.put("dragged", x0=x0, y0=y0, x1=x1, y1=y1)

    def _dragged(self, target: complex) -> None:
        if self._caught is None:
            return
        pole, self._target = self._caught[1], target
        for callback in self.callbacks:
            callback(pole, target)

    def _ended(self) -> None:
        self._caught = None
        self._sources.clear("dragged")
        self._place()
        self._after()
