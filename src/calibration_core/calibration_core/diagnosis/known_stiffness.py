"""What a loaded recording says of the joints' compliances, used where absolute positions depend on them.

Sag under the robot's own weight resembles the first harmonics of transmissions.  Compliances that loaded steps tell are
therefore not fitted to absolute positions again: they are considered, that is, held, and their covariance enters that
of everything fitted beside them.  A joint whose doubt is large against the noise of the positions is fitted again, with
what the loads tell as its prior.
Source: Schmidt 1966 (consider covariance).
"""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence

import numpy as np

from calibration_core.diagnosis.finding import Diagnosis
from calibration_core.model.effects.candidate import Candidate
from calibration_core.model.effects.priors import typical
from calibration_core.timeseries import Float1D, Float2D

LOOSE = 0.5  # of the noise of one coordinate: a compliance whose doubt moves the points by more is fitted again


@dataclasses.dataclass(frozen=True, eq=False)
class KnownCompliance:
    """Compliances with their doubt.

    Attributes:
        joints: Names of the n joints.
        value: (n,) rad/(N*m).
        covariance: (n, n), of the estimate and of the gain that all axes of the sensor may share.
    """

    joints: tuple[str, ...]
    value: Float1D
    covariance: Float2D

    def std(self, joint: str) -> float:
        """Return the standard deviation of one compliance, rad/(N*m)."""
        index = self.joints.index(joint)
        return float(np.sqrt(self.covariance[index, index]))

    def of(self, joints: Sequence[str]) -> Float2D:
        """Return the (k, k) covariance of some joints."""
        index = [self.joints.index(joint) for joint in joints]
        return self.covariance[np.ix_(index, index)]


@dataclasses.dataclass(frozen=True, eq=False)
class Considered:
    """What is known of compliances beside a fit.

    Attributes:
        candidates: `joint_elasticity` of the k joints that are held.
        covariance: (k, k) of those, (rad/(N*m))^2.
        expected: (f,) of the free ones, rad/(N*m); empty where nothing is known of them.
        root: (f, f) inverse square root of their covariance, N*m/rad: `root @ (c - expected)` is standard normal.
    """

    candidates: tuple[Candidate, ...] = ()
    covariance: Float2D = dataclasses.field(default_factory=lambda: np.zeros((0, 0)))
    expected: Float1D = dataclasses.field(default_factory=lambda: np.zeros(0))
    root: Float2D = dataclasses.field(default_factory=lambda: np.zeros((0, 0)))


def known_compliance(loaded: Diagnosis, rated_load: float) -> KnownCompliance | None:
    """Return what the diagnosis of loaded steps says of the compliances; None where they cannot be relied upon.

    Args:
        loaded: The diagnosis.
        rated_load: kg.
    """
    covariance = loaded.compliance_covariance
    if covariance is None or loaded.rest.significant or np.any(loaded.compliance <= 0):
        return None
    gain = typical("wrench_gain", rated_load) * loaded.compliance
    joints = loaded.identification.model.joints
    return KnownCompliance(joints, loaded.compliance, np.asarray(covariance + np.outer(gain, gain)))


def divided(
    known: KnownCompliance, offered: Sequence[Candidate], size: Sequence[float]
) -> tuple[tuple[Candidate, ...], Considered]:
    """Divide compliances into those that are fitted, with a prior, and those that are held.

    Args:
        known: What is known.
        offered: `joint_elasticity` of the joints that the weight loads.
        size: Root mean square of what each moves, per unit, in units of the noise of one coordinate.
    """
    doubts = [known.std(str(c.location["joint"])) * s for c, s in zip(offered, size, strict=True)]
    free = tuple(c for c, doubt in zip(offered, doubts, strict=True) if doubt > LOOSE)
    held = tuple(c for c, doubt in zip(offered, doubts, strict=True) if doubt <= LOOSE)
    names = [str(c.location["joint"]) for c in free]
    root = np.linalg.inv(np.linalg.cholesky(known.of(names)))
    expected = known.value[[known.joints.index(name) for name in names]]
    return free, Considered(held, known.of([str(c.location["joint"]) for c in held]), expected, root)
