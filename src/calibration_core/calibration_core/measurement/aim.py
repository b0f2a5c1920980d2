"""Where a tracker with one beam has to look for a target, and whether what it found there can be that target.

The robot's model and its joint angles say where a target is in the base; what is not known well is how the tracker
stands.  It is the cell file's pose at first, and every target that was found makes it better: the gain of a Kalman
filter whose state is the error of that pose (3 rad, 3 m), linear about the pose of the moment.
"""

from __future__ import annotations

import copy

import numpy as np

from calibration_core.cell import Cell
from calibration_core.errors import beyond, rounded_down
from calibration_core.measurement.target_check import TRAVEL
from calibration_core.model.chain import rotation_about
from calibration_core.model.kinematics import posture
from calibration_core.model.nominal import nominal_parameters
from calibration_core.model.robot import chain_of
from calibration_core.planning.plans.tolerances import DEVIATIONS
from calibration_core.timeseries import Float1D, Float2D

AXES = 0.03  # rad, one standard deviation of a stated axis of the tracker: set up by eye, to two degrees
ORIGIN = 0.05  # m, and of its stated place: by tape measure, from the robot's base
PLACE = TRAVEL / DEVIATIONS  # m, of a target on its flange, and of the links' lengths, before any calibration


class Aim:
    """Where each target is, in the tracker's frame, as far as it is known."""

    def __init__(self, cell: Cell) -> None:
        """Begin with the cell file.

        Raises:
            CellError: It does not say how the tracker stands, or the robot cannot be read.
        """
        if cell.frames.tracker is None:
            raise cell.missing("frames.tracker", "a tracker that has to be aimed")
        nominal = nominal_parameters(cell)
        self._chain, self._points = chain_of(cell), nominal.points
        self._origin, self._axes = nominal.tracker[:3, 3], nominal.tracker[:3, :3].T  # of the base in the tracker's
        self._shift = np.zeros(3)
        self._covariance = np.diag(np.repeat([AXES**2, ORIGIN**2], 3))

    def copy(self) -> Aim:
        """Return another that learns without this one: arrays are replaced, never changed."""
        return copy.copy(self)

    def in_base(self, name: str, q: Float1D) -> Float1D:
        """Return where a target is, (3,) m, base frame, at joint angles (n,) rad."""
        return np.asarray(posture(self._chain, q[None, :]).point(self._points[name])[:, 0])

    def place(self, name: str, q: Float1D) -> Float1D:
        """Return where a target is, (3,) m, tracker frame, at joint angles (n,) rad."""
        return np.asarray(self._axes @ (self.in_base(name, q) - self._origin) + self._shift)

    def fault(self, name: str, q: Float1D, found: Float1D) -> str:
        """Say why what was found at (3,) m, tracker frame, cannot be the target; empty: it can be."""
        off, allowed = self._off(name, q, found)
        if off <= allowed:
            return ""
        there = next((other for other in self._points if np.less_equal(*self._off(other, q, found))), "")
        limit = rounded_down(allowed, 2)
        words = f"a reflector was found {beyond(off, limit, 2)} m from its place, expected at most {limit:g} m"
        return f"{name}: {words}" + (f"; {there} is there" if there else "")

    def keep(self, name: str, q: Float1D, found: Float1D) -> None:
        """Learn from a target that was found at (3,) m, tracker frame."""
        slope, spread = self._spread(name, q)
        gain = np.linalg.solve(spread, slope @ self._covariance).T
        change = gain @ (found - self.place(name, q))
        self._axes = rotation_about(change[:3]) @ self._axes
        self._shift = self._shift + change[3:]
        rest = np.eye(6) - gain @ slope
        self._covariance = rest @ self._covariance @ rest.T + PLACE**2 * gain @ gain.T

    def _off(self, name: str, q: Float1D, found: Float1D) -> tuple[float, float]:
        """Return how far from a target's place something is, and how far it may be in that direction, m."""
        way = found - self.place(name, q)
        off = float(np.linalg.norm(way))
        along = way / off if off else np.full(3, 3**-0.5)  # any direction
        return off, DEVIATIONS / float(np.sqrt(along @ np.linalg.solve(self._spread(name, q)[1], along)))

    def _spread(self, name: str, q: Float1D) -> tuple[Float2D, Float2D]:
        """Return how a target's place depends on the pose's error (3, 6), and its covariance (3, 3) m^2."""
        x, y, z = self.place(name, q) - self._shift
        slope = np.hstack([np.array([[0.0, z, -y], [-z, 0.0, x], [y, -x, 0.0]]), np.eye(3)])
        return slope, slope @ self._covariance @ slope.T + PLACE**2 * np.eye(3)
