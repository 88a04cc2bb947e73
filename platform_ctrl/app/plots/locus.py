"""The root locus in the s-plane: branches over the gain and damping rays."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from platform_ctrl.app.pictures import Drawing
from platform_ctrl.app.plots.data import (
    HZ,
    LIMIT_DASHES,
    Sources,
    View,
    column,
    joined_curves,
    series,
    thinned,
)
from platform_ctrl.app.plots.panel import Key, Panel, Theme, limit_key, set_message
from platform_ctrl.common.values import FloatArray
from platform_ctrl.job.quantities import plain

DAMPINGS = (0.05, 0.1, 0.2, 0.4, 0.7)
# Poles of other plants that are drawn.
_OTHERS = 900
# The view relative to its reach: to the left, to the right, below; and where the rays end, rad/s.
_LEFT, _RIGHT, _BELOW, _END = 1.12, 0.30, 0.06, 1e7
# The view follows a reach that is smaller by more than this factor.
_HYSTERESIS = 1.35
# Least distance between the labels of the rays as a share of the view.
_APART = 0.17
_ROUND = np.array([1.0, 2.0, 5.0])
_BRANCH = ("re", "im", "gain")


def _slope(damping: float) -> float:
    """Return by how much a ray of a damping ratio goes to the left while it rises by 1."""
    return damping / math.sqrt(1.0 - damping**2)


class LocusPanel(Panel):
    """The root locus."""

    def __init__(self, theme: Theme, sources: Sources) -> None:
        super().__init__("locus", "Root locus", theme, sources)
        self._real, self._imaginary = View(-1.0, 0.3), View(-0.1, 1.0)
        plot = self.add(self._real, self._imaginary, "Re s, rad/s", "Im s, rad/s")
        plot.xgrid.grid_line_color = plot.ygrid.grid_line_color = None
        self._reach = 0.0
        self._draw_plane(plot)
        self._draw_poles(plot)
        self._message = self.message(plot)
        # Below the damping ratios at the ends of the rays.
        self._message.y_offset -= 14

    def _draw_plane(self, plot: Any) -> None:
        new, dotted = self.sources.new, [2, 3]
        wrong = plot.harea(x1=[0.0, 0.0], x2=[_END, _END], y=[-_END, _END], fill_alpha=1.0)
        self.theme.paint(wrong.glyph, fill_color="band")
        self.draw(plot.line, "x", "y", source=new("arcs", "x", "y"), line="frame", line_width=1, line_dash=dotted)
        slopes = np.array([_slope(one) for one in DAMPINGS])
        rays = new("rays", "x", "y", "x1", "y1")
        self.draw(plot.segment, "x", "y", "x1", "y1", source=rays, line="frame", line_width=1)
        zero, up = column(np.zeros(2 * len(slopes))), np.full(len(slopes), _END)
        left = column(np.tile(-slopes * _END, 2))
        self.sources.put("rays", x=zero, y=zero, x1=left, y1=column(np.concatenate([up, -up])))
        for dimension in ("width", "height"):
            self.span(plot, dimension, "reference", location=0.0)
        required = new("required_damping", "x", "y")
        dashed: dict[str, Any] = {"line_width": 1.5, "line_dash": list(LIMIT_DASHES)}
        self.draw(plot.line, "x", "y", source=required, line="limit", **dashed)

    def _draw_poles(self, plot: Any) -> None:
        new, draw = self.sources.new, self.draw
        others = new("other_poles", "re", "im")
        cloud: dict[str, Any] = {"marker": "dot", "size": 8, "line_alpha": 0.0, "fill_alpha": 0.35}
        draw(plot.scatter, "re", "im", source=others, fill="series-1", **cloud)
        branches = new("branches", *_BRANCH)
        branch = draw(plot.line, "re", "im", source=branches, line="series-3", line_width=1.2, line_alpha=0.75)
        starts = new("open_poles", "re", "im")
        draw(plot.scatter, "re", "im", source=starts, line="series-3", fill="page", marker="circle", size=4)
        overlays = new("overlay_poles", "re", "im", lists=("colour", "name"))
        plot.scatter("re", "im", source=overlays, marker="x", size=7, line_width=1.3, line_color="colour")
        poles = new("poles", "re", "im", "damping", "hz")
        cross = draw(plot.scatter, "re", "im", source=poles, line="series-1", marker="x", size=9, line_width=2)
        rows = [("pole", "@re{0.0} ± j @im{0.0} rad/s"), ("frequency", "@hz{0.0} Hz"), ("damping", "@damping{0.000}")]
        self.hover(plot, [cross], rows)
        rows = [("gain", "× @gain{0.00}"), ("s", "@re{0} ± j @im{0} rad/s")]
        self.hover(plot, [branch], rows, line_policy="nearest")
        labels = new("plane_labels", "x", "y", "dx", "dy", lists=("text", "align", "baseline"))
        side = {"text_align": "align", "text_baseline": "baseline", "x_offset": "dx", "y_offset": "dy"}
        self.words(plot, "x", "y", labels, "muted", text="text", **side)

    def show(self, picture: Drawing) -> None:
        """Follow a picture."""
        locus, overlays, put = picture.locus, picture.bode.overlays, self.sources.put
        factors, branches, reach = locus.values, locus.s.T, locus.view.reach
        columns = branches.real, branches.imag, np.broadcast_to(factors, branches.shape)
        put("branches", **{name: joined_curves(one) for name, one in zip(_BRANCH, columns, strict=True)})
        first = branches[:, 0] if branches.size else np.zeros(0, np.complex128)
        others = picture.other_poles[thinned(len(picture.other_poles), _OTHERS)]
        for name, poles in (("open_poles", first), ("other_poles", others)):
            put(name, re=column(poles.real), im=column(poles.imag))
        size = np.abs(picture.poles)
        with np.errstate(invalid="ignore", divide="ignore"):
            damping = column(np.where(size > 0.0, -picture.poles.real / size, np.nan))
        re, im = column(picture.poles.real), column(picture.poles.imag)
        put("poles", re=re, im=im, damping=damping, hz=column(size * HZ))
        found = [(pole, k, one.design) for k, one in enumerate(overlays) for pole in one.poles]
        put(
            "overlay_poles",
            re=column([pole.real for pole, _, _ in found]),
            im=column([pole.imag for pole, _, _ in found]),
            colour=[self.theme.colours[series(1 + k)] for _, k, _ in found],
            name=[name for _, _, name in found],
        )
        self._follow(reach)
        self._required(picture.damping)
        limits = [limit_key(f"required damping {picture.damping:g}")] if picture.damping is not None else []
        designs: list[Key] = [(one.design, series(1 + k), (), 1.5) for k, one in enumerate(overlays)]
        self.keys = [("gain from 0", "series-3", (), 1.4), *limits, *designs]
        right = int((picture.poles.real > 0.0).sum())
        trouble = "" if picture.stable else f"not stable: {right} {'pole' if right == 1 else 'poles'} to the right"
        set_message(self._message, trouble if np.isfinite(column(size)).any() else "no finite pole")

    def _required(self, damping: float | None) -> None:
        if damping is None or not 0.0 < damping < 1.0:
            self.sources.put("required_damping", x=column([]), y=column([]))
            return
        # Dashes are drawn one by one, also far outside the view: no further than the user may zoom out.
        end = 8.0 * self._reach
        left = -_slope(damping) * end
        self.sources.put("required_damping", x=column([left, 0.0, left]), y=column([end, 0.0, -end]))

    def _follow(self, reach: float) -> None:
        """Show the upper half plane as far as it matters; small changes of the reach move nothing."""
        if not (math.isfinite(reach) and reach > 0.0):
            return
        if self._reach / _HYSTERESIS <= reach <= self._reach:
            return
        self._reach = reach
        self._real.show(-_LEFT * reach, _RIGHT * reach)
        self._imaginary.show(-_BELOW * reach, reach)
        decade = math.floor(math.log10(reach * HZ))
        radii = np.sort(np.outer(10.0 ** np.arange(decade - 1, decade + 2), _ROUND).ravel()) / HZ
        turn = np.exp(1j * np.linspace(0.5 * np.pi, 1.5 * np.pi, 91))
        self._label(radii)
        arcs = np.outer(radii[radii < 4.0 * reach], turn)
        self.sources.put("arcs", x=joined_curves(arcs.real), y=joined_curves(arcs.imag))

    def _label(self, radii: FloatArray) -> None:
        """Write frequencies beside the arcs and damping ratios at the ends of the rays."""
        reach, left = self._reach, _LEFT * self._reach
        rows: list[tuple[float, float, float, float, str, str, str]] = []
        for radius in radii[(radii > 0.12 * reach) & (radii < 0.95 * reach)]:
            rows.append((0.0, radius, 5.0, 0.0, f"{plain(radius * HZ, 3)} Hz", "left", "middle"))
        last = math.inf
        for damping in reversed(DAMPINGS):
            slope = _slope(damping)
            if slope * reach >= left:
                rows.append((-left, left / slope, 3.0, -3.0, f"{damping:g}", "left", "bottom"))
            elif last - slope * reach >= _APART * left:
                last = slope * reach
                rows.append((-slope * reach, reach, -3.0, 3.0, f"{damping:g}", "right", "top"))
        numbers, words = ("x", "y", "dx", "dy"), ("text", "align", "baseline")
        columns = list(zip(*rows, strict=True))
        self.sources.put(
            "plane_labels",
            **{name: column(one) for name, one in zip(numbers, columns[:4], strict=True)},
            **{name: list(one) for name, one in zip(words, columns[4:], strict=True)},
        )
