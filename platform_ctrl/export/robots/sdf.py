"""SDF as a robot: poses relative to any frame, nested models, joints of one axis, gyros of IMUs."""

from __future__ import annotations

import math
from typing import Any
from xml.etree.ElementTree import Element

import numpy as np

from platform_ctrl.common.values import FloatArray
from platform_ctrl.export.robots.robot import NO_BODY, SHOWN, WORLD, Link, Pose, Reader, unread
from platform_ctrl.plant.gimbals import Body
from platform_ctrl.plant.mistakes import given

_MODEL = "__model__"
_KINDS = {"revolute": "hinge", "continuous": "hinge", "fixed": "fixed"}
_READ = """sdf version model world name canonical_link pose link joint frame attached_to relative_to degrees
    rotation_format inertial mass inertia ixx ixy ixz iyy iyz izz type parent child axis xyz expressed_in
    use_parent_model_frame limit lower upper effort velocity dynamics damping friction spring_stiffness
    spring_reference"""


class Sdf(Reader):
    """A file in SDF; files that it includes are not read."""

    format = "SDF"

    def __init__(self, label: str, top: Element) -> None:
        super().__init__(label, top)
        # frames: by name with the models around: the frame that its pose is relative to ("": none), and the pose
        self.frames: dict[str, tuple[str, Pose]] = {"": ("", Pose())}
        self.attached: dict[str, str] = {}  # Frames and models, and what they are fixed to
        self.elements: dict[str, Element] = {}  # Of links
        joints: dict[str, tuple[str, Element]] = {}  # Scope and element
        models = [*top.findall("model"), *top.findall("world/model")]
        for model in models:
            self._enter(model, "", f"{model.get('name')}::" if len(models) > 1 else "", joints)
        included = [one.findtext("uri", "") for one in top.iter("include")]
        if included and not self.elements:
            raise self.error(f"its parts are in files that it includes; import these: {', '.join(included)}")
        self.name = models[0].get("name", "") if models else ""
        ends = {name: (self._link(*one, "parent"), self._link(*one, "child")) for name, one in joints.items()}
        on = {child: (name, parent) for name, (parent, child) in ends.items()}
        static = all(one.findtext("static", "").strip() in ("true", "1") for one in models)
        if static or any(parent == WORLD for parent, _ in ends.values()):
            self.add(Link(name=WORLD, carrier="", pose=Pose(), body=NO_BODY))
        for name in self.ordered(ends, self.elements):
            self._add(name, *on.get(name, ("", WORLD if static else "")), joints)
        if (gravity := top.findtext("world/gravity")) is None:
            self.assume_gravity()
        else:
            self.gravity = self.numbers(gravity, 3, "gravity")
        self.notes += unread(top, _READ, f"{SHOWN} sensor")

    def _enter(self, model: Element, around: str, own: str, joints: dict[str, tuple[str, Element]]) -> None:
        """Note the frames of a model, whose names begin with `own`, in the one around it."""
        self._place(own + _MODEL, model, around + _MODEL if around + _MODEL in self.frames else "", around)
        for one in model.findall("link"):
            self.elements[own + one.get("name", "")] = one
            self._place(own + one.get("name", ""), one, own + _MODEL, own)
        for one in model.findall("frame"):
            self.attached[own + one.get("name", "")] = to = _named(own, one.get("attached_to", _MODEL))
            self._place(own + one.get("name", ""), one, to, own)
        for one in model.findall("model"):
            self._enter(one, own, f"{own}{one.get('name')}::", joints)
        for one in model.findall("joint"):
            joints[own + one.get("name", "")] = (own, one)
            self._place(own + one.get("name", ""), one, _named(own, one.findtext("child", "").strip()), own)
        first = next((one.get("name", "") for one in model.iter("link")), "")
        self.attached[own + _MODEL] = own + model.get("canonical_link", first)
        if own:  # the model by its name
            self.attached[own[:-2]], self.frames[own[:-2]] = own + _MODEL, (own + _MODEL, Pose())

    def _place(self, name: str, element: Element, default: str, scope: str) -> None:
        if name in self.frames and element.tag != "sensor":
            raise self.error(f"the name {given(name)} is used twice; choose another for one of them")
        pose = element.find("pose")
        relative = "" if pose is None else pose.get("relative_to") or pose.get("frame", "")
        self.frames[name] = (_named(scope, relative) if relative else default, self.pose(pose, given(name)))

    def _frame(self, name: str, inside: tuple[str, ...] = ()) -> Pose:
        if name not in self.frames or name in inside:
            words = "is defined by itself" if name in inside else "is not in this file"
            raise self.error(f"the frame {given(name)} {words}; correct relative_to or attached_to")
        base, own = self.frames[name]
        return own if name == base == "" else self._frame(base, (*inside, name)) @ own

    def _link(self, scope: str, joint: Element, end: str) -> str:
        """Return the link at an end of a joint, which may name a frame or a model."""
        if not (own := joint.findtext(end, "").strip()):
            raise self.error(f"joint {given(joint.get('name'))} has no {end}; name a link, or world")
        name = _named(scope, own)
        for _ in self.attached:
            name = self.attached.get(name, name) if name not in self.elements else name
        return name or WORLD

    def _add(self, name: str, joint: str, carrier: str, joints: dict[str, tuple[str, Element]]) -> None:
        """Add a link with its joint and sensors."""
        pose, element = self._frame(name), self.elements[name]
        for sensor in element.findall("sensor"):
            self._place(f"{name}/", sensor, name, name[: name.rfind("::") + 2] if "::" in name else "")
            self.sensor(name, sensor, self._frame(f"{name}/").turn)
        about: dict[str, Any] = {"pivot": pose.at}
        if joint:
            scope, one = joints[joint]
            kind = one.get("type", "")
            about = {"kind": _KINDS.get(kind, kind), "pivot": self._frame(joint).at}
            if about["kind"] == "hinge":
                about |= self._hinge(joint, one) | {"axis": self._axis(joint, scope, one.find("axis"))}
        body = self._body(element, pose, given(name))
        self.add(Link(name=name, carrier=carrier, pose=pose, body=body, joint=joint, **about))

    def _body(self, link: Element, pose: Pose, name: str) -> Body:
        inertial = link.find("inertial")
        if inertial is None or inertial.get("auto") == "true":
            return NO_BODY
        if inertial.find("mass") is None or inertial.find("inertia") is None:
            raise self.error(f"link {name}: its inertial has no mass or no inertia; give both")
        xx, yy, zz = (self.number(inertial, f"inertia/{key}", 1.0, f"link {name}") for key in ("ixx", "iyy", "izz"))
        xy, xz, yz = (self.number(inertial, f"inertia/{key}", 0.0, f"link {name}") for key in ("ixy", "ixz", "iyz"))
        own = pose @ self.pose(inertial.find("pose"), f"the inertial of {name}")
        matrix = np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])
        return own.body(self.number(inertial, "mass", 0.0, f"link {name}"), matrix)

    def _hinge(self, joint: str, element: Element) -> dict[str, Any]:
        """Return kind and keys of a joint about one axis; add what acts in it."""
        where, axis, inf = f"joint {given(joint)}", element.find("axis"), math.inf
        lower, upper = (self.number(axis, f"limit/{key}", end, where) for key, end in (("lower", -inf), ("upper", inf)))
        if lower == upper:
            self.notes.append(f"{where}: its limits are both {lower:g} rad: it is taken as fixed at zero")
            return {"kind": "fixed"}
        bearing = ("damping", "friction", "spring_stiffness", "spring_reference")
        self.bearing(joint, *(self.number(axis, f"dynamics/{key}", 0.0, where) for key in bearing))
        self.drive(joint, *(self.number(axis, f"limit/{key}", -1.0, where) for key in ("effort", "velocity")))
        return {"keys": self.stops(joint, lower, upper)}

    def _axis(self, joint: str, scope: str, axis: Element | None) -> FloatArray:
        xyz = None if axis is None else axis.find("xyz")
        if axis is None or xyz is None:
            return self._frame(joint).turn[:, 2]
        by_model = axis.findtext("use_parent_model_frame", "").strip() in ("true", "1")
        frame = xyz.get("expressed_in") or _MODEL * by_model
        along = self.numbers(xyz.text, 3, f"joint {given(joint)}: xyz")
        return self._frame(_named(scope, frame) if frame else joint).turn @ along / (np.linalg.norm(along) or 1.0)


def _named(scope: str, name: str) -> str:
    return "" if name in (WORLD, "__root__") else scope + name
