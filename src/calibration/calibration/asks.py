"""Asking another node: a request with a deadline, of a service or of an action, which ends once.

A server that died is invisible for 20 s and its futures never complete, so every wait has an end of its own.

Services of a driver that are called by configuration, before the first motion and as a stage of the stop, are written
as `name=package/srv/Type` or `name=package/srv/Type{field: value, ...}` (YAML), for example

    /start_traj_mode=motoros2_interfaces/srv/StartTrajMode
    /fanuc_gpio_controller/switch_control_state=fanuc_msgs/srv/SwitchControlState{status: 1}
"""

from __future__ import annotations

import dataclasses
import math
import threading
import time
from collections.abc import Callable, Mapping
from typing import Any

import yaml
from rclpy.action import ActionClient
from rclpy.node import Node

from calibration.rclpy_gaps import in_executor
from calibration.topics import load_type
from calibration_core.errors import InputError, quoted

Ended = Callable[[Any, str], None]
"""Called once: what was answered (of an action, with `.result` and `.status`), or None and why there is nothing."""
Until = Callable[[Callable[[], bool], float], bool]
"""Waits for a condition, at most so many s of wall time; returns whether it came true."""
ACCEPT_TIME = 5.0  # s of wall time, to accept a goal
LOOK = 0.005  # s of wall time, between two looks at what is waited for


class Ask:
    """One request that is under way; any thread may cancel it.

    Attributes:
        accepted: Whether the server has taken it on, where it is a goal.
        cancelled: Whether it was, by us.
        over: Whether it has ended.
    """

    def __init__(self, server: Server, ended: Ended, wait: float, accept: float | None) -> None:
        """Begin; arguments as for `Server.ask`, `accept` is None for a service."""
        self._server, self._ended, self._wait = server, ended, wait
        self._lock = threading.Lock()
        self._deadline = time.monotonic() + (wait if accept is None else accept)
        self._handle: Any = None
        self.pending: Any = None  # of a service, until it answers
        self.accepted = self.cancelled = self.over = False

    @property
    def goal(self) -> bytes | None:
        """Identifier of the goal, 16 bytes; None: it is not accepted yet, or over."""
        with self._lock:
            return None if self.over or self._handle is None else bytes(self._handle.goal_id.uuid)

    def cancel(self) -> None:
        """Have the server end it; what is not accepted yet is cancelled as soon as it is, what is not sent never is."""
        with self._lock:
            if self.over:
                return
            self.cancelled, handle = True, self._handle
        if handle is not None:
            handle.cancel_goal_async()

    def drop(self, why: str) -> None:
        """Cancel it, and wait no longer."""
        self.cancel()
        self.end(None, why)

    def look(self, now: float) -> None:
        """Give up what is late at `now`, s of the steady clock."""
        if now > self._deadline:
            self.drop(f"{self._server.name} does not answer")

    def end(self, answer: Any, text: str) -> None:
        """Tell how it ended, once."""
        with self._lock:
            if self.over:
                return
            self.over = True
        self._server.forget(self)
        self._ended(answer, text)

    def on_accept(self, future: Any) -> None:
        """Take a server's word on a goal."""
        error = future.exception()
        handle = None if error is not None else future.result()
        if handle is None or not handle.accepted:
            self.end(None, f"{self._server.name} rejects the request" if error is None else str(error))
            return
        with self._lock:
            self._handle, self._deadline = handle, time.monotonic() + self._wait
            self.accepted = True
            cancelled = self.cancelled
        if cancelled:
            handle.cancel_goal_async()
        if not self.over:
            handle.get_result_async().add_done_callback(self.on_answer)

    def on_answer(self, future: Any) -> None:
        """Take the answer."""
        error = future.exception()
        self.end(None if error else future.result(), str(error or ""))


class Server:
    """A service or an action of another node, and what it is asked."""

    def __init__(self, node: Node, kind: Any, name: str) -> None:
        """Listen for it; `kind` is its class."""
        self.name, self._node, self._of_action = name, node, hasattr(kind, "Goal")
        self._client: Any = ActionClient(node, kind, name) if self._of_action else node.create_client(kind, name)
        self._lock = threading.Lock()
        self._asks: list[Ask] = []

    def ready(self) -> bool:
        """Tell whether it is there; one that died is there for 20 s more."""
        return bool(self._client.server_is_ready() if self._of_action else self._client.service_is_ready())

    def missing(self) -> str:
        """Say that it is not there; empty if it is."""
        return "" if self.ready() else f"no {'action server' if self._of_action else 'service'} {self.name}"

    @property
    def asked(self) -> bool:
        """Whether an answer is awaited."""
        return bool(self._asks)

    def ask(
        self,
        request: Any,
        ended: Ended,
        wait: float = math.inf,
        *,
        accept: float = ACCEPT_TIME,
        feedback: Callable[[Any], None] | None = None,
    ) -> Ask:
        """Ask; returns at once.

        Args:
            request: Of the service, or goal of the action.
            ended: Called once, in the executor's thread or in that of who ends it.
            wait: s of wall time, that the answer may take; of an action, once the goal is accepted.
            accept: s of wall time, that a goal may take to be accepted.
            feedback: Called with each feedback, in the executor's thread.
        """
        one = Ask(self, ended, wait, accept if self._of_action else None)
        with self._lock:
            self._asks.append(one)
        if not self._of_action:
            one.pending = self._client.call_async(request)
            one.pending.add_done_callback(one.on_answer)
            return one

        def send() -> None:
            if one.cancelled:
                one.end(None, "stopped before it was sent")
            else:
                self._client.send_goal_async(request, feedback_callback=feedback).add_done_callback(one.on_accept)

        in_executor(self._node, send)
        return one

    def call(self, request: Any, seconds: float, until: Until | None = None) -> Any:
        """Ask and wait, in a thread that is not the executor's; None if no answer comes.

        Args:
            request: What is asked.
            seconds: Of wall time, that the server may take to appear, and to answer then.
            until: Waits; it may raise when nobody wants the answer any more.
        """
        until = until or wait_until
        if not until(self.ready, seconds):
            return None
        answers: list[Any] = []
        one = self.ask(request, lambda answer, _text: answers.append(answer))
        try:
            until(lambda: bool(answers), seconds)
        finally:
            one.drop("")
        return answers[0]

    def forget(self, one: Ask) -> None:
        """Keep nothing of what has ended."""
        with self._lock:
            self._asks.remove(one)
        if one.pending is not None:
            self._client.remove_pending_request(one.pending)

    def drop(self, why: str = "it is not wanted any more") -> None:
        """Cancel whatever is under way, and wait no longer."""
        for one in list(self._asks):
            one.drop(why)

    def destroy(self) -> None:
        """Listen no more, in the executor's thread; what was asked goes on."""
        self._client.destroy() if self._of_action else self._node.destroy_client(self._client)

    def tick(self, now: float) -> None:
        """Give up requests whose answer does not come; `now` is s of the steady clock."""
        for one in list(self._asks):
            one.look(now)


def wait_until(condition: Callable[[], bool], seconds: float) -> bool:
    """Wait, in a thread that is not the executor's, at most so many s of wall time; return whether it came true."""
    end = time.monotonic() + seconds
    while not condition():
        if time.monotonic() > end:
            return False
        time.sleep(LOOK)
    return True


@dataclasses.dataclass(frozen=True)
class Call:
    """One service call.

    Attributes:
        name: Of the service.
        type: `package/srv/Type`.
        fields: Of the request; the others keep their defaults.
    """

    name: str
    type: str
    fields: Mapping[str, Any]

    def request(self) -> Any:
        """Return the request.

        Raises:
            InputError: The package is not installed, or the type has no such field.
        """
        kind = load_type(self.type).Request
        try:
            return kind(check_fields=True, **self.fields)
        except (AssertionError, TypeError):
            known = ", ".join(f"{name} ({of})" for name, of in kind.get_fields_and_field_types().items())
            raise InputError(
                "parameters", self.name, quoted(dict(self.fields)), f"fields of {known or 'none'}"
            ) from None


def parse_call(text: str) -> Call:
    """Read one entry.

    Raises:
        InputError: It is malformed.
    """
    name, separator, rest = text.partition("=")
    kind, brace, fields = rest.partition("{")
    expected = "name=package/srv/Type{field: value}"
    if not separator or not name.strip() or "/srv/" not in kind:
        raise InputError("parameters", "services", quoted(text), expected)
    try:
        values = yaml.safe_load(brace + fields) if brace else {}
    except yaml.YAMLError:
        raise InputError("parameters", "services", quoted(text), expected) from None
    if not isinstance(values, dict):
        raise InputError("parameters", "services", quoted(text), expected)
    return Call(name.strip(), kind.strip(), values)


def succeeded(response: Any) -> tuple[bool, str]:
    """Tell whether a service's answer is a success, by the fields that drivers use, and its words."""
    text = str(getattr(response, "message", ""))
    flag = getattr(response, "success", None)
    if isinstance(flag, bool):
        return flag, text
    code = getattr(response, "result_code", None)
    value = getattr(code, "value", code)
    if isinstance(value, int):
        return value in {0, 1}, text or f"result code {value}"  # MotoROS2: 1 is ready, 0 is nothing to say
    return True, text


def callers(node: Any, parameter: str) -> list[tuple[Server, Any]]:
    """Return server and request of every call that a node's parameter names.

    Raises:
        InputError: A call cannot be understood, or its package is not installed.
    """
    calls = [parse_call(text) for text in node.value(parameter)]
    return [(Server(node, load_type(call.type), call.name), call.request()) for call in calls]
