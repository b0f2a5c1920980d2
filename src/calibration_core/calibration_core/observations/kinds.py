"""Which kinds of configurations a recording holds: loaded and unloaded steps, or a posture at rest."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np

from calibration_core.cell import Cell
from calibration_core.errors import IdentificationError, RecordingError
from calibration_core.timeseries import Bool1D, Float1D, Readings

SLACK = 0.02  # of the largest force: less is none
FEWEST = 12  # unloaded postures from which on they alone fix frames and geometry


def is_loaded(readings: Readings) -> bool:
    """Say whether a recording carries loaded-minus-unloaded information."""
    keys = np.unique(np.column_stack([readings.configuration, readings.step]), axis=0)
    return readings.wrench is not None and len(keys) > len(np.unique(readings.configuration))


def single_steps(readings: Readings) -> Bool1D:
    """Say which readings are of a configuration with one step alone, (m,)."""
    pairs = np.unique(np.column_stack([readings.configuration, readings.step]), axis=0)
    numbers, steps = np.unique(pairs[:, 0], return_counts=True)
    return np.isin(readings.configuration, numbers[steps == 1])


def at_rest(readings: Readings) -> Bool1D:
    """Say which readings are of postures at rest, (m,): of one step, or of a recording without load among several."""
    found = single_steps(readings)
    if readings.recording is not None and readings.wrench is not None:
        for rows in readings.each():
            found[rows] |= not np.any(readings.wrench[rows])
    return found


def holds_single_steps(readings: Readings) -> bool:
    """Say whether any configuration has one step alone."""
    return bool(np.any(single_steps(readings)))


def references_alone(readings: Readings) -> IdentificationError:
    """Return the error of displacements that show nothing, because each is the reference of itself."""
    return IdentificationError(
        readings.provenance.path,
        "step",
        "single steps, and positions relative to step 0 (measurements.points: displacement)",
        "several steps per configuration, or absolute positions",
    )


def postures_at_rest(readings: Readings) -> int:
    """Return how many configurations of a recording of loads are postures at rest; none where it holds no loads."""
    return len(np.unique(readings.configuration[at_rest(readings)])) if is_loaded(readings) else 0


def holds_both(readings: Readings, cell: Cell) -> bool:
    """Say whether a recording holds loaded configurations and, beside them, positions of postures at rest."""
    return cell.measurements.points == "absolute" and is_loaded(readings) and bool(np.any(at_rest(readings)))


def loaded_configurations(readings: Readings) -> list[int]:
    """Return the numbers of the configurations with several steps."""
    return [int(number) for number in np.unique(readings.configuration[~single_steps(readings)])]


def held_out_freedom(readings: Readings) -> int:
    """Return of how many independent coordinates the errors of configurations left out are.

    Under load one of the steps of a configuration and point is its offset, or the reference of the others.
    """
    if not is_loaded(readings):
        return 3 * len(readings)
    steps = np.unique(np.column_stack([readings.configuration, readings.point]), axis=0, return_counts=True)[1]
    return 3 * int(np.maximum(steps - 1, 1).sum())


def relative_pull(readings: Readings) -> Float1D:
    """Return how hard every reading is pulled, (m,), as a share of the range of the force of its recording, 0 to 1.

    The smallest force of a recording is that of no load: a sensor may show the weight of the tool.  Zero where no
    wrench was recorded, or the force is always the same.
    """
    pull = np.zeros(len(readings))
    if readings.wrench is not None:
        for rows in readings.each():
            force = np.linalg.norm(readings.wrench[rows, :3], axis=1)
            if np.ptp(force) > 0:
                pull[rows] = (force - force.min()) / np.ptp(force)
    return pull


def unloaded_visits(readings: Readings) -> list[int]:
    """Return the numbers of configurations with several steps at none of which anything pulls, as of a reference."""
    pulled = relative_pull(readings) > SLACK
    found: list[int] = []
    for rows in readings.each():
        some = np.unique(readings.configuration[rows][pulled[rows]])
        if len(some):  # otherwise nothing was loaded, or nobody knows
            found += sorted(set(loaded_configurations(readings.select(rows))) - set(some.tolist()))
    return found


def standing(readings: Readings) -> Bool1D:
    """Return the rows of first steps at which next to nothing pulls, (m,); where these are few, of all first steps.

    Of several recordings, each is judged by itself: each has frames of its own that they have to fix.
    """
    found = np.zeros(len(readings), dtype=bool)
    for rows in readings.each():
        found[rows] = _standing(readings.select(rows))
    return found


def _standing(readings: Readings) -> Bool1D:
    first = np.zeros(len(readings), dtype=bool)
    for number in np.unique(readings.configuration):
        inside = readings.configuration == number
        first |= inside & (readings.step == readings.step[inside].min())
    if readings.wrench is None:
        return first
    force = np.linalg.norm(readings.wrench[:, :3], axis=1)
    unloaded = first & (force < SLACK * force.max())
    enough = len(np.unique(readings.configuration[unloaded])) >= FEWEST
    return unloaded if enough else first


LEAST = 0.02  # of the largest load: levels closer than this are the same


def levels_of(readings: Readings) -> tuple[float, ...]:
    """Return the load levels of a recording's steps, as shares of the full load, the first being none.

    Of the configurations with as many readings as most have, the one of the largest load stands for all (a reference
    that is measured again and again is not loaded, nor are postures at rest beside loaded configurations); a load
    against the first full one is negative.
    """
    if is_loaded(readings):
        readings = readings.select(~single_steps(readings))
    assert readings.wrench is not None  # noqa: S101 - a loaded recording has a wrench
    numbers, counts = np.unique(readings.configuration, return_counts=True)
    usual, often = np.unique(counts, return_counts=True)
    size = np.linalg.norm(readings.wrench[:, :3], axis=1)
    among = np.isin(readings.configuration, numbers[counts == usual[np.argmax(often)]])
    inside = readings.configuration == readings.configuration[np.argmax(np.where(among, size, -1.0))]
    steps, first = np.unique(readings.step[inside], return_index=True)
    wrench = readings.wrench[inside][first][np.argsort(steps)]
    size = np.linalg.norm(wrench[:, :3], axis=1)
    full = wrench[int(np.argmax(size >= (1 - LEAST) * size.max())), :3]
    power = float(full @ full)
    if power == 0.0:
        return (0.0,)
    levels = np.round(wrench[:, :3] @ full / power, 2)
    levels[np.abs(levels) < LEAST] = 0.0
    return tuple(float(level) for level in np.clip(levels, -1.0, 1.0))


def largest_force(readings: Readings) -> float:
    """Return the largest force of a recording, N."""
    assert readings.wrench is not None  # noqa: S101 - a loaded recording has a wrench
    return float(np.linalg.norm(readings.wrench[:, :3], axis=1).max())


SAME = 0.5  # of the readings: more in common is the same recording
DIGITS = 6  # of m and rad: readings that agree to so many are the same, for noise is larger


def reading_keys(readings: Readings) -> set[bytes]:
    """Return every reading by its angles and position; formats differ in how a wrench is averaged."""
    values = np.round(np.column_stack([readings.q, readings.position]), DIGITS) + 0.0  # no negative zeros
    return {row.tobytes() for row in values}


def refuse_same(recordings: Iterable[Readings]) -> None:
    """Refuse recordings of which one holds, for the most part, the readings of another.

    Raises:
        RecordingError: There are two such; names the later one.
    """
    before: list[tuple[str, set[bytes]]] = []
    for readings in recordings:
        path, own = readings.provenance.path, reading_keys(readings)
        for other, theirs in before:
            same = len(own & theirs)
            if same > SAME * min(len(own), len(theirs)):
                found = f"{same} of {len(own)} readings that are those of {other}"
                raise RecordingError(path, "", found, "every recording once")
        before.append((path, own))
