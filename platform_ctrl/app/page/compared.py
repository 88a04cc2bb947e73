"""What a page compares its settings with: snapshots A, B, C, and the next step while it is previewed."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from platform_ctrl.app.page.messages import next_data, pinned_data
from platform_ctrl.common.values import value
from platform_ctrl.errors import InputError

if TYPE_CHECKING:
    from platform_ctrl.app.page.messages import Request
    from platform_ctrl.app.page.session import Session
    from platform_ctrl.app.pictures import NextStep
    from platform_ctrl.app.settings import Settings
    from platform_ctrl.job.judging import CheckResult

NAMES = ("A", "B", "C")
PREVIEW = "next step"


@value
class Snapshot:
    """Settings that are kept under a name, with their results; `drawn` says whether the plots show their curves."""

    name: str
    settings: Settings
    results: tuple[CheckResult, ...]
    drawn: bool


class Compared:
    """The snapshots and the next step of a session; it runs on the server's loop."""

    def __init__(self, page: Session) -> None:
        self._page = page
        self._snapshots: dict[str, Snapshot] = {}
        self._step: NextStep | None = None
        self._previewed = False

    def ghosts(self, loop: str) -> tuple[tuple[str, Settings], ...]:
        """Return the names and settings of what is drawn over the plots of a loop."""
        shown = [(one.name, one.settings) for one in self._snapshots.values() if one.drawn]
        if self._previewed and self._step is not None:
            shown.append((PREVIEW, self._step.settings))
        return tuple(one for one in shown if one[1].loop == loop)

    def data(self, loop: str) -> dict[str, Any]:
        """Return the snapshots of a loop, and the step, as the page shows them."""
        mine = [one for one in self._snapshots.values() if one.settings.loop == loop]
        return {
            "pinned": [pinned_data(one.name, one.settings.design, one.drawn, one.results) for one in mine],
            "free": next((name for name in NAMES if name not in self._snapshots), ""),
            "previewed": self._previewed,
        }

    def forget_step(self) -> None:
        """Drop the step: the settings change."""
        self._step, self._previewed = None, False

    def found(self, step: NextStep | None) -> None:
        """Take the next step of the settings that are shown, and show it; a preview of the same step stays."""
        before, self._step = self._step, step
        same = step is not None and before is not None and step.settings.data() == before.settings.data()
        self._previewed = self._previewed and same
        picture = self._page.picture
        if picture is not None:
            self._page.connection.answer(next=next_data(step, picture))

    def on_preview(self, request: Request) -> None:
        """Draw the curves of the next step over the plots, or no longer."""
        self._previewed = bool(request.more["on"]) and self._step is not None
        self._page.redraw(request.count)

    def on_apply(self, request: Request) -> None:
        """Take the next step."""
        step = self._step
        if step is None:
            self._page.connection.say("The next step is being computed again.", count=request.count)
            return
        slider, after, moved = step.slider.name, step.after, self._page.backend.moved
        self._page.change("next", lambda settings: moved(settings, slider, after), count=request.count)

    def on_pin(self, request: Request) -> None:
        """Keep the settings that are shown under the next free name."""
        picture, name = self._page.picture, next((one for one in NAMES if one not in self._snapshots), None)
        if picture is None or name is None:
            raise InputError(f"snapshot: {', '.join(NAMES)} are all in use; remove one first")
        self._snapshots[name] = Snapshot(
            name=name, settings=picture.settings, results=(*picture.requirements, *picture.goals), drawn=False
        )
        self._snapshots = dict(sorted(self._snapshots.items()))
        self._page.redraw(request.count)

    def on_snapshot(self, request: Request) -> None:
        """Draw a snapshot's curves or not, return to it, or remove it."""
        name, act = request.more["name"], request.more["act"]
        one = self._snapshots.get(name)
        if one is None:
            raise InputError(f"snapshot: there is none called {name}; there are {', '.join(self._snapshots) or 'none'}")
        if act == "restore":
            there = one.settings
            self._page.change("snapshot", lambda settings: there, count=request.count)
            return
        if act == "remove":
            del self._snapshots[name]
        elif act in ("draw", "hide"):
            self._snapshots[name] = Snapshot(name=name, settings=one.settings, results=one.results, drawn=act == "draw")
        else:
            raise InputError("snapshot: act must be draw, hide, restore or remove")
        self._page.redraw(request.count)
