"""Frequency responses of systems of every kind, and states of transfer functions.

Of C (z I - A)^-1 B + D what does not depend on the point is computed once. In modal coordinates the response is a sum
over the modes, one product of matrices for all points. Where the eigenvectors are too nearly dependent for that
(delays, multiple poles), A is brought to complex Schur form and the triangular equations are solved for all points at
once. Both have the errors of the largest entries of A everywhere: where those count (next to lightly damped poles, and
slow motion of fast systems), z I - A itself is factored, and the solution refined by residuals in the longest numbers
of the processor. Where these are doubles, the error next to a pole of damping zeta is about 1e-16 / zeta. Long chains
of delays leave the equations: a delay of d samples is a factor z^-d.
"""

from __future__ import annotations

import copy
from functools import cached_property
from typing import TYPE_CHECKING, Any, TypeAlias

import numpy as np
from numpy.typing import ArrayLike, NDArray

from platform_ctrl.analysis.system import ComplexArray, System, frequencies, period_of, scaled
from platform_ctrl.common.arguments import short
from platform_ctrl.common.values import FloatArray
from platform_ctrl.errors import ArgumentError

if TYPE_CHECKING:
    import control

# Systems with named signals, and with states.
NamedSystem: TypeAlias = "control.StateSpace | control.TransferFunction"
StateSystem: TypeAlias = "control.StateSpace | control.TransferFunction | System"

# Largest error of a realisation next to the poles' own frequencies, relative to the entry or a thousandth of its peak.
_REALISED = 1e-7


def linear_arrays(system: StateSystem, where: str) -> System:
    """Return the arrays of a `control.StateSpace`, or a minimal realisation of a `control.TransferFunction`.

    `where` is what messages call it. T. Kailath, Linear Systems, 1980, sec. 6.4.
    """
    if isinstance(system, System):
        return system
    if hasattr(system, "frdata"):
        raise ArgumentError(
            f"{where}: frequency response data say nothing between their frequencies; give a control.StateSpace or "
            "TransferFunction (of data take the values that you need from `data.frdata`)"
        )
    if not is_rational(system):
        return System.of(system, where)
    if not all(len(num) <= len(den) for _, _, num, den in _entries(system, where)):
        raise ArgumentError(
            f"{where}: the transfer function is improper, an entry has more zeros than poles; add fast poles"
        )
    return _realisation(system, where)


def is_rational(system: Any) -> bool:
    """Return whether it is a `control.TransferFunction`."""
    return hasattr(system, "num_list") and hasattr(system, "den_list")


def rational_response(system: control.TransferFunction, frequency: FloatArray) -> ComplexArray:
    """Return the values of a transfer function at `frequency` (N,), rad/s, as (p, m, N); inf at a pole."""
    where = "frequency_response"
    dt = period_of(system, where)
    point = np.exp(1j * frequency * dt) if dt else 1j * frequency
    out = np.zeros((system.noutputs, system.ninputs, len(frequency)), dtype=np.complex128)
    for i, j, num, den in _entries(system, where):
        with np.errstate(all="ignore"):
            below = np.polyval(den, point)
            out[i, j] = np.where(below == 0.0, np.inf, np.polyval(num, point) / below) if len(num) else 0.0
    return out


def _entries(system: Any, where: str) -> list[tuple[int, int, FloatArray, FloatArray]]:
    """Return outputs, inputs, numerators (empty: zero) and denominators without leading zeros."""
    out = []
    for i, j in np.ndindex(system.noutputs, system.ninputs):
        num, den = (
            np.trim_zeros(np.asarray(rows[i][j], dtype=np.float64), "f") for rows in (system.num_list, system.den_list)
        )
        if not (den.size and np.all(np.isfinite(num)) and np.all(np.isfinite(den))):
            raise ArgumentError(f"{where}: a coefficient is not finite, or a denominator is 0; check the system")
        out.append((i, j, num, den))
    return out


def _realisation(system: control.TransferFunction, where: str) -> System:
    """Return the companion form of one entry; several have states that they share: python-control finds them."""
    if system.ninputs * system.noutputs > 1:
        import control

        try:
            found = System.of(control.ss(system), where)
        except control.ControlMIMONotImplemented:
            raise ArgumentError(
                f"{where}: states that the entries of a transfer function share are found by slycot, which is not "
                "installed: pip install slycot, or give a control.StateSpace"
            ) from None
        _require_same(system, found, where)
        return found
    ((_, _, num, den),), dt = _entries(system, where), period_of(system, where)
    n = len(den) - 1
    num, den = np.concatenate([np.zeros(n + 1 - len(num)), num]) / den[0], den / den[0]
    A = np.eye(n, k=-1)
    A[:1] -= den[1:]
    return System(A, np.eye(n, 1), (num[1:] - num[0] * den[1:])[None], np.array([[num[0]]]), dt)


def _require_same(system: control.TransferFunction, found: System, where: str) -> None:
    """Raise an ArgumentError where the response of the states is not that of the transfer function."""
    rates = np.abs(np.concatenate([np.roots(den) for *_, den in _entries(system, where)]))
    w = (
        np.linspace(0.05, 0.95, 19) * np.pi / found.dt
        if found.dt
        else np.geomspace(0.1, 10.0, 5)[:, None] * np.unique(np.where(rates > 0.0, rates, 1.0))
    ).ravel()
    true, ours = rational_response(system, w), state_response(found, w)
    size = np.abs(true).max(axis=-1, where=np.isfinite(true), initial=0.0)
    with np.errstate(invalid="ignore"):
        wrong = np.abs(ours - true) > _REALISED * (np.abs(true) + 1e-3 * size[..., None])
    if np.any(wrong & np.isfinite(true) & np.isfinite(ours)):
        raise ArgumentError(
            f"{where}: the transfer function has no realisation of its states to {_REALISED:g} in floating point; "
            "make a control.StateSpace from the parts of the system"
        )


def frequency_response(system: StateSystem, frequency: ArrayLike, axis: int = -1) -> ComplexArray:
    """Return the response of `system` on the imaginary axis or on the unit circle.

    States are balanced. The response is summed over the modes where the condition number of the eigenvectors is below
    1e4, else computed from the Schur form of A; z I - A itself is factored next to lightly damped poles and far below
    fast ones. What rounding changes is as if A were changed in its last digits. The error is relative to the products
    that C sums: where they cancel, as in a steep roll-off between states that mix, the small rest has fewer digits.

    Parameters
    ----------
    system
        Continuous or discrete `control.StateSpace`, p outputs, m inputs, a `control.TransferFunction` (its polynomials
        are evaluated) or `System`, which may have leading batch axes.
    frequency : (N,)
        rad/s, >= 0.
    axis
        Axis of the frequencies in the result: the last one, or with -3 before the matrices, for products of responses.

    Returns
    -------
    complex (p, m, N), or (..., p, m, N)
        In the units of the outputs per unit of the inputs; inf where a frequency coincides with a computed pole.

    Raises
    ------
    ArgumentError
        If `system` or `frequency` is not what is expected, or data have no value at one of the frequencies.

    References
    ----------
    A. J. Laub, IEEE Trans. Automatic Control 26, 1981.
    """
    w = frequencies(frequency, "frequency_response")
    if not isinstance(axis, int) or axis not in (-1, -3):
        raise ArgumentError(f"frequency_response: axis must be -1 or -3, got {short(axis)}")
    if is_rational(system):
        return np.moveaxis(rational_response(system, w), -1, axis)
    return np.moveaxis(state_response(linear_arrays(system, "frequency_response"), w), -1, axis)


# Condition number of the eigenvectors from which on responses come from the Schur form.
_MODAL = 1e4
# |A| times a solution over the right-hand side, from which on z I - A itself is factored.
_GROWN = 1e6
# States that repeat another one a sample later, from which on they are taken out of the equations.
_LATE = 48
# Entries of the largest array at a time.
_TOGETHER = 1 << 22


class _Decomposed:
    """A matrix (n, n) in modal and in Schur form, each computed when it is first needed."""

    def __init__(self, A: FloatArray) -> None:
        self.A = A

    @cached_property
    def modes(self) -> tuple[ComplexArray, ComplexArray]:
        """Eigenvalues (n,), and eigenvectors of length one (n, n)."""
        if not np.isfinite(self.A).all():  # as of a loop beyond floating-point numbers: no response is finite
            return np.full(len(self.A), np.nan + 0j), np.full(self.A.shape, np.nan + 0j)
        values, vectors = np.linalg.eig(self.A)
        return values.astype(np.complex128), vectors.astype(np.complex128)

    @cached_property
    def left(self) -> ComplexArray | None:
        """The inverse of the eigenvectors; None where modes do not tell them apart."""
        with np.errstate(all="ignore"):
            try:
                inverse = np.linalg.inv(self.modes[1])
            except np.linalg.LinAlgError:
                return None
            # Columns have length one: this is about the condition number.
            told_apart = float(np.abs(inverse).max()) < _MODAL / np.sqrt(len(inverse))
        return np.asarray(inverse, dtype=np.complex128) if told_apart else None

    @cached_property
    def schur(self) -> tuple[ComplexArray, ComplexArray]:
        """T, upper triangular, and Q, unitary: A = Q T Q*."""
        from scipy.linalg import schur

        return schur(self.A, output="complex", check_finite=False)  # type: ignore[no-any-return]


class AxisResponse:
    """The response of one system along its frequency axis; `balanced` says whether its states are balanced already.

    A sampled system is evaluated as a function of z - 1: nothing cancels far below the sample rate.
    """

    def __init__(self, system: System, balanced: bool = False) -> None:
        A, B, C, D, self._dt = system
        if not balanced:
            A, B, C = scaled(A, B, C)
        self._late = _Late.of(System(A, B, C, D, self._dt))
        # The triangular equations have as many right-hand sides as inputs: of more inputs than outputs, turned.
        self._turned = C.shape[0] < B.shape[1]
        self._own, self._B, self._C, self._D = (A.T, C.T, B.T, D.T) if self._turned else (A, B, C, D)
        self._A = self._own - np.eye(len(A)) if self._dt > 0.0 else self._own
        self._size = float(np.linalg.norm(self._A))
        self._decomposed = _Decomposed(self._A)

    def part(self, own: System) -> AxisResponse:
        """Return the response of another balanced system with this A; what depends on A alone is computed once."""
        if len(self._A) >= _LATE or self._turned:
            return AxisResponse(own, balanced=True)
        out = copy.copy(self)
        out.__dict__.pop("_residues", None)
        out._B, out._C, out._D = own.B, own.C, own.D
        return out

    def at(self, frequency: FloatArray) -> ComplexArray:
        """Return the response at `frequency` (N,), rad/s, complex (N, p, m); inf at a pole."""
        if self._late is not None:
            return self._late.at(frequency)
        (p, m), n = self._D.shape, len(self._A)
        H = np.empty((p, m, len(frequency)), dtype=np.complex128)
        if not (p and m and n):
            H[:] = self._D[..., None]
        else:
            step = max(1, _TOGETHER // (n * (1 if self._residues is not None else m)))
            with np.errstate(all="ignore"):
                for k in range(0, len(frequency), step):
                    H[..., k : k + step] = self._strictly_proper(frequency[k : k + step])
                H += self._D[..., None]
            H[~np.isfinite(H)] = np.inf
        return H.transpose(2, 1, 0) if self._turned else H.transpose(2, 0, 1)

    @property
    def oldest(self) -> int:
        """Age, in samples, of the oldest values on which the system depends, 0 where no long delay is in it."""
        return 0 if self._late is None else int(self._late.ages.max(initial=1))

    @cached_property
    def poles(self) -> ComplexArray:
        """Poles, in the plane of s or z."""
        own = self._decomposed.modes[0] if self._late is None else np.linalg.eigvals(self._A).astype(np.complex128)
        return own + (1.0 if self._dt > 0.0 else 0.0)

    @cached_property
    def _residues(self) -> ComplexArray | None:
        """What each mode contributes, (p m, n) over z less its pole; None where modes do not tell them apart."""
        vectors, left = self._decomposed.modes[1], self._decomposed.left
        if left is None:
            return None
        with np.errstate(all="ignore"):
            out = (self._C @ vectors)[:, None, :] * (left @ self._B).T
        return np.asarray(out.reshape(-1, len(vectors)), dtype=np.complex128)

    def _strictly_proper(self, frequency: FloatArray) -> ComplexArray:
        """Return C (z I - A)^-1 B, (p, m, N)."""
        z, (p, m), size = _points(frequency, self._dt), self._D.shape, self._size
        if self._residues is None:
            X = self._by_schur(z)
            H = (self._C @ X).reshape(p, m, len(z))
            growth = (np.linalg.norm(X, axis=0) / np.repeat(np.linalg.norm(self._B, axis=0), len(z))).reshape(m, -1)
            near = (size * growth > _GROWN).any(axis=0)
        else:
            gap = z - self._decomposed.modes[0][:, None]
            square = gap.real**2 + gap.imag**2
            nearest = square.min(axis=0)
            shares = gap.conj() * (1.0 / square)
            if not nearest.all():  # at a pole, which not every input may reach
                shares[~self._residues.any(axis=0)] = 0.0
            H = (self._residues @ shares).reshape(p, m, len(z))
            near = (nearest > 0.0) & (nearest < (size / _GROWN) ** 2)
        at, step = np.flatnonzero(near), max(1, _TOGETHER // len(self._A) ** 2)
        for k in range(0, len(at), step):
            some = at[k : k + step]
            exact = _points(frequency[some].astype(np.longdouble), self._dt)
            H[..., some] = (self._C @ self._by_elimination(exact)).transpose(1, 2, 0)
        return np.asarray(H, dtype=np.complex128)

    def _by_schur(self, z: NDArray[np.complexfloating[Any, Any]]) -> ComplexArray:
        """Return (z I - A)^-1 B, (n, m N): for each input one column for each z."""
        T, Q = self._decomposed.schur
        X, every = np.repeat(Q.conj().T @ self._B, len(z), axis=1), np.tile(z, self._B.shape[1])
        for i in range(len(T) - 1, -1, -1):
            if i + 1 < len(T):
                X[i] += T[i, i + 1 :] @ X[i + 1 :]
            X[i] /= every - T[i, i]
        return np.asarray(Q @ X, dtype=np.complex128)

    def _by_elimination(self, exact: NDArray[np.complexfloating[Any, Any]]) -> ComplexArray:
        """Return (z I - A)^-1 B, (N, n, m); inf where z is a pole."""
        every, B, eye = exact[:, None, None], self._B.astype(np.complex128), np.eye(len(self._A))
        M = every.astype(np.complex128) * eye - self._A
        X = _solved(M, B)
        grown = np.linalg.norm(X, axis=1) * np.linalg.norm(self._A) > _GROWN * np.linalg.norm(B, axis=0)
        far = np.flatnonzero(grown.any(axis=1))
        if far.size:
            own = self._own.astype(np.longdouble) - (eye if self._dt > 0.0 else 0.0)
            X[far] += np.linalg.solve(M[far], (B - (every[far] * X[far] - own @ X[far])).astype(np.complex128))
        X[~np.isfinite(X)] = np.inf
        return X


class _Late:
    """A sampled system whose states are mostly those of delays: the others' equations, with powers of z in them."""

    def __init__(self, system: System, late: NDArray[np.bool_], source: NDArray[np.intp]) -> None:
        A, B, C, self._D, self._dt = system
        core = np.flatnonzero(~late)
        seen = np.flatnonzero(late & (np.any(A[core] != 0.0, axis=0) | np.any(C != 0.0, axis=0)))
        # A delayed state is `gain` times another state `age` samples before.
        gain, self.ages, head = np.ones(len(seen)), np.zeros(len(seen), dtype=int), seen.copy()
        while (inside := late[head]).any():
            gain[inside] *= A[head[inside], source[head[inside]]]
            self.ages[inside] += 1
            head[inside] = source[head[inside]]
        self._of = gain[:, None] * (head[:, None] == core)
        self._into, self._onto = A[np.ix_(core, seen)], C[:, seen]
        self._A = A[np.ix_(core, core)] - np.eye(len(core)) + self._into @ self._of
        self._B, self._C = B[core].astype(np.complex128), C[:, core] + self._onto @ self._of

    @staticmethod
    def of(system: System) -> _Late | None:
        """Return the system with its delays taken out, None where it has but few."""
        A, B, D = system.A, system.B, system.D
        if not system.dt > 0.0 or len(A) < _LATE or not D.size:
            return None
        links = A != 0.0
        source = np.argmax(links, axis=1)
        late = (links.sum(axis=1) == 1) & ~np.any(B != 0.0, axis=1)
        # Delays that follow each other in a ring have no source.
        end = np.arange(len(A))
        for _ in range(len(A)):
            if not (inside := late[end]).any():
                break
            end = np.where(inside, source[end], end)
        late &= ~late[end]
        return _Late(system, late, source) if late.sum() >= _LATE else None

    def at(self, frequency: FloatArray) -> ComplexArray:
        """Return the response at `frequency` (N,), rad/s, complex (N, p, m); inf at a pole."""
        n = len(self._A)
        H = np.empty((len(frequency), *self._D.shape), dtype=np.complex128)
        step = max(1, _TOGETHER // max(1, n * n))
        for k in range(0, len(frequency), step):
            w = frequency[k : k + step]
            turns = np.outer(w, self.ages).astype(np.longdouble)
            change = _points(-turns, self._dt).astype(np.complex128)[:, None, :]
            M = _points(w, self._dt)[:, None, None] * np.eye(n) - self._A
            X = _solved(M - (self._into * change) @ self._of, self._B)
            H[k : k + step] = (self._C + (self._onto * change) @ self._of) @ X + self._D
        H[~np.isfinite(H)] = np.inf
        return H


def _solved(M: ComplexArray, B: ComplexArray) -> ComplexArray:
    """Return M^-1 B (N, n, m) of matrices (N, n, n); not a number where one is singular."""
    try:
        return np.linalg.solve(M, np.broadcast_to(B, (len(M), *B.shape))).astype(np.complex128)
    except np.linalg.LinAlgError:
        singular = (np.linalg.slogdet(M)[0] == 0.0)[:, None, None]
        return np.where(singular, np.nan, np.linalg.solve(np.where(singular, np.eye(M.shape[-1]), M), B))


def _points(w: NDArray[np.floating[Any]], dt: float) -> NDArray[np.complexfloating[Any, Any]]:
    """Return j w, or of a sampled system z - 1 = exp(j w dt) - 1, as exactly as w, rad/s, is given."""
    if not dt > 0.0:
        return 1j * w
    tangent = np.tan(w * (0.5 * dt))
    imaginary = 2.0 * tangent / (1.0 + tangent * tangent)
    out = 1j * imaginary
    out.real = -tangent * imaginary
    return np.asarray(out)


def state_response(system: System, w: FloatArray) -> ComplexArray:
    """Return the response of a system, or of a stack of them, along the frequency axis, (..., p, m, N)."""
    A, B, C, D, dt = system
    if A.ndim == B.ndim == C.ndim == D.ndim == 2:
        return AxisResponse(system).at(w).transpose(1, 2, 0)
    batch = np.broadcast_shapes(*(item.shape[:-2] for item in system[:4]))
    A, B, C, D = (np.broadcast_to(item, (*batch, *item.shape[-2:])) for item in system[:4])
    H = np.empty((*batch, *D.shape[-2:], len(w)), dtype=np.complex128)
    if A.shape[-1] and D.size:
        A, B, C = scaled(A, B, C)
    for k in np.ndindex(batch):
        H[k] = AxisResponse(System(A[k], B[k], C[k], D[k], dt), balanced=True).at(w).transpose(1, 2, 0)
    return H
