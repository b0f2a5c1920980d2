"""A calibrated robot: the identified model, how well it is known, and within which range that was seen.

model = read_calibrated("model.yaml", cell)      # from model_file
chain = chain_of(cell).corrected(model.parameters.geometry)
if model.estimate is not None:                   # a file without `parameters` has no intervals
    names, units, value, covariance = ...        # model.estimate: one GaussianEstimate of everything identified
sample = with_values(model.parameters, {"compliance.joint_2": 1.1e-6})
reasons = model.valid_range.outside(q, force, torque, temperature)
"""

from __future__ import annotations

import dataclasses

import numpy as np

from calibration_core.cell import Cell
from calibration_core.model.identified.gaussian import GaussianEstimate
from calibration_core.model.kinematics import cross, posture
from calibration_core.model.parameters import ModelParameters
from calibration_core.model.robot import chain_of
from calibration_core.model.statics import recorded_load
from calibration_core.timeseries import Float1D, Float2D, Readings, read_only

MARGIN = 1e-6  # rad, m, K and share of the load: what rounding puts outside is inside


@dataclasses.dataclass(frozen=True, eq=False)
class ValidRange:
    """What the recording covered; beyond it the model extrapolates.

    Attributes:
        joints: (n, 2) rad, m where a joint slides: smallest and largest.
        force: Smallest and largest size of the external force, N; zeros where none was applied.
        torque: The same of the torque about the wrench point, N*m.
        temperature: Smallest and largest, degrees Celsius; None where it was not recorded.
    """

    joints: Float2D
    force: tuple[float, float]
    torque: tuple[float, float]
    temperature: tuple[float, float] | None

    def __post_init__(self) -> None:
        """Copy to a read-only array; raise ValueError on a wrong shape."""
        object.__setattr__(self, "joints", read_only(self.joints))
        if self.joints.ndim != 2 or self.joints.shape[1] != 2:
            msg = f"joints: expected shape (n, 2), got {self.joints.shape}"
            raise ValueError(msg)

    def joint_outside(self, q: Float2D) -> np.ndarray[tuple[int, int], np.dtype[np.bool_]]:
        """Return (m, n) whether a joint of (m, n) rad stands outside what was covered."""
        return np.asarray((q < self.joints[:, 0] - MARGIN) | (q > self.joints[:, 1] + MARGIN))

    def load_outside(self, force: Float1D, torque: Float1D) -> np.ndarray[tuple[int], np.dtype[np.bool_]]:
        """Return (m,) whether sizes of force (m,) N or torque (m,) N*m exceed the largest that were applied."""
        beyond = [size > (1 + MARGIN) * limit[1] for size, limit in ((force, self.force), (torque, self.torque))]
        return np.asarray(beyond[0] | beyond[1])

    def temperature_outside(self, temperature: Float1D) -> np.ndarray[tuple[int], np.dtype[np.bool_]]:
        """Return (m,) whether temperatures (m,) lie outside what was covered; False where one is not known."""
        if self.temperature is None:
            return np.zeros(len(temperature), dtype=bool)
        low, high = self.temperature
        return np.asarray((temperature < low - MARGIN) | (temperature > high + MARGIN))

    def and_of(self, other: ValidRange) -> ValidRange:
        """Return what two recordings of one robot cover together."""
        both = [self.temperature, other.temperature]
        known = [one for one in both if one is not None]
        return ValidRange(
            np.column_stack([
                np.minimum(self.joints[:, 0], other.joints[:, 0]), np.maximum(self.joints[:, 1], other.joints[:, 1])
            ]),
            (min(self.force[0], other.force[0]), max(self.force[1], other.force[1])),
            (min(self.torque[0], other.torque[0]), max(self.torque[1], other.torque[1])),
            (min(one[0] for one in known), max(one[1] for one in known)) if known else None,
        )  # fmt: skip


WITHOUT_INTERVALS = "The model file states no covariance: nothing that is taken from it has an interval."
"""What every command that reads such a file says, once."""


@dataclasses.dataclass(frozen=True, eq=False)
class CalibratedModel:
    """The content of a model file.

    Attributes:
        parameters: The identified, or extended, model.
        estimate: Everything identified with its joint covariance; None: nothing was identified, there are no intervals.
        valid_range: What the recording covered; None where the file does not say.
    """

    parameters: ModelParameters
    estimate: GaussianEstimate | None
    valid_range: ValidRange | None


def range_of(readings: Readings, cell: Cell, parameters: ModelParameters) -> ValidRange:
    """Return what a recording covers.

    Raises:
        CellError: The robot cannot be read, or a frame that the wrench needs is missing.
    """
    known = readings.temperature[np.isfinite(readings.temperature)]
    sizes = np.zeros((2, 1)) if readings.wrench is None else _sizes(readings, cell, parameters)
    return ValidRange(
        joints=np.column_stack([readings.q.min(axis=0), readings.q.max(axis=0)]),
        force=(float(sizes[0].min()), float(sizes[0].max())),
        torque=(float(sizes[1].min()), float(sizes[1].max())),
        temperature=(float(known.min()), float(known.max())) if len(known) else None,
    )


def _sizes(readings: Readings, cell: Cell, parameters: ModelParameters) -> Float2D:
    """Return the sizes (2, m) of force, N, and of torque about the wrench point, N*m."""
    assert readings.wrench is not None  # noqa: S101 - asked for only where one was recorded
    at = posture(chain_of(cell).corrected(parameters.geometry), readings.q)
    force, torque, where = recorded_load(readings.wrench, cell, parameters).in_base(at)
    if parameters.wrench_point is not None:
        torque = torque + cross(where - at.point(parameters.wrench_point), force)
    return np.stack([np.linalg.norm(force, axis=0), np.linalg.norm(torque, axis=0)])
