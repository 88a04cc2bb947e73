"""What a job file may say of design methods: the registry that the job reader asks.

The methods themselves are `design.method.Method`, above the job; `design.methods` registers those of the package.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, ClassVar, Literal, TypeVar

from platform_ctrl.errors import ArgumentError

if TYPE_CHECKING:
    from platform_ctrl.job.job import DesignSpec, Job, LoopSpec

Structure = Literal["cross-axis", "pid", "state-space"]
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
    responses
        Whether it works on measured responses, which the key ``responses`` names.
    """

    key: ClassVar[str]
    kinds: ClassVar[tuple[LoopKind, ...]] = ("caging", "rate", "pointing", "tracking")
    options: ClassVar[Mapping[str, object]]
    structures: ClassVar[tuple[Structure, ...]] = ()
    tunes: ClassVar[bool] = False
    responses: ClassVar[bool] = False

    def expect_responses(self, job: Job, spec: LoopSpec, design: DesignSpec, text: str, label: str) -> None:
        """Raise an `InputError` where a file's text, called `label`, holds no responses of a loop."""


# By key, in the order in which messages and the documentation name them.
METHODS: dict[str, JobMethod] = {}

AnyMethod = TypeVar("AnyMethod", bound=JobMethod)


def register_method(method: type[AnyMethod]) -> type[AnyMethod]:
    """Add a class of design methods; its key must be new."""
    if method.key in METHODS:
        raise ArgumentError(f"register_method: there is a method {method.key!r} already; choose another key")
    METHODS[method.key] = method()
    return method
