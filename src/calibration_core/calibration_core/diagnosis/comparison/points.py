"""How the measured positions of two recordings of one measurement are related: unit, names, axes, frame."""

from __future__ import annotations

import dataclasses
import itertools
import math

import numpy as np

from calibration_core.diagnosis.comparison.result import Difference, Side, farther_off
from calibration_core.timeseries import Float1D, Float2D, Int1D

UNITS = {"the recording in mm": 1000.0, "the simulation in mm": 0.001}
CLOSE = 0.2  # relative: how near to a unit's factor the spread must be
TURNED, SHIFTED = 5e-3, 1e-2  # rad and m: frames that are set up with care differ by less
BETTER = 0.2  # of the distance that is left: an exchange of names or axes must do at least so well
LEAST = 5e-4  # m: below, nothing is exchanged
MOST_NAMES = 5  # points whose exchange is tried


@dataclasses.dataclass(frozen=True, eq=False)
class Placed:
    """The simulated positions in the recording's frame.

    Attributes:
        rotation: (3, 3) recorded = rotation @ simulated + shift; improper where axes are mirrored.
        position: (m, 3) m, simulated positions, brought over.
        rms: m per coordinate, that remains.
        differences: What had to be changed.
    """

    rotation: Float2D
    position: Float2D
    rms: float
    differences: tuple[Difference, ...]


def place(
    recorded: Float2D, simulated: Float2D, point: Int1D, names: tuple[str, ...], far: tuple[float, float]
) -> Placed:
    """Bring simulated positions into the recording's frame, and say what it takes.

    Both are brought to metres.

    Args:
        recorded: (m, 3) m, tracker frame.
        simulated: (m, 3) m.
        point: (m,) index of the point.
        names: Of the points.
        far: m per coordinate, how far recording and simulation are from the cell file's own prediction.
    """
    side = farther_off(*far)
    found: list[Difference] = []
    factor = _unit(recorded, simulated)
    if factor != 1.0:
        which = next(name for name, value in UNITS.items() if value == factor)
        text = f"The positions differ by a factor of 1000: {which} instead of m."
        own: Side = "recording" if factor > 1 else "simulation"
        found.append(position_unit(own, text))
        if factor > 1:
            recorded = recorded / factor
        else:
            simulated = simulated * factor
    source = simulated
    order = _names(recorded, source, point, len(names))
    if order is not None:
        source = source[order.rows]
        listed = ", ".join(f"{names[a]} of the simulation is {names[b]} of the recording" for a, b in order.pairs)
        location = {"point": ", ".join(names[b] for _, b in order.pairs)}
        text = f"The measurement points have other names: {listed}."
        changed = [names[b] for _, b in order.pairs]
        remedy = f"name the points as the cell file has them: {listed}"
        size = float(len(order.pairs))
        found.append(Difference("point_order", location, side, size, "1", text, True, remedy, {"points": changed}))
    rotation, shift, rms = rigid(recorded, source)
    mirrored, away, left = rigid(recorded, source, proper=False)
    if np.linalg.det(mirrored) < 0 and rms > LEAST and left < BETTER * rms:
        rotation, shift, rms = mirrored, away, left
        text = "One frame is left-handed: an axis of the positions has the opposite sign."
        remedy = "turn the sign of one coordinate of all positions: frames are right-handed"
        where, further = {"tracker": "tracker"}, {"points": list(names)}
        found.append(Difference("point_order", where, side, 1.0, "1", text, True, remedy, further))
    else:
        angle = math.acos(float(np.clip((np.trace(rotation) - 1) / 2, -1.0, 1.0)))
        centre = source.mean(axis=0)
        moved = float(np.linalg.norm(rotation @ centre + shift - centre))
        if angle > TURNED or moved > SHIFTED:
            text = (
                f"The tracker frames differ: turned by {1e3 * angle:.1f} mrad, and the measured points shifted by "
                f"{1e3 * moved:.1f} mm on average; taken out before the comparison."
            )
            found.append(Difference("tracker_frame", {"tracker": "tracker"}, side, moved, "m", text, False))
    return Placed(rotation, source @ rotation.T + shift, rms, tuple(found))


def position_unit(side: Side, text: str) -> Difference:
    """Return the difference of positions of which one side's are in mm."""
    remedy = "give positions in m: multiply them by 0.001"
    return Difference("position_unit", {"tracker": "tracker"}, side, 1000.0, "1", text, True, remedy, {"factor": 1e-3})


def rigid(target: Float2D, source: Float2D, *, proper: bool = True) -> tuple[Float2D, Float1D, float]:
    """Return rotation (or, if not `proper`, the best orthogonal matrix), shift and rms per coordinate.

    Source: Kabsch 1976; Umeyama 1991.
    """
    centre, middle = target.mean(axis=0), source.mean(axis=0)
    u, _, vt = np.linalg.svd((target - centre).T @ (source - middle))
    sign = float(np.linalg.det(u @ vt)) if proper else 1.0
    rotation = u @ np.diag([1.0, 1.0, sign]) @ vt
    shift = centre - rotation @ middle
    rest = target - source @ rotation.T - shift
    return rotation, shift, float(np.sqrt(np.mean(rest**2)))


@dataclasses.dataclass(frozen=True, eq=False)
class _Order:
    rows: Int1D
    pairs: tuple[tuple[int, int], ...]


def _unit(recorded: Float2D, simulated: Float2D) -> float:
    spread, other = (float(np.sqrt(np.mean((x - x.mean(axis=0)) ** 2))) for x in (recorded, simulated))
    if spread == 0.0 or other == 0.0:
        return 1.0
    for factor in UNITS.values():
        if abs(spread / other / factor - 1) < CLOSE:
            return factor
    return 1.0


def _names(recorded: Float2D, simulated: Float2D, point: Int1D, count: int) -> _Order | None:
    """Return which points have exchanged their names; None if none have."""
    usual = min(rigid(recorded, simulated, proper=proper)[2] for proper in (True, False))
    if usual < LEAST or not 2 <= count <= MOST_NAMES or len(recorded) % count:
        return None
    table = np.arange(len(recorded)).reshape(-1, count)
    if not np.array_equal(point[table], np.broadcast_to(np.arange(count), table.shape)):
        return None
    best: tuple[float, tuple[int, ...]] | None = None
    for order in itertools.permutations(range(count)):
        rms = rigid(recorded, simulated[table[:, order].reshape(-1)])[2]
        if best is None or rms < best[0]:
            best = (rms, order)
    assert best is not None  # noqa: S101 - there is at least one permutation
    rms, order = best
    if rms > BETTER * usual:
        return None
    return _Order(table[:, order].reshape(-1), tuple((a, b) for b, a in enumerate(order) if a != b))
