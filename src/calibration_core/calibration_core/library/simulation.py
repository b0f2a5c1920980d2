"""`calibration_core.simulate`: a recording as a model predicts it."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from calibration_core.cell import Cell
from calibration_core.commands.evaluation.simulate import files_of, simulation_result, simulation_summary
from calibration_core.library.arguments import Seed, checked
from calibration_core.library.models import HoldsModel, given_model
from calibration_core.library.planning import PlanResult
from calibration_core.library.recordings import Recording
from calibration_core.library.result import Columns, Picture, Result
from calibration_core.outcomes.inputs import digest_of
from calibration_core.outcomes.simulation import Simulated
from calibration_core.outcomes.simulation import simulate as simulated_by
from calibration_core.planning.plans.plan_file import read_plan
from calibration_core.report.writing.output import Content


@dataclasses.dataclass(frozen=True, eq=False, repr=False)
class SimulationResult(Result):
    """A recording that a model made up.

    Attributes:
        cell: The cell that it holds for.
        simulated: Plan, model and readings.
    """

    simulated: Simulated

    @property
    def recording(self) -> Recording:
        """The recording: rad, m (tracker frame), N and N*m."""
        return Recording(self.simulated.readings, self.cell)

    @property
    def tables(self) -> Mapping[str, Columns]:
        """`measurements`: the columns of the measurement table, SI units."""
        return self.recording.tables

    @property
    def summary(self) -> str:
        """What was simulated, in a few lines, as the command prints it; the largest deflection in mm."""
        return simulation_summary(self.simulated)

    def plot(self) -> Picture:
        """Draw the configurations in the operating space, base frame, m."""
        from calibration_core.report.figures.operating_space import space_figure

        return Picture(space_figure(self.simulated.space), "Operating space of the simulated recording, base frame, m")

    def files(self, *, report: bool = True) -> dict[str, Content]:
        """Return result, bag, table and report: file name -> bytes, or what writes it; arguments as for `save`."""
        return files_of(self.simulated, self.cell, report=report)

    def _content(self) -> dict[str, Any]:
        return simulation_result(self.simulated, self.cell)


@checked
def simulate(
    cell: Cell,
    *,
    plan: PlanResult | str | Path | None = None,
    model: str | Path | HoldsModel | None = None,
    seed: Seed | None = None,
) -> SimulationResult:
    """Simulate the measurement of a plan: what the instruments of the cell would record.

    Args:
        cell: The cell.
        plan: A plan or its file; None makes one.
        model: A model file or result whose robot is measured; None: what the cell file believes.
        seed: Of the instruments' noise; None: no noise.

    Returns:
        A recording in rad, m (tracker frame), N and N*m.

    Raises:
        InputError: Plan, model or cell cannot be used.
        EquilibriumError: A load is beyond what the joints can carry.

    Source: static equilibrium on the deformed geometry, CWA 17384, 6.2.
    """
    given = None if model is None else given_model(model, cell)
    if plan is None or isinstance(plan, PlanResult):
        chosen, inputs = None if plan is None else plan.plan, {}
    else:
        chosen, inputs = read_plan(plan, cell), {"plan": digest_of(Path(plan))}
    return SimulationResult(cell, simulated_by(cell, chosen, given, seed, inputs))
