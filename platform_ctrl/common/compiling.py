"""How the functions of the kernel are compiled: those that Python calls are kept, the others are parts of these.

By itself numba optimises every function together with all that it calls, and makes machine code of them: what lies n
calls deep n times. A part is typed and translated alone; the costly optimisations and machine code are for what Python
calls.
"""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any, TypeVar, cast

import numba
from numba.core.codegen import JITCodeLibrary
from numba.core.compiler import Compiler
from numba.core.compiler_lock import global_compiler_lock
from numba.extending import overload

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
        _compile_in_one_process(dispatcher)
    return cast(F, dispatcher)


def _stamp(source: Path) -> tuple[float, int]:
    """Newest change and total size of the files beside a source file, and of those that say how it is compiled."""
    own = Path(__file__)
    shared = [own, own.with_name("simd.py"), own.with_name("references.py")]
    files = [file.stat() for file in (*shared, *sorted(source.parent.glob("*.py")))]
    return max(file.st_mtime for file in files), sum(file.st_size for file in files)


def _compile_in_one_process(dispatcher: Any) -> None:
    """Let other processes that need a cached function wait for the first, and take what that keeps."""
    compile_or_load, held = dispatcher.compile, False

    def compiled(signature: Any) -> Any:
        nonlocal held
        # numba's lock first: a thread must not wait for it with a file that the one which has it may need.
        with global_compiler_lock:
            if held or signature in dispatcher.overloads:
                return compile_or_load(signature)
            held = True
            try:
                with _alone(Path(dispatcher.stats.cache_path), dispatcher.py_func):
                    return compile_or_load(signature)
            finally:
                held = False

    dispatcher.compile = compiled


@contextlib.contextmanager
def _alone(folder: Path, function: Any) -> Iterator[None]:
    """Wait until no other process has the lock of a function; one that ends without a word loses it."""
    with contextlib.ExitStack() as stack:
        # Without such locks, or with nowhere to put the file, both compile.
        with contextlib.suppress(ImportError, OSError):
            import fcntl

            folder.mkdir(parents=True, exist_ok=True)
            name = f"{function.__module__}.{function.__qualname__}.lock"
            file = stack.enter_context((folder / name).open("ab"))
            fcntl.flock(file, fcntl.LOCK_EX)
        yield
