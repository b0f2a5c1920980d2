"""`deflect` and `compensate` as users run them."""

from __future__ import annotations

import csv
from pathlib import Path

import numpy as np
import pytest
import yaml
from program import result_of, run

ROOT = Path(__file__).resolve().parents[4]
CELL = ROOT / "config/cells/small.cell.yaml"
ANGLES = "0.1 0.5 0.2 0.3 0.7 0.1"
TASK = (
    "q1,q2,q3,q4,q5,q6,fx,fy,fz,tx,ty,tz,path\n"
    "0.1,0.5,0.2,0.3,0.7,0.1,50,0,-60,0,0,1,a\n"
    "0.12,0.5,0.2,0.3,0.7,0.1,50,0,-60,0,0,1,a\n"
    "0.1,0.5,0.2,0.3,0.0,0.1,50,0,-60,0,0,1,\n"
)


@pytest.fixture(scope="module")
def model(tmp_path_factory: pytest.TempPathFactory) -> Path:
    out = tmp_path_factory.mktemp("identified")
    assert run("identify", ROOT / "bags/small_loaded", "--cell", CELL, "--out", out, "--no-report") == 0
    return out / "model.yaml"


def test_deflect(model: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    options = ("--cell", CELL, "--model", model, "--out", tmp_path / "out")
    assert run("deflect", *options, "--q", ANGLES, "--wrench", "50 0 -60 0 0 1") == 0
    result = result_of(tmp_path / "out")
    points = {row["point"]: row for row in result["deflections"]}
    assert list(points) == ["tool", "mp1", "mp2", "mp3"]
    assert points["tool"]["moved"][2] < 0
    assert all(0 < u < 1e-3 for u in points["tool"]["u95"])
    spring = result["stiffness_ellipsoid"][0]
    assert 0 < spring["stiffness"][0] < spring["stiffness"][2]
    with (tmp_path / "out" / "deflections.csv").open() as file:
        rows = list(csv.DictReader(file))
    assert [float(rows[0][name]) for name in ("dx", "dy", "dz", "rx", "ry", "rz")] == points["tool"]["moved"]
    assert result["outside_valid_range"] == {"load": [1]}  # by the torque
    assert "beyond the model's valid range (load): 1 row\n" in capsys.readouterr().out
    page = (tmp_path / "out" / "report.html").read_text(encoding="utf-8")
    assert "Stiffness of the tool" in page
    assert "Deflection of the tool over the xz plane" in page
    assert page.count("<figure") == page.count("<img") == 1  # the map


def test_numbers_may_begin_with_a_minus_and_stand_between_commas(model: Path, tmp_path: Path) -> None:
    options = ("--cell", CELL, "--model", model, "--out", tmp_path / "out", "--no-report")
    assert run("deflect", *options, "--q", "-0.1,0.5,0.2,0.3,0.7,-.1", "--wrench", "-50,0,-60,0,0,1") == 0
    assert result_of(tmp_path / "out")["deflections"][0]["point"] == "tool"


def test_compensate(model: Path, tmp_path: Path) -> None:
    (tmp_path / "task.csv").write_text(TASK)
    options = ("--cell", CELL, "--model", model, "--out", tmp_path / "out")
    assert run("compensate", tmp_path / "task.csv", *options) == 0
    result = result_of(tmp_path / "out")
    assert (result["rows"], result["compensated"]) == (3, 2)
    assert result["refused"] == [{"row": 3, "reason": "near a singularity"}]
    assert 0 < result["u95"]["mean"] < 1e-3
    trajectory = yaml.safe_load((tmp_path / "out" / "trajectory.yaml").read_text())
    with (tmp_path / "out" / "compensated.csv").open() as file:
        rows = list(csv.DictReader(file))
    assert [float(rows[1][f"q{j}"]) for j in range(1, 7)] == trajectory["points"][1]["positions"]
    assert "near a singularity" in (tmp_path / "out" / "report.html").read_text(encoding="utf-8")
    # what is sent, deflects to where it should be: the corrected angles under the load
    assert (
        run(
            "deflect",
            *options,
            "--q",
            " ".join(rows[0][f"q{j}"] for j in range(1, 7)),
            "--wrench",
            "50 0 -60 0 0 1",
            "--no-report",
        )
        == 0
    )
    assert np.isfinite(result_of(tmp_path / "out")["largest"]["value"])


@pytest.mark.parametrize(
    ("options", "words"),
    [
        (("deflect", "--wrench", "1 2 3 0 0 0"), "--q"),
        (("deflect", "--q", ANGLES), "--wrench"),
        (("deflect", "--q", ANGLES, "--wrench", "1 2 3"), "--wrench"),
        (("deflect", "--q", "1 2", "--wrench", "1 2 3 0 0 0"), "--q"),
        (("deflect", "--q", "9 9 9 9 9 9", "--wrench", "1 2 3 0 0 0"), "beyond the limits"),
        (("compensate", "task.csv", "--payload", "-1 0 0 0"), "--payload"),
        (("compensate", "task.csv", "--seed-q", "a b"), "--seed-q"),
        (("compensate", "nothing.csv"), "nothing.csv"),
        (("compensate", "fast.csv"), "fast.csv: line 3: found"),
        (("compensate", "degrees.csv"), "degrees.csv: line 2: found joint_2 at 45"),
        (("compensate", "back.csv"), "back.csv: line 3, column time: found 1 s, expected more than 2 s of line 2"),
        (("deflect", "--poses", "degrees.csv", "--wrench", "1 2 3 0 0 0"), "degrees.csv: line 2: found joint_2 at 45"),
        (("deflect", "--q", ANGLES, "--wrench", "0 0 -9999 0 0 0"), "--wrench: found load beyond the rated load"),
        (("deflect", "--q", ANGLES, "--wrench", "0 0 -1 0 0 0", "--payload", "999 0 0 0"), "beyond the rated load"),
    ],
)
def test_what_cannot_be_used_is_named(
    options: tuple[str, ...],
    words: str,
    model: Path,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "task.csv").write_text(TASK)
    head, row = "q1,q2,q3,q4,q5,q6,time", "0.5,0.2,0.3,0.7,0.1"
    (tmp_path / "fast.csv").write_text(f"{head}\n0.1,{row},0\n0.5,{row},1\n")
    (tmp_path / "back.csv").write_text(f"{head}\n0.1,{row},2\n0.1,{row},1\n")
    (tmp_path / "degrees.csv").write_text(f"{head}\n0,45,0,0,45,0,1\n")
    assert run(*options, "--cell", CELL, "--model", model, "--out", tmp_path / "out") == 2
    error = capsys.readouterr().err
    assert words in error
    assert len(error.strip().splitlines()) == 1
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize("command", ["deflect", "compensate"])
def test_a_wrench_for_all_rows_beside_wrenches_in_the_file_is_said(
    command: str, model: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """`--wrench` holds for all rows; that the file's own are not used is a remark."""
    (tmp_path / "task.csv").write_text("".join(TASK.splitlines(keepends=True)[:3]))
    file = ("--poses", tmp_path / "task.csv") if command == "deflect" else (tmp_path / "task.csv",)
    options = ("--cell", CELL, "--model", model, "--no-report", "--out", tmp_path / "out")
    remark = (
        f"The wrenches of {tmp_path / 'task.csv'} (columns fx ... tz) were not used in 2 of 2 rows: the one that was "
        "given for all rows, 10 0 -30 0 0 0, holds."
    )
    for wrench, said in (("10 0 -30 0 0 0", True), ("50 0 -60 0 0 1", False)):
        assert run(command, *file, *options, "--wrench", wrench) == 0
        assert (remark in result_of(tmp_path / "out")["remarks"]) is said
        assert capsys.readouterr().out.count(remark) == said


def test_a_deflection_is_against_the_robot_with_its_payload(
    identified: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """What the payload does is no part of the answer; help, summary, result and report say so."""
    arguments = ("--cell", CELL, "--model", identified / "model.yaml", "--q", ANGLES, "--wrench", "50 0 -30 0 0 0")
    words = "What the load does is against the robot under its own weight and that of its payload of 3 kg"
    moved = []
    for name, more in (("bare", ()), ("loaded", ("--payload", "3 0 0 0.1"))):
        assert run("deflect", *arguments, *more, "--out", tmp_path / name) == 0
        assert (words in capsys.readouterr().out) == bool(more)
        result = result_of(tmp_path / name)
        assert any(words in remark for remark in result["remarks"]) == bool(more)
        page = " ".join((tmp_path / name / "report.html").read_text("utf-8").replace("\u00a0", " ").split())
        payload = " and that of its payload of 3 kg" if more else ""
        assert f"against the robot under its own weight{payload}; intervals" in page
        moved.append(np.array(result["deflections"][0]["moved"]))
    assert np.linalg.norm(moved[1] - moved[0]) < 0.02 * np.linalg.norm(moved[0])  # 3 kg alone do far more
    with pytest.raises(SystemExit):
        run("deflect", "--help")
    assert "no part of the answer" in " ".join(capsys.readouterr().out.split())
