"""Units that no file states: inferred where one alone makes sense, refused where two do."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path

import numpy as np

from calibration_core.errors import RecordingError
from calibration_core.recording.foreign.units import UNITS, ForeignUnit
from calibration_core.timeseries import Float1D, Float2D

LARGEST_TURN = 7.0  # rad: no joint of a calibrated robot stands farther than a turn from its zero
MOST_DEGREES = 720.0  # no joint stands farther than two turns from its zero
USUAL_JOINTS = 6  # robots with more joints often stand on a linear unit
STILL = 0.02  # degrees or m: so near to zero it is the same in either
NEAREST_POINT = 0.08  # m from the tracker
FARTHEST_POINT = 80.0  # m, range of a laser tracker
USUAL_POINT = (0.5, 15.0)  # m: nearer or farther no cell has its tracker, though a tracker could
LEAST_FORCE = 25.0  # no robot carries as many kN, so that a larger number is a force in N
MOST_FORCE = 1e5  # N: no robot carries ten tonnes, so that a larger number counts something
BEYOND_TRAVEL = 1.5  # times what the limits of a sliding joint allow
Inference = Callable[[Path, Float2D, str], tuple[ForeignUnit, str]]


def length(path: Path, values: Float2D, column: str) -> tuple[ForeignUnit, str]:
    """Return the unit of coordinates (m, 3), and why; `column` names the first of them in messages.

    Raises:
        RecordingError: There is more than one that makes sense, or none.
    """
    distance = np.linalg.norm(values, axis=1)
    fitting = [
        unit
        for unit in (UNITS["m"], UNITS["mm"])
        if distance.min(initial=math.inf) * unit.factor >= NEAREST_POINT
        and distance.max(initial=0.0) * unit.factor <= FARTHEST_POINT
    ]
    near = distance.max(initial=0.0) * UNITS["mm"].factor < USUAL_POINT[0]
    inches = distance * UNITS["in"].factor
    if UNITS["mm"] in fitting and near and USUAL_POINT[0] <= inches.min() and inches.max() <= USUAL_POINT[1]:
        fitting.append(UNITS["in"])
    if len(fitting) != 1:
        found = f"{distance.min():g} to {distance.max():g} from the origin, without a unit"
        raise RecordingError(
            path, f"column {column}", found, "a unit: state it in the header or in a map (units: {xyz: mm})"
        )
    limits = f"no target is nearer than {NEAREST_POINT:g} m or farther than {FARTHEST_POINT:g} m"
    return fitting[0], limits


def angle(path: Path, values: Float2D, column: str) -> tuple[ForeignUnit, str]:
    """Return the unit of joint angles (m, n), and why; arguments and errors as for `length`."""
    largest = float(np.abs(values).max(initial=0.0))
    spread = float(np.ptp(values, axis=0).max(initial=0.0))
    if largest > LARGEST_TURN:
        return UNITS["deg"], f"the largest is {largest:g}, more than a turn in rad"
    if spread > 0.5:
        return UNITS["rad"], f"the largest is {largest:g}: in degrees the robot would hardly move"
    found = f"angles up to {largest:g} without a unit"
    raise RecordingError(
        path, f"column {column}", found, "a unit: state it in the header or in a map (units: {q: deg})"
    )


def travel(farthest: float) -> Inference:
    """Return what infers the unit of a sliding joint, as `length` does, from its farthest position by its limits, m."""

    def infer(path: Path, values: Float2D, column: str) -> tuple[ForeignUnit, str]:
        largest = float(np.abs(values).max(initial=0.0))
        limits = f"the joint slides, and by its limits stands at most {farthest:g} m from its zero"
        if largest <= BEYOND_TRAVEL * farthest:
            return UNITS["m"], f"the largest is {largest:g}: {limits}"
        if largest * UNITS["mm"].factor <= BEYOND_TRAVEL * farthest:
            return UNITS["mm"], f"the largest is {largest:g}: {limits}"
        raise RecordingError(
            path, f"column {column}", f"positions up to {largest:g} without a unit", f"m, or mm: {limits}"
        )

    return infer


def force(path: Path, values: Float2D, column: str) -> tuple[ForeignUnit, str]:
    """Return the unit of forces (m, 3), and why; arguments and errors as for `length`."""
    largest = float(np.abs(values).max(initial=0.0))
    if LEAST_FORCE <= largest <= MOST_FORCE or largest == 0.0:
        return UNITS["n"], f"the largest is {largest:g}: in kN no robot carries it"
    found = f"forces up to {largest:g} without a unit"
    raise RecordingError(path, f"column {column}", found, "a unit: state it in the header or in a map (units: {f: kN})")


def refuse_two_ways(
    path: Path,
    joints: Sequence[str],
    numbers: Mapping[str, Float1D],
    columns: Mapping[str, str],
    inferred: Mapping[str, tuple[ForeignUnit, str]],
) -> None:
    """Refuse a joint without a unit that may as well slide as turn, where no cell file says which it does.

    Args:
        path: The file.
        joints: Meanings of its columns of joints.
        numbers: Meaning -> values as they stand in the file.
        columns: Meaning -> name of the column.
        inferred: Meaning -> unit that was inferred, and why.

    Raises:
        RecordingError: There is one beside joints in degrees.
    """
    for name in joints:
        unit = inferred[name][0].name if name in inferred else ""
        largest = float(np.abs(numbers[name]).max(initial=0.0))
        small = len(joints) > USUAL_JOINTS and STILL < largest <= LARGEST_TURN
        if unit == "deg" and (small or largest > MOST_DEGREES):
            found = f"positions up to {largest:g} without a unit, beside joints in degrees"
            stated = f"(units: {{{name}: deg}}, or m or mm where it slides)"
            expected = f"a unit, for the joint may turn or slide: state it in the header or in a map {stated}"
            raise RecordingError(path, f"column {columns[name]}", found, expected)
