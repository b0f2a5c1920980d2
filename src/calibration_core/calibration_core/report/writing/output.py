"""A result is one unit: all the files of a command appear together, or nothing changes.

They are made in a folder beside the output folder, and the two change places by one rename, under a lock on the folder
above.  Two writers never mix; of one that was killed the old result stays whole, and the next one clears what it left.
What a command does not write stays: files of others are carried into the new folder.
"""

from __future__ import annotations

import errno
import json
import os
import shutil
import tempfile
from collections.abc import Callable, Collection, Mapping, Sequence
from pathlib import Path

from calibration_core.errors import InputError, OutputError, storage_fault
from calibration_core.files.regular import read_regular
from calibration_core.report.writing import swap

RESULT, REPORT_HTML, REPORT_PDF = "result.json", "report.html", "report.pdf"
ALWAYS = frozenset({RESULT, REPORT_HTML, REPORT_PDF})
IDENTIFIED = ALWAYS | {"model.yaml", "table1.csv", "table2.csv", "residuals.csv"}
WRITTEN: Mapping[str, frozenset[str]] = {
    "plan": ALWAYS | {"plan.yaml", "table1.csv", "table1.yaml"},
    "simulate": ALWAYS | {"plan.yaml", "table1.csv", "table1.yaml", "recording", "measurements.csv"},
    "identify": IDENTIFIED,
    "diagnose": IDENTIFIED | {"next.yaml"},
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
    "init": frozenset({RESULT, "cell.yaml", "cell.schema.json", "robot.urdf"}),
    "check": ALWAYS | {"cell.html", "cell.png"},
}
"""What each command may write: with a new result, whatever of it stands there from an earlier one goes."""
MAX_RESULT = 1 << 28

Content = bytes | Callable[[Path], None]
"""What a file holds, or a function that makes a file or directory at the path that it is given."""


def write_files(directory: Path, files: Mapping[str, Content]) -> None:
    """Write a set of files into a directory, which is made if missing: all of them, or none.

    With `result.json` among them, what the earlier result there consisted of is replaced as a whole; otherwise files
    are added.  Where the directory cannot change places with another (it is a mount point, holds the working
    directory, or the one above cannot be written), files are renamed one by one, `result.json` last.

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
        with swap.SwapPlace(target) as place:
            for name, content in files.items():
                _stage(place.new, name, content)
            place.commit(lambda: _kept(target, place.new, files))
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


def _remove_empty(places: Sequence[Path]) -> None:
    """Remove the directories that were made, the innermost first; one in which something stands stays."""
    for place in places:
        try:
            place.rmdir()
        except OSError:
            return


def _kept(target: Path, new: Path, files: Mapping[str, Content]) -> Collection[str]:
    """Return the names in the target that stay: neither written anew nor part of the earlier result."""
    there = {entry.name: entry for entry in target.iterdir()}
    for name in files.keys() & there.keys():
        old_is, new_is = there[name].is_dir(), (new / name).is_dir()
        if old_is != new_is:
            code = errno.EISDIR if old_is else errno.ENOTDIR
            raise OSError(code, os.strerror(code), str(there[name]))
    gone = WRITTEN.get(made_by(target) or "", ALWAYS) if RESULT in files else frozenset()
    return [name for name in there if name not in files and name not in gone]


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
