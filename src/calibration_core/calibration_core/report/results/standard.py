"""Base frame, joint axes and wrist centre by the standard's methods, as rows and as part of result.json."""

from __future__ import annotations

import dataclasses
from typing import Any, Literal

import numpy as np

from calibration_core.cell import Cell
from calibration_core.identification.circle_point.joint_axes import AxisGeometry
from calibration_core.identification.geometry.identifiability import candidates
from calibration_core.identification.geometry.parameter_table import UNITS
from calibration_core.identification.geometry.terms import AXES
from calibration_core.identification.result.estimate import StandardGeometry
from calibration_core.model.chain import xyz_rpy
from calibration_core.model.identified.named_values import POSE

NOT_SEEN = 1e-12  # m and rad: a correction that is this certain is zero by the base frame's definition


@dataclasses.dataclass(frozen=True)
class StandardRow:
    """One quantity.

    Attributes:
        group: `base_frame`, `joint_axes` or `wrist_centre`.
        name: Of a joint axis as in the table of fitted geometry (`a_2`, `alpha_3`, ...).
        value: M or rad.
        std: One standard deviation.
        unit: `m` or `rad`.
    """

    group: Literal["base_frame", "joint_axes", "wrist_centre"]
    name: str
    value: float
    std: float
    unit: Literal["m", "rad"]


def standard_rows(found: StandardGeometry, cell: Cell) -> tuple[StandardRow, ...]:
    """Return what was found: tracker pose in the base frame, corrections to the geometry, wrist centre (flange)."""
    rows = []
    if found.base is not None:
        pose = xyz_rpy(found.base.tracker)
        for name, value, std, unit in zip(POSE, pose, found.base.std, UNITS, strict=True):
            rows.append(StandardRow("base_frame", f"tracker {name}", float(value), float(std), unit))
    if found.axes is not None:
        rows += _axes(found.axes, cell)
    if found.wrist is not None:
        for name, value, std in zip(AXES, found.wrist.flange, found.wrist.std, strict=True):
            rows.append(StandardRow("wrist_centre", f"wrist centre {name}", float(value), float(std), "m"))
    return tuple(rows)


def _axes(axes: AxisGeometry, cell: Cell) -> list[StandardRow]:
    named = {(one.joint, one.kind): one for one in candidates(cell)}
    seen = [(int(joint), int(kind)) for joint, kind in np.argwhere(axes.std > NOT_SEEN)]
    return [
        StandardRow("joint_axes", named[key].name, float(axes.geometry[key]), float(axes.std[key]), named[key].unit)
        for key in seen
    ]


def standard_dict(found: StandardGeometry | None, cell: Cell) -> dict[str, Any] | None:
    """Return the part of result.json; None where the methods do not apply."""
    if found is None:
        return None
    answer: dict[str, Any] = dict.fromkeys(("base_frame", "joint_axes", "wrist_centre"))
    for row in standard_rows(found, cell):
        answer[row.group] = answer[row.group] or {"parameters": []}
        answer[row.group]["parameters"].append({key: getattr(row, key) for key in ("name", "value", "std", "unit")})
    if found.base is not None:
        answer["base_frame"] |= {
            "axis_angle_error": found.base.axis_angle_error,
            "warnings": list(found.base.warnings),
        }
    if found.axes is not None:
        answer["joint_axes"] = answer["joint_axes"] or {"parameters": []}  # without noise nothing counts as seen
        answer["joint_axes"]["axes"] = [
            {
                "joint": name,
                "point": axis.point,
                "direction": axis.direction,
                "point_std": axis.point_std,
                "direction_std": axis.direction_std,
                "arc": max(circle.arc for circle in axis.circles),
                "rms": max(circle.rms for circle in axis.circles),
            }
            for name, axis in found.axes.axes.items()
        ]
        answer["joint_axes"]["not_observed"] = list(found.axes.not_observed)
    if found.wrist is not None:
        answer["wrist_centre"] |= {
            "tracker": found.wrist.position,
            "spread": found.wrist.spread,
            "points": "identified" if found.points_fitted else "nominal",
            "warnings": list(found.wrist.warnings),
        }
    answer["reasons"] = dict(found.reasons)
    return answer
