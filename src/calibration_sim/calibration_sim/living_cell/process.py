"""The process of the simulated cell: steps it in time, and ends on a signal."""

from __future__ import annotations

import os
import signal
import sys
import threading
import time
from collections.abc import Sequence

import rclpy
from rclpy.executors import ExternalShutdownException, ShutdownException, SingleThreadedExecutor
from rclpy.signals import SignalHandlerOptions

from calibration_core.errors import InputError
from calibration_sim.living_cell.node import SimulatedCell

STARTED_BY = "CALIBRATION_STARTED_BY"  # in the environment, where a launch that ends its processes has started it
LATE = 0.5  # s; a cell that lags behind further than this does not try to catch up
SEEN = 1.0  # s of wall time, a robot that stands is seen standing before the cell ends
LONGEST = 10.0  # s of wall time, that the cell goes on for a robot that moves


def live_on(node: SimulatedCell, stop: threading.Event, parent: int) -> None:
    """Step the cell at its multiple of real time until told to stop, or until its parent (0: it has none) has ended.

    A cell that cannot keep up runs slower.

    A robot that moves then moves on, as a real one would: the cell ends when it stands, and was seen to.
    """
    anchor, at = time.monotonic(), node.live.time
    asked = rest = -1.0  # s of the steady clock: when it was asked to stop, until when it goes on
    while True:
        if parent and os.getppid() != parent:
            stop.set()
        if stop.is_set():
            now = time.monotonic()
            rest = now + SEEN if asked < 0.0 or node.live.moving else rest
            asked = now if asked < 0.0 else asked
            if now > min(rest, asked + LONGEST):
                return
        until = node.schedule.next(node.live.time)
        ahead = (until - at) / node.speed - (time.monotonic() - anchor)
        if ahead < -LATE:
            anchor, at = time.monotonic(), until
        elif ahead > 0.0:
            time.sleep(ahead)
        node.step(until)


def main(args: Sequence[str] | None = None) -> int:
    """Run the simulated cell until a signal ends it; 0, or 2 with one line on stderr if the input cannot be used."""
    stop, over = threading.Event(), threading.Event()
    for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP):
        if number is not signal.SIGHUP or signal.getsignal(number) is not signal.SIG_IGN:  # `nohup` ignores it
            signal.signal(number, lambda *_: stop.set())
    rclpy.init(args=sys.argv if args is None else list(args), signal_handler_options=SignalHandlerOptions.NO)
    try:
        try:
            node = SimulatedCell()
        except InputError as error:
            sys.stderr.write(f"{error}\n")
            return 2
        executor = SingleThreadedExecutor()
        executor.add_node(node)

        def spin() -> None:
            try:
                while not over.is_set():
                    executor.spin_once()
            except (ExternalShutdownException, ShutdownException):
                return

        thread = threading.Thread(target=spin, name="executor", daemon=True)
        thread.start()
        live_on(node, stop, os.getppid() if STARTED_BY in os.environ else 0)
        over.set()
        executor.create_task(lambda: None)  # wakes it: an executor that is shut down while it spins breaks
        thread.join(timeout=1.0)
        executor.shutdown(timeout_sec=1.0)
        node.close()
        node.destroy_node()
        return 0
    finally:
        rclpy.try_shutdown()


if __name__ == "__main__":
    sys.exit(main())
