"""`calibration_core.plan`: which configurations and loads to measure."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, Literal

import numpy as np

from calibration_core.cell import Cell
from calibration_core.cli import parse
from calibration_core.commands.planning.arguments import LOAD_SHARE
from calibration_core.commands.planning.plan import Planned, make
from calibration_core.library.arguments import Seed, checked, differing
from calibration_core.library.models import HoldsModel, given_model
from calibration_core.library.result import Columns, Picture, Result
from calibration_core.planning.plans.plan import Plan
from calibration_core.recording.tables.columns import WRENCH, joint_columns
from calibration_core.report.writing.output import Content

Criterion = Literal["D", "A", "worst", "condition", "observability", "trace"]


@dataclasses.dataclass(frozen=True, eq=False, repr=False)
class PlanResult(Result):
    """Configurations with their loads, in the order in which they are measured.

    Attributes:
        cell: The cell that it was made for.
        planned: The plan and what is said of it.
    """

    planned: Planned

    @property
    def plan(self) -> Plan:
        """The plan: joint angles in rad, wrenches in N and N*m (base axes, at the wrench point)."""
        return self.planned.plan

    @property
    def tables(self) -> Mapping[str, Columns]:
        """`configurations` (rad: Table 1 of the standard) and `loads` (N, N*m, base axes, at the wrench point)."""
        chosen = self.plan.configurations
        q = np.array([one.q for one in chosen])
        loads = [(one.number, step, *wrench) for one in chosen for step, wrench in enumerate(one.steps)]
        return {
            "configurations": {
                "configuration": [one.number for one in chosen],
                **dict(zip(joint_columns(self.cell), q.T, strict=True)),
                "spare": [one.spare for one in chosen],
            },
            "loads": dict(zip(("configuration", "step", *WRENCH), zip(*loads, strict=True), strict=True)),
        }

    @property
    def summary(self) -> str:
        """What is planned and what it promises, in a few lines, as the command prints it; standard deviations in %."""
        return self.planned.summary

    def plot(self) -> Picture:
        """Draw the configurations in the operating space, base frame, m."""
        from calibration_core.report.figures.operating_space import space_figure

        return Picture(space_figure(self.planned.space), "Operating space of the plan, base frame, m")

    def files(self, *, report: bool = True) -> dict[str, Content]:
        """Return result, plan, Table 1 and report: file name -> bytes; arguments as for `save`."""
        return self.planned.files(report=report)

    def _content(self) -> dict[str, Any]:
        return self.planned.content


@checked
def plan(
    cell: Cell,
    *,
    configurations: int = 18,
    spares: float = 0.5,
    seed: Seed = 0,
    criterion: Criterion = "D",
    phases: bool = False,
    load_levels: Sequence[float] | None = None,
    load_share: float = LOAD_SHARE,
    largest_force: float | None = None,
    largest_torque: float | None = None,
    box: Sequence[float] | None = None,
    task: str | Path | None = None,
    model: str | Path | HoldsModel | None = None,
) -> PlanResult:
    """Choose configurations, loads and order for a measurement of joint stiffness.

    Args:
        cell: The cell.
        configurations: How many to measure, at least 12.
        spares: Spare configurations, as a share of those to measure.
        seed: The same seed gives the same plan.
        criterion: Determinant, mean or worst variance, or one of the indices of the standard.
        phases: Plan also what finds base frame, geometry, wrist centre and points before.
        load_levels: Load steps as shares of the full pull, the first 0; None: nine steps up and down.
        load_share: Full pull and end effector as a share of the rated load.
        largest_force: Range of the force sensor, N.
        largest_torque: Range of the torque sensor, N*m.
        box: Operating space: x, y and z in the base frame, lower and upper end of each, six numbers in m.
        task: Operating space: a file with the places of a task, columns x, y, z in m or q1 ... in rad.
        model: An identified model to plan with, instead of the cell file's.

    Returns:
        Configurations (rad), wrenches (N, N*m, base axes), and the expected standard deviations.

    Raises:
        InputError: An argument makes no sense, or no plan can be made under it.

    Source: CWA 17384, 5.1 and 5.4; D-optimal exchange (Fedorov, 1972).
    """
    options = parse(["plan", f"--cell={cell.path}"])
    asked = {"load_share": load_share, "largest_force": largest_force, "largest_torque": largest_torque}
    vars(options).update(
        stated=differing(asked, plan, {name: f"--{name.replace('_', '-')}" for name in asked}),
        configurations=configurations,
        spares=spares,
        seed=seed,
        criterion=criterion,
        phases=phases,
        load_levels=None if load_levels is None else list(load_levels),
        load_share=load_share,
        largest_force=largest_force,
        largest_torque=largest_torque,
        box=None if box is None else list(box),
        task=None if task is None else Path(task),
    )
    given = None if model is None else given_model(model, cell)
    return PlanResult(cell, make(options, cell, given))
