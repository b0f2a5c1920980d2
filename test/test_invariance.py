"""What is found does not depend on what things are called, how they are counted, or where frames and clocks are zero.

Every test draws the changes that it makes: names, numbers, orders, poses.  The quick ones make all of them at once; the
slow ones make each by itself, and say which it is that matters.
"""

from __future__ import annotations

import copy
import dataclasses
import math
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path

import numpy as np
import pytest
from invariance_cases import (
    RECORDINGS,
    Content,
    Recorded,
    answers_to,
    called,
    compare_answers,
    expected_answers,
    recorded_as,
    unchanged_answers,
)

from calibration_core.model.chain import rotation_x, rotation_z, rpy_of
from calibration_sim.mechanics.transforms import rotation_vector
from calibration_sim.scenarios.names import renamed

SLOW = pytest.mark.slow
LONG = {"loaded", "loaded, small robot", "loaded and at rest", "at rest", "two recordings"}

Change = Callable[[Recorded, np.random.Generator], Recorded]


# --- what is changed --------------------------------------------------------------------------------------------------


def _renamed(recorded: Recorded, names: Mapping[str, str]) -> Recorded:
    content = called({k: v for k, v in recorded.content.items() if k not in {"name", "source"}}, names)
    points = tuple(names[point] for point in recorded.readings.points)
    return dataclasses.replace(
        recorded.changed(points=points, content={**recorded.content, **content}), names={**recorded.names, **names}
    )


def _stated_names(style: str) -> Change:
    """Names as a maker gives them."""

    def change(recorded: Recorded, _: np.random.Generator) -> Recorded:
        old = (*recorded.content["robot"]["joints"], *recorded.readings.points)
        return _renamed(recorded, {name: renamed(name, style) for name in old})

    return change


def _drawn_names(recorded: Recorded, rng: np.random.Generator) -> Recorded:
    """Names of letters and misleading digits."""
    old = (*recorded.content["robot"]["joints"], *recorded.readings.points)
    letters, digits = rng.integers(97, 123, (len(old), 3)), rng.permutation(len(old))
    new = ["".join(map(chr, row)) + f"_{number}" for row, number in zip(letters, digits, strict=True)]
    return _renamed(recorded, dict(zip(old, new, strict=True)))


def _configurations_counted_otherwise(recorded: Recorded, rng: np.random.Generator) -> Recorded:
    """Give configurations any numbers: they stay in the order of time, their numbers do not."""
    old = np.unique(recorded.readings.configuration)
    new = rng.permutation([0, *rng.choice(900, len(old) - 1, replace=False) + 1])
    numbers = {int(a): int(b) for a, b in zip(old, new, strict=True)}
    other = recorded.changed(configuration=new[np.searchsorted(old, recorded.readings.configuration)])
    return dataclasses.replace(other, numbers=numbers)


def _steps_counted_otherwise(recorded: Recorded, rng: np.random.Generator) -> Recorded:
    """Leave out numbers of steps; step 0 is the first."""
    number = np.concatenate([[0], np.cumsum(rng.integers(1, 5, recorded.readings.step.max()))])
    other = recorded.changed(step=number[recorded.readings.step])
    return dataclasses.replace(other, steps=dict(enumerate(number.tolist())))


def _clock_set_otherwise(recorded: Recorded, rng: np.random.Generator) -> Recorded:
    time = recorded.readings.time
    return recorded if time is None else recorded.changed(time=time + float(rng.integers(-9000, 9000)))


def _points_in_another_order(recorded: Recorded, rng: np.random.Generator) -> Recorded:
    """Shuffle the points, in the cell file and in the recording's list; the rows stay as they are."""
    content, points = copy.deepcopy(recorded.content), recorded.readings.points
    known = list(content["frames"]["measurement_points"].items())
    content["frames"]["measurement_points"] = dict(known[k] for k in rng.permutation(len(known)))
    order = rng.permutation(len(points))
    place = np.argsort(order)[recorded.readings.point]
    return recorded.changed(points=tuple(points[k] for k in order), point=place, content=content)


def _rows_of_a_step_in_another_order(recorded: Recorded, rng: np.random.Generator) -> Recorded:
    """Shuffle the rows of every step, which are measured together."""
    readings = recorded.readings
    first = np.sort(np.unique(readings.configuration, return_index=True)[1])
    position = {int(readings.configuration[row]): k for k, row in enumerate(first)}
    in_time = np.array([position[int(number)] for number in readings.configuration])
    order = np.lexsort((rng.random(len(readings)), readings.step, in_time))
    arrays = {
        field.name: value[order]
        for field in dataclasses.fields(readings)
        if isinstance(value := getattr(readings, field.name), np.ndarray)
    }
    return recorded.changed(**arrays)


def _tracker_turned(recorded: Recorded, rng: np.random.Generator) -> Recorded:
    """Turn the tracker about its own standing axis, by which it measures azimuth and elevation.

    A rotation about z at the right of a frame with fixed-axis angles (r, p, y) adds to r, p and y alone if r = p = 0,
    as in these cells.
    """
    content, angle = copy.deepcopy(recorded.content), float(rng.uniform(-3, 3))
    pose = content["frames"]["tracker"]
    assert pose["rpy"][:2] == [0.0, 0.0]
    pose["rpy"] = [0.0, 0.0, pose["rpy"][2] + angle]
    turn = rotation_vector(np.array([0.0, 0.0, angle]))
    return recorded.changed(position=recorded.readings.position @ turn, content=content)


def _quarter_turned(place: Sequence[float], turns: int) -> list[float]:
    """Return x, y, z and what follows in a frame turned about z by some quarters."""
    x, y, *others = place
    for _ in range(turns):
        x, y = y, -x
    return [x, y, *others]


def _base_turned(recorded: Recorded, rng: np.random.Generator) -> Recorded:
    """Turn the base frame by quarters under the robot: first joint's zero, gravity and the tracker follow."""
    content, turns = copy.deepcopy(recorded.content), int(rng.integers(1, 4))
    robot, pose = content["robot"], content["frames"]["tracker"]
    robot["dh"][0]["theta"] = robot["dh"][0].get("theta", 0.0) - turns * math.pi / 2
    robot["gravity"] = _quarter_turned(robot["gravity"], turns)
    turned = {"xyz": _quarter_turned(pose["xyz"], turns), "rpy": [0.0, 0.0, pose["rpy"][2] - turns * math.pi / 2]}
    content["frames"]["tracker"] = turned
    return recorded.changed(content=content)


def _flange_turned(recorded: Recorded, rng: np.random.Generator) -> Recorded:
    """Turn the flange frame by quarters about the last axis, and state all that is fixed to it in the new one."""
    content, turns = copy.deepcopy(recorded.content), int(rng.integers(1, 4))
    robot, frames = content["robot"], content["frames"]
    last = robot["dh"][-1]
    assert (last["a"], last["alpha"]) == (0.0, 0.0)
    last["theta"] = last.get("theta", 0.0) + turns * math.pi / 2
    robot["inertials"][-1]["com"] = _quarter_turned(robot["inertials"][-1]["com"], turns)
    points = frames["measurement_points"]
    frames["measurement_points"] = {name: _quarter_turned(place, turns) for name, place in points.items()}
    if "wrench_point" in frames:
        frames["wrench_point"] = _quarter_turned(frames["wrench_point"], turns)
    if "force_torque" in frames:
        pose = frames["force_torque"]
        assert pose["rpy"][:2] == [0.0, 0.0]
        yaw = pose["rpy"][2] - turns * math.pi / 2
        frames["force_torque"] = {"xyz": _quarter_turned(pose["xyz"], turns), "rpy": [0.0, 0.0, yaw]}
    return recorded.changed(content=content)


# What belongs to the robot is changed alike in several recordings of it.
OF_THE_ROBOT: Mapping[str, Change] = {
    "drawn names": _drawn_names,
    "names of UR": _stated_names("ur"),
    "names of KUKA, counted from the flange": _stated_names("kuka"),
    "names with digits in odd places": _stated_names("odd"),
    "base turned": _base_turned,
    "flange turned": _flange_turned,
}
CHANGES: Mapping[str, Change] = {
    **OF_THE_ROBOT,
    "configurations counted otherwise": _configurations_counted_otherwise,
    "steps counted otherwise": _steps_counted_otherwise,
    "clock set otherwise": _clock_set_otherwise,
    "points in another order": _points_in_another_order,
    "rows of a step in another order": _rows_of_a_step_in_another_order,
    "tracker turned": _tracker_turned,
}
AT_ONCE = [change for change in CHANGES if not change.startswith("names ")]


def _changed(recording: str, changes: Sequence[str], seed: int) -> list[Recorded]:
    several = []
    for member, recorded in enumerate(recorded_as(recording)):
        for change in changes:
            own = 0 if change in OF_THE_ROBOT else member
            recorded = CHANGES[change](recorded, np.random.default_rng([seed, list(CHANGES).index(change), own]))
        several.append(recorded)
    return several


def _of_the_base(recording: str) -> bool:
    return any(planned.name == "base_compliance" for planned in RECORDINGS[recording][3])


def _check(recording: str, several: Sequence[Recorded]) -> None:
    expected = expected_answers(copy.deepcopy(unchanged_answers(recording)), several)
    assert expected["diagnose"]["findings"] or expected["diagnose"]["rest"]["where"]["configurations"]
    assert any(np.isfinite(row["value"]) for row in expected["identify"]["stiffness"]) or recording == "at rest"
    compare_answers(answers_to(several), expected)


@pytest.mark.parametrize("seed", [1, *(pytest.param(k, marks=SLOW) for k in (2, 3, 4))])
@pytest.mark.parametrize("recording", [pytest.param(name, marks=SLOW) if name in LONG else name for name in RECORDINGS])
def test_the_same_is_found_after_all_changes_at_once(recording: str, seed: int) -> None:
    """What tilts about the base's own axes is stated in these: the base is then left as it is."""
    changes = [change for change in AT_ONCE if change != "base turned" or not _of_the_base(recording)]
    several = _changed(recording, changes, seed)
    _check(recording, several[::-1])  # several recordings are named in the other order, too


# What tilts about the base's own axes is stated in these, and differs with them.
EACH = [(one, change) for one in RECORDINGS for change in CHANGES if change != "base turned" or not _of_the_base(one)]


@pytest.mark.slow
@pytest.mark.parametrize(("recording", "change"), EACH)
def test_the_same_is_found_after_each_change(recording: str, change: str) -> None:
    _check(recording, _changed(recording, [change], 1))


def _urdf(content: Content, links: Sequence[str], rng: np.random.Generator | None = None) -> str:
    """Return the robot as a URDF, elements in an order that is drawn."""
    robot = content["robot"]
    elements = [f'<link name="{links[0]}"/>', f'<link name="{links[-1]}"/>']
    place, turn, parent = np.zeros(3), np.eye(3), links[0]

    def joint(name: str, kind: str, child: str, more: str, theta: float = 0.0) -> str:
        xyz, rpy = (" ".join(map(repr, map(float, part))) for part in (place, rpy_of(turn @ rotation_z(theta))))
        ends = f'<parent link="{parent}"/><child link="{child}"/><origin xyz="{xyz}" rpy="{rpy}"/>'
        return f'<joint name="{name}" type="{kind}">{ends}{more}</joint>'

    for name, row, inertial, limits, child in zip(
        robot["joints"], robot["dh"], robot["inertials"], robot["joint_limits"], links[1:-1], strict=True
    ):
        limit = f'<axis xyz="0 0 1"/><limit lower="{limits[0]}" upper="{limits[1]}" effort="1" velocity="1"/>'
        elements.append(joint(name, "revolute", child, limit, row.get("theta", 0.0)))
        place, turn, parent = np.array([row["a"], 0.0, row["d"]]), rotation_x(row["alpha"]), child
        com = " ".join(map(repr, map(float, place + turn @ inertial["com"])))
        mass = f'<inertial><origin xyz="{com}"/><mass value="{inertial["mass"]}"/></inertial>'
        elements.append(f'<link name="{child}">{mass}</link>')
    elements.append(joint("to_flange", "fixed", links[-1], ""))
    order = range(len(elements)) if rng is None else rng.permutation(len(elements))
    return f'<robot name="r">{"".join(elements[k] for k in order)}</robot>'


def test_names_of_links_and_the_order_of_a_urdf_do_not_matter(tmp_path: Path) -> None:
    (recorded,) = recorded_as("at rest")
    robot = recorded.content["robot"]
    found = []
    for seed in (None, 5):
        rng = None if seed is None else np.random.default_rng(seed)
        links = [f"link_{k}" for k in range(len(robot["joints"]) + 2)]
        if rng is not None:
            links = [f"part {number}" for number in rng.permutation(len(links))]
        (tmp_path / f"{seed}.urdf").write_text(_urdf(recorded.content, links, rng))
        own = {k: v for k, v in robot.items() if k not in {"dh", "modified_dh", "inertials", "joint_limits"}}
        own |= {"urdf": str(tmp_path / f"{seed}.urdf"), "base_link": links[0], "flange": links[-1]}
        found.append(answers_to([recorded.changed(content={**recorded.content, "robot": own})]))
    assert found[0]["diagnose"]["findings"][0]["location"] == {"joint": "joint_2"}
    compare_answers(found[1], found[0])
