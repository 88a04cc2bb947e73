"""Feedforward of the platform's rate, taken up by the sampled plants of a loop.

    u = K y + F y_ff,   or   u = K (y + F y_ff),        y_ff = G Omega

y_ff are rates that no torque changes: the loop's poles and margins stay what they are, but what the platform's motion
does to torques, readings and line of sight does not. F and the sensors G become a part of every plant, behind its own
states, so that all that is measured on plants counts them.
"""

from __future__ import annotations

import dataclasses
from typing import Literal

import numpy as np

from platform_ctrl.analysis.between_samples import DisturbanceResponses, FedResponses, added_response
from platform_ctrl.analysis.system import ComplexArray, System
from platform_ctrl.common.values import FloatArray, value

Into = Literal["torque", "reading"]


@value
class RateFeedforward:
    """Feedforward of the platform's rate in a sampled loop."""

    into: Into  # what it adds to: the controller's ``"torque"``, or what the controller reads
    sensors: tuple[str, ...]  # names of the k sensors of the platform's rate that the controller reads
    path: System  # F, from their readings, rad/s, to the m torques, N m, or to the p readings; sampled
    # G, from the platform's rate (Omega1 to Omega3, rad/s) to the readings of the sensors, rad/s: with the rate held
    # between samples, and continuous, without the times `late` (k,), s, by which readings come late.
    measured: System
    smooth: System
    late: FloatArray
    noise: FloatArray  # (k,): rms of one sample of each sensor, rad/s

    @property
    def from_rate(self) -> System:
        """F G, from the platform's rate, held between samples, to torques or readings."""
        return self.measured.series(self.path)

    def responses(self, plain: DisturbanceResponses) -> FedResponses:
        """Return what disturbances do to plants with it, of what they do without."""
        return FedResponses(
            plain=plain, path=self.path, sensors=self.smooth, late=self.late, into_readings=self.into == "reading"
        )

    def torque_response(self, frequency: FloatArray) -> ComplexArray:
        """Return F G at frequencies (F,), rad/s, of the continuous platform rate: (F, m, 3)."""
        return added_response(self.path, self.smooth, self.late, frequency)

    def in_directions(self, sense: FloatArray) -> RateFeedforward:
        """Return it for combinations of the loop's readings, the rows of `sense` (k, p)."""
        if self.into == "torque":
            return self
        return dataclasses.replace(self, path=self.path._replace(C=sense @ self.path.C, D=sense @ self.path.D))

    def joined_to(self, controller: System) -> System:
        """Return K (or K with commands) together with F: inputs of K, then the sensors; states of K, then of F."""
        A, B, C, D, dt = controller
        n, p, f = len(A), D.shape[1], len(self.path.A)
        if self.into == "torque":
            cross, driven = np.zeros((n, f)), np.zeros((n, len(self.sensors)))
            out, direct = self.path.C, self.path.D
        else:
            read = slice(len(self.path.C))
            cross, driven = B[:, read] @ self.path.C, B[:, read] @ self.path.D
            out, direct = D[:, read] @ self.path.C, D[:, read] @ self.path.D
        return System(
            np.block([[A, cross], [np.zeros((f, n)), self.path.A]]),
            np.block([[B, driven], [np.zeros((f, p)), self.path.B]]),
            np.hstack([C, out]),
            np.hstack([D, direct]),
            dt,
        )

    def taken_up(self, whole: System, m: int, p: int) -> System:
        """Return plants (N, ...) that have it.

        Inputs are `m` torques and the platform's rate, the first `p` outputs are what the controller reads.
        """
        A, B, C, D, dt = whole
        A_f, B_f, C_f, D_f, _ = self.from_rate
        N, n, f = A.shape[0], A.shape[-1], len(A_f)
        new_A, new_B = np.zeros((N, n + f, n + f)), np.zeros((N, n + f, m + 3))
        new_A[:, :n, :n], new_A[:, n:, n:] = A, A_f
        new_B[:, :n], new_B[:, n:, m:] = B, B_f
        new_C, new_D = np.concatenate([C, np.zeros((N, C.shape[-2], f))], axis=-1), D.copy()
        if self.into == "torque":
            new_A[:, :n, n:] = B[..., :m] @ C_f
            new_B[:, :n, m:] += B[..., :m] @ D_f
            new_C[..., n:] = D[..., :m] @ C_f
            new_D[..., m:] += D[..., :m] @ D_f
        else:
            new_C[:, :p, n:] = C_f
            new_D[:, :p, m:] += D_f
        return System(new_A, new_B, new_C, new_D, dt)

    def noise_of_torques(self, closed: System) -> System:
        """Return the loops from independent samples of unit rms, one for each sensor, to the torques.

        `closed` (N, ...) leads from a disturbance of the torques and the noise of the readings to the torques.
        """
        path = self.path._replace(B=self.path.B * self.noise, D=self.path.D * self.noise)
        A, B, C, D, dt = closed
        m = C.shape[-2]
        if self.into == "reading":
            return path.series(System(A, B[..., m:], C, D[..., m:], dt))
        # What it adds to the torques, and what the controller adds against it.
        return path.series(System(A, B[..., :m], C, D[..., :m] + np.eye(m), dt))
