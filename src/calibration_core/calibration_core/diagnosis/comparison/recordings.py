"""A recording beside a simulation of it: first what is no physics, then configuration by configuration and step."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence

import numpy as np

from calibration_core.cell import Cell
from calibration_core.diagnosis.comparison.joints import (
    Link,
    as_recorded,
    by_posture,
    joint_differences,
    postures,
    relation,
)
from calibration_core.diagnosis.comparison.model import Misfit, misfit, reproduction, rigid_misfit
from calibration_core.diagnosis.comparison.points import Placed, place, position_unit, rigid
from calibration_core.diagnosis.comparison.result import (
    Comparison,
    Difference,
    OwnFaults,
    Reproduction,
    Side,
    StepByStep,
    Witness,
    farther_off,
)
from calibration_core.diagnosis.comparison.steps import UNLOADED, deflection, step_by_step
from calibration_core.diagnosis.comparison.witnesses import witnesses
from calibration_core.diagnosis.comparison.wrench import SMALL, read_as, wrench_differences
from calibration_core.identification.stiffness.predict import from_step_zero, predict_readings
from calibration_core.input_checks.check import check_inputs
from calibration_core.model.chain import Chain
from calibration_core.model.kinematics import posture, turned
from calibration_core.model.nominal import nominal_parameters
from calibration_core.model.robot import chain_of
from calibration_core.policy import FEWEST_READINGS
from calibration_core.timeseries import Bool1D, Float3D, Int1D, Readings

WRENCHES = ("wrench_sign", "wrench_unit", "wrench_frame")
ANGLES = ("joint_order", "angle_unit", "wrong_robot_file")
WRONG_FILE = 0.0025  # of the reach, m per coordinate: farther apart, the two are not the same robot


def compare(
    recorded: Readings,
    simulated: Readings,
    cell: Cell,
    own: OwnFaults | None = None,
    described: Sequence[Difference] = (),
) -> Comparison:
    """Compare a recording with a simulation.

    Args:
        recorded: The recording.
        simulated: What a simulation says of the same measurement.
        cell: The cell file, by which both are read.
        own: What is wrong with the simulation by itself; None: nothing.
        described: What was put right in the simulation before.
    """
    own = OwnFaults((), np.ones(len(simulated), dtype=bool), None) if own is None else own
    sound = simulated.select(own.sound)
    same = reproduction(sound, cell, own.noise)
    weightless, off = _without_weight(sound, cell, own.noise, same)
    same = weightless or same
    pairing = _paired(recorded, simulated, cell).without(~own.sound)
    found = [*described, *off, *pairing.differences]
    heard: tuple[Witness, ...] = ()
    steps = postures = None
    if len(pairing.recorded) >= FEWEST_READINGS:
        ours, theirs = recorded.select(pairing.recorded), simulated.select(pairing.simulated)
        chain = chain_of(cell)
        if ours.wrench is not None and theirs.wrench is None:
            same = dataclasses.replace(same, compliance=np.zeros(chain.n))
        far = misfit(recorded, cell), misfit(sound, cell)
        more, placed = _frames(ours, theirs, cell, chain, far, known=bool(found))
        found += more
        if ours.wrench is not None and theirs.wrench is not None:
            side = farther_off(far[0].deflection, far[1].deflection)
            found += wrench_differences(ours.wrench, theirs.wrench, sensor_axes(ours, cell, chain), side)
        elif theirs.wrench is not None:
            text = "The recording holds no load, the simulation does."
            found.append(Difference("loads", {"sensor": "force_torque"}, "recording", 0.0, "N", text, True))
        found = _decided(found, recorded, sound, cell)
        heard = tuple(witnesses(ours, theirs, cell, known=any(d.spoils for d in found)))
        if not any(d.spoils for d in found):
            steps, postures = step_by_step(ours, theirs, placed, cell, own.noise)
    else:
        text = "Nothing of the simulation corresponds to the recording: no comparison step by step is possible."
        found.append(Difference("configurations", {"robot": "robot"}, "either", 0.0, "1", text, False))
    if not same.reproduced and any(d.spoils and d.kind != "loads" and d.side != "recording" for d in found):
        same = dataclasses.replace(same, text="The core's model does not reproduce the simulation as it stands.")
    found += own.differences
    numbers = np.unique(recorded.configuration[pairing.recorded])
    notes = [one for one in (same.text, own.note, *(one.text for one in heard)) if one]
    return Comparison(
        recording=recorded.provenance.path,
        simulation=simulated.provenance.path,
        sha256=simulated.provenance.sha256,
        readings=len(pairing.recorded),
        configurations=len(numbers),
        reproduction=same,
        differences=tuple(found),
        steps=steps,
        postures=postures,
        sentences=_sentences(notes, found, steps, postures),
        witnesses=heard,
        rows=pairing.recorded,
        simulated=simulated.select(pairing.simulated),
    )


def _without_weight(
    simulated: Readings, cell: Cell, seen: float | None, same: Reproduction
) -> tuple[Reproduction | None, tuple[Difference, ...]]:
    """Tell whether a simulation leaves the robot's own weight out; then how the model without weight reproduces it."""
    if same.reproduced or not np.isfinite(same.absolute_rms) or chain_of(cell).mass is None:
        return None, ()
    robot = cell.robot.model_copy(update={"gravity": (0.0, 0.0, 0.0)})
    again = reproduction(simulated, cell.model_copy(update={"robot": robot}), seen)
    if farther_off(again.absolute_rms, same.absolute_rms) != "simulation":
        return None, ()
    text = (
        f"The simulation leaves the robot's own weight out: without it its positions are "
        f"{1e6 * again.absolute_rms:.0f} µm from the cell file's, with it {1e6 * same.absolute_rms:.0f} µm."
    )
    return again, (Difference("gravity", {"robot": "robot"}, "simulation", same.absolute_rms, "m", text, False),)


def with_loads(recorded: Readings, simulated: Readings, cell: Cell) -> tuple[Readings, tuple[Difference, ...]]:
    """Return a simulation whose loads are stated, and what had to be taken for granted; zeros state no load.

    One that bends was made under loads, and they are taken to be the recorded ones.
    """
    if simulated.wrench is not None and np.abs(simulated.wrench).max(initial=0.0) > SMALL:
        return simulated, ()
    simulated = dataclasses.replace(simulated, wrench=None)
    if recorded.wrench is None or not np.abs(recorded.wrench).max(initial=0.0) > SMALL:
        return simulated, ()
    pairing = _paired(recorded, simulated, cell)
    if len(pairing.recorded) < FEWEST_READINGS:
        return simulated, ()
    ours, theirs = recorded.select(pairing.recorded), simulated.select(pairing.simulated)
    if not np.any(np.ptp(ours.step) > 0):
        return simulated, ()
    size, bent = (float(np.sqrt(np.mean(deflection(r, r.position) ** 2))) for r in (ours, theirs))
    if bent <= UNLOADED * size:
        text = "The simulation states no load and does not bend: it is compared as the rigid robot."
    else:
        text = "The simulation states no load and bends: its loads are taken to be the recorded ones."
        simulated = dataclasses.replace(theirs, wrench=ours.wrench)
    return simulated, (Difference("loads", {"sensor": "force_torque"}, "simulation", 0.0, "N", text, False),)


def put_right(recorded: Readings, simulated: Readings, cell: Cell, wrong: Sequence[Difference]) -> Readings | None:
    """Return a simulation in the recording's units, signs and axes, rows that correspond; None where there is no way.

    Args:
        recorded: The recording.
        simulated: The simulation.
        cell: The cell file.
        wrong: What is wrong with the simulation.
    """
    pairing = _paired(recorded, simulated, cell)
    ours, theirs = recorded.select(pairing.recorded), simulated.select(pairing.simulated)
    wrench = theirs.wrench
    for difference in wrong:
        if difference.kind == "position_unit":
            theirs = dataclasses.replace(theirs, position=theirs.position * difference.further["factor"])
        elif difference.kind in ANGLES and "joint" in difference.location:
            theirs = dataclasses.replace(theirs, q=as_recorded(pairing.links, simulated.q[pairing.simulated]))
        elif difference.kind in WRENCHES and ours.wrench is not None and wrench is not None:
            axes = sensor_axes(ours, cell, chain_of(cell))
            theirs = dataclasses.replace(theirs, wrench=read_as(ours.wrench, wrench, axes))
        else:
            return None
    return theirs


@dataclasses.dataclass(frozen=True, eq=False)
class _Pairing:
    """Rows that belong together, what had to be seen through to find them, and how the joints' angles are related."""

    recorded: Int1D
    simulated: Int1D
    differences: tuple[Difference, ...]
    links: tuple[Link, ...]

    def without(self, aside: Bool1D) -> _Pairing:
        """Return the pairs of which the simulated row, (m,), is not set aside."""
        kept = ~aside[self.simulated]
        return dataclasses.replace(self, recorded=self.recorded[kept], simulated=self.simulated[kept])


def _paired(recorded: Readings, simulated: Readings, cell: Cell) -> _Pairing:
    """Find which configuration of the simulation is which of the recording: by number, else by posture."""
    ours, q = postures(recorded)
    theirs, other = postures(simulated)
    _, a, b = np.intersect1d(ours, theirs, return_indices=True)
    links = relation(q[a], other[b]) if len(a) else None
    found: list[Difference] = []
    robot = {"robot": "robot"}
    if links is None:
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
    if links is not None and pairs and not all(link.plain and link.joint == i for i, link in enumerate(links)):
        side = _joint_side(recorded.select(left), simulated.select(right), cell)
        found = [*joint_differences(links, cell.robot.joints, side), *found]
    found += [*_steps(recorded, ours[a], simulated, theirs[b]), *_points(recorded, simulated)]
    return _Pairing(left, right, tuple(found), links or ())


def _keys(readings: Readings, number: dict[int, int]) -> list[tuple[int, int, str] | None]:
    """Return (configuration as the recording counts it, step, point) of every row; None where it has no partner."""
    return [
        (number[int(c)], int(s), readings.points[p]) if int(c) in number else None
        for c, s, p in zip(readings.configuration, readings.step, readings.point, strict=True)
    ]


def _steps(recorded: Readings, common: Int1D, simulated: Readings, partners: Int1D) -> tuple[Difference, ...]:
    of = ((recorded, common), (simulated, partners))
    ours, theirs = (set(map(int, r.step[np.isin(r.configuration, kept)])) for r, kept in of)
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


def _joint_side(ours: Readings, theirs: Readings, cell: Cell) -> Side:
    """Say whose joint angles disagree with the robot file.

    The positions of either are held against its own angles and against those of the other: those of a simulation fit
    their own angles nearly without error, unless these are wrong.  What turns the whole robot, as another zero of its
    first joint does, the stated tracker frame decides.
    """
    if cell.measurements.points == "displacement":
        return farther_off(misfit(ours, cell).deflection, misfit(theirs, cell).deflection)
    left = {
        (whose, angles): rigid_misfit(dataclasses.replace(readings, q=q), cell)
        for whose, readings in (("recording", ours), ("simulation", theirs))
        for angles, q in (("recording", ours.q), ("simulation", theirs.q))
    }
    side = farther_off(left["simulation", "recording"], left["simulation", "simulation"])
    if side == "either":
        side = farther_off(left["recording", "recording"], left["recording", "simulation"])
    if side == "either":
        side = farther_off(misfit(ours, cell).absolute, misfit(theirs, cell).absolute)
    return side


def _decided(found: Sequence[Difference], recorded: Readings, simulated: Readings, cell: Cell) -> list[Difference]:
    """Give what may be the fault of either to the one that by itself does not fit the cell file, if the other does."""

    def open_to_both(difference: Difference) -> bool:
        return difference.of_recording and difference.side == "either"

    if not any(map(open_to_both, found)):
        return list(found)
    blocked = [any(one.blocks for one in check_inputs(each, cell)) for each in (recorded, simulated)]
    if blocked[0] == blocked[1]:
        return list(found)
    side: Side = "recording" if blocked[0] else "simulation"
    return [dataclasses.replace(d, side=side) if open_to_both(d) else d for d in found]


def _frames(
    ours: Readings, theirs: Readings, cell: Cell, chain: Chain, far: tuple[Misfit, Misfit], *, known: bool
) -> tuple[list[Difference], Placed | None]:
    """Compare positions; of displacements only their size says something."""
    if cell.measurements.points == "displacement":
        return _displacement_unit(ours, theirs), None
    differences = [bool(np.all(r.position[r.step == 0] == 0.0) and np.any(r.step == 0)) for r in (ours, theirs)]
    if differences[0] != differences[1]:
        which: Side = "recording" if differences[0] else "simulation"
        text = f"The {which} holds displacements from step 0, the other positions."
        remedy = "state measurements.points: displacement in the cell file, or record positions"
        return [Difference("no_relation", {"tracker": "tracker"}, which, 0.0, "m", text, True, remedy)], None
    apart = far[0].absolute, far[1].absolute
    axes = _flange_axes(ours, cell, chain)
    placed = place(ours.position, theirs.position, ours.point, ours.configuration, ours.points, apart, axes)
    found = list(placed.differences)
    if placed.rms > WRONG_FILE * chain.reach and not known:
        side = farther_off(rigid_misfit(ours, cell), rigid_misfit(theirs, cell))
        whose = f"the {side} was made with another robot" if side != "either" else "one of them is of another robot"
        text = (
            f"With the best frame recording and simulation are {1e3 * placed.rms:.1f} mm apart (rms per coordinate) at "
            f"the same joint angles: {whose}, or its joints, signs or units are mixed up."
        )
        remedy = "use the file of this robot, and check its joint zeros and signs"
        found.append(Difference("wrong_robot_file", {"robot": "robot"}, side, placed.rms, "m", text, True, remedy))
    return found, placed


def _flange_axes(readings: Readings, cell: Cell, chain: Chain) -> Float3D | None:
    """Return (m, 3, 3) whose columns are the flange's axes in the frame of the positions; None without a tracker pose.

    How that frame stands, the positions themselves show.
    """
    if cell.frames.tracker is None:
        return None
    model = nominal_parameters(cell)
    still = readings if readings.wrench is None else dataclasses.replace(readings, wrench=0 * readings.wrench)
    turn = rigid(readings.position, predict_readings(still, cell, model))[0] @ model.tracker[:3, :3].T
    flange = posture(chain, readings.q).flange.transpose(2, 1, 0)
    return np.ascontiguousarray(np.einsum("ab,mbc->mac", turn, flange))


def _displacement_unit(ours: Readings, theirs: Readings) -> list[Difference]:
    size, other = (float(np.sqrt(np.mean(from_step_zero(r, r.position) ** 2))) for r in (ours, theirs))
    for factor, whose in ((1e3, "recording"), (1e-3, "simulation")):
        if other > 0 and 1 / 3 < size / other / factor < 3:
            side: Side = "recording" if factor > 1 else "simulation"
            text = f"The displacements differ by a factor of 1000: the {whose} is in mm instead of m."
            return [position_unit(side, text)]
    return []


def sensor_axes(readings: Readings, cell: Cell, chain: Chain) -> Float3D:
    """Return (m, 3, 3) whose columns are the sensor's axes in the base frame."""
    sensor = nominal_parameters(cell).force_torque
    flange = posture(chain, readings.q).flange
    axes = flange if sensor is None else turned(flange, sensor[:3, :3])
    return np.ascontiguousarray(axes.transpose(2, 1, 0))


def _sentences(
    notes: Sequence[str], found: Sequence[Difference], steps: StepByStep | None, postures: StepByStep | None
) -> tuple[str, ...]:
    lines = [*notes, *(difference.sentence for difference in found)]
    if not found:
        lines.append("Protocol, joints, frames, signs and units of recording and simulation are the same.")
    if steps is None:
        lines.append("Physics is not compared step by step while such a difference stands.")
        return tuple(lines)
    bends = np.isfinite(steps.slope)
    what = "deflections" if bends else "positions"
    which = "common configurations" if postures is None else "common configurations with several steps"
    lines.append(_size(which, what, steps))
    if bends:
        lines.append(f"The recording bends {100 * (steps.slope - 1):+z.1f} % against the simulation.")
    lines.append(f"The difference is largest in configurations {_worst(steps)}.")
    if postures is not None:
        where = "common configurations with one step"
        lines.append(_size(where, "positions, in the frame that fits the unloaded robot best,", postures))
        lines.append(f"The difference of these positions is largest in configurations {_worst(postures)}.")
    return tuple(lines)


def _size(which: str, what: str, steps: StepByStep) -> str:
    return (
        f"Over {len(steps.by_configuration)} {which} the {what} differ by {1e6 * steps.rms:.1f} µm rms a coordinate, "
        f"noise alone would make {1e6 * steps.noise:.1f} µm."
    )


def _worst(steps: StepByStep) -> str:
    return ", ".join(f"{part.name} ({1e6 * part.rms:.0f} µm)" for part in steps.by_configuration[:3])
