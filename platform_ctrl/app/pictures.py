"""What the page draws for its settings, as frozen values. Nothing here draws."""

from __future__ import annotations

from platform_ctrl.analysis.curves import RootLocus
from platform_ctrl.analysis.system import ComplexArray
from platform_ctrl.app.settings import Settings
from platform_ctrl.common.values import FloatArray, value
from platform_ctrl.job.judging import CheckResult


@value
class TimeResponse:
    """Signals over time, of the plant shown, with the band of all others.

    `title` names the input: ``"1 mN m step at Q9"``. `values` (k, T) are those of the plant shown, `low` and `high` the
    extremes over the set, (k, 0) without a band; `t` in s. `series` is the index of each signal's colour,
    from 0 (`plant.drawing.signal_series`), `drive` (T,) the input over its largest value, and `limit` the job's
    limit in the first unit, or None.
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

    `response` (F,) is its loop transfer at the frequencies of the Bode diagram, dimensionless, `phase` its unwrapped
    phase in degrees, `poles` (n,) the s-plane equivalents of its closed loop's poles, rad/s. `step`, `Omega_step` and
    `Omega_gain` (F,) are as in `Picture`; a step has its own times.
    """

    design: str
    response: ComplexArray
    phase: FloatArray
    poles: ComplexArray
    step: TimeResponse
    Omega_step: TimeResponse
    Omega_gain: FloatArray


@value
class Bode:
    """The loop broken at the torquer `channel`, all others closed: L = 1/S - 1 there, for positive feedback u = +K y.

    `response` (F,) of the plant shown, its gain `magnitude` and its unwrapped `phase` in degrees, from -360 to 0 at the
    crossover. All frequencies are in rad/s, rising. The band has the extremes over the set at `band_frequency` (B,),
    which is empty without a band. `crossovers` are the frequencies at which the gain passes 1.
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
class ClosedLoop:
    """What noise and loads come to in the closed loop at the torquer of the Bode diagram, at its frequencies (F,).

    `KS` is the gain from noise of the readings to its torque, `PS` from a torque beside it to the readings: norms over
    all readings in the unit of the first. `units` are those of both.
    """

    KS: FloatArray
    PS: FloatArray
    units: tuple[str, str]


@value
class Nichols:
    """The Nichols plot of the same loop for all plants of the set, the plant shown first.

    `phase` (N, B), unwrapped, degrees, and `magnitude` (N, B) at `frequency` (B,), rad/s; without a band (1, F) of the
    plant shown. `disk_margin` is the job's limit, or None.
    """

    labels: tuple[str, ...]
    phase: FloatArray
    magnitude: FloatArray
    frequency: FloatArray
    disk_margin: float | None


@value
class FrequencyGain:
    """Gain over frequency, rad/s, from the platform's rate (or a torque on the platform) to the angles.

    `gain` (F,) is the norm over all angles, of the plant shown; `low` and `high` (B,) are the extremes over the set,
    empty without a band; `limit` the job's limit in `unit`, or None.
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
    """Stability margins and related numbers of the loop.

    Attributes
    ----------
    disk
        Disk margin of the plant shown, dimensionless; 0 if it is unstable. Of a caging loop all channels at once, of
        the stabilised platform at the torquer at which the loop is shown broken.
    worst_disk, worst_plant
        The least of the set and the label of its plant; of the plant shown without a band.
    worst_sampled
        Whether that is the least at the frequencies of a grid: between them it may be smaller.
    gain_up, gain_down
        Factors by which the shown channel's gain may rise and fall; inf and 0 without a bound.
    phase, delay
        Phase, degrees, and delay, s, that the shown channel may lose, least over all crossovers; inf without one.
    crossover
        Highest frequency at which the shown channel's gain passes 1, rad/s, or None.
    bandwidth
        Of the plant shown, rad/s: the largest singular value of S reaches 1/sqrt(2). Of a caging loop all channels, of
        the stabilised platform those of the platform's axes.
    damping
        Smallest damping ratio of the closed-loop poles.

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
class Drawing:
    """What the plots of a page draw for `settings`; `plants` are the labels of all plants that may be shown.

    `step` is the response to a torque step: caged at the channel's torquer, stabilised on the platform about the axis.
    `Omega_time` is caged the job's manoeuvre about the axis, linear model; stabilised the attitude after a rate step of
    the platform; `Omega_frequency` the same over frequency. `poles` (n,) are those of the closed loop in s, rad/s,
    `other_poles` those of the other plants of the band that the locus may show. `bandwidth`, Hz, and `damping` are
    limits, or None.
    """

    settings: Settings
    plants: tuple[str, ...]
    bode: Bode
    closed: ClosedLoop
    nichols: Nichols
    locus: RootLocus
    poles: ComplexArray
    other_poles: ComplexArray
    damping: float | None
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
class Measured:
    """Margins, the job's limits and goals as `check` judges them over the set, and lines about what is not shown."""

    margins: Margins
    requirements: tuple[CheckResult, ...]
    goals: tuple[CheckResult, ...] = ()
    notes: tuple[str, ...] = ()


@value
class Picture(Drawing):
    """A drawing with the results of `Measured`; `elapsed` is the time that it took, s."""

    margins: Margins
    requirements: tuple[CheckResult, ...]
    goals: tuple[CheckResult, ...]
    elapsed: float
    notes: tuple[str, ...] = ()
