"""What the loops of a plant are for, by its bodies, rotors and sensors."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np

from platform_ctrl.common.values import FloatArray, value
from platform_ctrl.design.cases import subsystems_over
from platform_ctrl.job.methods import LoopKind
from platform_ctrl.mechanics.linearisation import LinearModel, linearise
from platform_ctrl.plant.platform import Platform
from platform_ctrl.plant.sensors import AttitudeSensor, RateSensor

# Rate of the root about each axis, rad/s, at which subsystems are looked for, and how many: both ends, as in a job.
_RATE, _RATES = 0.1, 2
# Cosine between axes below which one does not see the other.
_ACROSS = 1e-6


@value
class PlannedLoop:
    """A loop that a plant needs."""

    kind: LoopKind
    gimbals: tuple[str, ...] = ()
    sensors: tuple[str, ...] = ()  # Of rate and pointing loops; none: the pick-offs of its gimbals
    torquers: tuple[str, ...] = ()  # None: those on its gimbals
    # What its sensors measure: "base": against the body that carries the gimbals; "inertial"; "gyro": the float of an
    # integrating gyro
    against: str = "base"

    @property
    def still(self) -> bool:
        """Whether it holds a body still while the base moves."""
        return self.against != "base"


def planned_loops(platform: Platform) -> tuple[PlannedLoop, ...]:
    """Return the loops that a plant is for, at rest and while the root turns about any axis.

    Inertial sensors on a gimballed body are there for a rate loop, or a pointing loop where they measure angles alone.
    Of the other subsystems those with gyros are caged, except an integrating gyro, which points what carries it; those
    without are pointed by their pick-offs.
    """
    model = linearise(platform)
    out = list(_inertial_loops(platform))
    taken = {name for loop in out for name in loop.gimbals}
    for gimbals in subsystems_over(platform, np.full(3, _RATE), _RATES):
        if taken.isdisjoint(gimbals):
            out.append(_own_loop(platform, model, gimbals))
    if any(loop.kind == "caging" for loop in out) and not taken and _shows_its_turn(platform, model):
        out.append(PlannedLoop(kind="stabilisation"))
    return tuple(out)


def _own_loop(platform: Platform, model: LinearModel, gimbals: tuple[str, ...]) -> PlannedLoop:
    gyro = _integrating_gyro(platform, model, gimbals)
    if gyro is not None:
        carrier, floating = gyro
        torquer = next((t.name for t in platform.torquers if t.gimbal == carrier), f"Q{carrier}")
        angle = platform.angle_names[platform.gimbal(floating)]
        return PlannedLoop(
            kind="pointing", gimbals=(carrier, floating), sensors=(angle,), torquers=(torquer,), against="gyro"
        )
    spinning = any(rotor.carrier in gimbals and rotor.spin for rotor in platform.rotors)
    if spinning:
        return PlannedLoop(kind="caging", gimbals=gimbals)
    angles = tuple(platform.angle_names[platform.gimbal(name)] for name in gimbals)
    return PlannedLoop(kind="pointing", gimbals=gimbals, sensors=angles)


def _integrating_gyro(platform: Platform, model: LinearModel, gimbals: tuple[str, ...]) -> tuple[str, str] | None:
    """Return a gimbal and the float that it carries whose fluid damps nutation out; None without."""
    if len(gimbals) != 2:
        return None
    for floating, carrier in (gimbals, gimbals[::-1]):
        k, i = platform.gimbal(floating), platform.gimbal(carrier)
        if platform.gimbals[k].parent != carrier or not any(r.carrier == floating for r in platform.rotors):
            continue
        damping = sum(one.viscous for one in platform.frictions if one.gimbal == floating)
        nutation = abs(model.G[k, i]) / np.sqrt(model.M[k, k] * model.M[i, i])
        if damping / model.M[k, k] > 2.0 * nutation > 0.0:
            return carrier, floating
    return None


def _shows_its_turn(platform: Platform, model: LinearModel) -> bool:
    """Whether the torques of caged gyros show the platform's rate about all axes, and torquers turn it about all."""
    from platform_ctrl.design.classical.stabilisation import rate_estimate
    from platform_ctrl.errors import DesignError

    if not {1, 2, 3} <= {torquer.root_axis for torquer in platform.torquers}:
        return False
    try:
        rate_estimate(model)
    except DesignError:
        return False
    return True


def _inertial_loops(platform: Platform) -> Iterator[PlannedLoop]:
    """Walk a loop for every branch of gimbals that carries inertial sensors."""
    rates = [one for one in platform.rate_sensors if one.body is not None and one.frame == "inertial"]
    for top in [gimbal.name for gimbal in platform.gimbals if gimbal.parent == platform.root_name]:
        for kind, sensors in (("rate", rates), ("pointing", list(platform.attitude_sensors))):
            found = _seen(platform, top, sensors)
            if found is not None:
                gimbals, names = found
                yield PlannedLoop(
                    kind="rate" if kind == "rate" else "pointing", gimbals=gimbals, sensors=names, against="inertial"
                )
                break


def _seen(
    platform: Platform, top: str, sensors: Sequence[RateSensor | AttitudeSensor]
) -> tuple[tuple[str, ...], tuple[str, ...]] | None:
    """Return gimbals of a branch, and as many sensors on it that show the rate of each; None without any.

    Sensors on the body of the line of sight come first, there those across it, then those on the innermost bodies; of
    gimbals the innermost.
    """
    sight = platform.line_of_sight
    paths = {sensor.name: path_to(platform, sensor.body or platform.root_name) for sensor in sensors}
    own = [sensor for sensor in sensors if top in paths[sensor.name]]

    def place(sensor: RateSensor | AttitudeSensor) -> tuple[bool, bool, int]:
        looking = sight is not None and sensor.body == sight.body
        along = sight is not None and looking and abs(float(_axis(sensor) @ sight.direction)) > _ACROSS
        return not looking, along, -len(paths[sensor.name])

    gimbals = [gimbal.name for gimbal in platform.gimbals]
    rows: list[FloatArray] = []
    chosen: list[str] = []
    for sensor in sorted(own, key=place):
        row = sensing_row(platform, sensor)
        if np.linalg.matrix_rank(np.array([*rows, row]), tol=_ACROSS) > len(rows):
            rows.append(row)
            chosen.append(sensor.name)
    columns: list[int] = []
    for k in reversed(range(len(gimbals))):
        if rows and np.linalg.matrix_rank(np.array(rows)[:, [*columns, k]], tol=_ACROSS) > len(columns):
            columns.append(k)
    if not columns:
        return None
    return tuple(gimbals[k] for k in sorted(columns)), tuple(sorted(chosen, key=[s.name for s in sensors].index))


def path_to(platform: Platform, body: str) -> tuple[str, ...]:
    """Return the gimbals between the root and a body, the body among them, the innermost first."""
    parents = {gimbal.name: gimbal.parent for gimbal in platform.gimbals}
    out = []
    while body in parents:
        out.append(body)
        body = parents[body]
    return tuple(out)


def sensing_row(platform: Platform, sensor: RateSensor | AttitudeSensor) -> FloatArray:
    """Return what a sensor on a body shows of the rate of every gimbal at zero angles, (n,)."""
    path = path_to(platform, sensor.body or platform.root_name)
    return np.array([gimbal.axis @ _axis(sensor) if gimbal.name in path else 0.0 for gimbal in platform.gimbals])


def _axis(sensor: RateSensor | AttitudeSensor) -> FloatArray:
    assert sensor.axis is not None, "a sensor on a body has an axis"
    return sensor.axis


def disturbing_axes(platform: Platform, loop: PlannedLoop) -> tuple[int, ...]:
    """Return the root axes, 1 to 3, about which a motion of the base disturbs what the loop holds still.

    About these the loop's gimbals have to turn against the base, and friction takes the body along.
    """
    names = loop.gimbals[:1] if loop.against == "gyro" else loop.gimbals
    axes = [platform.gimbals[platform.gimbal(name)].axis for name in names]
    if platform.line_of_sight is not None:
        along = platform.line_of_sight.direction
        across = [axis for axis in axes if np.linalg.norm(np.cross(axis, along)) > _ACROSS]
        axes = across or axes
    return tuple(int(k) + 1 for k in np.flatnonzero(np.abs(axes).max(axis=0) > _ACROSS))
