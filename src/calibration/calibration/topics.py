"""Every topic of the suite: name, type, quality of service; one table for nodes, recorder and reader.

Names are relative, so that a namespace or a remapping moves them; in a bag they stand as the cell file names them.
"""

from __future__ import annotations

import dataclasses
import enum
import functools
import importlib
from typing import Any

from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, HistoryPolicy, QoSProfile, ReliabilityPolicy, qos_check_compatible
from rclpy.qos import QoSCompatibility as Compatibility

from calibration_core.cell import Cell
from calibration_core.errors import InputError, quoted
from calibration_core.recording.definitions.own import CONDITIONS_TYPE, STEP_TYPE, TEXT_TYPE
from calibration_core.recording.messages.kinds import StreamKind

SAMPLES_DEPTH = 2000  # two seconds at 1 kHz: a keep-last history overwrites without a word
EVENTS_DEPTH = 1000
NO_PACKAGE = "no such package"
FROM_SOURCE = {"industrial_msgs", "fanuc_msgs", "kuka_driver_interfaces"}  # not released for Jazzy


class Quality(enum.Enum):
    """How messages of a topic are carried.

    SAMPLES: streams of instruments; nothing is resent to those who come late.
    STATE: the last message is what counts, and those who come late get it.
    EVENTS: every message counts, and those who come late get all of them.
    PULSE: a state that is worthless unless fresh; those who come late wait for the next.
    """

    SAMPLES = "samples"
    STATE = "state"
    EVENTS = "events"
    PULSE = "pulse"


@dataclasses.dataclass(frozen=True)
class Topic:
    """One topic.

    Attributes:
        name: As in a bag, with the leading slash.
        type: Message type, `package/msg/Name`.
        quality: How it is carried.
        optional: Whether a recording is complete without it.
    """

    name: str
    type: str
    quality: Quality
    optional: bool = True

    @property
    def relative(self) -> str:
        """The name for publishers and subscriptions."""
        return self.name.lstrip("/")

    @property
    def message(self) -> Any:
        """The message class."""
        return message_class(self.type)

    @property
    def qos(self) -> QoSProfile:
        """The quality that our own nodes offer and ask for."""
        return profile(self.quality)


ROBOT_STATE = Topic("/calibration/robot_state", "calibration_interfaces/msg/RobotState", Quality.STATE)
PERMISSION = Topic("/calibration/permission", "calibration_interfaces/msg/Permission", Quality.PULSE)
EVENT = Topic("/calibration/event", "calibration_interfaces/msg/SessionEvent", Quality.EVENTS)
READING = Topic("/calibration/reading", "calibration_interfaces/msg/Reading", Quality.EVENTS)
PRESENT_WRENCH = Topic("/calibration/wrench", StreamKind.WRENCH.value, Quality.PULSE)  # tared, mean of half a second
TARE = Topic("/calibration/tare", "calibration_interfaces/msg/TareEvent", Quality.EVENTS)
SAMPLE_CHECK = Topic("/calibration/sample_check", "calibration_interfaces/msg/SampleCheck", Quality.SAMPLES)
MOTION_PULSE = Topic("/calibration/motion_pulse", "calibration_interfaces/msg/MotionPulse", Quality.PULSE)
RECORDING = Topic("/calibration/recording", "calibration_interfaces/msg/RecordingState", Quality.PULSE)
MARKERS = Topic("/calibration/markers", "visualization_msgs/msg/MarkerArray", Quality.STATE)
PLAN_MARKERS = Topic("/calibration/plan_markers", "visualization_msgs/msg/MarkerArray", Quality.STATE)
PROCEDURE = Topic("/calibration/procedure", "calibration_interfaces/msg/ProcedureState", Quality.STATE)
STATE = Topic("/calibration/state", "calibration_interfaces/msg/State", Quality.STATE)
TYPED = Topic("/tracker/typed", TEXT_TYPE, Quality.SAMPLES)  # what an operator has measured

PROGRESS = Topic("/calibration/progress", "calibration_interfaces/msg/MeasurementProgress", Quality.STATE)
CONDITIONS_QUALITY = Quality.EVENTS

OWN = (ROBOT_STATE, PERMISSION, EVENT, READING, PROGRESS, TARE, SAMPLE_CHECK)


def contract_topics(cell: Cell) -> tuple[Topic, ...]:
    """Return the topics of which a recording is made."""
    names = cell.topics
    return (
        Topic(names.joint_states, StreamKind.JOINTS.value, Quality.SAMPLES, optional=False),
        *(Topic(names.point(point), StreamKind.POINT.value, Quality.SAMPLES, optional=False) for point in cell.points),
        Topic(names.wrench, StreamKind.WRENCH.value, Quality.SAMPLES),
        Topic(names.temperature, StreamKind.TEMPERATURE.value, Quality.SAMPLES),
        Topic(names.robot_description, TEXT_TYPE, Quality.STATE),
        Topic(names.step, STEP_TYPE, Quality.EVENTS),
        Topic(names.conditions, CONDITIONS_TYPE, CONDITIONS_QUALITY),
    )


def session_topics(cell: Cell) -> frozenset[str]:
    """Return the topics on which the sequencer tells of one session after the other."""
    return frozenset({cell.topics.step, cell.topics.conditions, EVENT.name, READING.name, PROGRESS.name})


def recorded_topics(cell: Cell) -> tuple[Topic, ...]:
    """Return everything that the recorder records."""
    return (*contract_topics(cell), *OWN)


def profile(quality: Quality) -> QoSProfile:
    """Return the profile of a quality; reliable, for whoever asks for less gets it too."""
    depth = {Quality.SAMPLES: SAMPLES_DEPTH, Quality.STATE: 1, Quality.EVENTS: EVENTS_DEPTH, Quality.PULSE: 1}[quality]
    kept = quality in (Quality.STATE, Quality.EVENTS)
    return QoSProfile(
        history=HistoryPolicy.KEEP_LAST,
        depth=depth,
        reliability=ReliabilityPolicy.RELIABLE,
        durability=DurabilityPolicy.TRANSIENT_LOCAL if kept else DurabilityPolicy.VOLATILE,
    )


def subscription_profile(node: Node, name: str, depth: int = SAMPLES_DEPTH) -> QoSProfile:
    """Return the strongest profile that every publisher of a topic offers now.

    Without a publisher, and with publishers that differ, best effort without history: it is compatible with all.

    Args:
        node: Who wants to subscribe.
        name: Topic, as for a subscription.
        depth: Messages kept between two callbacks.
    """
    offered = [info.qos_profile for info in node.get_publishers_info_by_topic(name)]
    reliable = bool(offered) and all(one.reliability == ReliabilityPolicy.RELIABLE for one in offered)
    kept = bool(offered) and all(one.durability == DurabilityPolicy.TRANSIENT_LOCAL for one in offered)
    return QoSProfile(
        history=HistoryPolicy.KEEP_LAST,
        depth=depth,
        reliability=ReliabilityPolicy.RELIABLE if reliable else ReliabilityPolicy.BEST_EFFORT,
        durability=DurabilityPolicy.TRANSIENT_LOCAL if kept else DurabilityPolicy.VOLATILE,
    )


def publishers(node: Node, name: str) -> list[str]:
    """Return the full names of the nodes that publish a topic, sorted; one that was killed is there for 20 s more."""
    infos = node.get_publishers_info_by_topic(name)
    return sorted(f"{info.node_namespace.rstrip('/')}/{info.node_name}" for info in infos)


def several_publishers(node: Node, name: str) -> str:
    """Return the names of a topic's publishers where there are more than one; empty otherwise.

    One that was killed is counted for 20 s more, but for one of the node's own name: its sign of life is watched.
    """
    names = publishers(node, name)
    own = node.get_fully_qualified_name()
    if sum(one != own for one in names) + (own in names) < 2:
        return ""
    return f"{node.resolve_topic_name(name)} is published by {', '.join(names)}"


def incompatible(node: Node, name: str, asked: QoSProfile) -> list[str]:
    """Return why publishers of a topic cannot be heard with the profile asked for; empty if all can."""
    why = []
    for info in node.get_publishers_info_by_topic(name):
        compatibility, reason = qos_check_compatible(info.qos_profile, asked)
        if compatibility == Compatibility.ERROR:
            why.append(f"{info.node_name}: {reason}")
    return why


@functools.cache
def message_class(kind: str) -> Any:
    """Import a message class, `package/msg/Name`.

    Raises:
        ModuleNotFoundError: The package is not installed.
        AttributeError: It has no such message.
    """
    package, group, name = kind.split("/")
    return getattr(importlib.import_module(f"{package}.{group}"), name)


def load_type(text: str) -> Any:
    """Return the class of a message, service or action that a driver brings, by its name, `package/msg/Name`.

    Raises:
        InputError: The name is malformed, the package is not installed (and what would install it), or has no such
            type.
    """
    parts = text.split("/")
    if len(parts) != 3 or parts[1] not in {"msg", "srv", "action"} or not all(part.isidentifier() for part in parts):
        raise InputError("parameters", "type", quoted(text), "package/msg/Name")
    package = parts[0]
    try:
        return message_class(text)
    except ImportError:
        by_apt = "" if package in FROM_SOURCE else f"apt install ros-jazzy-{package.replace('_', '-')}, or "
        expected = f"package {package}: {by_apt}built from its source in this workspace or an underlay"
        raise InputError(package, text, NO_PACKAGE, expected) from None
    except AttributeError:
        module = importlib.import_module(f"{package}.{parts[1]}")
        names = ", ".join(sorted(name for name in dir(module) if name[:1].isupper()))
        raise InputError(package, text, "no such type", f"one of {names}") from None


def offered_qos(profile_: QoSProfile) -> dict[str, object]:
    """Return a profile as rosbag2 writes it into a bag."""

    def time(one: Any) -> dict[str, int]:
        return {"sec": int(one.nanoseconds // 10**9), "nsec": int(one.nanoseconds % 10**9)}

    return {
        "history": profile_.history.name.lower(),
        "depth": profile_.depth,
        "reliability": profile_.reliability.name.lower(),
        "durability": profile_.durability.name.lower(),
        "deadline": time(profile_.deadline),
        "lifespan": time(profile_.lifespan),
        "liveliness": profile_.liveliness.name.lower(),
        "liveliness_lease_duration": time(profile_.liveliness_lease_duration),
        "avoid_ros_namespace_conventions": profile_.avoid_ros_namespace_conventions,
    }
