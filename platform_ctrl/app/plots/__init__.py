"""The page's plots: Bokeh figures that follow a `Drawing`."""

from __future__ import annotations

import math
from collections.abc import Iterator
from contextlib import contextmanager

import numpy as np
from bokeh.models import LayoutDOM

from platform_ctrl.app.pictures import Drawing
from platform_ctrl.app.plots.data import SMALL, Sources, View, column, dashes, round_bounds, series
from platform_ctrl.app.plots.frequency import BodePanel, NicholsPanel
from platform_ctrl.app.plots.locus import LocusPanel
from platform_ctrl.app.plots.panel import Panel, Theme, limit_key
from platform_ctrl.app.plots.responses import RatePanel, StepPanel
from platform_ctrl.job.budget import BudgetSpec
from platform_ctrl.job.quantities import plain
from platform_ctrl.verification.budget_result import TOGETHER, LineOfSightBudget, Waterfall, rms_ticks, waterfalls

MICRO = 1e6
# Sources that have a curve of their own, and points of a curve.
_CURVES, _POINTS = 5, 160
_WIDTH = 1.6
# Within the height of a step: middle of its words and of its bar, and the bar's height.
_WORDS, _BAR, _TALL = 0.27, 0.76, 0.34
# Steps for which there is room at least.
_ROWS = 6
_LIMIT = "limit"
# Share of a mean square below which its size is not written.
_LEAST_SHARE = 1e-4


def _rising(low: float, high: float) -> tuple[float, float]:
    return 0.0, max(round_bounds(0.0, high)[1], 1e-6)


class CumulativePanel(Panel):
    """The rms of an axis up to a frequency, of all sources and of the largest."""

    def __init__(self, theme: Theme, sources: Sources, budget: BudgetSpec, frequency: View, axis: int) -> None:
        super().__init__(f"cumulative{axis}", "Cumulative rms", theme, sources)
        self._budget, self._axis, self._source = budget, axis, f"cumulative{axis}"
        self._size = View(0.0, 1.0, _rising)
        plot = self.add(frequency, self._size, "frequency, Hz", "µrad")
        curves = self.curves(plot, self._source, _WIDTH)
        self._limit = self.limit_line(plot, "width")
        rows = [("@name", "$snap_y{0.[00]} µrad"), ("up to", "$snap_x{0.[000]} Hz")]
        self.hover(plot, [curves], rows, line_policy="interp")
        # The same at every move: what is drawn is interpolated.
        self._f = np.geomspace(budget.from_hz, budget.to_hz, _POINTS)

    def show_budget(self, found: LineOfSightBudget, largest: tuple[str, ...]) -> None:
        """Follow a budget; the sources `largest` have curves."""
        every = [found.total_cumulative[self._axis]]
        every += [found.cumulative[found.names.index(name), self._axis] for name in largest]
        f, names = column(self._f), ("all sources", *largest)
        self.put_curves(
            self._source,
            [
                (name, series(k), dashes(k), f, column(np.sqrt(np.interp(self._f, found.frequencies_hz, one)), MICRO))
                for k, (name, one) in enumerate(zip(names, every, strict=True))
            ],
        )
        limit, total = self._budget.limits.jitter_per_axis, MICRO * float(found.total[self._axis])
        near = limit is not None and MICRO * limit < 2.5 * total
        self._limit.location = MICRO * limit if near and limit is not None else None
        self._size.fit((0.0, max(total, MICRO * limit if near and limit is not None else 0.0)))
        self.detail = found.axes[self._axis]
        # In the legend the largest of this axis come first: for the last ones there may be no room.
        order = sorted(range(1, len(names)), key=lambda k: -float(found.rms[found.names.index(names[k]), self._axis]))
        keys = [(names[k], series(k), dashes(k), _WIDTH) for k in (0, *order)]
        self.keys = [*keys, *([limit_key(_LIMIT)] if near else [])]


class WaterfallPanel(Panel):
    """How the mean squares of the sources add up to the total, the largest first."""

    def __init__(self, theme: Theme, sources: Sources, name: str) -> None:
        super().__init__(name, "Sum of sources", theme, sources)
        self._across, self._rows = View(0.0, 1.0, _ends), View(8.0, 0.0, _turned)
        self.plot = plot = self.add(self._across, self._rows, "rms, µrad; lengths are mean squares", "")
        columns = {"y": "bar", "left": "low", "right": "high"}
        source = sources.new(name, "bar", "low", "high", "at", "zero", lists=("words", "colour"))
        plot.hbar(**columns, height=_TALL, source=source, fill_color="colour", line_color="colour", line_width=1)
        self.words(plot, "zero", "at", source, "ink", text="words", size=SMALL, text_baseline="middle")
        self._limit = self.limit_line(plot, "height")
        plot.yaxis[0].visible = False
        plot.ygrid[0].visible = False
        plot.min_border_left = 12

    def show_budget(self, fall: Waterfall, largest: tuple[str, ...], room: int) -> None:
        """Follow a waterfall with room for so many steps; the sources `largest` have the colours of their curves."""
        low, high = (MICRO**2 * np.append(one, last) for one, last in ((fall.low, 0.0), (fall.high, fall.total**2)))
        rows = len(low)
        texts = [
            f"{name}: {plain(MICRO * float(rms), 3)} µrad, {_percent(float(share))}"
            for name, rms, share in zip(fall.names, fall.rms, fall.shares, strict=True)
        ]
        texts.append(f"{TOGETHER}: {plain(MICRO * fall.total, 3)} µrad")
        roles = [series(1 + largest.index(one)) if one in largest else "reference" for one in fall.names]
        self.sources.put(
            self.name,
            bar=column(np.arange(rows) + _BAR),
            low=column(np.minimum(low, high)),
            high=column(np.maximum(low, high)),
            at=column(np.arange(rows) + _WORDS),
            zero=column(np.zeros(rows)),
            words=texts,
            colour=[self.theme.colours[one] for one in (*roles, series(0))],
        )
        self._rows.fit((0.0, float(room)))
        self._across.fit((0.0, MICRO**2 * fall.end))
        end = self._across.rest[1]
        ticks = MICRO * rms_ticks(end / MICRO**2)
        axis = self.plot.xaxis[0]
        places = [float(one) for one in ticks**2]
        if not hasattr(axis.ticker, "ticks") or list(axis.ticker.ticks) != places:
            axis.ticker = places
            self.plot.xgrid[0].ticker = axis.ticker
            axis.major_label_overrides = {at: plain(float(one), 3) for at, one in zip(places, ticks, strict=True)}
        inside = fall.limit is not None and (MICRO * fall.limit) ** 2 < end
        self._limit.location = (MICRO * fall.limit) ** 2 if inside and fall.limit is not None else None
        self.detail = fall.axis
        words = "" if fall.limit is None else f"limit {plain(MICRO * fall.limit, 3)} µrad"
        self.keys = [limit_key(words + ("" if inside else ", beyond the right end"))] if words else []


def _percent(share: float) -> str:
    return f"{plain(100.0 * share, 2)} %" if not 0.0 < share < _LEAST_SHARE else f"< {100.0 * _LEAST_SHARE:g} %"


def _ends(low: float, high: float) -> tuple[float, float]:
    """Return a length that stays while a slider moves the numbers a little."""
    decade = 10.0 ** math.floor(math.log10(max(high, 1e-12)))
    return 0.0, next(k * decade for k in (1.0, 1.3, 1.7, 2.2, 3.0, 4.0, 5.5, 7.5, 10.0) if k * decade >= 0.999 * high)


def _turned(low: float, high: float) -> tuple[float, float]:
    return high, low


class BudgetPlots:
    """The plots of a budget, in the order of the page: two axes over frequency, then the waterfalls below them."""

    def __init__(self, budget: BudgetSpec, theme: Theme, sources: Sources) -> None:
        self._budget = budget
        frequency = View(budget.from_hz, budget.to_hz, lambda low, high: (low, high), logarithmic=True)
        frequency.fit((budget.from_hz, budget.to_hz))
        self._over_frequency = [CumulativePanel(theme, sources, budget, frequency, axis) for axis in (0, 1)]
        self._falls = [WaterfallPanel(theme, sources, f"waterfall{k}") for k in (0, 1, 2)]
        self.panels: tuple[Panel, ...] = (*self._over_frequency, *self._falls)
        # The sources with colours: those that were largest first, so that none changes its colour while a slider moves.
        self._largest: tuple[str, ...] = ()
        self._found: LineOfSightBudget | None = None

    def show(self, found: LineOfSightBudget) -> None:
        """Follow a budget."""
        self._found = found
        if not set(self._largest) <= set(found.names) or not self._largest:
            self._largest = tuple(found.names[k] for k in found.ranking[:_CURVES])
        for panel in self._over_frequency:
            panel.show_budget(found, self._largest)
        falls = waterfalls(self._budget, found)
        room = max(_ROWS, *(1 + len(one.names) for one in falls))
        for fall, one in zip(self._falls, falls, strict=True):
            fall.show_budget(one, self._largest, room)

    def again(self) -> None:
        """Show the same with other colours."""
        if self._found is not None:
            self.show(self._found)


class Plots:
    """All plots of a page; they belong to one document.

    Attributes
    ----------
    layout
        Roots by name: ``"bode"``, ``"nichols"``, ``"locus"``, ``"step"``, ``"Omega"``, and of a job with a budget
        ``"cumulative0"``, ``"cumulative1"``, ``"waterfall0"`` to ``"waterfall2"``; each fills its container.
    panels
        What is drawn there, and what is written above it.
    sources
        Bokeh's column data sources by name: what is drawn, in the units of the axes.
    """

    def __init__(self, dark: bool = False, budget: BudgetSpec | None = None) -> None:
        self._theme, sources = Theme(dark), Sources()
        self._picture: Drawing | None = None
        # One view for all that is over frequency: zooming one zooms all.
        frequency = View(0.1, 1000.0, _frequencies, logarithmic=True)
        self._bode = BodePanel(self._theme, sources, frequency)
        nichols = NicholsPanel(self._theme, sources, self._bode.overlays)
        self._locus = LocusPanel(self._theme, sources)
        self._rate = RatePanel(self._theme, sources, frequency, self._bode.mouse)
        self._panels = (self._bode, nichols, self._locus, StepPanel(self._theme, sources), self._rate)
        self._budget = None if budget is None else BudgetPlots(budget, self._theme, sources)
        self.sources = sources.by_name
        self.panels = self._panels if self._budget is None else (*self._panels, *self._budget.panels)
        self.layout: dict[str, LayoutDOM] = {one.name: one.layout for one in self.panels}

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


def _subject(picture: Drawing) -> tuple[object, ...]:
    """Return loop, design, channel, axis and overlays of a picture: all but the numbers of sliders."""
    settings = picture.settings
    return settings.loop, settings.design, settings.channel, settings.axis, settings.overlays
