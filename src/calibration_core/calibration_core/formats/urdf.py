"""The calibrated robot as URDF: the cell's own with other joint origins, or a new one from DH rows.

Of a URDF everything stays but the `<origin>` of the joints between base and flange: inertials, meshes, limits, and what
else hangs on it.  `kinematics.yaml` holds the same origins joint by joint, for a xacro that loads them.
"""

from __future__ import annotations

import os
import re
from pathlib import Path
from xml.etree import ElementTree as ET

import numpy as np

from calibration_core.cell.urdf import urdf_bytes
from calibration_core.files.written import number, numbers
from calibration_core.files.yaml_file import yaml_text
from calibration_core.formats.calibrated import (
    Deviation,
    Exported,
    ExportedRobot,
    deviation,
    joint_frames,
    named,
    random_postures,
)
from calibration_core.model.chain import rpy_of
from calibration_core.model.urdf.tree import tree_of
from calibration_core.timeseries import Float1D, Float2D, Float3D

URDF, KINEMATICS = "robot.urdf", "kinematics.yaml"
BALL = 0.1  # m, radius of the ball that stands for a link's moments of inertia where they are not known
NOT_KNOWN = {"effort": "100000", "velocity": "3.14"}  # a URDF must state them; the cell file's DH rows have none


def urdf_files(robot: ExportedRobot, folder: Path) -> Exported:
    """Return `robot.urdf` and `kinematics.yaml`.

    Args:
        robot: What is exported.
        folder: Where the files will stand: relative names of meshes are written relative to it.

    Raises:
        CellError: The URDF of the cell cannot be read.
    """
    from_dh = robot.cell.urdf_path is None
    root, origins = _of_dh(robot) if from_dh else _of_urdf(robot, folder)
    root.insert(0, ET.Comment(_comment(robot)))
    ET.indent(root)
    raw = b'<?xml version="1.0"?>\n' + ET.tostring(root, encoding="utf-8") + b"\n"
    head = "# Origins of the calibrated joints in the links before them: m, rad, fixed axes (as <origin> of a URDF).\n"
    values = {name: _values(pose) for name, pose in origins.items()}
    notes = ["What a URDF has no words for (joint springs, effects) stands in the model file alone."]
    if from_dh:
        notes.append("Moments of inertia and the limits of effort and velocity are placeholders: DH rows have none.")
    return Exported(
        {URDF: raw, KINEMATICS: (head + yaml_text({"kinematics": values})).encode()},
        deviations=(_deviation(robot, raw),),
        notes=tuple(notes),
    )


def _deviation(robot: ExportedRobot, raw: bytes) -> Deviation:
    """Read the URDF with pinocchio and compare its forward kinematics with the chain's."""
    import pinocchio as pin

    cell = robot.cell
    base, flange = cell.robot.base_link or "base_link", cell.robot.flange or "flange"
    model = pin.buildModelFromXML(raw.decode())
    data = model.createData()
    index = [model.joints[model.getJointId(name)].idx_q for name in robot.chain.whole.joints]
    sizes = [model.joints[model.getJointId(name)].nq for name in robot.chain.whole.joints]
    ends = [model.getFrameId(base), model.getFrameId(flange)]
    rest = pin.neutral(model)
    q = random_postures(robot.chain)
    poses = np.empty((len(q), 4, 4))
    for k, row in enumerate(robot.chain.expanded(q)):
        values = rest.copy()
        for i, size, value in zip(index, sizes, row, strict=True):
            values[i : i + size] = (np.cos(value), np.sin(value)) if size == 2 else value
        pin.framesForwardKinematics(model, data, values)
        poses[k] = data.oMf[ends[0]].actInv(data.oMf[ends[1]]).homogeneous
    return deviation("kinematics of the URDF as pinocchio reads it", robot.chain, q, poses)


def _of_urdf(robot: ExportedRobot, folder: Path) -> tuple[ET.Element, dict[str, Float2D]]:
    """Return the cell's URDF with other joint origins.

    A joint's origin is followed by what the calibrated frame before it adds to the nominal one, turned into its axes:
    O' = O A (P^-1 P') A^-1, with A the smallest turn from z to the joint's axis.
    """
    cell = robot.cell
    path = cell.urdf_path
    assert path is not None  # noqa: S101 - asked for only where the cell has a URDF
    parser = ET.XMLParser(target=ET.TreeBuilder(insert_comments=True))
    root = ET.fromstring(urdf_bytes(path), parser)
    tree = tree_of(cell)
    elements = {str(joint.get("name")): joint for joint in root.findall("joint")}
    nominal, calibrated = joint_frames(robot.nominal), joint_frames(robot.chain)
    align = _alignments(robot)
    origins = {}
    for i, name in enumerate(cell.robot.joints):
        change = np.linalg.solve(nominal[i], calibrated[i])
        origin = tree.joints[name].origin
        pose = np.eye(4) if origin is None else np.asarray(origin, dtype=float)
        origins[name] = pose @ align[i] @ change @ align[i].T
        _set_origin(elements[name], origins[name])
    for before, after in zip(robot.nominal.mimics, robot.chain.mimics, strict=True):
        if after.offset != before.offset:
            _mimic_tag(elements[after.name]).set("offset", repr(after.offset))
    for mesh in root.iter("mesh"):
        mesh.set("filename", _moved(str(mesh.get("filename")), path.parent, folder))
    return root, origins


def _mimic_tag(joint: ET.Element) -> ET.Element:
    tag = joint.find("mimic")
    assert tag is not None  # noqa: S101 - the chain has it from there
    return tag


def _alignments(robot: ExportedRobot) -> Float3D:
    """Return per joint the (4, 4) turn from its axes in the chain, z along the axis, to those of the URDF."""
    from calibration_core.model.urdf.reading import joint_alignments

    poses = np.tile(np.eye(4), (robot.chain.n, 1, 1))
    poses[:, :3, :3] = joint_alignments(robot.cell)
    return poses


def _moved(name: str, beside: Path, folder: Path) -> str:
    """Return the name of a mesh for a URDF that stands elsewhere; URIs and absolute names stay."""
    if "://" in name or Path(name).is_absolute() or not (beside / name).is_file():
        return name
    return os.path.relpath(beside / name, folder.resolve())


def _of_dh(robot: ExportedRobot) -> tuple[ET.Element, dict[str, Float2D]]:
    cell, chain = robot.cell, robot.chain
    root = ET.Element("robot", name=re.sub(r"\W+", "_", cell.robot.name).strip("_") or "robot")
    ET.SubElement(root, "link", name="base_link")
    links = [*(f"link_{i + 1}" for i in range(chain.n)), "flange"]
    for i, name in enumerate(links):
        link = ET.SubElement(root, "link", name=name)
        if chain.mass is not None and chain.com is not None and i < chain.n:
            _inertial(link, float(chain.mass[i]), chain.com[i])
    poses = joint_frames(chain)
    parent = "base_link"
    for i, name in enumerate(chain.joints):
        joint = _joint(root, name, "prismatic" if chain.prismatic[i] else "revolute", parent, links[i], poses[i])
        ET.SubElement(joint, "axis", xyz="0 0 1")
        low, high = map(number, chain.limits[i])
        ET.SubElement(joint, "limit", {"lower": low, "upper": high, **NOT_KNOWN})
        parent = links[i]
    _joint(root, "flange_joint", "fixed", parent, "flange", poses[-1])
    return root, dict(zip(chain.joints, poses, strict=False))


def _inertial(link: ET.Element, mass: float, com: Float1D) -> None:
    inertial = ET.SubElement(link, "inertial")
    ET.SubElement(inertial, "origin", xyz=numbers(com), rpy="0 0 0")
    ET.SubElement(inertial, "mass", value=number(mass))
    ball = number(0.4 * mass * BALL**2)
    ET.SubElement(inertial, "inertia", ixx=ball, ixy="0", ixz="0", iyy=ball, iyz="0", izz=ball)


def _joint(root: ET.Element, name: str, kind: str, parent: str, child: str, pose: Float2D) -> ET.Element:
    joint = ET.SubElement(root, "joint", name=name, type=kind)
    ET.SubElement(joint, "parent", link=parent)
    ET.SubElement(joint, "child", link=child)
    _set_origin(joint, pose)
    return joint


def _set_origin(joint: ET.Element, pose: Float2D) -> None:
    origin = joint.find("origin")
    if origin is None:
        origin = ET.SubElement(joint, "origin")
    origin.set("xyz", numbers(pose[:3, 3]))
    origin.set("rpy", numbers(rpy_of(pose[:3, :3])))


def _values(pose: Float2D) -> dict[str, float]:
    numbers = [*pose[:3, 3], *rpy_of(pose[:3, :3])]
    return dict(zip(("x", "y", "z", "roll", "pitch", "yaw"), map(float, numbers), strict=True))


def _comment(robot: ExportedRobot) -> str:
    """Say what the origins hold; XML allows no two hyphens in a comment."""
    cell, change = robot.cell, _changes(robot)
    lines = [
        f" Calibrated kinematics of {cell.robot.name}, from the cell file {cell.path.name}.",
        "The origin of each joint holds the correction of the frame before it, the joint's zero offset folded in",
        "(mm and mrad in the frame before the joint, z along or about its axis):",
        *(f"  {name}: {text}" for name, text in zip(cell.robot.joints, change, strict=True)),
    ]
    if robot.folded:
        lines.append(f"Effects folded in: {'; '.join(named(robot.folded))}.")
    if robot.further:
        lines.append(f"Effects that a URDF cannot hold: {'; '.join(named(robot.further))}.")
    return "\n     ".join(lines).replace("--", "- -") + " "


def _changes(robot: ExportedRobot) -> list[str]:
    texts = []
    for before, after in zip(joint_frames(robot.nominal)[:-1], joint_frames(robot.chain)[:-1], strict=True):
        pose = np.linalg.solve(before, after)
        x, y, z = 1e3 * pose[:3, 3]
        rx, ry, offset = 1e3 * rpy_of(pose[:3, :3])
        texts.append(
            f"x {x:z.4f} y {y:z.4f} z {z:z.4f} mm, rx {rx:z.4f} ry {ry:z.4f} mrad, joint offset {offset:z.4f} mrad"
        )
    return texts
