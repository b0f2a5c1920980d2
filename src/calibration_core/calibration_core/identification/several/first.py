"""What is said of the set-up that was named first: its frames and points, as its own cell file calls them."""

from __future__ import annotations

import numpy as np

from calibration_core.identification.result.estimate import Identification
from calibration_core.identification.several.members import Member
from calibration_core.model.identified.gaussian import GaussianEstimate
from calibration_core.model.parameters import ModelParameters

POINTS, TRACKER = "measurement_points.", "tracker."
SET_UP = ("tracker", "point")  # groups of parameters that belong to no robot


def of_set_up(model: ModelParameters, member: Member, alone: Identification) -> ModelParameters:
    """Return a model of several set-ups with tracker pose and points of one of them.

    Args:
        model: Of all together.
        member: The one.
        alone: What it shows by itself.
    """
    tracker = alone.model.tracker
    if model.setups is not None:
        tracker = model.tracker @ model.setups[member.number - 1] @ tracker
    points = {name: np.array(point) for name, point in member.cell.frames.measurement_points.items()}
    points |= {name: model.points[member.point(name)] for name in member.readings.points}
    return model.replace(tracker=tracker, points=points, setups=None)


def estimate_of_set_up(estimate: GaussianEstimate, member: Member, alone: Identification) -> GaussianEstimate:
    """Return what is known of the numbers of `of_set_up`: what is shared, and the set-up's own points and tracker.

    The tracker pose, and points that displacements do not show, are known as the set-up shows them by itself.
    """
    mark = f"@{member.number}."
    others = (POINTS, TRACKER)
    kept = [k for k, name in enumerate(estimate.names) if mark in name or not name.startswith(others)]
    shared = estimate.chosen(kept)
    shared = shared.renamed([name.replace(mark, ".") for name in shared.names])
    own = [k for k, name in enumerate(alone.estimate.names) if name.startswith(others) and name not in shared.names]
    return GaussianEstimate.independent((shared, alone.estimate.chosen(own)))
