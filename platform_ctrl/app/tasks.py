"""Messages of a page, its state as text in its address, and its tasks that take longer than a picture."""

from __future__ import annotations

import base64
import json
import logging
import os
import re
import shlex
import threading
import zlib
from collections.abc import Callable, Mapping
from contextlib import suppress
from functools import partial
from inspect import signature
from pathlib import Path
from typing import TYPE_CHECKING, Any

from bokeh.core.properties import Any as AnyProperty
from bokeh.core.properties import Instance, Int, List, Nullable, String
from bokeh.model import DataModel
from bokeh.models import ColumnDataSource

from platform_ctrl.app.background import Requests, TaskCancelled
from platform_ctrl.app.fragments import fragment
from platform_ctrl.app.loops import LATER
from platform_ctrl.app.pictures import run_data
from platform_ctrl.app.plots.views import put
from platform_ctrl.app.saving import controllers_beside, difference, merged
from platform_ctrl.app.settings import Settings
from platform_ctrl.common.arguments import known_name, known_names, short
from platform_ctrl.design.methods import METHODS
from platform_ctrl.errors import InputError, PlatformCtrlError

if TYPE_CHECKING:
    from bokeh.document import Document

    from platform_ctrl.app.backend import Backend
    from platform_ctrl.design.tuning import OptionEffects


def parse_request(message: Any, acts: Mapping[str, Callable[..., Any]]) -> tuple[int, str, dict[str, Any]]:
    """Return a message of a page: its count, which the response names, its kind, and its content.

    The content fits what is done at a message of this kind, behind a first argument; its values are checked there.
    """
    try:
        more = dict(message)
        count, what = int(more.pop("n")), more.pop("what")
        signature(acts[what]).bind(None, **more)
        return count, what, more
    except (TypeError, ValueError, KeyError):
        raise InputError(
            f"a message must be one of the requests {', '.join(acts)}, the page sent {short(message)}"
        ) from None


class PageState(DataModel):
    """What a page shows besides its plots, and its last request: properties that Bokeh keeps equal at both ends."""

    # Of any type: `parse_request` refuses what is not a request.
    request = AnyProperty()
    # HTML of elements by their ids, columns of one row: Bokeh sends those that have changed.
    parts = Instance(ColumnDataSource)
    # The last line and its kind; what is going on, or an empty text; the rest as their requests name it.
    line = List(String, default=["", "quiet"])
    busy = String()
    view = String()
    spoken = String()
    link = Nullable(String)
    run = AnyProperty()
    # Number of the last request that is done, and how often the state has changed: set behind all else.
    answered = List(Int, default=[0, 0])


class Connection:
    """The server's end of the connection to a page; all but `later` runs on the server's loop."""

    def __init__(self, document: Document) -> None:
        self.document: Document | None = document
        self.model = PageState(name="state", parts=ColumnDataSource())

    def later(self, act: Callable[[], None]) -> None:
        """Call `act` on the server's loop; from any thread."""
        document = self.document
        if document is not None:
            # Bokeh takes a document apart before it says that its page is gone.
            with suppress(AttributeError):
                document.add_next_tick_callback(lambda: None if self.document is None else act())

    def say(self, text: str, kind: str = "quiet", count: int | None = None) -> None:
        """Write the page's line: ``"quiet"``, ``"good"`` or ``"error"``."""
        self.answer(count, line=[text, kind])

    def answer(self, count: int | None = None, html: Mapping[str, str] | None = None, **changes: Any) -> None:
        """Change what the page shows, `html` by the ids of elements; all its requests up to `count` are done."""
        model: Any = self.model
        put(model.parts, {key: [text] for key, text in (html or {}).items()})
        done, times = model.answered
        model.update(**changes, answered=[max(done, count or 0), times + 1])


# A plain file name.
_NAME = re.compile(r"[\w ,()+=@-][\w .,()+=@-]{0,79}(?<![ .])")


def target(folder: Path, name: str) -> Path:
    """Return the path of the job file that a page wants to save."""
    stem = name.strip().removesuffix(".toml")
    if _NAME.fullmatch(stem) is None:
        raise InputError(
            "name: only letters, digits, blanks, . , ( ) + = @ - and _ are allowed, 80 at most and no dot at the "
            f"beginning, got {short(name)}"
        )
    return folder / f"{stem}.toml"


_log = logging.getLogger(__name__)


def error_text(error: Exception) -> str:
    """Return the line that a page shows for an error; an unexpected one is logged as well."""
    if isinstance(error, PlatformCtrlError):
        return str(error)
    _log.error("the page: %s", " ".join(f"{type(error).__name__}: {error}".split()))
    return f"This could not be computed ({type(error).__name__}); the terminal says more."


# Texts of the page's line while a task runs, and after it was cancelled.
_RUNNING = {"tune": "Tuning is going on", "simulate": "A manoeuvre is being simulated"}
_CANCELLED = {"tune": "Tuning was cancelled; nothing was changed.", "simulate": "The simulation was cancelled."}


class LongTasks:
    """Tasks of a `page`, a `Session`, that take longer than a picture."""

    def __init__(self, page: Any, backend: Backend, connection: Connection) -> None:
        self.page, self.backend, self.connection = page, backend, connection
        self.measuring = Requests("page task")
        # Which task the page can cancel, and the event that says so: one at a time.
        self._running: tuple[str, threading.Event] | None = None

    def close(self) -> None:
        """Cancel everything without a word."""
        self.measuring.end()
        self.backend.requests.cancel(id(self))

    def measure(self, settings: Settings) -> None:
        """Compute what each slider does to each requirement of these settings, then the other parts of the job."""
        self.measuring.add("measure", partial(self._measured, settings))

    def _measured(self, settings: Settings, over: threading.Event) -> None:
        def go_on() -> None:
            if over.is_set():
                raise TaskCancelled("superseded")

        def effects() -> OptionEffects:
            influence = self.backend.influence(settings, go_on)
            budget = self.backend.sight.quick_results(settings)
            self.connection.later(lambda: self.page.show_effects(settings, influence, budget))
            return influence

        parts = self.backend.job_parts
        try:
            influence = effects()
            for one in parts.open(parts.parts(settings)):
                go_on()
                parts.measure(one)
                self.connection.later(self.page.parts_measured)
            # The first budget takes long: what sliders do to it is known now.
            known = {one.name for one in self.backend.sight.quick_results(settings) if one.valid}
            if not known <= set(influence.requirements):
                effects()
            shown = self.page.picture
            if shown is not None and LATER in [one.reason for one in shown.requirements]:
                self.page.again()
            self.page.pages.prepare()
        except Exception as error:
            error_text(error)

    def tune(self, count: int) -> None:
        """Tune the sliders that are not fixed."""
        settings = self.page.settings

        def tuned(over: threading.Event) -> Callable[[], None]:
            def progress(line: str) -> None:
                self.connection.later(partial(self._show_busy, over, f"Tuning the rest: {line}"))

            new = self.backend.tune(settings, progress, over.is_set)
            if new.options == settings.options:
                return lambda: self.connection.say("Tuning found no better values; nothing was changed.")
            return lambda: self.page.change("tune", lambda _: new)

        self._begin("tune", "Tuning the rest", count, tuned)

    def save(self, count: int, name: str, overwrite: bool) -> None:
        """Save the settings as a job file in the folder of the job."""
        try:
            path = target(self.backend.folder.resolve(), name)
        except PlatformCtrlError as error:
            self._saved(str(error), count)
            return
        settings = self.page.settings
        existing = [one.name for one in (path, controllers_beside(path)) if os.path.lexists(one)]
        if existing and not overwrite:
            self._saved(f"{existing[0]} exists already: overwrite it?", count, exists=True)
            return
        self.connection.say("", count=count)

        def saving(over: threading.Event) -> None:
            try:
                written = self.backend.save(settings, path, overwrite=overwrite)
            except Exception as error:
                self.connection.later(partial(self._saved, error_text(error)))
                return
            text = ". ".join((f"Saved: {path}", *written.notes))
            command = f"platform-ctrl check {shlex.quote(str(path))}"
            self.connection.later(lambda: self._saved(text, kind="good", command=command))
            self.connection.later(lambda: self.connection.say(text, "good"))

        self.page.requests.add("save", saving)

    def _saved(self, words: str, count: int | None = None, kind: str = "error", **more: Any) -> None:
        """Show in the dialog what came of saving."""
        html = fragment("saved", words=words, kind=kind, **more)
        self.connection.answer(count, html={"save-result": html})

    def simulate(self, count: int, manoeuvre: str) -> None:
        """Simulate a manoeuvre, or all of them."""
        settings = self.page.settings
        every = tuple(one.name for one in self.backend.read.manoeuvres)
        if manoeuvre:
            known_name("manoeuvre", manoeuvre, every)
        names = (manoeuvre,) if manoeuvre else every
        words = f"Simulating {names[0] if len(names) == 1 else f'{len(names)} runs'}"
        if not self.backend.has_simulated:
            words += ": the first run loads its equations, or compiles them once on this machine"

        def simulated(over: threading.Event) -> Callable[[], None]:
            for k, name in enumerate(names):
                if k:
                    line = f"Simulating {k + 1} of {len(names)}: {name}"
                    self.connection.later(partial(self._show_busy, over, line))
                trajectory = self.backend.simulate(settings, name, over.is_set)
                self.connection.later(self.page.parts_measured)
            return lambda: self.connection.answer(run=run_data(trajectory))

        self._begin("simulate", words, count, simulated)

    def _begin(self, name: str, words: str, count: int, work: Callable[[threading.Event], Callable[[], None]]) -> None:
        """Have `work` done and show what it returns unless it was cancelled, or another task is running."""
        if self._running is not None:
            self.connection.say(f"{_RUNNING[self._running[0]]}; Esc ends that.", count=count)
            return

        def done(over: threading.Event) -> None:
            try:
                show = work(over)
            except Exception as error:
                show = partial(self.connection.say, error_text(error), "error")
            self.connection.later(lambda: self._ended(over, show))

        over = self.backend.requests.add(id(self), done, urgent=True)
        self._running = name, over
        self.connection.answer(count, line=["", "quiet"], busy=words)

    def _show_busy(self, over: threading.Event, words: str) -> None:
        if self._running is not None and self._running[1] is over:
            self.connection.answer(busy=words)

    def _ended(self, over: threading.Event, show: Callable[[], None]) -> None:
        if self._running is not None and self._running[1] is over:
            self._running = None
            self.connection.answer(busy="")
            show()

    def cancel(self, count: int | None = None, *, name: str = "") -> None:
        """Cancel the task that is running, if it has this name or none is given."""
        if self._running is not None and name in ("", self._running[0]):
            self.backend.requests.cancel(id(self))
            self._ended(self._running[1], partial(self.connection.say, _CANCELLED[self._running[0]]))
        if count is not None:
            self.connection.answer(count)


def encode_state(backend: Backend, settings: Settings) -> str:
    """Return settings as a short text of letters, digits, - and _ alone."""
    changed = difference(backend.start().data(), settings.data())
    if not changed:
        return ""
    packed = zlib.compress(json.dumps(changed, separators=(",", ":"), sort_keys=True).encode(), 9)
    return base64.urlsafe_b64encode(packed).decode().rstrip("=")


def decode_state(backend: Backend, text: str) -> Settings:
    """Return the settings of a text from `encode_state`, checked against the job."""
    if not text:
        return backend.start()
    try:
        changed = json.loads(zlib.decompress(base64.urlsafe_b64decode(text + "=" * (-len(text) % 4))))
    except (ValueError, zlib.error, RecursionError):
        raise InputError("link: it is damaged; copy it again from the page") from None
    return checked_settings(backend, changed)


def checked_settings(backend: Backend, changed: object) -> Settings:
    """Return the job's settings with changes from outside, as plain data, checked against the job."""
    try:
        given = merged("it", backend.start().data(), changed)
        for loop in backend.read.loops:
            known_name(f"closed {loop.name}", given["closed"][loop.name], [one.name for one in loop.designs])
            for design in loop.designs:
                known_names("parts", given["optional"][loop.name][design.name], tuple(METHODS[design.method].parts))
        known_name("loop", given["loop"], [one.name for one in backend.read.loops])
        designs = [one.name for one in backend.read.loop(given["loop"]).designs]
        known_names("overlays", given["overlays"], designs)
        # Sliders of other loops and of parts that are off stay fixed.
        methods = [METHODS[one.method] for loop in backend.read.loops for one in loop.designs]
        known_names("fixed", sorted(given["fixed"]), tuple({option: 0 for one in methods for option in one.options}))
        parts = {
            loop: {name: tuple(sorted(set(parts))) for name, parts in designs.items()}
            for loop, designs in given["optional"].items()
        }
        more = {"optional": parts, "fixed": frozenset(given["fixed"]), "overlays": tuple(given["overlays"])}
        settings = backend.chosen(Settings(**(given | more)), design=given["design"])
        for name in ("plant", "axis"):
            settings = backend.with_choice(settings, name, given[name])
    except PlatformCtrlError as error:
        raise InputError(f"state: {error}") from None
    return settings
