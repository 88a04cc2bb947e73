"""Readings of body sensors in joint axes: turned by the inverse of their axes' Jacobian at the measured gimbal angles.

Joint rates q̇ show in the reading of a sensor about the axis s of body b as Σ J_j q̇_j, J_j = (R_b s) · a_j, of the
gimbals j between the root and b. With a sensor for each of the loop's gimbals what the loop reads is

    y_r = (JᵀJ + max(ε² − det² J, 0) 1)⁻¹ Jᵀ y,        ε = |det J(0)| / limit,

J⁻¹ y where |det J| ≥ ε. Nearer to the keyhole a motion that the sensors hardly show counts less, down to nothing where
J is singular; what they show well stays (damped least squares: Y. Nakamura, H. Hanafusa, J. Dyn. Sys., Meas., Control
108, 1986). Of rates against inertial space, y_r is the inertial rate in joint axes: zero while the bodies stand still.

Where sensors of the root show its rate, W y_b, T W y_b is subtracted from y first: rows of T are the sensors' axes
turned to the root's. y_r is then the rate of the joints against their parents.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import field
from typing import Any

import numpy as np

from platform_ctrl.common.values import FloatArray, read_only, replaced, value
from platform_ctrl.errors import ArgumentError
from platform_ctrl.plant.mistakes import Misfit, useless
from platform_ctrl.plant.platform import OMEGA_NAMES, Platform
from platform_ctrl.plant.sensors import Sensor

# Gimbals of a loop at most, and the least |det J| at zero angles that does not count as singular.
MOST_AXES, _SINGULAR = 3, 1e-6
# What a verdict says near a keyhole.
KEYHOLE = "keyhole: the gain of resolved readings is limited"


@value
class Resolver:
    """What turns the readings of a loop's sensors to the axes of its gimbals.

    Attributes
    ----------
    names
        Of the p resolved readings, in the order of `gimbals`.
    sensors, gimbals, encoders
        Names of p sensors, of p gimbals, and of the e sensors of the angles on which J depends.
    turned
        Indices of the gimbals (e,) whose angles the encoders measure.
    bias, scale : (e,)
        The encoders' constant errors, rad, and scale factors.
    limit, least
        Largest gain against that at the angles zero, and the |det J| at which it is reached; dimensionless.
    paths
        Of each sensor its axis (3,), in body axes, and the gimbals from its body towards the root: the axis (3,) of
        each, its column of J or −1, the place of its encoder or −1 where its angle does not count.
    base
        Names of the b sensors of the root's rate whose share is subtracted.
    of_base : (3, b)
        W, from their readings to the rate about the root's axes.
    """

    names: tuple[str, ...]
    sensors: tuple[str, ...]
    gimbals: tuple[str, ...]
    encoders: tuple[str, ...]
    turned: tuple[int, ...]
    bias: FloatArray
    scale: FloatArray
    limit: float
    least: float
    paths: tuple[tuple[FloatArray, tuple[tuple[FloatArray, int, int], ...]], ...]
    base: tuple[str, ...] = ()
    of_base: FloatArray = field(default_factory=lambda: read_only(np.zeros((3, 0))))

    @property
    def read(self) -> tuple[str, ...]:
        """Names of the p sensors, then of those of the root's rate."""
        return (*self.sensors, *self.base)

    def jacobian(self, cosines: Any, sines: Any) -> tuple[Any, Any]:
        """Return J (p, p) and T W (p, b), dimensionless, from cosines and sines of the encoders' angles, or symbols."""
        kind = np.asarray([*cosines, 0.0]).dtype
        rows, turned = np.zeros((len(self.sensors), len(self.gimbals)), kind), np.zeros((len(self.sensors), 3), kind)
        for k, (row, (axis, steps)) in enumerate(zip(rows, self.paths, strict=True)):
            for own, column, encoder in steps:
                along = axis @ own
                if column >= 0:
                    row[column] = along
                if encoder >= 0:
                    c, s = cosines[encoder], sines[encoder]
                    axis = c * axis + s * np.cross(own, axis) + (1 - c) * along * own
            turned[k] = axis
        return rows, turned @ self.of_base

    def of(self, names: Iterable[str]) -> tuple[str, ...]:
        """Return names of sensors with those of the resolved readings in the place of theirs."""
        turned = dict(zip(self.sensors, self.names, strict=True))
        return tuple(turned.get(name, name) for name in names)

    def _jacobian_at(self, q: FloatArray, off: FloatArray | float = 0.0) -> tuple[FloatArray, FloatArray]:
        angles = self.scale * q[list(self.turned)] + self.bias + off
        return self.jacobian(np.cos(angles), np.sin(angles))

    def matrix(self, q: FloatArray) -> FloatArray:
        """Return what makes resolved readings of `read` (p, p + b), dimensionless, at gimbal angles q (n,), rad."""
        J, share = self._jacobian_at(q)
        damping = max(self.least**2 - float(np.linalg.det(J)) ** 2, 0.0)
        return np.asarray(
            np.linalg.solve(J.T @ J + damping * np.eye(len(J)), J.T @ np.hstack([np.eye(len(J)), -share]))
        )

    def encoder_noise(self, q: FloatArray, rms: FloatArray, Omega: FloatArray) -> FloatArray:
        """Return what noise of the encoders, `rms` (e,) rad, adds to resolved readings (p, 3 e) while the root turns.

        They subtract its rates, up to `Omega` (3,), rad/s, about wrong axes; in columns that bound them in any sum.
        """
        p = len(self.names)
        if not self.base:
            return np.zeros((p, 0))
        shown = 0.5 * np.sqrt(np.count_nonzero(Omega)) * np.linalg.pinv(self.of_base) * Omega
        off = [self._jacobian_at(q, one)[1] - self._jacobian_at(q, -one)[1] for one in np.diag(rms)]
        return np.asarray(self.matrix(q)[:, :p] @ np.hstack([one @ shown for one in off]))

    def limited(self, q: FloatArray) -> bool:
        """Return whether the gain is limited at gimbal angles q (n,), rad: near the keyhole."""
        return abs(float(np.linalg.det(self._jacobian_at(q)[0]))) < self.least


def resolver(
    platform: Platform, gimbals: Sequence[str], sensors: Sequence[str], limit: float, base: Sequence[str] = ()
) -> Resolver:
    """Return what turns the readings of a loop's sensors to the axes of its gimbals.

    Parameters
    ----------
    platform
        That has the gimbals and the sensors.
    gimbals, sensors
        Of the loop; a gimbal on the motor side of a drive counts as its load.
    limit
        Largest gain against that at the angles zero, >= 1, dimensionless.
    base
        Sensors of the root's rate, whose share is subtracted from the readings.

    Returns
    -------
    Resolver
        With the first pick-off or angle sensor of each gimbal whose angle counts.

    Raises
    ------
    ArgumentError
        The sensors do not show every gimbal's rate, those of the root not what has to be subtracted, or an angle is not
        measured.
    """
    names = tuple(dict.fromkeys(platform.loads.get(name, name) for name in gimbals))
    if not 1 <= len(names) == len(sensors) <= MOST_AXES:
        words = f"resolve = true needs a sensor for each gimbal, {MOST_AXES} at most"
        raise ArgumentError(f"{words}; here are the sensors {', '.join(sensors)} and the gimbals {', '.join(names)}")
    measured = _encoders(platform)
    known = {one.name: one for one in platform.sensors}
    encoders: list[str] = []
    turned: list[int] = []
    paths = []
    for name in sensors:
        sensor: Any = known[name]
        path = _path(platform, name, getattr(sensor, "body", None), getattr(sensor, "frame", "inertial"))
        columns = [names.index(g) if (g := platform.gimbal_names[k]) in names else -1 for k in path]
        if max(columns, default=-1) < 0:
            words = f"{name} is on {sensor.body!r}, which none of the gimbals {', '.join(names)} carries"
            raise ArgumentError(f"{words}; resolve = true needs sensors of bodies that these turn")
        # The angles of this gimbal, and of those nearer to the root, turn sensor and axes alike, but not the root.
        last = len(path) if base else max(k for k, column in enumerate(columns) if column >= 0)
        steps = []
        for k, column in zip(path[: last + 1], columns, strict=False):
            at = -1
            if base or k != path[last]:
                if k not in measured:
                    raise ArgumentError(
                        f"{name} turns with gimbal {platform.gimbal_names[k]!r}, whose angle resolve = true needs and "
                        "no sensor measures; add a [[pickoff]] or [[angle_sensor]] of it to the plant"
                    )
                if measured[k] not in encoders:
                    encoders.append(measured[k])
                    turned.append(k)
                at = encoders.index(measured[k])
            steps.append((read_only(platform.gimbals[k].axis), column, at))
        paths.append((read_only(sensor.axis), tuple(steps)))
    end = "rate" if known[sensors[0]].unit == "rad/s" else "angle"
    angles = [platform.angle_names[platform.gimbal(name)] for name in names]
    made = Resolver(
        names=tuple(f"{angle}_resolved_{end}" for angle in angles),
        sensors=tuple(sensors),
        gimbals=names,
        encoders=tuple(encoders),
        turned=tuple(turned),
        bias=read_only([known[name].bias for name in encoders]),
        scale=read_only([1.0 + known[name].scale_error for name in encoders]),
        limit=limit,
        least=0.0,
        paths=tuple(paths),
        base=tuple(base),
        of_base=read_only(np.eye(3)),
    )
    still = np.ones(len(encoders))
    det = abs(float(np.linalg.det(made.jacobian(still, 0.0 * still)[0])))
    if det < _SINGULAR:
        raise ArgumentError(
            f"at the angles zero {', '.join(sensors)} do not show the rate of each of the gimbals {', '.join(names)}: "
            "two axes are parallel, or one is across all others; choose other sensors"
        )
    any_angles = np.arange(1.0, 1.0 + len(encoders))
    of_base = _of_base(platform, base, made.jacobian(np.cos(any_angles), np.sin(any_angles))[1], end, sensors)
    return replaced(made, {"least": det / limit, "of_base": of_base})


def _of_base(
    platform: Platform, base: Sequence[str], turned: FloatArray, end: str, sensors: Sequence[str]
) -> FloatArray:
    """Return W (3, b), what sensors of the root's rate show of it; `turned` are axes that it has to show."""
    known = {one.name: ideal(one).signals(platform) for one in platform.sensors if one.unit == "rad/s"}
    known = {name: signals for name, signals in known.items() if set(signals) <= set(OMEGA_NAMES)}
    if base and end != "rate":
        raise ArgumentError(f"resolve_base subtracts rates, and {', '.join(sensors)} measure angles; leave it out")
    if unknown := [name for name in base if name not in known]:
        have = f"its rate sensors are {', '.join(known)}" if known else "it has none"
        raise ArgumentError(f"resolve_base: {unknown[0]} is no rate sensor of {platform.root_name!r}; {have}")
    N = np.array([[known[name].get(axis, 0.0) for axis in OMEGA_NAMES] for name in base]).reshape(-1, 3)
    W = np.linalg.pinv(N)
    if base and np.abs(turned - turned @ W @ N).max() > _SINGULAR:
        words = (
            f"resolve_base: {', '.join(base)} do not show the rate of {platform.root_name!r} about every axis to which"
        )
        raise ArgumentError(f"{words} those of {', '.join(sensors)} turn; add rate sensors of it about other axes")
    return read_only(W)


def ideal(sensor: Sensor) -> Sensor:
    """Return a sensor about the axis that it is meant to have."""
    if getattr(sensor, "misalignment", None) is None:
        return sensor
    return replaced(sensor, {"misalignment": None})


def reading_units(platform: Platform, laws: Iterable[Resolver]) -> dict[str, str]:
    """Return the units of all readings by their names: sensors in the plant's order, then resolved ones."""
    out = {sensor.name: sensor.unit for sensor in platform.sensors}
    return out | {name: out[law.sensors[0]] for law in laws for name in law.names}


def resolve_misfits(loop: Mapping[str, Any]) -> Iterator[Misfit]:
    """Yield what is wrong with the keys of a loop that turns its readings, or does not."""
    if not loop.get("resolve"):
        for key in {"resolve_limit", "resolve_base"} & loop.keys():
            yield useless(loop, key, "without resolve = true; add it, or leave the key out")
        return
    for k, design in enumerate(loop["design"]):
        if "feedforward" in design and "resolve_base" in loop:
            words = "readings less the base's motion need none of its rate; leave it or resolve_base out"
            yield ("design", k, "feedforward"), f"feedforward: {words}"
        if "sensors" in design:
            words = "a loop with resolve = true turns the readings of its own sensors; leave the key out"
            yield ("design", k, "sensors"), f"sensors: {words}"


def _path(platform: Platform, name: str, body: str | None, frame: str) -> list[int]:
    """Return the indices of the gimbals from a sensor's body to the root."""
    if body is None or frame != "inertial":
        words = f"{name} measures about an axis of the root or of a joint already"
        raise ArgumentError(f"{words}; resolve = true turns readings of sensors of bodies against inertial space")
    k, out = platform.body(body) - 1, []
    while k >= 0:
        out.append(k)
        k = int(platform.parents[k])
    return out


def _encoders(platform: Platform) -> dict[int, str]:
    """Return the first sensor of the angle of each gimbal that has one, or whose motor side has one, by its index."""
    out: dict[int, str] = {}
    for one in (*platform.pickoffs, *platform.angle_sensors):
        out.setdefault(platform.gimbal(one.gimbal), one.name)
    for load, motor in platform.sides:
        if motor in out:
            out.setdefault(load, out[motor])
    return out
