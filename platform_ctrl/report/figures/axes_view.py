"""The bodies of a platform as SVG, in pixels: projected, set apart, drawn from far to near, and labelled."""

from __future__ import annotations

import itertools
import re
from collections.abc import Iterable, Sequence
from typing import NamedTuple
from xml.sax.saxutils import escape, quoteattr

import numpy as np

from platform_ctrl.common.text import greek, text_width
from platform_ctrl.common.values import FloatArray
from platform_ctrl.job.quantities import axis_text
from platform_ctrl.plant.drawing import Outline, bodies, disc_axis, levels
from platform_ctrl.plant.gimbals import Gimbal
from platform_ctrl.plant.platform import Platform

# What XML 1.0 cannot hold, escaped or not.
_FORBIDDEN = re.compile("[\x00-\x08\x0b\x0c\x0e-\x1f\ud800-\udfff\ufffe\uffff]")


def plain_text(text: str) -> str:
    """Return `text` escaped for the inside of an element."""
    return escape(_FORBIDDEN.sub("\ufffd", text))


def attribute(text: str) -> str:
    """Return `text` as an attribute's value, quotes included."""
    return quoteattr(_FORBIDDEN.sub("\ufffd", text))


def number(x: float) -> str:
    """Return a coordinate to a tenth of a pixel, without a trailing zero."""
    text = f"{x:.1f}".removesuffix(".0")
    return "0" if text == "-0" else text


def path(points: FloatArray, *, closed: bool = False) -> str:
    """Return the path data of a polyline through `points`, (k, 2)."""
    return "M" + "L".join(f"{number(x)} {number(y)}" for x, y in points) + ("Z" if closed else "")


def line(points: FloatArray, kind: str, *, closed: bool = False) -> str:
    """Return a polyline of the CSS class `kind`."""
    return f'<path class="{kind}" d="{path(points, closed=closed)}"/>'


def arrow_head(tail: FloatArray, tip: FloatArray, kind: str, size: float = 10.0) -> str:
    """Return a filled arrow head at `tip`, seen from `tail`."""
    along = direction(tail, tip)
    across = 0.36 * size * np.array([-along[1], along[0]])
    back = tip - size * along
    return line(np.array([tip, back + across, back - across]), kind, closed=True)


def direction(tail: FloatArray, tip: FloatArray) -> FloatArray:
    """Return the unit vector from `tail` to `tip`; to the right where they coincide."""
    along = np.asarray(tip - tail, dtype=np.float64)
    length = float(np.hypot(*along))
    return along / length if length > 1e-9 else np.array([1.0, 0.0])


def words(text: str, at: Sequence[float], kind: str, anchor: str = "start") -> str:
    """Return `text` with its baseline starting (or ``middle``, ``end``) at a point."""
    place = "" if anchor == "start" else f' text-anchor="{anchor}"'
    return f'<text class="{kind}" x="{number(at[0])}" y="{number(at[1])}"{place}>{plain_text(text)}</text>'


def level_class(level: int) -> str:
    """Return the CSS class of a body that many joints away from the root."""
    return f"level-{1 + (level - 1) % 5}"


def circle(at: Sequence[float], radius: float, kind: str) -> str:
    """Return a circle."""
    return f'<circle class="{kind}" cx="{number(at[0])}" cy="{number(at[1])}" r="{number(radius)}"/>'


# What acts or measures at a joint, drawn about the origin, with what it is called.
SIGNS = {
    "torquer": ("M-4.5-4.5H4.5V4.5H-4.5Z", "torquer"),
    "pickoff": ("M-4.5 0A4.5 4.5 0 1 1 4.5 0A4.5 4.5 0 1 1-4.5 0Z", "pick-off"),
    "spring": ("M-6 0L-4-4.5L-1.5 4.5L1.5-4.5L4 4.5L6 0", "spring"),
    "cage": ("M-2-5.5H-5V5.5H-2M2-5.5H5V5.5H2", "cage"),
    "erection": ("M-5-4.5H5L0 5Z", "erection"),
}


def sign(kind: str, at: Sequence[float], size: float = 1.0) -> str:
    """Return one of `SIGNS` at a point."""
    scale = "" if size == 1.0 else f" scale({size:.2f})"
    place = f"translate({number(at[0])} {number(at[1])}){scale}"
    return f'<path class="{kind}" transform="{place}" d="{SIGNS[kind][0]}"/>'


def direction_text(axis: FloatArray) -> str:
    """Return +1, −3 or the components of an axis, without the last digits of a rounded zero."""
    return axis_text(np.round(axis, 9) + 0.0)


_LARGEST, _SMALLEST = 68.0, 24.0  # radius of a disc, pixels
_SIDE, _SIDE_OF_MANY = 84.0, 64.0  # room beside each body for labels
FONT = 15.0
_LINE = 17.0


class Label(NamedTuple):
    """Lines of text, each with its CSS class, that belong beside the tip of an arrow."""

    lines: list[tuple[str, str]]
    tip: FloatArray
    along: FloatArray

    @property
    def size(self) -> FloatArray:
        """Width and height, pixels."""
        return np.array([max(text_width(text, FONT) for text, _ in self.lines), _LINE * len(self.lines)])


class _Looks(NamedTuple):
    """CSS classes of rotors by their control and of gimbals by how deep they are nested."""

    control: dict[str, str]
    level: dict[str, str]


class Sketch(NamedTuple):
    """A part of the picture and its size, pixels."""

    svg: str
    width: float
    height: float


def axes_view(platform: Platform, rows: FloatArray, width: float, height: float) -> Sketch:
    """Return the bodies of `platform` within `width` and about `height` pixels: lower, or higher for many bodies.

    What the root carries is a group each; arrows are groups with the body's name in ``data-body``.
    """
    groups = bodies(platform, rows[2])
    if not groups:
        text = words("nothing turns: the root alone", (0.5 * width, 60.0), "muted", "middle")
        return Sketch(text, width, 120.0)
    boxes = [_box(group, rows) for group in groups]
    sizes = np.array([high - low for low, high in boxes])
    # Room for labels of one or two lines above and below.
    plain = all(_alone(g) for g in platform.gimbals)
    pad = np.array([_SIDE if len(groups) < 7 else _SIDE_OF_MANY, (2.0 if plain else 4.0) * _LINE + 20.0])
    scale, counts, height = _packing(sizes, pad, width, height)
    origins = _origins(boxes, counts, scale, width, height)
    looks = _Looks(
        {rotor.name: rotor.control for rotor in platform.rotors},
        {name: level_class(level) for name, level in levels(platform).items()},
    )
    drawn = [_Body(group, rows, scale, origin, looks) for group, origin in zip(groups, origins, strict=True)]
    pieces = [piece for body in drawn for piece in ('<g class="body">', *body.pieces, "</g>")]
    labels = [label for body in drawn for label in body.labels(platform)]
    obstacles = np.concatenate([body.ink for body in drawn])
    pieces += _placed(labels, obstacles, np.array([width, height]))
    return Sketch("\n".join(pieces), width, height)


def triad(platform: Platform, rows: FloatArray, middle: FloatArray, length: float) -> str:
    """Return the root's axes 1, 2, 3 as arrows about a point, with the torquers on the root."""
    ends = length * _flat(rows, np.vstack([np.zeros(3), np.eye(3)]))
    at = middle - 0.5 * (ends.min(axis=0) + ends.max(axis=0))
    torqued = {t.root_axis for t in platform.torquers}
    order = sorted(range(3), key=lambda k: (round(rows[2, k], 6), k))
    pieces = []
    for k in order:
        tip = at + length * _flat(rows, np.eye(3)[k])
        along = direction(at, tip)
        pieces.append(f'<g class="root-axis" data-body="{k + 1}">')
        pieces += [line(np.array([at, tip - 6.0 * along]), "triad"), arrow_head(at, tip, "triad-head", 10.0)]
        if k + 1 in torqued:
            pieces.append(sign("torquer", at + 0.5 * (tip - at), 0.9))
        place = tip + 11.0 * along + np.array([0.0, 5.0])
        pieces += [words(str(k + 1), place, "name strong", "middle"), "</g>"]
    return "\n".join(pieces)


def _flat(rows: FloatArray, points: FloatArray) -> FloatArray:
    """Return points in root axes as seen: right and down, in units of a disc's radius."""
    return np.asarray(points @ rows[:2].T * np.array([1.0, -1.0]))


def _box(shapes: list[Outline], rows: FloatArray) -> tuple[FloatArray, FloatArray]:
    points = []
    for shape in shapes:
        flat = _flat(rows, shape.points)
        points.append(flat)
        if shape.kind == "disc":
            s = disc_axis(shape)
            # Half the width and the height of the disc as it is seen.
            rim = np.sqrt(np.maximum(0.0, 1.0 - (rows[:2] @ s) ** 2))
            points += [flat - rim, flat + rim]
    flat = np.concatenate(points)
    return flat.min(axis=0), flat.max(axis=0)


def _packing(sizes: FloatArray, pad: FloatArray, width: float, height: float) -> tuple[float, list[int], float]:
    """Return the scale, how many bodies are in each row, and the height: as large as fits, in equal rows."""
    while True:
        best: tuple[float, list[int], float] = (0.0, [], 0.0)
        for k in range(1, len(sizes) + 1):
            counts = [len(part) for part in np.array_split(np.arange(len(sizes)), k)]
            parts = np.split(sizes, np.cumsum(counts)[:-1])
            across = min((width - pad[0] * len(part)) / part[:, 0].sum() for part in parts)
            upward = sum(part[:, 1].max() for part in parts)
            scale = round(float(min(across, (height - pad[1] * k) / upward, _LARGEST)), 1)
            if scale > best[0]:
                best = scale, counts, float(scale * upward + pad[1] * k)
        if best[0] >= _SMALLEST or (best[0] > 0.0 and height > 1400.0):
            return best
        height += 40.0


def _origins(
    boxes: list[tuple[FloatArray, FloatArray]], counts: list[int], scale: float, width: float, height: float
) -> list[FloatArray]:
    """Return where each body's own origin comes to lie, rows and columns evenly spread."""
    bounds = np.cumsum([0, *counts])
    row_heights = [
        max(float((high - low)[1]) for low, high in boxes[start:end]) * scale
        for start, end in itertools.pairwise(bounds)
    ]
    gap_y = (height - sum(row_heights)) / len(counts)
    y, out = 0.5 * gap_y, []
    for row, row_height in enumerate(row_heights):
        part = boxes[bounds[row] : bounds[row + 1]]
        gap_x = (width - scale * sum(float((high - low)[0]) for low, high in part)) / len(part)
        x = 0.5 * gap_x
        for low, high in part:
            middle = y + 0.5 * row_height - 0.5 * scale * (low[1] + high[1])
            out.append(np.array([x - scale * low[0], middle]))
            x += scale * float((high - low)[0]) + gap_x
        y += row_height + gap_y
    return out


class _Body:
    """One body of the root with all that it carries, in pixels."""

    def __init__(
        self, shapes: list[Outline], rows: FloatArray, scale: float, origin: FloatArray, looks: _Looks
    ) -> None:
        self.shapes, self.rows, self.scale, self.origin, self.looks = shapes, rows, scale, origin, looks
        self.small = min(1.0, scale / 40.0)
        order = sorted(range(len(shapes)), key=lambda k: (round(self._depth(shapes[k]), 6), k))
        self.pieces = [piece for k in order for piece in self._drawn(shapes[k])]
        self.ink = np.concatenate([self._ink(shape) for shape in shapes])

    def _depth(self, shape: Outline) -> float:
        points = shape.points
        # Signs on a pin are seen whichever end of it is nearer.
        ahead = 0.45 if shape.kind.startswith("sign ") else 1e-3 if shape.kind == "bearing" else 0.0
        return float(points.mean(axis=0) @ self.rows[2]) + ahead

    def _flat(self, points: FloatArray) -> FloatArray:
        return self.origin + self.scale * _flat(self.rows, points)

    def _drawn(self, shape: Outline) -> Iterable[str]:
        flat, kind = self._flat(shape.points), shape.kind
        if kind == "disc":
            return self._disc(shape, flat)
        if kind == "mount":
            return self._mount(flat)
        if kind == "plate":
            return [line(flat, f"plate {self.looks.level[shape.body]}", closed=True)]
        if kind == "bearing":
            return [circle(flat[0], 3.2 * self.small, "bearing")]
        if kind.startswith("sign "):
            return [sign(kind.removeprefix("sign "), flat[0], self.small)]
        if kind in ("axis", "spin"):
            return self._arrow(shape, flat)
        if kind == "turn-tip":
            head = arrow_head(flat[-3], flat[-1], "turn-head", 10.0 * max(self.small, 0.7))
            return [line(flat, "halo"), line(flat[:-1], "turn"), head]
        if kind in ("bar", "pin"):
            kind = f"{kind} {self.looks.level[shape.body]}"
        return [line(_shorter(flat), "halo"), line(flat, kind)]

    def _arrow(self, shape: Outline, flat: FloatArray) -> list[str]:
        size = (11.0 if shape.kind == "axis" else 13.0) * max(self.small, 0.7)
        end = flat[1] - 0.6 * size * direction(flat[0], flat[1])
        return [
            f'<g class="{shape.kind}-arrow" data-body={attribute(shape.body)}>',
            line(np.array([flat[0], end]), shape.kind),
            arrow_head(flat[0], flat[1], f"{shape.kind}-head", size),
            "</g>",
        ]

    def _disc(self, shape: Outline, flat: FloatArray) -> list[str]:
        s = disc_axis(shape)
        seen = _flat(self.rows, s)
        across = direction(np.zeros(2), np.array([-seen[1], seen[0]]))
        rim = self.scale * across
        radii = self.scale, self.scale * abs(float(s @ self.rows[2]))
        angle = float(np.degrees(np.arctan2(across[1], across[0])))
        near = 1 if s @ self.rows[2] > 0.0 else 0
        kind = f"disc {self.looks.control[shape.body]}"
        body = np.array([flat[0] + rim, flat[1] + rim, flat[1] - rim, flat[0] - rim])
        return [
            _ellipse(flat[1 - near], radii, angle, kind),
            line(body, "disc-side", closed=True),
            line(body[:2], kind),
            line(body[2:], kind),
            _ellipse(flat[near], radii, angle, kind),
        ]

    def _mount(self, flat: FloatArray) -> list[str]:
        """Return a bearing block on either side of the axis, hatched, on the root."""
        along = direction(flat[0], flat[1])
        across = np.array([-along[1], along[0]])
        unit = 9.0 * self.small + 1.0
        out = []
        for side in (1.0, -1.0):
            low, high = flat[0] + side * 0.6 * unit * across, flat[0] + side * 1.9 * unit * across
            out.append(line(np.array([low, high]), "mount"))
            for k in range(3):
                foot = low + (high - low) * (k + 0.5) / 3.0
                out.append(line(np.array([foot, foot + 0.6 * unit * (along + 0.5 * side * across)]), "hatch"))
        return out

    def _ink(self, shape: Outline) -> FloatArray:
        """Return points on everything drawn, close enough for labels to keep clear of it."""
        flat = self._flat(shape.points)
        if shape.kind == "disc":
            s = disc_axis(shape)
            e = np.linalg.svd(s[None, :])[2][1:]
            angles = np.linspace(0.0, 2.0 * np.pi, 40, endpoint=False)
            ring = np.cos(angles)[:, None] * e[0] + np.sin(angles)[:, None] * e[1]
            centre = shape.points.mean(axis=0)
            return np.concatenate([self._flat(centre + r * ring) for r in (0.3, 0.6, 0.8, 1.0)])
        if len(flat) == 1:
            return np.array([flat[0] + d for d in ((-4, -4), (4, -4), (4, 4), (-4, 4))])
        t = np.linspace(0.0, 1.0, 9)[:, None]
        return np.concatenate([(1.0 - t) * p + t * q for p, q in itertools.pairwise(flat)])

    def labels(self, platform: Platform) -> list[Label]:
        """Return the texts at the tips of this body's arrows."""
        gimbals = {g.name: g for g in platform.gimbals}
        out = []
        for shape in self.shapes:
            flat = self._flat(shape.points)
            if shape.kind == "axis":
                gimbal = gimbals[shape.body]
                lines = [(greek(gimbal.angle), "angle"), (gimbal.name, "name")][: 1 if _alone(gimbal) else 2]
            elif shape.kind == "spin":
                lines = [(shape.body, "rotor-name")]
            else:
                continue
            out.append(Label(lines, flat[1], direction(flat[0], flat[1])))
        return out


def _alone(gimbal: Gimbal) -> bool:
    """Return whether the angle's name contains the gimbal's."""
    return gimbal.angle.endswith(gimbal.name)


def _shorter(flat: FloatArray) -> FloatArray:
    """Return a line without its ends, so that its halo does not cut into the lines that it joins."""
    along = direction(flat[0], flat[-1])
    out = flat.copy()
    if np.hypot(*(flat[-1] - flat[0])) > 14.0:
        out[0] += 5.0 * along
        out[-1] -= 5.0 * along
    return out


def _placed(labels: list[Label], ink: FloatArray, bounds: FloatArray) -> list[str]:
    """Return the labels as text, each where it hides least: near its arrow's tip, clear of lines and other labels."""
    tips = np.array([label.tip for label in labels]).reshape(-1, 2)
    taken: list[tuple[FloatArray, FloatArray]] = []
    out = []
    for k, label in enumerate(labels):
        half = 0.5 * label.size
        best: tuple[float, FloatArray, float] | None = None
        for distance in (5.0, 12.0, 22.0, 36.0, 54.0):
            for turn in np.radians((0, 30, -30, 60, -60, 90, -90, 125, -125, 160, -160)):
                c, s = np.cos(turn), np.sin(turn)
                way = np.array([c * label.along[0] - s * label.along[1], s * label.along[0] + c * label.along[1]])
                # From the tip to the middle of the text, which is a box.
                out_of_box = min(half[0] / max(abs(way[0]), 1e-9), half[1] / max(abs(way[1]), 1e-9))
                centre = label.tip + (distance + out_of_box) * way
                low, high = centre - half, centre + half
                cost = 0.5 * distance + 4.0 * abs(float(turn))
                cost += 3.0 * _inside(ink, low - 2.0, high + 2.0)
                cost += 60.0 * _inside(np.delete(tips, k, axis=0), low - 6.0, high + 6.0)
                cost += sum(400.0 for a, b in taken if np.all(low - 3.0 < b) and np.all(a < high + 3.0))
                cost += 50.0 * float(np.maximum(0.0, np.maximum(2.0 - low, high + 2.0 - bounds)).sum())
                if best is None or round(cost, 3) < best[0]:
                    best = round(cost, 3), centre, distance
        assert best is not None
        centre, distance = best[1:]
        taken.append((centre - half, centre + half))
        if distance > 15.0:
            toward = np.clip(label.tip, centre - half, centre + half)
            out.append(line(np.array([label.tip, toward]), "leader"))
        for row, (text, kind) in enumerate(label.lines):
            baseline = centre[1] - half[1] + _LINE * (row + 0.78)
            out.append(words(text, (centre[0], baseline), f"{kind} haloed", "middle"))
    return out


def _inside(points: FloatArray, low: FloatArray, high: FloatArray) -> int:
    return int(np.count_nonzero(np.all((points > low) & (points < high), axis=1)))


def _ellipse(at: FloatArray, radii: tuple[float, float], angle: float, kind: str) -> str:
    x, y = number(at[0]), number(at[1])
    place = f'cx="{x}" cy="{y}" rx="{number(radii[0])}" ry="{number(radii[1])}"'
    return f'<ellipse class="{kind}" {place} transform="rotate({number(angle)} {x} {y})"/>'
