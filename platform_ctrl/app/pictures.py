"""The curves of the page for its settings as frozen values, and the gimbal tree. Nothing is drawn here."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

import numpy as np

from platform_ctrl.analysis.curves import RootLocus
from platform_ctrl.analysis.system import ComplexArray
from platform_ctrl.app.settings import Settings
from platform_ctrl.common.text import greek
from platform_ctrl.common.values import FloatArray, value
from platform_ctrl.job.judging import CheckResult
from platform_ctrl.mechanics.kinematics import topology
from platform_ctrl.plant.drawing import Outline, bodies, camera, disc_axis
from platform_ctrl.plant.platform import Platform
from platform_ctrl.simulation.closed_loop import Trajectory


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
class Bode:
    """The loop broken at the torquer `channel`, all others closed: L = 1/S - 1 there, for positive feedback u = +K y.

    `response` (F,) of the plant shown, and its unwrapped `phase`, degrees, in the turn in which it comes closest to the
    critical point. All frequencies are in rad/s, rising. `band` (N, B) are the responses of the plants `labels` of the
    set at `band_frequency` (B,), which is empty without a band, and `band_phase` (N, B) their phases. `crossovers` are
    the frequencies at which the gain passes 1.
    """

    channel: str
    frequency: FloatArray
    response: ComplexArray
    phase: FloatArray
    labels: tuple[str, ...]
    band_frequency: FloatArray
    band: ComplexArray
    band_phase: FloatArray
    crossovers: FloatArray
    nyquist: float


@value
class ClosedLoop:
    """Gains from noise and loads in the closed loop at the torquer of the Bode diagram, at its frequencies (F,).

    `KS` is the gain from noise of the readings to its torque, `PS` from a torque beside it to the readings: norms over
    all readings in the unit of the first. `units` are those of both.
    """

    KS: FloatArray
    PS: FloatArray
    units: tuple[str, str]


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
    """The data of the plots of a page for `settings`.

    `step` is the response to a torque step: caged at the channel's torquer, stabilised on the platform about the axis.
    `Omega_time` is caged the job's manoeuvre about the axis, linear model; stabilised the attitude after a rate step of
    the platform; `Omega_gain` computes the same over frequency, which most pages never show. `poles` (n,) are those of
    the closed loop in s, rad/s, `other_poles` those of the other plants of the band that the locus may show. `limits`
    are the job's, by the metrics that curves are drawn with, or None.
    """

    settings: Settings
    bode: Bode
    closed: ClosedLoop
    locus: RootLocus
    poles: ComplexArray
    other_poles: ComplexArray
    step: TimeResponse
    Omega_time: TimeResponse
    Omega_gain: Callable[[], FrequencyGain]
    limits: Mapping[str, float | None]
    stable: bool
    all_stable: bool
    # Other designs of the loop, without bands.
    overlays: tuple[Drawing, ...] = ()

    @property
    def Omega_frequency(self) -> FrequencyGain:
        """The gain from what disturbs the loop."""
        with np.errstate(all="ignore"):
            return self.Omega_gain()

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
    """A drawing with what is `measured`; `elapsed` is the time that both took, s."""

    measured: Measured
    elapsed: float

    @property
    def requirements(self) -> tuple[CheckResult, ...]:
        """The job's limits as `check` judges them."""
        return self.measured.requirements


# Kinds of shapes, from behind to the front; arrows of turns and signs at joints are left out.
_KINDS = ("mount", "bar", "plate", "shaft", "pin", "disc", "bearing", "axis", "spin")
# Points of a disc's rim, distance between bodies of the root in radii of a disc, samples of a run.
_RIM, _CLEAR, _SAMPLES = 36, 0.6, 400


def tree_data(platform: Platform) -> dict[str, Any]:
    """Return the drawing of a platform as JSON values; lengths are in radii of a rotor's disc.

    `bodies` are the gimbals, then the rotors: each turns about its `axis` through its `pivot`, and with its `parent`,
    -1 for the root. `shapes` are lines, or a dot, and turn with a body; `series` is the number of a gimbal's colour.
    `rows` (2, 3) are the directions to the right and up; all vectors are in root axes at zero angles.
    """
    rows = camera(platform)
    shapes = _side_by_side(bodies(platform, rows[2]), rows[0])
    tree = topology(platform)
    names = [*(g.name for g in platform.gimbals), *(r.name for r in platform.rotors)]
    parents = [*map(int, tree.parents), *(int(k) - 1 for k in tree.carriers)]
    axes = [*(g.axis for g in platform.gimbals), *(r.axis for r in platform.rotors)]
    count = len(platform.gimbals)
    texts = [
        *(greek(g.angle) if g.angle.endswith(g.name) else f"{g.name} {greek(g.angle)}" for g in platform.gimbals),
        *(r.name for r in platform.rotors),
    ]
    tips = {one.body: one.points[-1] for one in shapes if one.kind in ("axis", "spin")}
    place = {name: k for k, name in enumerate(names)}
    drawn = []
    holder = -1
    for one in shapes:
        k = place.get(one.body, -1)
        if one.kind in ("pin", "shaft"):
            holder = parents[k]
        if one.kind in _KINDS:
            # A bearing belongs to the body that holds it.
            k = holder if one.kind == "bearing" else k
            series = 1 + k % 8 if one.kind == "axis" and 0 <= k < count else 0
            drawn.append({"kind": one.kind, "body": k, "series": series, "points": _plain(_line(one))})
    drawn.sort(key=lambda one: _KINDS.index(str(one["kind"])))
    return {
        "rows": _plain(rows[:2]),
        "bodies": [
            {"parent": parent, "axis": _plain(axis), "pivot": _plain(_pivot(shapes, name))}
            for name, parent, axis in zip(names, parents, axes, strict=True)
        ],
        "shapes": drawn,
        "labels": [
            {"body": k, "text": text, "at": _plain(tips[name])}
            for k, (name, text) in enumerate(zip(names, texts, strict=True))
        ],
    }


def run_data(trajectory: Trajectory) -> dict[str, Any]:
    """Return how a run turns the gimbals, `angles` (T, n), rad, and the platform: `turns` (T, 3), rotation vectors."""
    from scipy.spatial.transform import Rotation

    rows = slice(None, None, max(1, -(-len(trajectory.t) // _SAMPLES)))
    attitudes = Rotation.from_quat(np.roll(trajectory.attitude[rows], -1, axis=1))
    turns = (attitudes[0].inv() * attitudes).as_rotvec()
    named = {"t": trajectory.t[rows], "angles": trajectory.q[rows], "turns": turns}
    return {name: np.round(array, 9).tolist() for name, array in named.items()}


def _side_by_side(groups: list[list[Outline]], right: FloatArray) -> list[Outline]:
    """Return the bodies that the root carries in a row, about the origin."""
    k = int(np.argmax(np.abs(right)))
    along = np.sign(right[k]) * np.eye(3)[k]
    out, end = [], 0.0
    for group in groups:
        rims = [(one.points @ along, float(one.kind == "disc")) for one in group]
        low, high = min(float(x.min()) - r for x, r in rims), max(float(x.max()) + r for x, r in rims)
        out += [one.moved((end - low) * along) for one in group]
        end += high - low + _CLEAR
    return [one.moved(-0.5 * (end - _CLEAR) * along) for one in out]


def _line(one: Outline) -> FloatArray:
    """Return the points of a shape: of a disc those of its rim."""
    if one.kind != "disc":
        return np.vstack([one.points, one.points[:1]]) if one.kind == "plate" else one.points
    axis = disc_axis(one)
    side = np.cross(axis, np.eye(3)[int(np.argmin(np.abs(axis)))])
    side /= np.linalg.norm(side)
    turn = np.linspace(0.0, 2.0 * np.pi, _RIM + 1)[:, None]
    return np.asarray(one.points.mean(axis=0) + np.cos(turn) * side + np.sin(turn) * np.cross(axis, side))


def _pivot(shapes: list[Outline], name: str) -> FloatArray:
    """Return the point that a body turns about: midway between its pins, or the middle of its disc."""
    pins = [one.points for one in shapes if one.body == name and one.kind in ("pin", "disc")]
    return np.asarray(np.concatenate(pins).mean(axis=0))


def _plain(array: FloatArray) -> Any:
    return (np.round(array, 4) + 0.0).tolist()
