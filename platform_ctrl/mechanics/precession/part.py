"""The test of one subsystem for precession theory, as a value."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike

from platform_ctrl.common.arguments import real_array
from platform_ctrl.common.signatures import check_arguments
from platform_ctrl.common.values import FloatArray, value
from platform_ctrl.errors import ArgumentError, MechanicsError
from platform_ctrl.mechanics.kinematics import topology
from platform_ctrl.mechanics.linearisation import LinearModel
from platform_ctrl.mechanics.precession.choice import NOTHING, Choice, choose, slowest
from platform_ctrl.mechanics.precession.reduction import ComplexArray, Reduction, Scaled, distance, echelon, scaled

# Highest frequency, rad/s: its square is a number still.
_HIGHEST = 1e150


@value
class PrecessionPart:
    """The test of one subsystem, and its precession model.

    Attributes
    ----------
    model
        The linear model that the subsystem belongs to.
    gimbals
        Names, in the file's order; n of them.
    loop_frequency, required_separation
        The model has to hold up to `loop_frequency`, rad/s; what it drops has to be faster by that factor. 0: no
        frequency was given, and G has none to offer.
    singular_values : (n,)
        Of Tᵀ G T with Tᵀ M T = 1, rad/s, largest first; with nothing else in the equations they are the nutation
        frequencies. Small against the loop is what counts, not small in N m s.
    null_directions : (n, k)
        Columns: motions q̇ that G does nothing about, in as few angles each as possible; dimensionless.
    direction_names
        The same in words: "beta5 - beta7" is a motion of β5 against β7.
    momentum_directions : (n, k)
        Motions whose momenta a cured model keeps, dimensionless; none where precession theory is admissible.
    reasons, cures
        Why precession theory may not be used without changes, and what would help: lines of text, none where it may.

    References
    ----------
    K. Magnus, Ingenieur-Archiv 1976, eqs. (15), (19).

    See docs/precession.md.
    """

    model: LinearModel
    gimbals: tuple[str, ...]
    loop_frequency: float
    required_separation: float
    singular_values: FloatArray
    null_directions: FloatArray
    direction_names: tuple[str, ...]
    momentum_directions: FloatArray
    reasons: tuple[str, ...]
    cures: tuple[str, ...]
    _choice: Choice

    @property
    def name(self) -> str:
        """The gimbals' names, joined."""
        return "-".join(self.gimbals)

    @property
    def angles(self) -> tuple[str, ...]:
        """Names of the angles."""
        return tuple(self.model.angle_names[k] for k in self._rows)

    @property
    def M(self) -> FloatArray:
        """Inertia, (n, n), kg m²."""
        return self._of(self.model.M)

    @property
    def G(self) -> FloatArray:
        """G of (19), (n, n), N m s."""
        return self._of(self.model.G)

    @property
    def damping(self) -> FloatArray:
        """G − ∂Q/∂q̇, (n, n), N m s: what the test was made with."""
        return self._of(self.model.damping)

    @property
    def stiffness(self) -> FloatArray:
        """K − ∂Q/∂q, (n, n), N m/rad."""
        return self._of(self.model.stiffness)

    @property
    def rank(self) -> int:
        """Rank of G: how many singular values are not 0."""
        return len(self.gimbals) - int(self.null_directions.shape[1])

    @property
    def admissible(self) -> bool:
        """Whether precession theory may be used without changes."""
        return not self.reasons

    @property
    def restrained(self) -> bool:
        """Whether dampers or springs hold all null directions so well that their inertia does not matter either."""
        return self._choice.held and self.rank < len(self.gimbals)

    @property
    def nutation(self) -> FloatArray:
        """Frequencies |s| of the poles of the full equations that are dropped, (k,), rad/s, lowest first.

        One for a conjugate pair: nutation, and motion against a restraint. Where null directions are not restrained,
        these, the roots and the separation are those of the model that keeps their momenta.
        """
        return self._choice.trial.nutation

    @property
    def precession_roots(self) -> ComplexArray:
        """Roots of the model, (k,), rad/s, slowest first."""
        return self._choice.trial.roots

    @property
    def root_error(self) -> float:
        """Largest distance between the roots and the slow poles of the full equations, rad/s."""
        return self._choice.trial.root_error

    @property
    def multiple_roots(self) -> bool:
        """Whether the roots contain a multiple one that dropped terms may split.

        Non-zero multiple roots do. A root 0 does not while its eigenvectors are complete (an angle that the equations
        do not contain) or its chains of vectors are no longer than two: K v₀ = 0, G v₀ + K v₁ = 0 is the same with and
        without inertia, so that the full equations have the same double root. It does with longer chains.
        """
        return self._choice.trial.multiple_root is not None

    @property
    def separation(self) -> float:
        """Ratio of the lowest nutation frequency to the loop frequency or the fastest precession, whichever is higher.

        Precession is as fast as stiffness drives it in any direction, ‖G⁻¹ K‖ in coordinates of unit inertia: roots
        alone can be 0 under the stiffest spring.
        """
        return self._choice.trial.separation

    @property
    def highest_frequency(self) -> float:
        """Frequency above which what is dropped comes too near, rad/s; infinite where nothing is dropped."""
        return float(self.nutation.min(initial=np.inf)) / self.required_separation

    @check_arguments
    def error(self, frequency: ArrayLike, momentum_states: bool = False, each_direction: bool = False) -> FloatArray:
        """Return the relative error of this subsystem's model over frequency (N,), rad/s: see `Precession.error`."""
        omega = np.atleast_1d(np.asarray(frequency))
        omega = real_array("frequency", omega, (omega.size,))
        if np.any(omega <= 0.0) or np.any(omega > _HIGHEST):
            ends = f"{omega.min():g} to {omega.max():g}"
            raise ArgumentError(f"frequency: must be above 0 and up to {_HIGHEST:g} rad/s, got {ends}")
        return distance(*self._reduction(momentum_states), omega, each_direction)

    def _reduction(self, momentum_states: bool) -> tuple[Scaled, Reduction]:
        """Return the equations, and which directions the pure or the cured model treats in their own ways."""
        kept = self._choice.cured if momentum_states else self._choice.pure
        if kept is None:
            raise self._refusal()
        return self._choice.scaled, kept

    def _refusal(self) -> MechanicsError:
        """Return the error with the first reason and its cure."""
        return MechanicsError(f"precession theory is not admissible: {self.reasons[0]}; {self.cures[0]}")

    @property
    def _rows(self) -> list[int]:
        return [self.model.gimbal_names.index(name) for name in self.gimbals]

    def _of(self, matrix: FloatArray) -> FloatArray:
        return np.asarray(matrix[np.ix_(self._rows, self._rows)])


# A coefficient of a direction that is this small, half of the last digit in words, is not worth a word.
_SILENT = 0.005


def named_directions(
    at: Scaled, directions: FloatArray, angles: Sequence[str]
) -> tuple[FloatArray, tuple[str, ...], list[int]]:
    """Return directions in x as motions of few angles, (n, k), their names, and the leading angle of each."""
    vectors, leading = echelon((at.T @ directions).T)
    # The angle that is named first moves forward.
    vectors *= np.sign([vector[np.flatnonzero(np.abs(vector) >= _SILENT)[0]] for vector in vectors]).reshape(-1, 1)
    return vectors.T, tuple(_in_words(vector, angles) for vector in vectors), leading


def _in_words(vector: FloatArray, angles: Sequence[str]) -> str:
    words = ""
    for coefficient, angle in zip(vector, angles, strict=True):
        if abs(coefficient) >= _SILENT:
            size = f"{abs(coefficient):.2g}"
            sign = (" - " if words else "-") if coefficient < 0.0 else (" + " if words else "")
            words += f"{sign}{'' if size == '1' else size + ' '}{angle}"
    return words


def missing_restraint(at: Scaled, null: FloatArray, names: Sequence[str], fast: float) -> tuple[str, str]:
    """Return why null directions that nothing holds stand in the way, and the restraint that would hold them."""
    n, k = null.shape
    singular = f"G_R is {n} x {n} and skew, so its determinant is 0" if n % 2 else f"G_R has rank {n - k} of {n}"
    why = f"{singular}: {', '.join(names)} {'has' if k == 1 else 'have'} no gyroscopic stiffness"
    if fast == 0.0:
        # No gyroscopic pair at all, so nothing that a restraint could be measured by.
        return why, f"restrain {', '.join(names)} and give loop_frequency"
    stiffness = np.linalg.eigvals(null.T @ at.S @ null)
    held = slowest(null.T @ at.D @ null)
    if np.all(stiffness.real > 0.0):
        held = max(held, float(np.sqrt(np.abs(stiffness).min())))
    if held > NOTHING * at.size:
        why += f"; what restrains it acts up to {held:.3g} rad/s, {fast:.3g} rad/s are needed"
    directions, _ = echelon((at.T @ null).T)
    inertia = k * np.sum((directions @ at.back.T) ** 2, axis=1)
    along = ", ".join(
        f"{name}: stiffness well above {J * fast**2:.3g} N m/rad or damping well above {J * fast:.3g} N m s along it"
        for name, J in zip(names, inertia, strict=True)
    )
    return why, f"restrain {along}"


def kept_momenta(names: Sequence[str], n: int) -> str:
    """Return the cure that keeps the momenta of the named directions, of n in all."""
    if len(names) == n:
        return "keep all momenta, that is the full equations"
    if len(names) == 1:
        return f"keep one momentum state, that of {names[0]} (momentum_states=True)"
    return f"keep {len(names)} momentum states, those of {', '.join(names)} (momentum_states=True)"


# Loop frequency where none is given, against the highest nutation frequency.
_SLOW = 0.01


def assessed(model: LinearModel, rows: Sequence[int], loop_frequency: float | None, required: float) -> PrecessionPart:
    """Return the test of one subsystem, the gimbals in `rows`."""
    at = scaled(model, rows)
    gimbals, angles = [model.gimbal_names[k] for k in rows], [model.angle_names[k] for k in rows]
    _, gyro, right = np.linalg.svd(at.T.T @ model.G[np.ix_(rows, rows)] @ at.T)
    null = right[int(np.sum(gyro > NOTHING * gyro[0])) :].T
    if loop_frequency is None:
        loop_frequency = _SLOW * float(gyro[0])
    turning = _has_spinning_rotor(model, rows)
    choice = choose(at, null, turning, loop_frequency, required)
    directions, names, _ = named_directions(at, null, angles)
    kept, kept_names, _ = named_directions(at, choice.cured.N, angles)
    findings = choice.trial.objections(required)
    if not turning:
        findings.insert(0, ("no rotor gives it any momentum", "give it a rotor that spins"))
    elif not choice.held:
        findings.insert(0, missing_restraint(at, null, names, required * loop_frequency))
    cures = [kept_momenta(kept_names, len(rows)), *dict.fromkeys(f"or {cure}" for _, cure in findings)]
    return PrecessionPart(
        model=model,
        gimbals=tuple(gimbals),
        loop_frequency=loop_frequency,
        required_separation=required,
        singular_values=gyro,
        null_directions=directions,
        direction_names=names,
        momentum_directions=kept,
        reasons=tuple(f"{'-'.join(gimbals)}: {reason}" for reason, _ in findings),
        cures=tuple(cures if findings else ()),
        _choice=choice,
    )


def _has_spinning_rotor(model: LinearModel, rows: Sequence[int]) -> bool:
    """Whether any of these gimbals carries a rotor that spins."""
    tree = topology(model.platform)
    return bool(np.any(tree.on_path[tree.carriers][:, rows] & (tree.L[:, None] != 0.0)))
