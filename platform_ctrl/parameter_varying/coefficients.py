"""The coefficients of (27): what rotors and what inertias contribute, apart and exact.

The rotors' part is of one degree less in Omega than that of the inertias. Each is taken from `linearise` alone, the
rotors by ``terms="paper"``, which drops G_A, and the inertias with L = 0: small J Omega never comes out as a
difference of large L.
"""

from __future__ import annotations

import dataclasses
import itertools

import numpy as np

from platform_ctrl.description import OMEGA_NAMES, Platform
from platform_ctrl.frozen import FloatArray, value
from platform_ctrl.linearisation import LinearModel, Terms, linearise
from platform_ctrl.mechanics.coupling import inertia_rounding, momentum_rounding
from platform_ctrl.parameter_varying.polynomial import MatrixPolynomial, polynomial


@value
class RowPolynomials:
    """G (n, n), K (n, n) and Q0 (n,) of all gimbals' rows, or one part of them."""

    G: MatrixPolynomial
    K: MatrixPolynomial
    Q0: MatrixPolynomial


def bare(platform: Platform) -> Platform:
    """Return the platform without force elements."""
    return dataclasses.replace(platform, springs=(), frictions=(), cages=(), unbalances=(), erections=())


def rotor_part(platform: Platform, q: FloatArray) -> RowPolynomials:
    """Return what L does about the angles q (n,): gyroscopic action, restraint and disturbance."""
    n = len(q)
    at = [linearise(bare(platform), rate, "paper", q) for rate in np.eye(3)]
    shared = momentum_rounding(platform)
    G = {"1": clean(at[0].G, shared)}
    K = {name: clean(model.K, shared) for name, model in zip(OMEGA_NAMES, at, strict=True)}
    Q0 = {name: clean(model.Q0, np.diag(shared)) for name, model in zip(OMEGA_NAMES, at, strict=True)}
    return RowPolynomials(G=polynomial(G, (n, n)), K=polynomial(K, (n, n)), Q0=polynomial(Q0, (n,)))


def inertia_part(platform: Platform, q: FloatArray) -> RowPolynomials:
    """Return what the inertias do about the angles q (n,) at constant Omega: Coriolis and centrifugal terms."""
    n = len(q)
    rotors = tuple(dataclasses.replace(rotor, angular_momentum=0.0) for rotor in platform.rotors)
    still = dataclasses.replace(bare(platform), rotors=rotors)
    shared = inertia_rounding(platform)
    G, K, Q0 = {}, {}, {}
    at: dict[tuple[int, int], LinearModel] = {}
    for a, b in itertools.combinations_with_replacement(range(3), 2):
        rate = np.zeros(3)
        rate[[a, b]] = 1.0
        at[a, b] = linearise(still, rate, "exact", q)
    for (a, b), model in at.items():
        if a == b:
            G[OMEGA_NAMES[a]] = clean(model.G, shared)
            K[f"{OMEGA_NAMES[a]}^2"] = clean(model.K, shared)
            Q0[f"{OMEGA_NAMES[a]}^2"] = clean(model.Q0, np.diag(shared))
        else:
            name = f"{OMEGA_NAMES[a]}*{OMEGA_NAMES[b]}"
            K[name] = clean(model.K - at[a, a].K - at[b, b].K, shared)
            Q0[name] = clean(model.Q0 - at[a, a].Q0 - at[b, b].Q0, np.diag(shared))
    return RowPolynomials(G=polynomial(G, (n, n)), K=polynomial(K, (n, n)), Q0=polynomial(Q0, (n,)))


def acceleration_part(platform: Platform, q: FloatArray, terms: Terms) -> MatrixPolynomial:
    """Return the coefficient of q from Omega' about the angles q (n,): all of it, or C alone as the paper has it."""
    turning = linearise(bare(platform), terms=terms, q=q).M_Omega_q
    shared = inertia_rounding(platform)
    return polynomial({f"{a}'": clean(turning[:, k], shared) for k, a in enumerate(OMEGA_NAMES)}, (len(q),) * 2)


def clean(array: FloatArray, rounding: FloatArray) -> FloatArray:
    """Return the array without the entries that are rounding alone."""
    return np.where(np.abs(array) > rounding, array, 0.0)
