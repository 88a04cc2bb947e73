"""The options of all designs of a job: as they start, which of them count now, and which have been moved."""

from __future__ import annotations

import numpy as np

from platform_ctrl.design.classical import starting_values
from platform_ctrl.design.stabilisation import platform_servo
from platform_ctrl.designer.controllers import (
    acting_options,
    acts,
    default_numbers,
    full_options,
    parts_given,
    parts_used,
)
from platform_ctrl.designer.job_plants import JobPlants
from platform_ctrl.designer.knobs import lowest_rate
from platform_ctrl.designer.values import Settings
from platform_ctrl.errors import DesignError, PlatformCtrlError
from platform_ctrl.job import DesignSpec, LoopSpec
from platform_ctrl.linearisation import linearise


class DesignOptions:
    """The options of a job's designs.

    Parameters
    ----------
    plants
        Of the job.

    Attributes
    ----------
    start
        The settings of the job as it stands.
    """

    def __init__(self, plants: JobPlants) -> None:
        self.read, self._plants = plants.read, plants
        self.start = self._first()

    def offered(self, settings: Settings, spec: LoopSpec, design: DesignSpec) -> dict[str, float]:
        """Return the options that a design is made of as the loop is now, those of parts that are off as well."""
        options = settings.options[spec.name][design.name]
        if design.method != "classical":
            return dict(options)
        return acting_options(
            options,
            self._plants.gyros(settings, spec),
            lambda: self._plants.nutation(settings, spec),
            1.0 / settings.rate_hz,
        )

    def slowest(self, settings: Settings) -> float:
        """Return the sample rate, Hz, from which on all loops can be built with their options as they are."""
        found = 0.0
        for spec in self.read.loops:
            for design in spec.designs:
                if live(design) or (spec.name, design.name) == (settings.loop, settings.design):
                    options = self.offered(settings, spec, design)
                    used = parts_used(options, settings.parts_on(spec.name, design.name))
                    found = max(found, lowest_rate(design.method, used))
        return found

    def used(self, settings: Settings, spec: LoopSpec, design: DesignSpec) -> dict[str, float]:
        """Return the options that a design uses, without those of parts that are off.

        Raises
        ------
        DesignError
            An option makes no sense.
        """
        offered = self.offered(settings, spec, design)
        if design.method != "classical":
            return offered
        channel, period = self._plants.gyros(settings, spec), 1.0 / settings.rate_hz
        given = parts_used(offered, settings.parts_on(spec.name, design.name))
        try:
            complete = starting_values(given, channel, self._plants.nutation(settings, spec), period)
        except DesignError as error:
            # It may be another loop than the one that is worked on.
            raise DesignError(f"{spec.name}, {error}") from None
        return {name: x for name, x in complete.items() if acts(name, channel)}

    def touched(self, settings: Settings, loop: str, design: str) -> bool:
        """Return whether a design's knobs or parts are not as the job has them, or what its defaults rest on."""
        start = self.start
        return (
            dict(settings.options[loop][design]) != dict(start.options[loop][design])
            or settings.parts_on(loop, design) != start.parts_on(loop, design)
            or settings.rate_hz != start.rate_hz
            or dict(settings.spins) != dict(start.spins)
        )

    def _first(self) -> Settings:
        options: dict[str, dict[str, dict[str, float]]] = {}
        optional: dict[str, dict[str, tuple[str, ...]]] = {}
        closed: dict[str, str] = {}
        spins = {r.name: float(r.spin) for r in self.read.platform.rotors}
        sampling = self.read.sampling
        for spec in self.read.loops:
            options[spec.name], optional[spec.name] = {}, {}
            for design in spec.designs:
                options[spec.name][design.name] = self._options(spec, design, spins)
                optional[spec.name][design.name] = parts_given(design.options)
            there = [d.name for d in spec.designs if live(d)]
            closed[spec.name] = spec.use if spec.use in there or not there else there[0]
        first = self.read.loops[0]
        return Settings(
            axis=self._plants.loading_axis(first, 1),
            mode="caged" if first.kind == "caging" else "stabilised",
            loop=first.name,
            design=closed[first.name],
            options=options,
            optional=optional,
            rate_hz=1.0 / sampling.period,
            delay=sampling.delay,
            spins=spins,
            Omega=(0.0, 0.0, 0.0),
            channel=self._plants.channels_of(first)[0],
            closed=closed,
        )

    def _options(self, spec: LoopSpec, design: DesignSpec, spins: dict[str, float]) -> dict[str, float]:
        """Return all options of a design, complete, so that they stay while the plant is moved."""
        period = self.read.sampling.period
        if spec.kind != "caging":
            return dict(platform_servo(self.read, linearise(self.read.platform), spec, design).options)
        quick = self._plants.quick(spec)
        channel = quick.channels(spins)
        nutation = quick.nutation(spins, self.read.sampling, np.asarray(self.read.Omega))
        if design.method == "classical":
            return full_options(design.options, channel, nutation, period)
        try:
            return default_numbers(design, channel, nutation, period)
        except PlatformCtrlError:
            # What is wrong with them is told when they are to be designed.
            return dict(design.options)


def live(design: DesignSpec) -> bool:
    """Return whether a design is built from its knobs at once."""
    return design.method in ("classical", "platform-servo")
