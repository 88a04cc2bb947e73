"""Pictures of a plant from its description alone: axes and bodies, natural frequencies over the rotors' speed."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch
from numpy.typing import ArrayLike

from platform_ctrl.analysis.poles import pole_branches
from platform_ctrl.common.arguments import instance, real_numbers
from platform_ctrl.common.text import greek
from platform_ctrl.common.values import FloatArray, value
from platform_ctrl.errors import ArgumentError
from platform_ctrl.job.quantities import HZ, RPM, plain
from platform_ctrl.mechanics.linearisation import LinearModel, linearise
from platform_ctrl.mechanics.modes import poles_and_kinds, rotors_at_rest
from platform_ctrl.mechanics.state_space import linear_system, subsystems
from platform_ctrl.plant.drawing import Outline, bodies, camera, disc_axis, levels
from platform_ctrl.plant.platform import Platform
from platform_ctrl.report import style
from platform_ctrl.report.figures.panels import LabelPlacer
from platform_ctrl.report.figures.root_locus import increasing, spinning

# Inches of a disc's radius at most, and below a panel for its scale; in radii: room around each body, length of the
# root's axes.
_RADIUS, _NO_SCALE, _ROOM, _ROOT_AXIS = 0.62, 0.46, (1.3, 0.55), 0.8
# Of gimbals by how many joints lie between them and the root.
_LEVELS = (style.INK, style.SERIES[7], style.SERIES[6], style.SERIES[3], style.REFERENCE)
_ANGLE, _SPIN, _SIGN = style.SERIES[1], style.SERIES[0], style.SERIES[2]
_ROTORS = {
    "regulated": ("-", "rotor, constant relative spin"),
    "free": (style.DASHED, "rotor, free-running"),
    "servo": (style.DASH_DOTTED, "rotor, speed loop"),
}
# Parts at a joint: marker, and name in the legend.
_SIGNS: dict[str, tuple[dict[str, Any], str]] = {
    "torquer": ({"marker": "s", "markerfacecolor": _SIGN, "markersize": 5.5}, "torquer"),
    "pickoff": ({"marker": "o", "markerfacecolor": style.PAGE, "markersize": 5.5}, "pick-off"),
    "spring": ({"marker": "x", "markersize": 6.0}, "spring"),
    "cage": ({"marker": "|", "markersize": 9.0}, "cage"),
    "erection": ({"marker": "v", "markerfacecolor": style.PAGE, "markersize": 6.0}, "erection"),
}
# Speeds at which the modes are computed, at least.
_SPEEDS = 401
# A frequency this small against the fastest counts as zero: poles at zero are computed no more accurately.
_ZERO = 1e-5
# Intersections near the origin, where all lines begin, do not count: share of the largest speed.
_CORNER = 0.005
_HEIGHT = 4.25


@style.standalone
def axes_picture(platform: Platform) -> Figure:
    """Picture of the axes of `platform`.

    Gimbals are frames on their bearings with the positive direction and turn of their angle, rotors are discs with the
    direction of L, the root is its axes 1, 2, 3 and the hatched mounts. In the model all axes go through one point; the
    drawing moves bodies apart and keeps every direction.

    Parameters
    ----------
    platform
        From `read_platform`.

    Returns
    -------
    matplotlib.figure.Figure
        One panel without scales, the same for the same platform.
    """
    instance("platform", platform, Platform)
    rows = camera(platform)
    shapes, low, high = _placed([_root_axes(platform), *bodies(platform, rows[2])], rows)
    width, height = high - low
    scale = min(_RADIUS, style.FULL_WIDTH / width)
    handles, names = _entries(platform, shapes)
    figure, [[axes]] = style.panels(1, 1, scale * height - _NO_SCALE, names, titles=False)
    axes.set_position((0.0, 0.0, 1.0, scale * height / figure.get_size_inches()[1]))
    axes.set_axis_off()
    middle = 0.5 * (low[0] + high[0])
    axes.set_xlim(middle - 0.5 * style.FULL_WIDTH / scale, middle + 0.5 * style.FULL_WIDTH / scale)
    axes.set_ylim(low[1], high[1])
    order = sorted(range(len(shapes)), key=lambda k: (round(_depth(shapes[k][0], rows), 6), k))
    for rank, k in enumerate(order):
        _draw(axes, *shapes[k], rows, platform, 2.0 + 1e-3 * rank)
    _label(axes, platform, shapes, rows)
    style.legend(figure, handles, names)
    return figure


def _root_axes(platform: Platform) -> list[Outline]:
    torqued = [t.root_axis for t in platform.torquers if t.root_axis is not None]
    arrows = [Outline("root", np.array([np.zeros(3), _ROOT_AXIS * e]), str(k)) for k, e in enumerate(np.eye(3), 1)]
    return [*arrows, *(Outline("sign torquer", 0.5 * _ROOT_AXIS * np.eye(3)[[k - 1]]) for k in torqued)]


def _placed(
    groups: Sequence[list[Outline]], rows: FloatArray
) -> tuple[list[tuple[Outline, FloatArray]], FloatArray, FloatArray]:
    """Return every shape with where the origin of its body lies, side by side, and the corners of the whole."""
    found, x, top = [], 0.0, 0.0
    for group in groups:
        ink = np.concatenate([_ink(shape, rows) for shape in group])
        low, high = ink.min(axis=0), ink.max(axis=0)
        at = np.array([x + 0.5 * _ROOM[0] - low[0], -0.5 * (low[1] + high[1])])
        found += [(shape, at) for shape in group]
        x += float(high[0] - low[0]) + _ROOM[0]
        top = max(top, 0.5 * float(high[1] - low[1]) + _ROOM[1])
    return found, np.array([0.0, -top]), np.array([x, top])


def _rim(shape: Outline, face: int) -> FloatArray:
    """Return points on the rim of a disc's face, (k, 3)."""
    turn = np.linspace(0.0, 2.0 * np.pi, 73)[:, None]
    side, other = np.linalg.svd(disc_axis(shape)[None, :])[2][1:]
    return np.asarray(shape.points[face] + np.cos(turn) * side + np.sin(turn) * other)


def _ink(shape: Outline, rows: FloatArray) -> FloatArray:
    """Return points of a shape as seen, right and up."""
    points = np.concatenate([_rim(shape, 0), _rim(shape, 1)]) if shape.kind == "disc" else shape.points
    return np.asarray(points @ rows[:2].T)


def _depth(shape: Outline, rows: FloatArray) -> float:
    # Signs on a pin are seen whichever end of it is nearer.
    ahead = 0.45 if shape.kind.startswith("sign ") else 1e-3 if shape.kind == "bearing" else 0.0
    return float(shape.points.mean(axis=0) @ rows[2]) + ahead


def _draw(axes: Axes, shape: Outline, at: FloatArray, rows: FloatArray, platform: Platform, order: float) -> None:
    flat, kind = at + shape.points @ rows[:2].T, shape.kind
    level = levels(platform).get(shape.body, 1)
    colour = _LEVELS[(level - 1) % len(_LEVELS)]
    if kind == "disc":
        _disc(axes, shape, at, rows, platform, order)
    elif kind == "mount":
        _mount(axes, flat, order)
    elif kind == "plate":
        axes.fill(*flat.T, facecolor=style.BAND, edgecolor=colour, linewidth=2.0, zorder=order, clip_on=False)
    elif kind == "bearing":
        dot: dict[str, Any] = {"markerfacecolor": style.PAGE, "markeredgecolor": style.INK, "markersize": 4.0}
        axes.plot(*flat.T, "o", zorder=order, clip_on=False, **dot)
    elif kind.startswith("sign "):
        look: dict[str, Any] = {"color": _SIGN, **_SIGNS[kind.removeprefix("sign ")][0]}
        axes.plot(*flat.T, linestyle="none", zorder=order, clip_on=False, **look)
    elif kind in ("axis", "spin", "root"):
        colour = {"axis": _ANGLE, "spin": _SPIN, "root": style.INK}[kind]
        _arrow(axes, flat[0], flat[1], colour, order, f"{kind} {shape.body}")
    else:
        colour, thick = {"bar": (colour, 2.8), "pin": (colour, 1.7), "shaft": (_SPIN, 1.6)}.get(kind, (_ANGLE, 1.6))
        # A halo hides lines behind this one on both sides of it, but not at its ends, where it joins others.
        along = flat[-1] - flat[0]
        ends = 0.1 * along / max(float(np.hypot(*along)), 0.3)
        halo = np.array([flat[0] + ends, *flat[1:-1], flat[-1] - ends])
        axes.plot(*halo.T, color=style.PAGE, linewidth=6.0, solid_capstyle="butt", zorder=order, clip_on=False)
        axes.plot(*flat.T, color=colour, linewidth=thick, zorder=order, clip_on=False, gid=kind)
        if kind == "turn-tip":
            _arrow(axes, flat[-2], flat[-1], _ANGLE, order, "")


def _arrow(axes: Axes, tail: FloatArray, tip: FloatArray, colour: str, order: float, name: str) -> None:
    look = {"arrowstyle": "-|>,head_length=0.5,head_width=0.2", "shrinkA": 0.0, "shrinkB": 0.0}
    drawn = axes.annotate(
        "", (tip[0], tip[1]), (tail[0], tail[1]), arrowprops={**look, "color": colour, "linewidth": 1.7}, zorder=order
    )
    drawn.set_gid(name)


def _disc(axes: Axes, shape: Outline, at: FloatArray, rows: FloatArray, platform: Platform, order: float) -> None:
    near = int(disc_axis(shape) @ rows[2] > 0.0)
    front, back = (at + _rim(shape, face) @ rows[:2].T for face in (near, 1 - near))
    [control] = [rotor.control for rotor in platform.rotors if rotor.name == shape.body]
    dashes = _ROTORS[control][0]
    look: dict[str, Any] = {
        "edgecolor": _SPIN,
        "linewidth": 1.4,
        "linestyle": dashes,
        "zorder": order,
        "clip_on": False,
    }
    axes.fill(*back.T, facecolor=style.BAND, **look)
    along = front[0] - back[0]
    side = (front - front.mean(axis=0)) @ np.array([-along[1], along[0]])
    ends = [int(np.argmax(side)), int(np.argmin(side))]
    axes.fill(
        *np.concatenate([back[ends], front[ends[::-1]]]).T,
        facecolor=style.BAND,
        linewidth=0.0,
        zorder=order,
        clip_on=False,
    )
    for k in ends:
        axes.plot(*np.array([back[k], front[k]]).T, color=_SPIN, linewidth=1.4, zorder=order, clip_on=False)
    axes.fill(*front.T, facecolor=style.BAND, **look)


def _mount(axes: Axes, flat: FloatArray, order: float) -> None:
    """Draw a bearing block on either side of the axis, hatched, on the root."""
    along = (flat[1] - flat[0]) / max(float(np.hypot(*(flat[1] - flat[0]))), 1e-9)
    across, gap = np.array([-along[1], along[0]]), np.full(2, np.nan)
    blocks, hatch = [], []
    for side in (1.0, -1.0):
        block = flat[0] + side * np.outer([0.1, 0.3], across)
        blocks += [*block, gap]
        for foot in np.linspace(block[0], block[1], 4)[:-1] + side * 0.03 * across:
            hatch += [foot, foot + 0.09 * (along + 0.5 * side * across), gap]
    for lines, width in ((blocks, 1.7), (hatch, 0.8)):
        axes.plot(*np.array(lines).T, color=style.MUTED, linewidth=width, zorder=order, clip_on=False)


def _label(axes: Axes, platform: Platform, shapes: Sequence[tuple[Outline, FloatArray]], rows: FloatArray) -> None:
    """Write the names beside the tips of the arrows."""
    names = {
        g.name: greek(g.angle) if g.angle.endswith(g.name) else f"{greek(g.angle)}\n{g.name}" for g in platform.gimbals
    }
    places = LabelPlacer(axes, [at + _ink(shape, rows) for shape, at in shapes])
    for shape, at in shapes:
        if shape.kind not in ("axis", "spin", "root"):
            continue
        tail, tip = at + shape.points @ rows[:2].T
        text = names[shape.body] if shape.kind == "axis" else shape.body
        turn = round(math.degrees(math.atan2(*(tip - tail)[::-1])))
        directions = [turn + more for more in (0, 30, -30, 60, -60, 90, -90, 125, -125)]
        colour = {"axis": _ANGLE, "spin": _SPIN, "root": style.INK}[shape.kind]
        places.write(text, *tip, colour=colour, size=9.0, bold=True, required=True, directions=directions)


def _entries(platform: Platform, shapes: Sequence[tuple[Outline, FloatArray]]) -> tuple[list[Any], list[str]]:
    """Return the legend: what occurs in the picture."""
    kinds = {shape.kind for shape, _ in shapes}
    entries: dict[str, Any] = {f"1, 2, 3: axes of {platform.root_name}": Line2D([], [], color=style.INK)}
    if platform.gimbals:
        entries["axis and turn of a positive angle"] = Line2D([], [], color=_ANGLE)
    if platform.rotors:
        entries["spin axis, direction of L"] = Line2D([], [], color=_SPIN)
    for control in dict.fromkeys(rotor.control for rotor in platform.rotors):
        dashes, name = _ROTORS[control]
        entries[name] = Patch(facecolor=style.BAND, edgecolor=_SPIN, linestyle=dashes)
    for kind, (look, name) in _SIGNS.items():
        if f"sign {kind}" in kinds:
            entries[name] = Line2D([], [], color=_SIGN, linestyle="none", **look)
    return list(entries.values()), list(entries)


@value
class SpinMode:
    """One natural frequency of the gimbals over the rotors' speed."""

    label: str  # Its kind at the nominal speed, and the subsystem
    frequency: FloatArray  # (N,), |Im s|, rad/s
    nominal: float  # At the nominal speed


@style.standalone
def campbell(platform: Platform, *, spins: ArrayLike | None = None, orders: ArrayLike = (1.0, 2.0)) -> Figure:
    """Natural frequencies of the uncontrolled gimbals over the speed of the rotors, with multiples of that speed.

    Nutation rises with L, one mode for each gyroscopic pair; precession is slower: it rises if a platform rate
    stiffens the gimbals, and falls if springs do. Grey lines are multiples of the rotors' speed (1×:
    unbalance); where one meets a mode, a diamond says at which speed.

    Parameters
    ----------
    platform
        The plant, linearised about zero angles.
    spins : (k,), optional
        Increasing factors on the speeds of all rotors, >= 0, at least two: the range. Default 0 to 1.5. Rotors of
        different speeds have an axis in shares of the nominal speed.
    orders : (j,)
        Factors on the speed at which rotors excite.

    Returns
    -------
    matplotlib.figure.Figure
        One panel, frequencies in Hz.

    Raises
    ------
    ArgumentError
        No rotor that spins, or numbers that make no sense.

    References
    ----------
    W. Campbell, Trans. ASME 46, 1924.

    See docs/theory/precession.md.
    """
    factors = increasing("spins", spins, np.array([0.0, 1.5]))
    if factors[0] < 0.0:
        raise ArgumentError(f"campbell: spins must be factors >= 0, got {factors[0]:g}")
    multiples = np.atleast_1d(real_numbers("orders", orders))
    if multiples.ndim != 1 or not np.all(np.isfinite(multiples) & (multiples > 0.0)):
        raise ArgumentError(f"campbell: orders must be finite numbers > 0, such as (1, 2), got {multiples}")
    stopped = rotors_at_rest(spinning(platform))
    spin = sorted({round(abs(r.spin), 9) for r in platform.rotors if r.angular_momentum != 0.0})
    unit = RPM * spin[0] if len(spin) == 1 else 1.0
    model, still = linearise(platform), linearise(stopped)
    speed = np.union1d(factors, np.linspace(factors[0], factors[-1], _SPEEDS))
    modes = [m for group in subsystems(model) for m in _modes(model, still, group, speed)]

    labels = [f"{m.label}: {plain(m.nominal * HZ, 3)} Hz at nominal speed" for m in modes]
    figure, [[axes]] = style.panels(1, 1, _HEIGHT, labels, titles=False)
    handles: list[Any] = []
    for k, mode in enumerate(modes):
        handles += axes.plot(unit * speed, mode.frequency * HZ, **style.line_style(k))
        if speed[0] <= 1.0 <= speed[-1]:
            mark = style.MARKERS[k % len(style.MARKERS)]
            axes.plot([unit], [mode.nominal * HZ], mark, color=style.SERIES[k % len(style.SERIES)], markersize=5)
    highest = max((float(m.frequency.max()) for m in modes), default=0.0)
    axes.set_ylim(0.0, 1.18 * HZ * (highest or float(multiples.min()) * spin[0] * float(speed[-1])))
    axes.set_xlim(unit * speed[0], unit * speed[-1])
    style.linear_axis(axes.xaxis, 8)
    style.linear_axis(axes.yaxis, 6)
    axes.set_ylabel("frequency, Hz")
    axes.set_xlabel("rotor speed, rpm" if len(spin) == 1 else "rotor speed / nominal")
    if unit > 50.0:
        axes.xaxis.set_major_formatter(lambda rpm, _: f"{rpm:,.0f}")
    if speed[0] < 1.0 < speed[-1]:
        axes.axvline(unit, color=style.REFERENCE, linewidth=0.8, linestyle=(0, (1.2, 1.4)))
    _spin_lines(axes, modes, speed, unit, spin, multiples)
    if modes:
        style.legend(figure, handles, labels)
    else:
        words = "these gimbals have no oscillating mode"
        axes.annotate(words, (0.5, 0.5), xycoords="axes fraction", color=style.MUTED, ha="center")
    return figure


def _modes(model: LinearModel, still: LinearModel, group: tuple[str, ...], speed: FloatArray) -> list[SpinMode]:
    """Return the swinging modes of one subsystem, fastest first.

    The linear model is affine in the rotors' momenta, so that two linearisations give every speed.
    """
    full, rest = (linear_system(one, group).A for one in (model, still))
    at = np.union1d(speed, 1.0)
    s = pole_branches(np.linalg.eigvals(rest + at[:, None, None] * (full - rest)).astype(np.complex128))
    # A pair counts once. What is this small against the fastest is at rest: poles at zero come out that large.
    s = s[:, s.imag.sum(axis=0) > 0.0]
    lines = np.where(np.abs(s.imag) > _ZERO * float(np.abs(s).max(initial=0.0)), np.abs(s.imag), 0.0)
    poles, kinds = poles_and_kinds(model, group)
    out = []
    for line in lines.T:
        nominal = float(line[at == 1.0][0])
        kind = kinds[int(np.argmin(np.abs(np.abs(poles.imag) - nominal)))] if nominal > 0.0 else "oscillation"
        label = f"{kind} of {'-'.join(group)}"
        out.append(SpinMode(label=label, frequency=line[np.isin(at, speed)], nominal=nominal))
    return sorted(out, key=lambda one: -one.nominal)


def _spin_lines(
    axes: Axes, modes: list[SpinMode], speed: FloatArray, unit: float, reference: list[float], orders: FloatArray
) -> None:
    """Draw multiples of the rotors' speeds, and where they intersect the modes."""
    right, top = axes.get_xlim()[1], axes.get_ylim()[1]
    named = []
    for spin in reference:
        for order in orders:
            slope = order * spin * HZ
            axes.plot(unit * speed, slope * speed, color=style.MUTED, linewidth=0.9, linestyle=(0, (6, 2)), zorder=1.5)
            text = f"{order:g}×" if len(reference) == 1 else f"{order:g}× {plain(spin * RPM, 4)} rpm"
            end = min(0.96 * right / unit, 0.96 * top / slope)
            named.append((text, unit * end, slope * end))
    places = LabelPlacer(axes, [np.column_stack([line.get_xdata(), line.get_ydata()]) for line in axes.lines])
    for text, x, y in named:
        places.write(text, x, y, colour=style.MUTED, size=7.5, directions=(160, 180, -20, 90))
    if axes.get_xlim()[0] < unit < right:
        places.write("nominal", unit, 0.975 * top, colour=style.MUTED, size=7.0, directions=(0, 180))
    marks = []
    for spin in reference:
        for order in orders:
            for mode in modes:
                for at, frequency in _meetings(mode.frequency, speed, order * spin):
                    axes.plot(
                        [unit * at], [frequency * HZ], "D", color=style.LIMIT, markersize=5, zorder=5, linestyle="none"
                    )
                    places.reserve(unit * at, frequency * HZ)
                    where = f"{plain(unit * at, 4)} rpm" if len(reference) == 1 else f"× {plain(at, 3)}"
                    marks.append((where, unit * at, frequency * HZ))
    for text, x, y in marks:
        places.write(text, x, y, colour=style.LIMIT, size=7.5, required=True)


def _meetings(frequency: FloatArray, speed: FloatArray, slope: float) -> list[tuple[float, float]]:
    """Return speeds and frequencies, rad/s, at which a mode swings with `slope` times the speed."""
    apart = frequency - slope * speed
    swings = (frequency[:-1] > 0.0) & (frequency[1:] > 0.0)
    at = np.flatnonzero(swings & (np.sign(apart[:-1]) != np.sign(apart[1:])) & (apart[1:] != 0.0))
    found = speed[at] + (speed[at + 1] - speed[at]) * apart[at] / (apart[at] - apart[at + 1])
    return [(float(x), slope * float(x)) for x in found if x > _CORNER * speed[-1]]
