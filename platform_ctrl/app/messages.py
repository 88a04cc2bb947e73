"""The messages between page and server: requests are checked, pictures and settings are written as plain data."""

from __future__ import annotations

import dataclasses
import json
import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from contextlib import suppress
from typing import TYPE_CHECKING, Any

import numpy as np
from bokeh.core.properties import Any as AnyProperty
from bokeh.core.properties import String
from bokeh.model import DataModel

from platform_ctrl.app.budget import BudgetState
from platform_ctrl.app.job_parts import ChipState
from platform_ctrl.app.pictures import Margins, Picture
from platform_ctrl.app.settings import Mode, Settings, Slider
from platform_ctrl.common.arguments import short
from platform_ctrl.common.values import value
from platform_ctrl.design.methods import METHODS
from platform_ctrl.design.tuning import SHARE, OptionEffects, OptionValue, candidates
from platform_ctrl.errors import InputError
from platform_ctrl.job.judging import CheckResult
from platform_ctrl.job.quantities import BOUND, HZ, compared

if TYPE_CHECKING:
    from bokeh.document import Document

    from platform_ctrl.app.backend import Backend

# Characters of a message.
LONGEST = 20_000

# Every request, and what belongs to it besides its count.
REQUESTS: Mapping[str, Mapping[str, type]] = {
    "ready": {},
    "dark": {"dark": bool},
    "move": {"moves": list, "gesture": int},
    "fix": {"slider": str, "fixed": bool},
    "part": {"part": str, "on": bool},
    "reset": {"slider": str},
    "overlay": {"design": str, "on": bool},
    "set": {"name": str, "value": object},
    "limit": {"key": str, "number": object},
    "view": {"view": str},
    "undo": {},
    "redo": {},
    "tune": {},
    "cancel": {},
    "save": {"name": str, "overwrite": bool},
    "simulate": {"manoeuvre": str},
}
_WORDS = {bool: "true or false", int: "a whole number", str: "a text", list: "a list", dict: "a slider and its number"}


@value
class Request:
    """A checked message of a page: its `count`, which the response names, its kind `what`, and its typed content."""

    count: int
    what: str
    more: dict[str, Any]


def parse_request(message: Any) -> Request:
    """Return a message of a page, checked."""
    try:
        read = json.loads(message, parse_constant=_no_constant) if len(message) <= LONGEST else {}
        what, parts = read["what"], REQUESTS[read["what"]]
    except (TypeError, ValueError, KeyError, RecursionError):
        raise InputError(
            f"a message must be JSON of at most {LONGEST} characters with finite numbers and one of the requests "
            f"{', '.join(REQUESTS)}, the page sent {short(message)}"
        ) from None
    more = {name: of_kind(f"{what}: {name}", read.get(name), kind) for name, kind in parts.items()}
    for one in more.get("moves", ()):
        # Whether the slider is known and its value a number is seen when it moves.
        of_kind("move: each of the moves", one, dict)
    return Request(count=of_kind(f"{what}: n", read.get("n"), int), what=what, more=more)


def of_kind(name: str, given: object, kind: type) -> Any:
    """Return what a page has given if it is of the right kind."""
    if not isinstance(given, kind) or (kind is int and isinstance(given, bool)):
        raise InputError(f"{name} must be {_WORDS[kind]}, got {short(given)}")
    return given


def _no_constant(text: str) -> float:
    raise ValueError(text)


class MessageModel(DataModel):
    """The last request of the page, and the last response to it."""

    # Of any type: `parse_request` refuses what is not a request.
    request = AnyProperty(default="")
    response = String(default="")


class Connection:
    """The server's end of the connection to a page; all but `later` runs on the server's loop."""

    def __init__(self, document: Document) -> None:
        self.document: Document | None = document
        self.model = MessageModel(name="messages")
        self._answered = 0

    def close(self) -> None:
        """Release the document: nothing is sent any more."""
        self.document = None

    def later(self, act: Callable[[], None]) -> None:
        """Call `act` on the server's loop; from any thread."""
        document = self.document
        if document is not None:
            # Bokeh takes a document apart before it says that its page is gone.
            with suppress(AttributeError):
                document.add_next_tick_callback(lambda: None if self.document is None else act())

    def say(self, text: str, kind: str = "quiet", count: int | None = None) -> None:
        """Write the page's line: ``"quiet"``, ``"good"`` or ``"error"``."""
        self.answer(count, line={"text": text, "kind": kind})

    def answer(self, count: int | None = None, **parts: Any) -> None:
        """Send parts of what the page shows; all its messages up to `count` are done."""
        self._answered = max(self._answered, count or 0)
        content = {"n": self._answered, **parts}
        self.model.update(response=json.dumps(content, allow_nan=False, separators=(",", ":")))


# Name of the limit of a result, by its subject and name.
LimitNames = Mapping[tuple[str, str], str]
# Least share of its ratio by which a step has to help a requirement.
_LEAST_GAIN = 5e-3
# Shares of a mean square that are none.
_ROUNDING = 1e-12
# What a slider's value looked like before a page moved it; a start that no slider has is shown as none.
Starts = Mapping[str, float]


def plain_number(number: float | None) -> float | str | None:
    """Return a number as JSON can say it: infinite ones in words, none for what is no number."""
    if number is None or math.isnan(number):
        return None
    if math.isinf(number):
        return "inf" if number > 0 else "-inf"
    return float(number)


def slider_data(sliders: Iterable[Slider], starts: Starts) -> list[dict[str, Any]]:
    """Return the sliders as the page builds them."""
    return [dataclasses.asdict(one) | {"start": starts.get(one.name, one.value)} for one in sliders]


def choice_data(backend: Backend, settings: Settings, plants: tuple[str, ...]) -> dict[str, Any]:
    """Return what every list of the page offers."""
    loops = backend.read.loops
    kinds = {kind for loop in loops for one in loop.designs for kind in METHODS[one.method].kinds}
    spec = next(one for one in loops if one.name == settings.loop)
    others = [one for one in spec.designs if one.name != settings.design]
    return {
        "mode": ["caged", "stabilised"] if "stabilisation" in kinds else ["caged"],
        "loop": [one.name for one in loops],
        "design": [one.name for one in spec.designs],
        "channel": list(backend.channels(settings)),
        "axis": [1, 2, 3],
        "plant": list(plants),
        "manoeuvre": [one.name for one in backend.read.manoeuvres],
        "overlays": [{"design": one.name, "method": one.method} for one in others],
    }


def verdict_data(picture: Picture) -> dict[str, Any]:
    """Return the verdict and the margins."""
    verdict, words, more = _verdict(picture)
    return {
        "verdict": verdict,
        "words": words,
        "more": more,
        "figures": _figures(picture.margins, picture.stable, picture.settings.mode),
        "elapsed": f"{1e3 * picture.elapsed:.0f} ms",
    }


def strip_data(states: Sequence[ChipState], loop: str) -> dict[str, Any]:
    """Return the strip of the whole job: a line about all requirements, and a chip for each part; `loop` is shown."""
    count, checked, missed = (sum(getattr(one, of) for one in states) for of in ("count", "checked", "missed"))
    left = f", {count - checked} not checked" if checked < count else ""
    left = ", checking ..." if any(map(_is_open, states)) else left
    if missed:
        verdict, words = "bad", f"{missed} of {count} missed{left}"
    elif not checked and left.endswith("..."):
        verdict, words = "open", f"Checking {count} limits ..."
    elif left:
        verdict, words = "open", f"{checked} of {count} met{left}"
    else:
        verdict, words = "good", f"All {count} limits met"
    return {"verdict": verdict, "words": words, "chips": [_chip(one, loop) for one in states]}


def _is_open(one: ChipState) -> bool:
    """Return whether nothing is known of a chip yet, which is measured without a request."""
    return one.worst is None and not one.on_request and not one.error and one.count > 0


def _chip(one: ChipState, loop: str) -> dict[str, Any]:
    chip, worst = one.chip, one.worst
    whole = one.checked >= one.count and not one.error
    short = "not run" if one.on_request else "–" if one.error else "…" if one.count else "no limits"
    if one.error:
        words = one.error
    elif worst is None:
        words = f"{one.count} limits, " + ("not simulated for these settings" if one.on_request else "not measured")
    else:
        met = f"{one.missed} of {one.count} missed" if one.missed else f"{one.checked} of {one.count} met"
        words = f"{met}; nearest limit: {worst.name}" + (f", {worst.subject}" if worst.subject != chip.label else "")
    return {
        **chip._asdict(),
        "verdict": "bad" if one.missed else "good" if whole else "open",
        "margin": None if worst is None else plain_number(worst.margin),
        "short": short,
        "measuring": _is_open(one),
        "words": words,
        "shown": bool(chip.loop) and chip.loop == loop and chip.key.startswith("loop "),
    }


def budget_data(state: BudgetState) -> dict[str, Any]:
    """Return the table of the line of sight's budget, µrad: sources by axis, all together, and the limits."""
    found = state.found
    if found is None:
        return {"line": state.line, "exact": state.exact, "axes": [], "rows": [], "total": [], "limits": []}
    rows = [
        {
            "name": name,
            "kind": kind,
            # Rounding shows in axes on which a source does not act.
            "rms": [1e6 * float(x) if share > _ROUNDING else 0.0 for x, share in zip(rms, shares, strict=True)],
            "share": [float(share) for share in shares],
        }
        for name, kind, rms, shares in zip(found.names, found.kinds, found.rms, found.shares, strict=True)
    ]
    return {
        "line": state.line,
        "exact": state.exact,
        "axes": list(found.axes),
        "rows": rows,
        "total": [1e6 * float(x) for x in found.total],
        "across": 1e6 * found.jitter,
        "limits": [_row(one) | {"value": 1e6 * one.value, "limit": 1e6 * one.limit} for one in found.results],
        "friction": [] if found.friction is None else list(found.friction.statement),
    }


def requirement_data(results: Sequence[CheckResult], names: LimitNames) -> list[dict[str, Any]]:
    """Return rows of requirements and goals, with the `names` of the limits that the job states."""
    return [_row(one) | {"key": names.get((one.subject, one.name), ""), "limit": one.limit} for one in results]


def influence_data(
    influence: OptionEffects, budget: Sequence[CheckResult], sliders: Sequence[Slider], names: LimitNames
) -> dict[str, Any]:
    """Return what the sliders do to the requirements, the rows of those of the budget, and the next step."""
    return {
        "next": _next_step(influence, sliders),
        "budget": requirement_data(budget, names),
        "sliders": list(influence.options),
        "ratios": [plain_number(float(ratio)) for ratio in influence.ratios],
        "share": SHARE,
        "change": {
            name: [plain_number(float(number)) for number in row]
            for name, row in zip(influence.requirements, influence.change, strict=True)
        },
    }


def _next_step(influence: OptionEffects, sliders: Sequence[Slider]) -> dict[str, Any]:
    """Return the move of a slider by 5 % after which the tightest requirement is met best, by slopes, as a sentence."""
    if not influence.requirements:
        return {"words": "", "slider": ""}
    at = int(np.argmax(influence.ratios))
    tightest, ratio = influence.requirements[at], float(influence.ratios[at])
    free = [
        OptionValue(name=one.name, value=one.value, low=one.low, high=one.high)
        for one in sliders
        if one.name in influence.options and one.tunable and not one.fixed and one.value
    ]
    for name, after in candidates(influence, free, moves=(-SHARE, SHARE))[:1]:
        slider = next(one for one in sliders if one.name == name)
        change = float(influence.change[at, influence.options.index(name)]) / SHARE * (after / slider.value - 1.0)
        if change < -_LEAST_GAIN * ratio:
            way = "Raise" if after > slider.value else "Lower"
            to = f"{after:.4g} {slider.unit}".rstrip()
            return {"words": f"{way} {slider.label} to {to} for {tightest}.", "slider": name, "value": after}
    words = f"No single slider helps {tightest}." if free else f"No slider is free to help {tightest}."
    return {"words": words, "slider": ""}


def _row(one: CheckResult) -> dict[str, Any]:
    reached, required = compared(one)
    return {
        "name": one.name,
        "full": f"{one.subject}, {one.design}: {one.name}" if one.design else f"{one.subject}: {one.name}",
        "required": f"{BOUND[one.sense]} {required}",
        "reached": reached,
        "margin": one.margin if math.isfinite(one.margin) else None,
        "passed": bool(one.passed),
        "hard": one.hard,
        "method": one.method,
    }


def _verdict(picture: Picture) -> tuple[str, str, str]:
    if not picture.stable:
        return "bad", "Unstable", f"plant shown: {picture.settings.plant}"
    missed = [one.name for one in picture.requirements if not one.passed]
    count = len(picture.requirements)
    if not picture.all_stable:
        return "bad", "Unstable for a plant of the set", picture.margins.worst_plant
    if missed:
        return "bad", f"{len(missed)} of {count} missed", ", ".join(missed)
    if count == 0:
        return "good", "Stable", "this loop has no requirements"
    least = min(picture.requirements, key=lambda one: one.margin)
    # What lies between the frequencies of a grid is no verdict. The job's own verdict stands in the strip.
    sampled = any(one.method == "sampled" for one in picture.requirements)
    left = f"nearest limit: {least.name}, {100 * least.margin:.1f} %"
    met = "limit is" if count == 1 else "limits are"
    return "good", f"This loop's {met} met" + ", sampled" * sampled, left


# What the numbers are of, caged and stabilised: channels, angles, and what poles have to be faster than to count.
_OF = {
    "caged": ("all channels of the loop at once", "all angles of the loop", "loop's reference frequency"),
    "stabilised": ("broken at the torquer that is shown, all others closed", "the platform's axes", "crossover"),
}


def _figures(margins: Margins, stable: bool, mode: Mode) -> list[dict[str, Any]]:
    channels, axes, above = _OF[mode]
    sampled = margins.worst_sampled
    worst = f"Disk margin of {margins.worst_plant}" + ", the least at the frequencies of a grid" * sampled
    damping = f"Least of the closed-loop poles beyond a tenth of the {above}"
    # Label, value, unit, what it is, whether it is bad.
    rows: tuple[tuple[str, float | str | None, str, str, bool], ...] = (
        ("Disk margin, shown", margins.disk, "", f"Of the plant shown, {channels}", not stable),
        ("Disk margin, worst" + ", sampled" * sampled, margins.worst_disk, "", worst, margins.worst_disk <= 0.0),
        ("Gain margin", _decibels(margins), "dB", "How far the shown channel's gain may rise and fall", False),
        ("Phase margin", margins.phase, "°", "What the shown channel may lose", False),
        ("Delay margin", 1e3 * margins.delay, "ms", "How much later the torque may come", False),
        ("Crossover of L", margins.crossover, "Hz", "Highest frequency at which the shown channel's gain is 1", False),
        ("Bandwidth", margins.bandwidth, "Hz", f"S of {axes} reaches 1/√2", False),
        ("Damping", margins.damping, "", damping, margins.damping <= 0.0),
    )
    out = []
    for label, x, unit, tip, bad in rows:
        # Of a loop that is not stable these have no meaning.
        known = stable or label.startswith(("Disk", "Crossover", "Damping"))
        shown = x if isinstance(x, str) else plain_number(None if x is None else HZ * x if unit == "Hz" else x)
        out.append({"label": label, "value": shown if known else None, "unit": unit, "tip": tip, "bad": bad})
    return out


def _decibels(margins: Margins) -> str | None:
    if not margins.gain_up > 0.0:
        return None
    up = "∞" if math.isinf(margins.gain_up) else f"{20 * math.log10(margins.gain_up):.1f}"
    down = "−∞" if margins.gain_down <= 0.0 else f"{20 * math.log10(margins.gain_down):.1f}".replace("-", "−")
    return f"+{up} {down}"
