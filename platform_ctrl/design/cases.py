"""Which plants a loop must control: the nominal one, uncertain parameters, Omega, gimbal angles, friction, faults."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable, Iterator, Sequence
from itertools import combinations, product
from typing import NamedTuple

import numpy as np

from platform_ctrl.analysis.dry_torques import FedFriction
from platform_ctrl.analysis.plant_set import Group
from platform_ctrl.common.arguments import known_name
from platform_ctrl.common.values import FloatArray, replaced, value
from platform_ctrl.job.job import Job
from platform_ctrl.job.resolve import Resolver
from platform_ctrl.mechanics.linearisation import LinearModel, linearise
from platform_ctrl.mechanics.matrices import matrices
from platform_ctrl.mechanics.state_space import subsystems_of_all
from platform_ctrl.plant.flexible import MODE_NUMBERS
from platform_ctrl.plant.platform import Platform

# Steps of the frequency of a mode between the ends of its uncertainty at most, relative.
_STEP = 0.05
# Relative changes of parameters by what they are of and its name.
Changes = dict[str, dict[str, float]]


def changed(platform: Platform, changes: Changes) -> Platform:
    """Return `platform` with other parameters, relative changes by name.

    ``"inertia"`` changes J about the axis of a gimbal alone: what the gimbal's own body gains or loses is a thin disk
    about its axis, so that no other J about a gimbal axis through the same body changes unless the axes are parallel.
    By the name of the root it multiplies all of the root's own. ``"spin"`` changes the L of a rotor; ``"frequency"``,
    ``"damping"`` and ``"participation"`` those of a mode, the first two those of the drive of a gimbal.
    """
    inertia, spin = changes.get("inertia", {}), changes.get("spin", {})
    J = np.diag(matrices(platform).A_star)[3:]
    gimbals = tuple(
        replaced(g, {"inertia": g.inertia + inertia[g.name] * J[k] * np.outer(g.axis, g.axis)})
        if inertia.get(g.name)
        else g
        for k, g in enumerate(platform.gimbals)
    )
    rotors = tuple(
        replaced(r, {"angular_momentum": r.angular_momentum * (1.0 + spin[r.name])}) if spin.get(r.name) else r
        for r in platform.rotors
    )

    def of(name: str) -> dict[str, float]:
        return {what: changes[what][name] for what in MODE_NUMBERS if name in changes.get(what, {})}

    modes = tuple(one.changed(**of(one.name)) for one in platform.modes)
    drives = tuple(one.changed(**of(one.gimbal)) for one in platform.compliances)
    root = platform.root_inertia * (1.0 + inertia.get(platform.root_name, 0.0))
    parts = {"gimbals": gimbals, "rotors": rotors, "modes": modes, "compliances": drives, "root_inertia": root}
    return replaced(platform, parts)


@value
class Case:
    """A plant of the set, linearised at a platform rate and at angles of the gimbals."""

    label: str  # what it is
    group: Group  # what it stands for
    platform: Platform
    Omega: FloatArray  # (3,): rad/s
    torque: FloatArray  # (m,): share of its command that each torquer gives, which a fault leaves
    q: FloatArray | None = None  # (n,): rad; None: zero
    rate: float | None = None  # amplitude of the gimbals' rates for dry friction, rad/s; None: without dry friction
    # (m, f): what drives add in proportion to the f readings of gimbal rates from which they feed friction forward,
    # N m s; None: nothing.
    feedback: FloatArray | None = None


def cases(job: Job, gimbals: tuple[str, ...], torquers: Sequence[str] = (), root: bool = False) -> list[Case]:
    """Return the plants that the loop on `gimbals` with `torquers` must control, the nominal one first.

    Default: the first torquer on each of the gimbals.

    Then every corner of the parameter uncertainty and the samples inside it, the grid of Omega, the gimbal angles with
    the nominal and with the other parameters, and the faults. `root`: whether the root's inertia varies too.
    """
    torquers = torquers or [job.platform.torquer_on(name).name for name in gimbals]
    platform, whole, replace = job.platform, np.ones(len(torquers)), dataclasses.replace
    nominal = Case(label="nominal", group="nominal", platform=platform, Omega=np.zeros(3), torque=whole)
    out = [nominal]
    for label, changes in _varied(job, gimbals, torquers, root):
        out.append(replace(nominal, label=label, group="uncertainty", platform=changed(platform, changes)))
    for rates in _rates(job.Omega, job.Omega_grid):
        label = f"Omega = ({rates[0]:g}, {rates[1]:g}, {rates[2]:g}) rad/s"
        out.append(replace(nominal, label=label, group="Omega", Omega=np.array(rates)))
    varied = [one for one in out if one.group in ("nominal", "uncertainty")]
    for q in job.trims[1:]:
        for one in varied:
            group: Group = "angles" if one.group == "nominal" else "uncertainty"
            label = at_angles(platform, q) if one.group == "nominal" else f"{one.label}, {at_angles(platform, q)}"
            out.append(replace(one, label=label, group=group, q=q))
    slow, weak = job.faults.slow_rotor, job.faults.weak_torquer
    if slow is not None:
        for name in carried(platform, gimbals):
            label, slower = f"rotor {name} at {slow:.0%} of its spin", changed(platform, {"spin": {name: slow - 1.0}})
            out.append(replace(nominal, label=label, group="faults", platform=slower))
    if weak is not None:
        for k, name in enumerate(torquers):
            torque = np.where(np.arange(len(torquers)) == k, weak, 1.0)
            label = f"torquer {name} at {weak:.0%} of its torque"
            out.append(replace(nominal, label=label, group="faults", torque=torque))
    return out


def friction_rate(job: Job) -> float:
    """Return the amplitude of the gimbals' rates for which dry friction counts, rad/s; 0: it does not."""
    return float(np.max(job.Omega)) if job.platform.dry_frictions else 0.0


def with_friction(job: Job, torquers: Sequence[str], sensors: Sequence[str], plants: Sequence[Case]) -> list[Case]:
    """Return plants with dry friction as it acts on gimbals that turn at the largest rate of the platform.

    Feedforward of drives against it, by the rate that `sensors` show, acts as at a rate of that amplitude.
    """
    rate = friction_rate(job)
    if rate == 0.0:
        return []
    gains = _fed(job, torquers, sensors, lambda drive: drive.gain(rate))
    return _rubbing(f"dry friction at {rate:g} rad/s", plants, rate, gains)


def with_feedback(job: Job, torquers: Sequence[str], sensors: Sequence[str], plants: Sequence[Case]) -> list[Case]:
    """Return plants with the steepest feedback of drives that find the rate from `sensors` on the gimbals.

    friction sat(v / friction_rate) lies between no gain and that at v = 0, the bearing's own friction left out.
    """
    back = {law.torquer for law in job.drive_laws if law.feedback}
    steepest = _fed(job, torquers, sensors, lambda drive: drive.friction / drive.friction_rate)
    gains = np.where(np.isin(torquers, list(back))[:, None], steepest, 0.0)
    return _rubbing("friction that is fed forward at rest", plants, None, gains) if gains.any() else []


def _rubbing(words: str, plants: Sequence[Case], rate: float | None, gains: FloatArray) -> list[Case]:
    """Return plants with dry friction at an amplitude of rates and feedback of drives."""
    more = {"group": "friction", "rate": rate, "feedback": gains if gains.any() else None}
    labels = (words if one.group == "nominal" else f"{words}, {one.label}" for one in plants)
    return [replaced(one, {"label": label, **more}) for one, label in zip(plants, labels, strict=True)]


def _fed(job: Job, torquers: Sequence[str], sensors: Sequence[str], gain: Callable[[FedFriction], float]) -> FloatArray:
    """Return the torques (m,) of drives per reading (f,), N m s, by the gain of their feedforward."""
    out = np.zeros((len(torquers), len(sensors)))
    for law in job.drive_laws:
        if law.friction and law.torquer in torquers:
            size = gain(FedFriction(friction=law.friction, friction_rate=law.friction_rate))
            out[torquers.index(law.torquer)] = [size * law.weights.get(name, 0.0) for name in sensors]
    return out


def at_angles(platform: Platform, q: FloatArray) -> str:
    """Return gimbal angles (n,) in words, those alone that are not zero."""
    return ", ".join(f"{name} = {x:g} rad" for name, x in zip(platform.angle_names, q, strict=True) if x)


def near_keyhole(job: Job, laws: Sequence[Resolver]) -> tuple[str, ...]:
    """Return the job's angles, in words, at which the gain of resolved readings is limited."""
    return tuple(at_angles(job.platform, q) for q in job.trims if any(law.limited(q) for law in laws))


class _Width(NamedTuple):
    """A parameter that is uncertain: what it is of, its name, and the half-width of its relative change."""

    of: str
    name: str
    size: float


_LETTERS = {"inertia": "J", "spin": "L", "frequency": "f_", "damping": "ζ_", "participation": "φ_"}


def _varied(job: Job, gimbals: tuple[str, ...], torquers: Sequence[str], root: bool) -> Iterator[tuple[str, Changes]]:
    """Yield the relative changes of parameters: corners of the uncertainty, frequencies of modes, samples inside it."""
    of = job.uncertainty
    widths = [_Width("inertia", name, of.inertia) for name in (*gimbals, *([job.platform.root_name] if root else ()))]
    widths += [_Width("spin", name, of.spin) for name in carried(job.platform, gimbals)]
    widths = [*(one for one in widths if one.size > 0.0), *_of_modes(job, gimbals, torquers)]
    if not widths:
        return
    # Damping and participation of all modes go to their ends together.
    corners = [(one.of, "" if one.of in ("damping", "participation") else one.name) for one in widths]
    for signs in product((-1.0, 1.0), repeat=len(set(corners))):
        at = dict(zip(dict.fromkeys(corners), signs, strict=True))
        yield _moved(widths, [at[one] for one in corners], "+.0%")
    yield from _swept(widths)
    yield from _meeting(job, gimbals, torquers, widths)
    yield from (_moved(widths, place) for place in _samples(job, len(widths)))


def modes_of(job: Job, gimbals: Sequence[str], torquers: Sequence[str]) -> list[str]:
    """Return the names of modes that torquers, joints or the base excite, and of gimbals whose drives give way."""
    platform = job.platform
    drives = (one.gimbal for one in platform.compliances if {one.gimbal, one.motor_side} & {*gimbals})
    return [*(m.name for m in platform.modes if m.excited(list(torquers), gimbals)), *drives]


def _of_modes(job: Job, gimbals: Sequence[str], torquers: Sequence[str]) -> list[_Width]:
    """Return the widths of what is uncertain of these modes and drives."""
    modes = [mode.name for mode in job.platform.modes]
    return [
        _Width(what, name, size)
        for name in modes_of(job, gimbals, torquers)
        for what, size in job.uncertainty.of_mode(name).items()
        if size > 0.0 and (name in modes or what != "participation")
    ]


def _swept(widths: Sequence[_Width], step: float = _STEP) -> Iterator[tuple[str, Changes]]:
    """Yield the changes of each mode over the range of its frequency, where it is least damped and takes part most."""
    others = {"damping": -1.0, "participation": 1.0}
    for mode in (one for one in widths if one.of == "frequency"):
        for place in np.linspace(-1.0, 1.0, 2 * max(math.ceil(mode.size / step), 1) + 1):
            if place:
                yield _moved(widths, [float(place) if one is mode else others.get(one.of, 0.0) for one in widths])


def _meeting(
    job: Job, gimbals: Sequence[str], torquers: Sequence[str], widths: Sequence[_Width]
) -> Iterator[tuple[str, Changes]]:
    """Yield the changes with which two modes stand side by side, at both ends of what their ranges have in common.

    Two modes of opposite sign that a loop makes grow together do so when their frequencies differ by the sum of their
    damping ratios: with frequency shifts ±a of each alone, a² = ζ₁ζ₂ω² at the onset, 2 a apart.
    """
    swinging, names = job.uncertainty.of_mode, modes_of(job, gimbals, torquers)
    found = [(one, swinging(one.name)) for one in job.platform.modes if one.name in names]
    for pair in combinations(found, 2):
        low, high = (
            limit(one.frequency * (1.0 + sign * of["frequency"]) for one, of in pair)
            for limit, sign in ((max, -1.0), (min, 1.0))
        )
        if low > high or not any(of["frequency"] for _, of in pair):
            continue
        apart = max(sum(one.damping * (1.0 - of["damping"]) for one, of in pair), 1e-3)
        ends = ((low, low * (1.0 + apart)), (high, high * (1.0 - apart)))
        for at in (place for end in ends for place in (end, end[::-1])):
            places = {"damping": -1.0, "participation": 1.0}
            for (one, of), hertz in zip(pair, at, strict=True):
                share = (hertz / one.frequency - 1.0) / (of["frequency"] or math.inf)
                places[one.name] = min(max(share, -1.0), 1.0)
            yield _moved(
                widths, [places.get(one.name if one.of == "frequency" else one.of, 0.0) for one in widths], "+.2%"
            )


def _moved(widths: Sequence[_Width], places: Sequence[float], digits: str = "+.1%") -> tuple[str, Changes]:
    """Return the changes of parameters at places of their ranges, in words and as numbers."""
    out: Changes = {}
    words = []
    for one, place in zip(widths, places, strict=True):
        out.setdefault(one.of, {})[one.name] = place * one.size
        words += [f"{_LETTERS[one.of]}{one.name}{place * one.size:{digits}}"] if place else []
    return " ".join(words), out


def swung(job: Job) -> list[tuple[str, Platform]]:
    """Return the platform in words and as it is, and with each mode and drive at the ends of its frequency's range."""
    platform = job.platform
    widths = _of_modes(job, platform.gimbal_names, [one.name for one in platform.torquers])
    return [("", platform), *((label, changed(platform, changes)) for label, changes in _swept(widths, math.inf))]


def subsystems_over(
    platform: Platform, Omega: FloatArray, grid: int, q: FloatArray | None = None
) -> tuple[tuple[str, ...], ...]:
    """Return the groups of gimbals that are coupled at rest or on a grid of platform rates, in the file's order."""
    rates = [(0.0, 0.0, 0.0), *_rates(Omega, grid)]
    return subsystems_of_all([linearise(platform, Omega=rate, q=q) for rate in rates])


def _samples(job: Job, dimension: int) -> list[list[float]]:
    """Return points of the box [-1, 1]: a scrambled Sobol sequence (Owen), the same for the same seed."""
    if job.uncertainty.samples == 0:
        return []
    from scipy.stats import qmc

    points = qmc.Sobol(dimension, scramble=True, seed=np.random.default_rng(job.seed))
    # Drawn by powers of two, for which alone the sequence is balanced.
    drawn = points.random_base2(math.ceil(math.log2(job.uncertainty.samples)))[: job.uncertainty.samples]
    return [[float(entry) for entry in row] for row in 2.0 * drawn - 1.0]


def _rates(Omega: FloatArray, grid: int) -> list[tuple[float, ...]]:
    """Return a grid of platform rates up to `Omega` about each axis, without rest."""
    axes = [np.linspace(-rate, rate, grid) if rate > 0.0 else np.zeros(1) for rate in Omega]
    # An odd grid's middle is 0 up to rounding.
    axes = [np.where(np.abs(axis) < 1e-9 * rate, 0.0, axis) for axis, rate in zip(axes, Omega, strict=True)]
    return [tuple(map(float, rates)) for rates in product(*axes) if any(rates)]


def carried(platform: Platform, gimbals: tuple[str, ...]) -> list[str]:
    """Return the names of the rotors that the gimbals carry."""
    return [r.name for r in platform.rotors if r.carrier in gimbals]


def rows_of(model: LinearModel, gimbals: tuple[str, ...]) -> list[int]:
    """Return the row numbers of the named gimbals, in the loop's order."""
    return [known_name("gimbals", name, model.gimbal_names) for name in gimbals]
