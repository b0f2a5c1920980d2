"""What a measurement needs besides the robot: recorder, instruments and identification; who is lost pauses the run."""

from __future__ import annotations

import functools
import time
from collections.abc import Mapping
from typing import Any

from calibration_interfaces.msg import NodeHealth, SampleCheck

from calibration.cell.description_watch import DescriptionWatch
from calibration.cell.recorder_client import Recorder
from calibration.health import QOS, TOPIC
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
        self._heard: dict[str, float] = {}  # node -> s of the steady clock

    def listen(self, node: Any) -> None:
        """Listen to the recorder, the instruments that the sequencer's parameters name, and the identification."""
        self._recorder.listen()
        instruments = [node.value(name).rpartition("/")[0] for name in ("tracker", "force_torque")]
        wanted: dict[str, dict[str, str]] = {}  # topic -> name of a node -> with the namespace, as the parameter has it
        for name in [*filter(None, instruments), "identification"]:
            space, slash, own = name.rpartition("/")
            wanted.setdefault(f"{space}{slash}{TOPIC}", {})[own] = name
        for topic, names in wanted.items():
            node.create_subscription(NodeHealth, topic, functools.partial(self._on_health, names), QOS)
        check = SAMPLE_CHECK
        node.create_subscription(check.message, check.relative, self._on_check, check.qos)

    def _on_check(self, message: Any) -> None:
        """Note a stream that two publish: whatever is read of it is nobody's, until one has ended."""
        name = str(message.name)
        if message.problem == SampleCheck.TWO_SOURCES:
            self._two_sources[name] = f"{name}: {message.text}"
        else:
            self._two_sources.pop(name, None)

    def _on_health(self, names: Mapping[str, str], message: Any) -> None:
        if message.name in names:
            self._heard[names[message.name]] = time.monotonic()

    def fault(self, now: float) -> str:
        """Say who is missing; empty if nobody is.  `now` is s of the steady clock."""
        faults = [self._description.fault, self._recorder.fault(now), *list(self._two_sources.values())]
        late = [(name, now - heard) for name, heard in list(self._heard.items()) if now - heard > self._max_age]
        faults += [f"{name} is silent for {age:.1f} s" for name, age in late]
        return "; ".join(filter(None, faults))

    def recorded(self, since: float) -> bool:
        """Tell whether the recorder has given a sign of life after a moment, s of the steady clock."""
        return self._recorder.heard_since(since)

    def ready(self, since: float) -> bool:
        """Tell whether everybody has: nothing begins on a word that may be older than the loss of who gave it."""
        return self.recorded(since) and all(heard > since for heard in list(self._heard.values()))

    def tick(self, now: float) -> None:
        """Bring a recorder back to the run's bag."""
        self._recorder.tick(now)
