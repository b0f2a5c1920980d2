"""The documents of the project, and what can be run in them."""

from __future__ import annotations

import re
from collections.abc import Iterator
from pathlib import Path

ROOT = Path(__file__).resolve().parents[4]
DOCUMENTS = sorted({
    ROOT / "README.md", *ROOT.glob(".github/*.md"), *ROOT.glob("bags/*.md"), *ROOT.glob("src/*/doc/*.md")
})  # fmt: skip
FENCE = re.compile(r"^( *)```(\w*)\n(.*?)^\1```$", re.MULTILINE | re.DOTALL)


def blocks(path: Path) -> Iterator[tuple[str, str]]:
    """Yield language and text of every fenced block."""
    for indent, language, text in FENCE.findall(path.read_text("utf-8")):
        yield language, re.sub(rf"^{indent}", "", text, flags=re.MULTILINE)


def commands(path: Path) -> list[str]:
    """Return every line of a document that runs `calibration`, without its comment."""
    lines = [line for language, text in blocks(path) if language in {"", "sh", "console"} for line in text.splitlines()]
    found = [re.match(r"(?:\$ )?(?:\S*/bin/)?(calibration [^#|]+)", line) for line in lines]
    written = re.findall(r"`(calibration [a-z]+ [^`]+)`", path.read_text("utf-8"))
    return [line[1].strip() for line in found if line] + written
