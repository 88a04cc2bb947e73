"""The page's plots: Bokeh figures that follow a `Drawing`."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager

from bokeh.models import LayoutDOM

from platform_ctrl.app.pictures import Drawing
from platform_ctrl.app.plots.budget import BudgetPlots
from platform_ctrl.app.plots.loop import BodePanel, LocusPanel, NicholsPanel
from platform_ctrl.app.plots.painter import Axis, Theme
from platform_ctrl.app.plots.responses import DisturbancePanel, TimePanel
from platform_ctrl.app.plots.views import View
from platform_ctrl.job.budget import BudgetSpec
from platform_ctrl.verification.budget_result import LineOfSightBudget


class Plots:
    """All plots of a page; they belong to one document.

    Attributes
    ----------
    layout
        Roots by name: ``"bode"``, ``"nichols"``, ``"locus"``, ``"step"``, ``"Omega"``, and of a job with a budget
        ``"cumulative0"``, ``"cumulative1"``, ``"waterfall0"`` to ``"waterfall2"``; each fills its container.
    panels
        What is drawn there, and what is written above it.
    """

    def __init__(self, dark: bool = False, budget: BudgetSpec | None = None) -> None:
        self._theme = Theme(dark)
        self._subject: tuple[object, ...] = ()
        # One view for all that is over frequency: zooming one zooms all.
        view = View(0.1, 1000.0, _frequencies, logarithmic=True)
        frequency = Axis(view, "frequency, Hz", "frequency", "{0.[000]} Hz")
        self._loop = (
            BodePanel(self._theme, frequency),
            NicholsPanel(self._theme),
            LocusPanel(self._theme),
            TimePanel(self._theme, "step", "Step response", "step"),
            DisturbancePanel(self._theme, frequency),
        )
        self._budget = None if budget is None else BudgetPlots(budget, self._theme)
        self.panels = self._loop if self._budget is None else (*self._loop, *self._budget.panels)
        self.layout: dict[str, LayoutDOM] = {one.name: one.layout for one in self.panels}

    def show(self, picture: Drawing) -> None:
        """Follow a picture: all changes go to the browser together, no model is made or removed.

        Data that are not finite are gaps; a plot with nothing to draw shows a message.
        """
        settings = picture.settings
        # All but the numbers of sliders.
        subject = (settings.loop, settings.design, settings.channel, settings.axis, settings.overlays)
        if self._subject not in ((), subject):
            for view in {view for one in self._loop for view in one.views}:
                view.forget()
        self._subject = subject
        with self._combined():
            for one in self._loop:
                one.show(picture)

    def dark(self, dark: bool) -> None:
        """Switch the theme in place."""
        with self._combined():
            self._theme.change(dark)
            for one in self.panels:
                one.again()

    def show_budget(self, found: LineOfSightBudget) -> None:
        """Follow the budget of the line of sight, of a job that has one."""
        if self._budget is not None:
            with self._combined():
                self._budget.show(found)

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


def _frequencies(low: float, high: float) -> tuple[float, float]:
    """Return the ends of the data as those of a logarithmic axis."""
    return low, high if high > low else 10.0 * low
