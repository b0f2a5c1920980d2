"""Denavit-Hartenberg rows of the calibrated robot, standard (distal) and modified (proximal).

T_base_flange = B prod_i [ Rz(theta_i) Tz(d_i) Tx(a_i) Rx(alpha_i) Ry(beta_i) ] F, with q_i added to theta_i, or to
d_i where the joint slides.  beta is zero in a plain row.  Where two axes are parallel or nearly so, their common normal
is ill-defined and d would run away: Hayati's row has d = 0 and the small turn beta instead.  The modified rows are the
same numbers, grouped otherwise: T = B prod_i [ Tx(a) Rx(alpha) Ry(beta) of the axis before, Rz(theta_i) Tz(d_i) ] F.
Sources: Denavit and Hartenberg (1955); Craig, Introduction to Robotics; Hayati and Mirmirani (1985).
"""

from __future__ import annotations

import dataclasses
import math
from typing import Any

import numpy as np

from calibration_core.files.written import csv_bytes
from calibration_core.files.yaml_file import yaml_text
from calibration_core.formats.calibrated import (
    Exported,
    ExportedRobot,
    deviation,
    joint_frames,
    random_postures,
    refuse_mimics,
)
from calibration_core.model.chain import Chain, rotation_x, rotation_y, rotation_z, rpy_of
from calibration_core.timeseries import Float1D, Float2D, Float3D

NEARLY_PARALLEL = 0.02  # sine of the angle between two axes below which a row takes Hayati's form
SAME = 1e-12  # m: axes so near to each other coincide
COLUMNS = ("joint", "form", "a", "alpha", "beta", "d", "theta")


@dataclasses.dataclass(frozen=True)
class ExportedDhRow:
    """One row, m and rad; `form` is `DH` or `Hayati`."""

    form: str
    theta: float
    d: float
    a: float
    alpha: float
    beta: float


@dataclasses.dataclass(frozen=True, eq=False)
class DhTable:
    """A chain in standard rows.

    Attributes:
        base: (4, 4) pose of frame 0 in the base frame; its z axis is the axis of the first joint.
        rows: One per joint.
        flange: (4, 4) pose of the flange in frame n.
    """

    base: Float2D
    rows: tuple[ExportedDhRow, ...]
    flange: Float2D

    def modified(self) -> tuple[ExportedDhRow, ...]:
        """Return the modified rows: a, alpha and beta of the axis before; the first has none."""
        before = (ExportedDhRow("DH", 0.0, 0.0, 0.0, 0.0, 0.0), *self.rows[:-1])
        return tuple(
            ExportedDhRow(b.form, row.theta, row.d, b.a, b.alpha, b.beta)
            for b, row in zip(before, self.rows, strict=True)
        )


def dh_files(robot: ExportedRobot) -> Exported:
    """Return `dh.csv`, `dh_modified.csv` and `dh.yaml` with both.

    Raises:
        InputError: Joints of the robot mimic others.
    """
    refuse_mimics(robot, "DH rows")
    chain = robot.chain
    table = dh_table(chain)
    q = random_postures(chain)
    standard, modified = rebuilt(table, q, chain.prismatic), rebuilt_modified(table, q, chain.prismatic)
    notes = ["Joint positions of the encoders are added to theta, or to d where the joint slides."]
    hayati = [name for name, row in zip(chain.joints, table.rows, strict=True) if row.form == "Hayati"]
    if hayati:
        notes.append(
            f"The axes of {', '.join(hayati)} and of the joint after each are parallel or nearly so: these rows are "
            "Hayati's, with beta about y after alpha, and d = 0."
        )
    notes.append("The table starts at `base` in the robot's base frame and ends at `flange` in the last frame.")
    return Exported(
        {
            "dh.csv": _csv(chain, table.rows),
            "dh_modified.csv": _csv(chain, table.modified()),
            "dh.yaml": yaml_text(_document(chain, table)).encode(),
        },
        deviations=(
            deviation("kinematics rebuilt from the standard rows", chain, q, standard),
            deviation("kinematics rebuilt from the modified rows", chain, q, modified),
        ),
        notes=tuple(notes),
    )


def dh_table(chain: Chain) -> DhTable:
    """Return the rows of a chain.

    The direction of every x axis is the one that leaves theta between -90 and 90 degrees.
    """
    poses = joint_frames(chain)
    frames = [poses[0]]
    for pose in poses[1:]:
        frames.append(frames[-1] @ pose)
    here = frames[0]
    rows = []
    for after in frames[1 : chain.n]:
        local = np.linalg.solve(here, after)
        row = _row(local[:3, 3], local[:3, 2])
        rows.append(row)
        here = here @ row_pose(row)
    local = np.linalg.solve(here, frames[-1])
    theta = 0.0 if np.hypot(local[0, 0], local[1, 0]) < 0.5 else _half_turn(math.atan2(local[1, 0], local[0, 0]))[0]
    last = ExportedDhRow("DH", theta, float(local[2, 3]), 0.0, 0.0, 0.0)
    return DhTable(frames[0], (*rows, last), np.asarray(np.linalg.inv(row_pose(last)) @ local))


def _row(place: Float1D, axis: Float1D) -> ExportedDhRow:
    """Return the row from a frame to the axis (unit vector) through a place, both (3,) in that frame."""
    across = math.hypot(axis[0], axis[1])
    if across > NEARLY_PARALLEL:
        theta, _ = _half_turn(math.atan2(axis[0], -axis[1]))
        place, axis = rotation_z(-theta) @ place, rotation_z(-theta) @ axis
        foot = place - place[1] / axis[1] * axis
        return ExportedDhRow("DH", theta, float(foot[2]), float(foot[0]), math.atan2(-axis[1], axis[2]), 0.0)
    foot = place - place[2] / axis[2] * axis
    distance = math.hypot(foot[0], foot[1])
    theta, sign = (0.0, 1.0) if distance < SAME else _half_turn(math.atan2(foot[1], foot[0]))
    axis = rotation_z(-theta) @ axis
    return ExportedDhRow("Hayati", theta, 0.0, sign * distance, math.atan2(-axis[1], axis[2]), math.asin(axis[0]))


def _half_turn(angle: float) -> tuple[float, float]:
    """Return an angle of the same line between -90 and 90 degrees, and -1 where its direction changed."""
    if angle > math.pi / 2 + 1e-9:
        return angle - math.pi, -1.0
    if angle < -math.pi / 2 - 1e-9:
        return angle + math.pi, -1.0
    return angle, 1.0


def row_pose(row: ExportedDhRow) -> Float2D:
    """Return Rz(theta) Tz(d) Tx(a) Rx(alpha) Ry(beta), (4, 4)."""
    return _joint_part(row.theta, row.d) @ _link_part(row)


def _joint_part(theta: float, d: float) -> Float2D:
    pose = np.eye(4)
    pose[:3, :3], pose[2, 3] = rotation_z(theta), d
    return pose


def _link_part(row: ExportedDhRow) -> Float2D:
    pose = np.eye(4)
    pose[:3, :3], pose[0, 3] = rotation_x(row.alpha) @ rotation_y(row.beta), row.a
    return pose


def rebuilt(table: DhTable, q: Float2D, prismatic: tuple[bool, ...]) -> Float3D:
    """Return the (m, 4, 4) flange poses of the standard rows at q, (m, n)."""
    poses = np.tile(table.base, (len(q), 1, 1))
    for values, row, slides in zip(q.T, table.rows, prismatic, strict=True):
        poses = poses @ _moved(values, row, slides=slides) @ _link_part(row)
    return np.asarray(poses @ table.flange)


def rebuilt_modified(table: DhTable, q: Float2D, prismatic: tuple[bool, ...]) -> Float3D:
    """Return the (m, 4, 4) flange poses of the modified rows at q, (m, n)."""
    poses = np.tile(table.base, (len(q), 1, 1))
    for values, row, slides in zip(q.T, table.modified(), prismatic, strict=True):
        poses = poses @ _link_part(row) @ _moved(values, row, slides=slides)
    return np.asarray(poses @ table.flange)


def _moved(values: Float1D, row: ExportedDhRow, *, slides: bool) -> Float3D:
    """Return (m, 4, 4) Rz(theta) Tz(d) at the joint positions."""
    return np.stack(
        [_joint_part(row.theta, row.d + x) if slides else _joint_part(row.theta + x, row.d) for x in values]
    )


def _csv(chain: Chain, rows: tuple[ExportedDhRow, ...]) -> bytes:
    named = zip(chain.joints, rows, strict=True)
    return csv_bytes(COLUMNS, ([name, *(getattr(row, column) for column in COLUMNS[1:])] for name, row in named))


def _document(chain: Chain, table: DhTable) -> dict[str, Any]:
    def listed(rows: tuple[ExportedDhRow, ...]) -> list[dict[str, Any]]:
        return [
            {"joint": name, **{key: getattr(row, key) for key in COLUMNS[1:]}}
            for name, row in zip(chain.joints, rows, strict=True)
        ]

    def pose(matrix: Float2D) -> dict[str, list[float]]:
        return {"xyz": [float(x) for x in matrix[:3, 3]], "rpy": [float(x) for x in rpy_of(matrix[:3, :3])]}

    return {
        "units": {"length": "m", "angle": "rad"},
        "joint_types": ["prismatic" if slides else "revolute" for slides in chain.prismatic],
        "base": pose(table.base),
        "flange": pose(table.flange),
        "standard": listed(table.rows),
        "modified": listed(table.modified()),
    }
