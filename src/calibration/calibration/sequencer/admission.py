"""Whether a run may begin: what is looked at before its goal is accepted."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from calibration.cell.conditions_watch import fault
from calibration_core.cell import Cell
from calibration_core.errors import InputError, SessionError
from calibration_core.measurement.session import DATABASE
from calibration_core.planning.plans.plan_file import read_plan


def refusal(request: Any, cell: Cell) -> str:
    """Return why a `RunPlan` goal cannot be begun; empty if it can."""
    directory = Path(request.session)
    try:
        read_plan(request.plan, cell)
        there = (directory / DATABASE).exists()
        if not request.session:
            raise SessionError(directory, "", "no directory", "the directory of the session")
        if there and not request.resume:
            raise SessionError(directory, "", "a session", "a new directory, or resume to continue this one")
        if request.resume and not there:
            raise SessionError(directory, "", "no session", "one to continue, or no resume")
    except InputError as error:
        return str(error)
    return "; ".join(filter(None, map(fault, request.overrides)))
