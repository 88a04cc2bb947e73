"""What is dragged in a plot, as changes of settings: a pole, the crossover, a slider of the Bode diagram."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from typing import Protocol

import numpy as np

from platform_ctrl.analysis.arrays import ComplexArray, StateArrays
from platform_ctrl.app.closed_loops import ClosedLoops
from platform_ctrl.app.dragging import (
    NO_LIMITS,
    DragResult,
    FreeParameters,
    Limits,
    dragged_crossover,
    dragged_pole,
    dragged_slider,
)
from platform_ctrl.app.pictures import Drawing, Picture
from platform_ctrl.app.reachable import reachable_crossovers, reachable_poles
from platform_ctrl.app.settings import Settings, Slider, with_options
from platform_ctrl.app.slider_effects import free_parameters, limits_of
from platform_ctrl.errors import ArgumentError, DesignError

# A dragged crossover stays inside the diagram by this factor.
_INSIDE = 1.1


class _Shown(Protocol):
    """What drags need of a backend."""

    _loops: ClosedLoops

    def sliders(self, settings: Settings) -> tuple[Slider, ...]: ...

    def moved(self, settings: Settings, slider: str, number: float) -> Settings: ...

    def picture(
        self,
        settings: Settings,
        on_drawn: Callable[[Drawing], None] | None = None,
        ghosts: Sequence[tuple[str, Settings]] = (),
    ) -> Picture: ...

    def _dragged(
        self,
        settings: Settings,
        solve: Callable[[FreeParameters, StateArrays, int, Limits], DragResult],
        distance: float | None,
        on_limited: Callable[[tuple[str, ...]], None] | None,
        origin: Settings,
    ) -> Settings: ...


class Drags:
    """The drags of a `Backend`."""

    def drag_pole(
        self: _Shown,
        settings: Settings,
        pole: complex,
        target: complex,
        *,
        free: bool = False,
        on_limited: Callable[[tuple[str, ...]], None] | None = None,
        origin: tuple[Settings, complex] | None = None,
    ) -> Settings:
        """Return the settings in which a closed-loop pole lies at `target`, rad/s, or as near as it may be brought.

        It moves along the limits that are met, and no slider moves much further than the pole does, unless it is
        `free`; limits that are missed already are ignored. `on_limited` is called with the names of what keeps it from
        going all the way. `origin` has the settings and the pole where the drag began; default: those given.
        """
        if not (np.isfinite(pole) and np.isfinite(target)):
            raise ArgumentError(f"pole: both places must be finite, rad/s, got {pole} and {target}")

        def solve(parameters: FreeParameters, plant: StateArrays, channel: int, limits: Limits) -> DragResult:
            return dragged_pole(parameters, plant, complex(pole), complex(target), limits)

        before, first = (settings, complex(pole)) if origin is None else origin
        distance = abs(target - first) / max(abs(first), abs(target), 1e-300)
        return self._dragged(settings, solve, None if free else distance, on_limited, before)

    def drag_crossover(
        self: _Shown,
        settings: Settings,
        frequency: float,
        *,
        free: bool = False,
        on_limited: Callable[[tuple[str, ...]], None] | None = None,
        origin: tuple[Settings, float] | None = None,
    ) -> Settings:
        """Return the settings in which the shown channel crosses over at `frequency`, rad/s, or as near as can be.

        The highest crossover is dragged; it stops at limits, and where sliders would move much further than it does,
        unless it is `free`. `origin` has the settings and the crossover where the drag began; default: those given.
        """
        if not np.isfinite(frequency):
            raise ArgumentError(f"frequency must be a finite number of rad/s, got {frequency}")
        bode = self.picture(settings.but(band=False, overlays=())).bode
        if not len(bode.crossovers):
            raise DesignError(f"{settings.channel}: the loop has no crossover to drag, its gain never passes 1")
        start = float(bode.crossovers[-1])
        # Left of the diagram it could not be taken hold of again.
        frequency = max(float(frequency), min(start, _INSIDE * float(bode.frequency[0])))

        def solve(parameters: FreeParameters, plant: StateArrays, channel: int, limits: Limits) -> DragResult:
            return dragged_crossover(parameters, plant, channel, start, frequency, limits)

        before, first = (settings, start) if origin is None else origin
        distance = abs(math.log(frequency / first))
        return self._dragged(settings, solve, None if free else distance, on_limited, before)

    def drag_slider(
        self: _Shown,
        settings: Settings,
        name: str,
        target: float,
        *,
        free: bool = False,
        on_limited: Callable[[tuple[str, ...]], None] | None = None,
    ) -> Settings:
        """Return the settings with a slider, a lead zero or a notch say, at `target`, or as near as the limits allow.

        The others follow as little as keeps the limits that are met, unless it is `free`.
        """
        goal = self.moved(settings, name, target).options[settings.loop][settings.design][name]

        def solve(parameters: FreeParameters, plant: StateArrays, channel: int, limits: Limits) -> DragResult:
            return dragged_slider(parameters, name, goal, limits)

        distance = abs(math.log(goal / settings.options[settings.loop][settings.design][name]))
        return self._dragged(settings, solve, None if free else distance, on_limited, settings)

    def reachable_poles(self: _Shown, settings: Settings, pole: complex) -> ComplexArray:
        """Return the corners of the region within which a pole may be dragged, rad/s: a linear estimate."""
        with np.errstate(all="ignore"):
            parameters, plant, _ = free_parameters(self._loops, settings, self.sliders(settings), settings)
            return reachable_poles(parameters, plant, pole, limits_of(self._loops, settings, parameters))

    def reachable_crossovers(self: _Shown, settings: Settings, crossover: float) -> tuple[float, float]:
        """Return the ends between which the crossover may be dragged, rad/s: a linear estimate."""
        with np.errstate(all="ignore"):
            parameters, plant, channel = free_parameters(self._loops, settings, self.sliders(settings), settings)
            limits = limits_of(self._loops, settings, parameters)
            return reachable_crossovers(parameters, plant, channel, crossover, limits)

    def _dragged(
        self: _Shown,
        settings: Settings,
        solve: Callable[[FreeParameters, StateArrays, int, Limits], DragResult],
        distance: float | None,
        on_limited: Callable[[tuple[str, ...]], None] | None,
        origin: Settings,
    ) -> Settings:
        """Return the settings after a drag over a relative `distance` from where it began; None: without limits."""
        with np.errstate(all="ignore"):
            parameters, plant, channel = free_parameters(self._loops, settings, self.sliders(settings), origin)
            if distance is not None:
                limits = limits_of(self._loops, settings, parameters)
                parameters = parameters.within(distance)
            else:
                limits = NO_LIMITS
            result = solve(parameters, plant, channel, limits)
        if result.limited_by and on_limited is not None:
            on_limited(result.limited_by)
        return with_options(settings, result.numbers)
