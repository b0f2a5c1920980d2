"""What the parts of a cell file are made of: numbers that are finite, names that are not empty, poses."""

from __future__ import annotations

import math
from typing import Annotated

from pydantic import AfterValidator, BaseModel, BeforeValidator, ConfigDict, Field, WithJsonSchema

from calibration_core.files.names import CONTROL_FREE, NAME, PRINTABLE, is_name, is_printable

TURN = 2 * math.pi * 1.001  # rad: an angle beyond a turn is in degrees
IN_DEGREES = f"radians, at most one turn ({2 * math.pi:.2f}) either way: is it in degrees?"
EARTH = 9.80665  # m/s^2
MOST_OFF = 2.0  # m/s^2 from the Earth's gravity: more is another unit, or axes that are forgotten
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


def _name(value: str) -> str:
    if not is_name(value):
        raise ValueError(NAME)
    return value


def _label(value: str) -> str:
    if not is_printable(value):
        raise ValueError(PRINTABLE)
    return value


def _statement(value: str) -> str:
    if not value.strip():
        msg = "a text that is not empty"
        raise ValueError(msg)
    return value


def _radians(value: float) -> float:
    if abs(value) > TURN:
        raise ValueError(IN_DEGREES)
    return value


def _gravity(value: tuple[float, float, float]) -> tuple[float, float, float]:
    size = math.hypot(*value)
    if abs(size - EARTH) > MOST_OFF:
        raise field_error("", f"an acceleration of {size:.4g} m/s²", "9.76 to 9.84 m/s², as on Earth")
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
Name = Annotated[
    str, AfterValidator(_name), WithJsonSchema({"type": "string", "minLength": 1, "pattern": CONTROL_FREE})
]
Label = Annotated[
    str, AfterValidator(_label), WithJsonSchema({"type": "string", "pattern": CONTROL_FREE})
]  # a name that may be missing
Statement = Annotated[str, AfterValidator(_statement), WithJsonSchema({"type": "string", "minLength": 1})]
Radians = Annotated[Number, AfterValidator(_radians), _schema(minimum=-TURN, maximum=TURN)]
Angles = tuple[Radians, Radians, Radians]  # about x, y, z
Vector = tuple[Number, Number, Number]
Gravity = Annotated[Vector, AfterValidator(_gravity)]  # m/s^2
Interval = tuple[Number, Number]


class Strict(BaseModel):
    """A part of the cell file: no unknown keys, values never change."""

    model_config = ConfigDict(extra="forbid", frozen=True, arbitrary_types_allowed=True)


class Pose(Strict):
    """Pose of one frame in another: position (m) and fixed-axis angles about x, y, z (rad), R = Rz(y) Ry(p) Rx(r)."""

    xyz: Vector = (0.0, 0.0, 0.0)
    rpy: Angles = (0.0, 0.0, 0.0)


class FieldError(ValueError):
    """What is wrong with a field: where, what was found, what was expected."""

    def __init__(self, place: str, found: str, expected: str) -> None:
        self.place, self.found, self.expected = place, found, expected
        super().__init__(f"{place}: found {found}, expected {expected}")


def field_error(place: str, found: str, expected: str) -> FieldError:
    """Return the error for a field, its place relative to the part that holds it."""
    return FieldError(place, found, expected)
