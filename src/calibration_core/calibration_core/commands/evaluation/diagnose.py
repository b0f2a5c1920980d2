"""`calibration diagnose`: where simulation and recording differ, which physics is left out, and the extended model."""

from __future__ import annotations

import argparse
import dataclasses
import functools
from collections.abc import Sequence
from typing import Any

from calibration_core.cell import Cell
from calibration_core.commands.evaluation.candidate_measurements import offers_for, proposed_plan
from calibration_core.commands.shared.common import report_line, report_progress
from calibration_core.commands.shared.inputs import Refusal
from calibration_core.commands.shared.population_arguments import asked_population
from calibration_core.commands.shared.several import look_at_all, prepared_from, read_recordings
from calibration_core.diagnosis.diagnose import beside, diagnose, mixed_up
from calibration_core.diagnosis.result.finding import Diagnosis
from calibration_core.errors import InputError
from calibration_core.fleet.next_robot.population_file import TypePopulation
from calibration_core.fleet.next_robot.prior import PooledJoint, finding_odds, pooled_joints, prior_lines, prior_record
from calibration_core.identification.stiffness.loaded import Options
from calibration_core.model.identified.calibrated import ValidRange, range_of
from calibration_core.model.identified.gaussian import GaussianEstimate
from calibration_core.model.identified.model_file import GivenModel, model_text, read_given
from calibration_core.model.parameters import ModelParameters
from calibration_core.observations.observe import observe
from calibration_core.outcomes.inputs import as_anomalies, blocked, look, refuse_fitted, with_model_note, with_unit_note
from calibration_core.outcomes.simulation import improved_files, with_losses
from calibration_core.planning.plans.plan_file import plan_text
from calibration_core.report.document import Items, Paragraph, Section, cleaned
from calibration_core.report.results.diagnosis import diagnosis_dict
from calibration_core.report.results.result import plain, result_json
from calibration_core.report.results.traffic_light import light_of
from calibration_core.report.summary import on_a_terminal
from calibration_core.report.writing.output import RESULT, Content, write_files
from calibration_core.report.writing.tables import table_files
from calibration_core.timeseries import Readings


@dataclasses.dataclass(frozen=True, eq=False)
class Diagnosed:
    """A diagnosis with its files.

    Attributes:
        population: What is known of robots of this type; None: nothing.
        covers: What the recordings covered; None: what the readings show.
    """

    cell: Cell
    readings: Readings
    diagnosis: Diagnosis
    population: TypePopulation | None = None
    covers: ValidRange | None = None

    @functools.cached_property
    def content(self) -> dict[str, Any]:
        """The content of result.json."""
        content = diagnosis_dict(self.diagnosis, self.cell)
        if self.population is not None:
            odds = finding_odds(self.diagnosis.physics, self.population)
            content["summary"] += prior_lines(self.sisters, self.population)
            content["population"] = plain(prior_record(self.sisters, odds, self.population))
        if self.diagnosis.comparisons:
            content["summary"] = on_a_terminal(content["summary"], len(self.diagnosis.comparisons))
        return content

    @functools.cached_property
    def sisters(self) -> tuple[PooledJoint, ...]:
        """The joints with what is known of the robot's sisters; none without a population."""
        if self.population is None:
            return ()
        return pooled_joints(self.estimate, self.population)

    @property
    def summary(self) -> str:
        """The traffic light and what came out."""
        return "\n".join(self.content["summary"])

    @property
    def model(self) -> ModelParameters:
        """The model that is written for use."""
        return self.diagnosis.handed_out[0]

    @property
    def estimate(self) -> GaussianEstimate:
        """What is known of the uncertainty of the model's numbers."""
        return self.diagnosis.handed_out[1]

    @property
    def covered(self) -> ValidRange:
        """What the recording covered."""
        return self.covers or range_of(self.readings, self.cell, self.model)

    @property
    def model_text(self) -> str:
        """The model as its file."""
        return model_text(self.model, self.cell, self.estimate, self.covered)

    def files(self, *, report: bool) -> dict[str, Content]:
        """Return all files: file name -> content."""
        found, cell = self.diagnosis, self.cell
        result = result_json(self.content)
        files: dict[str, Content] = {RESULT: result, "model.yaml": self.model_text.encode()}
        if found.next_measurements:
            files["next.yaml"] = plan_text(proposed_plan(found.next_measurements, cell)).encode()
        files |= table_files(dataclasses.replace(found.identification, model=self.model), cell.prismatic)
        if not report:
            return files
        from calibration_core.report.documents.diagnosis import diagnosis_document
        from calibration_core.report.view3d.space import space_view
        from calibration_core.report.writing.rendering import rendered

        waterfall = next((one.waterfall for one in found.comparisons), ())
        view = space_view(found.identification.space, cell, waterfall) if waterfall else None
        document = diagnosis_document(found, cell, result, light_of(self.content), view)
        if self.population is not None:
            lines = Items(tuple(prior_lines(self.sisters, self.population)[1:]))
            source = Paragraph(f"{self.population.source}; {self.population.file}, SHA-256 {self.population.sha256}")
            section = Section(f"With the population of type {self.population.type}", "", (source, lines))
            document = dataclasses.replace(document, sections=(*document.sections, cleaned(section)))
        return {**files, **rendered(document, view)}


def run(arguments: argparse.Namespace) -> str:
    """Diagnose, write result, tables, extended model and report, and return a summary.

    Raises:
        InputError: The input cannot be used, or the output cannot be written.
    """
    _at_most(len(arguments.recordings), len(arguments.simulations))
    report_progress(arguments, 0.0, "reading the recording")
    cells, recordings = read_recordings(arguments)
    cell = cells[0]
    test = None if arguments.test is None else observe(arguments.test, cell)
    simulations = [observe(path, own, simulated=True) for path, own in zip(arguments.simulations, cells, strict=False)]
    given = None if arguments.model is None else read_given(arguments.model, cell)
    report_progress(arguments, 1 / 3, "looking for missing physics")
    population = asked_population(arguments, cell)
    answer = evaluate_all(recordings, cells, Options(robust=not arguments.no_robust), test, simulations, given)
    if isinstance(answer, Diagnosed):
        answer = dataclasses.replace(answer, population=population)
    report_progress(arguments, 2 / 3, "drawing the report" if arguments.report else "writing the results")
    files = answer.files(report=arguments.report)
    if isinstance(answer, Diagnosed) and len(recordings) == 1:
        files = {**files, **improved_files(answer.diagnosis, answer.readings, cell, arguments.out)}
    write_files(arguments.out, files)
    return f"{answer.summary}\n{report_line(arguments)}"


def evaluate_all(
    recordings: Sequence[Readings],
    cells: Sequence[Cell],
    options: Options,
    test: Readings | None = None,
    simulations: Sequence[Readings] = (),
    given: GivenModel | None = None,
) -> Diagnosed | Refusal:
    """Do what `evaluate` does with one recording, or with several of one robot together.

    Args:
        recordings: One or more.
        cells: One for each.
        options: How to evaluate.
        test: A recording of the first one's set-up that is predicted, not fitted.
        simulations: Of the recordings, in their order; of the first ones where there are fewer.
        given: A model to start from.

    Raises:
        InputError: The input cannot be used.
    """
    _at_most(len(recordings), len(simulations))
    refuse_fitted(test, recordings)
    if len(recordings) == 1:
        simulation = next(iter(simulations), None)
        return evaluate(recordings[0], cells[0], options, test, simulation, given)
    noted = look_at_all("diagnose", recordings, cells, test, given)
    if isinstance(noted, Refusal):
        return noted
    # what evaluates several recordings is slow to load, and most commands are given one
    from calibration_core.diagnosis.simulated import compare_checked
    from calibration_core.outcomes.together.diagnose import diagnose_together
    from calibration_core.outcomes.together.evaluate import covered

    own = zip(recordings, simulations, cells, strict=False)
    compared = [compare_checked(recording, simulation, cell) for recording, simulation, cell in own]
    offers = offers_for(recordings[0], cells[0])
    with mixed_up(compared):
        prepared = prepared_from(recordings, cells, options, test, given)
        found = diagnose_together(prepared, offers)
    result = beside(dataclasses.replace(found, anomalies=(*found.anomalies, *noted)), compared)
    covers = covered(prepared, result.identification.model)
    return Diagnosed(prepared.merged.cell, prepared.merged.readings, result, covers=covers)


def _at_most(recordings: int, simulations: int) -> None:
    """Refuse more simulations than recordings."""
    if simulations > recordings:
        expected = f"{recordings} at most: one for each recording, in their order"
        raise InputError("diagnose", "simulation", f"{simulations} simulations", expected)


def evaluate(
    readings: Readings,
    cell: Cell,
    options: Options,
    test: Readings | None = None,
    simulation: Readings | None = None,
    given: GivenModel | None = None,
) -> Diagnosed | Refusal:
    """Look at the input, then diagnose, with measurements to propose; arguments as for `diagnosis.diagnose`.

    Raises:
        InputError: The input cannot be used.
    """
    wrong = look(readings, test, cell)
    if blocked(wrong):
        return Refusal.of("diagnose", cell, readings, wrong, given)
    readings = with_model_note(with_unit_note(readings, cell), given)
    found = diagnose(readings, cell, options, test, simulation, offers_for(readings, cell), given)
    found = with_losses(found, cell)
    return Diagnosed(cell, readings, dataclasses.replace(found, anomalies=(*found.anomalies, *as_anomalies(wrong))))
