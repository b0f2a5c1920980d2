"""The manager with real processes: order, silence, come-back, and the state of the cell that it tells."""

from __future__ import annotations

import contextlib
import signal
import subprocess
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest
from granted import Granted

pytest.importorskip("calibration_interfaces.msg", reason="the messages are not built: run make setup")

from calibration_interfaces.msg import NodeHealth, State
from lifecycle_msgs.msg import Transition, TransitionEvent
from lifecycle_msgs.srv import ChangeState
from rclpy.parameter import Parameter
from stand_ins import CELL, call
from std_srvs.srv import Trigger

from calibration.lifecycle.heartbeat import LEASE
from calibration.manager import ManagerNode
from calibration.topics import STATE

pytestmark = pytest.mark.alone

BIN = Path(__file__).resolve().parents[3] / "install" / "calibration" / "lib" / "calibration"
NAMES = ["guard", "tracker", "force_torque"]
NOTICED = 1.5 * LEASE + 1.0  # s, from the blow to the message, on a busy machine


class Cell:
    """Processes that wait for their manager, and a manager in this process."""

    def __init__(self, spinning: Any, environment: dict[str, str]) -> None:
        self._environment = environment
        self.processes: dict[str, subprocess.Popen[bytes]] = {}
        self.client = spinning.plain("outside")
        self.states: list[State] = []
        self.events: list[tuple[int, str, str]] = []  # when, ns; who; what
        self.client.create_subscription(STATE.message, STATE.relative, self.states.append, STATE.qos)
        for name in NAMES:
            self.client.create_subscription(
                TransitionEvent, f"{name}/transition_event", lambda message, name=name: self._note(name, message), 100
            )
            self.start(name)

    def _note(self, name: str, message: TransitionEvent) -> None:
        if message.transition.label == "transition_success":
            self.events.append((int(message.timestamp), name, str(message.goal_state.label)))

    @property
    def changes(self) -> list[tuple[str, str]]:
        """Who became what, in the order of time: each node speaks on a topic of its own, of which one may be late."""
        return [(name, label) for _, name, label in sorted(self.events)]

    def start(self, name: str) -> None:
        command = [str(BIN / name), "--ros-args", "-p", f"cell:={CELL}", "-p", "autostart:=false"]
        self.processes[name] = subprocess.Popen(command, env=self._environment, stderr=subprocess.DEVNULL)

    def health(self, name: str) -> NodeHealth:
        found = [one for one in self.states[-1].nodes if one.name == name] if self.states else []
        return found[0] if found else NodeHealth(level=NodeHealth.ABSENT)

    def faults(self, code: str) -> list[Any]:
        return [one for one in self.states[-1].faults if one.code == code] if self.states else []

    def stop(self) -> None:
        for process in self.processes.values():
            with contextlib.suppress(ProcessLookupError):
                process.send_signal(signal.SIGCONT)
                process.kill()
            process.wait()


@pytest.fixture
def cell(spinning: Any, source_environment: dict[str, str]) -> Iterator[Cell]:
    one = Cell(spinning, source_environment)
    yield one
    one.stop()


def test_up_in_order_missed_when_silent_up_again_and_down(
    spinning: Any, cell: Cell, until: Callable[..., None]
) -> None:
    given = [Parameter("cell", value=str(CELL)), Parameter("nodes", value=NAMES)]
    until(lambda: set(NAMES) <= set(cell.client.get_node_names()), timeout=60.0)
    manager = spinning.add(ManagerNode(context=spinning.context, parameter_overrides=given))
    until(lambda: manager.order.all_active, timeout=60.0, what=manager._inactive())
    until(lambda: len(cell.events) == 6)
    assert cell.changes == [(name, state) for name in NAMES for state in ("inactive", "active")]

    # a dead process
    watch = Granted()
    cell.processes["tracker"].send_signal(signal.SIGKILL)
    cell.processes["tracker"].wait()
    until(lambda: cell.health("tracker").level == NodeHealth.SILENT)
    assert watch.seconds < NOTICED
    until(lambda: len(cell.faults("node_silent")) == 1)  # a busy machine silences others for a moment
    (fault,) = cell.faults("node_silent")
    assert (fault.source, fault.text) == ("tracker", "tracker is silent: no point is measured")
    assert fault.remedy == "start it again: ros2 run calibration tracker"
    assert manager.order.members["guard"].state == 3  # nobody else has ended
    cell.start("tracker")
    until(lambda: manager.order.all_active, timeout=60.0, what=manager._inactive())
    until(lambda: not cell.faults("node_silent"))

    # a process that stands still, and goes on
    watch = Granted()
    cell.processes["force_torque"].send_signal(signal.SIGSTOP)
    until(lambda: cell.health("force_torque").level == NodeHealth.SILENT)
    assert watch.seconds < NOTICED
    cell.processes["force_torque"].send_signal(signal.SIGCONT)
    until(lambda: manager.order.all_active)

    # what an operator deactivates is left alone, and shown
    change = cell.client.create_client(ChangeState, "tracker/change_state")
    assert call(change, ChangeState.Request(transition=Transition(label="deactivate"))).success
    until(lambda: cell.faults("node_not_active"))
    assert cell.faults("node_not_active")[0].remedy == "ros2 lifecycle set /tracker activate"
    time.sleep(1.0)
    assert cell.health("tracker").lifecycle.label == "inactive"
    is_active = cell.client.create_client(Trigger, "manager/is_active")
    answer = call(is_active, Trigger.Request())
    assert (answer.success, answer.message) == (False, "tracker is inactive")

    # all up again, and down in the opposite order
    assert call(cell.client.create_client(Trigger, "manager/startup"), Trigger.Request()).success
    assert call(is_active, Trigger.Request()).success
    cell.events.clear()
    assert call(cell.client.create_client(Trigger, "manager/shutdown"), Trigger.Request()).success
    until(lambda: len(cell.events) == 6)
    assert cell.changes == [(name, state) for name in reversed(NAMES) for state in ("inactive", "unconfigured")]


def test_a_node_that_hangs_is_silent_although_its_process_lives(spinning: Any, until: Callable[..., None]) -> None:
    """Its executor does not turn: what it sends by itself, as automatic liveliness is, would go on."""
    from rclpy.executors import SingleThreadedExecutor

    from calibration.node import CalibrationNode

    given = [Parameter("cell", value=str(CELL)), Parameter("nodes", value=["tracker"])]
    manager = spinning.add(ManagerNode(context=spinning.context, parameter_overrides=given))
    node = CalibrationNode("tracker", (), context=spinning.context)
    executor = SingleThreadedExecutor(context=spinning.context)
    executor.add_node(node)
    for _ in range(20):
        executor.spin_once(timeout_sec=0.1)
    until(lambda: manager.order.members["tracker"].alive)
    watch = Granted()
    until(lambda: not manager.order.members["tracker"].alive)
    assert watch.seconds < NOTICED
    executor.shutdown()
    node.destroy_node()
