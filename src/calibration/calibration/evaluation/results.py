"""`result.json` to the fields of the services' answers.

Each function fills a response and returns what is lacking in it, as one sentence; nothing if all is there.
"""

from __future__ import annotations

import json
import math
from typing import Any

from geometry_msgs.msg import Point

POSE = ("x", "y", "z", "roll", "pitch", "yaw")


def fill_stiffness(response: Any, result_json: str) -> str:
    """Fill joints, stiffness, std and identifiable."""
    rows = json.loads(result_json)["stiffness"]
    response.joints = [row["joint"] for row in rows]
    response.stiffness = [_number(row["value"]) for row in rows]
    response.std = [_number(row["std"]) for row in rows]
    response.identifiable = [bool(row["identifiable"]) for row in rows]
    return "" if any(response.identifiable) else "the recording determines no joint stiffness"


def fill_base_frame(response: Any, result_json: str) -> str:
    """Fill the tracker's pose in the base frame: by circle points (CWA 17384, 7.1), else as fitted to all readings."""
    rows = _by_standard(result_json, "base_frame") or _parameters(result_json, "tracker")
    if not all(f"tracker {name}" in rows for name in POSE):
        return "the recording determines no tracker frame: absolute points of unloaded configurations are needed"
    x, y, z, roll, pitch, yaw = (_number(rows[f"tracker {name}"]["value"]) for name in POSE)
    response.tracker.position = Point(x=x, y=y, z=z)
    turned = response.tracker.orientation
    turned.x, turned.y, turned.z, turned.w = quaternion(roll, pitch, yaw)
    response.std = [_number(rows[f"tracker {name}"]["std"]) for name in POSE]
    return ""


def fill_geometry(response: Any, result_json: str) -> str:
    """Fill names, values, std and units of the geometry: by circle points (7.2), else as fitted to all readings."""
    fitted = [row for row in _parameters(result_json, "geometry").values() if row["fitted"]]
    rows = list(_by_standard(result_json, "joint_axes").values()) or fitted
    response.parameters = [row["name"] for row in rows]
    response.values = [_number(row["value"]) for row in rows]
    response.std = [_number(row["std"]) for row in rows]
    response.units = [row["unit"] for row in rows]
    return "" if rows else "the recording determines no geometry: absolute points of many configurations are needed"


def fill_points(response: Any, result_json: str) -> str:
    """Fill the measurement points that were fitted, in the flange frame."""
    rows = _parameters(result_json, "point")
    for point in json.loads(result_json)["recording"]["points"]:
        axes = [rows.get(f"{point} {axis}") for axis in "xyz"]
        if any(row is None for row in axes) or not any(row["fitted"] for row in axes if row):
            continue
        x, y, z = (_number(row["value"]) for row in axes if row)
        response.points.append(point)
        response.positions.append(Point(x=x, y=y, z=z))
        response.std.extend(_number(row["std"]) for row in axes if row)
    return "" if response.points else "the recording determines no measurement point"


def fill_diagnosis(response: Any, result_json: str) -> str:
    """Fill the verdict and the names of the findings."""
    result = json.loads(result_json)
    response.verdict = result["verdict"]
    response.findings = [finding["effect"] for finding in result["findings"]]
    return ""


def fill_wrist_centre(response: Any, result_json: str) -> str:
    """Fill the wrist centre in the flange frame, by spheres and trilateration (7.3)."""
    rows = _by_standard(result_json, "wrist_centre")
    if not rows:
        reasons = (json.loads(result_json).get("standard_geometry") or {}).get("reasons", {})
        return str(reasons.get("wrist_centre", "the recording determines no wrist centre: it has loads"))
    x, y, z = (rows[f"wrist centre {axis}"] for axis in "xyz")
    response.centre = Point(x=_number(x["value"]), y=_number(y["value"]), z=_number(z["value"]))
    response.std = [_number(row["std"]) for row in (x, y, z)]
    return ""


def quaternion(roll: float, pitch: float, yaw: float) -> tuple[float, float, float, float]:
    """Return x, y, z, w of R = Rz(yaw) Ry(pitch) Rx(roll), angles in rad."""
    cr, sr = math.cos(roll / 2), math.sin(roll / 2)
    cp, sp = math.cos(pitch / 2), math.sin(pitch / 2)
    cy, sy = math.cos(yaw / 2), math.sin(yaw / 2)
    return (
        sr * cp * cy - cr * sp * sy,
        cr * sp * cy + sr * cp * sy,
        cr * cp * sy - sr * sp * cy,
        cr * cp * cy + sr * sp * sy,
    )


def _by_standard(result_json: str, group: str) -> dict[str, dict[str, Any]]:
    """Return the rows that one of the standard's methods gave; none where the recording does not follow it."""
    found = (json.loads(result_json).get("standard_geometry") or {}).get(group) or {}
    return {row["name"]: row for row in found.get("parameters", [])}


def _parameters(result_json: str, group: str) -> dict[str, dict[str, Any]]:
    rows = json.loads(result_json).get("parameters", [])
    return {row["name"]: row for row in rows if row["group"] == group}


def _number(value: float | None) -> float:
    return math.nan if value is None else float(value)
