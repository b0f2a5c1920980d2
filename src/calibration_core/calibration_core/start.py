"""Where the program `calibration` begins.  This module loads nothing: a signal is heeded from the first moment on.

Loading the program takes some tenths of a second, in which Python would answer Ctrl-C with a traceback.
"""

from __future__ import annotations

import os
import signal
import sys
from types import FrameType

ENDINGS = {signal.SIGINT: (130, "interrupted"), signal.SIGTERM: (143, "terminated")}


def main() -> int:
    """Load the program and run it; return the exit code.

    Outside of what a command does, which has handlers of its own, the ones of this module stay.
    """
    for number in ENDINGS:
        signal.signal(number, _end)
    from calibration_core import cli

    return cli.main()


def _end(number: int, _: FrameType | None) -> None:
    """End the process at once: nothing that could be left half done is under way."""
    code, word = ENDINGS[signal.Signals(number)]
    if sys.stderr is not None:
        os.write(2, f"calibration: {word}\n".encode())
    os._exit(code)


if __name__ == "__main__":
    sys.exit(main())
