"""Precession theory (15) of a linear model: the test for every subsystem, the model, and its error."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike

from platform_ctrl.common.arguments import distinct, known_name, positive
from platform_ctrl.common.signatures import check_arguments
from platform_ctrl.common.values import FloatArray, value
from platform_ctrl.mechanics.linearisation import LinearModel
from platform_ctrl.mechanics.precession.part import PrecessionPart, assessed, named_directions
from platform_ctrl.mechanics.precession.reduction import echelon, reduced_equations
from platform_ctrl.mechanics.state_space import gimbal_torquers, subsystems, whole_subsystems
from platform_ctrl.plant.platform import OMEGA_NAMES

if TYPE_CHECKING:
    import control


def system(
    parts: Sequence[PrecessionPart],
    momentum_states: bool,
    gimbals: Sequence[str],
    angles: Sequence[str],
    torquers: Sequence[str],
    torque_map: FloatArray,
) -> control.StateSpace:
    """Return the models of all parts as one system.

    `gimbals` and `angles` are those of all parts, and the rows of `torque_map`, (n, torquers); the order is the file's.
    """
    import control

    n, m = len(gimbals), len(torquers)
    states: list[str] = []
    size = sum(_states(part, momentum_states) for part in parts)
    A, B, C, D = np.zeros((size, size)), np.zeros((size, m + 3)), np.zeros((n, size)), np.zeros((n, m + 3))
    for part in parts:
        at, kept = part._reduction(momentum_states)
        of = reduced_equations(at, kept)
        T, back = at.T, at.back
        mine = [list(gimbals).index(name) for name in part.gimbals]
        inputs = np.hstack([T.T @ torque_map[mine], np.zeros((len(mine), 3))])
        rates = np.hstack([np.zeros((3, m)), np.eye(3)])
        if kept.H.shape[1]:
            # Combinations of angles that the held directions leave alone.
            rows, leading = echelon(kept.U.T @ back)
            change, to_old = rows @ T @ kept.U, kept.U.T @ back @ np.linalg.pinv(rows)
            names = [
                part.angles[k] if np.count_nonzero(row) == 1 else f"y_{part.angles[k]}"
                for row, k in zip(rows, leading, strict=True)
            ]
        else:
            _, _, leading = named_directions(at, kept.N, part.angles)
            momenta = part.momentum_directions.T @ back.T @ kept.N
            k = len(leading)
            zero = np.zeros((len(T), k))
            change = np.block([[T, zero], [zero.T, momenta]])
            to_old = np.block([[back, zero], [zero.T, np.linalg.inv(momenta)]])
            names = [*part.angles, *(f"pi_{part.angles[k]}" for k in leading)]
        here = slice(len(states), len(states) + len(names))
        A[here, here] = change @ of.A @ to_old
        B[here] = change @ (of.B @ inputs + of.E @ rates)
        C[mine, here] = T @ of.C @ to_old
        D[mine] = T @ (of.F @ inputs + of.J @ rates)
        states += names
    # Angles in the file's order, then combinations, then momenta.
    order = sorted(range(size), key=lambda k: (list(angles).index(states[k]) if states[k] in angles else n, k))
    return control.StateSpace(
        A[np.ix_(order, order)],
        B[order],
        C[:, order],
        D,
        inputs=[*torquers, *OMEGA_NAMES],
        outputs=list(angles),
        states=distinct("states", [states[k] for k in order]),
        remove_useless_states=False,
    )


def _states(part: PrecessionPart, momentum_states: bool) -> int:
    _, kept = part._reduction(momentum_states)
    return len(part.gimbals) + int(kept.N.shape[1]) - int(kept.H.shape[1])


@value
class Precession:
    """Precession theory of a linear model, where it may be used, and what it takes where it may not.

    Attributes
    ----------
    model
        What was tested.
    gimbals
        Names, in the file's order.
    parts
        The test of each subsystem.

    References
    ----------
    K. Magnus, Ingenieur-Archiv 1976, eq. (15).

    See docs/precession.md.
    """

    model: LinearModel
    gimbals: tuple[str, ...]
    parts: tuple[PrecessionPart, ...]

    @property
    def admissible(self) -> bool:
        """Whether precession theory may be used for every subsystem."""
        return all(part.admissible for part in self.parts)

    @property
    def reasons(self) -> tuple[str, ...]:
        """Why not: a line for each obstacle in each subsystem."""
        return tuple(line for part in self.parts for line in part.reasons)

    @property
    def cures(self) -> tuple[str, ...]:
        """What would help, a line each."""
        return tuple(f"{part.name}: {line}" for part in self.parts for line in part.cures)

    @property
    def momentum_states(self) -> int:
        """How many momentum states cure all subsystems; 0 where precession theory is admissible."""
        return sum(part.momentum_directions.shape[1] for part in self.parts)

    @check_arguments
    def part(self, gimbal: str) -> PrecessionPart:
        """Return the test of the subsystem that the named gimbal belongs to."""
        known_name("gimbal", gimbal, self.gimbals)
        return next(part for part in self.parts if gimbal in part.gimbals)

    @check_arguments
    def state_space(self, momentum_states: bool = False) -> control.StateSpace:
        """Return the precession model as a state-space system, proper and without the derivative of Omega.

        Parameters
        ----------
        momentum_states
            False: (15) with stiffness, G q̇ + K q + G_Omega ω = Q. True: subsystems that this does not suit keep the
            momenta π = vᵀ (M q̇ + M_Omega ω) of their `momentum_directions` v as states, π' = vᵀ (Q − G q̇ − K q −
            G_Omega ω); all other motion, M-orthogonal to v, is without inertia.

        Returns
        -------
        control.StateSpace
            States: the angles, then ``pi_`` + the leading angle of each momentum kept. Where a restraint holds a null
            direction its angles are no states: ``y_`` + angle then names a combination of angles that the
            direction does not change, and angles follow torques at once. Inputs: the torquers in the file's order, then
            Omega1 to Omega3. Outputs: the angles in the file's order. All deviate from the trim.

        Raises
        ------
        MechanicsError
            Not admissible, and `momentum_states` is False: the reason and a cure.
        ArgumentError
            Two signals would have the same name.
        """
        for part in self.parts:
            if not (momentum_states or part.admissible):
                raise part._refusal()
        angles = [self.model.angle_names[self.model.platform.gimbal(name)] for name in self.gimbals]
        torquers, torque_map = gimbal_torquers(self.model, self.gimbals)
        return system(self.parts, momentum_states, self.gimbals, angles, torquers, torque_map)

    def error(self, frequency: ArrayLike, momentum_states: bool = False, each_direction: bool = False) -> FloatArray:
        """Return the relative error of the precession model against the full one.

        ‖P_precession − P‖₂ / ‖P‖₂ with the largest singular values of the transfer functions from torques to angles
        (or rates: the factor jω cancels), in coordinates q = T x, Tᵀ M T = 1, so that no unit and no choice of gimbals
        matters. Of several subsystems the largest counts. With K = 0 and one nutation frequency ν it is ω/ν, exactly.
        Where
        the precession equations are refused although they have a unique solution, they are measured all the same.

        Parameters
        ----------
        frequency : (N,)
            Above 0, rad/s.
        momentum_states
            Of the model that `state_space` returns with this argument.
        each_direction
            ‖P⁻¹ (P_precession − P)‖₂: the error in each direction against the response in that direction. It bounds the
            other, in which a direction with a large response outshines those with a small one.

        Returns
        -------
        (N,)
            Dimensionless.

        Raises
        ------
        MechanicsError
            The precession equations have no unique solution.
        """
        of_parts = [part.error(frequency, momentum_states, each_direction) for part in self.parts]
        return np.max(of_parts, axis=0) if of_parts else np.zeros(np.size(frequency))

    def summary(self) -> str:
        """Return a few lines of text: for each subsystem the verdict, its figures, the reasons and the cures.

        Returns
        -------
        str
            To print.
        """
        lines = [] if self.parts else ["no gimbals: nothing precesses"]
        for part in self.parts:
            verdict = "admissible" if part.admissible else "not admissible"
            figures = f"nutation from {part.nutation.min():.4g} rad/s, " if part.nutation.size else ""
            loop = f"judged for a loop at {part.loop_frequency:.4g} rad/s"
            figures += loop if part.loop_frequency > 0.0 else "no loop frequency given"
            lines.append(f"{part.name}: precession theory {verdict}; {figures}")
            lines += [f"  {line}" for line in (*part.reasons, *part.cures)]
        return "\n".join(lines)


@check_arguments
def precession(
    model: LinearModel,
    gimbals: Sequence[str] | None = None,
    loop_frequency: float | None = None,
    separation: float = 3.0,
) -> Precession:
    """Test whether precession theory (15) may be used for a linear model, and return what it gives.

    It drops M q̈. That needs det G ≠ 0 (G − ∂Q/∂q̇ here), no multiple roots, and nutation well above all that the model
    is used for. Each subsystem is tested by itself.

    Parameters
    ----------
    model
        From `linearise`. Springs and damping of the platform count, so that a restraint can make a difference.
    gimbals
        Names of the gimbals of one or several subsystems; default all.
    loop_frequency
        Up to which the model has to hold, rad/s: the bandwidth of the loop. Default: a hundredth of each subsystem's
        highest nutation frequency, so that weak friction does not pass for a restraint.
    separation
        Factor by which everything dropped has to lie higher than that, and than the fastest precession root.

    Returns
    -------
    Precession
        The test of every subsystem, and the model.

    Raises
    ------
    ArgumentError
        Unknown gimbal, `gimbals` that cut through a subsystem, or a number that is not > 0.
    MechanicsError
        A* is singular at the trim (gimbal lock).

    References
    ----------
    K. Magnus, Ingenieur-Archiv 1976, eq. (15).

    See docs/precession.md.

    Examples
    --------
    >>> import platform_ctrl as pc
    >>> slow = pc.precession(pc.linearise(pc.read_platform("three_gyro_platform")))
    >>> slow.admissible, slow.part("4").direction_names, slow.momentum_states
    (False, ('beta5 - beta7',), 1)
    """
    frequency = None if loop_frequency is None else positive("loop_frequency", loop_frequency)
    required = positive("separation", separation)
    rows = whole_subsystems(model, gimbals)
    chosen = tuple(model.gimbal_names[k] for k in rows)
    groups = [group for group in subsystems(model) if group[0] in chosen]
    index = model.platform.gimbal
    parts = tuple(assessed(model, [index(name) for name in group], frequency, required) for group in groups)
    return Precession(model=model, gimbals=chosen, parts=parts)
