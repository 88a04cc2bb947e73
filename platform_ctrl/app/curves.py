"""The curves of a closed loop and of a set of plants: frequency, time, poles, margins."""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from functools import cache, cached_property
from typing import Any, NamedTuple

import numpy as np

from platform_ctrl.analysis.curves import RootLocus, loop_phase, traced_locus
from platform_ctrl.analysis.feedback import sensitivities_of_plants
from platform_ctrl.analysis.interconnection import COMMAND
from platform_ctrl.analysis.poles import continuous_poles, poles, spectral_abscissa
from platform_ctrl.analysis.response import frequency_response
from platform_ctrl.analysis.system import ComplexArray, System
from platform_ctrl.app.excitation import SampledInput, sampled_responses
from platform_ctrl.app.pictures import Bode, ClosedLoop, Drawing, FrequencyGain, Measured, TimeResponse
from platform_ctrl.app.settings import Settings
from platform_ctrl.common.values import FloatArray
from platform_ctrl.job.job import Job
from platform_ctrl.plant.drawing import signal_series

# Factors of the root locus: from 0 on poles move as the root of the factor, closer steps there.
_GAINS = np.concatenate([np.linspace(0.0, 1.0, 9) ** 1.5, np.linspace(1.0, 2.5, 6)[1:]])


def channel_response(S: ComplexArray, channel: int) -> ComplexArray:
    """Return the loop broken at one channel, all others closed, 1/S_ii - 1, complex (..., F) of S (..., F, m, m)."""
    with np.errstate(all="ignore"):
        out = 1.0 / S[..., channel, channel] - 1.0
    return np.asarray(np.where(np.isfinite(out), out, 0.0), dtype=np.complex128)


def gain_crossings(frequency: FloatArray, response: ComplexArray) -> tuple[FloatArray, FloatArray]:
    """Return where the gain passes 1, rad/s, and the phase there above -180, degrees, from -180 to 180."""
    with np.errstate(divide="ignore"):
        size = np.log(np.maximum(np.abs(response), 1e-300))
    at = np.flatnonzero((size[:-1] > 0.0) != (size[1:] > 0.0))
    share = size[at] / (size[at] - size[at + 1])
    w = np.exp((1.0 - share) * np.log(frequency[at]) + share * np.log(frequency[at + 1]))
    turn = np.angle(response[at + 1] / response[at])
    phase = np.degrees(np.angle(-response[at]) + share * turn)
    return w, np.asarray((phase + 180.0) % 360.0 - 180.0)


def gain_factors(frequency: FloatArray, response: ComplexArray) -> tuple[FloatArray, FloatArray]:
    """Return where the phase passes -180 degrees, rad/s, and the factor that brings the response (F,) to -1 there.

    At both ends of the grid, next to 0 and to the Nyquist frequency, the response may be nearly real: there too.
    """
    imaginary, real = response.imag, response.real
    at = np.flatnonzero((imaginary[:-1] > 0.0) != (imaginary[1:] > 0.0))
    with np.errstate(all="ignore"):
        share = imaginary[at] / (imaginary[at] - imaginary[at + 1])
        crossing = (1.0 - share) * real[at] + share * real[at + 1]
        ends = [k for k in (0, -1) if abs(imaginary[k]) < 1e-2 * abs(real[k])]
        w = np.append(frequency[at] * (frequency[at + 1] / frequency[at]) ** share, frequency[ends])
        factors = -1.0 / np.append(crossing, real[ends])
    known = np.isfinite(factors) & (factors > 0.0)
    return w[known], factors[known]


# Sampled loops are shown up to this share of the Nyquist frequency: at its edge sensitivities have no meaning.
EDGE = 0.999
# Points of a frequency grid besides those at resonances.
GRID_POINTS = 160


class Band(NamedTuple):
    """The loop transfers of a set: labels of the N plants, frequencies (B,), rad/s, and responses, complex (N, B)."""

    labels: tuple[str, ...]
    frequency: FloatArray
    responses: ComplexArray


class LoopTransfers(NamedTuple):
    """Plant, controller, and the sensitivity at the plant's input of u = K y over frequency, complex (F, ...)."""

    P: ComplexArray
    K: ComplexArray
    S: ComplexArray


class LoopCurves(ABC):
    """The curves of a closed loop, shown broken at one torquer; with a `band` those of the whole set too.

    A subclass says what is disturbed, and over which frequencies.

    Parameters
    ----------
    job, settings
        The job of the loop, and the settings of the page.
    plant, controller
        Of the plant shown, u = K y.
    readings, torquers
        Their signals, one of which is the `channel` that is broken.

    Attributes
    ----------
    units
        Units of readings and torques, and of what else is shown.
    limits
        The job's limits, by the metrics that curves are drawn with, or None.
    frequency
        Frequencies of the Bode diagram (F,), rad/s, those of the band among them.
    all_stable
        Whether the loops of all plants of the set are stable.
    other_poles
        Closed-loop poles of the plants of the set, in s, of any shape; none without a band.
    moving
        Which torques have the factor of the root locus.
    reach
        How much of the s-plane the root locus shows, rad/s; None: as its poles ask for it.
    """

    units: Mapping[str, str]
    limits: Mapping[str, float | None]
    frequency: FloatArray
    all_stable: bool
    other_poles: ComplexArray
    reach: float | None = None
    band: Band | None = None

    def __init__(
        self,
        job: Job,
        settings: Settings,
        plant: System,
        controller: System,
        readings: Sequence[str],
        torquers: Sequence[str],
        channel: str,
    ) -> None:
        self.job, self.settings, self.axis = job, settings, settings.axis
        self.plant, self.controller = plant, controller
        self.readings, self.torquers, self.channel = list(readings), list(torquers), channel
        self.index = self.torquers.index(channel)
        self.moving = [True] * len(self.torquers)

    @cached_property
    def z_poles(self) -> ComplexArray:
        """Closed-loop poles of the plant shown, in z, (n,)."""
        return poles(self.plant.feedback(self.controller).A)

    @cached_property
    def poles(self) -> ComplexArray:
        """The same in s = ln(z)/T, rad/s."""
        return continuous_poles(self.z_poles, self.plant.dt)

    @property
    def stable(self) -> bool:
        """Whether the loop of the plant shown is."""
        return bool(spectral_abscissa(self.poles) < 0.0)

    @abstractmethod
    def step(self) -> TimeResponse:
        """Return the response to a torque step."""

    @abstractmethod
    def disturbance(self) -> TimeResponse:
        """Return the response to the job's manoeuvre, or to an impulse on the free platform."""

    @abstractmethod
    def disturbance_gain(self) -> FrequencyGain:
        """Return the gain from what disturbs the loop at the frequencies of the Bode diagram."""

    @abstractmethod
    def measured(self, bode: Bode) -> Measured:
        """Return margins, and the job's limits compared with what is measured."""

    def locus(self) -> RootLocus:
        """Return the root locus over a factor on the `moving` torques."""
        moving, K = np.array(self.moving)[:, None], self.controller

        def closed(factors: FloatArray) -> ComplexArray:
            f = np.where(moving, factors[:, None, None], 1.0)
            A = self.plant.feedback(K._replace(C=f * K.C, D=f * K.D)).A
            return np.asarray(np.linalg.eigvals(A), dtype=np.complex128)

        return traced_locus(_GAINS, closed, self.plant.dt, quick=True, reach=self.reach)

    @cached_property
    def own(self) -> LoopTransfers:
        """Responses of plant and controller of the loop shown at the frequencies of the Bode diagram."""
        P, K = (frequency_response(one, self.frequency, -3) for one in (self.plant, self.controller))
        return LoopTransfers(P, K, sensitivities_of_plants(P, K)[1])

    def drawing(self) -> Drawing:
        """Return the curves."""
        response = channel_response(self.own.S, self.index)
        locus, others = self.locus(), self.other_poles.ravel()
        return Drawing(
            settings=self.settings,
            bode=self._bode(response),
            closed=self._closed_loop(),
            locus=locus,
            poles=self.poles,
            other_poles=others[np.abs(others) < 4.0 * locus.view.reach],
            step=self.step(),
            Omega_time=self.disturbance(),
            Omega_gain=cache(self.disturbance_gain),
            limits=self.limits,
            stable=self.stable,
            all_stable=self.all_stable,
        )

    def _closed_loop(self) -> ClosedLoop:
        """Return the gains from noise and loads at the channel."""
        units, torque = [self.units[name] for name in self.readings], self.units[self.channel]
        rows = [k for k, unit in enumerate(units) if unit == units[0]]
        P, K, S = self.own
        with np.errstate(all="ignore"):
            KS = (S[:, [self.index]] @ K[..., rows])[:, 0]
            PS = (P[:, rows] @ S[..., [self.index]])[..., 0]
        return ClosedLoop(
            KS=np.asarray(np.linalg.norm(KS, axis=-1)),
            PS=np.asarray(np.linalg.norm(PS, axis=-1)),
            units=(_per(torque, units[0]), _per(units[0], torque)),
        )

    def _bode(self, response: ComplexArray) -> Bode:
        """Return the loop broken at the channel."""
        grid, phase = self.frequency, loop_phase(response)
        labels, w, band = self.band or ((self.settings.plant,), np.zeros(0), np.zeros((1, 0), dtype=np.complex128))
        at = np.searchsorted(grid, w)
        # The difference of phases is unwrapped: it turns slowly where the band's grid is too coarse for phases.
        with np.errstate(all="ignore"):
            ratio = band * np.conj(response[at])
        return Bode(
            channel=self.channel,
            frequency=grid,
            response=response,
            phase=phase,
            labels=labels,
            band_frequency=w,
            band=band,
            band_phase=np.asarray(phase[at] + np.degrees(np.unwrap(np.angle(ratio), axis=-1))),
            crossovers=gain_crossings(grid, response)[0],
            nyquist=math.pi / self.plant.dt,
        )

    def over_time(
        self, drive: SampledInput, signals: Sequence[str], shown: System, band: System | None, inputs: FloatArray
    ) -> TimeResponse:
        """Return the responses of closed loops to `inputs` (m, T); their outputs are the `signals`."""
        values = sampled_responses(shown, inputs, drive.every)[0]
        low = high = np.zeros((len(values), 0))
        if band is not None:
            every = sampled_responses(band, inputs, drive.every)
            low, high = np.minimum(every.min(axis=0), values), np.maximum(every.max(axis=0), values)
        colour = signal_series(self.job.platform)
        return TimeResponse(
            title=drive.title,
            t=drive.t,
            signals=tuple(signals),
            series=tuple(colour[name.removesuffix(COMMAND)] for name in signals),
            units=tuple(self.units[name] for name in signals),
            values=values,
            low=low,
            high=high,
            drive=drive.u[:: drive.every] / (float(np.abs(drive.u).max()) or 1.0),
            limit=drive.limit,
        )


def frequency_gain(
    title: str,
    unit: str,
    frequency: FloatArray,
    shown: ComplexArray,
    band: tuple[FloatArray, ComplexArray] | None,
    limit: float | None = None,
) -> FrequencyGain:
    """Return the gain of the plant shown, with responses (F, k), and its extremes over the set.

    The set has responses (N, B, k) at frequencies (B,).
    """
    w, responses = band or (np.zeros(0), np.zeros((1, 0, 1)))
    gains = np.linalg.norm(responses, axis=-1)
    return FrequencyGain(
        title=title,
        unit=unit,
        frequency=frequency,
        gain=np.asarray(np.linalg.norm(shown, axis=-1)),
        band_frequency=w,
        low=gains.min(axis=0),
        high=gains.max(axis=0),
        limit=limit,
    )


def _per(unit: str, other: str) -> str:
    above = f"({unit})" if "/" in unit else unit
    return f"{above}/({other})" if set(other) & set(" /") else f"{above}/{other}"


def channel_margins(bode: Bode, stable: bool) -> dict[str, Any]:
    """Return those of the `Margins` that a channel has by its loop transfer on a grid."""
    w, above = gain_crossings(bode.frequency, bode.response)
    factors = gain_factors(bode.frequency, bode.response)[1]
    # Phase that may be lost: how far above -180 degrees, taken upwards from there.
    lead = np.radians(above % 360.0)
    return {
        "gain_up": float(factors[factors > 1.0].min(initial=math.inf)) if stable else math.nan,
        "gain_down": float(factors[factors <= 1.0].max(initial=0.0)) if stable else math.nan,
        "phase": float(np.abs(above).min(initial=math.inf)) if stable else math.nan,
        "delay": float((lead / w).min(initial=math.inf)) if stable else math.nan,
        "crossover": float(w[-1]) if len(w) else None,
    }
