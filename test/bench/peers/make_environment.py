"""Make one virtual environment per peer under build/peers, with exactly the version that is compared against.

    python test/bench/peers/make_environment.py [robotkinecal] [figaroh]
"""

from __future__ import annotations

import subprocess
import sys
import venv
from pathlib import Path

VERSIONS = {"robotkinecal": "0.1.0", "figaroh": "1.0.2"}
ROOT = Path(__file__).resolve().parents[3]


def python_of(peer: str) -> Path:
    """Return the interpreter of a peer's environment (which may not exist yet)."""
    return ROOT / "build" / "peers" / peer / "bin" / "python"


def make(peer: str) -> Path:
    """Install a peer if its environment is missing or holds another version, and return its interpreter."""
    python = python_of(peer)
    if not python.exists():
        venv.create(python.parents[1], with_pip=True)
    if _installed(python, peer) != VERSIONS[peer]:
        subprocess.run([python, "-m", "pip", "install", "-q", f"{peer}=={VERSIONS[peer]}"], check=True)
    return python


def _installed(python: Path, peer: str) -> str:
    code = f"import importlib.metadata as m\ntry: print(m.version({peer!r}))\nexcept m.PackageNotFoundError: print('')"
    return subprocess.run([python, "-c", code], check=True, capture_output=True, text=True).stdout.strip()


if __name__ == "__main__":
    for wanted in sys.argv[1:] or VERSIONS:
        print(make(wanted))
