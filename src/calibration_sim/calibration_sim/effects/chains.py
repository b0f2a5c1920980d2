"""Load chain and point chain: what stands between the load or a point on the robot and what is recorded of it."""

from __future__ import annotations

import dataclasses

import numpy as np

from calibration_core.timeseries import Float1D, Float2D
from calibration_sim.cell.sensors import Sensors
from calibration_sim.cell.truth import Truth
from calibration_sim.effects.draw import Draw, components
from calibration_sim.effects.effect import Acting, At, Effect, Label, Session, otherwise, seen
from calibration_sim.mechanics.chain import Chain
from calibration_sim.mechanics.statics import Push
from calibration_sim.mechanics.transforms import Placement, rotation_vector

SENSOR, TRACKER = {"sensor": "force_torque"}, {"tracker": "tracker"}
TOOL_CENTRE = (0.0, 0.0, 0.15)  # m, of mass, flange frame


@dataclasses.dataclass(frozen=True, eq=False)
class SensorHysteresis(Effect):
    """A strain-gauge sensor lags: each channel's error follows the load up to a limit and stays there until it turns.

    Attributes:
        half_width: (6,) N and N*m.
        radius: (6,) N and N*m, change of load after which the error has turned over.
    """

    half_width: Float1D
    radius: Float1D

    def report(self, wrench: Float2D, session: Session) -> Float2D:
        """Run a stop operator along the session."""
        error = np.zeros(6)
        shown = np.empty_like(wrench)
        last = np.zeros(6)
        for k, now in enumerate(wrench):
            error = np.clip(error + (now - last), -self.radius, self.radius)
            shown[k] = now - self.half_width * error / self.radius
            last = now
        return shown


def _linear(label: Label, matrix: Float2D) -> Effect:
    """Return a sensor that shows (I + matrix) times the wrench, N and N*m."""
    return Acting(label, {"report": lambda wrench, session: np.asarray(wrench + wrench @ matrix.T)})


def wrench_gain(draw: Draw) -> Effect:
    """One axis shows too much or too little."""
    axis = draw.among(0, 1, 2)
    gain = draw.sign() * draw.amplitude * draw.size.gain
    matrix = np.zeros((6, 6))
    matrix[axis, axis] = gain
    label = draw.label("load chain", "wrench_gain", SENSOR, {f"gain_f{'xyz'[axis]}": gain}, same_law=True)
    return _linear(label, matrix)


def wrench_crosstalk(draw: Draw) -> Effect:
    """Every axis shows something of every other."""
    ranges = np.repeat([1.0, 0.3], 3)
    matrix = draw.amplitude * draw.size.gain * draw.rng.standard_normal((6, 6)) * ranges[:, None] / ranges
    matrix[np.diag_indices(6)] = 0.0
    share = draw.amplitude * draw.size.gain
    return _linear(draw.label("load chain", "wrench_crosstalk", SENSOR, {"share": share}), matrix)


def wrench_drift(draw: Draw) -> Effect:
    """The sensor's zero wanders, evenly."""
    force, torque = draw.size.drift
    rate = draw.amplitude * np.concatenate([force * draw.direction(), torque * draw.direction()])
    parameters = components("drift_f{}", rate[:3]) | components("drift_t{}", rate[3:])
    label = draw.label("load chain", "wrench_drift", SENSOR, parameters, same_law=True)
    return Acting(label, {"report": lambda wrench, session: np.asarray(wrench + session.time[:, None] * rate)})


def _sensor_place(label: Label, turn: Float1D, shift: Float1D) -> Effect:
    """Return a sensor that is turned in its stated axes ((3,) rad) and shifted in the flange frame ((3,) m)."""

    def place(truth: Truth) -> dict[str, Placement]:
        stated = truth.force_torque
        moved = Placement(stated.rotation @ rotation_vector(turn), stated.translation + shift)
        return {"force_torque": moved}

    return otherwise(label, place)


def wrench_frame_misalignment(draw: Draw) -> Effect:
    """The sensor is mounted askew."""
    turn = draw.amplitude * draw.size.sensor_turn * draw.direction()
    parameters = components("rotation_{}", turn)
    label = draw.label("load chain", "wrench_frame_misalignment", SENSOR, parameters, same_law=True)
    return _sensor_place(label, turn, np.zeros(3))


def wrench_point_offset(draw: Draw) -> Effect:
    """The wrench is taken at another point than stated."""
    shift = draw.amplitude * draw.size.wrench_point * draw.direction()
    label = draw.label("load chain", "wrench_point_offset", SENSOR, components("offset_{}", shift), same_law=True)
    return _sensor_place(label, np.zeros(3), shift)


def tool_weight(draw: Draw) -> Effect:
    """A tool hangs on the flange that nobody weighed; the sensor was tared with it."""
    mass = draw.amplitude * draw.size.tool_mass

    def heavier(chain: Chain) -> Chain:
        links = list(chain.links)
        flange = links[chain.flange]
        total = flange.mass + mass
        com = (flange.mass * flange.com + mass * np.array(TOOL_CENTRE)) / total
        links[chain.flange] = dataclasses.replace(flange, mass=total, com=com)
        return dataclasses.replace(chain, links=tuple(links))

    label = draw.label("load chain", "tool_weight", {"tool": "tool"}, {"mass": mass}, same_law=True)
    return Acting(label, {"change_chain": heavier})


def cable_force(draw: Draw) -> Effect:
    """The hose package pulls at the wrist, more or less and to one side or the other as the wrist turns."""
    pull, first = draw.amplitude * draw.size.cable, draw.first
    swing, back = 0.5 * pull, np.array([0.0, 0.0, 0.3])

    def pushes(at: At) -> tuple[Push, ...]:
        wrist = float(at.q[first + 3] + 0.5 * at.q[first + 5])
        side = swing * np.array([np.sin(wrist), np.cos(wrist), 0.0])

        def force(place: Float1D) -> Float1D:
            towards = back - place
            return np.asarray(pull * towards / np.linalg.norm(towards) + side)

        return (Push(f"link_{first + 5}", np.zeros(3), force),)

    label = draw.label("load chain", "cable_force", {"tool": "tool"}, {"force": pull})
    return Acting(label, {"pushes": pushes})


def tracker_frame_misalignment(draw: Draw) -> Effect:
    """The tracker's registration is off: it is turned about its own place."""
    turn = draw.amplitude * draw.size.tracker_turn * draw.direction()
    parameters = components("rotation_{}", turn)
    label = draw.label("point chain", "tracker_frame_misalignment", TRACKER, parameters, same_law=True)

    def place(truth: Truth) -> dict[str, Placement]:
        return {"tracker": Placement(rotation_vector(turn) @ truth.tracker.rotation, truth.tracker.translation)}

    return otherwise(label, place)


def tracker_scale(draw: Draw) -> Effect:
    """All lengths are read too long by a share (refraction, wavelength)."""
    share = draw.sign() * draw.amplitude * draw.size.tracker_scale
    label = draw.label("point chain", "tracker_scale", TRACKER, {"scale": share}, same_law=True)
    return seen(label, lambda points, session: np.asarray((1.0 + share) * points))


def tracker_drift(draw: Draw) -> Effect:
    """Tracker and base drift apart, evenly."""
    velocity = draw.amplitude * draw.size.tracker_drift * draw.direction()
    rate = draw.amplitude * draw.size.tracker_rate * draw.direction()
    parameters = components("velocity_{}", velocity) | components("rate_{}", rate)
    label = draw.label("point chain", "tracker_drift", TRACKER, parameters)
    return seen(
        label,
        lambda points, session: np.asarray(points + session.time[:, None, None] * (velocity + np.cross(rate, points))),
    )


def measurement_point_offset(draw: Draw) -> Effect:
    """A target is not where the file says."""
    point = f"mp{1 + draw.among(0, 1, 2)}"
    shift, place = draw.amplitude * draw.size.point * draw.direction(), {"point": point}
    parameters = components("offset_{}", shift)
    label = draw.label("point chain", "measurement_point_offset", place, parameters, same_law=True)
    return otherwise(label, lambda truth: {"points": {**truth.points, point: truth.points[point] + shift}})


def clock_offset(draw: Draw) -> Effect:
    """The sensor's clock is ahead of everyone else's; only streams show it, tables of plateaus do not."""
    seconds = draw.sign() * draw.amplitude * 0.1

    def ahead(sensors: Sensors) -> Sensors:
        clock = dataclasses.replace(sensors.force_torque, clock_offset=seconds)
        return dataclasses.replace(sensors, force_torque=clock)

    label = draw.label("point chain", "clock_offset", TRACKER, {"offset": seconds}, same_law=True)
    return Acting(label, {"change_sensors": ahead})
