"""Robots with mimic joints between base and flange, as URDFs: a telescopic column, a parallelogram, stranger gears."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import yaml

from calibration_core.cell import Cell, load_cell
from calibration_core.model.chain import Chain
from calibration_core.timeseries import Float2D

CELLS = Path(__file__).parents[2] / "config" / "cells"
BALL = '<inertia ixx="0.1" ixy="0" ixz="0" iyy="0.1" iyz="0" izz="0.1"/>'
POINT = np.array([0.05, -0.03, 0.12])


def joint(
    name: str, kind: str, xyz: str, axis: str, limit: str, mimic: str = "", rpy: str = "0 0 0"
) -> tuple[str, str]:
    """Return a joint without its links, and the name of the link that it carries."""
    low, high = limit.split()
    bounds = f'<limit lower="{low}" upper="{high}" effort="1" velocity="1"/>'
    return (
        f'<joint name="{name}" type="{kind}"><origin xyz="{xyz}" rpy="{rpy}"/><axis xyz="{axis}"/>{bounds}{mimic}',
        name,
    )


def urdf(*joints: tuple[str, str], masses: tuple[float, ...], flange: str = "0 0 0.08") -> str:
    """Return a URDF of a serial chain: links named after the joints that carry them."""
    parents = ["base", *(f"{name}_link" for _, name in joints)]
    links = "".join(
        f'<link name="{name}"><inertial><origin xyz="0.02 {0.01 * k} {0.05 + 0.02 * k}"/>'
        f'<mass value="{mass}"/>{BALL}</inertial></link>'
        for k, (name, mass) in enumerate(zip(parents[1:], masses, strict=True))
    )
    rest = "".join(
        f'{text}<parent link="{parent}"/><child link="{name}_link"/></joint>'
        for (text, name), parent in zip(joints, parents, strict=False)
    )
    end = f'<joint name="on" type="fixed"><parent link="{parents[-1]}"/><child link="flange"/>'
    end += f'<origin xyz="{flange}"/></joint>'
    return f'<robot name="r"><link name="base"/><link name="flange"/>{links}{rest}{end}</robot>'


def mimic(driver: str, multiplier: float = 1.0, offset: float = 0.0) -> str:
    return f'<mimic joint="{driver}" multiplier="{multiplier}" offset="{offset}"/>'


ARM = (
    joint("joint_1", "revolute", "0 0 0.3", "0 0 1", "-2.9 2.9"),
    joint("joint_2", "revolute", "0.1 0 0.2", "0 1 0", "-1.5 1.9"),
    joint("joint_3", "revolute", "0 0 0.6", "0 1 0", "-2.2 1.2"),
    joint("joint_4", "revolute", "0.1 0 0.1", "1 0 0", "-3 3"),
    joint("joint_5", "revolute", "0.5 0 0", "0 1 0", "-2 2"),
    joint("joint_6", "revolute", "0.1 0 0", "1 0 0", "-3 3"),
)
ARM_MASSES = (25.0, 18.0, 12.0, 6.0, 3.0, 1.0)
COLUMN = urdf(
    joint("lift", "prismatic", "0 0 0.4", "0 0 1", "0 0.35", rpy="0.01 0 0.2"),
    joint("stage_2", "prismatic", "0.02 0 0.3", "0 0 1", "0 0.5", mimic("lift"), rpy="0 0.01 0"),
    joint("stage_3", "prismatic", "0 0.01 0.3", "0 0 1", "0 0.2", mimic("lift", 0.5, 0.03)),
    *ARM,
    masses=(60.0, 50.0, 40.0, *ARM_MASSES),
    flange="0.05 0 0",
)  # fmt: skip
PARALLELOGRAM = urdf(
    *ARM[:2],
    joint("keeps_level", "revolute", "0 0 0.7", "0 1 0", "-1.2 1.6", mimic("joint_2", -1.0)),
    joint("joint_3", "revolute", "0.05 0 0.1", "0 1 0", "-1.2 1.2"),
    *ARM[3:],
    masses=(40.0, 25.0, 8.0, 14.0, 6.0, 3.0, 1.0),
    flange="0.05 0 0",
)  # fmt: skip
ODD = urdf(
    joint("before", "revolute", "0 0 0.2", "0 1 0.2", "-2 2", mimic("b", 0.4, 0.1)),
    joint("a", "revolute", "0.1 0 0.3", "0 0 1", "-2 2"),
    joint("b", "revolute", "0.1 0 0.3", "0 1 0", "-1 1.5"),
    joint("spindle", "prismatic", "0.2 0 0.2", "1 0 0.3", "-1 1", mimic("a", 0.08, 0.02)),
    joint("c", "prismatic", "0.1 0.1 0", "1 0 0", "-0.2 0.4", rpy="0.1 0.4 0"),
    joint("d", "revolute", "0.1 0 0", "0 1 0", "-2 2"),
    joint("behind", "revolute", "0.1 0 0.1", "1 1 0", "-3 3", mimic("c", -1.5, 0.2)),
    masses=(20.0, 15.0, 12.0, 9.0, 6.0, 4.0, 2.0),
)  # fmt: skip
ROBOTS = {"column": COLUMN, "parallelogram": PARALLELOGRAM, "odd": ODD}
STIFFNESS = {
    "column": [6e5, 1.2e5, 1.5e5, 9e4, 2.5e4, 2e4, 1.2e4],
    "parallelogram": [1.2e5, 1.5e5, 9e4, 2.5e4, 2e4, 1.2e4],
    "odd": [1.2e5, 1.5e5, 6e5, 2e4],
}
JOINTS = {
    "column": ("lift", *(f"joint_{i}" for i in range(1, 7))),
    "parallelogram": tuple(f"joint_{i}" for i in range(1, 7)),
    "odd": ("a", "b", "c", "d"),
}


def content_of(robot: str, folder: Path) -> dict:
    """Return a cell file with one of the robots, which is written beside it."""
    (folder / "robot.urdf").write_text(ROBOTS[robot])
    content = yaml.safe_load((CELLS / "small.cell.yaml").read_text())
    content["robot"] = {
        "name": f"{robot} robot",
        "urdf": "robot.urdf",
        "base_link": "base",
        "flange": "flange",
        "joints": list(JOINTS[robot]),
        "rated_load": 10.0,
        "stiffness": STIFFNESS[robot],
    }
    content["frames"]["tracker"] = {"xyz": [3.5, -0.4, 0.9], "rpy": [0.0, 0.0, 3.0]}
    content["instruments"]["tracker"] = {"sigma": 1e-5}
    return content


def cell_of(robot: str, folder: Path, text: str | None = None, **changes: object) -> Cell:
    content = content_of(robot, folder)
    content["robot"] |= changes
    if text is not None:
        (folder / "robot.urdf").write_text(text)
    path = folder / "cell.yaml"
    path.write_text(yaml.safe_dump(content))
    return load_cell(path)


def postures_of(chain: Chain, m: int = 4) -> Float2D:
    return np.random.default_rng(1).uniform(chain.limits[:, 0], chain.limits[:, 1], (m, chain.n))
