"""Settings from plain data (a section of a scene file) as the frozen dataclasses they name."""

import dataclasses
import difflib
import math
import typing
from collections.abc import Mapping
from typing import Any, TypeVar

from regrasp.errors import InputError

Value = TypeVar("Value")
LEGAL: dict[type, tuple[type, ...]] = {float: (int, float), int: (int,), bool: (bool,), str: (str,)}
WORDS = {float: "a number", int: "a whole number", bool: "true or false", str: "text"}


def read(kind: type[Value], data: Mapping[str, Any], field: str = "planner") -> Value:
    """The dataclass `kind`, its fields (dataclasses too) taken from `data`, defaults where `data` says nothing.

    Raises InputError naming the field (from `field` down): an unknown key, a wrong type, a value the class refuses.
    """
    if not isinstance(data, Mapping):
        raise InputError(field, f"is {data!r}", "a mapping of settings")
    types = typing.get_type_hints(kind)
    legal = [each.name for each in dataclasses.fields(kind)]  # type: ignore[arg-type]
    values = {}
    for key, value in data.items():
        path = f"{field}.{key}"
        if key not in legal:
            near = difflib.get_close_matches(str(key), legal, n=1)
            raise InputError(path, "unknown key", f"{near[0]}?" if near else f"legal: {', '.join(legal)}")
        wanted = types[key]
        if dataclasses.is_dataclass(wanted):
            values[key] = read(typing.cast(type[Any], wanted), value, path)
        elif not isinstance(value, LEGAL[wanted]) or (isinstance(value, bool) and wanted is not bool):
            raise InputError(path, f"is {value!r}", WORDS[wanted])
        else:
            values[key] = wanted(value)
    try:
        return kind(**values)
    except ValueError as error:
        raise InputError(field, str(error)) from None


def demand(settings: object, positive: tuple[str, ...] = (), from_zero: tuple[str, ...] = ()) -> None:
    """Raises ValueError where a field named in `positive` is not above 0, one in `from_zero` below it, or one not finite."""
    for name in (*positive, *from_zero):
        value = getattr(settings, name)
        if not 0.0 <= value < math.inf or (value == 0.0 and name in positive):
            raise ValueError(f"{name} is {value}, legal: {'more than 0' if name in positive else '0 or more'}")
