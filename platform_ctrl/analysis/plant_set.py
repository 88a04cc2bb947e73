"""Several sampled plants of one loop at once: the nominal one and those that its controller must also stabilise."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any, Literal

import numpy as np
from numpy.typing import NDArray

from platform_ctrl.analysis.arrays import ComplexArray, StateArrays, named_system, state_arrays
from platform_ctrl.analysis.feedback import feedback_part
from platform_ctrl.analysis.feedforward import RateFeedforward
from platform_ctrl.analysis.frequency_grids import tuning_grid
from platform_ctrl.analysis.resolvent import ON_A_GRID
from platform_ctrl.analysis.response import frequency_response
from platform_ctrl.common.arguments import whole
from platform_ctrl.common.signatures import check_arguments
from platform_ctrl.common.values import FloatArray, value
from platform_ctrl.errors import ArgumentError
from platform_ctrl.plant.platform import OMEGA_NAMES

if TYPE_CHECKING:
    import control

BoolArray = NDArray[np.bool_]

# Matrices that differ by less than this share of their largest entry are the same.
_ALIKE = 1e-9
# Ending of the name of a command: what a loop holds a reading at.
COMMAND = "_command"

# What a plant of a set represents: the nominal one; other parameters; another platform rate; other gimbal angles;
# dry friction by its describing function; a part that fails.
Group = Literal["nominal", "uncertainty", "Omega", "angles", "friction", "faults"]


# Fields with an entry for each plant, beside what it is called.
_MATRICES = ("A", "B", "C", "D", "B_Omega", "D_Omega", "C_sight", "D_sight")
_OF_EACH = (*_MATRICES, "response", "Omega_response", "sight_response")


@value
class PlantSet:
    """Sampled plants of one loop: the nominal one first, then the others that the controller must stabilise."""

    # A, B, C, D: state equations, torques in N m → what is measured: angles in rad, of rate loops rates in rad/s.
    # Shapes (N, n, n), (N, n, m), (N, p, n), (N, p, m).
    A: FloatArray
    B: FloatArray
    C: FloatArray
    D: FloatArray
    period: float  # of the samples, s
    # labels, groups: what each plant is, and what it represents: ``"nominal"``, ``"uncertainty"``, ``"Omega"``,
    # ``"angles"``, ``"friction"`` or ``"faults"``.
    labels: tuple[str, ...]
    groups: tuple[Group, ...]
    # torques, angles: names of the m inputs and p measured outputs.
    torques: tuple[str, ...]
    angles: tuple[str, ...]
    # B_Omega, D_Omega: input of the platform's rate in rad/s, held between samples and not delayed, (N, n, 3) in units
    # of the states; and how it is measured at once, (N, p, 3): by a gyro that turns with the platform.
    B_Omega: FloatArray
    Omega: FloatArray  # (3,): largest platform rate about each axis, rad/s
    torque_limit: FloatArray  # (m,): of each torquer, N m; infinite for one without a limit
    # Nutation frequency of the nominal plant, rad/s: its fastest open-loop motion without torquers. Where it hardly
    # moves by itself, the frequency that is used instead.
    nutation: float
    noise: FloatArray  # (p,): rms of one sample of each pick-off, rad
    frequency: FloatArray  # (F,): the grid that a tuner measures on, rad/s, up to the Nyquist frequency
    response: ComplexArray  # complex (N, F, p, m): of the plants on `frequency`, torques → angles, rad/(N m)
    Omega_response: ComplexArray  # complex (N, F, p, 3): of the plants on `frequency`, platform rate → angles, s
    states: tuple[str, ...]  # names of the n states
    D_Omega: FloatArray
    sight: tuple[str, ...]  # names of the q outputs of the line of sight, rad/s
    # C_sight, D_sight: of these outputs: (N, q, n), and directly from torques and Omega, (N, q, m + 3).
    C_sight: FloatArray
    D_sight: FloatArray
    # complex (N, F, q, m + 3): of the plants on `frequency`, torques and platform rate → outputs of the line of sight.
    sight_response: ComplexArray
    # Feedforward of the platform's rate that the plants have: see `fed_forward`; None where there is none.
    feedforward: RateFeedforward | None = None

    @property
    def arrays(self) -> StateArrays:
        """All plants, (N, ...), from torques to what is measured."""
        return StateArrays(self.A, self.B, self.C, self.D, self.period)

    @property
    def whole(self) -> StateArrays:
        """All plants, (N, ...), from torques and Omega to what is measured and the outputs of the line of sight."""
        return StateArrays(
            self.A,
            np.concatenate([self.B, self.B_Omega], axis=-1),
            np.concatenate([self.C, self.C_sight], axis=-2),
            np.concatenate([np.concatenate([self.D, self.D_Omega], axis=-1), self.D_sight], axis=-2),
            self.period,
        )

    def fed_forward(self, feedforward: RateFeedforward) -> PlantSet:
        """Return the plants with feedforward of the platform's rate, its states behind theirs.

        Gains from the platform's rate change, those of the loop do not. The torque that feedforward adds counts in
        what the platform's rate does to the torques, its sensors' noise in what noise does.
        """
        m, p = len(self.torques), len(self.angles)
        whole = feedforward.taken_up(self.whole, m, p)
        added = whole.A.shape[-1] - len(self.states)
        states = (*self.states, *(f"feedforward_{k + 1}" for k in range(added)))
        out = dataclasses.replace(self, **_matrices(whole, m, p), states=states, feedforward=feedforward)
        return out.on(self.frequency)

    @property
    def noise_input(self) -> FloatArray:
        """How independent samples of unit rms become the noise of what the controller reads, (p, k).

        Noise that feedforward filters before it is read is not in it.
        """
        own, fed = np.diag(self.noise), self.feedforward
        static = fed is not None and fed.into == "reading" and not len(fed.path.A)
        return np.hstack([own, fed.path.D * fed.noise]) if fed is not None and static else own

    def of_torques(self) -> StateArrays:
        """Return the nominal plant from its torques to what is measured, without states that no torque changes."""
        added = 0 if self.feedforward is None else len(self.feedforward.from_rate.A)
        n = self.A.shape[-1] - added
        return StateArrays(self.A[0, :n, :n], self.B[0, :n], self.C[0, :, :n], self.D[0], self.period)

    def named_inputs(self, commands: Sequence[str] = ()) -> list[str]:
        """Return the names of what a delivered controller reads: the angles, commands, sensors of feedforward."""
        return [*self.angles, *commands, *(self.feedforward.sensors if self.feedforward is not None else ())]

    def on(self, frequency: FloatArray) -> PlantSet:
        """Return the set on another grid of frequencies (F,), rad/s."""
        return dataclasses.replace(self, frequency=frequency, **self._responses(frequency))

    def _responses(self, frequency: FloatArray) -> dict[str, Any]:
        # All together: what depends on the plant and on its outputs alone is then computed once.
        found = frequency_response(self.whole, frequency, -3, ON_A_GRID)
        m, p = len(self.torques), len(self.angles)
        parts = {
            "response": found[..., :p, :m],
            "Omega_response": found[..., :p, m:],
            "sight_response": found[..., p:, :],
        }
        return {name: np.ascontiguousarray(part) for name, part in parts.items()}

    def system(self, k: int = 0) -> control.StateSpace:
        """Return plant `k` with its signals by name; 0 is the nominal one.

        Inputs: the torques, then Omega1 to Omega3, rad/s, held between the samples; outputs: the angles.
        ``control.interconnect([plant, controller], inputs=["Omega1", "Omega2", "Omega3"], outputs=...)`` closes the
        loop of a controller u = K y.
        """
        k = whole("PlantSet.system: k", k, 0, len(self.labels) - 1)
        B, D = np.hstack([self.B[k], self.B_Omega[k]]), np.hstack([self.D[k], self.D_Omega[k]])
        arrays = self.arrays.at(k)._replace(B=B, D=D)
        return named_system(arrays, [*self.torques, *OMEGA_NAMES], self.angles, self.states)

    def joined(self, controller: control.StateSpace | StateArrays) -> StateArrays:
        """Return the arrays of a controller u = K y from all angles of this set to all of its torques, in its order.

        A `control.StateSpace` is joined by the names of its signals. Commands are left out, and what they alone reach,
        and so is feedforward of the platform's rate, which is a part of the plants. Other signals, sizes or sample
        periods are refused.
        """
        K = controller if isinstance(controller, StateArrays) else state_arrays(controller, "controller")
        if abs(K.dt - self.period) > 1e-9 * self.period:
            raise ArgumentError(f"controller: dt must be {self.period} s, as of the plants, got {K.dt} s")
        if not isinstance(controller, StateArrays):
            columns, rows = list(controller.input_labels), list(controller.output_labels)
            columns = [name for name in columns if name.removesuffix(COMMAND) == name or name in self.angles]
            if set(columns) != set(self.named_inputs()) or set(rows) != set(self.torques):
                raise ArgumentError(
                    f"controller: inputs and outputs must be {self.named_inputs()} and {list(self.torques)}, "
                    f"got {columns} and {rows}"
                )
            own, names = self.without_feedforward(controller)
            at, of = [names.index(name) for name in self.angles], [rows.index(name) for name in self.torques]
            K = feedback_part(own.part(of, slice(None)), at)
        else:
            K = self.feedback(K)
        if K.D.shape != (len(self.torques), len(self.angles)):
            raise ArgumentError(
                f"controller: must have {len(self.angles)} inputs and {len(self.torques)} outputs, "
                f"got {K.D.shape[1]} and {K.D.shape[0]}"
            )
        return K

    def without_feedforward(self, controller: control.StateSpace) -> tuple[StateArrays, list[str]]:
        """Return a controller's arrays and inputs without feedforward, which must be the one that the plants have."""
        K, names, fed = state_arrays(controller, "controller"), list(controller.input_labels), self.feedforward
        if fed is None:
            return K, names
        others = [name for name in names if name not in (*self.angles, *fed.sensors)]
        own, n = [*self.angles, *others], len(K.A) - len(fed.path.A)
        every = [names.index(name) for name in (*own, *fed.sensors)]
        of = [list(controller.output_labels).index(name) for name in self.torques]
        inner = K.part(slice(None), every[: len(own)])
        inner = inner._replace(A=K.A[:n, :n], B=inner.B[:n], C=K.C[:, :n])
        made = fed.joined_to(inner.part(of, slice(None)))
        if not _alike(K.part(of, every), made):
            raise ArgumentError(
                f"controller: its feedforward from {', '.join(fed.sensors)} is not the one that follows from the "
                "plant; design it again"
            )
        return inner, own

    def feedback(self, controller: StateArrays) -> StateArrays:
        """Return K of a controller u = K y, itself, or of u = K y + H r, with twice as many inputs."""
        p = len(self.angles)
        return feedback_part(controller, range(p)) if controller.D.shape[1] == 2 * p else controller

    def in_directions(self, sense: FloatArray) -> PlantSet:
        """Return the set with combinations of its measured outputs, the rows of `sense` (k, p), in their place."""
        return dataclasses.replace(
            self,
            C=sense @ self.C,
            D=sense @ self.D,
            D_Omega=sense @ self.D_Omega,
            angles=tuple(f"direction_{k + 1}" for k in range(len(sense))),
            noise=np.sqrt(sense**2 @ self.noise**2),
            response=sense @ self.response,
            Omega_response=sense @ self.Omega_response,
            feedforward=None if self.feedforward is None else self.feedforward.in_directions(sense),
        )

    @check_arguments
    def of(self, groups: Sequence[str]) -> BoolArray:
        """Return which plants belong to `groups`, truth values (N,); other names have no members."""
        return members(self.groups, groups)

    @check_arguments
    def finer(self, frequency: FloatArray) -> PlantSet:
        """Return the set with further frequencies (k,), rad/s, in its grid, where they are new and below Nyquist's."""
        new = np.setdiff1d(frequency[frequency <= np.pi / self.period], self.frequency)
        if not len(new):
            return self
        order = np.argsort(np.concatenate([self.frequency, new]), kind="stable")
        found = self._responses(new)
        parts: dict[str, Any] = {
            name: np.concatenate([getattr(self, name), part], axis=1)[:, order] for name, part in found.items()
        }
        return dataclasses.replace(self, frequency=np.concatenate([self.frequency, new])[order], **parts)

    @check_arguments
    def only(self, chosen: Sequence[int]) -> PlantSet:
        """Return the set of the `chosen` plants (indices); the first one is the new nominal plant."""
        index = np.asarray(chosen, dtype=np.intp)
        return dataclasses.replace(
            self,
            labels=tuple(self.labels[k] for k in index),
            groups=tuple(self.groups[k] for k in index),
            **{name: getattr(self, name)[index] for name in _OF_EACH},
        )


def _alike(one: StateArrays, other: StateArrays) -> bool:
    """Return whether two systems have the same matrices but for rounding."""
    pairs = [(getattr(one, name), getattr(other, name)) for name in "ABCD"]
    return all(
        a.shape == b.shape and bool(np.all(np.abs(a - b) <= _ALIKE * np.abs(b).max(initial=0.0))) for a, b in pairs
    )


def members(groups: Sequence[str], of: Sequence[str]) -> BoolArray:
    """Return which entries of `groups` are among `of`."""
    return np.array([group in of for group in groups], dtype=np.bool_)


def plant_set(  # noqa: PLR0913 - what a set is made of, by keyword
    whole: StateArrays,
    *,
    labels: tuple[str, ...],
    groups: tuple[Group, ...],
    torques: tuple[str, ...],
    angles: tuple[str, ...],
    sight: tuple[str, ...],
    states: Sequence[str],
    Omega: FloatArray,
    torque_limit: FloatArray,
    nutation: float,
    noise: FloatArray,
) -> PlantSet:
    """Return the set of the plants `whole`, as `PlantSet.whole` has them, its responses computed on `tuning_grid`."""
    none = np.zeros((len(labels), 0, 0, 0), dtype=np.complex128)
    out = PlantSet(
        **_matrices(whole, len(torques), len(angles)),
        period=whole.dt,
        labels=labels,
        groups=groups,
        torques=torques,
        angles=angles,
        Omega=Omega,
        torque_limit=torque_limit,
        nutation=nutation,
        noise=noise,
        frequency=np.zeros(0),
        response=none,
        Omega_response=none,
        states=tuple(states),
        sight=sight,
        sight_response=none,
    )
    return out.on(tuning_grid(nutation, whole.dt))


def _matrices(whole: StateArrays, m: int, p: int) -> dict[str, Any]:
    """Return the matrices of plants with m torques and p measured outputs by the names of the fields."""
    A, B, C, D, _ = whole
    parts = A, B[..., :m], C[:, :p], D[:, :p, :m], B[..., m:], D[:, :p, m:], C[:, p:], D[:, p:]
    return dict(zip(_MATRICES, parts, strict=True))
