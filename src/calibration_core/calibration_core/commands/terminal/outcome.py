"""How a command ends: exit code, one line on stderr, and a file with the traceback where nobody foresaw it.

0: done, whatever the verdict.  2: the input cannot be used, or the output not written.  1: a defect of ours.
130 and 143: interrupted from the keyboard (SIGINT) or ended from outside (SIGTERM); the line says what stays.
"""

from __future__ import annotations

import contextlib
import os
import platform
import signal
import sys
import tempfile
import threading
import traceback
import warnings
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from types import FrameType
from typing import IO

from calibration_core import __version__
from calibration_core.errors import EquilibriumError, InputError, shown_path

DONE, DEFECT, UNUSABLE, INTERRUPTED, TERMINATED = 0, 1, 2, 130, 143
CRASH = ".crash.txt"
MOST = 300  # characters of an error that nobody foresaw
AGAIN = 0.5  # s between attempts to end
NOTHING = "nothing was written"


class Terminated(BaseException):
    """SIGTERM has arrived."""


def carry_out(
    command: str, source: Path, out: Path, action: Callable[[], str], stays: Callable[[], str] = lambda: NOTHING
) -> int:
    """Carry out a command, print its summary, and return the exit code.

    Args:
        command: Its name, for messages.
        source: What it reads, for an error that knows no file.
        out: Where its results go; a traceback goes beside it.
        action: What it does; returns the summary.
        stays: Says, when it is ended before its time, what it has written already.
    """
    try:
        with _terminable(), warnings.catch_warnings():
            warnings.simplefilter("ignore")  # a warning of a library tells its users nothing that they could act on
            summary = action()
    except InputError as error:
        more = f" (and {len(error.further)} more in this file)" if error.further else ""
        return _failed(UNUSABLE, f"{error}{more}")
    except EquilibriumError as error:
        named = InputError(source, "wrench", str(error), "a load within the robot's capacity, in N and N·m")
        return _failed(UNUSABLE, str(named))
    except KeyboardInterrupt:
        return _failed(INTERRUPTED, f"calibration {command}: interrupted, {stays()}")
    except Terminated:
        return _failed(TERMINATED, f"calibration {command}: terminated, {stays()}")
    except Exception as error:  # noqa: BLE001 - the last resort: every expected error is one of those above
        return _failed(DEFECT, _crashed(command, out, error))
    with contextlib.suppress(OSError, ValueError):
        _crash_file(out).unlink(missing_ok=True)
    return _printed(summary)


def tolerate(*streams: IO[str] | None) -> None:
    """Let streams escape the characters that they cannot encode, instead of failing."""
    for stream in streams:
        reconfigure = getattr(stream, "reconfigure", None)
        if reconfigure is not None:
            reconfigure(errors="backslashreplace")


def _printed(text: str) -> int:
    """Print to stdout; a reader that has gone away has seen what it wanted."""
    if sys.stdout is None or not text:
        return DONE
    try:
        print(text, flush=True)
    except BrokenPipeError:
        _to_nowhere(sys.stdout)
    except OSError as error:
        _to_nowhere(sys.stdout)
        fault = InputError("standard output", "", error.strerror or str(error), "a place that can be written")
        return _failed(UNUSABLE, str(fault))
    return DONE


def _failed(code: int, text: str) -> int:
    if sys.stderr is not None:
        try:
            print(text, file=sys.stderr, flush=True)
        except OSError:
            _to_nowhere(sys.stderr)
    return code


def _to_nowhere(stream: IO[str]) -> None:
    """Point a stream to nowhere: Python flushes it once more when it ends."""
    handle = os.open(os.devnull, os.O_WRONLY)
    os.dup2(handle, stream.fileno())
    os.close(handle)


@contextlib.contextmanager
def _terminable() -> Iterator[None]:
    """Turn SIGINT and SIGTERM into an exception, so that what was begun is cleared up.

    An exception that arrives in a callback of the interpreter, for example while a module is imported, is ignored;
    therefore it is raised again every `AGAIN` until the command ends by it, and Python prints nothing of it.  Compiled
    code that is being imported turns it into an error of its own (`ImportError: initialization failed`): what fails
    after a signal fails because of it.
    """
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    kinds: list[type[BaseException]] = []

    def end(number: int, _: FrameType | None) -> None:
        if number != signal.SIGALRM:
            kinds.append(KeyboardInterrupt if number == signal.SIGINT else Terminated)
        signal.setitimer(signal.ITIMER_REAL, AGAIN)
        raise kinds[-1]

    hook = sys.unraisablehook

    def ignored(what: sys.UnraisableHookArgs) -> None:
        if not issubclass(what.exc_type, tuple(kinds)):
            hook(what)

    numbers = (signal.SIGINT, signal.SIGTERM, signal.SIGALRM)
    before = {number: signal.signal(number, end) for number in numbers}
    sys.unraisablehook = ignored
    try:
        yield
    except Exception:
        if kinds:
            raise kinds[-1] from None
        raise
    finally:
        signal.setitimer(signal.ITIMER_REAL, 0.0)
        sys.unraisablehook = hook
        for number, handler in before.items():
            signal.signal(number, handler if handler is not None else signal.SIG_DFL)


def _crashed(command: str, out: Path, error: Exception) -> str:
    """Write the traceback to a file and return the line that names it."""
    text = " ".join(str(error).split())
    text = f"{text[:MOST]}…" if len(text) > MOST else text
    what = f"{type(error).__name__}: {text}" if text else type(error).__name__
    line = f"calibration {command}: a defect of this program ({what})"
    lines = (
        f"calibration {__version__}, Python {platform.python_version()}, {platform.platform()}",
        f"arguments: {sys.argv[1:]}",
        "".join(traceback.format_exception(error)),
    )
    path = _write_somewhere(
        [_crash_file(out), Path(tempfile.gettempdir()) / f"calibration-{os.getpid()}{CRASH}"], lines
    )
    return line if path is None else f"{line}; the traceback stands in {shown_path(path)}, please report it"


def _crash_file(out: Path) -> Path:
    return out.with_name(f"{out.resolve().name}{CRASH}")


def _write_somewhere(paths: Sequence[Path], lines: Sequence[str]) -> Path | None:
    for path in paths:
        with contextlib.suppress(OSError, ValueError, RuntimeError):
            path.parent.mkdir(parents=True, exist_ok=True)
            path.write_text("\n".join(lines), encoding="utf-8", errors="backslashreplace")
            return path
    return None
