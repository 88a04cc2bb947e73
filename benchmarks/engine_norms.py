"""The engine's norms: H-infinity norms and disk margins beside python-control's, which lean on slycot."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from functools import partial
from typing import Any

import control
import numpy as np
from engine_linear import LARGE
from side_by_side import Comparison, DisagreementError, Section, close

from platform_ctrl import analysis


def stable_loop(states: int, channels: int, seed: int) -> control.StateSpace:
    """Return a random strictly proper loop transfer whose closed loop is stable."""
    rng = np.random.default_rng(seed)
    A = rng.normal(size=(states, states))
    A -= (np.linalg.eigvals(A).real.max() + 0.3) * np.eye(states)
    B, C = rng.normal(size=(states, channels)), rng.normal(size=(channels, states))
    return control.ss(A + B @ C, B, C, 0)


def closed_loop(states: int, dt: float) -> control.StateSpace:
    """Return a random stable system with three inputs and outputs."""
    loop = stable_loop(states, 3, 3)
    closed = control.ss(loop.A - loop.B @ loop.C, loop.B, loop.C, 0)
    return analysis.sampled(closed, dt) if dt else closed


def hinf_norms() -> Iterator[Comparison]:
    """Yield norms of well-scaled systems, of structures, and of one that AB13DD takes for unstable."""
    systems: dict[str, Callable[[], control.StateSpace]] = {
        f"{states} states, 3 x 3{', sampled' if dt else ''}": partial(closed_loop, states, dt)
        for states in (4, 6, 8, 16, 30)
        for dt in (0.0, 0.05)
    }
    systems |= {name: made for name, made in LARGE.items() if int(name.split()[0]) <= 400}
    for name, made in systems.items():
        one = made()
        yield Comparison(
            name=f"hinf_norm, {name}",
            ours=_norm(one),
            theirs={"control.linfnorm": _linfnorm(one)},
            target=0.4,
            clock="cpu",
            check=_near,
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
    for states, channels in ((9, 3), (16, 3), (12, 4)):
        loop = stable_loop(states, channels, 3)
        yield Comparison(
            name=f"disk_margin, {channels} x {channels}, {states} states, 400 frequencies",
            ours=_margin(loop),
            theirs={"control.disk_margins": _disk_margins(loop, w)},
            target=10.0,
            clock="cpu",
            check=close(2e-2),
        )


def _near(ours: Any, theirs: Mapping[str, Any]) -> str:
    """Say by how much a norm differs; `tests/analysis/test_hinf_norm.py` proves whose is right where they do."""
    return ", ".join(f"{abs(one / ours - 1.0):.0e}" for one in theirs.values())


def _found_infinite(ours: Any, theirs: Mapping[str, Any]) -> str:
    if not abs(ours - 1.000001) < 1e-8:
        raise DisagreementError(f"ours: {ours}, expected 1.000001")
    return ", ".join("wrong" if not np.isfinite(one) else "right" for one in theirs.values())


def _norm(system: control.StateSpace) -> Callable[[], float]:
    return lambda: analysis.hinf_norm(system)[0]


def _linfnorm(system: control.StateSpace) -> Callable[[], float]:
    return lambda: float(control.linfnorm(system)[0])


def _margin(loop: control.StateSpace) -> Callable[[], np.ndarray]:
    return lambda: np.array(analysis.disk_margin(loop).alpha)


def _disk_margins(loop: control.StateSpace, w: np.ndarray) -> Callable[[], np.ndarray]:
    return lambda: np.asarray(control.disk_margins(loop, w, 0.0, returnall=True)[0]).min()


SECTIONS: dict[str, Section] = {"hinf-norm": hinf_norms, "disk-margin": disk_margins}
