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
from platform_ctrl.common.values import FloatArray
from platform_ctrl.errors import InputError
from platform_ctrl.export.robots.robot import NO_BODY, ROTOR, WORLD, Joint, Link, Part, Pose, Robot, plain
from platform_ctrl.plant.gimbals import Body
from platform_ctrl.plant.mistakes import given, one_line, suggestion
from platform_ctrl.plant.reading import read_platform
from platform_ctrl.plant.source import path_of, read_text

Tables = dict[str, Any]

# Armature over C from which on a rotor's speed counts as regulated.
_REGULATED = 1e3
# Digits of numbers that were turned and moved.
_DIGITS = 14
# Joints below which a root begins, and what they say of it.
_MODES = {"fixed": "held", "ball": "pivot", "free": "floating"}


def import_robot(path: str | os.PathLike[str], root: str | None = None, tip: str | None = None) -> str:
    """Return a robot description in URDF, MJCF or SDF as the text of a plant file.

    Parameters
    ----------
    path
        Of the file. URDF and MJCF are read by the package mujoco, the extra ``import``.
    root
        Name of the link that is taken as root; what carries it is cut off. Default: the base, the link that carries
        joints and hangs on none.
    tip
        Name of the last link: joints that are not on the way to it are held at zero. Default: all joints turn.

    Returns
    -------
    str
        TOML. Comments at its head list, a line each, what of the file has no counterpart or was assumed.

    Raises
    ------
    InputError
        It cannot be read, or it is no tree of bodies on hinges.
    """
    robot = _read(path)
    tables, notes = _Tree(robot, root, tip).tables()
    text = _text(robot, tables, [*robot.notes, *notes])
    try:
        read_platform(tomllib.loads(text))
    except InputError as error:
        raise InputError(f"{robot.label}: {str(error).removeprefix('plant given as a dict: ')}") from None
    return text


def _read(path: str | os.PathLike[str]) -> Robot:
    file = path_of(path, "the path of a URDF, MJCF or SDF file")
    label = one_line(str(file))
    what = "a robot description in URDF, MJCF or SDF"
    text = read_text(file, what)
    try:
        top = fromstring(text.encode())
    except (ParseError, ValueError, LookupError) as error:
        raise InputError(f"{label}: is not XML: {one_line(str(error))}; give {what}") from None
    if "${" in text or "xacro:" in text.replace("xmlns:xacro", ""):
        raise InputError(f"{label}: has macros of xacro; expand them: xacro {label} > robot.urdf")
    if top.tag == "sdf":
        from platform_ctrl.export.robots.sdf import read_sdf

        return read_sdf(label, top)
    if top.tag in ("robot", "mujoco"):
        from platform_ctrl.export.robots.mujoco_spec import read_spec

        return read_spec(file, label, top)
    raise InputError(f"{label}: has the element <{one_line(top.tag)}> on top; give {what}")


class _Tree:
    """Rigid groups of links, each under the name of its first one, on their way to root and gimbals."""

    def __init__(self, robot: Robot, root: str | None, tip: str | None) -> None:
        self.robot, self.notes = robot, list[str]()
        self.links = {one.name: one for one in robot.links}
        self.group: dict[str, str] = {}
        for one in robot.links:
            rigid = one.joint.kind == "fixed" and one.carrier not in ("", WORLD)
            self.group[one.name] = self.group[one.carrier] if rigid else one.name
        self.root = self._root(root)
        self.owner = self._owners(None if tip is None else self._chain(tip))
        # A pivot is where the joint is.
        top, own = self.links[self.group[self.root]].joint, self.links[self.root].pose
        self.pose = Pose(own.turn, top.at) if top.kind == "ball" else own
        self.bodies = {name: self._body(name) for name in dict.fromkeys(self.owner.values())}
        self.size = float(max(np.linalg.norm((one.joint.at, one.pose.at)) for one in robot.links)) or 1.0

    def _error(self, words: str) -> InputError:
        return InputError(f"{self.robot.label}: {words}")

    def _known(self, name: str, option: str) -> str:
        if name not in self.links:
            raise self._error(f"{option}: there is no link {given(name)}; {suggestion(name, self.links)}")
        return name

    def _above(self, group: str) -> str:
        """Return the group that carries a group, or "" for none."""
        return self.group.get(self.links[group].carrier, "")

    def _root(self, root: str | None) -> str:
        if root is not None:
            return self._known(root, "--root")
        carrying = {self._above(one) for one in self.group.values() if self.links[one].joint.kind not in _MODES}
        bases = [one for one in self.links if one in carrying and self.links[one].joint.kind in _MODES]
        if not bases:
            raise self._error("has no joint that turns; a plant needs at least one gimbal")
        if len(bases) > 1:
            raise self._error(f"has several bases, {', '.join(map(given, bases))}; choose one by --root")
        return bases[0]

    def _chain(self, tip: str) -> list[str]:
        chain, base = [self.group[self._known(tip, "--tip")]], self.group[self.root]
        while chain[-1] != base:
            if not (above := self._above(chain[-1])):
                raise self._error(f"--tip: {given(self.root)} does not carry {given(tip)}; name a link that it carries")
            chain.append(above)
        return chain

    def _owners(self, chain: list[str] | None) -> dict[str, str]:
        """Return the group that each group belongs to in the plant; those that are cut off are left out."""
        base = self.group[self.root]
        owner, cut = {base: base}, []
        for one in dict.fromkeys(self.group.values()):
            joint, above = self.links[one].joint, owner.get(self._above(one))
            if one == base:
                continue
            if above is None:
                cut.append(one)
            elif chain is None or one in chain:
                if joint.kind != "hinge":
                    words = f"is {joint.kind}, but a plant has hinges alone; remove it, or hold it at zero by --tip"
                    raise self._error(f"joint {given(joint.name)} of {given(one)} {words}")
                owner[one] = one
            else:
                owner[one] = above
                words = f"not on the way to --tip: held at zero, {given(one)} is part of {given(above)}"
                self.notes.append(f"joint {given(joint.name)}: {words}")
        if cut := [one for one in self.links if self.group[one] in cut and one != WORLD]:
            words = "not carried by the root: cut off; choose another --root to have them"
            self.notes.append(f"links {', '.join(map(given, cut))}: {words}")
        names = {name for one in owner for name in (one, self.links[one].joint.name) if owner[one] == one != base}
        for coupled, words in self.robot.loops:
            if names & set(coupled):
                raise self._error(f"{words}; a plant is a tree: remove it, or hold these bodies at zero by --tip")
            self.notes.append(f"{words}: left out, it couples nothing that turns here")
        return owner

    def _body(self, name: str) -> Body:
        """Return a body of the plant, in root axes from the root's origin."""
        parts = [one.body for one in self.links.values() if self.owner.get(self.group[one.name]) == name]
        mass, centre, inertia = functools.reduce(operator.or_, parts, NO_BODY)
        turn = self.pose.turn
        return Body(mass, turn.T @ (centre - self.pose.at), turn.T @ inertia @ turn)

    def _place(self, name: str) -> FloatArray:
        """Return the joint of a body, or the root's origin, in root axes from that origin."""
        at = self.links[name].joint.at if name != self.group[self.root] else self.pose.at
        return self.pose.turn.T @ (at - self.pose.at)

    def _name(self, owner: str) -> str:
        return self.root if owner == self.group[self.root] else owner

    def tables(self) -> tuple[Tables, list[str]]:
        """Return the plant and the notes on it."""
        base = self.group[self.root]
        out: Tables = {"schema": 1, "name": one_line(self.robot.name) or "robot"}
        out["source"] = f"read by platform-ctrl import from {self.robot.label} ({self.robot.format})"
        out |= {"root": self._root_table(base), "gimbal": [], "rotor": []}
        gimbals: dict[str, str] = {}
        for name in [one for one in self.bodies if one != base]:
            link, above = self.links[name], self.owner[self._above(name)]
            if table := self._rotor(link, above):
                out["rotor"].append(table)
                continue
            gimbals[link.joint.name] = name
            out["gimbal"].append(self._gimbal(link, above))
            if link.joint.armature:
                out.setdefault("motor", []).append(self._motor(link.joint, name))
        for part in self.robot.parts:
            self._add(part, gimbals, out)
        measured = [one["gimbal"] for one in out.get("pickoff", ())]
        assumed = [one["name"] for one in out["gimbal"] if one["name"] not in measured]
        out["pickoff"] = [*out.get("pickoff", ()), *({"gimbal": one} for one in assumed)]
        if assumed:
            words = "the file has no angle sensor: ideal pick-offs are assumed; give them noise and quantisation"
            self.notes.append(f"{', '.join(map(given, assumed))}: {words}")
        return out, self.notes

    def _root_table(self, base: str) -> Tables:
        body, joint = self.bodies[base], self.links[base].joint
        mode = _MODES.get(joint.kind) if self.links[base].carrier == WORLD else None
        mode = "held" if joint.kind == "ball" and joint.armature else mode
        out: Tables = {"name": self.root}
        if body.mass:
            out |= self._masses(body, self._place(base))
        else:
            if mode in ("pivot", "floating"):
                raise self._error(f"link {given(base)} has no mass, but moves as root; give it mass and inertia")
            out["inertia"] = [1.0, 1.0, 1.0]
            words = "no mass in the file: its inertia is assumed, which has no effect while the root is held"
            self.notes.append(f"root {given(self.root)}: {words}")
        if mode:
            out["mode"] = mode
        else:
            words = 'the file does not say how it moves: add mode = "held", "pivot" or "floating"'
            self.notes.append(f"root {given(self.root)}: {words}")
        if self.robot.gravity.any():
            out["gravity"] = _clean(self.pose.turn.T @ self.robot.gravity)
        return out

    def _masses(self, body: Body, at: FloatArray) -> Tables:
        matrix = 0.5 * (body.inertia + body.inertia.T)
        rows = [_clean(row, float(np.trace(matrix))) for row in matrix]
        diagonal = np.count_nonzero(rows) == np.count_nonzero(np.diag(rows))
        out: Tables = {"inertia": [rows[k][k] for k in range(3)] if diagonal else rows}
        return out | ({"mass": body.mass, "centre": self._length(body.centre - at)} if body.mass else {})

    def _length(self, vector: FloatArray) -> list[float]:
        return _clean(vector, self.size)

    def _gimbal(self, link: Link, above: str) -> Tables:
        body, joint = self.bodies[link.name], link.joint
        if not body.inertia.any():
            words = "moves, but has no mass and inertia; give it an inertial element (meshes and shapes are not read)"
            raise self._error(f"link {given(link.name)} {words}")
        out: Tables = {"name": link.name, "parent": self._name(above), "axis": _clean(self.pose.turn.T @ joint.axis)}
        if (origin := self._place(link.name) - self._place(above)).any():
            out["origin"] = self._length(origin)
        out |= self._masses(body, self._place(link.name))
        return out | ({"angle": plain(joint.name)} if joint.name else {}) | dict(joint.keys)

    def _motor(self, joint: Joint, name: str) -> Tables:
        gears = [one.keys["gear"] for one in self.robot.parts if one.kind == "gear" and one.on == joint.name]
        gear = gears[0] if gears else 1.0
        words = f"is rotor_inertia times gear squared, with a gear of {gear:g}: correct both in [[motor]]"
        self.notes.append(f"joint {given(joint.name)}: armature {joint.armature:g} kg m2 {words}")
        return {"gimbal": name, "rotor_inertia": joint.armature / gear**2, "gear": gear}

    def _rotor(self, link: Link, above: str) -> Tables | None:
        """Return the table of a body that turns at a speed of its own, is round about its axis and carries nothing."""
        joint, body = link.joint, self.bodies[link.name]
        if joint.spin is None or any(self._above(one) == link.name for one in self.owner):
            return None
        axis, trace = self.pose.turn.T @ joint.axis, float(np.trace(body.inertia))
        C = float(axis @ body.inertia @ axis)
        A = 0.5 * (trace - C)
        off = np.linalg.norm(np.cross(axis, body.centre - self._place(link.name)))
        rest = np.abs(body.inertia - A * np.eye(3) - (C - A) * np.outer(axis, axis)).max()
        if rest > 1e-6 * trace or off**2 * body.mass > 1e-12 * trace:
            return None
        out: Tables = {"name": link.name.removeprefix(ROTOR), "carrier": self._name(above), "axis": _clean(axis)}
        out |= {"axial_inertia": C, "transverse_inertia": A, "control": "free", **joint.spin}
        out["control"] = "regulated" if joint.armature > _REGULATED * C else out["control"]
        if joint.keys:
            self.notes.append(f"rotor {given(out['name'])}: limits of its angle are left out")
        return out | {"mass": body.mass, "origin": self._length(body.centre - self._place(above))}

    def _add(self, part: Part, gimbals: dict[str, str], out: Tables) -> None:
        """Add a table on a joint or a link, or a note where that is no body of the plant."""
        owner = self.owner.get(self.group.get(part.on, ""))
        if part.axis is not None and owner is not None:
            place = {"body": self._name(owner), "axis": _clean(self.pose.turn.T @ part.axis)}
            if part.kind == "camera":
                words = f"[line_of_sight] with body = {given(place['body'])} and direction = {place['axis']}"
                self.notes.append(f"camera {given(part.keys['name'])}: for a line of sight add {words}")
                return
            table = place | dict(part.keys)
        elif part.on in gimbals and part.axis is None:
            table = {"gimbal": gimbals[part.on], **part.keys}
        elif "root_axis" in part.keys and part.on == self.links[self.group[self.root]].joint.name:
            table = dict(part.keys)
        else:
            self.notes.append(f"{part.kind} on {given(part.on)}: left out, that is no gimbal of the plant")
            return
        if part.kind == "pickoff" and any(one["gimbal"] == table["gimbal"] for one in out.get("pickoff", ())):
            part, table = Part(kind="angle_sensor", on=part.on, keys={}), {"name": part.keys["name"], **table}
        elif part.kind == "pickoff":
            table.pop("name", None)
        if part.kind != "gear":
            out.setdefault(part.kind, []).append(table)


def _clean(vector: FloatArray, size: float = 1.0) -> list[float]:
    """Return numbers without their rounding, which is relative to `size`."""
    digits = _DIGITS - math.floor(math.log10(size))
    return [round(float(x), digits) + 0.0 for x in vector]


def _text(robot: Robot, tables: Tables, notes: list[str]) -> str:
    """Return the plant file: notes, root, each gimbal with all that acts on it, and the rest."""
    head = f"From {robot.label} ({robot.format}), by platform-ctrl import. SI units."
    head = [head, "What has no counterpart in a plant file, or is assumed, and what to do:"] if notes else [head]
    lines = [*head, *(f"- {one_line(note)}" for note in dict.fromkeys(notes))]
    wrapped = [textwrap.fill(one, 116, initial_indent="# ", subsequent_indent="#   ", **_WRAP) for one in lines]
    out = ["\n".join(wrapped), toml({key: item for key, item in tables.items() if not isinstance(item, list)})]
    parts = {key: item for key, item in tables.items() if isinstance(item, list)}
    for gimbal in parts.pop("gimbal"):
        own = {key: [one for one in item if one.get("gimbal") == gimbal["name"]] for key, item in parts.items()}
        out.append(toml({"gimbal": [gimbal], **own}).lstrip("\n"))
    others = {key: [one for one in item if "gimbal" not in one] for key, item in parts.items()}
    return "\n".join(one for one in [*out, toml(others).lstrip("\n")] if one)


_WRAP: dict[str, Any] = {"break_long_words": False, "break_on_hyphens": False}
