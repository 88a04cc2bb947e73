"""The sampled closed loop around the exact non-linear plant: the typed shell of the compiled kernel."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike, NDArray

from platform_ctrl.analysis.joining import joined_arrays
from platform_ctrl.arguments import positive, real_array
from platform_ctrl.description import Platform, expect_platform
from platform_ctrl.errors import ArgumentError
from platform_ctrl.frozen import FloatArray, value
from platform_ctrl.job import Mode
from platform_ctrl.simulation import packing
from platform_ctrl.simulation.plant import pack, unit_quaternions
from platform_ctrl.simulation.servo_rotors import check_step, initial_spins, servo_rotors, with_rotor_states
from platform_ctrl.simulation.step_limit import check_elements

if TYPE_CHECKING:
    import control

Merged = tuple[FloatArray, FloatArray, FloatArray, FloatArray]


@value
class HalfCosine:
    """A platform rate that rises to `rate` about a root axis along half a cosine, is held, and falls back.

    Attributes
    ----------
    axis
        Root axis, 1 to 3.
    rate
        Rate that is held, rad/s.
    rise, hold
        Length of the rise (and of the fall), and of the time between, s.
    """

    axis: int
    rate: float
    rise: float
    hold: float


@value
class Trajectory:
    """One run, recorded at every sample instant t = k period.

    Attributes
    ----------
    t : (N,)
        Sample instants, s.
    q, rate, p : (N, n)
        Gimbal angles, rad; their rates, rad/s; joint momenta ∂T/∂q̇, N m s.
    reading : (N, pick-offs)
        What the pick-offs said, rad: noise and quantisation included.
    command, torque : (N, torquers)
        The controllers' output computed from this sample's readings, before limiting; and the torque that acts just
        after this instant: delayed, limited, then lagged. N m.
    Omega : (N, 3), attitude : (N, 4)
        Platform rate in its own axes, rad/s; unit quaternion w, x, y, z from platform axes to inertial axes.
    rotor_spin, rotor_torque : (N, servo rotors)
        Spins against the carriers, rad/s, and the torques of their motors, N m.
    angle_names, pickoff_names, torquer_names, rotor_names
        What the columns are; torquers and servo rotors in the plant's order.
    saturated : (torquers,)
        Number of samples whose command reached the torquer's limit.
    stop_contacts : (n,)
        How often each gimbal came up against a stop.
    ended
        ``"completed"``, or ``"diverged at t = ... s"``: the arrays then end there.
    mode, period, delay, step, seed
        What the run was made with; together with plant, controllers and manoeuvre they reproduce it bit for bit.
    """

    t: FloatArray
    q: FloatArray
    rate: FloatArray
    p: FloatArray
    reading: FloatArray
    command: FloatArray
    torque: FloatArray
    Omega: FloatArray
    attitude: FloatArray
    rotor_spin: FloatArray
    rotor_torque: FloatArray
    angle_names: tuple[str, ...]
    pickoff_names: tuple[str, ...]
    torquer_names: tuple[str, ...]
    rotor_names: tuple[str, ...]
    saturated: NDArray[np.int64]
    stop_contacts: NDArray[np.int64]
    ended: str
    mode: Mode
    period: float
    delay: float
    step: float
    seed: int

    @property
    def completed(self) -> bool:
        """Whether the run reached its end."""
        return self.ended == "completed"

    @property
    def attitude_angles(self) -> FloatArray:
        """Rotation vector of the platform against inertial axes, (N, 3), rad."""
        toward = np.where(self.attitude[:, :1] < 0.0, -1.0, 1.0) * self.attitude
        sine = np.linalg.norm(toward[:, 1:], axis=1, keepdims=True)
        angle = 2.0 * np.arctan2(sine, toward[:, :1])
        return np.asarray(toward[:, 1:] * np.divide(angle, sine, out=np.full_like(sine, 2.0), where=sine > 0.0))


def simulate(
    platform: Platform,
    controllers: Sequence[control.StateSpace],
    *,
    period: float,
    delay: float,
    duration: float,
    mode: Mode,
    Omega_profile: HalfCosine | None = None,
    root_torque: ArrayLike | None = None,
    seed: int = 0,
    noise: bool = True,
    step: float | None = None,
    q: ArrayLike | None = None,
    rate: ArrayLike | None = None,
    Omega: ArrayLike | None = None,
    attitude: ArrayLike | None = None,
    spin: ArrayLike | None = None,
) -> Trajectory:
    """Run sampled controllers on the exact non-linear plant: force elements act, servo rotors run their speed loops.

    At t = k `period` the pick-offs are read (angle + white noise, then quantisation) and the controllers are evaluated
    in their order, u = K y with no hidden sign. `delay` seconds later their torque command takes effect and is held
    until the next one does: it is limited to ± the torquer's limit first, and the limited command then passes the
    torquer's first-order lag. Before the first command takes effect the torquers are silent; controllers start at
    rest. The plant is integrated by the classical Runge-Kutta method; sample instants and the instants at which
    commands take effect always lie on its grid, and the lag is integrated exactly.

    A gimbal that has gone past a stop at the end of a substep is put back on it and loses its outward rate by an
    impulse at that joint: a perfectly inelastic impact, known to a substep in time, that keeps the other joint momenta
    and, with a free root, the angular momentum. While the gimbal presses against the stop its joint is locked.

    Parameters
    ----------
    platform
        The plant.
    controllers
        Discrete state spaces with dt = `period`. Inputs: angles that a pick-off measures, or outputs of a controller
        earlier in the list (that step's value, before limiting). Outputs: torquers, or signals that a later
        controller takes in.
    period, delay, duration
        Sample period, delay from sample to torque (may exceed a period), length of the run, s.
    mode
        ``"caged"``: Omega is prescribed by `Omega_profile`, states [q, p], the platform does not react;
        ``"stabilised"``: the platform is free and `root_torque` acts on it.
    Omega_profile
        Caged: platform rate; default zero.
    root_torque : (3,), optional
        Stabilised: constant torque on the platform in its own axes from t = 0 on, N m.
    seed, noise
        Seed of the pick-off noise; whether there is any.
    step
        Longest substep, s; default 1e-4. Stiff elements need short ones: less than 2.7 C/speed_gain for a servo rotor,
        2.7 times the shortest time constant of friction and cages.
    q, rate : (n,), optional
        Initial gimbal angles and rates; default zero.
    Omega : (3,), attitude : (4,), optional
        Initial platform rate (stabilised only) and attitude.
    spin : (servo rotors,), optional
        Initial spins of the servo rotors against their carriers, rad/s; default the nominal ones. Their loops start in
        the steady state of the nominal spin: with no torque.

    Returns
    -------
    Trajectory
        A run that diverges (a number that is not finite, as a singular mass matrix gives, or a rate above one radian
        per substep) ends early and says so in `ended`.

    Raises
    ------
    ArgumentError
        If an argument has the wrong shape, is out of range, or names something that the plant does not have; if the
        step is too long for a speed loop, a spring, a cage or friction.
    """
    expect_platform(platform)
    n = len(platform.gimbals)
    period = positive("period", period)
    delay = positive("delay", delay, zero=True)
    duration = positive("duration", duration, zero=True)
    longest = 1e-4 if step is None else positive("step", step)
    if mode not in ("caged", "stabilised"):
        raise ArgumentError(f"mode: given {mode!r}; expected 'caged' or 'stabilised'")
    free = mode == "stabilised"
    if free and Omega_profile is not None:
        raise ArgumentError("Omega_profile: given in mode 'stabilised', where the root is free; expected root_torque")
    if not free and (root_torque is not None or Omega is not None):
        given = "root_torque" if root_torque is not None else "Omega"
        raise ArgumentError(f"{given}: given in mode 'caged', where Omega is prescribed; expected Omega_profile")
    angles = real_array("q", q, (n,), 0.0)
    rates = real_array("rate", rate, (n,), 0.0)
    state = np.concatenate([angles, real_array("Omega", Omega, (3,), 0.0), rates, unit_quaternions(attitude, (4,))])
    torque = real_array("root_torque", root_torque, (3,), 0.0)
    profile = _packed_profile(Omega_profile)
    stops = np.array([(-np.inf, np.inf) if g.stops is None else g.stops for g in platform.gimbals]).reshape(n, 2)
    for k, gimbal in enumerate(platform.gimbals):
        if not stops[k, 0] <= angles[k] <= stops[k, 1]:
            raise ArgumentError(
                f"q: {gimbal.angle} starts at {angles[k]:.6g} rad; expected it between its stops {gimbal.stops}"
            )
    servos = servo_rotors(platform)
    spins = initial_spins(platform, spin, (len(servos),))
    merged = _merged(platform, controllers, period, free)
    samples = 1 + math.floor(duration / period + 1e-9)

    # A delay that is a whole number of periods up to rounding leaves no first segment.
    whole = math.floor(delay / period + 1e-9)
    first = delay - whole * period
    first = 0.0 if first < 1e-9 * period else first
    lengths = (first, period - first)
    count = np.array([math.ceil(length / longest - 1e-9) for length in lengths], dtype=np.int64)
    steps = np.array([length / c if c else 0.0 for length, c in zip(lengths, count, strict=True)])
    check_step(platform, float(steps.max()), free)
    check_elements(platform, float(steps.max()), free)

    sensed = np.array([platform.gimbal(s.gimbal) for s in platform.pickoffs], dtype=np.int64)
    rms = np.array([s.sampled_noise(period) if noise else 0.0 for s in platform.pickoffs])
    disturbance = np.random.default_rng(seed).standard_normal((samples, len(rms))) * rms
    quantisation = np.array([s.quantisation for s in platform.pickoffs])
    target = np.array(
        [t.root_axis - 1 if t.root_axis is not None else 3 + platform.gimbal(str(t.gimbal)) for t in platform.torquers],
        dtype=np.int64,
    )
    limit = np.array([np.inf if t.limit is None else t.limit for t in platform.torquers])
    decay = np.array(
        [[math.exp(-0.5 * h / t.lag) if t.lag > 0.0 else 0.0 for t in platform.torquers] for h in steps]
    ).reshape(2, len(limit))

    from platform_ctrl.simulation import old_kernel as kernel

    plant = pack(platform)
    if not free:
        kernel.half_cosine(0.0, profile, state[n : n + 3])
    state = with_rotor_states(packing.pack(platform), state[None], spins[None])[0]
    if not free:
        momenta = np.empty(n)
        kernel.joint_momenta(*plant, free, state, *kernel.workspace(n), momenta)
        state[n + 3 : 2 * n + 3] = momenta
    widths = (n, n + 3, n, 4 + len(rms), len(limit), len(limit), 2 * len(servos))
    records = tuple(np.zeros((samples, width)) for width in widths)
    saturated = np.zeros(len(limit), dtype=np.int64)
    contacts = np.zeros(n, dtype=np.int64)
    done = kernel.closed_loop(
        *plant,
        free,
        state,
        profile,
        torque,
        merged,
        (sensed, disturbance, quantisation),
        (target, limit, decay),
        stops,
        period,
        whole,
        (count, steps),
        records,  # type: ignore[arg-type]
        saturated,
        contacts,
    )
    angle, velocity, momentum, seen, command, applied, rotors = (record[:done] for record in records)
    return Trajectory(
        t=period * np.arange(done, dtype=np.float64),
        q=angle,
        rate=velocity[:, 3:],
        p=momentum,
        reading=seen[:, 4:],
        command=command,
        torque=applied,
        Omega=velocity[:, :3],
        attitude=seen[:, :4],
        rotor_spin=rotors[:, : len(servos)],
        rotor_torque=rotors[:, len(servos) :],
        angle_names=platform.angle_names,
        pickoff_names=tuple(s.name for s in platform.pickoffs),
        torquer_names=tuple(t.name for t in platform.torquers),
        rotor_names=tuple(r.name for r in servos),
        saturated=saturated,
        stop_contacts=contacts,
        ended="completed" if done == samples else f"diverged at t = {done * period:.6g} s",
        mode=mode,
        period=period,
        delay=delay,
        step=longest,
        seed=seed,
    )


def _packed_profile(profile: HalfCosine | None) -> FloatArray:
    packed = np.zeros(5)
    if profile is None:
        return packed
    if not isinstance(profile, HalfCosine):
        raise ArgumentError(f"Omega_profile: given {profile!r}; expected a HalfCosine")
    if profile.axis not in (1, 2, 3):
        raise ArgumentError(f"Omega_profile: axis is {profile.axis!r}; expected 1, 2 or 3")
    if not math.isfinite(profile.rate):
        raise ArgumentError(f"Omega_profile: rate is {profile.rate!r}; expected a finite number")
    packed[profile.axis - 1] = profile.rate
    packed[3] = positive("Omega_profile: rise", profile.rise, zero=True)
    packed[4] = positive("Omega_profile: hold", profile.hold, zero=True)
    return packed


def _merged(platform: Platform, controllers: Sequence[control.StateSpace], period: float, free: bool) -> Merged:
    """One state space from all pick-offs to all torquers."""
    K = joined_arrays(controllers, [s.name for s in platform.pickoffs], [t.name for t in platform.torquers], period)
    roots = {t.name for t in platform.torquers if t.root_axis is not None}
    for k, system in enumerate(controllers):
        acting = [name for name in system.output_labels if name in roots]
        if acting and not free:
            raise ArgumentError(
                f"controller {k + 1} ({system.name!r}): output {acting[0]!r} acts on the root, whose rate is "
                "prescribed in mode 'caged'; leave the controller out or use mode 'stabilised'"
            )
    A, B, C, D = (np.ascontiguousarray(part, dtype=np.float64) for part in (K.A, K.B, K.C, K.D))
    return A, B, C, D
