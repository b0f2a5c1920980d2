"""Parameters of the sequencer, and the rules that they make."""

from __future__ import annotations

import dataclasses
import math
from typing import Any, Protocol

from calibration.motion.arrival import ArrivalRules
from calibration.motion.catalogue import MOTION_INTERFACE
from calibration.node import Declared
from calibration_core.cell import Cell
from calibration_core.motion.speed import SPEED_ERROR
from calibration_core.motion.trajectory import MotionLimits
from calibration_core.planning.plans.measurement_queue import SequenceRules

OPERATOR, DEVICE = "operator", "device"
LOOK = ("base", "flange", "size")  # of markers
ARRIVAL, LIMITS, RULES = ArrivalRules(), MotionLimits(), SequenceRules()

# May be changed while the node runs, but not during a run: the next run takes them as they are then.
FREE = frozenset(
    {
        "motion.speed",
        "motion.margin",
        "motion.joint_speed",
        "motion.joint_acceleration",
        "motion.max_points",
        "load.timeout",
        "settle_time",
        "window",
        "measure_timeout",
        "min_samples",
        "attempts",
        "readings",
        "startup_cycles",
        "startup_period",
        "motion_limit",
        "settling_limit",
        "reading_limit",
        "server_wait",
        "markers.size",
    }
)
_TABLE = (
    Declared("cell", "", "The cell file.", required=True),
    *MOTION_INTERFACE,
    Declared("motion.speed", LIMITS.speed, "m/s, of every monitored point.", low=0.01, high=0.25),
    Declared(
        "motion.margin",
        LIMITS.margin,
        "Share of the speed that is kept free.",
        low=2.0 * SPEED_ERROR,
        high=0.9,
        read_only=False,
    ),
    Declared("motion.joint_speed", 0.8, "rad/s, of every joint.", low=0.001, high=10.0),
    Declared("motion.joint_acceleration", 0.6, "rad/s^2, of every joint.", low=0.001, high=100.0),
    Declared("motion.max_points", LIMITS.max_points, "Points of one trajectory.", low=3, high=10000),
    Declared("motion.prepare_services", [], "Called before the first motion: name=package/srv/Type{field: value}."),
    Declared("motion.hold_topic", "", "Topic that takes a hold trajectory, the second stage of the stop."),
    Declared("motion.stop_services", [], "Called as the third stage of the stop: name=package/srv/Type{...}."),
    Declared("arrival.tolerance", ARRIVAL.tolerance, "rad, of every joint.", low=1e-6, high=0.1),
    Declared("arrival.speed", ARRIVAL.speed, "rad/s, of every joint, while standing.", low=1e-6, high=0.1),
    Declared("arrival.dwell", ARRIVAL.dwell, "s, for which both hold.", low=0.01, high=10.0),
    Declared("load.by", OPERATOR, "Who changes the load.", choices=(OPERATOR, DEVICE)),
    Declared("load.interface", "driver/apply_load", "Action of the load device."),
    Declared("load.memory", "", "File that keeps, between runs, what is known of the load; empty: in $ROS_HOME."),
    Declared(
        "load.timeout",
        60.0,
        "s of the cell's time, that the load device may take.",
        low=0.1,
        high=3600.0,
        read_only=False,
    ),
    Declared(
        "settle_time", 1.5, "s, that everything has stood before a reading.", low=0.0, high=600.0, read_only=False
    ),
    Declared("window", 2.0, "s, that a reading is averaged over.", low=0.001, high=600.0),
    Declared(
        "measure_timeout",
        30.0,
        "s, that an instrument may wait for a settled window.",
        low=0.1,
        high=600.0,
        read_only=False,
    ),
    Declared(
        "min_samples", 0, "That every average must have; 0: as the instruments' nodes say.", low=0, read_only=False
    ),
    Declared("tracker", "tracker/measure", "Action of the tracker."),
    Declared("force_torque", "force_torque/measure", "Action of the force/torque sensor; empty: the cell has none."),
    Declared("recorder", "recorder", "Node that records to bag/ in the session; empty: the session alone is kept."),
    Declared("recorder_age", 1.0, "s, of the recorder's last sign of life; older pauses the run.", low=0.2, high=60.0),
    Declared("instrument_age", 1.5, "s, likewise of instruments and identification.", low=0.5, high=60.0),
    Declared("attempts", RULES.attempts, "Times that a configuration is tried.", low=1, high=20),
    Declared("readings", RULES.readings, "Times that a reading is tried.", low=1, high=20),
    Declared(
        "startup_cycles",
        RULES.startup_cycles,
        "Times of the start-up cycle before measuring.",
        low=0,
        high=100,
        read_only=False,
    ),
    Declared(
        "startup_period", RULES.startup_period, "s, after which it is repeated; 0: never.", low=0.0, read_only=False
    ),
    Declared("motion_limit", RULES.motion_limit, "s, of one motion.", low=1.0),
    Declared("settling_limit", RULES.settling_limit, "s, of settling.", low=1.0),
    Declared("reading_limit", RULES.reading_limit, "s, of one reading.", low=1.0),
    Declared("permission_age", 0.1, "s, of the guard's last word; older means no.", low=0.02, high=1.0),
    Declared("server_wait", 10.0, "s, that the other nodes may take to appear.", low=0.1, high=300.0),
    Declared("progress", True, "Whether it is worked out after every configuration what its readings determine."),
    Declared("markers.base", "", "Name of the robot's base frame; empty: the cell file's, or base_link."),
    Declared("markers.flange", "", "Name of the robot's flange frame; empty: the cell file's, or flange."),
    Declared("markers.size", 0.02, "m, diameter of a point that is shown.", low=1e-4, high=1.0),
    Declared("trace", "", "File for stop commands with the monotonic clock's ns; empty: none."),
)
PARAMETERS = tuple(dataclasses.replace(one, read_only=one.name not in FREE) for one in _TABLE)


class Values(Protocol):
    """Whatever has parameters."""

    def value(self, name: str) -> Any:
        """Return a parameter's value."""


def arrival_rules(node: Values) -> ArrivalRules:
    """Return when the robot has arrived."""
    return ArrivalRules(*(node.value(f"arrival.{name}") for name in ("tolerance", "speed", "dwell")))


def motion_limits(node: Values, cell: Cell) -> MotionLimits:
    """Return the limits of motions; none is planned faster than the controller's declared safety-rated limit."""
    names = ("speed", "margin", "joint_speed", "joint_acceleration", "max_points")
    given = {name: node.value(f"motion.{name}") for name in names}
    if cell.safety is not None:
        given["speed"] = min(given["speed"], cell.safety.speed_limit)
    return MotionLimits(**given)


def sequence_rules(node: Values) -> SequenceRules:
    """Return the rules of the procedure."""
    names = ("attempts", "readings", "startup_cycles", "settling_limit", "reading_limit")
    external = node.value("motion.backend") == "external"
    return SequenceRules(
        startup_period=node.value("startup_period") or math.inf,
        motion_limit=math.inf if external else node.value("motion_limit"),
        **{name: node.value(name) for name in names},
    )
