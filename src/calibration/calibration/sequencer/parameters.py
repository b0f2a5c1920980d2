"""Parameters of the sequencer, and the rules that they make."""

from __future__ import annotations

import functools
import math

from calibration.motion.arrival import ArrivalRules
from calibration.motion.backends import MOTION_INTERFACE
from calibration.node import CalibrationNode, Declared
from calibration_core.cell import Cell
from calibration_core.motion.trajectory import MotionLimits
from calibration_core.planning.plans.measurement_queue import SequenceRules

OPERATOR, DEVICE = "operator", "device"
ARRIVAL, LIMITS, RULES = ArrivalRules(), MotionLimits(), SequenceRules()

# Those that change while the node runs do not during a run: the next run takes them as they are then.
Free = functools.partial(Declared, read_only=False)
PARAMETERS = (
    Declared("cell", "", "The cell file.", required=True),
    *MOTION_INTERFACE,
    Free("motion.speed", LIMITS.speed, "m/s, of every monitored point.", low=0.01, high=0.25),
    Free("motion.joint_speed", 0.8, "rad/s, of every joint.", low=0.001, high=10.0),
    Free("motion.joint_acceleration", 0.6, "rad/s^2, of every joint.", low=0.001, high=100.0),
    Declared("motion.prepare_services", [], "Called before the first motion: name=package/srv/Type{field: value}."),
    Declared("motion.hold_topic", "", "Topic that takes a hold trajectory, the second stage of the stop."),
    Declared("motion.stop_services", [], "Called as the third stage of the stop: name=package/srv/Type{...}."),
    Declared("arrival.tolerance", ARRIVAL.tolerance, "rad, of every joint.", low=1e-6, high=0.1),
    Declared("arrival.dwell", ARRIVAL.dwell, "s, for which it holds, and the robot stands.", low=0.01, high=10.0),
    Declared("load.by", OPERATOR, "Who changes the load.", choices=(OPERATOR, DEVICE)),
    Declared("load.memory", "", "File that keeps, between runs, what is known of the load; empty: in $ROS_HOME."),
    Free("load.timeout", 60.0, "s of the cell's time, that the load device may take.", low=0.1, high=3600.0),
    Free("settle_time", 1.5, "s, that everything has stood before a reading.", low=0.0, high=600.0),
    Free("window", 2.0, "s, that a reading is averaged over.", low=0.001, high=600.0),
    Free("measure_timeout", 30.0, "s, that an instrument may wait for a settled window.", low=0.1, high=600.0),
    Declared("tracker", "tracker/measure", "Action of the tracker."),
    Declared("force_torque", "force_torque/measure", "Action of the force/torque sensor; empty: the cell has none."),
    Declared("recorder", "recorder", "Node that records to bag/ in the session; empty: the session alone is kept."),
    Declared("recorder_age", 1.0, "s, of the recorder's last sign of life; older pauses the run.", low=0.2, high=60.0),
    Declared("instrument_age", 1.5, "s, likewise of instruments and identification.", low=0.5, high=60.0),
    Free("attempts", RULES.attempts, "Times that a configuration is tried.", low=1, high=20),
    Free("readings", RULES.readings, "Times that a reading is tried.", low=1, high=20),
    Free("startup_cycles", RULES.startup_cycles, "Times of the start-up cycle before measuring.", low=0, high=100),
    Free("startup_period", RULES.startup_period, "s, after which it is repeated; 0: never.", low=0.0),
    Free("reading_limit", RULES.reading_limit, "s, of one reading.", low=1.0),
    Declared("permission_age", 0.1, "s, of the guard's last word; older means no.", low=0.02, high=1.0),
    Free("server_wait", 10.0, "s, that the other nodes may take to appear.", low=0.1, high=300.0),
    Declared("progress", True, "Whether it is worked out after every configuration what its readings determine."),
    Declared("trace", "", "File for stop commands with the monotonic clock's ns; empty: none."),
)


def arrival_rules(node: CalibrationNode) -> ArrivalRules:
    """Return when the robot has arrived."""
    return ArrivalRules(**{name: node.value(f"arrival.{name}") for name in ("tolerance", "dwell")})


def motion_limits(node: CalibrationNode, cell: Cell) -> MotionLimits:
    """Return the limits of motions; none is planned faster than the controller's declared safety-rated limit."""
    names = ("speed", "joint_speed", "joint_acceleration")
    given = {name: node.value(f"motion.{name}") for name in names}
    if cell.safety is not None:
        given["speed"] = min(given["speed"], cell.safety.speed_limit)
    return MotionLimits(**given)


def sequence_rules(node: CalibrationNode) -> SequenceRules:
    """Return the rules of the procedure."""
    names = ("attempts", "readings", "startup_cycles", "reading_limit")
    external = node.value("motion.backend") == "external"
    return SequenceRules(
        startup_period=node.value("startup_period") or math.inf,
        motion_limit=math.inf if external else RULES.motion_limit,
        **{name: node.value(name) for name in names},
    )
