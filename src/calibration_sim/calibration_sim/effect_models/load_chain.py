"""Load chain: what stands between the load on the robot and the wrench that is recorded."""

from __future__ import annotations

import dataclasses

import numpy as np

from calibration_core.timeseries import Float1D, Float2D
from calibration_sim.cell.truth import Truth
from calibration_sim.effect_models.effect import At, Effect, Session
from calibration_sim.mechanics.chain import Chain
from calibration_sim.mechanics.statics import Push
from calibration_sim.mechanics.transforms import Placement, rotation_vector


@dataclasses.dataclass(frozen=True, eq=False)
class LinearSensor(Effect):
    """The sensor shows a linear function of the wrench: gains on the diagonal, cross-talk beside it.

    Attributes:
        matrix: (6, 6) shown wrench = (I + matrix) true wrench, N and N*m.
    """

    matrix: Float2D

    def report(self, wrench: Float2D, session: Session) -> Float2D:
        """Show it."""
        return np.asarray(wrench + wrench @ self.matrix.T)


@dataclasses.dataclass(frozen=True, eq=False)
class WrenchDrift(Effect):
    """The sensor's zero wanders, evenly.

    Attributes:
        rate: (6,) N/s and N*m/s.
    """

    rate: Float1D

    def report(self, wrench: Float2D, session: Session) -> Float2D:
        """Add what has run up since the session began."""
        return np.asarray(wrench + session.time[:, None] * self.rate)


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


@dataclasses.dataclass(frozen=True, eq=False)
class SensorPlace(Effect):
    """The sensor is not where the cell file says: turned, or at another place.

    Attributes:
        turn: (3,) rad, rotation vector in the sensor's stated axes.
        shift: (3,) m, flange frame.
    """

    turn: Float1D
    shift: Float1D

    def change_truth(self, truth: Truth) -> Truth:
        """Move the sensor."""
        stated = truth.force_torque
        moved = Placement(stated.rotation @ rotation_vector(self.turn), stated.translation + self.shift)
        return dataclasses.replace(truth, force_torque=moved)


@dataclasses.dataclass(frozen=True, eq=False)
class ToolWeight(Effect):
    """A tool hangs on the flange that nobody weighed; the sensor was tared with it.

    Attributes:
        mass: kg.
        com: (3,) m, flange frame.
    """

    mass: float
    com: Float1D

    def change_chain(self, chain: Chain) -> Chain:
        """Make the flange heavier."""
        links = list(chain.links)
        flange = links[chain.flange]
        total = flange.mass + self.mass
        com = (flange.mass * flange.com + self.mass * self.com) / total
        links[chain.flange] = dataclasses.replace(flange, mass=total, com=com)
        return dataclasses.replace(chain, links=tuple(links))


@dataclasses.dataclass(frozen=True, eq=False)
class CablePull(Effect):
    """The hose package pulls at the wrist, more or less and to one side or the other as the wrist turns.

    Attributes:
        link: Name of the link it is tied to.
        force: N, mean pull towards the base.
        swing: N, amplitude across, following the fourth and sixth joint.
    """

    link: str
    force: float
    swing: float

    def pushes(self, at: At) -> tuple[Push, ...]:
        """Pull."""
        wrist = float(at.q[3] + 0.5 * at.q[5])
        side = self.swing * np.array([np.sin(wrist), np.cos(wrist), 0.0])
        back = np.array([0.0, 0.0, 0.3])

        def force(place: Float1D) -> Float1D:
            towards = back - place
            return np.asarray(self.force * towards / np.linalg.norm(towards) + side)

        return (Push(self.link, np.zeros(3), force),)
