"""Draws effects of the load chain and the point chain."""

from __future__ import annotations

import numpy as np

from calibration_sim.effect_models import load_chain, point_chain
from calibration_sim.effect_models.effect import Effect, Label
from calibration_sim.generators.draw import Draw, components

SENSOR, TRACKER = {"sensor": "force_torque"}, {"tracker": "tracker"}


def wrench_gain(draw: Draw) -> Effect:
    """One axis shows too much or too little."""
    axis = draw.among(0, 1, 2)
    gain = draw.sign() * draw.amplitude * draw.size.gain
    matrix = np.zeros((6, 6))
    matrix[axis, axis] = gain
    label = Label("load chain", "wrench_gain", SENSOR, draw.amplitude, {f"gain_f{'xyz'[axis]}": gain}, same_law=True)
    return load_chain.LinearSensor(label, matrix)


def wrench_crosstalk(draw: Draw) -> Effect:
    """Every axis shows something of every other."""
    ranges = np.repeat([1.0, 0.3], 3)
    matrix = draw.amplitude * draw.size.gain * draw.rng.standard_normal((6, 6)) * ranges[:, None] / ranges
    matrix[np.diag_indices(6)] = 0.0
    label = Label("load chain", "wrench_crosstalk", SENSOR, draw.amplitude, {"share": draw.amplitude * draw.size.gain})
    return load_chain.LinearSensor(label, matrix)


def wrench_drift(draw: Draw) -> Effect:
    """The sensor's zero wanders."""
    force, torque = draw.size.drift
    rate = draw.amplitude * np.concatenate([force * draw.direction(), torque * draw.direction()])
    parameters = components("drift_f{}", rate[:3]) | components("drift_t{}", rate[3:])
    label = Label("load chain", "wrench_drift", SENSOR, draw.amplitude, parameters, same_law=True)
    return load_chain.WrenchDrift(label, rate)


def wrench_frame_misalignment(draw: Draw) -> Effect:
    """The sensor is mounted askew."""
    turn = draw.amplitude * draw.size.sensor_turn * draw.direction()
    label = Label(
        "load chain",
        "wrench_frame_misalignment",
        SENSOR,
        draw.amplitude,
        components("rotation_{}", turn),
        same_law=True,
    )
    return load_chain.SensorPlace(label, turn, np.zeros(3))


def wrench_point_offset(draw: Draw) -> Effect:
    """The wrench is taken at another point than stated."""
    shift = draw.amplitude * draw.size.wrench_point * draw.direction()
    label = Label(
        "load chain", "wrench_point_offset", SENSOR, draw.amplitude, components("offset_{}", shift), same_law=True
    )
    return load_chain.SensorPlace(label, np.zeros(3), shift)


def tool_weight(draw: Draw) -> Effect:
    """A tool that nobody weighed."""
    mass = draw.amplitude * draw.size.tool_mass
    label = Label("load chain", "tool_weight", {"tool": "tool"}, draw.amplitude, {"mass": mass}, same_law=True)
    return load_chain.ToolWeight(label, mass, np.array([0.0, 0.0, 0.15]))


def cable_force(draw: Draw) -> Effect:
    """A hose package."""
    force = draw.amplitude * draw.size.cable
    label = Label("load chain", "cable_force", {"tool": "tool"}, draw.amplitude, {"force": force})
    return load_chain.CablePull(label, "link_5", force, 0.5 * force)


def tracker_frame_misalignment(draw: Draw) -> Effect:
    """The tracker's registration is off."""
    turn = draw.amplitude * draw.size.tracker_turn * draw.direction()
    label = Label(
        "point chain",
        "tracker_frame_misalignment",
        TRACKER,
        draw.amplitude,
        components("rotation_{}", turn),
        same_law=True,
    )
    return point_chain.TrackerTurned(label, turn)


def tracker_scale(draw: Draw) -> Effect:
    """Refraction."""
    share = draw.sign() * draw.amplitude * draw.size.tracker_scale
    label = Label("point chain", "tracker_scale", TRACKER, draw.amplitude, {"scale": share}, same_law=True)
    return point_chain.TrackerScale(label, share)


def tracker_drift(draw: Draw) -> Effect:
    """Tracker and base drift apart."""
    velocity = draw.amplitude * draw.size.tracker_drift * draw.direction()
    rate = draw.amplitude * draw.size.tracker_rate * draw.direction()
    parameters = components("velocity_{}", velocity) | components("rate_{}", rate)
    label = Label("point chain", "tracker_drift", TRACKER, draw.amplitude, parameters)
    return point_chain.TrackerDrift(label, velocity, rate)


def measurement_point_offset(draw: Draw) -> Effect:
    """A target is not where the file says."""
    point = f"mp{1 + draw.among(0, 1, 2)}"
    shift = draw.amplitude * draw.size.point * draw.direction()
    label = Label(
        "point chain",
        "measurement_point_offset",
        {"point": point},
        draw.amplitude,
        components("offset_{}", shift),
        same_law=True,
    )
    return point_chain.PointOffset(label, point, shift)


def clock_offset(draw: Draw) -> Effect:
    """The sensor's clock is ahead."""
    seconds = draw.sign() * draw.amplitude * 0.1
    label = Label("point chain", "clock_offset", TRACKER, draw.amplitude, {"offset": seconds}, same_law=True)
    return point_chain.ClockOffset(label, seconds)
