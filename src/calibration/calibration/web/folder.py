"""The folder in which the panel finds plans and sessions: what is there, and what of it may be handed out.

Names come from a page, and never leave the folder: a name has no slash, and what it leads to is looked up in a list.
"""

from __future__ import annotations

import dataclasses
import shutil
from pathlib import Path
from typing import Any

from calibration.web.request_table import NAME, RequestError
from calibration_core.measurement.session import DATABASE

PLAN = "plan.yaml"
PROPOSED = "diagnose/next.yaml"  # the plan of what a diagnosis would measure next
LOOKED_AT = 1 << 16  # bytes: what stands before a plan's configurations is short
BAG = "bag"
EVALUATIONS = ("identify", "diagnose", "verify")
FILES = ("result.json", "report.html", "report.pdf", "model.yaml", "table2.csv", "certificate.pdf", "certificate.json")


@dataclasses.dataclass(frozen=True)
class Folder:
    """A folder with sessions and plans.

    Attributes:
        root: The folder.
    """

    root: Path

    def session(self, name: str) -> Path:
        """Return the directory of a session, whether or not it is there.

        Raises:
            RequestError: The name is none.
        """
        if not NAME.fullmatch(name):
            raise RequestError("session", "name", repr(name), "letters, digits, _, - and .")
        return self.root / name

    def plans(self) -> dict[str, Path]:
        """Return the plans there are, by the name under which the page shows them, the newest first.

        Beside the folders, other files end in .yaml, too: cell files and parameters are no plans.
        """
        patterns = (f"*/{PLAN}", "*.yaml", f"*/{PROPOSED}")
        found = [path for pattern in patterns for path in self.root.glob(pattern) if path.is_file()]
        found.sort(key=lambda path: path.stat().st_mtime, reverse=True)
        names = {path.relative_to(self.root).as_posix(): path for path in found}
        return {
            name: path
            for name, path in names.items()
            if not _hidden(Path(name)) and ("/" in name or name == PLAN or _is_plan(path))
        }

    def sessions(self) -> list[dict[str, Any]]:
        """Return the sessions there are, the newest first: name, and which evaluations have results."""
        found = [path for path in self.root.iterdir() if (path / DATABASE).is_file()] if self.root.is_dir() else []
        found = [path for path in found if not _hidden(Path(path.name))]
        found.sort(key=lambda path: (path / DATABASE).stat().st_mtime, reverse=True)
        return [{"name": path.name, "files": sorted(self.files(path.name))} for path in found]

    def files(self, name: str) -> dict[str, Path]:
        """Return what of a session, or of a plan's folder, may be handed out, by `evaluation/file` or `file`."""
        directory = self.session(name)
        found = {file: directory / file for file in FILES if (directory / file).is_file()}
        for evaluation in EVALUATIONS:
            found |= {
                f"{evaluation}/{file}": directory / evaluation / file
                for file in FILES
                if (directory / evaluation / file).is_file()
            }
        if (directory / BAG).is_dir():
            found["bag.tar"] = directory / BAG
        return found

    def free(self) -> float | None:
        """Return the bytes that are free where the folder is; None: it is not there yet."""
        return float(shutil.disk_usage(self.root).free) if self.root.is_dir() else None


def _is_plan(path: Path) -> bool:
    """Whether a file has the first level of a plan; one that cannot be read is none."""
    try:
        with path.open("rb") as stream:
            return any(line.startswith(b"configurations:") for line in stream.read(LOOKED_AT).splitlines())
    except OSError:
        return False


def _hidden(name: Path) -> bool:
    """Whether a name, or a folder on the way to it, begins with a dot: such files are of tools, not of operators."""
    return any(part.startswith(".") for part in name.parts)
