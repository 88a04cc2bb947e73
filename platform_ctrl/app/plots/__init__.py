"""The page's plots: Bokeh figures that follow a `Drawing`."""

from __future__ import annotations

import math

import numpy as np
from bokeh.models import FixedTicker, LayoutDOM

from platform_ctrl.analysis.curves import Curve, Curves, Level, Words
from platform_ctrl.app.pictures import Drawing
from platform_ctrl.app.plots.loop import BodePanel, LocusPanel, NicholsPanel
from platform_ctrl.app.plots.painter import Axis, Panel, Theme
from platform_ctrl.app.plots.responses import DisturbancePanel, TimePanel
from platform_ctrl.app.plots.views import View, round_bounds
from platform_ctrl.job.budget import BudgetSpec
from platform_ctrl.job.quantities import plain
from platform_ctrl.verification.budget_result import TOGETHER, LineOfSightBudget, Waterfall, rms_ticks, waterfalls

MICRO = 1e6
# Sources that have a curve of their own, and points of a curve.
_CURVES, _POINTS = 5, 160
# Within the height of a step: middle of its words and of its bar, and the bar's height.
_WORDS, _BAR, _TALL = 0.27, 0.76, 0.34
# Steps for which there is room at least.
_ROWS = 6
# Share of a mean square below which its size is not written.
_LEAST_SHARE = 1e-4


class CumulativePanel(Panel):
    """The rms of an axis up to a frequency, of all sources and of the largest."""

    def __init__(self, theme: Theme, budget: BudgetSpec, frequency: View, axis: int) -> None:
        super().__init__(f"cumulative{axis}", "Cumulative rms", theme)
        self._budget, self._axis = budget, axis
        self.add(
            Axis(frequency, "frequency, Hz", "up to", "{0.[000]} Hz", "mouse", False),
            View(0.0, 1.0, lambda low, high: (0.0, max(round_bounds(0.0, high)[1], 1e-6))),
            "{0.[00]} µrad",
            "levels lines",
        )
        # The same at every move: what is drawn is interpolated.
        self._f = np.geomspace(budget.from_hz, budget.to_hz, _POINTS)

    def show_budget(self, found: LineOfSightBudget, largest: tuple[str, ...]) -> None:
        """Follow a budget; the sources `largest` have curves."""
        # In the legend the largest of this axis come first: for the last ones there may be no room.
        order = sorted(range(len(largest)), key=lambda k: -float(found.rms[found.names.index(largest[k]), self._axis]))
        every = [("all sources", 0, found.total_cumulative[self._axis])]
        every += [(largest[k], 1 + k, found.cumulative[found.names.index(largest[k]), self._axis]) for k in order]
        curves = [
            Curve(
                x=self._f,
                y=MICRO * np.sqrt(np.interp(self._f, found.frequencies_hz, one)),
                name=name,
                series=k,
                dashes=k,
                form="strong",
            )
            for name, k, one in every
        ]
        limit, total = self._budget.limits.jitter_per_axis, MICRO * float(found.total[self._axis])
        near = () if limit is None or MICRO * limit >= 2.5 * total else (Level(y=MICRO * limit, text="limit"),)
        view = (0.0, max(total, *(one.y for one in near), 0.0))
        self.put({0: Curves(curves=tuple(curves), quantity="µrad", levels=near, view=view)}, found.axes[self._axis])


class WaterfallPanel(Panel):
    """How the mean squares of the sources add up to the total, the largest first."""

    def __init__(self, theme: Theme, name: str) -> None:
        super().__init__(name, "Sum of sources", theme)
        across, rows = View(0.0, 1.0, _ends), View(8.0, 0.0, lambda low, high: (high, low))
        label = "rms, µrad; lengths are mean squares"
        self._plot = plot = self.add(Axis(across, label, "", "", "mouse"), rows, "", "bands verticals words").plot
        plot.yaxis[0].visible = False
        plot.ygrid[0].visible = False
        plot.min_border_left = 12

    def show_budget(self, fall: Waterfall, largest: tuple[str, ...], room: int) -> None:
        """Follow a waterfall with room for so many steps; the sources `largest` have the colours of their curves."""
        texts = [
            f"{name}: {plain(MICRO * float(rms), 3)} µrad, {_percent(float(share))}"
            for name, rms, share in zip(fall.names, fall.rms, fall.shares, strict=True)
        ]
        texts.append(f"{TOGETHER}: {plain(MICRO * fall.total, 3)} µrad")
        roles = [f"series-{2 + largest.index(one)}" if one in largest else "reference" for one in fall.names]
        ends = zip((*fall.low, 0.0), (*fall.high, fall.total**2), (*roles, "series-1"), strict=True)
        bars = [
            Curve(
                x=MICRO**2 * np.array([low, high, high, low]),
                y=k + _BAR + 0.5 * _TALL * np.array([-1.0, -1.0, 1.0, 1.0]),
                form="band",
                kind="bar",
                role=role,
            )
            for k, (low, high, role) in enumerate(ends)
        ]
        words = tuple(
            Words(x=0.0, y=k + _WORDS, text=text, align=("left", "middle"), role="ink") for k, text in enumerate(texts)
        )
        across = self.figures[0].x.view
        across.fit((0.0, MICRO**2 * fall.end))
        end = across.rest[1]
        ticks = MICRO * rms_ticks(end / MICRO**2)
        places = [float(one) for one in ticks**2]
        axis = self._plot.xaxis[0]
        if not isinstance(axis.ticker, FixedTicker) or list(axis.ticker.ticks) != places:
            axis.ticker = FixedTicker(ticks=places)
            self._plot.xgrid[0].ticker = axis.ticker
            axis.major_label_overrides = {at: plain(float(one), 3) for at, one in zip(places, ticks, strict=True)}
        limit = None if fall.limit is None else (MICRO * fall.limit) ** 2
        text = "" if fall.limit is None else f"limit {plain(MICRO * fall.limit, 3)} µrad"
        inside = limit is not None and limit < end
        upright = [] if limit is None else [(limit, "limit", text + ("" if inside else ", beyond the right end"))]
        shown = Curves(curves=tuple(bars), verticals=tuple(upright), words=words, view=(0.0, float(room)))
        self.put({0: shown}, fall.axis)


def _percent(share: float) -> str:
    return f"{plain(100.0 * share, 2)} %" if not 0.0 < share < _LEAST_SHARE else f"< {100.0 * _LEAST_SHARE:g} %"


def _ends(low: float, high: float) -> tuple[float, float]:
    """Return a length that stays while a slider moves the numbers a little."""
    decade = 10.0 ** math.floor(math.log10(max(high, 1e-12)))
    return 0.0, next(k * decade for k in (1.0, 1.3, 1.7, 2.2, 3.0, 4.0, 5.5, 7.5, 10.0) if k * decade >= 0.999 * high)


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

    def __init__(self, budget: BudgetSpec | None = None) -> None:
        self._theme = Theme()
        self._subject: tuple[object, ...] = ()
        # One view for all that is over frequency, with the ends of the data: zooming one zooms all.
        view = View(0.1, 1000.0, lambda low, high: (low, high if high > low else 10.0 * low), logarithmic=True)
        frequency = Axis(view, "frequency, Hz", "frequency", "{0.[000]} Hz")
        self._loop = (
            BodePanel(self._theme, frequency),
            NicholsPanel(self._theme),
            LocusPanel(self._theme),
            TimePanel(self._theme, "step", "Step response", "step"),
            DisturbancePanel(self._theme, frequency),
        )
        self.panels: tuple[Panel, ...] = self._loop
        if budget is not None:
            self._budget = budget
            ends = (budget.from_hz, budget.to_hz)
            view = View(*ends, lambda low, high: (low, high), logarithmic=True)
            view.fit(ends)
            self._over_frequency = [CumulativePanel(self._theme, budget, view, axis) for axis in (0, 1)]
            self._falls = [WaterfallPanel(self._theme, f"waterfall{k}") for k in (0, 1, 2)]
            self.panels += (*self._over_frequency, *self._falls)
        # The sources with colours: those that were largest first, so that none changes its colour while a slider moves.
        self._largest: tuple[str, ...] = ()
        self.layout: dict[str, LayoutDOM] = {one.name: one.laid_out() for one in self.panels}

    def show(self, picture: Drawing) -> None:
        """Follow a picture; no model is made or removed.

        Data that are not finite are gaps; a plot with nothing to draw shows a message.
        """
        settings = picture.settings
        # All but the numbers of sliders.
        subject = (settings.loop, settings.design, settings.channel, settings.axis, settings.overlays)
        if self._subject not in ((), subject):
            for view in {view for one in self._loop for view in one.views}:
                view.forget()
        self._subject = subject
        for one in self._loop:
            one.show(picture)

    @property
    def over_frequency(self) -> bool:
        """Whether the disturbance is shown over frequency."""
        return self._loop[-1].turned

    def dark(self, dark: bool) -> None:
        """Switch the theme in place."""
        if self._theme.change(dark):
            for figure in (figure for one in self.panels for figure in one.figures):
                figure.again()

    def show_budget(self, found: LineOfSightBudget) -> None:
        """Follow the budget of the line of sight, of a job that has one."""
        if not set(self._largest) <= set(found.names) or not self._largest:
            self._largest = tuple(found.names[k] for k in found.ranking[:_CURVES])
        falls = waterfalls(self._budget, found)
        room = max(_ROWS, *(1 + len(one.names) for one in falls))
        for panel in self._over_frequency:
            panel.show_budget(found, self._largest)
        for fall, one in zip(self._falls, falls, strict=True):
            fall.show_budget(one, self._largest, room)
