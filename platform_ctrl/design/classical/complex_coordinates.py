"""Symmetric gyros in complex coordinates: two equal axes α and β as one, z = α + iβ.

A plant that looks the same after any turn about the spin axis has real transfer matrices [[a, −b], [b, a]]: one
complex transfer function a + ib, of half the order, for example z/Q = 1/(J s² − i L s) of a gyro with G = [[0, L],
[−L, 0]]. Its response at negative frequencies is not the mirror image of that at positive ones: a motion that turns
with the rotor is not one that turns against it. The two singular values of the real matrix at ω are |P(jω)| and
|P(−jω)|.

Unequal axes are brought to this form by their units: with angles times (J1/J2)^(1/4) and (J2/J1)^(1/4), torques
divided by the same, both inertias are √(J1 J2) and G stays.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import field
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike

from platform_ctrl.analysis.arrays import ComplexArray, StateArrays, named_system, state_arrays
from platform_ctrl.analysis.sampling import sampled, with_lag
from platform_ctrl.common.arguments import positive, real_numbers
from platform_ctrl.common.signatures import check_arguments
from platform_ctrl.common.values import FloatArray, value
from platform_ctrl.design.plants import held_rate
from platform_ctrl.errors import ArgumentError
from platform_ctrl.mechanics.linearisation import LinearModel
from platform_ctrl.mechanics.state_space import state_space, whole_subsystems
from platform_ctrl.plant.platform import OMEGA_NAMES

if TYPE_CHECKING:
    import control

# Largest asymmetry of a pair of states, over the largest entry in their rows.
_SYMMETRIC = 1e-9


@value
class ComplexSystem:
    """A system with one complex input and one complex output: ẋ = A x + B u, or x[k+1] = A x[k] + B u[k].

    Attributes
    ----------
    A, B, C, D
        Half the states of the real system; in the units that `input_scale` and `output_scale` make. Complex, shapes (n,
        n), (n, 1), (1, n), (1, 1).
    dt
        Sample period, s; 0 for a continuous system.
    delay
        Dead time of a continuous system, s; a sampled one holds it in its states.
    inputs, outputs
        Names of the real and of the imaginary part.
    input_scale, output_scale : (2,)
        Real signals are those of the complex coordinates times these factors.
    inertia, momentum
        J, kg m², and L, N m s, of a plant P = 1/(J s² − i L s) behind its lags; 0 of a controller.
    states
        Names of the real system's states; none of a controller.
    rate_input : (2n, 3)
        Input of the platform's rate, rad/s, to the states of `real_arrays`; sampled: held, not delayed. Empty of a
        controller.
    """

    A: ComplexArray
    B: ComplexArray
    C: ComplexArray
    D: ComplexArray
    dt: float
    delay: float
    inputs: tuple[str, str]
    outputs: tuple[str, str]
    input_scale: FloatArray
    output_scale: FloatArray
    inertia: float = 0.0
    momentum: float = 0.0
    states: tuple[str, ...] = ()
    rate_input: FloatArray = field(default_factory=lambda: np.zeros((0, 3)))

    def real_arrays(self) -> StateArrays:
        """Return real and imaginary parts as a real system of twice the size, nothing rounded; without dead time."""
        return StateArrays(_real(self.A), _real(self.B), _real(self.C), _real(self.D), self.dt)

    def real_system(self) -> control.StateSpace:
        """Return the real system with two inputs and two outputs, in SI units.

        It has the names of `inputs` and `outputs`, of a plant also of the states. An `ArgumentError` with a dead time:
        no finite number of states has it.
        """
        if self.delay:
            raise ArgumentError("real_system: the system must be sampled or without dead time")
        A, B, C, D, _ = self.real_arrays()
        B, D = B / self.input_scale, D / self.input_scale
        arrays = StateArrays(A, B, self.output_scale[:, None] * C, self.output_scale[:, None] * D, self.dt)
        return named_system(arrays, self.inputs, self.outputs, self.states or None)


@check_arguments
def complex_plant(
    model: LinearModel,
    gimbals: Sequence[str],
    *,
    period: float | None = None,
    delay: float = 0.0,
    balance: bool = False,
) -> ComplexSystem:
    """Return a symmetric pair of gimbals from complex torque to complex angle.

    Parameters
    ----------
    model
        From `linearise`.
    gimbals
        Two gimbals, a subsystem: the first gives the real part. Each has a torquer and a pick-off.
    period
        Sample period, s: hold and delay are then exact. Without it the plant is continuous.
    delay
        From sample to torque, s; of a continuous plant its dead time.
    balance
        Whether unequal axes may be given units of their own that make them alike.

    Returns
    -------
    ComplexSystem
        With the torquers' lags.

    Raises
    ------
    ArgumentError
        Not two gimbals, or not symmetric to 1e-9; the message names what breaks the symmetry.
    MechanicsError
        The mass matrix is singular at the trim (gimbal lock).
    """
    rows = whole_subsystems(model, gimbals)
    if len(rows) != 2:
        raise ArgumentError(f"complex_plant: gimbals must be the two of one gyro, got {len(rows)}")
    delay = positive("complex_plant: delay", delay, zero=True)
    names = list(gimbals)
    torquers = [model.platform.torquer_on(name) for name in names]
    angles, torques = [model.platform.pickoff_on(name).name for name in names], [t.name for t in torquers]
    whole = state_space(model, gimbals=names)
    system = whole[angles, torques]
    order = [list(whole.state_labels).index(prefix + angle) for prefix in ("", "p_") for angle in angles]
    A, B, C = (np.asarray(item, dtype=np.float64) for item in (system.A, system.B, system.C))
    A, B, C = A[np.ix_(order, order)], B[order], C[:, order]
    rate = np.asarray(whole[angles, list(OMEGA_NAMES)].B, dtype=np.float64)[order]
    scale = np.ones(2)
    if balance:
        mobility = np.diag(A[:2, 2:])
        scale = (mobility / mobility[::-1]) ** 0.25
        states = np.concatenate([scale, 1.0 / scale])
        A, B, C = A / states[:, None] * states, B / states[:, None] / scale, C / scale[:, None] * states
        rate = rate / states[:, None]
    states_named = [*angles, *(f"p_{name}" for name in angles)]
    plain = named_system(StateArrays(A, B, C, np.zeros((2, 2)), 0.0), torques, angles, states_named)
    lags = np.array([t.lag for t in torquers])
    if period is None:
        arrays = with_lag(StateArrays(A, B, C, np.zeros((2, 2))), lags)
        labels = states_named + [f"lag_{name}" for name, lag in zip(torques, lags, strict=True) if lag > 0.0]
        rate = np.vstack([rate, np.zeros((len(labels) - len(rate), 3))])
    else:
        discrete = sampled(plain, positive("complex_plant: period", period), delay, lags)
        arrays, labels, delay = state_arrays(discrete, "complex_plant"), list(discrete.state_labels), 0.0
        rate = held_rate(A, rate, arrays.dt, len(labels))
    parts = zip("ABCD", arrays[:4], (labels, labels, angles, angles), (labels, torques, labels, torques), strict=True)
    A_z, B_z, C_z, D_z = (_complex(name, item, down, across) for name, item, down, across in parts)
    return ComplexSystem(
        A=A_z,
        B=B_z,
        C=C_z,
        D=D_z,
        dt=arrays.dt,
        delay=delay,
        inputs=(torques[0], torques[1]),
        outputs=(angles[0], angles[1]),
        input_scale=1.0 / scale,
        output_scale=scale,
        inertia=2.0 / float(A[0, 2] + A[1, 3]),
        momentum=float(A[3, 2] - A[2, 3]) / float(A[0, 2] + A[1, 3]),
        states=tuple(labels),
        rate_input=rate,
    )


@check_arguments
def complex_response(system: ComplexSystem, frequency: ArrayLike) -> ComplexArray:
    """Return the response at positive and negative frequencies (N,), rad/s, none of them at a pole."""
    w = np.atleast_1d(real_numbers("complex_response: frequency", frequency))
    if w.ndim != 1 or not np.all(np.isfinite(w)):
        raise ArgumentError(f"complex_response: frequency must be a vector of finite numbers, got shape {w.shape}")
    return transfer(system, np.asarray(1j * w, dtype=np.complex128))


def transfer(system: ComplexSystem, s: ComplexArray) -> ComplexArray:
    """Return the transfer function at points s; of a sampled system at z = exp(s dt)."""
    n = len(system.A)
    # z − 1 and A − 1: nothing cancels far below the sample rate.
    x, A = (np.expm1(s * system.dt), system.A - np.eye(n)) if system.dt > 0.0 else (s, system.A)
    inner = np.linalg.solve(x[:, None, None] * np.eye(n) - A, np.broadcast_to(system.B, (len(s), n, 1)))
    out = (system.C @ inner)[:, 0, 0] + system.D[0, 0]
    return np.asarray(out * np.exp(-s * system.delay), dtype=np.complex128)


def _complex(name: str, matrix: FloatArray, down: list[str], across: list[str]) -> ComplexArray:
    """Return blocks [[a, −b], [b, a]] as a + ib."""
    blocks = matrix.reshape(matrix.shape[0] // 2, 2, matrix.shape[1] // 2, 2).swapaxes(1, 2)
    real, imaginary = (
        0.5 * (blocks[..., 0, 0] + blocks[..., 1, 1]),
        0.5 * (blocks[..., 1, 0] - blocks[..., 0, 1]),
    )
    off = np.maximum(np.abs(blocks[..., 0, 0] - real), np.abs(blocks[..., 1, 0] - imaginary))
    size = np.abs(blocks).max(axis=(1, 2, 3), initial=0.0)[:, None]
    wrong = off > _SYMMETRIC * size
    if wrong.any():
        k, j = (int(index) for index in np.argwhere(wrong)[0])
        rows = (f"{down[2 * k + i]} from {across[2 * j]}, {across[2 * j + 1]}: " for i in (0, 1))
        shown = "; ".join(row + ", ".join(f"{x:.5g}" for x in blocks[k, j, i]) for i, row in enumerate(rows))
        raise ArgumentError(
            f"complex_plant: {name} must be symmetric about the spin axis, blocks a, −b; b, a, got {shown}; inertias, "
            "lags and springs must be equal, or with balance = True all but the inertias"
        )
    return np.asarray(real + 1j * imaginary, dtype=np.complex128)


def _real(matrix: ComplexArray) -> FloatArray:
    """Return entries a + ib as blocks [[a, −b], [b, a]]."""
    a, b = matrix.real, matrix.imag
    blocks = np.stack([np.stack([a, -b], axis=-1), np.stack([b, a], axis=-1)], axis=1)
    return np.asarray(blocks.reshape(2 * matrix.shape[0], 2 * matrix.shape[1]), dtype=np.float64)
