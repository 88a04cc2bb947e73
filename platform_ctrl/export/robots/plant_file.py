"""A robot description as the text of a plant file: rigid groups of links as root and gimbals, the rest as comments."""

from __future__ import annotations

import functools
import math
import operator
import os
import textwrap
import tomllib
from typing import Any
from xml.etree.ElementTree import ParseError, fromstring

import numpy as np

from platform_ctrl.common.files import toml
from platform_ctrl.common.values import FloatArray, value
from platform_ctrl.errors import InputError
from platform_ctrl.export.robots.robot import NO_BODY, ROTOR, WORLD, Link, Pose, Reader, RobotPart, plain
from platform_ctrl.plant.gimbals import Body
from platform_ctrl.plant.mistakes import given, one_line, suggestion
from platform_ctrl.plant.platform import Platform
from platform_ctrl.plant.reading import read_platform
from platform_ctrl.plant.source import path_of, read_text

# Armature over C from which on a rotor's speed counts as regulated.
_REGULATED = 1e3
# Digits of numbers that were turned and moved.
_DIGITS = 14
# Joints on which a root may hang, and its mode.
_MODES = {"fixed": "held", "ball": "pivot", "free": "floating"}


@value
class ImportedPlant:
    """A plant made of a robot description.

    Attributes
    ----------
    platform
        The plant.
    text
        Its plant file, TOML, with the notes at its head.
    notes
        What of the description has no counterpart in a plant file, or had to be assumed, a line each.
    """

    platform: Platform
    text: str
    notes: tuple[str, ...]


def import_robot(path: str | os.PathLike[str], root: str | None = None, tip: str | None = None) -> ImportedPlant:
    """Make a plant of a robot description in URDF, MJCF or SDF.

    Parameters
    ----------
    path
        Of the file. URDF and MJCF are read by the package mujoco, the extra ``import``.
    root
        Name of the link that is the root; what carries it is cut off. Default: the base, which carries joints and
        hangs on none.
    tip
        Name of the last link: joints that are not on the way to it are held at zero. Default: all joints turn.

    Returns
    -------
    ImportedPlant
        The plant, its file and the notes.

    Raises
    ------
    InputError
        The file cannot be read, or it is no tree of bodies on hinges.
    """
    with np.errstate(all="ignore"):  # numbers that nothing has are refused by their link
        robot = _read(path)
        tables = _Tree(robot, root, tip).tables()
    notes = tuple(one_line(note) for note in dict.fromkeys(robot.notes))
    text = _text(f"From {robot.label} ({robot.format}), by platform-ctrl import. SI units.", tables, notes)
    try:
        return ImportedPlant(platform=read_platform(tomllib.loads(text)), text=text, notes=notes)
    except InputError as error:
        raise robot.error(str(error).removeprefix("plant given as a dict: ")) from None


def _read(path: str | os.PathLike[str]) -> Reader:
    file, what = path_of(path, "the path of a URDF, MJCF or SDF file"), "a robot description in URDF, MJCF or SDF"
    label, text = one_line(str(file)), read_text(file, what)
    try:
        top = fromstring(text)
    except (ParseError, ValueError, LookupError) as error:
        raise InputError(f"{label}: is not XML: {one_line(str(error))}; give {what}") from None
    if "${" in text or "<xacro:" in text:
        raise InputError(f"{label}: has macros of xacro; expand them: xacro {label} > robot.urdf")
    if top.tag == "sdf":
        from platform_ctrl.export.robots.sdf import Sdf

        return Sdf(label, top)
    if top.tag in ("robot", "mujoco"):
        from platform_ctrl.export.robots.mujoco_spec import read_spec

        return read_spec(file, label, top)
    raise InputError(f"{label}: has the element <{one_line(top.tag)}> on top; give {what}")


class _Tree:
    """Which body of the plant each link belongs to: the root, or the first link of a rigid group on a hinge."""

    def __init__(self, robot: Reader, root: str | None, tip: str | None) -> None:
        self.robot, self.links = robot, {one.name: one for one in robot.links}
        self.group: dict[str, str] = {}  # The first link of the rigid group of each
        for one in robot.links:
            rigid = one.kind == "fixed" and one.carrier not in ("", WORLD)
            self.group[one.name] = self.group[one.carrier] if rigid else one.name
        self.root = self._base() if root is None else self._known(root, "--root")
        self.base = self.links[self.group[self.root]]
        self.owner = self._owners(None if tip is None else self._chain(self._known(tip, "--tip")))
        self._check_loops()
        own = self.links[self.root].pose
        self.pose = Pose(own.turn, self.base.pivot) if self.base.kind == "ball" else own
        self.size = float(max(np.linalg.norm((one.pivot, one.pose.at)) for one in robot.links)) or 1.0
        self.bodies = {name: self._body(name) for name in dict.fromkeys(self.owner.values())}

    def _known(self, name: str, option: str) -> str:
        if name not in self.links:
            raise self.robot.error(f"{option}: there is no link {given(name)}; {suggestion(name, self.links)}")
        return name

    def _base(self) -> str:
        free = [one.name for one in self.links.values() if one.carrier in ("", WORLD) and one.kind in _MODES]
        carrying = {self.group.get(self.links[one].carrier) for one in self.group.values() if one not in free}
        bases = [one for one in free if one in carrying]
        if not bases:
            raise self.robot.error("has no joint that turns; a plant needs at least one gimbal")
        if len(bases) > 1:
            raise self.robot.error(f"has several bases, {', '.join(map(given, bases))}; choose one by --root")
        return bases[0]

    def _chain(self, tip: str) -> list[str]:
        chain = [self.group[tip]]
        while chain[-1] != self.base.name:
            if (above := self.links[chain[-1]].carrier) not in self.group:
                words = f"{given(self.root)} does not carry {given(tip)}; name a link that it carries"
                raise self.robot.error(f"--tip: {words}")
            chain.append(self.group[above])
        return chain

    def _owners(self, chain: list[str] | None) -> dict[str, str]:
        owner: dict[str, str] = {}
        for one in self.links.values():
            above = owner.get(one.carrier)
            if self.group[one.name] == self.base.name:
                owner[one.name] = self.root
            elif above is not None and self.group[one.name] != one.name:
                owner[one.name] = above
            elif above is not None and chain is not None and one.name not in chain:
                owner[one.name] = above
                words = f"not on the way to --tip: held at zero, {given(one.name)} is part of {given(above)}"
                self.robot.notes.append(f"joint {given(one.joint)}: {words}")
            elif above is not None:
                if one.kind != "hinge":
                    words = f"is {one.kind}, but a plant has hinges alone; remove it, or hold it at zero by --tip"
                    raise self.robot.error(f"joint {given(one.joint)} of {given(one.name)} {words}")
                owner[one.name] = one.name
        if cut := [one for one in self.links if one not in owner and one != WORLD]:
            words = "not carried by the root: cut off; choose another --root to have them"
            self.robot.notes.append(f"links {', '.join(map(given, cut))}: {words}")
        return owner

    def _check_loops(self) -> None:
        turning = {self.links[one].joint for one in self.owner.values() if one != self.root}
        if not turning:
            raise self.robot.error("has no joint that turns between root and tip; a plant needs at least one gimbal")
        for names, words in self.robot.loops:
            if any(name in turning or self.owner.get(name, self.root) != self.root for name in names):
                words = f"{words}: a plant is a tree; remove it, or hold these bodies at zero by --tip"
                raise self.robot.error(words)
            self.robot.notes.append(f"{words}: left out, it couples nothing that turns here")

    def _body(self, name: str) -> Body:
        """Return a body of the plant, in root axes from the root's origin."""
        parts = [one.body for one in self.links.values() if self.owner.get(one.name) == name]
        mass, centre, inertia = functools.reduce(operator.or_, parts, NO_BODY)
        turn = self.pose.turn
        return Body(mass, turn.T @ (centre - self.pose.at), turn.T @ inertia @ turn)

    def _origin(self, name: str) -> FloatArray:
        """Return the joint of a body, or the root's origin, in root axes from that origin."""
        return self.pose.turn.T @ ((self.pose.at if name == self.root else self.links[name].pivot) - self.pose.at)

    def tables(self) -> dict[str, Any]:
        """Return the plant, and note what is assumed."""
        out: dict[str, Any] = {"schema": 1, "name": one_line(self.robot.name) or "robot"}
        out["source"] = f"read by platform-ctrl import from {self.robot.label} ({self.robot.format})"
        out |= {"root": self._root_table(), "gimbal": [], "rotor": [], "motor": [], "pickoff": []}
        gimbals: dict[str, str] = {}
        for link in [self.links[name] for name in self.bodies if name != self.root]:
            above = self.owner[link.carrier]
            if link.spins and (rotor := self._rotor(link, above)):
                out["rotor"].append(rotor)
                continue
            if link.spins:
                words = "turns, but is not round about its hinge, or carries others: it is a gimbal, without its speed"
                self.robot.notes.append(f"body {given(link.name)}: {words}")
            gimbals[link.joint] = link.name
            out["gimbal"].append(self._gimbal(link, above))
            if link.armature:
                out["motor"].append(self._motor(link))
        for part in self.robot.parts:
            self._add(part, gimbals, out)
        assumed = [one for one in gimbals.values() if one not in [had["gimbal"] for had in out["pickoff"]]]
        out["pickoff"] += [{"gimbal": one} for one in assumed]
        if assumed:
            words = "the file has no angle sensor: ideal pick-offs are assumed; give them noise and quantisation"
            self.robot.notes.append(f"{', '.join(map(given, assumed))}: {words}")
        return out

    def _root_table(self) -> dict[str, Any]:
        where, out = f"root {given(self.root)}", {"name": self.root, **self._masses(self.root)}
        mode = _MODES.get(self.base.kind) if WORLD in (self.base.carrier, self.base.name) else None
        mode = "held" if self.base.kind == "ball" and self.base.armature else mode
        if not out["inertia"]:
            if mode in ("pivot", "floating"):
                raise self.robot.error(f"link {given(self.root)} has no mass, but moves as root; give it an inertial")
            out["inertia"] = [1.0, 1.0, 1.0]
            words = "no mass in the file: its inertia is assumed, without effect while the root is held"
            self.robot.notes.append(f"{where}: {words}")
        if mode is None:
            words = 'the file does not say how it moves: add mode = "held", "pivot" or "floating"'
            self.robot.notes.append(f"{where}: {words}")
        gravity = {"gravity": _rounded(self.pose.turn.T @ self.robot.gravity)} if self.robot.gravity.any() else {}
        return out | ({"mode": mode} if mode else {}) | gravity

    def _masses(self, name: str) -> dict[str, Any]:
        """Return inertia, mass and centre of a body; no inertia for none."""
        mass, centre, inertia = self.bodies[name]
        if not inertia.any():
            return {"inertia": []}
        rows = [_rounded(row, float(np.abs(inertia).max())) for row in 0.5 * (inertia + inertia.T)]
        diagonal = np.count_nonzero(rows) == np.count_nonzero(np.diag(rows))
        out = {"inertia": np.diag(rows).tolist() if diagonal else rows}
        place = {"mass": float(f"{mass:.15g}"), "centre": _rounded(centre - self._origin(name), self.size)}
        return out | (place if mass else {})

    def _gimbal(self, link: Link, above: str) -> dict[str, Any]:
        masses = self._masses(link.name)
        if not masses["inertia"]:
            words = "moves, but has no inertia; give it an inertial (shapes in URDF and SDF have no mass)"
            raise self.robot.error(f"link {given(link.name)} {words}")
        out = {"name": link.name, "parent": above, "axis": _rounded(self.pose.turn.T @ link.axis)}
        origin = _rounded(self._origin(link.name) - self._origin(above), self.size)
        out |= ({"origin": origin} if any(origin) else {}) | masses
        return out | ({"angle": plain(link.joint)} if link.joint else {}) | (dict(link.keys) if not link.spins else {})

    def _motor(self, link: Link) -> dict[str, Any]:
        gear = self.robot.gears.get(link.joint, 1.0)
        words = f"is rotor_inertia times gear squared, with a gear of {gear:g}: correct both in [[motor]]"
        self.robot.notes.append(f"joint {given(link.joint)}: armature {link.armature:g} kg m2 {words}")
        return {"gimbal": link.name, "rotor_inertia": link.armature / gear**2, "gear": gear}

    def _rotor(self, link: Link, above: str) -> dict[str, Any] | None:
        """Return the table of a body that is round about its axis and carries nothing."""
        body, axis = self.bodies[link.name], self.pose.turn.T @ link.axis
        C = float(axis @ body.inertia @ axis)
        A = 0.5 * (float(np.trace(body.inertia)) - C)
        off = np.linalg.norm(np.cross(axis, body.centre - self._origin(link.name)))
        rest = np.abs(body.inertia - A * np.eye(3) - (C - A) * np.outer(axis, axis)).max()
        carries = any(one.carrier == link.name for one in self.links.values())
        if carries or rest > 1e-6 * A or off**2 * body.mass > 1e-12 * A:
            return None
        out = {"name": link.name.removeprefix(ROTOR), "carrier": above, "axis": _rounded(axis), **link.keys}
        out |= {"axial_inertia": C, "transverse_inertia": A, "mass": body.mass}
        out.setdefault("control", "regulated" if link.armature > _REGULATED * C else "free")
        if link.armature and out["control"] != "regulated":
            words = f"armature {link.armature:g} kg m2 is left out; add it to axial_inertia if it turns with the rotor"
            self.robot.notes.append(f"rotor {given(out['name'])}: {words}")
        return out | {"origin": _rounded(body.centre - self._origin(above), self.size)}

    def _add(self, part: RobotPart, gimbals: dict[str, str], out: dict[str, Any]) -> None:
        """Add a table on a joint or a link, or a note where that is no body of the plant."""
        kind, owner = part.kind, self.owner.get(part.on)
        if part.axis is not None and owner is not None:
            table = {"body": owner, "axis": _rounded(self.pose.turn.T @ part.axis), **part.keys}
        elif part.axis is None and part.on in gimbals:
            table = {"gimbal": gimbals[part.on], **part.keys}
        else:
            self.robot.notes.append(f"{kind} on {given(part.on)}: left out, that is no gimbal of the plant")
            return
        if kind == "camera":
            words = f"[line_of_sight] with body = {given(owner)} and direction = {table['axis']}"
            self.robot.notes.append(f"camera {given(part.keys['name'])}: for a line of sight add {words}")
            return
        if kind == "pickoff" and any(one["gimbal"] == table["gimbal"] for one in out["pickoff"]):
            kind = "angle_sensor"
        elif kind == "pickoff":
            table.pop("name", None)  # that of the angle
        out.setdefault(kind, []).append(table)


def _rounded(vector: FloatArray, size: float = 1.0) -> list[float]:
    """Return numbers without the errors of turning and moving, which are relative to `size`."""
    digits = _DIGITS - math.floor(math.log10(size))
    return [round(float(x), digits) + 0.0 for x in vector]


def _text(head: str, tables: dict[str, Any], notes: tuple[str, ...]) -> str:
    """Return the plant file: notes, root, each gimbal with all that acts on it, and the rest."""
    lines = ["What has no counterpart in a plant file, or is assumed, and what to do:"] if notes else []
    style: dict[str, Any] = {"initial_indent": "# ", "subsequent_indent": "#   ", "break_on_hyphens": False}
    lines = [head, *lines, *(f"- {note}" for note in notes)]
    out = ["\n".join(textwrap.fill(one, 118, break_long_words=False, **style) for one in lines)]
    out.append(toml({key: item for key, item in tables.items() if not isinstance(item, list)}))
    parts = {key: item for key, item in tables.items() if isinstance(item, list)}
    for gimbal in parts.pop("gimbal"):
        own = {key: [one for one in item if one.get("gimbal") == gimbal["name"]] for key, item in parts.items()}
        out.append(toml({"gimbal": [gimbal], **own}).lstrip("\n"))
    others = {key: [one for one in item if "gimbal" not in one] for key, item in parts.items()}
    return "\n".join(one for one in [*out, toml(others).lstrip("\n")] if one)
