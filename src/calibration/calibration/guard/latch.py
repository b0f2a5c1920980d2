"""What is latched, in a file: a guard that was killed or started again is latched by what the one before it saw.

The file is held open and overwritten in place, so that a full disk does not matter.  It is not synced: it outlives the
process, and where the computer fails, so does everything that could move the robot.
"""

from __future__ import annotations

import hashlib
import os
import re
from collections.abc import Iterable
from pathlib import Path

from calibration_core.cell import Cell
from calibration_core.errors import OutputError, SessionError, quoted
from calibration_core.motion.robot_status import Reason

SIZE = 256  # bytes, of the file: the numbers of all reasons fit in
EXPECTED = "numbers of reasons of the guard; remove it and look at the robot where it was damaged"


class Latch:
    """The latched reasons of one cell's guard.

    Attributes:
        reasons: What was latched when the file was opened.
    """

    def __init__(self, path: Path) -> None:
        """Open the file, and make it where there is none: nothing is latched then.

        Raises:
            OutputError: It cannot be written.
            SessionError: It holds something else.
        """
        self.path = path
        try:
            path.parent.mkdir(parents=True, exist_ok=True)
            self._file = os.open(path, os.O_RDWR | os.O_CREAT | os.O_CLOEXEC, 0o644)
            text = os.pread(self._file, SIZE, 0).decode("ascii", errors="replace")
            if not text:
                self.keep(())
        except OSError as error:
            raise OutputError(path, "", str(error), "a file that can be written; $ROS_HOME says where") from None
        try:
            self.reasons = tuple(Reason(int(word)) for word in text.split())
        except ValueError:
            os.close(self._file)
            raise SessionError(path, "", quoted(text.strip()), EXPECTED) from None

    def keep(self, reasons: Iterable[Reason]) -> None:
        """Keep what is latched now.

        Raises:
            OSError: It cannot be written.
        """
        os.pwrite(self._file, " ".join(str(int(one)) for one in reasons).ljust(SIZE).encode("ascii"), 0)


def latch_file(cell: Cell, namespace: str) -> Path:
    """Return where it is kept what is latched in a cell: in `calibration/` of `$ROS_HOME`, or of `~/.ros`.

    Args:
        cell: The cell; another robot has another file.
        namespace: Of the cell's nodes.
    """
    robot = cell.robot
    digest = hashlib.sha256(repr((robot.name, robot.serial, namespace)).encode()).hexdigest()[:12]
    home = Path(os.environ.get("ROS_HOME") or Path.home() / ".ros")
    return home / "calibration" / f"latch-{re.sub(r'[^A-Za-z0-9]+', '-', robot.name)}-{digest}.txt"
