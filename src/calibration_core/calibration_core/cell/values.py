"""What the parts of a cell file are made of: numbers that are finite, names that are not empty, poses."""

from __future__ import annotations

import math
from typing import Annotated

from pydantic import AfterValidator, BaseModel, BeforeValidator, ConfigDict, Field, WithJsonSchema

LARGEST = 1e12  # in SI units: stiffer or larger is nothing that a cell has


def _number(value: object) -> object:
    if isinstance(value, bool) or not isinstance(value, int | float):
        msg = "a number"
        raise ValueError(msg)
    if not math.isfinite(value):
        msg = "a finite number"
        raise ValueError(msg)
    if abs(value) > LARGEST:
        msg = f"a number of at most {LARGEST:g}"
        raise ValueError(msg)
    return float(value)


def _stiffness(value: object) -> object:
    if value == math.inf:
        return math.inf
    return _number(value)


def _not_empty(value: str) -> str:
    if not value.strip():
        msg = "a name that is not empty"
        raise ValueError(msg)
    return value


def _schema(**limits: float) -> WithJsonSchema:
    """State limits for the JSON Schema too, which cannot see through the functions that check numbers."""
    return WithJsonSchema({"type": "number", **limits})


Number = Annotated[float, BeforeValidator(_number)]
Positive = Annotated[Number, Field(gt=0), _schema(exclusiveMinimum=0)]
NonNegative = Annotated[Number, Field(ge=0), _schema(minimum=0)]
Length = Annotated[
    Positive, Field(ge=1e-9, le=1.0), _schema(minimum=1e-9, maximum=1)
]  # m, a standard deviation of positions
Angle = Annotated[Positive, Field(ge=1e-9, le=1.0), _schema(minimum=1e-9, maximum=1)]  # rad, one of directions
Stiffness = Annotated[float, BeforeValidator(_stiffness), Field(gt=0), _schema(exclusiveMinimum=0)]
Name = Annotated[str, AfterValidator(_not_empty), WithJsonSchema({"type": "string", "minLength": 1})]
Vector = tuple[Number, Number, Number]
Interval = tuple[Number, Number]


class Strict(BaseModel):
    """A part of the cell file: no unknown keys, values never change."""

    model_config = ConfigDict(extra="forbid", frozen=True, arbitrary_types_allowed=True)


class Pose(Strict):
    """Pose of one frame in another: position (m) and fixed-axis angles about x, y, z (rad), R = Rz(y) Ry(p) Rx(r)."""

    xyz: Vector = (0.0, 0.0, 0.0)
    rpy: Vector = (0.0, 0.0, 0.0)


class FieldError(ValueError):
    """What is wrong with a field: where, what was found, what was expected."""

    def __init__(self, place: str, found: str, expected: str) -> None:
        self.place, self.found, self.expected = place, found, expected
        super().__init__(f"{place}: found {found}, expected {expected}")


def field_error(place: str, found: str, expected: str) -> FieldError:
    """Return the error for a field, its place relative to the part that holds it."""
    return FieldError(place, found, expected)
