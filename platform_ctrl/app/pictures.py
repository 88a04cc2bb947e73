"""What the designer's page draws for its settings, as frozen values. Nothing here draws."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from platform_ctrl.analysis.arrays import ComplexArray
from platform_ctrl.app.settings import Settings
from platform_ctrl.common.values import FloatArray, value
from platform_ctrl.job.judging import CheckResult

BoolArray = NDArray[np.bool_]


@value
class TimeResponse:
    """Signals over time, of the plant shown, with the band of all others.

    Attributes
    ----------
    title
        What acts: for example ``"1 mN m step at Q9"``.
    t : (T,)
        s.
    signals, units
        Names and units of the k signals.
    series
        Which colour of the palette each has, from 0 on: by its name, as `report.quantities.signal_series` says.
    values : (k, T)
        Of the plant shown.
    low, high : (k, T)
        Least and largest over the plants of the set; shape (k, 0) without a band.
    drive : (T,)
        What acts, over its largest value: dimensionless.
    limit
        What the job allows in the first unit, or None.
    """

    title: str
    t: FloatArray
    signals: tuple[str, ...]
    units: tuple[str, ...]
    series: tuple[int, ...]
    values: FloatArray
    low: FloatArray
    high: FloatArray
    drive: FloatArray
    limit: float | None = None


@value
class Overlay:
    """The loop of another design.

    Attributes
    ----------
    design, method
        Its name, and the method that made it.
    response : complex (F,)
        Its loop transfer at the frequencies of the bode diagram, dimensionless.
    magnitude, phase : (F,)
        The same as gain (dimensionless) and unwrapped phase, degrees.
    poles : complex (n,)
        Of its closed loop, s-plane equivalents, rad/s.
    step, Omega_step
        Its responses, as `Picture.step` and `Picture.Omega_time`: same signals and units, a step over times of its own.
    Omega_gain : (F,)
        Its response at the frequencies of `Picture.Omega_frequency`, rad/(rad/s).
    requirements
        Its limits, measured; empty in a picture, which only draws the loop.
    """

    design: str
    method: str
    response: ComplexArray
    magnitude: FloatArray
    phase: FloatArray
    poles: ComplexArray
    step: TimeResponse
    Omega_step: TimeResponse
    Omega_gain: FloatArray
    requirements: tuple[CheckResult, ...] = ()


@value
class Bode:
    """The loop broken at one torquer, all others closed: L = 1/S - 1 there, u = K y without hidden sign.

    Attributes
    ----------
    channel
        The torquer.
    frequency : (F,)
        rad/s, denser at resonances.
    response : complex (F,)
        Of the plant shown, dimensionless.
    magnitude, phase : (F,)
        The same as gain (dimensionless) and unwrapped phase, degrees; at crossover it lies between -360 and 0.
    band_frequency : (B,)
        rad/s; empty without a band, as all below.
    magnitude_low, magnitude_high, phase_low, phase_high : (B,)
        Least and largest gain (dimensionless) and phase (degrees) over the plants of the set.
    crossovers : (k,)
        Frequencies at which the gain passes 1, rad/s, rising.
    nyquist
        Nyquist frequency, rad/s.
    overlays
        Other designs over it.
    """

    channel: str
    frequency: FloatArray
    response: ComplexArray
    magnitude: FloatArray
    phase: FloatArray
    band_frequency: FloatArray
    magnitude_low: FloatArray
    magnitude_high: FloatArray
    phase_low: FloatArray
    phase_high: FloatArray
    crossovers: FloatArray
    nyquist: float
    overlays: tuple[Overlay, ...] = ()


@value
class Nichols:
    """Gain over phase of the same loop, of all plants of the set.

    Attributes
    ----------
    labels
        Of the plants, the plant shown first; without a band it alone.
    phase, magnitude : (N, B)
        Unwrapped phase, degrees, and gain, dimensionless, at the frequencies of the band; without a band (1, F) at
        those of the curve.
    frequency : (B,)
        rad/s.
    disk_margin
        What the job asks for, dimensionless, or None: its region is to be kept free.
    """

    labels: tuple[str, ...]
    phase: FloatArray
    magnitude: FloatArray
    frequency: FloatArray
    disk_margin: float | None


@value
class Locus:
    """Closed-loop poles while all of the controller is multiplied by one factor; s-plane equivalents ln(z)/T, rad/s.

    Attributes
    ----------
    gains : (G,)
        The factors, from 0 on, rising; 1 is among them.
    branches : complex (G, n)
        Each column one continuous branch.
    present : complex (n,)
        At the factor 1.
    draggable : (n,)
        Which of `present` may be dragged: those of the upper half plane that sliders move.
    others : complex (k,)
        Closed-loop poles of the other plants of the band.
    reach
        How far a view of the plane has to go, rad/s, to show what matters.
    damping
        Smallest damping ratio that the job asks for, or None.
    """

    gains: FloatArray
    branches: ComplexArray
    present: ComplexArray
    draggable: BoolArray
    others: ComplexArray
    reach: float
    damping: float | None


@value
class FrequencyGain:
    """Gain from the platform's rate (or a torque on the platform) to the angles over frequency.

    Attributes
    ----------
    title, unit
        What it shows.
    frequency : (F,)
        rad/s.
    gain : (F,)
        Norm over all angles, of the plant shown.
    band_frequency, low, high : (B,)
        rad/s; least and largest gain over the plants of the set; empty without a band.
    limit
        What the job allows, in `unit`, or None.
    """

    title: str
    unit: str
    frequency: FloatArray
    gain: FloatArray
    band_frequency: FloatArray
    low: FloatArray
    high: FloatArray
    limit: float | None = None


@value
class Margins:
    """How far the loop is from instability.

    Attributes
    ----------
    disk
        Disk margin of the plant shown, dimensionless; 0 where it is unstable. Of a caging loop all channels at once, of
        the stabilised platform at the torquer that is shown broken.
    worst_disk, worst_plant
        The least of the set, and the label of the plant that has it; of the plant shown without a band.
    worst_sampled
        Whether that is the least at the frequencies of a grid: between them it may be smaller.
    gain_up, gain_down
        Factors by which the shown channel's gain may rise and fall; inf and 0 where there is no bound.
    phase
        Degrees that the shown channel may lose, least over all crossovers; inf without a crossover.
    delay
        Time that the shown channel may be later, s; inf without a crossover.
    crossover
        Highest frequency at which the shown channel's gain passes 1, rad/s; None without one.
    bandwidth
        Of the plant shown, rad/s: the largest singular value of S reaches 1/sqrt(2). Of a caging loop all channels, of
        the stabilised platform those of the platform's axes.
    damping
        Smallest damping ratio of its closed-loop poles above a tenth of the nutation frequency, or of the crossover of
        the stabilised platform.

    References
    ----------
    P. Seiler, A. Packard, P. Gahinet, IEEE Control Systems Magazine 40(5), 2020.
    """

    disk: float
    worst_disk: float
    worst_plant: str
    worst_sampled: bool
    gain_up: float
    gain_down: float
    phase: float
    delay: float
    crossover: float | None
    bandwidth: float
    damping: float


@value
class Drawn:
    """The curves of some settings.

    Attributes
    ----------
    bode, nichols, locus
        Of the loop at the settings' channel.
    step
        Caged: a torque step at the channel's torquer; stabilised: a torque step on the platform about the axis.
    Omega_time
        Caged: the job's manoeuvre about the axis, linear model; stabilised: the attitude after a rate step of the
        platform.
    Omega_frequency
        The same over frequency.
    bandwidth
        That is asked of the loop, Hz, or None.
    stable
        Whether the closed loop of the plant shown is.
    all_stable
        Whether all plants of the set are.
    """

    bode: Bode
    nichols: Nichols
    locus: Locus
    step: TimeResponse
    Omega_time: TimeResponse
    Omega_frequency: FrequencyGain
    bandwidth: float | None
    stable: bool
    all_stable: bool

    @property
    def crossover(self) -> float | None:
        """Highest frequency at which the loop's gain is 1, rad/s, or None."""
        found = self.bode.crossovers
        return float(found[-1]) if len(found) else None


@value
class Drawing(Drawn):
    """What the plots of a page draw.

    Attributes
    ----------
    settings
        What it was made for.
    plants
        Labels of all plants that may be shown.
    """

    settings: Settings
    plants: tuple[str, ...]


@value
class Picture(Drawing):
    """A drawing with what was measured.

    Attributes
    ----------
    margins
        Of the loop at the settings' channel, of the plant shown and of the set.
    requirements, goals
        The job's limits, and its goals, held against the set as `check` would.
    elapsed
        What the picture took, s.
    notes
        Lines to be told beside it: what is not shown, and why.
    """

    margins: Margins
    requirements: tuple[CheckResult, ...]
    goals: tuple[CheckResult, ...]
    elapsed: float
    notes: tuple[str, ...] = ()


@value
class Influence:
    """What each slider does to each requirement: change of its ratio for a slider that is 5 % larger.

    Attributes
    ----------
    sliders
        Names.
    requirements
        Names, in the order of `Picture.requirements`.
    ratios : (R,)
        As they are: at most 1 where met.
    change : (R, K)
        Of the ratio, dimensionless: negative is better; inf where the loop becomes unstable, nan where it is already.
    """

    sliders: tuple[str, ...]
    requirements: tuple[str, ...]
    ratios: FloatArray
    change: FloatArray
