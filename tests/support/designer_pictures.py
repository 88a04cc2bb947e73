"""A picture of a small loop, worked out by hand: L = k/(s (s + 20)), with everything that a page draws."""

from __future__ import annotations

import dataclasses
from typing import Any

import numpy as np

from platform_ctrl.analysis.curves import PlaneView, RootLocus
from platform_ctrl.app.pictures import (
    Bode,
    ClosedLoop,
    FrequencyGain,
    Margins,
    Measured,
    Picture,
    TimeResponse,
)
from platform_ctrl.app.settings import Settings
from platform_ctrl.job.judging import CheckResult

DAMPING = 20.0


def settings() -> Settings:
    return Settings(
        loop="caging",
        design="classical",
        options={},
        optional={},
        channel="Q4",
    )


def poles(gain: float) -> np.ndarray[Any, Any]:
    return np.sort_complex(np.roots([1.0, DAMPING, gain]).astype(np.complex128))


def picture(gain: float = 4000.0, *, overlays: tuple[str, ...] = (), plants: int = 3, **changes: Any) -> Picture:
    """Return the picture of a loop gain; `plants` with gains of 80 to 120 % make its band."""
    f = np.geomspace(1.0, 3000.0, 160)
    s = 1j * f
    spread = np.concatenate([[1.0], np.linspace(0.8, 1.2, plants)]) if plants else np.ones(1)
    responses = np.array([k * gain / (s * (s + DAMPING)) for k in spread])
    size, phase = np.abs(responses), np.degrees(np.unwrap(np.angle(responses), axis=1))
    band_f = f if plants else np.zeros(0)
    crossover = float(np.sqrt(0.5 * (np.sqrt(DAMPING**4 + 4.0 * gain**2) - DAMPING**2)))
    t = np.linspace(0.0, 0.5, 101)

    def step(k: float) -> np.ndarray[Any, Any]:
        p = poles(k * gain)
        a = 2e-3 / (p[0] * p[1]) * (1.0 + (p[1] * np.exp(p[0] * t) - p[0] * np.exp(p[1] * t)) / (p[0] - p[1]))
        return np.array([a.real, -0.5 * a.real, -1e6 * 2e-8 * a.real])

    steps = np.array([step(k) for k in spread])
    gains = np.linspace(0.0, 2.0, 41)
    branches = np.array([poles(k * gain) for k in gains])
    present = poles(gain)
    from_rate = np.abs(1e-2 * s / (s * s + DAMPING * s + gain))

    def time(title: str, limit: float | None) -> TimeResponse:
        return TimeResponse(
            title=title,
            t=t,
            signals=("alpha4", "beta5", "Q4"),
            units=("rad", "rad", "N m"),
            series=(0, 1, 0),
            values=steps[0],
            low=steps.min(axis=0) if plants else np.zeros((3, 0)),
            high=steps.max(axis=0) if plants else np.zeros((3, 0)),
            drive=np.minimum(1.0, 10.0 * t),
            limit=limit,
        )

    asked = CheckResult(
        name="bandwidth",
        subject="caging",
        design="classical",
        value=9.0,
        limit=5.0,
        unit="Hz",
        sense="at least",
        ratio=0.55,
        passed=True,
        stage="decoupled",
        evidence="",
    )
    made = Picture(
        settings=settings(),
        bode=Bode(
            channel="Q4",
            frequency=f,
            response=responses[0],
            phase=phase[0],
            labels=("nominal", *(f"plant {k}" for k in range(1, len(spread)))),
            band_frequency=band_f,
            band=responses if plants else np.zeros((1, 0), np.complex128),
            band_phase=phase if plants else np.zeros((1, 0)),
            crossovers=np.array([crossover]),
            nyquist=2000.0 * np.pi,
        ),
        closed=ClosedLoop(KS=3.0 * size[0], PS=0.01 / size[0], units=("N m/rad", "rad/(N m)")),
        locus=RootLocus(
            values=gains,
            branches=branches,
            nominal=present,
            dt=0.0,
            stable=branches.real.max(axis=1) < 0.0,
            edges=np.zeros(0),
            view=PlaneView(reach=120.0),
        ),
        poles=present,
        other_poles=np.concatenate([poles(k * gain) for k in spread[1:]]) if plants else np.zeros(0, np.complex128),
        step=time("1 mN m step at Q4", None),
        Omega_time=time("1 rad/s about axis 1", 1e-6),
        Omega_gain=lambda: FrequencyGain(
            title="rate Omega1 → angles",
            unit="rad/(rad/s)",
            frequency=f,
            gain=from_rate,
            band_frequency=band_f,
            low=0.9 * from_rate if plants else np.zeros(0),
            high=1.1 * from_rate if plants else np.zeros(0),
            limit=1e-3,
        ),
        limits={"damping": 0.1, "bandwidth": asked.limit, "disk margin": 0.5},
        measured=Measured(
            margins=Margins(
                disk=0.3,
                worst_disk=0.25,
                worst_plant="plant 1",
                worst_sampled=False,
                gain_up=np.inf,
                gain_down=0.0,
                phase=float(180.0 + np.interp(crossover, f, phase[0])),
                delay=0.001,
                crossover=crossover,
                bandwidth=50.0,
                damping=0.16,
            ),
            requirements=(asked,),
        ),
        stable=True,
        all_stable=True,
        elapsed=0.01,
    )
    # Another design's step goes on for as long as it takes: over times of its own.
    other = dataclasses.replace(time("other", None), t=2.0 * t[:81], values=step(1.5)[:, :81], drive=t[:81])
    nothing = dataclasses.replace(other, low=np.zeros((3, 0)), high=np.zeros((3, 0)))
    over = tuple(
        dataclasses.replace(
            made,
            settings=settings().but(design=name),
            bode=dataclasses.replace(made.bode, response=1.5 * responses[0]),
            poles=poles(1.5 * gain),
            step=nothing,
            Omega_time=nothing,
            Omega_gain=lambda: dataclasses.replace(made.Omega_frequency, gain=0.7 * from_rate),
        )
        for name in overlays
    )
    return dataclasses.replace(made, overlays=over, **changes)


def broken(number: float) -> Picture:
    """Return a picture in which every number of a curve is the same, not a finite one."""
    made = picture()

    def spoilt(part: Any) -> Any:
        changes = {}
        for one in dataclasses.fields(part):
            item = getattr(part, one.name)
            if isinstance(item, np.ndarray) and item.dtype != np.bool_:
                changes[one.name] = np.full(item.shape, number, item.dtype)
        return dataclasses.replace(part, **changes)

    names = ("bode", "locus", "step", "Omega_time")
    return dataclasses.replace(
        made,
        **{name: spoilt(getattr(made, name)) for name in names},
        Omega_gain=lambda: spoilt(made.Omega_frequency),
        poles=np.full(made.poles.shape, number, np.complex128),
        stable=False,
        all_stable=False,
    )
