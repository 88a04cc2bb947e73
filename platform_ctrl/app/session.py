"""One page: a Bokeh document with its settings, history, plots and running tasks."""

from __future__ import annotations

import json
import threading
from collections.abc import Callable
from functools import partial
from typing import TYPE_CHECKING, Any

from platform_ctrl.app import fragments
from platform_ctrl.app import tasks as work
from platform_ctrl.app.background import DesignPending, Requests
from platform_ctrl.app.pictures import tree_data
from platform_ctrl.app.plots import Plots
from platform_ctrl.app.settings import History
from platform_ctrl.common.arguments import known_name
from platform_ctrl.common.palette import PALETTE, declarations
from platform_ctrl.common.values import value
from platform_ctrl.errors import PlatformCtrlError

if TYPE_CHECKING:
    from bokeh.document import Document

    from platform_ctrl.app.backend import Backend
    from platform_ctrl.app.job_parts import BudgetState, ChipState
    from platform_ctrl.app.pictures import Drawing, Picture
    from platform_ctrl.app.settings import Settings
    from platform_ctrl.design.tuning import OptionEffects
    from platform_ctrl.job.judging import CheckResult


# Milliseconds without a change after which the influence of the sliders is computed.
IDLE = 350
# Longest time that measuring waits for the drawing to be sent, s.
_SENDING = 0.2
# Views of the page: the plots of the loop, or the budget of the line of sight.
VIEWS = ("loop", "budget")
# Requests that change the settings: the method of `Backend` that does it, with what belongs to the request.
CHANGES = {
    "fix": "with_fixed", "part": "with_part", "reset": "reset", "overlay": "with_overlay", "set": "with_choice",
    "limit": "with_limit",
}  # fmt: skip
Change = Callable[["Settings"], "Settings"]


@value
class Task:
    """A change of the settings to be shown; the steps of one gesture are undone together."""

    count: int
    change: Change
    gesture: object


class Session:
    """One page. Its methods run on the server's loop while the document is locked; `_work` runs in a thread."""

    def __init__(self, pages: Pages, document: Document, state: str) -> None:
        self.pages, self.backend, self.connection = pages, pages.backend, work.Connection(document)
        backend = self.backend
        self._tasks = tasks = work.LongTasks(self, backend, self.connection)
        self.settings = backend.start()
        self._line: str | None = None
        if state:
            try:
                self.settings = work.decode_state(backend, state)
            except PlatformCtrlError as error:
                self._line = f"The state in the link was not used: {error}"
        self.history = History(self.settings)
        self.plots, drawn = pages.take()
        self.picture = drawn if drawn is not None and drawn.settings.data() == self.settings.data() else None
        # What is done at each request of the page.
        self._acts: dict[str, Callable[..., Any]] = {what: getattr(backend, name) for what, name in CHANGES.items()} | {
            "ready": self._ready, "dark": self._dark, "move": self._move, "view": self._choose_view, "turn": self._turn,
            "undo": partial(self._step, -1), "redo": partial(self._step, 1), "tune": tasks.tune,
            "cancel": tasks.cancel, "save": tasks.save, "simulate": tasks.simulate,
        }  # fmt: skip
        self.connection.model.on_change("request", self._requested)
        self._view = VIEWS[0]
        # What a picture is computed for next.
        self.requests, self._lock = Requests("page"), threading.Lock()
        self._waiting: dict[str, Task] = {}
        # The curves to be drawn next.
        self._drawing: Drawing | None = None
        self._sent = threading.Event()
        # Effects of the sliders on requirements, and their settings; results of the budget; order of the table's rows.
        self._effects: OptionEffects | None = None
        self._effects_of: Settings | None = None
        self._budget_results: tuple[CheckResult, ...] = ()
        self._order: dict[tuple[str, str], int] = {}
        self._said: dict[str, ChipState] = {}
        # Settings that wait for a design, and the gesture that led to them; only `_work` uses it.
        self._awaited: tuple[Settings, object] | None = None
        self._idle: Any = None
        self._stop_listening = backend.loops.listen(self.again)

    def close(self, session_context: object) -> None:
        """Cancel all tasks and release everything; the page is closed."""
        self._stop_listening()
        self.requests.end()
        self._tasks.close()
        self.connection.document = None  # nothing is sent any more
        self._idle = self.picture = self._drawing = self._awaited = None

    def change(self, key: str, change: Change, *, count: int = 0, gesture: object = None) -> None:
        """Change the settings and show them; it replaces a waiting change of the same key."""
        self._tasks.cancel(name="tune")
        self._tasks.measuring.cancel("measure")
        self._no_rest()
        self._add(key, Task(count=count, change=change, gesture=object() if gesture is None else gesture))

    def _add(self, key: str, task: Task) -> None:
        with self._lock:
            self._waiting.pop(key, None)
            self._waiting[key] = task
        self.requests.add("picture", self._work)

    # Requests of the page.

    def _requested(self, name: str, old: object, new: object) -> None:
        """Do what a message requests; a wrong one is answered by an error."""
        count = None
        try:
            count, what, more = work.parse_request(new, self._acts)
            act = self._acts[what]
            if what not in CHANGES:
                act(count, **more)
                return
            if more.get("name") == "loop":
                self._show_view("loop")
            # The first part says what is changed.
            self.change(f"{what} {next(iter(more.values()))}", lambda settings: act(settings, **more), count=count)
        except Exception as error:
            # The sliders show their values again, not what was typed.
            html = {} if self.picture is None else self._chosen(self.picture.settings)
            self.connection.answer(count, line=[work.error_text(error), "error"], html=html)

    def _ready(self, count: int) -> None:
        if self.picture is None:
            self.change("ready", lambda settings: settings, count=count, gesture="ready")
        else:
            self._show(self.settings, "ready", self.picture, None, False, count)

    def _dark(self, count: int, dark: bool) -> None:
        self.plots.dark(dark)
        self.connection.answer(count)

    def _move(self, count: int, moves: list[dict[str, Any]], gesture: int) -> None:
        for one in moves:
            change = partial(self.backend.moved, slider=one["slider"], number=one["value"])
            self.change(f"move {one['slider']}", change, count=count, gesture=("move", one["slider"], gesture))

    def _choose_view(self, count: int, view: str) -> None:
        known_name("view", view, VIEWS if self.backend.read.budget is not None else VIEWS[:1])
        self._show_view(view)
        self.change("view", lambda settings: settings, count=count, gesture="ready")

    def _show_view(self, view: str) -> None:
        before, self._view = self._view, view
        self.connection.answer(view=view)
        if view == "loop" and before != view and self.picture is not None:
            self.plots.show(self.picture)

    def _turn(self, count: int, panel: str) -> None:
        {one.name: one for one in self.plots.panels}[panel].turn()
        self.connection.answer(count, html=self._headings())

    def _headings(self) -> dict[str, str]:
        return {f"head-{one.name}": fragments.fragment("heading", panel=one) for one in self.plots.panels}

    def _step(self, way: int, count: int) -> None:
        """Undo (-1) or redo (1) a step; settings that wait for a design are taken back first."""
        there = self.settings if way < 0 and self._awaited is not None else self.history.step(way)
        if there is None:
            self.connection.say(f"There is nothing to {'undo' if way < 0 else 'redo'}.", count=count)
        else:
            self.change("history", lambda settings: there, count=count, gesture="history")

    # Answers to the page.

    def again(self) -> None:
        """Compute the picture again with what has become known; called in a thread."""
        self._add("again", Task(count=0, change=lambda settings: settings, gesture="ready"))

    def _work(self, over: threading.Event) -> None:
        """Compute a picture for all changes that wait; runs in a thread. It is shown also when there are newer ones."""
        with self._lock:
            tasks, self._waiting = list(self._waiting.values()), {}
        if not tasks:
            return
        line, picture, awaits = None, None, False
        # Changes go on from settings that wait for a design.
        settings = self.settings if self._awaited is None else self._awaited[0]
        # A design that has become available is not a separate step of a gesture.
        gesture = next((task.gesture for task in reversed(tasks) if task.gesture != "ready"), "ready")
        if gesture == "ready" and self._awaited is not None:
            gesture = self._awaited[1]
        for task in tasks:
            try:
                settings = task.change(settings)
            except Exception as error:
                line = work.error_text(error)

        try:
            if self._view == "budget":
                state = self.backend.budget(settings)
                if state is not None:
                    self._send(partial(self._show_budget, state))
            picture = self.backend.picture(settings, self._drawn)
        except DesignPending as error:
            line, awaits = str(error), True
        except Exception as error:
            line = work.error_text(error)
        self._awaited = (settings, gesture) if awaits else None
        if picture is not None:
            # The next tasks start from here, before it is shown.
            self.settings = settings
        count = max(task.count for task in tasks)
        self.connection.later(partial(self._show, settings, gesture, picture, line, awaits, count))

    def _send(self, show: Callable[[], None]) -> None:
        """Have something shown, and wait until it is sent; called in a thread.

        Computing would keep it from being sent, for milliseconds at each message: the browser paints meanwhile.
        """
        self._sent.clear()
        self.connection.later(show)
        self.connection.later(self._sent.set)
        self._sent.wait(_SENDING)

    def _show_budget(self, state: BudgetState) -> None:
        if state.found is not None:
            self.plots.show_budget(state.found)
            self.connection.answer(html=self._headings())
        self.connection.answer(html={"budget": fragments.budget(state, self.backend.read.budget)})

    def parts_measured(self) -> None:
        """Show what has become known of the parts of the job."""
        self.connection.answer(html={"strip": self.strip()})
        state = self.backend.budget(self.settings) if self._view == "budget" else None
        if state is not None and state.exact:
            self._show_budget(state)

    def _drawn(self, drawing: Drawing) -> None:
        """Show the curves before they are measured; called in a thread."""
        if self.plots.over_frequency:
            for one in (drawing, *drawing.overlays):
                one.Omega_gain()
        if self._view == "loop":
            self._drawing = drawing
            # A newer one may be waiting already when it is its turn.
            self._send(lambda: self.plots.show(drawing) if drawing is self._drawing else None)

    def _show(
        self, settings: Settings, gesture: object, picture: Picture | None, line: str | None, awaits: bool, count: int
    ) -> None:
        """Show a picture, or the line of an error; with `awaits` it is computed again once a design is available."""
        line, self._line = self._line or line, None
        notes = () if picture is None else picture.measured.notes
        kind = "error" if line and not awaits else "quiet"
        html: dict[str, str] = {}
        if picture is not None:
            if gesture not in ("ready", "history"):
                self.history.put(settings, gesture)
            self.picture = picture
            html = self._shown(picture)
        elif self.picture is not None and awaits:
            html = self._chosen(settings)
        elif self.picture is not None:
            # Everything returns to the last picture; the curves may be drawn already.
            html = self._shown(self.picture)
            if self._view == "loop":
                self.plots.show(self.picture)
        self.connection.answer(count, html, line=[line or ". ".join(notes), kind])
        self.rest()

    def _chosen(self, settings: Settings) -> dict[str, str]:
        """Return the HTML that follows from the settings alone, by the ids of the elements."""
        every = self.backend.sliders(settings)
        known = self._effects if self._effects_of is settings else None
        spec = self.backend.loops.spec(settings.loop)
        tunable = spec.has_plants and any(one.tunable and not one.fixed for one in every)
        undo, redo = map(self.history.can, (-1, 1))
        return {
            "selectors": fragments.selectors(
                self.backend, settings, self._view if self.backend.read.budget is not None else ""
            ),
            "overlays": fragments.fragment("overlays", designs=spec.designs, settings=settings),
            "edits": fragments.fragment("edits", undo=undo, redo=redo, tunable=tunable),
            "sliders": fragments.sliders(self.backend, settings, known),
            "next": fragments.fragment("step", **fragments.next_step(known, every)),
        }

    def _shown(self, picture: Picture) -> dict[str, str]:
        """Return the HTML that follows from settings and picture, by the ids of the elements."""
        settings = picture.settings
        every = [*picture.requirements, *picture.measured.goals, *self._budget_results]
        # The tightest first, as they were when the sliders last rested: nothing jumps while one moves.
        if self._effects_of is settings or not {(one.subject, one.name) for one in every} <= self._order.keys():
            self._order = {(one.subject, one.name): k for k, one in enumerate(fragments.tightest_first(every))}
        every.sort(key=lambda one: self._order[one.subject, one.name])
        before = self._effects_of
        # Of another loop or design there is nothing to be shown, not even dimmed.
        same = before is not None and (before.loop, before.design) == (settings.loop, settings.design)
        effects, stale = self._effects if same else None, before is not settings
        sliders, names = self.backend.sliders(settings), self.backend.limit_names
        return {
            **self._chosen(settings),
            **self._headings(),
            "figures": fragments.figures(picture, self.backend.loops.spec(settings.loop).has_plants),
            "requirements": fragments.table(every, sliders, effects, names, stale, self.backend.read.budget),
            "strip": self.strip(),
            "elapsed": f"{1e3 * picture.elapsed:.0f} ms",
        }

    def show_effects(self, settings: Settings, effects: OptionEffects, budget: tuple[CheckResult, ...]) -> None:
        """Show what each slider does to each requirement of these settings, and the limits of the budget."""
        if self.picture is not None and self.picture.settings.data() == settings.data():
            self._effects, self._effects_of, self._budget_results = effects, self.picture.settings, budget
            self.connection.answer(html=self._shown(self.picture))

    def strip(self) -> str:
        """Return the HTML of the strip: the state of all parts of the job for the present settings."""
        parts, settings = self.backend.job_parts, self.settings
        states = parts.states(parts.parts(settings))
        # A chip that is being measured keeps its words, dimmed: nothing flickers while a slider moves.
        said = {one.chip.key: one for one in states if not one.measuring}
        self._said |= said
        return fragments.strip(states, self._said, settings.loop)

    def rest(self) -> None:
        """Compute what each slider does, and the other parts of the job, once nothing has changed for a while."""
        document = self.connection.document
        if document is None:
            return
        self._no_rest()

        def rested() -> None:
            self._idle = None
            if self.picture is not None:
                settings = self.picture.settings
                _, words, more = fragments.loop_verdict(self.picture)
                # The address, and what a screen reader says, not of every step of a move.
                link = work.encode_state(self.backend, settings)
                self.connection.answer(link=link, spoken=f"{words}. {more}")
                self._tasks.measure(settings)

        self._idle = document.add_timeout_callback(rested, IDLE)

    def _no_rest(self) -> None:
        if self._idle is not None and self.connection.document is not None:
            self.connection.document.remove_timeout_callback(self._idle)
        self._idle = None


class Pages:
    """The pages of a server.

    The plots of the next page, with the curves of the job, are made before it is opened: that takes a third of a second
    in which no other page could move a slider.
    """

    def __init__(self, backend: Backend) -> None:
        self.backend = backend
        self._lock = threading.Lock()
        self._next: tuple[Plots, Picture | None] | None = None

    def prepare(self) -> None:
        """Make the plots of the next page, unless they are there; in a thread."""
        with self._lock:
            self._next = self._next or self._made()

    def take(self) -> tuple[Plots, Picture | None]:
        """Return plots, and the picture of the job that they show."""
        with self._lock:
            out, self._next = self._next or self._made(), None
        return out

    def _made(self) -> tuple[Plots, Picture | None]:
        plots = Plots(budget=self.backend.read.budget)
        try:
            picture = self.backend.picture(self.backend.start())
        except Exception:  # the page asks for it again, and says so
            return plots, None
        plots.show(picture)
        return plots, picture

    def fill(self, document: Document) -> None:
        """Fill a new document with a page, which ends with the document's session."""
        backend = self.backend
        context: Any = document.session_context
        state: bytes = context.request.arguments.get("state", [b""])[0]
        session = Session(self, document, state.decode("utf-8", "replace"))
        with document.models.freeze():  # what belongs to the document is looked for once, not for every plot
            for root in (*session.plots.layout.values(), session.connection.model):
                document.add_root(root)
        document.on_session_destroyed(session.close)
        document.title = backend.read.name
        # A lost page says so itself, and is loaded again with its state: what the server knew of it may be gone.
        document.config.update(reconnect_session=False, notify_connection_status=False)
        document.template = fragments.templates().get_template("page.html")
        document.template_variables.update(
            has_budget=backend.read.budget is not None,
            palette=":root{{{}}}\n:root[data-theme=dark]{{{}}}".format(*map(declarations, PALETTE.values())),
            manoeuvres=[one.name for one in backend.read.manoeuvres],
            folder=str(backend.folder.resolve()),
            stem="job" if backend.path is None else backend.path.stem,
            tree=json.dumps(tree_data(backend.read.platform), separators=(",", ":")),
        )
