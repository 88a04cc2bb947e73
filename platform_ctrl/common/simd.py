"""Eight numbers in one register: the number type of the kernel.

A memory of the kernel is an array (slots, LANES): a slot holds one quantity of LANES scenarios side by side. `load`
takes a slot of it in one piece as a lane, a number like any other in the code that computes with it: LLVM's vector of
eight doubles, which compilers of this kind do not find by themselves in code with branches and short loops. Where
scenarios differ, comparisons give a mask and `choose` picks.

In plain Python the same code runs one scenario, whose memory is (slots,).
"""

from __future__ import annotations

import math
import operator
from collections.abc import Callable
from typing import Any, ClassVar

import numpy as np
from llvmlite import ir
from numba import types
from numba.core import cgutils
from numba.core.imputils import lower_builtin, lower_cast
from numba.core.typing.templates import AbstractTemplate, infer_global, signature
from numba.extending import models, register_model

from platform_ctrl.common.values import FloatArray

LANES = 8

# A number of the kernel: one float, or LANES of them; a mask likewise. For readers and type checkers.
Number = Any
Mask = Any


class _Vector(types.Type):
    """LANES numbers, the bits of a mask, or where such numbers begin, as LLVM has them."""

    def __init__(self, name: str, vector: Any) -> None:
        super().__init__(name=f"{name}{LANES}")
        self.vector = vector


@register_model(_Vector)
class _VectorModel(models.PrimitiveModel):
    def __init__(self, manager: Any, kind: Any) -> None:
        super().__init__(manager, kind, kind.vector)


_VECTOR, _BITS = ir.VectorType(ir.DoubleType(), LANES), ir.VectorType(ir.IntType(1), LANES)
_lane, _mask = _Vector("Lane", _VECTOR), _Vector("LaneMask", _BITS)
_slots = _Vector("Slots", ir.DoubleType().as_pointer())


class _Typed(AbstractTemplate):
    """What says the type of a call; what is made for a target is asked before numba's own, of which there are many."""

    metadata: ClassVar[dict[str, str]] = {"target": "cpu"}


def memory(slots: int) -> FloatArray:
    """Return zeros (slots, LANES) that begin at a cache line, so that a slot does not straddle two."""
    size = slots * LANES
    raw = np.zeros(size + 8)
    start = (-raw.ctypes.data // 8) % 8
    return raw[start : start + size].reshape(slots, LANES)


# Arithmetic.

_FLAGS = ("contract",)


def _widened(builder: Any, kind: Any, number: Any) -> Any:
    """A scalar as a lane that holds it LANES times."""
    if kind == _lane:
        return number
    if isinstance(kind, types.Integer):
        number = builder.sitofp(number, ir.DoubleType())
    one = builder.insert_element(ir.Constant(_VECTOR, ir.Undefined), number, ir.Constant(ir.IntType(32), 0))
    return builder.shuffle_vector(
        one, ir.Constant(_VECTOR, ir.Undefined), ir.Constant(ir.VectorType(ir.IntType(32), LANES), [0] * LANES)
    )


def _binary(name: Any, result: Any, emit: Callable[[Any, Any, Any], Any]) -> None:
    @infer_global(name)
    class _Typing(_Typed):
        def generic(self, args: Any, kws: Any) -> Any:
            if len(args) == 2 and not kws and _lane in args:
                given = [types.unliteral(kind) for kind in args]
                if all(kind == _lane or isinstance(kind, (types.Float, types.Integer)) for kind in given):
                    return signature(result, *given)
            return None

    def lower(context: Any, builder: Any, sig: Any, args: Any) -> Any:
        a, b = (_widened(builder, kind, number) for kind, number in zip(sig.args, args, strict=True))
        return emit(builder, a, b)

    for kinds in ((_lane, _lane), (_lane, types.Float), (types.Float, _lane), (_lane, types.Integer)):
        lower_builtin(name, *kinds)(lower)
    lower_builtin(name, types.Integer, _lane)(lower)


for _name, _emit in (
    (operator.add, lambda builder, a, b: builder.fadd(a, b, flags=_FLAGS)),
    (operator.sub, lambda builder, a, b: builder.fsub(a, b, flags=_FLAGS)),
    (operator.mul, lambda builder, a, b: builder.fmul(a, b, flags=_FLAGS)),
    (operator.truediv, lambda builder, a, b: builder.fdiv(a, b)),
):
    _binary(_name, _lane, _emit)


def _compare(sign: str) -> Callable[[Any, Any, Any], Any]:
    return lambda builder, a, b: builder.fcmp_ordered(sign, a, b)


_SIGNS = {"lt": "<", "le": "<=", "gt": ">", "ge": ">=", "eq": "==", "ne": "!="}
for _order, _sign in _SIGNS.items():
    _binary(getattr(operator, _order), _mask, _compare(_sign))


def _of_vectors(name: Any, result: Any, emit: Callable[..., Any], *kinds: Any) -> None:
    """Make an operator or a function of vectors of these kinds."""

    @infer_global(name)
    class _Typing(_Typed):
        def generic(self, args: Any, kws: Any) -> Any:
            return signature(result, *kinds) if tuple(args) == kinds else None

    lower_builtin(name, *kinds)(lambda context, builder, sig, args: emit(builder, *args))


_of_vectors(operator.neg, _lane, lambda builder, a: builder.fneg(a), _lane)
_of_vectors(operator.and_, _mask, lambda builder, a, b: builder.and_(a, b), _mask, _mask)
_of_vectors(operator.or_, _mask, lambda builder, a, b: builder.or_(a, b), _mask, _mask)
_of_vectors(operator.invert, _mask, lambda builder, a: builder.not_(a), _mask)


@lower_cast(types.Float, _lane)
@lower_cast(types.Integer, _lane)
def _cast(context: Any, builder: Any, given: Any, wanted: Any, number: Any) -> Any:
    return _widened(builder, given, number)


# Memory.


def load(memory: FloatArray, slot: int) -> Number:
    """Return a slot of the memory."""
    return memory[slot]


def store(memory: FloatArray, slot: int, number: Number) -> None:
    """Put a number into a slot of the memory."""
    memory[slot] = number


def load_one(memory: FloatArray, slot: int, column: int) -> float:
    """Return what one scenario has in a slot."""
    return float(memory[slot, column])


def store_one(memory: FloatArray, slot: int, column: int, number: float) -> None:
    """Put what one scenario has into a slot."""
    memory[slot, column] = number


def slots(memory: FloatArray) -> FloatArray:
    """Return a memory (slots, LANES) as compiled functions hand it on: by where it begins."""
    return memory


def _typed(function: Any, result: Any) -> None:
    """Say the type of what a function returns."""

    @infer_global(function)
    class _Typing(_Typed):
        def generic(self, args: Any, kws: Any) -> Any:
            return signature(result, *(types.unliteral(kind) for kind in args))


_typed(slots, _slots)
_typed(load, _lane)
_typed(load_one, types.float64)
_typed(store, types.none)
_typed(store_one, types.none)


@lower_builtin(slots, types.Array)
def _slots_of(context: Any, builder: Any, sig: Any, args: Any) -> Any:
    return context.make_array(sig.args[0])(context, builder, args[0]).data


def _place(context: Any, builder: Any, kinds: Any, given: Any) -> Any:
    """Where the first number of a slot is."""
    data, slot = given
    if kinds[0] != _slots:
        data = context.make_array(kinds[0])(context, builder, data).data
    return builder.gep(data, [builder.mul(slot, ir.Constant(slot.type, LANES))])


@lower_builtin(load, types.Any, types.Integer)
def _load(context: Any, builder: Any, sig: Any, args: Any) -> Any:
    place = _place(context, builder, sig.args, args)
    return builder.load(builder.bitcast(place, _VECTOR.as_pointer()), align=8)


@lower_builtin(load_one, types.Any, types.Integer, types.Integer)
def _load_one(context: Any, builder: Any, sig: Any, args: Any) -> Any:
    return builder.load(builder.gep(_place(context, builder, sig.args, args[:2]), [args[2]]), align=8)


@lower_builtin(store, types.Any, types.Integer, types.Any)
def _store(context: Any, builder: Any, sig: Any, args: Any) -> Any:
    place = builder.bitcast(_place(context, builder, sig.args, args[:2]), _VECTOR.as_pointer())
    builder.store(_widened(builder, sig.args[2], args[2]), place, align=8)
    return context.get_dummy_value()


@lower_builtin(store_one, types.Any, types.Integer, types.Integer, types.Any)
def _store_one(context: Any, builder: Any, sig: Any, args: Any) -> Any:
    place = builder.gep(_place(context, builder, sig.args, args[:2]), [args[2]])
    builder.store(context.cast(builder, args[3], sig.args[3], types.float64), place, align=8)
    return context.get_dummy_value()


# Elementary functions.


def choose(mask: Mask, a: Number, b: Number) -> Number:
    """Return a where the mask holds, else b."""
    return a if mask else b


def anywhere(mask: Mask) -> bool:
    """Return whether the mask holds in any scenario."""
    return bool(mask)


def root(x: Number) -> Number:
    """Return the square root."""
    return math.sqrt(x)


def whole(x: Number) -> Number:
    """Return the largest whole number not above x, as a float."""
    return math.floor(x)


def lesser(a: Number, b: Number) -> Number:
    """Return the smaller of two numbers."""
    return choose(a < b, a, b)


def greater(a: Number, b: Number) -> Number:
    """Return the larger of two numbers."""
    return choose(a > b, a, b)


def power_of_two(k: Number) -> Number:
    """Return 2 to the whole number k, from -1022 to 1023."""
    return math.ldexp(1.0, int(k))


def mantissa(x: Number) -> Number:
    """Return m in [1, 2) of x = m 2^e with a whole number e, for a normal x > 0."""
    return 2.0 * math.frexp(x)[0]


def exponent(x: Number) -> Number:
    """Return the whole number e of x = m 2^e with m in [1, 2), for a normal x > 0."""
    return float(math.frexp(x)[1] - 1)


@infer_global(choose)
class _Choose(_Typed):
    def generic(self, args: Any, kws: Any) -> Any:
        return signature(_lane, *(types.unliteral(kind) for kind in args)) if args[0] == _mask else None


@lower_builtin(choose, _mask, types.Any, types.Any)
def _choose(context: Any, builder: Any, sig: Any, args: Any) -> Any:
    a, b = (_widened(builder, kind, number) for kind, number in zip(sig.args[1:], args[1:], strict=True))
    return builder.select(args[0], a, b)


_WHOLE, _LANES = ir.VectorType(ir.IntType(64), LANES), ir.IntType(LANES)


def _repeated(number: int) -> Any:
    return ir.Constant(_WHOLE, [number] * LANES)


def _by_llvm(name: str) -> Callable[[Any, Any], Any]:
    def emit(builder: Any, x: Any) -> Any:
        kind = ir.FunctionType(_VECTOR, [_VECTOR])
        return builder.call(cgutils.get_or_insert_function(builder.module, kind, f"llvm.{name}.v{LANES}f64"), [x])

    return emit


def _emit_power(builder: Any, k: Any) -> Any:
    biased = builder.add(builder.fptosi(k, _WHOLE), _repeated(1023))
    return builder.bitcast(builder.shl(biased, _repeated(52)), _VECTOR)


def _emit_mantissa(builder: Any, x: Any) -> Any:
    bits = builder.and_(builder.bitcast(x, _WHOLE), _repeated((1 << 52) - 1))
    return builder.bitcast(builder.or_(bits, _repeated(1023 << 52)), _VECTOR)


def _emit_exponent(builder: Any, x: Any) -> Any:
    bits = builder.lshr(builder.bitcast(x, _WHOLE), _repeated(52))
    return builder.sitofp(builder.sub(bits, _repeated(1023)), _VECTOR)


def _emit_anywhere(builder: Any, mask: Any) -> Any:
    return builder.icmp_unsigned("!=", builder.bitcast(mask, _LANES), ir.Constant(_LANES, 0))


def _emit_choice(sign: str) -> Callable[[Any, Any, Any], Any]:
    return lambda builder, a, b: builder.select(builder.fcmp_ordered(sign, a, b), a, b)


_of_vectors(root, _lane, _by_llvm("sqrt"), _lane)
_of_vectors(whole, _lane, _by_llvm("floor"), _lane)
_of_vectors(power_of_two, _lane, _emit_power, _lane)
_of_vectors(mantissa, _lane, _emit_mantissa, _lane)
_of_vectors(exponent, _lane, _emit_exponent, _lane)
_of_vectors(anywhere, types.boolean, _emit_anywhere, _mask)
_binary(lesser, _lane, _emit_choice("<"))
_binary(greater, _lane, _emit_choice(">"))
