"""States and transitions of a managed node, as ROS 2 defines them (design.ros2.org/articles/node_lifecycle.html).

Pure bookkeeping: what the transitions do stands in the nodes.  Numbers and labels are those of `lifecycle_msgs`, and a
test compares the whole table with that of rcl.  rclpy's own lifecycle node is not used: in 7.1.6 a transition that is
not possible ends its process, exceptions of callbacks vanish, and a slow callback blocks every other one.
"""

from __future__ import annotations

import dataclasses
import threading

UNKNOWN, UNCONFIGURED, INACTIVE, ACTIVE, FINALIZED = range(5)
CONFIGURING, CLEANING_UP, SHUTTING_DOWN, ACTIVATING, DEACTIVATING, ERROR_PROCESSING = range(10, 16)
CONFIGURE, CLEANUP, ACTIVATE, DEACTIVATE = 1, 2, 3, 4

LABELS = {
    UNKNOWN: "unknown",
    UNCONFIGURED: "unconfigured",
    INACTIVE: "inactive",
    ACTIVE: "active",
    FINALIZED: "finalized",
    CONFIGURING: "configuring",
    CLEANING_UP: "cleaningup",
    SHUTTING_DOWN: "shuttingdown",
    ACTIVATING: "activating",
    DEACTIVATING: "deactivating",
    ERROR_PROCESSING: "errorprocessing",
}


@dataclasses.dataclass(frozen=True)
class Edge:
    """One transition: its number and label, and the states at its ends."""

    id: int
    label: str
    start: int
    goal: int


def _passing(state: int, first: int, success: int, failure: int) -> tuple[Edge, ...]:
    """Return the three ways out of a transition state."""
    return (
        Edge(first, "transition_success", state, success),
        Edge(first + 1, "transition_failure", state, failure),
        Edge(first + 2, "transition_error", state, ERROR_PROCESSING),
    )


GRAPH = (
    Edge(CONFIGURE, "configure", UNCONFIGURED, CONFIGURING),
    *_passing(CONFIGURING, 10, INACTIVE, UNCONFIGURED),
    Edge(CLEANUP, "cleanup", INACTIVE, CLEANING_UP),
    *_passing(CLEANING_UP, 20, UNCONFIGURED, INACTIVE),
    Edge(ACTIVATE, "activate", INACTIVE, ACTIVATING),
    *_passing(ACTIVATING, 30, ACTIVE, INACTIVE),
    Edge(DEACTIVATE, "deactivate", ACTIVE, DEACTIVATING),
    *_passing(DEACTIVATING, 40, INACTIVE, ACTIVE),
    Edge(5, "shutdown", UNCONFIGURED, SHUTTING_DOWN),
    Edge(6, "shutdown", INACTIVE, SHUTTING_DOWN),
    Edge(7, "shutdown", ACTIVE, SHUTTING_DOWN),
    *_passing(SHUTTING_DOWN, 50, FINALIZED, FINALIZED),
    Edge(60, "transition_success", ERROR_PROCESSING, UNCONFIGURED),
    Edge(61, "transition_failure", ERROR_PROCESSING, FINALIZED),
    Edge(62, "transition_error", ERROR_PROCESSING, FINALIZED),
)
ASKED = tuple(edge for edge in GRAPH if edge.start <= FINALIZED)  # those that somebody outside may ask for


class Machine:
    """Where a node stands; one transition at a time, whichever thread asks for it."""

    def __init__(self) -> None:
        """Begin unconfigured."""
        self._state = UNCONFIGURED
        self._lock = threading.Lock()

    @property
    def state(self) -> int:
        """The state's number; label in `LABELS`."""
        return self._state

    @property
    def available(self) -> tuple[Edge, ...]:
        """The transitions that are possible now."""
        return tuple(edge for edge in GRAPH if edge.start == self._state)

    def begin(self, number: int, label: str = "") -> Edge | None:
        """Begin the transition that is asked for; None if it is not possible now, or unknown.

        Args:
            number: Of the transition.
            label: Its label, which counts instead of the number where it is given.
        """
        with self._lock:
            for edge in ASKED:
                if edge.start == self._state and (edge.label == label if label else edge.id == number):
                    self._state = edge.goal
                    return edge
        return None

    def end(self, *, success: bool) -> Edge:
        """End the transition under way; return the edge taken."""
        with self._lock:
            label = "transition_success" if success else "transition_failure"
            edge = next(one for one in GRAPH if (one.start, one.label) == (self._state, label))
            self._state = edge.goal
            return edge
