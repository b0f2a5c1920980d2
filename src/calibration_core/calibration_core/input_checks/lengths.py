"""Lengths of the cell file that no robot, tracker or tool has: they are in another unit."""

from __future__ import annotations

import numpy as np

from calibration_core.cell import Cell
from calibration_core.input_checks.anomaly import InputAnomaly
from calibration_core.model.chain import Chain

LONGEST_ARM = 100.0  # m, linear axes included
LONGEST_TRAVEL = 500.0  # m, of a linear unit from its zero
FARTHEST_TRACKER = 300.0  # m; laser trackers measure up to 160 m
LARGEST_TOOL = 20.0  # m, from the flange to a measurement point, the wrench point or the sensor


def check_lengths(cell: Cell, chain: Chain) -> list[InputAnomaly]:
    """Return the lengths of a cell file that look like millimetres, as one anomaly; empty where they are plausible."""
    places: list[tuple[str, float, float]] = [("robot (its kinematics)", chain.reach, LONGEST_ARM)]
    if any(chain.prismatic):
        stated = "the URDF's limits" if cell.robot.joint_limits is None else "robot.joint_limits"
        places.append((f"{stated} of sliding joints", float(chain.travel.max()), LONGEST_TRAVEL))
    frames = cell.frames
    if frames.tracker is not None:
        places.append(("frames.tracker.xyz", _size(frames.tracker.xyz), FARTHEST_TRACKER))
    if frames.force_torque is not None:
        places.append(("frames.force_torque.xyz", _size(frames.force_torque.xyz), LARGEST_TOOL))
    if frames.wrench_point is not None:
        places.append(("frames.wrench_point", _size(frames.wrench_point), LARGEST_TOOL))
    far = max((_size(point) for point in frames.measurement_points.values()), default=0.0)
    places.append(("frames.measurement_points", far, LARGEST_TOOL))
    wrong = [(name, size, most) for name, size, most in places if size > most]
    if not wrong:
        return []
    seen = "; ".join(f"{name}: {size:,.4g} m, at most {most:g} m is plausible" for name, size, most in wrong)
    names = ", ".join(name for name, _, _ in wrong)
    text = f"lengths of the cell file look like millimetres ({seen})"
    remedy = f"give lengths of the cell file in m: multiply {names} by 0.001"
    return [InputAnomaly("position_unit", text, remedy, max(size for _, size, _ in wrong), unit="m", factor=1e-3,
                         place="cell")]  # fmt: skip


def _size(xyz: tuple[float, ...]) -> float:
    return float(np.linalg.norm(xyz))
