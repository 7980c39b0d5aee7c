"""Numbers with a unit and a legal range: SI, radians; a value that looks like millimetres, degrees or grams says so."""

import math
from dataclasses import dataclass
from typing import Annotated, Any

from pydantic import GetCoreSchemaHandler, GetJsonSchemaHandler
from pydantic_core import CoreSchema, PydanticCustomError, core_schema


def fault(reason: str, hint: str = "") -> PydanticCustomError:
    """The error a validator raises; `load` turns it into the line `file: field: reason (hint)`."""
    # The texts are passed as context because pydantic would expand any braces they hold.
    return PydanticCustomError("scene", "{reason}", {"reason": reason, "hint": hint})


@dataclass(frozen=True)
class Quantity:
    """A finite number in [low, high], in (low, high] when `above`; `high_hint` guesses why a number is above."""

    unit: str
    low: float
    high: float
    above: bool = False
    high_hint: str = ""

    @property
    def legal(self) -> str:
        """The legal values in words."""
        low = "" if self.low == -math.inf else f"{'>' if self.above else '≥'} {self.low:g}"
        high = "" if self.high == math.inf else f"≤ {self.high:g}"
        return " ".join(part for part in (low, "and" if low and high else "", high, self.unit) if part)

    def __call__(self, value: Any) -> float:
        """`value` as a float; a text such as 1e-3 counts (YAML 1.1 reads it as one), true and false do not."""
        try:
            number = math.nan if isinstance(value, bool) else float(value)
        except (TypeError, ValueError):
            number = math.nan
        if not math.isfinite(number):
            raise fault(f"{value!r} is not a finite number", f"legal: {self.legal}")
        if number > self.high:
            raise fault(
                f"{number:g} is too large", f"{self.high_hint + ' ' if self.high_hint else ''}legal: {self.legal}"
            )
        if number < self.low or (self.above and number == self.low):
            raise fault(f"{number:g} is too small", f"legal: {self.legal}")
        return number

    def __get_pydantic_core_schema__(self, source: Any, handler: GetCoreSchemaHandler) -> CoreSchema:
        return core_schema.no_info_before_validator_function(self, core_schema.float_schema())

    def __get_pydantic_json_schema__(self, schema: CoreSchema, handler: GetJsonSchemaHandler) -> dict[str, Any]:
        result: dict[str, Any] = dict(handler(schema), description=self.legal)
        if self.low > -math.inf:
            result["exclusiveMinimum" if self.above else "minimum"] = self.low
        if self.high < math.inf:
            result["maximum"] = self.high
        return result


Length = Annotated[float, Quantity("m", 0.0, 10.0, above=True, high_hint="metres, not millimetres?")]
Coordinate = Annotated[float, Quantity("m", -100.0, 100.0, high_hint="metres, not millimetres?")]
Angle = Annotated[float, Quantity("rad", -2 * math.pi, 2 * math.pi, high_hint="radians, not degrees?")]
JointValue = Annotated[float, Quantity("rad or m", -2 * math.pi, 2 * math.pi, high_hint="radians, not degrees?")]
JointSpeed = Annotated[float, Quantity("rad/s or m/s", 0.0, 100.0, above=True, high_hint="radians, not degrees?")]
Mass = Annotated[float, Quantity("kg", 0.0, 1000.0, above=True, high_hint="kilograms, not grams?")]
Density = Annotated[float, Quantity("kg/m³", 0.0, 30000.0, above=True)]
Friction = Annotated[float, Quantity("", 0.0, 3.0, above=True)]
Force = Annotated[float, Quantity("N", 0.0, 1e5, above=True)]
Acceleration = Annotated[float, Quantity("m/s²", -100.0, 100.0)]
Component = Annotated[float, Quantity("", -1.001, 1.001)]
Scale = Annotated[float, Quantity("", 0.0, 10.0, above=True)]
