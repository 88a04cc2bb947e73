"""`System`, the one carrier of A, B, C, D: in and out of `control.StateSpace`, in series, in feedback, balanced."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any, Literal, NamedTuple, TypeAlias

import numpy as np
from numpy.typing import ArrayLike, NDArray

from platform_ctrl.common.arguments import real_numbers
from platform_ctrl.common.text import unused
from platform_ctrl.common.values import FloatArray, portable
from platform_ctrl.errors import ArgumentError

if TYPE_CHECKING:
    import control

# What users pass in and get back; python-control is loaded where one is made.
StateSpace: TypeAlias = "control.StateSpace"

ComplexArray = NDArray[np.complex128]
# Which systems of a stack, or which inputs or outputs.
Index = Sequence[int] | NDArray[np.intp] | np.integer[Any] | slice | int | None


class System(NamedTuple):
    """A, B, C, D (each may carry leading batch axes) and the sample period `dt` (0: continuous).

    Attributes
    ----------
    A, B, C, D
        Each may carry leading batch axes; in the system's units. Shapes (..., n, n), (..., n, m), (..., p, n), (..., p,
        m).
    dt
        Sample period, s; 0: continuous.
    """

    A: FloatArray
    B: FloatArray
    C: FloatArray
    D: FloatArray
    dt: float = 0.0

    @classmethod
    def of(cls, system: control.StateSpace, where: str) -> System:
        """Return the arrays of a `control.StateSpace`; one without a time base (``dt=None``) counts as continuous.

        `where` is what messages call it. Data, a system that is not finite or has ``dt=True`` raise an `ArgumentError`.
        """
        portable(system)
        try:
            dt, *matrices = period_of(system, where), system.A, system.B, system.C, system.D
        except AttributeError:
            raise ArgumentError(
                f"{where}: must be a control.StateSpace, got {type(system).__name__}; convert it with control.ss"
            ) from None
        A, B, C, D = (np.asarray(item, dtype=np.float64) for item in matrices)
        for name, item in zip("ABCD", (A, B, C, D), strict=True):
            if not np.isfinite(item).all():
                raise ArgumentError(f"{where}: {name} of the system is not finite; check how the system was made")
        return cls(A, B, C, D, dt)

    @classmethod
    def split(cls, whole: FloatArray, states: int, dt: float) -> System:
        """Return the system of [A B; C D], matrices (..., n + p, n + m)."""
        n = states
        return cls(whole[..., :n, :n], whole[..., :n, n:], whole[..., n:, :n], whole[..., n:, n:], dt)

    def at(self, index: Index) -> System:
        """Return a system of a stack, or a stack of some of its systems."""
        return System(self.A[index], self.B[index], self.C[index], self.D[index], self.dt)

    def alike(self, other: System, rounding: float) -> bool:
        """Return whether both have the same matrices but for rounding, a share of the largest entry of each."""
        pairs = [(a, b, rounding * np.abs(b).max(initial=0.0)) for a, b in zip(self[:4], other[:4], strict=True)]
        return all(a.shape == b.shape and bool(np.all(np.abs(a - b) <= most)) for a, b, most in pairs)

    def part(self, outputs: Index, inputs: Index, direct: float = 0.0) -> System:
        """Return the systems from some inputs to some outputs, with all states, and `direct` times the identity."""
        D = self.D[..., outputs, :][..., inputs]
        D = D + direct * np.eye(*D.shape[-2:]) if direct else D
        return System(self.A, self.B[..., inputs], self.C[..., outputs, :], D, self.dt)

    def series(self, second: System, sign: float = 1.0) -> System:
        """Return `sign` times the second system after this one; the sample period is that of the first that has one."""
        A1, B1, C1, D1, dt = self
        A2, B2, C2, D2, second_dt = second
        whole = block([[A1, 0, B1], [B2 @ C1, A2, B2 @ D1], [D2 @ C1, C2, D2 @ D1]], _batch(self, second))
        n = A1.shape[-1] + A2.shape[-1]
        whole[..., n:, :] *= sign
        return System.split(whole, n, dt or second_dt)

    def feedback(
        self, controller: System, inputs: Sequence[int] | None = None, outputs: Sequence[int] | None = None
    ) -> System:
        """Return the loop of u = K (y + n), y = P (u + d), with every state of both, those of the plant first.

        `inputs` and `outputs` are those that the controller uses, in its order; default all. Inputs of the loop: all of
        the plant's, then the noise n; outputs: u, then all of the plant's. Leading axes of both broadcast.
        `ArgumentError` where the algebraic loop I - D_K D_P is singular.
        """
        A, B, C, D, dt = self
        A_K, B_K, C_K, D_K, _ = controller
        n, n_K, m, p = A.shape[-1], A_K.shape[-1], B.shape[-1], C.shape[-2]
        at, seen = (range(size) if some is None else list(some) for some, size in ((inputs, m), (outputs, p)))
        N, k, q = n + n_K, len(at), len(seen)
        # Rows of the states' rates, of u and of y over [x, x_K, d, n]: first of the open loop.
        whole = block(
            [[A, 0, B, np.zeros((n, q))], [0, A_K, 0, 0], [0, C_K, 0, 0], [C, 0, D, 0]], _batch(self, controller)
        )
        u, y = whole[..., N : N + k, :], whole[..., N + k :, :]
        read, D_loop = y[..., seen, :], D[..., seen, :][..., :, at]
        read[..., N + m :] += np.eye(q)
        u += D_K @ read
        if np.any(D_loop) and np.any(D_K):
            u[:] = _solve_algebraic_loop(np.eye(k) - D_K @ D_loop, u)
        whole[..., :n, :] += B[..., :, at] @ u
        whole[..., n:N, :] += B_K @ (read + D_loop @ u)
        y += D[..., :, at] @ u
        return System.split(whole, N, dt)

    def to_control(
        self,
        inputs: Sequence[str],
        outputs: Sequence[str],
        states: Sequence[str] | None = None,
        name: str | None = None,
    ) -> control.StateSpace:
        """Return a `control.StateSpace` with named signals; names that occur twice are numbered.

        States are called x0, x1 and so on by default; a full stop in `name` becomes an underscore.
        """
        import control

        # python-control keeps the full stop to itself.
        options = {} if name is None else {"name": name.replace(".", "_")}
        if states is not None:
            options["states"] = _distinct(states)  # type: ignore[assignment]
        system = control.StateSpace(
            *self, inputs=_distinct(inputs), outputs=_distinct(outputs), remove_useless_states=False, **options
        )
        return portable(system)


def period_of(system: Any, where: str) -> float:
    """Return the sample period of a system, s, 0 of a continuous one and of one without a time base."""
    if system.dt is True:
        raise ArgumentError(f"{where}: the system is discrete without a sample period (dt=True); give dt in s")
    return 0.0 if system.dt is None else float(system.dt)


def block(rows: Sequence[Sequence[NDArray[Any] | Literal[0]]], batch: tuple[int, ...] = ()) -> NDArray[Any]:
    """Return matrices (..., p, m) from blocks whose leading axes broadcast, with `batch` too; 0 stands for zeros."""
    given = [(i, j, one) for i, row in enumerate(rows) for j, one in enumerate(row) if isinstance(one, np.ndarray)]
    heights, widths = {i: one.shape[-2] for i, _, one in given}, {j: one.shape[-1] for _, j, one in given}
    down, right = (np.cumsum([0, *(sizes[k] for k in range(len(sizes)))]) for sizes in (heights, widths))
    shape = *np.broadcast_shapes(batch, *(one.shape[:-2] for *_, one in given)), down[-1], right[-1]
    out = np.zeros(shape, dtype=np.result_type(*(one for *_, one in given)))
    for i, j, one in given:
        out[..., down[i] : down[i + 1], right[j] : right[j + 1]] = one
    return out


def _batch(one: System, other: System) -> tuple[int, ...]:
    """Return the shape to which the leading axes of two systems broadcast."""
    return np.broadcast_shapes(*(item.shape[:-2] for item in (*one[:4], *other[:4])))


def _solve_algebraic_loop(matrix: FloatArray, right: FloatArray) -> FloatArray:
    smallest = np.linalg.svd(matrix, compute_uv=False).min(initial=np.inf)
    if not smallest > 1e-12 * max(1.0, float(np.abs(matrix).max())):
        words = f"the algebraic loop I - D_K D_P is singular (smallest singular value {smallest:.1e})"
        raise ArgumentError(f"closed_loop: {words}; add a lag or a delay, or change a direct gain")
    return np.asarray(np.linalg.solve(matrix, right), dtype=np.float64)


def _distinct(names: Sequence[str]) -> list[str]:
    used: dict[str, None] = {}
    for name in names:
        used[unused(name, used)] = None
    return list(used)


def frequencies(frequency: ArrayLike, where: str) -> FloatArray:
    """Return `frequency` as a vector of finite numbers >= 0, rad/s, or raise `ArgumentError`."""
    out = np.atleast_1d(real_numbers(f"{where}: frequency", frequency))
    if out.ndim != 1 or not np.isfinite(out).all() or out.min(initial=0.0) < 0.0:
        raise ArgumentError(
            f"{where}: frequency must be a vector of finite numbers >= 0 in rad/s, got shape {np.shape(frequency)}"
        )
    return out


def state_scaling(A: FloatArray, B: FloatArray, C: FloatArray) -> FloatArray:
    """Return powers of two s (n,) such that states x / s make [A B; C 0] balanced (Osborne).

    One scaling serves a whole stack. Scaled arrays are ``A * s / s[:, None]``, ``B / s[:, None]``, ``C * s``: exact in
    floating point.
    """
    # The routine itself: what is around it in scipy.linalg takes longer than a small matrix.
    from scipy.linalg.lapack import dgebal

    # Of a stack the mean magnitudes; signs do not matter to what balances.
    A, B, C = (np.abs(x).mean(axis=tuple(range(x.ndim - 2))) if x.ndim > 2 else x for x in (A, B, C))
    n, m, p = A.shape[0], B.shape[1], C.shape[0]
    if n == 0:
        return np.ones(0)
    if not np.isfinite(A).all():
        return np.ones(n)  # there is nothing to balance, which LAPACK would print
    whole = np.zeros((n + m + p, n + m + p))
    first, _, _, s, _ = dgebal(A, scale=1, permute=0)
    # B and C count as much as A does; their rows and columns themselves stay unscaled because
    # LAPACK leaves out states with an empty row or column.
    with np.errstate(over="ignore", invalid="ignore", divide="ignore"):
        size = float(np.linalg.norm(first)) or 1.0
        whole[:n, n : n + m] = _resized(B / s[:, None], size)
        whole[n + m :, :n] = _resized(C * s, size)
    whole[:n, :n] = first
    if not np.isfinite(whole).all():
        return np.ones(n)  # in these units inputs or outputs are beyond all numbers
    more = dgebal(whole, scale=1, permute=0)[3]
    return np.asarray(s * more[:n])


def _resized(block: FloatArray, size: float) -> FloatArray:
    norm = float(np.linalg.norm(block))
    return block * (size / norm) if 0.0 < norm < math.inf else block


def scaled(A: FloatArray, B: FloatArray, C: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return A, B, C in balanced states: the same transfer function, better conditioned."""
    s = state_scaling(A, B, C)
    return A * s / s[:, None], B / s[:, None], C * s


def seen_states(A: FloatArray, C: FloatArray) -> list[int]:
    """Return the states of systems (N, ...) on which an output depends in any of them, by what their matrices show.

    The angle of a balanced gimbal whose rate alone is measured is not among them: it drifts, and no output shows it.
    """
    links = (A != 0.0).any(axis=0)
    seen = (C != 0.0).any(axis=(0, 1))
    while True:
        wider = seen | links[seen].any(axis=0)
        if np.array_equal(wider, seen):
            return [int(k) for k in np.flatnonzero(seen)]
        seen = wider
