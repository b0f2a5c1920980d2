"""What a name may be: one line of characters that can be seen, for it stands in reports, tables and messages of a line.

One rule for the names of robots, joints, targets, paths and types, wherever they are read.
"""

from __future__ import annotations

NAME = "a name of printable characters, in one line and not empty"
PRINTABLE = "printable characters, in one line"
CONTROL_FREE = r"^[^\u0000-\u001f\u007f-\u009f\u2028\u2029]*$"  # what of the rule a JSON Schema can say


def is_printable(text: str) -> bool:
    """Return whether a text, which may be empty, has no line breaks, control characters or other unseen ones."""
    return text.isprintable()


def is_name(text: str) -> bool:
    """Return whether a text can be a name."""
    return bool(text.strip()) and is_printable(text)
