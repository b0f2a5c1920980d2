"""How the joint angles of two recordings of one measurement are related: order, sign, zero, unit."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Sequence

import numpy as np

from calibration_core.diagnosis.comparison.result import Difference, Side
from calibration_core.timeseries import Float1D, Float2D, Int1D, Readings

SAME = 2e-3  # rad: servo and encoder leave less between two drives to one configuration
FEWEST = 4  # configurations that a relation needs
MOVED = 0.05  # rad: a joint that turns less shows no zero of its own
UNITS = {"rad": 1.0, "degrees": math.pi / 180, "degrees in the other": 180 / math.pi}


@dataclasses.dataclass(frozen=True)
class Link:
    """One recorded joint in terms of a simulated one: recorded = sign * unit * simulated + zero.

    Attributes:
        sign: 1 or -1.
        unit: Key of `UNITS`.
        zero: rad.
        misfit: rad, median of what is left.
    """

    joint: int
    sign: int
    unit: str
    zero: float
    misfit: float

    @property
    def plain(self) -> bool:
        """Whether sign, unit and zero are the same."""
        return self.sign == 1 and self.unit == "rad" and self.zero == 0.0


def postures(readings: Readings) -> tuple[Int1D, Float2D]:
    """Return the numbers of the configurations and their (k, n) mean joint angles, rad."""
    numbers, index = np.unique(readings.configuration, return_inverse=True)
    total = np.zeros((len(numbers), readings.q.shape[1]))
    np.add.at(total, index.reshape(-1), readings.q)
    return numbers, total / np.bincount(index.reshape(-1))[:, None]


def relation(recorded: Float2D, simulated: Float2D) -> tuple[Link, ...] | None:
    """Relate two lists of postures, (k, n) rad each, row by row; None if they have nothing to do with each other."""
    if len(recorded) < FEWEST:
        same = float(np.abs(recorded - simulated).max(initial=0.0)) < SAME
        return tuple(Link(i, 1, "rad", 0.0, 0.0) for i in range(recorded.shape[1])) if same else None
    n = recorded.shape[1]
    own = tuple(_link(recorded[:, i], simulated[:, i], i) for i in range(n))
    if all(link.plain and link.misfit < SAME for link in own):
        return own
    links = [[_link(recorded[:, i], simulated[:, j], j) for j in range(n)] for i in range(n)]
    cost = np.array([[_cost(links[i][j], i == j) for j in range(n)] for i in range(n)])
    rows, columns = _assigned(cost)
    chosen = [links[i][j] for i, j in zip(rows, columns, strict=True)]
    return tuple(chosen) if all(link.misfit < SAME for link in chosen) else None


def by_posture(recorded: Float2D, simulated: Float2D) -> tuple[Int1D, Int1D]:
    """Return indices of rows, (k, n) rad and (l, n) rad, that are the same posture, whatever their order."""
    distance = np.abs(recorded[:, None] - simulated[None]).max(axis=2)
    rows, columns = _assigned(np.minimum(distance, 1.0))
    near = distance[rows, columns] < SAME
    return rows[near], columns[near]


def as_recorded(links: Sequence[Link], simulated: Float2D) -> Float2D:
    """Return simulated angles, (m, n), as the recording has them, rad."""
    return np.column_stack([one.sign * UNITS[one.unit] * simulated[:, one.joint] + one.zero for one in links])


def joint_differences(links: Sequence[Link], joints: Sequence[str], side: Side) -> tuple[Difference, ...]:
    """Say in which way the joints are not the same."""
    found: list[Difference] = []
    moved = [i for i, link in enumerate(links) if link.joint != i]
    if moved:
        names = ", ".join(f"{joints[links[i].joint]} of the simulation is {joints[i]} of the recording" for i in moved)
        text = f"The joints stand in another order: {names}."
        found.append(_difference("joint_order", [joints[i] for i in moved], side, text, "exchange the angles of {}"))
    turned = [joints[i] for i, link in enumerate(links) if link.sign < 0]
    if turned:
        text = f"The sign of {', '.join(turned)} is the opposite."
        remedy = "turn the sign of {}, or use the robot file in which its axis points the other way"
        found.append(_difference("wrong_robot_file", turned, side, text, remedy))
    scaled = [joints[i] for i, link in enumerate(links) if link.unit != "rad"]
    if scaled:
        text = f"The angles of {', '.join(scaled)} differ by the factor of degrees to radians."
        remedy = "give the angles of {} in rad"
        one = _difference("angle_unit", scaled, side, text, remedy)
        factor = 1 / UNITS[next(link.unit for link in links if link.unit != "rad")]
        found.append(dataclasses.replace(one, magnitude=180 / math.pi, further={**one.further, "factor": factor}))
    for i, link in enumerate(links):
        if link.zero:
            text = f"{joints[i]} has another zero: recorded minus simulated is {link.zero:+z.4f} rad."
            remedy = f"master {{}} again, or subtract {link.zero:+z.4f} rad from its angles"
            if side == "simulation":
                remedy = f"add {link.zero:+z.4f} rad to the angles of {{}}"
            one = _difference("wrong_robot_file", [joints[i]], side, text, remedy)
            found.append(dataclasses.replace(one, magnitude=abs(link.zero), unit="rad"))
    return tuple(found)


def _link(recorded: Float1D, simulated: Float1D, joint: int) -> Link:
    """Find the simplest way from one column of angles to the other, of those that fit."""
    best: Link | None = None
    for unit, factor in UNITS.items():
        for sign in (1, -1):
            rest = recorded - sign * factor * simulated
            shift = float(np.median(rest)) if np.ptp(recorded) > MOVED and np.ptp(simulated) * factor > MOVED else 0.0
            for zero in (0.0, shift):
                link = Link(joint, sign, unit, zero, float(np.median(np.abs(rest - zero))))
                if link.misfit < SAME:
                    return link
                if best is None or link.misfit < best.misfit:
                    best = link
    assert best is not None  # noqa: S101 - the loops are not empty
    return best


def _cost(link: Link, own: bool) -> float:
    """Rank links: those that fit before those that do not, the joint itself and plain ones first."""
    if link.misfit >= SAME:
        return 1e3 + link.misfit
    return (0.0 if own else 1.0) + (0.0 if link.plain else 0.5)


def _difference(kind: str, joints: Sequence[str], side: Side, text: str, remedy: str) -> Difference:
    listed = ", ".join(joints)
    size, further = float(len(joints)), {"joints": list(joints)}
    return Difference(kind, {"joint": listed}, side, size, "1", text, True, remedy.format(listed), further)


def _assigned(cost: Float2D) -> tuple[Int1D, Int1D]:
    """Return rows and columns of the cheapest assignment."""
    from scipy.optimize import linear_sum_assignment  # slow to load, and a recording by itself does not need it

    rows, columns = linear_sum_assignment(cost)
    return rows, columns
