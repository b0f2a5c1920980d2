"""What becomes of a request: the service or the action that it is, asked in the name of the operator, and logged."""

from __future__ import annotations

import asyncio
import contextlib
import math
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

from calibration_interfaces.msg import ConditionOverride, RobotState
from calibration_interfaces.srv import PointRequest, SelfTest

from calibration.web.access import Control, Session
from calibration.web.folder import BAG, Folder
from calibration.web.hub import Hub, in_loop
from calibration.web.link import Answer, CellLink
from calibration_core.errors import InputError

BETWEEN_STOPS = 0.1  # s of wall time between two stops that are asked for: taps in between share the next one
STEPS = {"add": SelfTest.Request.ADD, "evaluate": SelfTest.Request.EVALUATE, "clear": SelfTest.Request.CLEAR}
POINT = {what: getattr(PointRequest.Request, what.upper()) for what in ("skip", "repeat", "exclude")}
Log = Callable[[str], None]


class Operator:
    """Does what pages ask for."""

    def __init__(self, link: CellLink, folder: Folder, hub: Hub, control: Control, log: Log) -> None:
        """Prepare.

        Args:
            link: The cell's services and actions.
            folder: Where sessions and plans are.
            hub: Where it is shown what is under way.
            control: Who holds control.
            log: Takes one line for every request, with who asks and from where.
        """
        self._link, self._folder, self._hub, self._log = link, folder, hub, log
        self.control = control
        self._hold = 0.0
        self._chooser: Session | None = None
        self._stop: asyncio.Task[Answer] | None = None  # the one that is yet to be asked for
        self._stopped = -math.inf
        self._overrides: dict[str, ConditionOverride] = {}  # conditions that are overridden in the next run
        self._evaluation: asyncio.Task[None] | None = None

    async def do(self, name: str, values: dict[str, Any], session: Session) -> Answer:
        """Do what a session asks for; every request and its answer are logged.

        A stop is never refused: each is followed by one that the sequencer is asked for, at most so many a second.
        """
        if name != "stop":
            return await self._logged(name, values, session)
        if self._stop is None:
            self._stop = asyncio.get_running_loop().create_task(self._next_stop(session))
        return await asyncio.shield(self._stop)

    async def _next_stop(self, session: Session) -> Answer:
        await asyncio.sleep(self._stopped + BETWEEN_STOPS - time.monotonic())
        self._stopped, self._stop = time.monotonic(), None
        return await self._logged("stop", {}, session)

    async def _logged(self, name: str, values: dict[str, Any], session: Session) -> Answer:
        who = f"{session.name} from {session.address}"
        given = ", ".join(f"{key} {value}" for key, value in values.items() if value not in ("", False))
        try:
            answer = await self._done(name, values, session)
        except Exception as error:  # noqa: BLE001  # whatever it is, whoever asked must learn of it
            answer = Answer(done=False, text=_words(error))
        outcome = "" if answer.done else f": refused: {answer.text}"
        self._log(f"{name}{f' ({given})' if given else ''} by {who}{outcome}")
        return answer

    async def _done(self, name: str, values: dict[str, Any], session: Session) -> Answer:
        match name:
            case "control_ask" | "control_release" | "control_answer" | "operator":
                return self._control(name, values, session)
            case "override_condition":
                return await self._override(name, values, session)
            case "hold_time":
                self._hold, self._chooser = float(values["seconds"]), session
                self._hub.show("hold", self.hold)
                return Answer(done=True)
            case "run":
                return await self._run(values)
            case "identify":
                return self._aside(values)
            case "cancel_evaluation":
                return self._link.cancel_evaluation()
        return await self._link.ask(name, **_fields(name, values, session))

    async def _override(self, name: str, values: dict[str, Any], session: Session) -> Answer:
        """Have a condition overridden: in the run under way, or from the beginning of the next one."""
        fields = _fields(name, values, session)
        answer = await self._link.ask(name, **fields)
        if answer.done or answer.message is None:
            return answer
        self._overrides[values["condition"]] = fields["override"]
        self._hub.show("overrides", sorted(self._overrides))
        return Answer(done=True, text=f"{values['condition']} is overridden from the beginning of the next run")

    # --- control ------------------------------------------------------------------------------------------------------

    def _control(self, name: str, values: dict[str, Any], session: Session) -> Answer:
        if name == "control_ask":
            given = self.control.ask(session, time.monotonic())
            holder = self.control.holder
            return Answer(given, "" if given or holder is None else f"{holder.name} is asked")
        if name != "control_answer":  # a new operator of the same device asks for control anew
            self.control.release(session)
            session.name = str(values.get("name", session.name))
            return Answer(done=True)
        return Answer(self.control.answer(session, give=bool(values["give"])))

    # --- runs, evaluations -------------------------------------------------------------------------------------------

    async def _run(self, values: dict[str, Any]) -> Answer:
        plans = await asyncio.to_thread(self._folder.plans)
        plan = plans.get(values["plan"])
        if plan is None:
            return Answer(done=False, text=f"there is no plan {values['plan']}")
        fields = {
            "plan": str(plan),
            "session": str(self._folder.session(str(values["session"]))),
            "resume": values["resume"],
            "wanted_accuracy": float(values["wanted_accuracy"]),
            "stop_when_enough": values["stop_when_enough"],
            "overrides": list(self._overrides.values()),
        }
        self._hub.show("ended", "")
        answer = await self._link.begin_run(fields, lambda text: self._hub.show("ended", text))
        if answer.done:
            self._overrides.clear()
            self._hub.show("overrides", [])
        return answer

    def _aside(self, values: dict[str, Any]) -> Answer:
        """Begin an evaluation; the page shows how far it is.  One at a time."""
        if self._evaluation is not None and not self._evaluation.done():
            return Answer(done=False, text="one is under way")
        self._evaluation = asyncio.get_running_loop().create_task(self._evaluate(values))
        return Answer(done=True)

    async def _evaluate(self, values: dict[str, Any]) -> None:
        what, session = str(values["what"]), str(values["session"])
        loop = asyncio.get_running_loop()

        def report(share: float, text: str, *, failed: bool = False) -> None:
            self._hub.show("work_evaluation", {"share": share, "text": text, "failed": failed})

        report(0.0, "")
        try:
            recording: Path = self._folder.session(session) / BAG
            answer = await self._link.evaluate(
                what, str(recording), lambda share, text: in_loop(loop, lambda: report(share, text))
            )
        except Exception as error:  # noqa: BLE001  # whatever it is, whoever asked must learn of it
            answer = Answer(done=False, text=_words(error))
        await asyncio.sleep(0)  # progress that was told before the end comes before it
        report(1.0, f"{session}: {what}" if answer.done else answer.text, failed=not answer.done)

    async def close(self) -> None:
        """End what is under way here; what runs in the cell goes on."""
        self._link.leave()
        if self._evaluation is not None:
            self._evaluation.cancel()
            with contextlib.suppress(asyncio.CancelledError):
                await self._evaluation

    # --- loads that are confirmed without a click ---------------------------------------------------------------------

    @property
    def hold(self) -> float:
        """s, for which a load has to fit before it is confirmed without a click; 0: never.

        It is the choice of who holds control, and ends with that: the next one has to choose it anew.
        """
        if self._chooser is not self.control.holder:
            self._hold, self._chooser = 0.0, self.control.holder
        return self._hold

    @property
    def present(self) -> bool:
        """Whether the page of who holds control is open."""
        return self.control.holder is not None and self.control.holder.pages > 0

    async def confirm_held(self, configuration: int, step: int) -> bool:
        """Confirm a load that has fitted for long enough, by the name of who chose so; return whether it counts."""
        session = self.control.holder
        if session is None or not self.hold:
            return False
        values = {"configuration": configuration, "step": step, "override": False, "reason": ""}
        answer = await self._link.ask("load_applied", **_fields("load_applied", values, session))
        outcome = "" if answer.done else f": refused: {answer.text}"
        place = f"configuration {configuration}, step {step}"
        self._log(f"load of {place} held for {self.hold:g} s, chosen by {session.name} from {session.address}{outcome}")
        return answer.done


def _words(error: BaseException) -> str:
    """Return what a person is told of an error."""
    return str(error) if isinstance(error, InputError) else f"{type(error).__name__}: {error}"


def _fields(name: str, values: dict[str, Any], session: Session) -> dict[str, Any]:
    """Return the fields of a service's request."""
    by = {"operator_name": session.name}
    match name:
        case "resume_motion" | "guard_reset":
            return by
        case "load_applied":
            return {**by, **values}
        case "point":
            return {**by, **values, "what": POINT[values["what"]]}
        case "override_condition":
            override = ConditionOverride(condition=values["condition"], reason=values["reason"], **by)
            return {"override": override}
        case "confirm_mode":
            return {**by, "operating_mode": RobotState.MODE_MANUAL_REDUCED, "valid_for": float(values["valid_for"])}
        case "tare":
            return {"clear": values["clear"], "requested_by": session.name, "reason": "asked for at the panel"}
        case "self_test":
            return {"command": STEPS[values["step"]], "mass": float(values["mass"])}
    return {}
