"""Several recordings as one: rows below each other, positions in the base frame, every instrument with its own claim.

The positions of every recording are brought into the base frame by the tracker pose that it shows by itself; what that
pose leaves open is fitted again beside everything that the recordings share (`identification.setups`).  Covariances
are formed in the tracker's own frame first: what a tracker claims depends on where it stands.  Beside a recording of
displacements the others become displacements too: one offset per configuration and point is free in either.
"""

from __future__ import annotations

import dataclasses
import itertools
from collections.abc import Collection, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from calibration_core.cell import Cell, Pose, load_cell
from calibration_core.cell.identity import robot_sha256
from calibration_core.errors import InputError, RecordingError, quoted
from calibration_core.identification.result.estimate import Identification
from calibration_core.identification.stiffness.predict import from_step_zero
from calibration_core.model.chain import xyz_rpy
from calibration_core.model.kinematics import posture
from calibration_core.model.parameters import ModelParameters
from calibration_core.model.robot import chain_of
from calibration_core.model.statics import load_of
from calibration_core.observations.average import position_covariance, wrench_covariance
from calibration_core.observations.kinds import holds_single_steps, is_loaded, refuse_same
from calibration_core.recording.source import digests_of_several
from calibration_core.timeseries import Float1D, Float2D, Float3D, Note, Provenance, Readings


@dataclasses.dataclass(frozen=True, eq=False)
class Member:
    """One of several recordings.

    Attributes:
        readings: What was measured, numbered and named as in its own files.
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
    stride = _stride(recordings)
    return tuple(
        Member(recordings[k], cells[k], number, (number - 1) * stride) for number, k in enumerate(order, start=1)
    )


def as_one(recordings: Sequence[Readings]) -> Readings:
    """Return several files of one set-up as one recording: one tracker pose, one set of targets, one sensor.

    Files without a wrench beside files with one hold none.  Configurations keep their numbers where no two files share
    one.  Rows are in the order of time where the files' times are of one clock, else file after file.

    Raises:
        RecordingError: A file is named twice.
    """
    refuse_same(recordings)
    names = tuple(dict.fromkeys(name for one in recordings for name in one.points))
    recorded = any(one.wrench is not None for one in recordings)
    stride, used, end = _stride(recordings), set[int](), 0.0
    together = _one_clock(recordings)
    parts = []
    for k, one in enumerate(sorted(recordings, key=lambda one: one.provenance.start)):
        number, notes, time = one.configuration, one.notes, one.time
        if used & set(number.tolist()):
            number = number + k * stride
            text = f"its configurations are numbered from {number.min()} on, for another file has the same numbers"
            notes = (*notes, Note("renumbered", one.provenance.path, text))
        used |= set(number.tolist())
        if not together and np.isfinite(time).any():
            time = time - np.nanmin(time) + end
            end = float(np.nanmax(time)) + 1.0
        part = dataclasses.replace(
            one, points=names, configuration=number, time=time, notes=notes,
            point=np.array([names.index(name) for name in one.points])[one.point],
            wrench=np.zeros((len(one), 6)) if recorded and one.wrench is None else one.wrench,
        )  # fmt: skip
        parts.append(part)
    scattered = [one.provenance.path for one in parts if one.position_covariance is not None]
    if scattered and len(scattered) < len(parts):
        text = "the scatter within its windows is not used, for other files of the set-up do not hold it"
        parts[0] = parts[0].with_notes(*(Note("scatter_unused", path, text) for path in scattered))
    whole = dataclasses.replace(_stacked(parts), conditions=tuple(seen for one in parts for seen in one.conditions))
    return whole.select(np.argsort(whole.time, kind="stable")) if together else whole


def _stride(recordings: Sequence[Readings]) -> int:
    """Return what is added to numbers of configurations, once for each file before, so that no two files share one."""
    most = max(int(readings.configuration.max(initial=0)) for readings in recordings)
    return int(10 ** max(3, len(str(most))))


def _one_clock(recordings: Sequence[Readings]) -> bool:
    """Say whether times of several files are of one clock: a robot is never in configurations of two files at once."""
    if not all(np.isfinite(one.time).all() for one in recordings):
        return False
    spans = []
    for k, one in enumerate(recordings):
        for number in np.unique(one.configuration):
            time = one.time[one.configuration == number]
            spans.append((float(time.min()), float(time.max()), k))
    return all(a[2] == b[2] or a[1] <= b[0] for a, b in itertools.pairwise(sorted(spans)))


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


# --- several recordings as one ----------------------------------------------------------------------------------------


@dataclasses.dataclass(frozen=True, eq=False)
class Merged:
    """Several recordings as one.

    Attributes:
        cell: The cell of the first recording with the points of all, and the base frame as the frame of positions.
    """

    readings: Readings
    cell: Cell


def merge(members: Sequence[Member], alone: Sequence[Identification], first: int) -> Merged:
    """Return several recordings as one.

    Args:
        members: The recordings, in the order of their numbers; known effects taken off.
        alone: What each shows by itself.
        first: Index of the one that was named first; wrenches are stated in its axes where it holds any.
    """
    names = tuple(one.point(name) for one in members for name in one.readings.points)
    reference = wrench_reference(members, first)
    stated = members[reference], alone[reference]
    cell = _cell(members, alone, first, reference)
    differences = cell.measurements.points == "displacement"
    each = zip(members, alone, strict=True)
    parts = [placed(one, found, stated, names, differences=differences) for one, found in each]
    return Merged(_stacked(_same_warmth(parts)), cell)


def wrench_reference(members: Sequence[Member], first: int) -> int:
    """Return the index of the recording in whose axes wrenches are stated: the first, or the next that holds any."""
    holding = [k for k, one in enumerate(members) if one.readings.wrench is not None]
    return first if first in holding or not holding else holding[0]


def placed(
    member: Member,
    found: Identification,
    reference: tuple[Member, Identification],
    names: tuple[str, ...],
    *,
    differences: bool,
) -> Readings:
    """Return a recording in the base frame, named and numbered beside the others.

    Beside recordings with a wrench those without have one of zero; where neither it nor any of them has one, it has
    none.

    Args:
        member: The recording.
        found: What it, or another recording of its set-up, shows by itself.
        reference: The recording in whose axes wrenches are stated, and what it shows.
        names: Points of all recordings.
        differences: Whether positions become displacements from the first step of their configuration and point, as
            they do where one of the recordings holds displacements alone.

    Raises:
        CellError: It has a wrench, and its cell file does not say where the sensor or the wrench point is.
    """
    readings, cell, model = member.readings, member.cell, found.model
    _require_points(member, names)
    rotation, scale = model.tracker[:3, :3], noise_factor(found)
    position = readings.position @ rotation.T
    position = from_step_zero(readings, position) if differences else position + model.tracker[:3, 3]
    m = len(readings)
    wrench, claim, change = np.zeros((m, 6)), np.zeros((m, 6, 6)), np.tile(np.eye(6), (m, 1, 1))
    recorded = readings.wrench is not None or reference[0].readings.wrench is not None
    if readings.wrench is not None:
        load_of(readings, cell, model)  # refuses a cell that does not say where the sensor is: nothing may have asked
        change = _wrench_change(member, model, *reference)
        wrench = np.einsum("mij,mj->mi", change, readings.wrench)
        claim = scale**2 * change @ wrench_covariance(readings, cell) @ change.transpose(0, 2, 1)
    seen = readings.position_covariance
    path = readings.provenance.path
    return dataclasses.replace(
        readings,
        points=names,
        point=np.array([names.index(member.point(name)) for name in readings.points])[readings.point],
        configuration=readings.configuration + member.first_number,
        position=position,
        wrench=wrench if recorded else None,
        time=readings.time - (np.nanmin(readings.time) if np.isfinite(readings.time).any() else 0.0),
        position_covariance=None if seen is None else rotation @ seen @ rotation.T,
        wrench_covariance=None,
        recording=np.full(m, member.number - 1),
        position_claim=scale**2 * rotation @ position_covariance(readings, cell) @ rotation.T,
        wrench_claim=claim if recorded else None,
        viewpoint=np.tile(model.tracker[:3, 3], (m, 1)),
        wrench_change=change,
        notes=tuple(dataclasses.replace(note, place=f"{path}: {note.place}") for note in readings.notes),
    )


def noise_factor(found: Identification) -> float:
    """Return the factor on a recording's claimed noise with which it stands beside the others, at least 1.

    Where three points on a rigid tool show that the claim holds, what the standard's model leaves of a recording by
    itself is no noise: physics that is missing would weigh it less, and hide in the noise of all.
    """
    return found.noise.scale if found.noise.understated else 1.0


def with_readmitted(found: Identification, readmitted: Collection[object]) -> Identification:
    """Return what a recording shows by itself; readings used all the same by its user's word make its noise larger."""
    if not readmitted:
        return found
    return dataclasses.replace(found, noise=dataclasses.replace(found.noise, understated=True))


def _require_points(member: Member, names: tuple[str, ...]) -> None:
    """Refuse a further recording of a set-up with a point that the set-up does not have."""
    for name in member.readings.points:
        if member.point(name) not in names:
            known = [one.removesuffix(member.point("")) for one in names if one.endswith(member.point(""))]
            raise RecordingError(member.file, "point", quoted(name), f"a point of its set-up: {', '.join(known)}")


def _wrench_change(member: Member, model: ModelParameters, to_member: Member, to: Identification) -> Float3D:
    """Return what takes a wrench as recorded to axes and point of the reference, (m, 6, 6)."""
    m = len(member.readings)
    between = _point(member, model) - _point(to_member, to.model)
    if member.cell.measurements.wrench_axes == "base":
        at = posture(chain_of(member.cell).corrected(model.geometry), member.readings.q)
        arm, turn = (at.point(between) - at.flange_origin).T, np.tile(np.eye(3), (m, 1, 1))
    else:
        assert model.force_torque is not None  # noqa: S101 - `placed` has asked for it
        assert to.model.force_torque is not None  # noqa: S101
        target = to.model.force_torque[:3, :3].T
        arm = np.tile(target @ between, (m, 1))
        turn = np.tile(target @ model.force_torque[:3, :3], (m, 1, 1))
    change = np.zeros((m, 6, 6))
    change[:, :3, :3] = change[:, 3:, 3:] = turn
    change[:, 3:, :3] = _crossing(arm) @ turn
    return change


def _point(member: Member, model: ModelParameters) -> Float1D:
    """Return where a recording's wrenches are reduced to, flange frame, m."""
    if member.cell.measurements.wrench_at == "wrench_point":
        assert model.wrench_point is not None  # noqa: S101 - `placed` has asked for it
        return model.wrench_point
    assert model.force_torque is not None  # noqa: S101 - `placed` has asked for it
    return model.force_torque[:3, 3]


def _crossing(arm: Float2D) -> Float3D:
    """Return (m, 3, 3) matrices of the cross product from the left with `arm`, (m, 3)."""
    x, y, z = arm.T
    zero = np.zeros_like(x)
    return np.stack([[zero, -z, y], [z, zero, -x], [-y, x, zero]]).transpose(2, 0, 1)


def _same_warmth(parts: Sequence[Readings]) -> list[Readings]:
    """Return the recordings with one mean temperature: each has a thermometer, and a reference, of its own."""
    means = [_mean(part.temperature) for part in parts]
    common = float(np.mean(means))
    return [
        dataclasses.replace(part, temperature=part.temperature + (common - mean))
        for part, mean in zip(parts, means, strict=True)
    ]


def _stacked(parts: Sequence[Readings]) -> Readings:
    arrays: dict[str, Any] = {}
    for field in dataclasses.fields(Readings):
        values = [getattr(part, field.name) for part in parts]
        if any(isinstance(value, np.ndarray) for value in values):
            whole = all(value is not None for value in values)
            arrays[field.name] = np.concatenate(values) if whole else None
    return dataclasses.replace(
        parts[0],
        **arrays,
        provenance=_provenance([part.provenance for part in parts]),
        notes=tuple(note for part in parts for note in part.notes),
        conditions=(),
    )


def _provenance(each: Sequence[Provenance]) -> Provenance:
    return Provenance(
        path=", ".join(one.path for one in each),
        kind=", ".join(dict.fromkeys(one.kind for one in each)),
        sha256=digests_of_several((one.path, one.sha256) for one in each),
        messages={f"{one.path}: {name}": count for one in each for name, count in one.messages.items()},
        start=min((one.start for one in each if one.start), default=""),
    )


def _cell(members: Sequence[Member], alone: Sequence[Identification], first: int, reference: int) -> Cell:
    cell, model = members[first].cell, alone[reference].model
    points = {
        one.point(name): tuple(float(x) for x in found.model.points[name])
        for one, found in zip(members, alone, strict=True)
        for name in one.readings.points
    }
    frames = cell.frames.model_copy(
        update={
            "tracker": Pose(),
            "force_torque": None if model.force_torque is None else pose_of(model.force_torque),
            "wrench_point": None if model.wrench_point is None else tuple(float(x) for x in model.wrench_point),
            "measurement_points": points,
            "target_normals": {},
        }
    )
    measurements = members[reference].cell.measurements
    if displacements([one.cell for one in members]):
        measurements = measurements.model_copy(update={"points": "displacement"})
    return cell.model_copy(update={"frames": frames, "measurements": measurements, "end_effector": None})


def pose_of(pose: Float2D) -> Pose:
    """Return a (4, 4) pose as the cell file has it."""
    x, y, z, roll, pitch, yaw = xyz_rpy(pose)
    return Pose(xyz=(float(x), float(y), float(z)), rpy=(float(roll), float(pitch), float(yaw)))


def start_of(parameters: ModelParameters, merged: Merged) -> ModelParameters:
    """Return a model to start from with the frames and points of the merged recordings."""
    points: Mapping[str, Sequence[float]] = merged.cell.frames.measurement_points
    count = len(merged.readings.each())
    return parameters.replace(
        tracker=np.eye(4),
        points={name: np.array(point) for name, point in points.items()},
        setups=np.tile(np.eye(4), (count, 1, 1)),
    )


def _mean(values: Float1D) -> float:
    known = values[np.isfinite(values)]
    return float(known.mean()) if len(known) else 0.0
