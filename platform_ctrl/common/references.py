"""Named tuples that compiled functions hand on as one pointer.

By itself numba hands on every number of a tuple, and eight of every array: most of the code of a call, and of the time
that takes to compile.
"""

from __future__ import annotations

from typing import Any

from llvmlite import ir
from numba import types
from numba.core import cgutils
from numba.core.imputils import lower_getattr_generic
from numba.core.typing.templates import AttributeTemplate, infer_getattr
from numba.extending import NativeValue, models, register_model, typeof_impl, unbox


class Reference(types.Type):
    """A named tuple by reference; `instance_class` says which."""

    def __init__(self, instance_class: Any, members: tuple[types.Type, ...]) -> None:
        self.instance_class, self.members = instance_class, members
        super().__init__(name=f"reference({instance_class.__module__}.{instance_class.__name__}, {members})")

    def place(self, name: str) -> int:
        """Return which member has a name."""
        return int(self.instance_class._fields.index(name))


@register_model(Reference)
class _Model(models.PrimitiveModel):
    def __init__(self, manager: Any, kind: Reference) -> None:
        members = ir.LiteralStructType([manager.lookup(member).get_data_type() for member in kind.members])
        super().__init__(manager, kind, members.as_pointer())


def hand_on_by_reference(*tuples: type) -> None:
    """Let compiled functions hand on these named tuples, whose members stay as they are meanwhile, by reference."""
    for kind in tuples:
        typeof_impl.register(kind)(
            lambda value, context: Reference(type(value), tuple(typeof_impl(member, context) for member in value))
        )


@unbox(Reference)
def _unboxed(kind: Reference, value: Any, c: Any) -> Any:
    pointer = cgutils.alloca_once(c.builder, c.context.get_value_type(kind).pointee)
    wrong = cgutils.false_bit
    for k, member in enumerate(kind.members):
        item = c.pyapi.tuple_getitem(value, k)  # borrowed
        native = c.unbox(member, item)
        wrong = c.builder.or_(wrong, native.is_error)
        data = c.context.data_model_manager[member].as_data(c.builder, native.value)
        c.builder.store(data, cgutils.gep_inbounds(c.builder, pointer, 0, k))
    return NativeValue(pointer, is_error=wrong)


@infer_getattr
class _Members(AttributeTemplate):
    key = Reference

    def generic_resolve(self, kind: Reference, name: str) -> Any:
        return kind.members[kind.place(name)] if name in kind.instance_class._fields else None


@lower_getattr_generic(Reference)
def _member(context: Any, builder: Any, kind: Reference, value: Any, name: str) -> Any:
    k = kind.place(name)
    data = builder.load(cgutils.gep_inbounds(builder, value, 0, k))
    data.set_metadata("invariant.load", builder.module.add_metadata([]))
    return context.data_model_manager[kind.members[k]].from_data(builder, data)
