"""The plants of a loop, linear and sampled, and those of a loop around another one."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping, Sequence

import numpy as np

from platform_ctrl.analysis.between_samples import (
    ClosedResponses,
    DisturbanceResponses,
    Instants,
    PlantResponses,
    SlowerResponses,
    instants,
    rows_between,
)
from platform_ctrl.analysis.feedback import commanded_loop, with_error_alone
from platform_ctrl.analysis.interconnection import COMMAND
from platform_ctrl.analysis.plant_set import PlantSet
from platform_ctrl.analysis.poles import tuning_grid, without_drift
from platform_ctrl.analysis.sampling import every_nth, held_input, late_outputs, late_states, sampled, sampled_states
from platform_ctrl.analysis.system import System, seen_states
from platform_ctrl.common.values import FloatArray, value
from platform_ctrl.design.cases import (
    Case,
    carried,
    cases,
    friction_rate,
    near_keyhole,
    subsystems_over,
    with_feedback,
    with_friction,
)
from platform_ctrl.design.loop_signals import (
    Channels,
    LoopSignals,
    bare_system,
    expect_no_keyhole,
    following,
    loop_channels,
    loop_signals,
    shows_each,
    unseen,
)
from platform_ctrl.design.sections import gain
from platform_ctrl.errors import ArgumentError, InputError
from platform_ctrl.job.job import Job, LoopSpec, Sampling
from platform_ctrl.mechanics.linearisation import linearise
from platform_ctrl.mechanics.outputs import observed_system
from platform_ctrl.mechanics.state_space import tilting
from platform_ctrl.plant.drives import ROOT_TORQUE_NAMES
from platform_ctrl.plant.platform import OMEGA_NAMES

# Open-loop motion slower than this share of the Nyquist frequency is no reference for the loop.
_SLOW_MOTION = 1e-3
# Phase that a tracker's delay takes at the reference frequency of its loop, rad.
_PHASE = 0.5
# A loop that is slower by this factor is seen at its samples and at those of the fast loop alone, not between these.
_SLOW_LOOP = 8
# Sine of the angle between rate and momentum up to which a platform turns steadily.
_STEADY = 1e-6
# Largest angle of a motion in a sample period, rad: beyond it a sampled plant has lost all digits.
_LARGEST_ANGLE = 1e6


def plants_of(job: Job, spec: LoopSpec) -> PlantSet | None:
    """Return the sampled plants of a loop; None for a loop that is checked in the coupled system alone."""
    if spec.kind in ("stabilisation", "tracking"):
        return None
    try:
        signals = job_signals(job, spec)
        if signals.held:
            # An error says which gimbals its sensors do not show.
            loop_channels(linearise(job.platform), signals, job.period_of(spec))
            expect_no_keyhole(job, signals)
        found = sampled_plants(job, signals, job.every(spec))
        # What several designs, searches and bounds need again and again.
        return found.with_disturbances() if any(one.metric.disturbed_by for one in spec.requests) else found
    except ArgumentError as error:
        raise InputError(f"loop {spec.name!r}: {error}") from None


@value
class LinearPlants:
    """The plants of a loop before they are sampled."""

    cases: tuple[Case, ...]  # what each of them is, the nominal plant first
    signals: LoopSignals  # what the loop turns, reads and sets
    # Continuous: from torques and Omega to what the loop reads, the line of sight and `signals.fed`, (N, ...).
    system: System
    states: tuple[str, ...]  # names of the states
    # drifting, held: angles among them that the loop does not read; gimbals that are held.
    drifting: tuple[str, ...]
    held: tuple[str, ...]
    # (N, n, 3): what small rotations of a held root do to the states under gravity; None: nothing.
    tilted: FloatArray | None = None


def linear_plants(signals: LoopSignals, plants: Sequence[Case]) -> LinearPlants:
    """Linearise `plants`, and keep what a loop sets, reads and shows."""
    torques, sensors = [t.name for t in signals.torquers], [s.name for s in signals.sensors]
    gimbals = [*signals.gimbals, *signals.passive]
    outputs = [*sensors, *signals.sight, *(sensor.name for sensor in signals.fed)]
    systems = []
    for one in plants:
        rates = None if one.rate is None else np.full(len(one.platform.gimbals), one.rate)
        model = linearise(one.platform, Omega=one.Omega, q=one.q, rate_amplitude=rates)
        bare = bare_system(model, signals, currents=True)
        systems.append(observed_system(bare, one.platform, list(dict.fromkeys(outputs)), model.q0, model.Omega0))
    # Torques on a floating root do nothing here: no rate of the root is prescribed.
    columns = [systems[0].input_labels.index(name) for name in torques]
    columns += [systems[0].input_labels.index(name) for name in (ROOT_TORQUE_NAMES if signals.free else OMEGA_NAMES)]
    rows = [systems[0].output_labels.index(name) for name in outputs]
    A, B, C, D = (np.array([getattr(one, name) for one in systems]) for name in "ABCD")
    tilted = tilting(B, plants[0].platform)
    A, B, C, D, _ = System(A, B, C, D).part(rows, columns)
    share = _shares(plants)
    B, D = B * share, D * share
    states = list(systems[0].state_labels)
    drifting: tuple[str, ...] = ()
    if signals.held:
        # Nothing depends on the angle of a balanced gimbal whose rate alone is read.
        kept = seen_states(A, C)
        A, B, C, states = A[:, kept][:, :, kept], B[:, kept], C[:, :, kept], [states[k] for k in kept]
        tilted = tilted[:, kept]
        platform = plants[0].platform
        read = {signal for sensor in signals.sensors for signal in sensor.signals(platform)}
        if not signals.free:  # else the momentum of the whole says where they are
            drifting = tuple(name for name in states if name in set(platform.angle_names) - read)
    return LinearPlants(
        cases=tuple(plants),
        signals=signals,
        system=System(A, B, C, D),
        states=tuple(states),
        drifting=drifting,
        held=tuple(name for name in plants[0].platform.gimbal_names if signals.held and name not in gimbals),
        tilted=tilted if tilted.any() and not signals.free else None,
    )


def _shares(plants: Sequence[Case]) -> FloatArray:
    """Return the shares of torques that torquers give, and those of Omega, (N, 1, m + 3)."""
    return np.array([[[*one.torque, 1.0, 1.0, 1.0]] for one in plants])


def sampled_plants(job: Job, signals: LoopSignals, every: int, used: Mapping[str, int] | None = None) -> PlantSet:
    """Return the sampled plants that a loop with these signals must control.

    It is computed at every `every`-th sample; `used` has the number of samples between uses of a reading where that is
    another one.
    """
    linear, sampling = linear_plants(signals, loop_cases(job, signals)), job.sampling
    torques, names = (tuple(one.name for one in part) for part in (signals.torquers, signals.sensors))
    lags = np.array([t.lag for t in signals.torquers])
    m, p, q = len(torques), len(names), len(signals.sight)
    period = every * sampling.period
    _expect_slow(linear.system.A, linear.cases, period)
    held = _held(linear, sampling, lags)
    states = sampled_states(linear.states, torques, lags, held.A.shape[-1])
    shown = [*signals.sensors, *(None for _ in signals.sight), *signals.fed]
    # Feedback of drives is computed at every sample.
    often = dict.fromkeys(names, every) | {one.name: 1 for one in signals.fed} | dict(used or {})
    late = [0 if one is None else one.periods_late(sampling.period, often[one.name]) for one in shown]
    states += late_states(["" if one is None else one.name for one in shown], late)
    at = instants(sampling.period, sampling.delay)
    times = np.append(0.0, at.times)
    shown_between = linear.system.part(slice(p + q), slice(m))
    seen = rows_between(shown_between, sampling.period, sampling.delay, lags, times)
    stepped = held.part(slice(None), slice(m))
    responses: DisturbanceResponses = _responses(
        linear, stepped, late, [one[:, p + q :] for one in seen], at, job.Omega
    )
    # Readings, line of sight, the readings' signals between samples, and last what drives feed back.
    times = times[: None if every < _SLOW_LOOP else 1]
    rows = [k * (p + q) + j for k in range(len(times)) for j in range(p)]
    C, D = (one[:, rows] for one in seen)
    D = np.concatenate([D, np.tile(held.D[:, :p, m:], (1, len(times), 1))], axis=-1)
    C, D = (np.concatenate([x[:, : p + q], y, x[:, p + q :]], axis=-2) for x, y in ((held.C, C), (held.D, D)))
    whole = late_outputs(held._replace(C=C, D=D), [*late[: p + q], *([0] * len(times) * p), *late[p + q :]])
    whole = _with_drives(whole, linear)
    # Rates alone show neither where a free root looks nor where what turns it is.
    whole = without_drift(whole) if signals.free and job.platform.root_attitudes.isdisjoint(names) else whole
    if every > 1:
        whole, kept = every_nth(whole, every, p + q)
        times = np.add.outer(sampling.period * np.arange(every), times).ravel()
        states = [states[k] for k in kept]
        responses = SlowerResponses(plain=responses, every=every)
    nutation = loop_reference(linear, period)
    reacts = job.platform.moves_freely(any(spec.kind == "stabilisation" for spec in job.loops))
    found = PlantSet(
        whole=whole._replace(dt=period),
        labels=tuple(one.label for one in linear.cases),
        torques=torques,
        angles=names,
        nutation=nutation,
        commanded=following(job.platform, signals, period),
        noise=np.array([s.sampled_noise(sampling.period, often[s.name]) for s in signals.sensors]),
        groups=tuple(one.group for one in linear.cases),
        Omega=job.Omega,
        torque_limit=np.array([np.inf if t.limit is None else t.least_share * t.limit for t in signals.torquers]),
        states=tuple(states),
        sight=signals.sight,
        between=times,
        disturbances=responses,
        drifting=linear.drifting,
        held=(*linear.held, *([job.platform.root_name] if signals.held and not signals.free and reacts else [])),
        dry_friction=bool(linear.cases[0].platform.dry_frictions),
        tilted=linear.tilted is not None,
        quantised=tuple(one.name for one in signals.sensors if one.quantisation),
    )
    if signals.resolvers:
        still = np.zeros(len(job.platform.gimbals))
        trims = [still if one.q is None else one.q for one in linear.cases]
        found = found.resolved(
            np.array([signals.turning(q) for q in trims]),
            signals.readings,
            np.array([signals.encoder_noise(job, q, every) for q in trims]),
        )
        found = dataclasses.replace(found, limited=near_keyhole(job, signals.resolvers))
    return found.on(tuning_grid(nutation, period))


def _held(linear: LinearPlants, sampling: Sampling, lags: FloatArray) -> System:
    """Return the plants sampled, from torques and Omega, which is held like these, but neither delayed nor lagging."""
    A, m = linear.system.A, len(lags)
    out = sampled(linear.system.part(slice(None), slice(m)), sampling.period, sampling.delay, lags)
    # Omega acts on the plant's own states, which are the first.
    B_Omega = held_input(A, linear.system.B[..., m:], sampling.period)[1]
    B_Omega = np.pad(B_Omega, ((0, 0), (0, out.A.shape[-1] - A.shape[-1]), (0, 0)))
    B, D = (np.concatenate(pair, axis=-1) for pair in ((out.B, B_Omega), (out.D, linear.system.D[..., m:])))
    return out._replace(B=B, D=D)


def _responses(
    linear: LinearPlants,
    arrays: System,
    late: Sequence[int],
    seen: Sequence[FloatArray],
    at: Instants,
    Omega: FloatArray,
) -> PlantResponses:
    """Return the responses to disturbances of plants whose torques are set at every sample.

    `arrays` are the plants sampled, `seen` C and D of the readings' signals and the line of sight at instants.
    """
    p, q = len(linear.signals.sensors), len(linear.signals.sight)
    # Torques that add are not those of torquers, which may be weak.
    share = _shares(linear.cases)
    share = np.where(share > 0.0, share, 1.0)
    C, D = seen
    smooth = linear.system._replace(B=linear.system.B / share, D=linear.system.D / share)
    if linear.tilted is not None:
        D_tilted = np.pad(smooth.D, ((0, 0), (0, 0), (0, 3)))
        smooth = smooth._replace(B=np.concatenate([smooth.B, linear.tilted], axis=-1), D=D_tilted)
    return PlantResponses(
        smooth=smooth,
        stepped=late_outputs(
            arrays._replace(C=np.concatenate([arrays.C, C], axis=-2), D=np.concatenate([arrays.D, D], axis=-2)),
            [*late, *([0] * len(at.times) * (p + q))],
        ),
        late=tuple(late),
        instants=at,
        drives=_drive_gains(linear) if linear.signals.fed else None,
        readings=p,
        turning=None if linear.tilted is None else Omega,
    )


def tracking_plants(
    job: Job, spec: LoopSpec, inner: LoopSpec, inside: PlantSet, controller: System
) -> tuple[PlantSet, Channels]:
    """Return the plants of a tracking loop, from commands of the rate loop inside to its readings, and its directions.

    `inside` are the plants of the rate loop's design, its feedforward in them, around each of which its `controller` is
    closed, with its commands behind what it measures where it does more with them than to compare.
    """
    by_name = {sensor.name: sensor for sensor in job.platform.sensors}
    read = inner if inner.resolve else dataclasses.replace(inner, sensors=inside.angles)
    own, sensors, law = job_signals(job, read), spec.sensors, job.resolver(spec)
    end = len(own.sensors) - own.base
    both = dataclasses.replace(
        own,
        sensors=(*own.sensors[:end], *(by_name[name] for name in sensors), *own.sensors[end:]),
        resolvers=(*own.resolvers, *(() if law is None else (law,))),
    )
    plants = sampled_plants(job, both, job.every(inner), dict.fromkeys(sensors, job.every(spec)))
    p, m, kept = len(inside.angles), len(plants.torques), inside.kept
    K, feedforward = controller, inside.feedforward
    K = K if K.D.shape[1] > p else with_error_alone(K, inside.commanded)
    whole = plants.whole if feedforward is None else feedforward.taken_up(plants.whole, m, p)
    closed = commanded_loop(whole, K, range(m), range(p))
    slower = 1 if spec.rate_hz is None else round(job.period_of(spec) / plants.period)
    # Inputs are the torques, Omega, the commands; outputs are the torques, then all of the plant's: all readings, the
    # line of sight, all readings between samples. Of these only the tracking loop's own are kept.
    every, q = len(plants.angles), len(plants.sight)
    times = plants.between[: None if slower < _SLOW_LOOP else 1]
    seen = [m + every + q + k * every + j for k in range(len(times)) for j in range(p, every)]
    inputs = [*range(m + 3, m + 3 + kept), *range(m, m + 3)]
    outer = closed.part([*range(m + p, m + every + q), *seen], inputs)
    plain = plants.disturbances if feedforward is None else feedforward.responses(plants.disturbances)
    responses: DisturbanceResponses = ClosedResponses(plain=plain, controller=K._replace(dt=plants.period), readings=p)
    if slower > 1:
        outer = every_nth(outer, slower, len(sensors) + q)[0]
        times = np.add.outer(plants.period * np.arange(slower), times).ravel()
        responses = SlowerResponses(plain=responses, every=slower)
    outer = without_drift(outer)
    commands = tuple(f"{name}{COMMAND}" for name in plants.angles[:kept])
    nutation = tracking_reference(job, spec, plants.nutation, outer.dt / job.every(spec))
    found = dataclasses.replace(
        plants,
        whole=outer,
        torques=commands,
        angles=plants.angles[p:],
        nutation=nutation,
        commanded=None,
        noise=plants.noise[p:],
        turning=None if plants.turning is None else plants.turning[:, p:, p:],
        torque_limit=np.full(kept, np.inf),
        states=tuple(f"x{k}" for k in range(outer.A.shape[-1])),
        between=times,
        disturbances=responses,
        drifting=(),
    ).on(tuning_grid(nutation, outer.dt))
    w = 0.1 * nutation
    effect = np.real(1j * w * found.on(np.array([w])).response[0, 0])
    if not shows_each(effect):
        why = unseen(job.platform, [by_name[name] for name in sensors], effect)
        raise InputError(
            f"loop {spec.name!r}: sensors {', '.join(sensors)} do not show what each of the commands "
            f"{', '.join(commands)} does{why}; add a sensor of an angle, or give the axis a rate loop by itself"
        )
    sense = np.linalg.pinv(effect)
    return found, dataclasses.replace(commanded_channels(kept), sense=sense, noise=found.noise_of(sense))


def commanded_channels(count: int) -> Channels:
    """Return the directions of a loop that sets commands of rates: each one by itself, an integrator."""
    return Channels(basis=np.eye(count), momenta=np.zeros(0), inertias=np.ones(count), spins=np.zeros(0), order=1)


def tracking_reference(job: Job, spec: LoopSpec, inside: float, period: float) -> float:
    """Return the reference frequency of a tracking loop, rad/s, from that of the rate loop inside and its sensors."""
    every = job.every(spec)
    late = max(one.periods_late(period, every) for one in job.platform.sensors if one.name in spec.sensors)
    return min(0.1 * inside, _PHASE / ((late + every) * period))


def loop_reference(linear: LinearPlants, period: float) -> float:
    """Return the reference frequency of grids and starting values: the fastest motion, as nutation.

    Without held gimbals and rotors it is a tenth of the Nyquist frequency.
    """
    rotors = carried(linear.cases[0].platform, linear.signals.gimbals)
    angles = {gimbal.angle for gimbal in linear.cases[0].platform.gimbals}
    own = [k for k, name in enumerate(linear.states) if name.removeprefix("p_") in angles]
    nyquist, fastest = np.pi / period, 0.0
    if (rotors or not linear.signals.held) and not linear.signals.free:
        fastest = float(np.abs(np.linalg.eigvals(linear.system.A[0][np.ix_(own, own)])).max())
    return fastest if fastest > _SLOW_MOTION * nyquist else 0.1 * nyquist


def job_signals(job: Job, spec: LoopSpec) -> LoopSignals:
    """Return the signals of a loop of a job."""
    platform = job.platform
    signals = loop_signals(platform, spec)
    torquers = {torquer.name for torquer in signals.torquers}
    # A rate of the root feeds nothing back: fed forward, it takes off torque that friction brings in.
    moved = signals.held and friction_rate(job) > 0.0
    laws = [law for law in job.drive_laws if law.torquer in torquers and (law.feedback or moved)]
    read = {name for law in laws for name in law.weights}
    fed = tuple(one for one in platform.sensors if one.name in read)
    # A gimbal with a torquer could be caged as well: left out, the loop cuts through a subsystem.
    driven = set() if signals.held else {torquer.gimbal for torquer in platform.torquers}
    free = [name for name in job.passive_gimbals if name not in driven]
    # Those of them take part that are coupled with the loop's at any angles or rates; the root couples them all.
    coupled = set(free) if signals.free else set()
    for q in job.trims if free and not signals.free else ():
        for group in subsystems_over(platform, job.Omega, job.Omega_grid, q):
            coupled |= set(group) if set(group) & set(signals.gimbals) else set()
    return dataclasses.replace(signals, fed=fed, passive=tuple(name for name in free if name in coupled))


def _with_drives(whole: System, linear: LinearPlants) -> System:
    """Return sampled plants with what drives feed back of the last outputs, without these outputs."""
    count, m = len(linear.signals.fed), len(linear.signals.torquers)
    if not count:
        return whole
    inputs, outputs = whole.B.shape[-1], whole.C.shape[-2]
    closed = whole.feedback(gain(_drive_gains(linear)), range(m), range(outputs - count, outputs))
    return closed.part(slice(m, m + outputs - count), slice(inputs))


def _drive_gains(linear: LinearPlants) -> FloatArray:
    """Return the additions of drives to commands in proportion to their readings (N, m, f)."""
    none = np.zeros((len(linear.signals.torquers), len(linear.signals.fed)))
    # A torquer's column has the share of its command, which is not that of what the drive adds.
    return np.array([none if one.feedback is None else one.feedback / one.torque[:, None] for one in linear.cases])


def loop_cases(job: Job, signals: LoopSignals) -> list[Case]:
    """Return the plants that a loop with these signals must control, the nominal one first."""
    turned = (*signals.gimbals, *signals.passive)
    plants = cases(job, turned, [torquer.name for torquer in signals.torquers], root=signals.free)
    if signals.free and not job.platform.root_attitudes.isdisjoint(one.name for one in signals.sensors):
        _expect_steady(plants)
    elif signals.held:
        # These loops keep a body still while the platform turns about it: its rate is a disturbance, no constant at
        # which the gimbals rest. Friction brings it in.
        plants = [one for one in plants if one.group != "Omega"]
    still = [one for one in plants if one.group in ("nominal", "angles")]
    torquers, fed = ([one.name for one in part] for part in (signals.torquers, signals.fed))
    plants += with_friction(job, torquers, fed, still) if signals.held else []
    plants += with_feedback(job, torquers, fed, still) if signals.fed else []
    return plants


def _expect_steady(plants: Sequence[Case]) -> None:
    """Refuse rates at which a floating platform does not go on turning by itself."""
    for one in plants:
        momentum = linearise(one.platform, Omega=one.Omega, q=one.q).root_momentum
        if np.linalg.norm(np.cross(one.Omega, momentum)) > _STEADY * np.linalg.norm(one.Omega) * np.linalg.norm(
            momentum
        ):
            raise InputError(
                f"[operation]: at {one.label} a floating platform does not turn steadily, its momentum "
                f"({', '.join(f'{x:.3g}' for x in momentum)}) N m s lies along another axis; give a rate about it"
            )


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
