"""Words of the panel in the reader's language: the page and the terminal take them from the same files."""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path

LANGUAGES = ("en", "de")
FOLDER = Path(__file__).parents[1] / "static" / "words"


def words_of(language: str) -> Mapping[str, str]:
    """Return the words of a language by code; English where there is no such language."""
    name = language if language in LANGUAGES else LANGUAGES[0]
    found: dict[str, str] = json.loads((FOLDER / f"{name}.json").read_text("utf-8"))
    return found


class Words:
    """Words of one language."""

    def __init__(self, language: str) -> None:
        self._words = words_of(language)

    def __call__(self, code: str, **values: object) -> str:
        """Return the words of a code with its values; a code without words is shown as it is."""
        text = self._words.get(code, code)
        for name, value in values.items():
            text = text.replace(f"{{{name}}}", str(value))
        return text
