"""The test of one subsystem for precession theory, as a value."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from platform_ctrl.arguments import real_array
from platform_ctrl.errors import ArgumentError, MechanicsError
from platform_ctrl.frozen import FloatArray, value
from platform_ctrl.linearisation import LinearModel
from platform_ctrl.precession.choice import Choice
from platform_ctrl.precession.reduction import ComplexArray, Reduction, Scaled, distance
from platform_ctrl.signatures import check_arguments

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
        Why precession theory may not be used as it stands, and what would help: lines of text, none where it may.

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
        """Whether precession theory may be used as it stands."""
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
        """Return the relative error of this subsystem's model: see `Precession.error`.

        Parameters
        ----------
        frequency : (N,)
            Above 0, rad/s.
        momentum_states, each_direction
            As in `Precession.error`.

        Returns
        -------
        (N,)
            Dimensionless.

        Raises
        ------
        ArgumentError
            Not a row of numbers > 0.
        MechanicsError
            The precession equations have no unique solution.
        """
        omega = np.atleast_1d(np.asarray(frequency))
        omega = real_array("frequency", omega, (omega.size,))
        if np.any(omega <= 0.0) or np.any(omega > _HIGHEST):
            ends = f"{omega.min():g} to {omega.max():g}"
            raise ArgumentError(f"frequency: given {ends}; expected numbers > 0 up to {_HIGHEST:g}, rad/s")
        return distance(*self._reduction(momentum_states), omega, each_direction)

    def _reduction(self, momentum_states: bool) -> tuple[Scaled, Reduction]:
        """Return the equations, and which directions the pure or the cured model treats in their own ways."""
        kept = self._choice.cured if momentum_states else self._choice.pure
        if kept is None:
            raise self._refusal()
        return self._choice.scaled, kept

    def _refusal(self) -> MechanicsError:
        """Return the error that says why precession theory does not serve, and what would."""
        return MechanicsError(f"precession theory is not admissible: {self.reasons[0]}; {self.cures[0]}")

    @property
    def _rows(self) -> list[int]:
        return [self.model.gimbal_names.index(name) for name in self.gimbals]

    def _of(self, matrix: FloatArray) -> FloatArray:
        return np.asarray(matrix[np.ix_(self._rows, self._rows)])
