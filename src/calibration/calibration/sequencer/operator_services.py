"""What the operator can say to the sequencer: pause, go on, again, stop, the load is on, a condition is overridden."""

from __future__ import annotations

import time
from typing import Any

from calibration_interfaces.msg import Outcome
from calibration_interfaces.srv import LoadApplied, OverrideCondition, ResumeMotion
from std_srvs.srv import Trigger

from calibration.cell.conditions_watch import refused
from calibration.conversions import to_outcome
from calibration.sequencer.parameters import DEVICE
from calibration.sequencer.runner import Call
from calibration_core.measurement import messages as m

NO_PLAN = "no plan is being measured"
NAMELESS = "the name of who answers for it is missing"
HELD = "the permission was lost: reset the guard where it is latched, then call ~/resume_motion with your name"


class OperatorServices:
    """The services; what is said goes into the queue of the run under way."""

    def __init__(self, node: Any) -> None:
        """Offer them; `node` is the sequencer, with its run (`runner`, `port`), guard's word (`watch`), conditions."""
        self._node = node
        node.create_service(Trigger, "~/pause", self._on_pause)
        node.create_service(Trigger, "~/resume", self._on_resume)
        node.create_service(ResumeMotion, "~/resume_motion", self._on_resume_motion)
        node.create_service(Trigger, "~/repeat", lambda _request, response: self._redo(response, skip=False))
        node.create_service(Trigger, "~/skip", lambda _request, response: self._redo(response, skip=True))
        node.create_service(Trigger, "~/stop", self._on_stop)
        node.create_service(LoadApplied, "~/load_applied", self._on_load_applied)
        node.create_service(OverrideCondition, "~/override_condition", self._on_override)

    def _post(self, event: m.Event, response: Any) -> Any:
        runner = self._node.runner
        response.success = runner is not None
        response.message = "" if runner is not None else NO_PLAN
        if runner is not None:
            runner.post(event)
        return response

    def _on_pause(self, _request: Any, response: Any) -> Any:
        return self._post(m.Pause(0.0), response)

    def _on_resume(self, _request: Any, response: Any) -> Any:
        runner = self._node.runner
        if runner is not None and runner.sequence.held:
            response.success, response.message = False, HELD
            return response
        return self._post(m.Resume(0.0), response)

    def _on_resume_motion(self, request: Any, response: Any) -> Any:
        runner, name = self._node.runner, request.operator_name.strip()
        now = time.monotonic()
        if not name:
            response.outcome = to_outcome(Outcome.INPUT_UNUSABLE, NAMELESS)
        elif runner is None:
            response.outcome = to_outcome(Outcome.INPUT_UNUSABLE, NO_PLAN)
        elif not self._node.watch.ready(now):
            response.outcome = to_outcome(Outcome.NOT_PERMITTED, self._node.watch.at(now)[1])
        else:
            runner.post(m.ResumeMotion(now, name))
            response.outcome = to_outcome(Outcome.OK, "")
        return response

    def _redo(self, response: Any, *, skip: bool) -> Any:
        by_device = self._node.value("load.by") == DEVICE
        return self._post(m.Redo(0.0, skip=skip, moves_load=by_device), response)

    def _on_stop(self, _request: Any, response: Any) -> Any:
        self._node.interrupt()  # the runner may be waiting for a disk
        return self._post(m.Stop(0.0), response)

    def _on_load_applied(self, request: Any, response: Any) -> Any:
        port = self._node.port
        absent = (Outcome.INPUT_UNUSABLE, NO_PLAN)
        response.outcome = to_outcome(*(absent if port is None else port.load_applied(request)))
        return response

    def _on_override(self, request: Any, response: Any) -> Any:
        runner, port, conditions = self._node.runner, self._node.port, self._node.conditions
        response.outcome = refused(request.override, running=runner is not None) or to_outcome(Outcome.OK, "")
        if response.outcome.code == Outcome.OK and runner is not None and port is not None:
            runner.post(Call(lambda: conditions.override(request.override, port.session)))
        return response
