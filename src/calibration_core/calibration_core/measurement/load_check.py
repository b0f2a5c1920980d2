"""Whether the load that pulls is the one that was planned: the sensor's word against the plan's.

A plan states the wrench at the wrench point in base axes.  The sensor says what pulls at its own origin, in axes that
turn with the flange, together with the tool's weight and whatever its last tare left.  What counts is the difference
to the unloaded robot in the same posture: tool weight, tare and bias are the same in both, and cancel.  It is turned
to base axes with the joint angles, and its torque taken about the wrench point.
"""

from __future__ import annotations

import dataclasses
import math

import numpy as np

from calibration_core.cell import Cell
from calibration_core.errors import apart, beyond, rounded_down
from calibration_core.model.kinematics import posture
from calibration_core.model.nominal import nominal_parameters
from calibration_core.model.robot import chain_of
from calibration_core.model.statics import recorded_load
from calibration_core.planning.plans.tolerances import DEVIATIONS, Tolerances
from calibration_core.timeseries import Float1D


@dataclasses.dataclass(frozen=True, eq=False)
class Felt:
    """What the sensor said in one posture.

    Attributes:
        q: (n,) rad.
        wrench: (6,) N and N*m, as on the wrench topic.
        tare: Number of the tare in force; 0: none.
    """

    q: Float1D
    wrench: Float1D
    tare: int = 0


class LoadCheck:
    """Holds what pulls against what was planned.

    Args:
        cell: Where wrench point and sensor are.
        tolerances: See there.

    Attributes:
        floor: N, difference of force that never matters.
    """

    def __init__(self, cell: Cell, tolerances: Tolerances) -> None:
        self._cell, self._chain, self._parameters = cell, chain_of(cell), nominal_parameters(cell)
        self._tolerances, self.floor = tolerances, tolerances.floor(cell)
        sensor = cell.instruments.force_torque
        self._torque_floor = DEVIATIONS * (0.5 if sensor is None else sensor.sigma_torque)

    @staticmethod
    def possible(cell: Cell) -> bool:
        """Tell whether the cell file says where wrench point and sensor are."""
        return cell.frames.wrench_point is not None and cell.frames.force_torque is not None

    def pulls(self, felt: Felt) -> Float1D:
        """Return what the sensor says, (6,) N and N*m, in base axes and about the wrench point.

        Raises:
            CellError: The cell file does not say where the wrench point is.
        """
        wrench_point = self._parameters.wrench_point
        if wrench_point is None:
            raise self._cell.missing("frames.wrench_point", "holding a load against the plan")
        load = recorded_load(felt.wrench[None, :], self._cell, self._parameters)
        at = posture(self._chain, felt.q[None, :])
        force, torque, point = (one[:, 0] for one in load.in_base(at))
        lever = point - at.point(wrench_point)[:, 0]
        return np.concatenate([force, torque + np.cross(lever, force)])

    def acting_load(self, felt: Felt, unloaded: Felt) -> Float1D:
        """Return what pulls besides tool and bias, (6,) N and N*m, base axes, at the wrench point."""
        return self.pulls(felt) - self.pulls(unloaded)

    def force_band(self, wanted: Float1D) -> tuple[float, float]:
        """Return by how much size, N, and direction, rad, of a wanted force may be missed; NaN where it has none."""
        size = float(np.linalg.norm(wanted[:3]))
        return self._allowed(size, self.floor), self._tolerances.direction if size > 0.0 else math.nan

    def _allowed(self, size: float, floor: float) -> float:
        return max(self._tolerances.force * size, floor)

    def fault(self, wanted: Float1D, felt: Felt, unloaded: Felt) -> str:
        """Say what is wrong with a load: wanted, found, and what to do; empty if nothing is.

        Args:
            wanted: (6,) N and N*m, base axes, at the wrench point: the change from the unloaded step.
            felt: Now.
            unloaded: In the same posture, without the load.
        """
        if felt.tare != unloaded.tare:
            return (
                f"the sensor was tared (tare {felt.tare}, before {unloaded.tare}) since the unloaded step: what pulls"
                " is no longer known; measure the configuration again"
            )
        found = self.acting_load(felt, unloaded)
        band = self._band(wanted[:3], found[:3], self.floor)
        if band:
            return f"force: wanted {_vector(wanted[:3])} N, found {_vector(found[:3])} N ({band}); {_advice(wanted)}"
        if np.any(wanted[3:]):
            band = self._band(wanted[3:], found[3:], self._torque_floor)
            if band:
                texts = _vector(wanted[3:]), _vector(found[3:])
                return f"torque: wanted {texts[0]} N*m, found {texts[1]} N*m ({band}); {_advice(wanted)}"
        return ""

    def _band(self, wanted: Float1D, found: Float1D, floor: float) -> str:
        size, seen = float(np.linalg.norm(wanted)), float(np.linalg.norm(found))
        allowed = self._allowed(size, floor)
        if abs(seen - size) > allowed:
            allowed = rounded_down(allowed)
            texts = apart(seen, size, allowed)
            return f"size {texts[0]}, expected {texts[1]} ± {allowed:g}"
        angle = float(np.arctan2(np.linalg.norm(np.cross(wanted, found)), wanted @ found))
        if float(np.linalg.norm(found - wanted)) > floor and angle > self._tolerances.direction:
            limit = rounded_down(float(np.rad2deg(self._tolerances.direction)), 2)
            turned = beyond(float(np.rad2deg(angle)), limit, 1)
            return f"{turned}° from the direction wanted, expected at most {limit:g}°"
        return ""


def _vector(values: Float1D) -> str:
    return f"({', '.join(f'{value:z.0f}' for value in values)})"


def _advice(wanted: Float1D) -> str:
    if not np.any(wanted):
        return "release the load, or look at sensor and tare"
    return "apply the load as wanted, or look at wrench point, sensor frame and tare"
