"""Everything an identification hands out, written as one set: all of it, or nothing."""

from __future__ import annotations

import datetime as dt
from collections.abc import Mapping

from calibration_core.cell import Cell
from calibration_core.diagnosis.result.finding import Diagnosis
from calibration_core.identification.result.estimate import Identification
from calibration_core.report.results.diagnosis import identified_dict
from calibration_core.report.results.result import result_json
from calibration_core.report.writing.output import RESULT, Content
from calibration_core.report.writing.tables import table_files


def report_files(
    identification: Identification,
    cell: Cell,
    evaluated: dt.date | None = None,
    searched: Diagnosis | None = None,
) -> dict[str, Content]:
    """Return `report.html` and `report.pdf`: file name -> content.

    Args:
        identification: The answer.
        cell: The cell it belongs to.
        evaluated: Date of evaluation; today (UTC) if not given.
        searched: What the search for missing physics says; None where there was none.
    """
    # drawing and typesetting are slow to load, and a result can do without them
    from calibration_core.report.content import build
    from calibration_core.report.view3d.space import space_view
    from calibration_core.report.writing.rendering import rendered

    return rendered(build(identification, cell, evaluated, searched), space_view(identification.space, cell))


def identification_files(
    identification: Identification,
    cell: Cell,
    further: Mapping[str, bytes] | None = None,
    evaluated: dt.date | None = None,
    *,
    report: bool = True,
    searched: Diagnosis | None = None,
) -> dict[str, Content]:
    """Return result, tables and report as one set: file name -> content.

    Args:
        identification: The answer.
        cell: The cell it belongs to.
        further: More files of the same set, for example the identified model: file name -> content.
        evaluated: Date of evaluation; today (UTC) if not given.
        report: Whether to make the report.
        searched: What the search for missing physics says; None where there was none.
    """
    return {
        RESULT: result_json(identified_dict(identification, searched, cell)),
        **table_files(identification, cell.prismatic),
        **(report_files(identification, cell, evaluated, searched) if report else {}),
        **(further or {}),
    }
