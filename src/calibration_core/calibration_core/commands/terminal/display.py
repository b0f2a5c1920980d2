"""How far a command is, for whoever started it: a bar on a terminal, plain lines elsewhere, nothing within a second."""

from __future__ import annotations

import sys
import threading
from types import TracebackType
from typing import IO, Any

PATIENCE = 1.0  # s: a shorter command shows nothing


class Display:
    """Shows the stages of one command, as a context manager; `report_progress` may be called from any thread.

    On a terminal, a bar with the stage, the elapsed time and the time left is drawn and removed at the end.  Elsewhere
    each stage but the first is a line: a command that cannot read its input prints one line, its error.
    """

    def __init__(self, command: str, stream: IO[str] | None) -> None:
        """Prepare; nothing is shown before `PATIENCE` has passed.

        Args:
            command: Name of the command.
            stream: Where to, stderr: what a command finds, on stdout, does not depend on how long it takes.  None:
                nowhere.
        """
        self._command = command
        self._stream = stream
        self._lock = threading.Lock()
        self._timer = threading.Timer(PATIENCE, self._begin)
        self._timer.daemon = True
        self._stage = (0.0, "")
        self._shown = False
        self._bar: Any = None
        self._task: Any = None

    def __enter__(self) -> Display:
        """Begin to wait."""
        if self._stream is not None:
            self._timer.start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        """Remove the bar."""
        self._timer.cancel()
        with self._lock:
            self._shown = False
            if self._bar is not None:
                self._bar.stop()

    def report_progress(self, share: float, text: str) -> None:
        """Take what is done next.

        Args:
            share: Share of the command that is done, 0 to 1.
            text: What is done next.
        """
        with self._lock:
            self._stage = (share, text)
            if self._shown:
                self._show()

    def _begin(self) -> None:
        with self._lock:
            self._shown = True
            if self._stream is not None and self._stream.isatty():
                self._bar = _bar(self._stream)
                self._task = self._bar.add_task(self._command, total=1.0)
                self._bar.start()
            self._show()

    def _show(self) -> None:
        share, text = self._stage
        if self._bar is not None:
            self._bar.update(self._task, completed=share, description=f"{self._command}: {text}")
        elif self._stream is not None and share > 0.0:
            try:
                print(f"{self._command}: {text} ({share:.0%} done)", file=self._stream, flush=True)
            except (OSError, ValueError):  # the reader has gone; what matters is said at the end, by the exit code
                self._stream = None


def _bar(terminal: IO[str]) -> Any:
    from rich.console import Console  # imported when it is drawn: most commands are over before
    from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn, TimeRemainingColumn

    return Progress(
        TextColumn("{task.description}"),
        BarColumn(),
        TimeElapsedColumn(),
        TextColumn("left:"),
        TimeRemainingColumn(),
        console=Console(file=terminal),
        transient=True,
    )


def display_of(options: Any) -> Display:
    """Return the display that the options of a command ask for."""
    return Display(options.command, None if options.quiet or options.json else sys.stderr)
