"""A platform as MJCF: gimbals and rotors as bodies on hinges, torquers and sensors, to look at and to cross-check."""

from __future__ import annotations

import os
import re
from collections.abc import Sequence
from typing import Literal, get_args
from xml.etree.ElementTree import Comment, Element, SubElement, indent, tostring

import numpy as np
from scipy.spatial.transform import Rotation

from platform_ctrl.common.arguments import instance, one_of, short
from platform_ctrl.common.files import write_whole
from platform_ctrl.common.values import FloatArray, value
from platform_ctrl.errors import ArgumentError
from platform_ctrl.plant.drives import Torquer
from platform_ctrl.plant.gimbals import Rotor
from platform_ctrl.plant.platform import OMEGA_NAMES, Platform
from platform_ctrl.plant.sensors import Sensor, body_rates, body_rotations, gimbal_rate

Root = Literal["free", "prescribed", "fixed"]

# Inertia of the drive of a regulated rotor, over C, and of what turns a prescribed root, over that of everything: they
# give way by so much less.
REGULATED = 1e11
PRESCRIBED = 1e11
_STEP = 1e-4  # s


def write_mjcf(platform: Platform, path: str | os.PathLike[str], *, root: Root = "free") -> tuple[str, ...]:
    """Write a platform as a MuJoCo model, whole or not at all: RK4 with steps of 1e-4 s.

    Parameters
    ----------
    platform
        The plant.
    path
        Of the file; its folder is there.
    root
        ``"free"``: it moves as the plant's mode says: about its origin, or freely in space; one that is held is fixed.
        ``"prescribed"``: the controls ``Omega1_dot`` to ``Omega3_dot`` are its angular acceleration, rad/s², in its own
        axes, whatever reacts on it; ``"fixed"``: it does not move.

    Returns
    -------
    tuple of str
        What of the plant the file leaves out or has in another form, a line each.

    Raises
    ------
    ArgumentError
        `platform` is no `Platform`, `root` is another word or does not go with the plant's mode, a drive gives way, or
        MuJoCo uses a name for something else.
    InputError
        The file cannot be written there.
    """
    instance("platform", platform, Platform)
    one_of("write_mjcf: root", root, get_args(Root))
    _check_names(platform)
    floating = platform.mode == "floating"
    if floating and root == "prescribed":
        raise ArgumentError("write_mjcf: root: a floating root is free or fixed, its rates are not prescribed")
    root = "fixed" if platform.mode == "held" and root == "free" else root
    notes = _notes(platform, root)
    top = Element("mujoco", model=_line(platform.name))
    for line in filter(None, (platform.source, *notes)):
        top.append(Comment(f" {re.sub('-(?=-)', '- ', _line(line))} "))
    SubElement(top, "compiler", angle="radian", autolimits="true", inertiafromgeom="false")
    field = text(platform.gravity - platform.specific_force if not floating else np.zeros(3))
    option = SubElement(top, "option", timestep=repr(_STEP), integrator="RK4", gravity=field)
    SubElement(option, "flag", contact="disable")
    bodies = placed(platform)
    SubElement(SubElement(top, "default"), "geom", contype="0", conaffinity="0", group="1")
    world = SubElement(top, "worldbody")
    hinges = _add_root(world, platform, bodies, root)
    _add_drives(top, platform)
    controls = _add_actuators(top, platform, root)
    _add_sensors(top, platform, root)
    for group in [one for one in top[-3:] if not len(one)]:
        top.remove(group)
    place = [0.0, 0.0, 0.0] if floating else []
    turned, turning = ([], []) if root == "fixed" else ([*place, 1.0, 0.0, 0.0, 0.0], [*place, 0.0, 0.0, 0.0])
    qpos, qvel = [*turned, *(0.0 for _ in hinges)], [*turning, *hinges]
    key = SubElement(SubElement(top, "keyframe"), "key", name="running", qpos=text(qpos), qvel=text(qvel))
    if controls:
        key.set("ctrl", text(controls))
    indent(top)
    write_whole(path, tostring(top, encoding="unicode") + "\n")
    return notes


def _check_names(platform: Platform) -> None:
    bodies = [platform.root_name, *platform.gimbal_names, *(f"rotor {rotor.name}" for rotor in platform.rotors)]
    joints = ["root", *platform.angle_names, *(f"spin {rotor.name}" for rotor in platform.rotors)]
    for names, reserved in ((bodies, "world"), (joints, "")):
        for k, name in enumerate(names):
            if name == reserved or name in names[:k]:
                words = f"{short(name)} is used twice or reserved in MuJoCo; choose another name"
                raise ArgumentError(f"write_mjcf: {words}")


def _add_root(world: Element, platform: Platform, bodies: list[Placed], root: Root) -> list[float]:
    """Add all bodies; return the rates of the hinges as the model begins, in MuJoCo's order."""
    element = SubElement(world, "body", name=_line(platform.root_name))
    if root != "fixed":
        joint = SubElement(element, "joint", name="root", type="free" if platform.mode == "floating" else "ball")
        if root == "prescribed":
            joint.set("armature", repr(PRESCRIBED * _whole(platform)))
    _add_inertia(element, bodies[0])
    SubElement(element, "site", name="root", pos="0 0 0", size="0.001", group="4")
    size, below = (text(bodies[0].radius * np.array(one)) for one in ([0.95, 0.03], [0.0, 0.0, -1.12]))
    SubElement(element, "geom", type="cylinder", rgba=_ROOT, size=size, pos=below)
    return _add_carried(element, platform, bodies, 0, 0)


def _add_carried(element: Element, platform: Platform, bodies: list[Placed], body: int, depth: int) -> list[float]:
    carriers = zip(platform.rotors, platform.carriers, strict=True)
    rates = [_add_rotor(element, rotor, bodies[body]) for rotor, carrier in carriers if carrier == body - 1]
    for child in children(platform, body):
        gimbal = platform.gimbals[child - 1]
        place = {"pos": text(gimbal.origin)} if gimbal.origin.any() else {}
        inner = SubElement(element, "body", {"name": _line(gimbal.name)} | place)
        about = {"name": _line(gimbal.angle), "type": "hinge", "axis": text(gimbal.axis)}
        SubElement(inner, "joint", about | _joint(platform, child - 1))
        _add_inertia(inner, bodies[child])
        if gimbal.name in inertial_bodies(platform):
            SubElement(inner, "site", name=_line(gimbal.name), pos="0 0 0", size="0.001", group="4")
        # Drawn as a shaft along its axis.
        reach = bodies[child].radius * gimbal.axis
        look = {"rgba": _GIMBALS[depth % len(_GIMBALS)], "size": repr(0.045 * bodies[child].radius)}
        SubElement(inner, "geom", look, type="capsule", fromto=text([*-reach, *reach]))
        rates += [0.0, *_add_carried(inner, platform, bodies, child, depth + 1)]
    return rates


def _joint(platform: Platform, k: int) -> dict[str, str]:
    """Return the forces in a gimbal's bearing as attributes of its joint."""
    gimbal = platform.gimbals[k]
    stiffness, torque, damping = _spring(platform, gimbal.name)
    out = {"stiffness": repr(stiffness), "springref": repr(torque / stiffness)} if stiffness > 0.0 else {}
    frictions = [one for one in platform.frictions if one.gimbal == gimbal.name]
    armature = sum(one.gear**2 * one.rotor_inertia for one in platform.motors if one.gimbal == gimbal.name)
    armature += sum(one.inertia for one in platform.compliances if one.motor_side == gimbal.name)
    numbers = {
        "damping": damping + sum(one.viscous for one in frictions),
        "frictionloss": sum(0.5 * sum(one.coulomb) for one in frictions),
        "armature": armature,
    }
    out |= {key: repr(number) for key, number in numbers.items() if number}
    if gimbal.stops is not None:
        # A stop is a contact that gives a little: four steps to settle, the rate given back by its damping.
        away = np.log(max(gimbal.restitution, 1e-3))
        ratio = 1.0 if gimbal.restitution == 0.0 else float(-away / np.hypot(np.pi, away))
        out |= {"range": text(gimbal.stops), "solreflimit": text([4.0 * _STEP, ratio])}
    return out


def _add_drives(top: Element, platform: Platform) -> None:
    """Add a tendon for each drive that gives way: its length is the load's angle less that of the motor side."""
    group, angles = SubElement(top, "tendon"), dict(zip(platform.gimbal_names, platform.angle_names, strict=True))
    for one in platform.compliances:
        slack = f"{-0.5 * one.play!r} {0.5 * one.play!r}" if one.play else "0"
        numbers = {"stiffness": repr(one.strength), "damping": repr(one.damping), "springlength": slack}
        tendon = SubElement(group, "fixed", {"name": _line(f"drive {one.gimbal}")} | numbers)
        for side, share in ((one.gimbal, "1"), (one.motor_side, "-1")):
            SubElement(tendon, "joint", joint=_line(angles[side]), coef=share)


def _spring(platform: Platform, gimbal: str) -> tuple[float, float, float]:
    """Return stiffness, torque at zero angle, and damping of all springs and closed cages of a gimbal."""
    springs = [(s.stiffness, s.rest, s.damping) for s in platform.held_by if s.gimbal == gimbal]
    springs += [(c.stiffness, c.angle, c.damping) for c in platform.cages if c.gimbal == gimbal and not c.clearance]
    stiffness, torque = sum(k for k, _, _ in springs), sum(k * rest for k, rest, _ in springs)
    return stiffness, torque, sum(damping for _, _, damping in springs)


def _add_rotor(element: Element, rotor: Rotor, carrier: Placed) -> float:
    """Add a rotor; return its rate relative to its carrier as the model begins."""
    body = SubElement(element, "body", name=_line(f"rotor {rotor.name}"))
    joint = SubElement(body, "joint", name=_line(f"spin {rotor.name}"), type="hinge", axis=text(rotor.axis))
    if rotor.control == "regulated":
        joint.set("armature", repr(REGULATED * rotor.axial_inertia))
    A, C = rotor.transverse_inertia, rotor.axial_inertia
    # Without a mass of its own it has a share of the carrier's, where that has its centre.
    share = carrier.rotor_mass or _LIGHT * 2.0 * C / ROTOR_RADIUS**2
    if rotor.mass or carrier.rotor_mass:
        body.set("pos", text(rotor.origin if rotor.mass else carrier.centre))
    turn = Rotation.align_vectors(rotor.axis, [0.0, 0.0, 1.0])[0].as_quat(scalar_first=True)
    numbers = {"mass": repr(rotor.mass or share), "diaginertia": text([A, A, C]), "quat": text(turn)}
    SubElement(body, "inertial", numbers, pos="0 0 0")
    half, size = 0.2 * ROTOR_RADIUS * rotor.axis, repr(0.82 * ROTOR_RADIUS)
    SubElement(body, "geom", type="cylinder", rgba=_ROTOR, size=size, fromto=text([*-half, *half]))
    return rotor.spin


def _add_inertia(element: Element, one: Placed) -> None:
    inertial = SubElement(element, "inertial", pos=text(one.centre), mass=repr(one.mass))
    if np.array_equal(one.inertia, np.diag(np.diag(one.inertia))):
        inertial.set("diaginertia", text(np.diag(one.inertia)))
        return
    # MuJoCo's own way to the principal axes is less exact.
    moments, axes = np.linalg.eigh(one.inertia)
    axes[:, 0] *= np.sign(np.linalg.det(axes))
    turn = Rotation.from_matrix(axes).as_quat(scalar_first=True)
    inertial.attrib.update(diaginertia=text(moments), quat=text(turn))


def _whole(platform: Platform) -> float:
    """Return an inertia that is not less than that of everything, kg m²."""
    rotors = sum(2.0 * r.transverse_inertia + r.axial_inertia for r in platform.rotors)
    arm = sum(float(np.linalg.norm(g.origin)) for g in platform.gimbals)
    masses = [(b.mass, b.centre) for b in platform.bodies] + [(r.mass, r.origin) for r in platform.rotors]
    moved = sum(2.0 * mass * (arm + float(np.linalg.norm(centre))) ** 2 for mass, centre in masses)
    return float(sum(np.trace(body.inertia) for body in platform.bodies) + rotors + moved)


def _add_actuators(top: Element, platform: Platform, root: Root) -> list[float]:
    """Add torquers, then what turns a prescribed root, then speed loops; return the controls that a run begins with."""
    group = SubElement(top, "actuator")
    for torquer in platform.torquers:
        if torquer.root_axis is None or root == "free":
            _add_torquer(group, platform, torquer)
    if root == "prescribed":
        for name, gear in zip(OMEGA_NAMES, np.eye(3), strict=True):
            turning = text(PRESCRIBED * _whole(platform) * gear)
            SubElement(group, "motor", name=f"{name}_dot", joint="root", gear=turning)
    for gimbal in platform.gimbals:
        stiffness, torque, _ = _spring(platform, gimbal.name)
        if stiffness < 0.0:  # joints have none that drive away
            names = {"name": _line(f"spring {gimbal.name}"), "joint": _line(gimbal.angle)}
            bias = text([torque, -stiffness, 0.0])
            SubElement(group, "general", names, gainprm="0", biastype="affine", biasprm=bias)
    spins = {_line(f"spin {rotor.name}"): rotor.spin for rotor in platform.rotors if rotor.control == "servo"}
    for rotor in platform.rotors:
        if rotor.control == "servo":
            joint = {"joint": _line(f"spin {rotor.name}")}
            SubElement(group, "velocity", joint, name=_line(f"speed {rotor.name}"), kv=repr(rotor.speed_gain))
            if rotor.speed_integral:
                gain, rng = repr(rotor.speed_integral), {"actrange": "-1e12 1e12"}
                SubElement(group, "intvelocity", joint | rng, name=_line(f"speed integral {rotor.name}"), kp=gain)
    return [spins.get(one.get("joint", ""), 0.0) for one in group]


def _add_torquer(group: Element, platform: Platform, torquer: Torquer) -> None:
    """Limited control, then the lag, then the torque: as in the simulation."""
    about: dict[str, str] = {"name": _line(torquer.name)}
    if torquer.gimbal is not None:
        about["joint"] = _line(platform.gimbals[platform.gimbal(torquer.gimbal)].angle)
        about |= {"gear": repr(torquer.gain)} if torquer.command else {}
    elif torquer.root_axis is not None:
        about |= {"joint": "root", "gear": text(np.eye(3)[torquer.root_axis - 1])}
    if torquer.limit is not None:
        about["ctrlrange"] = text([-torquer.limit, torquer.limit])
    if torquer.lag:
        SubElement(group, "general", about, dyntype="filter", dynprm=repr(torquer.lag), gainprm="1")
    else:
        SubElement(group, "motor", about)


def inertial_bodies(platform: Platform) -> list[str]:
    """Return the gimbals whose rate or attitude in inertial space is read, or that have the line of sight."""
    read = {*_inertial(platform, platform.sensors)}
    read |= {platform.line_of_sight.body} if platform.line_of_sight is not None else set()
    return [name for name in platform.gimbal_names if name in read]


def _inertial(platform: Platform, sensors: Sequence[Sensor]) -> dict[str, list[str]]:
    """Return the names of sensors by the body whose rate or rotation in inertial space they read."""
    out: dict[str, list[str]] = {}
    for body, name in enumerate((platform.root_name, *platform.gimbal_names)):
        read = {*body_rates(platform, body), *body_rotations(platform, body)}
        found = [one.name for one in sensors if read & one.signals(platform).keys()]
        if found:
            out[name] = found
    return out


def _add_sensors(top: Element, platform: Platform, root: Root) -> None:
    group = SubElement(top, "sensor")
    joints = {angle: ("jointpos", angle) for angle in platform.angle_names}
    joints |= {gimbal_rate(angle): ("jointvel", angle) for angle in platform.angle_names}
    for sensor in platform.sensors:
        [signal, weight], *others = sensor.signals(platform).items()
        if signal in joints and weight == 1.0 and not others:
            kind, angle = joints[signal]
            noise = {"noise": repr(sensor.noise_rms)} if sensor.noise_rms else {}
            SubElement(group, kind, {"name": _line(sensor.name), "joint": _line(angle)} | noise)
    for rotor in platform.rotors:
        SubElement(group, "jointvel", name=_line(f"spin {rotor.name}"), joint=_line(f"spin {rotor.name}"))
    if root != "fixed":
        SubElement(group, "gyro", name="Omega", site="root")
        SubElement(group, "framequat", name="attitude", objtype="site", objname="root")
    for gimbal in inertial_bodies(platform):
        SubElement(group, "gyro", name=_line(f"{gimbal}_Omega"), site=_line(gimbal))
        SubElement(group, "framequat", name=_line(f"{gimbal}_attitude"), objtype="site", objname=_line(gimbal))


def _notes(platform: Platform, root: Root) -> tuple[str, ...]:
    """Return notes on parts of the plant that the MJCF file leaves out, or has in another form."""
    heavy = bool(platform.unbalances) or any(body.mass for body in platform.bodies)
    moved = root != "fixed" and heavy and platform.specific_force.any()
    left_out = [*platform.root_torquers] if root != "free" else []
    found: dict[str, list[str]] = {
        "dry friction of {}: MuJoCo's frictionloss, the mean of both directions, in place of a smooth curve": [
            friction.gimbal for friction in platform.dry_frictions
        ],
        "cage of {}: left out, for its clearance": [cage.gimbal for cage in platform.cages if cage.clearance],
        "erection of {}: left out; add it to the control of a torquer": [one.gimbal for one in platform.erections],
        f"torquer {{}}: left out, the root is {root}": left_out,
        "rate limit of {}: left out": [
            t.name for t in platform.torquers if t.rate_limit is not None and t.name not in left_out
        ],
        "quantisation of {}: left out": [one.name for one in platform.sensors if one.quantisation],
        "bandwidth, delay, bias or scale error of {}: left out": [
            one.name for one in platform.sensors if one.bandwidth_hz or one.delay or one.bias or one.scale_error
        ],
        **_notes_of_inertial(platform, root),
        "torque limit of the speed loop of {}: left out": [
            rotor.name for rotor in platform.rotors if rotor.control == "servo" and rotor.torque_limit is not None
        ],
        "stops of {}: contacts that give a little, in place of impacts": [
            gimbal.name for gimbal in platform.gimbals if gimbal.stops is not None
        ],
        "motor of {}: its inertia is the joint's armature, which lacks N J of the parent's rate in the gimbal's row": [
            one.gimbal for one in platform.motors
        ],
        "drive of {}: a tendon between load and motor side, the motor side's inertia as armature, damped in play too": [
            one.gimbal for one in platform.compliances
        ],
        "mode of the structure {}: left out, the bodies are rigid": [mode.name for mode in platform.modes],
        "voltage of {}: left out, the torque limit is that at rest": [
            torquer.name for torquer in platform.torquers if torquer.stall is not None
        ],
        "current loop or cogging of {}: left out": [
            one.name or one.gimbal for one in platform.motors if one.cogging is not None or platform.windings
        ],
        "specific force {}: gravity, which keeps its direction in the world when the root turns": [
            text(platform.specific_force) for _ in range(bool(moved))
        ],
    }
    return tuple(_line(note.format(", ".join(names))) for note, names in found.items() if names)


def _notes_of_inertial(platform: Platform, root: Root) -> dict[str, list[str]]:
    """Return where to find what sensors read of bodies in inertial space."""
    out: dict[str, list[str]] = {}
    for kind, sensors, signal in (
        ("rate sensor", platform.rate_sensors, "Omega"),
        ("attitude sensor", platform.attitude_sensors, "attitude"),
    ):
        for body, names in _inertial(platform, sensors).items():
            place = signal if body == platform.root_name else f"{body}_{signal}"
            how = "an element of" if place == "Omega" else "from"
            left_out = root == "fixed" and body == platform.root_name
            out[f"{kind} {{}}: {'left out' if left_out else f'{how} the sensor {place}'}"] = names
    sight = platform.line_of_sight
    if sight is not None and not (root == "fixed" and sight.body == platform.root_name):
        own = "" if sight.body == platform.root_name else f"{sight.body}_"
        out[f"line of sight of {{}}: from the sensors {own}Omega and {own}attitude"] = [sight.body]
    return out


def _line(words: str) -> str:
    return " ".join("".join(c if c.isprintable() else " " for c in words).split())


# Radius that rotors are drawn with, m, and by how much a gimbal is larger than what it holds.
ROTOR_RADIUS = 0.05
_AROUND = 1.22
# Mass of a rotor, relative to its inertia over its size; density of the ball whose mass a body has, kg/m³.
_LIGHT, _DENSITY = 1e-3, 1.0
# Of a body that has none, kg and kg m²: MuJoCo wants some.
_NO_MASS = 1e-12
# Second moments below this share of a body's largest are those of a plate; no mass can be moved out of it.
_FLAT = 1e-6
# Okabe and Ito's colours, which colour-blind people can tell apart; gimbals by their depth.
_GIMBALS = ("0.00 0.45 0.70 1", "0.34 0.71 0.91 1", "0.00 0.62 0.45 1", "0.80 0.47 0.65 1")
_ROTOR, _ROOT = "0.84 0.37 0.00 1", "0.55 0.57 0.60 1"


@value
class Placed:
    """A gimbal, or the root, with its mass."""

    radius: float  # That it is drawn with, m
    mass: float  # Its own, kg, rotors not included; without one in the plant: of no effect but through centre
    centre: FloatArray  # (3,): Of its own mass, m, body axes
    inertia: FloatArray  # (3, 3): About that centre, kg m²
    rotor_mass: float  # What each rotor without a mass of its own takes of the plant's, kg


def placed(platform: Platform) -> list[Placed]:
    """Return the root and all gimbals, in the order of `Platform.body`."""
    out = []
    for body, (own, centre, _) in enumerate(platform.bodies):
        inertia = platform.bodies[body].inertia_about_origin
        name = platform.gimbal_names[body - 1] if body else platform.root_name
        moment = sum((one.moment for one in platform.unbalances if one.body == name), own * centre)
        radius = _radius(platform, body)
        if name in platform.loads:  # its inertia is the joint's armature
            bare = _NO_MASS * np.eye(3)
            out.append(Placed(radius=radius, mass=_NO_MASS, centre=np.zeros(3), inertia=bare, rotor_mass=0.0))
            continue
        mass = own or (4.0 / 3.0 * np.pi * _DENSITY) ** 0.4 * (5.0 / 6.0 * float(np.trace(inertia))) ** 0.6
        if moment.any() and not own:
            # The centre of mass takes a quarter of the smallest second moment away.
            spread = np.linalg.eigvalsh(0.5 * np.trace(inertia) * np.eye(3) - inertia)
            mass = max(mass, float(4.0 * (moment @ moment) / max(spread[0], _FLAT * spread[-1])))
        centre = moment / mass
        inertia = inertia - mass * (centre @ centre * np.eye(3) - np.outer(centre, centre))
        share = _LIGHT * own
        mass -= share * sum(rotor.carrier == name and not rotor.mass for rotor in platform.rotors)
        out.append(Placed(radius=radius, mass=mass, centre=centre, inertia=inertia, rotor_mass=share))
    return out


def _radius(platform: Platform, body: int) -> float:
    return _AROUND * max((_radius(platform, child) for child in children(platform, body)), default=ROTOR_RADIUS)


def children(platform: Platform, body: int) -> list[int]:
    """Return the bodies that a body carries."""
    return [1 + int(k) for k in np.flatnonzero(platform.parents == body - 1)]


def text(numbers: FloatArray | tuple[float, ...] | list[float]) -> str:
    """Return numbers as an attribute, with all their digits."""
    return " ".join(repr(float(number)) for number in numbers)
