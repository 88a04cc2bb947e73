"""Where precession theory (15) may be used: the test of every subsystem, what cures it, and the model."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike
from scipy.linalg import block_diag, qr

from platform_ctrl.common.arguments import distinct, known_name, positive, real_array, short
from platform_ctrl.common.values import FloatArray, value
from platform_ctrl.errors import ArgumentError, MechanicsError
from platform_ctrl.mechanics.kinematics import topology
from platform_ctrl.mechanics.linearisation import LinearModel
from platform_ctrl.mechanics.reduction import Rows
from platform_ctrl.mechanics.state_space import (
    ComplexArray,
    NamedMatrices,
    gimbal_torquers,
    subsystems,
    whole_subsystems,
)
from platform_ctrl.plant.platform import OMEGA_NAMES

if TYPE_CHECKING:
    import control

# Loop frequency where none is given, against the highest nutation frequency.
_SLOW = 0.01
# A singular value of G this small against the largest is 0.
_NOTHING = 1e-9
# Non-zero roots nearer to each other than this, against the largest, are one multiple root: rounding alone parts a
# double root by the square root of the machine precision.
_MULTIPLE = 1e-7
# A dropped pole with Re s over |s| above this grows: by less than 1 % in a thousand periods it is rounding.
_GROWS = 1e-6
# A coordinate of a direction this much smaller than another one is as large: a name must not hang on the last digits
# of a plant file. Half of the last digit in words is not worth a word.
_AS_LARGE, _SILENT = 1e-3, 0.005
# Room for rounding where something is to lie a factor above something else.
_ROUNDING = 1e-9


@value
class PrecessionPart:
    """The test of one subsystem, and its precession model.

    Attributes
    ----------
    model
        The linear model that the subsystem belongs to.
    gimbals
        Names, in the file's order; n of them.
    loop_frequency
        Up to which the model has to hold, rad/s.
    singular_values : (n,)
        Of Tᵀ G T with Tᵀ M T = 1, rad/s, largest first; with nothing else in the equations they are the nutation
        frequencies. Small against the loop is what counts, not small in N m s.
    null_directions : (n, k)
        Columns: motions q̇ that G does nothing about, in as few angles each as possible; dimensionless.
    momentum_directions : (n, k)
        Motions whose momenta the model with momentum states keeps, dimensionless: the null directions, or all where
        with these alone it is not admissible either.
    reasons, cures
        Why precession theory may not be used without changes, and what would help: lines of text, none where it may.
    nutation : (p,)
        Frequencies |s| of the poles of the full equations that are dropped, rad/s, lowest first; one for a conjugate
        pair. These, the roots and the separation are those of the model that keeps the momenta of the null directions.
    precession_roots : (r,)
        Roots of the model, complex, rad/s, slowest first.
    root_error
        Largest distance between the roots and the slow poles of the full equations, rad/s.
    separation
        Ratio of the lowest nutation frequency to the loop frequency or the fastest precession, whichever is higher.
        Precession is as fast as stiffness drives it in any direction, ‖G⁻¹ K‖ in coordinates of unit inertia: roots
        alone can be 0 under the stiffest spring.

    References
    ----------
    K. Magnus, Ingenieur-Archiv 1976, eqs. (15), (19).

    See docs/theory/precession.md.
    """

    model: LinearModel
    gimbals: tuple[str, ...]
    loop_frequency: float
    singular_values: FloatArray
    null_directions: FloatArray
    momentum_directions: FloatArray
    reasons: tuple[str, ...]
    cures: tuple[str, ...]
    nutation: FloatArray
    precession_roots: ComplexArray
    root_error: float
    separation: float

    @property
    def angles(self) -> tuple[str, ...]:
        """Names of the angles."""
        return tuple(self.model.angle_names[k] for k in self._rows)

    @property
    def admissible(self) -> bool:
        """Whether precession theory may be used without changes."""
        return not self.reasons

    def error(self, frequency: ArrayLike, momentum_states: bool = False) -> FloatArray:
        """Return the relative error of this subsystem's model over frequency (N,), rad/s: see `Precession.error`."""
        omega = np.atleast_1d(np.asarray(frequency))
        omega = real_array("frequency", omega, (omega.size,))
        if np.any(omega <= 0.0):
            raise ArgumentError(f"frequency: must be above 0 rad/s, got {short(frequency)}")
        rows = Rows.of(self.model, self._rows)
        return rows.error(np.linalg.solve(rows.T, self._kept(momentum_states)), omega)

    def _kept(self, momentum_states: bool) -> FloatArray:
        """Return the directions whose momenta the model keeps."""
        if momentum_states:
            return self.momentum_directions
        if self.null_directions.shape[1]:
            raise MechanicsError(f"precession theory is not admissible: {self.reasons[0]}; {self.cures[0]}")
        return self.null_directions

    @property
    def _rows(self) -> list[int]:
        return [self.model.gimbal_names.index(name) for name in self.gimbals]


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

    See docs/theory/precession.md.
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
        return tuple(f"{'-'.join(part.gimbals)}: {line}" for part in self.parts for line in part.cures)

    @property
    def momentum_states(self) -> int:
        """How many momentum states cure all subsystems; 0 where precession theory is admissible."""
        return sum(part.momentum_directions.shape[1] for part in self.parts)

    def part(self, gimbal: str) -> PrecessionPart:
        """Return the test of the subsystem that the named gimbal belongs to."""
        known_name("gimbal", gimbal, self.gimbals)
        return next(part for part in self.parts if gimbal in part.gimbals)

    def state_space(self, momentum_states: bool = False) -> control.StateSpace:
        """Return the precession model: D q̇ + S q + G_Omega ω = Q solved for q̇.

        Parameters
        ----------
        momentum_states
            Keep the momenta that it takes, as states ``pi_`` + an angle behind the angles, N m s.

        Returns
        -------
        control.StateSpace
            Inputs are the torquers of these gimbals in the file's order, then Omega1 to Omega3; outputs are the
            angles.

        Raises
        ------
        MechanicsError
            Precession theory is not admissible and `momentum_states` is False; the error says the first reason.
        ArgumentError
            Two signals would have the same name.
        """
        for part in self.parts:
            if not (momentum_states or part.admissible):
                raise MechanicsError(f"precession theory is not admissible: {part.reasons[0]}; {part.cures[0]}")
        angles = [self.model.angle_names[self.model.platform.gimbal(name)] for name in self.gimbals]
        torquers, torque_map = gimbal_torquers(self.model, self.gimbals)
        momenta = [_leading(part.momentum_directions) for part in self.parts]
        names = [f"pi_{part.angles[k]}" for part, leads in zip(self.parts, momenta, strict=True) for k in leads]
        names = [*angles, *(names if momentum_states else [])]
        A, B = np.zeros((len(names), len(names))), np.zeros((len(names), len(torquers) + 3))
        first = len(angles)
        for part in self.parts:
            V = part._kept(momentum_states)
            rows = Rows.of(self.model, part._rows)
            n, k = V.shape
            found, to_file = rows.reduced(np.linalg.solve(rows.T, V))[0], block_diag(rows.T, np.eye(k))
            mine = [self.gimbals.index(name) for name in part.gimbals]
            at = [*mine, *range(first, first + k)]
            first += k
            A[np.ix_(at, at)] = to_file @ found[:, : n + k] @ np.linalg.inv(to_file)
            into = to_file @ found[:, n + k :]
            B[at] = np.hstack([into[:, :n] @ torque_map[mine], into[:, n:]])
        C, D = np.eye(len(angles), len(names)), np.zeros((len(angles), len(torquers) + 3))
        inputs, states = [*torquers, *OMEGA_NAMES], distinct("states", names)
        return NamedMatrices(A, B, C, D, inputs, angles, states).state_space()

    def error(self, frequency: ArrayLike, momentum_states: bool = False) -> FloatArray:
        """Return the relative error of the precession model against the full one.

        ‖P_precession − P‖₂ / ‖P‖₂ with the largest singular values of the transfer functions from torques to angles
        (or rates: the factor jω cancels), in coordinates q = T x, Tᵀ M T = 1, so that no unit and no choice of gimbals
        matters. Of several subsystems the largest counts. With K = 0 and one nutation frequency ν it is ω/ν, exactly.
        Where the precession equations are refused although they have a unique solution, they are measured all the same.

        Parameters
        ----------
        frequency : (N,)
            Above 0, rad/s.
        momentum_states
            Of the model that `state_space` returns with this argument.

        Returns
        -------
        (N,)
            Dimensionless.

        Raises
        ------
        MechanicsError
            The precession equations have no unique solution.
        """
        of_parts = [part.error(frequency, momentum_states) for part in self.parts]
        return np.max(of_parts, axis=0) if of_parts else np.zeros(np.size(frequency))

    def summary(self) -> str:
        """Return a few lines of text: for each subsystem the verdict, its values, the reasons and the cures.

        Returns
        -------
        str
            To print.
        """
        lines = [] if self.parts else ["no gimbals: nothing precesses"]
        for part in self.parts:
            figures = f"nutation from {part.nutation.min():.4g} rad/s, " if part.nutation.size else ""
            figures += f"judged for a loop at {part.loop_frequency:.4g} rad/s"
            lines.append(
                f"{'-'.join(part.gimbals)}: precession theory {'' if part.admissible else 'not '}admissible; {figures}"
            )
            lines += [f"  {line}" for line in (*part.reasons, *part.cures)]
        return "\n".join(lines)


def precession(
    model: LinearModel,
    gimbals: Sequence[str] | None = None,
    loop_frequency: float | None = None,
    separation: float = 3.0,
) -> Precession:
    """Test whether precession theory (15) may be used for a linear model, and return what it gives.

    It drops M q̈. That needs det G ≠ 0, no multiple roots, and nutation well above all that the model is used for. Each
    subsystem is tested by itself.

    Parameters
    ----------
    model
        From `linearise`. Springs and damping of the platform count.
    gimbals
        Names of the gimbals of one or several subsystems; default all.
    loop_frequency
        Up to which the model has to hold, rad/s: the bandwidth of the loop. Default: a hundredth of each subsystem's
        highest nutation frequency.
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

    See docs/theory/precession.md.

    Examples
    --------
    >>> import platform_ctrl as pc
    >>> slow = pc.precession(pc.linearise(pc.read_platform("three_gyro_platform")))
    >>> slow.admissible, slow.momentum_states
    (False, 1)
    >>> slow.part("4").reasons
    ('4-5-7: G_R is 3 x 3 and skew, so its determinant is 0: beta5 - beta7 has no gyroscopic stiffness',)
    """
    frequency = None if loop_frequency is None else positive("loop_frequency", loop_frequency)
    required = positive("separation", separation)
    rows = whole_subsystems(model, gimbals)
    chosen = tuple(model.gimbal_names[k] for k in rows)
    groups = [[model.gimbal_names.index(name) for name in group] for group in subsystems(model) if group[0] in chosen]
    parts = tuple(_tested(model, group, frequency, required) for group in groups)
    return Precession(model=model, gimbals=chosen, parts=parts)


def _tested(model: LinearModel, rows: list[int], loop_frequency: float | None, required: float) -> PrecessionPart:
    """Return the test of one subsystem, the gimbals in `rows`."""
    n, angles = len(rows), [model.angle_names[k] for k in rows]
    unit = Rows.of(model, rows)
    _, gyro, right = np.linalg.svd(unit.T.T @ model.G[np.ix_(rows, rows)] @ unit.T)
    null = _named(unit.T @ right[int(np.sum(gyro > _NOTHING * gyro[0])) :].T)
    tree = topology(model.platform)
    turning = bool(np.any(tree.on_path[tree.carriers][:, rows] & (tree.L[:, None] != 0.0)))
    V = null if turning else np.eye(n)
    loop = _SLOW * float(gyro[0]) if loop_frequency is None else loop_frequency
    (poles, _, _), (roots, chain, rate) = unit.roots(np.eye(n)), unit.roots(np.linalg.solve(unit.T, V))
    slow, dropped = poles[: len(roots)], poles[len(roots) :]
    gap = np.abs(roots[:, None] - slow[None, :])
    root_error = float(max(gap.min(axis=0).max(), gap.min(axis=1).max())) if gap.size else 0.0
    fastest = max(float(np.abs(roots).max(initial=0.0)), rate)
    lowest, highest = float(np.abs(dropped).min(initial=np.inf)), max(loop, fastest)
    findings = _too_near(lowest, loop, fastest, required)
    growing = dropped[dropped.real > _GROWS * np.abs(dropped)]
    if len(growing):
        findings.append((f"what would be dropped grows: pole at {growing[0]:.4g} rad/s", "damp it, or make it stiffer"))
    multiple = _multiple(roots, chain, fastest)
    # Momenta are kept so that a loop may be designed: what splits far below it does not matter there.
    if multiple is not None and (V.shape[1] == 0 or required * root_error > loop):
        what = f"the precession root {multiple:.4g} rad/s is multiple: what is dropped decides how it splits"
        findings.append((what, "part the roots by a change of stiffness or momentum"))
    kept = np.eye(n) if findings else V
    names = _in_words(null, angles)
    if not turning:
        findings.insert(0, ("no rotor gives it any momentum", "give it a rotor that spins"))
    elif len(names):
        singular = f"{n} x {n} and skew, so its determinant is 0" if n % 2 else f"of rank {n - len(names)} of {n}"
        nothing = f"{', '.join(names)} {'has' if len(names) == 1 else 'have'} no gyroscopic stiffness"
        findings.insert(0, (f"G_R is {singular}: {nothing}", ""))
    momenta = _in_words(kept, angles)
    states = "one momentum state, that" if len(momenta) == 1 else f"{len(momenta)} momentum states, those"
    which = "all momenta, that is the full equations" if len(momenta) == n else f"{states} of {', '.join(momenta)}"
    cures = [f"keep {which} (momentum_states=True)", *dict.fromkeys(f"or {cure}" for _, cure in findings if cure)]
    gimbals = tuple(model.gimbal_names[k] for k in rows)
    return PrecessionPart(
        model=model,
        gimbals=gimbals,
        loop_frequency=loop,
        singular_values=gyro,
        null_directions=null,
        momentum_directions=kept,
        reasons=tuple(f"{'-'.join(gimbals)}: {reason}" for reason, _ in findings),
        cures=tuple(cures if findings else ()),
        nutation=np.abs(dropped[dropped.imag >= 0.0]),
        precession_roots=roots,
        root_error=root_error,
        separation=lowest / highest if highest > 0.0 else np.inf,
    )


def _multiple(roots: ComplexArray, chain: int, fastest: float) -> complex | None:
    """Return a multiple root that dropped terms may split, or None.

    A root 0 with complete eigenvectors, or with chains no longer than two, is the same with and without inertia.
    """
    if chain > 2:
        return 0j
    found = roots[roots != 0.0]
    gap = np.abs(found[:, None] - found[None, :]) + np.diag(np.full(len(found), np.inf))
    if gap.size == 0 or gap.min() > _MULTIPLE * fastest:
        return None
    return complex(found[np.unravel_index(int(np.argmin(gap)), gap.shape)[0]])


def _too_near(lowest: float, loop: float, fastest: float, required: float) -> list[tuple[str, str]]:
    """Return where nutation does not lie high enough, each with a remedy."""
    nutation = f"nutation at {lowest:.4g} rad/s lies less than {required:g} times above"
    slower = f"close the loop below {lowest / required:.4g} rad/s, or spin the rotors faster"
    softer = "spin the rotors faster, or make the stiffness softer"
    pairs = (("the loop", loop, slower), ("precession, which stiffness drives", fastest, softer))
    near = [one for one in pairs if lowest * (1.0 + _ROUNDING) < required * one[1]]
    return [(f"{nutation} {what} at {frequency:.4g} rad/s", remedy) for what, frequency, remedy in near]


def _leading(directions: FloatArray) -> list[int]:
    """Return for each direction the angle that it is named after: among equals the first."""
    if not directions.size:
        return []
    weights = 1.0 - _AS_LARGE * np.arange(len(directions))
    return sorted(qr(directions.T * weights, mode="r", pivoting=True)[1][: directions.shape[1]].tolist())


def _named(directions: FloatArray) -> FloatArray:
    """Return the same directions with a 1 where all others have a 0, the angle that is named first forward."""
    found = directions @ np.linalg.inv(directions[_leading(directions)])
    found[np.abs(found) < _NOTHING] = 0.0
    first = np.argmax(np.abs(found) >= _SILENT, axis=0) if found.size else []
    return np.asarray(found * np.sign(found[first, range(found.shape[1])]))


def _in_words(directions: FloatArray, angles: Sequence[str]) -> tuple[str, ...]:
    """Return directions as sums of angles; the first coefficient of each is positive."""
    out = []
    for vector in directions.T:
        sizes = [(c, "" if f"{abs(c):.2g}" == "1" else f"{abs(c):.2g} ") for c in vector]
        parts = [
            f"{'-' if c < 0.0 else '+'} {size}{angle}"
            for (c, size), angle in zip(sizes, angles, strict=True)
            if abs(c) >= _SILENT
        ]
        out.append(" ".join(parts).removeprefix("+ "))
    return tuple(out)
