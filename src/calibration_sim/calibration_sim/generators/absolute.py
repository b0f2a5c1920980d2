"""Draws effects that show in absolute positions."""

from __future__ import annotations

import numpy as np

from calibration_sim.effect_models import absolute
from calibration_sim.effect_models.effect import Effect, Label
from calibration_sim.generators.draw import Draw, at_joint


def joint_zero_offset(draw: Draw) -> Effect:
    """An encoder's zero; the first and the last joint's are aliases of tracker and points."""
    j = draw.among(1, 2, 3, 4)
    offset = draw.sign() * draw.amplitude * draw.size.zero
    equivalent = ({"effect": "geometry_error", "location": at_joint(j)},)
    label = Label(
        "absolute", "joint_zero_offset", at_joint(j), draw.amplitude, {"offset": offset}, equivalent, same_law=True
    )
    return absolute.JointZero(label, j, offset)


def geometry_error(draw: Draw) -> Effect:
    """A joint's frame is shifted and turned on its link."""
    j = draw.among(1, 2, 3, 4)
    error = draw.amplitude * np.concatenate([draw.size.length * draw.direction(), draw.size.angle * draw.direction()])
    places = ({"link": f"link_{j}"}, {"link": f"link_{j + 1}"}, at_joint(j - 1))
    equivalent: tuple[dict[str, object], ...] = tuple({"effect": "geometry_error", "location": p} for p in places)
    equivalent += ({"effect": "joint_zero_offset", "location": at_joint(j)},)
    label = Label("absolute", "geometry_error", at_joint(j), draw.amplitude, {}, equivalent)
    return absolute.JointFrame(label, j, error)


def transmission_error(draw: Draw) -> Effect:
    """A gear that turns unevenly: two terms at least."""
    j = draw.among(0, 1, 2, 3, 4)
    size = draw.amplitude * draw.size.transmission
    orders = [int(draw.rng.integers(2, 5)), int(draw.rng.integers(5, 9))]
    terms = tuple(
        (order, size * share, float(draw.rng.uniform(0.0, 2.0 * np.pi)))
        for order, share in zip(orders, (1.0, 0.6), strict=True)
    )
    parameters = {f"amplitude_{order}": amplitude for order, amplitude, _ in terms}
    label = Label("absolute", "transmission_error", at_joint(j), draw.amplitude, parameters)
    return absolute.TransmissionError(label, j, terms)


def wrist_coupling(draw: Draw) -> Effect:
    """Hollow shafts."""
    joint, driver = (4, 3) if draw.among(0, 1) == 0 else (5, 4)
    share = draw.sign() * draw.amplitude * draw.size.wrist_coupling
    label = Label("absolute", "wrist_coupling", at_joint(joint), draw.amplitude, {"coupling": share}, same_law=True)
    return absolute.WristCoupling(label, joint, driver, share)


def joint_elasticity(draw: Draw) -> Effect:
    """Joints that sag, of which the file says nothing; the second and the third carry most of the weight."""
    equivalent = ({"effect": "joint_elasticity", "location": at_joint(2)},)
    label = Label("absolute", "joint_elasticity", at_joint(1), draw.amplitude, {}, equivalent)
    return absolute.ElasticJoints(label, draw.amplitude)


def thermal_growth(draw: Draw) -> Effect:
    """A robot that warms up."""
    rise = draw.amplitude * draw.size.warm_up
    parameters = {"expansion": absolute.EXPANSION}
    label = Label("absolute", "thermal_growth", {"robot": "robot"}, draw.amplitude, parameters, same_law=True)
    return absolute.WarmUp(label, rise, 1500.0)


def approach_direction(draw: Draw) -> Effect:
    """A joint that stops short."""
    j = draw.among(0, 1, 2, 3, 4)
    width = draw.amplitude * draw.size.approach
    label = Label("absolute", "approach_direction", at_joint(j), draw.amplitude, {"half_width": width})
    return absolute.ApproachDirection(label, j, width)
