"""`calibration init`: a commented cell file for a robot that one has the URDF, a bag or the name of."""

from __future__ import annotations

import argparse
import contextlib
import shutil
import sys
import tempfile
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any, TypeVar
from xml.etree import ElementTree as ET

from calibration_core.cell import load_cell
from calibration_core.cell.library import library_robot
from calibration_core.cell.schema import cell_schema_text
from calibration_core.cell.serial_chain import SerialChain, serial_chain
from calibration_core.cell.urdf import MAX_BYTES
from calibration_core.commands.files.cell_text import SCHEMA_NAME, URDF_NAME, Answers, cell_text, guessed
from calibration_core.commands.files.init_arguments import numbers, point, points
from calibration_core.commands.shared.common import typed
from calibration_core.errors import InputError, OutputError, RecordingError, shown_path
from calibration_core.files.regular import read_regular
from calibration_core.files.written import json_bytes
from calibration_core.model.robot import chain_of
from calibration_core.model.urdf.reading import MESHES, SHOWN, mesh_file, mesh_place
from calibration_core.outcomes.inputs import digest_of
from calibration_core.recording.bags.bag import read_contents
from calibration_core.recording.bags.files import bag_files
from calibration_core.recording.source import BAG_SUFFIXES, storage_suffix
from calibration_core.report.results.provenance import software
from calibration_core.report.results.result import SCHEMA
from calibration_core.report.rounding import counted
from calibration_core.report.writing.output import RESULT, Content, write_files

CELL_NAME = "cell.yaml"
TOPIC = "/robot_description"
OPTIONS = {
    "name": "--name",
    "robot.rated_load": "--rated-load",
    "frames.tracker": "--tracker",
    "frames.force_torque": "--sensor",
    "frames.wrench_point": "--wrench-point",
    "frames.measurement_points": "--point",
    "instruments.tracker": "--tracker-sigma",
    "instruments.force_torque.sigma_force": "--force-sigma",
    "instruments.force_torque.sigma_torque": "--torque-sigma",
}
"""Place in the cell file -> the option that states it."""
Value = TypeVar("Value")


def run(arguments: argparse.Namespace) -> str:
    """Find the robot, ask what is not stated where somebody is there to answer, write the cell file, and say what next.

    Raises:
        InputError: The robot is not to be found or cannot be used, the rated load is not known, or a cell file stands
            there already.
    """
    target: Path = arguments.out / CELL_NAME
    if target.exists():
        raise OutputError(target, "", "a cell file of before", "another --out: what was edited is not overwritten")
    with tempfile.TemporaryDirectory(prefix="calibration-init-") as folder:
        urdf = Path(folder) / URDF_NAME
        origin, answers = _robot(arguments, urdf)
        with _naming(Path(folder), origin if answers is None else arguments.robot):
            chain = serial_chain(urdf, arguments.base_link, arguments.flange)
            asked = _asked(arguments, answers or _stated(arguments, origin, chain))
            text, joints = _tested(Path(folder), asked, chain)
        meshes, missing = _meshes(urdf, Path(arguments.robot), arguments.meshes)
        files: dict[str, Content] = {
            CELL_NAME: text.encode(),
            URDF_NAME: urdf.read_bytes(),
            SCHEMA_NAME: cell_schema_text().encode(),
        }
        if meshes:
            files[MESHES] = lambda folder: _copied(folder, meshes)
        remarks = [*chain.remarks, *missing]
        result = {
            "schema": SCHEMA,
            "command": "init",
            "robot": asked.robot,
            "cell": str(target),
            "joints": list(joints),
            "rated_load": asked.rated_load,
            "guessed": list(guessed(asked)),
            "remarks": remarks,
            "sha256": [{"role": "urdf", "file": n, "sha256": d} for n, d in digest_of(urdf).items()],
            "software": software(),
        }
    lines = [f"Robot: {asked.robot}, {len(joints)} joints, {asked.rated_load:g} kg", f"Source: {asked.source}"]
    if guessed(asked):
        lines.append("Usual values, to be measured: " + ", ".join(guessed(asked)))
    lines += [f"Meshes: {counted(len(meshes), 'file')}, copied beside the URDF"] if meshes else []
    lines += [*remarks, f"cell file: {target}", f"next: {typed('check', target)}"]
    write_files(arguments.out, {**files, RESULT: json_bytes({**result, "summary": lines})})
    return "\n".join(lines)


def _meshes(urdf: Path, robot: Path, given: Path | None) -> tuple[dict[Path, Path], list[str]]:
    """Return the meshes that a URDF names, place in a folder of them -> file, and a sentence on those not found.

    They are looked for in the folder that is given, where the URDF or bag lay, and where ROS looks.
    """
    names = sorted({str(mesh.get("filename")) for mesh in ET.fromstring(urdf.read_bytes()).iter("mesh")})
    found = {name: mesh_file(robot.absolute(), name, () if given is None else (given.absolute(),)) for name in names}
    lost = [name for name, path in found.items() if path is None]
    files = {mesh_place(name): path for name, path in found.items() if path is not None}
    if not lost:
        return files, []
    shown = ", ".join(lost[:SHOWN]) + (", ..." if len(lost) > SHOWN else "")
    text = f"Meshes: {len(lost)} of {len(names)} not found ({shown}). Planning takes capsules along the links instead."
    return files, [f"{text} To have them, set ROS_PACKAGE_PATH or AMENT_PREFIX_PATH, or give --meshes FOLDER."]


def _copied(folder: Path, meshes: dict[Path, Path]) -> None:
    for place, path in meshes.items():
        (folder / place).parent.mkdir(parents=True, exist_ok=True)
        shutil.copyfile(path, folder / place)


def _robot(arguments: argparse.Namespace, urdf: Path) -> tuple[str, Answers | None]:
    """Write the robot's URDF to a place; return where it comes from, and what the library knows of it."""
    robot = Path(arguments.robot)
    if robot.suffix.lower() in {".urdf", ".xacro", ".xml"}:
        urdf.write_bytes(read_regular(robot, MAX_BYTES, "URDF"))
        if robot.suffix.lower() == ".xacro":
            serial_chain(robot)  # says what to do
        return str(robot), None
    if robot.is_dir() or storage_suffix(robot) in BAG_SUFFIXES:
        contents = read_contents(bag_files(robot), {}, text_topic=TOPIC)
        if not contents.text:
            found = f"no message on {TOPIC}"
            raise RecordingError(robot, "", found, "a bag that holds the robot's URDF there; or give the URDF itself")
        urdf.write_text(contents.text, encoding="utf-8")
        return f"{TOPIC} of {shown_path(robot)}", None
    known = library_robot(arguments.robot)
    urdf.write_bytes(known.urdf.read_bytes())
    name = f"{known.maker} {known.name}"
    stated = _options(arguments)
    load = known.rated_load if arguments.rated_load is None else arguments.rated_load
    return known.source, Answers(_name(arguments, f"the {known.name}"), name, known.source, load, **stated)


@contextlib.contextmanager
def _naming(folder: Path, origin: str) -> Iterator[None]:
    """Let errors about files in a folder that nobody will see name the option at fault, or where the robot is from."""
    try:
        yield
    except InputError as error:
        if not Path(error.file).is_relative_to(folder):
            raise
        option = next((name for place, name in OPTIONS.items() if f"{error.place}.".startswith(f"{place}.")), None)
        if option is not None:
            raise InputError(option, "", error.found, error.expected) from None
        raise InputError(origin, error.place, error.found, error.expected) from None


def _stated(arguments: argparse.Namespace, origin: str, chain: SerialChain) -> Answers:
    load = arguments.rated_load
    if load is None:
        load = _question(arguments, "Rated load of the robot in kg", None, float)
    if load is None:
        raise InputError(origin, "rated load", "nothing (a URDF does not state it)", "--rated-load KG")
    name = chain.name or Path(arguments.robot).stem
    return Answers(_name(arguments, name), name, origin, load, **_options(arguments))


def _name(arguments: argparse.Namespace, robot: str) -> str:
    return f"cell of {robot}" if arguments.name is None else str(arguments.name)


def _options(arguments: argparse.Namespace) -> dict[str, Any]:
    return {
        "tracker": arguments.tracker,
        "sensor": arguments.sensor,
        "wrench_point": arguments.wrench_point,
        "points": _stated_points(arguments.point),
        "tracker_sigma": arguments.tracker_sigma,
        "force_sigma": arguments.force_sigma,
        "torque_sigma": arguments.torque_sigma,
    }


def _stated_points(given: list[tuple[str, tuple[float, ...]]] | None) -> dict[str, tuple[float, ...]] | None:
    try:
        return None if given is None else points(given)
    except ValueError as error:
        raise InputError("--point", "", str(error), "every target once") from None


def _asked(arguments: argparse.Namespace, answers: Answers) -> Answers:
    """Ask for what is not known, where somebody is there to answer; an empty line leaves the usual value."""
    questions = {
        "tracker": "Tracker in the base frame: x y z in m, roll pitch yaw in rad",
        "sensor": "Force/torque sensor in the flange frame: x y z in m, roll pitch yaw in rad",
        "wrench_point": "Point where the load pulls, in the flange frame: x y z in m",
    }
    values = {name: getattr(answers, name) for name in Answers.__dataclass_fields__}
    for name, question in questions.items():
        if values[name] is None:
            values[name] = _question(arguments, question, None, lambda text: numbers(text.split()))
    if values["points"] is None:
        asked = _question(arguments, "Targets in the flange frame: NAME=x,y,z NAME=x,y,z ... in m", None, _points)
        values["points"] = asked
    return Answers(**values)


def _question(
    arguments: argparse.Namespace, text: str, default: Value | None, convert: Callable[[str], Value]
) -> Value | None:
    if arguments.no_questions or not (sys.stdin and sys.stdin.isatty() and sys.stderr and sys.stderr.isatty()):
        return default
    while True:
        print(f"{text} (empty: {'not known' if default is None else default}): ", end="", file=sys.stderr, flush=True)
        answer = sys.stdin.readline().strip()
        if not answer:
            return default
        try:
            return convert(answer)
        except (ValueError, argparse.ArgumentTypeError) as error:
            print(f"  {error}", file=sys.stderr)


def _points(text: str) -> dict[str, tuple[float, ...]]:
    return points([point(word) for word in text.split()])


def _tested(folder: Path, answers: Answers, chain: SerialChain) -> tuple[str, tuple[str, ...]]:
    """Return the text of a cell file that can be read, with the joints' names."""
    path = folder / CELL_NAME
    path.write_text(cell_text(answers, chain, 1.0), encoding="utf-8")
    reach = chain_of(load_cell(path)).reach
    text = cell_text(answers, chain, reach)
    path.write_text(text, encoding="utf-8")
    cell = load_cell(path)
    chain_of(cell)
    return text, cell.robot.joints
