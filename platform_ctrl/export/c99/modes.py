"""Any controller in modal form: decoupled states, alone or in pairs.

Poles that lie so close together that they cannot be separated without losing digits stay in one block (Bavely and
Stewart): a decoupling that is worse conditioned than a bound is not done.
"""

from __future__ import annotations

from itertools import pairwise

import numpy as np

from platform_ctrl.analysis.arrays import scaled, state_scaling
from platform_ctrl.common.values import FloatArray
from platform_ctrl.design.partition import Channels
from platform_ctrl.export.c99.scheme import Entry, Section, row

# Largest element of a decoupling transformation, in balanced states.
_MOST = 1e4
# A pole this near to z = 1 is an integrator.
INTEGRATOR = 1e-6


def _modes(A: FloatArray) -> tuple[FloatArray, FloatArray, list[int]]:
    """Return T, its inverse and the sizes of the blocks of T⁻¹ A T: one real pole, a pair, or a cluster each.

    Bavely, Stewart, SIAM J. Numerical Analysis 16, 1979.
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
    return V, W, sizes


def modal_sections(entry: Entry) -> tuple[tuple[Section, ...], FloatArray]:
    """Return the sections of a controller in its modes, slowest first, and T of x = T x_scheme."""
    A, B, C, _, period = entry.arrays
    if not len(A):
        return plain_sections(entry)
    balance = state_scaling(A, B, C)
    A, B, C = scaled(A, B, C)
    into, inverse, sizes = _modes(A)
    a, b, c = inverse @ A @ into, inverse @ B, C @ into
    firsts = np.concatenate([[0], np.cumsum(sizes)])
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
    T = balance[:, None] * (into * units)[:, columns]
    return tuple(sections), T


def plain_sections(entry: Entry) -> tuple[tuple[Section, ...], FloatArray]:
    """Return a controller in balanced states, all in one section, and T of x = T x_scheme."""
    A, B, C, D, _ = entry.arrays
    balance = state_scaling(A, B, C)
    A, B, C = scaled(A, B, C)
    names = [f"x{k + 1}" for k in range(len(A))]
    sources = [*entry.inputs, *names]
    sections: list[Section] = []
    if len(A):
        states = tuple(row(name, weights, sources) for name, weights in zip(names, np.hstack([B, A]), strict=True))
        note = "all states of the controller: its poles are too close together to be separated"
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
    """Return the slowest pole of a block, rad/s."""
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


def pid_sections(entry: Entry, channel: Channels, angles: tuple[str, ...]) -> tuple[Section, ...] | None:
    """Return the sections of a matrix PID, or None where the matrices have another structure.

    The states are two of every filter, then the integrals; `angles` are the inputs in the order of the outputs'
    gimbals.
    """
    n, T = len(channel.basis), entry.arrays.dt
    A, B, C, D, _ = entry.arrays
    if len(A) != 3 * n:
        return None
    columns = [entry.inputs.index(name) for name in angles]
    B, C = B[:, columns] @ channel.basis.T, channel.basis @ C
    D = channel.basis @ D[:, columns] @ channel.basis.T
    gains = np.zeros((3, n, n))
    filters: list[Section] = []
    integrals: list[Section] = []
    for k in range(n):
        own = slice(2 * k, 2 * k + 2)
        discrete = A[own, own]
        if abs(np.linalg.det(discrete + np.eye(2))) < 1e-9:
            return None
        # The inverse of Tustin's rule.
        continuous = 2.0 / T * (discrete - np.eye(2)) @ np.linalg.inv(discrete + np.eye(2))
        if not continuous[1, 0] < 0.0:
            return None
        frequency = float(np.sqrt(-continuous[1, 0]))
        damping = float(-continuous[1, 1] / (2.0 * frequency))
        # By this rule the outputs are (A + 1)/2 times the states plus half of B times the input.
        a, b, c, d = discrete, B[own, k], 0.5 * (discrete + np.eye(2)), 0.5 * B[own, k]
        # Angle, integral and rate as functions of [filter, integral, y].
        seen = np.array(
            [
                [*c[0], 0.0, d[0]],
                [*(0.5 * T * c[0]), 1.0, 0.5 * T * d[0]],
                [*c[1], 0.0, d[1]],
            ]
        )
        shown = np.column_stack([C[:, own], C[:, 2 * n + k], D[:, k]])
        # Rows and columns are scaled to their sizes.
        rows = np.linalg.norm(seen, axis=1)
        states = np.maximum(np.abs(seen / rows[:, None]).max(axis=0), 1e-300)
        scaled = seen / rows[:, None] / states
        gains[:, :, k] = np.linalg.lstsq(scaled.T, (shown / states).T, rcond=None)[0] / rows[:, None]
        angle, slope, state = f"angle_{k + 1}", f"slope_{k + 1}", f"integral_{k + 1}_x"
        x = [f"filter_{k + 1}_x1", f"filter_{k + 1}_x2"]
        sources = [f"direction_{k + 1}", *x]
        hertz = frequency / (2.0 * np.pi)
        filters.append(
            Section(
                name=f"filter_{k + 1}",
                kind="low-pass",
                note=f"low-pass at {hertz:.6g} Hz, damping {damping:.6g}: angle and its derivative, by Tustin's rule",
                signals=(
                    row(angle, np.array([d[0], *c[0]]), sources, ["direct", "c1", "c2"]),
                    row(slope, np.array([d[1], *c[1]]), sources, ["slope_direct", "slope_c1", "slope_c2"]),
                ),
                states=tuple(
                    row(x[i], np.array([b[i], *a[i]]), sources, [f"b{i + 1}", f"a{i + 1}1", f"a{i + 1}2"])
                    for i in range(2)
                ),
            )
        )
        integrals.append(
            Section(
                name=f"integral_{k + 1}",
                kind="integral",
                note="integral of the filtered angle, by Tustin's rule",
                signals=(row(f"integral_{k + 1}", np.array([0.5 * T, 1.0]), [angle, state], ["half_period", ""]),),
                states=(row(state, np.array([T, 1.0]), [angle, state], ["period", ""]),),
            )
        )
    into = Section(
        name="directions",
        kind="mix",
        note="angles in the directions of the gyros",
        signals=tuple(row(f"direction_{k + 1}", channel.basis[k], angles) for k in range(n)),
    )
    terms = [f"{name}_{k + 1}" for name in ("angle", "integral", "slope") for k in range(n)]
    labels = [f"{name}_{{}}{k + 1}" for name in ("kp", "ki", "kd") for k in range(n)]
    mixed = Section(
        name="pid",
        kind="mix",
        note="kp in N m/rad, ki in N m/(rad s), kd in N m s/rad; first index: torque, second: direction",
        signals=tuple(
            row(f"torque_{i + 1}", gains[:, i].ravel(), terms, [label.format(i + 1) for label in labels])
            for i in range(n)
        ),
    )
    directions = [f"torque_{k + 1}" for k in range(n)]
    back = Section(
        name="torques",
        kind="mix",
        note="torques back on the gimbals",
        signals=tuple(row(name, channel.basis.T[i], directions) for i, name in enumerate(entry.outputs)),
    )
    return (into, *filters, *integrals, mixed, back)
