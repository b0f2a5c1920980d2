"""A goal can be stopped at every moment of its life: nothing moves afterwards, and every goal gets a result."""

from __future__ import annotations

import dataclasses
import threading
import time
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

pytest.importorskip("rclpy")
pytest.importorskip("calibration_interfaces")

from action_msgs.msg import GoalStatus
from calibration_interfaces.action import ApplyLoad, Measure, MoveTo
from calibration_interfaces.msg import Outcome
from calibration_interfaces.srv import ProveStop
from rclpy.action import ActionServer, CancelResponse, GoalResponse
from rclpy.callback_groups import ReentrantCallbackGroup
from rclpy.parameter import Parameter
from sequencer_world import CELL, JOINTS, PULL, Operator, World, overrides

from calibration.conversions import to_outcome
from calibration.rclpy_gaps import in_executor
from calibration.recorder import RecorderNode
from calibration.sequencer.goal import TABLE, Answer, Goal, GoalEndedError, Request, Stage
from calibration.sequencer.sequencer import SequencerNode
from calibration_core.files.yaml_file import yaml_text

ENDS = {Request.CANCEL, Request.STOP, Request.END}
PREPARING = {Stage.ACCEPTED, Stage.NODES, Stage.GUARD, Stage.SESSION, Stage.RECORDER}


# --- the table -------------------------------------------------------------------------------------------------------


def expected(stage: Stage, request: Request) -> Answer:
    """What is to become of a request, in rules."""
    if stage is Stage.NONE:
        return Answer.BEGIN if request is Request.GOAL else Answer.NOTHING
    if request is Request.GOAL:
        return Answer.BUSY
    if request in ENDS:  # at every stage
        return Answer.HALT if stage in (Stage.PROVING, Stage.MOVING, Stage.ENDING) else Answer.KEEP
    if stage is Stage.ENDING:
        return Answer.LATE
    return Answer.EARLY if request is Request.ACT and stage in PREPARING else Answer.QUEUE


@pytest.mark.parametrize("stage", [stage for stage in Stage if stage is not Stage.NONE], ids=lambda one: one.name)
def test_every_request_at_every_stage(stage: Stage) -> None:
    assert {request: TABLE[Stage.NONE][request] for request in Request} == {
        request: expected(Stage.NONE, request) for request in Request
    }
    for request in Request:
        halted: list[Stage] = []
        goal = Goal(None, lambda: halted.append(stage))  # noqa: B023
        if stage in PREPARING:
            goal.enter(stage)
        else:
            goal.begin(SimpleNamespace(stage=stage))
        answer = goal.take(request, "event")
        assert answer is expected(stage, request), request
        ends = request in ENDS
        assert (goal.asked is request) == ends
        assert bool(halted) == (answer is Answer.HALT)
        assert (answer.refusal == "") == (ends or answer is Answer.QUEUE)
        moved: list[bool] = []
        assert goal.move(lambda: moved.append(True)) is not ends  # noqa: B023
        assert bool(moved) is not ends, "what is asked is kept, and no motion begins any more"
        assert goal.take(Request.STOP).refusal == ""
        assert goal.take(Request.CANCEL).refusal == "", "asked again, it is answered again"
        assert goal.asked is (request if ends else Request.STOP)


@pytest.mark.parametrize("stage", sorted(PREPARING, key=lambda one: one.name), ids=lambda one: one.name)
def test_no_wait_is_longer_than_the_reaction_to_a_stop(stage: Stage) -> None:
    goal = Goal(None, lambda: None)
    goal.enter(stage)
    assert goal.until(lambda: True, 0.0)
    assert not goal.until(lambda: False, 0.0)
    threading.Timer(0.05, goal.take, [Request.STOP]).start()
    began = time.monotonic()
    with pytest.raises(GoalEndedError, match=f"stopped by the operator while {stage.value}; nothing was moved"):
        goal.until(lambda: False, 300.0)
    assert time.monotonic() - began < 5.0
    with pytest.raises(GoalEndedError):
        goal.until(lambda: True, 300.0)
    with pytest.raises(GoalEndedError):
        goal.enter(Stage.RECORDER)


# --- a whole cell of stand-ins, and the node itself -------------------------------------------------------------------

NEEDED = ("", "tracker", "joint_states", "guard", "driver", "load_device", "recorder")  # one is absent; "": none
COME = [*sorted(PREPARING, key=lambda one: one.name), Stage.PROVING, *[Stage.MOVING] * 3, Stage.LOADING, Stage.SETTLING]
WAYS = ("cancel", "stop", "cancel and stop", "stop and cancel", "eight cancels")
REACTION = 0.3  # s, after the answer the robot stands; a goal that was on its way is cancelled as it arrives
RESULT = 8.0  # s, in which the result comes, also on a busy machine


class Busy(World):
    """A cell with a driver, a load device and perhaps a recorder, each of which can be absent for a while."""

    def __init__(self, spinning: Any, out: Path | None = None) -> None:
        self.absent = ""
        self.path: tuple[Any, Any, float] | None = None  # times, s, joint angles, rad, and when it was begun
        self.begun: list[float] = []  # s of the steady clock, when the driver took a goal that moves
        super().__init__(spinning)
        group = ReentrantCallbackGroup()
        self.node.create_service(ProveStop, "guard/prove_stop", self._prove)
        self.servers: dict[str, Any] = {"tracker": self.tracker}
        self._make = {
            "tracker": lambda: ActionServer(self.node, Measure, "tracker/measure", self._measure),
            "driver": lambda: ActionServer(
                self.node, MoveTo, "driver/move_to", self._move, callback_group=group, goal_callback=self._take,
                cancel_callback=self._cancel,
            ),
            "load_device": lambda: ActionServer(
                self.node, ApplyLoad, "driver/apply_load", self._pull, callback_group=group,
                cancel_callback=lambda _: CancelResponse.ACCEPT,
            ),
        }  # fmt: skip
        for name in ("driver", "load_device"):
            self.servers[name] = self._make[name]()
        self._spinning, self._out = spinning, out
        if out is not None:
            self._record()

    def _record(self) -> None:
        given = [Parameter("cell", value=CELL), Parameter("out", value=str(self._out))]
        self.recorder = self._spinning.add(RecorderNode(context=self._spinning.context, parameter_overrides=given))

    def leave(self, name: str) -> None:
        """Let a node be absent."""
        self.absent = name
        if name in self._make:
            self._do(self.servers[name].destroy)
        elif name == "recorder":
            self.recorder.stop()
            self._spinning.nodes.remove(self.recorder)
            self._spinning.executor.remove_node(self.recorder)
            self._do(self.recorder.destroy_node)

    def come_back(self) -> None:
        name, self.absent = self.absent, ""
        if name in self._make:
            self._do(lambda: self.servers.update({name: self._make[name]()}))
        elif name == "recorder":
            self._record()

    def _do(self, work: Any) -> None:
        done = threading.Event()
        in_executor(self.node, lambda: (work(), done.set()))
        assert done.wait(10.0)

    def _live(self) -> None:
        if self.path is not None:
            times, rows, begun = self.path
            at = min(time.monotonic() - begun, times[-1])
            self.q = np.array([np.interp(at, times, column) for column in rows.T])
        if self.absent != "guard":
            self.say_permission()
        if self.absent != "joint_states":
            self.say_joints()

    def _take(self, goal: Any) -> GoalResponse:
        if np.ptp([list(point.positions) for point in goal.trajectory.points], axis=0).any():
            self.begun.append(time.monotonic())
        return GoalResponse.ACCEPT

    def _cancel(self, _goal: Any) -> CancelResponse:
        self.path = None
        return CancelResponse.ACCEPT

    async def _move(self, goal: Any) -> Any:
        points = goal.request.trajectory.points
        times = [p.time_from_start.sec + 1e-9 * p.time_from_start.nanosec for p in points]
        rows = np.array([list(p.positions) for p in points])
        self.path = (times, rows, time.monotonic()) if not goal.is_cancel_requested else None
        end = time.monotonic() + times[-1]
        while not goal.is_cancel_requested and self.path is not None and time.monotonic() < end:
            await Soon()
        if goal.is_cancel_requested:
            self.path = None
            goal.canceled()
        elif self.path is None:
            goal.abort()
        else:
            goal.succeed()
        return MoveTo.Result(outcome=to_outcome(Outcome.OK, ""))

    def _prove(self, _request: Any, response: Any) -> Any:
        self.path = None
        response.outcome = to_outcome(Outcome.OK, "seen")
        return response

    async def _pull(self, goal: Any) -> Any:
        end = time.monotonic() + 0.15
        while time.monotonic() < end and not goal.is_cancel_requested:
            await Soon()
        _ = goal.canceled() if goal.is_cancel_requested else goal.succeed()
        return ApplyLoad.Result(outcome=to_outcome(Outcome.OK, ""))


class Soon:
    def __await__(self) -> Any:
        yield


@dataclasses.dataclass(frozen=True)
class Draw:
    """One goal that is ended.

    Attributes:
        absent: Who is absent from before the goal on, and comes back after the request.
        way: How it is ended.
        stage: To which the goal has come before.
        after: s, from there to the request.
        back: s, from the request to the return of who was absent.
    """

    absent: str
    way: str
    stage: Stage
    after: float
    back: float


class Ending:
    """Goals that are ended at random moments, one after another in one cell."""

    def __init__(self, spinning: Any, directory: Path, seed: int) -> None:
        self.directory, self.rng = directory, np.random.default_rng(seed)
        self.plan = directory / "plan.yaml"
        rows = [{"number": i, "q": [0.03 * i] * 6, "steps": [[0.0] * 6, PULL]} for i in (1, 2)]
        self.plan.write_text(yaml_text({"schema": 1, "joints": JOINTS, "configurations": rows}))
        self.cell = Busy(spinning, directory / "bag")
        self.operator = Operator(spinning)
        given = {"motion.backend": "simulated", "load.by": "device", "recorder": "recorder", "server_wait": 30.0}
        self.node = spinning.add(SequencerNode(context=spinning.context, parameter_overrides=overrides(**given)))
        self.node.get_logger().info("begin")  # the first line asks each of pytest's modules for its file: seconds
        self.seen: dict[str, int] = {}  # how often a goal was ended at each stage
        self.slowest = 0.0  # s, from the answer to the result

    def draw(self) -> Draw:
        absent = str(self.rng.choice(NEEDED)) if self.rng.random() < 0.4 else ""
        stage = Stage.ACCEPTED if absent else COME[int(self.rng.integers(len(COME)))]
        after, back = self.rng.uniform(0.0, self.rng.choice([0.01, 0.1, 0.6])), self.rng.uniform(0.0, 0.3)
        return Draw(absent, str(self.rng.choice(WAYS)), stage, float(after), float(back))

    def come(self, stage: Stage) -> bool:
        """Whether the goal has come to a stage; what comes before the run passes quickly."""
        goal = self.node.runs.goal
        past = stage is Stage.ACCEPTED or (goal is not None and stage in PREPARING and goal.stage not in PREPARING)
        return goal is not None and (goal.stage is stage or past)

    def accepted(self, number: int) -> Any:
        end = time.monotonic() + 30.0
        while True:  # one that follows an end at once may be told that the run is ending
            handle = self.operator.measure(self.plan, self.directory / f"session_{number}")
            if handle.accepted:
                return handle
            assert time.monotonic() < end, self.operator.refusals()[-1]

    def end(self, number: int, draw: Draw) -> None:
        """Have a plan measured, end it, and see that nothing moves any more and that a result comes."""
        cell = self.cell
        cell.q, cell.path = np.zeros(6), None
        if draw.absent:
            cell.leave(draw.absent)
        handle = self.accepted(number)
        result = handle.get_result_async()
        end = time.monotonic() + 30.0
        while not self.come(draw.stage) and not result.done():
            assert time.monotonic() < end, f"{number}: it does not come to {draw.stage.name}"
            time.sleep(0.002)
        time.sleep(draw.after)
        goal = self.node.runs.goal
        stage = "over" if goal is None else goal.stage.name
        self.seen[stage] = self.seen.get(stage, 0) + 1
        self.ask(handle, draw.way, over=stage == "over")
        answered, again = time.monotonic(), None
        if self.rng.random() < 0.3:
            again = self.operator.measure(self.plan, self.directory / f"again_{number}")
        time.sleep(draw.back)
        if draw.absent:
            cell.come_back()
        if again is not None and again.accepted:
            self.ask(again, "stop", over=False)
            answered = time.monotonic()
            self.wait(again.get_result_async(), "the goal that followed at once")
        answer = self.wait(result, f"{number}: {draw}, {stage}")
        self.slowest = max(self.slowest, time.monotonic() - answered)
        wanted = {"stop": GoalStatus.STATUS_ABORTED}.get(draw.way, GoalStatus.STATUS_CANCELED)
        if stage not in ("over", "ENDING") and draw.way != "stop and cancel":  # a stop may end it before the cancel
            assert answer.status == wanted, (draw, stage, answer)
        if stage not in ("over", "ENDING"):
            assert answer.result.outcome.code in (Outcome.CANCELLED, Outcome.STOPPED), (draw, stage, answer)
        time.sleep(max(answered + REACTION - time.monotonic(), 0.0))
        q = cell.q
        time.sleep(0.3)
        late = [begun - answered for begun in cell.begun if begun > answered + REACTION]
        assert not late, f"{number}: {draw}, {stage}: a motion begins {late[0]:.2f} s after the answer"
        assert np.array_equal(q, cell.q), f"{number}: {draw}, {stage}: the robot moves"

    def wait(self, future: Any, what: str) -> Any:
        end = time.monotonic() + RESULT
        while not future.done():
            assert time.monotonic() < end, f"no result: {what}"
            time.sleep(0.005)
        return future.result()

    def ask(self, handle: Any, way: str, *, over: bool) -> None:
        """End a goal; every request is answered."""
        cancels = {"cancel": 1, "stop": 0, "eight cancels": 8}.get(way, 1)
        if way.startswith("stop"):
            assert self.operator.says("stop").success or over
        asked = []
        for _ in range(cancels):
            asked.append(handle.cancel_goal_async())
            time.sleep(float(self.rng.uniform(0.0, 0.01)))
        if way == "cancel and stop":
            self.operator.says("stop")  # the run may have ended by then
        for one in asked:
            self.wait(one, f"an answer to {way}")
        first = asked[0].result() if asked else None
        assert first is None or first.goals_canceling or over or way == "stop and cancel"


def test_goals_that_are_ended_at_random_moments(spinning: Any, tmp_path: Path) -> None:
    end_goals(spinning, tmp_path, seed=1, times=16)


@pytest.mark.slow
def test_five_hundred_goals_that_are_ended_at_random_moments(spinning: Any, tmp_path: Path) -> None:
    end_goals(spinning, tmp_path, seed=2, times=500)


def end_goals(spinning: Any, directory: Path, seed: int, times: int) -> None:
    ending = Ending(spinning, directory, seed)
    for number in range(times):
        ending.end(number, ending.draw())
    print(f"\n{times} goals ended, 0 motions begun afterwards; result after at most {ending.slowest:.2f} s")
    print(f"ended at {ending.seen}; motions begun before: {len(ending.cell.begun)}")
    assert ending.cell.begun, "none of them had come to move"
