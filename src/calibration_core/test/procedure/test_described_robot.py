"""The robot that a driver describes against the cell's: another one is named by what differs."""

from __future__ import annotations

import re

import numpy as np
import pytest

from calibration_core.cell import Cell
from calibration_core.model.chain import Chain, rotation_rpy, rpy_of
from calibration_core.model.robot import chain_of
from calibration_core.planning.plans.described_robot import description_fault


def urdf_text(cell: Cell) -> str:
    assert cell.urdf_path is not None
    return cell.urdf_path.read_text(encoding="utf-8")


def urdf_of(chain: Chain, stretch: float = 0.0) -> str:
    """A URDF of a chain, with frames of its own at both ends; the third joint is farther out by `stretch` m."""
    parts, limits = ["<link name='world'/>"], chain.limits
    base = rotation_rpy(0.3, -0.2, 1.1)
    for i, name in enumerate(chain.joints):
        turn, at = chain.rotation[i], chain.translation[i] + (stretch * np.array([1.0, 0.0, 0.0]) if i == 2 else 0.0)
        turn = turn @ rotation_rpy(0.0, 0.0, float(chain.offset[i]))
        if i == 0:
            turn, at = base @ turn, base @ at + np.array([0.5, 0.1, -0.4])
        xyz, rpy = (" ".join(f"{value:.12g}" for value in values) for values in (at, rpy_of(turn)))
        parts.append(
            f"<link name='l{i}'/><joint name='{name}' type='revolute'><origin xyz='{xyz}' rpy='{rpy}'/>"
            f"<parent link='{'world' if i == 0 else f'l{i - 1}'}'/><child link='l{i}'/><axis xyz='0 0 1'/>"
            f"<limit lower='{limits[i][0]}' upper='{limits[i][1]}' effort='1' velocity='1'/></joint>"
        )
    return f"<robot name='any'>{''.join(parts)}</robot>"


def test_the_cells_own_urdf_is_its_robot(demo_cell: Cell) -> None:
    assert description_fault(urdf_text(demo_cell), demo_cell) == ""


def test_another_robot_is_told_by_limits_and_kinematics_whatever_its_name_is(demo_cell: Cell) -> None:
    text, renamed = re.subn(r'<robot name="[^"]+"', '<robot name="ur"', urdf_text(demo_cell))
    assert renamed == 1
    assert description_fault(text, demo_cell) == ""
    limit = re.search(r'lower="(-?[\d.]+)"', text)
    assert limit is not None
    narrow = text.replace(limit.group(0), 'lower="-0.7"', 1)
    assert re.match(r"limits of joint_1 -0\.7 to ", description_fault(narrow, demo_cell))
    origin = re.search(r'(<joint name="joint_3".*?xyz=")([^"]+)"', text, re.DOTALL)
    assert origin is not None
    x, y, z = map(float, origin.group(2).split())
    longer = text.replace(origin.group(0), f'{origin.group(1)}{x} {y} {z + 0.2}"')
    assert re.fullmatch(r"the flange \d{3} mm elsewhere in the same posture", description_fault(longer, demo_cell))
    calibrated = text.replace(origin.group(0), f'{origin.group(1)}{x} {y} {z + 0.003}"')
    assert description_fault(calibrated, demo_cell) == ""


def test_dh_rows_are_compared_whatever_frames_the_description_has(small_cell: Cell) -> None:
    chain = chain_of(small_cell)
    assert description_fault(urdf_of(chain), small_cell) == ""
    assert description_fault(urdf_of(chain, 0.002), small_cell) == ""
    text = description_fault(urdf_of(chain, 0.15), small_cell)
    assert re.fullmatch(r"the flange moves otherwise between the same postures, by [\d.]+ rad and \d+ mm", text), text
    wider = urdf_of(chain).replace(f"lower='{chain.limits[0][0]}'", "lower='-3.0'")
    assert description_fault(wider, small_cell) == ""  # a cell may allow less
    narrower = urdf_of(chain).replace(f"lower='{chain.limits[0][0]}'", "lower='-1.0'")
    assert description_fault(narrower, small_cell) == "limits of joint_1 -1 to 2.9, exceeded by -2.9 to 2.9"


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("", "no element found"), ("no xml", "expected well-formed XML"), ("<robot name='x'/>", "no joint 'joint_1', "),
        ("<!DOCTYPE a><robot name='x'/>", "without document type"), ("<sdf/>", "expected <robot>"),
    ],
)  # fmt: skip
def test_what_is_no_description_is_one_line(small_cell: Cell, text: str, words: str) -> None:
    found = description_fault(text, small_cell)
    assert words in found
    assert "\n" not in found
