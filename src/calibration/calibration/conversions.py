"""Messages to values of the core and back: besides `topics`, the only module that knows both.

Units are SI inside; what comes in other units is converted here and nowhere else.
"""

from __future__ import annotations

import dataclasses
import math
import struct
from collections.abc import Callable, Mapping
from typing import Any

import numpy as np
from builtin_interfaces.msg import Time
from calibration_interfaces import msg
from calibration_interfaces.msg import Permission, RobotState
from geometry_msgs.msg import Point, PointStamped, Vector3, Wrench, WrenchStamped
from rclpy.serialization import deserialize_message
from sensor_msgs.msg import JointState
from std_msgs.msg import Header

from calibration.robot_state.adapter import Report
from calibration_core.motion.guard import GuardDecision, GuardRules
from calibration_core.motion.robot_status import OperatingMode
from calibration_core.observations.average import Average
from calibration_core.recording.messages.kinds import StreamKind
from calibration_core.recording.messages.layout import Layout, layout_of
from calibration_core.timeseries import NANOSECONDS, Float1D, Float2D, Phase

STAMP = struct.Struct(">iI"), struct.Struct("<iI")  # of a serialised message with a header, big- or little-endian: ...
HEAD = 12  # ... s and ns, and what follows them
LENGTH_UNITS: Mapping[str, float] = {"m": 1.0, "mm": 1e-3, "inch": 0.0254}
FORCE_UNITS: Mapping[str, float] = {"N": 1.0, "kN": 1e3, "lbf": 4.4482216152605}
TORQUE_UNITS: Mapping[str, float] = {"N*m": 1.0, "N*mm": 1e-3, "kN*m": 1e3, "lbf*in": 0.1129848290276167}
SIGNS: Mapping[str, float] = {"applied_on_robot": 1.0, "applied_by_robot": -1.0}


@dataclasses.dataclass(frozen=True, eq=False)
class Sample:
    """One sample of an instrument.

    Attributes:
        stamp: `header.stamp` in ns; 0 where there is none.
        frame: `frame_id`; empty where there is none.
        values: (3,) m, or (6,) N and N*m.
        rotation: (4,) quaternion x, y, z, w where the message has one, else None.
    """

    stamp: int
    frame: str
    values: Float1D
    rotation: Float1D | None = None


# --- time ---------------------------------------------------------------------------------------------------------


def stamp_ns(stamp: Any) -> int:
    """Return a `builtin_interfaces/Time` in ns."""
    return int(stamp.sec) * NANOSECONDS + int(stamp.nanosec)


def to_stamp(time: int) -> Time:
    """Return ns as `builtin_interfaces/Time`; its seconds are a signed 32-bit number.

    Raises:
        ValueError: The time cannot be expressed.
    """
    seconds, rest = divmod(int(time), NANOSECONDS)
    if not -(2**31) <= seconds < 2**31:
        msg_text = f"{time} ns is not a time of ROS"
        raise ValueError(msg_text)
    return Time(sec=seconds, nanosec=rest)


def to_header(time: int, frame: str = "") -> Header:
    """Return a header."""
    return Header(stamp=to_stamp(time), frame_id=frame)


# --- samples that come in -----------------------------------------------------------------------------------------


def _xyz(one: Any) -> list[float]:
    return [one.x, one.y, one.z]


def _xyzw(one: Any) -> Float1D:
    return np.array([one.x, one.y, one.z, one.w])


def _point_stamped(message: Any, unit: float) -> Sample:
    return Sample(stamp_ns(message.header.stamp), message.header.frame_id, unit * np.array(_xyz(message.point)))


def _pose_stamped(message: Any, unit: float) -> Sample:
    return _pose(message.header, message.pose, unit)


def _pose_with_covariance(message: Any, unit: float) -> Sample:
    return _pose(message.header, message.pose.pose, unit)


def _pose(header: Any, pose: Any, unit: float) -> Sample:
    values = unit * np.array(_xyz(pose.position))
    return Sample(stamp_ns(header.stamp), header.frame_id, values, _xyzw(pose.orientation))


def _transform_stamped(message: Any, unit: float) -> Sample:
    values = unit * np.array(_xyz(message.transform.translation))
    return Sample(stamp_ns(message.header.stamp), message.header.frame_id, values, _xyzw(message.transform.rotation))


POINT_INPUTS: Mapping[str, tuple[str, Callable[[Any, float], Sample]]] = {
    "PointStamped": ("geometry_msgs/msg/PointStamped", _point_stamped),
    "PoseStamped": ("geometry_msgs/msg/PoseStamped", _pose_stamped),
    "PoseWithCovarianceStamped": ("geometry_msgs/msg/PoseWithCovarianceStamped", _pose_with_covariance),
    "TransformStamped": ("geometry_msgs/msg/TransformStamped", _transform_stamped),
}
"""What a tracker may send: name of the input -> message type, and the function that reads it (in metres)."""

TF_TYPE = "tf2_msgs/msg/TFMessage"


def transforms(message: Any, targets: Mapping[str, str], unit: float) -> dict[str, Sample]:
    """Return the samples in a `tf2_msgs/TFMessage`.

    Args:
        message: The message.
        targets: Child frame -> measurement point.
        unit: Metres per unit of the message.
    """
    found = {}
    for one in message.transforms:
        if one.child_frame_id in targets:
            found[targets[one.child_frame_id]] = _transform_stamped(one, unit)
    return found


def wrench_values(wrench: Any) -> Float1D:
    """Return the (6,) numbers of a `geometry_msgs/Wrench`."""
    return np.array([*_xyz(wrench.force), *_xyz(wrench.torque)])


def wrench_sample(message: Any) -> Sample:
    """Return the sample in a `geometry_msgs/WrenchStamped` or `Wrench` (without stamp and frame), in its units."""
    if not hasattr(message, "header"):
        return Sample(0, "", wrench_values(message))
    return Sample(stamp_ns(message.header.stamp), message.header.frame_id, wrench_values(message.wrench))


WRENCH_INPUTS: Mapping[str, str] = {
    "WrenchStamped": "geometry_msgs/msg/WrenchStamped",
    "Wrench": "geometry_msgs/msg/Wrench",
}
"""What a force/torque sensor may send: name of the input -> message type."""


def joint_positions(message: Any, joints: tuple[str, ...]) -> Float1D | None:
    """Return (n,) rad of a `sensor_msgs/JointState` in the order of `joints`; None if one of them is missing."""
    index = {name: place for place, name in enumerate(message.name)}
    if len(message.position) != len(message.name) or not set(joints) <= index.keys():
        return None
    return np.array([message.position[index[name]] for name in joints])


def stamp_of(payload: bytes) -> int:
    """Return the stamp, ns, of a serialised message whose first field is a header."""
    seconds, nanoseconds = STAMP[payload[1] & 1].unpack_from(payload, 4)
    return int(seconds) * NANOSECONDS + int(nanoseconds)


class _Reader:
    """Reads serialised messages of one shape, some ten times faster than rclpy makes a message of each."""

    def __init__(self, kind: StreamKind, joints: tuple[str, ...] = ()) -> None:
        self._kind, self._joints = kind, joints
        self._layout: Layout | None = None
        self._head = b""

    def _numbers(self, payload: bytes) -> tuple[Layout, Float1D] | None:
        """Return the shape of a message and its numbers; None where it is of another byte order."""
        layout = self._layout
        if layout is None or (len(payload), payload[HEAD : layout.values[0]]) != (layout.length, self._head):
            layout = self._layout = layout_of(self._kind, payload, self._joints)
            if layout is None:
                return None
            self._head = payload[HEAD : layout.values[0]]
        return layout, np.frombuffer(payload, "<f8", layout.values[1], layout.values[0])


class JointReader(_Reader):
    """Reads `sensor_msgs/JointState` of one driver.

    Attributes:
        names: The joints whose positions were in the last message.
    """

    def __init__(self, joints: tuple[str, ...]) -> None:
        """Take the names, in the order of the angles."""
        super().__init__(StreamKind.JOINTS, joints)
        self.names: tuple[str, ...] = ()

    def read(self, payload: bytes) -> tuple[int, Float1D] | None:
        """Return stamp, ns, and (n,) rad; None if a joint is missing."""
        found = self._numbers(payload)
        if found is None:
            message = deserialize_message(payload, JointState)
            self.names = tuple(message.name[: len(message.position)])
            q = joint_positions(message, self._joints)
            return None if q is None else (stamp_ns(message.header.stamp), q)
        layout, numbers = found
        self.names = layout.names[: layout.values[1]]
        return (stamp_of(payload), numbers[list(layout.pick)]) if layout.usable else None


class WrenchReader(_Reader):
    """Reads `geometry_msgs/WrenchStamped` of one driver."""

    def __init__(self) -> None:
        """Begin with no message."""
        super().__init__(StreamKind.WRENCH)

    def read(self, payload: bytes) -> Sample:
        """Return the sample, in the message's units."""
        found = self._numbers(payload)
        if found is None:
            return wrench_sample(deserialize_message(payload, WrenchStamped))
        return Sample(stamp_of(payload), found[0].frame, found[1])


# --- messages that go out -----------------------------------------------------------------------------------------


def to_point(values: Float1D) -> Point:
    """Return (3,) m as a point."""
    return Point(x=float(values[0]), y=float(values[1]), z=float(values[2]))


def to_wrench(values: Float1D) -> Wrench:
    """Return (6,) N and N*m as a wrench."""
    fx, fy, fz, tx, ty, tz = (float(value) for value in values)
    return Wrench(force=Vector3(x=fx, y=fy, z=fz), torque=Vector3(x=tx, y=ty, z=tz))


def to_point_stamped(sample: Sample) -> PointStamped:
    """Return a point as recordings hold it."""
    return PointStamped(header=to_header(sample.stamp, sample.frame), point=to_point(sample.values))


def to_wrench_stamped(sample: Sample) -> WrenchStamped:
    """Return a wrench as recordings hold it."""
    return WrenchStamped(header=to_header(sample.stamp, sample.frame), wrench=to_wrench(sample.values))


def to_step(time: int, configuration: int, step: int, phase: Phase) -> Any:
    """Return the marker of a change."""
    return msg.MeasurementStep(header=to_header(time), configuration=configuration, step=step, phase=int(phase))


def to_outcome(code: int, text: str) -> Any:
    """Return how something ended, in one line: the command line shows line breaks as two characters each."""
    return msg.Outcome(code=code, text="; ".join(text.splitlines()))


@dataclasses.dataclass(frozen=True, eq=False)
class Mean:
    """Mean of a stream over a settled window, with what the message says beside it.

    Attributes:
        name: Measurement point, or `wrench`.
        frame: Frame of the values.
        begin: Stamp of the first sample averaged, ns.
        end: Stamp of the last one, ns.
        average: Mean and covariance.
        tare: Number of the tare in force, 0: none.
    """

    name: str
    frame: str
    begin: int
    end: int
    average: Average
    tare: int = 0


def to_average(mean: Mean) -> Any:
    """Return a mean as a message."""
    one = mean.average
    return msg.Average(
        header=to_header((mean.begin + mean.end) // 2, mean.frame),
        name=mean.name,
        begin=to_stamp(mean.begin),
        end=to_stamp(mean.end),
        mean=one.mean.tolist(),
        covariance=one.covariance.ravel().tolist(),
        samples=one.samples,
        effective_samples=one.effective,
        outliers=one.outliers,
        tare=mean.tare,
    )


def from_average(message: Any) -> Mean:
    """Return the mean in a message."""
    mean = np.array(message.mean)
    covariance: Float2D = np.array(message.covariance).reshape(len(mean), len(mean))
    one = Average(mean, covariance, message.samples, message.effective_samples, message.outliers)
    begin, end = stamp_ns(message.begin), stamp_ns(message.end)
    return Mean(message.name, message.header.frame_id, begin, end, one, message.tare)


def to_tare(header: Header, number: int, bias: Float1D, mean: Mean | None, requested_by: str, reason: str) -> Any:
    """Return a tare as a message; without a mean it is the end of one."""
    return msg.TareEvent(
        header=header,
        number=number,
        bias=to_wrench(bias),
        covariance=np.zeros(36) if mean is None else mean.average.covariance.ravel(),
        samples=0 if mean is None else mean.average.samples,
        requested_by=requested_by,
        reason=reason,
    )


MILLIMETRES = 1e3


def tri_state(value: bool | None) -> int:
    """Return a bool, or None, as the message's number."""
    return int(RobotState.UNDECIDED if value is None else RobotState.TRUE if value else RobotState.FALSE)


def to_robot_state(report: Report, time: int, *, steady_to_ros: int) -> RobotState:
    """Return a report as a message.

    Args:
        report: What is known.
        time: ns, of publication.
        steady_to_ros: ns, to be added to a steady time to get the node's.
    """
    status = report.status
    until = status.confirmed_until
    return RobotState(
        header=to_header(time),
        operating_mode=int(status.operating_mode),
        drives=int(status.drives),
        safety=int(status.safety),
        motion_possible=tri_state(status.motion_possible),
        in_motion=tri_state(status.in_motion),
        in_error=tri_state(status.in_error),
        speed_scaling=math.nan if status.speed_scaling is None else status.speed_scaling,
        speed_limit_mm_s=math.nan if status.speed_limit is None else MILLIMETRES * status.speed_limit,
        vendor_codes=list(report.vendor_codes),
        source=report.source,
        source_stamp=to_stamp(report.source_time),
        received_stamp=to_stamp(max(report.received_time + steady_to_ros, 0) if report.received_time else 0),
        operator_confirmed=status.operator_confirmed,
        operator_name=report.operator,
        confirmed_until=to_stamp(0 if until is None else max(round(until * NANOSECONDS) + steady_to_ros, 0)),
    )


def to_permission(decision: GuardDecision, rules: GuardRules, time: int, *, hears: bool, stop: str) -> Permission:
    """Return a decision as a message.

    Args:
        decision: The decision.
        rules: Limits.
        time: ns.
        hears: Whether the sequencer gives a sign of life.
        stop: How the guard stops a motion.
    """
    return Permission(
        header=to_header(time),
        permitted=decision.permitted,
        latched=bool(decision.latched),
        reasons=[int(reason) for reason in decision.reasons],
        text=decision.text,
        speed=decision.speed,
        speed_point=decision.speed_point,
        speed_limit=rules.speed_limit,
        hears_sequencer=hears,
        stop=stop,
    )


def mode_names(modes: list[str]) -> frozenset[OperatingMode]:
    """Return operating modes by their names; unknown names raise KeyError."""
    return frozenset(OperatingMode[name] for name in modes)
