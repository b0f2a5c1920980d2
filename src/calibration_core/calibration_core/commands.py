"""What each command does: read, call the core, write the whole set of results, and say in short what came out."""

from __future__ import annotations

import argparse
from collections.abc import Callable, Mapping

import numpy as np

from calibration_core.cell import Cell, load_cell
from calibration_core.errors import InputError, quoted
from calibration_core.identification.identify import identify
from calibration_core.identification.loaded import Options
from calibration_core.identification.predict import predict_readings
from calibration_core.identification.robust import Key
from calibration_core.model.model_file import model_text, read_model
from calibration_core.observations.observe import observe
from calibration_core.report.output import write_files
from calibration_core.report.summary import summary
from calibration_core.report.tables import predictions_csv
from calibration_core.report.writing import write_identification


def run_identify(arguments: argparse.Namespace) -> str:
    """Identify, write result, tables, model and report, and return a summary."""
    cell = load_cell(arguments.cell)
    readings = observe(arguments.recording, cell)
    test = None if arguments.test is None else observe(arguments.test, cell)
    options = Options(
        method=arguments.method,
        weights=arguments.weights,
        deflections=arguments.deflections,
        robust=not arguments.no_robust,
        readmit=frozenset(_reading(text, cell) for text in arguments.readmit),
    )
    found = identify(readings, cell, options, test)
    model = {"model.yaml": model_text(found.model, cell).encode()}
    write_identification(found, cell, arguments.out, model)
    return f"{summary(found)}\nreport: {arguments.out / 'report.html'} and {arguments.out / 'report.pdf'}"


def run_predict(arguments: argparse.Namespace) -> str:
    """Predict every reading from angles and wrenches alone, and write the comparison."""
    cell = load_cell(arguments.cell)
    model = read_model(arguments.model, cell)
    readings = observe(arguments.recording, cell)
    predicted = predict_readings(readings, cell, model)
    error = np.linalg.norm(readings.position - predicted, axis=1)
    write_files(arguments.out, {"predictions.csv": predictions_csv(readings, predicted)})
    return (
        f"{len(readings)} readings: error mean {1e3 * error.mean():.3f} mm, largest {1e3 * error.max():.3f} mm\n"
        f"predictions: {arguments.out / 'predictions.csv'}"
    )


def _reading(text: str, cell: Cell) -> Key:
    parts = text.split(":", 2)
    try:
        key = int(parts[0]), int(parts[1]), parts[2]
    except (ValueError, IndexError):
        raise InputError("--readmit", "", quoted(text), "CONFIGURATION:STEP:POINT, for example 3:1:mp1") from None
    if key[2] not in cell.points:
        raise InputError("--readmit", "", quoted(text), f"a point of the cell: {', '.join(cell.points)}")
    return key


COMMANDS: Mapping[str, Callable[[argparse.Namespace], str]] = {
    "identify": run_identify,
    "predict": run_predict,
}
