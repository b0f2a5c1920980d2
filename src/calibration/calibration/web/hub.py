"""What the pages show, and who looks: the last state alone counts, and a page that is slow gets fewer of them."""

from __future__ import annotations

import asyncio
import json
from collections.abc import Callable
from typing import Any

from calibration.web.access import Session

BEAT = 0.2  # s between two messages that tell nothing new: a page that hears nothing for a second says so


def in_loop(loop: asyncio.AbstractEventLoop, work: Callable[[], object]) -> None:
    """Do something short in the thread of a loop; nothing where the loop has ended, also while this is called."""
    try:
        loop.call_soon_threadsafe(work)
    except RuntimeError:
        if not loop.is_closed():
            raise


class Page:
    """One open connection: what it has been sent."""

    def __init__(self, session: Session) -> None:
        self.session = session
        self.changed = asyncio.Event()
        self.sent: dict[str, str] = {}


class Hub:
    """Holds what is shown, and wakes the pages when it changes.

    Attributes:
        pages: Those that are open.
    """

    def __init__(self) -> None:
        self.pages: set[Page] = set()
        self._parts: dict[str, str] = {}

    def show(self, part: str, value: Any) -> None:
        """Show a part of the page: it replaces what was shown of it before."""
        text = json.dumps(value, separators=(",", ":"), allow_nan=False)
        if self._parts.get(part) != text:
            self._parts[part] = text
            self.wake()

    def wake(self) -> None:
        """Have every page look for what is new."""
        for page in self.pages:
            page.changed.set()

    def news(self, page: Page, own: dict[str, Any]) -> str:
        """Return what a page has not been sent yet, as one message; an empty object where nothing is new.

        Args:
            page: The page.
            own: What this page alone is shown.
        """
        parts = {**self._parts, "me": json.dumps(own, separators=(",", ":"), allow_nan=False)}
        new = {name: text for name, text in parts.items() if page.sent.get(name) != text}
        page.sent |= new
        return "{" + ",".join(f'"{name}":{text}' for name, text in new.items()) + "}"
