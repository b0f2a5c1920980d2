"""How a calibrated robot deflects under a load: tool and points, with intervals; its stiffness; a map over a plane."""

from __future__ import annotations

import dataclasses

import numpy as np

from calibration_core.compensation.inverse import reach_for, rigid, turning
from calibration_core.compensation.motion import covariance_of, tool_columns, tool_movement
from calibration_core.compensation.robot import CalibratedRobot, Conditions, LocalEffects, parts_of
from calibration_core.model.equilibrium import Equilibrium
from calibration_core.model.identified.gaussian import GaussianEstimate
from calibration_core.model.robot import chain_of
from calibration_core.timeseries import Float1D, Float2D, Float3D

TOOL = "tool"
QUANTILE = 1.959963984540054  # 95 % of a normal distribution, two-sided
PROBE = 1.0  # N, by which the stiffness at the working load is felt
GRID = 25  # places along either side of a map
PLANES = {"xy": (0, 1), "xz": (0, 2), "yz": (1, 2)}


@dataclasses.dataclass(frozen=True, eq=False)
class Deflection:
    """What a load does at m places, against the robot under its own weight and payload; base axes.

    Attributes:
        names: The tool, then the measurement points, p of them.
        moved: (m, p, 6) m and rad.
        u95: (m, p, 6) half widths of the 95 % intervals, m and rad; NaN without a covariance.
        compliance: (m, 3, 3) m/N, of the tool's origin at the load, effects included.
    """

    names: tuple[str, ...]
    moved: Float3D
    u95: Float3D
    compliance: Float3D

    def stiffness(self) -> tuple[Float2D, Float3D]:
        """Return main stiffnesses (m, 3) N/m, the softest first, and their directions (m, 3, 3), rows, base axes."""
        symmetric = (self.compliance + np.swapaxes(self.compliance, 1, 2)) / 2
        values, vectors = np.linalg.eigh(symmetric)
        soft = values[:, ::-1]
        stiff = np.where(soft > 0, 1 / np.where(soft > 0, soft, 1.0), np.inf)
        return stiff, np.swapaxes(vectors[:, :, ::-1], 1, 2)


def deflect(
    robot: CalibratedRobot,
    q: Float2D,
    wrench: Float2D,
    conditions: Conditions,
    estimate: GaussianEstimate | None,
    axes: str = "base",
) -> Deflection:
    """Return what a load does at given encoder angles.

    Args:
        robot: The robot with its payload, which is no part of the load.
        q: (m, n) rad.
        wrench: (m, 6) N and N*m of the environment on the robot, at the wrench point.
        conditions: Times, temperatures, paths.
        estimate: Covariance of the model; None: no intervals.
        axes: Axes of the wrenches: `base` or `tool`.

    Raises:
        CellError: There is a load, and the cell file has no wrench point.
        EquilibriumError: A load is beyond what the joints can carry.
    """
    named = {TOOL: None, **robot.parameters.points}
    loaded, bare = (_stand(robot, q, one, conditions, axes) for one in (wrench, np.zeros_like(wrench)))
    m = len(q)
    moved, u95 = np.zeros((m, len(named), 6)), np.full((m, len(named), 6), np.nan)
    by_effects = tool_movement(robot, loaded.parts, m) - tool_movement(robot, bare.parts, m)
    turned = _turned(robot, loaded.rest, bare.rest)
    own = robot.tool[:3, 3]
    for k, point in enumerate(named.values()):
        at = own if point is None else np.asarray(point)
        shift = (loaded.rest.at.point(at) - bare.rest.at.point(at)).T
        arm = (loaded.rest.at.point(at) - loaded.rest.at.point(own)).T
        moved[:, k, :3] = shift + by_effects[:, :3] + np.cross(by_effects[:, 3:], arm)
        moved[:, k, 3:] = turned + by_effects[:, 3:]
    if estimate is not None:
        difference = [tool_columns(robot, one.rest, one.parts, estimate) for one in (loaded, bare)]
        columns = difference[0] - difference[1]
        for k, (name, point) in enumerate(named.items()):
            at = own if point is None else np.asarray(point)
            own_columns = _at_point(robot, loaded.rest, difference[0], at) - _at_point(
                robot, bare.rest, difference[1], at
            )
            here = columns if point is None else own_columns
            here = here + _of_point(loaded.rest, bare.rest, name, estimate)
            variance = np.einsum("mii->mi", covariance_of(here, estimate))
            u95[:, k] = QUANTILE * np.sqrt(np.maximum(variance, 0.0))
    return Deflection(tuple(named), moved, u95, _compliance(robot, q, wrench, conditions, axes))


@dataclasses.dataclass(frozen=True, eq=False)
class _Standing:
    """A robot under a load, with its effects."""

    rest: Equilibrium
    parts: tuple[LocalEffects, ...]


def _stand(robot: CalibratedRobot, q: Float2D, wrench: Float2D, conditions: Conditions, axes: str) -> _Standing:
    load = robot.load(wrench, axes)
    rest = robot.stand(q, load)
    return _Standing(rest, tuple(parts_of(robot, q, load, rest, conditions)))


def _turned(robot: CalibratedRobot, loaded: Equilibrium, bare: Equilibrium) -> Float2D:
    return turning(robot.places(bare)[1], robot.places(loaded)[1]).T


def _at_point(robot: CalibratedRobot, rest: Equilibrium, columns: Float3D, point: Float1D) -> Float3D:
    """Return the columns of another point of the flange from those of the tool's origin: both are one rigid body."""
    arm = (rest.at.point(point) - rest.at.point(robot.tool[:3, 3])).T
    moved = columns.copy()
    moved[:, :3] += np.cross(np.swapaxes(columns[:, 3:], 1, 2), arm[:, None]).swapaxes(1, 2)
    return moved


def _of_point(loaded: Equilibrium, bare: Equilibrium, name: str, estimate: GaussianEstimate) -> Float3D:
    """Return how the deflection of a point depends on where it sits on the flange, (m, 6, p)."""
    change = np.moveaxis(loaded.at.flange - bare.at.flange, -1, 0)  # (m, axis of the flange, base)
    columns = np.zeros((len(change), 6, len(estimate.names)))
    for axis, letter in enumerate("xyz"):
        full = f"measurement_points.{name}.{letter}"
        if full in estimate.names:
            columns[:, :3, estimate.names.index(full)] = change[:, axis]
    return columns


def _compliance(robot: CalibratedRobot, q: Float2D, wrench: Float2D, conditions: Conditions, axes: str) -> Float3D:
    """Return (m, 3, 3) m/N at the tool's origin by central differences of the force there, about the working load.

    Displacements and forces are in base axes, whatever the axes of the wrench.
    """
    m = len(q)
    tool_axes = rigid(robot.chain, robot.tool)(q, np.arange(m))[1]  # (axis, base, m)
    result = np.zeros((m, 3, 3))
    for axis in range(3):
        ends = []
        for sign in (1.0, -1.0):
            extra = wrench.copy()
            extra[:, axis] += sign * PROBE
            at = _stand(robot, q, _at_wrench_point(robot, extra, tool_axes, axis, sign, axes), conditions, axes)
            shift = tool_movement(robot, at.parts, m)[:, :3]
            ends.append(at.rest.at.point(robot.tool[:3, 3]).T + shift)
        result[:, :, axis] = (ends[0] - ends[1]) / (2 * PROBE)
    return result if axes == "base" else np.asarray(np.einsum("mia,abm->mib", result, tool_axes))


def _at_wrench_point(
    robot: CalibratedRobot, wrench: Float2D, tool_axes: Float3D, axis: int, sign: float, axes: str
) -> Float2D:
    """Add the torque about the wrench point of a probing force at the tool's origin; `tool_axes` (axis, base, m)."""
    point = robot.cell.frames.wrench_point
    if point is None:
        return wrench
    lever = robot.tool[:3, 3] - np.array(point)  # flange axes
    in_tool = robot.tool[:3, :3].T @ lever
    arm = np.einsum("abm,a->mb", tool_axes, in_tool) if axes == "base" else np.tile(in_tool, (len(wrench), 1))
    force = np.zeros(3)
    force[axis] = sign * PROBE
    result = wrench.copy()
    result[:, 3:] += np.cross(arm, force)
    return result


@dataclasses.dataclass(frozen=True, eq=False)
class PlaneMap:
    """How far the tool yields over a plane, its orientation kept.

    Attributes:
        plane: `xy`, `xz` or `yz`.
        across: (k,) m along the first axis.
        up: (k,) m along the second.
        size: (k, k) m, rows along the second axis; NaN where the robot does not reach.
    """

    plane: str
    across: Float1D
    up: Float1D
    size: Float2D


def plane_map(robot: CalibratedRobot, q: Float1D, wrench: Float1D, plane: str, axes: str = "base") -> PlaneMap:
    """Map the deflection of the tool's origin over the plane through the tool at given angles.

    Args:
        robot: The robot.
        q: (n,) rad, whose orientation of the tool, and branch, are kept.
        wrench: (6,) N and N*m at the wrench point.
        plane: Which plane, base axes.
        axes: Axes of the wrench.

    Raises:
        CellError: There is a load, and the cell file has no wrench point.
        EquilibriumError: A load is beyond what the joints can carry.
    """
    chain = chain_of(robot.cell)
    forward = rigid(chain, robot.tool)
    origin, goal, _ = forward(q[None], np.arange(1))
    first, second = PLANES[plane]
    sides = []
    for axis in (first, second):
        low = -chain.reach if axis != 2 else min(0.0, float(origin[2, 0]))
        sides.append(np.linspace(low, chain.reach, GRID))
    across, up = sides
    grid = np.tile(origin, (1, GRID * GRID))
    grid[first], grid[second] = np.tile(across, GRID), np.repeat(up, GRID)
    start = np.tile(q, (GRID * GRID, 1))
    found = reach_for(grid, np.tile(goal, (1, 1, GRID * GRID)), start, forward, chain.reach, far=True)
    inside = np.all((found.q >= chain.limits[:, 0]) & (found.q <= chain.limits[:, 1]), axis=1) & found.arrived
    size = np.full(GRID * GRID, np.nan)
    rows = np.flatnonzero(inside)
    if len(rows):
        load = np.tile(wrench, (len(rows), 1))
        some = Conditions.unknown(len(rows))
        places = []
        for one in (load, np.zeros_like(load)):
            at = _stand(robot, found.q[rows], one, some, axes)
            shift = tool_movement(robot, at.parts, len(rows))[:, :3]
            places.append(at.rest.at.point(robot.tool[:3, 3]).T + shift)
        size[rows] = np.linalg.norm(places[0] - places[1], axis=1)
    return PlaneMap(plane, across, up, size.reshape(GRID, GRID))
