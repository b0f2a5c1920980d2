"""A node with a managed life: configured, activated and so on from outside, or by itself at its start.

Services and topic are those of every managed node (`ros2 lifecycle` works).  Transitions run beside the executor, one
at a time; what is not possible is answered so.  A callback that raises is told in the log, and the node stays where it
was.  While a node is not active, it has no subscription and no timer, services answer that it is not, and goals are
rejected.  Subscriptions are made when it is activated: one made before would have spent what is kept for latecomers.
"""

from __future__ import annotations

import inspect
import threading
import time
import traceback
from collections.abc import Callable
from typing import Any

from calibration_interfaces.msg import Outcome
from lifecycle_msgs.msg import State, Transition, TransitionDescription, TransitionEvent
from lifecycle_msgs.srv import ChangeState, GetAvailableStates, GetAvailableTransitions, GetState
from rclpy.action import ActionClient, ActionServer, CancelResponse, GoalResponse
from rclpy.callback_groups import ReentrantCallbackGroup
from rclpy.event_handler import PublisherEventCallbacks, SubscriptionEventCallbacks
from rclpy.node import Node
from rclpy.subscription import Subscription
from rclpy.timer import Timer

from calibration.background import Background, in_executor
from calibration.lifecycle import machine
from calibration.lifecycle.machine import Edge, Machine
from calibration_core.errors import CalibrationError

DESTROYED = 2.0  # s of wall time, that the executor has to take down what a node made


class TransitionError(CalibrationError):
    """A node cannot make the transition that is asked for; the text says why."""


class ManagedNode(Node):
    """A node with the life of a managed one; subclasses say what its transitions do.

    Attributes:
        trouble: Why the last transition failed; empty if it did not.
    """

    def __init__(self, name: str, **kwargs: Any) -> None:
        """Offer the services of a managed node; the node is unconfigured.

        Args:
            name: Of the node.
            kwargs: Passed on to `rclpy.node.Node`.
        """
        self._machine = Machine()
        self._gates = False  # what rclpy and the lifecycle need is served in every state
        self.trouble = ""
        super().__init__(name, **kwargs)
        group = ReentrantCallbackGroup()
        for kind, place, callback in (
            (ChangeState, "change_state", self._on_change_state),
            (GetState, "get_state", self._on_get_state),
            (GetAvailableStates, "get_available_states", self._on_get_states),
            (GetAvailableTransitions, "get_available_transitions", self._on_get_transitions),
            (GetAvailableTransitions, "get_transition_graph", self._on_get_graph),
        ):
            self.create_service(kind, f"~/{place}", callback, callback_group=group)
        self._events = self.create_publisher(TransitionEvent, "~/transition_event", 10)

    # --- what transitions do: for subclasses --------------------------------------------------------------------------

    def on_configure(self) -> None:
        """Make what the node is made of, but nothing that it hears; whatever is raised leaves it unconfigured."""

    def on_activate(self) -> None:
        """Subscribe, and begin to work; nothing moves because of it.  What is raised leaves the node inactive."""

    def on_deactivate(self) -> None:
        """End what is under way; subscriptions and timers are taken down then.  What is raised leaves it active."""

    def on_cleanup(self) -> None:
        """Give back what is no entity of ROS: processes, threads, files.  The entities are taken down afterwards."""

    # --- where it stands ----------------------------------------------------------------------------------------------

    @property
    def state(self) -> int:
        """Number of the state, as in `lifecycle_msgs/msg/State`."""
        return self._machine.state

    @property
    def active(self) -> bool:
        """Whether the node works."""
        return self._machine.state == machine.ACTIVE

    def start(self) -> None:
        """Configure and activate at once, before anybody spins the node.

        Raises:
            Exception: Whatever the callbacks raise; what the node made is taken down.
        """
        for number in (machine.CONFIGURE, machine.ACTIVATE):
            edge = self._machine.begin(number)
            if edge is not None:
                self._announce(edge)
                try:
                    self._do(edge)
                except BaseException:
                    self._announce(self._machine.end(success=False))
                    raise
                self._announce(self._machine.end(success=True))

    def change(self, number: int, label: str = "") -> bool:
        """Make a transition; return whether it was possible and succeeded.  Not to be called by the executor's thread.

        Args:
            number: Of the transition, as in `lifecycle_msgs/msg/Transition`.
            label: Its label, which counts instead of the number where it is given.
        """
        edge = self._machine.begin(number, label)
        if edge is None:
            asked, here = label or str(number), machine.LABELS[self.state]
            self.get_logger().warning(f"transition {asked} is not possible while the node is {here}")
            return False
        self._announce(edge)
        try:
            self._do(edge)
        except CalibrationError as error:
            self.trouble = str(error)
            self.get_logger().error(f"{edge.label}: {error}")
        except Exception as error:  # noqa: BLE001  # told in full; whoever asked hears that it failed
            self.trouble = f"{type(error).__name__}: {error}"
            self.get_logger().error(f"{edge.label}: {traceback.format_exc()}")
        else:
            self.trouble = ""
        self._announce(self._machine.end(success=not self.trouble))
        return not self.trouble

    def _do(self, edge: Edge) -> None:
        match edge.goal:
            case machine.CONFIGURING:
                self._gates = True
                self._made = self._making(self.on_configure)
            case machine.ACTIVATING:
                self._listening = self._making(self.on_activate)
            case machine.DEACTIVATING:
                self._end_work()
            case machine.CLEANING_UP:
                self._clean_up()
            case machine.SHUTTING_DOWN:
                if edge.start == machine.ACTIVE:
                    self._end_work()
                if edge.start != machine.UNCONFIGURED:
                    self._clean_up()

    def _making(self, callback: Callable[[], None]) -> set[Any]:
        """Call back; return the entities that were there before, to which the node goes back if it fails."""
        before = self._entities()
        try:
            callback()
        except BaseException:
            self._take_down(before)
            raise
        return before

    def _end_work(self) -> None:
        self.on_deactivate()
        made = {one for one in self._entities() if not isinstance(one, Subscription | Timer)}
        self._take_down(self._listening | made)

    def _clean_up(self) -> None:
        self.on_cleanup()
        self._take_down(self._made)

    def _announce(self, edge: Edge) -> None:
        message = TransitionEvent(timestamp=time.time_ns())
        message.transition = Transition(id=edge.id, label=edge.label)
        message.start_state, message.goal_state = _state(edge.start), _state(edge.goal)
        self._events.publish(message)
        self.announced()

    def announced(self) -> None:
        """Take notice that the state has changed."""

    # --- what is made, and taken down again ---------------------------------------------------------------------------

    def _entities(self) -> set[Any]:
        actions = [one for one in self.waitables if isinstance(one, ActionServer | ActionClient)]
        return {*self.publishers, *self.subscriptions, *self.services, *self.clients, *self.timers, *actions}

    def _take_down(self, before: set[Any]) -> None:
        """Destroy what is there and was not before; in the executor's thread, which must not be waiting for it."""
        done = threading.Event()

        def work() -> None:
            for waitable in [one for one in self.waitables if isinstance(one, ActionServer | ActionClient)]:
                if waitable not in before:
                    waitable.destroy()
            for there, destroy in (
                (self.timers, self.destroy_timer),
                (self.subscriptions, self.destroy_subscription),
                (self.services, self.destroy_service),
                (self.clients, self.destroy_client),
                (self.publishers, self.destroy_publisher),
            ):
                for one in list(there):
                    if one not in before:
                        destroy(one)
            done.set()

        in_executor(self, work)
        if not done.wait(DESTROYED):
            raise TransitionError("the executor is busy: what the node made is not taken down yet")

    # --- what does not fit is found by looking at the graph (`topics.incompatible`) -----------------------------------

    def create_publisher(self, *args: Any, event_callbacks: PublisherEventCallbacks | None = None, **more: Any) -> Any:
        """Make a publisher; without the events that rclpy makes for each by itself: they cost half of every wake."""
        events = event_callbacks or PublisherEventCallbacks(use_default_callbacks=False)
        return super().create_publisher(*args, event_callbacks=events, **more)

    def create_subscription(
        self, *args: Any, event_callbacks: SubscriptionEventCallbacks | None = None, **more: Any
    ) -> Any:
        """Make a subscription; without the events that rclpy makes for each by itself: they cost half of every wake."""
        events = event_callbacks or SubscriptionEventCallbacks(use_default_callbacks=False)
        return super().create_subscription(*args, event_callbacks=events, **more)

    # --- nothing reaches a node that is not active --------------------------------------------------------------------

    def create_service(self, srv_type: Any, srv_name: str, callback: Any, *args: Any, **kwargs: Any) -> Any:
        """Offer a service; while the node is not active, it answers so."""
        return super().create_service(srv_type, srv_name, self._serving(callback), *args, **kwargs)

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
        """Offer an action; while the node is not active, goals are rejected.  Goals run beside one another."""

        def judged(goal: Any) -> GoalResponse:
            if self.active:
                return goal_callback(goal)
            self.get_logger().warning(f"{name}: goal rejected: {self._not_active()}")
            return GoalResponse.REJECT

        return ActionServer(
            self, action, name, execute, callback_group=ReentrantCallbackGroup(), goal_callback=judged,
            cancel_callback=cancel_callback, handle_accepted_callback=handle_accepted_callback,
        )  # fmt: skip

    def _serving(self, callback: Callable[[Any, Any], Any]) -> Callable[[Any, Any], Any]:
        if not self._gates:
            return callback
        if inspect.iscoroutinefunction(callback):

            async def awaited(request: Any, response: Any) -> Any:
                return await callback(request, response) if self.active else self._refused(response)

            return awaited
        return lambda request, response: callback(request, response) if self.active else self._refused(response)

    def _not_active(self) -> str:
        return f"{self.get_fully_qualified_name()} is {machine.LABELS[self.state]}, not active"

    def _refused(self, response: Any) -> Any:
        text = self._not_active()
        if hasattr(response, "outcome"):
            response.outcome = Outcome(code=Outcome.NOT_AVAILABLE, text=text)
        else:
            response.success, response.message = False, text
        return response

    # --- the services of a managed node -------------------------------------------------------------------------------

    async def _on_change_state(self, request: Any, response: Any) -> Any:
        asked = request.transition
        response.success = await Background(self, lambda: self.change(int(asked.id), str(asked.label)))
        return response

    def _on_get_state(self, _request: Any, response: Any) -> Any:
        response.current_state = _state(self.state)
        return response

    def _on_get_states(self, _request: Any, response: Any) -> Any:
        response.available_states = [_state(number) for number in machine.LABELS]
        return response

    def _on_get_transitions(self, _request: Any, response: Any) -> Any:
        response.available_transitions = [_description(edge) for edge in self._machine.available]
        return response

    def _on_get_graph(self, _request: Any, response: Any) -> Any:
        response.available_transitions = [_description(edge) for edge in machine.GRAPH]
        return response


def _state(number: int) -> State:
    return State(id=number, label=machine.LABELS[number])


def _description(edge: Edge) -> TransitionDescription:
    return TransitionDescription(
        transition=Transition(id=edge.id, label=edge.label),
        start_state=_state(edge.start),
        goal_state=_state(edge.goal),
    )
