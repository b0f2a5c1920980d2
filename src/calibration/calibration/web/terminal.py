"""The panel in a terminal, over ssh: the state in the nodes' own words, and the keys of what is needed most.

It is a node of its own and asks the same services as the page; over ssh there is no page to hold control, so that
whoever sits there says a name when it is started.
"""

from __future__ import annotations

import argparse
import asyncio
import math
import threading
import time
from collections.abc import Sequence
from typing import Any, ClassVar

import rclpy
from calibration_interfaces.msg import SessionEvent, State
from rclpy.executors import SingleThreadedExecutor
from rclpy.signals import SignalHandlerOptions
from rclpy.utilities import remove_ros_args
from textual.app import App, ComposeResult
from textual.widgets import Footer, Static

from calibration.conversions import to_header
from calibration.node import FRESH, spin
from calibration.rclpy_gaps import in_executor
from calibration.topics import EVENT, STATE
from calibration.web.link import CellLink, Latest

NODE = "panel_terminal"
LOOK = 0.1  # s of wall time between two looks
SILENT = "The manager is silent: nothing is known of the cell."


def described(state: State) -> str:
    """Return what is shown of a state: what is done and waited for, the load, the faults with the way out."""
    one = state.procedure
    lines = [state.text, f"waits for: {state.waiting}" if state.waiting else ""]
    if one.configurations_total:
        lines.append(f"{one.configurations_done} of {one.configurations_total} configurations done")
    if one.load_awaited or one.load_left:
        felt = f"{_size(one.load_felt):.0f} N" if state.procedure_known and one.load_felt_known else "not known"
        wanted = f"pull with {_size(one.target):.0f} N, " if one.load_awaited else ""
        lines.append(f"load: {wanted}felt: {felt}. {one.load_left or one.load_fault}")
    lines += [state.progress.text, *(f"{fault.text}\n  → {fault.remedy}" for fault in state.faults)]
    return "\n".join(filter(None, lines))


def _size(wrench: Any) -> float:
    return math.hypot(wrench.force.x, wrench.force.y, wrench.force.z)


class Terminal(App[None]):
    """The terminal's page."""

    CSS = "#permission { text-style: bold; border: heavy red; } #permission.yes { border: heavy green; }"
    BINDINGS: ClassVar = [
        ("s", "do('stop')", "STOP"),
        ("p", "do('pause')", "pause"),
        ("r", "do('resume')", "go on"),
        ("m", "do('resume_motion')", "resume motion"),
        ("c", "do('load_applied')", "load is on"),
        ("g", "do('guard_reset')", "reset guard"),
        ("q", "quit", "quit"),
    ]

    def __init__(self, node: Any, name: str) -> None:
        """Prepare.

        Args:
            node: Spun by somebody else.
            name: Of the operator.
        """
        super().__init__()
        self.cell_node, self.operator = node, name
        self.cell_state = Latest(node, STATE.message, STATE.relative, STATE.qos)
        self.cell_event = node.create_publisher(EVENT.message, EVENT.relative, EVENT.qos)
        self.cell_link = CellLink(node)
        self.cell_shown: State | None = None
        self.cell_heard = time.monotonic()

    def compose(self) -> ComposeResult:
        """Make what is shown."""
        for place in ("permission", "state", "answer"):
            yield Static(id=place, markup=False)
        yield Footer()

    def on_mount(self) -> None:
        """Begin to look."""
        self.set_interval(LOOK, self._look_again)

    def _look_again(self) -> None:
        if not self.is_running:  # it ends: what is shown is taken down step by step, and this may fall between two
            return
        message = self.cell_state.last()
        if message is not None:
            self.cell_shown, self.cell_heard = message, time.monotonic()
        state = None if time.monotonic() - self.cell_heard > FRESH else self.cell_shown
        permitted = state is not None and state.permission_known and not state.not_permitted
        self.query_one("#permission").set_class(permitted, "yes")
        if state is None:  # nothing of it is current
            self._fill("permission", SILENT)
            self._fill("state", "")
        else:
            self._fill("permission", "The robot may move" if permitted else state.not_permitted)
            self._fill("state", described(state))

    def _fill(self, place: str, text: str) -> None:
        self.query_one(f"#{place}", Static).update(text, layout=True)

    async def action_do(self, request: str) -> None:
        """Ask for something."""
        by: dict[str, Any] = {"operator_name": self.operator}
        fields: dict[str, Any] = {}
        if request in ("resume_motion", "guard_reset"):
            fields = by
        elif request == "load_applied":
            procedure = (self.cell_shown or State()).procedure
            fields = {**by, "configuration": procedure.configuration, "step": procedure.step}
        answer = await self.cell_link.ask(request, **fields)
        self._show(f"{request} by {self.operator} at a terminal{'' if answer.done else f': refused: {answer.text}'}")
        if self.is_running:
            self._fill("answer", "Done" if answer.done else f"Not done: {answer.text}")

    def _show(self, line: str) -> None:
        header = to_header(self.cell_node.get_clock().now().nanoseconds)
        event = SessionEvent(header=header, kind=SessionEvent.OPERATOR_ACTION, source=NODE, text=line)
        in_executor(self.cell_node, lambda: self.cell_event.publish(event))


def show(arguments: Sequence[str]) -> int:
    """Show the panel in this terminal until it is quit; return the exit code."""
    parser = argparse.ArgumentParser(prog="panel --terminal", description="The operator's panel in a terminal.")
    parser.add_argument("--terminal", action="store_true", required=True)
    parser.add_argument("--name", required=True, help="of the operator: what is asked for is logged by it")
    given = parser.parse_args(remove_ros_args(["panel", *arguments])[1:])
    rclpy.init(args=list(arguments), signal_handler_options=SignalHandlerOptions.NO)
    node = rclpy.create_node(NODE)
    node.failed = threading.Event()  # set when a callback raises
    executor, ending = SingleThreadedExecutor(), threading.Event()
    executor.add_node(node)
    app = Terminal(node, given.name)
    thread = threading.Thread(target=spin, args=(executor, node, ending), name="executor", daemon=True)
    thread.start()
    try:
        asyncio.run(app.run_async())
    finally:
        ending.set()
        executor.create_task(lambda: None)
        thread.join(timeout=1.0)
        executor.shutdown(timeout_sec=1.0)
        node.destroy_node()
        rclpy.try_shutdown()
    return 0
