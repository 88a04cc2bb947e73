"""The gimbals, sensors and torquers of a loop, and the directions in which design methods see it."""

from __future__ import annotations

import dataclasses
import itertools
from collections.abc import Sequence

import numpy as np

from platform_ctrl.analysis.plant_set import PlantSet
from platform_ctrl.analysis.system import System, block
from platform_ctrl.common.values import FloatArray, value
from platform_ctrl.design.cases import at_angles, rows_of
from platform_ctrl.errors import ArgumentError, DesignError, InputError
from platform_ctrl.job.job import Job, LoopSpec
from platform_ctrl.job.methods import METHODS
from platform_ctrl.job.resolve import Resolver, resolver
from platform_ctrl.mechanics.linearisation import LinearModel, linearise
from platform_ctrl.mechanics.matrices import inverse_inertia
from platform_ctrl.mechanics.outputs import observed_system
from platform_ctrl.mechanics.state_space import NamedMatrices, free_system, linear_system
from platform_ctrl.plant.drives import Torquer
from platform_ctrl.plant.locking import with_rigid_drives
from platform_ctrl.plant.platform import OMEGA_NAMES, Platform
from platform_ctrl.plant.sensors import LOS_RATES, ROOT_ROTATIONS, Sensor

# Share of their effect at zero angles below which torquers are near a keyhole: 1/cos of the elevation is 10 there.
_KEYHOLE = 0.1
# Ratio of the least to the largest effect of torquers on readings from which on each is seen.
_SEEN = 1e-6
# Frequency at which effects of torquers are judged, over the fastest that springs give the gimbals.
_ABOVE_SPRINGS = 3.0
# Share of the largest gain from torques to the line of sight from which on an output counts as moved.
_MOVES = 1e-6
# A pair whose h is this small against the largest is not gyroscopic.
_NO_GYRO = 1e-9


@value
class LoopSignals:
    """The gimbals, sensors and torquers of a loop."""

    gimbals: tuple[str, ...]  # names, in the loop's order
    # torquers, sensors: of the loop, those sensors first that it keeps at zero or at commands, last the `base` ones
    # whose readings resolvers alone need.
    torquers: tuple[Torquer, ...]
    sensors: tuple[Sensor, ...]
    kept: int  # number of the first
    base: int = 0  # number of the last
    sight: tuple[str, ...] = ()  # outputs of the line of sight that its torquers move
    # held: whether gimbals that other loops turn are held; else the loop's are whole subsystems, perhaps with others
    # that no loop turns. passive: names of gimbals that no loop turns and that take part.
    held: bool = False
    passive: tuple[str, ...] = ()
    # Whether the loop reads the motion of a floating root, which is a part of its plants then: no torque from outside
    # acts on the whole.
    free: bool = False
    # Sensors from which drives of its torquers find the rates by which they feed friction forward: of gimbal rates, a
    # feedback, and where dry friction counts of the root.
    fed: tuple[Sensor, ...] = ()
    resolvers: tuple[Resolver, ...] = ()  # what turns readings to the axes of gimbals

    @property
    def order(self) -> int:
        """Which derivative of what is kept a torque shows in: 1 of rates, 2 of angles."""
        return self.orders[0]

    @property
    def orders(self) -> list[int]:
        """The same of every reading."""
        return [1 if sensor.unit == "rad/s" else 2 for sensor in self.sensors]

    @property
    def readings(self) -> tuple[str, ...]:
        """Names of what controllers read: the sensors, or resolved readings in the place of theirs."""
        names = tuple(one.name for one in self.sensors)[: len(self.sensors) - self.base]
        for law in self.resolvers:
            names = law.of(names)
        return names

    def turning(self, q: FloatArray) -> FloatArray:
        """Return what makes `readings` of the sensors' readings (p, p + base) at gimbal angles (n,), rad."""
        names = [one.name for one in self.sensors]
        out = np.eye(len(names) - self.base, len(names))
        for law in self.resolvers:
            at = [names.index(name) for name in law.read]
            out[np.ix_(at[: len(law.names)], at)] = law.matrix(q)
        return out

    def encoder_noise(self, job: Job, q: FloatArray, every: int) -> FloatArray:
        """Return what noise of encoders adds to `readings` at gimbal angles (n,), rad: unit sources, (p, i)."""
        known, parts = {one.name: one for one in job.platform.sensors}, [np.zeros((len(self.readings), 0))]
        for law in self.resolvers:
            rms = np.array([known[name].sampled_noise(job.sampling.period, every) for name in law.encoders])
            added = law.encoder_noise(q, rms, job.Omega)
            parts.append(np.zeros((len(self.readings), added.shape[1])))
            parts[-1][[self.readings.index(name) for name in law.names]] = added
        return np.hstack(parts)


def loop_signals(platform: Platform, spec: LoopSpec) -> LoopSignals:
    """Return the gimbals, sensors and torquers of a loop: a caging loop has one of each on every gimbal."""
    own = tuple(platform.torquer_on(name) for name in spec.gimbals) if not spec.torquers else ()
    if spec.kind == "caging":
        pickoffs = tuple(platform.pickoff_on(name) for name in spec.gimbals)
        return LoopSignals(gimbals=spec.gimbals, torquers=own, sensors=pickoffs, kept=len(pickoffs))
    sensors, kept = {sensor.name: sensor for sensor in platform.sensors}, spec.kept(platform)
    torquers = {torquer.name: torquer for torquer in platform.torquers}
    read = dict.fromkeys((*kept, *spec.sensors))
    base = [name for name in spec.resolve_base if name not in read]
    law = resolver(platform, spec.gimbals, kept, spec.resolve_limit, spec.resolve_base) if spec.resolve else None
    out = LoopSignals(
        gimbals=spec.gimbals,
        torquers=tuple(torquers[name] for name in spec.torquers) or own,
        sensors=tuple(sensors[name] for name in (*read, *base)),
        kept=len(kept),
        base=len(base),
        held=True,
        free=spec.moves_root(platform),
        resolvers=() if law is None else (law,),
    )
    return dataclasses.replace(out, sight=_moved_sight(platform, out))


def bare_system(model: LinearModel, signals: LoopSignals, currents: bool = False) -> NamedMatrices:
    """Return the linear model of a loop's gimbals and of those that no loop turns, currents of motors in it or not."""
    gimbals = [*signals.gimbals, *signals.passive]
    if signals.free:
        return free_system(model, gimbals, isolated=True, currents=currents)
    # With the specific force, through which gravity acts on a root that turns: see `tilting`.
    return linear_system(model, gimbals, True, others="held" if signals.held else "coupled", currents=currents)


def _moved_sight(platform: Platform, signals: LoopSignals) -> tuple[str, ...]:
    """Return the rates across the line of sight that the loop's torquers move, at the angles zero."""
    if platform.line_of_sight is None or signals.free:  # which no prescribed rate disturbs
        return ()
    model, signals = _tied(linearise(platform), signals)
    system = observed_system(linear_system(model, signals.gimbals, others="held"), model.platform, LOS_RATES[:2])
    gain = np.abs(system.C @ system.B[:, [system.input_labels.index(t.name) for t in signals.torquers]]).max(axis=1)
    largest = gain.max(initial=0.0)
    return tuple(name for name, one in zip(LOS_RATES, gain, strict=False) if one > _MOVES * largest > 0.0)


@value
class Channels:
    """Gyroscopic pairs and inertial directions of some gimbals."""

    # (n, n): orthogonal; rows are directions: y = basis @ q. First the pairs, then the inertial directions.
    basis: FloatArray
    momenta: FloatArray  # (pairs,): h of each pair, N m s
    inertias: FloatArray  # (n,): inertia in each direction, kg m²
    spins: FloatArray  # (rotors,): spin of the rotors that the gimbals carry, rad/s, without those that stand still
    order: int = 2  # 2 where the inertial directions measure angles, 1 where rates: a torque shows in that derivative
    # (n, p): of loops that read other sensors than pick-offs: from their readings to the directions. Design methods
    # then get plants whose outputs are the directions already; None: they take the gimbals' angles there by `basis`.
    # Methods for any sensors have further rows: readings beside those that the loop keeps.
    sense: FloatArray | None = None
    # (n,): viscous friction, N m s, and stiffness, N m/rad, against motion in each direction; None: not needed.
    damping: FloatArray | None = None
    stiffness: FloatArray | None = None
    noise: FloatArray | None = None  # (n,): rms of a sample of each direction, from its sensors; None: not known

    @property
    def inertial(self) -> int:
        """Number of directions without gyroscopic action."""
        return len(self.basis) - 2 * len(self.momenta)

    def turned(self, readings: int) -> FloatArray:
        """Return `basis` for so many outputs of `seen` plants, of which those behind the directions stay themselves."""
        further = readings - len(self.basis)
        return block([[self.basis, 0], [0, np.eye(further)]]) if further else self.basis

    def shown(self, plants: PlantSet) -> FloatArray:
        """Return what outputs of `seen` plants show of a motion that is 1 in the directions: units of the others."""
        n, k = len(self.basis), int(np.abs(plants.frequency - plants.nutation).argmin())
        size = np.linalg.norm(plants.response[0, k], axis=1)
        return np.append(np.ones(n), size[n:] / np.linalg.norm(size[:n]))

    def seen(self, plants: PlantSet) -> PlantSet:
        """Return plants as design methods see them: their outputs are the directions where the loop has `sense`."""
        return plants if self.sense is None else plants.in_directions(self.sense)

    def of_readings(self, K: System) -> System:
        """Return a controller of `seen` plants as one of the loop's readings."""
        return K if self.sense is None else K._replace(B=K.B @ self.sense, D=K.D @ self.sense)


def channels(model: LinearModel, rows: list[int]) -> Channels:
    """Return the pairs and inertial directions of the gimbals in `rows`."""
    from scipy.linalg import schur

    part = np.ix_(rows, rows)
    carriers = {model.gimbal_names[k] for k in rows}
    M, G = model.M[part], model.G[part]
    block, vectors = schur(0.5 * (G - G.T), output="real")
    largest = np.abs(G).max(initial=0.0)
    pairs: list[tuple[float, FloatArray, FloatArray]] = []
    single: list[FloatArray] = []
    k = 0
    while k < len(rows):
        h = float(block[k, k + 1]) if k + 1 < len(rows) else 0.0
        if abs(h) > _NO_GYRO * largest and largest > 0.0:
            pairs.append((abs(h), *_oriented(h, vectors[:, k], vectors[:, k + 1])))
            k += 2
        else:
            own = vectors[:, k]
            single.append(own if own[np.abs(own).argmax()] > 0.0 else -own)
            k += 1
    pairs.sort(key=lambda pair: -pair[0])
    basis = np.array([direction for _, first, second in pairs for direction in (first, second)] + single)
    return Channels(
        basis=basis,
        momenta=np.array([h for h, _, _ in pairs]),
        inertias=np.einsum("ki,ij,kj->k", basis, M, basis),
        spins=np.array([abs(r.spin) for r in model.platform.rotors if r.carrier in carriers and r.spin != 0.0]),
    )


def _oriented(h: float, first: FloatArray, second: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Turn a pair within its plane so that it lies along the gimbal axes where it can, with h > 0."""
    plane = np.array([first, second])
    # The gimbal axis that lies in the plane best becomes the first direction.
    along = plane.T @ plane
    lead = int(np.argmax(np.diag(along)))
    first_new = along[:, lead] / np.linalg.norm(along[:, lead])
    rotated = np.array([plane @ first_new])
    second_new = np.array([-rotated[0, 1], rotated[0, 0]]) @ plane
    return (first_new, second_new) if h > 0.0 else (first_new, -second_new)


def loop_channels(model: LinearModel, signals: LoopSignals, period: float, any_sensors: bool = True) -> Channels:
    """Return the directions in which design methods see a loop.

    Of a loop that reads other sensors than pick-offs there is one for each torquer: the combination of readings that
    shows, at a hundredth of the sample rate, what this torquer does to the rate or angle of its gimbal, and nothing of
    the others. Methods for `any_sensors` see the readings that are not kept beside them.
    """
    rows = rows_of(model, signals.gimbals)
    noise = np.array([sensor.sampled_noise(period) for sensor in signals.sensors])
    turning = signals.turning(model.q0)
    if not signals.held:
        found = channels(model, rows)
        return dataclasses.replace(found, noise=np.sqrt(found.basis**2 @ noise**2))
    model, signals = _tied(model, signals)
    rows, effect = rows_of(model, signals.gimbals), _effect(model, signals, period)
    own = np.array([signals.gimbals.index(str(torquer.gimbal)) for torquer in signals.torquers])
    mobility = np.diag(inverse_inertia(model.M[np.ix_(rows, rows)], signals.gimbals))[own]
    k, orders = signals.kept, signals.orders
    if signals.free:  # what is read is not the motion of the gimbals
        mobility = np.linalg.norm(effect[:k], axis=0)
    if not any_sensors and len({*orders}) > 1:
        others = " or ".join(name for name, one in METHODS.items() if one.any_sensors)
        raise DesignError(
            f"the method works axis by axis on angles or on rates, and this loop reads both: choose {others}, or give "
            "the design sensors of its own"
        )
    if not shows_each(effect[:k]):
        names = [sensor.name for sensor in signals.sensors[:k]]
        axes = [model.platform.gimbals[model.platform.gimbal(name)].axis for name in signals.gimbals]
        why = parallel("gimbals", signals.gimbals, axes, "turn about")
        why = why or unseen(model.platform, signals.sensors[:k], effect[:k])
        raise ArgumentError(
            f"sensors: {', '.join(names)} do not show what each of the torquers "
            f"{', '.join(torquer.name for torquer in signals.torquers)} does{why}; add a sensor, or leave out a torquer"
        )
    carried = [r for r in model.platform.rotors if r.carrier in signals.gimbals and r.spin != 0.0]
    effect = turning @ effect
    helping = len(effect) - k if any_sensors else 0
    seen = mobility[:, None] * np.linalg.pinv(effect[:k] if helping else effect)
    sense = block([[seen, 0], [0, np.eye(helping)]]) if helping else seen
    return Channels(
        basis=np.eye(len(own)),
        momenta=np.zeros(0),
        inertias=1.0 / mobility,
        spins=np.array([abs(rotor.spin) for rotor in carried]),
        order=signals.order,
        damping=None if signals.free else np.diag(model.damping)[rows][own],
        stiffness=None if signals.free else np.diag(model.stiffness)[rows][own],
        sense=sense,
        noise=np.sqrt((sense[: len(own)] @ turning) ** 2 @ noise**2),
    )


def following(platform: Platform, signals: LoopSignals, period: float) -> FloatArray | None:
    """Return where readings are while those that the loop keeps rest at commands, (p, kept); None: it keeps all."""
    k = signals.kept
    if k == len(signals.readings):
        return None
    model, rest = linearise(platform), np.array(signals.orders) == signals.order
    effect = signals.turning(model.q0) @ _effect(*_tied(model, signals), period)
    return np.vstack([np.eye(k), rest[k : len(effect), None] * (effect[k:] @ np.linalg.pinv(effect[:k]))])


def _tied(model: LinearModel, signals: LoopSignals) -> tuple[LinearModel, LoopSignals]:
    """Return a model and a loop's signals with drives that do not give way, as they are well below their resonances."""
    platform = with_rigid_drives(model.platform)
    if platform is model.platform:
        return model, signals
    loads = model.platform.loads
    sensors = {one.name: one for one in platform.sensors}
    torquers = {one.name: one for one in platform.torquers}
    gimbals = tuple(dict.fromkeys(loads.get(name, name) for name in signals.gimbals))
    passive = dict.fromkeys(loads.get(name, name) for name in signals.passive)
    tied = dataclasses.replace(
        signals,
        gimbals=gimbals,
        passive=tuple(name for name in passive if name not in gimbals),
        torquers=tuple(torquers[one.name] for one in signals.torquers),
        sensors=tuple(sensors[one.name] for one in signals.sensors),
    )
    q = model.q0[[model.platform.gimbal(name) for name in platform.gimbal_names]]
    return linearise(platform, model.Omega0, model.terms, q, model.specific_force), tied


def _effect(model: LinearModel, signals: LoopSignals, period: float) -> FloatArray:
    """Return the effect of each torquer on each reading, or on the rate of a measured angle.

    At a hundredth of the sample rate, or above what springs hold: below their resonance readings move the other way.
    """
    weights = [sensor.signals(model.platform) for sensor in signals.sensors]
    names = list(dict.fromkeys(name for one in weights for name in one))
    # A sensor may have the name of the signal that it reads, but shows it with its low-pass and errors.
    bare = without_sensors(model.platform)
    system = observed_system(bare_system(model, signals), bare, names, model.q0)
    inputs = [system.input_labels.index(torquer.name) for torquer in signals.torquers]
    rows = rows_of(model, signals.gimbals)
    stiffness = np.linalg.solve(model.M[np.ix_(rows, rows)], model.stiffness[np.ix_(rows, rows)])
    held = np.sqrt(np.abs(np.linalg.eigvals(stiffness)).max())
    s = 1j * max(2.0 * np.pi * 0.01 / period, _ABOVE_SPRINGS * held)
    shown = system.C @ np.linalg.solve(s * np.eye(system.nstates) - system.A, system.B[:, inputs])
    mixing = np.array([[one.get(name, 0.0) for name in names] for one in weights])
    return np.asarray(np.real(s ** np.array(signals.orders)[:, None] * (mixing @ shown)))


def without_sensors(platform: Platform) -> Platform:
    """Return the platform alone: what is observed of it by name are its signals."""
    return dataclasses.replace(platform, pickoffs=(), angle_sensors=(), rate_sensors=(), attitude_sensors=())


def shows_each(effect: FloatArray) -> bool:
    """Return whether readings (p) show what each of the inputs (m) does, by its effect (p, m) on them."""
    sizes = np.linalg.svd(effect, compute_uv=False)
    return len(effect) >= effect.shape[1] and bool(sizes[-1] > _SEEN * sizes[0])


def unseen(platform: Platform, sensors: Sequence[Sensor], effect: FloatArray) -> str:
    """Return in words why readings, rows of `effect`, do not show what each input does; empty where it is not plain."""
    own = {*OMEGA_NAMES, *ROOT_ROTATIONS}
    shown = [one.name for one in sensors if set(one.signals(platform)) <= own]
    if shown and platform.mode != "floating":
        words = f": {', '.join(shown)} show {platform.root_name!r}, which what turns on it moves"
        return f'{words} only with mode = "floating" in [root], or "pivot" without gravity'
    sizes = np.linalg.norm(effect, axis=1)
    still = [one.name for one, size in zip(sensors, sizes, strict=True) if size <= _SEEN * sizes.max(initial=0.0)]
    if still:
        do = "measures" if len(still) == 1 else "measure"
        return f": {', '.join(still)} {do} about an axis that none of them turns"
    axes = [_sensing_axis(platform, one) for one in sensors]
    return parallel("sensors", [one.name for one in sensors], axes, "measure about")


def _sensing_axis(platform: Platform, sensor: Sensor) -> FloatArray:
    """Return the axis about which a sensor measures, at the angles zero; zero where it has none."""
    gimbal, axis, root_axis = (getattr(sensor, key, None) for key in ("gimbal", "axis", "root_axis"))
    if gimbal is not None:
        return platform.gimbals[platform.gimbal(gimbal)].axis
    if root_axis is not None:
        return np.asarray(np.eye(3)[root_axis - 1])
    return np.zeros(3) if axis is None else np.asarray(axis)


def parallel(what: str, names: Sequence[str], axes: Sequence[FloatArray], do: str) -> str:
    """Return in words which two of some axes, of any length, are parallel; empty where no two are."""
    for k, j in itertools.combinations(range(len(names)), 2):
        lengths = float(np.linalg.norm(axes[k]) * np.linalg.norm(axes[j]))
        if np.linalg.norm(np.cross(axes[k], axes[j])) < _SEEN * lengths:
            return f": the {what} {names[k]} and {names[j]} {do} parallel axes"
    return ""


def expect_no_keyhole(job: Job, signals: LoopSignals) -> None:
    """Refuse gimbal angles at which a torquer hardly turns what the sensors read, as at an elevation of 90°."""
    least = []
    for q in job.trims:
        seen = signals.turning(q) @ _effect(*_tied(linearise(job.platform, q=q), signals), job.sampling.period)
        least.append(float(np.linalg.svd(seen[: signals.kept], compute_uv=False)[-1]))
    for q, one in zip(job.trims[1:], least[1:], strict=True):
        if one < _KEYHOLE * least[0]:
            raise InputError(
                f"[operation.angles]: at {at_angles(job.platform, q)} the torquers turn what {signals.sensors[0].name} "
                f"and others read by only {one / least[0]:.2g} of what they do at zero angles (keyhole), where no "
                "loop on these axes works; leave such angles out"
            )
