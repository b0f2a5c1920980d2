"""Node `identification`: the evaluation of a recording as services and as an action.

The work is done by the same code as the command line's, in a process beside the callbacks: the same files, the same
numbers.  One evaluation at a time; whoever comes meanwhile is told so.  A service answers as soon as the numbers are
there; the report is drawn by a second process and follows within seconds.  The action waits for it.
"""

from __future__ import annotations

import dataclasses
import sys
import threading
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

from calibration_interfaces import srv
from calibration_interfaces.action import Identify
from calibration_interfaces.msg import Outcome
from rclpy.action import ActionServer, CancelResponse
from rclpy.callback_groups import ReentrantCallbackGroup

from calibration import results
from calibration.background import Background
from calibration.conversions import to_outcome
from calibration.node import CalibrationNode, Declared, run
from calibration.worker import CancelledError, Worker

PARAMETERS = (
    Declared("cell", "", "The cell file taken where a request names none.", read_only=False),
    Declared("recording", "", "Recording of the current session.", read_only=False),
    Declared("out", "", "Directory for results; empty: beside the recording.", read_only=False),
    Declared("feedback_period", 0.2, "Time between two reports of progress, s.", low=0.01),
)
ERRORS = {
    "InputError": Outcome.INPUT_UNUSABLE,
    "IdentificationError": Outcome.NOT_IDENTIFIABLE,
}
COMMANDS = {
    Identify.Goal.STIFFNESS: "identify",
    Identify.Goal.BASE_FRAME: "identify",
    Identify.Goal.GEOMETRY: "identify",
    Identify.Goal.WRIST_CENTRE: "",
    Identify.Goal.POINTS: "identify",
    Identify.Goal.DIAGNOSIS: "diagnose",
}
SERVICES = {
    "identify_stiffness": (srv.IdentifyStiffness, Identify.Goal.STIFFNESS, results.fill_stiffness),
    "identify_base_frame": (srv.IdentifyBaseFrame, Identify.Goal.BASE_FRAME, results.fill_base_frame),
    "identify_geometry": (srv.IdentifyGeometry, Identify.Goal.GEOMETRY, results.fill_geometry),
    "identify_wrist_centre": (srv.IdentifyWristCentre, Identify.Goal.WRIST_CENTRE, results.fill_nothing),
    "identify_points": (srv.IdentifyPoints, Identify.Goal.POINTS, results.fill_points),
    "diagnose": (srv.Diagnose, Identify.Goal.DIAGNOSIS, results.fill_diagnosis),
}


@dataclasses.dataclass(frozen=True)
class Evaluated:
    """How an evaluation ended, and where its results are."""

    code: int
    text: str
    result_json: str = ""
    report: str = ""


@dataclasses.dataclass(frozen=True)
class Job:
    """One evaluation: the command line without `--no-report`, and the directory of its results."""

    arguments: tuple[str, ...]
    out: Path


class IdentificationNode(CalibrationNode):
    """Offers `~/identify_*`, `~/diagnose` and the action `~/identify`."""

    def __init__(self, **kwargs: Any) -> None:
        """Start the process that computes, and the services."""
        super().__init__("identification", PARAMETERS, **kwargs)
        self._worker = Worker()
        self._drawer: Worker | None = None  # started when it is needed
        self._drawing = threading.Lock()
        self._drawings: dict[Path, threading.Event] = {}
        self._busy = threading.Lock()
        self._stopping = threading.Event()
        group = ReentrantCallbackGroup()
        for name, (kind, what, fill) in SERVICES.items():
            self.create_service(kind, f"~/{name}", self._service(what, fill), callback_group=group)
        self._action = ActionServer(
            self, Identify, "~/identify", self._on_goal, callback_group=group,
            cancel_callback=lambda _goal: CancelResponse.ACCEPT,
        )  # fmt: skip
        self.diagnostics.report("evaluation", 0, "idle")

    def _service(self, what: int, fill: Callable[[Any, str], str]) -> Callable[[Any, Any], Any]:
        async def answer(request: Any, response: Any) -> Any:
            job = self._job(what, request)
            done = await self._evaluated(job, self._stopping.is_set)
            if isinstance(job, Job) and done.code == Outcome.OK:
                Background(self, lambda: self._draw(job, self._stopping.is_set))
            response.result_json, response.report_path = done.result_json, done.report
            lacking = fill(response, done.result_json) if done.code == Outcome.OK else ""
            code, text = (Outcome.NOT_IDENTIFIABLE, lacking) if lacking else (done.code, done.text)
            response.outcome = to_outcome(code, text)
            return response

        return answer

    async def _on_goal(self, goal: Any) -> Any:
        if goal.request.what not in COMMANDS:
            goal.abort()
            text = f"found what = {goal.request.what}, expected one of the constants"
            return Identify.Result(outcome=to_outcome(Outcome.INPUT_UNUSABLE, text))
        began, last = time.monotonic(), [0.0]

        def cancelled() -> bool:
            elapsed = time.monotonic() - began
            if elapsed - last[0] >= self.value("feedback_period"):
                last[0] = elapsed
                text = f"{COMMANDS[goal.request.what]}: {elapsed:.1f} s"
                goal.publish_feedback(Identify.Feedback(share_done=0.0, text=text))
            return bool(goal.is_cancel_requested) or self._stopping.is_set()

        job = self._job(goal.request.what, goal.request)
        done = await self._evaluated(job, cancelled)
        if isinstance(job, Job) and done.code == Outcome.OK:
            goal.publish_feedback(Identify.Feedback(share_done=0.5, text="drawing the report"))
            drawn = await Background(self, lambda: self._draw(job, cancelled))
            done = done if drawn.code == Outcome.OK else drawn
        if done.code == Outcome.OK:
            goal.publish_feedback(Identify.Feedback(share_done=1.0, text="done"))
            goal.succeed()
        elif done.code == Outcome.CANCELLED and goal.is_cancel_requested:
            goal.canceled()
        else:
            goal.abort()
        outcome = to_outcome(done.code, done.text)
        return Identify.Result(outcome=outcome, result_json=done.result_json, report_path=done.report)

    def _job(self, what: int, request: Any) -> Job | Evaluated:
        command = COMMANDS[what]
        if not command:
            return Evaluated(Outcome.NOT_AVAILABLE, "this version cannot identify the wrist centre")
        cell, recording = request.cell or self.value("cell"), request.recording or self.value("recording")
        for name, value in (("cell", cell), ("recording", recording)):
            if not value:
                text = f"{name}: found nothing, expected one in the request or as parameter of the node"
                return Evaluated(Outcome.INPUT_UNUSABLE, text)
        out = request.out or self.value("out") or str(Path(recording).absolute().parent / command)
        test = ("--test", request.test) if request.test else ()
        return Job((command, recording, "--cell", cell, "--out", out, *test), Path(out).absolute())

    async def _evaluated(self, job: Job | Evaluated, cancelled: Callable[[], bool]) -> Evaluated:
        """Compute the numbers of a job."""
        if isinstance(job, Evaluated):
            return job
        if not self._busy.acquire(blocking=False):
            return Evaluated(Outcome.BUSY, "another evaluation is under way")
        try:
            self.diagnostics.report("evaluation", 0, " ".join(job.arguments[:2]))
            return await Background(self, lambda: self._compute(job, cancelled))
        finally:
            self.diagnostics.report("evaluation", 0, "idle")
            self._busy.release()

    def _compute(self, job: Job, cancelled: Callable[[], bool]) -> Evaluated:
        """Compute, beside the executor; a report that is still being drawn for the same directory is given up."""
        earlier = self._drawings.get(job.out)
        if earlier is not None:
            earlier.set()
        done = self._run(self._worker, (*job.arguments, "--no-report"), cancelled)
        if done.code != Outcome.OK:
            return done
        text = (job.out / "result.json").read_text("utf-8")
        return dataclasses.replace(done, result_json=text, report=str(job.out / "report.html"))

    def _draw(self, job: Job, cancelled: Callable[[], bool]) -> Evaluated:
        """Draw the report, beside the executor, one at a time."""
        given_up = self._drawings[job.out] = threading.Event()
        with self._drawing:
            self._drawer = self._drawer or Worker()
            done = self._run(self._drawer, job.arguments, lambda: given_up.is_set() or cancelled())
            if self._drawings.get(job.out) is given_up:
                del self._drawings[job.out]
        if done.code not in (Outcome.OK, Outcome.CANCELLED):
            self.get_logger().error(f"no report: {done.text}")
            self.diagnostics.report("report", 2, done.text)
        return done

    def _run(self, worker: Worker, arguments: tuple[str, ...], cancelled: Callable[[], bool]) -> Evaluated:
        try:
            if arguments[0] not in worker.commands_when_ready(cancelled):
                return Evaluated(Outcome.NOT_AVAILABLE, f"this version has no command {arguments[0]}")
            done = worker.do(arguments, cancelled)
        except CancelledError:
            return Evaluated(Outcome.CANCELLED, "cancelled")
        except RuntimeError as error:
            return Evaluated(Outcome.INTERNAL, str(error))
        if done.trace:
            self.get_logger().error(done.trace)
        code = ERRORS.get(done.kind, Outcome.INTERNAL) if done.kind else Outcome.OK
        return Evaluated(code, done.text)

    def stop(self) -> None:
        """Cancel what is under way and end the processes."""
        self._stopping.set()
        end = time.monotonic() + 1.0
        while (self._busy.locked() or self._drawing.locked()) and time.monotonic() < end:
            time.sleep(0.01)
        self._worker.close()
        if self._drawer is not None:
            self._drawer.close()


def main(arguments: list[str] | None = None) -> int:
    """Run the node; return the exit code."""
    return run(IdentificationNode, arguments)


if __name__ == "__main__":
    sys.exit(main())
