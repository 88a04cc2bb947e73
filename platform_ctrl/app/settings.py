"""What the designer's page is set to, its sliders and its lists, as frozen values."""

from __future__ import annotations

import dataclasses
from collections import deque
from collections.abc import Mapping
from dataclasses import field
from typing import Any, Literal, NamedTuple

from platform_ctrl.common.values import value

Mode = Literal["caged", "stabilised"]
Group = Literal["gains", "lead", "notch", "lag", "design", "sampling", "rotors", "Omega"]

# Option → number, in the units of the job file; by design; by loop.
Options = Mapping[str, float]
LoopOptions = Mapping[str, Mapping[str, Options]]


class Conditions(NamedTuple):
    """All that a design of a method depends on: equal conditions give the same controller.

    Attributes
    ----------
    options
        Name and number of each option, sorted by name.
    rate_hz, delay
        Sample rate, Hz, and time from sample to torque, s.
    spins
        Name and spin of each rotor, rad/s, sorted by name.
    Omega : (3,)
        Largest platform rate about each axis, rad/s.
    """

    options: tuple[tuple[str, float], ...]
    rate_hz: float
    delay: float
    spins: tuple[tuple[str, float], ...]
    Omega: tuple[float, ...]

    def data(self) -> dict[str, Any]:
        """Return everything as JSON knows it."""
        out: dict[str, Any] = self._asdict()
        return out | {"options": dict(self.options), "spins": dict(self.spins), "Omega": list(self.Omega)}


@value
class Settings:
    """All that a page is set to; every part is plain data, so that a link can hold it.

    Attributes
    ----------
    mode
        ``"caged"``: Omega is prescribed, a caging loop is shown; ``"stabilised"``: the platform is free, all loops are
        closed, and the servo on the platform is shown.
    loop, design
        Names of the loop and of its design that is worked on.
    options
        Loop → design → option → number, in the units of the job file.
    optional
        Loop → design → names of the optional parts that are switched on: ``"lag"``, ``"notch"``, ``"spin_notch"``.
    rate_hz, delay
        Sample rate, Hz, and time from sample to torque, s.
    spins
        Rotor → spin relative to its carrier, rad/s.
    Omega : (3,)
        Platform rate at which the plants are shown, rad/s. Beyond the job's range it widens that range.
    plant
        Label of the plant of the set that is shown.
    band
        Whether all plants of the set are shown around it.
    fixed
        Names of sliders that neither drag nor tuning moves.
    overlays
        Names of other designs of the loop that are shown as well.
    channel
        Torquer at which the loop is shown broken, all others closed.
    axis
        Root axis of the responses to Omega, or to a torque on the platform: 1 to 3.
    closed
        Loop → name of the design that is closed there, while another loop is worked on and in what is saved.
    designed_for
        Loop → design → the conditions for which the controller that the page shows was designed. Without an entry it is
        the one for the settings as they are; with one it stays while rotors, sampling or platform rate are moved.
    """

    mode: Mode
    loop: str
    design: str
    options: LoopOptions
    optional: Mapping[str, Mapping[str, tuple[str, ...]]]
    rate_hz: float
    delay: float
    spins: Mapping[str, float]
    Omega: tuple[float, float, float]
    plant: str = "nominal"
    band: bool = True
    fixed: frozenset[str] = frozenset()
    overlays: tuple[str, ...] = ()
    channel: str = ""
    axis: int = 1
    closed: Mapping[str, str] = field(default_factory=dict)
    designed_for: Mapping[str, Mapping[str, Conditions]] = field(default_factory=dict)

    def but(self, **changes: Any) -> Settings:
        """Return these settings with some of them changed."""
        return dataclasses.replace(self, **changes)

    def parts_on(self, loop: str, design: str) -> tuple[str, ...]:
        """Return the optional parts of a design that are switched on."""
        return self.optional.get(loop, {}).get(design, ())

    def data(self) -> dict[str, Any]:
        """Return everything as JSON knows it; two settings are the same where these dicts are."""
        out: dict[str, Any] = {one.name: getattr(self, one.name) for one in dataclasses.fields(self)}
        out["options"] = {
            loop: {design: dict(options) for design, options in designs.items()}
            for loop, designs in self.options.items()
        }
        out["optional"] = {
            loop: {design: sorted(parts) for design, parts in designs.items()}
            for loop, designs in self.optional.items()
        }
        out["closed"] = dict(self.closed)
        out["designed_for"] = {
            loop: {design: conditions.data() for design, conditions in designs.items()}
            for loop, designs in self.designed_for.items()
        }
        out["spins"], out["Omega"] = dict(self.spins), list(self.Omega)
        out["fixed"], out["overlays"] = sorted(self.fixed), list(self.overlays)
        return out


@value
class Slider:
    """A number of the settings that a slider moves.

    Attributes
    ----------
    name
        What `Backend.moved` calls it: ``crossover_hz``, ``rate_hz``, ``delay``, ``spin 11``, ``Omega1``, ...
    label, unit
        For people.
    group
        Where it stands: ``"gains"``, ``"lead"``, ``"notch"``, ``"lag"``, ``"design"`` (options of a method that
        designs), ``"sampling"``, ``"rotors"`` or ``"Omega"``.
    low, high, value
        Ends of the slider, and where it stands. A number beyond the ends may be typed.
    logarithmic
        Whether equal steps are equal factors.
    tip
        A line that says what it does.
    fixed
        Whether drag and tuning leave it alone.
    part
        The optional part that it belongs to (see `Settings`), else empty.
    tunable
        Whether drag and tuning may move it.
    background
        Whether moving it asks for a new design, which takes seconds (`Backend.redesign`).
    """

    name: str
    label: str
    unit: str
    group: Group
    low: float
    high: float
    value: float
    logarithmic: bool = True
    tip: str = ""
    fixed: bool = False
    part: str = ""
    tunable: bool = False
    background: bool = False


@value
class Part:
    """A part of a controller that is there or not: a lag or a notch.

    Attributes
    ----------
    name, label
        ``"lag"``, ``"notch"`` or ``"spin_notch"``, and what people call it.
    on
        Whether it is there.
    tip
        A line that says what it does.
    """

    name: str
    label: str
    on: bool
    tip: str = ""


@value
class Choices:
    """What a page lets choose from; no slider changes it.

    Attributes
    ----------
    loops
        Names of the job's loops.
    designs
        Loop → names of its designs.
    methods
        Loop → design → method.
    channels
        Loop → torquers at which it may be shown broken.
    manoeuvres
        Names of the job's manoeuvres.
    """

    loops: tuple[str, ...]
    designs: dict[str, tuple[str, ...]] = field(default_factory=dict)
    methods: dict[str, dict[str, str]] = field(default_factory=dict)
    channels: dict[str, tuple[str, ...]] = field(default_factory=dict)
    manoeuvres: tuple[str, ...] = ()


class History:
    """Where a page was, and where it came back from."""

    def __init__(self, first: Settings, room: int = 200) -> None:
        self.now = first
        self._past: deque[Settings] = deque(maxlen=room)
        self._future: deque[Settings] = deque(maxlen=room)

    @property
    def can_undo(self) -> bool:
        """Whether there is something to go back to."""
        return bool(self._past)

    @property
    def can_redo(self) -> bool:
        """Whether something was taken back that can be done again."""
        return bool(self._future)

    def put(self, settings: Settings) -> None:
        """Go on to other settings; what was taken back before is forgotten. The same settings are no step."""
        if settings is self.now or settings.data() == self.now.data():
            return
        self._past.append(self.now)
        self._future.clear()
        self.now = settings

    def replace(self, settings: Settings) -> None:
        """Change where the page is without a step: while a slider is held, only its last place counts."""
        self.now = settings

    def undo(self) -> Settings:
        """Go one step back, or stay where there is none."""
        if self._past:
            self._future.append(self.now)
            self.now = self._past.pop()
        return self.now

    def redo(self) -> Settings:
        """Go forward again what was taken back, or stay."""
        if self._future:
            self._past.append(self.now)
            self.now = self._future.pop()
        return self.now
