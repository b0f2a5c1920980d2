"""The columns of a measurement table: their names, and which a table must and may have."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from calibration_core.cell import Cell
from calibration_core.errors import RecordingError, quoted

WRENCH = ("fx", "fy", "fz", "tx", "ty", "tz")
POSITION = ("x", "y", "z")
INTEGERS = ("configuration", "step")
OURS = {*INTEGERS, "point", *POSITION}
OPTIONAL = ("time", "temperature")  # a cell of these may be empty


def joint_columns(cell: Cell) -> list[str]:
    """Return the names of the columns of joint angles: `q1` ... `qn`."""
    return [f"q{i + 1}" for i in range(len(cell.robot.joints))]


def checked_columns(path: str | Path, header: Sequence[str], cell: Cell, place: str) -> list[str]:
    """Return the names of the columns, stripped, in their order.

    Raises:
        RecordingError: A column is unknown, missing or there twice.
    """
    if not header:
        raise RecordingError(path, place, "nothing", "a header line")
    names = [name.strip() for name in header]
    joints = joint_columns(cell)
    required = [*INTEGERS, *joints, "point", *POSITION]
    allowed = [*INTEGERS, *OPTIONAL, *joints, *WRENCH, "point", *POSITION]
    choices = "one of " + ", ".join(allowed)
    if len(names) == 1 and any(mark in names[0] for mark in ";\t|"):
        raise RecordingError(path, place, quoted(names[0]), "columns separated by commas")
    for name in names:
        if name not in allowed:
            extra = f" (the cell's robot has {len(joints)} joints)" if name[:1] == "q" and name[1:].isdigit() else ""
            raise RecordingError(path, f"{place}, column {quoted(name)}", "an unknown column", choices + extra)
        if names.count(name) > 1:
            raise RecordingError(path, f"{place}, column {name}", f"the column {names.count(name)} times", "it once")
    for name in required:
        if name not in names:
            raise RecordingError(path, f"{place}, column {name}", "no such column", "columns " + ", ".join(required))
    of_wrench = [name for name in WRENCH if name in names]
    if of_wrench and len(of_wrench) < len(WRENCH):
        absent = next(name for name in WRENCH if name not in names)
        found = f"no such column beside {', '.join(of_wrench)}"
        expected = f"the columns of a wrench together ({', '.join(WRENCH)}), or none of them"
        raise RecordingError(path, f"{place}, column {absent}", found, expected)
    return names
