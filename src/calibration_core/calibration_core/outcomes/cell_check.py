"""A cell file, and a recording that is to be read with it: all errors, and what is unusual."""

from __future__ import annotations

import dataclasses
from pathlib import Path

from calibration_core.cell import MAX_BYTES, Cell, load_cell
from calibration_core.cell.urdf import urdf_bytes
from calibration_core.errors import CellError, InputError
from calibration_core.files.yaml_file import YamlFile, read_yaml
from calibration_core.input_checks.cell_file import GUESS, Remark, implausible
from calibration_core.input_checks.check import check_inputs
from calibration_core.input_checks.recording_match import TopicMatch, match_bag
from calibration_core.model.chain import Chain
from calibration_core.model.robot import chain_of
from calibration_core.model.urdf.bodies import urdf_bodies
from calibration_core.observations.observe import observe
from calibration_core.outcomes.cell_in_words import meaning
from calibration_core.recording.source import recording_kind
from calibration_core.report.rounding import counted


@dataclasses.dataclass(frozen=True, eq=False)
class CheckedCell:
    """What was found out about a cell file, and about a recording beside it.

    Attributes:
        cell: The cell.
        chain: The robot.
        words: What the file means: label and sentence.
        unusual: What is unusual, but can be.
        topics: How the recording's topics match; empty for a table or none.
        readings: What was read of the recording, in words; empty without one.
    """

    cell: Cell
    chain: Chain
    words: list[tuple[str, str]]
    unusual: tuple[Remark, ...]
    topics: tuple[TopicMatch, ...]
    readings: tuple[str, ...]


def examine(path: Path, recording: Path | None = None) -> tuple[CheckedCell | None, list[InputError]]:
    """Look at a cell file, and at a recording if there is one; return what was found out, and every error.

    Args:
        path: The cell file.
        recording: A recording that is to be read with it.
    """
    try:
        cell = load_cell(path)
    except CellError as error:
        return None, [error, *error.further, *_urdf_faults(path)]
    try:
        chain = chain_of(cell)
        urdf_bodies(cell, "collision")  # what planning needs: meshes that exist
    except CellError as error:
        return None, [_located(path, error)]
    remarks = implausible(cell, chain)
    faults: list[InputError] = [_fault(path, one) for one in remarks if one.impossible]
    topics: tuple[TopicMatch, ...] = ()
    readings: tuple[str, ...] = ()
    if recording is not None:
        topics, readings, more = _recorded(recording, cell)
        faults += more
    if faults:
        return None, faults
    unusual = (*(one for one in remarks if not one.impossible), *_marked(path))
    return CheckedCell(cell, chain, meaning(cell, chain), unusual, topics, readings), []


def _marked(path: Path) -> list[Remark]:
    """Return what is still marked as a usual value, in one remark: nobody has measured it in this cell."""
    lines = path.read_text("utf-8-sig", errors="replace").splitlines()
    parts = [(number, *line.partition("#")[::2]) for number, line in enumerate(lines, start=1)]
    found = [str(number) for number, stated, comment in parts if stated.strip() and GUESS in comment]
    place = f"line{'s' if len(found) > 1 else ''} {', '.join(found)}"
    return [Remark(place, f"a guess, marked {GUESS}", "the value of this cell", impossible=False)] if found else []


def _recorded(recording: Path, cell: Cell) -> tuple[tuple[TopicMatch, ...], tuple[str, ...], list[InputError]]:
    try:
        kind = recording_kind(recording)
        topics = match_bag(recording, cell) if kind == "bag" else ()
    except InputError as error:
        return (), (), [error]
    faults = [
        InputError(recording, f"{one.role} ({one.topic})", one.text, "a topic that the cell file names, and its type")
        for one in topics
        if one.state in {"missing", "unusable"}
    ]
    if faults:
        return topics, (), faults
    try:
        read = observe(recording, cell)
        anomalies = check_inputs(read, cell)
    except InputError as error:
        return topics, (), [error]
    blocking = [InputError(recording, one.kind, one.text, one.remedy) for one in anomalies if one.blocks]
    configurations = len(set(read.configuration.tolist()))
    extent = [
        counted(len(read), "reading"),
        counted(configurations, "configuration"),
        counted(len(read.points), "target"),
    ]
    wrench = "with wrench" if read.wrench is not None else "without wrench"
    lines = (
        f"Recording: {', '.join([*extent, wrench])}",
        *(f"Note: {note.text}" for note in read.notes),
        *(f"Unusual: {one.text}" for one in anomalies if not one.blocks),
    )
    return topics, lines, blocking


def _urdf_faults(path: Path) -> list[InputError]:
    """Return what is wrong with the URDF of a cell file that is wrong itself."""
    try:
        data = read_yaml(path, MAX_BYTES, "cell file (YAML)", CellError).data
    except CellError:
        return []
    robot = data.get("robot") if isinstance(data, dict) else None
    name = robot.get("urdf") if isinstance(robot, dict) else None
    if not isinstance(name, str) or not name.strip():
        return []
    try:
        urdf_bytes((path.parent / name).resolve())
    except CellError as error:
        return [error]
    return []


def _fault(path: Path, remark: Remark) -> InputError:
    return _located(path, CellError(path, remark.place, remark.found, remark.expected))


def _located(path: Path, error: CellError) -> CellError:
    if error.line is not None or error.file != str(path):
        return error
    mark = _file(path).where(error.place)
    return error if mark is None else error.at(*mark)


def _file(path: Path) -> YamlFile:
    return read_yaml(path, MAX_BYTES, "cell file (YAML)", CellError)
