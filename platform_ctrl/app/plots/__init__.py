"""The page's plots: Bokeh figures that follow a `Drawing`, with poles and a crossover to be dragged."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager

from bokeh.models import LayoutDOM

from platform_ctrl.app.pictures import Drawing
from platform_ctrl.app.plots.bode import BodePanel
from platform_ctrl.app.plots.data import Sources, View, decades
from platform_ctrl.app.plots.locus import LocusPanel
from platform_ctrl.app.plots.nichols import NicholsPanel
from platform_ctrl.app.plots.panel import Theme
from platform_ctrl.app.plots.responses import RatePanel, StepPanel


class Plots:
    """All plots of a page; they belong to one document.

    Attributes
    ----------
    layout
        Roots by name: ``"bode"``, ``"nichols"``, ``"locus"``, ``"step"``, ``"Omega"``; each stretches with what it
        is put into.
    sources
        Bokeh's column data sources by name: what is drawn, in the units of the axes.
    """

    def __init__(self, dark: bool = False) -> None:
        self._theme = Theme(dark)
        self._sources = Sources()
        self._picture: Drawing | None = None
        # One view for everything over frequency: zooming one zooms all.
        frequency = View(0.1, 1000.0, decades, logarithmic=True)
        self._bode = BodePanel(self._theme, self._sources, frequency)
        self._nichols = NicholsPanel(self._theme, self._sources, self._bode.overlays)
        self._locus = LocusPanel(self._theme, self._sources)
        self._step = StepPanel(self._theme, self._sources)
        self._rate = RatePanel(self._theme, self._sources, frequency)
        self._panels = (self._bode, self._nichols, self._locus, self._step, self._rate)
        self._views = [frequency, *(view for one in self._panels for view in one.panel.views)]
        self.sources = self._sources.by_name
        self.layout: dict[str, LayoutDOM] = {one.panel.name: one.panel.layout for one in self._panels}

    @property
    def drags(self) -> int:
        """How many drags of a pole or of the crossover have begun: all calls of one drag see the same number."""
        return self._locus.handles.drag.begun + self._bode.handle.drag.begun

    def show(self, picture: Drawing) -> None:
        """Follow a picture: what has changed goes to the browser in one go, no model is made or removed.

        Data that are not finite are gaps; where there is nothing to draw the plot says so.
        """
        about = _about(picture)
        if self._picture is not None and _about(self._picture) != about:
            for view in self._views:
                view.anew()
        self._picture = picture
        with self._held():
            for one in self._panels:
                one.show(picture)

    def dark(self, dark: bool) -> None:
        """Switch the theme in place."""
        with self._held():
            self._theme.change(dark)
            if self._picture is not None:
                self.show(self._picture)

    def on_pole_dragged(self, callback: Callable[[complex, complex], None]) -> None:
        """Call `callback` while a pole is dragged: a few times a second, and once more where it is let go.

        Parameters
        ----------
        callback
            Gets the pole as it stands in the picture shown last, and where it is wanted, both rad/s in the upper half
            of the s-plane; its conjugate goes with it.
        """
        self._locus.on_dragged(callback)

    def on_crossover_dragged(self, callback: Callable[[float], None]) -> None:
        """Call `callback` while the crossover is dragged: a few times a second, and once more where it is let go.

        Parameters
        ----------
        callback
            Gets the frequency at which the gain is wanted to pass 1, rad/s.
        """
        self._bode.on_dragged(callback)

    @contextmanager
    def _held(self) -> Iterator[None]:
        document = self.layout["bode"].document
        if document is None or document.callbacks.hold_value is not None:
            yield
            return
        document.hold("combine")
        try:
            yield
        finally:
            document.unhold()


def _about(picture: Drawing) -> tuple[object, ...]:
    """Return what a picture is of; the same while sliders move."""
    settings = picture.settings
    return settings.loop, settings.design, settings.channel, settings.axis, settings.overlays
