"""Many runs of the exact plant with a free root and forces held constant."""

from __future__ import annotations

import math
from concurrent.futures import ThreadPoolExecutor

import numpy as np
from numpy.typing import ArrayLike

from platform_ctrl.common.arguments import instance, positive, real_array, unit_quaternions, whole
from platform_ctrl.common.processes import processors
from platform_ctrl.common.values import FloatArray, value
from platform_ctrl.errors import ArgumentError
from platform_ctrl.plant.platform import Platform
from platform_ctrl.simulation.added_states import initial_spins, servo_rotors, with_added_states
from platform_ctrl.simulation.packing import pack
from platform_ctrl.simulation.step_limit import check_steps


@value
class Rollout:
    """Where N runs ended, and with `every` how they got there.

    Attributes
    ----------
    q : (N, n)
        Gimbal angles at the end, rad. A run that overflowed or met a singular mass matrix holds NaN, here and below.
    velocity : (N, 3 + n)
        [Omega, q̇] at the end, rad/s.
    attitude : (N, 4)
        The root's unit quaternion w, x, y, z at the end, dimensionless.
    spin : (N, m)
        Spins of the m servo rotors against their carriers at the end, in the file's order, rad/s.
    t : (S,)
        Times that were recorded, s: the start, every `every` steps, and the end. Only the end without `every`.
    q_history : (N, S, n)
        Angles at the times `t`, rad.
    velocity_history : (N, S, 3 + n)
        [Omega, q̇] at those times, rad/s.
    attitude_history : (N, S, 4)
        Unit quaternions at those times, dimensionless.
    spin_history : (N, S, m)
        Spins at those times, rad/s.
    """

    q: FloatArray
    velocity: FloatArray
    attitude: FloatArray
    spin: FloatArray
    t: FloatArray
    q_history: FloatArray
    velocity_history: FloatArray
    attitude_history: FloatArray
    spin_history: FloatArray


def rollout(  # noqa: PLR0913 - options by keyword
    platform: Platform,
    q: ArrayLike,
    velocity: ArrayLike,
    step: float = 1e-3,
    steps: int = 1000,
    attitude: ArrayLike | None = None,
    force: ArrayLike | None = None,
    every: int | None = None,
    threads: int | None = None,
    spin: ArrayLike | None = None,
) -> Rollout:
    """Integrate N runs of the exact non-linear coupled plant with a free root by the classical Runge-Kutta method.

    The force elements of the platform act besides the forces that are given, servo rotors run their speed loops.
    Gimbal stops do not act here.

    Parameters
    ----------
    platform
        The plant.
    q : (N, n)
        Initial gimbal angles, rad.
    velocity : (N, 3 + n)
        Initial [Omega, q̇], rad/s.
    step, steps
        Step, s, and number of steps. Stiff elements need short steps: less than 2.7 C/speed_gain for a servo rotor,
        2.7 times the shortest time constant of friction and cages.
    attitude : (N, 4), optional
        Initial unit quaternions w, x, y, z that take root axes to inertial axes, dimensionless; default identity.
    force : (N, 3 + n), optional
        [M, Q] in root axes and at the joints, N m, held constant; default zero.
    every
        Record the runs every so many steps; the result does not depend on it.
    threads
        Number of threads that share the runs, in groups of eight; default: the processors available.
    spin : (N, m), optional
        Initial spins of the m servo rotors against their carriers, rad/s; default the nominal ones. Their loops start
        in the steady state of the nominal spin: with no torque.

    Returns
    -------
    Rollout
        The runs at their ends and, with `every`, on their way.

    Raises
    ------
    ArgumentError
        If an argument has the wrong shape, is not finite or is out of range; if the step is too long for a speed loop,
        a spring, a cage or friction.

    References
    ----------
    R. Featherstone, Rigid Body Dynamics Algorithms, 2008, ch. 7.

    See docs/theory/simulation.md.

    Examples
    --------
    >>> import platform_ctrl as pc
    >>> from platform_ctrl import simulation
    >>> platform = pc.read_platform("three_gyro_platform")
    >>> out = simulation.rollout(platform, q=[[0.1] * 5] * 64, velocity=[[0.2] * 8] * 64, step=1e-4, steps=10)
    >>> out.q.shape
    (64, 5)
    """
    n = len(instance("platform", platform, Platform).gimbals)
    try:
        runs = len(np.atleast_2d(np.asarray(q)))
    except ValueError:
        raise ArgumentError(f"q must be (N, {n}) real numbers, got rows of different lengths") from None
    angles = real_array("q", q, (runs, n))
    rates = real_array("velocity", velocity, (runs, n + 3))
    turned = unit_quaternions(attitude, (runs, 4))
    held = np.ascontiguousarray(real_array("force", force, (runs, n + 3), 0.0))
    step = positive("step", step)
    steps = whole("steps", steps, 0)
    every = None if every is None else whole("every", every, 1)
    threads = processors() if threads is None else whole("threads", threads, 1)
    spins = initial_spins(platform, spin, (runs, len(servo_rotors(platform))))
    check_steps([platform], step, free=True)

    from platform_ctrl.common.simd import LANES, memory
    from platform_ctrl.simulation.kernel.advance import advance

    plant = pack(platform)
    states = with_added_states(plant, np.concatenate([angles, rates, turned], axis=1), spins)
    marks = [steps] if every is None else [*range(0, steps, every), steps]
    along = np.empty((runs, len(marks), states.shape[1]))
    # A thread takes whole groups of scenarios that the kernel moves side by side.
    groups = math.ceil(runs / LANES)
    share = LANES * math.ceil(groups / threads) or 1
    parts = [slice(first, first + share) for first in range(0, runs, share)]

    def move(part: slice) -> None:
        space = memory(plant.at.end)
        advance(*plant, space, states[part], held[part], step, steps, every or 0, along[part])

    with ThreadPoolExecutor(max_workers=max(len(parts), 1)) as pool:
        list(pool.map(move, parts))
    spins_along, ends = along[..., 2 * n + 7 : 2 * n + 7 + plant.at.servos], along[:, -1]
    return Rollout(
        q=ends[:, :n],
        velocity=ends[:, n : 2 * n + 3],
        attitude=ends[:, 2 * n + 3 : 2 * n + 7],
        spin=spins_along[:, -1],
        t=step * np.array(marks, dtype=np.float64),
        q_history=along[..., :n],
        velocity_history=along[..., n : 2 * n + 3],
        attitude_history=along[..., 2 * n + 3 : 2 * n + 7],
        spin_history=spins_along,
    )
