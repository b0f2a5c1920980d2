"""Files of foreign programs as lines of text: encodings recognised, sizes bounded."""

from __future__ import annotations

import codecs
import dataclasses
from pathlib import Path

from calibration_core.errors import RecordingError, quoted
from calibration_core.files.regular import read_regular

MAX_BYTES = 1 << 28
MAX_LINE = 1 << 16
_MARKS = (
    (codecs.BOM_UTF8, "utf-8-sig"),
    (codecs.BOM_UTF16_LE, "utf-16"),
    (codecs.BOM_UTF16_BE, "utf-16"),
)
EXPORT = (
    "of a program other than KUKA KRL, ABB RAPID, FANUC TP (listing) or Universal Robots script, "
    "export the joint angles as a table with the columns J1 [deg] ... Jn [deg]"
)
ENCODINGS = ("utf-8", "utf-8-sig", "utf-16", "cp1252", "latin-1")


@dataclasses.dataclass(frozen=True)
class Text:
    """A file's text.

    Attributes:
        lines: Without line ends; line 1 has index 0.
    """

    path: Path
    lines: tuple[str, ...]
    encoding: str


def read_text(path: Path, encoding: str | None = None) -> Text:
    """Read a text file of up to 256 MiB.

    Args:
        path: A regular file.
        encoding: One of `ENCODINGS`; None: a byte order mark decides, else UTF-8, else the Western code page 1252.

    Raises:
        RecordingError: It cannot be read, is too large, or is no text.
    """
    raw = read_regular(path, MAX_BYTES, "table", RecordingError)
    used = encoding or next((name for mark, name in _MARKS if raw.startswith(mark)), None)
    try:
        text, used = _decoded(raw, used)
    except UnicodeError:
        found = f"bytes that are not {used}" if used else "bytes that are no text"
        raise RecordingError(path, "", found, f"text in one of {', '.join(ENCODINGS)}; {EXPORT}") from None
    if "\x00" in text:
        raise RecordingError(path, "", "zero bytes", f"text; {EXPORT}")
    lines = tuple(text.splitlines())
    for number, line in enumerate(lines, 1):
        if len(line) > MAX_LINE:
            raise RecordingError(path, f"line {number}", f"{len(line)} characters", f"at most {MAX_LINE} in a line")
    if not any(line.strip() for line in lines):
        raise RecordingError(path, "", quoted(text[:20]), "a table with at least one row")
    return Text(path, lines, used)


def _decoded(raw: bytes, encoding: str | None) -> tuple[str, str]:
    if encoding is not None:
        return raw.decode(encoding), encoding
    try:
        return raw.decode("utf-8"), "utf-8"
    except UnicodeDecodeError:
        return raw.decode("cp1252", errors="strict"), "cp1252"
