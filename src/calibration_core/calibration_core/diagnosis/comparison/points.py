"""How the measured positions of two recordings of one measurement are related: unit, names, axes, frame."""

from __future__ import annotations

import dataclasses
import itertools
import math

import numpy as np

from calibration_core.diagnosis.comparison.result import Difference, Side, farther_off
from calibration_core.timeseries import Float1D, Float2D, Float3D, Int1D

UNITS = {"the recording in mm": 1000.0, "the simulation in mm": 0.001}
CLOSE = 0.2  # relative: how near to a unit's factor the spread must be
TURNED, SHIFTED = 5e-3, 1e-2  # rad and m: frames that are set up with care differ by less
BETTER = 0.2  # of the distance that is left: an exchange of names or axes must do at least so well
LEAST = 5e-4  # m: below, nothing is exchanged
MOST_NAMES = 5  # points whose exchange is tried
ELSEWHERE = 2e-3  # m: points that are mounted with care stand nearer to each other


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
    recorded: Float2D,
    simulated: Float2D,
    point: Int1D,
    configuration: Int1D,
    names: tuple[str, ...],
    far: tuple[float, float],
    flange: Float3D | None = None,
) -> Placed:
    """Bring simulated positions into the recording's frame, and say what it takes.

    Both are brought to metres.

    Args:
        recorded: (m, 3) m, tracker frame.
        simulated: (m, 3) m.
        point: (m,) index of the point.
        configuration: (m,) its number.
        names: Of the points.
        far: m per coordinate, how far recording and simulation are from the cell file's own prediction.
        flange: (m, 3, 3) whose columns are the flange's axes in the recording's frame; None: they are not known.
    """
    side = farther_off(*far)
    offset = np.zeros_like(recorded)
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
    order = _names(recorded, source, point, configuration, len(names))
    if order is not None:
        source = source[order.rows]
        listed = ", ".join(f"{names[a]} of the simulation is {names[b]} of the recording" for a, b in order.pairs)
        location = {"point": ", ".join(names[b] for _, b in order.pairs)}
        where = f" in {order.where}" if order.where else ""
        text = f"The measurement points have other names{where}: {listed}."
        changed = [names[b] for _, b in order.pairs]
        remedy = f"name the points{where} as the cell file has them: {listed}"
        size = float(len(order.pairs))
        found.append(Difference("point_order", location, side, size, "1", text, True, remedy, {"points": changed}))
    rotation, shift, rms = rigid(recorded, source)
    mirrored, away, left = rigid(recorded, source, proper=False)
    if np.linalg.det(mirrored) < 0 and rms > LEAST and left < BETTER * rms:
        rotation, shift, rms = mirrored, away, left
        text = "One frame is left-handed: an axis of the positions has the opposite sign."
        remedy = "turn the sign of one coordinate of all positions: frames are right-handed"
        frame, further = {"tracker": "tracker"}, {"points": list(names)}
        found.append(Difference("point_order", frame, side, 1.0, "1", text, True, remedy, further))
    else:
        apart = None if flange is None else _elsewhere(recorded, source @ rotation.T + shift, point, len(names), flange)
        if apart is not None and flange is not None:
            offset = np.einsum("mab,mb->ma", flange, apart[point])
            rotation, shift, rms = rigid(recorded - offset, source)
            found.append(_other_tool(apart, names, side))
        angle = math.acos(float(np.clip((np.trace(rotation) - 1) / 2, -1.0, 1.0)))
        centre = source.mean(axis=0)
        moved = float(np.linalg.norm(rotation @ centre + shift - centre))
        if angle > TURNED or moved > SHIFTED:
            text = (
                f"The tracker frames differ: turned by {1e3 * angle:.1f} mrad, and the measured points shifted by "
                f"{1e3 * moved:.1f} mm on average; taken out before the comparison."
            )
            found.append(Difference("tracker_frame", {"tracker": "tracker"}, side, moved, "m", text, False))
    return Placed(rotation, source @ rotation.T + shift + offset, rms, tuple(found))


def _elsewhere(recorded: Float2D, placed: Float2D, point: Int1D, count: int, flange: Float3D) -> Float2D | None:
    """Return by how much every point stands elsewhere on the flange, (count, 3) m, flange axes; None where none does.

    Found together with what turns and shifts the frame besides, to first order.

    Args:
        recorded: (m, 3) m.
        placed: (m, 3) m, simulated positions in the recording's frame as it fits best.
        point: (m,) index of the point.
        count: Number of points.
        flange: (m, 3, 3) as of `place`.
    """
    usual = float(np.sqrt(np.mean((recorded - placed) ** 2)))
    m, arm = len(recorded), placed - placed.mean(axis=0)
    columns = np.zeros((m, 3, 6 + 3 * count))
    columns[:, :, :3] = np.cross(np.eye(3)[None], arm[:, None], axis=2).transpose(0, 2, 1)
    columns[:, :, 3:6] = np.eye(3)
    for k in range(count):
        columns[point == k, :, 6 + 3 * k : 9 + 3 * k] = flange[point == k]
    found = np.linalg.lstsq(columns.reshape(3 * m, -1), (recorded - placed).ravel(), rcond=1e-6)[0]
    apart = np.asarray(found[6:].reshape(count, 3))
    left = rigid(recorded - np.einsum("mab,mb->ma", flange, apart[point]), placed)[2]
    explained = usual > LEAST and left < BETTER * usual
    return apart if explained and np.linalg.norm(apart, axis=1).max() > ELSEWHERE else None


def _other_tool(apart: Float2D, names: tuple[str, ...], side: Side) -> Difference:
    """Say which points stand elsewhere on the flange, and how far, (p, 3) m."""
    length = np.linalg.norm(apart, axis=1)
    which = [k for k in range(len(names)) if length[k] > ELSEWHERE]
    listed = ", ".join(f"{names[k]} by {1e3 * length[k]:.1f} mm" for k in which)
    text = (
        f"Measurement points stand elsewhere on the flange: {listed}. Tool, targets or the zero of the last joint are "
        "not the same; taken out of the positions before the comparison."
    )
    return Difference(
        "points", {"point": ", ".join(names[k] for k in which)}, side, float(length.max()), "m", text, False
    )


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
    """Rows in their other order, which names are meant, and in which configurations; empty: in all."""

    rows: Int1D
    pairs: tuple[tuple[int, int], ...]
    where: str = ""


def _unit(recorded: Float2D, simulated: Float2D) -> float:
    spread, other = (float(np.sqrt(np.mean((x - x.mean(axis=0)) ** 2))) for x in (recorded, simulated))
    if spread == 0.0 or other == 0.0:
        return 1.0
    for factor in UNITS.values():
        if abs(spread / other / factor - 1) < CLOSE:
            return factor
    return 1.0


def _names(recorded: Float2D, simulated: Float2D, point: Int1D, configuration: Int1D, count: int) -> _Order | None:
    """Return which points have exchanged their names, everywhere or in some configurations; None if none have."""
    turn, shift, usual = min(
        (rigid(recorded, simulated, proper=proper) for proper in (True, False)), key=lambda r: r[2]
    )
    if usual < LEAST or not 2 <= count <= MOST_NAMES or len(recorded) % count:
        return None
    table = np.arange(len(recorded)).reshape(-1, count)
    if not np.array_equal(point[table], np.broadcast_to(np.arange(count), table.shape)):
        return None
    orders = [np.array(order) for order in itertools.permutations(range(count))]
    left = [rigid(recorded, simulated[table[:, order].reshape(-1)])[2] for order in orders]
    best = int(np.argmin(left))
    if left[best] <= BETTER * usual:
        return _Order(table[:, orders[best]].reshape(-1), _exchanged(orders[best]))
    # Targets that exchange their names in some configurations leave the frame nearly where it is.
    placed, rows, pairs, numbers = simulated @ turn.T + shift, table.copy(), set[tuple[int, int]](), []
    for number in np.unique(configuration):
        own = table[configuration[table[:, 0]] == number]
        apart = [float(np.sqrt(np.mean((recorded[own] - placed[own[:, order]]) ** 2))) for order in orders]
        best = int(np.argmin(apart))
        if BETTER * apart[0] > LEAST and apart[best] < BETTER * apart[0]:
            rows[configuration[table[:, 0]] == number] = own[:, orders[best]]
            pairs.update(_exchanged(orders[best]))
            numbers.append(str(number))
    if not numbers:
        return None
    return _Order(
        rows.reshape(-1), tuple(sorted(pairs, key=lambda pair: pair[1])), f"configurations {', '.join(numbers)}"
    )


def _exchanged(order: Int1D) -> tuple[tuple[int, int], ...]:
    return tuple((int(a), b) for b, a in enumerate(order) if a != b)
