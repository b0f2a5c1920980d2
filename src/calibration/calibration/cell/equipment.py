"""What a measurement needs besides the robot: recorder, instruments and identification; who is lost pauses the run."""

from __future__ import annotations

import time
from typing import Any

from calibration_interfaces.msg import NodeHealth, SampleCheck
from lifecycle_msgs.msg import State
from rclpy.qos import QoSProfile

from calibration.cell.description_watch import DescriptionWatch
from calibration.cell.recorder_client import Recorder
from calibration.lifecycle.heartbeat import TOPIC
from calibration.topics import SAMPLE_CHECK


class Equipment:
    """Listens to the signs of life of the recorder and of other nodes.

    A node that has never been heard is not missed: instruments may be served by somebody else.
    """

    def __init__(self, recorder: Recorder, description: DescriptionWatch, max_age: float) -> None:
        """Prepare; `listen` begins.

        Args:
            recorder: Of the run.
            description: What the driver says of the robot.
            max_age: s of wall time; a node without a sign of life for longer is lost.
        """
        self._recorder, self._description, self._max_age = recorder, description, max_age
        self._two_sources: dict[str, str] = {}  # stream -> who publish it
        self._heard: dict[str, tuple[float, str]] = {}  # node -> s of the steady clock, why it does not work

    def listen(self, node: Any) -> None:
        """Listen to the recorder, the instruments that the sequencer's parameters name, and the identification."""
        self._heard.clear()
        self._two_sources.clear()
        self._recorder.listen()
        instruments = [node.value(name).rpartition("/")[0] for name in ("tracker", "force_torque")]
        for name in [*filter(None, instruments), "identification"]:
            self._hear(node, name)
        check = SAMPLE_CHECK
        node.create_subscription(check.message, check.relative, self._on_check, check.qos)

    def _on_check(self, message: Any) -> None:
        """Note a stream that two publish: whatever is read of it is nobody's, until one has ended."""
        name = str(message.name)
        if message.problem == SampleCheck.TWO_SOURCES:
            self._two_sources[name] = f"{name}: {message.text}"
        else:
            self._two_sources.pop(name, None)

    def _hear(self, node: Any, name: str) -> None:
        def take(message: NodeHealth) -> None:
            active = message.lifecycle.id == State.PRIMARY_STATE_ACTIVE
            self._heard[name] = (time.monotonic(), "" if active else f"is {message.lifecycle.label}")

        node.create_subscription(NodeHealth, f"{name}/{TOPIC}", take, QoSProfile(depth=1))

    def fault(self, now: float) -> str:
        """Say who is missing; empty if nobody is.  `now` is s of the steady clock."""
        faults = [self._description.fault, self._recorder.fault(now), *list(self._two_sources.values())]
        for name, (heard, why) in list(self._heard.items()):
            if now - heard > self._max_age:
                faults.append(f"{name} is silent for {now - heard:.1f} s")
            elif why:
                faults.append(f"{name} {why}")
        return "; ".join(filter(None, faults))

    def recorded(self, since: float) -> bool:
        """Tell whether the recorder has given a sign of life after a moment, s of the steady clock."""
        return self._recorder.heard_since(since)

    def ready(self, since: float) -> bool:
        """Tell whether everybody has: nothing begins on a word that may be older than the loss of who gave it."""
        return self.recorded(since) and all(heard > since for heard, _ in list(self._heard.values()))

    def tick(self, now: float) -> None:
        """Bring a recorder back to the run's bag."""
        self._recorder.tick(now)
