"""What has to be designed and checked: the job file as values. SI units; Hz only where a name says so."""

from __future__ import annotations

from typing import Literal

from platform_ctrl.description import Platform
from platform_ctrl.frozen import FloatArray, value

Method = Literal["classical", "hinf", "platform-servo"]
LoopKind = Literal["caging", "stabilisation"]
Mode = Literal["caged", "stabilised"]


@value
class Spread:
    """Relative half-widths of the parameters: J about every gimbal axis, L of every rotor."""

    inertia: float = 0.0
    spin: float = 0.0


@value
class Sampling:
    """Sample period and the delay from sample to torque, both in s."""

    period: float
    delay: float


@value
class DesignSpec:
    """One way to design a loop.

    Attributes
    ----------
    name
        What the design is called in tables and plots.
    method
        Which method makes it.
    options
        The method's own numbers, by the names of the job file.
    tune
        Whether the method may move the options to meet the loop's limits.
    """

    name: str
    method: Method
    options: dict[str, float]
    tune: bool = False


@value
class LoopLimits:
    """What a loop has to reach; None where nothing is asked.

    Attributes
    ----------
    bandwidth_hz
        Lowest frequency where the largest singular value of S reaches 1/sqrt(2), at least.
    disk_margin, disk_margin_spread
        1/‖(S − T)/2‖ at least, nominal and over the parameter spread.
    damping, damping_spread
        Damping ratio of every closed-loop pole above a tenth of the nutation frequency, at least.
    torque_noise
        Rms torque from pick-off noise, N m, per torquer, at most.
    """

    bandwidth_hz: float | None = None
    disk_margin: float | None = None
    damping: float | None = None
    torque_noise: float | None = None
    disk_margin_spread: float | None = None
    damping_spread: float | None = None


@value
class LoopSpec:
    """A loop to be designed: which gimbals, by which methods, which of the designs is closed, its limits."""

    name: str
    kind: LoopKind
    gimbals: tuple[str, ...]
    designs: tuple[DesignSpec, ...]
    use: str
    limits: LoopLimits


@value
class CoupledLimits:
    """What the coupled system has to reach; None where nothing is asked.

    Attributes
    ----------
    disk_margin
        Simultaneous disk margin in all channels, at least.
    coupling_cost
        Largest relative loss of a loop-by-loop disk margin against the decoupled design.
    """

    disk_margin: float | None = None
    coupling_cost: float | None = None


@value
class Manoeuvre:
    """A run of the non-linear plant.

    Attributes
    ----------
    name, mode
        ``"caged"``: Omega is prescribed; ``"stabilised"``: the platform is free and a torque acts on it.
    axis
        Root axis, 1 to 3.
    rate, rise, hold
        Caged: half-cosine rise to `rate` rad/s in `rise` s, held for `hold` s, and back in `rise` s.
    torque
        Stabilised: step of the torque on the platform at t = 0, N m.
    duration
        Length of the run, s.
    limits
        ``angle``: largest gimbal angle, rad; ``attitude``: largest platform angle, rad; ``torque_share``: largest
        share of a torquer's limit (1: at the limit).
    """

    name: str
    mode: Mode
    axis: int
    duration: float
    rate: float = 0.0
    rise: float = 0.0
    hold: float = 0.0
    torque: float = 0.0
    limits: dict[str, float]


@value
class Job:
    """A job file: the plant, what it has to stand, the loops and the checks."""

    name: str
    plant: str
    platform: Platform
    Omega: FloatArray
    spread: Spread
    sampling: Sampling
    loops: tuple[LoopSpec, ...]
    coupled: CoupledLimits
    manoeuvres: tuple[Manoeuvre, ...]
    seed: int = 0
