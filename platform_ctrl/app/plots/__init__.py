"""The page's plots: Bokeh figures that follow a `Drawing`, with poles and a crossover to be dragged."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager

from bokeh.models import LayoutDOM

from platform_ctrl.analysis.arrays import ComplexArray
from platform_ctrl.app.pictures import Drawing
from platform_ctrl.app.plots.budget import BudgetPlots
from platform_ctrl.app.plots.data import Sources, View
from platform_ctrl.app.plots.frequency import BodePanel, NicholsPanel
from platform_ctrl.app.plots.handles import SliderHandle
from platform_ctrl.app.plots.locus import LocusPanel
from platform_ctrl.app.plots.panel import Theme
from platform_ctrl.app.plots.responses import RatePanel, StepPanel
from platform_ctrl.job.budget import Budget
from platform_ctrl.verification.budget_result import LineOfSightBudget


class Plots:
    """All plots of a page; they belong to one document.

    Attributes
    ----------
    layout
        Roots by name: ``"bode"``, ``"nichols"``, ``"locus"``, ``"step"``, ``"Omega"``, and of a job with a budget
        ``"cumulative0"``, ``"cumulative1"``, ``"waterfall0"`` to ``"waterfall2"``; each fills its container.
    sources
        Bokeh's column data sources by name: what is drawn, in the units of the axes.
    """

    def __init__(self, dark: bool = False, budget: Budget | None = None) -> None:
        self._theme, sources = Theme(dark), Sources()
        self._picture: Drawing | None = None
        # One view for all that is over frequency: zooming one zooms all.
        frequency = View(0.1, 1000.0, _ends, logarithmic=True)
        self._bode = BodePanel(self._theme, sources, frequency)
        nichols = NicholsPanel(self._theme, sources, self._bode.overlays)
        self._locus = LocusPanel(self._theme, sources)
        self._rate = RatePanel(self._theme, sources, frequency)
        self._panels = (self._bode, nichols, self._locus, StepPanel(self._theme, sources), self._rate)
        self._budget = None if budget is None else BudgetPlots(budget, self._theme, sources)
        self.sources = sources.by_name
        panels = self._panels if self._budget is None else (*self._panels, *self._budget.panels)
        self.layout: dict[str, LayoutDOM] = {one.name: one.layout for one in panels}

    @property
    def drags(self) -> int:
        """Number of drags so far: all callbacks of one drag see the same number."""
        sliders = sum(one.drag.count for one in self._bode.sliders)
        return self._locus.handles.drag.count + self._bode.handle.drag.count + sliders

    def show(self, picture: Drawing) -> None:
        """Follow a picture: all changes go to the browser together, no model is made or removed.

        Data that are not finite are gaps; a plot with nothing to draw shows a message.
        """
        if self._picture is not None and _subject(self._picture) != _subject(picture):
            for one in self._panels:
                for view in one.views:
                    view.forget()
        self._picture = picture
        with self._combined():
            for one in self._panels:
                one.show(picture)

    def dark(self, dark: bool) -> None:
        """Switch the theme in place."""
        with self._combined():
            self._theme.change(dark)
            if self._picture is not None:
                self.show(self._picture)
            if self._budget is not None:
                self._budget.again()

    def show_budget(self, found: LineOfSightBudget) -> None:
        """Follow the budget of the line of sight, of a job that has one."""
        if self._budget is not None:
            with self._combined():
                self._budget.show(found)

    def shade_poles(self, corners: ComplexArray) -> None:
        """Shade the region that the dragged pole may be brought to, rad/s, while the drag lasts."""
        self._locus.shade(corners)

    def shade_crossovers(self, ends: tuple[float, float]) -> None:
        """Shade where the crossover may be dragged to, rad/s, while the drag lasts."""
        self._bode.shade(*ends)

    def on_pole_dragged(self, callback: Callable[[complex, complex], None]) -> None:
        """Call `callback` a few times a second while a pole is dragged, and at the end.

        Parameters
        ----------
        callback
            Gets the pole in the last picture and its target, rad/s, both in the upper half of the s-plane.
        """
        self._locus.handles.callbacks.append(callback)

    def on_crossover_dragged(self, callback: Callable[[float], None]) -> None:
        """Call `callback` with the new crossover, rad/s, a few times a second while it is dragged, and at the end."""
        self._bode.handle.callbacks.append(callback)

    def on_slider_dragged(self, callback: Callable[[str, float], None]) -> None:
        """Call `callback` with a slider's name and its new frequency, rad/s, while it is dragged."""
        for handle in self._bode.sliders:

            def dragged(frequency: float, handle: SliderHandle = handle) -> None:
                callback(handle.slider, frequency)

            handle.callbacks.append(dragged)

    @contextmanager
    def _combined(self) -> Iterator[None]:
        document = self.layout["bode"].document
        if document is None or document.callbacks.hold_value is not None:
            yield
            return
        document.hold("combine")
        try:
            yield
        finally:
            document.unhold()


def _ends(low: float, high: float) -> tuple[float, float]:
    """Return the ends of the data as those of a logarithmic axis."""
    return low, high if high > low else 10.0 * low


def _subject(picture: Drawing) -> tuple[object, ...]:
    """Return what a picture shows apart from the sliders."""
    settings = picture.settings
    return settings.loop, settings.design, settings.channel, settings.axis, settings.overlays
