"""An output folder: no command takes away what it reads, or what it did not write; its own results it replaces."""

from __future__ import annotations

import shutil
from collections.abc import Callable
from pathlib import Path

import pytest
from program import CELL, run

import calibration_core as cal
from calibration_core.errors import OutputError
from calibration_core.report.writing.output import WRITTEN, made_by
from calibration_core.report.writing.ownership import refuse_inputs, require_own


def everything(folder: Path) -> dict[str, bytes]:
    """Return every file below a folder: name -> content."""
    return {str(path.relative_to(folder)): path.read_bytes() for path in folder.rglob("*") if path.is_file()}


@pytest.fixture
def refused(capsys: pytest.CaptureFixture[str]) -> Callable[..., str]:
    """Run the program; it must end with 2 and one line, and leave a folder as it was."""

    def refused(folder: Path, *arguments: object) -> str:
        before = everything(folder)
        capsys.readouterr()
        assert run(*arguments) == 2
        error = capsys.readouterr().err
        assert error.count("\n") == 1
        assert everything(folder) == before
        return error

    return refused


def test_a_command_leaves_recordings_of_another_and_its_own_input_alone(
    simulated: Path, identified: Path, tmp_path: Path, refused: Callable[..., str]
) -> None:
    shutil.copytree(simulated, tmp_path / "s")
    error = refused(tmp_path, "identify", tmp_path / "s" / "recording", "--cell", CELL, "--out", tmp_path / "s")
    assert "an input of this command" in error
    other = simulated / "recording"
    assert "recordings of calibration simulate" in refused(
        tmp_path, "identify", other, "--cell", CELL, "--out", tmp_path / "s"
    )
    shutil.copytree(identified, tmp_path / "t")
    model = tmp_path / "t" / "model.yaml"
    error = refused(tmp_path, "predict", other, "--cell", CELL, "--model", model, "--out", tmp_path / "t")
    assert error.startswith(f"{model}: found an input of this command")


def test_a_command_replaces_the_results_of_another(simulated: Path, identified: Path, tmp_path: Path) -> None:
    """Results can be made again from their inputs; the folder then holds one whole result."""
    out = tmp_path / "t"
    shutil.copytree(identified, out)
    model, recording = identified / "model.yaml", simulated / "measurements.csv"
    assert run("predict", recording, "--cell", CELL, "--model", model, "--no-report", "--out", out) == 0
    assert made_by(out) == "predict"
    assert not (out / "model.yaml").exists()


def test_the_same_command_leaves_its_input_alone(
    planned: Path, simulated: Path, identified: Path, tmp_path: Path, refused: Callable[..., str]
) -> None:
    """Even in a folder of its own results: there the input would be taken for one of them."""
    shutil.copytree(identified, tmp_path / "t")
    model, table = tmp_path / "t" / "model.yaml", simulated / "measurements.csv"
    error = refused(tmp_path, "identify", table, "--cell", CELL, "--model", model, "--out", tmp_path / "t")
    assert error.startswith(f"{model}: found an input of this command")
    shutil.copytree(simulated, tmp_path / "s")
    shutil.copy(planned / "plan.yaml", tmp_path / "s")
    plan = tmp_path / "s" / "plan.yaml"
    assert str(plan) in refused(tmp_path, "simulate", "--cell", CELL, "--plan", plan, "--out", tmp_path / "s")
    (tmp_path / "i").mkdir()
    table = shutil.copy(table, tmp_path / "i" / "measurements.csv")
    assert str(table) in refused(tmp_path, "import", table, "--out", tmp_path / "i")


@pytest.mark.parametrize(
    ("command", "given"),
    [
        ("simulate", "recording/a.mcap"),
        ("simulate", "recording"),
        ("plan", "table1.csv"),
        ("fleet", "ranking.csv"),
        ("init", "robot.urdf"),
        ("export", "kinematics.yaml"),
    ],
)
def test_inputs_are_known_by_any_name(command: str, given: str, tmp_path: Path) -> None:
    out, away = tmp_path / "out", tmp_path / "away"
    (out / given).parent.mkdir(parents=True)
    (out / given).touch()
    away.mkdir()
    (tmp_path / "link").symlink_to(out / given)
    for name in (out / given, away / ".." / "out" / given, tmp_path / "link"):
        with pytest.raises(OutputError, match="an input of this command"):
            refuse_inputs(out, command, [name])
    refuse_inputs(away, command, [out / given])
    refuse_inputs(out, command, [out / "other" / given, tmp_path / "gone", Path("a\0b")])


@pytest.mark.parametrize("command", sorted(WRITTEN))
def test_files_of_others_are_never_replaced(command: str, tmp_path: Path) -> None:
    """Whatever a command writes: a name that stands already is its own only with its result beside."""
    for name in WRITTEN[command] - {"result.json"}:
        out = tmp_path / name
        out.mkdir()
        (out / name).write_text("{}")
        (out / "notes.txt").touch()
        with pytest.raises(OutputError, match=f"{name}: found a file that calibration {command} did not write"):
            require_own(out, command)
        (out / "result.json").write_text(f'{{"schema": 1, "command": "{command}"}}')
        require_own(out, command)
    (tmp_path / "notes").mkdir()
    (tmp_path / "notes" / "notes.txt").touch()
    require_own(tmp_path / "notes", command)
    require_own(tmp_path / "gone", command)


def test_a_foreign_file_is_refused_before_anything_is_computed(
    simulated: Path, tmp_path: Path, refused: Callable[..., str]
) -> None:
    table, cell = simulated / "measurements.csv", ("--cell", CELL)
    cases: dict[str, tuple[object, ...]] = {
        "robot.urdf": ("init", "ur5e"),
        "measurements.csv": ("import", table),
        "plan.yaml": ("plan", *cell),
        "report.pdf": ("identify", table, *cell),
        "residuals.csv": ("diagnose", table, *cell),
    }
    for name, words in cases.items():
        out = tmp_path / str(words[0])
        out.mkdir()
        (out / name).write_text("mine")
        assert str(out / name) in refused(tmp_path, *words, "--out", out)


def test_a_result_in_memory_is_not_saved_over_others(simulated: Path, tmp_path: Path) -> None:
    found = cal.identify(cal.load_recording(simulated / "measurements.csv", cal.load_cell(CELL)))
    found.save(tmp_path, report=False)
    found.save(tmp_path, report=False)
    (tmp_path / "result.json").unlink()
    with pytest.raises(OutputError, match=r"model\.yaml"):
        found.save(tmp_path, report=False)


def test_the_urdf_of_the_cell_is_an_input_of_export(
    identified: Path, tmp_path: Path, refused: Callable[..., str]
) -> None:
    out, export = tmp_path / "out", ("export", "--model", identified / "model.yaml", "--format", "urdf")
    assert run(*export, "--cell", CELL, "--out", out) == 0
    assert run("init", out / "robot.urdf", "--rated-load", 10, "--out", tmp_path / "my") == 0
    shutil.copy(tmp_path / "my" / "cell.yaml", out)  # it names robot.urdf beside it
    error = refused(tmp_path, *export, "--cell", out / "cell.yaml", "--out", out)
    assert f"{out / 'robot.urdf'}: found an input of this command" in error
