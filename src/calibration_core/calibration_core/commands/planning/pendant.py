"""`calibration pendant`: a plan as a program for the robot's own pendant, where a hand on it moves the robot.

The sequencer (back end `external`) asks for one posture after the other, and sees from the joint states that the robot
stands there.  The program goes to the same postures in the same order, and halts at each until the operator starts it
again.  What the order leaves open stands in programs of its own: the spares, and the start-up cycle, which comes again.
"""

from __future__ import annotations

import argparse
import dataclasses
import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from calibration_core import __version__
from calibration_core.cell import MOST_CONDITION, Cell, load_cell
from calibration_core.commands.files.import_tables import MAX_MAP
from calibration_core.engine.command_line import refuse_without_effect, separate
from calibration_core.errors import CellError, InputError, RecordingError, quoted
from calibration_core.files.written import json_bytes
from calibration_core.files.yaml_file import read_yaml
from calibration_core.formats.pendant import MAKERS, Halt, Maker, plain
from calibration_core.model.nominal import nominal_parameters, tool_point
from calibration_core.model.robot import chain_of
from calibration_core.motion.speed import REFINED, Monitored, hermite_bound
from calibration_core.motion.trajectory import MotionLimits
from calibration_core.outcomes.inputs import digest_of
from calibration_core.planning.plans.measurement_queue import Item, SequenceRules
from calibration_core.planning.plans.plan import Plan
from calibration_core.planning.plans.plan_file import read_plan
from calibration_core.planning.route import stops
from calibration_core.policy import MOTION_PEAK
from calibration_core.recording.foreign.join import coupled
from calibration_core.recording.foreign.mapping import ImportMap, import_map
from calibration_core.report.results.command import input_record
from calibration_core.report.results.result import SCHEMA
from calibration_core.report.rounding import counted
from calibration_core.report.writing.output import RESULT, write_files
from calibration_core.timeseries import Float1D, Float2D

NAMES = ("calib", "calib_s", "calib_w")  # of the programs: at most 8 letters, as old controllers of Yaskawa take them
DIGITS = {"deg": 4, "mm": 4, "rad": 6, "pulses": 0}
NEEDED = {"--axis-speeds": ("kuka", "yaskawa"), "--pulses": ("yaskawa",)}  # option -> makers


@dataclasses.dataclass(frozen=True, eq=False)
class _Axes:
    """How the angles of the chain become values of the controller's axes.

    Attributes:
        names: Of the controller's axes, in the order of q.
        units: Likewise.
        matrix: (n, n) what takes q to the values.
        fastest: (n,) largest speed of every axis, value per s; where the maker needs none, 1.
    """

    names: tuple[str, ...]
    units: tuple[str, ...]
    matrix: Float2D
    fastest: Float1D


def run(arguments: argparse.Namespace) -> str:
    """Write the programs, and return a summary.

    Raises:
        InputError: Cell, plan or map cannot be used, or leave open where the controller's axes would stand.
    """
    maker = MAKERS[arguments.maker]
    for option, makers in NEEDED.items():
        if arguments.maker not in makers:
            needed = " or ".join(f"--maker {one}" for one in makers)
            refuse_without_effect(arguments.stated, "pendant", (option,), f"for {arguments.maker}", needed)
    cell = load_cell(arguments.cell)
    robot = f"{cell.robot.maker} {cell.robot.name}".strip()
    others = [key for key, one in MAKERS.items() if one.known.search(robot)]
    if others and arguments.maker not in others:
        raise InputError(cell.path, "robot", quoted(robot), f"a robot of this maker, or --maker {others[0]}")
    plan = read_plan(arguments.plan, cell)
    axes = _axes(arguments, cell, maker)
    inputs = {"plan": digest_of(arguments.plan)} | ({} if arguments.map is None else {"map": digest_of(arguments.map)})
    route = stops(plan, SequenceRules(startup_period=math.inf))
    spares = [Item(one.number, one.q, one.steps, 0, "configuration", one.phase) for one in plan.spares]
    home = [item for item in route if item.kind == "reference"][:1]
    parts = (route, [*spares, *home] if spares else [], [item for item in route if item.kind == "startup"])
    files: dict[str, bytes] = {}
    programs: list[dict[str, Any]] = []
    lines: list[str] = []
    for name, items in zip(NAMES, parts, strict=True):
        if items:
            halts, bound = _halts(items, cell, plan, axes, maker)
            file, fastest = maker.file(name), f"at most {1e3 * bound:.0f} mm/s"
            files[file] = maker.write(name, _remarks(cell, inputs["plan"], fastest), halts).encode("ascii")
            programs.append({"file": file, "stops": len(halts), "speed_bound": bound, "unit": "m/s"})
            lines.append(f"{file}: {counted(len(halts), 'stop')}, from one to the next {fastest}")
    notes = _notes(plan, maker, counted_otherwise=bool(np.any(axes.matrix != np.diag(np.diag(axes.matrix)))))
    result = {
        "schema": SCHEMA,
        "command": "pendant",
        "robot": cell.robot.name,
        "maker": arguments.maker,
        "files": sorted(files),
        "programs": programs,
        "axes": dict(zip(cell.robot.joints, axes.names, strict=True)),
        "notes": notes,
        "input": input_record(cell, None, inputs),
        "summary": [*lines, *notes],
    }
    write_files(arguments.out, {RESULT: json_bytes(result), **files})
    return "\n".join([f"{cell.robot.name} as {arguments.maker}: {', '.join(files)} in {arguments.out}", *lines, *notes])


# --- the controller's axes --------------------------------------------------------------------------------------------


def _axes(arguments: argparse.Namespace, cell: Cell, maker: Maker) -> _Axes:
    """Return the controller's axes of the cell's joints.

    Raises:
        InputError: Cell file, map and options leave one open.
    """
    how, joints, place = ImportMap(), cell.robot.joints, arguments.map or cell.path
    if arguments.map is not None:
        file = read_yaml(arguments.map, MAX_MAP, "map (YAML)", RecordingError)
        with file.locating():
            how = import_map(file.path, file.data)
    program = maker.file(NAMES[0])
    of = how.of(Path(program))
    if how.files and of not in how.files:
        found = ", ".join(quoted(one.match) for one in how.files)
        raise RecordingError(place, "files", found, f"a pattern that fits {program}, if anything of it shall count")
    meant = {meaning: axis for axis, meaning in of.columns.items()}
    names = tuple(meant.get(f"q{i + 1}", "nothing") for i in range(len(joints))) if meant else maker.axes
    turning = [name for name, slides in zip(names, cell.prismatic, strict=False) if not slides]
    fit = len(set(names)) == len(joints) and set(names) <= {*maker.axes, *maker.further}
    if not (fit and set(maker.axes) <= set(turning)):
        expected = f"{', '.join(maker.axes)}, each for a joint that turns"
        if maker.further:
            example = f"columns: {{{maker.further[0]}: q1, {maker.axes[0]}: q2, ...}}"
            expected += f", and {maker.further[0]} ... for others, by a map with {example}"
        found = f"{', '.join(names)} for {', '.join(joints)}"
        raise InputError(place, "files.columns" if meant else "robot.joints", found, expected)
    units = tuple("mm" if slides else maker.angle for slides in cell.prismatic)
    for i, unit in enumerate(units):
        stated = of.unit(f"q{i + 1}")
        if stated is not None and stated.name != unit:
            raise RecordingError(place, f"files.units.q{i + 1}", stated.name, f"{unit}, as {maker.language} has it")
    factor = np.array([{"mm": 1e3, "rad": 1.0}.get(unit, 180.0 / math.pi) for unit in units])
    fastest = _given("--axis-speeds", arguments, names, "largest speed, deg/s or mm/s, of")
    pulses = _given("--pulses", arguments, names, "pulses per degree of")
    inverse = np.linalg.inv(_coupling(how, cell, maker, place))
    return _Axes(names, units, (factor * pulses)[:, None] * inverse, fastest * pulses)


def _given(option: str, arguments: argparse.Namespace, axes: Sequence[str], what: str) -> Float1D:
    """Return one number above zero for every axis; ones where the maker needs none.

    Raises:
        InputError: They are not that.
    """
    if arguments.maker not in NEEDED[option]:
        return np.ones(len(axes))
    text: str | None = vars(arguments)[option.strip("-").replace("-", "_")]
    expected, values = f"{len(axes)} numbers above zero: {what} {', '.join(axes)}", np.zeros(0)
    try:
        values = np.array(separate(text or "0"))
    except ValueError as fault:
        expected += str(fault)
    if len(values) != len(axes) or not (np.isfinite(values) & (values > 0.0)).all():
        raise InputError("pendant", option, "nothing" if text is None else quoted(text), expected)
    return values


def _coupling(how: ImportMap, cell: Cell, maker: Maker, place: Path) -> Float2D:
    """Return (n, n) what takes the angles that the controller counts to those of the chain.

    Raises:
        InputError: Cell file and map both state it, neither does where the maker's robots need it, or it is none.
    """
    stated = "joint_coupling" in how.model_fields_set
    if stated and cell.robot.joint_coupling:
        raise RecordingError(place, "joint_coupling", "a coupling, as in the cell file", "one of them")
    if maker.coupled and not (stated or cell.robot.joint_coupling):
        expected = (
            "how J3 counts: {joint_3: {joint_2: 1.0}} where J2 moves its display, as on most robots of this maker, "
            "or joint_coupling: {q3: {q2: 1.0}} in a map; 0.0 where it does not"
        )
        raise CellError(cell.path, "robot.joint_coupling", "nothing", expected)
    each = {f"q{i + 1}": row for i, row in enumerate(np.eye(len(cell.robot.joints)))}
    matrix = cell.robot.coupling @ np.stack(coupled(each, how, place, []))
    if not np.linalg.cond(matrix) <= MOST_CONDITION:
        raise RecordingError(place, "joint_coupling", "couplings that undo each other", "factors that do not")
    return matrix


# --- the stops --------------------------------------------------------------------------------------------------------


def _halts(items: Sequence[Item], cell: Cell, plan: Plan, axes: _Axes, maker: Maker) -> tuple[list[Halt], float]:
    """Return the stops of a program, and a bound on the speed of every monitored point between them, m/s.

    Raises:
        InputError: Even the slowest motion that can be stated is too fast.
    """
    limits = MotionLimits()
    if cell.safety is not None:
        limits = dataclasses.replace(limits, speed=min(limits.speed, cell.safety.speed_limit))
    monitored = Monitored.of(chain_of(cell), nominal_parameters(cell), tool_point(cell))
    q = np.stack([one.q for one in items])
    values = q @ axes.matrix.T
    anywhere = monitored.lever @ (np.abs(np.linalg.inv(axes.matrix)) @ axes.fastest)  # m/s, all axes at once
    share = limits.allowed / float(anywhere.max()) * (100.0 if maker.speed == "%" else 1.0)
    first = max(math.floor(share / maker.step) * maker.step, maker.step)
    order = lambda one: (*maker.axes, *maker.further).index(one[0])  # noqa: E731
    found, bound = [], 0.0
    for k, item in enumerate(items):
        speed = None if maker.speed == "s" else first
        if k:
            line = q[k] - q[k - 1]
            ends = np.stack([line, line])
            each = float(hermite_bound(monitored, np.array([0.0, 1.0]), q[k - 1 : k + 1], ends, REFINED[-1]).max())
            fast = float(np.min(limits.joint_speed)) / max(float(np.abs(line).max()), 1e-9)
            most = min(limits.allowed / max(each, 1e-9), fast)  # share of the way per s
            speed, pace = _speed(maker, np.abs(values[k] - values[k - 1]) / axes.fastest, most)
            if each * pace > limits.allowed * (1.0 + 1e-9):
                slowest = f"{1e3 * each * pace:.0f} mm/s on the way to configuration {item.number} at {speed:g} %"
                raise InputError("pendant", "--axis-speeds", slowest, f"{1e3 * limits.allowed:.0f} mm/s at most")
            bound = max(bound, each * pace)
        written = {
            axis: (f"{round(float(value), DIGITS[unit]) + 0.0:.{DIGITS[unit]}f}", unit)
            for axis, value, unit in sorted(zip(axes.names, values[k], axes.units, strict=True), key=order)
        }
        what, short = _described(item, plan)
        place = f"{k + 1} of {len(items)}"
        found.append(Halt(written, speed, f"stop {place}: {what}", f"{place.replace(' of ', '/')} {short}"[:24]))
    return found, bound


def _speed(maker: Maker, way: Float1D, most: float) -> tuple[float, float]:
    """Return the speed of a motion as the maker states it, and the largest share of its way per s that it comes to.

    Args:
        maker: The maker.
        way: (n,) of every axis, over its largest speed where the maker states shares of that; not negative.
        most: Largest share of the way per s that is allowed.
    """
    if maker.speed == "s":
        seconds = max(math.ceil(MOTION_PEAK / most / maker.step) * maker.step, maker.step)
        return seconds, MOTION_PEAK / seconds
    fastest = float(way.max()) * (100.0 if maker.speed == "%" else 1.0)  # where the whole way takes 1 s
    stated = min(max(math.floor(most * fastest / maker.step) * maker.step, maker.step), 100.0)
    return stated, stated / fastest if fastest else 0.0


def _described(item: Item, plan: Plan) -> tuple[str, str]:
    """Return what is done at a stop, long and short."""
    if item.kind == "startup":
        return "start-up cycle, no reading", "START-UP"
    loaded = int(np.any(item.steps != 0.0, axis=1).sum())
    what = f"{counted(len(item.steps), 'reading')}, {f'{loaded} of them loaded' if loaded else 'unloaded'}"
    if item.kind == "reference":
        return f"reference, {what}", "REFERENCE"
    phase = f" ({item.phase})" if plan.preparation else ""
    return f"configuration {item.number}{phase}, {what}", f"C{item.number} {'LOADED' if loaded else 'UNLOADED'}"


# --- what is said -----------------------------------------------------------------------------------------------------


def _remarks(cell: Cell, digest: Mapping[str, str], fastest: str) -> list[str]:
    """Return what stands at the beginning of a program."""
    ((file, sha256),) = digest.items()
    mass = "" if cell.end_effector is None else f", by the cell file {cell.end_effector.mass:g} kg"
    lines = (
        f"calibration pendant {__version__}",
        f"cell {cell.name}, robot {cell.robot.name}",
        f"plan {file}, sha256",
        sha256,
        "MANUAL REDUCED SPEED ONLY, hold-to-run, nobody else in the cell.",
        "Start when the sequencer asks for the next posture and the load is off.",
        f"Payload: set what the flange carries{mass}. Tool and base frames do not matter.",
        "The first motion begins wherever the robot stands: jog near the first stop before.",
        f"From stop to stop, in this order, every monitored point: {fastest}.",
    )
    return [plain(line) for line in lines]


def _notes(plan: Plan, maker: Maker, *, counted_otherwise: bool) -> list[str]:
    """Return what the operator must know besides."""
    notes = [
        "manual reduced speed only: nothing but the hand on the enabling device stops the robot",
        "before the first start: jog near the first stop, set the payload, and compare the display with /joint_states",
    ]
    if counted_otherwise:
        notes.append("coupled joints are written as the controller counts them, not as the robot file does")
    if maker.speed == "%":
        notes.append("the speeds rest on --axis-speeds: compare them with the data sheet of this robot")
    unclear = 0 if plan.expected is None else plan.expected.unclear_moves
    if unclear:
        notes.append(f"{counted(unclear, 'motion')} of the plan cannot be proven clear of collisions")
    return notes
