"""Which accelerations of a subsystem may be dropped: candidates, each held against the full equations."""

from __future__ import annotations

import numpy as np

from platform_ctrl.common.values import FloatArray, value
from platform_ctrl.mechanics.precession.reduction import (
    ComplexArray,
    Reduction,
    Scaled,
    distance,
    full_poles,
    precession_rate,
    roots,
)

# Non-zero roots nearer to each other than this, against the largest, are one multiple root: rounding alone parts a
# double root by the square root of the machine precision.
_MULTIPLE = 1e-7
# A dropped pole with Re s over |s| above this grows: by less than 1 % in a thousand periods it is rounding, or friction
# that nobody lists makes up for it.
_GROWS = 1e-6
# How far from a root the response is measured, whose narrow peak is not meant, and how much more than 1/separation it
# may err: stiffness near its own limit adds as much again.
_ASIDE, _TWICE = 0.2, 2.0
# Room for rounding where something is to lie a factor above something else.
_ROUNDING = 1e-9


@value
class Trial:
    """Roots of a reduction and the poles of the full equations that it drops."""

    roots: ComplexArray  # complex: slowest first, rad/s
    chain: int  # length of the longest chain of vectors at the root 0
    rate: float  # how fast stiffness drives the motion without inertia, in any direction, rad/s
    # slow, dropped: complex: the poles of the full equations that correspond to the roots, and the rest, slowest
    # first, rad/s
    slow: ComplexArray
    dropped: ComplexArray
    pure: bool  # whether no momentum is kept
    loop_frequency: float  # up to which the reduction has to hold, rad/s
    error: float  # relative error of the response there; 0 beside a root, where it peaks

    @property
    def nutation(self) -> FloatArray:
        """|s| of the dropped poles, one for a conjugate pair, rad/s, lowest first."""
        return np.abs(self.dropped[self.dropped.imag >= 0.0])

    @property
    def fastest(self) -> float:
        """How fast anything kept is, rad/s: a root, or precession under stiffness in the worst direction."""
        return max(float(np.abs(self.roots).max(initial=0.0)), self.rate)

    @property
    def separation(self) -> float:
        """Lowest frequency dropped over the highest one kept; infinite where nothing is dropped or nothing kept."""
        kept = max(self.loop_frequency, self.fastest)
        lowest = float(np.abs(self.dropped).min(initial=np.inf))
        return lowest / kept if kept > 0.0 else np.inf

    @property
    def root_error(self) -> float:
        """Largest distance from a root to the nearest slow pole of the full equations or the other way, rad/s."""
        gap = np.abs(self.roots[:, None] - self.slow[None, :])
        return float(max(gap.min(axis=0).max(), gap.min(axis=1).max())) if gap.size else 0.0

    @property
    def multiple_root(self) -> complex | None:
        """A multiple root that what is dropped may split, or None."""
        if self.chain > 2:
            return 0j
        found = self.roots[self.roots != 0.0]
        gap = np.abs(found[:, None] - found[None, :]) + np.diag(np.full(len(found), np.inf))
        if gap.size == 0 or gap.min() > _MULTIPLE * self.fastest:
            return None
        return complex(found[np.unravel_index(int(np.argmin(gap)), gap.shape)[0]])

    def objections(self, required: float) -> list[tuple[str, str]]:
        """Return the objections to the reduction, each with a remedy, where the factor `required` is needed."""
        out: list[tuple[str, str]] = []
        lowest = float(np.abs(self.dropped).min(initial=np.inf))
        enough = lowest * (1.0 + _ROUNDING)
        swinging = len(self.dropped) and abs(self.dropped[0].imag) > abs(self.dropped[0].real)
        what = f"{'nutation' if swinging else 'the dropped decay'} at {lowest:.4g} rad/s"
        if enough < required * self.loop_frequency:
            out.append(
                (
                    f"{what} lies less than {required:g} times above the loop at {self.loop_frequency:.4g} rad/s",
                    f"close the loop below {lowest / required:.4g} rad/s, or spin the rotors "
                    f"{required * self.loop_frequency / lowest:.3g} times faster"
                    if lowest > 0.0
                    else "hold what does not return",
                )
            )
        if enough < required * self.fastest:
            out.append(
                (
                    f"{what} lies less than {required:g} times above precession, which stiffness drives at up to "
                    f"{self.fastest:.4g} rad/s",
                    "spin the rotors faster, or make the stiffness softer",
                )
            )
        growing = self.dropped[self.dropped.real > _GROWS * np.abs(self.dropped)]
        if len(growing):
            fastest = growing[np.argmax(growing.real)]
            out.append((f"what would be dropped grows: pole at {_pole(fastest)} rad/s", "damp it, or make it stiffer"))
        if self.root_error > (1.0 + _ROUNDING) * max(self.loop_frequency, self.fastest) / required:
            out.append(
                (
                    f"its roots miss the slow poles of the full equations by up to {self.root_error:.4g} rad/s",
                    "spin the rotors faster, or make the stiffness softer",
                )
            )
        if not out and self.error > _TWICE / required:
            out.append(
                (
                    f"its response at the loop's frequency is {100.0 * self.error:.0f} % off",
                    "spin the rotors faster, or make the stiffness softer",
                )
            )
        multiple = self.multiple_root
        # Momenta are kept so that a loop may be designed: what splits far below it does not matter there.
        if multiple is not None and (self.pure or required * self.root_error > self.loop_frequency):
            out.append(
                (
                    f"the precession root {_pole(multiple)} rad/s is multiple: what is dropped decides how it splits",
                    "part the roots by a change of stiffness or momentum",
                )
            )
        return out


def trial_of(at: Scaled, kept: Reduction, poles: ComplexArray, loop_frequency: float) -> Trial:
    """Return the trial of a reduction; `poles` are those of the full equations, slowest first."""
    found, chain = roots(at, kept)
    rate = precession_rate(at, kept)
    return Trial(
        roots=found,
        chain=chain,
        rate=rate,
        slow=poles[: len(found)],
        dropped=poles[len(found) :],
        pure=kept.N.shape[1] == 0,
        loop_frequency=loop_frequency,
        error=_error(at, kept, found, loop_frequency),
    )


def _error(at: Scaled, kept: Reduction, found: ComplexArray, loop_frequency: float) -> float:
    beside = np.abs(np.abs(found) - loop_frequency) < _ASIDE * np.abs(found)
    if loop_frequency == 0.0 or beside.any():
        return 0.0
    return float(distance(at, kept, np.array([loop_frequency]), each=False)[0])


def _pole(s: complex) -> str:
    if abs(s.imag) <= _MULTIPLE * abs(s):
        return f"{s.real:.4g}"
    real = f"{s.real:.4g} " if abs(s.real) > _MULTIPLE * abs(s) else ""
    return f"{real}{'-' if s.imag < 0.0 else '+'}{abs(s.imag):.4g}j"


# Of a frequency against the largest there is: 0, but for rounding.
NOTHING = 1e-9


def slowest(D: FloatArray) -> float:
    """Smallest |s| of s + D, rad/s: how fast a motion gives in to D alone; infinite where there is none."""
    return float(np.abs(np.linalg.eigvals(D)).min()) if len(D) else np.inf


def least_opposed_first(at: Scaled, null: FloatArray) -> FloatArray:
    """Return an orthogonal (n, n) that begins with the null directions; then D grows from column to column."""
    rest = Reduction(N=null, H=null[:, :0]).U
    _, _, right = np.linalg.svd(rest.T @ at.D @ rest)
    return np.hstack([null, rest @ right[::-1].T])


def is_regular(at: Scaled, U: FloatArray) -> bool:
    """Whether D alone decides the motion in the directions U: one of a gyroscopic pair alone is not enough."""
    return slowest(U.T @ at.D @ U) > NOTHING * at.size


def holds(at: Scaled, H: FloatArray, U: FloatArray, fast: float) -> bool:
    """Whether springs hold the directions H, each at a frequency above `fast`, and D the directions U."""
    if H.shape[1] == 0:
        return True
    stiffness = np.linalg.eigvals(H.T @ at.S @ H)
    if np.any(stiffness.real <= 0.0) or np.sqrt(np.abs(stiffness).min()) < fast:
        return False
    # D on U as the held directions, which give way, leave it.
    give = H @ np.linalg.solve(H.T @ at.S @ H, H.T)
    return slowest(U.T @ (np.eye(len(U)) - at.S @ give) @ at.D @ U) > max(fast, NOTHING * at.size)


@value
class Choice:
    """The pure model of a subsystem, and the one that cures it."""

    scaled: Scaled  # the equations that both are made of
    held: bool  # whether momentum, dampers or springs oppose motion in every direction, so that none needs its inertia
    pure: Reduction | None  # the model without momenta, or None where it has no unique solution
    cured: Reduction  # the one with as few momenta as it takes; the pure one where that is none
    # of the pure model; where not all directions are held, of the one that keeps the momenta of the others
    trial: Trial


def choose(at: Scaled, null: FloatArray, turning: bool, loop_frequency: float, required: float) -> Choice:
    """Return the models of a subsystem whose G leaves the directions `null` alone, and which has a rotor `turning`."""
    n, none = len(at.D), null[:, :0]
    poles = full_poles(at)
    # The first to be left out comes first.
    order = least_opposed_first(at, null)
    unopposed = null.shape[1] if turning else n
    fast = required * loop_frequency
    # Without a rotor nothing precesses, and without a loop there is nothing that a restraint has to be faster than.
    restrainable = turning and fast > 0.0
    damped = unopposed == 0 or slowest(null.T @ at.D @ null) > fast
    least = 0 if restrainable and damped else unopposed
    # Springs do not stand in for a gyroscopic pair: without any motion there is no precession.
    most = n if unopposed == n else n - 1
    candidates = [
        Reduction(N=none, H=order[:, :h])
        for h in range(least, most + 1)
        if restrainable and holds(at, order[:, :h], order[:, h:], fast)
    ]
    trials = [trial_of(at, candidate, poles, loop_frequency) for candidate in candidates]
    if trials:
        good = next((k for k, trial in enumerate(trials) if not trial.objections(required)), 0)
        pure: Reduction | None = candidates[good]
        trial, cured = trials[good], candidates[good]
    else:
        pure = Reduction(N=none, H=none) if is_regular(at, np.eye(n)) else None
        cured = Reduction(N=order[:, :least], H=none)
        trial = trial_of(at, cured, poles, loop_frequency)
    if not trials or trial.objections(required):
        cured = _cured(at, order, max(least, 1), poles, loop_frequency, required)
    return Choice(scaled=at, held=bool(trials), pure=pure, cured=cured, trial=trial)


def _cured(
    at: Scaled, order: FloatArray, least: int, poles: ComplexArray, loop_frequency: float, required: float
) -> Reduction:
    """Return the model with the fewest momenta, at least `least`, that nothing speaks against."""
    for k in range(least, len(order)):
        kept = Reduction(N=order[:, :k], H=order[:, :0])
        if is_regular(at, order[:, k:]) and not trial_of(at, kept, poles, loop_frequency).objections(required):
            return kept
    # With all momenta nothing is dropped.
    return Reduction(N=order, H=order[:, :0])
