"""The newcomer's path, from a URDF and an exported table to stiffness and deflection, without an edit by hand."""

from __future__ import annotations

import os
import subprocess
import sys
import time
import venv
from pathlib import Path

import pytest
from newcomer import OPTIONS, exported, found, robot

from calibration_core.cli import main

ROOT = Path(__file__).resolve().parents[1]
SECONDS = 60.0  # the whole path, once the wheels are there


def path_of(folder: Path, table: Path) -> list[list[str]]:
    """Return what a newcomer types."""
    cell = str(folder / "my" / "cell.yaml")
    imported = folder / "imported" / "measurements.csv"
    place = ("--q", "0 -1 1.2 0 0.5 0", "--wrench", "0 0 -200 0 0 0", "--out", str(folder / "deflected"))
    return [
        ["check", cell, "--out", str(folder / "check")],
        ["import", str(table), "--out", str(folder / "imported")],
        ["check", cell, str(imported), "--out", str(folder / "check2"), "--no-report"],
        ["identify", str(imported), "--cell", cell, "--out", str(folder / "identified")],
        ["deflect", "--cell", cell, "--model", str(folder / "identified" / "model.yaml"), *place],
    ]


def test_from_a_urdf_and_an_exported_table_to_stiffnesses(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "rb25.urdf").write_text(robot())
    assert main(["init", str(tmp_path / "rb25.urdf"), *OPTIONS, "--out", str(tmp_path / "my")]) == 0
    assert f"next: calibration check {tmp_path / 'my' / 'cell.yaml'}" in capsys.readouterr().out
    table = exported(tmp_path, tmp_path / "my" / "cell.yaml", simulated)
    begin = time.monotonic()
    for words in path_of(tmp_path, table):
        assert main(words) == 0, (words, capsys.readouterr())
    assert time.monotonic() - begin < SECONDS
    assert max(abs(error) for error in found(tmp_path / "identified")) < 4.0
    assert "Recording: 168 readings, 14 configurations, 3 targets, with wrench" in capsys.readouterr().out


def simulated(cell: Path, plan: Path, out: Path) -> None:
    assert (
        main(["simulate", "--cell", str(cell), "--plan", str(plan), "--seed", "5", "--no-report", "--out", str(out)])
        == 0
    )


@pytest.mark.slow
def test_the_same_with_what_pip_installs(tmp_path: Path) -> None:
    """A wheel in a fresh environment: no path into the sources, no ROS, no compiler."""
    wheels = tmp_path / "wheels"
    run(
        [sys.executable, "-m", "pip", "wheel", "-q", "--no-deps", "-w", str(wheels), str(ROOT / "src/calibration_core")]
    )
    venv.create(tmp_path / "venv", with_pip=True)
    python = tmp_path / "venv" / "bin" / "python"
    (wheel,) = wheels.glob("calibration_core-*.whl")
    constraints = ROOT / ".ci" / "constraints.txt"
    begin = time.monotonic()
    run([str(python), "-m", "pip", "install", "-q", "--only-binary", ":all:", "-c", str(constraints), str(wheel)])
    program = str(tmp_path / "venv" / "bin" / "calibration")
    (tmp_path / "rb25.urdf").write_text(robot())
    run([program, "init", str(tmp_path / "rb25.urdf"), *OPTIONS, "--out", str(tmp_path / "my")])
    run([program, "init", "kr16-2", "--out", str(tmp_path / "library")])
    used = time.monotonic() - begin

    def simulate(cell: Path, plan: Path, out: Path) -> None:
        run(
            [
                program,
                "simulate",
                "--cell",
                str(cell),
                "--plan",
                str(plan),
                "--seed",
                "5",
                "--no-report",
                "--out",
                str(out),
            ]
        )

    table = exported(tmp_path, tmp_path / "my" / "cell.yaml", simulate)
    begin = time.monotonic()
    for words in path_of(tmp_path, table):
        run([program, *words])
    used += time.monotonic() - begin
    print(f"pip install, init, check, import, identify, deflect: {used:.1f} s")
    assert used < SECONDS
    assert max(abs(error) for error in found(tmp_path / "identified")) < 4.0


def run(words: list[str]) -> None:
    clean = {key: value for key, value in os.environ.items() if not key.startswith(("PYTHON", "AMENT", "ROS"))}
    done = subprocess.run(words, capture_output=True, text=True, timeout=600, check=False, env=clean)
    assert done.returncode == 0, (words, done.stdout, done.stderr)
