"""The matrix PID of the structured design, read back out of its matrices.

In the directions of the gyros, with F a second-order low-pass of its own in every direction:

    torque = K_P F y + K_I (1/s) F y + K_D s F y
"""

from __future__ import annotations

import numpy as np

from platform_ctrl.design.channels import Channels
from platform_ctrl.export.code.entries import Entry
from platform_ctrl.export.code.scheme import Section
from platform_ctrl.export.code.sections import row


def pid_sections(entry: Entry, channel: Channels, angles: tuple[str, ...]) -> tuple[Section, ...] | None:
    """Return the sections of a matrix PID, or None where the matrices are no such thing at first sight.

    Parameters
    ----------
    entry
        The controller: two states of every filter, then the integrals.
    channel
        Directions of the gyros.
    angles
        Inputs in the order of the outputs' gimbals.

    Returns
    -------
    tuple of Section or None
        To be held against the controller's matrices.

    Notes
    -----
    The arguments are not judged.

    References
    ----------
    See docs/structured.md.
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
        # Tustin's rule backwards.
        continuous = 2.0 / T * (discrete - np.eye(2)) @ np.linalg.inv(discrete + np.eye(2))
        if not continuous[1, 0] < 0.0:
            return None
        frequency = float(np.sqrt(-continuous[1, 0]))
        damping = float(-continuous[1, 1] / (2.0 * frequency))
        # By this rule the states are seen through (A + 1)/2, and the input by half of what drives them.
        a, b, c, d = discrete, B[own, k], 0.5 * (discrete + np.eye(2)), 0.5 * B[own, k]
        # What the gains of this direction see of [filter, integral, y]: angle, integral, rate.
        seen = np.array(
            [
                [*c[0], 0.0, d[0]],
                [*(0.5 * T * c[0]), 1.0, 0.5 * T * d[0]],
                [*c[1], 0.0, d[1]],
            ]
        )
        shown = np.column_stack([C[:, own], C[:, 2 * n + k], D[:, k]])
        # Angle, integral and rate each in its own size, and so is what the states hold of them.
        rows = np.linalg.norm(seen, axis=1)
        states = np.maximum(np.abs(seen / rows[:, None]).max(axis=0), 1e-300)
        scaled = seen / rows[:, None] / states
        gains[:, :, k] = np.linalg.lstsq(scaled.T, (shown / states).T, rcond=None)[0] / rows[:, None]
        angle, slope, state = f"angle_{k + 1}", f"slope_{k + 1}", f"integral_{k + 1}_x"
        held = [f"filter_{k + 1}_x1", f"filter_{k + 1}_x2"]
        sources = [f"direction_{k + 1}", *held]
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
                    row(held[i], np.array([b[i], *a[i]]), sources, [f"b{i + 1}", f"a{i + 1}1", f"a{i + 1}2"])
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
