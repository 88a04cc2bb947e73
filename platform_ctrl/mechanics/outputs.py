"""Outputs of a linear model: signals of the plant, readings of its sensors, the line of sight.

About angles q0 and a rate Omega0 a body's rate against inertial space, in its own axes, deviates by

    δω_b = R_bᵀ (ω + Σ a_j q̇_j) + R_bᵀ Σ (Omega0 × a_j) q_j,        j: the gimbals between the root and the body,

and its small rotation θ_b by the integral of that, a state that is added where it is observed.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike

from platform_ctrl.common.arguments import distinct, real_array
from platform_ctrl.common.values import FloatArray
from platform_ctrl.errors import ArgumentError
from platform_ctrl.mechanics.kinematics import Kinematics, kinematics
from platform_ctrl.mechanics.state_space import NamedMatrices
from platform_ctrl.plant.platform import OMEGA_NAMES, Platform
from platform_ctrl.plant.sensors import LOWPASS, ROOT_ROTATIONS, Sensor, body_rates, body_rotations, gimbal_rate

if TYPE_CHECKING:
    import control

# A direction of rotation whose share is smaller belongs to those that are integrated already.
_SAME = 1e-9


def observed(
    system: control.StateSpace,
    platform: Platform,
    names: Sequence[str],
    q: ArrayLike | None = None,
    Omega: ArrayLike | None = None,
) -> control.StateSpace:
    """Return a linear model of the platform with `names` as its outputs.

    Parameters
    ----------
    system
        From `state_space`, or another whose first outputs are the angles of gimbals and at the same time its first
        states; further outputs Omega1 to Omega3, or inputs of these names. Gimbals whose angle is no output are held.
    platform
        What `system` is a model of.
    names
        Names of sensors, outputs of the line of sight (`Platform.outputs`) or signals of the plant.
    q : (n,)
        Angles of the trim, rad; default zero.
    Omega : (3,)
        Constant rate of the trim, rad/s; default zero.

    Returns
    -------
    control.StateSpace
        Inputs as before; states as before, then those of the sensors' low-passes, then integrals of rates. Readings
        have their scale errors, but no bias, noise or delay.

    Raises
    ------
    ArgumentError
        There is no such output, or a rotation against inertial space is observed at a rate Omega other than zero.
    """
    return observed_system(system, platform, names, q, Omega).state_space()


def observed_system(
    system: control.StateSpace | NamedMatrices,
    platform: Platform,
    names: Sequence[str],
    q: ArrayLike | None = None,
    Omega: ArrayLike | None = None,
) -> NamedMatrices:
    """Return the result of `observed`."""
    angles = real_array("q", q, (len(platform.gimbals),), 0.0)
    model = _Signals(system, platform, angles, real_array("Omega", Omega, (3,), 0.0))
    outputs = platform.outputs
    sensors = {sensor.name: sensor for sensor in platform.sensors}
    known = outputs.keys() | model.rows.keys() | model.rates.keys()
    unknown = [name for name in names if name not in known]
    if unknown:
        words = f"observed: there is no output {unknown[0]!r} of platform {platform.name!r}"
        raise ArgumentError(f"{words}; known: {', '.join((*outputs, *model.rows))}")
    wanted = [outputs.get(name, {name: 1.0}) for name in names]
    rows, integrated = model.integrated(wanted)
    filters = [sensors.get(name) for name in names]
    return _with_filters(system, rows, integrated, filters, names)


class _Signals:
    """Rows [C, D] of a linear model's signals, (states + inputs,) each, by name."""

    def __init__(
        self, system: control.StateSpace | NamedMatrices, platform: Platform, q: FloatArray, Omega: FloatArray
    ) -> None:
        self.system, self.platform, self.Omega = system, platform, Omega
        n, m = system.nstates, system.ninputs
        whole, inputs = np.hstack([system.A, system.B]), system.input_labels
        shown = np.hstack([system.C, system.D])
        still = [*platform.angle_names, *map(gimbal_rate, platform.angle_names), *OMEGA_NAMES]
        self.rows: dict[str, FloatArray] = dict.fromkeys(still, np.zeros(n + m))
        self.rows |= {name: np.eye(1, n + m, n + inputs.index(name))[0] for name in OMEGA_NAMES if name in inputs}
        held = [(name, system.state_labels.index(name)) for name in ROOT_ROTATIONS if name in system.state_labels]
        self.rows |= {name: np.eye(1, n + m, k)[0] for name, k in held}
        for k, name in enumerate(system.output_labels):
            self.rows[name] = shown[k]
            if name not in OMEGA_NAMES:
                self.rows[gimbal_rate(name)] = whole[k]
        for mode in platform.modes:
            self.rows |= dict.fromkeys((mode.name, mode.rate), np.zeros(n + m))
            if mode.name in system.state_labels:
                place = system.state_labels.index(mode.name)
                self.rows |= {mode.name: np.eye(1, n + m, place)[0], mode.rate: whole[place]}
        self.rates: dict[str, FloatArray] = {}
        self._add_bodies(kinematics(platform, q))

    def _add_bodies(self, at: Kinematics) -> None:
        """Add the bodies' rates, and which rates the rotations are the integrals of."""
        platform, angles = self.platform, self.platform.angle_names
        size = self.system.nstates + self.system.ninputs
        root = np.array([self.rows[name] for name in OMEGA_NAMES])
        rate = np.array([self.rows[gimbal_rate(name)] for name in angles]).reshape(-1, size)
        angle = np.array([self.rows[name] for name in angles]).reshape(-1, size)
        turning = np.cross(self.Omega, at.axes)
        for body, rotation in enumerate(at.rotations):
            path = at.tree.on_path[body]
            found = rotation.T @ (root + at.axes[path].T @ rate[path] + turning[path].T @ angle[path])
            self.rows |= dict(zip(body_rates(platform, body), found, strict=True))
            self.rates |= dict(zip(body_rotations(platform, body), found, strict=True))

    def integrated(self, wanted: Sequence[Mapping[str, float]]) -> tuple[FloatArray, FloatArray]:
        """Return rows of the outputs over [states, integrals, inputs], and the rates that are integrated.

        Of rotations about several axes of one body as few integrals are taken as they have directions: two integrals
        of one rate would be a mode that nothing controls.
        """
        n, size = self.system.nstates, self.system.nstates + self.system.ninputs
        basis: list[FloatArray] = []
        plain, rotations = [], []
        for weights in wanted:
            plain.append(sum((w * self.rows[s] for s, w in weights.items() if s in self.rows), np.zeros(size)))
            rate = sum((w * self.rates[s] for s, w in weights.items() if s not in self.rows), np.zeros(size))
            rotations.append(rate)
            length = float(np.linalg.norm(rate))
            if length > 0.0 and self.Omega.any():
                raise ArgumentError(
                    "observed: a rotation against inertial space is linear about rest alone; give Omega = 0"
                )
            left = rate - (np.linalg.lstsq(np.array(basis).T, rate)[0] @ np.array(basis) if basis else 0.0)
            if float(np.linalg.norm(left)) > _SAME * max(length, 1e-300):
                basis.append(rate)
        integrals = np.array(basis).reshape(len(basis), size)
        parts = [np.linalg.lstsq(integrals.T, rate)[0] if len(basis) else np.zeros(0) for rate in rotations]
        rows = np.array(plain).reshape(len(plain), size)
        shares = np.array(parts).reshape(len(parts), len(basis))
        return np.hstack([rows[:, :n], shares, rows[:, n:]]), integrals


def _with_filters(
    system: control.StateSpace | NamedMatrices,
    rows: FloatArray,
    integrals: FloatArray,
    sensors: Sequence[Sensor | None],
    names: Sequence[str],
) -> NamedMatrices:
    """Return the model with integrals and low-passes as states, and with the outputs' rows."""
    n, m, k = system.nstates, system.ninputs, len(integrals)
    slow = [i for i, sensor in enumerate(sensors) if sensor is not None and sensor.bandwidth_hz is not None]
    size = n + k + 2 * len(slow)
    A, B = np.zeros((size, size)), np.zeros((size, m))
    A[:n, :n], B[:n] = system.A, system.B
    A[n : n + k, :n], B[n : n + k] = integrals[:, :n], integrals[:, n:]
    C, D = np.zeros((len(rows), size)), rows[:, n + k :].copy()
    C[:, : n + k] = rows[:, : n + k]
    states = [*system.state_labels, *(f"integral_{j + 1}" for j in range(k))]
    for j, i in enumerate(slow):
        at, w = n + k + 2 * j, 2.0 * np.pi * float(sensors[i].bandwidth_hz or 0.0)  # type: ignore[union-attr]
        A[at : at + 2, at : at + 2] = w * LOWPASS
        A[at + 1, : n + k], B[at + 1] = w * C[i, : n + k], w * D[i]
        C[i], D[i] = np.eye(1, size, at)[0], 0.0
        states += [f"{names[i]}_filtered", f"{names[i]}_filter_rate"]
    scale = np.array([1.0 if sensor is None else 1.0 + sensor.scale_error for sensor in sensors])
    C, D = scale[:, None] * C, scale[:, None] * D
    return NamedMatrices(A, B, C, D, list(system.input_labels), distinct("outputs", list(names)), states)
