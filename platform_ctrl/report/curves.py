"""Curves of the pictures of a job's loops, computed once; nothing is drawn here."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping, Sequence
from typing import Any

import control
import numpy as np

from platform_ctrl.analysis.curves import Curve, Curves, Level, loop_phase, refined_loop
from platform_ctrl.analysis.feedback import channel_transfers, each_alone
from platform_ctrl.analysis.loop import Loop
from platform_ctrl.analysis.measuring import MetricRequest, Peak
from platform_ctrl.analysis.metrics import METRICS
from platform_ctrl.analysis.norms import gains
from platform_ctrl.analysis.plant_set import PlantSet
from platform_ctrl.analysis.poles import continuous_poles, following_grid
from platform_ctrl.analysis.singular_values import largest_singular_values
from platform_ctrl.analysis.system import ComplexArray
from platform_ctrl.analysis.transfers import ANGLE_PER_OMEGA, FOLLOWING, S_OUTPUT
from platform_ctrl.common.values import FloatArray, value
from platform_ctrl.design.loop import Design, LoopOutcome, closed_loop_poles, sampled_plant
from platform_ctrl.design.sections import gain
from platform_ctrl.job.job import LoopSpec
from platform_ctrl.job.quantities import HZ
from platform_ctrl.job.requirements import SCOPE_WORDS, of_readings

# Dashes of a limit by the plants that it is about, and what they are called.
_OF_SCOPE = {"": (1, "dashed"), "worst_case": (2, "dotted"), "faults": (3, "dash-dotted")}
# With more designs than this only the closed one shows all its singular values.
_ALL_LINES = 2
# A gain of this and less counts as zero.
_NOTHING = 1e-12
# Sensitivity plot, from left to right: the metric whose curve a panel shows, and its title.
SENSITIVITIES = {
    "sensitivity peak": "S: remaining share of a disturbance",
    "complementary sensitivity peak": "T: transmitted share",
    "disk margin": "(S − T)/2: 1/disk margin at its peak",
}
# Metrics whose curves the standard plots of a loop show.
_STANDARD = (*SENSITIVITIES, "Omega rejection", "torque rejection", "torque limit")
_FIRST = np.zeros(1, dtype=np.intp)


@value
class ShownDesign:
    """What is shown of one design with the loop's nominal plant."""

    design: Design
    # By the keys of METRICS: the gain over frequency whose peak each metric is (N,), and the metric itself
    gains: Mapping[str, FloatArray]
    peaks: Mapping[str, float]
    smallest_sensitivity: FloatArray  # (N,), Smallest singular value of S at the input
    loop_gains: FloatArray  # (m, N), Singular values of the loop transfer at the input
    channels: ComplexArray  # (m, N), Loop transfer of each torquer with all others closed, 1/S_ii − 1
    controller_gain: FloatArray  # (N,), Largest singular value of the controller
    angle_per_rate: FloatArray  # (3, N), Norm of all readings per rate about each root axis
    # Closed loop with the nominal plant, with uncertain parameters and Omega, and with a fault; s-plane, rad/s
    poles: ComplexArray
    varied_poles: ComplexArray
    fault_poles: ComplexArray
    label: str
    closed: bool  # Whether it closes the loop
    series: int  # Its colour and marker on the whole page
    solid: bool  # Whether it closes a loop of the page


@value
class ShownLoop:
    """What is shown of all designs of a loop, on one grid that includes the frequencies of their peaks."""

    spec: LoopSpec
    plants: PlantSet  # Those of the first design, the nominal one first
    frequency: FloatArray  # (N,), rad/s
    designs: tuple[ShownDesign, ...]  # In the job's order
    # The same disturbances without a controller: (3, N) and (N,)
    open_angle_per_rate: FloatArray
    open_angle_per_torque: FloatArray

    @property
    def closed(self) -> ShownDesign:
        """The design that closes the loop."""
        return next(one for one in self.designs if one.closed)


def palette_of(loops: Sequence[LoopOutcome]) -> dict[str, bool]:
    """Return the names of all designs, whose order is that of the colours, each with whether it closes a loop."""
    closed = {outcome.use for outcome in loops}
    return {design.name: design.name in closed for outcome in loops for design in outcome.designs}


def _peaks() -> dict[str, Peak]:
    """Return the metrics that are the peak of a gain over frequency, by their keys in `METRICS`."""
    measures = {kind: metric.measure for kind, metric in METRICS.items()}
    return {kind: one for kind, one in measures.items() if isinstance(one, Peak) and one.transfers}


def shown_loop(outcome: LoopOutcome, palette: Mapping[str, bool] | None = None) -> ShownLoop | None:
    """Return what is shown of all designs of `outcome`; None for a loop that is only checked in the coupled system.

    `palette` is that of all loops of the page; default: of this one.
    """
    found = [(one, one.plants) for one in outcome.designs if one.plants is not None and one.measures is not None]
    if not found:
        return None
    # A design may read what others do not, and have feedforward in its plants.
    own = next((plants for one, plants in found if one.name == outcome.use), found[0][1]).only([0])
    kinds = _kinds(own, outcome.spec)
    loops = [_loops(one, plants) for one, plants in found]
    for of in loops:
        for kind in kinds:
            _peaks()[kind].exact(of[_is_of_sight(kind)], MetricRequest(kind=kind), 0)
    at_peaks = np.concatenate([loop.peak_frequencies for of in loops for loop in of])
    poles = np.concatenate([np.linalg.eigvals(own.of_torques().A), *(loop.poles[0] for loop, _ in loops)])
    grid = _grid(own, poles)
    frequency = np.union1d(grid, at_peaks[(at_peaks > grid[0]) & (at_peaks < grid[-1])])
    silent = gain(np.zeros((len(own.torques), len(own.angles))))._replace(dt=own.period)
    palette = palette or palette_of([outcome])
    designs = []
    for (one, plants), of in zip(found, loops, strict=True):
        label = f"{one.name}, closed" if one.name == outcome.use and len(found) > 1 else one.name
        about = {"label": label, "closed": one.name == outcome.use, "solid": palette[one.name]}
        about["series"] = list(palette).index(one.name)
        designs.append(_shown_design(one, plants, of, kinds, frequency, about))
    return ShownLoop(
        spec=outcome.spec,
        plants=found[0][1],
        frequency=frequency,
        designs=tuple(designs),
        open_angle_per_rate=_per_rate(Loop(own.on(frequency), silent)),
        open_angle_per_torque=gains(own.of_torques(), frequency),
    )


def _loops(design: Design, plants: PlantSet) -> tuple[Loop, Loop]:
    """Return the loop of a design with the nominal plant, and the one whose line of sight is shown.

    The second has dry friction: it transmits motion of the platform that a balanced gimbal without friction would not.
    """
    K = plants.joined(design.controller)
    loop = Loop(plants.only([0]), K)
    assert design.measures is not None
    loop.poles = design.measures.poles[:1]
    rubs = bool(plants.sight) and "friction" in plants.groups
    return loop, Loop(plants.only([plants.groups.index("friction")]), K) if rubs else loop


def _kinds(plants: PlantSet, spec: LoopSpec) -> list[str]:
    """Return the metrics whose gains are shown: those of the standard plots, and those with a limit or a goal."""
    found = [kind for kind in _peaks() if kind in _STANDARD or limited({**spec.soft, **spec.limits}, kind, spec)]
    if np.isinf(plants.torque_limit).all():  # torquers without a limit have no share of it
        found = [kind for kind in found if not all(part.of_limit for part in _peaks()[kind].transfers)]
    return [kind for kind in found if plants.sight or not _is_of_sight(kind)]


def _is_of_sight(kind: str) -> bool:
    """Return whether a metric is the peak of a gain to the line of sight."""
    return any(part.target == "sight" for part in _peaks()[kind].transfers)


def _grid(plants: PlantSet, poles: ComplexArray) -> FloatArray:
    nyquist = np.pi / plants.period
    low = max(min(2e-3 * plants.nutation, 0.05 * nyquist), 1e-4 * nyquist)
    return following_grid(continuous_poles(poles, plants.period), low, 0.999 * nyquist)


def _per_rate(loop: Loop) -> FloatArray:
    """Return the norm of all readings per rate about each root axis, (3, N)."""
    return np.asarray(np.linalg.norm(loop.responses(ANGLE_PER_OMEGA, _FIRST)[0][0], axis=-2).T)


def _shown_design(
    design: Design,
    plants: PlantSet,
    loops: tuple[Loop, Loop],
    kinds: Sequence[str],
    frequency: FloatArray,
    about: Mapping[str, Any],
) -> ShownDesign:
    own, _ = on_grid = [Loop(one.plants.on(frequency), plants.joined(design.controller)) for one in loops]
    S = own.S_input[0]
    with np.errstate(all="ignore"):
        # L = S⁻¹ − I: never the product of two integrators' infinities.
        L = np.asarray(np.linalg.inv(S) - np.eye(S.shape[-1]), dtype=np.complex128)
    assert design.measures is not None
    poles = continuous_poles(design.measures.poles, plants.period)
    faults = plants.of(("faults",))
    return ShownDesign(
        design=design,
        gains={kind: _gain(on_grid[_is_of_sight(kind)], _peaks()[kind]) for kind in kinds},
        peaks={kind: _peaks()[kind].exact(loops[_is_of_sight(kind)], MetricRequest(kind=kind), 0) for kind in kinds},
        smallest_sensitivity=_singular_values(S)[:, -1],
        loop_gains=_singular_values(L).T,
        channels=each_alone(S),
        controller_gain=largest_singular_values(own.K),
        angle_per_rate=_per_rate(own),
        poles=poles[0],
        varied_poles=poles[1:][~faults[1:]].ravel(),
        fault_poles=poles[faults].ravel(),
        **about,
    )


def _gain(loop: Loop, peak: Peak) -> FloatArray:
    """Return the gain whose peak a metric is, of the first plant on its set's grid, (N,)."""
    parts = [one[0] for part in peak.transfers for one in loop.responses(part, _FIRST)]
    return np.asarray(np.max([largest_singular_values(one) for one in parts], axis=0))


def _singular_values(responses: ComplexArray) -> FloatArray:
    """Return the singular values of square responses (N, m, m), (N, m); NaN where a response is not finite."""
    out = np.full(responses.shape[:2], np.nan)
    finite = np.all(np.isfinite(responses), axis=(1, 2))
    out[finite] = np.linalg.svd(responses[finite], compute_uv=False)
    return out


def broken_loops(design: Design, k: int) -> tuple[FloatArray, ComplexArray]:
    """Return frequencies (N,), rad/s, and the loop at every torquer with all others closed, (m, N), with plant `k`."""
    assert design.plants is not None
    plants, K = design.plants.only([k]), design.own_controller
    # L at one torquer has the poles of the loop that is open there alone.
    open_there = [
        control.ss(K.A, K.B, keep[:, None] * K.C, keep[:, None] * K.D, K.dt) for keep in 1.0 - np.eye(K.noutputs)
    ]
    poles = np.concatenate([closed_loop_poles(plants, one)[0] for one in (K, *open_there)])
    P = sampled_plant(plants)
    return refined_loop(_grid(plants, poles), lambda w: channel_transfers(P, K, w))


def same_curve(kind: str, spec: LoopSpec) -> list[str]:
    """Return the metrics that are read off the curve of the metric `kind`: their limits belong beside it.

    Without a filter of the commands their errors are S.
    """
    metrics = _peaks()
    if kind not in metrics:
        return [kind]
    shown = set(metrics[kind].transfers)
    if S_OUTPUT in shown and not any(design.command for design in spec.designs):
        shown.add(FOLLOWING)
    return [name for name, peak in metrics.items() if set(peak.transfers) <= shown]


def limited(limits: Mapping[str, float], kind: str, spec: LoopSpec) -> list[str]:
    """Return the metrics on the curve of `kind` that have a limit (or a goal) for the nominal plant."""
    return [name for name in same_curve(kind, spec) if METRICS[name].key in limits]


def levels(spec: LoopSpec, kind: str, *, scale: float = 1.0, from_hz: float = 0.0) -> tuple[Level, ...]:
    """Return limits and goals of the metrics on the curve of `kind` as levels of a gain.

    `scale` is the SI unit in units of the panel; `from_hz` is where a level begins that holds from a frequency on.
    """
    out = []
    for limits, hard in ((spec.limits, True), (spec.soft, False)):
        for metric in (METRICS[name] for name in limited(limits, kind, spec)):
            limit = scale * metric.in_SI(limits[metric.key])
            inverse = isinstance(metric.measure, Peak) and metric.measure.reciprocal
            y = 1.0 / limit if inverse else limit
            if metric.band:
                text = f"{limits[metric.key]:g} dB" if metric.decibels else f"{limit:g}"
                start = max(from_hz, limits.get(metric.lowest_key, 0.0))
                end = limits.get(metric.frequency_key, np.inf)
                out.append(Level(y=y, text=text, hard=hard, start=start, end=end))
            else:
                out.append(Level(y=y, text=f"1/{limit:g}" if inverse else f"{limit:g}", hard=hard))
    return tuple(out)


def damping_rays(limits: Mapping[str, float]) -> list[tuple[float, int, str]]:
    """Return the limits on damping: ratio, dashes of its ray in the s-plane, and in words its dashes and plants."""
    metric, rays = METRICS["damping"], []
    for scope in metric.scopes:
        ratio = limits.get(f"{metric.key}_{scope}" if scope else metric.key)
        if ratio is not None:
            dashes, words = _OF_SCOPE[scope]
            rays.append((ratio, dashes, f"{words}, {ratio:g}{SCOPE_WORDS[scope] or ' for the nominal plant'}"))
    return rays


def _of_designs(loop: ShownLoop, values: Sequence[FloatArray], thin: bool = False) -> tuple[Curve, ...]:
    """Return a curve of each design; thin ones beside it of those that show all."""
    return tuple(
        Curve(
            x=loop.frequency * HZ,
            y=y,
            name="" if thin else one.label,
            series=one.series,
            dashes=0 if one.solid else 1 + one.series % 5,
            form="thin" if thin else "strong" if one.closed else "line",
        )
        for one, y in zip(loop.designs, values, strict=True)
        if not thin or one.closed or len(loop.designs) <= _ALL_LINES
    )


def _compared(
    loop: ShownLoop, opened: FloatArray, closed: Sequence[FloatArray], title: str, bounds: tuple[Level, ...]
) -> Curves:
    """Return a gain of each design beside the one without a controller."""
    top = 10.0 * max(float(np.nanmax(one)) for one in closed)
    grey = Curve(x=loop.frequency * HZ, y=opened, name="open loop", series=None)
    curves = (grey, *_of_designs(loop, closed))
    return Curves(curves=curves, title=title, low=1e-5 * top, high=top, levels=bounds)


def sensitivity(loop: ShownLoop) -> list[list[Curves]]:
    """Singular values of S, T and (S − T)/2 over frequency, with the limits on bandwidth, peaks and disk margin."""
    spec, key = loop.spec, METRICS["bandwidth"].key
    first, *others = (
        Curves(
            curves=_of_designs(loop, [one.gains[kind] for one in loop.designs]),
            title=title,
            low=1e-3,
            high=1e2,
            levels=levels(spec, kind),
        )
        for kind, title in SENSITIVITIES.items()
    )
    thin = _of_designs(loop, [one.smallest_sensitivity for one in loop.designs], thin=True)
    at = {one.series: one.design.measures.bandwidth * HZ for one in loop.designs if one.design.measures is not None}
    marks = (Curve(x=np.array([f]), y=np.sqrt([0.5]), series=k, form="mark") for k, f in at.items() if np.isfinite(f))
    first = dataclasses.replace(
        first,
        curves=(*first.curves, *thin, *marks),
        quantity="singular values, 1",
        references={float(np.sqrt(0.5)): "1/√2"},
        required=spec.limits.get(key),
        wished=spec.soft.get(key),
    )
    return [[first, *others]]


def loop_transfer(loop: ShownLoop) -> list[list[Curves]]:
    """Singular values of the loop transfer and of the controller, and the Bode plot of each channel."""
    designs, spec, torques = loop.designs, loop.spec, loop.plants.torques
    shown: dict[str, Any] = {"low": 1e-3, "high": 1e4, "references": {1.0: ""}}
    sizes = list(_of_designs(loop, [one.loop_gains[0] for one in designs]))
    for k in range(1, len(torques)):
        sizes += _of_designs(loop, [one.loop_gains[k] for one in designs], thin=True)
    above = [Curves(curves=tuple(sizes), title="loop transfer", quantity="singular values, 1", **shown)]
    below = [
        Curves(
            curves=_of_designs(loop, [one.controller_gain for one in designs]),
            title="controller, largest gain",
            quantity=of_readings(METRICS["controller gain"].unit, spec.kind),
            levels=levels(spec, "controller gain", from_hz=loop.plants.nutation / 10.0 * HZ),
        )
    ]
    for k, name in enumerate(torques):
        size = _of_designs(loop, [np.abs(one.channels[k]) for one in designs])
        phase = _of_designs(loop, [loop_phase(one.channels[k]) for one in designs])
        words = ("", "") if k else ("gain, 1", "phase, degrees")
        above.append(Curves(curves=size, title=f"{name}, others closed", quantity=words[0], **shown))
        below.append(Curves(curves=phase, quantity=words[1], kind="phase"))
    return [above, below]


def disturbance(loop: ShownLoop) -> list[list[Curves]]:
    """Gains from platform rate and torque disturbance to what the loop reads, and from the rate to the torque."""
    spec, designs = loop.spec, loop.designs
    what, unit = ("rates", "mrad/s") if spec.kind == "rate" else ("angles", "mrad")
    disturbed, per = ("command", "mrad/s") if spec.kind == "tracking" else ("torque", "mN m")
    panels = []
    for a, opened in enumerate(loop.open_angle_per_rate):
        if np.nanmax(opened, initial=0.0) > _NOTHING:
            closed = [1e3 * one.angle_per_rate[a] for one in designs]
            bounds = levels(spec, "Omega rejection", scale=1e3)
            panels.append(_compared(loop, 1e3 * opened, closed, f"rate Omega{a + 1} → {what}", bounds))
    panels = [dataclasses.replace(one, quantity="" if k else f"{unit} per rad/s") for k, one in enumerate(panels)]
    closed = [one.gains["torque rejection"] for one in designs]
    bounds = levels(spec, "torque rejection")
    torque = _compared(loop, loop.open_angle_per_torque, closed, f"{disturbed} disturbance → {what}", bounds)
    panels.append(dataclasses.replace(torque, quantity=f"{unit} per {per}"))
    shares = [one.gains["torque limit"] for one in designs if "torque limit" in one.gains]
    if any(np.any(one > 0.0) for one in shares):  # not a number without a limit
        panels.append(
            Curves(
                curves=_of_designs(loop, shares),
                title="full Omega → torque",
                quantity="torque over its limit, 1",
                low=1e-3,
                high=1e2,
                levels=levels(spec, "torque limit"),
                references={1.0: ""},
            )
        )
    return [panels]


def further_gains(loop: ShownLoop) -> list[str]:
    """Return the metrics with a limit or a goal that are the peak of a gain that no standard plot shows."""
    shown = {name for kind in _STANDARD for name in same_curve(kind, loop.spec)}
    return [kind for kind in loop.closed.gains if kind not in shown]


def further(loop: ShownLoop, kinds: Sequence[str]) -> list[list[Curves]]:
    """Gain over frequency of each of the metrics `kinds`, with its limit and goal."""
    panels = []
    for kind in kinds:
        metric = METRICS[kind]
        # Zero gains are drawn below everything else.
        values = [np.maximum(one.gains[kind] / metric.scale, _NOTHING) for one in loop.designs]
        words = of_readings(metric.name, loop.spec.kind), of_readings(metric.unit, loop.spec.kind) or "1"
        if kind == "attenuation":
            words = "line of sight per base motion, with dry friction", "rate per rate, 1"
        curves, bounds = _of_designs(loop, values), levels(loop.spec, kind, scale=1.0 / metric.scale)
        panels.append(Curves(curves=curves, title=words[0], quantity=words[1], levels=bounds))
    return [panels]
