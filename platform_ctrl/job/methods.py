"""Design methods in a job file: a design of a loop, and the registry that the job reader asks.

The methods themselves are `design.method.Method`, above the job; `design.methods` registers those of the package.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import field
from typing import Annotated, Any, ClassVar, Literal, TypeVar, get_args

from platform_ctrl.common.values import input_value
from platform_ctrl.errors import ArgumentError
from platform_ctrl.job.drive import CommandShaping, Feedforward
from platform_ctrl.plant import fields
from platform_ctrl.plant.mistakes import Misfit, given, wrong
from platform_ctrl.plant.tables import TABLE, Collected, unknown_key

Structure = Literal["cross-axis", "pid", "sections", "state-space"]
LoopKind = Literal["caging", "rate", "pointing", "tracking", "stabilisation"]


class JobMethod:
    """What a job file may say of a way to design a loop.

    Attributes
    ----------
    key
        What ``method`` is in the job file.
    kinds
        Which loops it designs.
    options
        The numbers that it takes, all > 0, by their keys in the job file.
    structures
        What ``structure`` may be; none: the key is refused.
    tunes
        Whether ``tune = true`` is accepted.
    any_sensors
        Whether it works on angles and rates in one loop, and on more readings than torquers one by one.
    responses
        Whether it works on measured responses, which the key ``responses`` names.
    """

    key: ClassVar[str]
    kinds: ClassVar[tuple[LoopKind, ...]] = ("caging", "rate", "pointing", "tracking")
    options: ClassVar[Mapping[str, object]]
    structures: ClassVar[tuple[Structure, ...]] = ()
    tunes: ClassVar[bool] = False
    any_sensors: ClassVar[bool] = False
    responses: ClassVar[bool] = False

    def expect_responses(
        self, text: str, label: str, torques: Sequence[str], readings: Sequence[str], period: float
    ) -> None:
        """Raise an `InputError` where a file's text, called `label`, holds no responses of a loop's sampled signals."""


# By key, in the order in which messages and the documentation name them.
METHODS: dict[str, JobMethod] = {}

AnyMethod = TypeVar("AnyMethod", bound=JobMethod)


def register_method(method: type[AnyMethod]) -> type[AnyMethod]:
    """Add a class of design methods; its key must be new."""
    if method.key in METHODS:
        raise ArgumentError(f"register_method: there is a method {method.key!r} already; choose another key")
    METHODS[method.key] = method()
    return method


@input_value
class DesignSpec:
    """One way to design a loop.

    Attributes
    ----------
    name
        What the design is called in tables and plots.
    method
        Key of the method that makes it: see `job.methods`.
    options
        The method's own numbers, by the names of the job file, in SI units.
    tune
        Whether the method may move the options to meet the loop's limits.
    structure
        What a structured controller is made of; None leaves it to the method.
    command
        What it does with commands; None: u = K (y − command) where the loop is commanded.
    sensors
        What this design of a rate or pointing loop reads; none: the loop's.
    feedforward
        Of the platform's rate, or None.
    responses
        Text of a file of measured responses of the loop's plant, or None; before the job is read in whole, its path.
    """

    name: fields.SystemName
    method: Annotated[str, fields.one_of(METHODS)]
    options: Annotated[dict[str, float], Collected(others=fields.NUMBER)] = field(default_factory=dict)
    tune: fields.Truth = False
    structure: Annotated[Structure, fields.one_of(get_args(Structure))] | None = None
    command: Annotated[CommandShaping | None, TABLE] = None
    sensors: fields.Names = ()
    feedforward: Annotated[Feedforward | None, TABLE] = None
    responses: fields.AnyText | None = None

    @staticmethod
    def _misfits(table: Mapping[str, Any]) -> Iterator[Misfit]:
        name = table["method"]
        method = METHODS[name]
        known = ["name", "method", *(["structure"] if method.structures else ())]
        known += ["responses"] if method.responses else []
        known += ["tune", *DESIGN_SIGNALS, *sorted(method.options), "command"]
        for key, item in table.items():
            if key not in known:
                yield key, unknown_key((key,), item, known).words
            elif key in method.options and not item > 0.0:
                yield wrong(table, key, "a number > 0")
        if table.get("tune") and not method.tunes:
            tuned = ", ".join(given(one) for one in sorted(METHODS) if METHODS[one].tunes)
            yield "tune", f"tune must be false: method {given(name)} has no tuner; methods that have one: {tuned}"


# Keys of a design that are about signals, and the loops whose designs have them.
DESIGN_SIGNALS, WITH_SIGNALS = ("sensors", "feedforward"), ("rate", "pointing")


def kind_misfits(design: Mapping[str, Any], kind: LoopKind) -> Iterator[tuple[str, str]]:
    """Yield what a design has that does not go with the kind of its loop."""
    if kind not in METHODS[design["method"]].kinds:
        expected = " or ".join(given(name) for name, one in METHODS.items() if kind in one.kinds)
        words = f"method must be one for a {kind} loop, {expected}, got {given(design['method'])}"
        yield "method", words
    if "command" in design and kind in ("caging", "stabilisation"):
        yield "command", f"command has no effect in a {kind} loop, which holds zero; leave it out"
    for key in DESIGN_SIGNALS if kind not in WITH_SIGNALS else ():
        if key in design:
            words = f"{key} belongs to designs of rate and pointing loops alone; leave it out of this {kind} loop"
            yield key, words
