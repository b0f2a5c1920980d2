"""Corrected targets on recordings of real robots: one half of the blocks corrects, the other half judges.

Where a diagnosis says that a target or the tracker moved, the model has the place where it stood first, and a
prediction of later readings is wrong by the move.  The rows that stand apart are set aside then, and point and tracker
are taken where the others show them, those of the half that was fitted: MA1400's target moved by 5 mm between
configurations 80 and 90, and the tracker by 0.8 mm between 146 and 147.
"""

from __future__ import annotations

import dataclasses
from pathlib import Path

import numpy as np
import pytest

from calibration_core.cell import Cell, load_cell
from calibration_core.compensation.compensate import compensate
from calibration_core.compensation.motion import tool_movement
from calibration_core.compensation.robot import CalibratedRobot, Conditions, parts_of
from calibration_core.compensation.task import Task
from calibration_core.diagnosis.diagnose import diagnose
from calibration_core.identification.stiffness.predict import predict_readings
from calibration_core.model.parameters import ModelParameters
from calibration_core.observations.observe import observe
from calibration_core.timeseries import Readings

BESIDE = Path("shared/data/real")
ROOT = Path(__file__).resolve().parents[1]
DATA = next((found for parent in ROOT.parents if (found := parent / BESIDE).is_dir()), ROOT.parent / BESIDE)
BLOCKS = 10
MOST = 1.1  # times what the diagnosis leaves on the other blocks
RECORDINGS = {"ur5": "ur5_grid", "wam": "wam_grid", "motoman": "motoman", "ur10_A": "ur10_A"}

pytestmark = pytest.mark.skipif(not DATA.is_dir(), reason=f"{DATA} is not there")


def halves(readings: Readings) -> tuple[Readings, Readings]:
    """Return the odd and the even ones of ten blocks in row order."""
    numbers = np.unique(readings.configuration, return_index=True)
    order = numbers[0][np.argsort(numbers[1])]
    block = {int(c): k for k, part in enumerate(np.array_split(order, BLOCKS)) for c in part}
    odd = np.array([block[int(c)] % 2 == 0 for c in readings.configuration])
    return readings.select(odd), readings.select(~odd)


@dataclasses.dataclass(frozen=True, eq=False)
class Half:
    """Half of the blocks, with what was fitted to them.

    Attributes:
        readings: The blocks.
        model: Of their diagnosis.
        apart: First and last configurations of stretches in which the target or the tracker stood elsewhere.
    """

    readings: Readings
    model: ModelParameters
    apart: tuple[tuple[int, int], ...]

    @staticmethod
    def of(readings: Readings, cell: Cell) -> Half:
        found = diagnose(readings, cell)
        model = found.identification.model if found.model is None else found.model
        moved = [one for one in found.anomalies if one.kind in {"target_moved", "tracker_moved"}]
        return Half(readings, model, tuple((int(one.configurations[0]), int(one.configurations[-1])) for one in moved))

    def without(self, stretches: tuple[tuple[int, int], ...], cell: Cell) -> Half:
        """Leave stretches out, and take point and tracker where the rest shows them."""
        number = self.readings.configuration
        kept = ~np.any([(number >= first) & (number <= last) for first, last in stretches], axis=0)
        rest = self.readings.select(kept)
        robot = CalibratedRobot.of(cell, self.model)
        axes = robot.stand(rest.q, None).at.flange  # (3 axes of the flange, 3, m)
        error = (rest.position - predict_readings(rest, cell, self.model)) @ self.model.tracker[:3, :3].T
        columns = np.concatenate([np.moveaxis(axes, 2, 0).swapaxes(1, 2), np.tile(-np.eye(3), (len(error), 1, 1))], 2)
        shift = np.linalg.lstsq(columns.reshape(-1, 6), error.ravel(), rcond=None)[0]
        points = {name: point + shift[:3] for name, point in self.model.points.items()}
        tracker = self.model.tracker.copy()
        tracker[:3, 3] += shift[3:]
        model = self.model.replace(points=points, tracker=tracker)
        return Half(rest, model, ())


def seen(robot: CalibratedRobot, q: np.ndarray, conditions: Conditions) -> np.ndarray:
    """Return where the tool is by a model, (m, 3) m, tracker frame."""
    rest = robot.stand(q, None)
    parts = tuple(parts_of(robot, q, None, rest, conditions, turns=False))
    origin = robot.places(rest)[0].T + tool_movement(robot, parts, len(q), turns=False)
    tracker = robot.parameters.tracker
    return (origin - tracker[:3, 3]) @ tracker[:3, :3]


def judged(fitted: ModelParameters, judge: ModelParameters, other: Readings, cell: Cell) -> tuple[float, float, float]:
    """Return the error of corrected targets by the judge, what prediction leaves (rms, m), and the share corrected."""
    point = other.points[0]
    robot, judging = (CalibratedRobot.of(cell, model).at_point(point) for model in (fitted, judge))
    rows = np.flatnonzero(other.point == 0)
    m = len(rows)
    conditions = Conditions(other.time[rows], other.temperature[rows], np.zeros(m, dtype=np.int64))
    task = Task(
        (), ((),) * m, other.q[rows], None, np.zeros((m, 6)), conditions.temperature, conditions.time, conditions.path
    )
    found = compensate(robot, task, None)
    tracker = fitted.tracker
    target = (found.target.T - tracker[:3, 3]) @ tracker[:3, :3]
    error = (seen(judging, found.q, conditions) - target)[found.ok]
    left = predict_readings(other, cell, fitted) - other.position
    return float(np.sqrt(np.mean(error**2))), float(np.sqrt(np.mean(left**2))), float(found.ok.mean())


@pytest.mark.slow
@pytest.mark.parametrize("robot", RECORDINGS)
def test_corrected_targets_are_as_good_as_the_prediction_of_other_blocks(robot: str) -> None:
    cell = load_cell(DATA / f"{robot}.cell.yaml")
    odd, even = halves(observe(DATA / f"{RECORDINGS[robot]}.csv", cell))
    both = Half.of(odd, cell), Half.of(even, cell)
    apart = (*both[0].apart, *both[1].apart)
    if apart:
        print(f"{robot}: target or tracker stood elsewhere in configurations {apart}")
        both = both[0].without(apart, cell), both[1].without(apart, cell)
    for fitted, judge in (both, both[::-1]):
        error, left, share = judged(fitted.model, judge.model, judge.readings, cell)
        print(
            f"{robot}: corrected targets {1e3 * error:.4f} mm, prediction {1e3 * left:.4f} mm rms, {share:.3f} of rows"
        )
        assert share > 0.8
        assert error <= MOST * left
