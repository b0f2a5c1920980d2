"""What the readings of a session on disk determine so far; asked for after every configuration, while measuring."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

from calibration_core.cell import Cell, load_cell
from calibration_core.errors import IdentificationError
from calibration_core.identification.progress import Progress, progress
from calibration_core.measurement.session import PLAN, Session
from calibration_core.planning.plans.plan import REFERENCE_NUMBER
from calibration_core.planning.plans.plan_file import read_plan
from calibration_core.recording.session_values import as_readings


def session_progress(directory: Path, cell: Cell, wanted: float = 0.0) -> Progress:
    """Evaluate the configurations that a session holds completely, whether or not it is being written to.

    Args:
        directory: The session's.
        cell: The cell that it was measured in.
        wanted: Accuracy that is wanted of every joint, see `Progress`; 0: none.

    Raises:
        SessionError: There is no session, or it is damaged.
        IdentificationError: Nothing is determined yet.
    """
    plan = read_plan(directory / PLAN, cell)
    with Session.look(directory) as session:
        done = session.completed
        confirmed = [one for one in session.confirmed() if one.configuration != REFERENCE_NUMBER]
        given_up = {number for _, number, outcome, _ in session.attempts if outcome == "given up"} - set(done)
    if not confirmed:
        raise IdentificationError(directory, "", "no configuration yet", "one that is measured completely")
    readings = as_readings(confirmed, cell.points, str(directory))
    over = {*done, *given_up}
    pending, spares = ([one for one in some if one.number not in over] for some in (plan.primary, plan.spares))
    return progress(readings, cell, pending, spares, wanted=wanted)


def progress_record(directory: str, cell_file: str, wanted: float) -> dict[str, Any]:
    """Return the same as plain values for another process; numbers that are not finite stay so."""
    found = session_progress(Path(directory), load_cell(cell_file), wanted)
    return {
        "configuration": found.configuration,
        "joints": list(found.joints),
        "stiffness": found.stiffness.tolist(),
        "lower": found.interval[:, 0].tolist(),
        "upper": found.interval[:, 1].tolist(),
        "accuracy": found.accuracy.tolist(),
        "expected": found.expected.tolist(),
        "suspicious": found.suspicious,
        "misfit": found.misfit,
        "misfit_limit": found.misfit_limit,
        "wanted": found.wanted if math.isfinite(found.wanted) else 0.0,
        "enough": found.enough,
        "next_configuration": found.next_configuration or 0,
        "text": found.text,
    }
