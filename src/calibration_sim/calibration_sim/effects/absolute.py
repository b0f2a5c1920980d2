"""What shows in absolute positions: geometry, gears that do not turn evenly, heat, and where a joint came from."""

from __future__ import annotations

import copy
import dataclasses
from typing import Any

import numpy as np

from calibration_core.timeseries import Float1D
from calibration_sim.cell.truth import Truth
from calibration_sim.effects.draw import Draw
from calibration_sim.effects.effect import Acting, At, Effect, Label, moving, otherwise

EXPANSION = 12e-6  # 1/K, steel
USUAL = 20.0  # degrees Celsius
SLOPE = 5e-3  # rad, 5 mm per metre
WARM = 1500.0  # s, to 63 % of the final temperature


def _added(values: Float1D, joint: int, more: Any) -> Float1D:
    result = np.array(values)
    result[joint] += more
    return result


def joint_zero_offset(draw: Draw) -> Effect:
    """An encoder's zero; the first and the last joint's are aliases of tracker and points."""
    j = draw.among(1, 2, 3, 4)
    offset, joint = draw.sign() * draw.amplitude * draw.size.zero, draw.first + j
    alike = (("geometry_error", draw.at(j)),)
    label = draw.label("absolute", "joint_zero_offset", draw.at(j), {"offset": offset}, alike, same_law=True)
    return otherwise(label, lambda truth: {"joint_zero": _added(truth.joint_zero, joint, offset)})


def geometry_error(draw: Draw) -> Effect:
    """A joint's frame is shifted and turned on its link."""
    j = draw.among(1, 2, 3, 4)
    error = draw.amplitude * np.concatenate([draw.size.length * draw.direction(), draw.size.angle * draw.direction()])
    places = (draw.link(j - 1), draw.link(j), draw.at(j - 1))
    alike = (*(("geometry_error", place) for place in places), ("joint_zero_offset", draw.at(j)))
    label, joint = draw.label("absolute", "geometry_error", draw.at(j), alike=alike), draw.first + j
    return otherwise(label, lambda truth: {"joint_frame_errors": _added(truth.joint_frame_errors, joint, error)})


def transmission_error(draw: Draw) -> Effect:
    """A gear that turns unevenly: two terms at least."""
    j = draw.among(0, 1, 2, 3, 4)
    size = draw.amplitude * draw.size.transmission
    orders = [int(draw.rng.integers(2, 5)), int(draw.rng.integers(5, 9))]
    terms = tuple((order, size * share, draw.phase()) for order, share in zip(orders, (1.0, 0.6), strict=True))
    parameters = {f"amplitude_{order}": amplitude for order, amplitude, _ in terms}
    return uneven_gear(draw.label("absolute", "transmission_error", draw.at(j), parameters), draw.first + j, terms)


def uneven_gear(label: Label, joint: int, terms: tuple[tuple[int, float, float], ...]) -> Effect:
    """Return the sum of A sin(k q + phi); terms are k (cycles per revolution of the joint), A and phi (rad)."""

    def turn(torque: Float1D, at: At) -> dict[int, float]:
        q = float(at.q[joint])
        return {joint: sum(size * np.sin(k * q + phase) for k, size, phase in terms)}

    return moving(label, turn)


def wrist_coupling(draw: Draw) -> Effect:
    """Hollow shafts in the wrist: a joint turns a little with the one before it."""
    j = 4 if draw.among(0, 1) == 0 else 5
    share, joint = draw.sign() * draw.amplitude * draw.size.wrist_coupling, draw.first + j
    label = draw.label("absolute", "wrist_coupling", draw.at(j), {"coupling": share}, same_law=True)
    return moving(label, lambda torque, at: {joint: share * at.q[joint - 1]})


def joint_elasticity(draw: Draw) -> Effect:
    """Joints that sag, of which the file says nothing; the second and the third carry most of the weight."""
    label = draw.label("absolute", "joint_elasticity", draw.at(1), alike=(("joint_elasticity", draw.at(2)),))
    return elastic_joints(label, draw.amplitude)


def elastic_joints(label: Label, share: float | Float1D) -> Effect:
    """Return joints that are softer than typical by a share, or each by its own (n,), of which no cell file knows."""

    def soften(truth: Truth) -> Truth:
        return dataclasses.replace(truth, stiffness=truth.stiffness / share)

    def leave_out(cell: dict[str, Any]) -> dict[str, Any]:
        rigid = copy.deepcopy(cell)
        del rigid["robot"]["stiffness"]
        return rigid

    return Acting(label, {"change_truth": soften, "change_file": leave_out})


def gravity_direction(draw: Draw) -> Effect:
    """The robot stands on a floor that slopes, of which its file says nothing."""
    tilt, way = draw.amplitude * SLOPE, draw.phase()
    axis = np.array([np.cos(way), np.sin(way), 0.0])

    def turn(truth: Truth) -> dict[str, Float1D]:
        return {"gravity": np.cos(tilt) * truth.gravity + np.sin(tilt) * np.cross(axis, truth.gravity)}

    return otherwise(draw.label("absolute", "gravity_direction", {"base": "base"}, same_law=True), turn)


def thermal_growth(draw: Draw) -> Effect:
    """The robot warms up during the session; all links grow, and the thermometer shows it."""
    rise = draw.amplitude * draw.size.warm_up
    label = draw.label("absolute", "thermal_growth", {"robot": "robot"}, {"expansion": EXPANSION}, same_law=True)
    return Acting(
        label,
        {
            "temperature": lambda time: np.asarray(rise * (1.0 - np.exp(-time / WARM))),
            "growth": lambda at: EXPANSION * (at.temperature - USUAL),
        },
    )


def approach_direction(draw: Draw) -> Effect:
    """A joint stops short of where it was sent, on the side that it came from."""
    j = draw.among(0, 1, 2, 3, 4)
    width, joint = draw.amplitude * draw.size.approach, draw.first + j
    label = draw.label("absolute", "approach_direction", draw.at(j), {"half_width": width})
    return moving(label, lambda torque, at: {joint: -width * at.approach[joint]})
