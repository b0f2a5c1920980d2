"""Whether the tracker's targets are where they should be: their distances, and how they move under the load.

Targets on one flange are a rigid body.  So in every step their distances are those of the session; from one unloaded
step to the next they travel as the joint angles say; a load moves them as the joints yield, each between two
thirds and twice as far as its believed stiffness says; and once the load is gone they stand where they stood before.
A target that moves while it is measured scatters more than the session's, and its mean is of no place at all.
Positions are compared within a configuration and a session alone: no frame has to be calibrated for that.
"""

from __future__ import annotations

import collections
import dataclasses
import itertools
from collections.abc import Iterable, Iterator, Mapping, Sequence

import numpy as np

from calibration_core.cell import Cell
from calibration_core.errors import rounded_down
from calibration_core.model.chain import nearest_rotation
from calibration_core.model.kinematics import linear_jacobian, posture
from calibration_core.model.nominal import nominal_parameters
from calibration_core.model.robot import chain_of
from calibration_core.model.simulation.simulate import tracker_covariance
from calibration_core.planning.plans.tolerances import DEVIATIONS
from calibration_core.recording.session_values import ConfirmedReading
from calibration_core.timeseries import Float1D, Float2D

SOFTER, STIFFER = 2.0, 1.0 / 1.5  # of the believed compliance: stiffness within 50 %
RETURN = 0.01  # share of the largest deflection, by which a robot whose gears have no hysteresis misses its place
ASIDE = 30.0  # degrees, from which the direction of a movement is told besides its size
TAKEN = 1.5  # times what somebody has answered for
TRAVEL = 0.05  # m, of places on the flange and of links before any calibration
SPREAD = 0.03  # m, of the places that are known in both frames, across their line: axes are known to some degrees
KEPT = 50  # distances of a pair, the newest: several configurations' worth
MM = 1e3
TARGETS = "targets"  # name of the override by which an operator answers for tracker and targets
PUT_RIGHT = f"put it right, or override {TARGETS!r} by name; then resume, and the configuration begins again"


@dataclasses.dataclass(frozen=True, eq=False)
class Targets:
    """What the tracker saw at one step.

    Attributes:
        q: (n,) rad.
        load: (6,) N and N*m, base axes, at the wrench point: what pulls besides what pulled at step 0.
        loaded: Whether a load is planned.
        positions: (3,) m, tracker frame, by name.
        covariances: (3, 3) m^2, of the means.
    """

    q: Float1D
    load: Float1D
    loaded: bool
    positions: Mapping[str, Float1D]
    covariances: Mapping[str, Float2D]

    def renamed(self, names: Sequence[str]) -> Targets:
        """Return it with other names of the targets, in the order of the present ones."""
        old = list(self.positions)
        return dataclasses.replace(
            self,
            positions={new: self.positions[one] for new, one in zip(names, old, strict=True)},
            covariances={new: self.covariances[one] for new, one in zip(names, old, strict=True)},
        )


class TargetCheck:
    """Holds what is seen against the session and the model; knows nothing before the first step that was kept."""

    def __init__(self, cell: Cell) -> None:
        """Take the cell, for stiffness, targets and the tracker's claim."""
        self._cell, self._chain, self._parameters = cell, chain_of(cell), nominal_parameters(cell)
        self._yields = cell.robot.stiffness is not None and self._parameters.wrench_point is not None
        self._return = RETURN
        self._complaint: tuple[str, float] = ("", 0.0)  # kind of what was found wrong last, and share of a return
        self._forget()

    def _forget(self) -> None:
        self._distances: dict[tuple[str, str], collections.deque[float]] = {}
        self._last: Targets | None = None  # the last step 0 that was kept, or the last visit to the reference
        self._scatter: collections.deque[float] = collections.deque(maxlen=KEPT)
        self._both: collections.deque[tuple[Float1D, Float1D]] = collections.deque(maxlen=KEPT)
        self.begin()

    def begin(self) -> None:
        """Begin an attempt at a configuration."""
        self._first: Targets | None = None
        self._axes: Float2D | None = None  # of the base in the tracker's, (3, 3); None: not known
        self._largest = 0.0  # m, deflection of any target in this attempt

    def accept(self) -> None:
        """Take what was found wrong last as it is from now on: somebody answers for it."""
        match self._complaint:
            case ("return", float(share)):
                self._return = max(self._return, TAKEN * share)
            case ("load", _):
                self._yields = False
            case _:
                self._forget()
        self._complaint = ("", 0.0)

    def restore(self, readings: Iterable[ConfirmedReading]) -> None:
        """Take over the distances from what a session holds already, in the order of time."""
        steps: dict[tuple[int, int], dict[str, ConfirmedReading]] = {}
        for one in readings:
            steps.setdefault((one.configuration, one.step), {})[one.point] = one
        for seen in steps.values():
            self._remember(
                {name: one.position for name, one in seen.items()},
                {name: one.position_covariance for name, one in seen.items()},
            )

    def keep(self, seen: Targets) -> None:
        """Take a step that counts; the first of an attempt is what the others are held against."""
        self._remember(seen.positions, seen.covariances)
        if self._first is None:
            self._first = self._last = seen
            places = self._places(seen.q, seen.positions)
            self._both += [(places[name], position) for name, position in seen.positions.items()]
            self._axes = self._turned()
        else:
            self._largest = max(self._largest, *(float(np.linalg.norm(d)) for d in self._displaced(seen).values()))

    def _remember(self, positions: Mapping[str, Float1D], covariances: Mapping[str, Float2D]) -> None:
        self._scatter += [_size(covariance) for covariance in covariances.values()]
        for pair in itertools.combinations(sorted(positions), 2):
            known = self._distances.setdefault(pair, collections.deque(maxlen=KEPT))
            known.append(_apart(positions, pair))

    def fault(self, seen: Targets) -> str:
        """Say what is wrong with what is seen; empty: nothing is.

        Another way since the last configuration alone is no fault: before the calibration nobody knows where a target
        sits.  Names are exchanged where the other ones fit, and all targets stand nearer to where they should by more.
        """
        found, off = self._found(seen), self._travelled_off(seen)
        complaint = self._complaint
        names = list(seen.positions)
        for pair in itertools.combinations(sorted(names), 2):
            swapped = dict(zip(pair, reversed(pair), strict=True))
            other = seen.renamed([swapped.get(name, name) for name in names])
            if (found or off > self._travelled_off(other) + TRAVEL) and not self._found(other):
                self._complaint = ("shape", 0.0)
                return f"{pair[0]} and {pair[1]} are exchanged: look at what the tracker is locked on"
        self._complaint = complaint
        return found

    def _found(self, seen: Targets) -> str:
        """Say what is wrong where every target carries its own name."""
        return (
            self._unsteady(seen)
            or self._shape(seen)
            or (self._yielded(seen) if self._first is not None else self._travelled(seen))
        )

    def _unsteady(self, seen: Targets) -> str:
        """Say which mean scatters more than those of the session: its target moved meanwhile, or others were seen."""
        if not self._scatter:
            return ""
        usual = float(np.median(self._scatter))
        for name, covariance in seen.covariances.items():
            claim = _size(tracker_covariance(self._cell, seen.positions[name][None, :])[0])
            limit = DEVIATIONS * float(np.hypot(usual, claim))
            if (size := _size(covariance)) > limit:
                self._complaint = ("shape", 0.0)
                return (
                    f"{name} moved while it was measured: its mean scatters by {size * MM:.2f} mm, expected at most"
                    f" {rounded_down(limit * MM):g} mm; look at target and beam"
                )
        return ""

    # --- distances -------------------------------------------------------------------------------------------------

    def _shape(self, seen: Targets) -> str:
        changed = {pair: change for pair in self._distances if (change := self._change(seen, pair)) is not None}
        if not changed:
            return ""
        self._complaint = ("shape", 0.0)
        every = [pair for pair in self._distances if set(pair) <= set(seen.positions)]
        alone = [
            name
            for name in seen.positions
            if len(seen.positions) > 2 and all((name in pair) or pair not in changed for pair in every)
        ]
        if len(alone) == 1:
            name, displaced = alone[0], self._displaced(seen)
            off = max(abs(change) for change in changed.values())
            if name in displaced:  # where it should stand is known from the others
                beyond = {one: way - self._band(seen, one, way)[0] for one, way in displaced.items()}
                others = np.mean([way for one, way in beyond.items() if one != name], axis=0)
                off = float(np.linalg.norm(beyond[name] - others))
            return f"{name} stands {off * MM:.1f} mm elsewhere: look at target and beam"
        pair, change = max(changed.items(), key=lambda one: abs(one[1]))
        usual = float(np.mean(self._distances[pair])) * MM
        words = (
            f"the distance from {pair[0]} to {pair[1]} is {usual + change * MM:.2f} mm, in this session {usual:.2f} mm"
        )
        return f"{words}: a target stands elsewhere; look at targets and beam"

    def _change(self, seen: Targets, pair: tuple[str, str]) -> float | None:
        """Return by how much a distance differs from the session's, m; None where it does not, or was not measured."""
        if not set(pair) <= set(seen.positions):
            return None
        known = self._distances[pair]
        change = _apart(seen.positions, pair) - float(np.mean(known))
        line = seen.positions[pair[0]] - seen.positions[pair[1]]
        line = line / max(float(np.linalg.norm(line)), 1e-12)
        variance = sum(float(line @ self._covariance(seen, name) @ line) for name in pair) * (1.0 + 1.0 / len(known))
        return change if abs(change) > DEVIATIONS * np.sqrt(variance) else None

    def _covariance(self, seen: Targets, name: str) -> Float2D:
        """Return the covariance of a mean, m^2: the claim, and what was seen to scatter."""
        claim = tracker_covariance(self._cell, seen.positions[name][None, :])[0]
        return np.asarray(claim + np.nan_to_num(seen.covariances[name]))

    # --- movements -------------------------------------------------------------------------------------------------

    def _displaced(self, seen: Targets) -> dict[str, Float1D]:
        """Return how far each target is from its place at step 0, (3,) m, tracker frame, less the encoders' way."""
        if self._first is None:
            return {}
        before, now = (self._places(one.q, seen.positions) for one in (self._first, seen))
        axes = np.zeros((3, 3)) if self._axes is None else self._axes
        return {
            name: seen.positions[name] - self._first.positions[name] - axes @ (now[name] - before[name])
            for name in seen.positions
            if name in self._first.positions
        }

    def _turned(self) -> Float2D | None:
        """Return the base's axes in the tracker's frame (3, 3): from what was seen; None: not known."""
        here, there = (np.array(rows) - np.mean(rows, axis=0) for rows in zip(*self._both, strict=True))
        sizes = np.linalg.svd(there.T @ here, compute_uv=False)
        return nearest_rotation(there.T @ here) if sizes[1] > len(here) * SPREAD**2 else None

    def _places(self, q: Float1D, names: Iterable[str]) -> dict[str, Float1D]:
        """Return where the unloaded robot has the targets, (3,) m, base frame."""
        at = posture(self._chain, q[None, :])
        points = self._parameters.points
        return {name: at.point(points[name])[:, 0] if name in points else at.flange_origin[:, 0] for name in names}

    def _yielded(self, seen: Targets) -> str:
        """Hold how the targets stand against step 0, one by one and in the mean, which has less noise."""
        moved = self._displaced(seen)
        if self._first is None or not moved or (seen.loaded and not self._yields):
            return ""
        off: dict[str, Float1D] = {}
        noise: dict[str, Float2D] = {}
        usual: list[Float1D] = []
        for name, way in moved.items():
            expected, low, high = self._band(seen, name, way)
            usual.append(expected)
            off[name] = way - np.clip(way, low, high)
            noise[name] = self._covariance(seen, name) + self._covariance(self._first, name)
        slack = 0.0 if seen.loaded else self._return * self._largest
        common = sum(noise.values(), np.zeros((3, 3))) / len(noise) ** 2
        out = [name for name in off if _sticks_out(off[name], noise[name], slack)]
        if not out and not _sticks_out(np.mean(list(off.values()), axis=0), common, slack):
            return ""
        way = moved[out[0]] if len(out) == 1 else np.mean(list(moved.values()), axis=0)
        size = float(np.linalg.norm(way))
        if seen.loaded:
            self._complaint = ("load", 0.0)
            who = out[0] if len(out) == 1 else "all points"
            meant = np.mean(usual, axis=0)
            found = f"{who} moved by {size * MM:.1f} mm where {np.linalg.norm(meant) * MM:.1f} is expected"
            turned = np.rad2deg(np.arctan2(np.linalg.norm(np.cross(way, meant)), way @ meant))
            aside = f", {turned:.0f}° from its direction" if turned > ASIDE and self._axes is not None else ""
            return f"{found}{aside}: tracker or load"
        self._complaint = ("return", size / max(self._largest, 1e-9))
        limit = rounded_down(max(DEVIATIONS * float(np.sqrt(np.trace(common) / 3.0)), slack) * MM)
        who = out[0] if len(out) == 1 else "the points"
        return (
            f"unloaded again, {who} missed the place of before the load by {size * MM:.2f} mm, expected at most"
            f" {limit:g} mm: the tracker or a target was moved, or the robot does not come back"
        )

    def _band(self, seen: Targets, name: str, way: Float1D) -> tuple[Float1D, Float1D, Float1D]:
        """Return how a target moves under the load, (3,) m, tracker frame: as believed, at least, at most.

        Where no axes are known yet, it is the way that was found (3,) whose length alone is held against the model's.
        """
        point, pulled = self._parameters.points.get(name), self._parameters.wrench_point
        if point is None or pulled is None or not self._yields:
            return np.zeros(3), np.zeros(3), np.zeros(3)
        at = posture(self._chain, seen.q[None, :])
        torque = linear_jacobian(at, at.point(pulled))[..., 0] @ seen.load[:3] + at.spins[..., 0] @ seen.load[3:]
        lever = linear_jacobian(at, at.point(point))[..., 0]  # (n, 3)
        each = lever * (self._parameters.compliance * torque)[:, None]
        if self._axes is None:
            along = way / max(float(np.linalg.norm(way)), 1e-12)
            each = np.linalg.norm(each.sum(axis=0)) * along[None, :]
        else:
            each = each @ self._axes.T
        ends = np.stack([SOFTER * each, STIFFER * each])
        return each.sum(axis=0), ends.min(axis=0).sum(axis=0), ends.max(axis=0).sum(axis=0)

    def _travelled_off(self, seen: Targets) -> float:
        """Return how far the ways from the last configuration are from what the joint angles say, m, at most.

        Without axes of the base, lengths alone are compared; 0 within a configuration, and where there was none before.
        """
        last = self._last
        if last is None or self._first is not None:
            return 0.0
        axes, off = self._turned(), 0.0
        for _, way, usual in self._ways(last, seen):
            other = np.linalg.norm(way) - np.linalg.norm(usual) if axes is None else np.linalg.norm(way - axes @ usual)
            off = max(off, abs(float(other)))
        return off

    def _ways(self, last: Targets, seen: Targets) -> Iterator[tuple[str, Float1D, Float1D]]:
        """Give each target's way since the last unloaded step, (3,) m: as seen, and by the joint angles, base frame."""
        before, now = self._places(last.q, last.positions), self._places(seen.q, last.positions)
        for name in filter(last.positions.__contains__, seen.positions):
            yield name, seen.positions[name] - last.positions[name], now[name] - before[name]

    def _travelled(self, seen: Targets) -> str:
        """Say which target has not moved since the last unloaded step, though the joints have."""
        last = self._last
        if last is None:
            return ""
        for name, way, expected in self._ways(last, seen):
            usual = float(np.linalg.norm(expected))
            noise = self._covariance(seen, name) + self._covariance(last, name)
            if usual > TRAVEL and not _sticks_out(way, noise, 0.0):
                self._complaint = ("shape", 0.0)
                moved = f"{np.linalg.norm(way) * MM:.1f} mm since the last configuration where {usual * MM:.0f}"
                return f"{name} has moved by {moved} is expected: the tracker holds an old value"
        return ""


def _size(covariance: Float2D) -> float:
    """Return the standard deviation of a place, m; of a single sample nothing is known."""
    return float(np.sqrt(np.trace(np.nan_to_num(covariance))))


def _apart(positions: Mapping[str, Float1D], pair: tuple[str, str]) -> float:
    return float(np.linalg.norm(positions[pair[0]] - positions[pair[1]]))


def _sticks_out(off: Float1D, covariance: Float2D, slack: float) -> bool:
    """Return whether an error is more than its noise, and more than does not matter."""
    size = float(np.linalg.norm(off))
    if size <= slack or size == 0.0:
        return False
    along = off / size
    return bool(size > DEVIATIONS * np.sqrt(float(along @ covariance @ along)))
