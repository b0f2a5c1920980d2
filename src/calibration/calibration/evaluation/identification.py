"""Node `identification`: the evaluation of a recording as an action, and as a service for the joint stiffness.

The work is done by the same code as the command line's, in a process beside the callbacks: the same files, the same
numbers.  One evaluation at a time; whoever comes meanwhile is told so.  The service answers as soon as the numbers are
there; the report is drawn by a second process and follows within seconds.  The action draws it before it answers.
"""

from __future__ import annotations

import dataclasses
import json
import math
import sys
import threading
import time
import traceback
from collections.abc import Callable
from pathlib import Path
from typing import Any

from calibration_interfaces.action import Identify
from calibration_interfaces.msg import Outcome
from calibration_interfaces.srv import IdentifyStiffness
from rclpy.callback_groups import ReentrantCallbackGroup
from rclpy.qos import QoSProfile

from calibration.conversions import to_outcome
from calibration.evaluation.markers import to_markers
from calibration.evaluation.worker import CancelledError, Worker
from calibration.node import CalibrationNode, Declared, run
from calibration.rclpy_gaps import Background
from calibration.topics import MARKERS, RECORDING
from calibration_core.cell import load_cell
from calibration_core.errors import InputError
from calibration_core.report.results.scene import scene_of

ENLARGED = 200.0  # times, that deflections are drawn as long as they are

PARAMETERS = (
    Declared("cell", "", "The cell file taken where a request names none.", read_only=False),
    Declared("recording", "", "Taken where a request names none and no session was recorded.", read_only=False),
    Declared("out", "", "Directory for results; empty: beside the recording.", read_only=False),
)
MANY = QoSProfile(depth=1000)  # requests at once: those beyond it would never be answered
FEEDBACK_PERIOD = 0.2  # s between two reports of progress
PACE = 0.005  # s between two refusals: a client keeps ten answers, and would lose what comes faster than it takes them
ERRORS = {
    "InputError": Outcome.INPUT_UNUSABLE,
    "IdentificationError": Outcome.NOT_IDENTIFIABLE,
}


COMMANDS = {
    Identify.Goal.STIFFNESS: "identify",
    Identify.Goal.BASE_FRAME: "identify",
    Identify.Goal.GEOMETRY: "identify",
    Identify.Goal.WRIST_CENTRE: "identify",
    Identify.Goal.POINTS: "identify",
    Identify.Goal.DIAGNOSIS: "diagnose",
}
"""Command of the command line that does what can be asked for."""


@dataclasses.dataclass(frozen=True)
class Evaluated:
    """How an evaluation ended, and where its results are."""

    code: int
    text: str
    result_json: str = ""
    report: str = ""


@dataclasses.dataclass(frozen=True)
class Job:
    """One evaluation: the command line without `--no-report`, the directory of its results, and the cell file."""

    arguments: tuple[str, ...]
    out: Path
    cell: str


class IdentificationNode(CalibrationNode):
    """Offers the action `~/identify` and the service `~/identify_stiffness`."""

    def __init__(self, **kwargs: Any) -> None:
        """Make the node."""
        super().__init__("identification", PARAMETERS, **kwargs)

    def on_start(self) -> None:
        """Start the process that computes, show the cell, and answer from now on."""
        self._worker = Worker()
        self._drawer: Worker | None = None  # started when it is needed
        self._drawing = threading.Lock()
        self._drawings: dict[Path, threading.Event] = {}
        self._busy = threading.Lock()
        group, answer = ReentrantCallbackGroup(), self._on_stiffness
        self.create_service(IdentifyStiffness, "~/identify_stiffness", answer, qos_profile=MANY, callback_group=group)
        self._action = self.create_action_server(Identify, "~/identify", self._on_goal)
        self._session = ""  # bag of the last session that was recorded
        self._markers = self.create_publisher(MARKERS.message, MARKERS.relative, MARKERS.qos)
        self.diagnostics.report("evaluation", 0, "idle")
        self.create_subscription(RECORDING.message, RECORDING.relative, self._on_recording, RECORDING.qos)
        if self.value("cell"):
            self._show(self.value("cell"), "")

    def _on_recording(self, message: Any) -> None:
        if message.plan_sha256:
            self._session = str(message.directory)

    def _aside(self, what: str, work: Callable[[], object]) -> None:
        """Do what nobody waits for beside the callbacks; tell of a defect."""

        def guarded() -> None:
            try:
                work()
            except Exception as error:  # noqa: BLE001  # nobody awaits it
                self.get_logger().error(traceback.format_exc())
                self.diagnostics.report(what, 2, f"{type(error).__name__}: {error}")

        Background(self, guarded)

    def _show(self, cell_file: str, result_json: str) -> None:
        """Show the points of a cell, and the operating space of a result; say why if the cell cannot be read."""
        try:
            cell = load_cell(cell_file)
        except InputError as error:
            self.get_logger().warning(f"nothing to show: {error}")
            return
        scene = None
        if result_json:
            scene = scene_of(json.loads(result_json)["operating_space"], ENLARGED)
        self._markers.publish(to_markers(cell, scene))

    async def _on_stiffness(self, request: Any, response: Any) -> Any:
        what = Identify.Goal.STIFFNESS
        job = self._job(what, request)
        done = _judged(what, await self._evaluated(job, self.ending.is_set, report=False))
        if isinstance(job, Job) and done.result_json:
            self._aside("markers", lambda: self._show(job.cell, done.result_json))
            self._aside("report", lambda: self._draw(job, self.ending.is_set))
            rows = json.loads(done.result_json)["stiffness"]
            response.joints = [row["joint"] for row in rows]
            response.stiffness, response.std = (
                [math.nan if row[name] is None else float(row[name]) for row in rows] for name in ("value", "std")
            )
            response.identifiable = [bool(row["identifiable"]) for row in rows]
        response.result_json, response.report_path = done.result_json, done.report
        response.outcome = to_outcome(done.code, done.text)
        return response

    async def _on_goal(self, goal: Any) -> Any:
        what = goal.request.what
        if what not in COMMANDS:
            goal.abort()
            text = f"found what = {what}, expected one of the constants"
            return Identify.Result(outcome=to_outcome(Outcome.INPUT_UNUSABLE, text))
        began, reported = time.monotonic(), [-math.inf]

        def cancelled() -> bool:
            elapsed = time.monotonic() - began
            if elapsed - reported[0] >= FEEDBACK_PERIOD:
                reported[0] = elapsed
                now = self._worker.progress
                goal.publish_feedback(Identify.Feedback(share_done=now.share, text=f"{now.text}: {elapsed:.1f} s"))
            return bool(goal.is_cancel_requested) or self.ending.is_set()

        job = self._job(what, goal.request)
        done = _judged(what, await self._evaluated(job, cancelled, report=True))
        if isinstance(job, Job) and done.result_json:
            self._aside("markers", lambda: self._show(job.cell, done.result_json))
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
        cell = request.cell or self.value("cell")
        recording = request.recording or self._session or self.value("recording")
        for name, value in (("cell", cell), ("recording", recording)):
            if not value:
                text = f"{name}: found nothing, expected one in the request or as parameter of the node"
                return Evaluated(Outcome.INPUT_UNUSABLE, text)
        out = request.out or self.value("out") or str(Path(recording).absolute().parent / command)
        test = ("--test", request.test) if request.test else ()
        other = getattr(request, "simulation", "")
        if other and command != "diagnose":
            return Evaluated(Outcome.INPUT_UNUSABLE, "simulation: found one, expected none: only a diagnosis compares")
        simulation = ("--simulation", other) if other else ()
        arguments = (command, recording, "--cell", cell, "--out", out, *test, *simulation)
        return Job(arguments, Path(out).absolute(), cell)

    async def _evaluated(self, job: Job | Evaluated, cancelled: Callable[[], bool], *, report: bool) -> Evaluated:
        """Compute the numbers of a job, and draw its report if wanted."""
        if isinstance(job, Evaluated):
            return job
        if not self._busy.acquire(blocking=False):
            time.sleep(PACE)
            return Evaluated(Outcome.BUSY, "another evaluation is under way")
        try:
            self.diagnostics.report("evaluation", 0, " ".join(job.arguments[:2]))
            return await Background(self, lambda: self._compute(job, cancelled, report=report))
        finally:
            self.diagnostics.report("evaluation", 0, "idle")
            self._busy.release()

    def _compute(self, job: Job, cancelled: Callable[[], bool], *, report: bool) -> Evaluated:
        """Compute, beside the executor; a report that is still being drawn for the same directory is given up."""
        earlier = self._drawings.get(job.out)
        if earlier is not None:
            earlier.set()
        done = self._run(self._worker, job.arguments if report else (*job.arguments, "--no-report"), cancelled)
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

    def on_end(self) -> None:
        """Cancel what is under way, and end the processes."""
        end = time.monotonic() + 1.0
        while (self._busy.locked() or self._drawing.locked()) and time.monotonic() < end:
            time.sleep(0.01)
        self._worker.close()
        if self._drawer is not None:
            self._drawer.close()


def _judged(what: int, done: Evaluated) -> Evaluated:
    """Return how an evaluation ended, by whether its result holds what was asked for."""
    missing = _lacking(what, json.loads(done.result_json)) if done.code == Outcome.OK else ""
    return dataclasses.replace(done, code=Outcome.NOT_IDENTIFIABLE, text=missing) if missing else done


def _lacking(what: int, result: dict[str, Any]) -> str:
    """Return what the recording does not determine of what was asked for, as one sentence; empty: nothing.

    Frames and geometry are those by circle points and spheres (CWA 17384, 7.1 to 7.3), else those fitted to all
    readings.
    """
    standard = result.get("standard_geometry") or {}
    given = {row["group"] for row in result.get("parameters", [])}
    fitted = {row["group"] for row in result.get("parameters", []) if row["fitted"]}
    match what:
        case Identify.Goal.STIFFNESS if not any(row["identifiable"] for row in result["stiffness"]):
            return "the recording determines no joint stiffness"
        case Identify.Goal.BASE_FRAME if not (standard.get("base_frame") or "tracker" in given):
            return "the recording determines no tracker frame: absolute points of unloaded configurations are needed"
        case Identify.Goal.GEOMETRY if not (standard.get("joint_axes") or "geometry" in fitted):
            return "the recording determines no geometry: absolute points of many configurations are needed"
        case Identify.Goal.POINTS if "point" not in fitted:
            return "the recording determines no measurement point"
        case Identify.Goal.WRIST_CENTRE if not standard.get("wrist_centre"):
            reasons = standard.get("reasons", {})
            return str(reasons.get("wrist_centre", "the recording determines no wrist centre: it has loads"))
    return ""


def main(arguments: list[str] | None = None) -> int:
    """Run the node; return the exit code."""
    return run(IdentificationNode, arguments)


if __name__ == "__main__":
    sys.exit(main())
