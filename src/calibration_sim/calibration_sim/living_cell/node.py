"""`simulated_cell`: the living cell as a ROS node, with the interfaces that drivers in a real cell have.

Publishes joint states, tracker points (a tracker with one beam: see `one_beam`), wrench, temperature, robot state, and
`/clock` at a chosen multiple of real time; follows trajectories (action `driver/move_to`, topic
`driver/joint_trajectory`); puts loads on (action `driver/apply_load`); misbehaves on request (parameter `fault`).
This module and `messages` alone know ROS.
"""

from __future__ import annotations

import os
import signal
import threading
import time
from collections.abc import Generator
from pathlib import Path as FilePath
from typing import Any

import numpy as np
from builtin_interfaces.msg import Time
from calibration_interfaces.action import ApplyLoad, MoveTo
from calibration_interfaces.msg import Outcome, RobotState
from geometry_msgs.msg import Point, PointStamped, WrenchStamped
from rcl_interfaces.msg import ParameterDescriptor, SetParametersResult
from rclpy.action import ActionServer, CancelResponse
from rclpy.callback_groups import ReentrantCallbackGroup
from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy
from rclpy.serialization import serialize_message
from rosgraph_msgs.msg import Clock
from sensor_msgs.msg import JointState, Temperature
from std_msgs.msg import Header, String
from trajectory_msgs.msg import JointTrajectory

from calibration_core.cell import load_cell
from calibration_core.errors import InputError, quoted
from calibration_core.recording.messages.kinds import StreamKind
from calibration_core.recording.messages.layout import Mould
from calibration_core.timeseries import NANOSECONDS, Float1D, Float2D
from calibration_sim.cell.streams import START, Rates
from calibration_sim.cell.truth import SPREADS, Truth, draw_truth, nominal_truth
from calibration_sim.living_cell.faults import Fault, Faults, Kind
from calibration_sim.living_cell.live import LiveCell, Refused
from calibration_sim.living_cell.live_sensors import LiveSensors
from calibration_sim.living_cell.messages import PARAMETERS, path_of, reported, wrench_message, wrench_values
from calibration_sim.living_cell.motion_log import MotionLog, TruthLog
from calibration_sim.living_cell.one_beam import BeamServer, OneBeam
from calibration_sim.living_cell.schedule import Schedule
from calibration_sim.mechanics.chain import read_chain
from calibration_sim.mechanics.mjcf import Spring

FEEDBACK = 0.1  # s of wall time between two feedbacks
STREAM = QoSProfile(depth=500, reliability=ReliabilityPolicy.RELIABLE)
STATE = QoSProfile(depth=1, reliability=ReliabilityPolicy.RELIABLE, durability=DurabilityPolicy.TRANSIENT_LOCAL)


class SimulatedCell(Node):
    """The node; `live` is stepped by whoever runs it."""

    def __init__(self, **kwargs: Any) -> None:
        """Set the cell up.

        Raises:
            InputError: A parameter or the cell file cannot be used.
        """
        super().__init__("simulated_cell", **kwargs)
        for name in self._parameter_overrides:
            if name not in PARAMETERS and not name.startswith(("use_sim_time", "qos_overrides.", "start_type_desc")):
                raise InputError("simulated_cell", name, "an unknown parameter", f"one of {', '.join(PARAMETERS)}")
        for name, (default, text) in PARAMETERS.items():
            self.declare_parameter(name, default, ParameterDescriptor(description=text, read_only=name != "fault"))
        if not self._value("cell"):
            own = self.get_fully_qualified_name()
            raise InputError(own, "cell", "nothing", "the cell file: --ros-args -p cell:=FILE")
        self.cell = load_cell(self._value("cell"))
        self.speed = float(self._value("speed"))
        self._with_clock = bool(self._value("clock"))
        if self.speed <= 0.0 or (self.speed != 1.0 and not self._with_clock):
            raise InputError("simulated_cell", "speed", f"{self.speed:g}", "above 0, and other than 1 only with clock")
        seed = int(self._value("seed"))
        truth = self._truth(seed)
        self.live = LiveCell(self.cell, truth, self._home(), self._concealed())
        rate = {name: float(self._value(f"rates.{name}")) for name in ("joints", "tracker", "wrench", "temperature")}
        self._sensors = LiveSensors(self.cell, truth, seed, rates=Rates(**rate), window=float(self._value("window")))
        self.schedule = Schedule(rate | {"state": float(self._value("rates.state"))})
        self.faults = Faults()
        self.lock = threading.RLock()
        self.ticks = 0
        self._owner: object = None
        self._epoch = START if self._with_clock else time.time_ns()
        self._clock_sent = 0.0
        self._woken = 0.0  # s of the monotonic clock
        self._frozen: list[float] = []
        self._last_state: dict[str, Any] = {}
        self._seen: dict[str, Float1D] = {}
        self._held: Float2D | None = None  # where the points were when the tracker began to hold them
        self._log = self._open_log("event_log")
        motion_log = self._value("motion_log")
        self._motion_log = MotionLog(FilePath(motion_log)) if motion_log else None
        truth_log = self._value("truth_log")
        self._truth_log = TruthLog(FilePath(truth_log)) if truth_log else None
        self._beam_server: BeamServer | None = None
        self._beam = self._served_beam()
        self._interfaces()

    def _served_beam(self) -> OneBeam | None:
        """Return the tracker's one beam, which is asked over TCP; None: it sees all points at once."""
        kind = self._value("tracker")
        if kind not in ("stream", "line"):
            raise InputError("simulated_cell", "tracker", quoted(kind), "one of stream, line")
        if kind == "stream":
            return None
        beam = OneBeam(tuple(self.cell.points), self.live.points, self.lock)
        self._beam_server = BeamServer(self._value("tracker_address"), beam)
        return beam

    def _interfaces(self) -> None:
        topics, node, names = self.cell.topics, self, self.cell.robot.joints
        joints = JointState(name=names, position=[0.0] * len(names))
        wrench = WrenchStamped(header=Header(frame_id="force_torque"))
        self._joint_mould = Mould(StreamKind.JOINTS, serialize_message(joints))
        self._wrench_mould = Mould(StreamKind.WRENCH, serialize_message(wrench))
        self._joints = node.create_publisher(JointState, topics.joint_states.lstrip("/"), STREAM)
        self._points = {p: node.create_publisher(PointStamped, f"input/{p}", STREAM) for p in self.cell.points}
        self._wrench = node.create_publisher(WrenchStamped, "input/wrench", STREAM)
        self._temperature = node.create_publisher(Temperature, topics.temperature.lstrip("/"), STREAM)
        self._state = node.create_publisher(RobotState, "driver/robot_state", STATE)
        self._clock_out = node.create_publisher(Clock, "/clock", QoSProfile(depth=10)) if self._with_clock else None
        self._description = node.create_publisher(String, topics.robot_description.lstrip("/"), STATE)
        urdf = self.cell.urdf_path
        if urdf is not None:
            self._description.publish(String(data=urdf.read_text(encoding="utf-8")))
        group = ReentrantCallbackGroup()
        common: dict[str, Any] = {"callback_group": group, "cancel_callback": self._cancel}
        self._move = ActionServer(node, MoveTo, "driver/move_to", self._on_move, **common)
        self._apply = ActionServer(node, ApplyLoad, "driver/apply_load", self._on_load, **common)
        node.create_subscription(JointTrajectory, "driver/joint_trajectory", self._on_trajectory, 10)
        node.add_on_set_parameters_callback(self._on_parameters)

    def _value(self, name: str) -> Any:
        return self.get_parameter(name).value

    def _truth(self, seed: int) -> Truth:
        kind = self._value("truth")
        if kind == "nominal":
            return nominal_truth(self.cell)
        if kind not in SPREADS:
            raise InputError("simulated_cell", "truth", quoted(kind), f"one of nominal, {', '.join(SPREADS)}")
        return draw_truth(self.cell, seed, spread=SPREADS[kind])

    def _concealed(self) -> tuple[Spring, ...]:
        joint, joints = self._value("concealed_joint"), self.cell.robot.joints
        if not joint:
            return ()
        link = next((link for link in read_chain(self.cell).links if link.joint == joint), None)
        if link is None:
            raise InputError("simulated_cell", "concealed_joint", quoted(joint), f"one of {', '.join(joints)}")
        across = np.linalg.svd(link.axis[None])[2][1]
        return (Spring(link.name, across, np.zeros(3), 1.0 / float(self._value("concealed_compliance"))),)

    def _home(self) -> Float1D:
        limits = read_chain(self.cell).limits
        given = np.array(self._value("home"), dtype=np.float64)
        home = np.clip(np.zeros(len(limits)), limits[:, 0], limits[:, 1]) if len(given) == 1 else given
        if home.shape != (len(limits),) or np.any((home < limits[:, 0]) | (home > limits[:, 1])):
            raise InputError("simulated_cell", "home", quoted(given.tolist()), f"{len(limits)} angles within limits")
        return home

    def _open_log(self, name: str) -> Any:
        path = self._value(name)
        return FilePath(path).open("w", encoding="utf-8", buffering=1) if path else None

    def log(self, event: str) -> None:
        """Write an event with the time of the monotonic clock, which all processes share."""
        if self._log is not None:
            self._log.write(f"{time.monotonic_ns()},{event}\n")

    # --- time and streams --------------------------------------------------------------------------------------------

    def step(self, until: float) -> None:
        """Let the cell live until `until` (s of its time), and send what is due then."""
        with self.lock:
            live, on = self.live, self.faults.on
            live.haste = 0.0 if on(Kind.EMERGENCY_STOP) else self.faults.value(Kind.OVER_SPEED, 1.0)
            live.blocked_after = 0.5 if on(Kind.BLOCKED) else 1.0
            before = live.moving, live.loading
            moved = live.advance(until)
            if self._motion_log is not None:
                self._motion_log.add(*moved)
            if before[0] and not live.moving:
                self.log("rest")
            due = self.schedule.due(until)
            self._send_clock(until)
            if self._beam is not None:
                self._beam.step(until)
            if "joints" in due and not on(Kind.JOINTS_STALE):
                self._send_joints()
            if "tracker" in due:
                self._send_points()
            if "wrench" in due and not on(Kind.WRENCH_SILENT):
                self._send_wrench()
            if "temperature" in due:
                self._temperature.publish(Temperature(header=self._header(), temperature=self._sensors.temperature()))
            self._send_state(always="state" in due)
            self.ticks += 1
        self._wake(changed=before != (live.moving, live.loading))

    def _wake(self, *, changed: bool) -> None:
        """Let goals that wait look again: at once when something has ended, now and then for their feedback."""
        now = time.monotonic()
        if self.executor is not None and (changed or now - self._woken > FEEDBACK):
            self._woken = now
            self.executor.wake()

    def stamp(self, ahead: float = 0.0) -> Time:
        """Return the time that the cell's messages carry, by a clock that is so many s ahead."""
        now = self._stamp_ns(ahead)
        return Time(sec=now // NANOSECONDS, nanosec=now % NANOSECONDS)

    def _stamp_ns(self, ahead: float = 0.0) -> int:
        return self._epoch + round((self.live.time + self.faults.value(Kind.CLOCK_JUMP, 0.0) + ahead) * NANOSECONDS)

    def _header(self, frame: str = "") -> Header:
        return Header(stamp=self.stamp(), frame_id=frame)

    def _send_clock(self, now: float) -> None:
        period = self.speed / float(self._value("clock_rate"))
        if self._clock_out is not None and (now - self._clock_sent >= 0.999 * period or not self.ticks):
            self._clock_sent = now
            self._clock_out.publish(Clock(clock=self.stamp()))

    def _send_joints(self) -> None:
        if not self.faults.on(Kind.JOINTS_FROZEN):
            self._frozen = self.live.q.tolist()
        position = [float("nan")] * len(self._frozen) if self.faults.on(Kind.JOINTS_NOT_FINITE) else self._frozen
        self._joints.publish(self._joint_mould.cast(self._stamp_ns(), position))

    def _send_points(self) -> None:
        places, on = self._shown_places(), self.faults.on
        offset, rate = float(self._value("tracker_clock_offset")), float(self._value("tracker_clock_rate"))
        header = Header(stamp=self.stamp(offset + (rate - 1.0) * self.live.time), frame_id="tracker")
        if self._truth_log is not None:
            self._truth_log.add(self.live)
        for index, (name, publisher) in enumerate(self._points.items()):
            if on(Kind.TRACKER_SILENT, name) or (self._beam is not None and self._beam.target != index):
                continue
            shown = self._sensors.point(index, places[index])
            if on(Kind.TRACKER_JUMP, name):
                shown = shown + self.faults.value(Kind.TRACKER_JUMP, 0.0)
            if on(Kind.TRACKER_NOT_FINITE, name):
                shown = np.full(3, np.nan)
            if self._beam is not None:
                self._beam.read(None if on(Kind.BEAM_BROKEN, name) else shown)
                continue
            if on(Kind.BEAM_BROKEN, name):
                shown = self._seen.get(name, shown)
            self._seen[name] = shown
            x, y, z = shown.tolist()
            publisher.publish(PointStamped(header=header, point=Point(x=x, y=y, z=z)))

    def _shown_places(self) -> Float2D:
        """Return what the tracker takes for the places of the points, (p, 3) m, without its noise."""
        places, on = self.live.points(), self.faults.on
        self._held = (places if self._held is None else self._held) if on(Kind.TRACKER_HELD) else None
        places = places if self._held is None else self._held
        if on(Kind.TARGETS_EXCHANGED):
            places = places[[1, 0, *range(2, len(places))]]
        return places + self.faults.grown(Kind.TRACKER_DRIFT, self.live.time)

    def _send_wrench(self) -> None:
        if self.cell.frames.wrench_point is None:
            return
        shown = self._sensors.wrench(self.live.wrench())
        shown[:3] += self.faults.value(Kind.WRENCH_OFFSET, 0.0)
        if self.faults.on(Kind.WRENCH_NOT_FINITE):
            shown[:] = np.nan
        self._wrench.publish(self._wrench_mould.cast(self._stamp_ns(), shown.tolist()))

    def _send_state(self, *, always: bool) -> None:
        if self.faults.on(Kind.MODE_STALE):
            return
        fields = reported(self.faults, mode=int(self._value("operating_mode")), moving=self.live.moving)
        if always or fields != self._last_state:
            self._last_state = fields
            unknown = float("nan")
            header, stamp = self._header(), self.stamp()
            self._state.publish(
                RobotState(
                    header=header, source_stamp=stamp, source="simulated_cell", speed_limit_mm_s=unknown, **fields
                )
            )

    # --- commands ----------------------------------------------------------------------------------------------------

    def _cancel(self, _goal: Any) -> CancelResponse:
        self.log("cancel")
        return CancelResponse.ACCEPT

    def _begin(self, trajectory: JointTrajectory, owner: object) -> None:
        path = path_of(trajectory, self.cell.robot.joints)
        with self.lock:
            if path is None:  # hold: the usual way to stop by topic
                self.live.brake()
                self.log("hold")
                return
            self.live.follow(path)
            self._owner = owner
            self.log("motion" if np.ptp(path.position, axis=0).any() else "stand")

    def _on_trajectory(self, trajectory: JointTrajectory) -> None:
        try:
            if trajectory.points:
                self._begin(trajectory, object())
            else:
                self.live.brake()
                self.log("hold")
        except Refused as error:
            self.get_logger().warning(f"trajectory refused: {error}")

    async def _on_move(self, goal: Any) -> Any:
        result, owner = MoveTo.Result(), object()
        try:
            self._begin(goal.request.trajectory, owner)
        except Refused as error:
            goal.abort()
            result.outcome = Outcome(code=Outcome.INPUT_UNUSABLE, text=str(error))
            return result
        reported, stopping = 0.0, False
        while self._owner is owner and self.live.moving:
            await _NextTick(self)
            if goal.is_cancel_requested and not stopping:
                stopping = True
                with self.lock:
                    self.live.brake()
            if time.monotonic() - reported > FEEDBACK:
                reported = time.monotonic()
                goal.publish_feedback(
                    MoveTo.Feedback(positions=self.live.q.tolist(), share_done=float(self.live.share_done))
                )
        result.positions = self.live.q.tolist()
        arrived = np.array_equal(self.live.q, self._goal_of(goal.request.trajectory))
        if goal.is_cancel_requested:
            goal.canceled()
            result.outcome = Outcome(code=Outcome.CANCELLED, text="the goal was cancelled")
        elif self._owner is not owner or not arrived:
            goal.abort()
            result.outcome = Outcome(code=Outcome.BLOCKED, text="did not arrive")
        else:
            goal.succeed()
            result.outcome = Outcome(code=Outcome.OK, text="arrived")
        return result

    def _goal_of(self, trajectory: JointTrajectory) -> Float1D:
        names = list(trajectory.joint_names)
        last = list(trajectory.points[-1].positions)
        return np.array([last[names.index(joint)] for joint in self.cell.robot.joints])

    async def _on_load(self, goal: Any) -> Any:
        result = ApplyLoad.Result()
        target = wrench_values(goal.request.target)
        began = self.live.time
        stuck = self.faults.on(Kind.LOAD_STUCK)
        try:
            with self.lock:
                if not stuck:
                    self.live.pull(target, float(self._value("load_ramp")))
        except Refused as error:
            goal.abort()
            result.outcome = Outcome(code=Outcome.INPUT_UNUSABLE, text=str(error))
            return result
        late = goal.request.timeout if goal.request.timeout > 0.0 else float("inf")
        while (stuck or self.live.loading) and not goal.is_cancel_requested and self.live.time - began < late:
            await _NextTick(self)
        result.applied = wrench_message(self.live.load)
        if goal.is_cancel_requested:
            goal.canceled()
            result.outcome = Outcome(code=Outcome.CANCELLED, text="on request")
        elif stuck or self.live.loading:
            goal.abort()
            result.outcome = Outcome(code=Outcome.TIMED_OUT, text="the load device does not answer")
        else:
            goal.succeed()
            result.outcome = Outcome(code=Outcome.OK, text="the load is on")
        return result

    def _on_parameters(self, parameters: list[Any]) -> SetParametersResult:
        """Begin the fault that is asked for, and write down the cell's time, ns."""
        with self.lock:
            try:
                faults = [Fault.read(str(one.value), self.live.time) for one in parameters if one.name == "fault"]
            except ValueError as error:
                return SetParametersResult(successful=False, reason=str(error))
            now = self.stamp()
            for one in faults:
                self.faults.begin(one)
                self.log(f"fault {one.kind.name} {now.sec * NANOSECONDS + now.nanosec}")
                if one.kind is Kind.DRIVER_KILLED:
                    os.kill(os.getpid(), signal.SIGKILL)
        return SetParametersResult(successful=True)

    def close(self) -> None:
        """Close the files, and the tracker's connections."""
        if self._beam_server is not None:
            self._beam_server.close()
        if self._motion_log is not None:
            self._motion_log.close()
        if self._truth_log is not None:
            self._truth_log.close()
        if self._log is not None:
            self._log.close()


class _NextTick:
    """Awaits a later step of the cell, as soon as something has ended or feedback is due."""

    def __init__(self, node: SimulatedCell) -> None:
        self._node, self._at = node, node.ticks

    def __await__(self) -> Generator[None, None, None]:
        while self._node.ticks == self._at:
            yield
