"""How commands end: exit code and one line, whatever happens; the earlier result stays whole."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
import warnings
from pathlib import Path

import pytest
from program import CELL, run

from calibration_core.commands.terminal import outcome

BAG = CELL.parents[2] / "bags" / "small_loaded"
SOURCE = Path("some.csv")
EARLIER = '{"schema": 1, "command": "diagnose"}'


@pytest.fixture
def out(tmp_path: Path) -> Path:
    folder = tmp_path / "out"
    folder.mkdir()
    (folder / "result.json").write_text(EARLIER)
    return folder


def everything(directory: Path) -> list[str]:
    return sorted(str(path.relative_to(directory)) for path in directory.rglob("*"))


def ending(out: Path, error: BaseException) -> int:
    def action() -> str:
        raise error

    return outcome.carry_out("identify", SOURCE, out, action)


def test_what_nobody_foresaw_is_one_line_and_a_file(out: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert ending(out, ZeroDivisionError("a\nb" * 1000)) == 1
    said = capsys.readouterr()
    assert said.out == ""
    assert len(said.err.splitlines()) == 1
    assert len(said.err) < 1000
    assert said.err.startswith("calibration identify: a defect of this program (ZeroDivisionError: a ba b")
    crash = out.with_name("out.crash.txt")
    assert str(crash) in said.err
    text = crash.read_text()
    assert "Traceback" in text
    assert "in action" in text
    assert everything(out.parent) == ["out", "out.crash.txt", "out/result.json"]
    assert outcome.carry_out("identify", SOURCE, out, lambda: "done") == 0
    assert not crash.exists()  # what has been put right says nothing more


def test_a_crash_file_finds_a_place(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "file").write_text("")
    monkeypatch.setattr(outcome.tempfile, "gettempdir", lambda: str(tmp_path))
    assert ending(tmp_path / "file" / "out", RecursionError()) == 1
    assert [path.suffix for path in tmp_path.iterdir() if path.name != "file"] == [".txt"]


@pytest.mark.parametrize(("error", "code", "word"), [
    (KeyboardInterrupt(), 130, "interrupted"), (outcome.Terminated(), 143, "terminated"),
    (MemoryError(), 1, "MemoryError"),
])  # fmt: skip
def test_other_endings(
    out: Path, capsys: pytest.CaptureFixture[str], error: BaseException, code: int, word: str
) -> None:
    assert ending(out, error) == code
    assert word in capsys.readouterr().err
    assert (out / "result.json").read_text() == EARLIER


def test_warnings_of_libraries_reach_nobody(out: Path, capfd: pytest.CaptureFixture[str]) -> None:
    def action() -> str:
        warnings.warn("divide by zero", RuntimeWarning, stacklevel=1)
        return "done"

    assert outcome.carry_out("identify", SOURCE, out, action) == 0
    assert capfd.readouterr() == ("done\n", "")


@pytest.mark.parametrize("arguments", [
    ("identify",), ("nonsense",), ("identify", "a.csv", "--cell", "c", "--nonsense"),
    ("plan", "--cell", "c", "--seed", "x"),
    ("plan", "--cell", "c", "--criterion", "Z" * 5000), ("plan", "--cell", "c", "--configurations", "\n\n"),
])  # fmt: skip
def test_arguments_that_make_no_sense_are_one_line(
    arguments: tuple[str, ...], capsys: pytest.CaptureFixture[str]
) -> None:
    with pytest.raises(SystemExit) as caught:
        run(*arguments)
    assert caught.value.code == 2
    said = capsys.readouterr().err
    assert len(said.splitlines()) == 1
    assert len(said) < 1200
    assert "--help" in said


def program(*arguments: object, **options: object) -> subprocess.Popen[bytes]:
    command = [sys.executable, "-m", "calibration_core.cli", *map(str, arguments)]
    return subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, **options)  # type: ignore[call-overload]


def said_last(errors: bytes) -> list[str]:
    """Return the lines of a standard error that say more than how far a command is; slow ones say that, too."""
    return [line for line in errors.decode().splitlines() if not line.endswith("% done)")]


def heeds(process: subprocess.Popen[bytes], number: int) -> bool:
    """Say whether a process handles a signal already, however long the interpreter took to begin."""
    status = Path(f"/proc/{process.pid}/status").read_text()
    caught = next(line.split()[1] for line in status.splitlines() if line.startswith("SigCgt:"))
    return bool(int(caught, 16) >> (number - 1) & 1)


@pytest.fixture(scope="module")
def whole(tmp_path_factory: pytest.TempPathFactory) -> float:
    """How long a diagnosis takes that nobody ends, s."""
    begun = time.monotonic()
    process = program("diagnose", BAG, "--cell", CELL, "--out", tmp_path_factory.mktemp("whole") / "out")
    _, errors = process.communicate(timeout=60)
    assert process.returncode == 0, errors
    return time.monotonic() - begun


@pytest.mark.parametrize(
    ("number", "code", "shares"), [(signal.SIGINT, 130, (0.0, 0.4)), (signal.SIGTERM, 143, (0.2,))]
)
def test_signals_end_with_one_line_and_leave_the_earlier_result(
    out: Path, number: int, code: int, shares: tuple[float, ...], whole: float
) -> None:
    for delay in (share * whole for share in shares):  # after the start: well before the end
        process = program("diagnose", BAG, "--cell", CELL, "--out", out)
        while process.poll() is None and not heeds(process, signal.SIGTERM):  # the program's own handler
            time.sleep(0.01)
        time.sleep(delay)
        process.send_signal(number)
        _, errors = process.communicate(timeout=60)
        # Python itself ends by the signal where it arrived inside code made from text; a shell says 130 to both
        assert process.returncode in (code, -number), errors
        assert len(said_last(errors)) == 1
        assert everything(out.parent) == ["out", "out/result.json"]
        assert (out / "result.json").read_text() == EARLIER


@pytest.mark.parametrize(("number", "code"), [(signal.SIGINT, 130), (signal.SIGTERM, 143)])
def test_a_signal_while_the_program_is_being_loaded_is_one_line(number: int, code: int, tmp_path: Path) -> None:
    command = [sys.executable, "-m", "calibration_core.start", "init", "ur10e", "--out", str(tmp_path / "out")]
    process = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE)
    while process.poll() is None and not heeds(process, signal.SIGTERM):  # nothing is loaded yet
        time.sleep(0.001)
    process.send_signal(number)
    said, errors = process.communicate(timeout=60)
    assert process.returncode == code, errors
    assert said == b""
    assert len(errors.decode().splitlines()) == 1
    assert everything(tmp_path) == []


def test_an_error_that_a_signal_became_is_an_interruption(out: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Compiled code that is interrupted while it is imported says that its initialization failed."""

    def action() -> str:
        try:
            signal.raise_signal(signal.SIGINT)
        except KeyboardInterrupt:
            raise ImportError("initialization failed") from None
        return "done"

    assert outcome.carry_out("diagnose", SOURCE, out, action) == 130
    said = capsys.readouterr().err
    assert "interrupted" in said
    assert "defect" not in said
    assert list(out.parent.glob("*crash*")) == []


def test_a_signal_that_is_ignored_where_it_arrives_ends_the_command_all_the_same(tmp_path: Path) -> None:
    """Python ignores an exception in a finaliser, and in its own callbacks while a module is imported."""
    code = """
import os, signal, sys, time
from pathlib import Path
from calibration_core.commands.terminal.outcome import carry_out
class Last:
    def __del__(self):
        os.kill(os.getpid(), int(sys.argv[1]))
        time.sleep(0.01)
def action():
    Last()
    end = time.monotonic() + 20.0
    while time.monotonic() < end:
        time.sleep(0.01)
    return "not ended"
sys.exit(carry_out("identify", Path("x"), Path("y"), action))
"""
    for number, code_of_exit in ((signal.SIGINT, 130), (signal.SIGTERM, 143)):
        began = time.monotonic()
        done = subprocess.run(
            [sys.executable, "-c", code, str(int(number))], capture_output=True, cwd=tmp_path, check=False
        )
        assert (done.returncode, done.stdout) == (code_of_exit, b"")
        assert len(done.stderr.splitlines()) == 1  # Python tells nothing of what it ignored
        assert time.monotonic() - began < 10.0


def test_a_reader_that_goes_away(tmp_path: Path) -> None:
    process = program("identify", BAG, "--cell", CELL, "--out", tmp_path / "out", "--no-report")
    assert process.stdout is not None
    process.stdout.close()
    assert process.stderr is not None
    assert said_last(process.stderr.read()) == []
    assert process.wait(timeout=60) == 0
    assert (tmp_path / "out" / "result.json").is_file()


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="there is no /dev/full")
def test_a_full_standard_output(tmp_path: Path) -> None:
    arguments = ["identify", BAG, "--cell", CELL, "--out", tmp_path / "out", "--no-report"]
    command = [sys.executable, "-m", "calibration_core.cli", *map(str, arguments)]
    with Path("/dev/full").open("w") as full:
        done = subprocess.run(command, stdout=full, stderr=subprocess.PIPE, timeout=60, check=False)
        assert done.returncode == 2
        assert len(said_last(done.stderr)) == 1
        assert b"No space left on device" in done.stderr
        both = subprocess.run([*command, "--readmit", "x"], stdout=full, stderr=full, timeout=60, check=False)
        assert both.returncode == 2


def test_closed_streams_and_an_ascii_locale(tmp_path: Path) -> None:
    arguments = ["identify", str(BAG), "--cell", str(CELL), "--no-report", "--out"]
    plain = {**os.environ, "LC_ALL": "C", "PYTHONUTF8": "0", "PYTHONCOERCECLOCALE": "0", "PYTHONIOENCODING": "ascii"}
    command = [sys.executable, "-m", "calibration_core.cli"]
    done = subprocess.run(
        [*command, *arguments, str(tmp_path / "größe")], capture_output=True, env=plain, timeout=60, check=False
    )
    assert (done.returncode, said_last(done.stderr)) == (0, [])
    assert b"\\xb5m" in done.stdout  # escaped, not lost
    missing = subprocess.run(
        [*command, "identify", "größe.csv", "--cell", "größe.yaml"],
        capture_output=True, env=plain, timeout=60, check=False,
    )  # fmt: skip
    assert missing.returncode == 2
    assert len(missing.stderr.splitlines()) == 1
    shell = f'exec "$@" {tmp_path / "closed"} >&- 2>&-'
    closed = subprocess.run(["sh", "-c", shell, "sh", *command, *arguments], timeout=60, check=False)
    assert closed.returncode == 0
    assert (tmp_path / "closed" / "result.json").is_file()
