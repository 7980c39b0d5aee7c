"""How kernels are compiled: kept on disk, beside other threads, without the memory manager, in packed instructions.

numba counts the references to every array that a function is given or takes from another, with atomic instructions, looks
of every index whether it counts from the end and of every slice whether it is within its array, and whether slices that are
assigned overlap: in kernels of a few dozen multiplications that costs as much as their arithmetic, and half of their
compilation. Kernels allocate nothing; their callers own all arrays.
"""

# numba's extension interface is untyped.
# mypy: disable-error-code="import-untyped, no-untyped-call, untyped-decorator, attr-defined"

import operator
from collections.abc import Callable
from typing import Any, TypeVar, cast

from numba import config, njit, types
from numba.core import cgutils
from numba.core.compiler_lock import global_compiler_lock
from numba.extending import lower_builtin
from numba.np.arrayobj import (
    getitem_array_tuple,
    getitem_arraynd_intp,
    load_item,
    make_array,
    make_view,
    setitem_array,
    store_item,
)

F = TypeVar("F", bound=Callable[..., Any])

OPTIONS: dict[str, Any] = {"cache": True, "nogil": True, "_nrt": False, "error_model": "numpy"}
"""numba's, of a kernel. With numpy's rules a division by zero is inf or NaN and costs no look at the divisor."""


def kernel(function: F) -> F:
    """Compile a function on arrays, numbers and records that allocates no array (`kernels.stack` has scratch arrays).

    It calls kernels only. To them, not to Python, it may return arrays that it was given, and views of them. In it an index
    counts from 0, a slice [a:b] has 0 ≤ a ≤ b and no step, and `a[…] = b` of two arrays wants equal shapes and no overlap;
    none of it is looked at.
    """
    return _packed(function)


def inlined(function: F) -> F:
    """A `kernel` that is copied into its callers."""
    return _packed(function, forceinline=True)


def ordered(function: F) -> F:
    """As `inlined`, for numbers among which there is no NaN, and of which zero has no sign: minima are single instructions."""
    return _packed(function, forceinline=True, fastmath={"nnan", "nsz"})


def heap(function: F) -> F:
    """As `kernel`, for functions that make arrays: numba's own, with the memory manager."""
    return cast(F, njit(cache=True, nogil=True)(function))


def _packed(function: F, **more: Any) -> F:
    """A function compiled with `OPTIONS` and more, operations on neighbouring numbers packed into one instruction.

    The results are the same. numba has one switch for all that it compiles, and compiles one function at a time.
    """
    dispatcher = njit(**OPTIONS, **more)(function)
    compile_one = dispatcher.compile

    def compile_packed(signature: Any) -> Any:
        with global_compiler_lock:
            before, config.SLP_VECTORIZE = config.SLP_VECTORIZE, 1
            try:
                return compile_one(signature)
            finally:
                config.SLP_VECTORIZE = before

    dispatcher.compile = compile_packed
    return cast(F, dispatcher)


def _place(
    context: Any, builder: Any, kind: Any, array: Any, index_kind: Any, index: Any
) -> tuple[Any, list[Any], list[Any]] | None:
    """(address, lengths, strides) of a[index], index as `kernel` allows them; None for indices of another kind."""
    several = isinstance(index_kind, types.BaseTuple)
    kinds = index_kind.types if several else (index_kind,)
    indices = cgutils.unpack_tuple(builder, index, count=len(kinds)) if several else (index,)
    if not all(
        isinstance(one, types.Integer) or (isinstance(one, types.SliceType) and not one.has_step) for one in kinds
    ):
        return None
    shape, strides = (cgutils.unpack_tuple(builder, row, count=kind.ndim) for row in (array.shape, array.strides))
    first, lengths, steps = [], [], []
    for axis in range(kind.ndim):
        if axis >= len(kinds):
            first.append(context.get_constant(types.intp, 0))
            lengths.append(shape[axis])
            steps.append(strides[axis])
        elif isinstance(kinds[axis], types.Integer):
            first.append(context.cast(builder, indices[axis], kinds[axis], types.intp))
        else:
            part = context.make_helper(builder, kinds[axis], value=indices[axis])
            last = builder.select(builder.icmp_signed("<", part.stop, shape[axis]), part.stop, shape[axis])
            first.append(part.start)
            lengths.append(builder.sub(last, part.start))
            steps.append(strides[axis])
    data = cgutils.get_item_pointer(context, builder, kind, array, first, wraparound=False, boundscheck=False)
    return data, lengths, steps


@lower_builtin(operator.getitem, types.Array, types.Integer)
@lower_builtin(operator.getitem, types.Array, types.SliceType)
@lower_builtin(operator.getitem, types.Array, types.BaseTuple)
def _take(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
    """a[…]. With the memory manager it is numba's own."""
    kind, index_kind = signature.args
    array = make_array(kind)(context, builder, arguments[0])
    place = None if context.enable_nrt else _place(context, builder, kind, array, index_kind, arguments[1])
    if place is None:
        own = getitem_array_tuple if isinstance(index_kind, types.BaseTuple) else getitem_arraynd_intp
        return own(context, builder, signature, arguments)
    data, lengths, strides = place
    if not isinstance(signature.return_type, types.Array):
        return load_item(context, builder, kind, data)
    return make_view(context, builder, kind, array, signature.return_type, data, lengths, strides)._getvalue()


@lower_builtin(operator.setitem, types.Array, types.Any, types.Any)
def _put(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
    """a[…] = b. With the memory manager it is numba's own."""
    kind, index_kind, value_kind = signature.args
    array = make_array(kind)(context, builder, arguments[0])
    place = None if context.enable_nrt else _place(context, builder, kind, array, index_kind, arguments[1])
    if place is None or (place[1] and not isinstance(value_kind, types.Array)):  # a number for many places
        return setitem_array(context, builder, signature, arguments)
    data, lengths, strides = place
    if not lengths:
        store_item(context, builder, kind, context.cast(builder, arguments[2], value_kind, kind.dtype), data)
        return context.get_dummy_value()
    if len(lengths) != value_kind.ndim:
        raise NotImplementedError(f"{len(lengths)} axes = {value_kind.ndim} axes in a kernel")
    source = make_array(value_kind)(context, builder, arguments[2])
    source_lengths, source_strides = (cgutils.unpack_tuple(builder, row) for row in (source.shape, source.strides))
    with cgutils.loop_nest(builder, lengths, lengths[0].type) as at:
        there = cgutils.get_item_pointer2(context, builder, data, lengths, strides, "A", at)
        here = cgutils.get_item_pointer2(
            context, builder, source.data, source_lengths, source_strides, value_kind.layout, at
        )
        value = context.cast(builder, load_item(context, builder, value_kind, here), value_kind.dtype, kind.dtype)
        store_item(context, builder, kind, value, there)
    return context.get_dummy_value()
