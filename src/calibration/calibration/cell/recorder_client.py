"""The recorder as the sequencer uses it: told where the session's bag is, listened to, closed at the end."""

from __future__ import annotations

import dataclasses
import math
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

from calibration_interfaces.msg import Outcome
from calibration_interfaces.srv import Record
from std_srvs.srv import Trigger

from calibration.conversions import to_stamp
from calibration.rclpy_gaps import Until, called, wait_until
from calibration.topics import RECORDING

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
        """Prepare; `listen` begins.

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
            self._record = node.create_client(Record, f"{name}/record")
            self._triggers = {what: node.create_client(Trigger, f"{name}/{what}") for what in ("hears", "close")}

    def listen(self) -> None:
        """Listen to its signs of life."""
        if self.name:
            topic = RECORDING
            self._node.create_subscription(topic.message, topic.relative, self._on_state, topic.qos)

    def _on_state(self, message: Any) -> None:
        self._state, self._heard = message, time.monotonic()

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
            answer = called(self._triggers["hears"], Trigger.Request(), CALL_TIME, until)
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
        answer = called(self._record, wanted.request(), CALL_TIME, until)
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
            self._record.call_async(self._wanted.request()).add_done_callback(self._on_answer)

    def _on_answer(self, answer: Any) -> None:
        if answer.exception() is None:
            self._refusal = str(answer.result().outcome.text)

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

        if called(self._triggers["close"], Trigger.Request(), CALL_TIME, until) is None:
            self._node.get_logger().error(f"the recorder {self.name} does not answer to close")
