"""Point chain: what stands between a point on the robot and the coordinates that are recorded."""

from __future__ import annotations

import dataclasses

import numpy as np

from calibration_core.timeseries import Float1D, Float3D
from calibration_sim.cell.sensors import Sensors
from calibration_sim.cell.truth import Truth
from calibration_sim.effect_models.effect import Effect, Session
from calibration_sim.mechanics.transforms import Placement, rotation_vector


@dataclasses.dataclass(frozen=True, eq=False)
class TrackerTurned(Effect):
    """The tracker frame is not turned as the cell file says.

    Attributes:
        turn: (3,) rad, rotation vector, base axes.
    """

    turn: Float1D

    def change_truth(self, truth: Truth) -> Truth:
        """Turn the tracker about its own place."""
        turned = Placement(rotation_vector(self.turn) @ truth.tracker.rotation, truth.tracker.translation)
        return dataclasses.replace(truth, tracker=turned)


@dataclasses.dataclass(frozen=True, eq=False)
class TrackerScale(Effect):
    """All lengths are read too long by a share (refraction, wavelength).

    Attributes:
        share: Relative.
    """

    share: float

    def see(self, points: Float3D, session: Session) -> Float3D:
        """Stretch."""
        return np.asarray((1.0 + self.share) * points)


@dataclasses.dataclass(frozen=True, eq=False)
class TrackerDrift(Effect):
    """Tracker and base drift apart, evenly.

    Attributes:
        velocity: (3,) m/s, tracker axes.
        rate: (3,) rad/s.
    """

    velocity: Float1D
    rate: Float1D

    def see(self, points: Float3D, session: Session) -> Float3D:
        """Add what has run up since the session began."""
        return np.asarray(points + session.time[:, None, None] * (self.velocity + np.cross(self.rate, points)))


@dataclasses.dataclass(frozen=True, eq=False)
class PointOffset(Effect):
    """A measurement point is not where the cell file says.

    Attributes:
        point: Its name.
        shift: (3,) m, flange frame.
    """

    point: str
    shift: Float1D

    def change_truth(self, truth: Truth) -> Truth:
        """Move it."""
        points = dict(truth.points)
        points[self.point] = points[self.point] + self.shift
        return dataclasses.replace(truth, points=points)


@dataclasses.dataclass(frozen=True, eq=False)
class ClockOffset(Effect):
    """The sensor's clock is ahead of everyone else's; only streams show it, tables of plateaus do not.

    Attributes:
        seconds: s.
    """

    seconds: float

    def change_sensors(self, sensors: Sensors) -> Sensors:
        """Set the clock."""
        return dataclasses.replace(
            sensors, force_torque=dataclasses.replace(sensors.force_torque, clock_offset=self.seconds)
        )
