"""`manager`: brings the nodes up and down in order, notices when one falls silent, and tells the state of the cell.

It asks for transitions as `ros2 lifecycle` does, and has no other authority: it moves nothing, permits nothing, ends no
node because another one has ended.  A node that comes back is brought up again; one that an operator deactivates is
left alone.  `calibration/state` is everything that a panel needs, in one message.
"""

from __future__ import annotations

import dataclasses
import math
import sys
import time
from collections.abc import Generator, Sequence
from functools import partial
from typing import Any

from calibration_interfaces.msg import Conditions, NodeHealth
from lifecycle_msgs.msg import Transition
from lifecycle_msgs.srv import ChangeState
from rclpy.callback_groups import ReentrantCallbackGroup
from rclpy.clock import Clock, ClockType
from rclpy.event_handler import SubscriptionEventCallbacks
from rclpy.qos import QoSProfile
from std_srvs.srv import Trigger

from calibration.conversions import to_header
from calibration.lifecycle import machine
from calibration.lifecycle.heartbeat import LEASE, TOPIC, quality
from calibration.lifecycle.order import Order
from calibration.node import CalibrationNode, Declared, run
from calibration.status.faults import MISSED
from calibration.status.whole import Whole
from calibration.topics import (
    CONDITIONS_QUALITY,
    PERMISSION,
    PROCEDURE,
    PROGRESS,
    READING,
    ROBOT_STATE,
    SAMPLE_CHECK,
    STATE,
    profile,
)
from calibration_core.cell import load_cell

# The guard is the first to come and the last to go; the sequencer comes when everything that it needs is there.
# What puts a result to use is needed by nobody, and keeps nobody waiting.
NAMES = ("guard", "recorder", "tracker", "force_torque", "identification", "sequencer", "compensation")
LOOK = 0.1  # s of wall time between two looks, and at least between two messages
PERIOD = 0.2  # s of wall time between two messages that tell nothing new: who reads them sees at once that none comes
ANSWER = 30.0  # s of wall time, that a transition may take
LOST = 3.0  # s of wall time, after which a request that began nothing counts as lost: its server may have been dead
GOALS = {
    machine.CONFIGURE: machine.INACTIVE,
    machine.ACTIVATE: machine.ACTIVE,
    machine.DEACTIVATE: machine.INACTIVE,
    machine.CLEANUP: machine.UNCONFIGURED,
}

PARAMETERS = (
    Declared("cell", "", "The cell file.", required=True),
    Declared("nodes", list(NAMES), "Nodes, in the order in which they are brought up."),
    Declared("bring_up", True, "Whether nodes are brought up when they appear; false: when ~/startup is called."),
    Declared("permission_age", 0.5, "s, that the guard's last word is shown.", low=0.02, high=10.0),
)


@dataclasses.dataclass(frozen=True)
class _Asked:
    """A transition that was asked for."""

    name: str
    transition: int
    future: Any
    since: float


class ManagerNode(CalibrationNode):
    """Brings up, takes down, watches and tells."""

    def __init__(self, **kwargs: Any) -> None:
        """Make the node.

        Raises:
            InputError: A parameter or the cell file cannot be used.
        """
        super().__init__("manager", PARAMETERS, **kwargs)

    def on_configure(self) -> None:
        """Offer the services and the state of the cell."""
        self.cell = load_cell(self.value("cell"), live=True)
        names: tuple[str, ...] = tuple(self.value("nodes"))
        self.order = Order(names, LEASE, time.monotonic())
        self.order.up = self.value("bring_up")
        self.whole = Whole(names, self.value("permission_age"))
        self._changers = {name: self._changer(name) for name in names}
        self._asked: _Asked | None = None
        self._reported: dict[str, object] = {}
        self._sent = -math.inf
        self._publisher = self.create_publisher(STATE.message, STATE.relative, STATE.qos)
        group = ReentrantCallbackGroup()
        self.create_service(Trigger, "~/startup", self._on_startup, callback_group=group)
        self.create_service(Trigger, "~/shutdown", self._on_shutdown, callback_group=group)
        self.create_service(Trigger, "~/is_active", self._on_is_active)

    def _changer(self, name: str) -> Any:
        return self.create_client(ChangeState, f"{name}/change_state")

    def on_activate(self) -> None:
        """Listen to every node, and to what they say of the cell."""
        for name in self.order.members:
            lost = SubscriptionEventCallbacks(liveliness=partial(self._on_liveliness, name))
            hear = partial(self._on_heartbeat, name)
            self.create_subscription(NodeHealth, f"{name}/{TOPIC}", hear, quality(), event_callbacks=lost)
        for topic, field in (
            (PROCEDURE, "procedure"),
            (PERMISSION, "permission"),
            (ROBOT_STATE, "robot"),
            (PROGRESS, "progress"),
        ):
            self.create_subscription(topic.message, topic.relative, partial(self._on_part, field), topic.qos)
        conditions = self.cell.topics.conditions.lstrip("/")
        self.create_subscription(
            Conditions, conditions, partial(self._on_part, "conditions"), profile(CONDITIONS_QUALITY)
        )
        self.create_subscription(SAMPLE_CHECK.message, SAMPLE_CHECK.relative, self.whole.hear_stream, SAMPLE_CHECK.qos)
        now = QoSProfile(depth=100)  # what was said before belongs to no run under way
        self.create_subscription(READING.message, READING.relative, self._on_reading, now)
        self.create_timer(LOOK, self._look, clock=Clock(clock_type=ClockType.STEADY_TIME))

    # --- what is heard -----------------------------------------------------------------------------------------------

    def _on_part(self, field: str, message: Any) -> None:
        self.whole.hear(field, message, time.monotonic())

    def _on_reading(self, message: Any) -> None:
        self.whole.hear_reading(message, time.monotonic())

    def _on_heartbeat(self, name: str, message: NodeHealth) -> None:
        message.name = name  # a remapping may have renamed the node, not its place in the order
        self.whole.hear_node(message)
        if self.order.hear(name, int(message.process), int(message.lifecycle.id), time.monotonic()):
            self.get_logger().info(f"{name} is heard: process {message.process}, {message.lifecycle.label}")

    def _on_liveliness(self, name: str, event: Any) -> None:
        now = time.monotonic()
        if event.alive_count == 0 and event.not_alive_count_change > 0 and self.order.lose(name, now):
            self._miss(name)

    def _miss(self, name: str) -> None:
        self.get_logger().error(f"{name} is silent: {MISSED.get(name, 'it does not work')}")

    # --- what is done ------------------------------------------------------------------------------------------------

    def _look(self) -> None:
        now = time.monotonic()
        for name in self.order.silent(now):
            self._miss(name)
        self._follow(now)
        if self._asked is None:
            step = self.order.next(now)
            if step is not None:
                self._ask(*step, now)
        self._report(now)

    def _ask(self, name: str, transition: int, now: float) -> None:
        client = self._changers[name]
        if client.service_is_ready():
            future = client.call_async(ChangeState.Request(transition=Transition(id=transition)))
            self._asked = _Asked(name, transition, future, now)

    def _follow(self, now: float) -> None:
        """See what became of the transition that was asked for."""
        asked = self._asked
        if asked is None:
            return
        member = self.order.members[asked.name]
        refused = asked.future.done() and not (asked.future.exception() is None and asked.future.result().success)
        lost = now - asked.since > (ANSWER if member.state in (machine.CONFIGURING, machine.DEACTIVATING) else LOST)
        if not refused and not lost and member.alive and member.state != GOALS[asked.transition]:
            return
        if refused or (lost and member.alive):
            self.get_logger().error(f"{asked.name} does not become {machine.LABELS[GOALS[asked.transition]]}")
            self.order.fail(asked.name, now)
        if not asked.future.done():  # the client may know a dead server alone, whatever its successor does
            self.destroy_client(self._changers[asked.name])
            self._changers[asked.name] = self._changer(asked.name)
        self._asked = None

    def _report(self, now: float) -> None:
        """Send the state if it is news, and once a period."""
        message = self.whole.message(self.order, now)
        news = self.whole.news(message)
        if news == self._reported and now - self._sent < PERIOD:
            return
        self._reported, self._sent = news, now
        message.header = to_header(self.now_ns())
        self._publisher.publish(message)
        gravest = max((int(one.level) for one in message.faults), default=0)
        self.diagnostics.report("cell", gravest, "; ".join(str(one.text) for one in message.faults) or "all is well")

    # --- what is asked -----------------------------------------------------------------------------------------------

    async def _on_startup(self, _request: Any, response: Any) -> Any:
        self.order.bring(up=True)
        await _Until(lambda: self.order.all_active or not self.order.up, ANSWER)
        response.success = self.order.all_active
        response.message = self._inactive()
        return response

    async def _on_shutdown(self, _request: Any, response: Any) -> Any:
        self.order.bring(up=False)
        await _Until(lambda: self.order.all_down or self.order.up, ANSWER)
        response.success = self.order.all_down
        up = [one.name for one in self.order.members.values() if one.alive and one.state != machine.UNCONFIGURED]
        response.message = "" if response.success else f"still up: {', '.join(up)}"
        return response

    def _on_is_active(self, _request: Any, response: Any) -> Any:
        response.success, response.message = self.order.all_active, self._inactive()
        return response

    def _inactive(self) -> str:
        members = self.order.members.values()
        parts = [f"{one.name} is {machine.LABELS[one.state] if one.alive else 'not heard'}" for one in members
                 if not one.alive or one.state != machine.ACTIVE]  # fmt: skip
        return ", ".join(parts)


class _Until:
    """Awaits a condition, or the end of some time; the node's timer looks again and again."""

    def __init__(self, condition: Any, seconds: float) -> None:
        self._condition, self._end = condition, time.monotonic() + seconds

    def __await__(self) -> Generator[None, None, None]:
        while not self._condition() and time.monotonic() < self._end:
            yield


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the node; return the exit code."""
    return run(ManagerNode, arguments)


if __name__ == "__main__":
    sys.exit(main())
