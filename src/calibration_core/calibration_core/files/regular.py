"""Bytes of a regular file of bounded size: never a device, a pipe, or more than was agreed on."""

from __future__ import annotations

import errno
import io
import os
import stat
from pathlib import Path

from calibration_core.errors import InputError


def read_regular(path: Path, most: int, what: str, error: type[InputError] = InputError) -> bytes:
    """Return the content of a regular file.

    Args:
        path: The file; links are followed.
        most: Bytes that it may have.
        what: What it should be, for messages, e.g. `cell file (YAML)`.
        error: Kind of error to raise.

    Raises:
        InputError: It cannot be read, is no regular file (directory, device, pipe), or is larger.
    """
    try:
        with open_regular(path) as stream:
            size = os.fstat(stream.fileno()).st_size
            if size > most:
                raise error(path, "", f"{size} bytes", f"a {what} of at most {most} bytes")
            content = stream.read(most + 1)
    except IsADirectoryError:
        raise error(path, "", "a directory", f"a readable {what}") from None
    except (OSError, ValueError) as fault:  # ValueError: a zero byte in the name
        raise error(path, "", getattr(fault, "strerror", None) or str(fault), f"a readable {what}") from None
    if len(content) > most:
        raise error(path, "", f"more than {most} bytes", f"a {what} of at most {most} bytes")
    return content


def open_regular(path: Path) -> io.BufferedReader:
    """Open a regular file for reading; links are followed.

    Raises:
        OSError: It cannot be opened, or is no regular file (directory, device, pipe): `strerror` says so.
    """
    stream = open(path, "rb", opener=_without_waiting)  # noqa: SIM115 - the caller closes it
    if not stat.S_ISREG(os.fstat(stream.fileno()).st_mode):
        stream.close()
        raise OSError(errno.EINVAL, "no regular file", str(path))
    return stream


def _without_waiting(path: str, flags: int) -> int:
    """Open a file; without O_NONBLOCK, opening a pipe that nobody writes to would wait for ever."""
    return os.open(path, flags | os.O_CLOEXEC | os.O_NONBLOCK)
