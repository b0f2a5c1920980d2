"""What every node of the suite has in common: declared parameters, diagnostics, start and end of the process.

Parameters come from a table; a name that is not in it is an error, for a misspelt key would otherwise be ignored
without a word.  The process ends by a flag: signals only set it, the executor spins in a thread of its own, and while
it still spins, `stop` may cancel motions and close files.
"""

from __future__ import annotations

import dataclasses
import itertools
import math
import os
import secrets
import signal
import socket
import sys
import threading
import time
import traceback
from collections.abc import Callable, Mapping, Sequence
from types import FrameType
from typing import Any

import rclpy
from calibration_interfaces.msg import NodeHealth
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
from rcl_interfaces.msg import FloatingPointRange, IntegerRange, ParameterDescriptor, SetParametersResult
from rclpy.action import ActionServer, CancelResponse, GoalResponse
from rclpy.callback_groups import ReentrantCallbackGroup
from rclpy.clock import Clock, ClockType
from rclpy.event_handler import PublisherEventCallbacks, SubscriptionEventCallbacks
from rclpy.exceptions import InvalidParameterTypeException, InvalidParameterValueException, ParameterException
from rclpy.executors import ExternalShutdownException, ShutdownException, SingleThreadedExecutor
from rclpy.node import Node
from rclpy.parameter import Parameter
from rclpy.qos import QoSProfile, ReliabilityPolicy
from rclpy.signals import SignalHandlerOptions
from rosgraph_msgs.msg import Clock as ClockMessage

from calibration.conversions import to_stamp
from calibration.process_tree import UNUSABLE, Parent, on_end
from calibration.rclpy_gaps import NEVER, PolledClock, RCLError, Waiting, given_parameters
from calibration.transport import sockets_only
from calibration_core.errors import InputError, quoted
from calibration_core.files.yaml_file import read_yaml

TOPIC = "calibration/health"  # of all nodes in a namespace
PERIOD = 0.25  # s of wall time between two signs of life
FRESH = 0.7  # s of wall time without one, after which what the node has said is not shown as current any more
LEASE = 1.5  # s of wall time without one, after which the node counts as silent
LISTEN = 0.8  # s of wall time, for another one before the start
FOUND = 0.5  # s, likewise, from when another one is found in the graph: its sign is on its way, or it is dead
QOS = QoSProfile(depth=50)  # every node of a cell, several times


class Health:
    """Sends a node's health again and again, and at once when it changes.

    Attributes:
        identifier: Of this node in this process, drawn at its start.
    """

    def __init__(self, node: Any, role: str) -> None:
        """Begin.

        Args:
            node: A `CalibrationNode`: the gravest of its diagnostics is what is sent.
            role: What it is.
        """
        self._node = node
        self.identifier = secrets.randbits(63)
        self._own = NodeHealth(
            role=role, name=node.get_name(), process=os.getpid(), computer=socket.gethostname(),
            identifier=self.identifier, since=time.time_ns(),
        )  # fmt: skip
        self._publisher = node.create_publisher(NodeHealth, TOPIC, QOS)
        self._others = Waiting(node, NodeHealth, TOPIC, QOS) if node.OWNER else None
        node.create_timer(PERIOD, self.send, clock=Clock(clock_type=ClockType.STEADY_TIME))

    def send(self) -> None:
        """Send the health as it is now."""
        self.look()
        self._own.level, self._own.text = self._node.diagnostics.worst
        self._own.stamp = to_stamp(time.time_ns())
        self._publisher.publish(self._own)

    def look(self) -> None:
        """See whether another node of this kind is heard; at every tick of those that move or permit."""
        for message in [] if self._others is None else self._others.take():
            if message.role == self._own.role and message.identifier != self.identifier:
                own, other = self._own, message
                younger = (own.since, own.identifier) > (other.since, other.identifier)
                self._node.on_second(words(message), younger)


def words(message: Any) -> str:
    """Say who else is there."""
    return f"two {message.role}s: another one is process {message.process} on {message.computer}"


def refuse_second(role: str, listen: float = LISTEN) -> None:
    """Listen for another node of a kind, before this one begins.

    Raises:
        InputError: There is one.
    """
    quiet = [Parameter("start_type_description_service", value=False)]  # it may do no more than the node to come
    node = rclpy.create_node(f"{role}_looks_around", start_parameter_services=False, parameter_overrides=quiet)
    heard: list[Any] = []
    node.create_subscription(
        NodeHealth, TOPIC, lambda message: heard.append(message) if message.role == role else None, QOS
    )
    executor = SingleThreadedExecutor()
    executor.add_node(node)
    end, found = time.monotonic() + listen, False
    try:
        while not heard and (left := end - time.monotonic()) > 0.0:
            executor.spin_once(timeout_sec=min(left, PERIOD))
            if not found and any(one.node_name == role for one in node.get_publishers_info_by_topic(TOPIC)):
                found, end = True, max(end, time.monotonic() + FOUND)
        if heard:
            raise InputError(role, f"namespace {node.get_namespace()}", words(heard[0]), "one")
    finally:
        executor.shutdown()
        node.destroy_node()


NODE_NAMES = (
    "compensation", "force_torque", "guard", "identification", "manager", "panel", "recorder", "sequencer",
    "simulated_cell", "tracker",
)  # fmt: skip
NO_WORDS = [""]  # declared for an empty list: without a value, none of a node's parameters could be read all at once
BUILT_IN = ("use_sim_time", "qos_overrides.", "start_type_description_service")
MAX_PARAMETER_BYTES = 1 << 20
POLL = 0.1  # s between looks at the flag that ends the process
HELD_SIGNALS = 2  # launch sends SIGINT, then SIGTERM

Value = bool | int | float | str | list[str] | list[float] | list[int] | list[bool]


class ParameterError(InputError):
    """A parameter is unknown, of the wrong type, out of range, or missing."""


@dataclasses.dataclass(frozen=True)
class Declared:
    """One parameter of a node.

    Attributes:
        name: Name, dots between groups.
        default: Value if nothing is given; its type is the parameter's.  An empty list is a list of strings.
        description: One sentence with the unit.
        low: Smallest number allowed.
        high: Largest number allowed.
        choices: The strings allowed, empty: any.
        required: Whether it must be given, that is: not empty.
        read_only: Whether it is fixed once the node runs; the others change while it runs, but not while it is busy.
    """

    name: str
    default: Value
    description: str
    low: float | None = None
    high: float | None = None
    choices: tuple[str, ...] = ()
    required: bool = False
    read_only: bool = True

    def descriptor(self) -> ParameterDescriptor:
        """Return what ROS tells about the parameter."""
        text = f"{self.description} One of: {', '.join(self.choices)}." if self.choices else self.description
        answer = ParameterDescriptor(name=self.name, description=text, read_only=self.read_only)
        if self.low is None and self.high is None:
            return answer
        if isinstance(self.default, int):
            low, high = (
                -(2**63) if self.low is None else int(self.low),
                2**63 - 1 if self.high is None else int(self.high),
            )
            answer.integer_range = [IntegerRange(from_value=low, to_value=high, step=0)]
        else:
            low_f = -sys.float_info.max if self.low is None else float(self.low)
            high_f = sys.float_info.max if self.high is None else float(self.high)
            answer.floating_point_range = [FloatingPointRange(from_value=low_f, to_value=high_f, step=0.0)]
        return answer

    @property
    def wanted(self) -> str:
        """What is to be given, and how: for whoever has left it out."""
        what = self.description[0].lower() + self.description[1:].rstrip(".")
        kind = "DIR" if what.startswith("directory") else "FILE"
        return f"{what}: --ros-args -p {self.name}:={kind}"

    def fault(self, value: object) -> str:
        """Say what is wrong with a value that has the right type; empty if nothing is."""
        if isinstance(value, float) and not math.isfinite(value):
            return "a number that is not finite"
        if self.choices and isinstance(value, str) and value not in self.choices:
            return quoted(value)
        if self.required and not value:
            return "nothing"
        return ""


class CalibrationNode(Node):
    """A node with declared parameters, diagnostics and a sign of life, which works once it is made.

    Attributes:
        diagnostics: What the node tells about its health, once a second and at every change.
        ending: Set when the node has been told to end.
        failed: Set when the node cannot go on; the process then ends with exit code 1.
        health: Its sign of life, and its identity.
        OWNER: What of which there may be one in a namespace this kind of node is, for example "guard"; empty: nothing.
    """

    OWNER = ""
    _polled_clock: PolledClock | None = None  # of a simulation

    def __init__(self, name: str, parameters: Sequence[Declared], **kwargs: Any) -> None:
        """Declare the parameters, and make what the node consists of.

        Args:
            name: Name of the node; a remapping may replace it.
            parameters: Its parameters.
            kwargs: Passed on to `rclpy.node.Node` (context, parameter_overrides, namespace, ...).

        Raises:
            ParameterError: A parameter is unknown, of the wrong type, out of range, or missing.
            InputError: Something else that the node was given cannot be used.
        """
        super().__init__(name, **kwargs)
        self.failed, self.ending = threading.Event(), threading.Event()
        self._table = {one.name: one for one in parameters}
        try:
            self._declare()
            self.add_on_set_parameters_callback(self._check)
            self.diagnostics = Diagnostics(self)
            self.health = Health(self, name)
            self.on_start()
        except BaseException:
            self.destroy_node()
            raise

    def on_start(self) -> None:
        """Make what the node consists of, and begin to work; nothing moves because of it."""

    def on_end(self) -> None:
        """End what is under way, and give back processes, threads and files; the executor still spins."""

    def _declare(self) -> None:
        own = self.get_fully_qualified_name()
        overrides = given_parameters(self)
        for name in overrides:
            if name not in self._table and not name.startswith(BUILT_IN):
                raise ParameterError(own, name, "an unknown parameter", f"one of {', '.join(sorted(self._table))}")
        for one in self._table.values():
            lists, given = isinstance(one.default, list), overrides.get(one.name)
            default = one.default or NO_WORDS if lists else one.default
            empty = lists and given is not None and given.type_ == Parameter.Type.NOT_SET  # so a file's [] arrives
            expected = f"{type(one.default).__name__}{_range(one)}"
            try:
                self.declare_parameter(one.name, NO_WORDS if empty else default, one.descriptor(), empty)
            except (InvalidParameterTypeException, InvalidParameterValueException, ParameterException) as error:
                found = quoted(None if given is None else given.value)
                raise ParameterError(own, one.name, found, expected) from error
            if one.fault(self.value(one.name)):
                expected = f"one of {', '.join(one.choices)}" if one.choices else one.wanted
                raise ParameterError(own, one.name, one.fault(self.value(one.name)), expected)

    def value(self, name: str) -> Any:
        """Return a parameter's value; an empty list where none was given."""
        found = self.get_parameter(name).value
        return [] if found == NO_WORDS else list(found) if isinstance(self._table[name].default, list) else found

    def _check(self, parameters: list[Parameter]) -> SetParametersResult:
        for given in parameters:
            one = self._table.get(given.name)
            fault = one.fault(given.value) if one else ""
            if fault:
                return SetParametersResult(successful=False, reason=f"{given.name}: {fault}")
            if one and self.busy():
                return SetParametersResult(successful=False, reason=f"{given.name}: not now: {self.busy()}")
        return SetParametersResult(successful=True)

    def busy(self) -> str:
        """Say what is under way that forbids to change a parameter; empty if nothing is."""
        return ""

    def now_ns(self) -> int:
        """Return the node's time, ns: the simulation's where `use_sim_time` is set."""
        if self._polled_clock is not None:
            self._polled_clock.look()
        return int(self.get_clock().now().nanoseconds)

    def on_second(self, words: str, younger: bool) -> None:
        """Another node of this kind is heard: the younger one ends; the elder one says so, and stops what it does."""
        self.diagnostics.report("owner", 2, words)
        if younger and not self.failed.is_set():
            self.get_logger().fatal(words)
            self.failed.set()

    def stop(self) -> None:
        """End the work, before the process ends; the executor still spins.  Once is enough."""
        if not self.ending.is_set():
            self.ending.set()
            self.on_end()

    # --- what does not fit is found by looking at the graph (`topics.incompatible`) -----------------------------------

    def create_publisher(self, *args: Any, event_callbacks: PublisherEventCallbacks | None = None, **more: Any) -> Any:
        """Make a publisher; without the events that rclpy makes for each by itself: they cost half of every wake."""
        events = event_callbacks or PublisherEventCallbacks(use_default_callbacks=False)
        return super().create_publisher(*args, event_callbacks=events, **more)

    def create_subscription(
        self, kind: Any, *args: Any, event_callbacks: SubscriptionEventCallbacks | None = None, **more: Any
    ) -> Any:
        """Make a subscription; without the events that rclpy makes for each by itself: they cost half of every wake."""
        events = event_callbacks or SubscriptionEventCallbacks(use_default_callbacks=False)
        if kind is not ClockMessage:
            return super().create_subscription(kind, *args, event_callbacks=events, **more)
        clock = super().create_subscription(kind, *args, event_callbacks=events, callback_group=NEVER, **more)
        self._polled_clock = PolledClock(clock)
        return clock

    def create_action_server(
        self,
        action: Any,
        name: str,
        execute: Callable[[Any], Any],
        *,
        goal_callback: Callable[[Any], GoalResponse] = lambda _goal: GoalResponse.ACCEPT,
        cancel_callback: Callable[[Any], CancelResponse] = lambda _goal: CancelResponse.ACCEPT,
        handle_accepted_callback: Callable[[Any], None] = lambda goal: goal.execute(),
    ) -> ActionServer:
        """Offer an action; when the node ends, goals are rejected.  Goals run beside one another."""

        def judged(goal: Any) -> GoalResponse:
            return GoalResponse.REJECT if self.ending.is_set() else goal_callback(goal)

        return ActionServer(
            self, action, name, execute, callback_group=ReentrantCallbackGroup(), goal_callback=judged,
            cancel_callback=cancel_callback, handle_accepted_callback=handle_accepted_callback,
        )  # fmt: skip


def _range(one: Declared) -> str:
    if one.low is None and one.high is None:
        return ""
    return f" from {'-inf' if one.low is None else one.low} to {'inf' if one.high is None else one.high}"


class Diagnostics:
    """The node's health on `/diagnostics`: once a second of wall time and at every change of a level or text."""

    LEVELS = (DiagnosticStatus.OK, DiagnosticStatus.WARN, DiagnosticStatus.ERROR, DiagnosticStatus.STALE)

    def __init__(self, node: CalibrationNode) -> None:
        """Start publishing."""
        self._node = node
        self._status: dict[str, DiagnosticStatus] = {}
        qos = QoSProfile(depth=10, reliability=ReliabilityPolicy.RELIABLE)
        self._publisher = node.create_publisher(DiagnosticArray, "/diagnostics", qos)
        self._timer = node.create_timer(1.0, self.publish, clock=Clock(clock_type=ClockType.STEADY_TIME))

    def report(self, what: str, level: int, text: str, values: Mapping[str, object] | None = None) -> None:
        """Say how one thing stands.

        Args:
            what: The thing, for example a topic.
            level: 0 fine, 1 warning, 2 error, 3 stale.
            text: One line for a person.
            values: Figures.
        """
        name = f"{self._node.get_name()}: {what}"
        pairs = [KeyValue(key=key, value=str(value)) for key, value in (values or {}).items()]
        new = DiagnosticStatus(level=self.LEVELS[level], name=name, message=text,
                               hardware_id=self._node.get_name(), values=pairs)  # fmt: skip
        old = self._status.get(what)
        self._status[what] = new
        if old is None or (old.level, old.message) != (new.level, new.message):
            self.publish()

    @property
    def worst(self) -> tuple[int, str]:
        """Level and text of the gravest thing; level 0 and no text if all is well."""
        gravest = max(self._status.values(), key=lambda one: one.level[0], default=None)
        if gravest is None or gravest.level == DiagnosticStatus.OK:
            return 0, ""
        return min(int(gravest.level[0]), 2), f"{gravest.name.partition(': ')[2]}: {gravest.message}"

    @property
    def state(self) -> DiagnosticStatus:
        """One line for the node as a whole: the gravest thing."""
        level, text = self.worst
        name = self._node.get_name()
        message = text or "all is well"
        return DiagnosticStatus(level=self.LEVELS[level], name=f"{name}: state", message=message, hardware_id=name)

    def publish(self) -> None:
        """Send everything known, the node's state first."""
        message = DiagnosticArray(status=[self.state, *self._status.values()])
        message.header.stamp = to_stamp(self._node.now_ns())
        self._publisher.publish(message)


def check_parameter_files(arguments: Sequence[str]) -> None:
    """Refuse parameter files with sections that no node takes: they would be ignored without a word.

    Raises:
        ParameterError: A file cannot be read, names an unknown node, or has a section that holds without a namespace
            alone although the node has one.
    """
    spaces = [value.partition(":=")[2] for flag, value in itertools.pairwise(arguments) if flag == "-r"
              and value.startswith("__ns:=")]  # fmt: skip
    space = spaces[-1].strip("/") if spaces else ""
    files = [value for flag, value in itertools.pairwise(arguments) if flag == "--params-file"]
    for file in files:
        for key in _sections(read_yaml(file, MAX_PARAMETER_BYTES, "parameter file (YAML)", ParameterError).data):
            last = key.rstrip("/").rpartition("/")[2]
            if last not in NODE_NAMES and "*" not in last:
                raise ParameterError(file, key, "an unknown node", f"one of {', '.join(NODE_NAMES)}, or /**")
            if space and key.strip("/") == last and "*" not in last:
                raise ParameterError(file, key, "a section that holds without a namespace alone", f"/**/{last}")


def _sections(data: object, prefix: str = "") -> list[str]:
    """Return the names of all nodes that a parameter file has sections for, namespaces in front."""
    if not isinstance(data, dict):
        return []
    found: list[str] = []
    for key, value in data.items():
        name = f"{prefix}/{key}" if prefix else str(key)
        found += [name] if isinstance(value, dict) and "ros__parameters" in value else _sections(value, name)
    return found


def run(make: Callable[[], CalibrationNode], arguments: Sequence[str] | None = None) -> int:
    """Run a node until a signal or its own failure ends it; the exit code of the process.

    SIGINT, SIGTERM and SIGHUP (the terminal's window is closed) end it, unless it was started to outlive its terminal
    (`nohup`), and so does the end of the launch that started it.  Two signals are held until the node has stopped what
    it does; the third SIGINT or SIGTERM ends the process at once.

    Args:
        make: Makes the node, once ROS is initialised: its class.
        arguments: Command line without the program's name; None: the process's own.

    Returns:
        0 after a signal, 2 if the input cannot be used (one line on stderr), 1 after a failure.
    """
    stop = threading.Event()

    held: list[int] = []

    def on_signal(number: int, _frame: FrameType | None) -> None:
        stop.set()
        if number != signal.SIGHUP:  # of which a closed terminal may send several
            held.append(number)
        if len(held) > HELD_SIGNALS:
            os._exit(128 + number)

    on_end(on_signal)
    parent = Parent.of(os.environ)
    given = list(sys.argv[1:] if arguments is None else arguments)
    shared = sockets_only(os.environ)
    try:
        try:
            rclpy.init(args=given, signal_handler_options=SignalHandlerOptions.NO)
            check_parameter_files(given)
            owner = str(getattr(make, "OWNER", ""))
            if owner:
                refuse_second(owner)
            node = make()
            if shared:
                node.get_logger().warning(shared)
        except InputError as error:
            print(error, file=sys.stderr)
            return UNUSABLE
        except RCLError as error:
            if os.environ.get("ROS_SECURITY_ENABLE", "").lower() != "true":
                raise
            text = " ".join(str(error).split())
            print(f"ROS_SECURITY_ENABLE is true, and the node does not run without it: {text}", file=sys.stderr)
            return UNUSABLE
        return _until(node, stop, parent)
    finally:
        rclpy.try_shutdown()


def _until(node: CalibrationNode, stop: threading.Event, parent: Parent) -> int:
    executor = SingleThreadedExecutor(context=node.context)
    executor.add_node(node)
    ending = threading.Event()
    thread = threading.Thread(target=spin, args=(executor, node, ending), name="executor", daemon=True)
    thread.start()
    gone = ""
    while not stop.wait(POLL) and not node.failed.is_set() and not gone:
        gone = parent.gone()
    if gone:
        node.get_logger().error(gone)
    try:
        node.stop()
    finally:
        ending.set()
        executor.create_task(lambda: None)  # wakes it: an executor that is shut down while it spins breaks
        thread.join(timeout=1.0)
        executor.shutdown(timeout_sec=1.0)
        node.destroy_node()
    return 1 if node.failed.is_set() else 0


def spin(executor: SingleThreadedExecutor, node: CalibrationNode, ending: threading.Event) -> None:
    """Spin until told to end; an exception out of a callback ends the node and stands in the log."""
    try:
        while not ending.is_set():
            executor.spin_once()
    except (ExternalShutdownException, ShutdownException):
        return
    except Exception:  # noqa: BLE001  # told in full, and the process ends
        node.get_logger().fatal(traceback.format_exc())
        node.failed.set()
