"""Ask the processor for a cache line before it is needed: a scan hits cells all over a map larger than the caches."""

from __future__ import annotations

from typing import Any

from llvmlite import ir
from numba.core import cgutils, types
from numba.extending import intrinsic

DISTANCE = 32
"""How many points ahead to fetch: far enough to hide memory, near enough not to be evicted again. Measured."""


def _prefetch(typing_context: Any, array: Any, index: Any) -> Any:
    """`prefetch(array, index)`: a hint to fetch array[index] (1-D, C order) for writing; index is not checked."""

    def generate(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        view = context.make_array(signature.args[0])(context, builder, args[0])
        shape = cgutils.unpack_tuple(builder, view.shape)
        strides = cgutils.unpack_tuple(builder, view.strides)
        pointer = cgutils.get_item_pointer2(
            context, builder, view.data, shape, strides, "C", [args[1]], wraparound=False
        )
        byte_pointer = ir.IntType(8).as_pointer()
        i32 = ir.IntType(32)
        function = cgutils.get_or_insert_function(
            builder.module,
            ir.FunctionType(ir.VoidType(), [byte_pointer, i32, i32, i32]),
            "llvm.prefetch.p0",
        )
        write, keep_in_all_caches, data = i32(1), i32(3), i32(1)
        builder.call(function, [builder.bitcast(pointer, byte_pointer), write, keep_in_all_caches, data])
        return context.get_dummy_value()

    return types.void(array, index), generate


prefetch: Any = intrinsic(_prefetch)
