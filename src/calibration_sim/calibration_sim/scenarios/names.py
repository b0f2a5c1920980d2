"""Other names for the joints and points of a recording: what things are called may not change what is found."""

from __future__ import annotations

from collections.abc import Mapping
from types import MappingProxyType
from typing import Any

_UR = ("shoulder_pan_joint", "shoulder_lift_joint", "elbow_joint", "wrist_1_joint", "wrist_2_joint", "wrist_3_joint")
_ODD = ("axis_90", "2nd", "S", "kr240_r2900_a1", "U17", "10")
_POINTS = ("smr_red", "nest 7", "12")
JOINTS: Mapping[str, tuple[str, ...]] = MappingProxyType(
    {
        "ur": _UR,
        "kuka": tuple(f"lbr_iiwa_14_joint_a{i}" for i in range(6, 0, -1)),  # counted from the flange
        "odd": _ODD,
    }
)
NAMES = ("plain", *JOINTS)


def renamed(value: Any, names: str) -> Any:
    """Return plain content with joints (`joint_1`, ...) and points (`mp1`, ...) called otherwise, keys included."""
    if names == "plain":
        return value
    other = {f"joint_{i}": name for i, name in enumerate(JOINTS[names], start=1)}
    other |= {f"mp{i}": name for i, name in enumerate(_POINTS, start=1)}
    return _renamed(value, other)


def _renamed(value: Any, other: Mapping[str, str]) -> Any:
    if isinstance(value, str):
        return other.get(value, value)
    if isinstance(value, Mapping):
        return {_renamed(key, other): _renamed(item, other) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return type(value)(_renamed(item, other) for item in value)
    return value
