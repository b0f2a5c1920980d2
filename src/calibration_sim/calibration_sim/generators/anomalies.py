"""Draws what goes wrong in a measurement without being physics of the robot."""

from __future__ import annotations

import numpy as np

from calibration_sim.effect_models import anomalies
from calibration_sim.effect_models.effect import Effect, Label
from calibration_sim.generators.draw import Draw

POINTS = 3


def _label(kind: str, location: dict[str, str], draw: Draw, configurations: tuple[int, ...] = ()) -> Label:
    return Label("anomaly", kind, location, draw.amplitude, configurations=configurations)


def _since(draw: Draw) -> tuple[int, tuple[int, ...]]:
    """Return the index of the first configuration concerned, and the numbers from there on."""
    first = int(draw.rng.integers(draw.configurations // 4, draw.configurations - draw.configurations // 4))
    return first, tuple(range(first + 1, draw.configurations + 1))


def target_moved(draw: Draw) -> Effect:
    """A target that was knocked and put back."""
    point = draw.among(*range(POINTS))
    first, numbers = _since(draw)
    shift = draw.amplitude * float(draw.rng.uniform(1.0e-3, 3e-3)) * draw.direction()
    label = _label("target_moved", {"point": f"mp{point + 1}"}, draw, numbers)
    return anomalies.TargetMoved(label, point, first, shift)


def loose_target(draw: Draw) -> Effect:
    """A target that sits loose."""
    point = draw.among(*range(POINTS))
    label = _label("loose_target", {"point": f"mp{point + 1}"}, draw)
    return anomalies.TargetLoose(label, point, draw.amplitude * 1.2e-4, draw.seed())


def tracker_moved(draw: Draw) -> Effect:
    """A tracker that was bumped into."""
    first, numbers = _since(draw)
    shift = draw.amplitude * float(draw.rng.uniform(1.5e-3, 4e-3)) * draw.direction()
    turn = draw.amplitude * float(draw.rng.uniform(2e-4, 6e-4)) * draw.direction()
    return anomalies.TrackerMoved(_label("tracker_moved", {"tracker": "tracker"}, draw, numbers), first, shift, turn)


def outlier_readings(draw: Draw) -> Effect:
    """Wild readings."""
    size = draw.amplitude * float(draw.rng.uniform(5e-4, 2e-3))
    return anomalies.Outliers(_label("outlier_readings", {"tracker": "tracker"}, draw), 0.02, size)


def noise_understated(draw: Draw) -> Effect:
    """A tracker worse than its sheet."""
    factor = 1.0 + draw.amplitude * float(draw.rng.uniform(1.5, 3.0))
    return anomalies.NoiseUnderstated(_label("noise_understated", {"tracker": "tracker"}, draw), factor)


def unsettled(draw: Draw) -> Effect:
    """An arm that was not left time to come to rest, in a third of the configurations."""
    count = max(3, draw.configurations // 3)
    indices = tuple(sorted(int(k) for k in draw.rng.choice(draw.configurations, count, replace=False)))
    label = _label("unsettled", {"robot": "robot"}, draw, tuple(k + 1 for k in indices))
    return anomalies.Unsettled(label, indices, draw.amplitude * 8e-5, draw.seed())


def wrong_robot_file(draw: Draw) -> Effect:
    """A file of the longer or shorter variant."""
    row, key = ((1, "a"), (3, "d"))[int(draw.rng.integers(2))]
    scale = 0.2 if draw.size.tool_mass > 5.0 else 0.08
    change = float(draw.sign() * scale * np.clip(draw.amplitude, 0.5, 1.5))
    return anomalies.WrongFile(_label("wrong_robot_file", {"robot": "robot"}, draw), row, key, change)
