"""Scratch arrays on the stack of the kernel that asks for them: numba's own come from the heap (`kernels.native`)."""

# numba's extension interface is untyped.
# mypy: disable-error-code="import-untyped, no-untyped-call, attr-defined"

import functools
import math
from collections.abc import Callable
from typing import Any, cast

from llvmlite import ir
from numba import types
from numba.core import cgutils
from numba.extending import intrinsic
from numba.np.arrayobj import make_array, populate_array

from regrasp.kernels.rotations import Array


def _stack(typing_context: Any, shape: Any) -> Any:
    axes = shape.types if isinstance(shape, types.BaseTuple) else [shape]
    known = all(isinstance(axis, types.IntegerLiteral) for axis in axes)
    kind = types.Array(types.float64, len(axes), "C")

    def lower(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        given = cgutils.unpack_tuple(builder, arguments[0]) if isinstance(shape, types.BaseTuple) else [arguments[0]]
        word = context.get_value_type(types.intp)
        if known:
            lengths = [context.get_constant(types.intp, axis.literal_value) for axis in axes]
            cells = ir.ArrayType(ir.DoubleType(), math.prod(axis.literal_value for axis in axes))
            data = builder.bitcast(cgutils.alloca_once(builder, cells), ir.DoubleType().as_pointer())
        else:
            lengths = [
                context.get_constant(types.intp, axis.literal_value) if isinstance(axis, types.IntegerLiteral)
                else context.cast(builder, value, axis, types.intp) for axis, value in zip(axes, given, strict=True)
            ]  # fmt: skip
            data = builder.alloca(ir.DoubleType(), functools.reduce(builder.mul, lengths))
        steps = [ir.Constant(word, 8)]
        for length in reversed(lengths[1:]):
            steps.insert(0, builder.mul(steps[0], length))
        array = make_array(kind)(context, builder)
        # Without a memory manager's handle nothing counts references.
        populate_array(array, data=data, shape=lengths, strides=steps, itemsize=ir.Constant(word, 8), meminfo=None)
        return array._getvalue()

    return kind(shape), lower


stack = cast(Callable[[int | tuple[int, ...]], Array], intrinsic(prefer_literal=True)(_stack))
"""As `np.empty(shape)` in a kernel, float64.

The array lives until the kernel ends: it must not be returned. Where all lengths are literal numbers each call in the source is
one array, in a loop too; with others every call takes more of the stack, so that a loop is no place for it.
"""
