"""A caging loop scheduled by the platform's rate, proved for every Omega(t) within limits.

The mixed-sensitivity problem of `design.riccati.weighted_loop` in continuous time, around the parameter-varying model:
its parameters are Omega and products of it; with momentum states they may change at any rate.

    ::

        n ──────────────►(+)──► W_e ──► z1, and to K
                          ▲
        d ──►(+)──► G(Ω) ─┴───► W_t ──► z2
              ▲
        u ────┴───► W_u ──────────────► z3

    G(Ω) gimbals behind the torquers' lag,  W_e = 1/M + ω_e/s,  W_t and W_u constant,  d scaled by `disturbance`.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike

from platform_ctrl.analysis.arrays import StateArrays, named_system, state_arrays
from platform_ctrl.analysis.feedback import series
from platform_ctrl.common.arguments import positive, real_array
from platform_ctrl.common.values import FloatArray, value
from platform_ctrl.design.lmi.scheduled import Scheduled, scheduled
from platform_ctrl.design.partition import between, channels
from platform_ctrl.design.riccati.weighted_loop import error_weight, mixed_sensitivity, signal_names, torque_units
from platform_ctrl.design.synthesis import hinf
from platform_ctrl.errors import ArgumentError
from platform_ctrl.mechanics.linearisation import Terms, linearise
from platform_ctrl.mechanics.parameter_varying import parameter_varying
from platform_ctrl.mechanics.polynomials import monomial_values
from platform_ctrl.plant.platform import Platform

if TYPE_CHECKING:
    from control import StateSpace

WHERE = "scheduled caging"


@value
class ScheduledCaging:
    """A caging controller that follows Omega.

    Attributes
    ----------
    scheduled
        The design of the weighted problem, with its certificate.
    frozen
        Least gamma of the design for Omega = 0 alone, dimensionless.
    angles, torques
        Names of the controller's inputs and outputs.
    Omega_max : (3,)
        The rates that are covered, rad/s.
    weight_rate : (k,)
        ω_e of the channels, rad/s; their gain is 1/M.
    peak
        M, dimensionless.
    basis, torque : (k, k)
        Channels from angles, dimensionless, and torquers from the channels' torques, N m.
    """

    scheduled: Scheduled
    frozen: float
    angles: tuple[str, ...]
    torques: tuple[str, ...]
    Omega_max: FloatArray
    weight_rate: FloatArray
    peak: float
    basis: FloatArray
    torque: FloatArray

    @property
    def price(self) -> float:
        """Relative increase of gamma against the design at rest."""
        return self.scheduled.gamma_optimal / self.frozen - 1.0

    def controller(self, Omega: ArrayLike) -> StateSpace:
        """Return the controller at a rate of the platform (3,), rad/s, within the limits, integral action included.

        u = K y: inputs `angles`, rad, outputs `torques`, N m.
        """
        rate = real_array("Omega", Omega, (3,))
        if np.any(np.abs(rate) > self.Omega_max * (1 + 1e-9)):
            raise ArgumentError(f"Omega: must be at most {self.Omega_max.tolist()} rad/s, got {rate.tolist()}")
        # The weight's integrator belongs to the controller: it is in series before K.
        weight = error_weight(np.full(len(self.weight_rate), 1.0 / self.peak), self.weight_rate)
        K = self.scheduled.at(monomial_values(self.scheduled.box.names, rate))
        whole = between(self.basis, series(weight, state_arrays(K, "controller")), self.torque)
        return named_system(whole, self.angles, self.torques)


def scheduled_caging(  # noqa: PLR0913 - options by keyword
    platform: Platform,
    gimbals: Sequence[str] | None = None,
    *,
    Omega_max: ArrayLike = (1.0, 1.0, 1.0),
    bandwidth_hz: float,
    inertial_bandwidth_hz: float | None = None,
    sensitivity_peak: float = 1.9,
    complementary: float = 0.5,
    disturbance: float = 0.25,
    torque: float = 0.1,
    lag: float = 2e-4,
    terms: Terms = "exact",
    backoff: float = 0.02,
    time_limit: float = 60.0,
) -> ScheduledCaging:
    """Caging loop for some gimbals that follows Omega, with a proof for every Omega(t) within `Omega_max`.

    Parameters
    ----------
    platform, gimbals
        The platform, and the gimbals that are caged, each with a torquer; default all.
    Omega_max : (3,)
        Largest rates about the axes, rad/s. A zero leaves the axis out.
    bandwidth_hz, inertial_bandwidth_hz
        Of W_e, Hz, for gyroscopic pairs and for directions without gyroscopic action (default: the same).
    sensitivity_peak, complementary, disturbance, torque
        M, W_t, the size of d and W_u, dimensionless: torques count in units of h ω_nutation (pairs) and J ω_nutation²
        (others).
    lag
        Lag of the torquers, s; the delay of a sampled loop is to be added here.
    terms
        ``"exact"`` or ``"paper"``, see `parameter_varying`; the latter has fewer parameters.
    backoff
        Relative distance from the least gamma, see `scheduled`.
    time_limit
        See `scheduled`, s.

    Returns
    -------
    ScheduledCaging
        A controller for every rate, and its certificate.

    Raises
    ------
    ArgumentError
        The arguments do not make sense, or a gimbal without a torquer of its own.
    DesignError
        As `scheduled`.

    References
    ----------
    P. Apkarian, P. Gahinet, G. Becker, Automatica 31, 1995.

    See docs/lmi.md.
    """
    limits = real_array(f"{WHERE}: Omega_max", Omega_max, (3,))
    lag, width = positive(f"{WHERE}: lag", lag), positive(f"{WHERE}: bandwidth_hz", bandwidth_hz)
    single = (
        width if inertial_bandwidth_hz is None else positive(f"{WHERE}: inertial_bandwidth_hz", inertial_bandwidth_hz)
    )
    peak = positive(f"{WHERE}: sensitivity_peak", sensitivity_peak)
    constants = {"complementary": complementary, "disturbance": disturbance, "torque": torque}
    constants = {name: positive(f"{WHERE}: {name}", size) for name, size in constants.items()}
    model = parameter_varying(platform, gimbals=gimbals, terms=terms, form="momenta")
    affine = model.affine()
    k = len(model.gimbals)
    torques = tuple(name for name in affine.inputs if not name.startswith("d_"))
    T = affine.B[k:, : len(torques)]
    if len(torques) != k or np.linalg.matrix_rank(T) < k:
        raise ArgumentError(f"{WHERE}: each of the gimbals {model.gimbals} must have a torquer, got {torques}")
    rows = [platform.gimbal_names.index(name) for name in model.gimbals]
    channel = channels(linearise(platform, terms=terms), rows)
    nutation = float(np.abs(np.linalg.eigvals(affine.A_0)).max())
    if not nutation > 0:
        raise ArgumentError(f"{WHERE}: one of the gimbals {model.gimbals} must carry a rotor with momentum")
    weight_rate = 2 * np.pi * np.array([width] * 2 * len(channel.momenta) + [single] * channel.inertial)
    into = np.linalg.inv(T) @ channel.basis.T * torque_units(channel, nutation)
    eye, gain = np.eye(k), np.full(k, 1.0 / peak)

    def plant(rho: FloatArray) -> StateSpace:
        A, C = affine.state_matrix(rho), channel.basis @ affine.C
        B = affine.B[:, :k] @ into
        none = np.zeros((k, k))
        # Behind the gimbals' states: torques behind the lag, through which d does not go.
        lagged = np.block([[A, B], [np.zeros_like(B).T, -eye / lag]])
        angles = np.hstack([C, none])
        acting = StateArrays(lagged, np.vstack([np.zeros_like(B), eye / lag]), angles, none)
        disturbed = StateArrays(lagged, np.vstack([constants["disturbance"] * B, none]), angles, none)
        weights = constants["complementary"] * eye, constants["torque"] * eye
        return named_system(mixed_sensitivity(acting, disturbed, gain, weight_rate, weights), *signal_names(k))

    corners = np.array([vertex.parameters for vertex in model.vertices(limits)])
    low, high = corners.min(axis=0), corners.max(axis=0)
    found = scheduled(plant, affine.parameters, low, high, k, k, backoff=backoff, time_limit=time_limit)
    at_rest = hinf(plant(np.zeros(len(low))), k, k, method="riccati", backoff=backoff)
    return ScheduledCaging(
        scheduled=found,
        frozen=at_rest.gamma_optimal,
        angles=tuple(affine.outputs),
        torques=torques,
        Omega_max=limits,
        weight_rate=weight_rate,
        peak=peak,
        basis=channel.basis,
        torque=into,
    )
