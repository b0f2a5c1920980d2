"""Robots of four sizes that sag under their own weight, calculated with pinocchio and with nothing of the product.

Stiffnesses are stated up to 40 % wrong, and postures stay where the tracker sees them.
"""

from __future__ import annotations

import dataclasses
from pathlib import Path

import numpy as np
import pinocchio as pin

from calibration_core.cell import Cell, load_cell
from calibration_core.files.yaml_file import yaml_text
from calibration_core.timeseries import Provenance, Readings

GRAVITY = 9.80665
SOLVED = 1e-15  # rad
SIZES = (6, 60, 210, 500)  # kg
LOW, HIGH = (np.array(q) for q in ((-1.6, -0.9, -0.9, -2.5, -1.8, -2.5), (1.6, 1.0, 1.2, 2.5, 1.8, 2.5)))
PLATE = ((0.15, -0.1, 0.2), (-0.18, 0.05, 0.16), (0.02, 0.2, 0.28))  # m, of a 210 kg robot
TRACKER = (3.1, -2.2, 0.9), (0.02, -0.01, 2.4)


@dataclasses.dataclass(frozen=True)
class Robot:
    """Joints (origin in the link before, axis), links (mass, centre of gravity in the link), stiffnesses; SI units."""

    joints: tuple[str, ...]
    origins: tuple[tuple[float, float, float], ...]
    axes: tuple[str, ...]
    masses: tuple[float, ...]
    centres: tuple[tuple[float, float, float], ...]
    stiffness: tuple[float, ...]

    @property
    def urdf(self) -> str:
        """The robot as a URDF."""
        links = ['<link name="base_link"/>', '<link name="flange"/>']
        joints = []
        before = "base_link"
        for k, name in enumerate(self.joints):
            x, y, z = self.centres[k]
            links.append(
                f'<link name="link_{k}"><inertial><origin xyz="{x} {y} {z}"/><mass value="{self.masses[k]}"/>'
                '<inertia ixx="1" iyy="1" izz="1" ixy="0" ixz="0" iyz="0"/></inertial></link>'
            )
            x, y, z = self.origins[k]
            joints.append(
                f'<joint name="{name}" type="revolute"><parent link="{before}"/><child link="link_{k}"/>'
                f'<origin xyz="{x} {y} {z}"/><axis xyz="{self.axes[k]}"/>'
                '<limit lower="-3" upper="3" effort="0" velocity="0"/></joint>'
            )
            before = f"link_{k}"
        joints.append(
            f'<joint name="plate" type="fixed"><parent link="{before}"/><child link="flange"/>'
            '<origin xyz="0 0 0" rpy="0 1.5707963267948966 0"/></joint>'
        )
        return "\n".join(['<?xml version="1.0"?>', '<robot name="independent">', *links, *joints, "</robot>"])


DOWN = ("0 0 -1", "0 1 0", "0 1 0", "-1 0 0", "0 1 0", "-1 0 0")
UP = ("0 0 1", "0 1 0", "0 1 0", "1 0 0", "0 1 0", "1 0 0")
ROBOTS = {
    6: Robot(
        ("A1", "A2", "A3", "A4", "A5", "A6"),
        ((0, 0, 0.2), (0.025, 0, 0.2), (0, 0, 0.455), (0.02, 0, 0.035), (0.4, 0, 0), (0.08, 0, 0)),
        UP,
        (10, 13, 8, 4, 2, 6),
        ((0, 0.02, 0.1), (0.01, 0.05, 0.2), (0.03, -0.03, 0.02), (0.2, 0.01, 0), (0.03, 0, 0.01), (0.06, 0.01, 0.03)),
        (4e4, 4.5e4, 3e4, 9e3, 8e3, 4e3),
    ),
    60: Robot(
        (
            "shoulder_pan_joint",
            "shoulder_lift_joint",
            "elbow_joint",
            "wrist_1_joint",
            "wrist_2_joint",
            "wrist_3_joint",
        ),
        ((0, 0, 0.35), (0.26, 0, 0.33), (0, 0, 0.93), (0.05, 0, 0.09), (0.95, 0, 0), (0.18, 0, 0)),
        DOWN,
        (180, 130, 95, 45, 22, 60),
        (
            (0.1, 0.02, 0.2),
            (0.02, 0.08, 0.42),
            (0.06, -0.04, 0.05),
            (0.45, 0.01, 0),
            (0.06, 0, 0.01),
            (0.12, 0.02, 0.05),
        ),
        (7e5, 6.5e5, 4.5e5, 1.3e5, 1.1e5, 6e4),
    ),
    210: Robot(
        ("joint_a1", "joint_a2", "joint_a3", "joint_a4", "joint_a5", "joint_a6"),
        ((0, 0, 0.35), (0.35, 0, 0.325), (0, 0, 1.15), (0.06, 0, 0.041), (1.0, 0, 0), (0.215, 0, 0)),
        DOWN,
        (400, 330, 220, 110, 50, 150),
        ((0.15, 0.03, 0.2), (0.03, 0.1, 0.5), (0.1, -0.05, 0.05), (0.5, 0.02, 0), (0.08, 0, 0.02), (0.2, 0.03, 0.08)),
        (2.2e6, 1.965e6, 1.5e6, 4.5e5, 4e5, 2.2e5),
    ),
    500: Robot(
        ("S", "L", "U", "R", "B", "T"),
        ((0, 0, 0.5), (0.5, 0, 0.545), (0, 0, 1.3), (0.1, 0, 0.055), (1.025, 0, 0), (0.29, 0, 0)),
        UP,
        (900, 750, 520, 250, 130, 350),
        ((0.2, 0.04, 0.3), (0.05, 0.15, 0.6), (0.15, -0.08, 0.08), (0.5, 0.03, 0), (0.1, 0, 0.03), (0.25, 0.04, 0.1)),
        (6e6, 5.5e6, 4e6, 1.3e6, 1.1e6, 6e5),
    ),
}  # fmt: skip


@dataclasses.dataclass(frozen=True, eq=False)
class Played:
    """A recording of postures at rest: its cell, as the cell file states it, and the true stiffnesses, (6,) N*m/rad."""

    readings: Readings
    cell: Cell
    stiffness: np.ndarray


def play(folder: Path, seed: int) -> Played:
    """Return a recording; everything that is not in the table of robots is drawn from the seed.

    Args:
        folder: Where cell file and URDF are written.
        seed: Robots of the four sizes take turns.
    """
    rng = np.random.default_rng(seed)
    size = SIZES[seed % len(SIZES)]
    robot = ROBOTS[size]
    stiffness = np.array(robot.stiffness) * np.exp(0.25 * rng.standard_normal(6))
    stated = stiffness * (1 + rng.choice([-1, 1], 6) * rng.uniform(0.05, 0.4, 6))
    configurations, count, sigma = int(rng.integers(30, 121)), int(rng.integers(1, 4)), float(rng.uniform(1e-5, 3e-5))
    names = [f"mp{k + 1}" for k in range(count)]
    plate = (size / 210) ** (1 / 3) * np.array(PLATE[:count])
    cell = _cell(folder, robot, size, stated, dict(zip(names, plate, strict=True)), sigma)
    model, zero = _true(robot, rng, wrong=bool(rng.integers(2)))
    span = (HIGH - LOW) * rng.uniform(0.15, 0.7, 6)
    q = LOW + (HIGH - LOW - span) * rng.uniform(0, 1, 6) + span * rng.uniform(0, 1, (configurations, 6))
    points = plate + 5e-4 * rng.standard_normal(plate.shape)
    turn = pin.rpy.rpyToMatrix(*(np.array(TRACKER[1]) + 1e-3 * rng.standard_normal(3)))
    place = np.array(TRACKER[0]) + 2e-3 * rng.standard_normal(3)
    seen = np.concatenate([(_sagged(model, row + zero, stiffness, points) - place) @ turn for row in q])
    readings = Readings(
        points=tuple(names),
        configuration=np.repeat(np.arange(1, configurations + 1), count),
        step=np.zeros(len(seen), dtype=np.int64),
        point=np.tile(np.arange(count), configurations),
        q=np.repeat(q, count, axis=0),
        position=seen + sigma * rng.standard_normal(seen.shape),
        wrench=None,
        time=np.full(len(seen), np.nan),
        temperature=np.full(len(seen), 20.0),
        provenance=Provenance(f"independent {seed}", "csv", {}, {}),
    )
    return Played(readings, cell, stiffness)


def _cell(
    folder: Path, robot: Robot, size: int, stated: np.ndarray, plate: dict[str, np.ndarray], sigma: float
) -> Cell:
    (folder / "robot.urdf").write_text(robot.urdf, encoding="utf-8")
    content = {
        "name": "independent",
        "robot": {
            "name": f"{size} kg",
            "urdf": "robot.urdf",
            "base_link": "base_link",
            "flange": "flange",
            "joints": list(robot.joints),
            "rated_load": float(size),
            "stiffness": stated.tolist(),
        },
        "frames": {
            "tracker": {"xyz": list(TRACKER[0]), "rpy": list(TRACKER[1])},
            "measurement_points": {name: point.tolist() for name, point in plate.items()},
        },
        "instruments": {"tracker": {"sigma": sigma}},
    }
    (folder / "cell.yaml").write_text(yaml_text(content), encoding="utf-8")
    return load_cell(folder / "cell.yaml")


def _true(robot: Robot, rng: np.random.Generator, *, wrong: bool) -> tuple[pin.Model, np.ndarray]:
    """Return the robot and the errors of its zeros, rad; lengths are off by a tenth of a millimetre where `wrong`."""
    model = pin.buildModelFromXML(robot.urdf)
    model.gravity.linear = np.array([0.0, 0.0, -GRAVITY])
    if not wrong:
        return model, np.zeros(6)
    for joint in range(1, 7):
        before = model.jointPlacements[joint]
        model.jointPlacements[joint] = pin.SE3(before.rotation, before.translation + 1e-4 * rng.standard_normal(3))
    return model, 1e-4 * rng.standard_normal(6)


def _sagged(model: pin.Model, q: np.ndarray, stiffness: np.ndarray, points: np.ndarray) -> np.ndarray:
    """Return where points of the flange, (k, 3) m, stand in base axes: joints turn by torque over stiffness."""
    data, sag = model.createData(), np.zeros(6)
    for _ in range(60):
        before, sag = sag, -pin.computeGeneralizedGravity(model, data, q + sag) / stiffness
        if np.abs(sag - before).max() < SOLVED:
            break
    pin.framesForwardKinematics(model, data, q + sag)
    flange = data.oMf[model.getFrameId("flange")]
    return points @ flange.rotation.T + flange.translation
