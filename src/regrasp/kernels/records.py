"""Records: frozen bundles of arrays and numbers that kernels take as one pointer each.

numba passes a NamedTuple of arrays by value, and an array alone is six or more machine words: a call with the planner's
models would have hundreds of arguments, which costs most of the compile time and more than the work of a small kernel.
A record is one pointer to a table of machine words. Its fields are read as from any object, in Python and in kernels.
"""

# numba's extension interface is untyped.
# mypy: disable-error-code="import-untyped, arg-type, attr-defined, no-untyped-call, untyped-decorator, override"

import functools
from dataclasses import dataclass, fields
from typing import Any, ClassVar, dataclass_transform

import numpy as np
from llvmlite import ir
from numba.core import cgutils, types
from numba.core.datamodel.models import OpaqueModel
from numba.core.typing.templates import AttributeTemplate
from numba.extending import NativeValue, infer_getattr, lower_getattr_generic, register_model, unbox
from numba.np.arrayobj import make_array, populate_array
from numba.np.numpy_support import from_dtype


class RecordType(types.Type):
    """The numba type of a class of records: its name and its members' types."""

    def __init__(self, name: str, members: tuple[tuple[str, types.Type], ...]) -> None:
        self.members = dict(members)
        self._key = (name, members)
        super().__init__(name)

    @property
    def key(self) -> Any:
        """What makes the type: numba's cache on disk compares it."""
        return self._key

    def offset(self, member: str) -> int:
        """Where a member stands in the table, in words."""
        count = 0
        for name, kind in self.members.items():
            if name == member:
                break
            count += words(kind)
        return count


def words(kind: types.Type) -> int:
    """Words that a value takes in the table: an array's address and lengths, a nested record's address, a number."""
    return 1 + kind.ndim if isinstance(kind, types.Array) else 1


@functools.cache
def array_type(dtype: np.dtype[Any], axes: int, writeable: bool, aligned: bool) -> types.Array:
    """The numba type of C-contiguous arrays: made once, as records of many arrays are made for every search."""
    return types.Array(from_dtype(dtype), axes, "C", readonly=not writeable, aligned=aligned)


@dataclass_transform(frozen_default=True, eq_default=False)
class Record:
    """Base class of records: subclasses list their fields as a dataclass does and are frozen.

    Fields are C-contiguous arrays, which kernels may write into, ints, floats and other records. All instances of one
    class have the same array types; TypeError otherwise. In a kernel an array taken from a record is borrowed: it must
    not be returned to Python.
    """

    _numba_type_: ClassVar[RecordType | None] = None

    def __init_subclass__(cls) -> None:
        dataclass(frozen=True, eq=False)(cls)

    def __post_init__(self) -> None:
        members, table = [], []
        for field in fields(self):
            value = getattr(self, field.name)
            if isinstance(value, Record):
                members.append((field.name, value._numba_type_))
                table.append(value._address)
            elif isinstance(value, np.ndarray):
                flags = value.flags
                if not flags.c_contiguous:
                    raise TypeError(f"{type(self).__name__}.{field.name} is not a C-contiguous array")
                members.append((field.name, array_type(value.dtype, value.ndim, flags.writeable, flags.aligned)))
                table += [value.ctypes.data, *value.shape]
            else:
                kind = types.int64 if field.type is int else types.float64
                members.append((field.name, kind))
                table.append(int(value) if field.type is int else int(np.float64(value).view(np.int64)))
        key = type(self).__name__, tuple(members)
        if self._numba_type_ is None:
            type(self)._numba_type_ = RecordType(*key)
        elif key != self._numba_type_.key:
            raise TypeError(f"{type(self).__name__} has fields {key}, others of its kind {self._numba_type_.key}")
        object.__setattr__(self, "_table", np.array(table, np.int64))
        object.__setattr__(self, "_address", self._table.ctypes.data)

    def __reduce__(self) -> tuple[Any, ...]:
        return type(self), tuple(getattr(self, field.name) for field in fields(self))


register_model(RecordType)(OpaqueModel)


@unbox(RecordType)
def _unbox(typ: RecordType, obj: Any, c: Any) -> NativeValue:
    address = c.pyapi.object_getattr_string(obj, "_address")
    pointer = c.pyapi.long_as_voidptr(address)
    c.pyapi.decref(address)
    return NativeValue(pointer, is_error=cgutils.is_not_null(c.builder, c.pyapi.err_occurred()))


@infer_getattr
class _Fields(AttributeTemplate):
    key = RecordType

    def generic_resolve(self, typ: RecordType, attr: str) -> types.Type | None:
        return typ.members.get(attr)


@lower_getattr_generic(RecordType)
def _field(context: Any, builder: Any, typ: RecordType, pointer: Any, attr: str) -> Any:
    member = typ.members[attr]
    first = typ.offset(attr)

    def word(index: int, kind: Any) -> Any:
        slot = builder.gep(builder.bitcast(pointer, kind.as_pointer()), [ir.Constant(ir.IntType(64), first + index)])
        value = builder.load(slot)
        # The table never changes: the optimiser may keep what it has read across stores into arrays.
        value.set_metadata("invariant.load", builder.module.add_metadata([]))
        return value

    if not isinstance(member, types.Array):
        return word(0, context.get_value_type(member))
    array = make_array(member)(context, builder)
    size = context.get_constant(types.intp, member.dtype.bitwidth // 8)
    shape = [word(1 + axis, ir.IntType(64)) for axis in range(member.ndim)]
    strides = [size]
    for length in reversed(shape[1:]):
        strides.insert(0, builder.mul(strides[0], length))
    # Without a memory manager's handle nothing counts references: the record outlives the call.
    populate_array(
        array, data=word(0, context.get_data_type(member.dtype).as_pointer()), shape=shape, strides=strides,
        itemsize=size, meminfo=None,
    )  # fmt: skip
    return array._getvalue()
