"""Whether precession theory (15) may be used for a subsystem, what stands in its way, and what would cure it."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike

from platform_ctrl.arguments import real_array
from platform_ctrl.errors import ArgumentError, MechanicsError
from platform_ctrl.frozen import FloatArray, value
from platform_ctrl.linearisation import LinearModel
from platform_ctrl.mechanics.kinematics import topology
from platform_ctrl.precession.reduction import (
    ComplexArray,
    Reduction,
    Scaled,
    distance,
    echelon,
    full_poles,
    scaled,
)
from platform_ctrl.precession.trial import tried

# A singular value of D that is this small against the largest is 0.
_NULL = 1e-9
# Loop frequency where none is given, against the highest nutation frequency.
_SLOW = 0.01
# A coefficient of a direction that is this small is not worth a word.
_SILENT = 0.005


@value
class PrecessionPart:
    """The test of one subsystem, and its precession model.

    Attributes
    ----------
    gimbals, angles
        Names, in the file's order.
    M, G, damping, stiffness : (n, n)
        Inertia, G, G − ∂Q/∂q̇ and K − ∂Q/∂q of the linear model: what the test was made with.
    loop_frequency, required_separation
        The model has to hold up to `loop_frequency`, rad/s; what it drops has to be faster by that factor.
    singular_values : (n,)
        Of Tᵀ G T with Tᵀ M T = 1, rad/s, largest first; with nothing else in the equations they are the nutation
        frequencies. Small against the loop is what counts, not small in N m s.
    rank
        Of G: how many singular values are not 0.
    null_directions : (n, k)
        Columns: motions q̇ that G does nothing about, in as few angles each as possible.
    direction_names
        The same in words: "beta5 - beta7" is a motion of β5 against β7.
    restrained
        Whether dampers, or springs, hold all null directions so well that their inertia does not matter either.
    nutation
        Frequencies |s| of the poles of the full equations that are dropped, rad/s, one for a conjugate pair, lowest
        first: nutation, and motion against a restraint. Where null directions are not restrained, these and the next
        three belong to the model that keeps their momenta.
    precession_roots : complex
        Roots of the model, rad/s, slowest first.
    root_error
        Largest distance between the roots and the slow poles of the full equations, rad/s.
    multiple_roots
        Whether they contain a multiple root that dropped terms may split. Non-zero multiple roots do. A root 0 does
        not while its eigenvectors are complete (an angle that the equations do not contain) or its chains of vectors
        are no longer than two: K v₀ = 0, G v₀ + K v₁ = 0 is the same with and without inertia, so that the full
        equations have the same double root. It does with longer chains.
    separation
        Lowest nutation frequency over the loop frequency or the fastest precession, whichever is higher. Precession is
        as fast as stiffness drives it in any direction, ‖G⁻¹ K‖ in coordinates of unit inertia: roots alone can be 0
        under the stiffest spring.
    momentum_directions : (n, k)
        Motions whose momenta a cured model keeps; none where precession theory is admissible.
    admissible
        Whether precession theory may be used as it stands.
    reasons, cures
        Why not, and what would help: lines of text.
    scaled, pure, cured
        The equations in coordinates of unit inertia, and the directions that the pure model (None where it has no
        unique solution) and the cured one treat in their own ways.
    """

    gimbals: tuple[str, ...]
    angles: tuple[str, ...]
    M: FloatArray
    G: FloatArray
    damping: FloatArray
    stiffness: FloatArray
    loop_frequency: float
    required_separation: float
    singular_values: FloatArray
    rank: int
    null_directions: FloatArray
    direction_names: tuple[str, ...]
    restrained: bool
    nutation: FloatArray
    precession_roots: ComplexArray
    root_error: float
    multiple_roots: bool
    separation: float
    momentum_directions: FloatArray
    admissible: bool
    reasons: tuple[str, ...]
    cures: tuple[str, ...]
    scaled: Scaled
    pure: Reduction | None
    cured: Reduction

    @property
    def name(self) -> str:
        """The gimbals' names, joined."""
        return "-".join(self.gimbals)

    @property
    def highest_frequency(self) -> float:
        """Frequency above which what is dropped comes too near, rad/s; infinite where nothing is dropped."""
        return float(self.nutation.min(initial=np.inf)) / self.required_separation

    def reduction(self, momentum_states: bool) -> Reduction:
        """Return the directions of the pure or of the cured model.

        Raises
        ------
        MechanicsError
            The pure model has no unique solution.
        """
        if momentum_states:
            return self.cured
        if self.pure is None:
            raise self.refusal()
        return self.pure

    def refusal(self) -> MechanicsError:
        """Return the error that says why precession theory does not serve, and what would."""
        return MechanicsError(f"precession theory is not admissible: {self.reasons[0]}; {self.cures[0]}")

    def error(self, frequency: ArrayLike, momentum_states: bool = False, each_direction: bool = False) -> FloatArray:
        """Return the relative error of this subsystem's model, (N,): see `Precession.error`."""
        omega = np.atleast_1d(np.asarray(frequency))
        omega = real_array("frequency", omega, (omega.size,))
        if np.any(omega <= 0.0):
            raise ArgumentError(f"frequency: given {omega.min():g}; expected numbers > 0, rad/s")
        return distance(self.scaled, self.reduction(momentum_states), omega, each_direction)


def judged(model: LinearModel, rows: Sequence[int], loop_frequency: float | None, required: float) -> PrecessionPart:
    """Return the test of one subsystem, the gimbals in `rows`.

    Raises
    ------
    MechanicsError
        Its mass matrix is singular (gimbal lock).
    """
    at = scaled(model, rows)
    n, part = len(rows), np.ix_(rows, rows)
    angles = [model.angle_names[k] for k in rows]
    _, gyro, right = np.linalg.svd(at.T.T @ model.G[part] @ at.T)
    if loop_frequency is None:
        loop_frequency = _SLOW * float(gyro[0])
    fast = required * loop_frequency
    rank = int(np.sum(gyro > _NULL * gyro[0]))
    null, none = right[rank:].T, np.zeros((n, 0))
    directions, names, _ = named_directions(at, null, angles)
    poles = full_poles(at)
    # The models to choose from: what gives way first stands first.
    order = _least_opposed_first(at, null)
    damped = rank == n or _slowest(null.T @ at.D @ null) > fast > 0.0
    turning = _turns(model, rows)
    first = 0 if damped and turning else n - rank if turning else n
    held = [
        Reduction(N=none, H=order[:, :h])
        for h in range(first, n)
        if h == 0 or _holds(at, order[:, :h], order[:, h:], fast)
    ]
    trials = [tried(at, candidate, poles, loop_frequency) for candidate in held]
    good = next((k for k, trial in enumerate(trials) if not trial.obstacles(required)), 0)
    restrained = bool(held) and (damped or held[good].H.shape[1] >= n - rank)
    findings = []
    if restrained:
        pure: Reduction | None = held[good]
        trial, cured = trials[good], held[good]
    else:
        pure = Reduction(N=none, H=none) if _slowest(at.D) > _NULL * at.size else None
        cured = Reduction(N=order[:, :first], H=none)
        trial = tried(at, cured, poles, loop_frequency)
        findings.append(_lack(turning, at, null, names, fast))
    findings += trial.obstacles(required)
    if findings:
        # As many momenta as it takes; with all of them nothing is dropped.
        for k in range(max(first, 1), n + 1):
            cured = Reduction(N=order[:, :k], H=none)
            if _splits(at, order, k) and not tried(at, cured, poles, loop_frequency).obstacles(required):
                break
    kept, kept_names, _ = named_directions(at, cured.N, angles)
    where = "-".join(model.gimbal_names[k] for k in rows)
    return PrecessionPart(
        gimbals=tuple(model.gimbal_names[k] for k in rows),
        angles=tuple(angles),
        M=model.M[part],
        G=model.G[part],
        damping=model.damping[part],
        stiffness=model.stiffness[part],
        loop_frequency=loop_frequency,
        required_separation=required,
        singular_values=gyro,
        rank=rank,
        null_directions=directions,
        direction_names=names,
        restrained=restrained and rank < n,
        nutation=trial.nutation,
        precession_roots=trial.roots,
        root_error=trial.root_error,
        multiple_roots=trial.multiple_root is not None,
        separation=trial.separation,
        momentum_directions=kept,
        admissible=not findings,
        reasons=tuple(f"{where}: {reason}" for reason, _ in findings),
        cures=(*((_keep(kept_names, n),) if findings else ()), *(f"or {cure}" for _, cure in findings)),
        scaled=at,
        pure=pure,
        cured=cured,
    )


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


def _least_opposed_first(at: Scaled, null: FloatArray) -> FloatArray:
    """Return an orthogonal (n, n) that begins with the null directions; then D grows from column to column."""
    rest = Reduction(N=null, H=null[:, :0]).U
    _, _, right = np.linalg.svd(rest.T @ at.D @ rest)
    return np.hstack([null, rest @ right[::-1].T])


def _slowest(D: FloatArray) -> float:
    """Smallest |s| of s + D, rad/s: how fast a motion gives in to D alone; infinite where there is none."""
    return float(np.abs(np.linalg.eigvals(D)).min()) if len(D) else np.inf


def _splits(at: Scaled, order: FloatArray, k: int) -> bool:
    """Whether D is regular on all but the first k directions: one of a gyroscopic pair alone is not enough."""
    rest = order[:, k:]
    return _slowest(rest.T @ at.D @ rest) > _NULL * at.size


def _holds(at: Scaled, H: FloatArray, U: FloatArray, fast: float) -> bool:
    """Whether springs hold the directions H, each at a frequency above `fast`, and D the directions U."""
    stiffness = np.linalg.eigvals(H.T @ at.S @ H)
    if np.any(stiffness.real <= 0.0) or np.sqrt(np.abs(stiffness).min()) < fast:
        return False
    # D on U as the held directions, which give way, leave it.
    give = H @ np.linalg.solve(H.T @ at.S @ H, H.T)
    return _slowest(U.T @ (np.eye(len(U)) - at.S @ give) @ at.D @ U) > max(fast, _NULL * at.size)


def _turns(model: LinearModel, rows: Sequence[int]) -> bool:
    """Whether any of these gimbals carries a rotor that spins."""
    tree = topology(model.platform)
    return bool(np.any(tree.on_path[tree.carriers][:, rows] & (tree.L[:, None] != 0.0)))


def _lack(turning: bool, at: Scaled, null: FloatArray, names: Sequence[str], fast: float) -> tuple[str, str]:
    """Return why null directions that nothing holds are there, and the restraint that would hold them."""
    if not turning:
        return "no rotor gives it any momentum", "give it a rotor that spins"
    n, k = null.shape
    singular = f"G_R is {n} x {n} and skew, so its determinant is 0" if n % 2 else f"G_R has rank {n - k} of {n}"
    why = f"{singular}: {', '.join(names)} {'has' if k == 1 else 'have'} no gyroscopic stiffness"
    if fast == 0.0:
        # No gyroscopic pair at all, so nothing that a restraint could be measured by.
        return why, f"restrain {', '.join(names)} and give loop_frequency"
    stiffness = np.linalg.eigvals(null.T @ at.S @ null)
    held = _slowest(null.T @ at.D @ null)
    if np.all(stiffness.real > 0.0):
        held = max(held, float(np.sqrt(np.abs(stiffness).min())))
    if held > _NULL * at.size:
        why += f"; what restrains it acts up to {held:.3g} rad/s, {fast:.3g} rad/s are needed"
    directions, _ = echelon((at.T @ null).T)
    inertia = k * np.sum((directions @ at.back.T) ** 2, axis=1)
    along = ", ".join(
        f"{name}: stiffness well above {J * fast**2:.3g} N m/rad or damping well above {J * fast:.3g} N m s along it"
        for name, J in zip(names, inertia, strict=True)
    )
    return why, f"restrain {along}"


def _keep(names: Sequence[str], n: int) -> str:
    if len(names) == n:
        return "keep all momenta, that is the full equations"
    if len(names) == 1:
        return f"keep one momentum state, that of {names[0]} (momentum_states=True)"
    return f"keep {len(names)} momentum states, those of {', '.join(names)} (momentum_states=True)"
