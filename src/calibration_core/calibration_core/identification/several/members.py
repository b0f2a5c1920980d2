"""Which recordings are evaluated together: the same robot, each recording once, in an order of their own."""

from __future__ import annotations

import dataclasses
import itertools
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from calibration_core.cell import Cell, load_cell
from calibration_core.cell.identity import robot_sha256
from calibration_core.errors import InputError, RecordingError, quoted
from calibration_core.observations.kinds import holds_single_steps, is_loaded, refuse_same
from calibration_core.timeseries import Readings


@dataclasses.dataclass(frozen=True, eq=False)
class Member:
    """One of several recordings.

    Attributes:
        readings: What was measured, numbered and named as in its own files.
        cell: The cell that it was measured in.
        number: From 1, loaded recordings before those at rest, each kind in the order of time; where no dates are
            known, of the digests: it does not depend on the order in which the recordings were named.
        first_number: What is added to its configurations' numbers, so that no two recordings share one.
    """

    readings: Readings
    cell: Cell
    number: int
    first_number: int

    @property
    def file(self) -> str:
        """The recording as its user named it."""
        return self.readings.provenance.path

    def point(self, name: str) -> str:
        """Return what a measurement point of this recording is called beside those of the others."""
        return f"{name}@{self.number}"


def members_of(recordings: Sequence[Readings], cells: Sequence[Cell]) -> tuple[Member, ...]:
    """Return the recordings in the order of their numbers.

    Raises:
        InputError: The robots differ, or a recording is named twice.
    """
    _same_robot(cells)
    _same_convention(recordings, cells)
    order = sorted(range(len(recordings)), key=lambda k: _key(recordings[k]))
    for one, other in itertools.pairwise(order):
        first, second = recordings[one].provenance, recordings[other].provenance
        if first.sha256 and sorted(first.sha256.values()) == sorted(second.sha256.values()):
            raise RecordingError(second.path, "", f"the same content as in {first.path}", "every recording once")
    refuse_same(recordings)
    most = max(int(readings.configuration.max(initial=0)) for readings in recordings)
    stride = 10 ** max(3, len(str(most)))
    return tuple(
        Member(recordings[k], cells[k], number, (number - 1) * stride) for number, k in enumerate(order, start=1)
    )


def cells_of(paths: Sequence[Path], count: int, command: str) -> tuple[Cell, ...]:
    """Read the cell files of several recordings: one for all, or one for each.

    Raises:
        InputError: Neither one nor as many as recordings, or one cannot be used.
    """
    if len(paths) not in {1, count}:
        raise InputError(command, "--cell", f"{len(paths)} cell files", f"one for all, or {count}, one for each")
    cells = tuple(load_cell(path) for path in paths)
    return cells if len(cells) == count else cells * count


def _key(readings: Readings) -> tuple[bool, str, list[str], str]:
    provenance = readings.provenance
    return not is_loaded(readings), provenance.start, sorted(provenance.sha256.values()), provenance.path


def _same_robot(cells: Sequence[Cell]) -> None:
    first = cells[0]
    digest = robot_sha256(first)
    for cell in cells[1:]:
        if robot_sha256(cell) == digest:
            continue
        ours, theirs = first.robot.model_dump(), cell.robot.model_dump()
        keys = [key for key in ours if ours[key] != theirs[key] and key not in {"urdf", "stiffness"}]
        found = f"another robot ({', '.join(keys) or 'content of the URDF'} differ)"
        raise InputError(cell.path, "robot", found, f"the robot of {first.path}: its recordings are evaluated together")


def _same_convention(recordings: Sequence[Readings], cells: Sequence[Cell]) -> None:
    loaded = [cell for readings, cell in zip(recordings, cells, strict=True) if readings.wrench is not None]
    if displacements(cells):
        for readings, cell in zip(recordings, cells, strict=True):
            if cell.measurements.points == "absolute" and holds_single_steps(readings):
                expected = "several steps in every configuration, for they stand beside displacements"
                raise RecordingError(readings.provenance.path, "step", "postures with one step", expected)
    for cell in loaded[1:]:
        if cell.measurements.wrench_axes != loaded[0].measurements.wrench_axes:
            found = f"{cell.measurements.wrench_axes} beside {loaded[0].measurements.wrench_axes} in {loaded[0].path}"
            raise InputError(cell.path, "measurements.wrench_axes", found, "the same axes in all recordings")
    for readings, cell in zip(recordings, cells, strict=True):
        unknown = [name for name in readings.points if "@" in name]
        if unknown:
            raise InputError(cell.path, "frames.measurement_points", quoted(unknown[0]), "names of points without @")


def displacements(cells: Sequence[Cell]) -> bool:
    """Say whether recordings are evaluated as displacements from their first steps: all are, as soon as one is."""
    return any(cell.measurements.points == "displacement" for cell in cells)


def numbered(member: Member) -> tuple[int, int]:
    """Return the first and last number that the recording's configurations have beside those of the others."""
    numbers = np.asarray(member.readings.configuration)
    return int(numbers.min()) + member.first_number, int(numbers.max()) + member.first_number
