"""Scratch arrays on the stack of the kernel that asks for them.

numba's own arrays come from the heap, and every function that they are passed to counts them up and down with atomic
instructions: for the few numbers that a small kernel needs on its way that costs more than its arithmetic.
"""

# numba's extension interface is untyped.
# mypy: disable-error-code="import-untyped, no-untyped-call, attr-defined"

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
    lengths = [axis.literal_value for axis in (shape.types if isinstance(shape, types.BaseTuple) else [shape])]
    kind = types.Array(types.float64, len(lengths), "C")

    def lower(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        cells = ir.ArrayType(ir.DoubleType(), math.prod(lengths))
        data = builder.bitcast(cgutils.alloca_once(builder, cells), ir.DoubleType().as_pointer())
        strides = [8 * math.prod(lengths[axis + 1 :]) for axis in range(len(lengths))]
        shape, steps = ([context.get_constant(types.intp, n) for n in row] for row in (lengths, strides))
        array = make_array(kind)(context, builder)
        # Without a memory manager's handle nothing counts references.
        populate_array(
            array, data=data, shape=shape, strides=steps, itemsize=context.get_constant(types.intp, 8), meminfo=None
        )
        return array._getvalue()

    return kind(shape), lower


stack = cast(Callable[[int | tuple[int, ...]], Array], intrinsic(prefer_literal=True)(_stack))
"""As `np.empty(shape)` in a kernel, float64, of lengths that are literal numbers in its source.

The array lives until the kernel ends, and each call in the source is one array, in a loop too: it must not be returned.
"""
