"""A real browser for tests: a page in, its document or a picture of it out."""

from __future__ import annotations

import shutil
import subprocess
from pathlib import Path

import pytest

FLAGS = (
    "--headless", "--no-sandbox", "--no-first-run", "--disable-background-networking", "--disable-component-update",
    "--disable-sync", "--use-gl=angle", "--use-angle=swiftshader", "--enable-unsafe-swiftshader",
    "--virtual-time-budget=4000",
)  # fmt: skip


def browser() -> str:
    """Return the program; skip the test where there is none."""
    found = shutil.which("chromium") or shutil.which("chromium-browser") or shutil.which("google-chrome")
    if found is None:
        pytest.skip("no Chromium found")
    return found


def dumped(page: Path, folder: Path) -> str:
    """Return a page's document as it is after its programs have run."""
    return _run(page, folder, "--dump-dom")


def pictured(page: Path, folder: Path, width: int, height: int) -> Path:
    """Return a picture of a page, PNG."""
    target = folder / f"{page.stem}-{width}.png"
    _run(page, folder, f"--window-size={width},{height}", f"--screenshot={target}", "--hide-scrollbars")
    return target


def _run(page: Path, folder: Path, *arguments: str) -> str:
    words = [browser(), *FLAGS, f"--user-data-dir={folder / 'profile'}", *arguments, page.as_uri()]
    return subprocess.run(words, capture_output=True, timeout=120, check=True).stdout.decode()
