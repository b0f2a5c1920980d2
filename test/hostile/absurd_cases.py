"""Inputs that are absurd but plausible: what is changed in a good recording, and what is to be said of it."""

from __future__ import annotations

import dataclasses
import tempfile
from collections.abc import Iterator, Sequence
from pathlib import Path

import numpy as np
from input_cases import wrench

from calibration_core.cell import Cell, load_cell
from calibration_core.files.yaml_file import yaml_text
from calibration_core.input_checks.anomaly import InputAnomaly
from calibration_core.input_checks.check import check_inputs
from calibration_core.input_checks.wrench_axes import quarter_turns
from calibration_core.timeseries import Readings
from calibration_sim.effects.draw import robot_cell
from calibration_sim.scenarios.generate import Generated, generate
from calibration_sim.scenarios.grid import Scenario

ZERO = 0.05  # rad
MOST_AMPLITUDE = 50.0  # times its typical size
OTHERS = {"heavy": "giant", "light": "middle", "tiny": "light", "middle": "heavy", "giant": "heavy"}


@dataclasses.dataclass(frozen=True, eq=False)
class Absurd:
    """One changed input.

    Attributes:
        name: Of the change.
        readings, cell: As changed.
        kinds: The words of the contract, one of which is to be said.
        joints: The joints that are to be named; empty: none.
        factor: The factor that is to be named; None: none.
    """

    name: str
    readings: Readings
    cell: Cell
    kinds: frozenset[str]
    joints: tuple[str, ...] = ()
    factor: float | None = None

    def named_by(self, found: Sequence[InputAnomaly]) -> bool:
        """Say whether this is what was found first."""
        first = next((one for one in found if one.blocks), None)
        if first is None or first.kind not in self.kinds or (self.joints and first.joints != self.joints):
            return False
        return self.factor is None or (first.factor is not None and abs(first.factor / self.factor - 1) < 1e-6)


def absurd_inputs(readings: Readings, cell: Cell, robot: str, rng: np.random.Generator) -> Iterator[Absurd]:
    """Yield every change of a good loaded recording of a robot of the simulation."""
    joints, n = cell.robot.joints, readings.q.shape[1]

    def made(name: str, changed: Readings, kind: str, joints: tuple[str, ...] = (), factor: float | None = None,
             described: Cell = cell) -> Absurd:  # fmt: skip
        return Absurd(name, changed, described, frozenset(kind.split("|")), joints, factor)

    def placed(position: np.ndarray) -> Readings:
        return dataclasses.replace(readings, position=position)

    def angled(q: np.ndarray) -> Readings:
        return dataclasses.replace(readings, q=q)

    def pulled(force: float, torque: float | None = None, turn: np.ndarray | None = None) -> Readings:
        return wrench(force, torque or force, turn)(readings, cell)[0]

    turns = quarter_turns()
    yield made("sign of the wrench", pulled(-1.0), "wrench_sign", factor=-1.0)
    yield made("forces in kN", pulled(1e-3), "wrench_unit", factor=1e3)
    yield made("torques in N·mm", pulled(1.0, 1e3), "wrench_unit", factor=1e-3)
    yield made("positions / 1000", placed(readings.position / 1e3), "position_unit", factor=1e3)
    yield made("positions in mm", placed(readings.position * 1e3), "position_unit", factor=1e-3)
    for i, j in ((1, 2), (3, 5)):
        q = readings.q.copy()
        q[:, [i, j]] = q[:, [j, i]]
        yield made(f"joints {i + 1} and {j + 1} exchanged", angled(q), "joint_order", (joints[i], joints[j]))
    yield made("angles in degrees", angled(np.degrees(readings.q)), "angle_unit", factor=np.pi / 180)
    kept = {"measurements": cell.measurements, "instruments": cell.instruments}
    other = robot_cell(OTHERS[robot]).model_copy(update=kept)
    yield made("another robot's file", readings, "wrong_robot_file|no_relation", described=other)
    turn = turns[rng.integers(len(turns))]
    yield made("sensor turned by quarters", pulled(1.0, 1.0, turn), "wrench_frame")
    yield made("wrench_at", readings, "wrench_frame", described=_read(cell, wrench_at="wrench_point"))
    yield made("wrench_axes", readings, "wrench_frame", described=_read(cell, wrench_axes="base"))
    yield made("rows shuffled", placed(readings.position[rng.permutation(len(readings))]), "no_relation")
    order = np.array([1, 0, *range(2, len(readings.points))])
    yield made("two points exchanged", dataclasses.replace(readings, point=order[readings.point]), "point_order")
    axis = int(rng.integers(2))
    mirrored = {
        name: tuple(-x if k == axis else x for k, x in enumerate(xyz))
        for name, xyz in cell.frames.measurement_points.items()
    }
    yield made("points mirrored", readings, "point_order", described=_framed(cell, measurement_points=mirrored))
    for joint in range(1, n):  # the first joint's zero turns robot and tracker frame together: nothing changes
        sign = 1.0 if rng.random() < 0.5 else -1.0
        q = readings.q + sign * ZERO * np.eye(n)[joint]
        yield made(f"zero of joint {joint + 1} off", angled(q), "wrong_robot_file", (joints[joint],))
    if cell.frames.tracker is not None:
        far = cell.frames.tracker.model_copy(update={"xyz": tuple(1e3 * x for x in cell.frames.tracker.xyz)})
        yield made("tracker at 4,000 m", readings, "position_unit", factor=1e-3, described=_framed(cell, tracker=far))


def _read(cell: Cell, **how: str) -> Cell:
    return cell.model_copy(update={"measurements": cell.measurements.model_copy(update=how)})


def _framed(cell: Cell, **frames: object) -> Cell:
    return cell.model_copy(update={"frames": cell.frames.model_copy(update=frames)})


def made(scenario: Scenario, folder: Path) -> tuple[Readings, Cell]:
    """Return a simulated recording and its cell."""
    return written(generate(scenario), folder)


def written(played: Generated, folder: Path) -> tuple[Readings, Cell]:
    """Return the readings of a simulated recording and the cell that its file describes."""
    path = folder / "cell.yaml"
    path.write_text(yaml_text(played.cell), encoding="utf-8")
    return played.readings, load_cell(path)


def broken(played: Generated) -> bool:
    """Say whether an effect is so large that the robot is broken, and a joint stands far from where it is said to be.

    The first grid makes the members of its pairs as large as their signal demands: a backlash that shows little in
    the steps of a plan comes to 447 times its typical size, 45 mrad, and holds the joint 22 mrad off throughout.
    """
    return any(effect["amplitude"] > MOST_AMPLITUDE for effect in played.label["effects"])


def refused(scenario: Scenario) -> list[str] | None:
    """Return what is said of a good recording that would refuse it; None where the robot is broken."""
    played = generate(scenario)
    if broken(played):
        return None
    with tempfile.TemporaryDirectory() as folder:
        found = [one for one in check_inputs(*written(played, Path(folder))) if one.blocks]
    return [f"{scenario.group} {scenario.robot} {scenario.protocol} {scenario.seed}: {one.text}" for one in found]
