"""The root locus in the s-plane: branches over the gain, damping rays, and poles to be dragged."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import numpy as np
from bokeh.core.properties import value
from bokeh.models.annotations.geometry import BoxAnnotation, Span

from platform_ctrl.analysis.arrays import ComplexArray
from platform_ctrl.app.pictures import Drawing, Locus
from platform_ctrl.app.plots.bode import HZ
from platform_ctrl.app.plots.data import (
    FONT,
    LIMIT_DASHES,
    Sources,
    View,
    column,
    inner_height,
    inner_width,
    series,
    strung,
    thinned,
)
from platform_ctrl.app.plots.handles import Drag
from platform_ctrl.app.plots.panel import Panel, Theme, tell
from platform_ctrl.common.values import FloatArray

# Points that are put between the two gains, closer where the poles move fastest.
_POINTS = 9
_REAL = 1e-9


def rounded(gains: FloatArray, branches: ComplexArray) -> tuple[FloatArray, ComplexArray]:
    """Return gains and branches with more points where a pair of poles turns from complex to real or back.

    The two poles of a pair are m ± √d, and m and d go smoothly with the gain while the poles themselves do not: between
    the two gains m and d are taken to be linear. All other branches are straight there.

    Parameters
    ----------
    gains : (G,)
        Rising.
    branches : complex (G, n)
        Each column one continuous branch.

    Returns
    -------
    (H,), complex (H, n)
        H ≥ G.
    """
    if len(gains) < 2 or branches.shape[1] < 2:
        return gains, branches
    # A pole that is infinitely fast turns nowhere.
    fine = np.isfinite(branches)
    real = ~fine | (np.abs(branches.imag) <= _REAL * (np.abs(branches) + 1.0))
    turns = np.flatnonzero((real[1:] != real[:-1]).any(axis=1))
    share = 0.5 - 0.5 * np.cos(np.pi * np.arange(1, _POINTS + 1) / (_POINTS + 1))
    at, more_gains, more = [], [], []
    for k in turns:
        start, end = branches[k], branches[k + 1]
        changed = np.flatnonzero((real[k] != real[k + 1]) & fine[k] & fine[k + 1])
        where = share
        pairs = []
        for i in changed:
            ends = start if not real[k, i] else end
            j = next((j for j in changed if j > i and abs(ends[j] - ends[i].conjugate()) <= 1e-6 * abs(ends[i])), None)
            if j is not None:
                m0, m1 = 0.5 * (start[i] + start[j]).real, 0.5 * (end[i] + end[j]).real
                d0, d1 = (0.25 * ((s[i] - s[j]) ** 2).real for s in (start, end))
                pairs.append((i, j, m0, m1, d0, d1))
                # The turn itself is one of the points.
                where = np.union1d(where, [d0 / (d0 - d1)] if d0 * d1 < 0.0 else [])
        with np.errstate(invalid="ignore"):
            points = start + where[:, None] * (end - start)
        for i, j, m0, m1, d0, d1 in pairs:
            root = np.sqrt((d0 + where * (d1 - d0)).astype(np.complex128))
            # Which of the two goes up, or to the right, is as at the ends.
            up = np.sign(((start if not real[k, i] else end)[i]).imag)
            right = np.sign(((end if real[k + 1, i] else start)[i] - (end if real[k + 1, i] else start)[j]).real)
            sign = np.where(np.abs(root.imag) > 0.0, up, right)
            middle = m0 + where * (m1 - m0)
            points[:, i], points[:, j] = middle + sign * root, middle - sign * root
        at.append(np.full(len(where), k + 1))
        more_gains.append(gains[k] + where * (gains[k + 1] - gains[k]))
        more.append(points)
    if not at:
        return gains, branches
    places = np.concatenate(at)
    return np.insert(gains, places, np.concatenate(more_gains)), np.insert(
        branches, places, np.concatenate(more), axis=0
    )


# Rings that there are, and half their size, pixels.
NUMBER, _HALF = 12, 9.0


class PoleHandles:
    """Rings around poles.

    Parameters
    ----------
    plot
        The s-plane, rad/s.
    theme
        Colours.
    sources
        Where the data of all plots stand; the source ``dragged`` shows where a pole and its conjugate are wanted.
    ended
        Called after a drag.
    """

    def __init__(self, plot: Any, theme: Theme, sources: Sources, ended: Callable[[], None]) -> None:
        self.callbacks: list[Callable[[complex, complex], None]] = []
        self._plot, self._sources, self._then = plot, sources, ended
        # Ring → pole. A ring keeps its pole from picture to picture.
        self._poles: dict[int, complex] = {}
        # While a ring is dragged: which, where its pole stands in the last picture, and where it was wanted then.
        self._caught: tuple[int, complex] | None = None
        self._wanted = 0j
        # Where each was put last; while the document holds its events, news of that comes later.
        self._put: dict[int, list[float]] = {}
        self._putting = False
        self.boxes = []
        for k in range(NUMBER):
            box: Any = BoxAnnotation(
                left=0.0, right=1.0, bottom=0.0, top=1.0, editable=True, movable="both", resizable="none",
                visible=False, name=f"pole-handle-{k}", fill_alpha=0.10,
                hover_fill_alpha=0.40, line_alpha=0.55, hover_line_alpha=1.0, hover_line_width=1, propagate_hover=True,
            )  # fmt: skip
            box.border_radius = int(_HALF)
            theme.paint(
                box, fill_color="series-1", hover_fill_color="series-1", line_color="series-1", hover_line_color="ink"
            )
            plot.add_layout(box)
            for name in ("left", "right", "bottom", "top"):
                box.on_change(name, self._mover(k))
            self.boxes.append(box)
        self.drag: Drag[complex] = Drag(plot, self._dragged, self._ended)
        for one in (plot.x_range, plot.y_range):
            one.on_change("start", self._zoomed)
            one.on_change("end", self._zoomed)
        plot.on_change("inner_width", self._zoomed)
        plot.on_change("inner_height", self._zoomed)

    def show(self, locus: Locus) -> None:
        """Stand around the poles that may be dragged, the slowest ones where there are too many."""
        poles = locus.present[locus.draggable & np.isfinite(locus.present)]
        left = [complex(pole) for pole in poles[np.argsort(np.abs(poles), kind="stable")[:NUMBER]]]
        kept: dict[int, complex] = {}
        if self._caught is not None and left:
            # It has come some part of the way: of all poles it is the one nearest to both ends of that way.
            k, before = self._caught
            kept[k] = min(left, key=lambda pole: abs(pole - before) + abs(pole - self._wanted))
            self._caught = (k, kept[k])
            left.remove(kept[k])
        others = [k for k in self._poles if k not in kept]
        if others and left:
            from scipy.optimize import linear_sum_assignment

            away = np.abs(np.subtract.outer([self._poles[k] for k in others], left))
            rows, columns = linear_sum_assignment(away)
            kept |= {others[i]: left[j] for i, j in zip(rows, columns, strict=True)}
            left = [pole for j, pole in enumerate(left) if j not in columns]
        free = (k for k in range(NUMBER) if k not in kept)
        self._poles = kept | dict(zip(free, left, strict=False))
        self._place()

    def _place(self) -> None:
        wide, high = self._sizes()
        for k, box in enumerate(self.boxes):
            if self._caught is not None and self._caught[0] == k:
                continue
            if k not in self._poles:
                box.visible = False
                continue
            x, y = self._poles[k].real, self._poles[k].imag
            left, right, bottom, top = self._put[k] = [x - wide, x + wide, y - high, y + high]
            self._putting = True
            box.update(left=left, right=right, bottom=bottom, top=top, visible=True)
            self._putting = False

    def _sizes(self) -> tuple[float, float]:
        """Return half the size of a ring in rad/s across and up."""
        x, y = self._plot.x_range, self._plot.y_range
        spans = [float(one.end) - float(one.start) for one in (x, y)]
        if not all(math.isfinite(span) and span > 0.0 for span in spans):
            return 1.0, 1.0
        return spans[0] * _HALF / inner_width(self._plot), spans[1] * _HALF / inner_height(self._plot)

    def _zoomed(self, name: str, old: object, new: object) -> None:
        self._place()

    def _mover(self, k: int) -> Callable[[str, object, object], None]:
        def moved(name: str, old: object, new: object) -> None:
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
                self._wanted = self._caught[1]
            # The lower half plane is the upper one's mirror: the pole wanted is the upper of the pair.
            target = complex(middle.real, abs(middle.imag))
            self._mark(self._caught[1], target)
            self.drag.move(target)

        return moved

    def _mark(self, pole: complex, target: complex) -> None:
        self._sources.put(
            "dragged",
            x0=column([pole.real, pole.real]),
            y0=column([pole.imag, -pole.imag]),
            x1=column([target.real, target.real]),
            y1=column([target.imag, -target.imag]),
        )

    def _dragged(self, target: complex) -> None:
        if self._caught is None:
            return
        pole, self._wanted = self._caught[1], target
        for callback in self.callbacks:
            callback(pole, target)

    def _ended(self) -> None:
        self._caught = None
        self._sources.put("dragged", **{name: column([]) for name in ("x0", "y0", "x1", "y1")})
        self._place()
        self._then()


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
    """The root locus."""

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
        required = sources.new("required_damping", "x", "y")
        poles = sources.new("poles", "re", "im", "damping", "hz")
        marks = sources.new("plane_labels", "x", "y", "dx", "dy", lists=("text", "align", "baseline"))
        away = sources.new("dragged", "x0", "y0", "x1", "y1")
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
        edge = plot.line("x", "y", source=required, line_width=1.5, line_dash=list(LIMIT_DASHES))
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

    def on_dragged(self, callback: Callable[[complex, complex], None]) -> None:
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
        self._required(locus.damping)
        self.handles.show(locus)
        self.panel.say("drag a ringed pole" if locus.draggable.any() else "")
        self.panel.keys(
            [
                ("gain from 0", "series-3", (), 1.4),
                *(
                    [(f"required damping {locus.damping:g}", "limit", LIMIT_DASHES, 1.5)]
                    if locus.damping is not None
                    else []
                ),
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

    def _required(self, damping: float | None) -> None:
        if damping is None or not 0.0 < damping < 1.0:
            self._sources.put("required_damping", x=column([]), y=column([]))
            return
        # Dashes are drawn one by one, far outside the view too: no further than somebody may zoom out.
        end = 8.0 * self._reach
        slope = -damping / math.sqrt(1.0 - damping**2) * end
        self._sources.put("required_damping", x=column([slope, 0.0, slope]), y=column([end, 0.0, -end]))

    def _look(self, locus: Locus) -> None:
        """Show the upper half plane as far as it matters; a reach that changes a little moves nothing."""
        reach = locus.reach
        if self.handles.drag.active:
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
