"""The robots on which the diagnosis is proved, and what is typical of their class.

The magnitudes of the robots of 240 kg and of 10 kg are those of `docs/physics.md` (A1-A4), chosen within its ranges;
those of 3, 60 and 500 kg are set one by one and follow no power of the load.  An effect of amplitude one has them.
"""

from __future__ import annotations

import dataclasses
import functools
from pathlib import Path

from calibration_core.cell import Cell, load_cell

CELLS = Path(__file__).with_name("cells")
ROBOTS = ("heavy", "light")
MORE_ROBOTS = ("tiny", "middle", "giant")  # 3, 60 and 500 kg
FIRST_AXIS = {"column": 1}  # index of the arm's first axis, where the arm stands on further ones


@dataclasses.dataclass(frozen=True)
class Magnitudes:
    """What is typical of a class of robots, SI units.

    Attributes:
        bearing: rad/(N*m), tilting of the first three joints' bearings.
        wrist_bearing: rad/(N*m), of the last three.
        bending: 1/EI, 1/(N*m^2).
        base_rotation: rad/(N*m).
        base_translation: m/N.
        tool_rotation: rad/(N*m).
        tool_translation: m/N.
        coupling: Of the geometric mean of two compliances.
        modulation: Of a joint's compliance with its angle.
        compensator: Anchor (m), arm (m), stiffness (N/m), free length (m).
        hardening: At the rated torque.
        soft: Additional compliance below the first torque.
        soft_torque: First torque of the soft zone, of the rated one.
        clearance: rad, first three joints and last three.
        clearance_torque: Of the rated torque.
        friction: rad, half width, first three joints and last three.
        creep: Per decade of time.
        creep_time: s.
        rated_torque: N*m, each joint's under the rated load.
        gain: Of the wrench.
        drift: N/s and N*m/s.
        sensor_turn: rad.
        wrench_point: m.
        tool_mass: kg.
        cable: N.
        tracker_turn: rad.
        tracker_scale: Relative.
        tracker_drift: m/s.
        tracker_rate: rad/s.
        point: m.
        zero: rad.
        length: m.
        angle: rad.
        transmission: rad.
        wrist_coupling: rad/rad.
        warm_up: K.
        approach: rad.
        beams: Links (index) that are long enough to bend.
    """

    bearing: float
    wrist_bearing: float
    bending: float
    base_rotation: float
    base_translation: float
    tool_rotation: float
    tool_translation: float
    compensator: tuple[float, float, float, float]
    clearance: tuple[float, float]
    friction: tuple[float, float]
    rated_torque: tuple[float, ...]
    drift: tuple[float, float]
    wrench_point: float
    tool_mass: float
    cable: float
    point: float
    length: float
    transmission: float
    wrist_coupling: float
    approach: float
    coupling: float = 0.10
    modulation: float = 0.05
    hardening: float = 0.10
    soft: float = 0.65
    soft_torque: float = 0.12
    clearance_torque: float = 0.015
    creep: float = 0.02
    creep_time: float = 60.0
    gain: float = 0.01
    sensor_turn: float = 8.7e-3
    tracker_turn: float = 1.75e-3
    tracker_scale: float = 20e-6
    tracker_drift: float = 10e-6 / 3600.0
    tracker_rate: float = 7e-6 / 3600.0
    zero: float = 1e-3
    angle: float = 5e-4
    warm_up: float = 6.0
    beams: tuple[int, ...] = (0, 1, 3)


MAGNITUDES = {
    "heavy": Magnitudes(
        bearing=1 / 8e6,
        wrist_bearing=1 / 2e6,
        bending=1 / 6e6,
        base_rotation=1 / 3e7,
        base_translation=1 / 5e8,
        tool_rotation=1 / 2.5e6,
        tool_translation=1 / 3e8,
        compensator=(0.2, 0.75, 1.75e5, 0.45),
        clearance=(1.5e-4, 3e-4),
        friction=(5e-5, 1e-4),
        rated_torque=(5000.0, 9000.0, 6000.0, 1200.0, 1200.0, 400.0),
        drift=(5.0 / 3600.0, 0.5 / 3600.0),
        wrench_point=5e-3,
        tool_mass=10.0,
        cable=30.0,
        point=2e-3,
        length=5e-4,
        transmission=1.5e-4,
        wrist_coupling=2e-4,
        approach=1e-4,
    ),
    "light": Magnitudes(
        bearing=1 / 3e5,
        wrist_bearing=1 / 3e5,
        bending=1 / 8e4,
        base_rotation=1 / 1e6,
        base_translation=1 / 2e7,
        tool_rotation=1 / 2e5,
        tool_translation=1 / 2e7,
        compensator=(0.08, 0.30, 9.2e3, 0.18),
        clearance=(1e-4, 1e-4),
        friction=(1e-4, 1.5e-4),
        rated_torque=(80.0, 130.0, 70.0, 20.0, 20.0, 7.0),
        drift=(0.5 / 3600.0, 0.05 / 3600.0),
        wrench_point=2e-3,
        tool_mass=1.0,
        cable=3.0,
        point=1e-3,
        length=3e-4,
        transmission=3e-4,
        wrist_coupling=1e-3,
        approach=3e-4,
    ),
    "tiny": Magnitudes(
        bearing=1 / 7e4,
        wrist_bearing=1 / 4e4,
        bending=1 / 3e4,
        base_rotation=1 / 3e5,
        base_translation=1 / 9e6,
        tool_rotation=1 / 6e4,
        tool_translation=1 / 9e6,
        compensator=(0.05, 0.16, 2.4e3, 0.10),
        clearance=(1.6e-4, 2.2e-4),
        friction=(1.6e-4, 2.4e-4),
        rated_torque=(18.0, 24.0, 14.0, 5.0, 5.0, 2.5),
        drift=(0.2 / 3600.0, 0.02 / 3600.0),
        wrench_point=1.5e-3,
        tool_mass=0.4,
        cable=1.2,
        point=8e-4,
        length=2.5e-4,
        transmission=4e-4,
        wrist_coupling=1.2e-3,
        approach=2.5e-4,
        coupling=0.08,
        modulation=0.07,
        hardening=0.13,
        soft=0.8,
        soft_torque=0.16,
        creep=0.028,
        creep_time=40.0,
        beams=(1, 2),
    ),
    "middle": Magnitudes(
        bearing=1 / 1.6e6,
        wrist_bearing=1 / 5e5,
        bending=1 / 1.1e6,
        base_rotation=1 / 9e6,
        base_translation=1 / 1.2e8,
        tool_rotation=1 / 9e5,
        tool_translation=1 / 1.1e8,
        compensator=(0.14, 0.52, 6.5e4, 0.31),
        clearance=(1.1e-4, 2.1e-4),
        friction=(8e-5, 1.3e-4),
        rated_torque=(900.0, 1500.0, 800.0, 180.0, 180.0, 80.0),
        drift=(2.0 / 3600.0, 0.2 / 3600.0),
        wrench_point=3e-3,
        tool_mass=4.0,
        cable=14.0,
        point=1.5e-3,
        length=4e-4,
        transmission=2e-4,
        wrist_coupling=5e-4,
        approach=1.6e-4,
        coupling=0.13,
        modulation=0.06,
        hardening=0.08,
        soft=0.5,
        soft_torque=0.10,
        creep=0.015,
        creep_time=110.0,
        beams=(0, 1, 2),
    ),
    "giant": Magnitudes(
        bearing=1 / 2.2e7,
        wrist_bearing=1 / 5e6,
        bending=1 / 1.3e7,
        base_rotation=1 / 5e7,
        base_translation=1 / 9e8,
        tool_rotation=1 / 6e6,
        tool_translation=1 / 6e8,
        compensator=(0.26, 0.9, 3.1e5, 0.52),
        clearance=(1.3e-4, 2.6e-4),
        friction=(4e-5, 8e-5),
        rated_torque=(12000.0, 21000.0, 13000.0, 3200.0, 3200.0, 1300.0),
        drift=(9.0 / 3600.0, 1.0 / 3600.0),
        wrench_point=6e-3,
        tool_mass=22.0,
        cable=60.0,
        point=2.5e-3,
        length=6e-4,
        transmission=1.2e-4,
        wrist_coupling=1.5e-4,
        approach=8e-5,
        coupling=0.09,
        modulation=0.04,
        hardening=0.12,
        soft=0.6,
        soft_torque=0.09,
        creep=0.012,
        creep_time=150.0,
    ),
}
MAGNITUDES["column"] = MAGNITUDES["light"]  # the same arm, on a lifting column


@functools.cache
def robot_cell(name: str) -> Cell:
    """Return the cell of a robot, one of `ROBOTS` or `MORE_ROBOTS` or `FIRST_AXIS`, as its file states it."""
    return load_cell(CELLS / f"{name}.cell.yaml")
