"""From a URDF to a chain, through pinocchio."""

from __future__ import annotations

import contextlib
import os
import tempfile
from collections.abc import Iterator
from typing import Any
from xml.etree import ElementTree as ET

import numpy as np
import pinocchio as pin

from calibration_core.cell import Cell
from calibration_core.errors import CellError, quoted
from calibration_core.model.chain import Chain, rotation_x
from calibration_core.timeseries import Float1D, Float2D

CONTINUOUS_LIMIT = 2 * np.pi
MAX_URDF_BYTES = 64 << 20


def chain_of_urdf(cell: Cell) -> Chain:
    """Return the kinematic chain between the links that the cell file names, with the URDF's masses.

    Raises:
        CellError: The URDF is missing, malformed, or does not hold the joints and links that the cell file names.
    """
    model = load_urdf(cell)
    data = model.createData()
    pin.forwardKinematics(model, data, pin.neutral(model))
    pin.updateFramePlacements(model, data)
    base, flange = (frame_of(cell, model, data, key) for key in ("base_link", "flange"))
    to_base = base.inverse()
    ids = joint_ids(cell, model)
    axes = _axes(cell, model, data, ids)

    n = len(ids)
    rotation, translation = np.empty((n, 3, 3)), np.empty((n, 3))
    bodies: list[Any] = []
    previous = pin.SE3.Identity()
    for i, (joint, axis) in enumerate(zip(ids, axes, strict=True)):
        here = to_base * data.oMi[joint]
        frame = pin.SE3(here.rotation @ _align_z(axis), here.translation)
        step = previous.inverse() * frame
        rotation[i], translation[i] = step.rotation, step.translation
        bodies.append(frame)
        previous = frame
    end = previous.inverse() * (to_base * flange)
    mass, com = _masses(cell, model, data, ids, [to_base.inverse() * body for body in bodies])
    return Chain(
        joints=cell.robot.joints,
        rotation=rotation,
        translation=translation,
        offset=np.zeros(n),
        flange_rotation=end.rotation,
        flange_translation=end.translation,
        limits=_limits(cell, model, ids),
        gravity=cell.gravity,
        mass=mass,
        com=com,
        inertials_known=cell.robot.inertials_known,
    )


def load_urdf(cell: Cell) -> Any:
    """Return the URDF's `pinocchio.Model`; raise CellError where it is missing or malformed."""
    path = cell.urdf_path
    assert path is not None  # noqa: S101 - the cell has a URDF on this branch
    try:
        if path.stat().st_size > MAX_URDF_BYTES:
            raise CellError(path, "", f"{path.stat().st_size} bytes", f"a URDF of at most {MAX_URDF_BYTES} bytes")
        text = path.read_text(encoding="utf-8")
        root = ET.fromstring(text)
    except OSError as error:
        raise CellError(path, "", error.strerror or str(error), "a URDF (robot.urdf of the cell file)") from None
    except (ET.ParseError, UnicodeDecodeError) as error:
        raise CellError(path, "", str(error), "well-formed XML (URDF)") from None
    if root.tag != "robot":
        raise CellError(path, "", f"<{root.tag}>", "<robot> as the outermost element")
    said: list[str] = []
    try:
        with captured_stderr(said):
            return pin.buildModelFromXML(text)
    except (RuntimeError, ValueError) as error:
        raise CellError(path, "", " ".join(said) or str(error), "a URDF that pinocchio can read") from None


@contextlib.contextmanager
def captured_stderr(said: list[str]) -> Iterator[None]:
    """Collect what the C++ parser prints, so that a faulty file gets one line and not a page."""
    kept = os.dup(2)
    with tempfile.TemporaryFile() as sink:
        os.dup2(sink.fileno(), 2)
        try:
            yield
        finally:
            os.dup2(kept, 2)
            os.close(kept)
            sink.seek(0)
            said.extend(sink.read(2000).decode(errors="replace").split())


def frame_of(cell: Cell, model: Any, data: Any, key: str) -> Any:
    """Return the pose in the model's world of the link that the cell file names under `key`, or raise CellError."""
    name = getattr(cell.robot, key)
    if not model.existFrame(name):
        names = ", ".join(frame.name for frame in model.frames if frame.type == pin.FrameType.BODY)
        raise CellError(cell.path, f"robot.{key}", quoted(name), f"a link of the URDF: {names}")
    return data.oMf[model.getFrameId(name)]


def joint_ids(cell: Cell, model: Any) -> list[int]:
    """Return the model's numbers of the cell file's joints, or raise CellError where they are no chain."""
    known = [name for name in model.names if name != "universe"]
    ids = []
    for i, name in enumerate(cell.robot.joints):
        if name not in known:
            raise CellError(
                cell.path, f"robot.joints.{i}", quoted(name), "a moving joint of the URDF: " + ", ".join(known)
            )
        ids.append(model.getJointId(name))
    support = list(model.supports[model.frames[model.getFrameId(cell.robot.flange)].parentJoint])
    chain = [joint for joint in support if joint in ids]
    if chain != ids:
        order = ", ".join(model.names[joint] for joint in chain) or "none of them"
        raise CellError(
            cell.path, "robot.joints", ", ".join(cell.robot.joints), f"the joints from base to flange: {order}"
        )
    return ids


def _axes(cell: Cell, model: Any, data: Any, ids: list[int]) -> list[Float1D]:
    pin.computeJointJacobians(model, data, pin.neutral(model))
    axes = []
    for i, joint in enumerate(ids):
        column = pin.getJointJacobian(model, data, joint, pin.LOCAL)[:, model.joints[joint].idx_v]
        if model.joints[joint].nv != 1 or np.linalg.norm(column[3:]) < 0.5:
            raise CellError(
                cell.path, f"robot.joints.{i}", f"{cell.robot.joints[i]!r}, no rotary joint", "a rotary joint"
            )
        axes.append(column[3:] / np.linalg.norm(column[3:]))
    return axes


def _align_z(axis: Float1D) -> Float2D:
    """Return the smallest rotation that takes z to `axis`."""
    z = np.array([0.0, 0.0, 1.0])
    c = float(axis @ z)
    if c > 1 - 1e-12:
        return np.eye(3)
    if c < -1 + 1e-12:
        return rotation_x(np.pi)
    v = np.cross(z, axis)
    skew = np.array([[0, -v[2], v[1]], [v[2], 0, -v[0]], [-v[1], v[0], 0]])
    return np.eye(3) + skew + skew @ skew / (1 + c)


def _masses(cell: Cell, model: Any, data: Any, ids: list[int], bodies: list[Any]) -> tuple[Any, Any]:
    """Gather every body's mass on the nearest joint of the chain below it (other joints stand at zero)."""
    n = len(ids)
    if cell.robot.inertials is not None:
        raise CellError(cell.path, "robot.inertials", "inertials beside a urdf", "the URDF's own inertials only")
    mass, moment = np.zeros(n), np.zeros((n, 3))
    for joint in range(1, model.njoints):
        carriers = [ids.index(j) for j in model.supports[joint] if j in ids]
        inertia = model.inertias[joint]
        if carriers and inertia.mass > 0:
            link = carriers[-1]
            com = bodies[link].inverse() * data.oMi[joint] * inertia.lever
            mass[link] += inertia.mass
            moment[link] += inertia.mass * com
    if not mass.any():
        return None, None
    return mass, moment / np.where(mass > 0, mass, 1.0)[:, None]


def _limits(cell: Cell, model: Any, ids: list[int]) -> Float2D:
    if cell.robot.joint_limits is not None:
        return np.array(cell.robot.joint_limits, dtype=float)
    limits = np.empty((len(ids), 2))
    for i, joint in enumerate(ids):
        index = model.joints[joint].idx_q
        bounded = model.joints[joint].nq == 1
        low = model.lowerPositionLimit[index] if bounded else -np.inf
        high = model.upperPositionLimit[index] if bounded else np.inf
        known = np.isfinite([low, high]).all() and low < high and abs(low) < 1e6 and abs(high) < 1e6
        limits[i] = (low, high) if known else (-CONTINUOUS_LIMIT, CONTINUOUS_LIMIT)
    return limits
