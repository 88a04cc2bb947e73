"""Several sampled plants of one loop at once: the nominal one and those that its controller must also stabilise."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping, Sequence
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from platform_ctrl.analysis.between_samples import (
    CombinedResponses,
    DisturbanceResponses,
    Disturbed,
    RateFeedforward,
    disturbed,
)
from platform_ctrl.analysis.feedback import feedback_part
from platform_ctrl.analysis.interconnection import COMMAND
from platform_ctrl.analysis.response import frequency_response
from platform_ctrl.analysis.sight import MeanSquare, SightBudget
from platform_ctrl.analysis.system import ComplexArray, StateSpace, System
from platform_ctrl.common.arguments import whole
from platform_ctrl.common.values import FloatArray, replaced, value
from platform_ctrl.errors import ArgumentError
from platform_ctrl.plant.platform import OMEGA_NAMES

BoolArray = NDArray[np.bool_]

# Matrices that differ by less than this share of their largest entry are the same.
_ALIKE = 1e-9
# Rate at which drifting angles decay in plants for a synthesis, 1/s: slow beside any loop.
REGULAR = 5e-3

# What a plant of a set represents: the nominal one; other parameters; another platform rate; other gimbal angles;
# dry friction by its describing function; a part that fails.
Group = Literal["nominal", "uncertainty", "Omega", "angles", "friction", "faults"]


@value
class PlantSet:
    """Sampled plants of one loop: the nominal one first, then the others that the controller must stabilise."""

    # All plants, (N, ...). Inputs: m torques, N m, and the rate of the platform, rad/s, (3,), held between samples and
    # not delayed. Outputs: p that are measured, angles in rad, of rate loops rates in rad/s; q rates of the line of
    # sight, rad/s; and the measured signals at the instants `between`, one after another.
    whole: System
    # labels, groups: what each plant is, and what it represents: ``"nominal"``, ``"uncertainty"``, ``"Omega"``,
    # ``"angles"``, ``"friction"`` or ``"faults"``.
    labels: tuple[str, ...]
    groups: tuple[Group, ...]
    # torques, angles, sight, states: names of the m inputs, the p measured outputs, those of the line of sight, and the
    # n states.
    torques: tuple[str, ...]
    angles: tuple[str, ...]
    sight: tuple[str, ...]
    states: tuple[str, ...]
    Omega: FloatArray  # (3,): largest platform rate about each axis, rad/s
    torque_limit: FloatArray  # (m,): of each torquer, N m; infinite for one without a limit
    # Nutation frequency of the nominal plant, rad/s: its fastest open-loop motion without torquers. Where it hardly
    # moves by itself, the frequency that is used instead.
    nutation: float
    # (p,): rms of one sample of each sensor, rad or rad/s; (N, p, p): what makes the measured outputs of the sensors'
    # readings, in each plant; None: they are these. Behind both are sources of noise alone.
    noise: FloatArray
    turning: FloatArray | None = None
    # (p, k): where the readings are while the k that the loop keeps, the first, rest at their commands; the others
    # help. None: it keeps all.
    commanded: FloatArray | None = None
    between: FloatArray  # (k,): instants after a sample, s
    # The grid that a tuner measures on, (F,), rad/s, up to the Nyquist frequency: see `on`.
    frequency: FloatArray = dataclasses.field(default_factory=lambda: np.zeros(0))
    # complex (N, F, p, m): of the plants on `frequency`, torques → measured outputs.
    response: ComplexArray = dataclasses.field(default_factory=lambda: np.zeros((0, 0, 0, 0), dtype=np.complex128))
    disturbances: DisturbanceResponses  # what continuous disturbances do
    # The same on `frequency`; None: not computed yet.
    disturbed: Disturbed | None = None
    # Angles that the loop does not read and on which something depends: the loop may be in balance at any of them.
    drifting: tuple[str, ...] = ()
    # held: names of gimbals that other loops turn and that are held here; dry_friction: whether the plant has any.
    held: tuple[str, ...] = ()
    dry_friction: bool = False
    tilted: bool = False  # whether in `disturbances` gravity stays where it is while a held root turns
    quantised: tuple[str, ...] = ()  # sensors with steps, which are not in `noise`
    limited: tuple[str, ...] = ()  # angles, in words, at which the gain of resolved readings is limited: a keyhole
    # The budget of the line of sight, where the loop has limits on it, and its forms for a search: see `with_sight`.
    sight_budget: SightBudget | None = None
    sight_forms: Mapping[str, tuple[MeanSquare, ...]] | None = None
    # Feedforward of the platform's rate in the plants, or None: see `fed_forward`.
    feedforward: RateFeedforward | None = None

    @property
    def period(self) -> float:
        """Sample period, s."""
        return self.whole.dt

    @property
    def kept(self) -> int:
        """Number of measured outputs, the first, that the loop keeps at zero or at commands; the others help."""
        return len(self.angles) if self.commanded is None else self.commanded.shape[1]

    @property
    def arrays(self) -> System:
        """All plants, (N, ...), from torques to what is measured."""
        return self.whole.part(slice(len(self.angles)), slice(len(self.torques)))

    @property
    def A(self) -> FloatArray:
        """State matrices, (N, n, n)."""
        return self.whole.A

    @property
    def B(self) -> FloatArray:
        """Of the torques, (N, n, m)."""
        return self.arrays.B

    @property
    def C(self) -> FloatArray:
        """Of what is measured, (N, p, n)."""
        return self.arrays.C

    @property
    def B_Omega(self) -> FloatArray:
        """Of the platform's rate, (N, n, 3)."""
        return self.whole.B[..., len(self.torques) :]

    @property
    def D_Omega(self) -> FloatArray:
        """From the platform's rate directly to what is measured, (N, p, 3): by a gyro that turns with the platform."""
        return self.whole.D[:, : len(self.angles), len(self.torques) :]

    def fed_forward(self, feedforward: RateFeedforward) -> PlantSet:
        """Return the plants with feedforward of the platform's rate, its states behind theirs.

        Gains from the platform's rate change, those of the loop do not. The torque that feedforward adds counts in
        what the platform's rate does to the torques, its sensors' noise in what noise does.
        """
        whole = feedforward.taken_up(self.whole, len(self.torques), len(self.angles))
        added = whole.A.shape[-1] - len(self.states)
        found = dataclasses.replace(
            self,
            whole=whole,
            states=(*self.states, *(f"feedforward_{k + 1}" for k in range(added))),
            feedforward=feedforward,
            disturbances=feedforward.responses(self.disturbances),
            disturbed=None,
        )
        return found if self.disturbed is None else found.with_disturbances()

    def noise_of(self, sense: FloatArray | None = None) -> FloatArray:
        """Return the rms of one sample of what is measured, or of combinations (k, p) of it, of the nominal plant."""
        turned = np.eye(len(self.angles)) if self.turning is None else self.turning[0]
        return np.asarray(np.sqrt((turned if sense is None else sense @ turned) ** 2 @ self.noise**2))

    def noise_input(self, k: int) -> FloatArray:
        """Return how independent samples of unit rms become the noise of what the controller reads of plant k, (p, i).

        Noise that feedforward filters before it is read is not in it.
        """
        own, fed = np.diag(self.noise) if self.turning is None else self.turning[k] * self.noise, self.feedforward
        static = fed is not None and fed.into == "reading" and not len(fed.path.A)
        return np.hstack([own, fed.path.D * fed.noise]) if fed is not None and static else own

    def of_torques(self) -> System:
        """Return the nominal plant from its torques to what is measured, without states that no torque changes."""
        added = 0 if self.feedforward is None else len(self.feedforward.from_rate.A)
        n = self.A.shape[-1] - added
        A, B, C, D, period = self.arrays.at(0)
        return System(A[:n, :n], B[:n], C[:, :n], D, period)

    def named_inputs(self, commands: Sequence[str] = ()) -> list[str]:
        """Return the names of what a delivered controller reads: the angles, commands, sensors of feedforward."""
        return [*self.angles, *commands, *(self.feedforward.sensors if self.feedforward is not None else ())]

    def on(self, frequency: FloatArray) -> PlantSet:
        """Return the set on another grid of frequencies (F,), rad/s."""
        known = None if self.disturbed is None else self.disturbed_at(frequency)
        return dataclasses.replace(
            self, frequency=frequency, response=frequency_response(self.arrays, frequency, -3), disturbed=known
        )

    def with_disturbances(self) -> PlantSet:
        """Return the set with the responses to disturbances on its grid, which searches need again and again."""
        return self if self.disturbed is not None else replaced(self, {"disturbed": self.disturbed_at(self.frequency)})

    def disturbed_on_grid(self) -> Disturbed:
        """Return the responses to disturbances on the set's grid."""
        return self.disturbed_at(self.frequency) if self.disturbed is None else self.disturbed

    def disturbed_at(self, frequency: FloatArray, plants: NDArray[np.intp] | None = None) -> Disturbed:
        """Return the responses to disturbances at frequencies (F,), rad/s: of every plant, (N, F, ...).

        Of some `plants` (F,), each at its own frequency: (F, ...).
        """
        return disturbed(self.disturbances.at(frequency, plants), len(self.angles), self.kept)

    def with_sight(self, controller: System) -> PlantSet:
        """Return the set with the forms of its budget, friction balanced for this stable controller; itself without."""
        if self.sight_budget is None:
            return self
        return replaced(self, {"sight_forms": self.sight_budget.forms(controller)})

    def regular(self) -> PlantSet:
        """Return the set for a synthesis: angles that drift decay slowly, else nothing would hold the loop together."""
        if not self.drifting:
            return self
        decay = np.where(np.isin(self.states, self.drifting), np.exp(-REGULAR * self.period), 1.0)[:, None]
        B = np.concatenate([decay * self.B, self.B_Omega], axis=-1)
        regular = self.whole._replace(A=decay * self.A, B=B)
        return replaced(self, {"whole": regular, "drifting": ()}).on(self.frequency)

    def system(self, k: int = 0) -> StateSpace:
        """Return plant `k` with its signals by name; 0 is the nominal one.

        Inputs: the torques, then Omega1 to Omega3, rad/s, held between the samples; outputs: the angles.
        ``control.interconnect([plant, controller], inputs=["Omega1", "Omega2", "Omega3"], outputs=...)`` closes the
        loop of a controller u = K y.
        """
        k = whole("PlantSet.system: k", k, 0, len(self.labels) - 1)
        arrays = self.whole.at(k).part(slice(len(self.angles)), slice(None))
        return arrays.to_control([*self.torques, *OMEGA_NAMES], self.angles, self.states)

    def joined(self, controller: StateSpace | System) -> System:
        """Return the arrays of a controller u = K y from all angles of this set to all of its torques, in its order.

        A `control.StateSpace` is joined by the names of its signals. Commands are left out, and what they alone reach,
        and so is feedforward of the platform's rate, which is a part of the plants. Other signals, sizes or sample
        periods are refused.
        """
        K = controller if isinstance(controller, System) else System.of(controller, "controller")
        if abs(K.dt - self.period) > 1e-9 * self.period:
            raise ArgumentError(f"controller: dt must be {self.period} s, as of the plants, got {K.dt} s")
        if not isinstance(controller, System):
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

    def without_feedforward(self, controller: StateSpace) -> tuple[System, list[str]]:
        """Return a controller's arrays and inputs without feedforward, which must be the one that the plants have."""
        K, names, fed = System.of(controller, "controller"), list(controller.input_labels), self.feedforward
        if fed is None:
            return K, names
        others = [name for name in names if name not in (*self.angles, *fed.sensors)]
        own, n = [*self.angles, *others], len(K.A) - len(fed.path.A)
        every = [names.index(name) for name in (*own, *fed.sensors)]
        of = [list(controller.output_labels).index(name) for name in self.torques]
        inner = K.part(slice(None), every[: len(own)])
        inner = inner._replace(A=K.A[:n, :n], B=inner.B[:n], C=K.C[:, :n])
        made = fed.joined_to(inner.part(of, slice(None)))
        if not K.part(of, every).alike(made, _ALIKE):
            words = f"its feedforward from {', '.join(fed.sensors)} is not the one that follows from the plant"
            raise ArgumentError(f"controller: {words}; design it again")
        return inner, own

    def feedback(self, controller: System) -> System:
        """Return K of a controller u = K y, itself, or of u = K y + H r, with as many inputs more as are kept."""
        p = len(self.angles)
        return feedback_part(controller, range(p)) if controller.D.shape[1] == p + self.kept else controller

    def in_directions(self, sense: FloatArray) -> PlantSet:
        """Return the set with combinations of its measured outputs, the rows of `sense` (k, p), in their place."""
        found, k = self._combined(sense), self.kept
        commanded = self.commanded if len(sense) > k else None
        return dataclasses.replace(
            found,
            angles=tuple(f"direction_{k + 1}" for k in range(len(sense))),
            commanded=None if commanded is None else sense @ commanded @ np.linalg.inv(sense[:k, :k]),
            noise=self.noise if self.turning is not None else self.noise_of(sense),
            turning=None if self.turning is None else sense @ self.turning,
            response=sense @ self.response,
            feedforward=None if self.feedforward is None else self.feedforward.in_directions(sense),
            sight_budget=None if self.sight_budget is None else self.sight_budget.in_directions(sense),
            sight_forms=None,
        )

    def resolved(self, turning: FloatArray, names: Sequence[str], added: FloatArray) -> PlantSet:
        """Return the set that measures `names`, in each plant other combinations (N, p, p) of its measured outputs.

        `added` (N, p, i) is noise of these combinations by i further sources of unit rms.
        """
        noise = np.append(self.noise, np.ones(added.shape[-1]))
        whole = np.concatenate([turning, added], axis=-1)
        return dataclasses.replace(self._combined(turning), angles=tuple(names), turning=whole, noise=noise)

    def _combined(self, sense: FloatArray) -> PlantSet:
        """Return the set with combinations of its measured outputs, (k, p), or of each plant (N, k, p)."""
        *batch, k, p = sense.shape
        q, times = len(self.sight), len(self.between)
        seen = np.zeros((*batch, k + q + times * k, p + q + times * p))
        seen[..., :k, :p], seen[..., k : k + q, p : p + q] = sense, np.eye(q)
        for i in range(times):
            seen[..., k + q + i * k : k + q + (i + 1) * k, p + q + i * p : p + q + (i + 1) * p] = sense
        return dataclasses.replace(
            self,
            whole=self.whole._replace(C=seen @ self.whole.C, D=seen @ self.whole.D),
            disturbances=CombinedResponses(plain=self.disturbances, sense=sense),
            disturbed=None,
        )

    def of(self, groups: Sequence[str]) -> BoolArray:
        """Return which plants belong to `groups`, truth values (N,); other names have no members."""
        return members(self.groups, groups)

    def finer(self, frequency: FloatArray) -> PlantSet:
        """Return the set with further frequencies (k,), rad/s, in its grid, where they are new and below Nyquist's."""
        new = np.setdiff1d(frequency[frequency <= np.pi / self.period], self.frequency)
        if not len(new):
            return self
        more, at = self.on(new), np.searchsorted(self.frequency, new)

        def both(own: ComplexArray, other: ComplexArray) -> ComplexArray:
            return np.insert(own, at, other, axis=1)

        frequency, response = np.insert(self.frequency, at, new), both(self.response, more.response)
        known = more.disturbed and self.disturbed and Disturbed(*map(both, self.disturbed, more.disturbed))
        return replaced(self, {"frequency": frequency, "response": response, "disturbed": known})

    def only(self, chosen: Sequence[int]) -> PlantSet:
        """Return the set of the `chosen` plants (indices); the first one is the new nominal plant."""
        index = np.asarray(chosen, dtype=np.intp)
        return dataclasses.replace(
            self,
            whole=self.whole.at(index),
            response=self.response[index],
            turning=None if self.turning is None else self.turning[index],
            labels=tuple(self.labels[k] for k in index),
            groups=tuple(self.groups[k] for k in index),
            disturbances=self.disturbances.only(index),
            disturbed=None if self.disturbed is None else Disturbed(*(one[index] for one in self.disturbed)),
        )


def members(groups: Sequence[str], of: Sequence[str]) -> BoolArray:
    """Return which entries of `groups` are among `of`."""
    return np.array([group in of for group in groups], dtype=np.bool_)
