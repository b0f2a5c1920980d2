"""The cell as it really is, hidden from whoever identifies it.

The cell file holds what is believed; a `Truth` holds what the simulation plays.  Randomness comes from separate streams
of one seed, so that truth, protocol and noise can each be varied alone.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from pathlib import Path
from types import MappingProxyType

import numpy as np

from calibration_core.cell import Cell
from calibration_core.files.yaml_file import yaml_text
from calibration_core.timeseries import Float1D, Float2D, read_only
from calibration_sim.cell.sensors import SOUND, Sensors
from calibration_sim.mechanics.transforms import Placement, placement, rotation_vector

TRUTH_STREAM, PROTOCOL_STREAM, NOISE_STREAM = range(3)


def generator(seed: int, stream: int) -> np.random.Generator:
    """Return the generator of one stream (truth, protocol or noise) of a seed."""
    return np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(stream,)))


@dataclasses.dataclass(frozen=True, eq=False)
class Truth:
    """What the simulated cell is made of.

    Attributes:
        stiffness: (n,) N*m/rad.
        gravity: (3,) m/s^2, base axes.
        joint_zero: (n,) rad, true joint angle minus encoder angle.
        joint_frame_errors: (n, 6) m and rad (rotation vector), of each joint's frame in its own nominal axes.
        tracker: Tracker frame in the base frame.
        force_torque: Sensor frame in the flange frame.
        wrench_point: (3,) m, flange frame.
        points: Measurement point -> (3,) m, flange frame.
        sensors: Instruments with their faults.
    """

    stiffness: Float1D
    gravity: Float1D
    joint_zero: Float1D
    joint_frame_errors: Float2D
    tracker: Placement
    force_torque: Placement
    wrench_point: Float1D
    points: Mapping[str, Float1D]
    sensors: Sensors = SOUND

    def __post_init__(self) -> None:
        """Copy arrays, make them read-only and freeze the mapping."""
        for name in ("stiffness", "gravity", "joint_zero", "joint_frame_errors", "wrench_point"):
            object.__setattr__(self, name, read_only(getattr(self, name)))
        points = {name: read_only(value) for name, value in self.points.items()}
        object.__setattr__(self, "points", MappingProxyType(points))


@dataclasses.dataclass(frozen=True)
class Spread:
    """One standard deviation of what a random truth differs by from the cell file.

    Attributes:
        stiffness: Of the logarithm of each stiffness.
        joint_zero: rad.
        joint_shift: m per axis of each joint's frame.
        joint_turn: rad per axis of each joint's frame.
        tracker_shift: m per axis.
        tracker_turn: rad per axis.
        sensor_turn: rad per axis.
        point: m per coordinate of each measurement point and of the wrench point.
    """

    stiffness: float = 0.15
    joint_zero: float = 0.0
    joint_shift: float = 0.0
    joint_turn: float = 0.0
    tracker_shift: float = 0.0
    tracker_turn: float = 0.0
    sensor_turn: float = 0.0
    point: float = 0.0


ROUGH = Spread()  # stiffnesses wrong, all else as stated
# A cell set up with care: what a first installation leaves before anything is refitted.
WORKSHOP = Spread(
    joint_zero=5e-4,
    joint_shift=3e-4,
    joint_turn=2e-4,
    tracker_shift=2e-3,
    tracker_turn=5e-4,
    sensor_turn=2e-3,
    point=1e-3,
)
# A cell of which nothing but the robot's nominal description is known: 0.5 mm and 0.5 mrad off in every joint's frame,
# the tracker somewhere about where somebody put it, the targets glued on by eye.
UNCALIBRATED = Spread(
    joint_zero=5e-4,
    joint_shift=5e-4,
    joint_turn=5e-4,
    tracker_shift=0.05,
    tracker_turn=0.02,
    point=3e-3,
)
SPREADS = {"draw": ROUGH, "workshop": WORKSHOP, "uncalibrated": UNCALIBRATED}


def nominal_truth(cell: Cell, sensors: Sensors = SOUND) -> Truth:
    """Return the cell exactly as its file states it.

    Raises:
        CellError: The file states no stiffness.
    """
    if cell.robot.stiffness is None:
        raise cell.missing("robot.stiffness", "simulating an elastic robot")
    n = len(cell.robot.joints)
    frames = cell.frames
    return Truth(
        stiffness=np.array(cell.robot.stiffness),
        gravity=cell.gravity,
        joint_zero=np.zeros(n),
        joint_frame_errors=np.zeros((n, 6)),
        tracker=placement(frames.tracker),
        force_torque=placement(frames.force_torque),
        wrench_point=np.array(frames.wrench_point or (0.0, 0.0, 0.0)),
        points={name: np.array(value) for name, value in frames.measurement_points.items()},
        sensors=sensors,
    )


def draw_truth(cell: Cell, seed: int, *, spread: Spread = ROUGH, sensors: Sensors = SOUND) -> Truth:
    """Return a random truth about the cell file's values; the same seed gives the same truth.

    Raises:
        CellError: The file states no stiffness.
    """
    nominal = nominal_truth(cell, sensors)
    rng = generator(seed, TRUTH_STREAM)
    n = len(nominal.stiffness)

    def moved(frame: Placement, shift: float, angle: float) -> Placement:
        turned = frame.rotation @ rotation_vector(angle * rng.standard_normal(3))
        return Placement(turned, frame.translation + shift * rng.standard_normal(3))

    scale = np.repeat([spread.joint_shift, spread.joint_turn], 3)
    return dataclasses.replace(
        nominal,
        stiffness=nominal.stiffness * np.exp(spread.stiffness * rng.standard_normal(n)),
        joint_zero=0.0 + spread.joint_zero * rng.standard_normal(n),
        joint_frame_errors=0.0 + scale * rng.standard_normal((n, 6)),
        tracker=moved(nominal.tracker, spread.tracker_shift, spread.tracker_turn),
        force_torque=moved(nominal.force_torque, 0.0, spread.sensor_turn),
        wrench_point=nominal.wrench_point + spread.point * rng.standard_normal(3),
        points={name: value + spread.point * rng.standard_normal(3) for name, value in nominal.points.items()},
    )


def write_truth(path: Path, truth: Truth, cell: Cell, *, seed: int) -> None:
    """Write the hidden truth as YAML: SI units, frames as origin and rotation matrix (rows)."""
    content = {
        "cell": cell.name,
        "robot": cell.robot.name,
        "seed": seed,
        "stiffness": dict(zip(cell.robot.joints, truth.stiffness.tolist(), strict=True)),
        "joint_zero": truth.joint_zero.tolist(),
        "joint_frame_errors": truth.joint_frame_errors.tolist(),
        "gravity": truth.gravity.tolist(),
        "tracker": _plain(truth.tracker),
        "force_torque": _plain(truth.force_torque),
        "wrench_point": truth.wrench_point.tolist(),
        "measurement_points": {name: value.tolist() for name, value in truth.points.items()},
        "sensors": dataclasses.asdict(truth.sensors),
    }
    path.write_text(yaml_text(_lists(content)), encoding="utf-8")


def _plain(frame: Placement) -> dict[str, object]:
    return {"xyz": frame.translation.tolist(), "rotation": frame.rotation.tolist()}


def _lists(value: object) -> object:
    """Turn tuples into lists, which YAML knows, at every depth."""
    if isinstance(value, dict):
        return {key: _lists(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [_lists(item) for item in value]
    return value
