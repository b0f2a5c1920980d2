"""The manager with real processes: silence, come-back, and the state of the cell that it tells."""

from __future__ import annotations

import contextlib
import signal
import subprocess
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest
from granted import Granted

pytest.importorskip("calibration_interfaces.msg", reason="the messages are not built: run make setup")

from calibration_interfaces.msg import NodeHealth, State
from rclpy.parameter import Parameter
from stand_ins import CELL

from calibration.manager import ManagerNode
from calibration.node import LEASE
from calibration.topics import STATE

pytestmark = pytest.mark.alone

BIN = Path(__file__).resolve().parents[3] / "install" / "calibration" / "lib" / "calibration"
NAMES = ["guard", "tracker", "force_torque"]
NOTICED = 1.5 * LEASE + 1.0  # s, from the blow to the message, on a busy machine


class Cell:
    """Processes, and a manager in this process."""

    def __init__(self, spinning: Any, environment: dict[str, str]) -> None:
        self._environment = environment
        self.processes: dict[str, subprocess.Popen[bytes]] = {}
        self.states: list[State] = []
        spinning.plain("outside").create_subscription(STATE.message, STATE.relative, self.states.append, STATE.qos)
        for name in NAMES:
            self.start(name)

    def start(self, name: str) -> None:
        command = [str(BIN / name), "--ros-args", "-p", f"cell:={CELL}"]
        self.processes[name] = subprocess.Popen(command, env=self._environment, stderr=subprocess.DEVNULL)

    def health(self, name: str) -> NodeHealth:
        found = [one for one in self.states[-1].nodes if one.name == name] if self.states else []
        return found[0] if found else NodeHealth(level=NodeHealth.ABSENT)

    def all_heard(self) -> bool:
        """Whether every process that was started last is heard."""
        found = [(self.health(name), process.pid) for name, process in self.processes.items()]
        return all(one.level < NodeHealth.ABSENT and one.process == pid for one, pid in found)

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


def test_missed_when_silent_and_heard_again(spinning: Any, cell: Cell, until: Callable[..., None]) -> None:
    given = [Parameter("cell", value=str(CELL)), Parameter("nodes", value=NAMES)]
    spinning.add(ManagerNode(context=spinning.context, parameter_overrides=given))
    until(cell.all_heard, timeout=60.0)
    first = cell.health("tracker")
    assert first.role == "tracker"
    assert len({cell.health(name).identifier for name in NAMES}) == len(NAMES)

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
    assert cell.health("guard").level < NodeHealth.ABSENT  # nobody else has ended
    cell.start("tracker")
    until(cell.all_heard, timeout=60.0)
    until(lambda: not cell.faults("node_silent"))
    assert cell.health("tracker").since > first.since

    # a process that stands still, and goes on
    watch = Granted()
    cell.processes["force_torque"].send_signal(signal.SIGSTOP)
    until(lambda: cell.health("force_torque").level == NodeHealth.SILENT)
    assert watch.seconds < NOTICED
    cell.processes["force_torque"].send_signal(signal.SIGCONT)
    until(cell.all_heard)


def test_a_node_that_hangs_is_silent_although_its_process_lives(spinning: Any, until: Callable[..., None]) -> None:
    """Its executor does not turn: what it sends by itself, as automatic liveliness is, would go on."""
    from rclpy.executors import SingleThreadedExecutor

    from calibration.node import CalibrationNode

    given = [Parameter("cell", value=str(CELL)), Parameter("nodes", value=["tracker"])]
    manager = spinning.add(ManagerNode(context=spinning.context, parameter_overrides=given))
    health = manager.whole.health
    node = CalibrationNode("tracker", (), context=spinning.context)
    executor = SingleThreadedExecutor(context=spinning.context)
    executor.add_node(node)
    for _ in range(20):
        executor.spin_once(timeout_sec=0.1)
    until(lambda: health["tracker"].level < NodeHealth.ABSENT)
    watch = Granted()
    until(lambda: health["tracker"].level == NodeHealth.SILENT)
    assert watch.seconds < NOTICED
    executor.shutdown()
    node.destroy_node()
