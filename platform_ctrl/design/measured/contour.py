"""The contour of the Nyquist criterion through measured data: the axis, and half circles round poles that lie on it.

A resonance narrower than the distance of the frequencies changes the sign of the response from one frequency to the
next, and the data do not show on which side of the axis its pole is. It counts as stable: between the two frequencies
the contour leaves the axis to the right, with the response of one pole fitted to the data. Limits on the half circle
are no further restriction: what is bounded on the axis is bounded to the right of it.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from platform_ctrl.analysis.system import ComplexArray
from platform_ctrl.common.values import FloatArray, value
from platform_ctrl.errors import NotCertifiedError

# A pole between two frequencies: the response turns by more than this, rad, and exceeds its neighbours by this factor.
_RESONANCE_TURN = np.radians(110.0)
_RESONANCE_PEAK = 1.5
# Towards the pole the contour first follows the axis, halving the distance so many times.
_HALVINGS = 6
# ... but not nearer than this share of the distance between the two frequencies.
_NEAREST_APPROACH = 5e-3
_ARC_POINTS = 5
# Singular values of a residue that are smaller than this share of the largest one are noise.
_RESIDUE_NOISE = 0.2


@value
class Contour:
    """Points along the contour, upwards, and the response there."""

    s: ComplexArray  # complex (N,): 1/s; on the axis, and to the right of it round poles
    P: ComplexArray  # complex (N, n, n): response at s
    # (N,): size of the residue of the pole that a point was put there for; 0 at measured frequencies.
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
    """Return whether a pole is between two neighbouring frequencies, (N − 1,)."""
    U, sizes, V = np.linalg.svd(P)
    size = sizes[:, 0]
    left = size[:-1] > size[1:]
    u, v = (np.where(left[:, None], item[:-1], item[1:]) for item in (U[:, :, 0], V[:, 0]))
    # In the direction of the largest singular value of the larger response.
    here, there = (np.einsum("ki,kij,kj->k", u.conj(), item, v.conj()) for item in (P[:-1], P[1:]))
    higher = np.maximum(size[1:], size[:-1])
    beyond = np.concatenate([[0.0], size, [0.0]])
    # Dead time turns the response as well; a pole raises it above what is on both sides.
    turned = np.abs(np.angle(there * here.conj())) > _RESONANCE_TURN
    return np.asarray(turned & (higher > _RESONANCE_PEAK * np.maximum(beyond[:-3], beyond[3:])))


def _around(w: FloatArray, P: ComplexArray, k: int) -> Contour:
    """Return the contour between frequencies k and k + 1, round the pole there."""
    p = _pole(w, P, k)
    approach = 0.5 * min(p.imag - w[k], w[k + 1] - p.imag) * 0.5 ** np.arange(_HALVINGS)
    near = int(np.sum(approach > _NEAREST_APPROACH * (w[k + 1] - w[k])))
    approach = approach[: max(near, 1)]
    arc = approach[-1] / 2.0 * np.exp(1j * np.linspace(-0.5 * np.pi, 0.5 * np.pi, _ARC_POINTS))
    s = 1j * p.imag + np.concatenate([-1j * approach, arc, 1j * approach[::-1]])
    # P = B + R/(s − p) with B and R from the two neighbours, and R without what is noise.
    left, right = 1.0 / (1j * w[k] - p), 1.0 / (1j * w[k + 1] - p)
    U, sizes, V = np.linalg.svd((P[k + 1] - P[k]) / (right - left))
    R = (U * np.where(sizes >= _RESIDUE_NOISE * sizes[0], sizes, 0.0)) @ V
    B = 0.5 * (P[k] - R * left + P[k + 1] - R * right)
    return Contour(s=s, P=B + R / (s - p)[:, None, None], residue=np.full(len(s), sizes[0]))


def _pole(w: FloatArray, P: ComplexArray, k: int) -> complex:
    """Return the pole between frequencies k and k + 1, on the axis or left of it."""
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


# Largest turn of an eigenvalue between two frequencies, rad.
_LARGEST_TURN = np.radians(140.0)
# Largest distance of the slope of |det P| at the lowest frequencies from a whole number, and of its phase from that of
# a real number, rad.
_SLOPE_TOLERANCE = 0.3
_PHASE_TOLERANCE = np.radians(60.0)
# Points between 0 and the lowest frequency at which the controller alone is followed, and how far down.
_LOW_POINTS, _LOWEST_SHARE = 400, 1e-8
# Points with a larger real part over the imaginary one lie on half circles, not on the axis.
_OFF_AXIS = 1e-12
_HZ = 1.0 / (2.0 * np.pi)

# The controller's response at points s.
Controller = Callable[[ComplexArray], ComplexArray]


def unstable_poles(plant: Contour, controller: Controller, unstable: int = 0, integrators: int | None = None) -> int:
    """Return the number of unstable poles of the closed loop u = K y, y = P u, with P along the contour.

    K integrates in every channel; its own poles are not unstable. `unstable` is the number of unstable poles of the
    plant, `integrators` that of its poles at s = 0 (z = 1), by default read from the slope of det P at the lowest
    frequencies.
    """
    frequency, P = plant.frequency, plant.P
    L = P @ controller(plant.s)
    _require_gains_at_ends(frequency, L)
    _require_gain_at_resonances(plant, L)
    turned = _below(frequency, P, L, controller, integrators)
    turned += _between(frequency, np.asarray(np.eye(P.shape[-1]) - L, dtype=np.complex128))
    turned -= float(np.angle(1.0 - np.linalg.eigvals(L[-1])).sum())
    return unstable - round(turned / np.pi)


def _require_gains_at_ends(frequency: FloatArray, L: ComplexArray) -> None:
    low, high = np.linalg.svd(L[0], compute_uv=False)[-1], np.abs(np.linalg.eigvals(L[-1])).max()
    if not low > 1.0:
        raise NotCertifiedError(
            f"stability from data: at the lowest frequency, {frequency[0] * _HZ:.3g} Hz, the least gain of P K must "
            f"exceed 1, but is {low:.2g}; measure lower frequencies, or require a faster loop"
        )
    if not high < 1.0:
        raise NotCertifiedError(
            f"stability from data: at the highest frequency, {frequency[-1] * _HZ:.3g} Hz, the gain of P K must be "
            f"below 1, but is {high:.2g}; measure higher frequencies, or limit torque_per_noise"
        )


def _require_gain_at_resonances(plant: Contour, L: ComplexArray) -> None:
    """The closed-loop pole must not be between the half circle and the axis."""
    k = np.flatnonzero(plant.s.real > _OFF_AXIS * plant.frequency)
    weak = np.abs(np.linalg.eigvals(L[k])).max(axis=-1, initial=0.0) < 1.0
    if weak.any():
        raise NotCertifiedError(
            f"stability from data: the gain of P K next to the resonance at {plant.frequency[k[weak][0]] * _HZ:.4g} "
            "Hz must exceed 1; measure more frequencies there, or require resonance_damping"
        )


def plant_integrators(frequency: FloatArray, P: ComplexArray) -> int:
    """Return the number of poles at s = 0 that det P shows at its lowest frequencies."""
    near = max(3, int(np.searchsorted(frequency, 2.0 * frequency[0])))
    w, size = np.log(frequency[:near]), np.log(np.abs(np.linalg.det(P[:near])))
    slope = -float(np.polyfit(w, size, 1)[0])
    if abs(slope - round(slope)) > _SLOPE_TOLERANCE or round(slope) < 0:
        raise NotCertifiedError(
            f"stability from data: below {frequency[near - 1] * _HZ:.3g} Hz det P must fall with a whole power of "
            f"frequency, but falls with {slope:.2f}; measure lower frequencies, or give integrators"
        )
    return round(slope)


def _below(
    frequency: FloatArray, P: ComplexArray, L: ComplexArray, controller: Controller, integrators: int | None
) -> float:
    """Return the phase of s^k det Z from 0 to the lowest frequency, less the k quarter turns of s^k."""
    n, w0 = P.shape[-1], frequency[0]
    k = plant_integrators(frequency, P) if integrators is None else integrators
    at_rest = np.linalg.det(-P[0]) * (1j) ** k
    of_plant = float(np.angle(at_rest**2)) / 2.0
    if abs(of_plant) > _PHASE_TOLERANCE:
        raise NotCertifiedError(
            f"stability from data: at {w0 * _HZ:.3g} Hz the phase of s^{k} det P must be near 0 or 180°, but is "
            f"{np.degrees(of_plant):.0f}° off; measure lower frequencies, or give integrators"
        )
    down = w0 * np.geomspace(_LOWEST_SHARE, 1.0, _LOW_POINTS)
    K = np.asarray(controller(np.asarray(1j * down, dtype=np.complex128)) * down[:, None, None], dtype=np.complex128)
    start = np.linalg.det(1j * K[0])
    of_controller = float(np.angle(start**2)) / 2.0
    of_controller += float(_steps(K).sum())
    of_rest = float(np.angle(1.0 - np.linalg.eigvals(np.linalg.inv(L[0]))).sum())
    return float(of_plant + of_controller + of_rest - 0.5 * np.pi * (k + n))


def _steps(Z: ComplexArray) -> FloatArray:
    """Phases of the eigenvalues of Z_k⁻¹ Z_{k+1}, (N − 1, n)."""
    out: FloatArray = np.angle(np.linalg.eigvals(np.linalg.solve(Z[:-1], Z[1:])))
    return out


def _between(frequency: FloatArray, Z: ComplexArray) -> float:
    turns = _steps(Z)
    widest = np.abs(turns).max(axis=-1)
    k = int(widest.argmax())
    if widest[k] > _LARGEST_TURN:
        raise NotCertifiedError(
            f"stability from data: between {frequency[k] * _HZ:.4g} and {frequency[k + 1] * _HZ:.4g} Hz the phase of "
            f"I − P K jumps by {np.degrees(widest[k]):.0f}°, more than {np.degrees(_LARGEST_TURN):.0f}°; measure more "
            "frequencies there"
        )
    return float(turns.sum())
