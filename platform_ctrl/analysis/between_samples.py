"""Responses of sampled loops to continuous disturbances, at the samples and between them.

The platform's rate and torques that act on gimbals are continuous; only the controller is sampled. A component
w exp(jωt) moves the plant alone by G(jω) w exp(jωt), and the samples of that are readings like any others. All that a
controller does about it is a sequence of held torques u exp(jωkT). With P the exactly sampled plant,

    y = P u + E G_y(jω) w,        z(t) = exp(jωt) [G_z(jω) w + L(ω, τ) u],        τ = t − kT,

where E delays readings and L is what a torque sequence makes of z at the instant τ of a period. The mean square of z
is an integral over τ: Gauss's rule on both sides of the instant at which the delayed torque changes. By Parseval's
theorem that is the sum over ω and all its images ω + 2πn/T (Chen and Francis, Optimal Sampled-Data Control Systems,
1995, ch. 3).

Rows of z are weighted by the roots of the rule, so that the largest singular value of [rows] is the largest root mean
square of z over the amplitude of w. Where a loop is computed at every n-th sample, its torques are held meanwhile: a
component of a slow sequence is a sum of n components of the fast one, 2π/(nT) apart, whose squares add.

Feedforward of the platform's rate becomes a part of every sampled plant, behind its own states:

    u = K y + F y_ff,   or   u = K (y + F y_ff),        y_ff = G Omega

y_ff are rates that no torque changes: the loop's poles and margins stay what they are, but what the platform's motion
does to torques, readings and line of sight does not.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from itertools import pairwise
from typing import Literal, NamedTuple, Self, TypeAlias

import numpy as np
from numpy.typing import NDArray

from platform_ctrl.analysis.response import frequency_response
from platform_ctrl.analysis.sampling import held_input, split_delay, with_lag
from platform_ctrl.analysis.system import ComplexArray, System, block
from platform_ctrl.common.values import FloatArray, value

# Points of Gauss's rule on each part of a period. The plant's own motions are slow against half a period, torquers
# may settle within it: a lag of a tenth of a part has an error of 1 % of what it adds.
_POINTS = 5
# A part of the delay below this share of a period counts as zero.
_SHORT = 1e-6
# Components of a slow sequence that are followed: a hold passes of the others less than 1 % each.
_MOST_COMPONENTS = 64

Chosen = NDArray[np.intp] | None


class ReadAndSeen(NamedTuple):
    """Responses at some frequencies; columns are m inputs of the loop, then disturbances: torques, Omega1 to Omega3.

    `read` (..., p, m + d): to what is read, at the samples. `seen` (..., k, s, m + d): to the readings' own signals and
    the rates of the line of sight, each at k instants or components, weighted.
    """

    read: ComplexArray
    seen: ComplexArray


def _response(system: System, w: FloatArray, of: Chosen) -> ComplexArray:
    return frequency_response(system, w, -3) if of is None else response_at(system, w, of)


def response_at(system: System, w: FloatArray, of: NDArray[np.intp]) -> ComplexArray:
    """Return the responses (F, p, m) of systems `of` (F,) of a stack (N, ...), each at its frequency w (F,), rad/s."""
    A, B, C, D, dt = system
    z = np.exp(1j * w * dt) if dt else 1j * w
    x = np.linalg.solve(z[:, None, None] * np.eye(A.shape[-1]) - A[of], B[of].astype(np.complex128))
    return np.asarray(C[of] @ x + D[of], dtype=np.complex128)


@value
class Instants:
    """Instants within a period, s, at which signals are seen, and the roots of their weights in a mean square."""

    times: FloatArray
    weights: FloatArray


def instants(period: float, delay: float) -> Instants:
    """Return the instants of Gauss's rule between samples, before and after a delayed torque changes."""
    _, _, part = split_delay("instants", period, delay, 1)
    edges = [0.0, *([part] if _SHORT < part < 1.0 - _SHORT else []), 1.0]
    x, weights = np.polynomial.legendre.leggauss(_POINTS)
    halves = [(0.5 * (high - low), low) for low, high in pairwise(edges)]
    return Instants(
        times=period * np.concatenate([low + half * (x + 1.0) for half, low in halves]),
        weights=np.sqrt(np.concatenate([half * weights for half, _ in halves])),
    )


def rows_between(
    plants: System, period: float, delay: float, lags: FloatArray, times: Sequence[float] | FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Return C and D of the outputs of sampled plants (`sampling.sampled`) at instants after a sample.

    `plants` (N, ...) are continuous, with p outputs; C is (N, k p, n), D (N, k p, m) for k instants, one after another.
    """
    A, B, C, D, _ = with_lag(plants, lags)
    N, n, m = len(A), A.shape[-1], B.shape[-1]
    period, whole, part = split_delay("rows_between", period, delay, m)
    reach = whole + (1 if part > 0.0 else 0)
    old, new = (slice(n + m * (j - 1), n + m * j) if j else slice(n + m * reach, None) for j in (whole + 1, whole))
    found = []
    for tau in times:
        # Over [x, held torques, torque]: the state at the instant, then the torque that acts there.
        x, acting = np.zeros((N, n, n + m * (reach + 1))), new
        x[..., :n] = np.eye(n)
        for start, end, torque in ((0.0, part * period, old), (part * period, period, new)):
            if tau > start and end > start:
                phi, driven = held_input(A, B, min(tau, end) - start)
                x = phi @ x
                x[..., torque] += driven
                acting = torque
        row = C @ x
        row[..., acting] += D
        found.append(row)
    rows = np.concatenate(found, axis=-2) if found else np.zeros((N, 0, n + m * (reach + 1)))
    return rows[..., : n + m * reach], rows[..., n + m * reach :]


@value
class PlantResponses:
    """Responses of plants whose torques are set at every sample, perhaps with a gain from readings that drives have.

    Outputs are p readings, s signals of the line of sight and f readings of drives, in this order.
    """

    # (N, ...): continuous, from disturbances to these outputs.
    smooth: System
    # (N, ...): sampled, from torques to these outputs, late, and to readings' signals and line of sight at instants.
    stepped: System
    late: tuple[int, ...]  # (p + s + f,): whole periods by which these outputs are late
    instants: Instants
    drives: FloatArray | None = None  # (N, m, f): what drives add to the torques in proportion to their readings
    readings: int  # p
    # (3,): of plants in which gravity acts: small rotations of the root, the integrals of its rates, are the last three
    # inputs of `smooth`. Rates that are slower than these, rad/s, turn it by as much as these: at full rate by 1 rad.
    turning: FloatArray | None = None

    @property
    def inputs(self) -> int:
        """The number of inputs, m."""
        return int(self.stepped.B.shape[-1])

    @property
    def period(self) -> float:
        """The sample period, s."""
        return self.stepped.dt

    def at(self, w: FloatArray, of: Chosen = None) -> ReadAndSeen:
        """Return responses of all plants at all frequencies w (F,), (N, F, ...), or of plants `of` (F,), (F, ...)."""
        p, outputs, m = self.readings, len(self.late), self.stepped.B.shape[-1]
        f = 0 if self.drives is None else self.drives.shape[-1]
        shown = outputs - f
        G, H = _response(self.smooth, w, of), _response(self.stepped, w, of)
        if self.turning is not None:
            G[..., -6:-3] += G[..., -3:] / (1j * np.maximum(w[:, None, None], self.turning))
            G = G[..., :-3]
        late = np.exp(-1j * self.period * w[:, None] * np.array(self.late, dtype=np.float64))[..., None]
        read = np.concatenate([H[..., :outputs, :], late * G], axis=-1)
        k = len(self.instants.times)
        turned = self.instants.weights * np.exp(-1j * w[:, None] * self.instants.times)
        moved = H[..., outputs:, :].reshape(*H.shape[:-2], k, shown, m) * turned[..., None, None]
        still = self.instants.weights[:, None, None] * G[..., None, :shown, :]
        seen = np.concatenate([moved, still], axis=-1)
        if self.drives is not None:
            gains = self.drives[:, None] if of is None else self.drives[of]
            fed = read[..., shown:, :]
            into = np.linalg.inv(np.eye(m) - gains @ fed[..., :m])
            torques = into @ np.concatenate(
                [np.broadcast_to(np.eye(m), (*read.shape[:-2], m, m)), gains @ fed[..., m:]], axis=-1
            )
            read, seen = _with_inputs(ReadAndSeen(read, seen), torques, m, read.shape[-1] - m)
        return ReadAndSeen(read[..., :p, :], seen)

    def only(self, index: NDArray[np.intp]) -> PlantResponses:
        """Return the responses of some of the plants."""
        drives = None if self.drives is None else self.drives[index]
        return dataclasses.replace(self, smooth=self.smooth.at(index), stepped=self.stepped.at(index), drives=drives)


@value
class _Changed:
    """Responses that follow from those of simpler plants, `plain`."""

    plain: DisturbanceResponses

    @property
    def inputs(self) -> int:
        """The number of inputs, m."""
        return self.plain.inputs

    @property
    def period(self) -> float:
        """The sample period, s."""
        return self.plain.period

    def only(self, index: NDArray[np.intp]) -> Self:
        """Return the responses of some of the plants."""
        return dataclasses.replace(self, plain=self.plain.only(index))


@value
class SlowerResponses(_Changed):
    """Responses of plants whose inputs are set at every n-th sample only, and held meanwhile."""

    every: int

    @property
    def period(self) -> float:
        """The slower sample period, s."""
        return self.every * self.plain.period

    def at(self, w: FloatArray, of: Chosen = None) -> ReadAndSeen:
        """Return the responses; see `DisturbanceResponses`."""
        m, span = self.inputs, min(self.every, _MOST_COMPONENTS)
        shifts = (np.arange(span) - span // 2) * 2.0 * np.pi / self.period
        parts = []
        for shift in shifts:
            at = w + shift
            read, seen = self.plain.at(np.abs(at), of)
            # A response at a negative frequency is the conjugate one.
            back = (at < 0.0)[:, None, None]
            read, seen = np.where(back, read.conj(), read), np.where(back[..., None], seen.conj(), seen)
            held = np.exp(-1j * np.outer(at * self.plain.period, np.arange(self.every))).mean(axis=1)[:, None, None]
            read[..., :m] *= held
            seen[..., :m] *= held[..., None]
            if shift:
                read[..., m:], seen[..., m:] = 0.0, 0.0
            parts.append(ReadAndSeen(read, seen))
        read = np.sum([one.read for one in parts], axis=0)
        return ReadAndSeen(read, np.concatenate([one.seen for one in parts], axis=-3))


@value
class FedResponses(_Changed):
    """Responses of plants with feedforward F of the platform's rate.

    The readings of its sensors through F add to the inputs, or to what is read.
    """

    feedforward: RateFeedforward

    def at(self, w: FloatArray, of: Chosen = None) -> ReadAndSeen:
        """Return the responses; see `DisturbanceResponses`."""
        read, seen = self.plain.at(w, of)
        added = self.feedforward.response(w)
        if self.feedforward.into == "reading":
            read[..., -3:] += added
            return ReadAndSeen(read, seen)
        m = self.inputs
        read[..., -3:] += read[..., :m] @ added
        seen[..., -3:] += seen[..., :m] @ added[..., None, :, :]
        return ReadAndSeen(read, seen)


@value
class ClosedResponses(_Changed):
    """Responses of plants around which a loop is closed, to its commands and to Omega1 to Omega3 alone.

    Outputs are the signals that the loop does not read.
    """

    controller: System  # u = K y + H r, from the first p readings and commands
    readings: int  # p

    @property
    def inputs(self) -> int:
        """The number of commands."""
        return int(self.controller.D.shape[1]) - self.readings

    def at(self, w: FloatArray, of: Chosen = None) -> ReadAndSeen:
        """Return the responses; see `DisturbanceResponses`."""
        found, p, m = self.plain.at(w, of), self.readings, self.plain.inputs
        KH = frequency_response(self.controller, w, -3)
        K, H = KH[..., :p], KH[..., p:]
        own = found.read[..., :p, :]
        into = np.linalg.inv(np.eye(m) - K @ own[..., :m])
        inputs = into @ np.concatenate(
            [np.broadcast_to(H, (*own.shape[:-2], *H.shape[-2:])), K @ own[..., -3:]], axis=-1
        )
        read, seen = _with_inputs(found, inputs, m, 3)
        return ReadAndSeen(read[..., p:, :], seen[..., p:, :])


@value
class CombinedResponses(_Changed):
    """Responses of plants of which combinations of the readings are read."""

    sense: FloatArray  # (q, p), or of each plant (N, q, p)

    def only(self, index: NDArray[np.intp]) -> CombinedResponses:
        """Return the responses of some of the plants."""
        sense = self.sense[index] if self.sense.ndim > 2 else self.sense
        return CombinedResponses(plain=self.plain.only(index), sense=sense)

    def at(self, w: FloatArray, of: Chosen = None) -> ReadAndSeen:
        """Return the responses; see `DisturbanceResponses`."""
        read, seen = self.plain.at(w, of)
        sense, p = self.sense, self.sense.shape[-1]
        if sense.ndim > 2:
            sense = sense[:, None] if of is None else sense[of]
        within = sense[..., None, :, :] @ seen[..., :p, :]
        return ReadAndSeen(sense @ read, np.concatenate([within, seen[..., p:, :]], axis=-2))


# What gives the responses of the plants of a loop.
DisturbanceResponses: TypeAlias = PlantResponses | SlowerResponses | FedResponses | ClosedResponses | CombinedResponses


def _with_inputs(found: ReadAndSeen, inputs: ComplexArray, m: int, d: int) -> ReadAndSeen:
    """Return responses whose m inputs are set by others and by the last d disturbances, `inputs` (..., m, m' + d)."""
    read, seen = found.read[..., :m] @ inputs, found.seen[..., :m] @ inputs[..., None, :, :]
    read[..., -d:] += found.read[..., -d:]
    seen[..., -d:] += found.seen[..., -d:]
    return ReadAndSeen(read, seen)


class Disturbed(NamedTuple):
    """Responses to disturbances with as few rows as possible: columns as in `ReadAndSeen`.

    `read` (..., p, m + d); `angle` and `sight` (..., rows, m + d): the readings' own signals and the rates of the line
    of sight between samples.
    """

    read: ComplexArray
    angle: ComplexArray
    sight: ComplexArray


def disturbed(found: ReadAndSeen, readings: int, kept: int) -> Disturbed:
    """Return responses with the rows of all instants as few that have the same gains; of readings of the kept alone."""
    return Disturbed(found.read, _fewer(found.seen[..., :kept, :]), _fewer(found.seen[..., readings:, :]))


def _fewer(seen: ComplexArray) -> ComplexArray:
    *batch, k, s, columns = seen.shape
    rows = seen.reshape(*batch, k * s, columns)
    return rows if k * s <= columns else np.asarray(np.linalg.qr(rows, mode="r"))


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
        """Return responses to disturbances of plants with feedforward, from those without it."""
        return FedResponses(plain=plain, feedforward=self)

    def response(self, frequency: FloatArray) -> ComplexArray:
        """Return F G at frequencies (F,), rad/s, from the continuous platform rate: (F, m or p, 3)."""
        late = np.exp(-1j * frequency[:, None] * self.late)[..., None]
        shown = frequency_response(self.smooth, frequency, -3) * late
        return np.asarray(frequency_response(self.path, frequency, -3) @ shown)

    def in_directions(self, sense: FloatArray) -> RateFeedforward:
        """Return it for combinations of the loop's readings, the rows of `sense` (k, p)."""
        if self.into == "torque":
            return self
        return dataclasses.replace(self, path=self.path._replace(C=sense @ self.path.C, D=sense @ self.path.D))

    def joined_to(self, controller: System) -> System:
        """Return K (or K with commands) together with F: inputs of K, then the sensors; states of K, then of F."""
        A, B, C, D, dt = controller
        A_F, B_F, C_F, D_F, _ = self.path
        p = len(C_F)
        into, onto = (np.zeros((len(A), p)), np.eye(p)) if self.into == "torque" else (B[:, :p], D[:, :p])
        whole = block([[A, into @ C_F, B, into @ D_F], [0, A_F, 0, B_F], [C, onto @ C_F, D, onto @ D_F]])
        return System.split(whole, len(A) + len(A_F), dt)

    def taken_up(self, whole: System, m: int, p: int) -> System:
        """Return plants (N, ...) that have it.

        Inputs are `m` torques and the platform's rate, the first `p` outputs are what the controller reads.
        """
        A, B, C, D, dt = whole
        A_F, B_F, C_F, D_F, _ = self.from_rate
        n, outputs = A.shape[-1], C.shape[-2]
        into, onto = B[..., :m], D[..., :m]
        if self.into == "reading":
            into, onto = np.zeros((n, p)), np.eye(outputs)[:, :p]
        driven = block([[B[..., :m], B[..., m:] + into @ D_F], [0, B_F]])
        seen = block([[C, onto @ C_F, D[..., :m], D[..., m:] + onto @ D_F]])
        n += len(A_F)
        return System(block([[A, into @ C_F], [0, A_F]]), driven, seen[..., :n], seen[..., n:], dt)

    def noise_of_torques(self, closed: System) -> System:
        """Return the loops from independent samples of unit rms, one for each sensor, to the torques.

        `closed` (N, ...) leads from a disturbance of the torques and the noise of the readings to the torques.
        """
        path = self.path._replace(B=self.path.B * self.noise, D=self.path.D * self.noise)
        A, B, C, D, dt = closed
        m = C.shape[-2]
        if self.into == "reading":
            return path.series(System(A, B[..., m:], C, D[..., m:], dt))
        # Its part of the torques, and the controller's part against it.
        return path.series(System(A, B[..., :m], C, D[..., :m] + np.eye(m), dt))
