"""The engine's norms: H-infinity norms and disk margins beside python-control's, which lean on slycot."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from typing import Any

import control
import numpy as np
from side_by_side import Comparison, DisagreementError, Section, close

from platform_ctrl import analysis
from platform_ctrl.analysis.arrays import ComplexArray
from platform_ctrl.analysis.diagonal_mu import mu_bounds


def stable_loop(states: int, channels: int, seed: int) -> control.StateSpace:
    """Return a random strictly proper loop transfer whose closed loop is stable."""
    rng = np.random.default_rng(seed)
    A = rng.normal(size=(states, states))
    A -= (np.linalg.eigvals(A).real.max() + 0.3) * np.eye(states)
    B, C = rng.normal(size=(states, channels)), rng.normal(size=(channels, states))
    return control.ss(A + B @ C, B, C, 0)


def hinf_norms() -> Iterator[Comparison]:
    """Yield norms of well-scaled systems, and one that AB13DD takes for unstable."""
    for states in (8, 16, 32):
        loop = stable_loop(states, 3, 3)
        closed = control.ss(loop.A - loop.B @ loop.C, loop.B, loop.C, 0)
        yield Comparison(
            name=f"hinf_norm, {states} states, 3 x 3",
            ours=_norm(closed),
            theirs={"control.linfnorm": _linfnorm(closed)},
            check=close(1e-8),
        )
    zeta = 1e-8
    A = np.array([[0.0, 1.0, 0.0], [-1.0, -2.0 * zeta, 0.0], [0.0, 0.0, -1e9]])
    wide = control.ss(A, [[0.0], [2.0 * zeta], [1e9]], [[1.0, 0.0, 1e-3]], 0)
    yield Comparison(
        name="hinf_norm, damping 1e-8 beside 1e9 rad/s",
        ours=_norm(wide),
        theirs={"control.linfnorm": _linfnorm(wide)},
        check=_found_infinite,
        note=lambda: f"norm {analysis.hinf_norm(wide)[0]:.6f}; linfnorm says {control.linfnorm(wide)[0]}",
    )


def disk_margins() -> Iterator[Comparison]:
    """Yield margins at 400 frequencies: both bounds there and, of ours, the peak in between with its proof."""
    w = np.geomspace(1e-2, 1e2, 400)
    for states, channels, target in ((9, 3, 50.0), (16, 3, 50.0), (12, 4, None)):
        loop = stable_loop(states, channels, 3)
        yield Comparison(
            name=f"disk_margin, {channels} x {channels}, {states} states, 400 frequencies",
            ours=_margin(loop, w),
            theirs={"control.disk_margins": _disk_margins(loop, w)},
            target=target,
            check=close(1e-3),
        )
        response = np.moveaxis(analysis.frequency_response(loop, w), -1, 0)
        M = np.ascontiguousarray(np.linalg.inv(np.eye(channels) + response) - 0.5 * np.eye(channels))
        yield Comparison(
            name=f"mu alone, {channels} channels, 400 matrices",
            ours=_mu(M),
            theirs={"slycot.ab13md": _ab13md(M)},
            check=close(1e-3),
        )


def _found_infinite(ours: Any, theirs: Mapping[str, Any]) -> str:
    if not abs(ours - 1.000001) < 1e-8:
        raise DisagreementError(f"ours: {ours}, expected 1.000001")
    return ", ".join("wrong" if not np.isfinite(one) else "right" for one in theirs.values())


def _norm(system: control.StateSpace) -> Callable[[], float]:
    return lambda: analysis.hinf_norm(system)[0]


def _linfnorm(system: control.StateSpace) -> Callable[[], float]:
    return lambda: float(control.linfnorm(system)[0])


def _margin(loop: control.StateSpace, w: np.ndarray) -> Callable[[], np.ndarray]:
    return lambda: analysis.disk_margin(loop, frequency=w).lower_response


def _disk_margins(loop: control.StateSpace, w: np.ndarray) -> Callable[[], np.ndarray]:
    return lambda: np.asarray(control.disk_margins(loop, w, 0.0, returnall=True)[0])


def _mu(M: ComplexArray) -> Callable[[], np.ndarray]:
    return lambda: mu_bounds(M).upper


def _ab13md(M: ComplexArray) -> Callable[[], np.ndarray]:
    from slycot import ab13md

    blocks, kinds = np.ones(M.shape[-1], dtype=int), np.full(M.shape[-1], 2)
    return lambda: np.array([ab13md(one, blocks, kinds)[0] for one in M])


SECTIONS: dict[str, Section] = {"hinf-norm": hinf_norms, "disk-margin": disk_margins}
