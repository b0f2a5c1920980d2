"""Universal Robots' kinematics file, which `ur_description` and `ur_robot_driver` take as `kinematics_params_file`.

The file states, link by link, the pose (x, y, z, roll, pitch, yaw; fixed axes) of the link's frame in the one before;
each joint turns about the z axis of its link's frame.  The first frame stands in `base_link_inertia`, which is the
controller's base frame and is turned by half a turn about z against `base_link`; the last is `wrist_3_link`, which
equals `tool0`.  There are no rows with a common normal, so parallel axes need no special case.
`hash` is the controller's: the driver compares it to see whether the file belongs to the robot.
Sources: documentation of the packages ur_description (urdf/ur_macro.xacro) and ur_calibration.
"""

from __future__ import annotations

import dataclasses
import math
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np

from calibration_core.errors import InputError, quoted
from calibration_core.files.yaml_file import read_yaml, yaml_text
from calibration_core.formats.calibrated import (
    Exported,
    ExportedRobot,
    deviation,
    joint_frames,
    random_postures,
    refuse_mimics,
)
from calibration_core.model.chain import Chain, pose_matrix, rotation_rpy, rotation_z, rpy_of
from calibration_core.timeseries import Float2D, Float3D

LINKS = ("shoulder", "upper_arm", "forearm", "wrist_1", "wrist_2", "wrist_3")
KEYS = ("x", "y", "z", "roll", "pitch", "yaw")
FILE = "kinematics.yaml"
MAX_BYTES = 1 << 16
NEAREST = 0.05  # m and rad: by no more does a robot differ from the file extracted from it
SAME_AXIS = 1e-6  # m and rad
HOW = (
    "--template FILE, the file extracted from this robot's controller: "
    "ros2 launch ur_calibration calibration_correction.launch.py robot_ip:=<IP> target_filename:=<FILE>"
)


@dataclasses.dataclass(frozen=True, eq=False)
class Template:
    """The robot's own extracted file: (6, 4, 4) poses of the links, and the controller's hash."""

    poses: Float3D
    hash: str


def ur_files(robot: ExportedRobot, template: Path | None) -> Exported:
    """Return `kinematics.yaml`.

    Raises:
        InputError: There is no template, it cannot be used, or it is another robot's.
    """
    refuse_mimics(robot, "a UR's kinematics")
    if template is None:
        raise InputError("export --format ur", "--template", "nothing", HOW)
    extracted = read_template(template)
    poses, base, flange = ur_poses(robot.chain, extracted, template, robot.nominal)
    known = extracted.hash
    content: dict[str, Any] = {
        "kinematics": {
            **{
                link: dict(zip(KEYS, map(float, [*pose[:3, 3], *rpy_of(pose[:3, :3])]), strict=True))
                for link, pose in zip(LINKS, poses, strict=True)
            },
            "hash": known,
        }
    }
    q = random_postures(robot.chain)
    written = read_poses(content)
    return Exported(
        {FILE: yaml_text(content).encode()},
        deviations=(deviation("kinematics rebuilt from the file", robot.chain, q, rebuilt(written, q, base, flange)),),
        notes=(f"The file keeps the controller's hash {known}: give it to the driver as kinematics_params_file.",),
    )


def read_template(path: Path) -> Template:
    """Read an extracted kinematics file.

    Raises:
        InputError: It is missing or not of this form.
    """
    file = read_yaml(path, MAX_BYTES, "kinematics file of a Universal Robots controller (YAML)")
    with file.locating():
        content = file.data
        if not isinstance(content, dict) or not isinstance(content.get("kinematics"), dict):
            raise InputError(path, "kinematics", quoted(content), f"a mapping of {', '.join(LINKS)} and hash")
        kinematics = content["kinematics"]
        for link in LINKS:
            row = kinematics.get(link)
            if not isinstance(row, dict) or not all(_finite(row.get(key)) for key in KEYS):
                raise InputError(path, f"kinematics.{link}", quoted(row), f"finite numbers {', '.join(KEYS)}")
        known = kinematics.get("hash")
        if not isinstance(known, str) or not known.strip():
            raise InputError(path, "kinematics.hash", quoted(known), "the hash of the controller's calibration")
        return Template(read_poses(content), known)


def _finite(value: object) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool) and math.isfinite(value)


def read_poses(content: dict[str, Any]) -> Float3D:
    """Return the (6, 4, 4) poses that a kinematics file states."""
    rows = [[float(content["kinematics"][link][key]) for key in KEYS] for link in LINKS]
    return np.stack([pose_matrix(np.array(row[:3]), np.array(row[3:])) for row in rows])


def rebuilt(poses: Float3D, q: Float2D, base: Float2D, flange: Float2D) -> Float3D:
    """Return the (m, 4, 4) poses of the cell's flange in the cell's base frame, from a file's link poses.

    Args:
        poses: (6, 4, 4).
        q: (m, 6) rad.
        base: (4, 4) pose of `base_link_inertia` in the cell's base frame.
        flange: (4, 4) pose of the cell's flange in `wrist_3_link`.
    """
    here = np.tile(base, (len(q), 1, 1))
    turned = np.tile(np.eye(4), (len(q), 1, 1))
    for pose, values in zip(poses, q.T, strict=True):
        turned[:, :3, :3] = np.stack([rotation_z(float(value)) for value in values])
        here = here @ pose @ turned
    return np.asarray(here @ flange)


def ur_poses(chain: Chain, template: Template, path: Path, nominal: Chain) -> tuple[Float3D, Float2D, Float2D]:
    """Return the (6, 4, 4) link poses, and the (4, 4) `base` and `flange` of `rebuilt`.

    A link's frame may slide along its axis and turn about it; it is put where it comes nearest to the template's, so
    that meshes and collision bodies stay where they belong.

    Raises:
        InputError: The robot has not six revolute joints, or is not the template's.
    """
    if chain.n != len(LINKS) or any(chain.prismatic):
        raise InputError(
            "export --format ur", "robot.joints", f"{chain.n} joints", "the six revolute joints of a UR robot"
        )
    best: tuple[float, Float2D, Float2D] | None = None
    for base, flange in product(_bases(), _flanges()):
        gap = _gap(nominal, template.poses, base, flange)
        if best is None or gap < best[0]:
            best = gap, base, flange
    assert best is not None  # noqa: S101 - there are four ways to try
    gap, base, flange = best
    if gap > NEAREST:
        raise InputError(
            path,
            "kinematics",
            f"link frames that differ by up to {gap:.3g} m or rad from the cell file's robot",
            f"the file of this robot (differences below {NEAREST:g}; base frame base or base_link, flange tool0 or "
            "flange of ur_description)",
        )
    return _linked(chain, template.poses, base, flange), base, flange


def _bases() -> tuple[Float2D, ...]:
    """Return poses of `base_link_inertia` in the cell's base frame: it is that frame, or the cell's is `base_link`."""
    half = np.eye(4)
    half[:3, :3] = rotation_z(math.pi)
    return np.eye(4), half


def _flanges() -> tuple[Float2D, ...]:
    """Return poses of the cell's flange in `wrist_3_link`: `tool0` or `flange` of ur_description."""
    flange = np.eye(4)
    flange[:3, :3] = rotation_rpy(0.0, -math.pi / 2, -math.pi / 2)
    return np.eye(4), flange


def _gap(chain: Chain, template: Float3D, base: Float2D, flange: Float2D) -> float:
    """Return how far the chain's link frames are from the template's at zero, m or rad, the larger."""
    end = joint_frames(chain)[-1] @ np.linalg.inv(flange)
    if math.hypot(*end[:2, 2], *end[:2, 3]) > SAME_AXIS:
        return math.inf  # the last frame of the file turns with the last joint about its own z axis
    ours, theirs = _cumulated(_linked(chain, template, base, flange)), _cumulated(template)
    moved = np.linalg.norm(ours[:, :3, 3] - theirs[:, :3, 3], axis=1).max()
    turned = np.linalg.norm(ours[:, :3, :3] - theirs[:, :3, :3], axis=(1, 2)).max() / math.sqrt(2)
    return float(max(moved, turned))


def _linked(chain: Chain, template: Float3D, base: Float2D, flange: Float2D) -> Float3D:
    """Return the (6, 4, 4) link poses of a chain, frames as near to the template's as their axes allow."""
    own = joint_frames(chain)
    theirs = _cumulated(template)
    here, before = np.linalg.inv(base), np.eye(4)
    poses = []
    for i in range(chain.n):
        here = here @ own[i]
        placed = here @ _along_axis(here, theirs[i]) if i < chain.n - 1 else here @ own[-1] @ np.linalg.inv(flange)
        poses.append(np.linalg.solve(before, placed))
        before = placed
    return np.stack(poses)


def _along_axis(here: Float2D, there: Float2D) -> Float2D:
    """Return the turn about and movement along the z axis of a frame that bring it nearest to another."""
    local = np.linalg.solve(here, there)
    pose = np.eye(4)
    pose[:3, :3] = rotation_z(math.atan2(local[1, 0] - local[0, 1], local[0, 0] + local[1, 1]))
    pose[2, 3] = local[2, 3]
    return pose


def _cumulated(poses: Float3D) -> Float3D:
    frames: list[Float2D] = []
    here = np.eye(4)
    for pose in poses:
        here = here @ pose
        frames.append(here)
    return np.stack(frames)
