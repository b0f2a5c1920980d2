"""A shipped tree of processes at real time, as an operator and a bystander see it: what moves, stops and is well."""

from __future__ import annotations

import dataclasses
import time
from pathlib import Path
from typing import Any

import numpy as np
import yaml
from stand_ins import unloaded

from calibration.process_tree import REAL_CELL, SIMULATED_CELL, Tree
from calibration.topics import STATE
from calibration_core.files.yaml_file import yaml_text

QUIET = 0.5  # s, watched after everything that an operator or a crash may do: nothing moves by itself
STOPS = ("cancel", "hold")  # what the robot hears that is to stop
STAND = 1e-5  # rad, joints that stand do not differ by more
LONG = 90.0  # s, anything may take on a busy machine


@dataclasses.dataclass(frozen=True)
class BackEnd:
    """One way to move the robot, in its shipped tree.

    Attributes:
        name: Of the back end.
        tree: The tree; the simulated cell stands for the drivers where the tree has none.
        said: Arguments of the tree.
    """

    name: str
    tree: Tree = SIMULATED_CELL
    said: tuple[tuple[str, str], ...] = ()


SIMULATED = BackEnd("simulated")
REAL = (("adapter", "native"),)
TOPIC = BackEnd(
    "joint_trajectory_topic", REAL_CELL,
    (*REAL, ("backend", "joint_trajectory_topic"), ("interface", "driver/joint_trajectory")),
)  # fmt: skip
ACTION = BackEnd("follow_joint_trajectory", REAL_CELL, (*REAL, ("backend", "follow_joint_trajectory")))


def long_ways(plan: Path) -> Path:
    """Write the postures of a plan, far from each other, unloaded: motions are long, and readings short."""
    content = yaml.safe_load(plan.read_text(encoding="utf-8"))
    for row in content["configurations"]:
        row["steps"], row["spare"] = [[0.0] * 6], False
    content |= {"startup_cycle": [], "reference": None, "expected": None}
    path = plan.parent / "long_ways.yaml"
    path.write_text(yaml_text(content), encoding="utf-8")
    return path


def rows(path: Path) -> list[tuple[int, str]]:
    """Times of the monotonic clock, ns, and words of a log or a trace; none where there is no file yet."""
    lines = path.read_text(encoding="utf-8").splitlines() if path.exists() else []
    return [(int(at), what) for at, comma, what in (line.partition(",") for line in lines) if comma]


class LiveTree:
    """One tree, in which a plan is measured.

    Attributes:
        state: The last `calibration/state`.
        q: Joint angles now, rad.
        readings: What was announced as confirmed.
        quiet: How often it was watched that nothing moves by itself.
        moved: What moved by itself.
    """

    def __init__(self, suite: Any, plan: Path, back_end: BackEnd) -> None:
        from calibration_interfaces.msg import Reading
        from sensor_msgs.msg import JointState

        self.suite, self.plan, self.rng = suite, plan, np.random.default_rng(12)
        self.quiet, self.moved = 0, list[str]()
        self.readings: list[Any] = []
        self.state: Any = None
        self.q: np.ndarray = np.empty(0)
        self.sessions = 0
        client = suite.client
        client.create_subscription(STATE.message, STATE.relative, self._on_state, STATE.qos)
        client.create_subscription(Reading, "calibration/reading", self.readings.append, 1000)
        client.create_subscription(JointState, "joint_states", self._on_joints, 1)
        self.by_hand = back_end.tree is not SIMULATED_CELL  # no load device
        self.log = suite.directory / "cell.csv"
        self.log.touch()
        if self.by_hand:
            unloaded(suite.directory / "ros")
            suite.start("simulated_cell", event_log=self.log)
        self.traces = {name: suite.directory / f"{name}.trace" for name in ("guard", "sequencer")}
        more = {name: {"trace": path} for name, path in self.traces.items()}
        suite.start_tree(back_end.tree, {"simulated_cell": {"event_log": self.log}} | more, **dict(back_end.said))
        self.await_active()
        self.begin()

    def _on_state(self, message: Any) -> None:
        self.state = message

    def _on_joints(self, message: Any) -> None:
        self.q = np.array(message.position)

    # --- what is seen ------------------------------------------------------------------------------------------------

    def events(self, begin: int = 0, *whats: str) -> list[tuple[int, str]]:
        """What the robot heard and did since a moment, ns."""
        return [(at, what) for at, what in rows(self.log) if at >= begin and (not whats or what in whats)]

    def commanded(self, begin: int) -> list[tuple[int, str]]:
        """Who commanded a stop since a moment, and when, ns; in the order of time."""
        return sorted(
            (at, f"{name}: {what}") for name, path in self.traces.items() for at, what in rows(path) if at >= begin
        )

    def wait(self, condition: Any, what: str, seconds: float = LONG) -> None:
        end = time.monotonic() + seconds
        while not condition():
            assert time.monotonic() < end, f"{what}\n{self.words()}"
            time.sleep(0.005)

    def words(self) -> str:
        said = "" if self.state is None else f"{self.state.text}; {self.state.waiting}; {self.state.not_permitted}"
        return "\n".join([said, *(f"--- {name}\n{self.suite.log(name)[-1500:]}" for name in ("sequencer", "guard"))])

    def await_active(self, name: str = "", process: int = 0) -> None:
        """Wait until the manager hears every node, `name` as the process of that number."""
        began = time.time()

        def active() -> bool:
            if self.state is None or self.state.header.stamp.sec == 0:
                return False
            fine = all(one.level < one.ABSENT for one in self.state.nodes)
            there = {one.name: one.process for one in self.state.nodes}
            heard = all(one.stamp.sec + 1e-9 * one.stamp.nanosec > began for one in self.state.nodes)
            return fine and heard and (not name or there[name] == process)

        self.wait(active, f"not all nodes are heard: {name}")

    def stands(self) -> None:
        """See that the joints stand."""
        time.sleep(0.15)
        before = self.q
        time.sleep(0.3)
        assert np.abs(self.q - before).max() < STAND, f"the joints move: {np.abs(self.q - before).max()} rad in 0.3 s"

    def see_quiet(self, when: str) -> None:
        """See that nothing moves by itself."""
        begin, before = time.monotonic_ns(), self.q
        time.sleep(QUIET)
        self.quiet += 1
        if self.events(begin, "motion") or np.abs(self.q - before).max() > STAND:
            self.moved.append(when)

    # --- what is done ------------------------------------------------------------------------------------------------

    def begin(self, *, resume: bool = False) -> None:
        """Have the plan measured, in a new session unless one is to be resumed."""
        self.sessions += not resume
        self.run = self.suite.run(self.plan, resume=resume, session=self.suite.directory / f"session_{self.sessions}")
        if resume and self.by_hand:
            self.release()

    def release(self) -> None:
        """Confirm, where that is asked, that no load of the ended run is on."""
        from calibration_interfaces.msg import Outcome
        from calibration_interfaces.srv import LoadApplied

        def released() -> bool:
            procedure = self.state.procedure
            if "another run" not in procedure.waiting:
                return procedure.state not in (procedure.NO_RUN, procedure.PREPARING, procedure.FINISHED)
            place = {"configuration": procedure.configuration, "step": procedure.step}
            answer = self.suite.call(LoadApplied, "sequencer/load_applied", operator_name="test", **place)
            return bool(answer.outcome.code == Outcome.OK)

        self.wait(released, "no release is asked for")

    def reset(self) -> None:
        """Reset the guard by name, until it takes it: on a busy machine something may look stale at that moment."""
        from calibration_interfaces.srv import ResetGuard

        end = time.monotonic() + LONG
        while self.suite.call(ResetGuard, "guard/reset", operator_name="test").permission.latched:
            assert time.monotonic() < end, self.words()
            time.sleep(0.1)

    def allow(self) -> None:
        """Reset the guard, see that this moves nothing, and resume motion: by name, as an operator would."""
        from calibration_interfaces.msg import Outcome
        from calibration_interfaces.srv import ResumeMotion

        self.reset()
        self.see_quiet("after a reset")
        end = time.monotonic() + LONG
        while not self.run.over:
            answer = self.suite.call(ResumeMotion, "sequencer/resume_motion", operator_name="test")
            if answer.outcome.code == Outcome.OK:
                return
            assert time.monotonic() < end, f"{answer.outcome.text}\n{self.words()}"
            time.sleep(0.1)
            self.reset()

    def move(self) -> None:
        """Wait until the robot has moved for a moment, and still does."""
        last = time.monotonic() + 3 * LONG
        while True:
            end = time.monotonic() + 15.0
            while time.monotonic() < end and not self.moving():
                if self.run.over:
                    print(f"the run is over: {self.run.result(1.0).outcome.text}", flush=True)
                    self.begin()
                time.sleep(0.01)
            if not self.moving():  # on a busy machine something may have looked stale
                assert time.monotonic() < last, self.words()
                self.allow()
                continue
            time.sleep(self.rng.uniform(0.3, 0.9))
            if self.moving():
                return

    def moving(self) -> bool:
        last = self.events()
        return bool(last) and last[-1][1] == "motion"
