"""`calibration_core.deflect` and `compensate`: a calibrated robot under load, and where to send it."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, Literal

import numpy as np
from numpy.typing import ArrayLike

from calibration_core.cell import Cell
from calibration_core.commands.application import compensate as compensating
from calibration_core.commands.application import deflect as deflecting
from calibration_core.compensation.inverse import rpy_of_axes
from calibration_core.compensation.requests import Request, finite
from calibration_core.compensation.robot import CalibratedRobot
from calibration_core.compensation.tables import PLACE
from calibration_core.compensation.task import Task, places, read_task
from calibration_core.errors import InputError
from calibration_core.library.arguments import Numbers, checked
from calibration_core.library.models import HoldsModel, given_model
from calibration_core.library.result import Columns, Picture, Result
from calibration_core.model.identified.model_file import GivenModel
from calibration_core.outcomes.compensation import Applied, Deflected, apply, deflected
from calibration_core.outcomes.inputs import Inputs, digest_of
from calibration_core.recording.tables.columns import WRENCH, joint_columns
from calibration_core.report.writing.output import Content
from calibration_core.timeseries import Bool1D, Float1D, Float2D, Float3D

Axes = Literal["base", "tool"]
Plane = Literal["xy", "xz", "yz"]


@dataclasses.dataclass(frozen=True, eq=False, repr=False)
class DeflectionResult(Result):
    """How far a load moves and turns tool and points, against the robot under its own weight and that of its payload.

    Attributes:
        cell: The cell that it holds for.
        done: Places, wrenches and what they do.
        inputs: Role -> name -> SHA-256 of what it rests on.
    """

    done: Deflected
    inputs: Inputs

    @property
    def points(self) -> tuple[str, ...]:
        """Names of the p points, `tool` first, no unit."""
        return self.done.found.names

    @property
    def moved(self) -> Float3D:
        """(m, p, 6) displacement (m) and turn (rad) of every point, base axes."""
        return self.done.found.moved

    @property
    def u95(self) -> Float3D:
        """(m, p, 6) half widths of the 95 % intervals of `moved`, m and rad; NaN where the model has no covariance."""
        return self.done.found.u95

    @property
    def stiffness(self) -> tuple[Float2D, Float3D]:
        """(m, 3) main stiffnesses of the tool's point, N/m, softest first; their directions (m, 3, 3), base axes."""
        return self.done.found.stiffness()

    @property
    def tables(self) -> Mapping[str, Columns]:
        """`deflections`: one row per place and point, m and rad, base axes."""
        found = self.done.found
        names = ("dx", "dy", "dz", "rx", "ry", "rz")
        m, p = found.moved.shape[:2]
        columns: dict[str, Any] = {"row": np.repeat(np.arange(1, m + 1), p), "point": list(found.names) * m}
        columns |= dict(zip(names, found.moved.reshape(-1, 6).T, strict=True))
        columns |= {f"u95_{name}": values for name, values in zip(names, found.u95.reshape(-1, 6).T, strict=True)}
        return {"deflections": columns}

    @property
    def summary(self) -> str:
        """The first places in a few lines, as the command prints them; mm, mrad, N/µm."""
        return deflecting.summary(self.done)

    def plot(self) -> Picture:
        """Draw how far the tool yields, mm, over a plane through the first place, m."""
        from calibration_core.report.figures.deflection_map import map_figure

        chart = self.done.chart
        assert chart is not None  # noqa: S101 - the library always makes one
        return Picture(map_figure(chart.across, chart.up, 1e3 * chart.size, chart.plane), "Deflection of the tool")

    def files(self, *, report: bool = True) -> dict[str, Content]:
        """Return result, table and report: file name -> bytes; arguments as for `save`."""
        return deflecting.files_of(self.done, self.cell, self.inputs, report=report)

    def _content(self) -> dict[str, Any]:
        return deflecting.deflection_result(self.done, self.cell, self.inputs)


@dataclasses.dataclass(frozen=True, eq=False, repr=False)
class CompensationResult(Result):
    """Where to send the robot so that its tool arrives; rows that are refused keep their nominal angles.

    Attributes:
        cell: The cell that it holds for.
        applied: The task with its corrections.
        inputs: Role -> name -> SHA-256 of what it rests on.
    """

    applied: Applied
    inputs: Inputs

    @property
    def q(self) -> Float2D:
        """(m, n) corrected joint angles, rad (m where a joint slides)."""
        return self.applied.found.q

    @property
    def ok(self) -> Bool1D:
        """(m,) which rows were corrected, no unit."""
        return self.applied.found.ok

    @property
    def status(self) -> tuple[str, ...]:
        """Per row `ok`, or why it was refused, no unit."""
        return self.applied.found.status

    @property
    def error_before(self) -> Float1D:
        """(m,) m: expected distance of the tool from its target without the correction; NaN where refused early."""
        return self.applied.found.lengths[0]

    @property
    def u95(self) -> Float1D:
        """(m,) m: what that distance exceeds in one of twenty cases with the correction; NaN where not known."""
        return self.applied.found.u95

    @property
    def tables(self) -> Mapping[str, Columns]:
        """`compensated`: corrected angles (rad), corrected places (m, rad, base frame), errors (m) and status."""
        found = self.applied.found
        place = np.hstack([found.sent.T, rpy_of_axes(found.sent_axes)])
        before, after = found.lengths
        columns: dict[str, Any] = dict(zip(WRENCH, self.applied.task.wrench.T, strict=True))
        columns |= dict(zip(joint_columns(self.cell), found.q.T, strict=True))
        columns |= dict(zip(PLACE, place.T, strict=True))
        columns |= {"error_before": before, "error_after": after, "u95": found.u95, "status": list(found.status)}
        return {"compensated": columns}

    @property
    def summary(self) -> str:
        """What came out, in a few lines, as the command prints it; mm."""
        return compensating.summary(self.applied)

    def plot(self) -> Picture:
        """Draw the errors row by row, mm: without the correction, and what is to be expected with it."""
        from calibration_core.report.figures.application import errors_figure

        before, after = self.applied.found.lengths
        labels = "row", "predicted with"
        return Picture(errors_figure(1e3 * before, 1e3 * after, 1e3 * self.u95, labels), "Errors at the tool")

    def files(self, *, report: bool = True) -> dict[str, Content]:
        """Return result, corrected targets and report: file name -> bytes; arguments as for `save`."""
        return compensating.files_of(self.applied, self.cell, self.inputs, report=report)

    def _content(self) -> dict[str, Any]:
        return compensating.compensation_result(self.applied, self.cell, self.inputs)


@checked
def deflect(
    cell: Cell,
    model: str | Path | HoldsModel,
    task: str | Path | Numbers,
    wrench: Numbers | None = None,
    *,
    axes: Axes = "base",
    payload: Sequence[float] | None = None,
    plane: Plane = "xz",
) -> DeflectionResult:
    """Predict where a load moves tool and measurement points of a calibrated robot.

    Args:
        cell: The cell.
        model: A model file, or the result of `identify` or `diagnose`.
        task: Joint angles (m, n) or (n,), rad (m where a joint slides), or a file with places.
        wrench: (6,) or (m, 6) N and N*m of the environment on the robot, at the wrench point; None: as the file says.
        axes: Axes of the wrench.
        payload: Mass (kg) and centre of gravity (m, flange frame) of what hangs on the flange before the load pulls:
            the answer is against the robot with it; None: nothing.
        plane: Plane of the drawing, through the first place.

    Returns:
        Displacements (m) and turns (rad) in base axes with their 95 % intervals, and the tool's stiffness (N/m).

    Raises:
        InputError: Model or task cannot be used, nothing pulls, a place is out of reach, or a load is beyond the rated
            load.
        EquilibriumError: A load is beyond what the joints can carry.

    Source: static equilibrium on the deformed geometry, CWA 17384, 6.2.
    """
    given, robot, inputs = _ready(cell, model, Request(axes, _payload(payload)), task, "poses")
    asked = _task(cell, task, wrench)
    done = deflected(robot, given.calibrated, asked, axes=axes, plane=plane)
    return DeflectionResult(cell, done, inputs)


@checked
def compensate(
    cell: Cell,
    model: str | Path | HoldsModel,
    task: str | Path | Numbers,
    wrench: Numbers | None = None,
    *,
    axes: Axes = "base",
    payload: Sequence[float] | None = None,
    seed_q: Numbers | None = None,
    one_path: bool = False,
) -> CompensationResult:
    """Correct targets so that the tool of the calibrated, loaded robot reaches them.

    Args:
        cell: The cell.
        model: A model file, or the result of `identify` or `diagnose`.
        task: Joint angles (m, n) or (n,), rad (m where a joint slides): the target is where the nominal robot has its
            tool there; or a file with places, angles, wrenches, temperatures, times and paths.
        wrench: (6,) or (m, 6) N and N*m of the environment on the robot, at the wrench point; None: as the file says.
        axes: Axes of the wrench.
        payload: Mass (kg) and centre of gravity (m, flange frame) of what the robot carries; None: nothing.
        seed_q: (n,) rad, chooses the branch where a file states places alone; None: the middle of the limits.
        one_path: Whether angles given as an array are one path, in order of travel.

    Returns:
        Corrected angles (rad) and places (m, rad), with the errors to be expected (m); a row that cannot be corrected
        is refused by name.

    Raises:
        InputError: Model or task cannot be used; angles are in degrees; or the times of the file let a point of the
            robot move faster than 250 mm/s.
        EquilibriumError: A load is beyond what the joints can carry.

    Source: Newton's method on the calibrated, loaded robot; static equilibrium of CWA 17384, 6.2.
    """
    given, robot, inputs = _ready(cell, model, Request(axes, _payload(payload)), task, "task")
    asked = _task(cell, task, wrench, one_path=one_path)
    seed = None if seed_q is None else _array("seed_q", seed_q, (len(cell.robot.joints),))
    found = apply(robot, given.calibrated, asked, axes=axes, seed_q=seed)
    return CompensationResult(cell, found, inputs)


def _ready(
    cell: Cell, model: str | Path | HoldsModel, request: Request, task: object, role: str
) -> tuple[GivenModel, CalibratedRobot, Inputs]:
    given = given_model(model, cell)
    inputs = dict(given.digest)
    if isinstance(task, str | Path):
        inputs[role] = digest_of(Path(task))
    return given, CalibratedRobot.of(cell, given.parameters, request.payload), inputs


def _payload(payload: Sequence[float] | None) -> tuple[float, ...] | None:
    return None if payload is None else tuple(float(x) for x in _array("payload", payload, (4,)))


def _task(cell: Cell, task: str | Path | ArrayLike, wrench: ArrayLike | None, *, one_path: bool = False) -> Task:
    if isinstance(task, str | Path):
        asked = read_task(Path(task), cell)
    else:
        n = len(cell.robot.joints)
        angles = np.atleast_2d(np.asarray(task, dtype=np.float64))
        asked = places(q=_array("task", angles, (len(angles), n)), one_path=one_path)
        header = tuple(joint_columns(cell))
        asked = dataclasses.replace(asked, header=header, rows=tuple(tuple(map(repr, row)) for row in angles.tolist()))
    if wrench is None:
        return asked
    loads = np.asarray(wrench, dtype=np.float64)
    if loads.ndim == 1:
        return asked.with_wrench(_array("wrench", loads, (6,)).tolist())
    return dataclasses.replace(asked, wrench=_array("wrench", loads, (len(asked), 6)))


def _array(name: str, values: ArrayLike, shape: tuple[int, ...]) -> Any:
    """Return finite numbers of a shape.

    Raises:
        InputError: They have another shape, or one is not finite.
    """
    array = np.asarray(values, dtype=np.float64)
    if array.shape != shape:
        raise InputError("arguments", name, f"an array of shape {array.shape}", f"shape {shape}")
    finite(name, array)
    return array
