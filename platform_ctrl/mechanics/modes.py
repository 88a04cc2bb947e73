"""The modes of the uncontrolled gimbals, and what kind each of them is.

Of an eigenvector x to a pole s of (s² M + s G + s D + K) x = 0, with G that of the rotors alone, the smallest of three
torques determines which two balance each other, measured by x̄ᵀ M⁻¹ x:

    smallest                              mode
    restraint, s D x + K x                nutation: the rotors' torques against inertia
    inertia, s² M x                       precession: the rotors' torques against restraint
    the rotors' torques, s G x            oscillation, divergence or decay, as without rotors

D holds friction, damping and what a platform rate makes of the inertias; K holds springs, unbalance and restraint by a
platform rate.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Iterable
from typing import Literal

import numpy as np

from platform_ctrl.common.values import FloatArray, replaced, value
from platform_ctrl.mechanics.linearisation import LinearModel, linearise
from platform_ctrl.mechanics.state_space import ComplexArray, linear_system, named_rows, subsystems
from platform_ctrl.plant.platform import Platform

Kind = Literal["nutation", "precession", "rigid body", "pendulum", "oscillation", "divergence", "decay"]

# A pole this small against the fastest of its group counts as zero: multiple zeros come out that large in floats.
_ZERO = 1e-5
# Real parts, or differences of real poles, this small against a pole are rounding.
_EQUAL = 1e-6


@value
class Mode:
    """A group of poles of the uncontrolled gimbals."""

    gimbals: tuple[str, ...]  # The subsystem
    # "nutation" and "precession" of rotors; "rigid body": poles at the origin that no rotor and no restraint takes
    # away; "pendulum": an oscillation by unbalance; "oscillation", "divergence" and "decay"
    kind: Kind
    poles: int  # How many
    frequency: float  # Of the oscillation, |Im s|, rad/s; 0 where there is none
    growth: float  # Largest real part, 1/s; 0 where nothing grows


def modes(model: LinearModel, gimbals: tuple[str, ...]) -> tuple[Mode, ...]:
    """Return the modes of a subsystem at the model's trim, fastest first."""
    s, kinds = poles_and_kinds(model, gimbals)
    small = _ZERO * float(np.abs(s).max(initial=0.0))
    moving = int((np.abs(s) > small).sum())
    out, k = [], 0
    while k < moving:
        # A conjugate pair, or two real poles at the same distance from the origin.
        pair = k + 1 < moving and bool(abs(abs(s[k + 1]) - abs(s[k])) <= _EQUAL * abs(s[k]))
        together = slice(k, k + 2 if pair else k + 1)
        kind = "divergence" if "divergence" in kinds[together] else kinds[k]
        out.append(_mode(gimbals, kind, s[together], small))
        k = together.stop
    rest, standing = len(s) - moving, _precessing(model, gimbals)
    turned = min(standing, rest)
    at_zero: tuple[tuple[Kind, int], ...] = (("precession", turned), ("rigid body", rest - turned))
    out += [_mode(gimbals, kind, np.zeros(poles, dtype=np.complex128), small) for kind, poles in at_zero if poles]
    return tuple(out)


def poles_and_kinds(model: LinearModel, gimbals: tuple[str, ...]) -> tuple[ComplexArray, list[Kind]]:
    """Return the poles of a subsystem, fastest first, and the kind of each that is not at the origin."""
    rows = named_rows(model, gimbals)
    part = np.ix_(rows, rows)
    M, spinning = model.M[part], _rotors_part(model)[part]
    damping, stiffness = model.damping[part] - spinning, model.stiffness[part]
    hanging = dataclasses.replace(model.platform, unbalances=())
    unbalance = model.Q_angle[part] - _again(model, hanging).Q_angle[part]
    s, vectors = np.linalg.eig(linear_system(model, gimbals).A)
    order = np.argsort(-np.abs(s), kind="stable")
    s, x = s[order], vectors[: len(rows), order]

    def size(torques: ComplexArray) -> FloatArray:
        return np.asarray(np.sqrt(np.abs(np.einsum("ik,ik->k", torques.conj(), np.linalg.solve(M, torques)))))

    inertia, rotors = size(s**2 * (M @ x)), size(s * (spinning @ x))
    restraint = size(s * (damping @ x) + stiffness @ x)
    # Along the mode itself: what the other elements hold of a torque across it does not count.
    weight, whole = (np.real(np.einsum("ik,ij,jk->k", x.conj(), part, x)) for part in (-unbalance, stiffness))
    kinds: list[Kind] = []
    for k, pole in enumerate(s):
        if rotors[k] > min(inertia[k], restraint[k]):
            kinds.append("nutation" if restraint[k] <= inertia[k] else "precession")
        elif abs(pole.imag) > _EQUAL * abs(pole):
            kinds.append("pendulum" if weight[k] > 0.5 * abs(whole[k]) else "oscillation")
        else:
            kinds.append("divergence" if pole.real > 0.0 else "decay")
    return s, kinds


def rotors_at_rest(platform: Platform) -> Platform:
    """Return the platform with its rotors at rest: the linear model is affine in their momenta."""
    return replaced(platform, {"rotors": tuple(replaced(r, {"angular_momentum": 0.0}) for r in platform.rotors)})


def _rotors_part(model: LinearModel) -> FloatArray:
    """Return the part of G from the rotors' momenta, (n, n): nutation and precession follow from it."""
    return np.asarray(model.G - _again(model, rotors_at_rest(model.platform)).G)


def _again(model: LinearModel, platform: Platform) -> LinearModel:
    """Return another platform's model at the same trim."""
    return linearise(platform, Omega=model.Omega0, terms=model.terms, q=model.q0, specific_force=model.specific_force)


def _precessing(model: LinearModel, gimbals: tuple[str, ...]) -> int:
    """Return in how many directions without restraint a torque makes the rotors precess: poles at the origin."""
    rows = named_rows(model, gimbals)
    part = np.ix_(rows, rows)
    spinning, stiffness = _rotors_part(model)[part], model.stiffness[part]
    _, sizes, directions = np.linalg.svd(stiffness)
    free = directions[sizes <= _EQUAL * max(float(sizes.max(initial=0.0)), 1e-300)]
    return int(np.linalg.matrix_rank(free @ spinning @ free.T, tol=_EQUAL * float(np.abs(spinning).max(initial=0.0))))


def _mode(gimbals: tuple[str, ...], kind: Kind, s: ComplexArray, small: float) -> Mode:
    frequency, growth = float(np.abs(s.imag).max(initial=0.0)), float(s.real.max(initial=0.0))
    return Mode(
        gimbals=gimbals,
        kind=kind,
        poles=len(s),
        frequency=frequency if frequency > small else 0.0,
        growth=growth if growth > small else 0.0,
    )


def nutates(model: LinearModel, gimbals: Iterable[str]) -> bool:
    """Return whether a mode in which one of these gimbals takes part is a nutation."""
    named = set(gimbals)
    return any("nutation" in poles_and_kinds(model, group)[1] for group in subsystems(model) if named & set(group))
