"""Windows in which a step was measured: announced by step markers, or found in the joints and the wrench.

Without markers, a configuration is a standstill of the joints, and a step is a stretch of constant wrench in it.
Encoders of a loaded robot read slightly differently under load, so a standstill may move a little: what separates
two configurations is judged against the motions between them.
"""

from __future__ import annotations

import dataclasses

import numpy as np

from calibration_core.cell import Cell
from calibration_core.timeseries import (
    NANOSECONDS,
    Bool1D,
    Float1D,
    Float2D,
    Int1D,
    Note,
    Phase,
    StepMarkers,
    Streams,
    TimeSeries,
)

JOINT_BLOCK = 0.05  # s
SLOWEST_MOTION = 2e-4  # rad/s; also the most by which noise-free encoders may creep at a standstill
FASTEST_STANDSTILL = 0.02  # rad/s, with noisy encoders
SAME_CONFIGURATION = 0.05  # of the largest motion between standstills, at most ...
SAME_ANGLE = 0.02  # rad
SHORTEST_STANDSTILL = 1.0  # s
WRENCH_BLOCK = 0.25  # s
SHORTEST_PLATEAU = 4  # blocks
CHANGE = 6.0  # robust standard deviations
SETTLING = 1.0  # s after a motion or change of load that are not used, at most ...
SETTLING_SHARE = 0.3  # ... of the plateau
USUAL_SIGMA = (1.0, 0.5)  # N, N*m, where the cell names no force/torque sensor


@dataclasses.dataclass(frozen=True)
class Window:
    """A stretch of time in which one step was measured.

    Attributes:
        configuration: Its number.
        step: Its step, 0 first.
        begin: ns, first instant.
        end: ns, behind the last instant.
    """

    configuration: int
    step: int
    begin: int
    end: int


def marked_windows(steps: StepMarkers, last: int) -> tuple[list[Window], list[Note]]:
    """Return the measuring phases between step markers.

    A configuration that was measured again (after an interruption) counts once: the attempt with most steps, the last
    of equals.

    Args:
        steps: The markers.
        last: ns, time of the last sample; ends a phase that no marker ends.
    """
    ends = np.append(steps.time[1:], last + 1)
    windows = [
        Window(int(steps.configuration[i]), int(steps.step[i]), int(steps.time[i]), int(ends[i]))
        for i in np.flatnonzero((steps.phase == Phase.MEASURING) & (ends > steps.time))
    ]
    attempts: dict[int, list[list[Window]]] = {}
    for window in windows:
        mine = attempts.setdefault(window.configuration, [])
        if not mine or window.step <= mine[-1][-1].step:
            mine.append([])
        mine[-1].append(window)
    notes = []
    chosen: list[Window] = []
    for configuration, mine in attempts.items():
        best = max(reversed(mine), key=len)
        chosen += best
        if len(mine) > 1:
            text = f"measured {len(mine)} times: the attempt with {len(best)} steps is used"
            notes.append(Note("repeated", f"configuration {configuration}", text, len(mine) - 1))
    return sorted(chosen, key=lambda window: window.begin), notes


def found_windows(recording: Streams, cell: Cell) -> list[Window]:
    """Find configurations and steps where no markers were recorded.

    Returns:
        Windows in the order of time; configurations are numbered from 1, steps from 0.
    """
    windows: list[Window] = []
    configuration = 0
    noise = None if recording.wrench is None else _Wrench(recording.wrench, cell)
    for begin, end in standstills(recording.joints):
        plateaus = [(begin, end)] if noise is None else noise.plateaus(begin, end)
        if plateaus:
            configuration += 1
        for step, (first, last) in enumerate(plateaus):
            settling = int(min(SETTLING * NANOSECONDS, SETTLING_SHARE * (last - first)))
            windows.append(Window(configuration, step, first + settling, last))
    return windows


def standstills(joints: TimeSeries) -> list[tuple[int, int]]:
    """Return (begin, end) in ns of the stretches in which no joint moves, one per configuration."""
    time, q = block_means(joints, JOINT_BLOCK)
    if len(time) < 2:
        return []
    speed = np.abs(np.diff(q, axis=0)).max(axis=1) / (np.diff(time) / NANOSECONDS)
    noise = 6.0 * float(np.quantile(speed, 0.1))
    runs = _runs(speed < min(max(SLOWEST_MOTION, noise), FASTEST_STANDSTILL))
    still = [(first, last) for first, last in runs if time[last] - time[first] >= 0.3 * NANOSECONDS]
    if not still:
        return []
    means = np.array([q[first : last + 1].mean(axis=0) for first, last in still])
    largest = float(np.abs(np.diff(means, axis=0)).max()) if len(means) > 1 else 0.0
    same = min(SAME_ANGLE, SAME_CONFIGURATION * largest) if largest > 0.0 else SAME_ANGLE
    merged = [still[0]]
    for first, last in still[1:]:
        between = q[merged[-1][1] : first + 1]
        home = q[merged[-1][0] : merged[-1][1] + 1].mean(axis=0)
        if np.abs(between - home).max() <= same:
            merged[-1] = (merged[-1][0], last)
        else:
            merged.append((first, last))
    return [
        (int(time[first]), int(time[last]))
        for first, last in merged
        if time[last] - time[first] >= SHORTEST_STANDSTILL * NANOSECONDS
    ]


class _Wrench:
    """The wrench in blocks, whitened by the sensor's claim, with the noise of a block."""

    def __init__(self, wrench: TimeSeries, cell: Cell) -> None:
        sensor = cell.instruments.force_torque
        force, torque = USUAL_SIGMA if sensor is None else (sensor.sigma_force, sensor.sigma_torque)
        sigma = np.repeat([max(force, 1e-6), max(torque, 1e-6)], 3)
        self.time, blocks = block_means(wrench, WRENCH_BLOCK)
        self.blocks: Float2D = blocks / sigma
        steps = np.abs(np.diff(self.blocks, axis=0))
        # A quarter of the steps between blocks lie below 0.32 sigma even where most of the time is spent on ramps.
        quarter = np.quantile(steps, 0.25, axis=0) if len(steps) else np.zeros(6)
        self.noise: Float1D = np.maximum(quarter / (0.3186 * np.sqrt(2.0)), 0.1)

    def plateaus(self, begin: int, end: int) -> list[tuple[int, int]]:
        """Return (begin, end) in ns of the stretches of constant wrench between two instants."""
        rows = np.flatnonzero((self.time >= begin) & (self.time <= end))
        if len(rows) < SHORTEST_PLATEAU:
            return [(begin, end)] if len(rows) else []
        time, blocks = self.time[rows], self.blocks[rows]
        limit = CHANGE * np.sqrt(2.0) * self.noise
        quiet = (np.abs(blocks[2:] - blocks[:-2]) < limit).all(axis=1)
        found: list[tuple[int, int]] = []
        for first, last in _runs(quiet):  # differences over two blocks reach one block further
            if last + 1 - first >= SHORTEST_PLATEAU:
                found.append((first, last + 1))
        kept = self._without_disturbances(blocks, found)
        edge = int(WRENCH_BLOCK * NANOSECONDS / 2)
        return [
            (
                begin if first == 0 else int(time[first]) + edge,
                end if last == len(blocks) - 1 else int(time[last]) - edge,
            )
            for first, last in kept
        ]

    def _without_disturbances(self, blocks: Float2D, found: list[tuple[int, int]]) -> list[tuple[int, int]]:
        """Of neighbouring plateaus with the same wrench keep the longer one: the load was touched, not changed."""
        kept: list[tuple[int, int]] = []
        span = float(np.abs(blocks - blocks[0]).max())
        for first, last in found:
            if kept:
                before = blocks[kept[-1][0] : kept[-1][1] + 1]
                change = np.abs(blocks[first : last + 1].mean(axis=0) - before.mean(axis=0))
                if (change < np.maximum(CHANGE * self.noise / np.sqrt(len(before)), max(3.0, 0.01 * span))).all():
                    if last - first > kept[-1][1] - kept[-1][0]:
                        kept[-1] = (first, last)
                    continue
            kept.append((first, last))
        return kept


def block_means(series: TimeSeries, seconds: float) -> tuple[Int1D, Float2D]:
    """Average a series over blocks of time of at least two sampling intervals; empty blocks are left out.

    Returns:
        Mean times (b,) ns and mean values (b, k).
    """
    if len(series) < 2:
        return series.time, series.values
    interval = float(np.median(np.diff(series.time)))
    width = int(max(seconds * NANOSECONDS, 2.0 * interval, 1.0))
    since = series.time - series.time[0]
    first = np.flatnonzero(np.append(True, np.diff(since // width) > 0))
    count = np.diff(np.append(first, len(since)))
    time = series.time[0] + np.add.reduceat(since, first) // count
    return time, np.add.reduceat(series.values, first, axis=0) / count[:, None]


def _runs(mask: Bool1D) -> list[tuple[int, int]]:
    """(first, last) of the runs of True, in terms of the points that the differences in `mask` join."""
    edges = np.flatnonzero(np.diff(np.concatenate([[False], mask, [False]]).astype(np.int8)))
    return [(int(a), int(b)) for a, b in zip(edges[::2], edges[1::2], strict=True)]
