"""The closed loops that one controller makes with every plant of a set, and their largest gains.

The parts of a closed loop are named by where they begin and end:

    [torque, Omega, noise] → [torque, angle, sight]        u = K (y + noise),  y = P (u + torque) + P_Omega Omega

"angle" is all that is measured, of rate loops rates; "sight" are the rates of the line of sight. A controller may also
have inputs for commands, behind those for what is measured: "command" enters there, with the other sign, and without
them as noise.

The largest gain over frequency is taken on the set's grid and at the closed-loop poles that are narrower than the
grid's spacing (`Loop.grid_peaks`): quick enough for a search. Over all frequencies it is a norm (`norms.peak`).
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import cached_property
from typing import Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray

from platform_ctrl.analysis.between_samples import Disturbed
from platform_ctrl.analysis.channel import Channel
from platform_ctrl.analysis.drift import Drift, unseen_equilibria, without_drift
from platform_ctrl.analysis.feedback import (
    closed_loop,
    commanded_loop,
    sensitivities_of_plants,
    with_error_alone,
)
from platform_ctrl.analysis.norms import Band, gains
from platform_ctrl.analysis.plant_set import PlantSet
from platform_ctrl.analysis.poles import continuous_poles, poles, spectral_abscissa
from platform_ctrl.analysis.response import frequency_response
from platform_ctrl.analysis.singular_values import largest_singular_values
from platform_ctrl.analysis.system import ComplexArray, System
from platform_ctrl.common.values import FloatArray, replaced
from platform_ctrl.errors import ArgumentError

# Half-width of a resonance over the grid's spacing, up to which it may hide between two points of the grid.
_NARROW = 0.5


class Transfer(NamedTuple):
    """A part of the closed loop: from `source` to `target`, and `direct` times the identity.

    From torque to torque the closed loop is −T = S − I at the plants' input, from noise to angle at their output.
    With `of_limit` every torque is taken by itself, over its torquer's limit, for platform rates over the set's Omega.
    """

    source: Literal["torque", "Omega", "noise", "command"]
    target: Literal["torque", "angle", "sight"]
    direct: float = 0.0
    of_limit: bool = False


S_OUTPUT, S_INPUT = Transfer("noise", "angle", 1.0), Transfer("torque", "torque", 1.0)
FOLLOWING = Transfer("command", "angle", 1.0)  # from a command to its error
T_OUTPUT, T_INPUT = Transfer("noise", "angle"), Transfer("torque", "torque")
# (S − T)/2 = S − I/2
HALF_OUTPUT, HALF_INPUT = Transfer("noise", "angle", 0.5), Transfer("torque", "torque", 0.5)
ANGLE_PER_OMEGA, ANGLE_PER_TORQUE = Transfer("Omega", "angle"), Transfer("torque", "angle")
SIGHT_PER_OMEGA = Transfer("Omega", "sight")
TORQUE_SHARE = Transfer("Omega", "torque", of_limit=True)

Indices = NDArray[np.intp]

# Where a peak is looked for: parts of the closed loop, or one between named signals.
Parts = Sequence[Transfer] | Channel


class Loop:
    """A controller closed around every plant of a set, each part computed when it is first needed.

    `controller` is u = K y, or u = K y + H r with twice as many inputs: see `analysis.following`.
    """

    def __init__(self, plants: PlantSet, controller: System) -> None:
        self.plants = plants
        self.controller = plants.feedback(controller)
        self.two_degrees = None if self.controller is controller else controller
        self.m, self.p = plants.B.shape[-1], plants.C.shape[-2]
        self.period, self.slow = plants.period, plants.nutation / 10.0
        # By metric and plant: exact values with their frequencies, rad/s, and values that a plant is no worse than.
        self.exact_values: dict[tuple[object, int], tuple[float, float]] = {}
        self.proved: dict[tuple[object, int], float] = {}
        # By plant: overshoot and settling time of each channel, (p,).
        self.of_steps: dict[int, tuple[FloatArray, FloatArray]] = {}

    @cached_property
    def arrays(self) -> System:
        """Closed loops (N, ...): inputs torque disturbance, Omega, noise; outputs torques, angles, readings, sight."""
        m, p = self.m, self.p
        whole = self.plants.whole.part(slice(p + len(self.plants.sight)), slice(None))
        A, B, C, D, _ = closed_loop(whole, self.controller, torques=range(m), angles=range(p))
        C_read, D_read = C[..., m : m + p, :], D[..., m : m + p, :].copy()
        D_read[..., m + 3 :] += np.eye(p)
        C = np.concatenate([C[..., : m + p, :], C_read, C[..., m + p :, :]], axis=-2)
        D = np.concatenate([D[..., : m + p, :], D_read, D[..., m + p :, :]], axis=-2)
        if self._feeds_torque:
            # The torque is what the controller sets and what feedforward adds, whose states are the plants' last.
            assert self.plants.feedforward is not None
            fed = self.plants.feedforward.from_rate
            n, f = self.plants.A.shape[-1], len(fed.A)
            C[..., :m, n - f : n] += fed.C
            D[..., :m, m : m + 3] += fed.D
        return System(A, B, C, D, self.plants.period)

    @property
    def _feeds_torque(self) -> bool:
        """Whether feedforward adds to the controller's torques."""
        return self.plants.feedforward is not None and self.plants.feedforward.into == "torque"

    @cached_property
    def own_arrays(self) -> System:
        """Closed loops (N, ...) without Omega: inputs torque disturbance and noise; outputs torques and angles."""
        return closed_loop(self.plants.arrays, self.controller)

    @cached_property
    def drifts(self) -> tuple[Drift, ...]:
        """Of each plant the closed loop without the equilibria that its sensors do not see, and these."""
        if not self.plants.drifting:
            return ()
        A, B, C, D, dt = self.own_arrays
        read = slice(self.m, None)
        every = range(len(A))
        return tuple(unseen_equilibria(System(A[k], B[k], C[k, read], D[k, read], dt)) for k in every)

    @property
    def free_angles(self) -> tuple[str, ...]:
        """Names of the angles at which a loop is in balance wherever they are, with any of the plants."""
        if not self.drifts:
            return ()
        moved = np.max([np.abs(one.equilibria).max(axis=1, initial=0.0) for one in self.drifts], axis=0)
        return tuple(
            name for name, at in zip(self.plants.states, moved, strict=False) if at and name in self.plants.drifting
        )

    def settled(self, system: System) -> System:
        """Return one of the closed loops, or a part, without poles of equilibria that its response does not have."""
        return without_drift(system) if self.plants.drifting else system

    @cached_property
    def following(self) -> System:
        """Closed loops (N, ...) from commands to what is measured, at the samples, then at the instants between."""
        plants, m, p = self.plants, self.m, self.p
        arrays = plants.arrays
        seen = arrays._replace(
            C=np.concatenate([arrays.C, plants.C_between], axis=-2),
            D=np.concatenate([arrays.D, plants.D_between[..., :m]], axis=-2),
        )
        K = with_error_alone(self.controller) if self.two_degrees is None else self.two_degrees
        return commanded_loop(seen, K, range(m), range(p)).part(slice(m, None), slice(m, None))

    @property
    def inputs(self) -> list[str]:
        """Names of the closed loops' inputs."""
        names = self.plants
        return [*names.torques, "Omega1", "Omega2", "Omega3", *(f"noise_{name}" for name in names.angles)]

    @property
    def outputs(self) -> list[str]:
        """Names of the closed loops' outputs; ``reading_`` is an angle with its noise: what the controller gets."""
        names = self.plants
        return [*names.torques, *names.angles, *(f"reading_{name}" for name in names.angles), *names.sight]

    @cached_property
    def poles(self) -> ComplexArray:
        """Poles of the closed loops in z, (N, poles)."""
        return poles(np.array([one.system.A for one in self.drifts]) if self.drifts else self.own_arrays.A)

    @cached_property
    def decay(self) -> FloatArray:
        """Decay rate of the slowest pole, 1/s, (N,)."""
        return np.asarray(-spectral_abscissa(continuous_poles(self.poles, self.plants.period)))

    @cached_property
    def K(self) -> ComplexArray:
        """Response of the controller on the set's grid."""
        return frequency_response(self.controller, self.plants.frequency, -3)

    @cached_property
    def S_output(self) -> ComplexArray:
        """Sensitivity at the plants' output, (N, F, p, p)."""
        return self._sensitivities[0]

    @cached_property
    def S_input(self) -> ComplexArray:
        """Sensitivity at the plants' input, (N, F, m, m)."""
        return self._sensitivities[1]

    @cached_property
    def _sensitivities(self) -> tuple[ComplexArray, ComplexArray]:
        return sensitivities_of_plants(self.plants.response, self.K)

    def only(self, chosen: Sequence[int]) -> Loop:
        """Return the loops of some of the plants (indices): what is computed here is taken over."""
        index = np.asarray(chosen, dtype=np.intp)
        out = Loop(self.plants.only(chosen), self._given)
        out.K, out.poles, out.decay = self.K, self.poles[index], self.decay[index]
        out.S_output, out.S_input = self.S_output[index], self.S_input[index]
        out.arrays, out.own_arrays = self.arrays.at(index), self.own_arrays.at(index)
        return out

    @property
    def peak_frequencies(self) -> FloatArray:
        """Frequencies, rad/s, at which the exact values computed so far are reached."""
        w = np.array([at for _, at in self.exact_values.values()])
        return np.unique(w[np.isfinite(w) & (w > 0.0)])

    def channel(self, channel: Channel | None) -> System:
        """Return the weighted parts of the closed loops between named signals, (N, ...)."""
        return (channel or Channel()).of(self.arrays, self.inputs, self.outputs)

    def parts(self, parts: Parts, k: int) -> list[System]:
        """Return the systems of plant `k` whose gains count."""
        if isinstance(parts, Channel):
            return [self.settled(self.channel(parts).at(k))]
        return [self.settled(self._system(transfer, k)) for transfer in parts]

    def _system(self, transfer: Transfer, k: int) -> System:
        if transfer.source == "command":
            loop = self.following.at(k).part(slice(self.p), slice(None))
            return loop._replace(C=-loop.C, D=transfer.direct * np.eye(self.p) - loop.D)
        m, p = self.m, self.p
        if self.between(transfer):
            raise TypeError("what continuous disturbances do is not rational in z: see `gain_at`")
        columns = slice(0, m) if transfer.source == "torque" else slice(m, m + p)
        rows = slice(0, m) if transfer.target == "torque" else slice(m, m + p)
        found = self.own_arrays.at(k).part(rows, columns)
        return found._replace(D=found.D + transfer.direct * np.eye(*found.D.shape))

    def between(self, transfer: Transfer) -> bool:
        """Return whether a part is from a continuous disturbance: between samples, not rational in z."""
        if transfer.source == "torque" and transfer.target != "torque":
            # Commands of another loop in place of torques are sampled.
            return bool(self._disturbed.read.shape[-1] == 2 * self.m + 3)
        return transfer.source == "Omega"

    def _expect_sight(self, transfer: Transfer) -> None:
        if transfer.target == "sight" and not self.plants.sight:
            raise ArgumentError(
                "attenuation: the loop moves no line of sight; give the plant a [line_of_sight] that the loop turns"
            )

    @cached_property
    def _disturbed(self) -> Disturbed:
        return self.plants.disturbed_on_grid()

    @property
    def _shares(self) -> FloatArray:
        return np.asarray(self.plants.Omega / self.plants.torque_limit[:, None])

    def gain_at(self, parts: Parts, frequency: FloatArray, k: int = 0) -> FloatArray:
        """Return the largest gain (F,) of parts of the closed loop with plant `k` at any frequencies (F,), rad/s."""
        continuous = () if isinstance(parts, Channel) else [one for one in parts if self.between(one)]
        sampled = parts if isinstance(parts, Channel) else [one for one in parts if not self.between(one)]
        found = [gains(one, frequency) for one in (self.parts(sampled, k) if sampled else ())]
        if continuous:
            alone = Loop(replaced(self.plants.only([k]), {"disturbed": None}).on(frequency), self._given)
            first = np.zeros(1, dtype=np.intp)
            found += [largest_singular_values(one[0]) for part in continuous for one in alone.responses(part, first)]
        return np.asarray(np.max(found, axis=0))

    @property
    def _given(self) -> System:
        return self.controller if self.two_degrees is None else self.two_degrees

    def responses(self, transfer: Transfer, members: Indices) -> list[ComplexArray]:
        """Return the responses of a part of some closed loops on the grid, (k, F, ...), which may be several."""
        self._expect_sight(transfer)
        plants, S = self.plants, self.S_output[members]
        if transfer.source == "command" and self.two_degrees is not None:
            H = frequency_response(self.two_degrees, plants.frequency, -3)[..., self.p :]
            return [transfer.direct * np.eye(self.p) - S @ plants.response[members] @ H]
        if transfer.source == "command":
            return [S - (1.0 - transfer.direct) * np.eye(self.p)]
        if (transfer.source, transfer.target) in (("noise", "angle"), ("torque", "torque")):
            S = S if transfer.source == "noise" else self.S_input[members]
            return [S - (1.0 - transfer.direct) * np.eye(S.shape[-1])]
        if transfer.source == "noise":
            return [self.K @ S]
        if not self.between(transfer):
            return [S @ plants.response[members]]
        m = self.m
        columns = slice(-3, None) if transfer.source == "Omega" else slice(m, 2 * m)
        read, angle, sight = (one[members] for one in self._disturbed)
        torque = self.K @ S @ read[..., columns]
        if transfer.target != "torque":
            seen = angle if transfer.target == "angle" else sight
            return [seen[..., columns] + seen[..., :m] @ torque]
        if self._feeds_torque:
            assert plants.feedforward is not None
            torque = torque + plants.feedforward.torque_response(plants.frequency)
        if not transfer.of_limit:
            return [torque]
        share = torque * self._shares
        return [share[..., j : j + 1, :] for j in range(m)]

    def grid_peaks(self, parts: Parts, band: Band, members: Indices) -> FloatArray:
        """Return the largest gain of the parts of some plants within `band`, (k,); infinite of an unstable loop."""
        grid = self.plants.frequency
        if isinstance(parts, Channel):
            responses = [frequency_response(self.channel(parts).at(members), grid, -3)]
        else:
            responses = [response for transfer in parts for response in self.responses(transfer, members)]
        inside = (grid >= band[0]) & (grid <= band[1])
        if not inside.any():
            # A band beside the grid, or between two of its points.
            inside[[np.abs(grid - edge).argmin() for edge in band if np.isfinite(edge)]] = True
        peaks: FloatArray = np.max([_highest(response[:, inside]) for response in responses], axis=0)
        for i, k in enumerate(members):
            w = self.narrow.get(int(k), np.zeros(0))
            w = w[(w >= band[0]) & (w <= band[1])]
            if not w.size:
                continue
            peaks[i] = max(peaks[i], float(self.gain_at(parts, w, int(k)).max()))
        return np.where(self.decay[members] > 0.0, peaks, np.inf)

    @cached_property
    def narrow(self) -> dict[int, FloatArray]:
        """Frequencies, rad/s, of resonances of stable loops that may hide between two points of the grid, by plant."""
        grid = self.plants.frequency
        s = continuous_poles(self.poles, self.plants.period)
        centre = np.where(np.isfinite(s), s.imag, 0.0)
        place = np.clip(np.searchsorted(grid, centre), 1, len(grid) - 1)
        # Below the grid its first frequency is the spacing.
        spacing = np.where(centre < grid[0], centre, grid[place] - grid[place - 1])
        narrow = (centre > 0.0) & (-s.real < _NARROW * spacing) & (self.decay > 0.0)[:, None]
        return {int(k): np.unique(np.abs(s[k, narrow[k]].imag)) for k in np.flatnonzero(narrow.any(axis=1))}


def _highest(matrices: ComplexArray) -> FloatArray:
    """Return the largest singular value over the frequencies of each plant, (N,) of (N, F, p, m).

    No singular value is larger than the root of the sum of squares: where that is below the value at one frequency,
    the singular values need not be known.
    """
    N, F = matrices.shape[:2]
    if not F:
        return np.zeros(N)
    size = np.linalg.norm(matrices, axis=(-2, -1))
    size = np.where(np.isfinite(size), size, np.inf)
    out = largest_singular_values(matrices[np.arange(N), np.argmax(size, axis=1)])
    plants, places = np.nonzero(size > out[:, None])
    np.maximum.at(out, plants, largest_singular_values(matrices[plants, places]))
    return out
