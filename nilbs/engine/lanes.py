"""Several numbers in one register of the processor: a type for compiled code.

Lanes hold 32 bytes: eight float32 or four float64. They are added, multiplied and compared lane by lane, in the same
way wherever the code stands, so that an answer does not depend on what LLVM makes of a loop.
"""

import operator
from typing import Any

from llvmlite import ir
from numba import types
from numba.core import cgutils
from numba.extending import intrinsic, models, overload, register_model
from numba.np.arrayobj import make_array

BYTES = 32
# A product and a sum may become one rounding.
FLAGS = ("contract",)


class Lanes(types.Type):
    """Numbers of one kind side by side."""

    def __init__(self, kind: types.Type, count: int) -> None:
        self.kind, self.count = kind, count
        super().__init__(name=f"Lanes({kind}, {count})")


@register_model(Lanes)
class _LanesModel(models.PrimitiveModel):
    def __init__(self, manager: Any, lanes: Lanes) -> None:
        one = ir.IntType(1) if lanes.kind == types.boolean else manager.lookup(lanes.kind).get_value_type()
        super().__init__(manager, lanes, ir.VectorType(one, lanes.count))


def _of(kind: types.Type) -> Lanes:
    return Lanes(kind, 8 * BYTES // kind.bitwidth)


@intrinsic
def spread(typing: Any, number: Any) -> Any:
    """The number in every lane."""
    lanes = _of(number)

    def code(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        vector = context.get_value_type(lanes)
        first = builder.insert_element(ir.Constant(vector, ir.Undefined), args[0], ir.Constant(ir.IntType(32), 0))
        zeros = ir.Constant(ir.VectorType(ir.IntType(32), lanes.count), None)
        return builder.shuffle_vector(first, ir.Constant(vector, ir.Undefined), zeros)

    return lanes(number), code


@intrinsic
def load(typing: Any, array: Any, i: Any, j: Any) -> Any:
    """The numbers array[i, j, :] of a contiguous array with as many as there are lanes."""
    lanes = _of(array.dtype)

    def code(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        whole = make_array(array)(context, builder, args[0])
        rows = cgutils.unpack_tuple(builder, whole.shape, 3)[1]
        index = [context.cast(builder, value, kind, types.intp) for value, kind in zip(args[1:], (i, j), strict=True)]
        offset = builder.mul(builder.add(builder.mul(index[0], rows), index[1]), rows.type(lanes.count))
        pointer = builder.bitcast(builder.gep(whole.data, [offset]), context.get_value_type(lanes).as_pointer())
        return builder.load(pointer, align=array.dtype.bitwidth // 8)

    return lanes(array, i, j), code


def _arithmetic(name: str) -> Any:
    @intrinsic
    def combined(typing: Any, a: Any, b: Any) -> Any:
        def code(context: Any, builder: Any, signature: Any, args: Any) -> Any:
            return getattr(builder, name)(*args, flags=FLAGS)

        return a(a, b), code

    return combined


def _comparison(sign: str) -> Any:
    @intrinsic
    def compared(typing: Any, a: Any, b: Any) -> Any:
        def code(context: Any, builder: Any, signature: Any, args: Any) -> Any:
            return builder.fcmp_ordered(sign, *args)

        return Lanes(types.boolean, a.count)(a, b), code

    return compared


def _operator(function: Any, combined: Any) -> None:
    @overload(function, strict=False)
    def operation(a: Any, b: Any) -> Any:
        if isinstance(a, Lanes) and a == b:
            return lambda a, b: combined(a, b)
        return None


_ARITHMETIC = {"fadd": (operator.add, operator.iadd), "fsub": (operator.sub,), "fmul": (operator.mul,)}
for _name, _functions in (_ARITHMETIC | {"fdiv": (operator.truediv,)}).items():
    for _function in _functions:
        _operator(_function, _arithmetic(_name))
for _function, _name in ((operator.lt, "<"), (operator.le, "<="), (operator.ge, ">="), (operator.eq, "==")):
    _operator(_function, _comparison(_name))


@intrinsic
def both(typing: Any, a: Any, b: Any) -> Any:
    """Where two comparisons hold."""

    def code(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        return builder.and_(*args)

    return a(a, b), code


@intrinsic
def choose(typing: Any, mask: Any, a: Any, b: Any) -> Any:
    """The numbers of a where a comparison holds, of b elsewhere."""

    def code(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        return builder.select(*args)

    return a(mask, a, b), code


@intrinsic
def smaller(typing: Any, a: Any, b: Any) -> Any:
    """The smaller numbers; b where a is not a number."""

    def code(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        return builder.select(builder.fcmp_ordered("<", *args), *args)

    return a(a, b), code


@intrinsic
def larger(typing: Any, a: Any, b: Any) -> Any:
    """The larger numbers; b where a is not a number."""

    def code(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        return builder.select(builder.fcmp_ordered(">", *args), *args)

    return a(a, b), code


def _reduction(sign: str) -> Any:
    @intrinsic
    def reduced(typing: Any, a: Any) -> Any:
        def code(context: Any, builder: Any, signature: Any, args: Any) -> Any:
            value, half = args[0], a.count // 2
            while half:
                order = [(k + half) % a.count for k in range(a.count)]
                turned = builder.shuffle_vector(
                    value, value, ir.Constant(ir.VectorType(ir.IntType(32), a.count), order)
                )
                value = builder.select(builder.fcmp_ordered(sign, value, turned), value, turned)
                half //= 2
            return builder.extract_element(value, ir.Constant(ir.IntType(32), 0))

        return a.kind(a), code

    return reduced


# Of the numbers of a register.
smallest, largest = _reduction("<"), _reduction(">")


@intrinsic
def lane(typing: Any, a: Any, k: Any) -> Any:
    """The number in lane k."""

    def code(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        return builder.extract_element(*args)

    return a.kind(a, k), code


@intrinsic
def halves(typing: Any, low: Any, high: Any) -> Any:
    """One number in the lower half of the lanes, another in the upper half."""
    lanes = _of(low)

    def code(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        undefined = ir.Constant(context.get_value_type(lanes), ir.Undefined)
        first, second = (builder.insert_element(undefined, number, ir.Constant(ir.IntType(32), 0)) for number in args)
        half = lanes.count // 2
        order = ir.Constant(ir.VectorType(ir.IntType(32), lanes.count), [0] * half + [lanes.count] * half)
        return builder.shuffle_vector(first, second, order)

    return lanes(low, low), code


@intrinsic
def swapped(typing: Any, a: Any) -> Any:
    """The lanes with their two halves in each other's place."""

    def code(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        half = a.count // 2
        order = [(k + half) % a.count for k in range(a.count)]
        undefined = ir.Constant(context.get_value_type(a), ir.Undefined)
        return builder.shuffle_vector(args[0], undefined, ir.Constant(ir.VectorType(ir.IntType(32), a.count), order))

    return a(a), code


@intrinsic
def load_at(typing: Any, array: Any, i: Any) -> Any:
    """The numbers array[i : i + lanes] of a contiguous array."""
    return _loaded(array, i, _of(array.dtype))


@intrinsic
def load_counts(typing: Any, array: Any, i: Any) -> Any:
    """Eight integers of 16 bits, array[i : i + 8]."""
    return _loaded(array, i, Lanes(array.dtype, BYTES // 4))


def _loaded(array: Any, i: Any, lanes: Lanes) -> Any:
    def code(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        data, at = make_array(array)(context, builder, args[0]).data, context.cast(builder, args[1], i, types.intp)
        pointer = builder.bitcast(builder.gep(data, [at]), context.get_value_type(lanes).as_pointer())
        return builder.load(pointer, align=array.dtype.bitwidth // 8)

    return lanes(array, i), code


@intrinsic
def numbers(typing: Any, a: Any) -> Any:
    """Integers as float32."""
    lanes = Lanes(types.float32, a.count)

    def code(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        return builder.sitofp(args[0], context.get_value_type(lanes))

    return lanes(a), code


@intrinsic
def joined(typing: Any, a: Any, b: Any) -> Any:
    """The bits of two lanes of integers together."""

    def code(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        return builder.or_(*args)

    return a(a, b), code


@intrinsic
def filled(typing: Any, a: Any) -> Any:
    """Where integers are not zero."""

    def code(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        return builder.icmp_signed("!=", args[0], ir.Constant(context.get_value_type(a), None))

    return Lanes(types.boolean, a.count)(a), code


@intrinsic
def bits(typing: Any, mask: Any) -> Any:
    """A comparison as an integer: bit k is set where it holds in lane k."""

    def code(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        return builder.zext(builder.bitcast(args[0], ir.IntType(mask.count)), ir.IntType(64))

    return types.int64(mask), code


@intrinsic
def lowest(typing: Any, mask: Any) -> Any:
    """The lowest bit that is set in an integer other than zero."""

    def code(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        return builder.cttz(args[0], ir.Constant(ir.IntType(1), 1))

    return mask(mask), code


@intrinsic
def store(typing: Any, array: Any, i: Any, j: Any, a: Any) -> Any:
    """Write lanes to array[i, j, :] of a contiguous array with as many as there are lanes."""

    def code(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        whole = make_array(array)(context, builder, args[0])
        rows = cgutils.unpack_tuple(builder, whole.shape, 3)[1]
        index = [context.cast(builder, value, kind, types.intp) for value, kind in zip(args[1:3], (i, j), strict=True)]
        offset = builder.mul(builder.add(builder.mul(index[0], rows), index[1]), rows.type(a.count))
        pointer = builder.bitcast(builder.gep(whole.data, [offset]), context.get_value_type(a).as_pointer())
        builder.store(args[3], pointer, align=array.dtype.bitwidth // 8)
        return context.get_dummy_value()

    return types.none(array, i, j, a), code


@intrinsic
def ones(typing: Any, number: Any) -> Any:
    """How many bits are set in an integer of 64 bits."""

    def code(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        return builder.ctpop(args[0])

    return types.int64(number), code
