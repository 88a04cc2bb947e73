"""What is dragged on a page: each drag is one step of undo, and the region that it may reach is shaded."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, TypeVar

from platform_ctrl.app.plots.data import HZ

if TYPE_CHECKING:
    from platform_ctrl.app.page.session import Session
    from platform_ctrl.app.page.tasks import PageTasks
    from platform_ctrl.app.settings import Settings

Place = TypeVar("Place", complex, float)


class PageDrags:
    """The drags of a session."""

    def __init__(self, page: Session, tasks: PageTasks) -> None:
        self._page, self._tasks, self._backend, self._plots = page, tasks, page.backend, page.plots
        # The drag that goes on, with the settings and the place that it began with.
        self._origin: tuple[object, Settings, Any] | None = None
        page.plots.on_pole_dragged(self._pole_dragged)
        page.plots.on_crossover_dragged(self._crossover_dragged)
        page.plots.on_slider_dragged(self._slider_dragged)

    def _pole_dragged(self, pole: complex, target: complex) -> None:
        dragged, free, gesture = self._backend.drag_pole, self._page.free, ("pole", self._plots.drags)

        def change(settings: Settings) -> Settings:
            if not free and self._begins(gesture):
                self._tasks.shade(lambda: self._backend.reachable_poles(settings, pole), self._plots.shade_poles)
            origin = self._drag_origin(gesture, settings, pole)
            return dragged(settings, pole, target, free=free, on_limited=self._page.limited, origin=origin)

        self._page.change("drag", change, gesture=gesture)

    def _crossover_dragged(self, frequency: float) -> None:
        dragged, free, gesture = (
            self._backend.drag_crossover,
            self._page.free,
            ("crossover", self._plots.drags),
        )
        now = None if self._page.picture is None else self._page.picture.crossover

        def change(settings: Settings) -> Settings:
            if now is None:
                return dragged(settings, frequency, free=free, on_limited=self._page.limited)
            if not free and self._begins(gesture):
                self._tasks.shade(
                    lambda: self._backend.reachable_crossovers(settings, now), self._plots.shade_crossovers
                )
            origin = self._drag_origin(gesture, settings, now)
            return dragged(settings, frequency, free=free, on_limited=self._page.limited, origin=origin)

        self._page.change("drag", change, gesture=gesture)

    def _slider_dragged(self, slider: str, frequency: float) -> None:
        dragged, free, hertz = self._backend.drag_slider, self._page.free, frequency * HZ

        def change(settings: Settings) -> Settings:
            return dragged(settings, slider, hertz, free=free, on_limited=self._page.limited)

        self._page.change("drag", change, gesture=(slider, self._plots.drags))

    def _begins(self, gesture: object) -> bool:
        return self._origin is None or self._origin[0] != gesture

    def _drag_origin(self, gesture: object, settings: Settings, place: Place) -> tuple[Settings, Place]:
        """Return the settings and the place with which a drag began; only `_work` uses it."""
        if self._origin is None or self._begins(gesture):
            self._origin = gesture, settings, place
        return self._origin[1], self._origin[2]
