"""How kernels are compiled: kept on disk, beside other threads, and without the memory manager.

numba counts the references to every array that a function is given or takes from another, with atomic instructions, and
looks whether slices that are assigned overlap: in kernels of a few dozen multiplications that costs as much as their
arithmetic, and half of their compilation. Kernels allocate nothing; their callers own all arrays.
"""

# numba's extension interface is untyped.
# mypy: disable-error-code="import-untyped, no-untyped-call, untyped-decorator"

import operator
from collections.abc import Callable
from typing import Any, TypeVar, cast

from numba import njit, types
from numba.core import cgutils
from numba.extending import lower_builtin
from numba.np.arrayobj import (
    basic_indexing,
    load_item,
    make_array,
    normalize_indices,
    setitem_array,
    store_item,
)

F = TypeVar("F", bound=Callable[..., Any])

OPTIONS: dict[str, Any] = {"cache": True, "nogil": True, "_nrt": False, "error_model": "numpy"}
"""numba's, of a kernel. With numpy's rules a division by zero is inf or NaN and costs no look at the divisor."""


def kernel(function: F) -> F:
    """Compile a function on arrays, numbers and records that allocates no array (`kernels.stack` has scratch arrays).

    It calls kernels only. To them, not to Python, it may return arrays that it was given, and views of them. In it
    `a[…] = b` of two arrays wants equal shapes and no overlap; neither is looked at.
    """
    return cast(F, njit(**OPTIONS)(function))


def inlined(function: F) -> F:
    """A `kernel` that is copied into its callers."""
    return cast(F, njit(**OPTIONS, forceinline=True)(function))


def ordered(function: F) -> F:
    """As `inlined`, for numbers among which there is no NaN, and of which zero has no sign: minima are single instructions."""
    return cast(F, njit(**OPTIONS, forceinline=True, fastmath={"nnan", "nsz"})(function))


def heap(function: F) -> F:
    """As `kernel`, for functions that make arrays: numba's own, with the memory manager."""
    return cast(F, njit(cache=True, nogil=True)(function))


@lower_builtin(operator.setitem, types.Array, types.Any, types.Array)
def _assign(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
    """a[…] = b. With the memory manager it is numba's own."""
    if context.enable_nrt:
        return setitem_array(context, builder, signature, arguments)
    kind, index_kind, source_kind = signature.args
    several = isinstance(index_kind, types.BaseTuple)
    kinds = index_kind.types if several else (index_kind,)
    indices = cgutils.unpack_tuple(builder, arguments[1], count=len(kinds)) if several else (arguments[1],)
    kinds, indices = normalize_indices(context, builder, kinds, indices)
    array = make_array(kind)(context, builder, arguments[0])
    data, lengths, strides = basic_indexing(context, builder, kind, array, kinds, indices, boundscheck=False)
    if len(lengths) != source_kind.ndim:
        raise NotImplementedError(f"{len(lengths)} axes = {source_kind.ndim} axes in a kernel")
    source = make_array(source_kind)(context, builder, arguments[2])
    source_lengths, source_strides = (cgutils.unpack_tuple(builder, row) for row in (source.shape, source.strides))
    with cgutils.loop_nest(builder, lengths, lengths[0].type) as at:
        there = cgutils.get_item_pointer2(context, builder, data, lengths, strides, "A", at)
        here = cgutils.get_item_pointer2(
            context, builder, source.data, source_lengths, source_strides, source_kind.layout, at
        )
        value = context.cast(builder, load_item(context, builder, source_kind, here), source_kind.dtype, kind.dtype)
        store_item(context, builder, kind, value, there)
    return context.get_dummy_value()
