"""The sequencer's part of the cell's state: what it does and waits for, sent at every change."""

from __future__ import annotations

import math
import time
from collections.abc import Callable
from typing import Any

import numpy as np
from calibration_interfaces.msg import ProcedureState
from geometry_msgs.msg import Wrench

from calibration.cell.reading_checks import PresentLoad
from calibration.conversions import to_header, to_wrench
from calibration.status.observer import Observer
from calibration.topics import PROCEDURE
from calibration_core.measurement import messages as m
from calibration_core.measurement.sequence import Sequence
from calibration_core.timeseries import Float1D, Phase

PERIOD = 1.0  # s of wall time between two messages that tell nothing new
LIVE = 0.2  # s, likewise, while a load is being changed or a reading is taken: both are watched
STATES = {
    m.RunState.IDLE: ProcedureState.PREPARING,
    m.RunState.READY: ProcedureState.READY,
    m.RunState.MOVING: ProcedureState.MOVING,
    m.RunState.LOADING: ProcedureState.LOADING,
    m.RunState.SETTLING: ProcedureState.SETTLING,
    m.RunState.READING: ProcedureState.READING,
    m.RunState.UNLOADING: ProcedureState.UNLOADING,
    m.RunState.FINISHED: ProcedureState.FINISHED,
}
# These change all the time, and are no news.
STEADY = ("header", "share_done", "averaged", "seconds_left", "load_felt", "load_fault")


class ProcedureReport:
    """Tells what the sequencer does."""

    def __init__(self, node: Any) -> None:
        """Offer the topic; no plan is being measured yet."""
        self._node = node
        self._publisher = node.create_publisher(PROCEDURE.message, PROCEDURE.relative, PROCEDURE.qos)
        self._last: dict[str, Any] = {}
        self._sent = -math.inf
        self._message = ProcedureState(text="no plan is being measured", seconds_left=math.nan)
        self._message.band_force = self._message.band_angle = self._message.averaged = math.nan
        self._send()

    def preparing(self, plan: str, session: str, recording: str) -> None:
        """Tell that a goal was accepted."""
        self._message = self._fresh(ProcedureState.PREPARING, "looking for what the run needs")
        self._message.plan, self._message.session, self._message.recording = plan, session, recording
        self._message.waits_for = ProcedureState.NODES
        self._message.waiting = "the cell's nodes and drivers"
        self._send()

    def ended(self, text: str) -> None:
        """Tell that a run is over, and how."""
        self._message.state, self._message.text = ProcedureState.FINISHED, text
        self._message.waits_for, self._message.waiting, self._message.question = ProcedureState.NOBODY, "", ""
        self._message.moving = self._message.paused = self._message.held = self._message.load_awaited = False
        self._message.averaged, self._message.seconds_left = math.nan, 0.0
        self._message.goal = []
        self._send()

    def publish(
        self,
        sequence: Sequence,
        observer: Observer,
        present: Callable[[Float1D], PresentLoad],
        averaged: float,
        *,
        moving: bool,
    ) -> None:
        """Tell how a run stands; nothing is sent if that is no news.

        Args:
            sequence: The procedure.
            observer: Who watches it.
            present: Tells what pulls now, given what is wanted.
            averaged: Share of the averaging window of the reading under way, 0 to 1; NaN: nothing is averaged.
            moving: Whether a motion is under way.
        """
        old = self._message
        new = self._fresh(STATES[sequence.state], observer.text)
        new.plan, new.session, new.recording = old.plan, old.session, old.recording
        new.waits_for, new.waiting, new.question = int(observer.waits_for), observer.waiting, observer.question
        new.paused, new.held, new.moving = sequence.paused, sequence.held, moving
        new.readings = observer.readings
        new.kind, new.phase_name = observer.item, observer.phase
        new.configuration, new.attempt = observer.configuration, observer.attempt
        new.step, new.steps = observer.step, observer.steps
        new.phase = int(sequence.position[2] if sequence.position else Phase.MOVING)
        queue = sequence.queue
        new.configurations_done, new.configurations_total = len(queue.completed), queue.target
        new.configurations_skipped = len(queue.given_up)
        new.share_done, new.seconds_left = float(queue.share_done), float(sequence.seconds_left)
        new.load_awaited, new.target = observer.load_awaited, to_wrench(observer.target)
        size = float(np.linalg.norm(observer.target[:3]))
        new.direction = observer.target[:3] / size if size > 0.0 else np.zeros(3)
        reading = sequence.state is m.RunState.READING
        new.averaged = averaged if reading else math.nan
        load = present(observer.target)
        new.band_force, new.band_angle = load.band_force, load.band_angle
        new.load_felt_known, new.load_fault = load.felt is not None, load.fault if observer.load_awaited else ""
        new.load_felt = to_wrench(np.zeros(6) if load.felt is None else load.felt)
        new.goal = [] if observer.goal is None else observer.goal.tolist()
        last = observer.reading
        new.reading_verdict, new.reading_text = int(last.verdict), last.text
        new.reading_configuration, new.reading_step = last.configuration, last.step
        self._message = new
        if self._news() or time.monotonic() - self._sent >= (LIVE if new.load_awaited or reading else PERIOD):
            self._send()

    def _fresh(self, state: int, text: str) -> ProcedureState:
        message = ProcedureState(state=state, text=text, seconds_left=math.nan, target=Wrench())
        message.band_force = message.band_angle = message.averaged = math.nan
        message.joints = list(self._node.cell.robot.joints)
        return message

    def _news(self) -> bool:
        return {name: repr(value) for name, value in self._fields()} != self._last

    def _fields(self) -> list[tuple[str, Any]]:
        names = self._message.get_fields_and_field_types()
        return [(name, getattr(self._message, name)) for name in names if name not in STEADY]

    def _send(self) -> None:
        self._message.header = to_header(self._node.now_ns())
        self._last = {name: repr(value) for name, value in self._fields()}
        self._sent = time.monotonic()
        self._publisher.publish(self._message)
