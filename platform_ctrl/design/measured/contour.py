"""The contour of the Nyquist criterion through measured data: the axis, and half circles round poles that lie on it.

A resonance sharper than the frequencies are dense changes the sign of the response from one frequency to the next,
and the data between do not say on which side of the axis its pole lies. It counts as stable: between the two
frequencies the contour leaves the axis to the right, with the response of one pole fitted to the data there. Limits
asked on it cost nothing: what is bounded on the axis is bounded to the right of it.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from platform_ctrl.analysis.arrays import ComplexArray
from platform_ctrl.frozen import FloatArray, value

# A pole between two frequencies: the response turns by more than this, rad, and is larger than beyond by this factor.
_TURN = np.radians(110.0)
_PEAK = 1.5
# Towards the pole the contour first follows the axis, halving the distance so many times.
_HALVINGS = 6
# ... but not nearer than this share of the distance between the two frequencies.
_NEAREST = 5e-3
_ARC_POINTS = 5
# Singular values of a residue that are smaller than this share of the largest one are noise.
_NOISE = 0.2


@value
class Contour:
    """Points along the contour, upwards, and the response there.

    Attributes
    ----------
    s : complex (N,)
        1/s; on the axis, and to the right of it round poles.
    P : complex (N, n, n)
        Response at s.
    residue : (N,)
        Size of the residue of the pole that a point was put there for; 0 at measured frequencies.
    """

    s: ComplexArray
    P: ComplexArray
    residue: FloatArray

    @property
    def frequency(self) -> FloatArray:
        """Imaginary part of s, rad/s, (N,)."""
        return np.asarray(self.s.imag, dtype=np.float64)


def contour(frequency: FloatArray, P: ComplexArray) -> Contour:
    """Return the contour through the response P (N, n, n) at `frequency`, rad/s."""
    parts = []
    start = 0
    for k in np.flatnonzero(_jumps(P)):
        parts += [_measured(frequency[start : k + 1], P[start : k + 1]), _around(frequency, P, int(k))]
        start = int(k) + 1
    parts.append(_measured(frequency[start:], P[start:]))
    return Contour(
        s=np.concatenate([part.s for part in parts]),
        P=np.concatenate([part.P for part in parts]),
        residue=np.concatenate([part.residue for part in parts]),
    )


def _measured(frequency: FloatArray, P: ComplexArray) -> Contour:
    return Contour(s=np.asarray(1j * frequency, dtype=np.complex128), P=P, residue=np.zeros(len(frequency)))


def _jumps(P: ComplexArray) -> NDArray[np.bool_]:
    """Whether a pole lies between two frequencies that are next to each other, (N − 1,)."""
    U, sizes, V = np.linalg.svd(P)
    size = sizes[:, 0]
    left = size[:-1] > size[1:]
    u, v = (np.where(left[:, None], item[:-1], item[1:]) for item in (U[:, :, 0], V[:, 0]))
    # What turns is the direction in which the larger of the two answers most.
    here, there = (np.einsum("ki,kij,kj->k", u.conj(), item, v.conj()) for item in (P[:-1], P[1:]))
    higher = np.maximum(size[1:], size[:-1])
    beyond = np.concatenate([[0.0], size, [0.0]])
    # Dead time turns the response as well; a pole raises it above what is on both sides.
    turned = np.abs(np.angle(there * here.conj())) > _TURN
    return np.asarray(turned & (higher > _PEAK * np.maximum(beyond[:-3], beyond[3:])))


def _around(w: FloatArray, P: ComplexArray, k: int) -> Contour:
    """The contour between frequencies k and k + 1, round the pole there."""
    p = _pole(w, P, k)
    approach = 0.5 * min(p.imag - w[k], w[k + 1] - p.imag) * 0.5 ** np.arange(_HALVINGS)
    near = int(np.sum(approach > _NEAREST * (w[k + 1] - w[k])))
    approach = approach[: max(near, 1)]
    arc = approach[-1] / 2.0 * np.exp(1j * np.linspace(-0.5 * np.pi, 0.5 * np.pi, _ARC_POINTS))
    s = 1j * p.imag + np.concatenate([-1j * approach, arc, 1j * approach[::-1]])
    # P = B + R/(s − p) with B and R from the two neighbours, and R without what is noise.
    left, right = 1.0 / (1j * w[k] - p), 1.0 / (1j * w[k + 1] - p)
    U, sizes, V = np.linalg.svd((P[k + 1] - P[k]) / (right - left))
    R = (U * np.where(sizes >= _NOISE * sizes[0], sizes, 0.0)) @ V
    B = 0.5 * (P[k] - R * left + P[k + 1] - R * right)
    return Contour(s=s, P=B + R / (s - p)[:, None, None], residue=np.full(len(s), sizes[0]))


def _pole(w: FloatArray, P: ComplexArray, k: int) -> complex:
    """The pole between frequencies k and k + 1, on the axis or left of it."""
    near = np.arange(max(k - 1, 0), min(k + 3, len(w)))
    if len(near) == 4:
        # P (s − p) = C0 + C1 s at four frequencies, linear in p, C0 and C1.
        s, H = 1j * w[near], P[near].reshape(4, -1)
        lines = np.stack([np.ones(4), s / s[0]], axis=1)
        # What a straight line over s cannot explain, of s P and of P.
        rest = np.eye(4) - lines @ np.linalg.pinv(lines)
        moved, still = (rest @ (s[:, None] * H)).ravel(), (rest @ H).ravel()
        p = complex(np.vdot(still, moved) / np.vdot(still, still))
        if w[k] < p.imag < w[k + 1]:
            return complex(min(p.real, 0.0), p.imag)
    size = np.linalg.norm(P[k : k + 2], 2, axis=(-2, -1))
    return complex(0.0, w[k] + (w[k + 1] - w[k]) * size[1] / size.sum())
