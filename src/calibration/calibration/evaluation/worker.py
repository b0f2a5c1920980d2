"""A process beside the node that does the long work: the same commands as the command line, one after another.

Besides, it says what the readings of a session under way determine so far.  Lines of JSON on stdin and stdout.  The
process loads what the commands need before the first one arrives, ends when its stdin does, and is replaced when a
command is cancelled: half a result is never written.
"""

from __future__ import annotations

import contextlib
import dataclasses
import io
import json
import os
import signal
import subprocess
import sys
import threading
import traceback
from collections.abc import Callable, Sequence
from typing import IO, Any

from calibration_core.errors import EquilibriumError, IdentificationError, InputError

POLL = 0.02  # s between looks at a cancel request


@dataclasses.dataclass(frozen=True)
class Finished:
    """How a command ended: the class of the error (empty: none), its line or the summary, and where a defect lies."""

    kind: str
    text: str
    trace: str


class CancelledError(Exception):
    """The command was cancelled, and its process ended."""


@dataclasses.dataclass(frozen=True)
class Progress:
    """What a command is doing: share of its stages that are done, 0 to 1, and what it does next."""

    share: float = 0.0
    text: str = "getting ready"


class Worker:
    """The process, and the one command that it may be doing.

    Attributes:
        progress: What it last said of that command.
    """

    def __init__(self, *, niceness: int = 0) -> None:
        """Start the process; it gets ready while others go on.

        Args:
            niceness: How far the process stands back behind others.
        """
        self._niceness = niceness
        self.progress = Progress()
        self._commands: tuple[str, ...] = ()
        self._process = self._start()

    def _start(self) -> subprocess.Popen[str]:
        self._commands = ()
        command = [sys.executable, "-P", __file__, str(self._niceness)]
        environment = {**os.environ, "OPENBLAS_NUM_THREADS": os.environ.get("OPENBLAS_NUM_THREADS", "1")}
        return subprocess.Popen(
            command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True, env=environment, encoding="utf-8"
        )

    def commands_when_ready(self, cancelled: Callable[[], bool]) -> tuple[str, ...]:
        """Return the names of the commands there are.

        Raises:
            CancelledError: It was cancelled.
            RuntimeError: The process died.
        """
        self.progress = Progress()
        if not self._commands:
            self._commands = tuple(self._beside(self._read, cancelled)["commands"])
        return self._commands

    def do(self, arguments: Sequence[str], cancelled: Callable[[], bool]) -> Finished:
        """Run a command; to be called from one thread at a time, beside the executor.

        Args:
            arguments: Command line, the command's name first.
            cancelled: Whether to give up.

        Raises:
            CancelledError: It was cancelled.
            RuntimeError: The process died.
        """
        answer = self.ask({"arguments": list(arguments)}, cancelled)
        return Finished(str(answer["kind"]), str(answer["text"]), str(answer["trace"]))

    def ask(self, question: dict[str, Any], cancelled: Callable[[], bool]) -> dict[str, Any]:
        """Put a question; return the answer.  Called and raising as `do`."""
        self.commands_when_ready(cancelled)
        return self._beside(lambda: self._ask(question), cancelled)

    def _beside(self, step: Callable[[], dict[str, Any] | None], cancelled: Callable[[], bool]) -> dict[str, Any]:
        """Take one step that waits for the process, in a thread, so that it can be given up."""
        answers: list[dict[str, Any] | None] = []
        thread = threading.Thread(target=lambda: answers.append(step()), name="worker", daemon=True)
        thread.start()
        while thread.is_alive():
            thread.join(POLL)
            if thread.is_alive() and cancelled():
                self._replace(thread)
                raise CancelledError
        answer = answers[0] if answers else None
        if answer is None:
            self._replace(thread)
            message = "the process that computes has died"
            raise RuntimeError(message)
        return answer

    def _ask(self, question: dict[str, Any]) -> dict[str, Any] | None:
        try:
            stream = _pipe(self._process.stdin)
            stream.write(json.dumps(question) + "\n")
            stream.flush()
        except (BrokenPipeError, ValueError):
            return None
        return self._read()

    def _read(self) -> dict[str, Any] | None:
        for line in _pipe(self._process.stdout):
            answer: dict[str, Any] = json.loads(line)
            if "share" not in answer:
                return answer
            self.progress = Progress(float(answer["share"]), str(answer["text"]))
        return None

    def _replace(self, thread: threading.Thread) -> None:
        self._process.kill()
        thread.join(5.0)
        self.close()
        self._process = self._start()

    def close(self) -> None:
        """End the process."""
        self._process.kill()
        self._process.wait(5.0)
        for stream in (self._process.stdin, self._process.stdout):
            with contextlib.suppress(BrokenPipeError):
                _pipe(stream).close()


def _pipe(stream: IO[str] | None) -> IO[str]:
    if stream is None:
        message = "a process without pipes"
        raise RuntimeError(message)
    return stream


# --- the other side -----------------------------------------------------------------------------------------------


def perform(arguments: list[str], report_progress: Callable[[float, str], None]) -> dict[str, Any]:
    """Run one command of the command line.

    Args:
        arguments: The command line, the command's name first.
        report_progress: Told the share of the command's stages that are done, and what it does next.

    Returns:
        `kind`: the class of the error that ended it, empty if none did; `text`: its summary, or the error's line;
        `trace`: where a defect lies.
    """
    from calibration_core import cli, commands

    printed = io.StringIO()
    try:
        with contextlib.redirect_stdout(printed), contextlib.redirect_stderr(printed):
            options = cli.parse(arguments)
            options.report_progress = report_progress
            text = commands.command(options.command)(options)
    except SystemExit:  # wrong arguments
        lines = printed.getvalue().strip().splitlines()
        return {"kind": InputError.__name__, "text": lines[-1] if lines else "wrong arguments", "trace": ""}
    except (InputError, EquilibriumError) as error:
        kind = IdentificationError if isinstance(error, IdentificationError) else InputError
        return {"kind": kind.__name__, "text": str(error), "trace": ""}
    except Exception as error:  # noqa: BLE001  # told in full to the one who asked
        return {"kind": "defect", "text": f"{type(error).__name__}: {error}", "trace": traceback.format_exc()}
    return {"kind": "", "text": text, "trace": ""}


def worked_out(question: dict[str, Any]) -> dict[str, Any]:
    """Answer one question: the progress, None while nothing is determined; or the class of the error and its words."""
    from calibration_core.commands.evaluation.progress import progress_record

    found: dict[str, Any] | None = None
    try:
        found = progress_record(question["session"], question["cell"], question["wanted"])
    except IdentificationError as error:
        return {"kind": "", "text": str(error), "trace": "", "progress": None}
    except (InputError, EquilibriumError) as error:
        return {"kind": "InputError", "text": str(error), "trace": "", "progress": None}
    except Exception as error:  # noqa: BLE001  # told in full to the one who asked
        text = f"{type(error).__name__}: {error}"
        return {"kind": "defect", "text": text, "trace": traceback.format_exc(), "progress": None}
    return {"kind": "", "text": "", "trace": "", "progress": found}


def serve() -> None:
    """Answer one line after another until there are no more."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C goes to the whole group; the node decides
    os.nice(int(sys.argv[1]) if len(sys.argv) > 1 else 0)
    from calibration_core import commands
    from calibration_core.commands.evaluation import identify  # noqa: F401  # loaded before the first question
    from calibration_core.recording.messages.typed import standard_types

    standard_types()  # likewise

    answers = sys.stdout

    def say(**words: object) -> None:
        print(json.dumps(words), file=answers, flush=True)

    say(commands=list(commands.NAMES))
    for line in sys.stdin:
        question = json.loads(line)
        if "session" in question:
            say(**worked_out(question))
        else:
            say(**perform(question["arguments"], lambda share, text: say(share=share, text=text)))


if __name__ == "__main__":
    serve()
