"""`calibration identify`: joint stiffness, and where the recording allows, frames, geometry and points."""

from __future__ import annotations

import argparse
import dataclasses
import functools
from collections.abc import Collection, Sequence
from typing import TYPE_CHECKING, Any

from calibration_core.cell import Cell
from calibration_core.commands.shared.common import report_line, report_progress
from calibration_core.commands.shared.inputs import Refusal
from calibration_core.commands.shared.several import look_at_all, prepared_from, read_recordings
from calibration_core.diagnosis.diagnose import diagnose
from calibration_core.diagnosis.model_estimate import with_bias
from calibration_core.diagnosis.result.finding import Diagnosis
from calibration_core.engine.command_line import refuse_without_effect
from calibration_core.errors import InputError, quoted
from calibration_core.identification.checks.noise_audit import with_own_outliers
from calibration_core.identification.identify import identify
from calibration_core.identification.result.estimate import Identification
from calibration_core.identification.stiffness.fit import Key, keys_of
from calibration_core.identification.stiffness.loaded import Options
from calibration_core.model.identified.calibrated import ValidRange, range_of
from calibration_core.model.identified.model_file import GivenModel, model_text, read_given
from calibration_core.observations.kinds import is_loaded
from calibration_core.observations.observe import observe
from calibration_core.outcomes.inputs import as_anomalies, blocked, look, refuse_fitted, with_model_note, with_unit_note
from calibration_core.report.results.diagnosis import identified_dict, unproven
from calibration_core.report.writing.identification_files import identification_files
from calibration_core.report.writing.output import Content, write_files
from calibration_core.timeseries import Note, Readings

if TYPE_CHECKING:
    from calibration_core.outcomes.together.prepare import Prepared


@dataclasses.dataclass(frozen=True, eq=False)
class Identified:
    """An identification, with what a search for missing physics says.

    Attributes:
        searched: The search; None where it could not work on the recording.
        covers: What the recordings covered; None: what the readings show.
    """

    cell: Cell
    readings: Readings
    identification: Identification
    searched: Diagnosis | None
    covers: ValidRange | None = None

    @functools.cached_property
    def content(self) -> dict[str, Any]:
        """The content of result.json."""
        return identified_dict(self.identification, self.searched, self.cell)

    @property
    def summary(self) -> str:
        """The traffic light and what came out."""
        return "\n".join(self.content["summary"])

    @property
    def covered(self) -> ValidRange:
        """What the recording covered."""
        return self.covers or range_of(self.readings, self.cell, self.identification.model)

    @property
    def model_text(self) -> str:
        """The identified model as its file."""
        found = self.identification
        return model_text(found.model, self.cell, found.estimate, self.covered)

    def files(self, *, report: bool) -> dict[str, Content]:
        """Return all files: file name -> content."""
        found, cell = self.identification, self.cell
        model = {"model.yaml": self.model_text.encode()}
        return identification_files(found, cell, model, report=report, searched=self.searched)


def run(arguments: argparse.Namespace) -> str:
    """Identify, write result, tables, model and report, and return a summary.

    Raises:
        InputError: The input cannot be used, or the output cannot be written.
    """
    report_progress(arguments, 0.0, "reading the recording")
    cells, recordings = read_recordings(arguments)
    cell = cells[0]
    refuse_idle(arguments.stated, recordings, robust=not arguments.no_robust)
    test = None if arguments.test is None else observe(arguments.test, cell)
    given = None if arguments.model is None else read_given(arguments.model, cell)
    options = Options(
        method=arguments.method,
        weights=arguments.weights,
        deflections=arguments.deflections,
        robust=not arguments.no_robust,
        readmit=frozenset(_reading(text, cell, len(recordings)) for text in arguments.readmit),
    )
    report_progress(arguments, 1 / 3, "identifying, and looking for missing physics")
    answer = evaluate_all(recordings, cells, options, test, given)
    if isinstance(answer, Identified):
        refuse_unknown(options.readmit, answer.readings)
    report_progress(arguments, 2 / 3, "drawing the report" if arguments.report else "writing the results")
    write_files(arguments.out, answer.files(report=arguments.report))
    return f"{answer.summary}\n{report_line(arguments)}"


def refuse_idle(stated: Collection[str], recordings: Sequence[Readings], *, robust: bool) -> None:
    """Refuse stated options that have no effect on these recordings.

    Raises:
        InputError: There is one.
    """
    if not robust:
        where = "with --no-robust, which uses every reading"
        refuse_without_effect(stated, "identify", ("--readmit",), where, "no --no-robust")
    if not any(map(is_loaded, recordings)):
        options = ("--method", "--weights", "--deflections")
        refuse_without_effect(stated, "identify", options, "on a recording at rest", "a loaded recording")


def refuse_unknown(keys: Collection[Key], readings: Readings) -> None:
    """Refuse to use a reading after all that the recordings do not hold.

    Raises:
        InputError: There is one.
    """
    known = set(keys_of(readings))
    for configuration, step, point in sorted(keys):
        if (configuration, step, point) not in known:
            found = quoted(f"{configuration}:{step}:{point}")
            raise InputError("identify", "--readmit", found, f"a reading of {readings.provenance.path}")


def evaluate_all(
    recordings: Sequence[Readings],
    cells: Sequence[Cell],
    options: Options,
    test: Readings | None = None,
    given: GivenModel | None = None,
) -> Identified | Refusal:
    """Do what `evaluate` does with one recording, or with several of one robot together.

    Raises:
        InputError: The input cannot be used.
    """
    refuse_fitted(test, recordings)
    if len(recordings) == 1:
        return evaluate(recordings[0], cells[0], options, test, given)
    # what evaluates several recordings is slow to load, and most commands are given one
    from calibration_core.outcomes.together.evaluate import covered, identify_together

    noted = look_at_all("identify", recordings, cells, test, given)
    if isinstance(noted, Refusal):
        return noted
    prepared = prepared_from(recordings, cells, options, test, given)
    merged = prepared.merged
    found, searched = _searched_together(identify_together(prepared), prepared)
    found = dataclasses.replace(found, anomalies=(*found.anomalies, *noted))
    if searched is not None:
        searched = dataclasses.replace(searched, anomalies=(*searched.anomalies, *noted))
    return Identified(merged.cell, merged.readings, found, searched, covered(prepared, found.model))


def _searched_together(found: Identification, prepared: Prepared) -> tuple[Identification, Diagnosis | None]:
    """Do what `_searched` does, with several recordings."""
    from calibration_core.outcomes.together.diagnose import diagnose_together

    asked = prepared.options
    usual = Options(robust=asked.robust, readmit=asked.readmit, start=asked.start)
    try:
        searched = diagnose_together(dataclasses.replace(prepared, options=usual))
    except InputError as error:
        note = Note("search", "missing physics", f"could not be looked for: {error}")
        return dataclasses.replace(found, notes=(*found.notes, note)), None
    together = searched.identification.together  # recordings are compared less what was found in all of them
    if together is not None and together.taken_off:
        from calibration_core.outcomes.together.evaluate import identify_less

        found = identify_less(prepared, together.taken_off)
    anomalies = with_own_outliers(searched.anomalies, found.anomalies)
    found = dataclasses.replace(with_bias(found, searched), anomalies=anomalies, together=together)
    return found, dataclasses.replace(searched, anomalies=anomalies)


def evaluate(
    readings: Readings,
    cell: Cell,
    options: Options,
    test: Readings | None = None,
    given: GivenModel | None = None,
) -> Identified | Refusal:
    """Look at the input, identify, and look for missing physics; arguments as for `identification.identify`.

    Raises:
        InputError: The input cannot be used.
    """
    wrong = look(readings, test, cell)
    if blocked(wrong):
        return Refusal.of("identify", cell, readings, wrong, given)
    readings = with_model_note(with_unit_note(readings, cell), given)
    found = identify(readings, cell, options, test, given)
    found, searched = _searched(found, readings, cell, options, test, given)
    noted = as_anomalies(wrong)
    found = dataclasses.replace(found, anomalies=(*found.anomalies, *noted))
    if searched is not None:
        searched = dataclasses.replace(searched, anomalies=(*searched.anomalies, *noted))
    return Identified(cell, readings, found, searched)


def _searched(
    found: Identification,
    readings: Readings,
    cell: Cell,
    options: Options,
    test: Readings | None,
    given: GivenModel | None,
) -> tuple[Identification, Diagnosis | None]:
    """Look for missing physics; the identification gets its bias, and its anomalies are those of the search.

    Where the search cannot work on a recording of which the standard's model says something, a note tells why.
    """
    usual = Options(robust=options.robust, readmit=options.readmit)
    known = found if given is None and options == usual else None
    try:
        searched = diagnose(readings, cell, usual, test, given=given, identified=known)
    except InputError as error:
        note = Note("search", "missing physics", f"could not be looked for: {error}")
        return dataclasses.replace(found, notes=(*found.notes, note)), None
    anomalies = with_own_outliers(searched.anomalies, found.anomalies)
    noted = (note for note in searched.identification.notes if note not in found.notes)
    notes = (*found.notes, *noted, *_unproven(found, searched))
    return (
        dataclasses.replace(with_bias(found, searched), anomalies=anomalies, notes=notes),
        dataclasses.replace(searched, anomalies=anomalies),
    )


def _unproven(found: Identification, searched: Diagnosis) -> tuple[Note, ...]:
    """Say where nothing is missing, and yet the identified model of postures at rest leaves more than noise."""
    left = unproven(found, searched)
    if left is None:
        return ()
    text = (
        f"it leaves {1e6 * left.seen:.0f} µm per coordinate, the noise is {1e6 * left.noise:.0f} µm: geometry and "
        "compliances that do not clearly improve configurations left out stay as stated; fitted all the same, as in "
        f"the model that diagnose writes, they leave {1e6 * searched.rms_after:.0f} µm; more configurations prove them"
    )
    return (Note("unproven", "identified model", text),)


def _reading(text: str, cell: Cell, recordings: int) -> Key:
    parts = text.split(":", 2)
    try:
        key = int(parts[0]), int(parts[1]), parts[2]
    except (ValueError, IndexError):
        raise InputError("--readmit", "", quoted(text), "CONFIGURATION:STEP:POINT, for example 3:1:mp1") from None
    _, mark, number = key[2].rpartition("@")
    if recordings > 1 and not (mark and number in map(str, range(1, recordings + 1))):
        raise InputError("--readmit", "", quoted(text), "CONFIGURATION:STEP:POINT@NUMBER, for example 1003:1:mp1@2")
    if recordings == 1 and key[2] not in cell.points:
        raise InputError("--readmit", "", quoted(text), f"a point of the cell: {', '.join(cell.points)}")
    return key
