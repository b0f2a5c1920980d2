"""Cell files: what is allowed is read, everything else is refused by the name of its field."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from calibration_core.cell import Cell, load_cell
from calibration_core.errors import CellError

CONFIG = Path(__file__).resolve().parents[3] / "config" / "cells"
REAL = Path(__file__).resolve().parents[4] / "shared" / "data" / "real"
TEXT = """name: a cell
robot:
  name: a robot
  dh: [{a: 0.05, alpha: -1.5708, d: 0.4}, {a: 0.45, alpha: 0, d: 0}, {a: 0.04, alpha: 0.3, d: 0.2, theta: 1}]
  joints: [j1, j2, j3]
  joint_limits: [[-3, 3], [-3, 3], [-3, 3]]
  rated_load: 10
frames:
  measurement_points: {mp1: [0.1, 0, 0], mp2: [0, 0.1, 0]}
instruments:
  tracker: {sigma: 2.0e-5}
"""


def load(tmp_path: Path, text: str) -> Cell:
    path = tmp_path / "cell.yaml"
    path.write_text(text, encoding="utf-8")
    return load_cell(path)


def test_the_least(tmp_path: Path) -> None:
    cell = load(tmp_path, TEXT)
    assert cell.points == ("mp1", "mp2")
    assert cell.robot.joints == ("j1", "j2", "j3")
    assert cell.gravity.tolist() == [0, 0, -9.80665]
    assert cell.robot.dh is not None
    assert (cell.robot.dh[0].theta, cell.robot.dh[2].theta) == (0.0, 1.0)
    assert (cell.measurements.points, cell.measurements.wrench_axes, cell.measurements.wrench_at) == (
        "absolute", "sensor", "sensor",
    )  # fmt: skip
    assert cell.frames.tracker is None
    assert cell.instruments.force_torque is None
    assert len(cell.sha256) == 64
    assert cell.urdf_path is None


@pytest.mark.parametrize("path", sorted(CONFIG.glob("*.yaml")), ids=lambda path: path.stem)
def test_our_cells(path: Path) -> None:
    cell = load_cell(path)
    assert len(cell.robot.joints) >= 3
    if cell.urdf_path is not None:
        assert cell.urdf_path.is_file()


@pytest.mark.skipif(not REAL.is_dir(), reason="the real recordings are not beside the project")
def test_real_cells() -> None:
    cells = {path.name: load_cell(path) for path in REAL.glob("*.cell.yaml")}
    assert len(cells["wam.cell.yaml"].robot.joints) == 7
    assert cells["fanuc.cell.yaml"].measurements.points == "displacement"


def test_topics_by_role_and_by_default_name(tmp_path: Path) -> None:
    topics = "topics: {wrench: /ft, /joint_states: /js, /tracker/mp1: /laser, tracker: {mp2: /other}}\n"
    cell = load(tmp_path, TEXT + topics)
    assert cell.topics.wrench == "/ft"
    assert cell.topics.joint_states == "/js"
    assert cell.topics.point("mp1") == "/laser"
    assert cell.topics.point("mp2") == "/other"
    assert load(tmp_path, TEXT).topics.point("mp2") == "/tracker/mp2"


def test_a_declared_speed_limit(tmp_path: Path) -> None:
    assert load(tmp_path, TEXT).safety is None
    declared = load(tmp_path, TEXT + "safety: {speed_limit: 0.2, source: checksum 8A3F}\n").safety
    assert declared is not None
    assert (declared.speed_limit, declared.source) == (0.2, "checksum 8A3F")


COUPLED = TEXT.replace("rated_load: 10", "rated_load: 10\n  joint_coupling: {j3: {j2: 1}}")


def test_a_coupling_of_joints_is_for_recordings(tmp_path: Path) -> None:
    cell = load(tmp_path, COUPLED)
    assert cell.robot.coupling.tolist() == [[1, 0, 0], [0, 1, 0], [0, 1, 1]]
    with pytest.raises(
        CellError, match=r"cell.yaml:8:3: robot.joint_coupling: found a coupling, expected no coupling where"
    ):
        load_cell(cell.path, live=True)
    assert load_cell(CONFIG / "small.cell.yaml", live=True).robot.joint_coupling == {}


@pytest.mark.parametrize("coupling", ["{j3: {j9: 1}}", "{j3: {j3: 1}}", "{j2: {j3: 1}, j3: {j2: 1}}"])
def test_a_coupling_that_makes_no_sense_is_refused(tmp_path: Path, coupling: str) -> None:
    with pytest.raises(CellError, match="joint_coupling"):
        load(tmp_path, COUPLED.replace("{j3: {j2: 1}}", coupling))


def test_values_are_frozen(tmp_path: Path) -> None:
    cell = load(tmp_path, TEXT)
    with pytest.raises(ValueError, match="frozen"):
        cell.name = "other"  # type: ignore[misc]
    with pytest.raises(TypeError):
        cell.frames.measurement_points["mp3"] = (0, 0, 0)  # type: ignore[index]
    cell.gravity[2] = 0.0
    assert cell.gravity[2] == -9.80665


@pytest.mark.parametrize(
    ("old", "new", "place", "found"),
    [
        ("rated_load: 10", "rated_load: heavy", "robot.rated_load", "'heavy'"),
        ("rated_load: 10", "rated_load: .nan", "robot.rated_load", "nan"),
        ("rated_load: 10", "rated_load: -1", "robot.rated_load", "-1"),
        ("rated_load: 10", "rated_load: yes", "robot.rated_load", "True"),
        ("  rated_load: 10\n", "", "robot.rated_load", "nothing"),
        ("rated_load: 10", "rated_load: 10\n  colour: red", "robot.colour", "an unknown key"),
        ("rated_load: 10", "rated_load: 10\n  urdf: a.urdf", "robot", "both urdf and dh"),
        ("[j1, j2, j3]", "[j1, j2]", "robot.joints", "2 joints"),
        ("[j1, j2, j3]", "[j1, j2, j2]", "robot.joints", "repeated names"),
        ("[j1, j2, j3]", "[j1, j2, '']", "robot.joints.2", "''"),
        ("[j1, j2, j3]", '[j1, j2, "j3\\nj4"]', "robot.joints.2", "'j3\\nj4'"),
        ("{mp1: [0.1", '{"mp1\\e[2J": [0.1', "frames.measurement_points.mp1", "'mp1\\x1b[2J'"),
        ("name: a cell", 'name: "a\\u2028cell"', "name", "'a\\u2028cell'"),
        ("rated_load: 10", 'rated_load: 10\n  serial: "7\\t8"', "robot.serial", "'7\\t8'"),
        ("rated_load: 10", "rated_load: 10\n  gravity: [0, 0, -981]", "robot.gravity", "981 m/s²"),
        ("rated_load: 10", "rated_load: 10\n  gravity: [0, 0, 0]", "robot.gravity", "0 m/s²"),
        ("a: 0.45, ", "a: 0.45, theta: 90, ", "robot.dh.1.theta", "90"),
        ("[j1, j2, j3]", "[j1, j2, j3, j4]", "robot.dh", "3 entries"),
        ("[[-3, 3]", "[[3, -3]", "robot.joint_limits.0", "[3, -3]"),
        ("[[-3, 3]", "[[-170, 170]", "robot.joint_limits.0", "[-170, 170]"),
        ("  joint_limits: [[-3, 3], [-3, 3], [-3, 3]]\n", "", "robot.joint_limits", "nothing"),
        ("a: 0.45", "a: .inf", "robot.dh.1.a", "inf"),
        ("a: 0.45, ", "", "robot.dh.1.a", "nothing"),
        ("{mp1: [0.1, 0, 0], mp2: [0, 0.1, 0]}", "{}", "frames.measurement_points", "none"),
        ("[0.1, 0, 0]", "[0.1, 0]", "frames.measurement_points.mp1", "nothing"),
        ("sigma: 2.0e-5", "", "instruments.tracker", "no uncertainty"),
        ("sigma: 2.0e-5", "sigma_range: 1.0e-5", "instruments.tracker.sigma_angle", "nothing"),
        ("name: a cell", "name: a cell\npath: other", "path", "an unknown key"),
        ("name: a cell", "name: a cell\nname: twice", "", "key 'name' twice"),
        ("name: a cell", "name: [", "", ""),
        ("name: a cell", "safety: {speed_limit: 0.3, source: me}\nname: a cell", "safety.speed_limit", "0.3"),
        ("name: a cell", "safety: {speed_limit: 0, source: me}\nname: a cell", "safety.speed_limit", "0"),
        ("name: a cell", "safety: {speed_limit: 0.2}\nname: a cell", "safety.source", "nothing"),
        ("name: a cell", "safety: {source: me}\nname: a cell", "safety.speed_limit", "nothing"),
        ("name: a cell", "measurements: {points: relative}\nname: a cell", "measurements.points", "'relative'"),
    ],
)
def test_faults(tmp_path: Path, old: str, new: str, place: str, found: str) -> None:
    assert old in TEXT
    with pytest.raises(CellError) as caught:
        load(tmp_path, TEXT.replace(old, new, 1))
    assert caught.value.place.startswith(place)
    assert found in caught.value.found
    assert len(str(caught.value).splitlines()) == 1


def test_an_unknown_key_lists_the_choices(tmp_path: Path) -> None:
    with pytest.raises(CellError, match="expected one of name, source, note, robot"):
        load(tmp_path, TEXT + "colour: red\n")


def test_missing_file_and_directory(tmp_path: Path) -> None:
    for path in (tmp_path / "missing.yaml", tmp_path):
        with pytest.raises(CellError, match="a readable cell file"):
            load_cell(path)


def test_what_is_needed_and_missing(tmp_path: Path) -> None:
    cell = load(tmp_path, TEXT)
    error = cell.missing("frames.wrench_point", "the load")
    assert str(error).endswith("frames.wrench_point: found nothing, expected a value, needed for the load")


def test_all_faults_at_once_in_the_order_of_the_file(tmp_path: Path) -> None:
    text = TEXT.replace("a: 0.45", "a: long").replace("rated_load: 10", "rated_load: -1\n  colour: red")
    with pytest.raises(CellError) as caught:
        load(tmp_path, text.replace("{sigma: 2.0e-5}", "{}"))
    faults = [caught.value, *caught.value.further]
    assert [(fault.line, fault.place) for fault in faults] == [
        (4, "robot.dh.1.a"), (7, "robot.rated_load"), (8, "robot.colour"), (12, "instruments.tracker"),
    ]  # fmt: skip
    assert str(faults[0]).startswith(f"{tmp_path / 'cell.yaml'}:4:47: robot.dh.1.a: found 'long', expected")


def test_gravity_of_a_robot_on_the_wall(tmp_path: Path) -> None:
    cell = load(tmp_path, TEXT.replace("rated_load: 10", "rated_load: 10\n  gravity: [9.8, 0, 0]"))
    assert np.array_equal(cell.gravity, [9.8, 0, 0])


def test_a_model_in_the_place_of_the_cell_file_is_called_what_it_is(tmp_path: Path) -> None:
    path = tmp_path / "model.yaml"
    path.write_text("schema: 2\nrobot: small\nstiffness: {}\n")
    with pytest.raises(CellError) as caught:
        load_cell(path)
    assert str(caught.value).startswith(
        f"{path}:1:9: schema: found a model, plan or other result, expected a cell file"
    )
    assert caught.value.further == ()
