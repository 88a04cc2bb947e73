"""The page's plots: Bokeh figures that follow a `Drawing`."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager

from bokeh.models import LayoutDOM

from platform_ctrl.app.pictures import Drawing
from platform_ctrl.app.plots.budget import BudgetPlots
from platform_ctrl.app.plots.data import Sources, View
from platform_ctrl.app.plots.frequency import BodePanel, NicholsPanel
from platform_ctrl.app.plots.locus import LocusPanel
from platform_ctrl.app.plots.panel import Theme
from platform_ctrl.app.plots.responses import RatePanel, StepPanel
from platform_ctrl.job.budget import BudgetSpec
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

    def __init__(self, dark: bool = False, budget: BudgetSpec | None = None) -> None:
        self._theme, sources = Theme(dark), Sources()
        self._picture: Drawing | None = None
        # One view for all that is over frequency: zooming one zooms all.
        frequency = View(0.1, 1000.0, _ends, logarithmic=True)
        self._bode = BodePanel(self._theme, sources, frequency)
        nichols = NicholsPanel(self._theme, sources, self._bode.overlays)
        self._locus = LocusPanel(self._theme, sources)
        self._rate = RatePanel(self._theme, sources, frequency, self._bode.mouse)
        self._panels = (self._bode, nichols, self._locus, StepPanel(self._theme, sources), self._rate)
        self._budget = None if budget is None else BudgetPlots(budget, self._theme, sources)
        self.sources = sources.by_name
        self._every = self._panels if self._budget is None else (*self._panels, *self._budget.panels)
        self.layout: dict[str, LayoutDOM] = {one.name: one.layout for one in self._every}

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

    def captions(self) -> dict[str, str]:
        """Return what a screen reader says of each panel, by its name."""
        return {one.name: one.caption for one in self._every}

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
