"""The sampled closed loop around the exact non-linear plant: the typed shell of the compiled kernel."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from platform_ctrl.common.values import FloatArray, value
from platform_ctrl.job.scenario import Mode, Scenario
from platform_ctrl.simulation.added_states import servo_rotors
from platform_ctrl.simulation.batch import BatchResult, merged_controller, recorded
from platform_ctrl.simulation.run_plan import prepared_run
from platform_ctrl.simulation.scenarios import commanded_readings, courses_of, expect_several, steps

if TYPE_CHECKING:
    import control


@value
class Trajectory:
    """One run, recorded at every sample instant t = k period.

    Attributes
    ----------
    t : (N,)
        Sample instants, s.
    q, rate, p : (N, n)
        Gimbal angles, rad; their rates, rad/s; joint momenta ∂T/∂q̇, N m s.
    reading : (N, readings)
        What the sensors said, the pick-offs first, rad and rad/s: lag, delay, errors, noise, quantisation included.
        Behind them are those that are turned to joint axes.
    reading_command : (N, commanded readings)
        What the scenario commands of readings, in their units; what an outer loop commands adds to it.
    command, torque : (N, torquers)
        The controllers' output computed from this sample's readings, before limiting; and the torque that acts just
        after this instant: delayed, limited, then lagged. N m.
    Omega : (N, 3)
        Platform rate in its own axes, rad/s.
    attitude : (N, 4)
        Unit quaternion w, x, y, z from platform axes to inertial axes, dimensionless.
    rotor_spin, rotor_torque : (N, servo rotors)
        Spins against the carriers, rad/s, and the torques of their motors, N m.
    line_of_sight : (N, outputs)
        Line of sight, if the plant has one, without any sensor's errors: ``los_rate1``, ``los_rate2``,
        ``los_roll_rate``, rad/s, and ``los_angle1``, ``los_angle2``, ``los_roll`` since t = 0, rad.
    angle_names, pickoff_names, torquer_names, rotor_names, commanded_names
        What the columns are, each in the plant's order; `pickoff_names` are those of all readings, `commanded_names` of
        those that are commanded.
    commanded_units
        Of these readings, ``"rad"`` or ``"rad/s"``.
    metrics
        Those of this one run, as a batch has them.
    ended
        ``"completed"``, or ``"diverged at t = ... s"``: the arrays then end there.
    mode, period, delay, step, seed
        What the run was made with, times in s; together with plant, controllers and manoeuvre they reproduce it bit for
        bit.
    """

    t: FloatArray
    q: FloatArray
    rate: FloatArray
    p: FloatArray
    reading: FloatArray
    reading_command: FloatArray
    command: FloatArray
    torque: FloatArray
    Omega: FloatArray
    attitude: FloatArray
    rotor_spin: FloatArray
    rotor_torque: FloatArray
    line_of_sight: FloatArray
    angle_names: tuple[str, ...]
    pickoff_names: tuple[str, ...]
    torquer_names: tuple[str, ...]
    rotor_names: tuple[str, ...]
    commanded_names: tuple[str, ...]
    commanded_units: tuple[str, ...]
    metrics: BatchResult
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
    def following_error(self) -> FloatArray:
        """Largest |reading − command| from the scenario's `settle` on, without errors of sensors, by commanded name."""
        readings = list(self.metrics.units)
        return self.metrics.following_error[0, [readings.index(name) for name in self.commanded_names]]

    @property
    def saturated(self) -> NDArray[np.int64]:
        """Number of samples whose command reached the torquer's limit, (torquers,)."""
        return np.asarray(self.metrics.saturated[0])

    @property
    def stop_contacts(self) -> NDArray[np.int64]:
        """How often each gimbal came up against a stop, (n,)."""
        return np.asarray(self.metrics.stop_contacts[0])

    @property
    def attitude_angles(self) -> FloatArray:
        """Rotation vector of the platform against inertial axes, (N, 3), rad."""
        from scipy.spatial.transform import Rotation

        return np.asarray(Rotation.from_quat(self.attitude, scalar_first=True).as_rotvec())


def simulate(
    scenario: Scenario,
    controllers: Sequence[control.StateSpace],
    *,
    period: float,
    step: float = 1e-4,
    noise: bool = True,
) -> Trajectory:
    """Run sampled controllers on the exact non-linear plant: force elements act, servo rotors run their speed loops.

    At t = k `period` pick-offs and rate sensors are read (angle or rate + white noise, then quantisation) and the
    controllers are evaluated in their order, u = K y (positive feedback), u = K (y − command) where the scenario
    commands a reading. The scenario's `delay` later their torque
    command takes effect and is held until the next one does: it is limited to ± the torquer's limit first; the limited
    command is followed no faster than the torquer's rate limit, and then passes its first-order lag. Before the first
    command takes effect the torquers are silent; controllers start at rest. The plant is integrated by the classical
    Runge-Kutta method; sample instants and the instants at which commands take effect always lie on its grid, and the
    lag is integrated exactly.

    A gimbal that has gone past a stop at the end of a substep is put back on it and its outward rate is turned by an
    impulse at that joint into its `restitution` times as much inward, 0 by default: an impact, known to a substep in
    time, that keeps the other joint momenta and, with a free root, the angular momentum. While the gimbal presses
    against the stop its joint is locked.

    Parameters
    ----------
    scenario
        The run: plant, mode, duration, delay, motion, faults, initial values, seed.
    controllers
        Discrete state spaces with dt = `period`, or n periods: computed at every n-th sample, the first included, and
        held in between. Inputs: angles and rates that sensors measure, commands of readings,
        NAME + ``_command``, zero unless the scenario has them, or outputs of a controller earlier in the list (that
        step's value, before limiting). Outputs: torquers, or signals that a later
        controller takes in. In mode ``"caged"`` those that act on the root are left out.
    period
        Sample period, s.
    step
        Longest substep, s; shorter where the base shakes faster. Stiff elements need short ones: less than
        2.7 C/speed_gain for a servo rotor, 2.7 times the shortest time constant of friction and cages.
    noise
        Whether the sensors' noise is simulated.

    Returns
    -------
    Trajectory
        A run that diverges (a number that is not finite, as a singular mass matrix gives, or a rate above one radian
        per substep) ends early and says so in `ended`.

    Raises
    ------
    ArgumentError
        If a part of the scenario has the wrong shape, is out of range, or names something that the plant does not
        have; if the step is too long for a speed loop, a spring, a cage or friction.

    References
    ----------
    R. Featherstone, Rigid Body Dynamics Algorithms, 2008, ch. 7.

    See docs/theory/simulation.md.
    """
    period, step = steps(period, step)
    expect_several("controllers", controllers)
    member = prepared_run(scenario, period, step)
    commanded, readings = commanded_readings(scenario), scenario.units
    controller = merged_controller(scenario, controllers, period)
    record, metrics = recorded(member, controller, period, noise)
    platform = scenario.platform
    record = record[: int(metrics.samples[0])]
    n, nu, servos = len(platform.gimbals), len(platform.torquers), servo_rotors(platform)
    widths = (n, n, 3, n, 4, len(readings), nu, nu, len(servos), len(servos))
    angle, rate, Omega, momentum, attitude, reading, command, torque, spin, motor, sight = np.split(
        record, np.cumsum(widths), axis=1
    )
    t = period * np.arange(len(record), dtype=np.float64)
    return Trajectory(
        t=t,
        q=angle,
        rate=rate,
        p=momentum,
        reading=reading,
        reading_command=courses_of(scenario, t)[:, 0],
        command=command,
        torque=torque,
        Omega=Omega,
        attitude=attitude,
        rotor_spin=spin,
        rotor_torque=motor,
        line_of_sight=sight,
        angle_names=platform.angle_names,
        pickoff_names=tuple(readings),
        torquer_names=tuple(t.name for t in platform.torquers),
        rotor_names=tuple(r.name for r in servos),
        commanded_names=commanded,
        commanded_units=tuple(readings[name] for name in commanded),
        metrics=metrics,
        ended=metrics.ended[0],
        mode=scenario.mode,
        period=period,
        delay=scenario.delay,
        step=min(step, scenario.longest_step),
        seed=scenario.seed,
    )
