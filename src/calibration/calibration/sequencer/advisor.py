"""While measuring: what the readings determine so far, worked out by a process that stands back behind the others.

After every configuration the runner's thread says so and goes on; a thread of this module asks the process, and the
answer is published when it is there.  Whoever moves or guards waits for nothing here.
"""

from __future__ import annotations

import threading
from collections.abc import Callable
from typing import Any

from calibration.evaluation.worker import CancelledError, Worker

NICENESS = 10


class Advisor:
    """Answers after every configuration, the newest request first; one at a time."""

    def __init__(self, report: Callable[[dict[str, Any]], None], complain: Callable[[str], None]) -> None:
        """Start the process.

        Args:
            report: Called with every answer, see `commands.progress.progress_record`, in a thread of its own.
            complain: Called with why there is none.
        """
        self._report, self._complain = report, complain
        self._worker = Worker(niceness=NICENESS)
        self._wanted: dict[str, Any] | None = None
        self._lock = threading.Condition()
        self._closing = False
        self._thread = threading.Thread(target=self._run, name="advisor", daemon=True)
        self._thread.start()

    def ask(self, session: str, cell: str, wanted: float) -> None:
        """Ask what its readings determine; an older question that was not answered yet is dropped."""
        with self._lock:
            self._wanted = {"session": session, "cell": cell, "wanted": wanted}
            self._lock.notify()

    def _run(self) -> None:
        while True:
            with self._lock:
                self._lock.wait_for(lambda: self._wanted is not None or self._closing)
                question, self._wanted = self._wanted, None
            if self._closing or question is None:
                return
            try:
                answer = self._worker.ask(question, lambda: self._closing)
            except CancelledError:
                return
            except RuntimeError as error:
                self._complain(str(error))
                continue
            if answer["kind"]:
                self._complain(answer["trace"] or answer["text"])
            elif answer["progress"] is not None:
                self._report(answer["progress"])

    def close(self) -> None:
        """End the process; what is being worked out is given up."""
        with self._lock:
            self._closing = True
            self._lock.notify()
        self._thread.join(2.0)
        self._worker.close()
