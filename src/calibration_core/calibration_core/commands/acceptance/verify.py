"""`calibration verify`: a model on places that it was not identified from, against a tolerance, with a certificate."""

from __future__ import annotations

import argparse
import math
from typing import Any

import numpy as np

from calibration_core.acceptance.decision import COVERAGE, PROBABILITY, WORDS, guard_factor
from calibration_core.acceptance.verification import Verification, verify
from calibration_core.cell import Cell, load_cell
from calibration_core.commands.shared.common import report_line, report_progress
from calibration_core.commands.shared.inputs import Refusal
from calibration_core.commands.shared.several import dated
from calibration_core.errors import InputError
from calibration_core.identification.checks.space import operating_space
from calibration_core.model.identified.model_file import read_given
from calibration_core.model.parameters import ModelParameters
from calibration_core.model.robot import chain_of
from calibration_core.model.statics import load_of
from calibration_core.observations.kinds import is_loaded
from calibration_core.observations.observe import observe
from calibration_core.outcomes.inputs import Inputs, blocked, digest_of, look, naming_model, refuse_own
from calibration_core.outcomes.verification import error_sizes, not_conforming, places, remarks, reservations
from calibration_core.report.results.command import command_result, input_record
from calibration_core.report.results.result import recording_record, result_json
from calibration_core.report.results.traffic_light import light_of, with_light
from calibration_core.report.rounding import counted
from calibration_core.report.writing.output import RESULT, Content, write_files
from calibration_core.timeseries import Readings

CERTIFICATE = "certificate.pdf"
LARGEST_TOLERANCE = 0.01  # m: as much or more is meant in mm; robots are more accurate before any calibration


def run(arguments: argparse.Namespace) -> str:
    """Judge a model by a recording, write result, report and certificate, and return a summary.

    Raises:
        InputError: The input cannot be used, or the output cannot be written.
        EquilibriumError: A load is beyond what the joints can carry.
    """
    report_progress(arguments, 0.0, "predicting the readings")
    refuse_tolerance(arguments.tolerance)
    cell = load_cell(arguments.cell)
    (readings,) = dated([observe(arguments.recording, cell)], arguments.date, "verify")
    found = look(readings, None, cell)
    given = read_given(arguments.model, cell)
    readings, model = refuse_own(readings, given, cell), given.calibrated
    if blocked(found):
        refusal = Refusal.of("verify", cell, readings, found, given)
        write_files(arguments.out, refusal.files(report=arguments.report))
        return f"{refusal.summary}\n{report_line(arguments)}"
    with naming_model(arguments.model):
        judged = verify(readings, cell, model, arguments.tolerance, fit_tracker=arguments.fit_tracker)
    inputs = {"model": digest_of(arguments.model)}
    if arguments.report:
        report_progress(arguments, 0.5, "writing the certificate")
    write_files(arguments.out, files_of(judged, cell, readings, model.parameters, inputs, report=arguments.report))
    certificate = f"\ncertificate: {arguments.out / CERTIFICATE}" if arguments.report else ""
    return f"{verification_summary(judged)}{certificate}\n{report_line(arguments)}"


def files_of(
    judged: Verification,
    cell: Cell,
    readings: Readings,
    parameters: ModelParameters,
    inputs: Inputs,
    *,
    report: bool,
) -> dict[str, Content]:
    """Return everything that the command writes: file name -> content.

    Args:
        judged: What came out.
        cell: The cell.
        readings: The recording.
        parameters: The model.
        inputs: Role -> file -> SHA-256 of input files besides the cell's and the recording's.
        report: Whether report and certificate are among them.
    """
    content = verification_result(judged, cell, readings, inputs)
    result = result_json(content)
    files: dict[str, Content] = {RESULT: result}
    if report:
        from calibration_core.report.documents.verification import certificate_document, verification_document
        from calibration_core.report.view3d.space import space_view
        from calibration_core.report.writing.pdf import render_pdf
        from calibration_core.report.writing.rendering import rendered

        space = _space(readings, cell, parameters)
        document = verification_document(judged, cell, result, space, inputs, light_of(content))
        files |= rendered(document, space_view(space, cell))
        files[CERTIFICATE] = render_pdf(certificate_document(judged, cell, result, inputs))
    return files


def refuse_tolerance(tolerance: float) -> None:
    """Refuse a tolerance that is none.

    Raises:
        InputError: It is not finite, not above zero, or so large that it is meant in mm.
    """
    if not 0 < tolerance < LARGEST_TOLERANCE:
        found = f"{tolerance:g} m" + (f", which is {1e3 * tolerance:g} mm" if 0 < tolerance < math.inf else "")
        expected = f"a length in m above zero and below {LARGEST_TOLERANCE:g} (0.1 mm is 0.0001)"
        raise InputError("verify", "--tolerance", found, expected)


def _space(readings: Readings, cell: Cell, parameters: ModelParameters) -> Any:
    load = None if readings.wrench is None else load_of(readings, cell, parameters)
    return operating_space(chain_of(cell).corrected(parameters.geometry), parameters, readings, load)


def verification_result(found: Verification, cell: Cell, readings: Readings, inputs: Inputs) -> dict[str, Any]:
    """Return the content of result.json; the verdict is `unexplained` where the model does not conform."""
    after, before = error_sizes(found.error), None if found.before is None else error_sizes(found.before)
    worst = found.least_certain
    fit = {"rms_after": after["rms"], "noise": float(np.sqrt(np.mean(found.shares["tracker"] ** 2)))}
    beyond = not_conforming(found)
    content = command_result(
        "verify",
        cell,
        recording_record(readings, loaded=is_loaded(readings)),
        fit if before is None else {**fit, "rms_before": before["rms"]},
        verdict="unexplained" if beyond else "consistent",
        unexplained={
            "rms": float(np.sqrt(max(after["rms"] ** 2 - fit["noise"] ** 2, 0.0))) if beyond else 0.0,
            "significant": bool(beyond),
            "where": {"configurations": list(beyond)} if beyond else {},
        },
        tolerance=found.tolerance,
        decision=found.decision,
        decision_rule={
            "standard": "ISO 14253-1",
            "probability": PROBABILITY,
            "guard_band": guard_factor(),
            "unit": "u",
        },
        error={"before": before, "after": after, "unit": "m"},
        uncertainty={
            "standard": float(found.uncertainty[worst]),
            "expanded": COVERAGE * float(found.uncertainty[worst]),
            "coverage_factor": COVERAGE,
            "contributions": {source: float(share[worst]) for source, share in found.shares.items()},
            "of": "the least certain reading",
            "unit": "m",
        },
        tracker="fitted to this recording" if found.fitted else "of the model",
        rms_with_tracker_fitted=found.elsewhere,
        intervals_of_the_model=found.with_intervals,
        places=places(found),
        remarks=remarks(found),
        notes=[vars(note) for note in readings.notes],
        input=input_record(cell, readings.provenance, inputs),
    )
    good = f"every reading conforms to the tolerance of {1e3 * found.tolerance:g} mm"
    residual, further = reservations(found)
    return {**with_light(content, good, residual, further), "summary": verification_summary(found).splitlines()}


def verification_summary(found: Verification) -> str:
    """Return what came out, in a few lines."""
    after = error_sizes(found.error)
    largest = f"{1e3 * after['max']:.3f} mm"
    tolerance = f"{1e3 * found.tolerance:.3f} mm"
    lines = [f"{WORDS[found.decision]}: largest error {largest}, tolerance {tolerance} (ISO 14253-1)"]
    text = f"{counted(len(found.size), 'reading')}: error mean {1e3 * after['mean']:.3f} mm"
    if found.before is not None:
        text += f" (cell file: {1e3 * error_sizes(found.before)['mean']:.3f} mm)"
    lines.append(f"{text}, U at most {1e3 * COVERAGE * float(found.uncertainty.max()):.3f} mm (k = {COVERAGE:g})")
    lines += remarks(found)
    (_, step), further = reservations(found)
    steps = [step] if not_conforming(found) else [one for _, one in further if one]
    lines += [f"next: {one}" for one in steps]
    return "\n".join(lines)
