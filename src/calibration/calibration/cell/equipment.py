"""What a measurement needs besides the robot: recorder, instruments and identification; who is lost pauses the run.

The recorder gets the place of the session's bag, is listened to, and is closed at the end.
"""

from __future__ import annotations

import dataclasses
import math
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

from calibration_interfaces.msg import NodeHealth, Outcome, SampleCheck
from calibration_interfaces.srv import Record
from std_srvs.srv import Trigger

from calibration.asks import Server, Until, wait_until
from calibration.cell.watches import DescriptionWatch
from calibration.conversions import to_stamp
from calibration.node import QOS, TOPIC
from calibration.rclpy_gaps import Waiting
from calibration.topics import RECORDING, SAMPLE_CHECK

CALL_TIME = 5.0  # s of wall time, the recorder has to answer, and to hear everything
AGAIN = 2.0  # s of wall time, after which a recorder that does something else is asked again
BEHIND = 5.0  # s of wall time, what came may wait for the disk


@dataclasses.dataclass(frozen=True)
class Wanted:
    """The bag that a run needs: directory, hash of the plan, session, and the time (ns) from which it is that one's."""

    directory: Path
    plan_sha256: str
    since: int
    session: str = ""

    def request(self) -> Any:
        """Return it as a request to the recorder."""
        since, named = to_stamp(self.since), self.session
        return Record.Request(directory=str(self.directory), plan_sha256=self.plan_sha256, since=since, session=named)


class Recorder:
    """Watches the recorder; without one it asks for nothing, and finds no fault."""

    def __init__(self, node: Any, name: str, max_age: float) -> None:
        """Listen to its signs of life.

        Args:
            node: The sequencer.
            name: The recorder's name; empty: there is none.
            max_age: s of wall time; without a sign of life for longer, the recorder counts as lost.
        """
        self._node, self.name, self._max_age = node, name, max_age
        self._state: Any = None
        self._heard = self._asked = -math.inf  # s of the steady clock
        self._wanted: Wanted | None = None
        self._refusal = ""  # why it could not go on in the bag when it was asked last
        if name:
            self._record = Server(node, Record, f"{name}/record")
            self._triggers = {what: Server(node, Trigger, f"{name}/{what}") for what in ("hears", "close")}
            self._states = Waiting(node, RECORDING.message, RECORDING.relative, RECORDING.qos)

    def take(self) -> None:
        """Take the recorder's signs of life that have come."""
        for message, arrived, _ in self._states.arrivals() if self.name else ():
            self._state, self._heard = message, arrived

    def missing(self, wait: float, until: Until = wait_until) -> str:
        """Wait for the recorder, and until it hears every instrument that publishes; return what is missing.

        What is measured before would not be in the bag.
        """
        if not self.name:
            return ""
        end = time.monotonic() + wait
        if not until(self._lives, wait):
            return f"no recorder {self.name}: start one, or nothing is recorded"
        answer = None

        def hears() -> bool:
            nonlocal answer
            answer = self._triggers["hears"].call(Trigger.Request(), CALL_TIME, until)
            return answer is not None and bool(answer.success)

        if until(hears, max(end - time.monotonic(), CALL_TIME)):
            return ""
        return f"recorder: {'no answer' if answer is None else answer.message}"

    def _lives(self) -> bool:
        return time.monotonic() - self._heard <= self._max_age

    def record(self, wanted: Wanted, until: Until = wait_until) -> str:
        """Have the recorder go on in the bag of a session; return what is wrong, empty if nothing is."""
        if not self.name:
            return ""
        self._wanted = wanted
        answer = self._record.call(wanted.request(), CALL_TIME, until)
        if answer is None:
            return f"the recorder {self.name} does not answer"
        if answer.outcome.code != Outcome.OK:
            return str(answer.outcome.text)
        until(lambda: not self.fault(time.monotonic()), CALL_TIME)
        return self.fault(time.monotonic())

    def fault(self, now: float) -> str:
        """Say why the session is not being recorded; empty if it is.

        Args:
            now: s of the steady clock.
        """
        wanted, state = self._wanted, self._state
        if wanted is None:
            return ""
        age = now - self._heard
        if state is None or age > self._max_age:
            return f"the recorder {self.name} is silent{'' if state is None else f' for {age:.1f} s'}"
        if not state.recording:
            why = f": {self._refusal}; it goes on by itself once that is put right" if self._refusal else ""
            return f"the recorder {self.name} has closed its bag{why}"
        if state.directory != str(wanted.directory) or state.plan_sha256 != wanted.plan_sha256:
            return f"the recorder {self.name} records to {state.directory}, not to {wanted.directory}"
        if state.behind > BEHIND:
            return f"the recorder {self.name} has not come to write for {state.behind:.1f} s"
        return ""

    def heard_since(self, moment: float) -> bool:
        """Tell whether the recorder has given a sign of life after a moment, s of the steady clock."""
        return self._wanted is None or self._heard > moment

    def tick(self, now: float) -> None:
        """Ask a recorder that lives and does something else, as one that was started again, to go on in the bag."""
        if self._wanted is None or now - self._heard > self._max_age or now - self._asked < AGAIN:
            return
        if self.fault(now):
            self._asked = now
            self._record.drop()
            self._record.ask(self._wanted.request(), self._on_answer)

    def _on_answer(self, answer: Any, _text: str) -> None:
        if answer is not None:
            self._refusal = str(answer.outcome.text)

    def recorded(self, session: Path, bag: str) -> tuple[Path, str]:
        """Return where a session was recorded, and what is wrong: without a recorder, the session is the recording."""
        if not self.name:
            return session, ""
        if any((session / bag).glob("*.mcap")):
            return session / bag, ""
        return session, f"{session / bag}: found no bag, expected the recorder's"

    def close(self) -> None:
        """Close the bag, so that it can be evaluated; one that has fallen silent is not waited for."""
        if self._wanted is None:
            return
        self._wanted = None

        def until(condition: Callable[[], bool], seconds: float) -> bool:
            return wait_until(lambda: condition() or not self._lives(), seconds) and condition()

        if self._triggers["close"].call(Trigger.Request(), CALL_TIME, until) is None:
            self._node.get_logger().error(f"the recorder {self.name} does not answer to close")


class Equipment:
    """Listens to the signs of life of the recorder and of other nodes.

    A node that has never been heard is not missed: instruments may be served by somebody else.
    """

    def __init__(self, node: Any, recorder: Recorder, description: DescriptionWatch, max_age: float) -> None:
        """Listen to the instruments that the sequencer's parameters name, and to the identification.

        Args:
            node: The sequencer.
            recorder: Of the run.
            description: What the driver says of the robot.
            max_age: s of wall time; a node without a sign of life for longer is lost.
        """
        self._recorder, self._description, self._max_age = recorder, description, max_age
        self._two_sources: dict[str, str] = {}  # stream -> who publish it
        self._heard: dict[str, float] = {}  # node -> s of the steady clock
        instruments = [node.value(name).rpartition("/")[0] for name in ("tracker", "force_torque")]
        wanted: dict[str, dict[str, str]] = {}  # topic -> name of a node -> with the namespace, as the parameter has it
        for name in [*filter(None, instruments), "identification"]:
            space, slash, own = name.rpartition("/")
            wanted.setdefault(f"{space}{slash}{TOPIC}", {})[own] = name
        self._signs = [(names, Waiting(node, NodeHealth, topic, QOS)) for topic, names in wanted.items()]
        self._checks = Waiting(node, SAMPLE_CHECK.message, SAMPLE_CHECK.relative, SAMPLE_CHECK.qos)

    def take(self) -> None:
        """Take what has come; to be called some times in the age of a sign of life."""
        self._recorder.take()
        for names, signs in self._signs:
            for message, arrived, _ in signs.arrivals():
                if message.name in names:
                    self._heard[names[message.name]] = arrived
        for message in self._checks.take():
            self._on_check(message)

    def _on_check(self, message: Any) -> None:
        """Note a stream that two publish: whatever is read of it is nobody's, until one has ended."""
        name = str(message.name)
        if message.problem == SampleCheck.TWO_SOURCES:
            self._two_sources[name] = f"{name}: {message.text}"
        else:
            self._two_sources.pop(name, None)

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
