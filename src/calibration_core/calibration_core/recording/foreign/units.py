"""Units as people write them: a text such as `mm`, `[deg]` or `kN`, and its factor to SI."""

from __future__ import annotations

import dataclasses
import math
import re
from types import MappingProxyType
from typing import Literal

Dimension = Literal["length", "angle", "force", "torque", "time", "temperature", "number"]
SI = MappingProxyType(
    {"length": "m", "angle": "rad", "force": "N", "torque": "N*m", "time": "s", "temperature": "degC", "number": "1"}
)
_INCH = 0.0254  # m, exact
_POUND = 4.4482216152605  # N, pound-force, exact
_KILOPOND = 9.80665  # N, kilogram-force, exact
_DEGREE = math.pi / 180.0


@dataclasses.dataclass(frozen=True)
class ForeignUnit:
    """A unit of measurement.

    Attributes:
        dimension: What it measures.
        factor: SI value of one unit.
        offset: Added before the factor (degrees Fahrenheit, kelvin).
    """

    name: str
    dimension: Dimension
    factor: float
    offset: float = 0.0

    def to_si(self, value: float) -> float:
        """Return the value in SI units (degrees Celsius for temperatures)."""
        return (value + self.offset) * self.factor


def _all(dimension: Dimension, name: str, factor: float, *texts: str, offset: float = 0.0) -> dict[str, ForeignUnit]:
    return {text: ForeignUnit(name, dimension, factor, offset) for text in (name.lower(), *texts)}


UNITS = MappingProxyType(
    {
        **_all("length", "m", 1.0, "meter", "meters", "metre", "metres"),
        **_all("length", "mm", 1e-3, "millimeter", "millimeters", "millimetre", "millimetres"),
        **_all("length", "cm", 1e-2, "centimeter", "centimeters"),
        **_all("length", "um", 1e-6, "µm", "μm", "micron", "microns", "micrometer", "micrometers"),
        **_all("length", "in", _INCH, "inch", "inches", '"', "zoll"),
        **_all("length", "ft", 12.0 * _INCH, "foot", "feet"),
        **_all("angle", "rad", 1.0, "radian", "radians"),
        **_all("angle", "mrad", 1e-3),
        **_all("angle", "deg", _DEGREE, "°", "degree", "degrees", "grad", "decimal degrees"),
        **_all("force", "N", 1.0, "newton", "newtons"),
        **_all("force", "kN", 1e3, "kilonewton"),
        **_all("force", "daN", 10.0),
        **_all("force", "lbf", _POUND, "lb"),
        **_all("force", "kgf", _KILOPOND, "kp", "kilopond"),
        **_all("torque", "N*m", 1.0, "nm", "n·m", "n.m", "n m", "n-m", "newtonmeter"),
        **_all("torque", "kN*m", 1e3, "knm", "kn·m", "kn.m"),
        **_all("torque", "N*mm", 1e-3, "nmm", "n·mm", "n.mm"),
        **_all("torque", "N*cm", 1e-2, "ncm", "n·cm", "n.cm"),
        **_all("torque", "kgf*m", _KILOPOND, "kgfm", "kgf·m", "kgf.m", "kgf-m", "kpm"),
        **_all("torque", "lbf*ft", 12.0 * _POUND * _INCH, "lbf-ft", "lbf.ft", "ft-lbf", "ft-lb"),
        **_all("torque", "lbf*in", _POUND * _INCH, "lbf-in", "lbf.in", "in-lbf", "in-lb"),
        **_all("time", "s", 1.0, "sec", "second", "seconds"),
        **_all("time", "ms", 1e-3, "millisecond", "milliseconds"),
        **_all("time", "us", 1e-6, "µs", "microseconds"),
        **_all("time", "ns", 1e-9, "nanoseconds"),
        **_all("time", "min", 60.0, "minutes"),
        **_all("time", "d", 86400.0, "days"),
        **_all("temperature", "degC", 1.0, "°c", "c", "celsius", "deg c"),
        **_all("temperature", "K", 1.0, "kelvin", offset=-273.15),
        **_all("temperature", "degF", 5.0 / 9.0, "°f", "f", "fahrenheit", offset=-32.0),
    }
)  # `grad` is German for degrees; the gon, a hundredth of a right angle, is not used by robots
_UNKNOWN = re.compile(r"^(.*?)\s*[\[(<{]\s*([^\])>}]+?)\s*[\])>}]\s*$")
_BRACKETS = re.compile(r"^\s*[\[(<{]\s*(.*?)\s*[\])>}]\s*$")
_TRAILING = re.compile(r"^(.*?)(?:\s*[\[(<{]\s*([^\])>}]*?)\s*[\])>}]|\s*/\s*(\S+)|[\s_]+([^\s_]+))\s*$")


def unit_of(text: str) -> ForeignUnit | None:
    """Return the unit that a text names, with or without brackets; None if it names none."""
    inside = _BRACKETS.match(text)
    return UNITS.get((inside.group(1) if inside else text).strip().lower().rstrip("."))


def unknown_unit(field: str) -> tuple[str, str]:
    """Return a header field without what stands in brackets behind it, and that; two empty texts where none does."""
    found = _UNKNOWN.match(field)
    return ("", "") if found is None else (found.group(1), found.group(2))


def split_unit(field: str) -> tuple[str, ForeignUnit | None]:
    """Return a header field without its unit, and the unit: `X [mm]`, `X (mm)`, `X/mm`, `X_mm`, `X mm`."""
    found = _TRAILING.match(field)
    if found is None:
        return field.strip(), None
    name, bracketed, divided, trailing = found.groups()
    unit = unit_of(bracketed or divided or trailing or "")
    if unit is None or not name.strip():
        return field.strip(), None
    return name.strip(), unit
