"""How a process ends that is asked to end while its modules are still being loaded.

Loading a node takes a second or two.  A signal would raise KeyboardInterrupt wherever the interpreter happens to be:
that prints a traceback, and inside a callback of the interpreter it is ignored, and the process runs on.
"""

from __future__ import annotations

import importlib
import os
import signal
from collections.abc import Callable
from typing import Any

SIGNALS = (signal.SIGINT, signal.SIGTERM)


def load(module: str, name: str) -> Callable[[], Any]:
    """Import a module while SIGINT and SIGTERM end the process at once; return one of its functions.

    Nothing has begun yet, so that nothing is left half done, and the exit code is 0.  The function sets the handlers
    that hold from then on.

    Raises:
        ImportError: There is no such module.
        AttributeError: The module has no such function.
    """
    for number in SIGNALS:
        signal.signal(number, lambda *_: os._exit(0))
    function: Callable[[], Any] = getattr(importlib.import_module(module), name)
    return function
