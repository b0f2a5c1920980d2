"""Whether what a cell file states can be: a tracker at 4,000 m, targets in millimetres.

Each rule has two limits: beyond the first a value is doubtful and said so, beyond the second it cannot be.  What cannot
be whatever the recording, such as angles in degrees, no reader of a cell file accepts (`calibration_core.cell`).
"""

from __future__ import annotations

import dataclasses
import itertools
import math
from collections.abc import Iterator

import numpy as np

from calibration_core.cell import Cell
from calibration_core.model.chain import Chain

STANDARD_GRAVITY = 9.80665
FARTHEST_TRACKER = (40.0, 400.0)  # m; makers state 40 to 320 m for laser trackers
LONGEST_REACH = (5.0, 30.0)  # m; the largest robots reach 4.7 m
FARTHEST_TARGET = (1.5, 10.0)  # m from the flange
LONGEST_RAIL = (100.0, 500.0)  # m from its zero; the longest linear units
LONGEST_SLIDE = (10.0, 100.0)  # m; a joint that slides on an arm
HEAVIEST_LINK = 2000.0  # kg; links of robots for 1,000 kg and more weigh up to 1,500 kg
HEAVIEST_SHARE = 100.0  # times the rated load: whole robots for light loads with long arms weigh up to 70 times
USUAL_STIFFNESS = (1e3, 1e8)  # N*m/rad; physics of joints from desktop arms to 1,000 kg robots
WORST_TRACKER = (1e-3, 2e-2)  # m, one standard deviation
SHARE_OF_LOAD = (0.02, 0.5)  # standard deviation of the force as a share of the rated load


GUESS = "TO BE MEASURED"  # in the comment behind a usual value that `init` wrote


@dataclasses.dataclass(frozen=True)
class Remark:
    """What is hard to believe in a cell file.

    Attributes:
        place: Field, e.g. `frames.tracker.xyz`.
        found: What stands there, in words.
        expected: What would be usual, with the likely cause.
        impossible: Whether it cannot be, and not only is unusual.
    """

    place: str
    found: str
    expected: str
    impossible: bool


def implausible(cell: Cell, chain: Chain) -> tuple[Remark, ...]:
    """Return what is hard to believe in a cell file, in its order; empty where nothing is."""
    return (*_robot(cell, chain), *_frames(cell, chain), *_instruments(cell))


def _robot(cell: Cell, chain: Chain) -> Iterator[Remark]:
    robot = cell.robot
    yield from _beyond("robot", "a reach", chain.reach, LONGEST_REACH, "metres: are the lengths in millimetres?")
    if chain.reach < 0.15:
        found = f"a reach of {chain.reach:.3g} m"
        yield Remark("robot", found, "the robot's lengths in metres; base_link and flange at its two ends", True)
    for i, stiffness in enumerate(robot.stiffness or ()):
        if not chain.prismatic[i] and not USUAL_STIFFNESS[0] <= stiffness <= USUAL_STIFFNESS[1] < math.inf:
            if stiffness == math.inf:
                continue
            found = f"{stiffness:.3g} N·m/rad for {robot.joints[i]}"
            yield Remark(f"robot.stiffness.{i}", found, "1e3 to 1e8 N·m/rad: not N·m per degree or a compliance", False)
    yield from _travels(cell, chain)
    gravity = float(np.linalg.norm(robot.gravity))
    if abs(gravity - STANDARD_GRAVITY) > 0.1:
        found = f"an acceleration of {gravity:.4g} m/s²"
        yield Remark("robot.gravity", found, "9.76 to 9.84 m/s², as on Earth", False)
    whole = chain.whole
    if whole.mass is not None and whole.com is not None:
        moving = float(whole.mass.sum())
        if moving < 0.5 * robot.rated_load:
            found = f"links of {moving:.3g} kg in all, for a rated load of {robot.rated_load:g} kg"
            yield Remark("robot", found, "a robot several times as heavy as its load: are masses or load in kg?", False)
        yield from _heavy(cell, whole)
        far = float(np.linalg.norm(whole.com, axis=1).max())
        if far > 2.0 * chain.reach:
            yield Remark("robot.inertials", f"a centre of gravity {far:.3g} m from its joint", "metres", True)


def _travels(cell: Cell, chain: Chain) -> Iterator[Remark]:
    for i, name in enumerate(chain.joints):
        if chain.prismatic[i]:
            place = "robot.urdf" if cell.robot.joint_limits is None else f"robot.joint_limits.{i}"
            limits = LONGEST_RAIL if chain.stage(i) < chain.rails else LONGEST_SLIDE
            expected = "a travel in metres: are the limits in millimetres?"
            yield from _beyond(place, f"a travel of {name} up to", float(chain.travel[i]), limits, expected)


def _heavy(cell: Cell, whole: Chain) -> Iterator[Remark]:
    """Name links that are heavier than those of any robot, or on an arm than its rated load explains."""
    rated = cell.robot.rated_load
    for i, mass in enumerate(() if whole.mass is None else whole.mass.tolist()):
        most = HEAVIEST_LINK if whole.prismatic[i] else min(HEAVIEST_LINK, HEAVIEST_SHARE * rated)
        if mass > most:
            place = "robot.urdf" if cell.robot.inertials is None else f"robot.inertials.{i}"
            found = f"a link of {mass:,.4g} kg behind {whole.joints[i]}, for a rated load of {rated:g} kg"
            yield Remark(place, found, f"kilograms, at most {most:,.4g} kg: are masses in grams?", False)


def _frames(cell: Cell, chain: Chain) -> Iterator[Remark]:
    frames = cell.frames
    if frames.tracker is not None:
        away = float(np.linalg.norm(frames.tracker.xyz))
        cause = "metres from the base: is the pose in millimetres?"
        yield from _beyond("frames.tracker.xyz", "a tracker at", away, FARTHEST_TRACKER, cause)
        if away < 0.3 * chain.reach:
            found = f"a tracker {away:.3g} m from the base of a robot that reaches {chain.reach:.3g} m"
            yield Remark("frames.tracker.xyz", found, "a tracker out of the robot's reach; in the base frame", False)
    if frames.force_torque is not None:
        away = float(np.linalg.norm(frames.force_torque.xyz))
        yield from _beyond("frames.force_torque.xyz", "a sensor at", away, FARTHEST_TARGET, "metres from the flange")
    if frames.wrench_point is not None:
        away = float(np.linalg.norm(frames.wrench_point))
        cause = "metres from the flange: in millimetres?"
        yield from _beyond("frames.wrench_point", "a wrench point at", away, FARTHEST_TARGET, cause)
    for name, place in frames.measurement_points.items():
        away = float(np.linalg.norm(place))
        cause = "metres from the flange: in millimetres, or in another frame?"
        yield from _beyond(f"frames.measurement_points.{name}", "a target at", away, FARTHEST_TARGET, cause)
    yield from _spread(cell)


def _spread(cell: Cell) -> Iterator[Remark]:
    places = np.array(list(cell.frames.measurement_points.values()))
    if len(places) < 2:
        return
    apart, one, other = min(
        (float(np.linalg.norm(a - b)), name, another)
        for (name, a), (another, b) in itertools.combinations(zip(cell.points, places, strict=True), 2)
    )
    if apart < 1e-3:
        found = f"{one} and {other} {1e3 * apart:.2g} mm apart"
        yield Remark("frames.measurement_points", found, "targets at different places", apart == 0.0)
    if len(places) >= 3:
        _, values, _ = np.linalg.svd(places - places.mean(axis=0))
        if values[1] < 0.02 * max(values[0], 1e-9):
            found = "all targets in one line"
            yield Remark(
                "frames.measurement_points", found, "targets that span a plane: the tool's turn is seen", False
            )


def _instruments(cell: Cell) -> Iterator[Remark]:
    tracker = cell.instruments.tracker
    for key in ("sigma", "sigma_range"):
        value = getattr(tracker, key)
        if value is not None:
            cause = "metres, usually 5e-6 to 5e-5: is it in millimetres?"
            yield from _beyond(f"instruments.tracker.{key}", "a standard deviation of", value, WORST_TRACKER, cause)
            if value < 1e-6:
                found = f"a standard deviation of {1e6 * value:.2g} µm"
                yield Remark(
                    f"instruments.tracker.{key}", found, "usually 5 to 50 µm: no tracker reads better than 1 µm", False
                )
    if tracker.sigma_angle is not None and tracker.sigma_angle > 2e-4:
        found = f"{tracker.sigma_angle:g} rad"
        yield Remark("instruments.tracker.sigma_angle", found, "rad, usually 2e-6 to 2e-5: is it in degrees?", False)
    sensor, load = cell.instruments.force_torque, cell.robot.rated_load * STANDARD_GRAVITY
    if sensor is not None and sensor.sigma_force > SHARE_OF_LOAD[0] * load:
        found = f"{sensor.sigma_force:g} N, {100 * sensor.sigma_force / load:.2g} % of the rated load"
        beyond = sensor.sigma_force > SHARE_OF_LOAD[1] * load
        yield Remark("instruments.force_torque.sigma_force", found, "N, usually below 0.2 % of the rated load", beyond)


def _beyond(place: str, what: str, value: float, limits: tuple[float, float], expected: str) -> Iterator[Remark]:
    if value > limits[0]:
        yield Remark(place, f"{what} {value:,.4g} m", expected, value > limits[1])
