"""The H-infinity norm of a closed loop as smooth pieces: every peak near the highest, with derivatives.

A dynamic controller is one matrix M = [A_K, B_K; C_K, D_K], which closes a static loop around the
plant with the controller's integrators beside it. From M on, at any s,

    T(M + dM) = T + L dM (I − N dM)⁻¹ R,     L, R, N: the loop from u to z, from w to y and from u to y,

so that first and second derivatives of a singular value are products of small matrices (Apkarian and Noll, IEEE
Trans. Automatic Control 51, 2006, for the first; the second is ordinary perturbation of a Hermitian eigenvalue). A
peak's frequency moves with the controller: its gradient is that at fixed frequency, its curvature is the Schur
complement of the frequency in the joint Hessian.

Where peaks are follows from the eigenvalues of a Hamiltonian matrix at a level somewhat below the highest peak known
(Boyd and Balakrishnan, Systems & Control Letters 15, 1990), used as proposals only.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from platform_ctrl.common.values import FloatArray, value
from platform_ctrl.design.partition import Partition

ComplexArray = NDArray[np.complex128]

# Steps of the search for the top of a peak.
_CLIMBS = 12
# Bend of a peak over the logarithm of frequency, relative to its height, below which it is flat.
_FLAT = 0.05
# Peaks that no deeper dip than this parts, relative, count once.
_DIP = 1e-6


@value
class Peaks:
    """Singular values at and near the peaks of a closed loop."""

    frequency: FloatArray  # (k,): rad/s; inf for the direct term
    values: FloatArray  # (k,): singular values, the largest first
    index: NDArray[np.intp]  # (k,): which singular value at that frequency
    gradients: FloatArray  # (k, rows, columns): with respect to M


class ClosedLoop:
    """The loop of an augmented plant and one matrix M."""

    def __init__(self, plant: Partition, M: FloatArray) -> None:
        self.plant, self.M = plant, M
        ny, nu = plant.D22.shape
        if np.any(plant.D22):
            E = np.linalg.inv(np.eye(nu) - M @ plant.D22)
            if not np.abs(E).max() < 1e10:
                raise np.linalg.LinAlgError("not well posed")
            F = np.eye(ny) + plant.D22 @ E @ M
            gain = E @ M
            self.B2, self.C2 = plant.B2 @ E, F @ plant.C2
            self.D12, self.D21, self.D22 = plant.D12 @ E, F @ plant.D21, plant.D22 @ E
        else:
            gain, self.B2, self.C2 = M, plant.B2, plant.C2
            self.D12, self.D21, self.D22 = plant.D12, plant.D21, plant.D22
        self.A = plant.A + plant.B2 @ gain @ plant.C2
        self.B = plant.B1 + plant.B2 @ gain @ plant.D21
        self.C = plant.C1 + plant.D12 @ gain @ plant.C2
        self.D = plant.D11 + plant.D12 @ gain @ plant.D21
        self._poles: ComplexArray | None = None
        self._balanced: tuple[FloatArray, FloatArray, FloatArray] | None = None

    @property
    def poles(self) -> ComplexArray:
        """Closed-loop poles, rad/s."""
        if self._poles is None:
            self._poles = np.linalg.eigvals(self.A).astype(np.complex128)
        return self._poles

    def abscissa(self) -> float:
        """Return the largest real part of the poles."""
        return float(np.max(self.poles.real, initial=-np.inf))

    def pole_pieces(self, window: float) -> tuple[FloatArray, FloatArray]:
        """Return real parts within `window` of the largest, (k,), and their gradients with respect to M, (k, r, c)."""
        from scipy.linalg import eig

        poles, left, right = eig(self.A, left=True, right=True)
        top = float(np.max(poles.real))
        near = np.flatnonzero((poles.real >= top - window) & (poles.imag >= 0.0))
        near = near[np.argsort(-poles.real[near], kind="stable")]
        inner = np.einsum("ik,ik->k", left[:, near].conj(), right[:, near])
        # A defective pole has no gradient; a finite one of the right direction serves.
        inner = np.where(np.abs(inner) < 1e-8, 1e-8, inner)
        a, b = left[:, near].conj().T @ self.B2, self.C2 @ right[:, near] / inner
        return poles.real[near], np.real(a[:, :, None] * b.T[:, None, :])

    def _shifted(self, frequency: FloatArray) -> ComplexArray:
        """Return jωI − A, (N, n, n)."""
        n = len(self.A)
        out = np.empty((len(frequency), n, n), dtype=np.complex128)
        out[:] = -self.A
        out.reshape(len(frequency), n * n)[:, :: n + 1] += 1j * frequency[:, None]
        return out

    def resolvent(self, frequency: FloatArray) -> ComplexArray:
        """Return (jωI − A)⁻¹ at finite frequencies, (N, n, n)."""
        return np.asarray(np.linalg.inv(self._shifted(frequency)))

    def gains(self, frequency: FloatArray) -> FloatArray:
        """Return the largest singular value at finite frequencies."""
        T = self.C @ np.linalg.solve(self._shifted(frequency), self.B[None]) + self.D
        return np.asarray(np.linalg.svd(T, compute_uv=False)[:, 0])

    def top(self, memory: FloatArray, enough: float) -> tuple[float, float]:
        """Return the norm and its frequency, inf for the direct term (Bruinsma and Steinbuch 1990).

        The frequencies in `memory` are looked at first; above `enough` any value that the loop has somewhere serves.
        """
        direct = float(np.linalg.norm(self.D, 2)) if np.any(self.D) else 0.0
        best, frequency = direct, np.inf
        poles = self.poles
        resonant = poles[np.argsort(-np.abs(poles.imag) / (np.abs(poles.real) * np.abs(poles) + 1e-300))[:2]]
        look = np.concatenate([[0.0], memory, np.abs(resonant), np.abs(resonant.imag)])
        for _ in range(30):
            gains = self.gains(look)
            i = int(np.argmax(gains))
            if gains[i] <= best * (1.0 + 1e-9):
                break
            best, frequency = float(gains[i]), float(look[i])
            if best > enough:
                break
            crossed = self._crossed(best * (1.0 + 1e-9), direct)
            if crossed.size == 0:
                break
            look = np.concatenate([0.5 * (crossed[1:] + crossed[:-1]), [0.5 * crossed[0]]])
        return best, frequency

    def slope(self, frequency: float) -> FloatArray:
        """Return the gradient of the largest singular value at one frequency with respect to M."""
        T, L, R, _ = self.responses(frequency)
        U, _, Vh = np.linalg.svd(T, full_matrices=False)
        return np.real(np.outer(L.T @ U[:, 0].conj(), R @ Vh[0].conj()))

    def crossings(self, level: float) -> FloatArray:
        """Return sorted frequencies that contain those where a singular value equals `level`."""
        from platform_ctrl.analysis.arrays import scaled
        from platform_ctrl.analysis.singular_values import hamiltonian_crossings

        if not level > 0.0:
            return np.zeros(0)
        if self._balanced is None:
            self._balanced = scaled(self.A, self.B, self.C)
        (A, B, C), root = self._balanced, np.sqrt(level)
        return hamiltonian_crossings(A, B / root, C / root, self.D / level)

    def _crossed(self, level: float, direct: float) -> FloatArray:
        """Return the sorted frequencies of Hamiltonian eigenvalues on the axis, to rounding."""
        n = len(self.A)
        H = np.empty((2 * n, 2 * n))
        F: FloatArray = self.A
        driven: FloatArray = self.B / level
        seen: FloatArray = self.C / level
        if np.any(self.D):
            if not level > direct * (1.0 + 1e-6):
                return self.crossings(level)
            R = np.eye(self.D.shape[1]) - self.D.T @ self.D / level**2
            gain = np.asarray(np.linalg.solve(R, np.hstack([self.B.T, self.D.T @ self.C / level])), dtype=np.float64)
            driven, seen = np.asarray(gain[:, :n].T / level), gain[:, n:]
            F = np.asarray(self.A + self.B @ seen / level, dtype=np.float64)
            H[n:, :n] = -(self.C.T @ self.C + self.C.T @ self.D @ seen / level) / level
        else:
            H[n:, :n] = -self.C.T @ seen
        H[:n, :n], H[:n, n:], H[n:, n:] = F, driven @ self.B.T, -F.T
        if not np.all(np.isfinite(H)):
            return np.zeros(0)
        at = np.linalg.eigvals(H)
        return np.sort(at.imag[(at.imag >= 0.0) & (np.abs(at.real) <= 1e-6 * np.abs(at))])

    def peak_frequencies(self, window: float, memory: FloatArray) -> tuple[FloatArray, float]:
        """Return the frequencies of the local maxima above (1 − window) of the highest, and the highest.

        Those in `memory` are looked at in any case.
        """
        poles = self.poles
        direct = float(np.linalg.norm(self.D, 2)) if self.D.size else 0.0
        grid = np.unique(np.concatenate([[0.0], np.abs(poles), np.abs(poles.imag), memory]))
        gains = self.gains(grid)

        def look(more: FloatArray) -> float:
            nonlocal grid, gains
            more = np.setdiff1d(more[np.isfinite(more)], grid)
            if more.size == 0:
                return 0.0
            found = self.gains(more)
            grid, gains = np.concatenate([grid, more]), np.concatenate([gains, found])
            order = np.argsort(grid, kind="stable")
            grid, gains = grid[order], gains[order]
            return float(found.max())

        for _ in range(3):
            top = max(float(gains.max()), direct)
            crossed = self.crossings((1.0 - window) * top)
            look(_between(crossed))
            inside = crossed[(crossed > 0.0)]
            # An interval above the level may hold several peaks.
            wide = np.flatnonzero(self._above(grid, gains, inside, (1.0 - window) * top))
            if wide.size:
                look(np.exp(np.linspace(np.log(inside[wide]), np.log(inside[wide + 1]), 8)[1:-1]).ravel())
            # A level far below the new top still contains all that is near it; one far above has to be looked at again.
            if gains.max() <= top * 1.5:
                break
        for _ in range(6):
            frequency, found = self._tops(grid, gains, window, direct)
            top = max(float(found.max(initial=0.0)), direct)
            if look(_between(self.crossings(top * (1.0 + 1e-8)))) <= top * (1.0 + 1e-8):
                break
        frequency = frequency[found >= (1.0 - window) * top]
        kept: list[float] = []
        for w in np.sort(frequency):
            if not kept or w - kept[-1] > 1e-6 * w:
                kept.append(float(w))
        if direct >= (1.0 - window) * top:
            kept.append(np.inf)
        return np.array(kept), top

    @staticmethod
    def _above(grid: FloatArray, gains: FloatArray, ends: FloatArray, level: float) -> NDArray[np.bool_]:
        """Return which intervals between neighbouring `ends` hold a point of the grid above the level."""
        if ends.size < 2:
            return np.zeros(0, dtype=np.bool_)
        place = np.searchsorted(ends, grid[gains > level], side="right") - 1
        out = np.zeros(ends.size - 1, dtype=np.bool_)
        out[place[(place >= 0) & (place < ends.size - 1)]] = True
        return out & (ends[1:] > 1.001 * ends[:-1])

    def _tops(self, grid: FloatArray, gains: FloatArray, window: float, direct: float) -> tuple[FloatArray, FloatArray]:
        """Return frequencies and heights of the local maxima of a sorted grid, climbed to their tops."""
        padded = np.concatenate([[-np.inf], gains, [-np.inf]])
        local = np.flatnonzero((padded[1:-1] >= padded[:-2]) & (padded[1:-1] >= padded[2:]))
        top = max(float(gains.max()), direct)
        local = _parted(gains, local[gains[local] >= (1.0 - 1.3 * window) * top])
        start = grid[local]
        if local.size == 0:
            return start, np.zeros(0)
        low = grid[np.maximum(local - 1, 0)]
        high = np.where(local + 1 < len(grid), grid[np.minimum(local + 1, len(grid) - 1)], 2.0 * grid[-1])
        frequency = self._climbed(start, low, high)
        found = self.gains(frequency)
        worse = found < gains[local]
        return np.where(worse, start, frequency), np.where(worse, gains[local], found)

    def _climbed(self, start: FloatArray, low: FloatArray, high: FloatArray) -> FloatArray:
        """Newton steps on dσ/dω between brackets, halved where Newton leaves them."""
        w, low, high = start.copy(), low.copy(), high.copy()
        active = w > 0.0
        for _ in range(_CLIMBS):
            if not np.any(active):
                break
            at = w[active]
            slope, bend = self._along_axis(at)
            rising = slope > 0.0
            lo, hi = low[active], high[active]
            lo, hi = np.where(rising, at, lo), np.where(rising, hi, at)
            with np.errstate(divide="ignore", invalid="ignore"):
                new = at - slope / bend
            fine = np.isfinite(new) & (bend < 0.0) & (new > lo) & (new < hi)
            new = np.where(fine, new, 0.5 * (lo + hi))
            moved = np.abs(new - at) > 1e-7 * at
            low[active], high[active], w[active] = lo, hi, new
            active[np.flatnonzero(active)] = moved
        return w

    def _along_axis(self, frequency: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return dσ/dω and d²σ/dω² of the largest singular value."""
        X = self.resolvent(frequency)
        XB = X @ self.B
        CX = self.C @ X
        T = self.C @ XB + self.D
        T1 = -1j * (CX @ XB)
        T2 = -2.0 * (CX @ (X @ XB))
        U, S, Vh = np.linalg.svd(T, full_matrices=True)
        c = U.conj().swapaxes(1, 2) @ T1 @ Vh[:, 0].conj()[:, :, None]  # u_k' T1 v
        d = Vh @ T1.conj().swapaxes(1, 2) @ U[:, :, :1]  # v_k' T1' u
        slope = c[:, 0, 0].real
        bend = np.einsum("ni,nij,nj->n", U[:, :, 0].conj(), T2, Vh[:, 0].conj()).real
        for k in range(len(frequency)):
            apart = S[k, 0] - S[k] > 1e-3 * S[k, 0]
            bend[k] += second_order(c[k], d[k], S[k], float(S[k, 0]), apart)[0, 0]
        return slope, bend

    def responses(self, frequency: float) -> tuple[ComplexArray, ComplexArray, ComplexArray, ComplexArray]:
        """Return T, L, R, N at one frequency, rad/s or inf."""
        if not np.isfinite(frequency):
            return tuple(m.astype(np.complex128) for m in (self.D, self.D12, self.D21, self.D22))  # type: ignore[return-value]
        w = self.B.shape[1]
        shifted = self._shifted(np.array([frequency]))[0]
        X: ComplexArray = np.asarray(np.linalg.solve(shifted, np.hstack([self.B, self.B2])), dtype=np.complex128)
        Z, Y = self.C @ X, self.C2 @ X
        return Z[:, :w] + self.D, Z[:, w:] + self.D12, Y[:, :w] + self.D21, Y[:, w:] + self.D22

    def peaks(self, window: float, memory: FloatArray) -> Peaks:
        """Return all singular values within (1 − window) of the norm at the frequencies of the peaks."""
        frequencies, top = self.peak_frequencies(window, memory)
        out: list[tuple[float, float, int, FloatArray]] = []
        for w in frequencies:
            T, L, R, _ = self.responses(float(w))
            U, S, Vh = np.linalg.svd(T, full_matrices=False)
            for i in np.flatnonzero((1.0 - window) * top <= S):
                a, b = L.conj().T @ U[:, i], R @ Vh[i].conj()
                out.append((float(S[i]), float(w), int(i), np.real(np.outer(a.conj(), b))))
        out.sort(key=lambda one: -one[0])
        return Peaks(
            frequency=np.array([one[1] for one in out]),
            values=np.array([one[0] for one in out]),
            index=np.array([one[2] for one in out], dtype=np.intp),
            gradients=np.array([one[3] for one in out]).reshape(len(out), *self.M.shape),
        )

    def block(self, frequency: float, count: int) -> tuple[FloatArray, ComplexArray, ComplexArray]:
        """Return the `count` largest singular values at one frequency and a_i = L' u_i, b_i = R v_i, a column each.

        To first order the largest singular value at M + dM is the largest eigenvalue of diag(values) + (P + P')/2 with
        P = a' dM b, also where several coincide.
        """
        T, L, R, _ = self.responses(frequency)
        U, S, Vh = np.linalg.svd(T, full_matrices=False)
        return S[:count], L.conj().T @ U[:, :count], R @ Vh[:count].conj().T

    def curvature(self, frequency: float, mix: ComplexArray, J: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return a piece's gradient with respect to M and its Hessian in parameters that move M linearly, J = dM/dx.

        The piece is Re(u' T v) with u, v mixed from the leading singular vectors by the unit vector `mix`.
        """
        T, L, R, N = self.responses(frequency)
        U, S, Vh = np.linalg.svd(T, full_matrices=True)
        r = len(mix)
        u, v = U[:, :r] @ mix, Vh[:r].conj().T @ mix
        height = float(np.abs(mix) ** 2 @ S[:r])
        apart = height - S > 1e-3 * height
        apart[:r] = False
        n = J.shape[2]
        left, right = U.conj().T @ L, R @ v  # u_k' L, R v
        JR = np.einsum("ijx,j->ix", J, right)
        c = left @ JR
        back, across = R @ Vh.conj().T, u.conj() @ L  # R v_k, u' L
        LJ = np.einsum("i,ijx->jx", across, J)
        d = (back.T @ LJ).conj()
        bend = LJ.T @ N @ JR
        H = np.real(bend + bend.T)
        inner = np.isfinite(frequency) and frequency > 0.0
        if inner:
            X = self.resolvent(np.array([frequency]))[0]
            CX, XB = self.C @ X, X @ self.B
            T1, T2 = -1j * (CX @ XB), -2.0 * (CX @ X @ XB)
            L1, R1 = -1j * (CX @ X @ self.B2), -1j * (self.C2 @ X @ XB)
            c = np.hstack([c, (U.conj().T @ T1 @ v)[:, None]])
            d = np.hstack([d, (Vh @ T1.conj().T @ u)[:, None]])
            whole = np.zeros((n + 1, n + 1))
            whole[:n, :n] = H
            mixed = np.real((u.conj() @ L1) @ JR + LJ.T @ (R1 @ v))
            whole[:n, n] = whole[n, :n] = mixed
            whole[n, n] = float(np.real(u.conj() @ T2 @ v))
            H = whole
        H = H + second_order(c, d, S, height, apart)
        if inner:
            # A flat peak would run away with the least change: its frequency is damped.
            bent = float(H[n, n]) - _FLAT * height / frequency**2
            H = H[:n, :n] - (np.outer(H[:n, n], H[:n, n]) / bent if bent < 0.0 else 0.0)
        return np.real(np.outer(across, right)), np.asarray(0.5 * (H + H.T), dtype=np.float64)


def _parted(gains: FloatArray, local: NDArray[np.intp]) -> NDArray[np.intp]:
    """Return the local maxima without those that a flat stretch joins to a higher neighbour."""
    kept: list[int] = []
    for i in local:
        if kept:
            before = kept[-1]
            if gains[before : i + 1].min() >= (1.0 - _DIP) * min(gains[before], gains[i]):
                if gains[i] > gains[before]:
                    kept[-1] = int(i)
                continue
        kept.append(int(i))
    return np.array(kept, dtype=np.intp)


def _between(crossed: FloatArray) -> FloatArray:
    """Return points in all intervals that sorted frequencies divide the axis into."""
    if crossed.size == 0:
        return crossed
    return np.concatenate([[0.5 * crossed[0]], 0.5 * (crossed[1:] + crossed[:-1]), [2.0 * crossed[-1]]])


def second_order(
    c: ComplexArray, d: ComplexArray, S: FloatArray, height: float, apart: NDArray[np.bool_]
) -> FloatArray:
    """Second-order perturbation (n, n) of a singular value, a sum over the other eigenpairs of [0, T; T', 0].

    `height` is the value, of the vectors u and v, among all of them S (r,). c (rows, n) holds u_k' dT v for all left
    vectors k, d v_k' dT' u for all right ones. `apart` (r,) says which of the others are distinct from it: those that
    nearly coincide have no derivatives of their own.
    """
    r = len(S)
    plus, minus = 0.5 * (c[:r] + d[:r]), 0.5 * (c[:r] - d[:r])
    gap = height - S[apart]
    out = (2.0 * np.real(plus[apart].conj().T / gap @ plus[apart])) if np.any(apart) else 0.0
    least = 1e-6 * height + 1e-300
    out = out + 2.0 * np.real(minus.conj().T / np.maximum(height + S, least) @ minus)
    for rest in (c[r:], d[r:]):
        out = out + np.real(rest.conj().T @ rest) / max(height, least)
    return np.asarray(out, dtype=np.float64)
