"""Memory below NumPy's arrays: records at an address, and cache lines asked for before they are needed.

A scan's cells lie in many tiles. Kernels get the addresses of these, so that one loop goes through all of them and the
fetching ahead does not stop at a tile's end. Nothing is checked: the caller keeps the arrays alive and the indices
inside.
"""

from __future__ import annotations

from typing import Any

from llvmlite import ir
from numba.core import types
from numba.extending import intrinsic

DISTANCE = 32
"""How many points ahead to fetch: far enough to hide memory, near enough not to be evicted again. Measured."""


def _fetch(builder: Any, pointer: Any) -> None:
    """A hint to bring the line at a pointer into the caches, to be written."""
    byte_pointer, i32 = ir.IntType(8).as_pointer(), ir.IntType(32)
    kind = ir.FunctionType(ir.VoidType(), [byte_pointer, i32, i32, i32])
    function = builder.module.globals.get("llvm.prefetch.p0") or ir.Function(builder.module, kind, "llvm.prefetch.p0")
    write, keep_in_all_caches, data = i32(1), i32(3), i32(1)
    builder.call(function, [builder.bitcast(pointer, byte_pointer), write, keep_in_all_caches, data])


def _prefetch(typing_context: Any, array: Any, index: Any) -> Any:
    """`prefetch(array, index)`: fetch array[index] (1-D, C order)."""

    def generate(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        view = context.make_array(signature.args[0])(context, builder, args[0])
        _fetch(builder, builder.gep(view.data, [args[1]]))
        return context.get_dummy_value()

    return types.void(array, index), generate


def _prefetch_at(typing_context: Any, address: Any) -> Any:
    """`prefetch_at(address)`."""

    def generate(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        _fetch(builder, builder.inttoptr(args[0], ir.IntType(8).as_pointer()))
        return context.get_dummy_value()

    return types.void(types.int64), generate


def _record_at(typing_context: Any, like: Any, address: Any) -> Any:
    """`record_at(like, address)`: the record at an address, of the kind that the array `like` holds."""

    def generate(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        return builder.inttoptr(args[1], context.get_value_type(signature.return_type))

    return like.dtype(like, types.int64), generate


def _add_four(typing_context: Any, record: Any, first: Any, a: Any, b: Any, c: Any, d: Any) -> Any:
    """`add_four(record, first, a, b, c, d)`: add to the four float64 of a record that begin with the field `first`.

    The same bits as one by one, at once: LLVM could see that by itself, but numba tells it not to look.
    """
    offset = record.offset(first.literal_value)

    def generate(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        four, i32 = ir.VectorType(ir.DoubleType(), 4), ir.IntType(32)
        start = builder.bitcast(args[0], ir.IntType(8).as_pointer())
        fields = builder.bitcast(builder.gep(start, [ir.IntType(64)(offset)]), four.as_pointer())
        terms = ir.Constant(four, ir.Undefined)
        for k, term in enumerate(args[2:]):
            terms = builder.insert_element(terms, term, i32(k))
        builder.store(builder.fadd(builder.load(fields, align=8), terms), fields, align=8)
        return context.get_dummy_value()

    return types.void(record, first, *[types.float64] * 4), generate


add_four: Any = intrinsic(prefer_literal=True)(_add_four)
prefetch: Any = intrinsic(_prefetch)
prefetch_at: Any = intrinsic(_prefetch_at)
record_at: Any = intrinsic(_record_at)
