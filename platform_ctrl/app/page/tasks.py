"""Tasks of a page that take longer than a picture: tuning, the influence of the sliders, saving, a simulated run."""

from __future__ import annotations

import logging
import os
import re
import shlex
import threading
import time
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any, Generic, Protocol, TypeVar

from platform_ctrl.app.page.messages import Request, influence_data
from platform_ctrl.app.saving import controllers_beside
from platform_ctrl.common.arguments import known_name
from platform_ctrl.common.signatures import short
from platform_ctrl.errors import InputError, PlatformCtrlError

if TYPE_CHECKING:
    from platform_ctrl.app.backend import Backend
    from platform_ctrl.app.gimbal_tree import TreeView
    from platform_ctrl.app.page.session import Connection
    from platform_ctrl.app.pictures import Picture
    from platform_ctrl.app.settings import Choices, Settings

# A name and no path; nothing that a system keeps to itself.
_NAME = re.compile(r"[\w .,()+=@-]+(?<![ .])")
_LONGEST = 80
_RESERVED = re.compile(r"(?i)(con|prn|aux|nul|com\d|lpt\d)(\..*)?")


def target(folder: Path, name: str) -> Path:
    """Return the path of the job file that a page wants to save."""
    stem = name.strip().removesuffix(".toml")
    if len(stem) > _LONGEST:
        raise InputError(f"name: it may have at most {_LONGEST} characters, this one has {len(stem)}")
    if _RESERVED.fullmatch(stem) is not None:
        raise InputError(f"name: Windows reserves {short(name)} for a device; choose another one")
    if _NAME.fullmatch(stem) is None:
        raise InputError(f"name: only letters, digits, blanks, . , ( ) + = @ - and _ are allowed, got {short(name)}")
    if stem.startswith("."):
        raise InputError(f"name: {short(name)} must not begin with a dot, which would hide the file")
    return folder / f"{stem}.toml"


def check_line(path: Path) -> str:
    """Return the command that checks a saved job."""
    return f"platform-ctrl check {shlex.quote(str(path))}"


# Least seconds between two lines about the progress of a task.
PROGRESS_INTERVAL = 0.15
# Milliseconds after which a simulation says what takes it so long.
LONG = 1000
_log = logging.getLogger(__name__)


def error_text(error: Exception) -> str:
    """Return the line that a page shows for an error; an unexpected one is logged as well."""
    if isinstance(error, PlatformCtrlError):
        return str(error)
    _log.error("the page: %s", " ".join(f"{type(error).__name__}: {error}".split()))
    return f"This could not be computed ({type(error).__name__}); the terminal says more."


class Page(Protocol):
    """The page that tasks belong to."""

    backend: Backend
    connection: Connection
    choices: Choices
    settings: Settings
    picture: Picture | None
    tree: TreeView

    def change(self, key: str, change: Callable[[Settings], Settings]) -> None:
        """Have the settings changed and shown."""


class PageTasks:
    """The long tasks of a session, each in a thread of its own."""

    def __init__(self, page: Page) -> None:
        self._page, self._backend, self._connection = page, page.backend, page.connection
        self._cancelled: threading.Event | None = None
        self._run_cancelled: threading.Event | None = None
        self._measuring = False

    def close(self) -> None:
        """End what is going on; nothing is sent any more."""
        self.cancel_tuning()
        self._cancel_run()

    def data(self) -> dict[str, Any]:
        """Return what the page shows for saving and simulating."""
        path = self._backend.path
        stem = "job" if path is None else path.stem
        manoeuvres = self._page.choices.manoeuvres
        return {
            "folder": str(self._folder()),
            "stem": f"{stem}-tuned",
            "manoeuvre": manoeuvres[0] if manoeuvres else "",
        }

    def handle(self, request: Request) -> None:
        """Do what a message requests."""
        getattr(self, f"_on_{request.what}")(request)

    def cancel_tuning(self) -> None:
        """End tuning, if it is going on."""
        if self._cancelled is not None:
            self._cancelled.set()

    def influence(self, settings: Settings) -> None:
        """Work out what each slider does to each requirement of these settings, and tell the page."""
        page = self._page
        if self._measuring or self._cancelled is not None:
            return
        self._measuring = True

        def measured() -> Callable[[], None]:
            influence = self._backend.influence(settings)

            def show() -> None:
                self._measuring = False
                now = page.picture
                if now is not None and now.settings.data() == settings.data():
                    self._connection.answer(influence=influence_data(influence))
                elif now is not None:
                    self.influence(now.settings)

            return show

        def failed(line: str) -> None:
            self._measuring = False

        self._do(measured, failed)

    def _on_cancel(self, request: Request) -> None:
        self.cancel_tuning()
        self._cancel_run()
        self._connection.answer(request.count)

    def _on_tune(self, request: Request) -> None:
        page = self._page
        if self._cancelled is not None:
            self._connection.say("Tuning is going on already.", count=request.count)
            return
        if self._run_cancelled is not None:
            self._connection.say("A manoeuvre is being simulated; Esc ends that.", count=request.count)
            return
        self._cancelled = cancelled = threading.Event()
        settings, last = page.settings, [0.0]
        self._connection.answer(request.count, busy={"text": "Tuning the rest", "share": None, "cancel": True})

        def progress(line: str) -> None:
            now = time.monotonic()
            if now - last[0] < PROGRESS_INTERVAL:
                return
            last[0] = now
            busy = {"text": f"Tuning the rest: {line}", "share": None, "cancel": True}
            self._connection.later(lambda: self._connection.answer(busy=busy) if self._cancelled is cancelled else None)

        def tuned() -> Callable[[], None]:
            new = self._backend.tune(settings, progress, cancelled.is_set)

            def show() -> None:
                self._cancelled = None
                self._connection.answer(busy=None)
                if cancelled.is_set():
                    self._connection.say("Tuning was cancelled; nothing was changed.")
                    return
                if new.options == settings.options:
                    self._connection.say("Tuning found no better values; nothing was changed.")
                    return
                page.change("tune", lambda _: new)

            return show

        def failed(line: str) -> None:
            self._cancelled = None
            self._connection.answer(busy=None, line={"text": line, "kind": "quiet" if cancelled.is_set() else "error"})

        self._do(tuned, failed)

    def _on_save(self, request: Request) -> None:
        page = self._page
        try:
            path = target(self._folder(), request.more["name"])
        except PlatformCtrlError as error:
            self._connection.answer(request.count, saved={"kind": "error", "text": str(error)})
            return
        settings, overwrite = page.settings, request.more["overwrite"]
        there = [one.name for one in (path, controllers_beside(path)) if os.path.lexists(one)]
        if there and not overwrite:
            reply = {"kind": "error", "text": f"{there[0]} is there already: overwrite it?", "exists": True}
            self._connection.answer(request.count, saved=reply)
            return
        self._connection.answer(request.count)

        def saved() -> Callable[[], None]:
            written = self._backend.save(settings, path, overwrite=overwrite)
            text = ". ".join((f"Saved: {path}", *written.notes))
            reply = {"kind": "good", "text": text, "command": check_line(path)}
            return lambda: self._connection.answer(saved=reply, line={"text": text, "kind": "good"})

        self._do(saved, lambda line: self._connection.answer(saved={"kind": "error", "text": line}))

    def _on_simulate(self, request: Request) -> None:
        page = self._page
        manoeuvre = request.more["manoeuvre"]
        known_name("manoeuvre", manoeuvre, page.choices.manoeuvres)
        if self._run_cancelled is not None or self._cancelled is not None:
            what = "A manoeuvre is being simulated already" if self._cancelled is None else "Tuning is going on"
            self._connection.say(f"{what}; Esc ends that.", count=request.count)
            return
        self._run_cancelled = cancelled = threading.Event()
        settings, first = page.settings, not self._backend.has_simulated
        busy: dict[str, Any] = {"text": "Simulating", "share": None, "cancel": True}
        self._connection.answer(request.count, busy=busy)

        def takes_long() -> None:
            if self._run_cancelled is cancelled:
                words = f"Simulating {manoeuvre}"
                if first:
                    words += ": the first run loads its equations, or compiles them once on this machine"
                self._connection.answer(busy=busy | {"text": words})

        self._connection.soon(takes_long, LONG)

        def simulated() -> Callable[[], None]:
            trajectory = self._backend.simulate(settings, manoeuvre, cancelled.is_set)
            platform = self._backend.job(settings).platform

            def show() -> None:
                self._run_cancelled = None
                if cancelled.is_set():
                    self._connection.answer(busy=None)
                    return
                page.tree.stage(platform)
                page.tree.show(trajectory)
                self._connection.answer(busy=None, simulated=manoeuvre)

            return show

        def failed(line: str) -> None:
            self._run_cancelled = None
            reply = {"text": line, "kind": "error"}
            if cancelled.is_set():
                reply = {"text": "The simulation was cancelled.", "kind": "quiet"}
            self._connection.answer(busy=None, line=reply)

        self._do(simulated, failed)

    def _cancel_run(self) -> None:
        if self._run_cancelled is not None:
            self._run_cancelled.set()

    def _folder(self) -> Path:
        path = self._backend.path
        return (Path() if path is None else path.parent).resolve()

    def _do(self, work: Callable[[], Callable[[], None]], failed: Callable[[str], None]) -> None:
        """Do `work` in a thread; what it returns, or `failed` with a line, is then called on the server's loop."""

        def run() -> None:
            try:
                done = work()
            except Exception as error:
                line = error_text(error)
                self._connection.later(lambda: failed(line))
            else:
                self._connection.later(done)

        threading.Thread(target=run, name="page task", daemon=True).start()


T = TypeVar("T")


class LatestTasks(Generic[T]):
    """Tasks that a thread works off; a newer task takes the place of one of the same key that still waits.

    The thread lives as long as there is something to do.
    """

    def __init__(self, work: Callable[[list[T]], None]) -> None:
        self._work = work
        self._lock = threading.Lock()
        self._waiting: dict[str, T] = {}
        self._working = False
        self._closed = False

    def add(self, key: str, task: T) -> None:
        """Have a task done; the one of the same key that waits is dropped."""
        with self._lock:
            if self._closed:
                return
            self._waiting.pop(key, None)
            self._waiting[key] = task
            if self._working:
                return
            self._working = True
        threading.Thread(target=self._run, name="page", daemon=True).start()

    def close(self) -> None:
        """Drop what waits; nothing more is taken."""
        with self._lock:
            self._closed = True
            self._waiting.clear()

    def _run(self) -> None:
        while True:
            with self._lock:
                if not self._waiting:
                    self._working = False
                    return
                tasks = list(self._waiting.values())
                self._waiting.clear()
            self._work(tasks)
