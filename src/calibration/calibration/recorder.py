"""Node `recorder`: every topic of the table to a bag, as raw bytes, on the disk within a fraction of a second.

A tick only takes what has come; a thread of its own opens, writes, syncs and closes bags.  `~/close` ends the bag's
file, so that it can be evaluated while the node lives on; `~/open` continues the bag with a further file.  `~/hears`
tells whether every instrument that publishes would be heard: what is measured before that would be missing in the bag.

Where the bag is, the session decides that is measured: `~/record` closes the present bag and goes on in the session's.
Twenty times a second the recorder says what it does; whoever measures and does not hear that stops.  A bag that cannot
be written any more, as on a full disk, is left as it is; a further file goes on as soon as that can be written.
"""

from __future__ import annotations

import collections
import contextlib
import functools
import math
import os
import queue
import re
import sys
import threading
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

from calibration_interfaces.msg import Outcome
from calibration_interfaces.srv import Record
from rclpy.callback_groups import ReentrantCallbackGroup
from rclpy.clock import Clock, ClockType
from rclpy.serialization import deserialize_message
from std_srvs.srv import Trigger

from calibration.conversions import stamp_ns, stamp_of, to_header, to_outcome
from calibration.node import CalibrationNode, Declared, run
from calibration.rclpy_gaps import Background, Waiting, in_executor
from calibration.topics import (
    READING,
    RECORDING,
    SAMPLES_DEPTH,
    Quality,
    Topic,
    contract_topics,
    incompatible,
    offered_qos,
    recorded_topics,
    session_topics,
    subscription_profile,
)
from calibration_core.cell import load_cell
from calibration_core.errors import OutputError
from calibration_core.recording.bags.live_writer import LiveBag, LiveTopic
from calibration_core.timeseries import NANOSECONDS

SEPARATOR = "=" * 80
BUILT_IN = {
    "bool", "byte", "char", "float32", "float64", "int8", "uint8", "int16", "uint16", "int32", "uint32", "int64",
    "uint64", "string", "wstring",
}  # fmt: skip
_FIELD = re.compile(r"^\s*([a-zA-Z][\w/]*)(<=\d+)?(\[[^\]]*\])?\s+[a-zA-Z]\w*")


def definition(kind: str) -> str:
    """Return the definition of `package/msg/Name`; empty if it, or one of the types in it, is not installed as text."""
    own = _text(kind)
    if own is None:
        return ""
    parts, done, todo = [own], {kind}, _used(kind, own)
    while todo:
        name = todo.pop(0)
        if name in done:
            continue
        done.add(name)
        text = _text(name)
        if text is None:
            return ""
        package, _, base = name.split("/")
        parts.append(f"{SEPARATOR}\nMSG: {package}/{base}\n{text}")
        todo += _used(name, text)
    return "\n".join(part.rstrip("\n") for part in parts) + "\n"


def _used(kind: str, text: str) -> list[str]:
    """Return the full names of the message types in a definition, in their order."""
    package = kind.split("/", maxsplit=1)[0]
    found = []
    for line in text.splitlines():
        match = _FIELD.match(line.split("#", 1)[0])
        name = match[1] if match else ""
        if not name or name in BUILT_IN:
            continue
        parts = name.split("/")
        found.append(f"{parts[0]}/msg/{parts[-1]}" if len(parts) > 1 else f"{package}/msg/{name}")
    return found


@functools.cache
def _text(kind: str) -> str | None:
    package, group, name = kind.split("/")
    prefixes = [*filter(None, os.environ.get("AMENT_PREFIX_PATH", "").split(os.pathsep)), sys.prefix]
    for prefix in prefixes:
        file = Path(prefix) / "share" / package / group / f"{name}.msg"
        if file.is_file():
            return file.read_text("utf-8")
    return None


TICK = 0.05  # s of wall time, after which what has come is taken, new publishers are looked for, and a sign is given
THOROUGH = 1.0  # s of wall time between looks at what all publishers offer
DRAIN = 2.0  # s of wall time, the executor may take until what has arrived is taken, when the node ends
SYNC_PERIOD = 0.25  # s of wall time after which what came is on the disk
AGAIN = 2.0  # s of wall time, after which a bag that could not be written is tried again

PARAMETERS = (
    Declared("cell", "", "The cell file.", required=True),
    Declared("out", "", "Directory of a bag from the start on; empty: nothing is recorded before a session asks."),
    Declared("compression", "none", "Of the chunks.", choices=("none", "lz4", "zstd")),
)

Item = tuple[Topic, int, bytes]
FOREIGN = "readings of {session} are heard, which is not the session that is recorded: look who plays a bag here"


class RecorderNode(CalibrationNode):
    """Records until it is stopped or told to close."""

    OWNER = "recorder"

    def __init__(self, **kwargs: Any) -> None:
        """Make the node."""
        super().__init__("recorder", PARAMETERS, **kwargs)

    def on_start(self) -> None:
        """Read the cell, offer the services, open the bag and wait for publishers."""
        cell = load_cell(self.value("cell"))
        self._topics = recorded_topics(cell)
        self._instruments = [topic for topic in contract_topics(cell) if topic.quality is Quality.SAMPLES]
        self._queue: collections.deque[Item] = collections.deque()
        self._infos: dict[str, LiveTopic] = {}
        self._numbers: dict[str, int] = {}
        self._asked: queue.Queue[Callable[[], None]] = queue.Queue()  # what the writer does next: it alone owns the bag
        self._place, self._plan, self._session = str(self.value("out")), "", ""
        self._lost = ""  # why the bag cannot be written
        self._foreign = ""  # another session, of which readings are heard
        self._session_topics, self._since = session_topics(cell), 0
        self._signs = self.create_publisher(RECORDING.message, RECORDING.relative, RECORDING.qos)
        self._bag: LiveBag | None = None
        self._ending = threading.Event()
        waiting = ReentrantCallbackGroup()  # these await the writer
        self.create_service(Record, "~/record", self._on_record, callback_group=waiting)
        self.create_service(Trigger, "~/close", self._on_close, callback_group=waiting)
        self.create_service(Trigger, "~/open", self._on_open, callback_group=waiting)
        self.create_service(Trigger, "~/hears", self._on_hears)
        self._heard: dict[str, tuple[Waiting, Any]] = {}
        self._counted: dict[str, int] = {}
        self._looked = -math.inf  # s of the monotonic clock
        self._written = time.monotonic()  # when everything that had come was last on the disk
        if self._place:
            self._open_bag()
        self._leaving = False
        self._writer = threading.Thread(target=self._write_on, name="writer", daemon=True)
        self._writer.start()
        self.create_timer(TICK, self._tick, clock=Clock(clock_type=ClockType.STEADY_TIME))
        self.create_timer(1.0, self._report, clock=Clock(clock_type=ClockType.STEADY_TIME))
        self._look()

    def _open_bag(self) -> None:
        self._bag = LiveBag(Path(self._place), self.value("compression"), self._plan)
        self._numbers, self._lost = {}, ""

    # --- what comes in ----------------------------------------------------------------------------------------

    def _tick(self) -> None:
        self._drain()
        self._look()
        self._sign()

    def _look(self) -> None:
        """Subscribe to what is published; our own topics at once, for their quality is known.

        Asking who publishes what is slow: topics whose number of publishers has not changed wait for the thorough look.
        """
        now = time.monotonic()
        thorough = now - self._looked >= THOROUGH
        if thorough:
            self._looked = now
        for topic in self._topics:
            count = self.count_publishers(topic.relative)
            if count == self._counted.get(topic.name, 0) and not thorough:
                continue
            self._counted[topic.name] = count
            offered = self.get_publishers_info_by_topic(topic.relative)
            if topic.name in self._heard:
                messages, asked = self._heard[topic.name]
                if not offered or not incompatible(self, topic.relative, asked):
                    continue
                self.destroy_subscription(messages.subscription)
            elif not offered and topic.quality is Quality.SAMPLES:
                continue
            profile = subscription_profile(self, topic.relative) if offered else topic.qos
            profile.depth = SAMPLES_DEPTH
            messages = Waiting(self, topic.message, topic.relative, profile, raw=True)
            self._heard[topic.name] = (messages, profile)

    def _wanted(self, topic: Topic, payload: bytes) -> bool:
        """Tell whether a message is recorded."""
        if topic.name in self._session_topics and stamp_of(payload) < self._since:
            return False  # of an earlier session: who comes late gets everything that was announced
        return topic is not READING or not self._of_another(deserialize_message(payload, topic.message).session)

    def _of_another(self, session: str) -> bool:
        """Tell whether a reading is of another session than the one that is recorded; it is told once."""
        if not self._session or session == self._session:
            return False
        if session != self._foreign:
            self._foreign = session
            self.get_logger().error(f"{FOREIGN.format(session=session or 'no session')}: they are not recorded")
        return True

    def _drain(self) -> None:
        """Take what has arrived; whoever asks to close the bag sent it all before.

        A message counts as received when it arrived; before the first word of a simulated clock, at no time.
        """
        clock, now = self.now_ns(), time.monotonic()
        came: list[Item] = []
        for topic in self._topics:
            if topic.name not in self._heard:
                continue
            for payload, arrived, _ in self._heard[topic.name][0].arrivals(SAMPLES_DEPTH):
                if topic.name not in self._infos:
                    self._infos[topic.name] = self._info(topic)
                if self._wanted(topic, payload):
                    came.append((topic, clock and clock - round((now - arrived) * NANOSECONDS), payload))
        self._queue.extend(sorted(came, key=lambda one: one[1]))

    def _info(self, topic: Topic) -> LiveTopic:
        offered = self.get_publishers_info_by_topic(topic.relative)
        hashes = {str(one.topic_type_hash) for one in offered}
        known = hashes.pop() if len(hashes) == 1 else ""
        qos = tuple(offered_qos(one.qos_profile) for one in offered)
        return LiveTopic(topic.name, topic.type, definition(topic.type), known, qos)

    # --- what goes out ----------------------------------------------------------------------------------------

    def _write_on(self) -> None:
        """Write what comes, and do what is asked; the writer's thread."""
        tried = time.monotonic()
        while not self._ending.is_set():
            with contextlib.suppress(queue.Empty):
                self._asked.get(timeout=SYNC_PERIOD)()
            self._write()
            if self._lost and time.monotonic() - tried > AGAIN:
                tried = time.monotonic()
                self._go_on()

    def _write(self, *, last: bool = False) -> bool:
        """Bring everything onto the disk that has come; False where that fails.

        What came before the first word of a simulated clock waits for it: it counts as received then.
        """
        try:
            written = False
            while self._queue:
                topic, received, payload = self._queue.popleft()
                if self._bag is None:
                    continue
                received = received or self.now_ns()
                if not received and not last:
                    self._queue.appendleft((topic, received, payload))
                    break
                if topic.name not in self._numbers:
                    self._numbers[topic.name] = self._bag.add_topic(self._infos[topic.name])
                self._bag.write(self._numbers[topic.name], received, payload)
                written = True
            if self._bag is not None and (written or not self._bag.there):
                self._bag.sync()
            self._written = time.monotonic()
        except OutputError as error:
            self.get_logger().error(f"{error}; recording goes on by itself once that is put right")
            self._lost, bag, self._bag = str(error), self._bag, None
            if bag is not None:
                bag.leave()
            return False
        return True

    def _go_on(self) -> None:
        """Go on with a bag that was lost, where its directory's own has not gone, too."""
        try:
            if Path(self._place).absolute().parent.is_dir():
                self._open_bag()
                self.get_logger().warning(f"recording goes on in {self._place}")
        except OutputError as error:
            self._lost = str(error)

    def _close_bag(self) -> str:
        """Write what has come and end the file; return what is wrong, empty if nothing is."""
        if self._write(last=True) and self._bag is not None:
            try:
                self._bag.close()
            except OutputError as error:
                self._lost = str(error)
        self._bag = None
        return self._lost

    async def _by_writer(self, work: Callable[[], str]) -> str:
        """Have the writer do something; return what is wrong, empty if nothing is."""
        answers: list[str] = []
        done = threading.Event()

        def ask() -> None:
            try:
                answers.append(work())
            except OutputError as error:
                answers.append(str(error))
            finally:
                done.set()

        if self._writer.is_alive():
            self._asked.put(ask)
            await Background(self, done.wait)
        else:
            ask()
        self._report()
        return answers[0]

    async def _on_record(self, request: Any, response: Any) -> Any:
        """Go on in the bag of a session; what was announced of it before the recorder came is asked for again."""
        self._drain()
        others = self._bag is None or self._bag.path.absolute() != Path(request.directory).absolute()

        def go_on() -> str:
            if not others and self._bag is not None:
                self._bag.belong_to(request.plan_sha256)
            else:
                gone = self._lost and not Path(self._place).absolute().parent.is_dir()
                if gone and request.directory == self._place:  # whoever has moved it away may put it back
                    return self._lost
                self._close_bag()
                self._place, self._plan = request.directory, request.plan_sha256
                self._open_bag()
            self._plan, self._session, self._foreign = request.plan_sha256, request.session, ""
            return ""

        wrong = await self._by_writer(go_on)
        response.outcome = to_outcome(Outcome.INPUT_UNUSABLE if wrong else Outcome.OK, wrong)
        bag = self._bag
        response.file = "" if bag is None else str(bag.file)
        if others and not wrong:
            self._hear_again(stamp_ns(request.since))
        return response

    def _hear_again(self, since: int) -> None:
        """Ask again for what was announced of the session."""
        self._since = since
        kept = [topic.name for topic in self._topics if topic.quality in (Quality.STATE, Quality.EVENTS)]
        for name in kept:
            if name in self._heard:
                self.destroy_subscription(self._heard.pop(name)[0].subscription)
        self._looked = -math.inf
        self._look()

    async def _on_close(self, _request: Any, response: Any) -> Any:
        self._drain()
        answers: list[str] = []

        def close() -> str:
            bag, self._session = self._bag, ""
            if bag is None:
                self._lost = ""
                return "no bag is open"
            wrong = self._close_bag()
            answers.append(f"{bag.messages} messages in {bag.file}")
            self._lost = ""
            return wrong

        wrong = await self._by_writer(close)
        response.success, response.message = not wrong, wrong or answers[0]
        return response

    async def _on_open(self, _request: Any, response: Any) -> Any:
        def open_again() -> str:
            if self._bag is not None:
                return f"{self._bag.file} is open"
            if not self._place:
                return str(OutputError("out", "", "nothing", "the directory of a bag"))
            self._open_bag()
            return ""

        wrong = await self._by_writer(open_again)
        bag = self._bag
        response.success, response.message = not wrong, wrong or ("" if bag is None else str(bag.file))
        return response

    def _on_hears(self, _request: Any, response: Any) -> Any:
        silent = [
            topic.name for topic in self._instruments if self._matched(topic) < self.count_publishers(topic.relative)
        ]
        response.success = not silent
        response.message = f"nothing is heard yet of {', '.join(silent)}" if silent else ""
        return response

    def _matched(self, topic: Topic) -> int:
        """Return from how many publishers a sample would come: a tracker that has to be aimed sends none before."""
        return self._heard[topic.name][0].subscription.get_publisher_count() if topic.name in self._heard else 0

    def _sign(self) -> None:
        bag = self._bag
        self._signs.publish(
            RECORDING.message(
                header=to_header(self.now_ns()),
                recording=bag is not None and not self._leaving,
                directory=str(Path(self._place).absolute()) if self._place else "",
                file="" if bag is None else str(bag.file),
                plan_sha256="" if bag is None else bag.plan_sha256,
                messages=0 if bag is None else bag.messages,
                behind=time.monotonic() - self._written,
            )
        )

    def _report(self) -> None:
        bag = self._bag
        foreign = FOREIGN.format(session=self._foreign) if self._foreign else ""
        self.diagnostics.report("session", 1 if foreign else 0, foreign or "every reading is of this session")
        if self._lost:
            self.diagnostics.report("bag", 2, f"{self._lost}; recording goes on by itself once that is put right")
            return
        if bag is None:
            self.diagnostics.report("bag", 1, "closed: nothing is recorded")
            return
        figures = {"messages": bag.messages, "waiting": len(self._queue), "topics": len(self._numbers)}
        self.diagnostics.report("bag", 0, f"recording to {bag.file}", figures)

    def on_end(self) -> None:
        """Say so at once, for a robot may move; write what has come and close the bag."""
        drained = threading.Event()
        self._leaving = True

        def drain() -> None:
            self._sign()
            self._drain()
            drained.set()

        in_executor(self, drain)
        drained.wait(DRAIN)
        self._ending.set()
        self._writer.join(timeout=5.0)
        while not self._asked.empty():  # nobody who asked waits for ever
            self._asked.get()()
        if wrong := self._close_bag():
            self.get_logger().error(wrong)


def main(arguments: list[str] | None = None) -> int:
    """Run the node; return the exit code."""
    return run(RecorderNode, arguments)


if __name__ == "__main__":
    sys.exit(main())
