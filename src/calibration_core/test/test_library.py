"""The robots that a cell file can start from: complete, with sources, and as long as their makers state."""

from __future__ import annotations

import subprocess
import tomllib
from pathlib import Path

import numpy as np
import pytest
from scipy.optimize import minimize

from calibration_core.cell import Cell
from calibration_core.cell.library import FOLDER, library, library_robot
from calibration_core.cell.serial_chain import serial_chain
from calibration_core.errors import CellError
from calibration_core.model.chain import Chain
from calibration_core.model.kinematics import posture
from calibration_core.model.robot import chain_of

ROBOTS = library()


def chain(key: str) -> Chain:
    about = serial_chain(ROBOTS[key].urdf)
    return chain_of(
        Cell.model_validate({
            "name": key,
            "robot": {
                "name": key, "urdf": ROBOTS[key].urdf.name, "base_link": about.base_link, "flange": about.flange,
                "joints": about.joints, "rated_load": ROBOTS[key].rated_load,
            },
            "frames": {"measurement_points": {"mp1": [0, 0, 0]}},
            "instruments": {"tracker": {"sigma": 1e-5}},
            "path": FOLDER / "cell.yaml",
        })
    )  # fmt: skip


def test_twelve_robots_of_five_makers_with_their_sources() -> None:
    assert len(ROBOTS) >= 12
    assert len({robot.maker for robot in ROBOTS.values()}) >= 5
    assert all(robot.source.startswith("https://") for robot in ROBOTS.values())
    assert {path.stem for path in FOLDER.glob("*.urdf")} >= set(ROBOTS)


@pytest.mark.parametrize("key", [key for key in ROBOTS if not key.startswith("ur_")])
def test_the_reach_is_the_one_on_the_makers_data_sheet(key: str) -> None:
    """The wrist centre, where the last three axes meet, reaches as far from axis 1 as the maker states."""
    robot = chain(key)

    def short(q: np.ndarray) -> float:
        at = posture(robot, np.array([[0.0, q[0], q[1], 0.0, 0.0, 0.0]]))
        return -float(np.hypot(*at.origin[4][:2, 0]))

    low, high = robot.limits[1:3, 0], robot.limits[1:3, 1]
    starts = [low + share * (high - low) for share in np.random.default_rng(1).random((12, 2))]
    bounds = list(zip(low, high, strict=True))
    found = min(minimize(short, start, bounds=bounds).fun for start in starts)
    assert -found == pytest.approx(ROBOTS[key].reach, rel=2.5e-3)


@pytest.mark.parametrize(
    ("key", "place"),
    [
        ("ur_ur5e", (-0.8172, -0.2329, 0.0628)),  # -(a2 + a3), -(d4 + d6), d1 - d5: what the pendant shows at zero
        ("ur_ur10e", (-1.18425, -0.2907, 0.06085)),
    ],
)
def test_universal_robots_stand_at_zero_as_their_pendant_shows(key: str, place: tuple[float, float, float]) -> None:
    at = posture(chain(key), np.zeros((1, 6)))
    np.testing.assert_allclose(at.flange_origin[:, 0], place, atol=1e-9)
    np.testing.assert_allclose(at.flange[2][:, 0], [0, -1, 0], atol=1e-9)


@pytest.mark.parametrize("key", ROBOTS)
def test_the_flange_points_outwards_and_limits_are_radians(key: str) -> None:
    robot = chain(key)
    at = posture(robot, np.zeros((1, 6)))
    last = at.axis(5)[:, 0]
    assert abs(float(at.flange[2][:, 0] @ last)) == pytest.approx(1.0)
    assert float((at.flange_origin - at.origin[3])[:, 0] @ at.flange[2][:, 0]) > 0.05
    assert np.all(np.abs(robot.limits) < 8.0)
    assert np.all(robot.limits[:, 0] < robot.limits[:, 1])


def test_masses_of_universal_robots_are_in_place() -> None:
    """At zero the arm lies level: its centre of gravity is on the arm, as far out as the rows and masses say."""
    robot = chain("ur_ur5e")
    assert robot.mass is not None
    assert robot.com is not None
    at = posture(robot, np.zeros((1, 6)))
    places = [at.body[i][:, :, 0].T @ robot.com[i] + at.body_origin[i][:, 0] for i in range(6)]
    upper_arm, forearm = places[1], places[2]
    np.testing.assert_allclose(upper_arm, [-0.425 + 0.2125, -0.11336, 0.1625], atol=1e-9)
    np.testing.assert_allclose(forearm, [-0.425 - 0.3922 + 0.15, -0.0265, 0.1625], atol=1e-9)


def test_every_file_of_the_package_goes_into_the_wheel() -> None:
    package = Path(__file__).parents[1]
    declared = tomllib.loads((package / "pyproject.toml").read_text())["tool"]["setuptools"]["package-data"]["*"]
    suffixes = {Path(pattern).suffix or Path(pattern).name for pattern in declared}
    files = subprocess.run(
        ["find", "-L", "calibration_core", "-type", "f"], cwd=package, capture_output=True, text=True, check=True
    ).stdout.split()
    other = [Path(file) for file in files if not file.endswith((".py", ".pyc", "py.typed"))]
    assert [str(file) for file in other if file.suffix not in suffixes] == []
    assert {".urdf", ".js", ".json", ".yaml"} <= {file.suffix for file in other}


def test_a_robot_is_found_by_its_name_and_the_nearest_is_offered() -> None:
    assert library_robot("UR10e").key == "ur_ur10e"
    assert library_robot("kuka-kr6-r900").name == "KR 6 R900 sixx"
    with pytest.raises(CellError, match="did you mean ur_ur10e"):
        library_robot("ur_ur10")
    with pytest.raises(CellError, match=r"expected a URDF, a bag with /robot_description, or a robot of the library"):
        library_robot("zzz")


def test_the_chain_of_a_foreign_urdf(tmp_path: Path) -> None:
    """A gripper with a mimic joint and a camera beside the arm do not matter."""
    text = ROBOTS["abb_irb1600_6_12"].urdf.read_text()
    more = """<link name="world"/>
      <joint name="stand" type="fixed"><parent link="world"/><child link="base_link"/></joint>
      <link name="finger"/><joint name="f" type="prismatic"><parent link="flange"/><child link="finger"/>
      <limit lower="0" upper="1"/><mimic joint="joint_1"/></joint><link name="camera"/>
      <joint name="c" type="fixed"><parent link="link_3"/><child link="camera"/></joint></robot>"""
    (tmp_path / "robot.urdf").write_text(text.replace("</robot>", more))
    found = serial_chain(tmp_path / "robot.urdf")
    assert (found.base_link, found.flange, len(found.joints)) == ("base_link", "flange", 6)
    short = serial_chain(tmp_path / "robot.urdf", flange="link_4")
    assert (short.flange, len(short.joints)) == ("link_4", 4)
    with pytest.raises(CellError, match="2 moving joints"):
        serial_chain(tmp_path / "robot.urdf", flange="link_2")
    with pytest.raises(CellError, match="a link of the URDF: base_link"):
        serial_chain(tmp_path / "robot.urdf", base_link="nowhere")


def finger(name: str, parent: str, more: str = "") -> str:
    """Return a link that slides beside another, as a finger does."""
    return f"""<link name="{name}"/><joint name="j_{name}" type="prismatic"><parent link="{parent}"/>
      <child link="{name}"/><axis xyz="0 1 0"/><limit lower="0" upper="0.04" effort="1" velocity="1"/>{more}</joint>"""


@pytest.mark.parametrize("renamed", [True, False])
@pytest.mark.parametrize("fingers", [
    finger("left", "hand") + finger("right", "hand"),
    finger("left", "hand") + finger("right", "hand", '<mimic joint="j_left"/>'),
    finger("left", "hand") + finger("tip", "left") + finger("right", "hand"),
])  # fmt: skip
def test_fingers_are_no_joints_of_the_arm(tmp_path: Path, fingers: str, renamed: bool) -> None:
    """With a link that is called a flange, and with none."""
    text = ROBOTS["abb_irb1600_6_12"].urdf.read_text()
    hand = """<link name="hand"/><joint name="h" type="fixed"><parent link="flange"/><child link="hand"/></joint>"""
    text = text.replace("</robot>", f"{hand}{fingers}</robot>")
    if renamed:
        text = text.replace('"flange"', '"last"').replace('"tool0"', '"further"')
    (tmp_path / "robot.urdf").write_text(text)
    found = serial_chain(tmp_path / "robot.urdf")
    assert found.joints == serial_chain(ROBOTS["abb_irb1600_6_12"].urdf).joints
    assert found.flange == ("link_6" if renamed else "flange")
    assert len(serial_chain(tmp_path / "robot.urdf", flange="left").joints) == 7  # what is asked for is taken


def test_one_finger_behind_a_named_flange_is_no_joint_of_the_arm(tmp_path: Path) -> None:
    text = ROBOTS["abb_irb1600_6_12"].urdf.read_text().replace("</robot>", f"{finger('jaw', 'flange')}</robot>")
    text = text.replace('"flange"', '"left_flange"')
    (tmp_path / "robot.urdf").write_text(text)
    found = serial_chain(tmp_path / "robot.urdf")
    assert (found.flange, len(found.joints)) == ("left_flange", 6)
