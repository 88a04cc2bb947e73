"""How the functions of the kernel are compiled: those that Python calls are kept, the others are parts of these.

By itself numba optimises every function together with all that it calls, and makes machine code of them: what lies n
calls deep n times. A part is typed and translated alone; the costly optimisations and machine code are for what Python
calls.

Named tuples are handed on as one pointer, see `hand_on_by_reference`: by itself numba hands on every number of a tuple,
and eight of every array: most of the code of a call, and of the time that takes to compile.
"""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any, TypeVar, cast

import numba
from llvmlite import ir
from numba import types
from numba.core import cgutils
from numba.core.codegen import JITCodeLibrary
from numba.core.compiler import Compiler
from numba.core.imputils import lower_getattr_generic
from numba.core.typing.templates import AttributeTemplate, infer_getattr
from numba.extending import NativeValue, models, overload, register_model, typeof_impl, unbox

F = TypeVar("F", bound=Callable[..., Any])


class _NoMachineCode:
    """What numba asks to prepare machine code for its environment, where there is none."""

    @staticmethod
    def set_env(name: str, env: object) -> None:
        """Set nothing."""


class _Part(JITCodeLibrary):
    """A function to be linked into its callers; of its own methods numba calls these."""

    def _optimize_final_module(self) -> None:
        """Do the cheap half, which inlines what is to be; the rest is left to the callers."""
        passes, builder = self._codegen._module_pass_manager(
            loop_vectorize=False, slp_vectorize=False, opt=0, cost="cheap"
        )
        passes.run(self._final_module, builder)

    def _finalize_final_module(self) -> None:
        self._finalize_dynamic_globals()
        self._finalized = True

    def get_pointer_to_function(self, name: str) -> int:
        """Return 0: no such machine code."""
        self._ensure_finalized()
        return 0

    @property
    def codegen(self) -> Any:
        """What prepares machine code."""
        return _NoMachineCode


class PartCompiler(Compiler):
    """numba's compiler, for parts."""

    def define_pipelines(self) -> Any:
        """Return numba's own steps, which put what they make into a part."""
        self.state.library = _Part(self.state.targetctx.codegen(), self.state.func_id.func_qualname)
        return super().define_pipelines()


_njit: Any = numba.njit  # its types know nothing of the switches for wrappers

# error_model="numpy": a vanishing pivot becomes inf or NaN instead of an exception in the middle of a run.
# No "nrt": no array is made within, and none of those given is counted in and out of every call.
_OPTIONS: dict[str, Any] = {"_nrt": False, "nogil": True, "error_model": "numpy", "fastmath": {"contract"}}
# Without wrappers for Python and C, which take as long as a small function.
_PART = _OPTIONS | {"no_cpython_wrapper": True, "no_cfunc_wrapper": True, "pipeline_class": PartCompiler}


def internal(function: F) -> F:
    """Compile for compiled callers alone, within which it is kept."""
    return cast(F, _njit(**_PART)(function))


def inlined(function: F) -> F:
    """Compile into every caller."""
    return cast(F, _njit(forceinline=True, **_PART)(function))


def overloading(function: Callable[..., Any]) -> Callable[[F], F]:
    """Return what marks the choice, by the types of the arguments, of code that compiled callers run as a function."""
    return cast(Callable[[F], F], overload(function, strict=False, jit_options=_PART))


def compiled(function: F) -> F:
    """Compile a function that Python calls, and keep the result until any file beside it changes."""
    try:
        dispatcher = _njit(cache=True, **_OPTIONS)(function)
    except RuntimeError:  # nowhere to keep a cache: compile in every process
        return cast(F, _njit(**_OPTIONS)(function))
    if hasattr(dispatcher, "_cache"):  # not with NUMBA_DISABLE_JIT, where it is the plain function
        # What was compiled by another "version" is not even unpickled: its types may have been in another module.
        dispatcher._cache._cache_file._version += f" {_stamp(Path(function.__code__.co_filename))}"
    return cast(F, dispatcher)


def _stamp(source: Path) -> tuple[float, int]:
    """Newest change and total size of the files beside a source file, and of those that say how it is compiled."""
    own = Path(__file__)
    shared = [own, own.with_name("simd.py")]
    files = [file.stat() for file in (*shared, *sorted(source.parent.glob("*.py")))]
    return max(file.st_mtime for file in files), sum(file.st_size for file in files)


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
