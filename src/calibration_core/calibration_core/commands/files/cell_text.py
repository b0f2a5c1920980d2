"""The text of a new cell file: every value with what it means, and what is not known yet said so."""

from __future__ import annotations

import dataclasses
import json
import re
from collections.abc import Mapping, Sequence
from typing import TypeVar

from calibration_core.cell.schema import FIRST_LINE
from calibration_core.cell.serial_chain import SerialChain
from calibration_core.input_checks.cell_file import GUESS

SCHEMA_NAME, URDF_NAME = "cell.schema.json", "robot.urdf"
Value = TypeVar("Value")


@dataclasses.dataclass(frozen=True)
class Answers:
    """What is known of a cell; None: not known yet, a usual value is written and marked.

    Attributes:
        rated_load: kg.
        tracker: x y z (m) and roll pitch yaw (rad) in the base frame.
        sensor: The force/torque sensor in the flange frame, likewise.
        wrench_point: m, flange frame.
        points: Name -> m, flange frame.
        tracker_sigma: m for each coordinate.
        force_sigma: N.
        torque_sigma: N*m.
    """

    name: str
    robot: str
    source: str
    rated_load: float
    tracker: Sequence[float] | None = None
    sensor: Sequence[float] | None = None
    wrench_point: Sequence[float] | None = None
    points: Mapping[str, Sequence[float]] | None = None
    tracker_sigma: float | None = None
    force_sigma: float | None = None
    torque_sigma: float | None = None


def guessed(answers: Answers) -> tuple[str, ...]:
    """Return the places in the file that hold usual values, because nothing better is known."""
    instruments = {
        "instruments.tracker.sigma": answers.tracker_sigma,
        "instruments.force_torque.sigma_force": answers.force_sigma,
        "instruments.force_torque.sigma_torque": answers.torque_sigma,
    }
    frames = {
        "frames.force_torque": answers.sensor,
        "frames.wrench_point": answers.wrench_point,
        "frames.measurement_points": answers.points,
    }
    return tuple(place for place, value in {**frames, **instruments}.items() if value is None)


def cell_text(answers: Answers, chain: SerialChain, reach: float) -> str:
    """Return the cell file.

    Args:
        answers: What is known.
        chain: What the URDF says.
        reach: m, by which usual values are sized.
    """
    points = _stated(answers.points, _usual_points(reach))
    sensor = _stated(answers.sensor, (0.0,) * 6)
    wrench_point = _stated(answers.wrench_point, (0.0, 0.0, round(0.08 * reach, 3)))
    weight = answers.rated_load * 9.81
    sigma = _stated(answers.tracker_sigma, 2.0e-5)
    force = _stated(answers.force_sigma, max(4e-4 * weight, 0.02))
    torque = _stated(answers.torque_sigma, max(1e-4 * weight, 0.005))
    masses = (
        f"it states masses of {chain.masses:.4g} kg in all"
        if chain.masses
        else "it states no masses, so the sag of the links under their own weight is not predicted"
    )
    return f"""{FIRST_LINE.format(path=SCHEMA_NAME)}
# A robot cell for `calibration`.  SI units: m, rad, kg, N, N·m.  What is marked
# {GUESS} is a usual value and not yours.  Then: calibration check cell.yaml
name: {_text(answers.name)}
source: {_text(answers.source)}
robot:
  name: {_text(answers.robot)}
  urdf: {URDF_NAME}  # {masses}
  base_link: {_text(chain.base_link)}
  flange: {_text(chain.flange)}  # frames below are given in this one
  joints: [{", ".join(map(_text, chain.joints))}]  # as /joint_states names them
  rated_load: {answers.rated_load:g}  # kg
  # stiffness: [1.0e+6, ...]  # N·m/rad for each joint: what is believed today, if anything
frames:
{_tracker(answers.tracker)}
  force_torque: {_pose(sensor)}  # the sensor in the flange frame{_mark(answers.sensor)}
  wrench_point: {_row(wrench_point)}  # where the load pulls, in the flange frame{_mark(answers.wrench_point)}
  # the targets in the flange frame; three or more that are not in one line tell most
  measurement_points:{_mark(answers.points, 2)}
{_rows(points)}
instruments:  # one standard deviation of one averaged reading
  tracker: {{sigma: {sigma:.3g}}}  # m for each coordinate{_mark(answers.tracker_sigma)}
  force_torque: {{sigma_force: {force:.3g}, sigma_torque: {torque:.3g}}}  # N, N·m{_mark(answers.force_sigma)}
  # temperature: {{sigma: 0.1}}  # K, if it is recorded
measurements:
  points: absolute  # or displacement: x, y, z are differences to the unloaded step
  wrench_axes: sensor  # or base: the axes in which the wrench is recorded
  wrench_at: sensor  # or wrench_point: the point that the recorded torque is about
"""


def _stated(value: Value | None, usual: Value) -> Value:
    """Return what is known, zero too, and else the usual value."""
    return usual if value is None else value


def _tracker(pose: Sequence[float] | None) -> str:
    if pose is None:
        return "  # tracker: {xyz: [3.0, 0.0, 1.0], rpy: [0.0, 0.0, 3.14]}  # in the base frame; planning needs it"
    return f"  tracker: {_pose(pose)}  # the tracker in the base frame"


def _usual_points(reach: float) -> dict[str, tuple[float, float, float]]:
    far = round(min(max(0.1 * reach, 0.05), 0.25), 3)
    return {"mp1": (far, 0.0, 0.05), "mp2": (-0.5 * far, 0.87 * far, 0.05), "mp3": (-0.5 * far, -0.87 * far, 0.08)}


def _rows(points: Mapping[str, Sequence[float]]) -> str:
    return "\n".join(f"    {_text(name)}: {_row(place)}" for name, place in points.items())


def _mark(value: object, gap: int = 0) -> str:
    """Return the mark of a value that is not known; after a comment, or `gap` spaces after a key."""
    if value is not None:
        return ""
    return f"{' ' * gap}# {GUESS}" if gap else f"  {GUESS}"


def _pose(values: Sequence[float]) -> str:
    return f"{{xyz: {_row(values[:3])}, rpy: {_row([*values[3:], 0.0, 0.0, 0.0][:3])}}}"


def _row(values: Sequence[float]) -> str:
    return "[" + ", ".join(f"{value:z.6g}" for value in values) + "]"


def _text(text: str) -> str:
    """Return a text as YAML: plain where nothing can be mistaken, quoted otherwise."""
    plain = re.fullmatch(r"[A-Za-z_][\w./-]*( [\w./-]+)*", text, re.ASCII) and not re.fullmatch(
        r"(?i)null|true|false|yes|no|on|off|y|n|nan|inf", text
    )
    return text if plain else json.dumps(text, ensure_ascii=False)
