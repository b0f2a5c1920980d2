"""What the operator can say to the sequencer: pause, go on, again, stop, the load is on, a condition is overridden."""

from __future__ import annotations

import math
import time
from typing import Any

from calibration_interfaces.msg import Outcome
from calibration_interfaces.srv import LoadApplied, OverrideCondition, ResumeMotion
from rclpy.callback_groups import ReentrantCallbackGroup
from std_srvs.srv import Trigger

from calibration.asks import wait_until
from calibration.cell.conditions_watch import refused
from calibration.conversions import to_outcome
from calibration.rclpy_gaps import Background
from calibration.sequencer.goal import Answer, Request
from calibration.sequencer.parameters import DEVICE
from calibration.sequencer.runner import Call
from calibration_core.measurement import messages as m

NAMELESS = "the name of who answers for it is missing"
HELD = "the permission was lost: reset the guard where it is latched, then call ~/resume_motion with your name"


class OperatorServices:
    """The services; what is said is taken as `goal.TABLE` says, and heard by the run alone."""

    def __init__(self, node: Any) -> None:
        """Offer them; `node` is the sequencer, with its goal (`runs`), guard's word (`watch`), conditions."""
        self._node = node
        node.create_service(Trigger, "~/pause", lambda _, answer: self._say(answer, Request.PAUSE, m.Pause(0.0)))
        node.create_service(Trigger, "~/resume", self._on_resume)
        node.create_service(ResumeMotion, "~/resume_motion", self._on_resume_motion)
        node.create_service(Trigger, "~/repeat", lambda _, answer: self._redo(answer, skip=False))
        node.create_service(Trigger, "~/skip", lambda _, answer: self._redo(answer, skip=True))
        node.create_service(Trigger, "~/stop", lambda _, answer: self._say(answer, Request.STOP))
        group = ReentrantCallbackGroup()
        node.create_service(LoadApplied, "~/load_applied", self._on_load_applied, callback_group=group)
        node.create_service(OverrideCondition, "~/override_condition", self._on_override)

    def _say(self, response: Any, request: Request, event: m.Event | None = None) -> Any:
        response.message = self._node.runs.take(request, event).refusal
        response.success = not response.message
        return response

    def _on_resume(self, _request: Any, response: Any) -> Any:
        runner, watch, now = self._node.runner, self._node.watch, time.monotonic()
        lost = watch.latched if runner is None else runner.sequence.held or not watch.ready(now)
        if lost and self._node.runs.goal is not None:
            response.success, response.message = False, HELD
            return response
        return self._say(response, Request.RESUME, m.Resume(0.0))

    def _on_resume_motion(self, request: Any, response: Any) -> Any:
        node, name, now = self._node, request.operator_name.strip(), time.monotonic()
        if not name:
            response.outcome = to_outcome(Outcome.INPUT_UNUSABLE, NAMELESS)
        elif node.runner is not None and not node.watch.ready(now):
            response.outcome = to_outcome(Outcome.NOT_PERMITTED, node.watch.at(now)[1])
        else:
            refusal = node.runs.take(Request.ACT, m.ResumeMotion(now, name)).refusal
            response.outcome = to_outcome(Outcome.INPUT_UNUSABLE if refusal else Outcome.OK, refusal)
        return response

    def _redo(self, response: Any, *, skip: bool) -> Any:
        by_device = self._node.value("load.by") == DEVICE
        return self._say(response, Request.ACT, m.Redo(0.0, skip=skip, moves_load=by_device))

    async def _on_load_applied(self, request: Any, response: Any) -> Any:
        """Have the run's thread, which owns loads and readings, take the operator's word."""
        port, answers = self._node.port, list[tuple[int, str]]()
        refusal = self._node.runs.take(Request.ACT, Call(lambda: answers.append(port.load_applied(request)))).refusal
        if not refusal:
            over = lambda: bool(answers) or self._node.port is not port  # noqa: E731  # a disk may be slow
            await Background(self._node, lambda: wait_until(over, math.inf))
            refusal = "" if answers else Answer.LATE.value
        response.outcome = to_outcome(*([(Outcome.INPUT_UNUSABLE, refusal)] if refusal else answers)[0])
        return response

    def _on_override(self, request: Any, response: Any) -> Any:
        port = self._node.port
        response.outcome = refused(request.override, running=port is not None) or to_outcome(Outcome.OK, "")
        if response.outcome.code == Outcome.OK:
            refusal = self._node.runs.take(Request.ACT, Call(lambda: port.override_condition(request.override))).refusal
            response.outcome = to_outcome(Outcome.INPUT_UNUSABLE if refusal else Outcome.OK, refusal)
        return response
