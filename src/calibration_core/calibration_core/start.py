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
    """Load the program and run it; return the exit code."""
    before = {number: signal.signal(number, _end) for number in ENDINGS}
    from calibration_core import cli

    for number, handler in before.items():
        signal.signal(number, handler)
    try:
        return cli.main()
    except KeyboardInterrupt:  # while the arguments are read; what comes then ends by itself
        _end(signal.SIGINT, None)
        return ENDINGS[signal.SIGINT][0]


def _end(number: int, _: FrameType | None) -> None:
    """End the process at once: nothing has begun yet, so that nothing is left half done."""
    code, word = ENDINGS[signal.Signals(number)]
    if sys.stderr is not None:
        os.write(2, f"calibration: {word}, nothing was written\n".encode())
    os._exit(code)


if __name__ == "__main__":
    sys.exit(main())
