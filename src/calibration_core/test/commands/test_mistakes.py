"""Mistakes of a tired engineer: each ends with exit code 2 and one line that says file, place, found and expected."""

from __future__ import annotations

import os
import re
import signal
from collections.abc import Iterator
from pathlib import Path

import pytest
from program import CELL, WRENCH, names, rewritten, run

from calibration_core.cli import main
from calibration_core.errors import RecordingError
from calibration_core.fleet.recordings.inputs import input_file

ROOT = Path(__file__).resolve().parents[4]
ANGLES = "0.1 0.5 0.2 0.3 0.7 0.1"
TASK = "q1,q2,q3,q4,q5,q6,fx,fy,fz,tx,ty,tz\n0.1,0.5,0.2,0.3,0.7,0.1,50,0,-60,0,0,1\n"


def refused(capsys: pytest.CaptureFixture[str], tmp_path: Path, *arguments: object) -> str:
    """Run a command that cannot be done; return its line."""
    out = tmp_path / "out"
    before = names(tmp_path)
    capsys.readouterr()
    try:
        code = run(*arguments, *(() if "--out" in arguments else ("--out", out)))
    except SystemExit as end:
        code = end.code
    line = capsys.readouterr().err
    assert code == 2, line
    assert line.count("\n") == 1
    assert ": found " in line
    assert ", expected " in line
    assert names(tmp_path) == before
    return line


def stated(path: Path, text: str) -> Path:
    path.write_text(text, encoding="utf-8")
    return path


@pytest.mark.parametrize(
    ("arguments", "place", "found", "expected"),
    [
        (("plan", "--configurations", "12,5"), "--configurations", "'12,5'", "a whole number"),
        (("plan", "--load-levels", "0,5"), "--load-levels", "'0,5'", "a number, with a decimal point"),
        (("plan", "--box", "1", "2"), "--box", "another number of values", "6 values"),
        (("plan", "--seed"), "--seed", "another number of values", "one value"),
        (("predict", "x.csv"), "--model", "nothing", "a value"),
        (("predict", "x.csv", "y.csv", "--model", "m.yaml"), "", "'y.csv'", "arguments as in"),
        (("simulate", "--seed", "1,5"), "--seed", "'1,5'", "an integer of at least 0"),
        (("simulate", "--seed", "1", "--seed", "2"), "--seed", "the option twice", "one --seed"),
        (("plan", "--cell", CELL), "--cell", "the option twice", "one --cell"),
    ],
)
def test_arguments_are_named_with_what_was_found_and_expected(
    arguments: tuple[object, ...], place: str, found: str, expected: str,
    tmp_path: Path, capsys: pytest.CaptureFixture[str],
) -> None:  # fmt: skip
    line = refused(capsys, tmp_path, *arguments, "--cell", CELL)
    start = (
        f"calibration {arguments[0]}: {place}: found {found}" if place else f"calibration {arguments[0]}: found {found}"
    )
    assert line.startswith(start)
    assert f", expected {expected}" in line
    assert line.count("expected") == 1


def test_options_that_may_be_repeated_are_not_refused() -> None:
    with pytest.raises(SystemExit) as end:
        main(["identify", "--cell", "a.yaml", "--cell", "b.yaml", "--readmit", "1:2:p", "--readmit", "1:3:p", "--help"])
    assert end.value.code == 0


@pytest.mark.parametrize("command", ["predict", "deflect", "export"])
def test_an_output_folder_that_is_a_file_is_refused_before_anything_is_computed(
    command: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Neither cell nor model exist: the folder is what is looked at first."""
    out = stated(tmp_path / "results", "a file")
    further = {"predict": ("x.csv",), "deflect": ("--q", ANGLES), "export": ("--format", "dh")}[command]
    line = refused(capsys, tmp_path, command, *further, "--cell", "no.yaml", "--model", "no.yaml", "--out", out)
    assert line == f"{out}: found a file, expected a directory for the results\n"
    line = refused(capsys, tmp_path, command, *further, "--cell", "no.yaml", "--model", "no.yaml", "--out", out / "in")
    assert line == f"{out / 'in'}: found a file, {out}, above it, expected a directory for the results\n"


@pytest.mark.parametrize("command", [("plan",), ("simulate", "--plan"), ("export", "--format", "dh", "--model")])
def test_an_empty_file_is_said_to_hold_nothing(
    command: tuple[str, ...], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    empty = stated(tmp_path / "empty.yaml", "")
    file = (empty,) if len(command) > 1 else ()
    line = refused(capsys, tmp_path, *command, *file, "--cell", CELL if file else empty)
    assert line.startswith(f"{empty}: found nothing, expected ")


def test_a_directory_where_a_file_is_meant(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    line = refused(capsys, tmp_path, "plan", "--cell", ROOT)
    assert line == f"{ROOT}: found a directory, expected a readable cell file (YAML)\n"


@pytest.fixture
def in_time() -> Iterator[None]:
    """End a test that waits for ever."""

    def end(*_: object) -> None:
        raise TimeoutError

    before = signal.signal(signal.SIGALRM, end)
    signal.alarm(30)
    yield
    signal.alarm(0)
    signal.signal(signal.SIGALRM, before)


TABLE, MODEL = "{simulated}/measurements.csv", "{identified}/model.yaml"
PIPES = [
    ("plan", "--cell", CELL, "--task", "pipe.csv"),
    ("plan", "--cell", CELL, "--population", "pipe.yaml"),
    ("plan", "--cell", CELL, "--model", "pipe.yaml"),
    ("simulate", "--cell", CELL, "--plan", "pipe.yaml"),
    ("identify", "pipe.csv", "--cell", CELL),
    ("identify", "pipe.db3", "--cell", CELL),
    ("identify", "session", "--cell", CELL),
    ("identify", TABLE, "--cell", "pipe.yaml"),
    ("identify", TABLE, "--cell", CELL, "--test", "pipe.csv"),
    ("diagnose", TABLE, "--cell", CELL, "--simulation", "pipe.csv"),
    ("predict", "pipe.csv", "--cell", CELL, "--model", MODEL),
    ("verify", TABLE, "--cell", CELL, "--model", "pipe.yaml", "--tolerance", 1e-3),
    ("compare", TABLE, "pipe.csv", "--cell", CELL),
    ("deflect", "--cell", CELL, "--model", MODEL, "--poses", "pipe.csv", "--wrench", "0 0 -9 0 0 0"),
    ("compensate", "pipe.csv", "--cell", CELL, "--model", MODEL),
    ("export", "--cell", CELL, "--model", MODEL, "--format", "ur", "--template", "pipe.yaml"),
    ("init", "pipe.urdf", "--rated-load", 10),
    ("check", CELL, "pipe.csv"),
    ("import", "pipe.csv"),
    ("import", TABLE, "--map", "pipe.yaml"),
    ("fleet", "pipe.csv"),
]


@pytest.mark.usefixtures("in_time")
@pytest.mark.parametrize("arguments", PIPES, ids=lambda words: " ".join(str(word).split("/")[-1] for word in words))
def test_a_pipe_where_a_file_is_meant(
    arguments: tuple[object, ...], simulated: Path, identified: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """No command waits for somebody to write to it."""
    (tmp_path / "session").mkdir()
    for name in ("pipe.csv", "pipe.yaml", "pipe.urdf", "pipe.db3", "session/session.db"):
        os.mkfifo(tmp_path / name)
    placed = [
        tmp_path / word
        if isinstance(word, str) and word.startswith(("pipe.", "session"))
        else str(word).format(simulated=simulated, identified=identified)
        for word in arguments
    ]
    out = () if arguments[0] == "check" else ("--out", tmp_path / "out")
    assert run(*placed, *out) == 2
    printed = capsys.readouterr()
    (line,) = [text for text in (printed.out + printed.err).splitlines() if "found no regular file" in text]
    assert ", expected " in line
    assert not (tmp_path / "out").exists()


@pytest.mark.usefixtures("in_time")
@pytest.mark.parametrize("command", ["check", "plan"])
def test_a_pipe_as_the_urdf_of_a_cell(command: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    os.mkfifo(tmp_path / "pipe.urdf")
    demo = (CELL.parent / "demo.cell.yaml").read_text(encoding="utf-8")
    text = re.sub(r"urdf: \S+", "urdf: pipe.urdf", demo)
    cell = stated(tmp_path / "cell.yaml", text)
    words = ("check", cell) if command == "check" else ("plan", "--cell", cell, "--out", tmp_path / "out")
    assert run(*words) == 2
    printed = capsys.readouterr()
    assert "pipe.urdf: found no regular file, expected a readable URDF" in printed.out + printed.err


@pytest.mark.usefixtures("in_time")
def test_a_pipe_in_a_plant_is_a_recording_that_cannot_be_used(tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "pipe.csv")
    with pytest.raises(RecordingError, match=r"pipe\.csv: found no regular file, expected a recording"):
        input_file(str(tmp_path / "pipe.csv"))


def test_describe_of_what_is_no_json(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert run("describe", CELL) == 2
    assert capsys.readouterr().err == f"{CELL}:1:1: found no JSON, expected result.json of schema 1\n"


def test_init_of_what_is_no_robot(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert refused(capsys, tmp_path, "init", CELL).startswith(f"{CELL}: found no URDF, expected a URDF, a bag with ")
    assert refused(capsys, tmp_path, "init", "ur11").startswith("ur11: found neither a file nor a robot of the library")


@pytest.mark.parametrize(
    "option",
    [("--wrench", "0,5 1,5 2,5"), ("--payload", "1,5 0,2"), ("--q", "0,1 0,5 0,2"), ("--wrench", "0.5 1,5 2 3 4 5")],
)
def test_a_decimal_comma_is_no_separator(
    option: tuple[str, str], identified: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Six numbers may be three with decimal commas: where blanks separate, commas do not."""
    given = {"--q": ANGLES, "--wrench": "0 0 -50 0 0 0", **dict([option])}
    options = [word for pair in given.items() for word in pair]
    line = refused(capsys, tmp_path, "deflect", "--cell", CELL, "--model", identified / "model.yaml", *options)
    assert line.startswith(f"{option[0]}: found '{option[1]}', expected ")
    assert "decimal point" in line


def test_commas_between_numbers_separate_them(identified: Path, tmp_path: Path) -> None:
    options = ("--q", "0.1,0.5,0.2,0.3,0.7,0.1", "--wrench", "0, 0, -50, 0, 0, 0", "--no-report")
    assert (
        run("deflect", "--cell", CELL, "--model", identified / "model.yaml", *options, "--out", tmp_path / "out") == 0
    )


@pytest.mark.parametrize("command", ["deflect", "compensate"])
def test_a_task_from_a_spreadsheet_is_refused_by_its_separator(
    command: str, identified: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    task = stated(tmp_path / "task.csv", "\ufeff" + TASK.replace(",", ";").replace(".", ",").replace("\n", "\r\n"))
    file = (task,) if command == "compensate" else ("--poses", task)
    line = refused(capsys, tmp_path, command, *file, "--cell", CELL, "--model", identified / "model.yaml")
    assert line == (
        f"{task}: line 1: found columns separated by semicolons, expected columns separated by commas, and numbers "
        "with a decimal point\n"
    )


@pytest.mark.parametrize(
    ("options", "words"),
    [
        (
            ("--tolerance", "0.1"),
            "verify: --tolerance: found 0.1 m, which is 100 mm, expected a length in m above zero",
        ),
        *(
            (
                (f"--tolerance={text}",),
                f"verify: --tolerance: found {text} m, expected a length in m above zero and below",
            )
            for text in ("0", "-0.0001", "nan", "inf")
        ),
    ],
)
def test_a_tolerance_in_millimetres(
    options: tuple[str, ...], words: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    line = refused(capsys, tmp_path, "verify", "x.csv", "--cell", CELL, "--model", "m.yaml", *options)
    assert line.startswith(words)


def test_a_centre_of_gravity_in_millimetres(
    identified: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    options = ("--q", ANGLES, "--wrench", "0 0 -50 0 0 0", "--payload", "2 0 0 300")
    line = refused(capsys, tmp_path, "deflect", "--cell", CELL, "--model", identified / "model.yaml", *options)
    assert line.startswith("--payload: found '2 0 0 300', expected ")
    assert "at most 10 m away" in line


def test_steps_without_a_wrench_are_readings_at_rest(simulated: Path, tmp_path: Path) -> None:
    """Where wrench columns are absent there is no external load, whatever the steps."""
    table = simulated / "measurements.csv"
    rewritten(table, tmp_path / "rest.csv", lambda row: {k: v for k, v in row.items() if k not in WRENCH})
    for command in ("identify", "diagnose"):
        assert run(command, tmp_path / "rest.csv", "--cell", CELL, "--no-report", "--out", tmp_path / command) == 0


def test_a_bag_without_the_wrench_topic_that_the_cell_file_names(
    simulated: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Its loads stand on another topic: it is evaluated as a recording at rest, and that is said."""
    cell = stated(tmp_path / "cell.yaml", f"{CELL.read_text(encoding='utf-8')}\ntopics: {{wrench: /sensor/wrench}}\n")
    words = (
        "note: /sensor/wrench: no messages, but geometry_msgs/msg/WrenchStamped on /force_torque/wrench: no load is "
        "read (topics of the cell file)"
    )
    assert run("identify", simulated / "recording", "--cell", cell, "--no-report", "--out", tmp_path / "out") == 0
    assert words in capsys.readouterr().out


@pytest.mark.parametrize("command", ["identify", "diagnose"])
def test_the_same_readings_twice_are_one_recording(
    command: str, simulated: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """A copy saved with other line ends, or the bag beside its table, says nothing new, and tests nothing."""
    table, bag, copy = simulated / "measurements.csv", simulated / "recording", tmp_path / "copy.csv"
    copy.write_bytes(table.read_bytes().replace(b"\n", b"\r\n"))
    line = refused(capsys, tmp_path, command, table, copy, "--cell", CELL)
    assert f"{copy}: found" in line or f"{table}: found" in line
    assert "readings that are those of" in line
    assert line.endswith("expected every recording once\n")
    for fitted, test in ((bag, table), (table, bag)):
        assert run(command, fitted, "--test", test, "--cell", CELL, "--out", tmp_path / "out") == 2
        assert "which is fitted" in capsys.readouterr().err
