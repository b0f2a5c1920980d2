"""A simulated plant: robots of six types measured at several dates, some of them damaged in known ways.

All of a robot's randomness comes from the seed of the plant and its number, so that any part of a plant is the same
wherever it is made.  What is hidden stands in `truth.json`, apart from what a fleet reads.
"""

from __future__ import annotations

import csv
import dataclasses
import json
import sys
from collections.abc import Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor
from pathlib import Path
from typing import Any

import numpy as np

from calibration_core.files.yaml_file import read_yaml, yaml_text
from calibration_core.recording.tables.table import write_table
from calibration_core.timeseries import Float1D
from calibration_sim.cell.truth import Spread, Truth, draw_truth
from calibration_sim.effects.draw import FIRST_AXIS, MAGNITUDES, robot_cell
from calibration_sim.effects.effect import Effect, Label
from calibration_sim.effects.joints import dead_zone, spring
from calibration_sim.effects.structure import Base
from calibration_sim.scenarios.measure import Noise, lagging_sensor, look
from calibration_sim.scenarios.protocols import make_protocol, points_of
from calibration_sim.scenarios.world import World, play

TYPES = ("tiny", "light", "column", "middle", "heavy", "giant")
DAYS = ("2026-01-12", "2026-07-13", "2027-01-11", "2027-07-12", "2028-01-10", "2028-07-10")
DAMAGES = ("softer_joint", "growing_backlash", "soft_base", "exchanged_reducer")
HEALTHY = "healthy"
DAMAGED, BROKEN, WRONG_CELL = 0.04, 0.01, 0.005  # shares of robots; of recordings
CONFIGURATIONS = (15, 18, 21)  # of the plans
SOFTER, CLEARANCE, EXCHANGE = -0.15, 1e-4, 0.05  # relative; rad a date; relative
BASE = 1e7  # N*m/rad
# Between sisters, and what registration leaves of frames and points; the stiffness is drawn here, joint by joint.
SETTING_UP = Spread(
    stiffness=0.0,
    joint_zero=5e-5,
    joint_shift=1.7e-4,
    tracker_shift=2e-3,
    tracker_turn=1e-4,
    sensor_turn=5e-4,
    point=2e-4,
)
PRECISE = slice(0, 1)  # joints at which a reducer is exchanged: where a measurement tells 5 percent
STRONG = ("heavy", "giant")  # robots whose loads move a base of 1e7 N*m/rad
MANIFEST, TRUTH = "plant.csv", "truth.json"


@dataclasses.dataclass(frozen=True)
class PlantRobot:
    """One robot.

    Attributes:
        number: In the plant, from 0.
        type: One of `TYPES`.
        damage: One of `DAMAGES`, or `healthy`.
        joint: Index of the damaged joint in the order of q.
        since: Index of the date from which the damage is there.
        size: Of the damage: relative change of the stiffness, rad a date, or rad/(N*m).
    """

    number: int
    type: str
    damage: str
    joint: int
    since: int
    size: float

    @property
    def name(self) -> str:
        """As in the manifest."""
        return f"r{self.number + 1:04d}"


@dataclasses.dataclass(frozen=True)
class PlantRecording:
    """One recording to be made.

    Attributes:
        seed: Of the plant.
        robot: Which robot.
        date: Index of the date.
        spread: Standard deviation of the logarithm of each stiffness between sisters.
        fault: `broken`, `wrong_cell`, or empty.
    """

    seed: int
    robot: PlantRobot
    date: int
    spread: float
    fault: str

    @property
    def folder(self) -> Path:
        """Within the plant's folder: TYPE/ROBOT/DATE."""
        return Path(self.robot.type) / self.robot.name / DAYS[self.date]


def plant(seed: int, robots: int, dates: int, spread: float) -> tuple[PlantRecording, ...]:
    """Return every recording of a plant.

    Args:
        seed: Of everything.
        robots: How many, the types taking turns.
        dates: How many, half a year apart; at most six.
        spread: Standard deviation of the logarithm of each stiffness between sisters.
    """
    rng = _generator(seed, 0)
    damaged: dict[int, str] = {}
    order = [int(number) for number in rng.permutation(robots)]
    for k in range(round(DAMAGED * robots)):
        damage = DAMAGES[k % len(DAMAGES)]
        free = [n for n in order if n not in damaged and (damage != "soft_base" or TYPES[n % len(TYPES)] in STRONG)]
        damaged[free[0]] = damage
    made = [_robot(seed, number, damaged.get(number, HEALTHY), dates) for number in range(robots)]
    recordings = [(robot, date) for robot in made for date in range(dates)]
    faults = rng.random(len(recordings))
    return tuple(
        PlantRecording(seed, robot, date, spread, _fault(robot, float(draw)))
        for (robot, date), draw in zip(recordings, faults, strict=True)
    )


def _robot(seed: int, number: int, damage: str, dates: int) -> PlantRobot:
    kind = TYPES[number % len(TYPES)]
    if damage == HEALTHY:
        return PlantRobot(number, kind, HEALTHY, 0, 0, 0.0)
    rng = _generator(seed, 1, number)
    first = FIRST_AXIS.get(kind, 0)
    joints = np.arange(first, len(robot_cell(kind).robot.joints))
    joint = int(rng.choice(joints[PRECISE] if damage == "exchanged_reducer" else joints[:5]))
    since = int(rng.integers(1, dates)) if dates > 1 else 0
    since = min(since, 1) if damage == "growing_backlash" else since  # it has grown by the last date
    sizes = {
        "softer_joint": SOFTER,
        "growing_backlash": CLEARANCE,
        "soft_base": 1 / BASE,
        "exchanged_reducer": EXCHANGE * float(rng.choice([-1.0, 1.0])),
    }
    return PlantRobot(number, kind, damage, joint, since, sizes[damage])


def _fault(robot: PlantRobot, draw: float) -> str:
    if robot.damage != HEALTHY:
        return ""
    return "broken" if draw < BROKEN else "wrong_cell" if draw < BROKEN + WRONG_CELL else ""


def true_stiffness(recording: PlantRecording) -> Float1D:
    """Return the (n,) stiffnesses of the robot's joints at the date, N*m/rad (N/m where a joint slides)."""
    robot = recording.robot
    nominal = np.array(robot_cell(robot.type).robot.stiffness, dtype=np.float64)
    rng = _generator(recording.seed, 2, robot.number)
    stiffness = nominal * np.exp(recording.spread * rng.standard_normal(len(nominal)))
    if robot.damage in {"softer_joint", "exchanged_reducer"} and recording.date >= robot.since:
        stiffness[robot.joint] *= 1 + robot.size
    return np.asarray(stiffness)


def _effects(recording: PlantRecording) -> Iterator[Effect]:
    """Yield what is wrong with the robot at the date, besides its stiffnesses."""
    robot = recording.robot
    age = recording.date - robot.since + 1
    if age < 1:
        return
    joint = robot_cell(robot.type).robot.joints[robot.joint]
    if robot.damage == "growing_backlash":
        clearance = age * robot.size
        size = MAGNITUDES[robot.type]
        torque = size.clearance_torque * size.rated_torque[robot.joint - FIRST_AXIS.get(robot.type, 0)]
        label = Label("joint law", "backlash", {"joint": joint}, parameters={"clearance": clearance})
        yield spring(label, robot.joint, dead_zone(clearance, torque))
    if robot.damage == "soft_base":
        label = Label("structure", "base_compliance", {"base": "base"}, parameters={"rotation": robot.size})
        yield Base(label, (robot.size, robot.size, robot.size), (0.0, 0.0, 0.0))


def write_plant(recordings: Sequence[PlantRecording], out: Path, jobs: int) -> Path:
    """Write recordings, cell files, the manifest and what is hidden; return the manifest.

    Args:
        recordings: Of the plant, or a part of it.
        out: Folder; made if it is missing.
        jobs: Processes.
    """
    out.mkdir(parents=True, exist_ok=True)
    tasks = [(recording, out) for recording in recordings]
    if jobs == 1:
        truths = [_write(task) for task in tasks]
    else:
        with ProcessPoolExecutor(jobs) as pool:
            truths = list(pool.map(_write, tasks, chunksize=8))
    manifest = out / MANIFEST
    with manifest.open("w", encoding="utf-8", newline="") as stream:
        writer = csv.writer(stream, lineterminator="\n")
        writer.writerow(("recording", "cell", "robot", "type", "date"))
        for one in recordings:
            table, cell = one.folder / "measurements.csv", one.folder / "cell.yaml"
            writer.writerow((table, cell, one.robot.name, one.robot.type, DAYS[one.date]))
    (out / TRUTH).write_text(json.dumps(truths, indent=1) + "\n", encoding="utf-8")
    return manifest


def _write(task: tuple[PlantRecording, Path]) -> dict[str, Any]:
    """Make one recording; return what is hidden in it."""
    recording, out = task
    robot, folder = recording.robot, out / recording.folder
    folder.mkdir(parents=True, exist_ok=True)
    cell = robot_cell(robot.type)
    number = _generator(recording.seed, 3, robot.number, recording.date)
    plan, noise, setting_up = (int(number.integers(2**31)) for _ in range(3))
    stiffness = true_stiffness(recording)
    truth: Truth = dataclasses.replace(draw_truth(cell, setting_up, spread=SETTING_UP), stiffness=stiffness)
    world = World(cell, truth, (lagging_sensor(cell), *_effects(recording)))
    kind = f"L{CONFIGURATIONS[plan % len(CONFIGURATIONS)]}"
    protocol = make_protocol(cell, kind, plan)
    factor = float(np.exp(number.uniform(np.log(0.85), np.log(1.15))))
    readings = look(world, play(world, protocol), points_of(cell, kind), Noise(factor=factor), noise)
    table = folder / "measurements.csv"
    write_table(table, readings)
    if recording.fault == "broken":
        content = table.read_bytes()
        table.write_bytes(content[: len(content) // 3] + b"\n,,,nonsense\n")
    described = robot.type if recording.fault != "wrong_cell" else TYPES[(TYPES.index(robot.type) + 3) % len(TYPES)]
    file = read_yaml(robot_cell(described).path, 1 << 18, "cell file (YAML)").data
    (folder / "cell.yaml").write_text(yaml_text(file), encoding="utf-8")
    return {
        **dataclasses.asdict(robot), "robot": robot.name, "date": DAYS[recording.date], "fault": recording.fault,
        "recording": str(recording.folder / "measurements.csv"), "stiffness": stiffness.tolist(),
    }  # fmt: skip


def _generator(seed: int, *key: int) -> np.random.Generator:
    return np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(31, *key)))


if __name__ == "__main__":  # OUT ROBOTS DATES SEED
    robots, dates, seed = map(int, sys.argv[2:])
    sys.stdout.write(f"{write_plant(plant(seed, robots, dates, 0.03), Path(sys.argv[1]), 2)}\n")
