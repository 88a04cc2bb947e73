"""A controller closed around every plant of a set, with derivatives: responses, singular values, poles, noise.

The formulas are in `descent`.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import cached_property
from typing import NamedTuple

import numpy as np

from platform_ctrl.analysis.between_samples import response_at
from platform_ctrl.analysis.feedback import sensitivities_of_plants
from platform_ctrl.analysis.loop import Loop
from platform_ctrl.analysis.norms import LEVEL, stationary_covariance
from platform_ctrl.analysis.plant_set import REGULAR, PlantSet
from platform_ctrl.analysis.poles import SPLIT, continuous_poles
from platform_ctrl.analysis.sight import MeanSquare
from platform_ctrl.analysis.singular_values import largest_singular_values
from platform_ctrl.analysis.system import ComplexArray, System, block
from platform_ctrl.analysis.transfers import SENSITIVITIES, UNDISTURBED, Map, Responses, column_of, maps_of, row_of
from platform_ctrl.common.values import FloatArray
from platform_ctrl.design.fixed_structure import maps
from platform_ctrl.design.sections import gain

# Share of the grid's spacing at which a top is looked at again.
_CLOSER = 0.2
# A point of the grid that is higher than what is found around it by this factor is the top of a narrow peak.
_SPIKE = 1.1
# Decay rates are counted in this share of the nutation frequency, or in their limit over the second number if that is
# less; poles as many units from their limit are active.
_DECAY_UNIT, _NO_DECAY = 0.02, 20.0
_SLOW = 20.0
# Poles this near to that of the angles of regular plants, relative, are theirs: a loop's gain hardly moves them.
_NEARLY = 0.1
# Relative step in frequency for the slope of a singular value.
_SLOPE_STEP = 1e-4
# A gain below this counts as zero: a balanced gimbal without friction transmits nothing.
_NOTHING = 1e-200
# Resonances of less damping may hide between two points of the grid.
_HIDDEN = 0.02


class Points:
    """A loop at single frequencies (k,) of single plants (k,)."""

    def __init__(
        self, loops: LoopGradients, plant: maps.Numbers, frequency: FloatArray, disturbed: bool = False
    ) -> None:
        plants = loops.plants
        z = np.exp(1j * frequency * plants.period)
        P = response_at(plants.arrays, frequency, plant)
        K, self._left, self._right = loops.controller_response(z)
        found = plants.disturbed_at(frequency, plant) if disturbed else UNDISTURBED
        self.responses = Responses(P, K, *sensitivities_of_plants(P, K), loops.loop.fed(frequency), *found)

    def singular(self, of: Map, only: int | None = None) -> maps.Singular:
        """Return the largest singular value of a map at every point as smooth pieces; with `only`, of one point."""
        X = of.response(self.responses)
        found = maps.singular(X if only is None else X[only : only + 1])
        return found._replace(at=found.at + (only or 0))

    def differential(self, of: Map, found: maps.Singular) -> FloatArray:
        """Return the gradients of `found`."""
        responses = Responses(*(item[found.at] if len(item) else item for item in self.responses))
        a, b = of.differential(responses, found.u, found.v)
        row = np.concatenate([row_of(a, self._left[found.at]), a], axis=1)
        column = np.concatenate([column_of(self._right[found.at], b), b], axis=1)
        return np.asarray(np.real(row[:, :, None] * column[:, None, :]))


class LoopGradients:
    """A sampled controller, u = K y, closed around every plant of a set: what pieces have in common."""

    def __init__(self, plants: PlantSet, controller: System, regular: bool = False) -> None:
        # Whether angles that drift decay slowly in `plants`, which gives closed loops poles that they do not have.
        self.regular = regular
        self.plants, self.controller = plants, controller
        self.A_K, self.B_K, self.C_K, self.D_K, _ = controller
        self.M = np.block([[self.A_K, self.B_K], [self.C_K, self.D_K]])
        self.order = len(self.A_K)
        self.p, self.m = plants.C.shape[-2], plants.B.shape[-1]

    @cached_property
    def loop(self) -> Loop:
        """What needs no derivative; the controller's response on the grid is computed as at single points."""
        out = Loop(self.plants, self.controller)
        out.K = self.controller_response(np.exp(1j * self.plants.frequency * self.plants.period))[0]
        return out

    def unstable(self) -> maps.Numbers:
        """Return the plants whose loops are not stable, the fastest growing first."""
        largest = np.abs(np.linalg.eigvals(self._closed.A)).max(axis=-1, initial=0.0)
        return np.argsort(-largest, kind="stable")[: int(np.sum(largest >= 1.0))]

    def controller_response(self, z: ComplexArray) -> tuple[ComplexArray, ComplexArray, ComplexArray]:
        """Return K (k, m, p), C_K R (k, m, n_K) and R B_K (k, n_K, p) at the points `z`."""
        R = np.linalg.inv(z[:, None, None] * np.eye(self.order) - self.A_K)
        right = R @ self.B_K
        return self.C_K @ right + self.D_K, self.C_K @ R, right

    def none(self) -> maps.Pieces:
        """Return no pieces."""
        return self.constant()

    def constant(self, *ratios: float) -> maps.Pieces:
        """Return pieces of the nominal plant that the controller does not change."""
        k = len(ratios)
        gradient = np.zeros((k, self.order + self.m, self.order + self.p))
        return maps.Pieces(ratio=np.array(ratios), gradient=gradient, plant=np.zeros(k, dtype=np.intp))

    def peaks(
        self,
        of: Map,
        floor: float,
        members: maps.Numbers,
        band: tuple[float, float] = (0.0, np.inf),
        ends: bool = True,
    ) -> maps.Pieces:
        """Return the tops of a map's largest singular value that reach `floor`.

        With `ends` the ends of the band count as tops, and the highest top is there even below the floor.
        """
        w = self.plants.frequency
        inside = np.flatnonzero((w >= band[0]) & (w <= band[1]))
        if not len(inside):
            return self.none()
        cut = slice(int(inside[0]), int(inside[-1]) + 1)
        response = self.loop.at(members, of.disturbed, cut)
        sizes = _sizes(of.response(response), floor)
        padded = np.pad(sizes, ((0, 0), (1, 1)), constant_values=-np.inf if ends else np.inf)
        chosen = (sizes >= padded[:, :-2]) & (sizes > padded[:, 2:]) & (sizes >= floor)
        if ends:
            chosen[np.unravel_index(int(np.argmax(sizes)), sizes.shape)] = True
        hidden = self._hidden(of, floor, members, band)
        row, k = np.nonzero(chosen)
        if not len(k):
            return hidden
        x, step = maps.tops(np.log(w[cut]), np.log(np.maximum(sizes, _NOTHING)), row, k)
        # Once more, from three points close to the top.
        close = x + np.multiply.outer(np.array([-_CLOSER, 0.0, _CLOSER]), step)
        near = Points(self, np.tile(members[row], 3), np.exp(close.ravel()), of.disturbed)
        left, middle, right = np.linalg.svd(of.response(near.responses), compute_uv=False)[:, 0].reshape(3, -1)
        fall, rise = left - middle, right - middle
        bend = np.where(fall + rise < 0.0, fall + rise, -np.inf)
        x = x + _CLOSER * step * np.clip(0.5 * (fall - rise) / bend, -2.0, 2.0)
        # A peak narrower than the grid, that one point shows, has its top there and not where a parabola has it.
        beside = sizes[row, k] > _SPIKE * np.maximum(middle, np.maximum(left, right))
        x = np.where(beside, np.log(w[cut])[k], x)
        found = self._pieces(of, members[row], np.exp(x))
        return maps.joined([found, hidden]) if len(hidden.ratio) else found

    def _hidden(self, of: Map, floor: float, members: maps.Numbers, band: tuple[float, float]) -> maps.Pieces:
        """Return a map's largest singular value at resonances narrower than the grid or below it, from `floor` on."""
        s = self.poles.s[members]
        narrow = (
            np.isfinite(s)
            & (s.imag > band[0])
            & (s.imag < min(band[1], float(self.plants.frequency[-1])))
            & (np.abs(s.real) < _HIDDEN * s.imag)
        )
        row, k = np.nonzero(narrow)
        if not len(k):
            return self.none()
        found = self._pieces(of, members[row], s.imag[row, k])
        high = found.ratio >= floor
        return maps.Pieces(ratio=found.ratio[high], gradient=found.gradient[high], plant=found.plant[high])

    def _pieces(self, of: Map, plant: maps.Numbers, frequency: FloatArray) -> maps.Pieces:
        at = Points(self, plant, frequency, of.disturbed)
        found = at.singular(of)
        return maps.Pieces(ratio=found.size, gradient=at.differential(of, found), plant=plant[found.at])

    def sight(self, forms: Sequence[MeanSquare], limit: float) -> maps.Pieces:
        """Return root mean squares of the line of sight over a limit, of the nominal plant."""
        ratios, gradients = [], []
        for one in forms:
            K, left, right = self.controller_response(np.exp(1j * one.theta * one.period))
            size, G = one.root(K)
            eye_m, eye_p = (np.broadcast_to(np.eye(k), (len(K), k, k)) for k in (self.m, self.p))
            into, out = np.concatenate([right, eye_p], axis=1), np.concatenate([left, eye_m], axis=2)
            gradients.append(np.einsum("nbp,npm,nma->ab", into, G, out, optimize=True).real / limit)
            ratios.append(size / limit)
        return maps.Pieces(
            ratio=np.array(ratios), gradient=np.array(gradients), plant=np.zeros(len(ratios), dtype=np.intp)
        )

    def edge(self, of: Map, frequency: float, members: maps.Numbers) -> maps.Pieces:
        """Return a map's largest singular value at one frequency."""
        at = np.full(len(members), min(frequency, float(self.plants.frequency[-1])))
        return self._pieces(of, members, at)

    def level(self, frequency: float, floor: float) -> tuple[maps.Pieces, FloatArray]:
        """Return the largest singular value of the nominal S up to `frequency`, over the level of the bandwidth.

        At most 1 up to the bandwidth. The second result is the derivative of each piece with respect to log(frequency).
        """
        nominal = np.zeros(1, dtype=np.intp)
        w = min(frequency, float(self.plants.frequency[-1]))
        around = w * np.exp(_SLOPE_STEP * np.array([0.0, 1.0, -1.0]))
        at = Points(self, np.zeros(3, dtype=np.intp), around)
        parts, slopes = [], []
        for of in (one for part in SENSITIVITIES for one in maps_of(part, self.plants)):
            tops = self.peaks(of, floor * LEVEL, nominal, (0.0, w), ends=False)
            found = at.singular(of, only=0)
            X = of.response(at.responses)
            change = (X[1] - X[2]) / (2.0 * _SLOPE_STEP)
            edge = maps.Pieces(ratio=found.size, gradient=at.differential(of, found), plant=np.zeros_like(found.at))
            parts += [tops, edge]
            slopes += [np.zeros(len(tops.ratio)), np.real(np.einsum("ki,ij,kj->k", found.u, change, found.v))]
        return maps.joined(parts).times(1.0 / LEVEL), np.concatenate(slopes) / LEVEL

    def damping(self, floor: float, limit: float, members: maps.Numbers) -> maps.Pieces:
        """Return limit/damping of the poles."""
        s = self.poles.s[members]
        finite = np.isfinite(s)
        size = np.where(finite, np.abs(s), 1.0)
        ratio, slope = maps.at_least(np.where(finite, -s.real / size, 1.0), limit)
        counts = finite & (s.imag >= 0.0) & ((size * self.plants.period > SPLIT) | (s.real > 0.0))
        row, k = maps.reaching(ratio, counts, floor)
        s, size = s[row, k], size[row, k]
        # d(−Re s/|s|) = Re((Re s conj(s)/|s|³ − 1/|s|) ds).
        factor = slope[row, k] * (s.real * s.conj() / size**3 - 1.0 / size)
        return maps.Pieces(
            ratio=ratio[row, k], gradient=self._pole_gradient(factor, members[row], k), plant=members[row]
        )

    def decay(self, limit: float, members: maps.Numbers) -> maps.Pieces:
        """Return 1 + (limit − decay)/unit of the slow poles: at most 1 where limit is kept; see `_DECAY_UNIT`.

        The ratio limit/decay would be hardly visible until it is too late.
        """
        s = self.poles.s[members]
        unit = _DECAY_UNIT * self.plants.nutation
        if limit > 0.0:
            # No decay at all has to be worse than most other things.
            unit = min(unit, limit / _NO_DECAY)
        ratio = np.where(np.isfinite(s), 1.0 + (limit + s.real) / unit, -np.inf)
        # Poles of angles that decay slowly in regular plants alone do not count.
        artificial = (np.abs(s + REGULAR) < _NEARLY * REGULAR) & self.regular
        row, k = maps.reaching(ratio, (s.imag >= 0.0) & ~artificial, 1.0 - _SLOW)
        gradient = self._pole_gradient(np.full(len(k), 1.0 / unit), members[row], k)
        return maps.Pieces(ratio=ratio[row, k], gradient=gradient, plant=members[row])

    def fastest(self, floor: float, limit: float, members: maps.Numbers) -> maps.Pieces:
        """Return |w|/limit of the closed-loop poles in the w-plane, w = (2/T) (z − 1)/(z + 1)."""
        z = self.poles.z[members]
        two = 2.0 / self.plants.period
        w = two * (z - 1.0) / (z + 1.0)
        row, k = maps.reaching(np.abs(w) / limit, z.imag >= 0.0, floor)
        z, w = z[row, k], w[row, k]
        # dw = 2 two dz/(z + 1)² and dz = z T ds.
        factor = w.conj() / np.abs(w) * 2.0 * two / (z + 1.0) ** 2 * z * self.plants.period / limit
        gradient = self._pole_gradient(factor, members[row], k)
        return maps.Pieces(ratio=np.abs(w) / limit, gradient=gradient, plant=members[row])

    def controller_poles(self, floor: float, limit: float) -> maps.Pieces:
        """Return |w|/limit of the controller's poles in the w-plane."""
        if not self.order:
            return self.none()
        z, x = np.linalg.eig(self.A_K)
        y = left_vectors(x)
        two = 2.0 / self.plants.period
        w = two * (z - 1.0) / (z + 1.0)
        _, k = maps.reaching(np.abs(w)[None] / limit, (z.imag >= 0.0)[None], floor)
        z, w = z[k], w[k]
        factor = w.conj() / np.maximum(np.abs(w), 1e-12) * 2.0 * two / (z + 1.0) ** 2 / limit
        gradient = np.zeros((len(k), *self.M.shape))
        gradient[:, : self.order, : self.order] = np.real(factor[:, None, None] * y[k][:, :, None] * x.T[k][:, None, :])
        return maps.Pieces(ratio=np.abs(w) / limit, gradient=gradient, plant=np.zeros(len(k), dtype=np.intp))

    @cached_property
    def poles(self) -> Poles:
        """The poles of every closed loop."""
        z, x = np.linalg.eig(self._closed.A)
        # Left eigenvectors. Where A is defective, as with several samples of pure delay, slopes do not exist.
        y = left_vectors(x)
        s = continuous_poles(z, self.plants.period)
        entries = len(self.M)
        left, right = y @ self._closed.B[..., :entries], self._closed.C[..., entries:, :] @ x
        return Poles(*(np.asarray(one, dtype=np.complex128) for one in (z, s, left, right)))

    def _pole_gradient(self, factor: ComplexArray, plant: maps.Numbers, k: maps.Numbers) -> FloatArray:
        """Return the gradient of Re(factor ds) for pole `k` of `plant`."""
        poles = self.poles
        scale = factor / (poles.z[plant, k] * self.plants.period)
        a, b = poles.left[plant, k], poles.right[plant, :, k]
        return np.asarray(np.real(scale[:, None, None] * a[:, :, None] * b[:, None, :]))

    @cached_property
    def _closed(self) -> System:
        """M closed around every plant with the controller's delays beside it, inputs [x_K', u] and outputs [x_K, y].

        From disturbances of M's outputs and noise of its inputs to both: see `System.feedback`; dA = L dM R with L from
        the first ones and R to the last ones.
        """
        A, B, C, D, dt = self.plants.arrays
        own = np.eye(self.order)
        beside = block([[A, 0, 0, B], [0, 0, own, 0], [0, own, 0, 0], [C, 0, 0, D]])
        return System.split(beside, A.shape[-1] + self.order, dt).feedback(gain(self.M))

    def noise(self, limit: float, members: maps.Numbers) -> maps.Pieces:
        """Return rms/limit of the torques from pick-off noise, a piece for each torquer; nothing for unstable loops."""
        stable = [k for k in members if np.all(self.poles.s[k].real < 0.0)]
        return maps.joined([self.none(), *(self._noise(limit, int(k)) for k in stable)])

    def _noise(self, limit: float, plant: int) -> maps.Pieces:
        loop, entries = self._closed.at(plant), len(self.M)
        torques, noise = slice(self.order, entries), slice(entries + self.order, None)
        # The noise enters with the measurement: ȳ = R x + F n, u = M_u ȳ.
        A, L, R = loop.A, loop.B[:, :entries], loop.C[entries:]
        F = (loop.D[entries:, entries:] + np.eye(self.order + self.p))[:, self.order :]
        shown = (loop.D[:entries, :entries] + np.eye(entries))[torques]
        B, C, D = loop.B[:, noise], loop.C[torques], loop.D[torques, noise]
        into = self.plants.noise_input(plant)
        variance = into @ into.T
        X = stationary_covariance(A, B @ into)
        adjoint = stationary_covariance(A.T, C[:, :, None])
        direct = D @ variance
        rms = np.sqrt(np.einsum("ij,jk,ik->i", C, X, C) + np.sum(direct * D, axis=1))
        own = shown[:, :, None] * (C @ X @ R.T + direct @ F.T)[:, None, :]
        inner = L.T @ adjoint @ (A @ X @ R.T + B @ variance @ F.T)
        scale = 1.0 / np.maximum(rms * limit, 1e-300)
        return maps.Pieces(
            ratio=rms / limit,
            gradient=(own + inner) * scale[:, None, None],
            plant=np.full(self.m, plant, dtype=np.intp),
        )


def _sizes(X: ComplexArray, floor: float) -> FloatArray:
    """Return the largest singular values of matrices (N, F, p, m); Frobenius norms of those far below the floor."""
    rank = min(X.shape[-2:])
    if rank < 3:
        return largest_singular_values(X)
    out: FloatArray = np.sqrt(np.sum(X.real**2 + X.imag**2, axis=(-2, -1)))
    # The largest value is at least this; the neighbours of a top say where it is.
    high = np.pad(~(out < min(floor, float(out.max()) / np.sqrt(rank))), ((0, 0), (1, 1)))
    high = high[:, 1:-1] | high[:, :-2] | high[:, 2:]
    out[high] = largest_singular_values(X[high])
    return out


class Poles(NamedTuple):
    """Closed-loop poles in z and s, (N, n), and left (N, n, n_K + m), right (N, n_K + p, n): dz = left dM right."""

    z: ComplexArray
    s: ComplexArray
    left: ComplexArray
    right: ComplexArray


def left_vectors(x: ComplexArray) -> ComplexArray:
    """Return the inverses of stacks of eigenvectors, or least-squares ones where there are none."""
    try:
        return np.asarray(np.linalg.inv(x), dtype=np.complex128)
    except np.linalg.LinAlgError:
        return np.asarray(np.linalg.pinv(x), dtype=np.complex128)
