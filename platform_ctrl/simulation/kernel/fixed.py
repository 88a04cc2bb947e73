"""What is known when a kernel for the GPU is compiled: a named tuple whose members are constants of its code.

How the bodies hang together and where their slots are is the same in every scenario of a plant. Written into the code
it takes a third of the instructions away: sums of addresses, and branches for what the plant does not have. The
functions see `Fixed` as the tuple that it holds. numba-cuda alone knows this type.
"""

# It speaks to numba-cuda in untyped terms, of which the older form within numba, seen where that is absent, lacks some.
# mypy: disable-error-code="attr-defined,misc,name-defined,no-untyped-call,untyped-decorator"

from __future__ import annotations

import pickle
from hashlib import sha256
from typing import Any

from numba.cuda import types
from numba.cuda.cudadecl import registry
from numba.cuda.cudaimpl import lower_constant, lower_getattr_generic
from numba.cuda.extending import core_models, register_model, typeof_impl
from numba.cuda.typing.templates import AttributeTemplate
from numba.cuda.typing.typeof import typeof


class Fixed:
    """A named tuple of numbers and arrays that a kernel has as constants; equal if all of it is."""

    def __init__(self, value: Any) -> None:
        self.value = value
        self.key = sha256(pickle.dumps(tuple(value))).hexdigest()[:16]

    def __eq__(self, other: object) -> bool:
        return isinstance(other, Fixed) and self.key == other.key

    def __hash__(self) -> int:
        return hash(self.key)


class _FixedType(types.Type):
    def __init__(self, fixed: Fixed) -> None:
        self.fixed = fixed
        super().__init__(name=f"Fixed{fixed.key}")


@typeof_impl.register(Fixed)
def _type_of_fixed(fixed: Fixed, context: Any) -> Any:
    return _FixedType(fixed)


register_model(_FixedType)(core_models.OpaqueModel)


@lower_constant(_FixedType)
def _constant(context: Any, builder: Any, kind: Any, fixed: Fixed) -> Any:
    return context.get_dummy_value()


@registry.register_attr
class _Members(AttributeTemplate):
    key = _FixedType

    def generic_resolve(self, kind: Any, name: str) -> Any:
        return typeof(getattr(kind.fixed.value, name))


@lower_getattr_generic(_FixedType)
def _member(context: Any, builder: Any, kind: Any, fixed: Any, name: str) -> Any:
    number = getattr(kind.fixed.value, name)
    return context.get_constant_generic(builder, typeof(number), number)
