"""`panel`: the operator's page, for a tablet at the robot, and the same in a terminal.

It shows the state of the cell, and asks for what the operator wants as the terminal would: by services and actions of
the other nodes.  It has no authority of its own: it moves nothing, permits nothing, and its stop is no emergency stop.
"""

from __future__ import annotations

import asyncio
import collections
import functools
import math
import socket
import sys
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from calibration_interfaces.msg import SessionEvent
from rclpy.clock import Clock, ClockType
from sensor_msgs.msg import JointState

from calibration.conversions import joint_positions, to_header
from calibration.node import FRESH, CalibrationNode, Declared, ParameterError, run
from calibration.rclpy_gaps import in_executor
from calibration.topics import EVENT, STATE
from calibration.web.access import EVERY, Control, Session, bracketed, origins
from calibration.web.folder import Folder
from calibration.web.hub import Hub
from calibration.web.link import CellLink, Latest
from calibration.web.operator import Operator
from calibration.web.server import Server, Settings
from calibration.web.serving import Door, Serving, listening, printed
from calibration.web.view import EVENT_KINDS, Held, checklist, forgotten, place_of, plain, unfinished, view
from calibration_core.cell import load_cell
from calibration_core.report.view3d import cell_view

LOOK = 0.05  # s of wall time between two looks at what has come
SLOW = 2.0  # s of wall time between two looks at what changes slowly: disk, and what the recorder hears
EVENTS = 10  # last ones that the page lists
LOOPBACK = "127.0.0.1"

PARAMETERS = (
    Declared("cell", "", "The cell file.", required=True),
    Declared("session", "", "Directory of a session; plans and sessions are beside it.", required=True),
    Declared("host", LOOPBACK, "Address to listen at; 0.0.0.0: at every one of this machine."),
    Declared("names", [], "Further names of this machine; `https://NAME`: as a reverse proxy serves the page."),
    Declared("port", 8420, "Port to listen at, or the next one that is free; 0: any.", low=0, high=65535),
)


class PanelNode(CalibrationNode):
    """Listens to the cell, and serves the page."""

    def __init__(self, **kwargs: Any) -> None:
        """Make the node.

        Raises:
            InputError: A parameter cannot be used, or the port is taken.
        """
        super().__init__("panel", PARAMETERS, **kwargs)

    def on_start(self) -> None:
        """Read the cell, take the port, listen to the cell, and serve."""
        self._cell = load_cell(self.value("cell"), live=True)
        host = self.value("host")
        try:
            self._socket = listening(host, self.value("port"))
        except OSError as error:
            raise ParameterError(self.get_name(), "host", f"{host}: {error.strerror}", "one to listen at") from error
        port = int(self._socket.getsockname()[1])
        names = [*self.value("names"), *([socket.gethostname()] if host != LOOPBACK else [])]
        shown = f"http://{bracketed(names[0] if host in EVERY else host)}:{port}"
        address = next((one.rstrip("/") for one in names if "://" in one), shown)
        settings = Settings(origins(host, names, port), port, address)
        folder = Folder(Path(self.value("session")).absolute().parent)
        self._hub, self._control, self._folder = Hub(), Control(), folder
        self._held = Held()
        self._latest: dict[str, Any] | None = None
        self._unfinished: dict[str, str] | None = None
        self._door = Door(lambda text: in_executor(self, lambda: self.get_logger().warning(text)))
        self._operator_events: collections.deque[SessionEvent] = collections.deque()
        self._event = self.create_publisher(EVENT.message, EVENT.relative, EVENT.qos)
        self._link = CellLink(self)
        self._operator = Operator(self._link, folder, self._hub, self._control, self._log)
        scene = functools.cache(self._in_space)
        do, door = self._operator.do, self._door
        self._server = Server(settings, folder, self._hub, self._control, do, self._on_entry, scene, door)
        if host != LOOPBACK:
            self.get_logger().warning(f"the page is served at {host} without TLS: who listens there can read the token")
        self._web = Serving(self._server.application(), self._socket, self._operator.close, self._door)
        self._heard = self._moved = -FRESH
        self._slow = -SLOW
        self._disk: float | None = None
        self._recorder: tuple[bool, str] | None = None
        self._happened: collections.deque[dict[str, Any]] = collections.deque(maxlen=EVENTS)
        self.create_subscription(EVENT.message, EVENT.relative, self._on_event, EVENT.qos)
        self._states = Latest(self, STATE.message, STATE.relative, STATE.qos)
        self._joints = Latest(self, JointState, self._cell.topics.joint_states.lstrip("/"))
        self._hub.show("cell", {"name": self._cell.name, "robot": self._cell.robot.name,
                                "joints": list(self._cell.robot.joints), "nominal": self._nominal(),
                                "session": Path(self.value("session")).name})  # fmt: skip
        self._hub.show("silent", value=True)
        self._web.start()
        self._print()
        self.create_timer(LOOK, self._look, clock=Clock(clock_type=ClockType.STEADY_TIME))

    def _print(self) -> None:
        url = f"{self._server.settings.address}/#{self._server.access.token}"
        print(printed(url), flush=True)

    # --- what is shown -----------------------------------------------------------------------------------------------

    def _look(self) -> None:
        """Take what has come, and hand it to the pages."""
        now = time.monotonic()
        joints = self._joints.last()
        q = None if joints is None else joint_positions(joints, self._cell.robot.joints)
        message = self._states.last()
        state = None if message is None else plain(message)
        self._web.do(lambda: self._show(state, None if q is None else [round(float(one), 5) for one in q], now))

    def _show(self, state: dict[str, Any] | None, q: list[float] | None, now: float) -> None:
        """Show what came, and what is current no more; in the server's thread."""
        self._hub.show("hold", self._operator.hold)
        if q is not None:
            self._moved = now
        if q is not None or now - self._moved > FRESH:
            self._hub.show("q", q)
        if state is not None:
            self._latest, self._heard = state, now
        elif self._latest is not None and now - self._heard > FRESH:
            self._latest = state = forgotten(self._latest)
        self._hub.show("silent", now - self._heard > FRESH)
        if state is not None:
            shown = view(state)
            self._unfinished = unfinished(state, self._folder.root, self._unfinished)
            self._hub.show("unfinished", self._unfinished)
            self._hub.show("view", shown)
            self._hub.show("check", checklist(shown, self._disk, self._recorder))
            self._hold(state, now, fits=shown["confirm"]["by_itself"])
        if now - self._slow >= SLOW:
            self._slow = now
            self._web.begin(self._look_around())

    async def _look_around(self) -> None:
        self._disk = await asyncio.to_thread(self._folder.free)
        answer = await self._link.ask("recorder_hears")
        self._recorder = (answer.done, answer.text)
        await self._server.keep_used()

    def _hold(self, state: dict[str, Any], now: float, *, fits: bool) -> None:
        """Have a load confirmed that has fitted for as long as the operator has chosen, while the operator looks."""
        since = self._held.look(place_of(state), now, fits=fits and self._operator.present)
        self._hub.show("held", round(since, 1))
        if self._held.take(now, self._operator.hold):
            self._web.begin(self._confirm_held(state["procedure"]["configuration"], state["procedure"]["step"]))

    async def _confirm_held(self, configuration: int, step: int) -> None:
        if not await self._operator.confirm_held(configuration, step):
            self._held.refused(time.monotonic())

    def _on_event(self, message: SessionEvent) -> None:
        """Take what happened, as the nodes report it; what one has reported before this one listened comes, too."""
        one = {"time": message.header.stamp.sec, "kind": EVENT_KINDS.get(message.kind, ""),
               "source": message.source, "text": message.text}  # fmt: skip
        self._web.do(lambda: self._add(one))

    def _add(self, event: dict[str, Any]) -> None:
        self._happened.append(event)
        self._hub.show("events", list(self._happened))
        if event["kind"] == "permission_lost":
            self._hub.show("lost_at", event)

    def _nominal(self) -> dict[str, float]:
        """Return what the cell file believes of the joints' stiffnesses, N*m/rad; rigid ones are left out."""
        stiffness = self._cell.robot.stiffness or ()
        pairs = zip(self._cell.robot.joints, stiffness, strict=False)
        return {joint: float(one) for joint, one in pairs if math.isfinite(one)}

    def _in_space(self) -> dict[str, Any]:
        """Return the cell in space, and where the load pulls, in the flange frame."""
        point = self._cell.frames.wrench_point
        return {"view": cell_view(self._cell).json(), "wrench_point": list(point or (0.0, 0.0, 0.0))}

    # --- what is logged ----------------------------------------------------------------------------------------------

    def _on_entry(self, session: Session | None, text: str) -> None:
        self._log(text)
        if session is not None:
            self._print()

    def _log(self, text: str) -> None:
        """Write down what was asked for at the panel: in the log, and for bag and session as an event; in order."""
        header = to_header(self.now_ns())
        self._operator_events.append(
            SessionEvent(header=header, kind=SessionEvent.OPERATOR_ACTION, source="panel", text=text)
        )
        in_executor(self, self._publish_events)

    def _publish_events(self) -> None:
        while self._operator_events:
            event = self._operator_events.popleft()
            self.get_logger().info(event.text)
            self._event.publish(event)

    def on_end(self) -> None:
        """Serve no more, and give the port back; what runs in the cell goes on."""
        self._web.stop()
        self._socket.close()


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the node, or show the panel in this terminal (`--terminal`); return the exit code."""
    given = list(sys.argv[1:] if arguments is None else arguments)
    if "--terminal" in given:
        from calibration.web.terminal import show

        return show(given)
    return run(PanelNode, given)


if __name__ == "__main__":
    sys.exit(main())
