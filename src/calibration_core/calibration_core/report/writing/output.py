"""A result is one unit: all the files of a command appear together, or nothing changes.

They are made in a hidden folder inside the output folder and then renamed one by one, `result.json` last, so that
whoever stands in the folder, or looks at it, keeps it.  A rename that fails is undone with all before it.  What a
command does not write stays.
"""

from __future__ import annotations

import errno
import json
import os
import shutil
import tempfile
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path

from calibration_core.errors import InputError, OutputError, storage_fault
from calibration_core.files.regular import read_regular

RESULT, REPORT_HTML, REPORT_PDF = "result.json", "report.html", "report.pdf"
ALWAYS = frozenset({RESULT, REPORT_HTML, REPORT_PDF})
IDENTIFIED = ALWAYS | {"model.yaml", "table1.csv", "table2.csv", "residuals.csv"}
WRITTEN: Mapping[str, frozenset[str]] = {
    "plan": ALWAYS | {"plan.yaml", "table1.csv", "table1.yaml"},
    "pendant": frozenset(
        {RESULT}
        | {f"calib{part}.{suffix}" for part in ("", "_s", "_w") for suffix in ("src", "mod", "ls", "script")}
        | {"CALIB.JBI", "CALIB_S.JBI", "CALIB_W.JBI"}
    ),
    "simulate": ALWAYS | {"plan.yaml", "table1.csv", "table1.yaml", "recording", "measurements.csv"},
    "identify": IDENTIFIED,
    "diagnose": IDENTIFIED
    | {"next.yaml", "simulation.csv", "cell_lines.yaml", "robot.urdf", "kinematics.yaml", "robot.xml"},
    "predict": ALWAYS | {"predictions.csv"},
    "compare": ALWAYS,
    "verify": ALWAYS | {"certificate.pdf"},
    "import": frozenset({RESULT, "measurements.csv"}),
    "deflect": ALWAYS | {"deflections.csv"},
    "compensate": ALWAYS | {"compensated.csv", "poses.csv", "trajectory.yaml"},
    "export": frozenset(
        {
            RESULT,
            "robot.urdf",
            "kinematics.yaml",
            "dh.csv",
            "dh_modified.csv",
            "dh.yaml",
            "robot.xml",
            "corrections.csv",
        }
    ),
    "fleet": ALWAYS
    | {
        "fleet.parquet",
        "population.yaml",
        "ranking.csv",
        "ranking.parquet",
        "joints.csv",
        "joints.parquet",
        "populations.csv",
        "populations.parquet",
    },
    "init": frozenset({RESULT, "cell.yaml", "cell.schema.json", "robot.urdf", "meshes"}),
    "check": ALWAYS | {"cell.html", "cell.png"},
}
"""What each command may write: with a new result, whatever of it stands there from an earlier one goes."""
MAX_RESULT = 1 << 28
UNFINISHED = ".calibration-"
"""How the name of the hidden folder begins in which a result is made; a killed process leaves it behind."""

Content = bytes | Callable[[Path], None]
"""What a file holds, or a function that makes a file or directory at the path that it is given."""


def write_files(directory: Path, files: Mapping[str, Content]) -> None:
    """Write a set of files into a directory, which is made if missing: all of them, or none.

    With `result.json` among them, what the earlier result there consisted of is replaced as a whole; otherwise files
    are added.

    Args:
        directory: Where to.
        files: Name -> content; a name that stands already is replaced, but a directory only by a directory.

    Raises:
        OutputError: The directory cannot be made or a file cannot be written.
    """
    target, missing, written = directory, [], False
    try:
        target = directory.resolve()
        missing = [place for place in (target, *target.parents) if not place.exists()]
        if target.exists() and not target.is_dir():
            raise NotADirectoryError(errno.ENOTDIR, os.strerror(errno.ENOTDIR), str(target))
        target.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryDirectory(prefix=UNFINISHED, dir=target) as folder:
            new, old = Path(folder) / "new", Path(folder) / "old"
            new.mkdir()
            old.mkdir()
            for name, content in files.items():
                _stage(new, name, content)
            _put(target, new, old, files)
        written = True
    except OSError as error:
        name = Path(str(error.filename)).name if error.filename else ""
        fault = storage_fault(target, error, "a directory that can be written")
        raise OutputError(directory, name, *fault) from None
    except (ValueError, RuntimeError) as error:  # a zero byte in the name; links that go round in circles
        raise OutputError(directory, "", str(error), "a directory that can be written") from None
    finally:
        if not written:
            _remove_empty(missing)


def _put(target: Path, new: Path, old: Path, files: Mapping[str, Content]) -> None:
    """Rename what was made to where it belongs, and take away the rest of the earlier result; undo all on a failure."""
    for name in files:
        goal, source = target / name, new / name
        if goal.exists() and goal.is_dir() != source.is_dir():
            code = errno.EISDIR if goal.is_dir() else errno.ENOTDIR
            raise OSError(code, os.strerror(code), str(goal))
    earlier = WRITTEN.get(made_by(target) or "", ALWAYS) if RESULT in files else frozenset()
    gone = [name for name in sorted(earlier - set(files)) if os.path.lexists(target / name)]
    moved: list[str] = []
    try:
        for name in [*sorted(files, key=lambda name: name == RESULT), *gone]:
            moved.append(name)
            if os.path.lexists(target / name):
                _keep(target / name, old / name)
            if name in files:
                (new / name).replace(target / name)
            elif os.path.lexists(target / name):
                (target / name).unlink()
    except BaseException:
        for name in reversed(moved):
            if os.path.lexists(old / name):
                (old / name).replace(target / name)
            elif name in files and not (new / name).exists():
                (target / name).replace(new / name)
        raise


def _keep(path: Path, copy: Path) -> None:
    """Keep what is to be replaced: a folder or link is moved away, a file gets a second name, or is copied."""
    if path.is_dir() or path.is_symlink():
        path.replace(copy)
        return
    try:
        os.link(path, copy)
    except OSError:
        shutil.copy2(path, copy)


def _remove_empty(places: Sequence[Path]) -> None:
    """Remove the directories that were made, the innermost first; one in which something stands stays."""
    for place in places:
        try:
            place.rmdir()
        except OSError:
            return


def made_by(directory: Path) -> str | None:
    """Return the command whose result stands in a directory; None where no result of this program does."""
    try:
        content = json.loads(read_regular(directory / RESULT, MAX_RESULT, "result"))
    except (InputError, ValueError, RecursionError):
        return None
    command = content.get("command") if isinstance(content, dict) else None
    return command if isinstance(command, str) and command in WRITTEN else None


def _stage(directory: Path, name: str, content: Content) -> None:
    path = directory / name
    if isinstance(content, bytes):
        with path.open("xb") as file:
            file.write(content)
            file.flush()
            os.fsync(file.fileno())
        return
    # made under its own name (which may be written into it), and away from what it leaves beside itself
    folder = Path(tempfile.mkdtemp(prefix=f".{name}.", dir=directory))
    try:
        content(folder / name)
        (folder / name).replace(path)
    finally:
        shutil.rmtree(folder)
