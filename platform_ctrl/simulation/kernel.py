"""The exact non-linear plant and the sampled closed loop, compiled: bare floats and arrays only.

Everything is written in the root's axes. Bodies are numbered 0 (root) and 1 + k (gimbal k); all turn about one fixed
point, so inertias and angular momenta of a subtree simply add up. With the rates w, the axes a, the carriers'
inertias I (rotors included: A(1 - ss') + C ss' where regulated, A(1 - ss') where free) and h = sum L s of the rotors:

    N = I wdot + w x (I w + h)                            moment of one carrier
    Q_j = a_j . (sum of N over the subtree of j)          joint torque; the root's M is the sum over all bodies
    p_j = a_j . (sum of H = I w + h over the subtree)     joint momentum, eq. (9): dT/dqdot_j
    dT/dq_j = a_j . (H_subtree x w_parent)                only w_parent turns against the frame of j

The root rows are Boltzmann-Hamel's by construction: they are the moment of momentum in turning axes.

The state vector is [q (n), v (3 + n), attitude (4)] with v = [Omega, qdot] for a free root and v = [Omega(t), p] for a
prescribed Omega; attitude is the unit quaternion w, x, y, z that takes root axes to inertial axes.

A plant is the tuple (order, parent, axis, inertia, momentum), see `platform_ctrl.simulation.plant`. Nothing is
allocated inside the time loops. Non-positive pivots give NaN, which the callers take as divergence.

All compiled functions stand in this one file: numba's cache notices changes of a function's own file only. Flags
are handed down as variables, rows are copied by loops: numba compiles a function anew for every literal, and slice
assignments bring the text of their error messages with them.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any, TypeVar, cast

import numpy as np
from numba import njit
from numpy.typing import NDArray

from platform_ctrl.frozen import FloatArray

Work = tuple[FloatArray, ...]
Flags = NDArray[np.bool_]
Plant = tuple[NDArray[np.int64], NDArray[np.int64], FloatArray, FloatArray, FloatArray]
F = TypeVar("F", bound=Callable[..., Any])


def _compiled(function: F) -> F:
    # error_model="numpy": a vanishing pivot becomes inf or NaN instead of an exception in the middle of a run.
    return cast(F, njit(cache=True, nogil=True, error_model="numpy")(function))


@_compiled
def workspace(n: int) -> Work:
    """Scratch arrays for n gimbals: rotations, axes, inertias, momenta, rates, moments, I a, mass matrix, vector."""
    bodies = n + 1
    return (
        np.zeros((bodies, 3, 3)),
        np.zeros((bodies, 3)),
        np.zeros((bodies, 6)),
        np.zeros((bodies, 3)),
        np.zeros((bodies, 3)),
        np.zeros((bodies, 3)),
        np.zeros((bodies, 3)),
        np.zeros((n + 3, n + 3)),
        np.zeros(n + 3),
    )


@_compiled
def _carrier(R: FloatArray, inertia: FloatArray, momentum: FloatArray, I: FloatArray, h: FloatArray) -> None:  # noqa: E741
    """Turn a carrier's inertia (xx, yy, zz, xy, xz, yz) and its rotors' momentum into root axes."""
    xx, yy, zz, xy, xz, yz = inertia[0], inertia[1], inertia[2], inertia[3], inertia[4], inertia[5]
    a0 = R[0, 0] * xx + R[0, 1] * xy + R[0, 2] * xz
    a1 = R[0, 0] * xy + R[0, 1] * yy + R[0, 2] * yz
    a2 = R[0, 0] * xz + R[0, 1] * yz + R[0, 2] * zz
    b0 = R[1, 0] * xx + R[1, 1] * xy + R[1, 2] * xz
    b1 = R[1, 0] * xy + R[1, 1] * yy + R[1, 2] * yz
    b2 = R[1, 0] * xz + R[1, 1] * yz + R[1, 2] * zz
    c0 = R[2, 0] * xx + R[2, 1] * xy + R[2, 2] * xz
    c1 = R[2, 0] * xy + R[2, 1] * yy + R[2, 2] * yz
    c2 = R[2, 0] * xz + R[2, 1] * yz + R[2, 2] * zz
    I[0] = a0 * R[0, 0] + a1 * R[0, 1] + a2 * R[0, 2]
    I[1] = b0 * R[1, 0] + b1 * R[1, 1] + b2 * R[1, 2]
    I[2] = c0 * R[2, 0] + c1 * R[2, 1] + c2 * R[2, 2]
    I[3] = a0 * R[1, 0] + a1 * R[1, 1] + a2 * R[1, 2]
    I[4] = a0 * R[2, 0] + a1 * R[2, 1] + a2 * R[2, 2]
    I[5] = b0 * R[2, 0] + b1 * R[2, 1] + b2 * R[2, 2]
    for i in range(3):
        h[i] = R[i, 0] * momentum[0] + R[i, 1] * momentum[1] + R[i, 2] * momentum[2]


@_compiled
def _moment(I: FloatArray, h: FloatArray, w: FloatArray, N: FloatArray) -> None:  # noqa: E741
    """Replace the angular acceleration in N by the moment I wdot + w x (I w + h)."""
    H0 = I[0] * w[0] + I[3] * w[1] + I[4] * w[2] + h[0]
    H1 = I[3] * w[0] + I[1] * w[1] + I[5] * w[2] + h[1]
    H2 = I[4] * w[0] + I[5] * w[1] + I[2] * w[2] + h[2]
    e0, e1, e2 = N[0], N[1], N[2]
    N[0] = I[0] * e0 + I[3] * e1 + I[4] * e2 + w[1] * H2 - w[2] * H1
    N[1] = I[3] * e0 + I[1] * e1 + I[5] * e2 + w[2] * H0 - w[0] * H2
    N[2] = I[4] * e0 + I[5] * e1 + I[2] * e2 + w[0] * H1 - w[1] * H0


@_compiled
def assemble(plant: Plant, moments: bool, y: FloatArray, work: Work) -> None:
    """Fill the workspace at a state: axes, subtrees' inertias and momenta, lower triangle of A*.

    With `moments` (free root: v holds the rates) also the moments at zero generalised acceleration, summed over
    the subtrees.
    """
    order, parent, axis, inertia, momentum = plant
    R, a, I, h, w, N, Ia, mass, _ = work  # noqa: E741
    n = order.shape[0]
    for i in range(3):
        for j in range(3):
            R[0, i, j] = 1.0 if i == j else 0.0
        w[0, i] = y[n + i]
        N[0, i] = 0.0
    # A child takes its parent's rate and acceleration before the parent's acceleration turns into a moment below.
    for m in range(n):
        k = order[m]
        b, f = k + 1, parent[k]
        x0, x1, x2 = axis[k, 0], axis[k, 1], axis[k, 2]
        c, s = math.cos(y[k]), math.sin(y[k])
        for i in range(3):
            r0, r1, r2 = R[f, i, 0], R[f, i, 1], R[f, i, 2]
            along = r0 * x0 + r1 * x1 + r2 * x2
            a[b, i] = along
            along *= 1.0 - c
            R[b, i, 0] = c * r0 + s * (r1 * x2 - r2 * x1) + along * x0
            R[b, i, 1] = c * r1 + s * (r2 * x0 - r0 * x2) + along * x1
            R[b, i, 2] = c * r2 + s * (r0 * x1 - r1 * x0) + along * x2
        _carrier(R[b], inertia[b], momentum[b], I[b], h[b])
        if moments:
            rate = y[n + 3 + k]
            w0, w1, w2 = w[f, 0], w[f, 1], w[f, 2]
            a0, a1, a2 = a[b, 0] * rate, a[b, 1] * rate, a[b, 2] * rate
            w[b, 0], w[b, 1], w[b, 2] = w0 + a0, w1 + a1, w2 + a2
            N[b, 0] = N[f, 0] + w1 * a2 - w2 * a1
            N[b, 1] = N[f, 1] + w2 * a0 - w0 * a2
            N[b, 2] = N[f, 2] + w0 * a1 - w1 * a0
    for i in range(6):
        I[0, i] = inertia[0, i]
    for i in range(3):
        h[0, i] = momentum[0, i]
    if moments:
        for b in range(n + 1):
            _moment(I[b], h[b], w[b], N[b])
    for i in range(3, n + 3):
        for j in range(3, i):
            mass[i, j] = 0.0
    for m in range(n - 1, -1, -1):
        k = order[m]
        b, f = k + 1, parent[k]
        a0, a1, a2 = a[b, 0], a[b, 1], a[b, 2]
        F0 = I[b, 0] * a0 + I[b, 3] * a1 + I[b, 4] * a2
        F1 = I[b, 3] * a0 + I[b, 1] * a1 + I[b, 5] * a2
        F2 = I[b, 4] * a0 + I[b, 5] * a1 + I[b, 2] * a2
        Ia[b, 0], Ia[b, 1], Ia[b, 2] = F0, F1, F2
        mass[3 + k, 0], mass[3 + k, 1], mass[3 + k, 2] = F0, F1, F2
        mass[3 + k, 3 + k] = a0 * F0 + a1 * F1 + a2 * F2
        up = f
        while up > 0:
            mass[max(up, b) + 2, min(up, b) + 2] = a[up, 0] * F0 + a[up, 1] * F1 + a[up, 2] * F2
            up = parent[up - 1]
        for i in range(6):
            I[f, i] += I[b, i]
        for i in range(3):
            h[f, i] += h[b, i]
            N[f, i] += N[b, i]
    mass[0, 0], mass[1, 1], mass[2, 2] = I[0, 0], I[0, 1], I[0, 2]
    mass[1, 0], mass[2, 0], mass[2, 1] = I[0, 3], I[0, 4], I[0, 5]


@_compiled
def _factor(mass: FloatArray, low: int) -> None:
    """Cholesky factor, in place, of the rows and columns from `low`; the diagonal holds its reciprocals."""
    size = mass.shape[0]
    for j in range(low, size):
        s = mass[j, j]
        for k in range(low, j):
            s -= mass[j, k] * mass[j, k]
        d = 1.0 / math.sqrt(s)
        mass[j, j] = d
        for i in range(j + 1, size):
            s = mass[i, j]
            for k in range(low, j):
                s -= mass[i, k] * mass[j, k]
            mass[i, j] = s * d


@_compiled
def _solve(mass: FloatArray, low: int, x: FloatArray) -> None:
    """Solve, in place, with what `_factor` left in `mass`."""
    size = mass.shape[0]
    for i in range(low, size):
        s = x[i]
        for k in range(low, i):
            s -= mass[i, k] * x[k]
        x[i] = s * mass[i, i]
    for i in range(size - 1, low - 1, -1):
        s = x[i]
        for k in range(i + 1, size):
            s -= mass[k, i] * x[k]
        x[i] = s * mass[i, i]


@_compiled
def derivative(
    plant: Plant, free: bool, locked: Flags, y: FloatArray, force: FloatArray, work: Work, dy: FloatArray
) -> None:
    """Derivative of the state vector under the generalised force [M, Q]; leaves the mass matrix factored.

    With a prescribed Omega, v[:3] must hold its value at this instant. A gimbal that is `locked` does not turn: its
    row gives way to qdot = const (free root) or qdot = 0 (prescribed Omega; its momentum then means nothing).
    """
    order, parent = plant[0], plant[1]
    _, a, I, h, w, N, Ia, mass, x = work  # noqa: E741
    n = order.shape[0]
    assemble(plant, free, y, work)
    for k in range(n):
        if locked[k]:
            for i in range(n + 3):
                mass[max(i, 3 + k), min(i, 3 + k)] = 0.0
            mass[3 + k, 3 + k] = 1.0
    if free:
        _factor(mass, 0)
        for i in range(3):
            x[i] = force[i] - N[0, i]
        for k in range(n):
            b = k + 1
            x[3 + k] = force[3 + k] - (a[b, 0] * N[b, 0] + a[b, 1] * N[b, 1] + a[b, 2] * N[b, 2])
            if locked[k]:
                x[3 + k] = 0.0
        _solve(mass, 0, x)
        for k in range(n):
            dy[k] = 0.0 if locked[k] else y[n + 3 + k]
        for i in range(n + 3):
            dy[n + i] = x[i]
    else:
        _factor(mass, 3)
        W0, W1, W2 = y[n], y[n + 1], y[n + 2]
        for k in range(n):
            b = k + 1
            x[3 + k] = y[n + 3 + k] - (
                Ia[b, 0] * W0 + Ia[b, 1] * W1 + Ia[b, 2] * W2
                + a[b, 0] * h[b, 0] + a[b, 1] * h[b, 1] + a[b, 2] * h[b, 2]
            )  # fmt: skip
            if locked[k]:
                x[3 + k] = 0.0
        _solve(mass, 3, x)
        for m in range(n):
            k = order[m]
            b, f = k + 1, parent[k]
            dy[k] = x[3 + k]
            for i in range(3):
                w[b, i] = w[f, i] + a[b, i] * x[3 + k]
        # N is free in this mode: it collects the momentum that the joints below add to a subtree that turns as one.
        for i in range(n + 1):
            N[i, 0], N[i, 1], N[i, 2] = 0.0, 0.0, 0.0
        for m in range(n - 1, -1, -1):
            k = order[m]
            b, f = k + 1, parent[k]
            v0, v1, v2 = w[b, 0], w[b, 1], w[b, 2]
            H0 = I[b, 0] * v0 + I[b, 3] * v1 + I[b, 4] * v2 + h[b, 0] + N[b, 0]
            H1 = I[b, 3] * v0 + I[b, 1] * v1 + I[b, 5] * v2 + h[b, 1] + N[b, 1]
            H2 = I[b, 4] * v0 + I[b, 5] * v1 + I[b, 2] * v2 + h[b, 2] + N[b, 2]
            p0, p1, p2 = w[f, 0], w[f, 1], w[f, 2]
            dy[n + 3 + k] = (
                force[3 + k]
                + a[b, 0] * (H1 * p2 - H2 * p1)
                + a[b, 1] * (H2 * p0 - H0 * p2)
                + a[b, 2] * (H0 * p1 - H1 * p0)
            )
            for i in range(3):
                N[f, i] += N[b, i] + Ia[b, i] * x[3 + k]
        for i in range(3):
            dy[n + i] = 0.0
    W0, W1, W2 = 0.5 * y[n], 0.5 * y[n + 1], 0.5 * y[n + 2]
    e = 2 * n + 3
    e0, e1, e2, e3 = y[e], y[e + 1], y[e + 2], y[e + 3]
    dy[e] = -e1 * W0 - e2 * W1 - e3 * W2
    dy[e + 1] = e0 * W0 + e2 * W2 - e3 * W1
    dy[e + 2] = e0 * W1 + e3 * W0 - e1 * W2
    dy[e + 3] = e0 * W2 + e1 * W1 - e2 * W0


@_compiled
def joint_momenta(plant: Plant, moments: bool, y: FloatArray, work: Work, p: FloatArray) -> None:
    """Joint momenta dT/dqdot of a state whose v holds the rates; `moments` as in `assemble`."""
    n = plant[0].shape[0]
    _, a, _, h, _, _, _, mass, _ = work
    assemble(plant, moments, y, work)
    for k in range(n):
        b = k + 1
        s = a[b, 0] * h[b, 0] + a[b, 1] * h[b, 1] + a[b, 2] * h[b, 2]
        for i in range(n + 3):
            s += mass[max(3 + k, i), min(3 + k, i)] * y[n + i]
        p[k] = s


@_compiled
def rk4_step(
    plant: Plant,
    free: bool,
    locked: Flags,
    y: FloatArray,
    Omega: FloatArray,
    force: FloatArray,
    step: float,
    work: Work,
    stages: FloatArray,
) -> None:
    """One step of the classical Runge-Kutta method, in place.

    `force` (3, 3 + n) and, for a prescribed rate, `Omega` (3, 3) hold the values at the step's beginning, middle and
    end; `stages` (3, 2 n + 7) is scratch.
    """
    n = plant[0].shape[0]
    size = y.shape[0]
    at, dy, total = stages[0], stages[1], stages[2]
    for i in range(size):
        at[i] = y[i]
        total[i] = 0.0
    for s in range(4):
        row = (s + 1) // 2
        if not free:
            for i in range(3):
                at[n + i] = Omega[row, i]
        derivative(plant, free, locked, at, force[row], work, dy)
        weight = 1.0 if s == 0 or s == 3 else 2.0
        ahead = step if s == 2 else 0.5 * step
        for i in range(size):
            total[i] += weight * dy[i]
            at[i] = y[i] + ahead * dy[i]
    norm = 0.0
    for i in range(size):
        y[i] += step / 6.0 * total[i]
    for i in range(size - 4, size):
        norm += y[i] * y[i]
    norm = 1.0 / math.sqrt(norm)
    for i in range(size - 4, size):
        y[i] *= norm
    if not free:
        for i in range(3):
            y[n + i] = Omega[2, i]


@_compiled
def advance(plant: Plant, free: bool, states: FloatArray, force: FloatArray, step: float, steps: int) -> None:
    """Move every row of `states` (N, 2 n + 7) on by `steps` steps with its `force` (N, 3 + n) held.

    `free` is True: with a prescribed Omega use `closed_loop`.
    """
    n = plant[0].shape[0]
    work = workspace(n)
    stages = np.empty((3, 2 * n + 7))
    held = np.empty((3, n + 3))
    Omega = np.zeros((3, 3))
    locked = np.zeros(n, dtype=np.bool_)
    for r in range(states.shape[0]):
        for i in range(n + 3):
            held[0, i] = held[1, i] = held[2, i] = force[r, i]
        y = states[r]
        for _ in range(steps):
            rk4_step(plant, free, locked, y, Omega, held, step, work, stages)


@_compiled
def half_cosine(t: float, profile: FloatArray, Omega: FloatArray) -> None:
    """Omega at t; `profile` is the rate vector, the rise and the hold."""
    rise, hold = profile[3], profile[4]
    share = 0.0
    if t < 0.0 or t > 2.0 * rise + hold:
        share = 0.0
    elif t < rise:
        share = 0.5 - 0.5 * math.cos(math.pi * t / rise)
    elif t <= rise + hold:
        share = 1.0
    else:
        share = 0.5 - 0.5 * math.cos(math.pi * (2.0 * rise + hold - t) / rise)
    for i in range(3):
        Omega[i] = share * profile[i]


@_compiled
def _hold(
    plant: Plant,
    free: bool,
    y: FloatArray,
    begin: FloatArray,
    Omega: FloatArray,
    force: FloatArray,
    step: float,
    stops: FloatArray,
    touching: Flags,
    locked: Flags,
    work: Work,
    stages: FloatArray,
) -> None:
    """Repeat a step from `begin` with those gimbals locked that lay at a stop and have gone past it."""
    n = plant[0].shape[0]
    a, I, h, w, N, dy = work[1], work[2], work[3], work[4], work[5], stages[1]  # noqa: E741
    pressed = False
    for k in range(n):
        locked[k] = touching[k] and (y[k] < stops[k, 0] or y[k] > stops[k, 1])
        pressed = pressed or locked[k]
    if not pressed:
        return
    for i in range(y.shape[0]):
        y[i] = begin[i]
    rk4_step(plant, free, locked, y, Omega, force, step, work, stages)
    if not free:
        derivative(plant, free, locked, y, force[2], work, dy)
        for k in range(n):
            if locked[k]:
                b = k + 1
                v0, v1, v2 = w[b, 0], w[b, 1], w[b, 2]
                y[n + 3 + k] = (
                    a[b, 0] * (I[b, 0] * v0 + I[b, 3] * v1 + I[b, 4] * v2 + h[b, 0] + N[b, 0])
                    + a[b, 1] * (I[b, 3] * v0 + I[b, 1] * v1 + I[b, 5] * v2 + h[b, 1] + N[b, 1])
                    + a[b, 2] * (I[b, 4] * v0 + I[b, 5] * v1 + I[b, 2] * v2 + h[b, 2] + N[b, 2])
                )


@_compiled
def _meet_stops(
    plant: Plant,
    free: bool,
    y: FloatArray,
    stops: FloatArray,
    touching: Flags,
    locked: Flags,
    contacts: NDArray[np.int64],
    zero: FloatArray,
    work: Work,
    dy: FloatArray,
) -> None:
    """Put every gimbal that has gone past its stop back on it: a perfectly inelastic impact."""
    n = plant[0].shape[0]
    mass, x = work[7], work[8]
    hit = False
    for k in range(n):
        past = y[k] < stops[k, 0] or y[k] > stops[k, 1]
        if past:
            hit = True
            y[k] = min(max(y[k], stops[k, 0]), stops[k, 1])
            if not touching[k]:
                contacts[k] += 1
        touching[k] = past or locked[k]
        locked[k] = False
    if not hit:
        return
    derivative(plant, free, locked, y, zero, work, dy)  # dy[:n] = qdot, and the factored mass matrix
    low = 0 if free else 3
    # Impulses in turn until no gimbal that touches moves outwards; one pass does it for one contact.
    for _ in range(100):
        settled = True
        for k in range(n):
            outward = dy[k] if y[k] >= stops[k, 1] else -dy[k]
            if not touching[k] or outward <= 1e-12:
                continue
            settled = False
            for i in range(n + 3):
                x[i] = 0.0
            x[3 + k] = 1.0
            _solve(mass, low, x)
            impulse = -dy[k] / x[3 + k]
            for j in range(n):
                dy[j] += impulse * x[3 + j]
            if free:
                for i in range(n + 3):
                    y[n + i] += impulse * x[i]
            else:
                y[n + 3 + k] += impulse
        if settled:
            return


@_compiled
def closed_loop(
    plant: Plant,
    free: bool,
    y: FloatArray,
    profile: FloatArray,
    root_torque: FloatArray,
    controller: tuple[FloatArray, FloatArray, FloatArray, FloatArray],
    pickoffs: tuple[NDArray[np.int64], FloatArray, FloatArray],
    torquers: tuple[NDArray[np.int64], FloatArray, FloatArray],
    stops: FloatArray,
    period: float,
    whole: int,
    segments: tuple[NDArray[np.int64], FloatArray],
    records: tuple[FloatArray, FloatArray, FloatArray, FloatArray, FloatArray, FloatArray],
    saturated: NDArray[np.int64],
    contacts: NDArray[np.int64],
) -> int:
    """Run the sampled loop; return how many samples were recorded before the run ended.

    Parameters
    ----------
    controller
        One discrete state space from all readings to all torquers' commands.
    pickoffs
        Gimbal index, noise (samples, pick-offs), quantisation.
    torquers
        Index into [M, Q], limit (inf: none), decay of the lag over half a substep (2 segments, torquers).
    whole, segments
        A period has two segments, before and after the command changes: number of substeps and substep. The first
        holds the command of `whole` + 1 samples ago, the second that of `whole` samples ago.
    records
        q, v = [Omega, qdot], p, attitude with reading behind it, command, torque; a row per sample.
    """
    Ac, Bc, Cc, Dc = controller
    sensed, noise, quantisation = pickoffs
    target, limit, decay = torquers
    count, steps = segments
    out_q, out_v, out_p, out_attitude, out_command, out_torque = records
    n, nx, ny, nu = plant[0].shape[0], Ac.shape[0], sensed.shape[0], target.shape[0]
    samples: int = out_q.shape[0]
    work = workspace(n)
    stages = np.empty((3, 2 * n + 7))
    dy = np.empty(2 * n + 7)
    force = np.zeros((3, n + 3))
    zero = np.zeros(n + 3)
    Omega = np.zeros((3, 3))
    x, x_next = np.zeros(nx), np.zeros(nx)
    torque, held = np.zeros(nu), np.zeros(nu)
    touching, locked = np.zeros(n, dtype=np.bool_), np.zeros(n, dtype=np.bool_)
    begin = np.empty(2 * n + 7)
    fastest = 1.0 / max(steps[0], steps[1])
    for k in range(samples):
        # Rates and momenta at the sample.
        if free:
            joint_momenta(plant, free, y, work, out_p[k])
            for i in range(n):
                dy[i] = y[n + 3 + i]
        else:
            half_cosine(k * period, profile, y[n : n + 3])
            derivative(plant, free, locked, y, zero, work, dy)
            for i in range(n):
                out_p[k, i] = y[n + 3 + i]
        for i in range(n):
            out_q[k, i] = y[i]
            out_v[k, 3 + i] = dy[i]
        for i in range(3):
            out_v[k, i] = y[n + i]
        for i in range(4):
            out_attitude[k, i] = y[2 * n + 3 + i]
        for i in range(2 * n + 7):
            if not math.isfinite(y[i]):
                return k
        for i in range(n + 3):
            if not abs(out_v[k, i]) < fastest:
                return k
        # The controllers.
        reading = out_attitude[k, 4:]
        for i in range(ny):
            reading[i] = y[sensed[i]] + noise[k, i]
            if quantisation[i] > 0.0:
                reading[i] = quantisation[i] * math.floor(reading[i] / quantisation[i] + 0.5)
        command = out_command[k]
        for i in range(nu):
            s = 0.0
            for j in range(nx):
                s += Cc[i, j] * x[j]
            for j in range(ny):
                s += Dc[i, j] * reading[j]
            if not math.isfinite(s):
                return k
            command[i] = s
            if abs(s) >= limit[i]:
                saturated[i] += 1
        for i in range(nx):
            s = 0.0
            for j in range(nx):
                s += Ac[i, j] * x[j]
            for j in range(ny):
                s += Bc[i, j] * reading[j]
            x_next[i] = s
        x, x_next = x_next, x
        # The plant up to the next sample.
        start = k * period
        for g in range(2):
            if g == 1 or count[0] > 0:
                source = k - whole - 1 + g
                for i in range(nu):
                    held[i] = min(max(out_command[source, i], -limit[i]), limit[i]) if source >= 0 else 0.0
                    if decay[g, i] == 0.0:
                        torque[i] = held[i]
            if (g == 0 and count[0] > 0) or (g == 1 and count[0] == 0):
                for i in range(nu):
                    out_torque[k, i] = torque[i]
            if k == samples - 1:
                continue
            h = steps[g]
            for m in range(count[g]):
                for s in range(3):
                    for i in range(n + 3):
                        force[s, i] = root_torque[i] if i < 3 else 0.0
                    for i in range(nu):
                        force[s, target[i]] += torque[i]
                    if s < 2:
                        for i in range(nu):
                            torque[i] = held[i] + (torque[i] - held[i]) * decay[g, i]
                    if not free:
                        half_cosine(start + (m + 0.5 * s) * h, profile, Omega[s])
                for i in range(2 * n + 7):
                    begin[i] = y[i]
                rk4_step(plant, free, locked, y, Omega, force, h, work, stages)
                _hold(plant, free, y, begin, Omega, force, h, stops, touching, locked, work, stages)
                _meet_stops(plant, free, y, stops, touching, locked, contacts, zero, work, dy)
            start += count[g] * h
    return samples
