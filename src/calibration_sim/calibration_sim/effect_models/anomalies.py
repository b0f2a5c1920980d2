"""What goes wrong in a measurement without being physics of the robot."""

from __future__ import annotations

import copy
import dataclasses
from typing import Any

import numpy as np

from calibration_core.timeseries import Float1D, Float3D
from calibration_sim.cell.sensors import Sensors
from calibration_sim.effect_models.effect import Effect, Session
from calibration_sim.mechanics.transforms import rotation_vector


@dataclasses.dataclass(frozen=True, eq=False)
class TargetMoved(Effect):
    """A target sits at another place of the plate from one configuration on.

    Attributes:
        point: Index of the point.
        since: Index of the first configuration concerned.
        shift: (3,) m, flange frame.
    """

    point: int
    since: int
    shift: Float1D

    def see(self, points: Float3D, session: Session) -> Float3D:
        """Move it along with the plate."""
        later = np.isin(session.configuration, session.numbers[self.since :])
        result = points.copy()
        result[later, self.point] += session.axes[later] @ self.shift
        return result


@dataclasses.dataclass(frozen=True, eq=False)
class TargetLoose(Effect):
    """A target is loose in its nest: it stands a little differently at every step.

    Attributes:
        point: Index of the point.
        size: m, standard deviation per axis.
        seed: Of its places.
    """

    point: int
    size: float
    seed: int

    def see(self, points: Float3D, session: Session) -> Float3D:
        """Shake it."""
        rng = np.random.default_rng(self.seed)
        result = points.copy()
        places = self.size * rng.standard_normal((len(points), 3))
        result[:, self.point] += np.einsum("sij,sj->si", session.axes, places)
        return result


@dataclasses.dataclass(frozen=True, eq=False)
class TrackerMoved(Effect):
    """Someone bumped into the tracker: from one configuration on it stands elsewhere.

    Attributes:
        since: Index of the first configuration concerned.
        shift: (3,) m, tracker axes.
        turn: (3,) rad.
    """

    since: int
    shift: Float1D
    turn: Float1D

    def see(self, points: Float3D, session: Session) -> Float3D:
        """See everything moved."""
        later = np.isin(session.configuration, session.numbers[self.since :])
        result = points.copy()
        result[later] = result[later] @ rotation_vector(self.turn).T + self.shift
        return result


@dataclasses.dataclass(frozen=True, eq=False)
class Outliers(Effect):
    """Some readings are wild.

    Attributes:
        rate: Share of readings.
        size: m, standard deviation per coordinate.
    """

    rate: float
    size: float

    def change_sensors(self, sensors: Sensors) -> Sensors:
        """Spoil the tracker."""
        tracker = dataclasses.replace(sensors.tracker, outlier_rate=self.rate, outlier_size=self.size)
        return dataclasses.replace(sensors, tracker=tracker)


@dataclasses.dataclass(frozen=True, eq=False)
class NoiseUnderstated(Effect):
    """The tracker is worse than its sheet says.

    Attributes:
        factor: Real over claimed standard deviation.
    """

    factor: float

    def change_sensors(self, sensors: Sensors) -> Sensors:
        """Multiply the noise."""
        tracker = dataclasses.replace(sensors.tracker, noise_factor=sensors.tracker.noise_factor * self.factor)
        return dataclasses.replace(sensors, tracker=tracker)


@dataclasses.dataclass(frozen=True, eq=False)
class Unsettled(Effect):
    """In some configurations the arm still swings when it is read: all points are off together, each time elsewhere.

    Attributes:
        indices: Of the configurations concerned.
        size: m, standard deviation per axis.
        seed: Of the swing.
    """

    indices: tuple[int, ...]
    size: float
    seed: int

    def see(self, points: Float3D, session: Session) -> Float3D:
        """Swing."""
        rng = np.random.default_rng(self.seed)
        numbers = session.numbers
        swinging = np.isin(session.configuration, [numbers[k] for k in self.indices])
        swing = self.size * rng.standard_normal((len(points), 1, 3))
        return np.asarray(points + np.where(swinging[:, None, None], swing, 0.0))


@dataclasses.dataclass(frozen=True, eq=False)
class WrongFile(Effect):
    """The cell file describes another robot of the same family: one length is that of a longer or shorter variant.

    Attributes:
        row: Index of the DH row.
        key: `a` or `d`.
        change: m.
    """

    row: int
    key: str
    change: float

    def change_file(self, cell: dict[str, Any]) -> dict[str, Any]:
        """Write the other length."""
        other = copy.deepcopy(cell)
        other["robot"]["dh"][self.row][self.key] += self.change
        return other
