"""How figures look: colours that colour-blind people tell apart, in a light and a dark page alike.

Figures are drawn once. Every colour is drawn as that of the light page; when the SVG goes into the page each becomes a
CSS variable with that colour as its default, and the page's style sheet sets the variables for the theme.
"""

from __future__ import annotations

import json
import re
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from contextvars import ContextVar
from functools import cached_property, wraps
from importlib import resources
from io import StringIO
from typing import Any, ParamSpec, TypeVar

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from matplotlib.axis import XAxis, YAxis
from matplotlib.backends.backend_svg import FigureCanvasSVG
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.text import Text
from matplotlib.ticker import FuncFormatter, LogLocator, MaxNLocator, NullFormatter, NullLocator
from numpy.typing import NDArray

from platform_ctrl.common.palette import PALETTE
from platform_ctrl.common.text import text_width
from platform_ctrl.common.values import FloatArray
from platform_ctrl.job.quantities import power_of_ten

P = ParamSpec("P")
Drawn = TypeVar("Drawn")

_VARIABLES = {colour: role for role, colour in PALETTE["light"].items()}
SERIES = tuple(colour for colour, role in _VARIABLES.items() if role.startswith("series-"))
# Line styles and markers differ as well.
DASHES: tuple[Any, ...] = (
    "-",
    (0, (5, 2)),
    (0, (1.2, 1.4)),
    (0, (6, 1.6, 1.2, 1.6)),
    (0, (6, 1.4, 1.2, 1.4, 1.2, 1.4)),
    (0, (3, 1)),
    "-",
    (0, (9, 2)),
)
DASHED, DOTTED, DASH_DOTTED = DASHES[1], DASHES[2], DASHES[3]
MARKERS = ("o", "s", "^", "D", "v", "P", "X", "*")
PAGE, INK, MUTED, GRID, FRAME, LIMIT, BEYOND, BAND, REFERENCE = (
    PALETTE["light"][role] for role in ("page", "ink", "muted", "grid", "frame", "limit", "beyond", "band", "reference")
)

# By what they are called in `data-axes`, 0 and 1.
_SCALES = ("linear", "log")
# Inches: margins of a figure, gaps between panels, rows of the legend, distance of an axis label from its axis.
FULL_WIDTH = 9.6
_LEFT, _RIGHT, _BOTTOM, _GAP_X = 0.66, 0.2, 0.46, 0.76
_TITLE, _NO_TITLE, _LEGEND_ROW = 0.26, 0.08, 0.22
_LABEL_AWAY, _LABEL_BELOW = 0.5, 0.25
# Markers of matplotlib: down, and to the left; their length in points.
_TICKS, _TICK = {"x": 3, "y": 0}, 3.0

_COLOURS: Any = {
    "text.color": INK,
    "axes.labelcolor": MUTED,
    "axes.edgecolor": FRAME,
    "grid.color": GRID,
    "xtick.color": FRAME,
    "ytick.color": FRAME,
    "xtick.labelcolor": MUTED,
    "ytick.labelcolor": MUTED,
}
_of_page: ContextVar[bool] = ContextVar("of_page", default=False)


def _look() -> Any:
    return mpl.rc_context(_COLOURS, str(resources.files("platform_ctrl.report") / "templates" / "report.mplstyle"))


@contextmanager
def settings() -> Iterator[None]:
    """Make and draw the figures of a page: pyplot does not know them; the caller's own settings come back after it."""
    before = _of_page.set(True)
    try:
        with _look():
            yield
    finally:
        _of_page.reset(before)


def standalone(draw: Callable[P, Drawn]) -> Callable[P, Drawn]:
    """Decorate a plot for scripts and notebooks: in the report's look whatever the settings are."""

    @wraps(draw)
    def drawn(*args: P.args, **keywords: P.kwargs) -> Drawn:
        with _look():
            return draw(*args, **keywords)

    return drawn


def _figure(width: float, height: float) -> Figure:
    """Return an empty figure: of a page on nothing, of a script on white paper and known to pyplot, which shows it."""
    if _of_page.get():
        figure = Figure(figsize=(width, height), facecolor="none")
        FigureCanvasSVG(figure)
        return figure
    from matplotlib import pyplot

    return pyplot.figure(figsize=(width, height), facecolor="white")


def panels(
    rows: int, columns: int, tall: float, names: Sequence[str] = (), *, titles: bool = True, width: float = FULL_WIDTH
) -> tuple[Figure, NDArray[Any]]:
    """Return a figure with a grid of panels, `tall` inches each, and its axes (rows, columns).

    `names`: of the legend above.
    """
    over = _TITLE if titles else _NO_TITLE
    top = 0.1 + _LEGEND_ROW * legend_rows(names, width) + over
    height = top + rows * tall + (rows - 1) * (_BOTTOM + over) + _BOTTOM
    across = (width - _LEFT - _RIGHT - (columns - 1) * _GAP_X) / columns
    place = {
        "left": _LEFT / width,
        "right": 1.0 - _RIGHT / width,
        "bottom": _BOTTOM / height,
        "top": 1.0 - top / height,
    }
    place |= {"wspace": _GAP_X / across, "hspace": (over + _BOTTOM) / tall}
    figure = _figure(width, height)
    kind = {"axes_class": _Panel} if _of_page.get() else {}
    axes = figure.subplots(rows, columns, squeeze=False, gridspec_kw=place, subplot_kw=kind)
    for one in axes.flat:
        one.xaxis.set_label_coords(0.5, -_LABEL_BELOW / tall)
        one.yaxis.set_label_coords(-_LABEL_AWAY / across, 0.5)
    return figure, axes


class _Scale:
    """An axis that draws its grid, ticks, numbers and label in few objects: matplotlib's own has seven for a tick."""

    majorTicks: Any = cached_property(lambda axis: [])
    minorTicks: Any = cached_property(lambda axis: [])

    def draw(self: Any, renderer: Any) -> None:
        """Draw what locator and formatter say."""
        name, box, formatter, points = (
            self.axis_name,
            self.axes.bbox,
            self.get_major_formatter(),
            renderer.points_to_pixels,
        )
        every, scale = np.asarray(self.get_majorticklocs()), self.get_transform().transform
        low, high = np.sort(scale(np.asarray(self.get_view_interval())))
        slack, order = 1e-9 * (high - low), 1 if name == "x" else -1
        inside = [low - slack <= scale(x) <= high + slack for x in every]
        at, place = every[inside], getattr(self.axes, f"get_{name}axis_transform")
        through = [np.repeat(at, 3), np.tile([0.0, 1.0, np.nan], len(at))][::order]
        tick: dict[str, Any] = {
            "marker": _TICKS[name],
            "markersize": _TICK,
            "markeredgewidth": 0.8,
            "color": FRAME,
            "linestyle": "",
        }
        lines = [Line2D(*[at, 0.0 * at][::order], transform=place("tick1"), **tick)]
        if self.get_tick_params()["gridOn"]:
            lines.insert(0, Line2D(*through, transform=place("grid"), color=GRID, linewidth=0.6))
        transform, va, ha = getattr(self.axes, f"get_{name}axis_text1_transform")(_TICK + 3.5)
        text = Text(transform=transform, va=va, ha=ha, color=MUTED, fontsize=7.5)
        for one in (*lines, text):
            one.set_figure(self.axes.figure)
        for line in lines if len(at) else []:
            line.draw(renderer)
        for x, words in zip(at, np.array(formatter.format_ticks(every), dtype=object)[inside], strict=True):
            text.set(position=[x, 0.0][::order], text=words)
            text.draw(renderer)
        self.label.draw(renderer)
        self.offsetText.set_text(formatter.get_offset())
        self.offsetText.set_position((1, box.ymin - points(17.0)) if name == "x" else (0, box.ymax + points(3.0)))
        self.offsetText.draw(renderer)


class _X(_Scale, XAxis): ...


class _Y(_Scale, YAxis): ...


class _Panel(Axes):
    """A panel of a page: a third of the time for its axes."""

    def _init_axis(self) -> None:
        super()._init_axis()  # type: ignore[misc]
        self.xaxis.__class__, self.yaxis.__class__ = _X, _Y


def line_style(k: int) -> dict[str, Any]:
    """Return colour and dashes of the k-th series."""
    return {"color": SERIES[k % len(SERIES)], "linestyle": DASHES[k % len(DASHES)]}


def legend_rows(names: Sequence[str], width: float) -> int:
    """Return how many rows a legend of `names` needs in a figure of `width` inches."""
    size = float(mpl.rcParams["legend.fontsize"])
    longest = max((text_width(name, size) for name in names), default=0.0)
    columns = max(1, int(72.0 * (width - _LEFT) // (longest + 5.2 * size)))
    return -(-len(names) // columns)


def legend(figure: Figure, handles: Sequence[Any], names: Sequence[str]) -> Any:
    """Put a legend into the strip that `panels` has left above."""
    if not names:
        return None
    width, height = map(float, figure.get_size_inches())
    return figure.legend(
        handles,
        names,
        loc="upper left",
        ncols=-(-len(names) // legend_rows(names, width)),
        bbox_to_anchor=(_LEFT / width, 1.0 - 0.07 / height),
        borderaxespad=0.0,
        borderpad=0.1,
        handlelength=2.6,
        columnspacing=1.8,
    )


def log_axis(axis: Any) -> None:
    """Label the decades plainly; grid lines at the decades alone."""
    axis.set_major_locator(LogLocator(base=10.0, numticks=9))
    axis.set_minor_locator(NullLocator())
    axis.set_major_formatter(FuncFormatter(lambda number, _: power_of_ten(number)))
    axis.set_minor_formatter(NullFormatter())


def frequency_axes(axes: Axes, low: float, high: float, *, log_gain: bool, label: bool = True) -> None:
    """Make x a logarithmic frequency axis from `low` to `high` Hz, and y too with `log_gain`."""
    axes.set_xscale("log")
    axes.set_xlim(low, high)
    log_axis(axes.xaxis)
    if label:
        axes.set_xlabel("frequency, Hz")
    if log_gain:
        axes.set_yscale("log")
        log_axis(axes.yaxis)


def linear_axis(axis: Any, ticks: int = 5) -> None:
    """Use a handful of round ticks."""
    axis.set_major_locator(MaxNLocator(ticks, steps=[1, 2, 2.5, 5, 10]))


def gain_limits(axes: Axes, curves: Sequence[FloatArray], low: float | None, high: float | None) -> None:
    """Set whole decades around the finite positive values of `curves`, at most `low` to `high`."""
    values = np.concatenate([np.ravel(curve) for curve in curves]) if curves else np.ones(1)
    values = values[np.isfinite(values) & (values > 0.0)]
    bottom, top = (values.min(), values.max()) if values.size else (0.1, 10.0)
    bottom = max(bottom, low) if low is not None else bottom
    top = min(top, high) if high is not None else top
    decades = np.floor(np.log10(bottom) + 1e-9), np.ceil(np.log10(top) - 1e-9)
    axes.set_ylim(10.0 ** decades[0], 10.0 ** max(decades[1], decades[0] + 1.0))


def envelope(t: FloatArray, y: FloatArray, buckets: int = 250) -> tuple[FloatArray, FloatArray]:
    """Return a trace thinned to the least and the largest value of each of `buckets` stretches, in their order.

    Drawn, it covers the same ink as the whole trace: no peak is lost.
    """
    N = len(y)
    if 3 * buckets >= N:
        return t, y
    edges = np.linspace(0, N, buckets + 1).astype(np.intp)[:-1]
    width = int(np.diff(np.append(edges, N)).max())
    index = np.minimum(edges[:, None] + np.arange(width), np.append(edges[1:], N)[:, None] - 1)
    stretch = y[index]
    rows = np.arange(buckets)
    low, high = index[rows, stretch.argmin(axis=1)], index[rows, stretch.argmax(axis=1)]
    keep = np.unique(np.concatenate([[0], low, high, [N - 1]]))
    return t[keep], y[keep]


_COLOUR = re.compile("|".join(_VARIABLES))
# Hundredths of a point are fine enough; spaces are not needed beside letters of paths and in styles.
_TAG, _NEEDLESS = re.compile(r"<[^>]*>"), re.compile(r"(?<=\.\d\d)\d+|\s*\n\s*|(?<=[MLCQ;:]) ")
# What a page does not need: heads, names, the font, turns by nothing.
_PLAIN = {
    re.compile(pattern, re.DOTALL): plain
    for pattern, plain in {
        r"<\?xml.*?\?>|<!DOCTYPE.*?>|<metadata>.*?</metadata>|<style.*?</style>|<!--.*?-->": "",
        r' id="legend_\d+"': ' class="legend"',
        r' id="(?!m[0-9a-f]|p[0-9a-f]|h[0-9a-f])[^"]*"| transform="rotate\(-?0 [^"]*"': "",
        "xlink:href": "href",
        # As Matplotlib 3.10 and 3.11 write fonts.
        r"font: (bold |700 |)([0-9.]+px) [^;\"]*": r"font-size:\2;font-weight:\1",
        r"font-weight:(?=[;\"])|font-family: [^;\"]*;? ?": "",
        r">\s+<": ">\n<",
    }.items()
}
_MARKERS = re.compile(r'<g([^>]*)>\n((?:<use [^>]*? (style="[^"]*")/>\n)(?:<use [^>]*? \3/>\n)+)</g>')


def svg(figure: Figure, description: str) -> str:
    """Return `figure` as an SVG element for the page: theme variables for colours, the page's own font, no address."""
    out = StringIO()
    width, height = figure.get_size_inches() * 72.0
    nothing = dict.fromkeys(("Date", "Creator", "Format", "Type"))
    figure.savefig(out, format="svg", facecolor="none", metadata=nothing)  # on the page's own ground
    text = out.getvalue()
    text = text[text.index("<svg") :]
    for pattern, plain in _PLAIN.items():
        text = pattern.sub(plain, text)
    # Markers of one look have it once.
    text = _MARKERS.sub(lambda found: f"<g{found[1]} {found[3]}>\n{found[2].replace(f' {found[3]}', '')}</g>", text)
    # Numbers between tags are what the reader reads.
    text = _TAG.sub(
        lambda found: _COLOUR.sub(lambda one: f"var(--{_VARIABLES[one[0]]})", _NEEDLESS.sub("", found[0])), text
    )
    escaped = description.replace("&", "&amp;").replace('"', "&quot;").replace("<", "&lt;")
    head = f'<svg viewBox="0 0 {width:g} {height:g}" role="img" aria-label="{escaped}"{_scales(figure)}>'
    return head + text[text.index(">") + 1 :].strip()


def _scales(figure: Figure) -> str:
    """Return where each panel is, in the points of the picture, and its scales: what the page's script reads."""
    width, height = figure.get_size_inches() * 72.0
    found = []
    for axes in figure.axes:
        if axes.get_xscale() not in _SCALES or axes.get_yscale() not in _SCALES or not axes.axison:
            continue
        box = axes.get_position()
        place = [round(x, 1) for x in (box.x0 * width, (1.0 - box.y1) * height, box.width * width, box.height * height)]
        ends = [[*(float(f"{x:.5g}") for x in limits), _SCALES.index(scale)] for limits, scale in (
            (axes.get_xlim(), axes.get_xscale()), (axes.get_ylim(), axes.get_yscale())
        )]  # fmt: skip
        found.append([*place, *ends])
    words = re.sub(r"(?<=\d)\.0(?=[,\]])", "", json.dumps(found, separators=(",", ":")))
    return f' data-axes="{words}"' if found else ""
