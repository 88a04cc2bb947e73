"""A run advanced sample by sample, with inputs that change on the way: for co-simulation and hardware in the loop.

The compiled kernel is that of whole runs, and its memory is kept between calls: the numbers are those of `simulate`.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike

from platform_ctrl.common.arguments import real_array, real_numbers, whole
from platform_ctrl.common.values import FloatArray, replaced
from platform_ctrl.errors import ArgumentError, SimulationError
from platform_ctrl.job.scenario import Scenario
from platform_ctrl.simulation.batch import columns_of_record, merged_controller
from platform_ctrl.simulation.closed_loop import Trajectory, counts, trajectory_of
from platform_ctrl.simulation.compilation import wait_for_compilation
from platform_ctrl.simulation.kernel import arrays
from platform_ctrl.simulation.run_plan import batch, prepared
from platform_ctrl.simulation.scenarios import commanded_readings, courses_of, expect_several, steps

if TYPE_CHECKING:
    import control

# Samples of one call of compiled code, between which an interrupt takes effect.
_CHUNK = 1000
# Samples of one call of `advance`: their record has to fit into the memory.
_MAX_SAMPLES = 10_000_000
# Numbers of a snapshot before gimbals' torques, commands and the kernel's memory: sample, whether going, Omega reached,
# slope, M.
_HEAD = 2 + 3 + 3 + 3


class Simulator:
    """The sampled closed loop around the non-linear plant, advanced by as many samples at a time as wanted.

    Sample 0 is taken at once; the scenario's `duration` is ignored. Inputs of `advance` act from the last sample on.
    Without inputs the run is that of `simulate`, bit for bit, however many samples each call advances it by.

    Parameters
    ----------
    scenario
        The run: plant, mode, delay, manoeuvre, faults, initial values, seed.
    controllers
        As for `simulate`.
    period
        Sample period, s.
    step
        Longest substep, s.
    noise
        Whether the sensors' noise is simulated.
    Omega : (3,), optional
        Caged: platform rate at t = 0 beside the manoeuvre's, rad/s; default zero.

    Attributes
    ----------
    scenario
        As given.
    period, step
        Sample period and longest substep, s.
    sample
        Number of the last sample, 0 at the beginning.
    going
        Whether the run has not diverged.
    now
        The last sample, a `Trajectory` of one row.

    Raises
    ------
    ArgumentError
        As `simulate`; Omega is given in mode ``"stabilised"``.
    """

    def __init__(
        self,
        scenario: Scenario,
        controllers: Sequence[control.StateSpace],
        *,
        period: float,
        step: float = 1e-4,
        noise: bool = True,
        Omega: ArrayLike | None = None,
    ) -> None:
        from platform_ctrl.common.simd import LANES, memory

        self.period, self.step = steps(period, step)
        expect_several("controllers", controllers)
        member = prepared(scenario, self.period, self.step)
        self.scenario = scenario
        self._free = scenario.mode == "stabilised"
        commanded = commanded_readings(scenario)
        controller = merged_controller(
            scenario.platform, controllers, self.period, scenario.mode, commanded, scenario.drives
        )
        batched = batch([member], controller, self.period, noise)
        self._controller = controller
        self._packed, self._shared, self._simulation = batched.packed, batched.shared, batched.layout
        self._keys = np.repeat(batched.keys[None], LANES, axis=1)
        self._memory = memory(self._simulation.end)
        self._figures = np.zeros((1, self._simulation.end - self._simulation.metrics, LANES))
        self._table = scenario.torque_table if self._free else scenario.Omega_table
        self._reached, self._slope, self._torque = np.zeros(3), np.zeros(3), np.zeros(3)
        self._gimbal_torque = np.zeros(len(scenario.platform.gimbals))
        self._command = np.zeros(len(commanded))
        self.sample, self.going = -1, True
        self._row = np.zeros((0, columns_of_record(batched)))
        if Omega is not None:
            self._expect("Omega", "caged")
            self._reached = real_array("Omega", Omega, (3,))
        wait_for_compilation()
        plants, given = (np.repeat(rows[:, :, None], LANES, axis=2) for rows in (batched.plants, batched.given))
        self._move(1, self._course(0.0, self.period), plants, given)

    def _expect(self, name: str, mode: str) -> None:
        """Judge an input that belongs to one mode."""
        if self.scenario.mode != mode:
            raise ArgumentError(f"{name}: has no effect in mode {self.scenario.mode!r}, only in mode {mode!r}")

    @property
    def now(self) -> Trajectory:
        """The last sample, a trajectory of one row."""
        return self._trajectory(self._row, self.sample)

    def advance(
        self,
        samples: int = 1,
        *,
        Omega: ArrayLike | None = None,
        Omega_rate: ArrayLike | None = None,
        torque: ArrayLike | None = None,
        gimbal_torque: ArrayLike | None = None,
        command: ArrayLike | None = None,
    ) -> Trajectory:
        """Advance the run by a number of samples and return them.

        Parameters
        ----------
        samples
            How many.
        Omega : (3,), optional
            Caged: platform rate from the last sample on, added to the manoeuvre's, rad/s; None: it goes on from what it
            has reached. The platform's attitude, the gimbals' angles and joint momenta do not jump with it.
        Omega_rate : (3,), optional
            Caged: slope of that rate until the next sample that is returned last, rad/s²; None: none, Omega is held.
        torque : (3,), optional
            Stabilised: torque on the platform in its own axes, added to the manoeuvre's and held, N m; None: as before.
        gimbal_torque : (n,), optional
            Torques at the gimbals' joints beside the torquers', held, N m; None: as before.
        command : (commanded readings,), optional
            Adds to what the scenario commands of these readings, in its order of sensors, from the next sample on and
            held, rad or rad/s; None: as before. A `Command` without any numbers makes a reading one of them.

        Returns
        -------
        Trajectory
            The new samples. A run that diverges ends with the last sound one,
            and `going` is False then; counts of saturated samples and of contacts are those since t = 0.

        Raises
        ------
        ArgumentError
            An input has the wrong shape or is not finite, or belongs to the other mode.
        SimulationError
            The run has diverged before.
        """
        samples = whole("samples", samples, 1, _MAX_SAMPLES)
        n = len(self.scenario.platform.gimbals)
        for name, given, mode in (
            ("Omega", Omega, "caged"),
            ("Omega_rate", Omega_rate, "caged"),
            ("torque", torque, "stabilised"),
        ):
            if given is not None:
                self._expect(name, mode)
        start = self._reached if Omega is None else real_array("Omega", Omega, (3,))
        slope = real_array("Omega_rate", Omega_rate, (3,), 0.0)
        moment = self._torque if torque is None else real_array("torque", torque, (3,))
        joints = self._gimbal_torque if gimbal_torque is None else real_array("gimbal_torque", gimbal_torque, (n,))
        if command is not None:
            command = real_array("command", command, self._command.shape)
        if not self.going:
            raise SimulationError(f"the run has {self.now.ended}; start a new one")
        self._command = self._command if command is None else command
        begin, end = self.sample * self.period, (self.sample + samples) * self.period
        self._put(start - self._reached, moment - self._torque, joints)
        self._reached, self._slope, self._torque = start, slope, moment
        course = self._course(begin, end)
        first, parts = self.sample + 1, []
        nothing = np.zeros((1, 0, 0))
        while self.going and self.sample + 1 < first + samples:
            parts.append(self._move(min(_CHUNK, first + samples - self.sample - 1), course, nothing, nothing))
        self._reached = start + slope * (end - begin)
        return self._trajectory(np.concatenate(parts), first)

    def _put(self, jump: FloatArray, moment_jump: FloatArray, joints: FloatArray) -> None:
        """Let inputs act from now on: where the last step ended the next begins, so that there they jump."""
        at, layout, mem = self._packed.at, self._simulation, self._memory
        n, ended = at.n, at.surroundings + 2 * at.block
        mem[ended + n + 3 : ended + n + 6] += jump[:, None]
        if moment_jump.any():
            mem[layout.steady : layout.steady + 3] += moment_jump[:, None]
            for row in range(3):
                mem[layout.table + 3 * row : layout.table + 3 * row + 3] += moment_jump[:, None]
        mem[layout.steady + 3 : layout.steady + 3 + n] = joints[:, None]
        self._gimbal_torque = joints

    def _course(self, begin: float, end: float) -> tuple[arrays.Shared, float]:
        """What the kernel looks Omega up in between two times: the manoeuvre's table and the input; and its scale."""
        own, scale = self._table, 1.0 if self._table is None else self._table.scale
        if self._free or not (self._reached.any() or self._slope.any()):
            return self._shared, scale
        inner = [] if own is None else [float(t) for t in own.t if begin < t < end]
        knots = np.array([begin, *inner, end])
        pieces = np.zeros((len(knots) - 1, 3, 4))
        if own is not None:
            pieces += scale * np.array([_piece_from(own.t, self._shared.pieces, t) for t in knots[:-1]])
        pieces[:, :, 0] += self._reached + self._slope * (knots[:-1, None] - begin)
        pieces[:, :, 1] += self._slope
        return self._shared._replace(knots=knots, pieces=pieces), 1.0

    def _move(
        self, samples: int, course: tuple[arrays.Shared, float], plants: FloatArray, given: FloatArray
    ) -> FloatArray:
        """Advance by `samples` samples and return their record, up to where the run diverges."""
        from platform_ctrl.simulation.kernel.loop import simulate_groups

        shared, scale = course
        first = self.sample + 1
        if first > 0:
            self._memory[self._simulation.rate + arrays.SCALE] = scale
        else:
            given[:, self._simulation.rate + arrays.SCALE - self._packed.at.end] = scale
        record = np.zeros((samples, self._row.shape[1]))
        if self.scenario.commands:
            t = self.period * np.arange(first, first + samples, dtype=np.float64)
            courses = courses_of(self.scenario, t) + self._command
            shared = shared._replace(number=np.concatenate([self._controller.number, courses.ravel()]))
        simulate_groups(
            self._packed.links,
            shared,
            self._keys,
            self._memory,
            None,  # type: ignore[arg-type]
            self._packed.at,
            self._simulation,
            self._free,
            first,
            first + samples,
            plants,
            given,
            self._figures,
            record,
        )
        sound = int(counts(self._figures[0, :, 0], self.scenario.platform)[2][0]) - first
        self.going = sound == samples
        record = record[:sound]
        self.sample += sound
        if sound:
            self._row = record[-1:]
        return record

    def _trajectory(self, record: FloatArray, first: int) -> Trajectory:
        ended = "completed" if self.going else f"diverged at t = {(self.sample + 1) * self.period:.6g} s"
        found = trajectory_of(
            record, self._figures[0, :, 0], self.scenario, first=first, period=self.period, step=self.step, ended=ended
        )
        return replaced(found, {"reading_command": found.reading_command + self._command})

    def snapshot(self) -> FloatArray:
        """Return all that the run has come to, from which `restore` goes on.

        Returns
        -------
        (size,)
            The kernel's memory and what is kept beside it, SI units.
        """
        head = [float(self.sample), float(self.going)]
        inputs = (self._reached, self._slope, self._torque, self._gimbal_torque, self._command)
        return np.concatenate([head, *inputs, self._memory[:, 0], self._row[0] if len(self._row) else []])

    def restore(self, snapshot: ArrayLike) -> None:
        """Go back, or on, to where a snapshot of a run like this one was taken.

        Parameters
        ----------
        snapshot : (size,)
            From `snapshot` of a stepper of the same scenario, controllers, period and step; SI units.

        Raises
        ------
        ArgumentError
            It is of another size.
        """
        n, slots = len(self._gimbal_torque), len(self._memory)
        head = _HEAD + n + len(self._command)
        numbers = real_numbers("snapshot", snapshot)
        if numbers.shape != (head + slots + self._row.shape[1],):
            raise ArgumentError(f"snapshot must have the shape of those of this run, got {numbers.shape}")
        self.sample, self.going = int(numbers[0]), bool(numbers[1])
        self._reached, self._slope, self._torque = (numbers[2 + 3 * k : 5 + 3 * k].copy() for k in range(3))
        self._gimbal_torque, self._command = numbers[_HEAD : _HEAD + n].copy(), numbers[_HEAD + n : head].copy()
        self._memory[:] = numbers[head : head + slots, None]
        self._figures[:] = self._memory[self._simulation.metrics : self._simulation.end]
        self._row = numbers[None, head + slots :].copy()


def _piece_from(t: FloatArray, pieces: FloatArray, begin: float) -> FloatArray:
    """Coefficients (3, 4) of a table in powers of the time since `begin`, until its next point."""
    time = min(max(begin, t[0]), t[-1])
    k = min(int(np.searchsorted(t, time, side="right")) - 1, len(pieces) - 1)
    c, s = pieces[k], time - t[k]
    out = np.zeros((3, 4))
    out[:, 0] = c[:, 0] + s * (c[:, 1] + s * (c[:, 2] + s * c[:, 3]))
    if t[0] <= begin < t[-1]:
        out[:, 1] = c[:, 1] + s * (2.0 * c[:, 2] + 3.0 * s * c[:, 3])
        out[:, 2] = c[:, 2] + 3.0 * s * c[:, 3]
        out[:, 3] = c[:, 3]
    return out
