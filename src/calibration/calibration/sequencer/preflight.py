"""What a run needs in the cell, looked for before anything moves: everything that is missing is named at once."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable, Sequence
from typing import Any

from rclpy.node import Node

from calibration.cell.clients import ActionPort
from calibration.cell.permission import PermissionWatch
from calibration.cell.port import call_and_wait
from calibration.motion.arrival import Joints
from calibration.motion.calls import succeeded

Check = Callable[[float], str]
"""Waits up to so many s of wall time; returns what is missing, empty if nothing is."""
AT_LEAST = 0.3  # s, that every check has, however long those before it took
POLL = 0.02  # s


def missing(checks: Iterable[Check], wait: float) -> str:
    """Return all that is missing, in the order of the checks, after `wait` s that they share; empty if nothing is."""
    end = time.monotonic() + wait
    return "; ".join(filter(None, [check(max(end - time.monotonic(), AT_LEAST)) for check in checks]))


def prepared(node: Node, calls: Sequence[tuple[Any, Any]]) -> Check:
    """Return a check that calls services (client, request) in their order, up to the first that fails."""

    def check(wait: float) -> str:
        for client, request in calls:
            answer = call_and_wait(node, client, request, wait)
            if answer is None:
                return f"{client.srv_name}: no answer"
            success, text = succeeded(answer)
            if not success:
                return f"{client.srv_name}: {text or 'refused'}"
        return ""

    return check


def served(port: ActionPort) -> Check:
    """Return a check that an action has a server."""
    return lambda wait: "" if port.ready(wait) else f"no action server {port.name}"


def joints_heard(joints: Joints, topic: str) -> Check:
    """Return a check that joint states come."""

    def check(wait: float) -> str:
        end = time.monotonic() + wait
        while joints.latest is None:
            if time.monotonic() > end:
                return f"no joint states on {topic}"
            time.sleep(POLL)
        return ""

    return check


def guard_ready(watch: PermissionWatch, wait: float) -> bool:
    """Wait for the guard to find nothing against motion, but for the proof; a latched fault does not go by itself.

    Where it finds something, nothing moves before the operator resumes motion, whatever is reset meanwhile.
    """
    end = time.monotonic() + wait
    while not watch.ready(time.monotonic()):
        if time.monotonic() > end or watch.latched:
            return False
        time.sleep(POLL)
    return True
