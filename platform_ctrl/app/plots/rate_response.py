"""From the platform's rate, or a torque on it, to the angles: over time for a manoeuvre, or over frequency."""

from __future__ import annotations

import math

import numpy as np
from bokeh.models.annotations.geometry import BoxAnnotation, Span

from platform_ctrl.app.pictures import Drawing
from platform_ctrl.app.plots.bode import HZ
from platform_ctrl.app.plots.panel import Panel, Theme, overlay_keys, tell
from platform_ctrl.app.plots.sources import (
    LIMIT_DASHES,
    Sources,
    Unit,
    column,
    dashes,
    extent,
    finite,
    quantity,
    series,
)
from platform_ctrl.app.plots.time_response import TimePanel
from platform_ctrl.app.plots.views import View

# Below this share of the peak nothing is shown at rest.
_LEAST = 1e-5


class RatePanel:
    """Response to Omega, or of the free platform to a torque on it, over time or over frequency."""

    def __init__(self, theme: Theme, sources: Sources, frequency: View) -> None:
        self.panel = Panel("Omega", "Disturbance", theme)
        self._sources, self._theme, self._frequency = sources, theme, frequency
        self.over_time = TimePanel(self.panel, "Omega_time", sources, theme)
        self._gain = View(1e-3, 1.0, _decades, logarithmic=True)
        plot = self.panel.add(frequency, self._gain, "frequency, Hz", "", log_x=True, log_y=True)
        self.plot = plot
        lines = sources.new("Omega_gain", "frequency", "gain")
        band = sources.new("Omega_gain_band", "frequency", "low", "high")
        others = sources.new("Omega_gain_overlays", lists=("xs", "ys", "name", "colour", "dash"))
        self._limit = BoxAnnotation(bottom=1.0, visible=False, level="underlay", fill_alpha=1.0, line_alpha=0.0)
        theme.paint(self._limit, fill_color="beyond")
        plot.add_layout(self._limit)
        self._edge = Span(dimension="width", location=None, line_width=1.5, line_dash=list(LIMIT_DASHES))
        theme.paint(self._edge, line_color="limit")
        plot.add_layout(self._edge)
        area = plot.varea("frequency", "low", "high", source=band, fill_alpha=0.16)
        theme.paint(area.glyph, fill_color="series-1")
        plot.multi_line("xs", "ys", source=others, line_color="colour", line_dash="dash", line_width=1.5)
        line = plot.line("frequency", "gain", source=lines, line_width=2.2)
        theme.paint(line.glyph, line_color="series-1")
        self.panel.hover(
            plot, [line], [("frequency", "@frequency{0.[000]} Hz"), ("gain", "@gain{0.[0000]}")], mode="vline",
            line_policy="interp",
        )  # fmt: skip
        self.panel.crosshair(plot)
        self._message = self.panel.message(plot)
        self._unit = Unit()
        self.shows_frequency = False
        self.toggle = self.panel.button("frequency", "Omega-toggle")
        self.toggle.on_click(self._toggled)
        row = self.panel.row
        row.children = [row.children[0], self.toggle, *row.children[1:]]
        plot.visible = False
        self._picture: Drawing | None = None

    def _toggled(self) -> None:
        self.choose(not self.shows_frequency)

    def choose(self, frequency: bool) -> None:
        """Show the response over frequency, or over time."""
        self.shows_frequency = frequency
        self.toggle.label = "time" if frequency else "frequency"
        self.plot.visible = frequency
        self.over_time.visible(not frequency)
        if self._picture is not None:
            self.show(self._picture)

    def show(self, picture: Drawing) -> None:
        """Follow a picture with the figures that are seen."""
        self._picture = picture
        if self.shows_frequency:
            self._show_gain(picture)
        else:
            keys = self.over_time.show(picture, picture.Omega_time, "Omega_step")
            self.panel.say(picture.Omega_time.title)
            self.panel.keys(keys)

    def _show_gain(self, picture: Drawing) -> None:
        response, overlays = picture.Omega_frequency, picture.bode.overlays
        with np.errstate(invalid="ignore"):
            gain = np.where(response.gain > 0.0, response.gain, np.nan)
        top = extent([gain])
        size = top[1] if top is not None else math.nan
        limit = response.limit if response.limit is not None and 0.0 < response.limit < math.inf else None
        self._unit.follow(response.unit, size)
        scale, unit = self._unit.scale, self._unit.name
        put = self._sources.put
        put("Omega_gain", frequency=column(response.frequency * HZ), gain=column(gain, scale))
        f, low, high = finite(
            column(response.band_frequency * HZ), column(response.low, scale), column(response.high, scale)
        )
        # A logarithmic axis has no zero.
        floor = column(_LEAST * scale * size if size > 0.0 else 1e-30)
        put("Omega_gain_band", frequency=f, low=np.maximum(low, floor), high=np.maximum(high, floor))
        own = [(k, one) for k, one in enumerate(overlays) if len(one.Omega_gain) == len(response.frequency)]
        put(
            "Omega_gain_overlays",
            xs=[column(response.frequency * HZ)] * len(own),
            ys=[column(np.where(one.Omega_gain > 0.0, one.Omega_gain, np.nan), scale) for _, one in own],
            name=[one.design for _, one in own],
            colour=[self._theme.colours[series(1 + k)] for k, _ in own],
            dash=[list(dashes(1 + k)) for k, _ in own],
        )
        if limit is not None:
            self._limit.bottom = scale * limit
        self._limit.visible = limit is not None
        self._edge.location = None if limit is None else scale * limit
        if top is not None:
            # A limit close by is shown too.
            high_end = size if limit is None or not size / 30.0 < limit < 30.0 * size else max(size, 1.5 * limit)
            self._gain.fit((scale * max(top[0], _LEAST * size), scale * high_end))
        self.plot.yaxis[0].axis_label = unit
        tell(self._message, "no finite response" if top is None else "" if picture.stable else "closed loop not stable")
        self.panel.say(response.title)
        limits = [] if limit is None else [(f"limit {quantity(limit, response.unit)}", "limit", LIMIT_DASHES, 1.5)]
        self.panel.keys([(picture.settings.design, "series-1", (), 2.2), *overlay_keys(overlays), *limits])


def _decades(low: float, high: float) -> tuple[float, float]:
    bottom, top = math.floor(math.log10(low) + 1e-9), math.ceil(math.log10(high) - 1e-9)
    return 10.0**bottom, 10.0 ** max(top, bottom + 1)
