"""Guard, robot, tracker and operator of a sequencer under test."""

from __future__ import annotations

import os
import tempfile
import time
from pathlib import Path
from typing import Any

import numpy as np
import pytest

pytest.importorskip("rclpy")
pytest.importorskip("calibration_interfaces")

from builtin_interfaces.msg import Time
from calibration_interfaces.action import Measure, RunPlan
from calibration_interfaces.msg import (
    ConditionOverride,
    Conditions,
    MeasurementStep,
    Outcome,
    Permission,
    ProcedureState,
    Reading,
    SessionEvent,
)
from calibration_interfaces.srv import LoadApplied, OverrideCondition, ResumeMotion
from goals import GoalClient
from rclpy.action import ActionServer
from rclpy.duration import Duration
from rclpy.parameter import Parameter
from rclpy.task import Future
from sensor_msgs.msg import JointState, Temperature
from stand_ins import Bent, unloaded
from std_msgs.msg import Header
from std_srvs.srv import Trigger

from calibration.conversions import Mean, to_average, to_outcome
from calibration.topics import EVENT, PERMISSION, PROCEDURE, READING, Quality, profile
from calibration_core.observations.average import Average

CELL = str(Path(__file__).resolve().parents[3] / "config" / "cells" / "demo.cell.yaml")
JOINTS = [f"joint_{i}" for i in range(1, 7)]
GOAL = [0.1, 0.2, 0.1, 0.0, 0.3, 0.0]
PULL = [0.0, 0.0, -500.0, 0.0, 0.0, 0.0]


def overrides(**values: Any) -> list[Parameter]:
    usual = {"cell": CELL, "motion.backend": "external", "force_torque": "", "settle_time": 0.1, "recorder": ""}
    usual |= {"load.memory": str(unloaded(Path(tempfile.mkdtemp(dir=os.environ["ROS_HOME"]))))}
    usual |= {"arrival.dwell": 0.1, "server_wait": 10.0, "permission_age": 1.0, "progress": False}
    return [Parameter(name, value=value) for name, value in (usual | values).items()]


class World:
    """Guard, robot and tracker of the sequencer under test."""

    def __init__(self, spinning: Any) -> None:
        self.node = spinning.plain("world")
        pulse = PERMISSION.qos
        pulse.deadline = Duration(nanoseconds=10**8)
        self.permissions = self.node.create_publisher(Permission, PERMISSION.relative, pulse)
        self.joints = self.node.create_publisher(JointState, "joint_states", 10)
        self.temperatures = self.node.create_publisher(Temperature, "cell/temperature", 10)
        self.q = np.zeros(6)
        self.permitted, self.hears, self.temperature = True, True, 21.5
        self.average = 0.0  # s that an average takes
        self.force = [0.0, 0.0, 0.0]  # N, what the operator was asked to pull with, and does
        self.tracker_fault = ""  # exchanged: the first two targets are taken for each other; knocked: one, by 5 mm
        self.excluded: dict[str, str] = {}  # points that an operator leaves out of the next reading
        self.asked: list[list[str]] = []  # points of every reading
        self._bent = Bent()
        self.node.create_subscription(ProcedureState, PROCEDURE.relative, self._on_target, PROCEDURE.qos)
        self.tracker = ActionServer(self.node, Measure, "tracker/measure", self._measure)
        self.timer = self.node.create_timer(0.02, self._live)

    def _live(self) -> None:
        self.say_permission()
        self.say_joints()

    def say_permission(self) -> None:
        text = "" if self.permitted else "not now"
        reasons = [] if self.permitted else [Permission.DRIVES_OFF]
        self.permissions.publish(
            Permission(permitted=self.permitted, text=text, hears_sequencer=self.hears, reasons=reasons)
        )

    def say_joints(self) -> None:
        self.joints.publish(JointState(header=now(), name=JOINTS, position=self.q.tolist()))
        self.temperatures.publish(Temperature(temperature=self.temperature))

    def _on_target(self, state: ProcedureState) -> None:
        force = state.target.force
        self.force = [force.x, force.y, force.z]

    async def _measure(self, goal: Any) -> Any:
        if self.average:
            await self._half_way(goal)
        at = time.time_ns()
        seen = self._bent.seen(self.q, self.force)
        if self.tracker_fault == "exchanged":
            seen["mp1"], seen["mp2"] = seen["mp2"], seen["mp1"]
        elif self.tracker_fault == "knocked":
            seen["mp1"] = seen["mp1"] + np.array([3e-3, 4e-3, 0.0])
        self.asked.append(list(goal.request.names))
        excluded, self.excluded = self.excluded, {}
        means = [
            Mean(name, "tracker", at - 10**8, at, Average(seen[name], 1e-10 * np.eye(3), 20, 20.0, 0))
            for name in goal.request.names
            if name not in excluded
        ]
        goal.succeed()
        return Measure.Result(
            outcome=to_outcome(Outcome.OK, ""),
            averages=[to_average(mean) for mean in means],
            excluded=list(excluded),
            exclusions=list(excluded.values()),
        )

    async def _half_way(self, goal: Any) -> None:
        """Say that half of the window is there, and take some time for the rest."""
        ready = Future(executor=self.node.executor)
        timer = self.node.create_timer(0.5 * self.average, lambda: ready.set_result(None))
        point, *left = goal.request.names
        goal.publish_feedback(Measure.Feedback(share_done=0.5, text="waiting for samples", point=point, left=left))
        await ready
        self.node.destroy_timer(timer)


def now() -> Header:
    at = time.time_ns()
    return Header(stamp=Time(sec=at // 10**9, nanosec=at % 10**9))


class Operator:
    """Calls the sequencer's services."""

    def __init__(self, spinning: Any) -> None:
        node = spinning.plain("operator")
        self.clients = {name: node.create_client(Trigger, f"sequencer/{name}") for name in ("pause", "resume", "stop")}
        self.load = node.create_client(LoadApplied, "sequencer/load_applied")
        self.motion = node.create_client(ResumeMotion, "sequencer/resume_motion")
        self.condition = node.create_client(OverrideCondition, "sequencer/override_condition")
        self.plan = GoalClient(node, RunPlan, "sequencer/run")
        self.readings: list[Any] = []
        self.steps: list[Any] = []
        self.states: list[Any] = []
        self.conditions: list[Any] = []
        self.events: list[Any] = []
        node.create_subscription(ProcedureState, PROCEDURE.relative, self.states.append, PROCEDURE.qos)
        node.create_subscription(Conditions, "calibration/conditions", self.conditions.append, profile(Quality.EVENTS))
        node.create_subscription(SessionEvent, EVENT.relative, self.events.append, EVENT.qos)
        node.create_subscription(Reading, READING.relative, self.readings.append, READING.qos)
        node.create_subscription(MeasurementStep, "calibration/step", self.steps.append, profile(Quality.EVENTS))

    def says(self, name: str) -> Any:
        assert self.clients[name].wait_for_service(10.0)
        return self.clients[name].call(Trigger.Request(), timeout_sec=10.0)

    def loaded(self, configuration: int, step: int, name: str = "A. Smith") -> Any:
        assert self.load.wait_for_service(10.0)
        request = LoadApplied.Request(operator_name=name, configuration=configuration, step=step)
        return self.load.call(request, timeout_sec=10.0).outcome

    def overrides(self, condition: str, name: str = "A. Smith", reason: str = "no cooling today") -> Any:
        assert self.condition.wait_for_service(10.0)
        override = ConditionOverride(condition=condition, operator_name=name, reason=reason)
        return self.condition.call(OverrideCondition.Request(override=override), timeout_sec=10.0).outcome

    def measure(self, plan: Path, session: Path, **goal: Any) -> Any:
        assert self.plan.wait_for_server(10.0)
        accepted = self.plan.send_goal_async(RunPlan.Goal(plan=str(plan), session=str(session), **goal))
        end = time.monotonic() + 10.0
        while not accepted.done():
            assert time.monotonic() < end
            time.sleep(0.01)
        return accepted.result()

    def rejected(self, until: Any, plan: Path, session: Path, **goal: Any) -> str:
        """Send a goal that is not accepted; return the words that are told of it."""
        before = len(self.refusals())
        assert not self.measure(plan, session, **goal).accepted
        until(lambda: len(self.refusals()) > before)
        return self.refusals()[-1]

    def refusals(self) -> list[str]:
        return [str(one.text) for one in self.events if one.kind == SessionEvent.REJECTED]

    def moves_on(self, name: str = "A. Smith") -> Any:
        assert self.motion.wait_for_service(10.0)
        return self.motion.call(ResumeMotion.Request(operator_name=name), timeout_sec=10.0).outcome


def ended(handle: Any, seconds: float = 20.0) -> Any:
    future = handle.get_result_async()
    end = time.monotonic() + seconds
    while not future.done():
        assert time.monotonic() < end, "no result"
        time.sleep(0.01)
    return future.result().result
