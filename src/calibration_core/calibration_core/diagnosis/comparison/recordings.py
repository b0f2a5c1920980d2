"""A recording beside a simulation of it: first what is no physics, then configuration by configuration and step."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence

import numpy as np

from calibration_core.cell import Cell
from calibration_core.diagnosis.comparison.joints import by_posture, joint_differences, postures, relation
from calibration_core.diagnosis.comparison.model import Misfit, misfit, reproduction
from calibration_core.diagnosis.comparison.points import Placed, place, rigid
from calibration_core.diagnosis.comparison.result import (
    Comparison,
    Difference,
    PartDifference,
    Side,
    StepByStep,
    farther_off,
)
from calibration_core.diagnosis.comparison.wrench import wrench_differences
from calibration_core.identification.stiffness.predict import from_step_zero
from calibration_core.model.chain import Chain
from calibration_core.model.kinematics import posture, turned
from calibration_core.model.nominal import nominal_parameters
from calibration_core.model.robot import chain_of
from calibration_core.observations.covariance import coordinate_std, position_covariance
from calibration_core.timeseries import Float2D, Float3D, Int1D, Readings

FEWEST = 4  # readings that a comparison needs
WRONG_FILE = 0.0025  # of the reach, m per coordinate: farther apart, the two are not the same robot


def compare(recorded: Readings, simulated: Readings, cell: Cell) -> Comparison:
    """Compare a recording with a simulation.

    Args:
        recorded: The recording.
        simulated: What a simulation says of the same measurement.
        cell: The cell file, by which both are read.
    """
    same = reproduction(simulated, cell)
    pairing = _paired(recorded, simulated, cell)
    found = list(pairing.differences)
    steps = None
    if len(pairing.recorded) >= FEWEST:
        ours, theirs = recorded.select(pairing.recorded), simulated.select(pairing.simulated)
        chain = chain_of(cell)
        far = misfit(recorded, cell), misfit(simulated, cell)
        more, placed = _frames(ours, theirs, cell, chain, far, known=bool(found))
        found += more
        if ours.wrench is not None and theirs.wrench is not None:
            side = farther_off(far[0].deflection, far[1].deflection)
            found += wrench_differences(ours.wrench, theirs.wrench, sensor_axes(ours, cell, chain), side)
        elif (ours.wrench is None) != (theirs.wrench is None):
            which: Side = "recording" if ours.wrench is None else "simulation"
            text = f"The {which} holds no wrench, the other does."
            found.append(Difference("loads", {"sensor": "force_torque"}, which, 0.0, "N", text, True))
        if not any(d.spoils for d in found):
            steps = _step_by_step(ours, theirs, placed, cell)
    else:
        text = "Nothing of the simulation corresponds to the recording: no comparison step by step is possible."
        found.append(Difference("configurations", {"robot": "robot"}, "either", 0.0, "1", text, False))
    numbers = np.unique(recorded.configuration[pairing.recorded])
    return Comparison(
        recording=recorded.provenance.path,
        simulation=simulated.provenance.path,
        sha256=simulated.provenance.sha256,
        readings=len(pairing.recorded),
        configurations=len(numbers),
        reproduction=same,
        differences=tuple(found),
        steps=steps,
        sentences=_sentences(same.text, found, steps, len(numbers)),
    )


@dataclasses.dataclass(frozen=True, eq=False)
class _Pairing:
    """Rows that belong together, and what had to be seen through to find them."""

    recorded: Int1D
    simulated: Int1D
    differences: tuple[Difference, ...]


def _paired(recorded: Readings, simulated: Readings, cell: Cell) -> _Pairing:
    """Find which configuration of the simulation is which of the recording: by number, else by posture."""
    ours, q = postures(recorded)
    theirs, other = postures(simulated)
    _, a, b = np.intersect1d(ours, theirs, return_indices=True)
    links = relation(q[a], other[b]) if len(a) else None
    found: list[Difference] = []
    robot = {"robot": "robot"}
    if links is not None:
        found += joint_differences(links, cell.robot.joints, _joint_side(recorded, simulated, cell))
    else:
        a, b = by_posture(q, other)
        if len(a):
            text = f"The simulation numbers its configurations otherwise: {len(a)} are the same by their joint angles."
            found.append(Difference("configurations", robot, "either", float(len(a)), "1", text, False))
    if len(a) and (len(a) < len(ours) or len(a) < len(theirs)):
        text = f"{len(a)} configurations are in both; the recording holds {len(ours)}, the simulation {len(theirs)}."
        found.append(Difference("configurations", robot, "either", float(len(ours) - len(a)), "1", text, False))
    number = dict(zip(map(int, theirs[b]), map(int, ours[a]), strict=True))
    rows = {key: k for k, key in enumerate(_keys(simulated, number)) if key is not None}
    pairs = [
        (k, rows[key])
        for k, key in enumerate(_keys(recorded, dict(zip(number.values(), number.values(), strict=True))))
        if key in rows
    ]
    left, right = (np.array([pair[side] for pair in pairs], dtype=np.int64) for side in (0, 1))
    return _Pairing(left, right, (*found, *_steps(recorded, simulated), *_points(recorded, simulated)))


def _keys(readings: Readings, number: dict[int, int]) -> list[tuple[int, int, str] | None]:
    """Return (configuration as the recording counts it, step, point) of every row; None where it has no partner."""
    return [
        (number[int(c)], int(s), readings.points[p]) if int(c) in number else None
        for c, s, p in zip(readings.configuration, readings.step, readings.point, strict=True)
    ]


def _steps(recorded: Readings, simulated: Readings) -> tuple[Difference, ...]:
    ours, theirs = (set(map(int, r.step)) for r in (recorded, simulated))
    if ours == theirs:
        return ()
    text = f"The recording has {len(ours)} steps per configuration, the simulation {len(theirs)}; common ones compare."
    return (Difference("steps", {"robot": "robot"}, "either", float(len(ours ^ theirs)), "1", text, False),)


def _points(recorded: Readings, simulated: Readings) -> tuple[Difference, ...]:
    ours, theirs = ({r.points[k] for k in np.unique(r.point)} for r in (recorded, simulated))
    alone = sorted(ours ^ theirs)
    if not alone:
        return ()
    text = f"Measurement points that only one of the two holds: {', '.join(alone)}."
    return (Difference("points", {"point": ", ".join(alone)}, "either", float(len(alone)), "1", text, False),)


def _joint_side(recorded: Readings, simulated: Readings, cell: Cell) -> Side:
    """Say which of two recordings is farther from what the robot file says of its positions."""
    if cell.measurements.points == "displacement":
        far = misfit(recorded, cell).deflection, misfit(simulated, cell).deflection
    else:
        far = _rigid_misfit(recorded, cell), _rigid_misfit(simulated, cell)
    return farther_off(*far)


def _rigid_misfit(readings: Readings, cell: Cell) -> float:
    """Return what is left of the positions after the best rigid frame, m per coordinate."""
    return rigid(readings.position, _undeformed(readings, cell, chain_of(cell)))[2]


def _undeformed(readings: Readings, cell: Cell, chain: Chain) -> Float2D:
    """Return (m, 3) m, base frame, where the cell file puts the points of the undeformed robot."""
    stated = nominal_parameters(cell).points
    points = np.stack([stated[name] for name in readings.points])[readings.point].T
    return posture(chain, readings.q).point(points).T


def _frames(
    ours: Readings, theirs: Readings, cell: Cell, chain: Chain, far: tuple[Misfit, Misfit], *, known: bool
) -> tuple[list[Difference], Placed | None]:
    """Compare positions; of displacements only their size says something.

    Args:
        ours: Rows of the recording.
        theirs: The corresponding rows of the simulation.
        cell: The cell file.
        chain: The robot.
        far: How far both are from the cell file's model.
        known: Whether joints or protocol differ already, so that another robot is no explanation of its own.
    """
    if cell.measurements.points == "displacement":
        return _displacement_unit(ours, theirs), None
    differences = [bool(np.all(r.position[r.step == 0] == 0.0) and np.any(r.step == 0)) for r in (ours, theirs)]
    if differences[0] != differences[1]:
        which: Side = "recording" if differences[0] else "simulation"
        text = f"The {which} holds displacements from step 0, the other positions."
        return [Difference("displacements", {"tracker": "tracker"}, which, 0.0, "m", text, True)], None
    placed = place(ours.position, theirs.position, ours.point, ours.points, (far[0].absolute, far[1].absolute))
    found = list(placed.differences)
    if placed.rms > WRONG_FILE * chain.reach and not known:
        side = farther_off(_rigid_misfit(ours, cell), _rigid_misfit(theirs, cell))
        whose = f"the {side} was made with another robot" if side != "either" else "one of them is of another robot"
        text = (
            f"With the best frame recording and simulation are {1e3 * placed.rms:.1f} mm apart (rms per coordinate) at "
            f"the same joint angles: {whose}, or its joints, signs or units are mixed up."
        )
        found.append(Difference("wrong_robot_file", {"robot": "robot"}, side, placed.rms, "m", text, True))
    return found, placed


def _displacement_unit(ours: Readings, theirs: Readings) -> list[Difference]:
    size, other = (float(np.sqrt(np.mean(from_step_zero(r, r.position) ** 2))) for r in (ours, theirs))
    for factor, whose in ((1e3, "recording"), (1e-3, "simulation")):
        if other > 0 and 1 / 3 < size / other / factor < 3:
            side: Side = "recording" if factor > 1 else "simulation"
            text = f"The displacements differ by a factor of 1000: the {whose} is in mm instead of m."
            return [Difference("length_unit", {"tracker": "tracker"}, side, 1000.0, "1", text, True)]
    return []


def sensor_axes(readings: Readings, cell: Cell, chain: Chain) -> Float3D:
    """Return (m, 3, 3) whose columns are the sensor's axes in the base frame."""
    sensor = nominal_parameters(cell).force_torque
    flange = posture(chain, readings.q).flange
    axes = flange if sensor is None else turned(flange, sensor[:3, :3])
    return np.ascontiguousarray(axes.transpose(2, 1, 0))


def _step_by_step(ours: Readings, theirs: Readings, placed: Placed | None, cell: Cell) -> StepByStep:
    """Compare what corresponds, deflections where there are several steps, else positions."""
    position = theirs.position if placed is None else placed.position
    bends = len(np.unique(ours.step)) > 1
    mine, other = ours.position, position
    if bends:
        mine, other = _deflection(ours, mine), _deflection(ours, other)
    rest = mine - other
    noise = coordinate_std(position_covariance(ours, cell))
    power = float(np.sum(other**2))
    shown = mine if bends else np.zeros_like(mine)
    groups = [
        _parts(rest, shown, np.asarray(names), order)
        for names, order in (
            ([str(c) for c in ours.configuration], False),
            ([str(s) for s in ours.step], True),
            ([ours.points[p] for p in ours.point], True),
        )
    ]
    return StepByStep(
        rms=float(np.sqrt(np.mean(rest**2))),
        noise=float(np.sqrt(2)) * noise,
        slope=float(np.sum(mine * other)) / power if bends and power > 0 else float("nan"),
        by_configuration=groups[0],
        by_step=groups[1],
        by_point=groups[2],
    )


def _deflection(readings: Readings, position: Float2D) -> Float2D:
    """Return positions less the mean of their configuration and point."""
    _, group = np.unique(np.column_stack([readings.configuration, readings.point]), axis=0, return_inverse=True)
    group = group.reshape(-1)
    mean = np.zeros((group.max() + 1, 3))
    np.add.at(mean, group, position)
    return position - (mean / np.bincount(group)[:, None])[group]


def _parts(rest: Float2D, measured: Float2D, names: np.ndarray, in_order: bool) -> tuple[PartDifference, ...]:
    parts = []
    for name in dict.fromkeys(map(str, names)):
        rows = names == name
        parts.append(
            PartDifference(
                name,
                float(np.sqrt(np.mean(rest[rows] ** 2))),
                float(np.linalg.norm(rest[rows], axis=1).max()),
                float(np.sqrt(np.mean(measured[rows] ** 2))),
            )
        )
    return tuple(parts) if in_order else tuple(sorted(parts, key=lambda part: -part.rms))


def _sentences(
    model: str, found: Sequence[Difference], steps: StepByStep | None, configurations: int
) -> tuple[str, ...]:
    lines = [model, *(difference.text for difference in found)]
    if not found:
        lines.append("Protocol, joints, frames, signs and units of recording and simulation are the same.")
    if steps is None:
        lines.append("Physics is not compared step by step while such a difference stands.")
        return tuple(lines)
    bends = np.isfinite(steps.slope)
    what = "deflections" if bends else "positions"
    lines.append(
        f"Over {configurations} common configurations the {what} differ by {1e6 * steps.rms:.1f} µm rms a coordinate, "
        f"noise alone would make {1e6 * steps.noise:.1f} µm."
    )
    if bends:
        lines.append(f"The recording bends {100 * (steps.slope - 1):+.1f} % against the simulation.")
    worst = ", ".join(f"{part.name} ({1e6 * part.rms:.0f} µm)" for part in steps.by_configuration[:3])
    lines.append(f"The difference is largest in configurations {worst}.")
    return tuple(lines)
