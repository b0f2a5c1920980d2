"""The panel's side of ROS: what it hears of the cell, and the services and actions that it asks.

State, joint states and the load device's state are looked at some times a second, and the last message is all that is
taken: however many come, no more is done.  Whoever asks is a coroutine of another thread; answers are handed there.
"""

from __future__ import annotations

import asyncio
import dataclasses
import time
from collections.abc import Callable
from typing import Any

from calibration_interfaces.action import Identify, RunPlan
from calibration_interfaces.msg import Outcome, SessionEvent
from calibration_interfaces.srv import (
    ConfirmMode,
    LoadApplied,
    OverrideCondition,
    PointRequest,
    ResetGuard,
    ResumeMotion,
    SelfTest,
    Tare,
)
from rclpy.qos import QoSProfile, ReliabilityPolicy
from std_srvs.srv import Trigger

from calibration.asks import Ask, Server
from calibration.rclpy_gaps import Waiting, hidden, in_executor
from calibration.topics import EVENT
from calibration.web.hub import in_loop

ANSWER = 5.0  # s of wall time, that a service may take
ACCEPT = 10.0  # s of wall time, that an action may take to accept a goal
FOUND = 10.0  # s, for a server that the graph shows: a lost datagram of the discovery is sent again after 3 s
ABSENT = 2.0  # s, for a server that the graph does not show
REASON = 1.0  # s, that the reason of a rejection may take to come
LOOK = 0.05  # s between two looks
SERVICES: dict[str, tuple[Any, str, float]] = {
    "stop": (Trigger, "sequencer/stop", 2.0),
    "pause": (Trigger, "sequencer/pause", ANSWER),
    "resume": (Trigger, "sequencer/resume", ANSWER),
    "resume_motion": (ResumeMotion, "sequencer/resume_motion", ANSWER),
    "repeat": (Trigger, "sequencer/repeat", ANSWER),
    "skip": (Trigger, "sequencer/skip", ANSWER),
    "point": (PointRequest, "tracker/point", ANSWER),
    "load_applied": (LoadApplied, "sequencer/load_applied", ANSWER),
    "override_condition": (OverrideCondition, "sequencer/override_condition", ANSWER),
    "guard_reset": (ResetGuard, "guard/reset", ANSWER),
    "confirm_mode": (ConfirmMode, "guard/confirm_mode", ANSWER),
    "tare": (Tare, "force_torque/tare", 60.0),
    "self_test": (SelfTest, "force_torque/self_test", 60.0),
    "recorder_hears": (Trigger, "recorder/hears", 2.0),
}
"""Request: type of the service, its name, s of wall time that its answer may take."""


@dataclasses.dataclass(frozen=True)
class Answer:
    """How a request ended; `text` is one line for a person, `message` what was answered, if anything was."""

    done: bool
    text: str = ""
    message: Any = None


class Latest(Waiting):
    """A topic of which the last message alone counts, taken when it is looked at."""

    def __init__(self, node: Any, kind: Any, name: str, quality: QoSProfile | None = None) -> None:
        quality = quality or QoSProfile(depth=1, reliability=ReliabilityPolicy.BEST_EFFORT)
        quality.depth = 1
        super().__init__(node, kind, name, quality)

    def last(self) -> Any:
        """Return the last message that has come since the last look; None: none has."""
        found = self.take()
        return found[-1] if found else None


class CellLink:
    """Services and actions of the cell, asked from coroutines; made and destroyed by the executor's node."""

    def __init__(self, node: Any) -> None:
        """Make the clients of the services; those of actions are there only while one is under way."""
        self._node = node
        self._servers = {key: Server(node, kind, name) for key, (kind, name, _) in SERVICES.items()}
        reliable = QoSProfile(depth=1, reliability=ReliabilityPolicy.RELIABLE)
        self._event = Latest(node, EVENT.message, EVENT.relative, reliable)
        self._run: asyncio.Task[None] | None = None  # held: a task that nobody holds may be collected
        self._beginning = False
        self._evaluation: Ask | None = None

    async def ask(self, request: str, **fields: Any) -> Answer:
        """Ask a service; return how it ended, also if nobody answers."""
        kind, name, seconds = SERVICES[request]
        server = self._servers[request]
        if not server.ready():
            return Answer(done=False, text=f"{name} is not there")
        done = asyncio.get_running_loop().create_future()
        one = server.ask(kind.Request(**fields), lambda message, _text: settle(done, message))
        try:
            message = await asyncio.wait_for(done, seconds)
        except TimeoutError:
            message = None
        finally:
            one.drop("")
        return Answer(done=False, text=f"{name} does not answer") if message is None else judged(message)

    async def begin_run(self, fields: dict[str, Any], ended: Callable[[str], None]) -> Answer:
        """Have a plan measured; return whether the goal was accepted.

        The client stays until the end: it is by its being there that the sequencer knows the robot to be minded.

        Args:
            fields: Of the goal of `RunPlan`.
            ended: Called with how it ended, in the calling thread's loop.
        """
        if self._beginning:
            return Answer(done=False, text="a run is being begun")
        self._beginning = True
        try:
            return await self._begin_run(fields, ended)
        finally:
            self._beginning = False

    async def _begin_run(self, fields: dict[str, Any], ended: Callable[[str], None]) -> Answer:
        server = await self._server(RunPlan, "sequencer/run")
        if server is None:
            return Answer(done=False, text="sequencer/run is not there")
        self._event.last()  # what was said before the goal
        one, done = self._send(server, RunPlan.Goal(**fields))
        if not await self._accepted(server, one):
            await self._spun(server.destroy)
            return Answer(done=False, text=await self._rejection())
        self._run = asyncio.get_running_loop().create_task(self._until(server, done, ended))
        return Answer(done=True)

    async def _rejection(self) -> str:
        """Return why a run was rejected: a rejected goal carries no words, an event of the sequencer does."""
        end = time.monotonic() + REASON
        while time.monotonic() < end:
            event = self._event.last()
            if event is not None and event.kind == SessionEvent.REJECTED:
                return str(event.text)
            await asyncio.sleep(LOOK)
        return "the goal is rejected"

    def leave(self) -> None:
        """Wait no longer for the end of a run; in the thread of its loop."""
        if self._run is not None:
            self._run.cancel()

    async def _until(self, server: Server, done: asyncio.Future[Any], ended: Callable[[str], None]) -> None:
        answer = await done
        await self._spun(server.destroy)
        ended(f"{server.name} does not answer" if answer is None else str(answer.result.outcome.text))

    async def evaluate(self, what: str, recording: str, progress: Callable[[float, str], None]) -> Answer:
        """Have a recording identified or diagnosed; return how it ended.

        Args:
            what: `stiffness` or `diagnosis`.
            recording: What is evaluated.
            progress: Called in the executor's thread with the share that is done and what is being done.
        """
        server = await self._server(Identify, "identification/identify")
        if server is None:
            return Answer(done=False, text="identification/identify is not there")
        kind = {"stiffness": Identify.Goal.STIFFNESS, "diagnosis": Identify.Goal.DIAGNOSIS}[what]
        goal = Identify.Goal(what=kind, recording=recording)
        one, done = self._send(server, goal, lambda of: progress(float(of.feedback.share_done), str(of.feedback.text)))
        self._evaluation = one
        try:
            if not await self._accepted(server, one):
                return Answer(done=False, text="the identification takes no request now")
            answer = await done
            return judged(answer.result) if answer else Answer(done=False, text=f"{server.name} does not answer")
        finally:
            self._evaluation = None
            await self._spun(server.destroy)

    def cancel_evaluation(self) -> Answer:
        """Cancel the evaluation that is under way, also where it is not accepted yet."""
        if self._evaluation is None:
            return Answer(done=False, text="nothing is being evaluated")
        self._evaluation.cancel()
        return Answer(done=True)

    async def _server(self, kind: Any, name: str) -> Server | None:
        """Return a server that is there; None: there is none."""
        server: Server = await self._spun(lambda: Server(self._node, kind, name))
        service = self._node.resolve_service_name(hidden(name, "send_goal"))
        began = time.monotonic()
        while not server.ready():
            if time.monotonic() - began > (FOUND if self._node.count_services(service) else ABSENT):
                await self._spun(server.destroy)
                return None
            await asyncio.sleep(LOOK)
        return server

    def _send(
        self, server: Server, goal: Any, feedback: Callable[[Any], None] | None = None
    ) -> tuple[Ask, asyncio.Future[Any]]:
        """Send a goal; return it, and what gets the answer, None where there is none."""
        done = asyncio.get_running_loop().create_future()
        return server.ask(goal, lambda answer, _: settle(done, answer), accept=ACCEPT, feedback=feedback), done

    async def _accepted(self, server: Server, one: Ask) -> bool:
        """Wait until a goal is accepted or not."""
        while not one.accepted and not one.over:
            server.tick(time.monotonic())
            await asyncio.sleep(LOOK)
        return one.accepted

    async def _spun(self, work: Callable[[], Any]) -> Any:
        """Do something short in the executor's thread, which must not be waiting for what is taken down meanwhile.

        Raises:
            Exception: What the work raised.
        """
        loop = asyncio.get_running_loop()
        done = loop.create_future()

        def do() -> None:
            found: tuple[Any, Exception | None]
            try:
                found = (work(), None)
            except Exception as error:  # noqa: BLE001  # handed over to the one who awaits
                found = (None, error)
            settle(done, found)

        in_executor(self._node, do)
        found, error = await done
        if error is not None:
            raise error
        return found


def settle(done: asyncio.Future[Any], value: Any) -> None:
    """Set a future's result from another thread; nothing where nobody awaits it any more."""
    in_loop(done.get_loop(), lambda: None if done.done() else done.set_result(value))


def judged(message: Any) -> Answer:
    """Return how a service or action ended, from what it answered."""
    if hasattr(message, "outcome"):
        return Answer(message.outcome.code == Outcome.OK, str(message.outcome.text), message)
    return Answer(bool(message.success), str(message.message), message)
