"""Zeros have no sign in any file or text, and cells that a spreadsheet would compute stay text."""

import json
import math
import re
from pathlib import Path

import numpy as np
import pytest

from calibration_core.cli import main
from calibration_core.files.written import csv_bytes, json_bytes, number, numbers
from calibration_core.files.yaml_file import read_yaml, yaml_text

ROOT = Path(__file__).resolve().parents[4]
SMALL = ROOT / "config/cells/small.cell.yaml"
SIGNED_ZERO = re.compile(r"(?<![\w.+−-])[-−]0(?:\.0*)?(?:[eE][-+]?\d+)?(?![\w.])")


@pytest.mark.parametrize("zero", [0.0, -0.0, np.float64(-0.0)])
def test_a_zero_has_no_sign(tmp_path: Path, zero: float) -> None:
    assert number(zero) == "0.0"
    assert numbers([zero, 1.5]) == "0.0 1.5"
    assert json.loads(json_bytes({"a": [zero, {"b": zero}]}).decode()) == {"a": [0.0, {"b": 0.0}]}
    assert b"-" not in json_bytes({"a": [zero, {"b": (zero,)}]})
    assert csv_bytes(["x"], [[zero]]) == b"x\n0.0\n"
    (tmp_path / "a.yaml").write_text(yaml_text({"a": [float(zero)], "b": float(zero)}, flow=None), encoding="utf-8")
    read = read_yaml(tmp_path / "a.yaml", 100, "file").data
    assert [math.copysign(1.0, value) for value in (*read["a"], read["b"])] == [1.0, 1.0]


def test_other_numbers_are_read_back_to_the_bit(tmp_path: Path) -> None:
    values = [*np.random.default_rng(1).normal(size=20).tolist(), 5e-324, -5e-324, 1e300, -1e-9]
    assert [float(number(value)) for value in values] == values
    (tmp_path / "a.yaml").write_text(yaml_text(values), encoding="utf-8")
    assert read_yaml(tmp_path / "a.yaml", 10_000, "file").data == values


def test_cells_are_inert_and_what_is_not_known_is_empty() -> None:
    rows = [["=1+1", math.nan, -2.0, 3, "-4.5"]]
    assert csv_bytes(["a", "b", "c", "d", "e"], rows) == b"a,b,c,d,e\n'=1+1,,-2.0,3,-4.5\n"


def test_no_command_writes_or_says_a_signed_zero(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Every command that writes numbers of its own, on one small cell with turned frames."""
    cell = ["--cell", str(SMALL), "--no-report"]
    model = ["--model", str(tmp_path / "identify/model.yaml")]
    (tmp_path / "task.csv").write_text("q1,q2,q3,q4,q5,q6,time\n0.1,-1.2,0.9,0,0.5,0,0\n0.2,-1.2,0.9,0,0.5,0,9\n")
    pull = ["--wrench", "0 0 -50 0 0 0"]
    runs = [
        ["plan", *cell],
        ["simulate", *cell, "--plan", str(tmp_path / "plan/plan.yaml"), "--seed", "1"],
        ["identify", str(tmp_path / "simulate/measurements.csv"), *cell],
        ["predict", str(tmp_path / "simulate/measurements.csv"), *cell, *model],
        ["deflect", *cell, *model, "--q", "0 -1.2 0.9 0 0.5 0", *pull],
        ["compensate", str(tmp_path / "task.csv"), *cell, *model, *pull],
        *(["export", *cell[:2], *model, "--format", kind] for kind in ("dh", "urdf", "mjcf", "table")),
    ]
    for run in runs:
        out = tmp_path / (run[0] if run[0] != "export" else run[-1])
        joints = ["--joints", "2", "3", "--points", "3"] if run[-1] == "table" else []
        assert main([*run, *joints, "--out", str(out)]) == 0, capsys.readouterr().err
        _without_signed_zeros("what it says", capsys.readouterr().out)
        written = [path for path in out.rglob("*") if path.suffix in {".json", ".yaml", ".csv", ".urdf", ".xml"}]
        assert (out / "result.json") in written
        for path in written:
            _without_signed_zeros(str(path), path.read_text(encoding="utf-8"))


def _without_signed_zeros(what: str, text: str) -> None:
    found = SIGNED_ZERO.search(text)
    assert found is None, f"{what}: {text[max(found.start() - 60, 0) : found.end() + 20]!r}"
