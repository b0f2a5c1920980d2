"""What goes wrong in a measurement without being physics of the robot."""

from __future__ import annotations

import copy
import dataclasses
from collections.abc import Callable
from typing import Any

import numpy as np

from calibration_core.timeseries import Float3D
from calibration_sim.cell.sensors import Sensors, TrackerFaults
from calibration_sim.effects.draw import Draw
from calibration_sim.effects.effect import Acting, Effect, Label, Session, seen
from calibration_sim.mechanics.transforms import rotation_vector

POINTS = 3


def _label(draw: Draw, kind: str, location: str, configurations: tuple[int, ...] = ()) -> Label:
    place = {"point" if location.startswith("mp") else location: location}
    return draw.label("anomaly", kind, place, configurations=configurations)


def _since(draw: Draw) -> tuple[int, tuple[int, ...]]:
    """Return the index of the first configuration concerned, and the numbers from there on."""
    first = int(draw.rng.integers(draw.configurations // 4, draw.configurations - draw.configurations // 4))
    return first, tuple(range(first + 1, draw.configurations + 1))


def target_moved(draw: Draw) -> Effect:
    """A target that was knocked: it sits at another place of the plate from one configuration on."""
    point = draw.among(*range(POINTS))
    first, numbers = _since(draw)
    shift = draw.amplitude * float(draw.rng.uniform(1.0e-3, 3e-3)) * draw.direction()

    def move(points: Float3D, session: Session) -> Float3D:
        later = session.since(first)
        result = points.copy()
        result[later, point] += session.axes[later] @ shift
        return result

    return seen(_label(draw, "target_moved", f"mp{point + 1}", numbers), move)


def loose_target(draw: Draw) -> Effect:
    """A target that is loose in its nest: it stands a little differently at every step."""
    point = draw.among(*range(POINTS))
    size, seed = draw.amplitude * 1.2e-4, draw.seed()

    def shake(points: Float3D, session: Session) -> Float3D:
        result = points.copy()
        places = size * np.random.default_rng(seed).standard_normal((len(points), 3))
        result[:, point] += np.einsum("sij,sj->si", session.axes, places)
        return result

    return seen(_label(draw, "loose_target", f"mp{point + 1}"), shake)


def tracker_moved(draw: Draw) -> Effect:
    """A tracker that was bumped into: from one configuration on it stands elsewhere."""
    first, numbers = _since(draw)
    shift = draw.amplitude * float(draw.rng.uniform(1.5e-3, 4e-3)) * draw.direction()
    turn = draw.amplitude * float(draw.rng.uniform(2e-4, 6e-4)) * draw.direction()

    def bump(points: Float3D, session: Session) -> Float3D:
        later = session.since(first)
        result = points.copy()
        result[later] = result[later] @ rotation_vector(turn).T + shift
        return result

    return seen(_label(draw, "tracker_moved", "tracker", numbers), bump)


def _worse_tracker(label: Label, change: Callable[[TrackerFaults], TrackerFaults]) -> Effect:
    def worse(sensors: Sensors) -> Sensors:
        return dataclasses.replace(sensors, tracker=change(sensors.tracker))

    return Acting(label, {"change_sensors": worse})


def outlier_readings(draw: Draw) -> Effect:
    """Wild readings."""
    size = draw.amplitude * float(draw.rng.uniform(5e-4, 2e-3))
    label = _label(draw, "outlier_readings", "tracker")
    return _worse_tracker(label, lambda tracker: dataclasses.replace(tracker, outlier_rate=0.02, outlier_size=size))


def noise_understated(draw: Draw) -> Effect:
    """A tracker worse than its sheet."""
    factor = 1.0 + draw.amplitude * float(draw.rng.uniform(1.5, 3.0))
    label = _label(draw, "noise_understated", "tracker")
    return _worse_tracker(
        label, lambda tracker: dataclasses.replace(tracker, noise_factor=tracker.noise_factor * factor)
    )


def unsettled(draw: Draw) -> Effect:
    """An arm that still swings when it is read, in a third of the configurations: all points are off together."""
    indices = draw.some(max(3, draw.configurations // 3))
    size, seed = draw.amplitude * 8e-5, draw.seed()

    def swing(points: Float3D, session: Session) -> Float3D:
        swinging = np.isin(session.configuration, [session.numbers[k] for k in indices])
        swung = size * np.random.default_rng(seed).standard_normal((len(points), 1, 3))
        return np.asarray(points + np.where(swinging[:, None, None], swung, 0.0))

    return seen(_label(draw, "unsettled", "robot", tuple(k + 1 for k in indices)), swing)


def wrong_robot_file(draw: Draw) -> Effect:
    """A cell file of another robot of the family: one length is that of the longer or shorter variant."""
    row, key = ((1, "a"), (3, "d"))[int(draw.rng.integers(2))]
    scale = 0.2 if draw.size.tool_mass > 5.0 else 0.08
    change = float(draw.sign() * scale * np.clip(draw.amplitude, 0.5, 1.5))

    def write(cell: dict[str, Any]) -> dict[str, Any]:
        other = copy.deepcopy(cell)
        other["robot"]["dh"][draw.first + row][key] += change
        return other

    return Acting(_label(draw, "wrong_robot_file", "robot"), {"change_file": write})
