"""The calibrated robot as a MuJoCo model: drives, a spring behind each, and more springs where the model has them.

Every robot joint is two joints of MuJoCo: the drive, which a position actuator holds where the encoder says, and
`<joint>_deflection` behind it, with the identified stiffness.  The control `<joint>` is the encoder's position; under a
load the deflections answer.  Off-axis compliances, bent links, base and tool compliances are further hinges and slides;
a compliance between two joints is a fixed tendon with a spring.
"""

from __future__ import annotations

from collections.abc import Sequence
from xml.etree import ElementTree as ET

import numpy as np

from calibration_core.files.written import numbers
from calibration_core.formats.calibrated import (
    Exported,
    ExportedRobot,
    deviation,
    joint_frames,
    named,
    random_postures,
    refuse_mimics,
)
from calibration_core.formats.springs import LinkSprings, Spring, Springs, springs_of
from calibration_core.model.chain import Chain
from calibration_core.timeseries import Float1D, Float2D, Float3D

FILE = "robot.xml"
LEAST_MASS = 1e-6  # kg: MuJoCo wants every moving body to be massive
BALL = 0.1  # m, radius of the ball that stands for a link's moments of inertia
MOST_JOINTS = 6  # of one body, says MuJoCo
DRIVE = 1e4  # a drive is so much stiffer than the spring behind it
RIGID_DRIVE = 1e8  # N*m/rad, where the joint has no spring
OWN_FREQUENCY = 2 * np.pi * 100.0  # rad/s of a spring with its armature alone: statics does not see it
DAMPING = 0.2  # of critical


def mjcf_files(robot: ExportedRobot) -> Exported:
    """Return `robot.xml`.

    Compliances between two joints become fixed tendons: the stiffness matrix of the pair is the inverse of its
    compliances, and its off-diagonal term the tendon's stiffness.

    Raises:
        InputError: Joints of the robot mimic others.
    """
    refuse_mimics(robot, "MJCF")
    chain = robot.chain
    springs = springs_of(chain, robot.further)
    stiffness, tendons = _joint_stiffness(chain, robot.parameters.compliance, springs)
    root = ET.Element("mujoco", model=robot.cell.robot.name)
    root.append(ET.Comment(_comment(robot, springs)))
    ET.SubElement(root, "compiler", angle="radian", autolimits="false")
    ET.SubElement(root, "option", gravity=numbers(chain.gravity), integrator="implicitfast", timestep="0.001")
    world = ET.SubElement(root, "worldbody")
    _bodies(world, robot, springs, stiffness)
    if tendons:
        listed = ET.SubElement(root, "tendon")
        for name, value, sign, first, second in tendons:
            fixed = ET.SubElement(listed, "fixed", name=name, stiffness=repr(value), springlength="0")
            ET.SubElement(fixed, "joint", joint=f"{chain.joints[first]}_deflection", coef="1")
            ET.SubElement(fixed, "joint", joint=f"{chain.joints[second]}_deflection", coef=repr(sign))
    actuators = ET.SubElement(root, "actuator")
    for i, name in enumerate(chain.joints):
        gain = _drive(stiffness[i])
        ET.SubElement(
            actuators, "position", name=name, joint=name, kp=repr(gain), kv=repr(2 * gain / OWN_FREQUENCY),
            ctrllimited="true", ctrlrange=numbers(chain.limits[i]),
        )  # fmt: skip
    ET.indent(root)
    notes = ["Set the control of each joint to its encoder's position; the deflections answer to loads and weight."]
    if chain.mass is None:
        notes.append("The masses of the links are not known: the model bends under external loads alone.")
    else:
        notes.append("Moments of inertia are placeholders: statics needs masses and centres of gravity alone.")
    written = ET.tostring(root, encoding="utf-8") + b"\n"
    q = random_postures(chain)
    compared = deviation(f"flange poses of {FILE}, its springs unloaded,", chain, q, _rebuilt(written, chain, q))
    return Exported({FILE: written}, held=springs.held, deviations=(compared,), notes=tuple(notes))


def _rebuilt(written: bytes, chain: Chain, q: Float2D) -> Float3D:
    """Return the (m, 4, 4) flange poses of what was written, its drives at q, (m, n), and its springs unloaded."""
    from scipy.spatial.transform import Rotation

    root = ET.fromstring(written)
    above = {child: parent for parent in root.iter("body") for child in parent.findall("body")}
    here = next(body for body in root.iter("body") if body.get("name") == "flange")
    branch = [here]
    while here in above:
        here = above[here]
        branch.insert(0, here)
    poses = np.tile(np.eye(4), (len(q), 1, 1))
    for body in branch:
        if body.get("pos") is not None:
            w, x, y, z = _floats(body, "quat")
            fixed = np.eye(4)
            fixed[:3, :3], fixed[:3, 3] = Rotation.from_quat([x, y, z, w]).as_matrix(), _floats(body, "pos")
            poses = poses @ fixed
        for joint in body.findall("joint"):
            if joint.get("name") in chain.joints:
                position, axis = q[:, chain.joints.index(str(joint.get("name")))], np.array(_floats(joint, "axis"))
                moved = np.tile(np.eye(4), (len(q), 1, 1))
                if joint.get("type") == "slide":
                    moved[:, :3, 3] = position[:, None] * axis
                else:
                    moved[:, :3, :3] = Rotation.from_rotvec(position[:, None] * axis).as_matrix()
                poses = poses @ moved
    return poses


def _floats(element: ET.Element, key: str) -> list[float]:
    return [float(text) for text in str(element.get(key)).split()]


def _joint_stiffness(
    chain: Chain, compliance: Float1D, springs: Springs
) -> tuple[Float1D, list[tuple[str, float, float, int, int]]]:
    """Return (n,) stiffness of the joints' own springs, 0 where rigid, and the tendons between joints."""
    matrix = np.diag(compliance)
    for first, second, between in springs.coupled:
        matrix[first, second] += between
        matrix[second, first] += between
    soft = np.flatnonzero(compliance > 0)
    full = np.zeros((chain.n, chain.n))
    full[np.ix_(soft, soft)] = np.linalg.inv(matrix[np.ix_(soft, soft)])
    own = np.diag(full).copy()
    tendons = []
    for first in range(chain.n):
        for second in range(first + 1, chain.n):
            value = full[first, second]
            if value == 0.0:
                continue
            own[[first, second]] -= abs(value)
            name = f"{chain.joints[first]}_with_{chain.joints[second]}"
            tendons.append((name, float(abs(value)), float(np.sign(value)), first, second))
    return own, tendons


def _drive(stiffness: float) -> float:
    """Return the gain of a joint's position actuator, N*m/rad."""
    return float(DRIVE * stiffness) if stiffness > 0 else RIGID_DRIVE


def _bodies(world: ET.Element, robot: ExportedRobot, springs: Springs, stiffness: Float1D) -> None:
    chain = robot.chain
    here = _carriers(ET.SubElement(world, "body", name="base"), "base", springs.base)
    poses = joint_frames(chain)
    for i, name in enumerate(chain.joints):
        own: LinkSprings = springs.links[i]
        here = _body(here, f"{name}_before", poses[i]) if own.before else here
        if own.before:
            here = _body(_carriers(here, f"{name}_before", own.before), f"{name}_drive", np.eye(4))
        else:
            here = _body(here, f"{name}_drive", poses[i])
        kind = "slide" if chain.prismatic[i] else "hinge"
        armature = _drive(stiffness[i]) / OWN_FREQUENCY**2
        ET.SubElement(here, "joint", name=name, type=kind, axis="0 0 1", armature=repr(armature))
        if stiffness[i] > 0:
            _spring(here, f"{name}_deflection", kind, np.array([0.0, 0.0, 1.0]), np.zeros(3), stiffness[i])
        if own.behind:
            _inertial(here, 0.0, np.zeros(3))
            here = _body(_carriers(_body(here, f"{name}_behind", np.eye(4)), f"{name}_behind", own.behind),
                         f"link_{i + 1}", np.eye(4))  # fmt: skip
        mass = 0.0 if chain.mass is None else float(chain.mass[i])
        _inertial(here, mass, np.zeros(3) if chain.com is None else chain.com[i])
        if own.beyond:
            here = _carriers(_body(here, f"{name}_beyond", np.eye(4)), f"{name}_beyond", own.beyond)
    here = _body(here, "flange", poses[-1])
    if springs.flange:
        here = _carriers(here, "tool", springs.flange)
    elif here.find("inertial") is None:
        _inertial(here, 0.0, np.zeros(3))
    if robot.parameters.wrench_point is not None:
        ET.SubElement(here, "site", name="wrench_point", pos=numbers(robot.parameters.wrench_point))
    for point, place in robot.parameters.points.items():
        ET.SubElement(here, "site", name=point, pos=numbers(place))


def _carriers(first: ET.Element, name: str, springs: Sequence[Spring]) -> ET.Element:
    """Put springs into a body and into as many more without mass as they need; return the last."""
    here = first
    for begin in range(0, len(springs), MOST_JOINTS):
        if begin:
            here = _body(here, f"{name}_{begin // MOST_JOINTS + 1}", np.eye(4))
        for k, spring in enumerate(springs[begin : begin + MOST_JOINTS], begin + 1):
            kind = "slide" if spring.slides else "hinge"
            _spring(here, f"{name}_spring_{k}", kind, spring.axis, spring.place, 1 / spring.compliance)
        _inertial(here, 0.0, np.zeros(3))
    return here


def _spring(body: ET.Element, name: str, kind: str, axis: Float1D, place: Float1D, stiffness: float) -> None:
    armature = stiffness / OWN_FREQUENCY**2
    ET.SubElement(
        body, "joint", name=name, type=kind, axis=numbers(axis), pos=numbers(place), stiffness=repr(float(stiffness)),
        armature=repr(float(armature)), damping=repr(float(2 * DAMPING * stiffness / OWN_FREQUENCY)),
    )  # fmt: skip


def _body(parent: ET.Element, name: str, pose: Float2D) -> ET.Element:
    return ET.SubElement(parent, "body", name=name, pos=numbers(pose[:3, 3]), quat=numbers(_quaternion(pose)))


def _quaternion(pose: Float2D) -> Float1D:
    """Return the (4,) unit quaternion w, x, y, z of a pose's rotation."""
    from scipy.spatial.transform import Rotation

    x, y, z, w = Rotation.from_matrix(pose[:3, :3]).as_quat()
    return np.array([w, x, y, z])


def _inertial(body: ET.Element, mass: float, com: Float1D) -> None:
    mass = max(mass, LEAST_MASS)
    ball = 0.4 * mass * BALL**2
    ET.SubElement(body, "inertial", pos=numbers(com), mass=repr(mass), diaginertia=numbers([ball] * 3))


def _comment(robot: ExportedRobot, springs: Springs) -> str:
    text = f" Calibrated robot {robot.cell.robot.name}: geometry and joint stiffness from the model file."
    left = tuple(effect for effect in robot.further if effect not in springs.held)
    if left:
        text += f" Effects that it does not hold: {'; '.join(named(left))}."
    return text.replace("--", "- -") + " "
