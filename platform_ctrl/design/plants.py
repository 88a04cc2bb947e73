"""The plants that a loop must control: the nominal one, uncertain parameters, the range of Omega, parts that fail."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Collection, Iterator, Mapping, Sequence
from itertools import product

import numpy as np

from platform_ctrl.analysis.arrays import StateArrays, seen_states
from platform_ctrl.analysis.feedback import closed_loop
from platform_ctrl.analysis.plant_set import COMMAND, Group, PlantSet, plant_set
from platform_ctrl.analysis.sampling import held_input, late_outputs, late_states, sampled, sampled_states
from platform_ctrl.common.arguments import known_name
from platform_ctrl.common.values import FloatArray, value
from platform_ctrl.design.partition import Channels, channels
from platform_ctrl.errors import ArgumentError, InputError
from platform_ctrl.job.job import Job, LoopSpec, Sampling
from platform_ctrl.mechanics.linearisation import LinearModel, linearise
from platform_ctrl.mechanics.matrices import inverse_inertia, matrices
from platform_ctrl.mechanics.outputs import observed
from platform_ctrl.mechanics.state_space import state_space, subsystems_of_all
from platform_ctrl.plant.platform import OMEGA_NAMES, Platform, Torquer
from platform_ctrl.plant.sensors import LOS_RATES, Sensor

# Open-loop motion slower than this share of the Nyquist frequency is no reference for the loop.
_SLOW_MOTION = 1e-3
# Phase that a tracker's delay takes at the frequency that its loop goes by, rad.
_PHASE = 0.5
# Share of their effect at zero angles below which torquers are near a keyhole: 1/cos of the elevation is 10 there.
_KEYHOLE = 0.1
# Ratio of the least to the largest effect of torquers on readings from which on each is seen.
_SEEN = 1e-6
# Share of the largest gain from torques to the line of sight from which on an output counts as moved.
_MOVES = 1e-6
# Rate at which angles that a rate loop leaves free decay in its plants, 1/s: four times what every pole has to.
_FORGETTING = 0.2
# Largest angle of a motion in a sample period, rad: beyond it a sampled plant has lost all digits.
_LARGEST_ANGLE = 1e6


def changed(platform: Platform, inertia: dict[str, float], spin: dict[str, float]) -> Platform:
    """Return `platform` with other inertias and spins, relative changes by name.

    `inertia` changes J about the axis of a gimbal alone: what the gimbal's own body gains or loses is a thin disk about
    its axis, so that no other J about a gimbal axis through the same body changes unless the axes are parallel. `spin`
    changes the L of a rotor.
    """
    J = np.diag(matrices(platform).A_star)[3:]
    gimbals = tuple(
        dataclasses.replace(g, inertia=g.inertia + inertia.get(g.name, 0.0) * J[k] * np.outer(g.axis, g.axis))
        for k, g in enumerate(platform.gimbals)
    )
    rotors = tuple(
        dataclasses.replace(r, angular_momentum=r.angular_momentum * (1.0 + spin.get(r.name, 0.0)))
        for r in platform.rotors
    )
    return dataclasses.replace(platform, gimbals=gimbals, rotors=rotors)


def with_spins(platform: Platform, spins: Mapping[str, float]) -> Platform:
    """Return the platform with other spins of its rotors, rad/s; those that are not named stay."""
    rotors = tuple(
        dataclasses.replace(r, angular_momentum=r.axial_inertia * spins[r.name])
        if r.name in spins and spins[r.name] != r.spin
        else r
        for r in platform.rotors
    )
    return dataclasses.replace(platform, rotors=rotors)


@value
class Case:
    """A plant of the set: what it is and stands for, the rate (3,) and angles (n,) at which it is linearised.

    `torque`, (m,), is the share of its torque that each torquer of the loop keeps; no angles: zero. `rate` is the
    amplitude of the gimbals' rates, rad/s, for which dry friction is replaced by its describing function; None: without
    dry friction.
    """

    label: str
    group: Group
    platform: Platform
    Omega: FloatArray
    torque: FloatArray
    q: FloatArray | None = None
    rate: float | None = None


def cases(job: Job, gimbals: tuple[str, ...], torquers: Sequence[str] = ()) -> list[Case]:
    """Return the plants that the loop on `gimbals` with `torquers` must control, the nominal one first.

    Default: the first torquer on each of the gimbals.

    Then every corner of the parameter uncertainty and the samples inside it, the grid of Omega, the gimbal angles with
    the nominal and with the other parameters, and the faults.
    """
    torquers = torquers or [job.platform.torquer_on(name).name for name in gimbals]
    platform, still, whole = job.platform, np.zeros(3), np.ones(len(torquers))
    out = [Case(label="nominal", group="nominal", platform=platform, Omega=still, torque=whole)]
    for label, parameters in _varied(job, gimbals):
        moved = changed(platform, **parameters)
        out.append(Case(label=label, group="uncertainty", platform=moved, Omega=still, torque=whole))
    for rates in _rates(job.Omega, job.Omega_grid):
        label = f"Omega = ({rates[0]:g}, {rates[1]:g}, {rates[2]:g}) rad/s"
        out.append(Case(label=label, group="Omega", platform=platform, Omega=np.array(rates), torque=whole))
    varied = [one for one in out if one.group in ("nominal", "uncertainty")]
    for q in job.trims[1:]:
        for one in varied:
            group: Group = "angles" if one.group == "nominal" else "uncertainty"
            label = at_angles(platform, q) if one.group == "nominal" else f"{one.label}, {at_angles(platform, q)}"
            out.append(dataclasses.replace(one, label=label, group=group, q=q))
    return [*out, *_faults(job, gimbals, torquers)]


def _with_friction(job: Job, plants: Sequence[Case]) -> list[Case]:
    """Return plants with dry friction as it acts on gimbals that turn at the largest rate of the platform."""
    rate = float(np.max(job.Omega))
    if rate == 0.0 or not any(max(friction.breakaway) > 0.0 for friction in job.platform.frictions):
        return []
    out: list[Case] = []
    for one in plants:
        label = f"dry friction at {rate:g} rad/s" + ("" if one.group == "nominal" else f", {one.label}")
        out.append(dataclasses.replace(one, label=label, group="friction", rate=rate))
    return out


def at_angles(platform: Platform, q: FloatArray) -> str:
    """Return gimbal angles (n,) in words, those alone that are not zero."""
    return ", ".join(f"{name} = {x:g} rad" for name, x in zip(platform.angle_names, q, strict=True) if x)


def _varied(job: Job, gimbals: tuple[str, ...]) -> Iterator[tuple[str, dict[str, dict[str, float]]]]:
    """Walk the relative changes of J and L at the corners of the uncertainty, then at the samples inside it."""
    named = [("inertia", g, job.uncertainty.inertia) for g in gimbals]
    named += [("spin", name, job.uncertainty.spin) for name in _carried(job.platform, gimbals)]
    named = [entry for entry in named if entry[2] > 0.0]
    if not named:
        return
    for signs in product((-1.0, 1.0), repeat=len(named)):
        yield _moved(named, signs, "+.0%")
    for place in _samples(job, len(named)):
        yield _moved(named, place, "+.1%")


def _moved(
    named: list[tuple[str, str, float]], place: Sequence[float], digits: str
) -> tuple[str, dict[str, dict[str, float]]]:
    out: dict[str, dict[str, float]] = {"inertia": {}, "spin": {}}
    words = []
    for (parameter, name, width), part in zip(named, place, strict=True):
        out[parameter][name] = part * width
        words.append(f"{'J' if parameter == 'inertia' else 'L'}{name}{part * width:{digits}}")
    return " ".join(words), out


def subsystems_over(platform: Platform, Omega: FloatArray, grid: int) -> tuple[tuple[str, ...], ...]:
    """Return the groups of gimbals that are coupled at rest or on a grid of platform rates, in the file's order."""
    return subsystems_of_all([linearise(platform, Omega=rate) for rate in [(0.0, 0.0, 0.0), *_rates(Omega, grid)]])


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


def _faults(job: Job, gimbals: tuple[str, ...], torquers: Sequence[str]) -> Iterator[Case]:
    still, whole = np.zeros(3), np.ones(len(torquers))
    slow, weak = job.faults.slow_rotor, job.faults.weak_torquer
    if slow is not None:
        for name in _carried(job.platform, gimbals):
            platform = changed(job.platform, {}, {name: slow - 1.0})
            label = f"rotor {name} at {slow:.0%} of its spin"
            yield Case(label=label, group="faults", platform=platform, Omega=still, torque=whole)
    if weak is not None:
        for k, name in enumerate(torquers):
            label = f"torquer {name} at {weak:.0%} of its torque"
            torque = np.where(np.arange(len(torquers)) == k, weak, 1.0)
            yield Case(label=label, group="faults", platform=job.platform, Omega=still, torque=torque)


def _carried(platform: Platform, gimbals: tuple[str, ...]) -> list[str]:
    return [r.name for r in platform.rotors if r.carrier in gimbals]


def rows_of(model: LinearModel, gimbals: tuple[str, ...]) -> list[int]:
    """Return the row numbers of the named gimbals, in the loop's order."""
    return [known_name("gimbals", name, model.gimbal_names) for name in gimbals]


def plants_of(job: Job, spec: LoopSpec) -> PlantSet | None:
    """Return the plants of a loop of the job; None for a loop that is checked in the coupled system alone."""
    if spec.kind in ("stabilisation", "tracking"):
        return None
    try:
        return loop_plants(job, spec)
    except ArgumentError as error:
        raise InputError(f"loop {spec.name!r}: {error}") from None


@value
class LoopSignals:
    """What a loop turns, reads and sets.

    Attributes
    ----------
    gimbals
        Names, in the loop's order.
    torquers, sensors
        Of the loop.
    sight
        Outputs of the line of sight that its torquers move.
    held
        Whether all other gimbals are held; else the loop's are whole subsystems.
    """

    gimbals: tuple[str, ...]
    torquers: tuple[Torquer, ...]
    sensors: tuple[Sensor, ...]
    sight: tuple[str, ...] = ()
    held: bool = False


def forgetting(A: FloatArray, states: Sequence[str], angles: Collection[str]) -> FloatArray:
    """Return A (..., n, n) with those of its states that are `angles` decaying.

    A loop that holds a body is in balance at any angle: it holds against a cable or a weight that pulls at it. So
    each of its angles is a closed-loop pole at zero, which says nothing about the loop, but which no verdict and no
    certificate could tell from one that grows. Far above the rate of the decay nothing changes.
    """
    out = A.copy()
    for k, name in enumerate(states):
        if name in angles:
            out[..., k, k] -= _FORGETTING
    return out


def caging_signals(platform: Platform, gimbals: tuple[str, ...]) -> LoopSignals:
    """Return the signals of a caging loop: one torquer and one pick-off on each gimbal."""
    return LoopSignals(
        gimbals=gimbals,
        torquers=tuple(platform.torquer_on(name) for name in gimbals),
        sensors=tuple(platform.pickoff_on(name) for name in gimbals),
    )


def loop_signals(platform: Platform, spec: LoopSpec) -> LoopSignals:
    """Return what a caging, rate or pointing loop turns, reads and sets."""
    if spec.kind == "caging":
        return caging_signals(platform, spec.gimbals)
    sensors = {sensor.name: sensor for sensor in platform.sensors}
    torquers = {torquer.name: torquer for torquer in platform.torquers}
    out = LoopSignals(
        gimbals=spec.gimbals,
        torquers=tuple(torquers[name] for name in spec.torquers)
        or tuple(platform.torquer_on(name) for name in spec.gimbals),
        sensors=tuple(sensors[name] for name in spec.sensors),
        held=True,
    )
    return dataclasses.replace(out, sight=_moved_sight(platform, out))


def _moved_sight(platform: Platform, signals: LoopSignals) -> tuple[str, ...]:
    """Return the rates across the line of sight that the loop's torquers move, at the angles zero."""
    if platform.line_of_sight is None:
        return ()
    model = linearise(platform)
    system = observed(state_space(model, gimbals=signals.gimbals, others="held"), platform, LOS_RATES[:2])
    gain = np.abs(system.C @ system.B[:, [system.input_labels.index(t.name) for t in signals.torquers]]).max(axis=1)
    largest = gain.max(initial=0.0)
    return tuple(name for name, one in zip(LOS_RATES, gain, strict=False) if one > _MOVES * largest > 0.0)


def loop_channels(model: LinearModel, signals: LoopSignals, period: float) -> Channels:
    """Return the directions in which design methods see a loop.

    Of a loop that reads other sensors than pick-offs there is one for each torquer: the combination of readings that
    shows, at a hundredth of the sample rate, what this torquer does to the rate or angle of its gimbal, and nothing of
    the others.
    """
    rows = rows_of(model, signals.gimbals)
    if not signals.held:
        return channels(model, rows)
    platform, order = model.platform, 1 if signals.sensors[0].unit == "rad/s" else 2
    effect = _effect(model, signals, period)
    own = np.array([signals.gimbals.index(str(torquer.gimbal)) for torquer in signals.torquers])
    mobility = np.diag(inverse_inertia(model.M[np.ix_(rows, rows)], signals.gimbals))[own]
    sizes = np.linalg.svd(effect, compute_uv=False)
    if len(signals.sensors) < len(own) or not sizes[-1] > _SEEN * sizes[0]:
        raise ArgumentError(
            f"sensors: {', '.join(sensor.name for sensor in signals.sensors)} do not show what each of the torquers "
            f"{', '.join(torquer.name for torquer in signals.torquers)} does; add a sensor, or leave out a torquer"
        )
    carried = [r for r in platform.rotors if r.carrier in signals.gimbals and r.spin != 0.0]
    return Channels(
        basis=np.eye(len(own)),
        momenta=np.zeros(0),
        inertias=1.0 / mobility,
        spins=np.array([abs(rotor.spin) for rotor in carried]),
        order=order,
        sense=mobility[:, None] * np.linalg.pinv(effect),
    )


def _effect(model: LinearModel, signals: LoopSignals, period: float) -> FloatArray:
    """Return what each torquer does to each reading, or to its rate of angles, at a hundredth of the sample rate."""
    weights = [sensor.signals(model.platform) for sensor in signals.sensors]
    names = list(dict.fromkeys(name for one in weights for name in one))
    system = observed(state_space(model, gimbals=signals.gimbals, others="held"), model.platform, names, model.q0)
    inputs = [system.input_labels.index(torquer.name) for torquer in signals.torquers]
    s = 2j * np.pi * 0.01 / period
    shown = system.C @ np.linalg.solve(s * np.eye(system.nstates) - system.A, system.B[:, inputs])
    mixing = np.array([[one.get(name, 0.0) for name in names] for one in weights])
    order = 1 if signals.sensors[0].unit == "rad/s" else 2
    return np.asarray(np.real(s**order * (mixing @ shown)))


def _expect_no_keyhole(job: Job, signals: LoopSignals) -> None:
    """Refuse gimbal angles at which a torquer hardly turns what the sensors read, as at an elevation of 90°."""
    least = [
        float(np.linalg.svd(_effect(linearise(job.platform, q=q), signals, job.sampling.period), compute_uv=False)[-1])
        for q in job.trims
    ]
    for q, one in zip(job.trims[1:], least[1:], strict=True):
        if one < _KEYHOLE * least[0]:
            raise InputError(
                f"angles: at {at_angles(job.platform, q)} the torquers turn what {signals.sensors[0].name} and others "
                f"read by only {one / least[0]:.2g} of what they do at zero angles (keyhole), where no loop on these "
                "axes works; leave such angles out of [operation]"
            )


@value
class LinearPlants:
    """The plants of a loop before they are sampled: torques and platform rate → angles.

    Attributes
    ----------
    cases
        What each of them is, the nominal plant first.
    signals
        What the loop turns, reads and sets.
    A, B, C, D, B_Omega, D_Omega
        Continuous; shapes (N, n, n), (N, n, m), (N, p, n), (N, p, m), (N, n, 3), (N, p, 3).
    C_sight, D_sight
        Of the line of sight, (N, q, n) and, from torques and Omega, (N, q, m + 3).
    states
        Names of the n states.
    """

    cases: tuple[Case, ...]
    signals: LoopSignals
    A: FloatArray
    B: FloatArray
    C: FloatArray
    D: FloatArray
    B_Omega: FloatArray
    D_Omega: FloatArray
    C_sight: FloatArray
    D_sight: FloatArray
    states: tuple[str, ...]

    @property
    def torquers(self) -> tuple[Torquer, ...]:
        """Torquers of the loop, in its order."""
        return self.signals.torquers

    @property
    def sensors(self) -> tuple[Sensor, ...]:
        """Sensors of the loop, in its order."""
        return self.signals.sensors


def linear_plants(signals: LoopSignals, plants: Sequence[Case]) -> LinearPlants:
    """Linearise `plants`, and keep what a loop sets, reads and shows."""
    torques, sensors = [t.name for t in signals.torquers], [s.name for s in signals.sensors]
    inputs, p, m = [*torques, *OMEGA_NAMES], len(sensors), len(torques)
    systems = []
    for one in plants:
        rates = None if one.rate is None else np.full(len(one.platform.gimbals), one.rate)
        model = linearise(one.platform, Omega=one.Omega, q=one.q, rate_amplitude=rates)
        bare = state_space(model, gimbals=signals.gimbals, others="held" if signals.held else "coupled")
        systems.append(observed(bare, one.platform, [*sensors, *signals.sight], model.q0, model.Omega0))
    columns = [systems[0].input_labels.index(name) for name in inputs]
    A, C = (np.array([getattr(system, name) for system in systems]) for name in "AC")
    B, D = (np.array([getattr(system, name)[:, columns] for system in systems]) for name in "BD")
    states = list(systems[0].state_labels)
    if signals.held:
        kept = seen_states(A, C)
        A, B, C, states = A[:, kept][:, :, kept], B[:, kept], C[:, :, kept], [states[k] for k in kept]
        platform = plants[0].platform
        read = {signal for sensor in signals.sensors for signal in sensor.signals(platform)}
        A = forgetting(A, states, set(platform.angle_names) - read)
    torque = np.array([one.torque for one in plants])[:, None, :]
    return LinearPlants(
        cases=tuple(plants),
        signals=signals,
        A=A,
        B=B[..., :m] * torque,
        C=C[:, :p],
        D=D[:, :p, :m] * torque,
        B_Omega=B[..., m:],
        D_Omega=D[:, :p, m:],
        C_sight=C[:, p:],
        D_sight=np.concatenate([D[:, p:, :m] * torque, D[:, p:, m:]], axis=-1),
        states=tuple(states),
    )


def sampled_plants(linear: LinearPlants, sampling: Sampling, Omega: FloatArray) -> PlantSet:
    """Sample linear plants; `Omega` is the largest platform rate about each axis, rad/s."""
    torques, names = (tuple(one.name for one in part) for part in (linear.torquers, linear.sensors))
    A, lags = linear.A, np.array([t.lag for t in linear.torquers])
    p, m = len(names), len(torques)
    _expect_slow(A, linear.cases, sampling.period)
    C, D = (
        np.concatenate([linear.C, linear.C_sight], axis=1),
        np.concatenate([linear.D, linear.D_sight[..., :m]], axis=1),
    )
    arrays = sampled(StateArrays(A, linear.B, C, D, 0.0), sampling.period, sampling.delay, lags)
    B_Omega = held_rate(A, linear.B_Omega, sampling.period, arrays.A.shape[-1])
    D_Omega = np.concatenate([linear.D_Omega, linear.D_sight[..., m:]], axis=1)
    states = sampled_states(linear.states, torques, lags, arrays.A.shape[-1])
    late = [sensor.periods_late(sampling.period) for sensor in linear.sensors]
    whole = late_outputs(
        arrays._replace(B=np.concatenate([arrays.B, B_Omega], axis=-1), D=np.concatenate([arrays.D, D_Omega], axis=-1)),
        [*late, *(0 for _ in linear.signals.sight)],
    )
    return plant_set(
        StateArrays(whole.A, whole.B[..., :m], whole.C[:, :p], whole.D[:, :p, :m], sampling.period),
        labels=tuple(one.label for one in linear.cases),
        torques=torques,
        angles=names,
        nutation=loop_reference(linear, sampling.period),
        noise=np.array([s.sampled_noise(sampling.period) for s in linear.sensors]),
        groups=tuple(one.group for one in linear.cases),
        B_Omega=whole.B[..., m:],
        Omega=Omega,
        torque_limit=np.array([np.inf if t.limit is None else t.limit for t in linear.torquers]),
        states=[*states, *late_states(names, late)],
        D_Omega=whole.D[:, :p, m:],
        sight=linear.signals.sight,
        C_sight=whole.C[:, p:],
        D_sight=whole.D[:, p:],
    )


def tracking_plants(job: Job, spec: LoopSpec, inner: LoopSpec, controller: StateArrays) -> tuple[PlantSet, Channels]:
    """Return the plants of a tracking loop, from commands of the rate loop inside to its readings, and its directions.

    `controller` is that of the rate loop, closed around each of its plants.
    """
    sensors = {sensor.name: sensor for sensor in job.platform.sensors}
    own = loop_signals(job.platform, inner)
    both = dataclasses.replace(own, sensors=(*own.sensors, *(sensors[name] for name in spec.sensors)))
    plants = _loop_plants(job, both)
    p, m = len(own.sensors), len(own.torquers)
    A, B, C, D, dt = closed_loop(plants.whole, controller, torques=range(m), angles=range(p))
    # u = K (y + noise): a command is noise with the other sign. Outputs are the torques, then all of the plant's.
    Omega, command = slice(m, m + 3), slice(m + 3, m + 3 + p)
    read, sight = slice(m + p, m + p + len(spec.sensors)), slice(m + p + len(spec.sensors), None)
    commands = tuple(f"{sensor.name}{COMMAND}" for sensor in own.sensors)
    late = max(sensors[name].periods_late(dt) for name in spec.sensors)
    found = plant_set(
        StateArrays(A, -B[..., command], C[..., read, :], -D[..., read, command], dt),
        labels=plants.labels,
        torques=commands,
        angles=spec.sensors,
        nutation=min(0.1 * plants.nutation, _PHASE / ((late + 1) * dt)),
        noise=plants.noise[p:],
        groups=plants.groups,
        B_Omega=B[..., Omega],
        Omega=job.Omega,
        D_Omega=D[..., read, Omega],
        sight=plants.sight,
        C_sight=C[..., sight, :],
        D_sight=np.concatenate([-D[..., sight, command], D[..., sight, Omega]], axis=-1),
    )
    z = np.exp(1j * (w := 0.1 * found.nutation) * dt)
    inside = np.linalg.solve(z * np.eye(found.A.shape[-1]) - found.A[0], found.B[0])
    effect = np.real(1j * w * (found.C[0] @ inside + found.D[0]))
    sizes = np.linalg.svd(effect, compute_uv=False)
    if len(spec.sensors) < p or not sizes[-1] > _SEEN * sizes[0]:
        raise InputError(
            f"loop {spec.name!r}: sensors {', '.join(spec.sensors)} do not show what each of the commands "
            f"{', '.join(commands)} does; add a sensor of an angle, or give the axis a rate loop by itself"
        )
    channel = Channels(
        basis=np.eye(p),
        momenta=np.zeros(0),
        inertias=np.ones(p),
        spins=np.zeros(0),
        order=1,
        sense=np.linalg.pinv(effect),
    )
    return found, channel


def loop_reference(linear: LinearPlants, period: float) -> float:
    """Return the frequency that grids go by: of caged gimbals and those that carry rotors their fastest motion."""
    carried = _carried(linear.cases[0].platform, linear.signals.gimbals)
    angles = {gimbal.angle for gimbal in linear.cases[0].platform.gimbals}
    own = [k for k, name in enumerate(linear.states) if name.removeprefix("p_") in angles]
    moving = bool(carried) or not linear.signals.held
    return reference_frequency(linear.A[0][np.ix_(own, own)] if moving else np.zeros((1, 1)), period)


def loop_plants(job: Job, loop: LoopSpec | tuple[str, ...]) -> PlantSet:
    """Return the sampled plants of a loop, or of the caging loop on some gimbals, signals in the loop's order."""
    platform = job.platform
    signals = loop_signals(platform, loop) if isinstance(loop, LoopSpec) else caging_signals(platform, loop)
    if signals.held:
        loop_channels(linearise(platform), signals, job.sampling.period)  # its sensors have to show what they need to
        _expect_no_keyhole(job, signals)
    return _loop_plants(job, signals)


def _loop_plants(job: Job, signals: LoopSignals) -> PlantSet:
    return sampled_plants(linear_plants(signals, loop_cases(job, signals)), job.sampling, job.Omega)


def loop_cases(job: Job, signals: LoopSignals) -> list[Case]:
    """Return the plants that a loop with these signals must control, the nominal one first."""
    plants = cases(job, signals.gimbals, [torquer.name for torquer in signals.torquers])
    if signals.held:
        # These loops keep a body still while the platform turns about it: its rate is a disturbance, no constant at
        # which the gimbals rest. Friction brings it in.
        plants = [one for one in plants if one.group != "Omega"]
        plants += _with_friction(job, [one for one in plants if one.group in ("nominal", "angles")])
    return plants


def _expect_slow(A: FloatArray, plants: Sequence[Case], period: float) -> None:
    finite = np.array([np.isfinite(one).all() for one in A])
    fastest = np.where(finite, np.abs(np.linalg.eigvals(np.where(finite[:, None, None], A, 0.0))).max(axis=-1), np.inf)
    worst = int(fastest.argmax())
    if fastest[worst] * period > _LARGEST_ANGLE:
        where = f"plant {plants[worst].label}" if plants[worst].label else "the plant"
        raise InputError(
            f"rate_hz = {1.0 / period:.6g}: in a sample period {where} turns by {fastest[worst] * period:.3g} rad or "
            f"grows as fast, more than {_LARGEST_ANGLE:.0e}; choose a higher rate"
        )


def held_rate(A: FloatArray, B: FloatArray, period: float, order: int) -> FloatArray:
    """Return the sampled input of Omega: held like the torques, but neither delayed nor lagging."""
    out = np.zeros((*A.shape[:-2], order, B.shape[-1]))
    # The sampled states begin with the plant's own, on which Omega acts directly.
    out[..., : A.shape[-1], :] = held_input(A, B, period)[1]
    return out


def reference_frequency(A: FloatArray, period: float) -> float:
    """Return the frequency that grids and starting values go by: nutation; without any, a tenth of Nyquist's."""
    nyquist = np.pi / period
    fastest = float(np.abs(np.linalg.eigvals(A)).max())
    return fastest if fastest > _SLOW_MOTION * nyquist else 0.1 * nyquist
