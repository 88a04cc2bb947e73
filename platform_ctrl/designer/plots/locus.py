"""The root locus in the s-plane: branches over the gain, damping rays, and poles to be dragged."""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np
from bokeh.core.properties import value
from bokeh.models.annotations.geometry import Span

from platform_ctrl.designer.pictures import Drawing, Locus
from platform_ctrl.designer.plots.bode import HZ
from platform_ctrl.designer.plots.breakaways import rounded
from platform_ctrl.designer.plots.columns import column, strung, thinned
from platform_ctrl.designer.plots.palette import ASKED, FONT, series
from platform_ctrl.designer.plots.panel import Panel, Theme, tell
from platform_ctrl.designer.plots.pole_handles import PoleHandles
from platform_ctrl.designer.plots.sources import Sources
from platform_ctrl.designer.plots.views import View
from platform_ctrl.frozen import FloatArray

DAMPINGS = (0.05, 0.1, 0.2, 0.4, 0.7)
# Gains along the branches, and poles of other plants, that are drawn.
_GAINS, _OTHERS = 161, 900
# The view relative to its reach: to the left, to the right, below; and where the rays end, rad/s.
_LEFT, _RIGHT, _BELOW, _END = 1.12, 0.30, 0.06, 1e7
# A reach may leave the one shown by this factor before the view follows.
_PLAY = 1.35
# Words at the rays are this share of the view apart at least.
_APART = 0.17
_ROUND = np.array([1.0, 2.0, 5.0])


class LocusPanel:
    """The root locus.

    Parameters
    ----------
    theme
        Colours.
    sources
        Where the data of all plots stand.
    """

    def __init__(self, theme: Theme, sources: Sources) -> None:
        self.panel = Panel("locus", "Root locus", theme)
        self._sources, self._theme = sources, theme
        self._real, self._imaginary = View(-1.0, 0.3), View(-0.1, 1.0)
        plot = self.panel.add(self._real, self._imaginary, "real part, rad/s", "imaginary part, rad/s")
        self.plot = plot
        plot.xgrid.grid_line_color = plot.ygrid.grid_line_color = None
        self._reach = 0.0
        rays = sources.new("rays", "x", "y", "x1", "y1")
        arcs = sources.new("arcs", "x", "y")
        branches = sources.new("branches", "re", "im", "gain")
        ends = sources.new("open_poles", "re", "im")
        others = sources.new("other_poles", "re", "im")
        overlays = sources.new("overlay_poles", "re", "im", lists=("colour", "name"))
        asked = sources.new("asked_damping", "x", "y")
        poles = sources.new("poles", "re", "im", "damping", "hz")
        marks = sources.new("plane_labels", "x", "y", "dx", "dy", lists=("text", "align", "baseline"))
        away = sources.new("pulled", "x0", "y0", "x1", "y1")
        paint = theme.paint
        wrong = plot.harea(
            x1=[0.0, 0.0], x2=[_END, _END], y=[-_END, _END], fill_alpha=1.0,
        )  # fmt: skip
        paint(wrong.glyph, fill_color="band")
        arc = plot.line("x", "y", source=arcs, line_width=1, line_dash=[2, 3])
        ray = plot.segment("x", "y", "x1", "y1", source=rays, line_width=1)
        paint(arc.glyph, line_color="frame")
        paint(ray.glyph, line_color="frame")
        for dimension in ("width", "height"):
            axis = Span(dimension=dimension, location=0.0, line_width=1)
            paint(axis, line_color="reference")
            plot.add_layout(axis)
        edge = plot.line("x", "y", source=asked, line_width=1.5, line_dash=list(ASKED))
        paint(edge.glyph, line_color="limit")
        cloud = plot.scatter("re", "im", source=others, marker="dot", size=8, line_alpha=0.0, fill_alpha=0.35)
        paint(cloud.glyph, fill_color="series-1")
        branch = plot.line("re", "im", source=branches, line_width=1.2, line_alpha=0.75)
        paint(branch.glyph, line_color="series-3")
        start = plot.scatter("re", "im", source=ends, marker="circle", size=4)
        paint(start.glyph, fill_color="page", line_color="series-3")
        plot.scatter(
            "re", "im", source=overlays, marker="x", size=7, line_width=1.3, line_color="colour",
        )  # fmt: skip
        line = plot.segment("x0", "y0", "x1", "y1", source=away, line_width=1.2, line_dash=[3, 3])
        target = plot.scatter("x1", "y1", source=away, marker="circle", size=9, fill_alpha=0.0, line_width=1.2)
        paint(line.glyph, line_color="ink")
        paint(target.glyph, line_color="ink")
        cross = plot.scatter("re", "im", source=poles, marker="x", size=9, line_width=2)
        paint(cross.glyph, line_color="series-1")
        rows = [("pole", "@re{0.0} ± j @im{0.0} rad/s"), ("frequency", "@hz{0.0} Hz"), ("damping", "@damping{0.000}")]
        self.panel.hover(plot, [cross], rows)
        self.panel.hover(
            plot, [branch], [("gain", "× @gain{0.00}"), ("s", "@re{0} ± j @im{0} rad/s")], line_policy="nearest"
        )
        label = plot.text(
            "x", "y", text="text", source=marks, text_align="align", text_font=value(FONT),
            text_font_size=value("10px"),
            text_baseline="baseline", x_offset="dx", y_offset="dy",
        )  # fmt: skip
        paint(label.glyph, text_color="muted")
        self.handles = PoleHandles(plot, theme, sources, self._look_again)
        self._later: Locus | None = None
        self._message = self.panel.message(plot)
        # Below the damping ratios at the ends of the rays.
        self._message.y_offset -= 14
        slopes = [zeta / math.sqrt(1.0 - zeta**2) for zeta in DAMPINGS]
        sources.put(
            "rays",
            x=column(np.zeros(2 * len(slopes))),
            y=column(np.zeros(2 * len(slopes))),
            x1=column([-slope * _END for slope in slopes] * 2),
            y1=column([_END] * len(slopes) + [-_END] * len(slopes)),
        )

    def on_pulled(self, callback: Callable[[complex, complex], None]) -> None:
        """Call `callback` with a pole and where it is dragged to, rad/s, while it is."""
        self.handles.callbacks.append(callback)

    def show(self, picture: Drawing) -> None:
        """Follow a picture."""
        locus = picture.locus
        at = thinned(len(locus.gains), _GAINS)
        factors, rows = rounded(locus.gains[at], locus.branches[at])
        branches = rows.T
        gains = np.broadcast_to(factors, branches.shape)
        put = self._sources.put
        put("branches", re=strung(branches.real), im=strung(branches.imag), gain=strung(gains))
        first = branches[:, 0] if branches.size else np.zeros(0, np.complex128)
        put("open_poles", re=column(first.real), im=column(first.imag))
        others = locus.others[thinned(len(locus.others), _OTHERS)]
        put("other_poles", re=column(others.real), im=column(others.imag))
        size = np.abs(locus.present)
        with np.errstate(invalid="ignore", divide="ignore"):
            damping = np.where(size > 0.0, -locus.present.real / size, np.nan)
        put(
            "poles",
            re=column(locus.present.real),
            im=column(locus.present.imag),
            damping=column(damping),
            hz=column(size * HZ),
        )
        overlays = picture.bode.overlays
        found = [(pole, k, one.design) for k, one in enumerate(overlays) for pole in one.poles]
        put(
            "overlay_poles",
            re=column([pole.real for pole, _, _ in found]),
            im=column([pole.imag for pole, _, _ in found]),
            colour=[self._theme.colours[series(1 + k)] for _, k, _ in found],
            name=[name for _, _, name in found],
        )
        self._look(locus)
        self._asked(locus.damping)
        self.handles.show(locus)
        self.panel.say("drag a ringed pole" if locus.draggable.any() else "")
        self.panel.keys(
            [
                ("gain from 0", "series-3", (), 1.4),
                *([(f"asked damping {locus.damping:g}", "limit", ASKED, 1.5)] if locus.damping is not None else []),
                *[(one.design, series(1 + k), (), 1.5) for k, one in enumerate(overlays)],
            ]
        )
        if not np.isfinite(column(size)).any():
            tell(self._message, "no finite pole")
        else:
            right = int((locus.present.real > 0.0).sum())
            tell(
                self._message,
                "" if picture.stable else f"not stable: {right} {'pole' if right == 1 else 'poles'} to the right",
            )

    def _asked(self, damping: float | None) -> None:
        if damping is None or not 0.0 < damping < 1.0:
            self._sources.put("asked_damping", x=column([]), y=column([]))
            return
        # Dashes are drawn one by one, far outside the view too: no further than somebody may zoom out.
        end = 8.0 * self._reach
        slope = -damping / math.sqrt(1.0 - damping**2) * end
        self._sources.put("asked_damping", x=column([slope, 0.0, slope]), y=column([end, 0.0, -end]))

    def _look(self, locus: Locus) -> None:
        """Show the upper half plane as far as it matters; a reach that changes a little moves nothing."""
        reach = locus.reach
        if self.handles.pulling.active:
            # A view that moves would move the pole under the mouse; it follows afterwards.
            self._later = locus
            return
        if not (math.isfinite(reach) and reach > 0.0) or self._reach / _PLAY <= reach <= self._reach:
            return
        self._reach = reach * 1.12
        reach = self._reach
        self._real.show(-_LEFT * reach, _RIGHT * reach)
        self._imaginary.show(-_BELOW * reach, reach)
        decades = 10.0 ** np.arange(math.floor(math.log10(reach * HZ)) - 1, math.floor(math.log10(reach * HZ)) + 2)
        radii = np.sort(np.outer(decades, _ROUND).ravel()) / HZ
        turn = np.exp(1j * np.linspace(0.5 * np.pi, 1.5 * np.pi, 91))
        self._label(radii)
        arcs = np.outer(radii[radii < 4.0 * reach], turn)
        self._sources.put("arcs", x=strung(arcs.real), y=strung(arcs.imag))

    def _look_again(self) -> None:
        locus, self._later = self._later, None
        if locus is not None:
            self._look(locus)

    def _label(self, radii: FloatArray) -> None:
        """Write frequencies beside the arcs and damping ratios at the ends of the rays."""
        reach, left = self._reach, _LEFT * self._reach
        rows: list[tuple[float, float, float, float, str, str, str]] = []
        for radius in radii[(radii > 0.12 * reach) & (radii < 0.95 * reach)]:
            rows.append((0.0, radius, 5.0, 0.0, f"{radius * HZ:.3g} Hz", "left", "middle"))
        last = math.inf
        for damping in reversed(DAMPINGS):
            slope = damping / math.sqrt(1.0 - damping**2)
            if slope * reach < left:
                if last - slope * reach < _APART * left:
                    continue
                last = slope * reach
                rows.append((-slope * reach, reach, -3.0, 3.0, f"{damping:g}", "right", "top"))
            else:
                rows.append((-left, left / slope, 3.0, -3.0, f"{damping:g}", "left", "bottom"))
        x, y, dx, dy, text, align, baseline = (list(one) for one in zip(*rows, strict=True))
        self._sources.put(
            "plane_labels",
            x=column(x),
            y=column(y),
            dx=column(dx),
            dy=column(dy),
            text=text,
            align=align,
            baseline=baseline,
        )
