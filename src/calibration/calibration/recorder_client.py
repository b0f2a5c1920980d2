"""The recorder as the sequencer uses it: its bag is opened before a run, and closed after it."""

from __future__ import annotations

import time
from typing import Any

from rclpy.node import Node
from std_srvs.srv import Trigger

from calibration.cell_port import call_and_wait

CALL_TIME = 5.0  # s of wall time, the recorder has to answer, and to hear everything
LOOK = 0.05  # s of wall time between two looks


class Recorder:
    """Calls the recorder's services from a thread that is not the executor's; without a recorder it does nothing."""

    def __init__(self, node: Node, name: str) -> None:
        """Take the recorder's name; empty: there is none."""
        self._node = node
        services = ("open", "hears", "close") if name else ()
        self._clients = {what: node.create_client(Trigger, f"{name}/{what}") for what in services}

    def open(self) -> None:
        """Open the bag, and wait until every instrument is heard: what is measured first would be missing in it."""
        if not self._there("open") or self._ask("open") is None:
            return
        end = time.monotonic() + CALL_TIME
        while (answer := self._ask("hears")) is not None and not answer.success:
            if time.monotonic() > end:
                self._node.get_logger().error(f"recorder: {answer.message}")
                return
            time.sleep(LOOK)

    def close(self) -> None:
        """Close the bag, so that it can be evaluated."""
        if self._there("close"):
            self._ask("close")

    def _there(self, what: str) -> bool:
        return what in self._clients and bool(self._clients[what].service_is_ready())

    def _ask(self, what: str) -> Any:
        answer = call_and_wait(self._node, self._clients[what], Trigger.Request(), CALL_TIME)
        if answer is None:
            self._node.get_logger().error(f"the recorder does not answer to {what}")
        return answer
