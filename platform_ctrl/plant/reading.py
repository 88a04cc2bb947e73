"""Plant files: TOML or dict -> Platform.

Each table alone is judged by the reader, keys and values, and by its record, what fits in one table; here is judged
what must fit together: bodies and the names of them, sensing axes, signals.
"""

from __future__ import annotations

import dataclasses
import math
import os
from collections.abc import Iterator, Mapping
from pathlib import Path as FilePath
from typing import Any

import numpy as np

from platform_ctrl.common.values import FloatArray, replaced
from platform_ctrl.plant.drives import ROOT_TORQUE_NAMES, Servo
from platform_ctrl.plant.fields import SCHEMA, default_angle, default_torquer
from platform_ctrl.plant.flexible import Compliance, with_mode_table
from platform_ctrl.plant.gimbals import Gimbal, mass_misfits
from platform_ctrl.plant.locking import carried_inertia, with_rigid_drives
from platform_ctrl.plant.mistakes import Mistake, Path, at, given, report, strange, suggestion, wrong
from platform_ctrl.plant.platform import OMEGA_NAMES, Platform, plant_data, sensor_tables
from platform_ctrl.plant.sensors import LOS_ANGLES
from platform_ctrl.plant.source import InputData, is_shipped_name, open_file, open_mapping, open_shipped, path_of
from platform_ctrl.plant.tables import Key, Shape, made, read_table, references, shape

# Which signal of its own each table names.
_SIGNALS = {
    "gimbal": "angle",
    "mode": "coordinate",
    "torquer": "torque",
    "rate_sensor": "rate",
}
# Cosine below which two axes count as normal to each other, and sine below which they count as parallel.
_NORMAL = 1e-6
# Density of the ball that has a body's mass and inertia, kg/m³: osmium has 2e4, the largest structures in space 1e-3.
_THINNEST, _DENSEST = 1e-6, 1e8
# Distance from a body's centre of mass to its joints over its radius of gyration: a boom of a thousandth of the mass
# reaches 110.
_FARTHEST = 300.0


# The whole file.
PLANT_FILE = dataclasses.replace(
    shape(Platform), keys={"schema": Key(SCHEMA, "schema", needed=True)} | {**shape(Platform).keys}
)


def read_platform(source: str | os.PathLike[str] | Mapping[str, Any] | Platform) -> Platform:
    """Read a plant.

    Parameters
    ----------
    source
        The name of a shipped model (no suffix, no path separator), the path of a TOML file, or a dict of the
        same structure, in which tuples and NumPy arrays serve as vectors. A platform, such as one that was made in
        Python, is judged as a file is.

    Returns
    -------
    Platform
        In SI units; axes of unit length; every angular momentum in place of the spin.

    Raises
    ------
    InputError
        One line: which file, table and key, what was given, what is expected.

    Examples
    --------
    >>> import platform_ctrl as pc
    >>> platform = pc.read_platform("three_gyro_platform")
    >>> platform.angle_names
    ('alpha4', 'beta5', 'beta7', 'alpha9', 'beta10')
    """
    document = open_plant(source, FilePath())
    platform, mistakes = judge_plant(document)
    if platform is None:
        raise report(document.label, document.data, mistakes)
    return platform


def open_plant(source: object, folder: FilePath) -> InputData:
    """Return the document of a plant: a platform, a dict, a shipped model, or a file whose path starts in `folder`."""
    if isinstance(source, Platform):
        return open_mapping(plant_data(source), f"platform {given(source.name)}", folder)
    if isinstance(source, Mapping):
        return open_mapping(source, "plant given as a dict", folder)
    path = path_of(source, "the name of a shipped model, a path or a dict")
    if isinstance(source, str) and is_shipped_name(source):
        return open_shipped(source)
    return open_file(folder / path)


def judge_plant(document: InputData) -> tuple[Platform | None, list[Mistake]]:
    """Return the platform that a document describes, or None and its mistakes."""
    if "root" not in document.data and {"plant", "loop"} <= set(document.data):
        its_plant = given(document.data["plant"])
        return None, [Mistake(("plant",), f"this is a job file; give its plant instead, {its_plant}")]
    data = _axis_by_axis(with_mode_table(document.data, document.folder))
    read, mistakes = read_table(PLANT_FILE, data)
    if mistakes := [*document.mistakes, *mistakes]:
        return None, mistakes
    del read["schema"]
    parts = made(read)
    if mistakes := [*_tree_mistakes(parts)] or [*_drives(parts)]:
        return None, mistakes
    platform = Platform(**_with_inertias(parts))
    mistakes = [
        *_masses(platform, data),
        *_other_units(platform),
        *_relative_rates(platform),
        *_line_of_sight(platform),
        *_signals(platform),
        *_modes(platform),
    ]
    return (None, mistakes) if mistakes else (_with_stiffness(platform), [])


def _drives(parts: Mapping[str, Any]) -> Iterator[Mistake]:
    """Yield drives that give way without an inertia on their motor side."""
    turned = {one.gimbal for one in parts.get("motors", ())}
    taken = {one.name: k for k, one in enumerate(parts.get("gimbals", ()))}
    for k, one in enumerate(parts.get("compliances", ())):
        if not one.inertia and one.gimbal not in turned:
            words = "it has no motor side: give its inertia, or a [[motor]] with a rotor_inertia on the gimbal"
            yield Mistake(("compliance", k), words)
        if one.motor_side in taken:
            words = (
                f"name = {given(one.motor_side)} is that of the motor side of [[compliance]] {k + 1}; choose another"
            )
            yield Mistake(("gimbal", taken[one.motor_side], "name"), words)


def _with_stiffness(platform: Platform) -> Platform:
    """Return the platform with the stiffness of drives of which the frequency is given."""
    if all(one.frequency is None for one in platform.compliances):
        return platform
    drives = [
        one
        if one.frequency is None
        else replaced(one, {"stiffness": carried_inertia(platform, one.gimbal) * one.frequency**2, "frequency": None})
        for one in platform.compliances
    ]
    return replaced(platform, {"compliances": tuple(drives)})


def _with_inertias(parts: dict[str, Any]) -> dict[str, Any]:
    """Return the arguments of a platform whose servos have the inertia that they turn, where none is given."""
    if all(one.inertia is not None for one in parts.get("servos", ())):
        return parts
    rigid = with_rigid_drives(Platform(**parts | {"servos": ()}))
    turned = {one.gimbal: carried_inertia(rigid, one.gimbal) for one in parts["servos"]}
    for one in rigid.motors:
        if one.gimbal in turned:
            turned[one.gimbal] += one.gear**2 * one.rotor_inertia
    servos = tuple(replaced(one, {"inertia": one.inertia or turned[one.gimbal]}) for one in parts["servos"])
    return parts | {"servos": servos}


def _axis_by_axis(data: Mapping[str, Any]) -> dict[str, Any]:
    """Return a plant whose sensors with ``axis = "all"`` are three each, about the axes of the body: name + 1, 2, 3."""
    out = dict(data)
    for kind in ("rate_sensor", "attitude_sensor"):
        tables = out.get(kind)
        if not isinstance(tables, list):
            continue
        first, others = [], []
        for table in tables:
            if not (isinstance(table, dict) and table.get("axis") == "all"):
                first.append(table)
                continue
            named = isinstance(table.get("name"), str)
            axes = ([1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0])
            three = [{**table, "axis": axis} for axis in axes]
            if named:
                three = [one | {"name": f"{table['name']}{k}"} for k, one in enumerate(three, 1)]
            # The others behind all tables of the file, so that a mistake is found in the table that has it.
            first.append(three[0])
            others += three[1:]
        out[kind] = [*first, *others]
    return out


def _tree_mistakes(parts: Mapping[str, Any]) -> list[Mistake]:
    """Return what is wrong with the bodies of a platform, of which `parts` are the arguments."""
    root, gimbals = parts["root_name"], parts.get("gimbals", ())
    words = f"name = {given(root)} is the name of the root already; choose another"
    roots = [Mistake(("gimbal", k, "name"), words) for k, one in enumerate(gimbals) if one.name == root]
    return [*roots, *_references(parts, root, [one.name for one in gimbals]), *_circles(root, gimbals)]


def _references(parts: Mapping[str, Any], root: str, gimbals: list[str]) -> Iterator[Mistake]:
    """Yield the names of bodies that are not there; what acts or measures on a gimbal may name a motor side."""
    turning = [*gimbals, *(one.motor_side for one in parts.get("compliances", ()))]
    for table, of in shape(Platform).keys.items():
        if not isinstance(of.holds, Shape) or not isinstance(of.holds.make, type):
            continue
        part = parts.get(of.field)
        places: list[tuple[Path, Any]] = [((table, k), one) for k, one in enumerate(part or ())] if of.array else []
        if part is not None and of.array is None:
            places = [((table,), part)]
        for path, one in places:
            for key, refers in references(of.holds.make):
                own = gimbals if of.holds.make in (Compliance, Servo) else turning
                name, known = getattr(one, key), [root, *gimbals] if refers.root else own
                if name is not None and name not in known:
                    hint = f" ({refers.hint})" if refers.hint and name == root else ""
                    words = f"the name of {'the root or a gimbal' if refers.root else 'a gimbal'}{hint}"
                    yield from at(path, [wrong(one, key, words, f"; {suggestion(name, known)}")])


def _circles(root: str, gimbals: tuple[Gimbal, ...]) -> Iterator[Mistake]:
    parent = {one.name: one.parent for one in gimbals if one.name != root}
    reported: set[str] = set()
    for k, one in enumerate(gimbals):
        chain = [one.name]
        while (above := parent.get(chain[-1])) is not None and above not in chain:
            chain.append(above)
        # A gimbal that only hangs on a cycle is not part of it.
        if above == chain[0] and above not in reported:
            reported.update(chain)
            cycle = " -> ".join(given(name) for name in [*chain, above])
            words = f"parent = {given(one.parent)} closes a ring of parents, {cycle}; let the chain end at the root"
            yield Mistake(("gimbal", k, "parent"), words)


def _other_units(platform: Platform) -> Iterator[Mistake]:
    """Yield masses, inertias and lengths that no body has together: they are in other units than kg, kg m² and m.

    Of all bodies of a density a ball has the least inertia for its mass. A root that is held may have any numbers.
    """
    sides = platform.loads  # their joints are those of their loads
    for b, body in enumerate(platform.bodies):
        if not body.mass or (b == 0 and platform.mode != "floating"):
            continue
        name = (platform.root_name, *platform.gimbal_names)[b]
        path: Path = ("gimbal", b - 1) if b else ("root",)
        spun = [r for r in platform.rotors if r.carrier == name and not r.mass]  # the carrier's mass has theirs
        moments = np.trace(body.inertia) + sum(r.axial_inertia + 2.0 * r.transverse_inertia for r in spun)
        gyration = math.sqrt(0.5 * moments / body.mass)
        density = body.mass / (4.0 / 3.0 * math.pi * (math.sqrt(5.0 / 3.0) * gyration) ** 3)
        units = "masses are in kg, lengths in m, inertias in kg m2 about the centre of mass"
        if not _THINNEST <= density <= _DENSEST:
            words = f"{body.mass:.4g} kg with this inertia are a ball of {density:.1g} kg/m3, as no body is"
            yield Mistake((*path, "mass"), f"mass: {words}; {units}")
            continue
        carried = [k for k, one in enumerate(platform.gimbals) if one.parent == name and one.name not in sides]
        joints: dict[Path, FloatArray] = {(*path, "centre"): np.zeros(3)}
        joints |= {("gimbal", k, "origin"): platform.gimbals[k].origin for k in carried}
        for place, joint in joints.items() if b else ():
            far = float(np.linalg.norm(joint - body.centre))
            if far > _FARTHEST * gyration:
                words = f"{far:.4g} m from the centre of mass of {name!r} are {far / gyration:.0f} radii of gyration"
                yield Mistake(place, f"{place[-1]}: {words}, {gyration:.2g} m; {units}")


def _masses(platform: Platform, data: Mapping[str, Any]) -> Iterator[Mistake]:
    """Judge what the root's mode needs of masses, and where a body needs one."""
    root = data["root"]
    yield from at(("root",), mass_misfits(root, "centre", "the root's centre of mass from its origin"))
    floating = platform.mode == "floating"
    needs = 'the key "mass" is missing; a floating root needs mass and centre of itself and of every gimbal'
    if floating and not platform.root_mass:
        yield Mistake(("root", "mass"), needs)
    for k, one in enumerate(platform.gimbals):
        if one.name in platform.loads:
            continue
        if floating and not one.mass:
            yield Mistake(("gimbal", k, "mass"), needs)
        elif not one.mass and _leaves_origin(platform, one):
            words = "its joint is not at the root's origin, where a body without mass has to turn; give mass and centre"
            yield Mistake(("gimbal", k), words)
    for kind, parts in (("unbalance", platform.unbalances), ("erection", platform.erections)):
        if floating and parts:
            has = {"unbalance": "centre and mass of a body say where it is", "erection": "leave it out"}[kind]
            words = f"no specific force acts in a root that floats freely; {has}"
            yield Mistake((kind, 0), words)
    if floating and platform.specific_force.any():
        words = "specific_force has no effect on a floating root, whose acceleration follows from the forces"
        yield Mistake(("root", "specific_force"), f"{words}; leave it out")
    for k, torquer in enumerate(platform.torquers):
        if platform.mode == "held" and torquer.root_axis is not None:
            words = f'root_axis = {torquer.root_axis} turns the root, which mode = "held" holds; take "pivot" or'
            yield Mistake(("torquer", k, "root_axis"), f'{words} "floating", or leave the torquer out')


def _leaves_origin(platform: Platform, gimbal: Gimbal) -> bool:
    """Whether a gimbal's joint is off the root's origin at some angles of the gimbals that carry it."""
    parents = {one.name: one for one in platform.gimbals}
    joint, size = gimbal.origin, float(np.linalg.norm(gimbal.origin))
    while (above := parents.get(gimbal.parent)) is not None:
        # What a gimbal turns cannot be made up for further out, at all angles, but along its axis.
        if np.linalg.norm(np.cross(joint, above.axis)) > _NORMAL * size:
            return True
        gimbal, joint, size = above, joint + above.origin, size + float(np.linalg.norm(above.origin))
    return bool(np.linalg.norm(joint) > _NORMAL * size)


def _relative_rates(platform: Platform) -> Iterator[Mistake]:
    """Yield sensors of a body's rate against its parent that have no parent, or read nothing of it."""
    for k, one in enumerate(platform.rate_sensors):
        if one.frame != "parent" or one.body is None or one.axis is None:
            continue
        if one.body == platform.root_name:
            words = f'frame = "parent" needs a gimbal: {given(one.body)} is the root; leave it out, or measure a gimbal'
            yield Mistake(("rate_sensor", k, "frame"), words)
            continue
        axis = platform.gimbals[platform.gimbal(one.body)].axis
        if abs(float(axis @ one.axis)) < _NORMAL:
            words = (
                f"axis: gimbal {given(one.body)} turns about {given(axis.tolist())} against its parent, and "
                f"{given(one.axis.tolist())} is normal to that: the reading would be 0; measure along that axis"
            )
            yield Mistake(("rate_sensor", k, "axis"), words)


def _line_of_sight(platform: Platform) -> Iterator[Mistake]:
    """Judge whether any gimbal can turn the line of sight."""
    sight = platform.line_of_sight
    if sight is None:
        return
    axes, body = [], platform.body(sight.body)
    while body:
        axes.append(platform.gimbals[body - 1].axis)
        body = 1 + int(platform.parents[body - 1])
    if axes and all(np.linalg.norm(np.cross(one, sight.direction)) < _NORMAL for one in axes):
        words = (
            f"direction = {given(sight.direction.tolist())} is parallel to the axis of every gimbal that carries it: "
            "none of them turns the line of sight; choose a direction normal to the axis of the inner gimbal"
        )
        yield Mistake(("line_of_sight", "direction"), words)


def _modes(platform: Platform) -> Iterator[Mistake]:
    """Yield modes in which nothing takes part that the platform has."""
    known = [*(one.name for one in platform.torquers), *(one.name for one in platform.sensors)]
    known += LOS_ANGLES if platform.line_of_sight is not None else ()
    torquers = [one.name for one in platform.torquers]
    for k, mode in enumerate(platform.modes):
        words = "torquer, sensor or line-of-sight angle of the plant"
        yield from at(("mode", k), strange("participation", mode.participation, words, known))
        yield from at(("mode", k), strange("joints", mode.joints, "gimbal of the plant", platform.gimbal_names))
        if mode.interface != platform.modes[0].interface:
            words = "modes of one plant are all free, or all have their joints locked"
            yield Mistake(("mode", k, "interface"), f"interface = {given(mode.interface)}: {words}; give one kind")
        if mode.interface == "fixed" and (name := next((one for one in mode.participation if one in torquers), None)):
            words = f"torquer {given(name)} does not excite a mode whose joints are locked; give joints in its place"
            yield Mistake(("mode", k, "participation"), f"participation: {words}")
        if platform.mode == "floating" and mode.base_force.any():
            words = "base_force has no effect on a floating root, whose acceleration follows from the forces; "
            yield Mistake(("mode", k, "base_force"), f"{words}leave it out")
    for name in dict.fromkeys(name for mode in platform.modes for name in mode.joints):
        taken = sum(mode.joints.get(name, 0.0) ** 2 for mode in platform.modes)
        if name in platform.gimbal_names and taken >= (whole := carried_inertia(platform, name)):
            words = f"squares of {given(name)} of all modes are {taken:.4g} kg m², and what the gimbal turns has"
            yield Mistake(("mode", 0, "joints"), f"joints: {words} {whole:.4g} kg m²; they have to be less")


def _signals(platform: Platform) -> Iterator[Mistake]:
    """Angles, torques and rates are inputs and outputs of one system: no name twice."""
    of_root, rate = "a torque about a root axis", "a platform rate"
    taken = dict.fromkeys(OMEGA_NAMES, rate) | dict.fromkeys(ROOT_TORQUE_NAMES, of_root)
    for path, key, name, default in _signal_names(platform):
        own = name == default and taken.get(name) in (of_root, rate) and path[0] != "gimbal"
        what = f"the default name {given(name)}" if name == default else f"{key} = {given(name)}"
        where = path if name == default else (*path, key)
        if "." in name:
            yield Mistake(where, f"{what} has a full stop, which no signal may have; choose a name without one")
        elif name in taken and not own:
            yield Mistake(where, f"{what} is the name of {taken[name]} already; choose another")
        else:
            taken[name] = f"the {_SIGNALS.get(str(path[0]), 'reading')} of [[{path[0]}]] {int(path[1]) + 1}"


def _signal_names(platform: Platform) -> Iterator[tuple[Path, str, str, str]]:
    """Yield the path of each part, its key for the name, the name, and what it is by default."""
    for k, one in enumerate(platform.gimbals):
        yield ("gimbal", k), "angle", one.angle, default_angle(one.name)
    for k, mode in enumerate(platform.modes):
        yield ("mode", k), "name", mode.name, ""
    for k, torquer in enumerate(platform.torquers):
        yield ("torquer", k), "name", torquer.name, default_torquer(torquer.gimbal, torquer.root_axis)
    for kind, sensors in sensor_tables().items():
        for k, sensor in enumerate(getattr(platform, sensors)):
            if name := shape(type(sensor)).keys.get("name"):  # a pick-off has that of its angle
                yield (kind, k), "name", sensor.name, "" if name.needed else next(iter(sensor.signals(platform)))
