"""The guard's messages: permission and robot state, from and to values of the core."""

from __future__ import annotations

import math

from calibration_interfaces.msg import Permission, RobotState

from calibration.conversions import to_header, to_stamp
from calibration.robot_state.adapter import Report
from calibration_core.motion.guard import GuardDecision, GuardRules
from calibration_core.motion.robot_status import OperatingMode
from calibration_core.timeseries import NANOSECONDS

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
