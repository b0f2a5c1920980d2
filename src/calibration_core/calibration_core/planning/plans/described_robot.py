"""Whether the robot that a driver describes (a URDF on `robot_description`) is the one of the cell file.

A cell with a URDF names base and flange: joint limits and the flange's places are compared as for a plan.  A cell with
DH rows names no links, and its base and flange frames may be others than the URDF's: what is compared is how the flange
moves from one posture to another, by angle and slide of the screw, which do not depend on frames.  The name that a URDF
gives the robot tells nothing: a driver's is often its maker's, or that of the cell.
"""

from __future__ import annotations

import dataclasses
import tempfile
from pathlib import Path
from xml.etree import ElementTree as ET

import numpy as np

from calibration_core.cell import Cell
from calibration_core.cell.urdf import urdf_bytes
from calibration_core.errors import CellError, quoted
from calibration_core.model.chain import Chain, rotation_vector
from calibration_core.model.kinematics import posture
from calibration_core.model.robot import chain_of
from calibration_core.planning.plans.planned_robot import SAME_LIMIT, PlannedRobot
from calibration_core.timeseries import Float1D, Float2D

SAME_ANGLE, SAME_SLIDE = 0.01, 0.01  # rad, m: a calibrated robot is nearer to its nominal description
LARGEST = 0.3  # rad (m), of a joint in the postures compared; the flange turns by less than half a turn between them
POSTURES = 6


def description_fault(text: str, cell: Cell) -> str:
    """Say why a description is not the cell's robot, everything that differs; empty if it may be.

    Raises:
        CellError: The cell's own URDF cannot be used.
    """
    with tempfile.TemporaryDirectory() as directory:
        path = Path(directory) / "robot_description"
        path.write_text(text, encoding="utf-8")
        try:
            root = ET.fromstring(urdf_bytes(path))
            absent = [name for name in cell.robot.joints if root.find(f"joint[@name='{name}']") is None]
            if absent:
                return f"no joint {', '.join(map(quoted, absent))}"
            described = chain_of(_with_urdf(cell, path, root))
        except CellError as error:
            place = f"{error.place}: " if error.place else ""
            return f"{place}found {error.found}, expected {error.expected}"
    own, names = chain_of(cell), cell.robot.joints
    found: list[str] = []
    if cell.robot.joint_limits is not None:
        found = _limits_exceeded(own, described)
        described = dataclasses.replace(described, limits=own.limits)
    if cell.robot.dh is not None:
        return "; ".join([*found, *_screws_differ(own, described)])
    return "; ".join([*found, *PlannedRobot.of(described).differences(PlannedRobot.of(own), names)])


def _with_urdf(cell: Cell, path: Path, root: ET.Element) -> Cell:
    """Return the cell with another URDF; where it names no links, with those at both ends of its joints."""
    robot = cell.robot
    names = {"base_link": robot.base_link, "flange": robot.flange}
    if robot.dh is not None:
        ends = [root.find(f"joint[@name='{robot.joints[i]}']/{tag}") for i, tag in ((0, "parent"), (-1, "child"))]
        names = {key: str(end.get("link")) for key, end in zip(names, ends, strict=True) if end is not None}
    changed = {**names, "urdf": str(path), "dh": None, "joint_limits": None, "inertials": None, "joint_types": None}
    return cell.model_copy(update={"robot": robot.model_copy(update=changed)})


def _limits_exceeded(own: Chain, described: Chain) -> list[str]:
    """Return where limits that the cell file states itself, which may be narrower, allow more than the description."""
    return [
        f"limits of {name} {its[0]:g} to {its[1]:g}, exceeded by {mine[0]:g} to {mine[1]:g}"
        for name, mine, its in zip(own.joints, own.limits, described.limits, strict=True)
        if mine[0] < its[0] - SAME_LIMIT or mine[1] > its[1] + SAME_LIMIT
    ]


def _screws_differ(own: Chain, other: Chain) -> list[str]:
    mine, its = _screws(own), _screws(other)
    off = np.abs(mine - its).max(axis=0)
    if off[0] <= SAME_ANGLE and off[1] <= SAME_SLIDE:
        return []
    return [f"the flange moves otherwise between the same postures, by {off[0]:.3f} rad and {1e3 * off[1]:.0f} mm"]


def _screws(chain: Chain) -> Float2D:
    """Return angle, rad, and slide, m, of the flange's screws from one of some postures to the next."""
    q = np.random.default_rng(7).uniform(-LARGEST, LARGEST, (POSTURES, chain.n))
    at = posture(chain, q)
    turns, places = np.moveaxis(at.flange, 2, 0).transpose(0, 2, 1), at.flange_origin.T
    return np.array([_screw(turns[i], places[i], turns[i + 1], places[i + 1]) for i in range(POSTURES - 1)])


def _screw(before: Float2D, at: Float1D, after: Float2D, to: Float1D) -> tuple[float, float]:
    turn = rotation_vector(after @ before.T)
    angle = float(np.linalg.norm(turn))
    if angle < SAME_ANGLE:  # joints that slide alone
        return angle, float(np.linalg.norm(to - at))
    return angle, float((to - after @ before.T @ at) @ turn / angle)
