"""A cell file, and a recording that is to be read with it: all errors, and what is unusual."""

from __future__ import annotations

import dataclasses
from pathlib import Path

import numpy as np

from calibration_core.cell import MAX_BYTES, Cell, load_cell
from calibration_core.cell.urdf import urdf_bytes
from calibration_core.errors import CellError, InputError
from calibration_core.files.yaml_file import YamlFile, read_yaml
from calibration_core.input_checks.cell_file import GUESS, Remark, implausible
from calibration_core.input_checks.check import check_inputs
from calibration_core.model.chain import Chain
from calibration_core.model.kinematics import posture
from calibration_core.model.robot import chain_of
from calibration_core.model.urdf.reading import lost_meshes, urdf_shapes
from calibration_core.observations.observe import observe
from calibration_core.recording.bags.bag import Contents, read_contents
from calibration_core.recording.bags.files import bag_files
from calibration_core.recording.messages.kinds import Samples, StreamKind
from calibration_core.recording.source import recording_kind
from calibration_core.report.rounding import counted


@dataclasses.dataclass(frozen=True, eq=False)
class CheckedCell:
    """What was found out about a cell file, and about a recording beside it.

    Attributes:
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
    """Look at a cell file, and at a recording if there is one; return what was found out, and every error."""
    try:
        cell = load_cell(path)
    except CellError as error:
        return None, [error, *error.further, *_urdf_faults(path)]
    try:
        chain = chain_of(cell)
        missing = lost_meshes(urdf_shapes(cell)[1])
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
    if missing:
        unusual += (Remark("robot.urdf", missing, "all its meshes", impossible=False),)
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


COUNTS = ("no", "one", "two", "three", "four", "five", "six", "seven", "eight", "nine", "ten")


def meaning(cell: Cell, chain: Chain) -> list[tuple[str, str]]:
    """Return label and sentence of everything that the file states."""
    rows = [("Robot", _robot(cell, chain)), ("Flange at zero", _flange(chain))]
    frames, instruments, measured = cell.frames, cell.instruments, cell.measurements
    rows.append(("Stiffness", "stated for every joint" if cell.robot.stiffness else "not stated: found by identify"))
    rows.append(("Masses", _masses(cell, chain)))
    if frames.tracker is None:
        rows.append(("Tracker", "its place is not stated: it is found from the recording; planning needs it"))
    else:
        x, y, z = frames.tracker.xyz
        away = float(np.linalg.norm(frames.tracker.xyz))
        rows.append(("Tracker", f"{away:.3g} m from the base, at x {x:.3g} m, y {y:.3g} m, z {z:.3g} m"))
    rows.append(("Tracker's reading", _tracker(cell)))
    names = [f"{name} ({1e3 * float(np.linalg.norm(at)):.0f} mm)" for name, at in frames.measurement_points.items()]
    rows.append(("Targets, from the flange", ", ".join(names)))
    if frames.wrench_point is not None:
        rows.append(
            ("Load", f"pulls {1e3 * float(np.linalg.norm(frames.wrench_point)):.0f} mm from the flange's origin")
        )
    if instruments.force_torque is not None:
        sensor = instruments.force_torque
        rows.append(("Force/torque sensor", f"reads to {sensor.sigma_force:g} N and {sensor.sigma_torque:g} N·m (1 σ)"))
    axes = "base" if measured.wrench_axes == "base" else "the sensor's"
    about = "the wrench point" if measured.wrench_at == "wrench_point" else "the sensor's origin"
    rows.append(("Wrenches", f"in {axes} axes, about {about}: what the environment does to the robot"))
    kind = "positions in the tracker's frame" if measured.points == "absolute" else "differences to the unloaded step"
    rows.append(("Readings", kind))
    if cell.boxes:
        rows.append(("Boxes", ", ".join(box.name for box in cell.boxes)))
    return rows


def _robot(cell: Cell, chain: Chain) -> str:
    turning, sliding = len(chain.revolute), chain.n - len(chain.revolute)
    kinds = [f"{_count(turning)} turning" if turning else "", f"{_count(sliding)} sliding" if sliding else ""]
    joints = f"{' and '.join(kind for kind in kinds if kind)} joints"
    if chain.mimics:
        verb = "mimic others" if chain.mimics[1:] else "mimics another"
        joints += f" and {_count(len(chain.mimics))} more that {verb}"
    source = "URDF" if cell.robot.dh is None else "DH rows"
    size = f"{chain.reach:.3g} m long, rated load {cell.robot.rated_load:g} kg"
    return f"{cell.robot.name}: {joints} ({source}), {size}"


def _flange(chain: Chain) -> str:
    at = posture(chain, np.zeros((1, chain.n)))
    x, y, z = at.flange_origin[:, 0]
    axis = at.flange[2][:, 0]
    towards = "xyz"[int(np.argmax(np.abs(axis)))]
    sign = "+" if axis[int(np.argmax(np.abs(axis)))] > 0 else "-"
    return f"x {x:z.3f} m, y {y:z.3f} m, z {z:z.3f} m in the base frame; its z axis points along {sign}{towards}"


def _masses(cell: Cell, chain: Chain) -> str:
    mass = chain.whole.mass
    if mass is None:
        return "not stated: the sag of the links under their own weight is not predicted"
    known = "" if cell.robot.inertials_known else ", declared as guesses"
    return f"{float(mass.sum()):.4g} kg in {counted(int(np.count_nonzero(mass)), 'moving link')}{known}"


def _tracker(cell: Cell) -> str:
    tracker = cell.instruments.tracker
    if tracker.sigma is not None:
        return f"to {1e6 * tracker.sigma:.3g} µm for each coordinate (1 σ)"
    along, angle = 1e6 * (tracker.sigma_range or 0.0), 1e6 * (tracker.sigma_angle or 0.0)
    more = 1e6 * tracker.sigma_range_per_m
    return f"to {along:.3g} µm and {more:.2g} µm/m along the beam, {angle:.3g} µrad across (1 σ)"


def _count(number: int) -> str:
    return COUNTS[number] if number < len(COUNTS) else str(number)


LATE = 1.0  # s between a stamp and its receipt, or between the clocks of two topics, that is worth a remark


@dataclasses.dataclass(frozen=True)
class TopicMatch:
    """One stream of a recording.

    Attributes:
        role: What the cell file wants there.
        topic: Its name.
        state: `read`, `optional` (not there, and not needed), `missing` or `unusable`.
        text: How much is there, or what is wrong and how it is mended.
    """

    role: str
    topic: str
    state: str
    text: str


def match_bag(path: Path, cell: Cell) -> tuple[TopicMatch, ...]:
    """Return how the topics of a bag answer to those that a cell file names.

    Raises:
        RecordingError: The bag cannot be read at all.
    """
    topics = cell.topics
    roles: list[tuple[str, str, StreamKind, bool]] = [("joint states", topics.joint_states, StreamKind.JOINTS, True)]
    roles += [(f"target {name}", topics.point(name), StreamKind.POINT, True) for name in cell.points]
    roles += [
        ("wrench", topics.wrench, StreamKind.WRENCH, False),
        ("temperature", topics.temperature, StreamKind.TEMPERATURE, False),
    ]
    types = read_contents(bag_files(path), {}).topics
    wanted = {topic: kind for _, topic, kind, _ in roles if types.get(topic) == kind.value}
    contents = read_contents(bag_files(path), wanted, cell.robot.joints)
    taken = {topic for _, topic, _, _ in roles}
    found = [_match(contents, taken, role, topic, kind, needed) for role, topic, kind, needed in roles]
    marked = topics.step in types
    text = "step markers" if marked else "none: plateaus are found from standstill and wrench"
    return (*found, TopicMatch("steps", topics.step, "read" if marked else "optional", text))


def _match(contents: Contents, taken: set[str], role: str, topic: str, kind: StreamKind, needed: bool) -> TopicMatch:
    type_name = contents.topics.get(topic)
    if type_name != kind.value:
        others = [name for name, what in contents.topics.items() if what == kind.value and name not in taken]
        wrong = "not in the recording" if type_name is None else f"carries {type_name} instead of {kind.value}"
        hint = (
            f"; of that type there: {', '.join(others[:6])} (topics: {{{topic}: ...}} in the cell file)"
            if others
            else ""
        )
        lost = needed or (others and kind is StreamKind.WRENCH)  # without loads another question is answered
        return TopicMatch(role, topic, "missing" if lost else "optional", wrong + hint)
    samples = contents.streams.get(topic)  # none where a topic was declared and never written
    if samples is None:
        return TopicMatch(role, topic, "missing" if needed else "optional", "holds no message")
    if samples.unusable and not len(samples.stamp):
        names = ", ".join(samples.example)
        text = f"names {names}; the cell file has other joints: write these names in robot.joints"
        return TopicMatch(role, topic, "unusable", text)
    if not len(samples.stamp):
        return TopicMatch(role, topic, "missing" if needed else "optional", "holds no message that can be read")
    return TopicMatch(role, topic, "read", _extent(samples))


def _extent(samples: Samples) -> str:
    stamped = samples.stamp > 0
    text = f"{len(samples.stamp):,} messages over {(samples.received[-1] - samples.received[0]) / 1e9:.0f} s"
    if not stamped.all():
        return f"{text}; without stamps: the time of receipt counts"
    late = float(np.median(samples.received - samples.stamp)) / 1e9
    return f"{text}; its clock is {late:+.3g} s off the recorder's" if abs(late) > LATE else text
