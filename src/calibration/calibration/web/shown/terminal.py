"""The panel in a terminal, over ssh: the same state, and the keys of what is needed most.

It is a node of its own and asks the same services as the page; over ssh there is no page to hold control, so that
whoever sits there says a name when it is started.
"""

from __future__ import annotations

import argparse
import asyncio
import locale
import threading
import time
from collections.abc import Sequence
from typing import Any, ClassVar

import rclpy
from calibration_interfaces.msg import SessionEvent
from rclpy.executors import SingleThreadedExecutor
from rclpy.signals import SignalHandlerOptions
from rclpy.utilities import remove_ros_args
from textual.app import App, ComposeResult
from textual.containers import VerticalScroll
from textual.widgets import Footer, Static

from calibration.background import in_executor
from calibration.conversions import to_header
from calibration.lifecycle.heartbeat import FRESH
from calibration.node import spin
from calibration.topics import EVENT, STATE
from calibration.web.link import CellLink, Latest
from calibration.web.shown import text
from calibration.web.shown.plain import plain
from calibration.web.shown.view import view
from calibration.web.shown.words import Words

NODE = "panel_terminal"
LOOK = 0.1  # s of wall time between two looks


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

    def __init__(self, node: Any, name: str, language: str) -> None:
        """Prepare.

        Args:
            node: Spun by somebody else.
            name: Of the operator.
            language: Of the words.
        """
        super().__init__()
        self.cell_node, self.operator, self.words = node, name, Words(language)
        self.cell_state = Latest(node, STATE.message, STATE.relative, STATE.qos)
        self.cell_event = node.create_publisher(EVENT.message, EVENT.relative, EVENT.qos)
        self.cell_link = CellLink(node)
        self.cell_shown: dict[str, Any] | None = None
        self.cell_heard = time.monotonic()

    def compose(self) -> ComposeResult:
        """Make what is shown."""
        yield Static(id="status", markup=False)
        yield Static(id="permission", markup=False)
        with VerticalScroll():
            yield Static(id="load", markup=False)
            yield Static(id="bars", markup=False)
            yield Static(id="faults", markup=False)
        yield Static(id="answer", markup=False)
        yield Footer()

    def on_mount(self) -> None:
        """Begin to look."""
        self.set_interval(LOOK, self._look_again)

    def _look_again(self) -> None:
        if not self.is_running:  # it ends: what is shown is taken down step by step, and this may fall between two
            return
        message = self.cell_state.take()
        if message is not None:
            self.cell_shown, self.cell_heard = view(plain(message)), time.monotonic()
        if self.cell_shown is None or time.monotonic() - self.cell_heard > FRESH:
            self._fill("status", [self.words("nothing_known")])
            self.query_one("#permission").set_class(False, "yes")
            for place in ("permission", "load", "bars", "faults"):  # nothing of it is current
                self._fill(place, [])
            return
        shown, w = self.cell_shown, self.words
        self._fill("status", text.status(shown, w))
        self._fill("permission", text.permission(shown, w))
        self.query_one("#permission").set_class(shown["permission"]["permitted"], "yes")
        self._fill("load", text.load(shown, w))
        self._fill("bars", text.bars(shown, w))
        self._fill("faults", text.faults(shown, w))

    def _fill(self, place: str, lines: list[str]) -> None:
        self.query_one(f"#{place}", Static).update("\n".join(lines), layout=True)

    async def action_do(self, request: str) -> None:
        """Ask for something."""
        by: dict[str, Any] = {"operator_name": self.operator}
        fields: dict[str, Any] = {}
        if request in ("resume_motion", "guard_reset"):
            fields = by
        elif request == "load_applied":
            procedure = (self.cell_shown or {}).get("procedure", {"configuration": 0, "step": 0})
            fields = {**by, "configuration": procedure["configuration"], "step": procedure["step"]}
        answer = await self.cell_link.ask(request, **fields)
        self._show(f"{request} by {self.operator} at a terminal{'' if answer.done else f': refused: {answer.text}'}")
        if self.is_running:
            self._fill("answer", [self.words("done") if answer.done else f"{self.words('not_done')}: {answer.text}"])

    def _show(self, line: str) -> None:
        header = to_header(self.cell_node.get_clock().now().nanoseconds)
        event = SessionEvent(header=header, kind=SessionEvent.OPERATOR_ACTION, source=NODE, text=line)
        in_executor(self.cell_node, lambda: self.cell_event.publish(event))


def show(arguments: Sequence[str]) -> int:
    """Show the panel in this terminal until it is quit; return the exit code."""
    parser = argparse.ArgumentParser(prog="panel --terminal", description="The operator's panel in a terminal.")
    parser.add_argument("--terminal", action="store_true", required=True)
    parser.add_argument("--name", required=True, help="of the operator: what is asked for is logged by it")
    parser.add_argument("--language", default=(locale.getlocale()[0] or "en")[:2], help="en or de")
    given = parser.parse_args(remove_ros_args(["panel", *arguments])[1:])
    rclpy.init(args=list(arguments), signal_handler_options=SignalHandlerOptions.NO)
    node = rclpy.create_node(NODE)
    node.failed = threading.Event()  # set when a callback raises
    executor, ending = SingleThreadedExecutor(), threading.Event()
    executor.add_node(node)
    app = Terminal(node, given.name, given.language)
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
