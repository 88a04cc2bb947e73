"""The controllers of settings: built from sliders at once, made by a method beforehand, or given in a file."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

from platform_ctrl.analysis.feedback import feedback_part
from platform_ctrl.analysis.interconnection import COMMAND
from platform_ctrl.analysis.system import System
from platform_ctrl.app.excitation import first_axis
from platform_ctrl.app.plants import JobPlants
from platform_ctrl.app.settings import Settings, stated_limits
from platform_ctrl.design.feedforward import rate_feedforward
from platform_ctrl.design.loop import Design
from platform_ctrl.design.loop_signals import Channels, loop_signals
from platform_ctrl.design.method import SectionedMethod
from platform_ctrl.design.methods import METHODS
from platform_ctrl.design.methods.platform_servo import PlatformServo
from platform_ctrl.errors import DesignError, PlatformCtrlError
from platform_ctrl.job.job import Job, LoopSpec
from platform_ctrl.job.methods import DesignSpec
from platform_ctrl.plant.source import read_json
from platform_ctrl.verification.controllers import read_controllers

# Options that act in gyroscopic pairs alone, beside those of the notch.
_OF_PAIRS = frozenset({"crossover_hz", "damping_hz", "damping2_hz", "lead_hz", "rolloff_hz"})
# The one that a classical design takes whatever its gyros: the default of the integral's corner is a share of it.
ALWAYS = "crossover_hz"
_PARTED = {name: option for method in METHODS.values() if method.instant for name, option in method.options.items()}


def part_of(option: str) -> str:
    """Return the optional part that an option of a classical or a PI loop belongs to, else an empty text."""
    known = _PARTED.get(option)
    return "" if known is None else known.part


def acts(option: str, channel: Channels) -> bool:
    """Return whether the controller of a classical loop with these gyros is made of an option."""
    if option.startswith("inertial_"):
        return channel.inertial > 0
    return len(channel.momenta) > 0 or not (option in _OF_PAIRS or part_of(option) == "notch")


def full_options(
    design: DesignSpec, given: Mapping[str, float], channel: Channels, nutation: float, period: float
) -> dict[str, float]:
    """Return all options of a classical or PI design, those of parts that it does not have as well."""
    method = METHODS[design.method]

    def complete(options: Mapping[str, float]) -> dict[str, float]:
        return method.defaults(replace(design, options=dict(options)), channel, nutation, period)

    if design.method == "pi":
        crossover = complete(given)["crossover_hz"]
        rest = {"double_integral_hz": 0.1 * crossover, "lag_hz": 0.1 * crossover, "lag_ratio": 3.0}
        rest |= {"notch_hz": min(3.0 * crossover, 0.35 / period), "notch_depth": 0.3, "notch_width": 0.3}
        return complete(rest | dict(given))
    own = {name: x for name, x in given.items() if name == ALWAYS or acts(name, channel)}
    rate_hz = 1.0 / period
    more = {"lag_hz": 0.1 * complete(own)["crossover_hz"], "lag_ratio": 3.0}
    if len(channel.momenta):
        more |= {"notch_hz": min(nutation / math.tau, 0.35 * rate_hz), "notch_depth": 0.7, "notch_width": 0.3}
    if len(channel.spins):
        spin = float(channel.spins.mean()) / math.tau
        more |= {"spin_notch_hz": min(spin, 0.4 * rate_hz), "spin_notch_depth": 0.1, "spin_notch_width": 0.1}
    return complete(more | own)


def direct_arrays(method: str, options: Mapping[str, float], channel: Channels, period: float) -> System:
    """Return the sampled controller of a classical or PI design of complete options, from readings to torques."""
    sectioned = METHODS[method]
    assert isinstance(sectioned, SectionedMethod)
    controller = channel.of_readings(sectioned.of_directions(dict(options), channel, period))
    if not all(bool((abs(item) < 1e300).all()) for item in controller[:4]):
        raise DesignError(f"{method}: the controller of these options is not finite; choose less extreme ones")
    return controller


class DesignOptions:
    """The options of a job's designs.

    Attributes
    ----------
    start
        The settings of the job file.
    """

    def __init__(self, plants: JobPlants) -> None:
        self.read, self._plants = plants.read, plants
        self.start = self._first()

    def offered(self, settings: Settings, spec: LoopSpec, design: DesignSpec) -> dict[str, float]:
        """Return the options that a design is made of, those of parts that are off as well."""
        options = settings.options[spec.name][design.name]
        if design.method != "classical":
            return dict(options)
        channel = self._plants.gyros(spec, design)
        return {name: x for name, x in options.items() if acts(name, channel)}

    def used(self, settings: Settings, spec: LoopSpec, design: DesignSpec) -> dict[str, float]:
        """Return the options that a design uses, without those of parts that are off."""
        offered = self.offered(settings, spec, design)
        if not (built_directly(design) and METHODS[design.method].parts):
            return offered
        channel, nutation = self._plants.gyros(spec, design), self._plants.nutation(spec, design)
        period = self.read.period_of(spec)
        parts = ("", *settings.parts_on(spec.name, design.name))
        given = {name: x for name, x in offered.items() if part_of(name) in parts}
        try:
            complete = METHODS[design.method].defaults(replace(design, options=given), channel, nutation, period)
        except DesignError as error:
            # It may be another loop than the one that is shown.
            raise DesignError(f"{spec.name}, {error}") from None
        return {name: x for name, x in complete.items() if design.method == "pi" or acts(name, channel)}

    def touched(self, settings: Settings, loop: str, design: str) -> bool:
        """Return whether a design's sliders or parts are not as the job has them."""
        start = self.start
        return dict(settings.options[loop][design]) != dict(start.options[loop][design]) or settings.parts_on(
            loop, design
        ) != start.parts_on(loop, design)

    def _first(self) -> Settings:
        options, optional, closed = {}, {}, {}
        for spec in self.read.loops:
            options[spec.name] = {one.name: self._options(spec, one) for one in spec.designs}
            parts = {one.name: {part_of(name) for name in one.options} for one in spec.designs}
            optional[spec.name] = {name: tuple(sorted(own - {""})) for name, own in parts.items()}
            there = [d.name for d in spec.designs if built_directly(d)]
            closed[spec.name] = spec.use if spec.use in there or not there else there[0]
        first = self.read.loops[0]
        return Settings(
            axis=self._plants.loading_axis(first, first_axis(self.read)),
            loop=first.name,
            design=closed[first.name],
            options=options,
            optional=optional,
            channel=self._plants.read.channels_of(first)[0],
            closed=closed,
            limits=stated_limits(self.read),
        )

    def _options(self, spec: LoopSpec, design: DesignSpec) -> dict[str, float]:
        """Return all options of a design, complete."""
        method, period = METHODS[design.method], self.read.period_of(spec)
        if isinstance(method, PlatformServo):
            return method.all_options(design, period)
        channel, nutation = self._plants.gyros(spec, design), self._plants.nutation(spec, design)
        if method.instant and method.parts:
            return full_options(design, design.options, channel, nutation, period)
        try:
            return method.defaults(design, channel, nutation, period)
        except PlatformCtrlError:
            # Their error is reported when they are designed.
            return dict(design.options)


def built_directly(design: DesignSpec) -> bool:
    """Return whether a design is built from its sliders at once."""
    return METHODS[design.method].instant


def existing_designs(path: Path, job: Job) -> list[Design]:
    """Return each entry of a file that fits the job's caging loops, without feedforward and commands."""
    out = []
    _, data = read_json(path, "a JSON file with controllers")
    for part in ("controllers", "alternatives"):
        read = read_controllers(path, job, part)
        entries: list[Any] = list(data.get(part, [])) if isinstance(data, dict) else []
        for K, entry in zip(read, entries, strict=True):
            loops = (one for one in job.loops if one.has_plants)
            spec = next(
                (one for one in loops if set(K.output_labels) == set(loop_names(job, one, one.closed)[1])), None
            )
            if spec is None:
                continue
            design = next((one for one in spec.designs if one.name == entry.get("design")), spec.closed)
            readings, torques = loop_names(job, spec, design)
            arrays = System.of(K, str(K.name))
            names = list(K.input_labels)
            if design.feedforward is not None and set(design.feedforward.sensors) <= set(names):
                fed = rate_feedforward(job, spec.read_by(design), design)
                n = len(arrays.A) - len(fed.path.A)
                arrays = arrays._replace(A=arrays.A[:n, :n], B=arrays.B[:n], C=arrays.C[:, :n])
                names = [name for name in names if name not in fed.sensors or name in readings]
            own = {name for name in names if name.removesuffix(COMMAND) not in readings or name in readings}
            if own != set(readings):
                continue
            at = [list(K.input_labels).index(name) for name in readings]
            of = [list(K.output_labels).index(name) for name in torques]
            ordered = feedback_part(arrays._replace(C=arrays.C[of], D=arrays.D[of]), at)
            options = entry.get("options")
            numbers = {
                str(name): float(x)
                for name, x in (options.items() if isinstance(options, dict) else ())
                if isinstance(x, int | float) and not isinstance(x, bool) and x > 0.0
            }
            name, method = str(entry.get("design") or "given"), str(entry.get("method"))
            given = ordered.to_control(readings, torques)
            out.append(Design(loop=spec.name, name=name, method=method, controller=given, options=numbers))
    return out


def loop_names(job: Job, spec: LoopSpec, design: DesignSpec) -> tuple[list[str], list[str]]:
    """Return the names of what a design of a loop reads and sets; a tracking loop sets commands of the loop inside."""
    if spec.around is not None:
        return list(job.readings_of(spec.read_by(design))), list(job.channels_of(spec))
    signals = loop_signals(job.platform, spec.read_by(design))
    return list(signals.readings), [one.name for one in signals.torquers]
