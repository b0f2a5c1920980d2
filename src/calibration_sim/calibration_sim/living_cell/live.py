"""The cell as it lives: a robot that is sent along trajectories, and a load that is put on, in simulated time.

Motors follow the cubic Hermite polynomial through the points of a trajectory, as controllers interpolate them.  How
fast they go along it may differ from the command: a held robot stands, a faulty one rushes, a braked one comes to rest
on its path.  What hangs on the motors gives way statically, and rings down after every motion and change of load.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike

from calibration_core.cell import Cell
from calibration_core.timeseries import Float1D, Float2D, Float3D, read_only
from calibration_sim.cell.table import build_mechanism, solve_states
from calibration_sim.cell.timeline import RINGING_AFTER_MOTION, RINGING_AFTER_RAMP, RINGING_FREQUENCY, RINGING_TIME
from calibration_sim.cell.truth import Truth
from calibration_sim.mechanics.mjcf import Spring

TICK = 1e-3  # s, between the angles of a motion that are looked at
BRAKING = 0.1  # s, from full speed to rest on the path
START_TOLERANCE = 2e-3  # rad, between a trajectory's first point and where the robot stands


class Refused(ValueError):  # noqa: N818  # what the controller answers
    """A trajectory or load that the simulated controller does not accept."""


@dataclasses.dataclass(frozen=True, eq=False)
class Path:
    """A trajectory to follow.

    Attributes:
        time: (m,) s, from zero, strictly increasing.
        position: (m, n) rad.
        velocity: (m, n) rad/s, at rest at the end.
    """

    time: Float1D
    position: Float2D
    velocity: Float2D

    def __post_init__(self) -> None:
        """Copy to read-only arrays; raise Refused on what no controller would follow."""
        for name in ("time", "position", "velocity"):
            object.__setattr__(self, name, read_only(getattr(self, name)))
        if len(self.time) < 2 or self.position.shape != self.velocity.shape or len(self.position) != len(self.time):
            raise Refused("fewer than two points, or points without positions and velocities")
        if not all(np.isfinite(values).all() for values in (self.time, self.position, self.velocity)):
            raise Refused("a value that is not finite")
        if self.time[0] != 0.0 or np.any(np.diff(self.time) <= 0.0):
            raise Refused("times that do not increase from zero")
        if np.any(self.velocity[-1] != 0.0):
            raise Refused("motion at the last point")

    @property
    def duration(self) -> float:
        """Length, s."""
        return float(self.time[-1])

    def at(self, time: ArrayLike) -> Float2D:
        """Return the angles (k, n) rad at times (k,) s along the path."""
        t = np.clip(np.asarray(time, dtype=np.float64), 0.0, self.duration)
        i = np.clip(np.searchsorted(self.time, t, side="right") - 1, 0, len(self.time) - 2)
        h = (self.time[i + 1] - self.time[i])[:, None]
        u = (t - self.time[i])[:, None] / h
        before, after = 1.0 - u, u
        return np.asarray(
            before**2 * ((1.0 + 2.0 * u) * self.position[i] + h * u * self.velocity[i])
            + after**2 * ((3.0 - 2.0 * u) * self.position[i + 1] - h * before * self.velocity[i + 1])
        )


class LiveCell:
    """The cell's physics, driven by commands and by time; times are s from its start.

    Attributes:
        time: Now.
        q: (n,) rad, encoder angles now.
        load: (6,) N and N*m, base axes, at the wrench point: what pulls now.
        haste: How fast the motors go along a path; 1 as commanded, 0 held.
        blocked_after: Share of a path after which the motors stop; 1: never.
    """

    def __init__(self, cell: Cell, truth: Truth, home: ArrayLike, springs: Sequence[Spring] = ()) -> None:
        """Put the robot at `home` (n,) rad, without load.

        Args:
            cell: What is believed.
            truth: What is.
            home: (n,) rad.
            springs: What gives way besides the joints, and stands in no cell file.
        """
        self.cell, self.truth = cell, truth
        self.mechanism = build_mechanism(cell, truth, springs=springs)
        self.time = 0.0
        self.q: Float1D = np.array(home, dtype=np.float64)
        self.load: Float1D = np.zeros(6)
        self.haste = 1.0
        self.blocked_after = 1.0
        self._path: Path | None = None
        self._along = 0.0  # s, on the path
        self._pace = 1.0  # falls to zero while braking
        self._braking = False
        self._ramp: tuple[float, float, Float1D, Float1D] | None = None  # begin, end, from, to
        self._ringing: Float2D = np.zeros((len(truth.points), 3))
        self._ringing_since = 0.0
        self._solved: tuple[bytes, Float2D, Float1D] | None = None

    @property
    def moving(self) -> bool:
        """Whether a path is being followed."""
        return self._path is not None

    @property
    def loading(self) -> bool:
        """Whether the load is changing."""
        return self._ramp is not None

    @property
    def share_done(self) -> float:
        """How much of the path lies behind, 0 to 1."""
        return 1.0 if self._path is None else self._along / self._path.duration

    def follow(self, path: Path) -> None:
        """Begin to follow a path, in place of another one if there is one.

        Raises:
            Refused: It begins elsewhere, or leaves the joint limits that the controller knows.
        """
        gap = float(np.max(np.abs(path.position[0] - self.q)))
        if path.position.shape[1] != len(self.q) or not gap <= START_TOLERANCE:
            raise Refused(f"the first point is {gap:.3g} rad away from where the robot stands")
        # the rest of a path begun slightly off: what the motors do is continuous
        shift = (self.q - path.position[0]) * np.linspace(1.0, 0.0, len(path.time))[:, None]
        self._path = Path(path.time, path.position + shift, path.velocity)
        self._along, self._pace, self._braking = 0.0, 1.0, False

    def brake(self) -> None:
        """Come to rest on the path, quickly."""
        self._braking = self._path is not None

    def pull(self, wrench: ArrayLike, duration: float) -> None:
        """Change the load to a wrench (6,), base axes at the wrench point, over `duration` s.

        Raises:
            Refused: It is not finite.
        """
        target = np.array(wrench, dtype=np.float64)
        if target.shape != (6,) or not np.isfinite(target).all():
            raise Refused("a wrench that is not six finite numbers")
        self._ramp = (self.time, self.time + max(duration, TICK), self.load.copy(), target)

    def advance(self, time: float) -> tuple[Float1D, Float2D]:
        """Let time go on; return the instants (k,) s and angles (k, n) rad at which the motors moved, 1 ms apart."""
        moved: tuple[Float1D, Float2D] = (np.empty(0), np.empty((0, len(self.q))))
        if self._path is not None and time > self.time:
            moved = self._move(self._path, time)
        self.time = max(time, self.time)
        if self._ramp is not None:
            begin, end, start, target = self._ramp
            share = min((self.time - begin) / (end - begin), 1.0)
            self.load = start + share * (target - start)
            if share == 1.0:
                self._ramp = None
                self._ring(RINGING_AFTER_RAMP * (self._rest(target)[0] - self._rest(start)[0]))
        return moved

    def _move(self, path: Path, time: float) -> tuple[Float1D, Float2D]:
        count = max(1, round((time - self.time) / TICK))
        dt = (time - self.time) / count
        slower = dt / BRAKING if self._braking else 0.0
        pace = np.maximum(self._pace - slower * np.arange(1, count + 1), 0.0)
        along = self._along + np.cumsum(self.haste * pace) * dt
        end = path.duration * self.blocked_after
        q = path.at(np.minimum(along, end))
        instants = self.time + dt * np.arange(1, count + 1)
        self.q, self._along, self._pace = q[-1], float(min(along[-1], end)), float(pace[-1])
        if self._along >= end or self._pace == 0.0:
            self._path = None
            way = path.at(np.array([max(self._along - 0.05, 0.0), self._along]))
            direction = self._points_at(way[1]) - self._points_at(way[0])
            size = max(float(np.max(np.linalg.norm(direction, axis=1))), 1e-9)
            self._ring(RINGING_AFTER_MOTION * direction / size)
        return np.asarray(instants, dtype=np.float64), q

    def points(self) -> Float2D:
        """Return where the measurement points are now, (p, 3) m, true tracker frame."""
        since = self.time - self._ringing_since
        swing = np.exp(-since / RINGING_TIME) * np.sin(2.0 * np.pi * RINGING_FREQUENCY * since)
        return np.asarray(self._rest(self.load)[0] + swing * self._ringing)

    def wrench(self) -> Float1D:
        """Return what a perfect force/torque sensor reports now, (6,) N and N*m; without a load, nothing."""
        return self._rest(self.load)[1] if self.load.any() else np.zeros(6)

    def _rest(self, load: Float1D) -> tuple[Float2D, Float1D]:
        """Return points (p, 3) and reported wrench (6,) at rest at the present angles under a load."""
        key = self.q.tobytes() + load.tobytes()
        if self._solved is None or self._solved[0] != key:
            states = solve_states(self.mechanism, self.cell, self.truth, self.q[None], load[None])
            self._solved = (key, states.points[0], states.wrench[0])
        return self._solved[1], self._solved[2]

    def _points_at(self, q: Float1D) -> Float2D:
        in_flange = np.array(list(self.truth.points.values()))
        return self.truth.tracker.inverse_apply(self.mechanism.forward(q).apply(in_flange))

    def _ring(self, amplitude: Float2D) -> None:
        self._ringing, self._ringing_since = amplitude, self.time


def watched(cell: LiveCell, q: Float2D) -> Float3D:
    """Return the positions (k, p, 3) m, base frame, of every point whose speed matters, at link angles (k, n) rad.

    Link origins, flange, sensor, wrench point and measurement points of the true robot, undeformed.
    """
    truth = cell.truth
    on_flange = np.array([np.zeros(3), truth.force_torque.translation, truth.wrench_point, *truth.points.values()])
    origins, rotations, flanges = cell.mechanism.postures(q)
    return np.concatenate([origins, flanges[:, None] + on_flange @ rotations.transpose(0, 2, 1)], axis=1)
