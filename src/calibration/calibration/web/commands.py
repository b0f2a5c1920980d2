"""Commands of the command line that the panel offers: plans and verifications, in a process that is there meanwhile."""

from __future__ import annotations

import asyncio
import threading
from collections.abc import Callable, Sequence

from calibration.evaluation.worker import Worker

LOOK = 0.3  # s between two looks at how far it is
NICENESS = 10  # the measurement goes before


async def run_command(arguments: Sequence[str], progress: Callable[[float, str], None]) -> str:
    """Run a command; return why it failed, empty if it did not.  Whoever cancels the coroutine ends the process.

    Args:
        arguments: The command line, the command's name first.
        progress: Called with the share that is done and what is being done.
    """
    worker, given_up = Worker(niceness=NICENESS), threading.Event()
    work = asyncio.create_task(asyncio.to_thread(worker.do, arguments, given_up.is_set))
    try:
        while not work.done():
            progress(worker.progress.share, worker.progress.text)
            await asyncio.wait({work}, timeout=LOOK)
        finished = work.result()
    except RuntimeError as error:
        return str(error)
    finally:
        given_up.set()
        await asyncio.gather(work, return_exceptions=True)
        worker.close()
    return finished.text if finished.kind else ""
