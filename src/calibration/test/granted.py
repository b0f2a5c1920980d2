"""A stopwatch for bars on a machine that others keep busy: it stands while its processes wait for a core."""

from __future__ import annotations

import os
import subprocess
import time
from pathlib import Path

NANOSECONDS = 1e9


class Granted:
    """Time since the begin, s, less what each process was kept waiting for a core, by its thread that waited longest.

    The kernel counts that (`/proc/PID/task/TID/schedstat`, second number, ns).  Where nothing else runs, it is the time
    of the clock.  A process that has ended counts as it was seen last.
    """

    def __init__(self, *processes: int) -> None:
        """Begin; without `processes`, for this one.  Of several, one works after the other: their delays add up."""
        self._delays = {process: delays(process) for process in processes or (os.getpid(),)}
        self._waited = dict.fromkeys(self._delays, 0.0)
        self._began = time.monotonic()

    @property
    def waited(self) -> float:
        """Time that was not granted so far."""
        for process, before in self._delays.items():
            now = delays(process)
            longest = max((now[thread] - before.get(thread, 0.0) for thread in now), default=0.0)
            self._waited[process] = max(self._waited[process], longest)
        return sum(self._waited.values())

    @property
    def seconds(self) -> float:
        """Time that was granted so far."""
        return max(0.0, time.monotonic() - self._began - self.waited)

    def until_ended(self, process: subprocess.Popen[bytes], timeout: float = 60.0) -> int:
        """Wait for the end of a process, and count meanwhile what is granted to it; return its exit code."""
        end = time.monotonic() + timeout
        while (code := process.poll()) is None:
            assert time.monotonic() < end, f"process {process.pid} does not end within {timeout:.0f} s"
            self.waited  # noqa: B018  # nobody can tell when it has ended
            time.sleep(0.02)
        return code


def delays(process: int) -> dict[str, float]:
    """How long each thread of a process has waited for a core, s; empty where nobody counts it."""
    found = {}
    for path in Path(f"/proc/{process}/task").glob("*/schedstat"):
        try:
            found[path.parent.name] = int(path.read_text(encoding="ascii").split()[1]) / NANOSECONDS
        except (OSError, IndexError, ValueError):  # the thread has ended
            continue
    return found
