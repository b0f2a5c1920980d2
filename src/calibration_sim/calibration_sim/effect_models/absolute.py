"""What shows in absolute positions: geometry, gears that do not turn evenly, heat, and where a joint came from."""

from __future__ import annotations

import copy
import dataclasses
from typing import Any

import numpy as np

from calibration_core.timeseries import Float1D
from calibration_sim.cell.truth import Truth
from calibration_sim.effect_models.effect import At, Effect

EXPANSION = 12e-6  # 1/K, steel
USUAL = 20.0  # degrees Celsius


@dataclasses.dataclass(frozen=True, eq=False)
class JointZero(Effect):
    """An encoder's zero is wrong.

    Attributes:
        joint: Index in the order of q.
        offset: rad, true minus read.
    """

    joint: int
    offset: float

    def change_truth(self, truth: Truth) -> Truth:
        """Turn the joint."""
        zero = np.array(truth.joint_zero)
        zero[self.joint] += self.offset
        return dataclasses.replace(truth, joint_zero=zero)


@dataclasses.dataclass(frozen=True, eq=False)
class JointFrame(Effect):
    """A joint's frame stands wrong on the link before it.

    Attributes:
        joint: Index in the order of q.
        error: (6,) m and rad (rotation vector), in the joint's nominal axes.
    """

    joint: int
    error: Float1D

    def change_truth(self, truth: Truth) -> Truth:
        """Move it."""
        errors = np.array(truth.joint_frame_errors)
        errors[self.joint] += self.error
        return dataclasses.replace(truth, joint_frame_errors=errors)


@dataclasses.dataclass(frozen=True, eq=False)
class TransmissionError(Effect):
    """A gear does not turn evenly: sum of A sin(k q + phi).

    Attributes:
        joint: Index in the order of q.
        terms: Harmonic (cycles per joint revolution), amplitude (rad), phase (rad).
    """

    joint: int
    terms: tuple[tuple[int, float, float], ...]

    def deflect(self, memory: None, torque: Float1D, at: At) -> Float1D:
        """Run ahead or lag."""
        result = np.zeros(len(torque))
        q = float(at.q[self.joint])
        result[self.joint] = sum(size * np.sin(k * q + phase) for k, size, phase in self.terms)
        return result


@dataclasses.dataclass(frozen=True, eq=False)
class WristCoupling(Effect):
    """Hollow shafts in the wrist: a joint turns a little with another.

    Attributes:
        joint: Index of the one that is turned along.
        driver: Index of the one that turns it.
        share: rad/rad.
    """

    joint: int
    driver: int
    share: float

    def deflect(self, memory: None, torque: Float1D, at: At) -> Float1D:
        """Turn along."""
        result = np.zeros(len(torque))
        result[self.joint] = self.share * at.q[self.driver]
        return result


@dataclasses.dataclass(frozen=True, eq=False)
class ElasticJoints(Effect):
    """The cell file knows of no elasticity, and all joints sag under the robot's own weight.

    Attributes:
        share: Compliance over what is typical.
    """

    share: float

    def change_truth(self, truth: Truth) -> Truth:
        """Soften all joints."""
        return dataclasses.replace(truth, stiffness=truth.stiffness / self.share)

    def change_file(self, cell: dict[str, Any]) -> dict[str, Any]:
        """Leave the stiffnesses out."""
        rigid = copy.deepcopy(cell)
        del rigid["robot"]["stiffness"]
        return rigid


@dataclasses.dataclass(frozen=True, eq=False)
class WarmUp(Effect):
    """The robot warms up during the session; all links grow, and the thermometer shows it.

    Attributes:
        rise: K, in the end.
        constant: s, to 63 % of it.
    """

    rise: float
    constant: float

    def temperature(self, time: Float1D) -> Float1D:
        """Approach the final temperature."""
        return np.asarray(self.rise * (1.0 - np.exp(-time / self.constant)))

    def growth(self, at: At) -> float:
        """Expand as steel."""
        return EXPANSION * (at.temperature - USUAL)


@dataclasses.dataclass(frozen=True, eq=False)
class ApproachDirection(Effect):
    """A joint stops short of where it was sent, on the side that it came from.

    Attributes:
        joint: Index in the order of q.
        half_width: rad.
    """

    joint: int
    half_width: float

    def deflect(self, memory: None, torque: Float1D, at: At) -> Float1D:
        """Lag."""
        result = np.zeros(len(torque))
        result[self.joint] = -self.half_width * at.approach[self.joint]
        return result
