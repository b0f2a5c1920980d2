"""What a measurement table must satisfy as a whole: plausible sizes, order, no reading twice."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np

from calibration_core.cell import Cell
from calibration_core.cell.travel import farthest
from calibration_core.errors import RecordingError, rounded_down
from calibration_core.timeseries import Bool1D, Int1D, Note, Readings

MAX_DISTANCE = 80.0  # m; trackers measure up to 80 m
MAX_DISPLACEMENT = 0.2  # m; a robot does not bend further
MAX_ANGLE = 4 * math.pi  # rad; the widest joints turn twice either way
BEYOND_TRAVEL = 10.0  # times what a sliding joint's limits allow: beyond, the unit is wrong
SHORTEST_TRAVEL = 1.0  # m; limits of less are not judged by
LONGEST_TRAVEL = 1000.0  # m; no linear unit is longer
TEMPERATURES = (-40.0, 100.0)  # degrees Celsius
OVERLOAD = 20.0  # times the rated load: beyond, the unit is wrong
MAX_ARM = 3.0  # m, for the torque of such a load


def check_plausible(path: Path, readings: Readings, cell: Cell, lines: Int1D, word: str = "line") -> None:
    """Refuse numbers that can only be of another unit; `word` is what an entry of `lines` is called in messages.

    Raises:
        RecordingError: Millimetres for metres, degrees for radians, kelvin for degrees Celsius, or a force no robot
            carries.
    """
    displacement = cell.measurements.points == "displacement"
    limit = MAX_DISPLACEMENT if displacement else MAX_DISTANCE
    distance = np.linalg.norm(readings.position, axis=1)
    what = "a displacement" if displacement else "a position"
    _refuse(path, word, lines, "x y z", distance > limit, distance, f"{what} in m, at most {limit:g} m")
    _check_joints(path, readings, cell, lines, word)
    cold, hot = TEMPERATURES
    celsius = readings.temperature
    _refuse(path, word, lines, "temperature", (celsius < cold) | (celsius > hot), celsius, f"{cold:g} to {hot:g} °C")
    if readings.wrench is not None:
        most = OVERLOAD * cell.robot.rated_load * float(np.linalg.norm(cell.gravity) or 9.80665)
        force = np.linalg.norm(readings.wrench[:, :3], axis=1)
        expected = f"a force in N, at most {rounded_down(most):g} ({OVERLOAD:g} times the rated load)"
        _refuse(path, word, lines, "fx fy fz", force > most, force, expected)
        torque = np.linalg.norm(readings.wrench[:, 3:], axis=1)
        expected = f"a torque in N*m, at most {rounded_down(most * MAX_ARM):g}"
        _refuse(path, word, lines, "tx ty tz", torque > most * MAX_ARM, torque, expected)


def _check_joints(path: Path, readings: Readings, cell: Cell, lines: Int1D, word: str) -> None:
    """Refuse angles in degrees and travels in millimetres, the first row of them."""
    slides = np.array(cell.prismatic)
    size = np.abs(readings.q)
    limits = np.full(size.shape[1], MAX_ANGLE)
    if slides.any():
        travel = BEYOND_TRAVEL * np.maximum(farthest(cell)[slides], SHORTEST_TRAVEL / BEYOND_TRAVEL)
        limits[slides] = np.minimum(travel, LONGEST_TRAVEL)
    worst = np.argmax(size / limits, axis=1)
    values, most = size[np.arange(len(size)), worst], limits[worst]
    wrong = values > most
    if wrong.any():
        joint = int(worst[np.argmax(wrong)])
        expected = "an angle in rad, at most 4 pi"
        if slides[joint]:
            expected = f"a distance in m, at most {rounded_down(limits[joint]):g} m by the limits of this joint"
        _refuse(path, word, lines, f"q{joint + 1}", wrong, values, expected)


def _refuse(path: Path, word: str, lines: Int1D, column: str, wrong: Bool1D, values: np.ndarray, expected: str) -> None:
    if wrong.any():
        first = int(np.argmax(wrong))
        place = f"{word} {lines[first]}, column {column}"
        raise RecordingError(path, place, f"a size of {values[first]:.6g}", expected)


def check_steps(path: Path, readings: Readings, lines: Int1D, word: str = "line") -> list[Note]:
    """Check that rows stand in the order of time and that no reading is there twice; `word` as in `check_plausible`.

    Returns:
        A note if step 0 is missing in some configurations.

    Raises:
        RecordingError: Time or steps go back, a step is negative, or (configuration, step, point) repeats.
    """
    if (readings.step < 0).any():
        row = int(np.argmax(readings.step < 0))
        raise RecordingError(path, f"{word} {lines[row]}, column step", str(readings.step[row]), "an integer from 0")
    known = np.flatnonzero(np.isfinite(readings.time))
    back = np.flatnonzero(np.diff(readings.time[known]) < 0)
    if len(back):
        row = int(known[back[0] + 1])
        found = f"{readings.time[row]:.9g} after {readings.time[known[back[0]]]:.9g}"
        raise RecordingError(path, f"{word} {lines[row]}, column time", found, "rows in the order of time")
    order = np.argsort(readings.configuration, kind="stable")
    configuration, step = readings.configuration[order], readings.step[order]
    same = np.diff(configuration) == 0
    wrong = np.flatnonzero(same & (np.diff(step) < 0))
    if len(wrong):
        row = int(order[wrong[0] + 1])
        found = f"step {readings.step[row]} of configuration {readings.configuration[row]} after step {step[wrong[0]]}"
        raise RecordingError(path, f"{word} {lines[row]}, column step", found, "steps in the order of time")
    keys = np.column_stack([readings.configuration, readings.step, readings.point])
    order = np.lexsort(keys.T[::-1])
    twice = np.flatnonzero((np.diff(keys[order], axis=0) == 0).all(axis=1))
    if len(twice):
        pairs = np.sort(np.column_stack([order[twice], order[twice + 1]]), axis=1)
        first, again = (int(i) for i in pairs[np.argmin(pairs[:, 1])])
        c, s, p = keys[again]
        found = f"configuration {c}, step {s}, point {readings.points[p]} as in {word} {lines[first]}"
        raise RecordingError(path, f"{word} {lines[again]}", found, "every reading once")
    firsts = step[np.flatnonzero(np.append(True, ~same))]
    without = int(np.count_nonzero(firsts != 0))
    if without:
        text = f"{without} configurations begin with a later step than 0"
        return [Note("no_step_zero", path.name, text, without)]
    return []
