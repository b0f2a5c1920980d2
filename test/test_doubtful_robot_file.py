"""Few displacements of a robot on soft bearings: no robot file and no zero is accused without evidence.

The plant is of its own: rigid lines of joints, each a spring that also tilts in its bearing, and a first joint whose
base rocks more easily to one side.
"""

from __future__ import annotations

import copy
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from calibration_core.cell import Cell, load_cell
from calibration_core.files.yaml_file import yaml_text
from calibration_core.input_checks.check import check_inputs
from calibration_core.timeseries import Float1D, Float2D, Provenance, Readings

HALF = np.pi / 2
ROWS = ((0.33, -HALF, 0.645, 0.0), (1.15, 0.0, 0.0, -HALF), (0.115, -HALF, 0.0, 0.0), (0.0, HALF, 1.22, 0.0),
        (0.0, -HALF, 0.0, 0.0), (0.0, 0.0, 0.215, 0.0))  # fmt: skip
COMPLIANCE = 1.0 / np.array([1.9e6, 2.4e6, 1.7e6, 5e5, 4e5, 3e5])  # rad/(N*m)
POINTS = {"mp1": (0.17, 0.01, 0.12), "mp2": (-0.1, 0.15, 0.10), "mp3": (-0.08, -0.16, 0.17)}
LEVELS = (0.0, 0.5, 1.0, 0.5, 0.0)
SIGMA = 1.5e-5  # m
PULL = 1600.0  # N
LOW, HIGH = np.array([-2.5, -0.9, -2.0, -2.7, -1.9, -2.7]), np.array([2.5, 1.2, 1.1, 2.7, 1.9, 2.7])
BEARINGS = {1: (3e-7, 2e-7), 2: (3e-7, 1e-7)}  # joint, from 0 -> rad/(N*m) about x and y of the frame before
ROCKING = (1.2e-7, 0.5e-7)  # rad/(N*m), to the soft and to the stiff side


def _frames(q: Float1D, rows: Any = ROWS) -> tuple[list[tuple[Float2D, Float1D]], Float2D, Float1D]:
    """Return axes (3, 3) and origin (3,) of the frame before each joint, and those of the flange, from standard DH."""
    turn, origin, before = np.eye(3), np.zeros(3), []
    for (a, alpha, d, theta), angle in zip(rows, q, strict=True):
        before.append((turn, origin))
        c, s, ca, sa = np.cos(angle + theta), np.sin(angle + theta), np.cos(alpha), np.sin(alpha)
        origin = origin + turn @ np.array([a * c, a * s, d])
        turn = turn @ np.array([[c, -s * ca, s * sa], [s, c * ca, -c * sa], [0.0, sa, ca]])
    return before, turn, origin


def _moved(q: Float1D, force: Float1D, points: Float2D, *, tilts: bool) -> tuple[Float2D, Float2D, Float1D]:
    """Return how points (k, 3) of the flange move under a pull at its origin, base axes, m, and its axes and origin."""
    before, turn, flange = _frames(q)
    target = flange + points @ turn.T
    shift = np.zeros_like(target)
    for joint, (axes, origin) in enumerate(before):
        moment = axes.T @ np.cross(flange - origin, force)
        bearing = np.array(BEARINGS.get(joint, (0.0, 0.0)))
        if joint == 0:
            bearing = np.where(moment[:2] > 0, *ROCKING)
        angle = np.array([*(tilts * bearing * moment[:2]), COMPLIANCE[joint] * moment[2]])
        shift += np.cross(axes @ angle, target - origin)
    return shift, turn, flange


def _recording(seed: int, loaded: int, single: int, *, pull: float, noise: float, tilts: bool) -> Readings:
    """Return displacements of loaded configurations, and of single steps after them, which are zero by definition."""
    draw = np.random.default_rng(seed)
    points = np.array(list(POINTS.values()))
    rows: list[tuple[Any, ...]] = []
    for number in range(loaded + single):
        q, direction = draw.uniform(LOW, HIGH), draw.normal(size=3)
        first = np.zeros_like(points)
        for step, level in enumerate(LEVELS if number < loaded else (0.0,)):
            force = level * pull * direction / np.linalg.norm(direction)
            shift, turn, _ = _moved(q, force, points, tilts=tilts)
            seen = shift + noise * SIGMA * draw.normal(size=shift.shape)
            first = seen if step == 0 else first
            wrench = np.concatenate([turn.T @ force, np.zeros(3)])
            rows += [(number + 1, step, q, wrench, k, seen[k] - first[k]) for k in range(len(points))]
    numbers, steps, angles, wrenches, names, positions = zip(*rows, strict=True)
    count = len(rows)
    return Readings(
        configuration=np.array(numbers), step=np.array(steps), time=np.full(count, np.nan),
        temperature=np.full(count, np.nan), q=np.array(angles), wrench=np.array(wrenches), point=np.array(names),
        position=np.array(positions), points=tuple(POINTS), provenance=Provenance("plant.csv", "csv", {}, {}),
    )  # fmt: skip


def _content() -> dict[str, Any]:
    here = {"xyz": [0.0, 0.0, 0.0], "rpy": [0.0, 0.0, 0.0]}
    rows = [dict(zip(("a", "alpha", "d", "theta"), row, strict=True)) for row in ROWS]
    limits = [[float(low), float(high)] for low, high in zip(LOW, HIGH, strict=True)]
    return {
        "name": "plant",
        "robot": {"name": "plant", "dh": rows, "joints": [f"a{k}" for k in range(1, 7)], "joint_limits": limits,
                  "rated_load": 210.0, "stiffness": [float(1 / c) for c in COMPLIANCE]},
        "frames": {"tracker": here, "force_torque": here, "wrench_point": [0.0, 0.0, 0.0],
                   "measurement_points": {name: list(point) for name, point in POINTS.items()}},
        "instruments": {"tracker": {"sigma": SIGMA}, "force_torque": {"sigma_force": 1.0, "sigma_torque": 0.5}},
        "measurements": {"points": "displacement"},
    }  # fmt: skip


def _cell(folder: Path, content: dict[str, Any]) -> Cell:
    path = folder / "cell.yaml"
    path.write_text(yaml_text(content), encoding="utf-8")
    return load_cell(path)


@pytest.mark.parametrize(("pull", "noise"), [(PULL, 1.0), (0.06 * PULL, 1.0), (0.06 * PULL, 2.0)])
def test_few_displacements_accuse_no_robot_file(tmp_path: Path, pull: float, noise: float) -> None:
    cell = _cell(tmp_path, _content())
    drawn = [(loaded, single, seed) for loaded, single in ((4, 0), (5, 3)) for seed in range(5)]
    accused = [
        (key, fault.kind, fault.text)
        for key in drawn
        for fault in check_inputs(_recording(key[2], *key[:2], pull=pull, noise=noise, tilts=True), cell)
    ]
    assert accused == []


@pytest.mark.parametrize("tilts", [True, False])
def test_the_file_of_another_robot_is_still_refused(tmp_path: Path, tilts: bool) -> None:
    content = copy.deepcopy(_content())
    content["robot"]["dh"][2]["theta"] += HALF  # an elbow that hangs a quarter turn lower
    cell = _cell(tmp_path, content)
    found = [check_inputs(_recording(seed, 12, 0, pull=PULL, noise=1.0, tilts=tilts), cell) for seed in (0, 2)]
    assert all(fault.blocks and fault.kind in {"wrong_robot_file", "no_relation"} for (fault,) in found)


@pytest.mark.parametrize(("joint", "offset"), [(0, 0.15), (1, 0.06), (2, -0.1), (4, 0.1)])
def test_a_zero_that_leaves_noise_is_still_named(tmp_path: Path, joint: int, offset: float) -> None:
    content = copy.deepcopy(_content())
    content["robot"]["dh"][joint]["theta"] += offset
    cell = _cell(tmp_path, content)
    (fault,) = check_inputs(_recording(3, 12, 0, pull=PULL, noise=1.0, tilts=False), cell)
    assert (fault.kind, fault.joints) == ("wrong_robot_file", (f"a{joint + 1}",))
    assert fault.magnitude == pytest.approx(-offset, rel=0.1)
