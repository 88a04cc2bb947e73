"""Closed loops with positive feedback, u = +K y: torque = K(pick-off).

::

        d ----+                                  +---- n
              v                                  v
      u ----> + ----> plant P ----+----> y ----> +
      ^                                          |
      +---------------- controller K <-----------+

Sensitivities are written for the negative-feedback loop transfer L = -K P (broken at the plant's input) or
L = -P K (at its output), so that S = (I + L)^-1 and T = L S as in the books. A controller of two degrees of freedom,
u = K y + H r, is one system of what is measured, y, and of its commands r.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike

from platform_ctrl.analysis.response import NamedSystem, frequency_response, linear_arrays
from platform_ctrl.analysis.system import ComplexArray, StateSpace, System, block, seen_states
from platform_ctrl.common.arguments import one_of
from platform_ctrl.common.values import FloatArray
from platform_ctrl.errors import ArgumentError

At = Literal["input", "output"]


def loop_transfer(plant: NamedSystem, controller: NamedSystem, at: At = "input") -> StateSpace:
    """Return L = -K P (``at="input"``) or -P K (``at="output"``): S = (I + L)^-1.

    Plant and controller are joined by signal names where all of the controller's names exist in the plant, by
    position otherwise.

    Parameters
    ----------
    plant, controller
        With u = K y, `control.StateSpace` or `TransferFunction`; the controller may use some of the plant's signals
        only.
    at
        Where the loop is broken: the plant's ``"input"`` or ``"output"``.

    Returns
    -------
    control.StateSpace
        Square: as many channels as the controller has outputs (or inputs).
    """
    P, K, torques, angles = _matched(plant, controller, "loop_transfer")
    P = P.part(angles, torques)
    one_of("at", at, ("input", "output"))
    if at == "input":
        first, second, names = P, K, list(controller.output_labels)
    else:
        first, second, names = K, P, list(controller.input_labels)
    of_plant, of_controller = _states(plant, P, controller, K)
    states = of_plant + of_controller if first is P else of_controller + of_plant
    return first.series(second, sign=-1.0).to_control(names, names, states)


def closed_loop(plant: NamedSystem, controller: NamedSystem) -> StateSpace:
    """Return the closed loop of u = K (y + n), y = P (u + d), as one system with every state of both.

    Parameters
    ----------
    plant
        May have more inputs and outputs than the controller uses: joined by name (see `loop_transfer`). All of
        its inputs become inputs of the result, all of its outputs outputs.
    controller
        u = K y, same sample period.

    Returns
    -------
    control.StateSpace
        Inputs: the plant's inputs (a disturbance that adds to the controller's torque, or for example Omega1),
        then ``noise_`` + name for every pick-off that the controller uses. Outputs: the controller's torques, then
        the plant's outputs (without the noise). States: the plant's, then the controller's.

    Raises
    ------
    ArgumentError
        If sizes, names or sample periods do not fit, or the algebraic loop I - D_K D_P is singular.
    """
    P, K, at, seen = _matched(plant, controller, "closed_loop")
    of_plant, of_controller = _states(plant, P, controller, K)
    inputs = [*plant.input_labels, *(f"noise_{plant.output_labels[i]}" for i in seen)]
    outputs = [*(plant.input_labels[i] for i in at), *plant.output_labels]
    return P.feedback(K, at, seen).to_control(inputs, outputs, of_plant + of_controller)


def _states(plant: NamedSystem, P: System, controller: NamedSystem, K: System) -> tuple[list[str], list[str]]:
    """Return the names of the plant's states and, each behind ``controller_``, of the controller's."""
    own = getattr(plant, "state_labels", None) or [f"plant_{k}" for k in range(len(P.A))]
    its = getattr(controller, "state_labels", None) or [f"x_{k}" for k in range(len(K.A))]
    return list(own), [f"controller_{name}" for name in its]


def channel_transfers(plant: NamedSystem, controller: NamedSystem, frequency: ArrayLike) -> ComplexArray:
    """Return L at each of the plant's inputs with all others closed, 1/S_ii − 1, complex (m, N); −1 is critical.

    From the closed loop's own equations, not from P and K: integrators do no harm at DC.
    """
    return each_alone(frequency_response(closed_loop_with_sensitivity(plant, controller, "input"), frequency, -3))


def each_alone(S: ComplexArray) -> ComplexArray:
    """Return the loop of every channel with all others closed, 1/S_ii − 1, complex (m, N), of sensitivities (N, m, m).

    Never the product of two integrators' infinities.
    """
    with np.errstate(all="ignore"):
        return np.asarray(1.0 / np.diagonal(S, axis1=1, axis2=2).T - 1.0, dtype=np.complex128)


def closed_loop_with_sensitivity(plant: NamedSystem, controller: NamedSystem, at: At) -> System:
    """Return the arrays of S at the plant's input or output, with every state of plant and controller."""
    P, K, torques, angles = _matched(plant, controller, "sensitivity")
    P = P.part(angles, torques)
    m = len(torques)
    # S = I - T, and the closed loop from d to u (from n to y) is -T.
    one_of("at", at, ("input", "output"))
    part = slice(0, m) if at == "input" else slice(m, None)
    return P.feedback(K).part(part, part, 1.0)


def loop_of_sensitivity(S: System) -> System:
    """Return L = S^-1 - I of S = (I + L)^-1."""
    A, B, C, D, dt = S
    inverse = np.linalg.inv(D)
    return System(A - B @ inverse @ C, B @ inverse, -inverse @ C, inverse - np.eye(len(D)), dt)


def _matched(plant: NamedSystem, controller: NamedSystem, where: str) -> tuple[System, System, list[int], list[int]]:
    """Return both systems' arrays and the plant's inputs and outputs that the controller uses, in its order."""
    P, K = linear_arrays(plant, f"{where} (plant)"), linear_arrays(controller, f"{where} (controller)")
    if plant.dt is None or controller.dt is None:
        # A static gain without a time base takes the other's.
        dt = max(P.dt, K.dt)
        P, K = P._replace(dt=dt), K._replace(dt=dt)
    if abs(P.dt - K.dt) > 1e-9 * max(P.dt, K.dt):
        words = f"plant and controller must have the same sample period, got {P.dt} s and {K.dt} s"
        raise ArgumentError(f"{where}: {words}; see platform_ctrl.analysis.sampled")
    inputs, outputs = list(plant.input_labels), list(plant.output_labels)
    if set(controller.output_labels) <= set(inputs) and set(controller.input_labels) <= set(outputs):
        at = [inputs.index(name) for name in controller.output_labels]
        return P, K, at, [outputs.index(name) for name in controller.input_labels]
    if (K.D.shape[1], K.D.shape[0]) != P.D.shape:
        raise ArgumentError(
            f"{where}: the controller has inputs {list(controller.input_labels)} and outputs "
            f"{list(controller.output_labels)}, the plant outputs {outputs} and inputs {inputs}; "
            "they must have the same names, or be as many"
        )
    return P, K, list(range(P.D.shape[1])), list(range(P.D.shape[0]))


def _inverses(X: ComplexArray) -> ComplexArray:
    """Return the inverses of matrices (..., m, m), inf all over where one is singular or not a number.

    By the adjugate up to m = 2, of which there are many thousands in a search: a third of the time.
    """
    m = X.shape[-1]
    with np.errstate(all="ignore"):
        if m == 1:
            out = np.asarray(1.0 / X, dtype=np.complex128)
        elif m == 2:
            a, b, c, d = X[..., 0, 0], X[..., 0, 1], X[..., 1, 0], X[..., 1, 1]
            out = np.stack([d, -b, -c, a], axis=-1).reshape(X.shape) / (a * d - b * c)[..., None, None]
        else:
            try:
                out = np.linalg.inv(X).astype(np.complex128)
            except np.linalg.LinAlgError:
                fine = (np.linalg.det(X) != 0.0)[..., None, None]
                out = np.where(fine, np.linalg.inv(np.where(fine, X, np.eye(m))), np.inf).astype(np.complex128)
            out[~np.isfinite(X).all(axis=(-2, -1))] = np.inf
    wrong = ~np.isfinite(out).all(axis=(-2, -1))
    if wrong.any():
        out[wrong] = np.inf
    return np.asarray(out, dtype=np.complex128)


def sensitivities_of_plants(P: ComplexArray, K: ComplexArray) -> tuple[ComplexArray, ComplexArray]:
    """Return (I - P K)^-1 and (I - K P)^-1 of plants P (..., F, p, m) with one controller K (F, m, p), u = K y.

    Inf where that is singular.
    """
    p, m = P.shape[-2:]
    return _inverses(np.eye(p) - P @ K), _inverses(np.eye(m) - K @ P)


def feedback_part(controller: System, measured: Sequence[int]) -> System:
    """Return K from some of a controller's inputs, without the states that only the other inputs reach."""
    A, B = controller.A, controller.B
    others = [k for k in range(B.shape[1]) if k not in measured]
    # States that an input reaches are those that outputs of the transposed system see.
    reached, else_reached = (set(seen_states(A.T[None], B[:, at].T[None])) for at in (measured, others))
    kept = [k for k in range(len(A)) if k in reached or k not in else_reached]
    own = controller.part(slice(None), measured)
    return own._replace(A=A[np.ix_(kept, kept)], B=own.B[kept], C=own.C[:, kept])


def with_error_alone(controller: System, commanded: FloatArray | None = None) -> System:
    """Return u = K (y − r) of u = K y: inputs y, then r; with `commanded` (p, k) u = K (y − commanded r)."""
    A, B, C, D, dt = controller
    E = np.eye(B.shape[1]) if commanded is None else commanded
    return System(A, np.hstack([B, -B @ E]), C, np.hstack([D, -D @ E]), dt)


def commanded_loop(plants: System, controller: System, torques: Sequence[int], angles: Sequence[int]) -> System:
    """Return plants (N, ...) with u = K y + H r closed: inputs the plants', then r; outputs u, then the plants'."""
    A, B, C, D, dt = plants
    k, inputs, outputs = controller.B.shape[1] - len(angles), B.shape[-1], C.shape[-2]
    # The commands go through the plant as what is measured without noise.
    whole = System.split(block([[A, B, 0], [C, D, 0], [0, 0, np.eye(k)]]), A.shape[-1], dt)
    found = whole.feedback(controller, torques, [*angles, *range(outputs, outputs + k)])
    return found.part(slice(len(torques) + outputs), slice(inputs + k))
