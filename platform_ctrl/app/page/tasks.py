"""What takes a page longer than a picture: tuning, the influence of the sliders, saving, a simulated run."""

from __future__ import annotations

import logging
import os
import re
import shlex
import threading
import time
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any

from platform_ctrl.app.page.messages import influence_data
from platform_ctrl.app.page.requests import Request
from platform_ctrl.app.saving import controllers_beside
from platform_ctrl.common.arguments import known_name
from platform_ctrl.common.signatures import short
from platform_ctrl.errors import InputError, PlatformCtrlError

if TYPE_CHECKING:
    from platform_ctrl.app.page.session import Session
    from platform_ctrl.app.settings import Settings

# A name and no path; nothing that a system keeps to itself.
_NAME = re.compile(r"[\w .,()+=@-]+(?<![ .])")
_LONGEST = 80
_RESERVED = re.compile(r"(?i)(con|prn|aux|nul|com\d|lpt\d)(\..*)?")


def target(folder: Path, name: str) -> Path:
    """Return the path of the job file that a page wants to save."""
    stem = name.strip().removesuffix(".toml")
    if len(stem) > _LONGEST:
        raise InputError(f"name: {len(stem)} characters; expected at most {_LONGEST}")
    if _RESERVED.fullmatch(stem) is not None:
        raise InputError(f"name: given {short(name)}; expected another: Windows keeps it for a device")
    if _NAME.fullmatch(stem) is None:
        raise InputError(f"name: given {short(name)}; expected letters, digits, blanks, . , ( ) + = @ - or _")
    if stem.startswith("."):
        raise InputError(f"name: given {short(name)}; expected no dot at its beginning: such files are hidden")
    return folder / f"{stem}.toml"


def check_line(path: Path) -> str:
    """Return the command that checks a saved job."""
    return f"platform-ctrl check {shlex.quote(str(path))}"


# Seconds between two tellings of how far a long task is.
TOLD = 0.15
# Milliseconds after which a simulation says what takes it so long.
LONG = 1000
_log = logging.getLogger(__name__)


def words_of(error: Exception) -> str:
    """Return the line that a page shows for an error; one that is no error of input is told to the log as well."""
    if isinstance(error, PlatformCtrlError):
        return str(error)
    _log.error("the designer's page: %s", " ".join(f"{type(error).__name__}: {error}".split()))
    return f"This could not be worked out ({type(error).__name__}); the terminal says more."


class PageTasks:
    """The long tasks of a session, each in a thread of its own."""

    def __init__(self, session: Session) -> None:
        self._session = session
        self._cancelled: threading.Event | None = None
        self._flight_cancelled: threading.Event | None = None
        self._measuring = False

    def close(self) -> None:
        """End what is going on; nothing is told any more."""
        self.cancel_tuning()
        self._cancel_flying()

    def told(self) -> dict[str, Any]:
        """Return what the page has to know for saving and running."""
        path = self._session.backend.path
        stem = "job" if path is None else path.stem
        manoeuvres = self._session.choices.manoeuvres
        return {
            "folder": str(self._folder()),
            "stem": f"{stem}-tuned",
            "manoeuvre": manoeuvres[0] if manoeuvres else "",
        }

    def ask(self, ask: Request) -> None:
        """Do what a message asks for."""
        getattr(self, f"_ask_{ask.what}")(ask)

    def cancel_tuning(self) -> None:
        """End tuning, if it is going on."""
        if self._cancelled is not None:
            self._cancelled.set()

    def influence(self, settings: Settings) -> None:
        """Work out what each slider does to each requirement of these settings, and tell the page."""
        session = self._session
        if self._measuring or self._cancelled is not None:
            return
        self._measuring = True

        def measured() -> Callable[[], None]:
            influence = session.backend.influence(settings)

            def tell() -> None:
                self._measuring = False
                now = session.picture
                if now is not None and now.settings.data() == settings.data():
                    session.answer(influence=influence_data(influence))
                elif now is not None:
                    self.influence(now.settings)

            return tell

        def failed(line: str) -> None:
            self._measuring = False

        self._do(measured, failed)

    def _ask_cancel(self, ask: Request) -> None:
        self.cancel_tuning()
        self._cancel_flying()
        self._session.answer(ask.count)

    def _ask_tune(self, ask: Request) -> None:
        session = self._session
        if self._cancelled is not None:
            session.say("Tuning is going on already.", count=ask.count)
            return
        if self._flight_cancelled is not None:
            session.say("A manoeuvre is being simulated; Esc ends that.", count=ask.count)
            return
        self._cancelled = cancelled = threading.Event()
        settings, last = session.settings, [0.0]
        session.answer(ask.count, busy={"text": "Tuning the rest", "share": None, "cancel": True})

        def progress(line: str) -> None:
            now = time.monotonic()
            if now - last[0] < TOLD:
                return
            last[0] = now
            busy = {"text": f"Tuning the rest: {line}", "share": None, "cancel": True}
            session.later(lambda: session.answer(busy=busy) if self._cancelled is cancelled else None)

        def tuned() -> Callable[[], None]:
            new = session.backend.tune(settings, progress, cancelled.is_set)

            def show() -> None:
                self._cancelled = None
                session.answer(busy=None)
                if cancelled.is_set():
                    session.say("Tuning was cancelled; nothing was moved.")
                    return
                if new.options == settings.options:
                    session.say("Tuning found nothing better than where the sliders stand; nothing was moved.")
                    return
                session.change("tune", lambda _: new)

            return show

        def failed(line: str) -> None:
            self._cancelled = None
            session.answer(busy=None, line={"text": line, "kind": "quiet" if cancelled.is_set() else "error"})

        self._do(tuned, failed)

    def _ask_save(self, ask: Request) -> None:
        session = self._session
        try:
            path = target(self._folder(), ask.more["name"])
        except PlatformCtrlError as error:
            session.answer(ask.count, saved={"kind": "error", "text": str(error)})
            return
        settings, overwrite = session.settings, ask.more["overwrite"]
        there = [one.name for one in (path, controllers_beside(path)) if os.path.lexists(one)]
        if there and not overwrite:
            told = {"kind": "error", "text": f"{there[0]} is there already: overwrite it?", "exists": True}
            session.answer(ask.count, saved=told)
            return
        session.answer(ask.count)

        def saved() -> Callable[[], None]:
            written = session.backend.save(settings, path, overwrite=overwrite)
            text = ". ".join((f"Saved: {path}", *written.notes))
            told = {"kind": "good", "text": text, "command": check_line(path)}
            return lambda: session.answer(saved=told, line={"text": text, "kind": "good"})

        self._do(saved, lambda line: session.answer(saved={"kind": "error", "text": line}))

    def _ask_fly(self, ask: Request) -> None:
        session = self._session
        manoeuvre = ask.more["manoeuvre"]
        known_name("manoeuvre", manoeuvre, session.choices.manoeuvres)
        if self._flight_cancelled is not None or self._cancelled is not None:
            what = "A manoeuvre is being simulated already" if self._cancelled is None else "Tuning is going on"
            session.say(f"{what}; Esc ends that.", count=ask.count)
            return
        self._flight_cancelled = cancelled = threading.Event()
        settings, first = session.settings, not session.backend.has_simulated
        busy: dict[str, Any] = {"text": "Simulating", "share": None, "cancel": True}
        session.answer(ask.count, busy=busy)

        def takes_long() -> None:
            if self._flight_cancelled is cancelled:
                words = f"Simulating {manoeuvre}"
                if first:
                    words += ": the first run loads its equations, or compiles them once on this machine"
                session.answer(busy=busy | {"text": words})

        session.soon(takes_long, LONG)

        def flown() -> Callable[[], None]:
            trajectory = session.backend.simulate(settings, manoeuvre, cancelled.is_set)
            platform = session.backend.job(settings).platform

            def show() -> None:
                self._flight_cancelled = None
                if cancelled.is_set():
                    session.answer(busy=None)
                    return
                session.tree.stage(platform)
                session.tree.show(trajectory)
                session.answer(busy=None, flown=manoeuvre)

            return show

        def failed(line: str) -> None:
            self._flight_cancelled = None
            told = {"text": line, "kind": "error"}
            if cancelled.is_set():
                told = {"text": "The simulation was cancelled.", "kind": "quiet"}
            session.answer(busy=None, line=told)

        self._do(flown, failed)

    def _cancel_flying(self) -> None:
        if self._flight_cancelled is not None:
            self._flight_cancelled.set()

    def _folder(self) -> Path:
        path = self._session.backend.path
        return (Path() if path is None else path.parent).resolve()

    def _do(self, work: Callable[[], Callable[[], None]], failed: Callable[[str], None]) -> None:
        """Do `work` in a thread; what it returns, or `failed` with a line, is then called on the server's loop."""
        session = self._session

        def run() -> None:
            try:
                done = work()
            except Exception as error:
                line = words_of(error)
                session.later(lambda: failed(line))
            else:
                session.later(done)

        threading.Thread(target=run, name="designer task", daemon=True).start()
