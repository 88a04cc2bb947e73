"""Any controller as its own modes: states that do not see one another, alone or in pairs.

Poles that lie so close together that they cannot be told apart without losing digits stay in one block (Bavely and
Stewart): a decoupling that is worse conditioned than a bound is not done.
"""

from __future__ import annotations

from itertools import pairwise

import numpy as np

from platform_ctrl.analysis.arrays import scaled, state_scaling
from platform_ctrl.export.code.entries import Entry
from platform_ctrl.export.code.scheme import Section
from platform_ctrl.export.code.sections import row
from platform_ctrl.frozen import FloatArray, value

# Largest element of a decoupling transformation, in balanced states.
_MOST = 1e4
# A pole this near to z = 1 is an integrator.
INTEGRATOR = 1e-6


@value
class Modes:
    """A matrix in block-diagonal form.

    Attributes
    ----------
    T, inverse : (n, n)
        x = T x_modes; `inverse` @ A @ T is block-diagonal.
    sizes
        Of the blocks, in their order.

    References
    ----------
    C. A. Bavely, G. W. Stewart, SIAM J. Numerical Analysis 16, 1979.
    """

    T: FloatArray
    inverse: FloatArray
    sizes: tuple[int, ...]


def modes(A: FloatArray) -> Modes:
    """Return the block-diagonal form of a real matrix: blocks of one real pole, a pair, or a cluster.

    Parameters
    ----------
    A : (n, n)
        Balanced.

    Returns
    -------
    Modes
        A pair's block is [[a, w], [-w, a]].

    Notes
    -----
    The arguments are not judged.

    References
    ----------
    C. A. Bavely, G. W. Stewart, SIAM J. Numerical Analysis 16, 1979.
    """
    from scipy.linalg import schur
    from scipy.linalg.lapack import dtrexc, dtrsyl

    n = len(A)
    t, V = schur(A, output="real")
    W = V.T.copy()
    sizes: list[int] = []
    low = 0
    while low < n:
        high = low + _width(t, low)
        while high < n:
            X, scale, _ = dtrsyl(t[low:high, low:high], t[high:, high:], -t[low:high, high:], isgn=-1)
            if np.all(np.isfinite(X)) and scale > 0.0 and np.abs(X).max() <= _MOST * scale:
                X = X / scale
                V[:, high:] += V[:, low:high] @ X
                W[low:high] -= X @ W[high:]
                t[low:high, high:] = 0.0
                break
            # The nearest pole joins the block.
            centre = np.trace(t[low:high, low:high]) / (high - low)
            heads = [k for k in range(high, n) if k == high or t[k, k - 1] == 0.0]
            nearest = min(heads, key=lambda k: abs(_pole(t, k) - centre))
            width = _width(t, nearest)
            t, Q, _ = dtrexc(t, np.eye(n), nearest + 1, high + 1)
            V, W = V @ Q, Q.T @ W
            high += width
        if high - low == 2 and t[low + 1, low] * t[low, low + 1] < 0.0:
            turn = np.sqrt(-t[low + 1, low] / t[low, low + 1])
            V[:, low + 1] *= turn
            W[low + 1] /= turn
        sizes.append(high - low)
        low = high
    return Modes(T=V, inverse=W, sizes=tuple(sizes))


def modal_sections(entry: Entry) -> tuple[tuple[Section, ...], FloatArray]:
    """Return the sections of a controller in its modes, slowest first, and T of x = T x_scheme.

    Parameters
    ----------
    entry
        The controller.

    Returns
    -------
    sections
        One for each mode, and the outputs; a mode's states are in the unit of the torque that they add to most.
    T : (n, n)
        From the scheme's states to the controller's.

    Notes
    -----
    The arguments are not judged.

    References
    ----------
    C. A. Bavely, G. W. Stewart, SIAM J. Numerical Analysis 16, 1979.
    """
    A, B, C, _, period = entry.arrays
    if not len(A):
        return plain_sections(entry)
    balance = state_scaling(A, B, C)
    A, B, C = scaled(A, B, C)
    found = modes(A)
    a, b, c = found.inverse @ A @ found.T, found.inverse @ B, C @ found.T
    firsts = np.concatenate([[0], np.cumsum(found.sizes)])
    blocks = [np.arange(first, last) for first, last in pairwise(firsts)]
    poles = [np.linalg.eigvals(a[np.ix_(block, block)]) for block in blocks]
    order = sorted(range(len(blocks)), key=lambda k: (_corner(poles[k], period), int(blocks[k][0])))
    sections, names, units = [], [""] * len(A), np.ones(len(A))
    for number, k in enumerate(order, 1):
        block = blocks[k]
        size = np.abs(c[:, block]).max(initial=0.0) or 1.0 / (np.abs(b[block]).max(initial=0.0) or 1.0)
        # A power of two: nothing is rounded.
        unit = 2.0 ** -np.floor(np.log2(size))
        own = [f"mode_{number}" if len(block) == 1 else f"mode_{number}_x{i + 1}" for i in range(len(block))]
        for i, name in zip(block, own, strict=True):
            names[i], units[i] = name, unit
        weights = np.hstack([b[block] / unit, a[np.ix_(block, block)]])
        integrating = bool(np.all(np.abs(poles[k] - 1.0) < INTEGRATOR))
        sections.append(
            Section(
                name=f"mode_{number}",
                kind="integral" if integrating else "states",
                note=_note(poles[k], period),
                states=tuple(row(name, w, [*entry.inputs, *own]) for name, w in zip(own, weights, strict=True)),
            )
        )
    columns = [int(i) for k in order for i in blocks[k]]
    shown = np.hstack([entry.arrays.D, (c * units)[:, columns]])
    sources = [*entry.inputs, *(names[i] for i in columns)]
    sections.append(_outputs(entry, shown, sources))
    T = balance[:, None] * (found.T * units)[:, columns]
    return tuple(sections), T


def plain_sections(entry: Entry) -> tuple[tuple[Section, ...], FloatArray]:
    """Return a controller in balanced states, all in one section, and T of x = T x_scheme.

    Parameters
    ----------
    entry
        The controller.

    Returns
    -------
    sections
        The states, if there are any, and the outputs.
    T : (n, n)
        Diagonal, powers of two.

    Notes
    -----
    The arguments are not judged.

    References
    ----------
    Textbook definition.
    """
    A, B, C, D, _ = entry.arrays
    balance = state_scaling(A, B, C)
    A, B, C = scaled(A, B, C)
    names = [f"x{k + 1}" for k in range(len(A))]
    sources = [*entry.inputs, *names]
    sections: list[Section] = []
    if len(A):
        states = tuple(row(name, weights, sources) for name, weights in zip(names, np.hstack([B, A]), strict=True))
        note = "all states of the controller: its poles cannot be told apart"
        sections.append(Section(name="states", kind="states", note=note, states=states))
    sections.append(_outputs(entry, np.hstack([D, C]), sources))
    return tuple(sections), np.diag(balance)


def _outputs(entry: Entry, weights: FloatArray, sources: list[str]) -> Section:
    rows = tuple(row(name, w, sources) for name, w in zip(entry.outputs, weights, strict=True))
    return Section(name="outputs", kind="mix", note="sum of the modes and the direct term", signals=rows)


def _width(t: FloatArray, k: int) -> int:
    return 2 if k + 1 < len(t) and t[k + 1, k] != 0.0 else 1


def _pole(t: FloatArray, k: int) -> complex:
    if _width(t, k) == 1:
        return complex(t[k, k])
    return complex(t[k, k], np.sqrt(abs(t[k, k + 1] * t[k + 1, k])))


def _corner(poles: object, period: float) -> float:
    """Return how fast a block is, rad/s: its slowest pole."""
    z = np.atleast_1d(np.asarray(poles, dtype=np.complex128))
    return float(np.abs(np.log(np.where(np.abs(z) < 1e-300, 1e-300, z)) / period).min())


def _note(poles: object, period: float) -> str:
    z = np.atleast_1d(np.asarray(poles, dtype=np.complex128))
    if np.all(np.abs(z - 1.0) < INTEGRATOR):
        return "integrator" if len(z) == 1 else f"{len(z)} integrators"
    if len(z) == 1 and z[0].real <= 0.0:
        return f"pole at z = {z[0].real:.6g}"
    if len(z) > 2 or (len(z) == 2 and abs(z[0].imag) < 1e-12):
        return "poles that lie close together at z = " + ", ".join(f"{p:.6g}" for p in z)
    s = np.log(z[0]) / period
    hertz = abs(s) / (2.0 * np.pi)
    if len(z) == 1:
        return f"pole at {hertz:.6g} Hz" + ("" if s.real < 0.0 else ", unstable")
    return f"poles at {hertz:.6g} Hz, damping {-s.real / abs(s):.4g}"
