"""Everything an identification hands out, written as one set: all of it, or nothing."""

from __future__ import annotations

import datetime as dt
from collections.abc import Mapping
from pathlib import Path

from calibration_core.cell import Cell
from calibration_core.identification.estimate import Identification
from calibration_core.report.output import RESULT, Content, write_files
from calibration_core.report.result import result_dict, result_json
from calibration_core.report.tables import table_files


def report_files(identification: Identification, cell: Cell, evaluated: dt.date | None = None) -> dict[str, Content]:
    """Return `report.html` and `report.pdf`: file name -> content.

    Args:
        identification: The answer.
        cell: The cell it belongs to.
        evaluated: Date of evaluation; today (UTC) if not given.
    """
    # drawing and typesetting are slow to load, and a result can do without them
    from calibration_core.report.content import build
    from calibration_core.report.rendering import rendered

    return rendered(build(identification, cell, evaluated), identification.space)


def write_identification(
    identification: Identification,
    cell: Cell,
    out_dir: Path,
    further: Mapping[str, bytes] | None = None,
    evaluated: dt.date | None = None,
    *,
    report: bool = True,
) -> Path:
    """Write result, tables and report as one set; return the path of `result.json`.

    Args:
        identification: The answer.
        cell: The cell it belongs to.
        out_dir: Directory, made if missing.
        further: More files of the same set, for example the identified model: file name -> content.
        evaluated: Date of evaluation; today (UTC) if not given.
        report: Whether to make the report.

    Raises:
        OutputError: They cannot be written; then none of them is.
    """
    files: dict[str, Content] = {
        RESULT: result_json(result_dict(identification, cell)),
        **table_files(identification, cell.prismatic),
        **(report_files(identification, cell, evaluated) if report else {}),
        **(further or {}),
    }
    write_files(out_dir, files)
    return out_dir / RESULT
