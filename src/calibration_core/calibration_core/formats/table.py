"""Joint-angle corrections over a grid: for controllers that add a table to their commands.

At every node the calibrated robot, bent by its own weight, stands with the corrected angles where the nominal robot
would stand with the commanded ones.  Between nodes the table is interpolated linearly in every joint.
"""

from __future__ import annotations

import dataclasses
import math

import numpy as np

from calibration_core.errors import InputError
from calibration_core.files.written import csv_bytes
from calibration_core.formats.calibrated import SEED, Deviation, Exported, ExportedRobot, flange_poses
from calibration_core.model.chain import Chain
from calibration_core.model.equilibrium import solve_equilibrium
from calibration_core.model.kinematics import by_axis, posture
from calibration_core.timeseries import Float1D, Float2D, Float3D, Int1D

FILE = "corrections.csv"
POSTURES = 1000
MOST_NODES = 200_000
ITERATIONS = 12
CLOSE = 1e-12  # rad, of the last step
NEARLY_SINGULAR = 8e-2  # per reach: smallest singular value of the flange's Jacobian, m/rad, below which corrections
HELD_BACK = 2e-2  # are held back, at most by so much, the same unit
CHUNK = 5000
WRIST = math.radians(45.0)  # of the last joint but one: out of the wrist's singularity


@dataclasses.dataclass(frozen=True)
class DeflectionGrid:
    """Which joints the table runs over.

    Attributes:
        joints: Their numbers, from 1, in the order of the table's columns.
        points: Nodes per joint.
        q: Positions of all joints, (n,) rad, where they do not run; None: the middle of their limits, the last but one
            of six or more at 45 degrees.
        range: Lower and upper end for each of the joints, one after the other, rad; None: their limits.
    """

    joints: tuple[int, ...] = (2, 3)
    points: int = 21
    q: tuple[float, ...] | None = None
    range: tuple[float, ...] | None = None


def table_files(robot: ExportedRobot, grid: DeflectionGrid) -> Exported:
    """Return `corrections.csv`: positions of the running joints, and the corrections of all, rad (m where one slides).

    Raises:
        InputError: The grid does not fit the robot.
        EquilibriumError: The robot cannot carry its own weight.
    """
    chain = robot.chain
    index, held = _checked(chain, grid)
    ends = chain.limits[index] if grid.range is None else _ends(chain, index, grid.range)
    axes = [np.linspace(low, high, grid.points) for low, high in ends]
    nodes = np.stack([axis.ravel() for axis in np.meshgrid(*axes, indexing="ij")], axis=1)
    q = np.tile(held, (len(nodes), 1))
    q[:, index] = nodes
    correction = corrections(robot, q)
    between, error, uncorrected = _between(robot, index, held, axes, correction)
    names = [f"q{i + 1}" for i in index]
    head = [*names, *(f"dq{i + 1}" for i in range(chain.n))]
    others = ", ".join(f"q{i + 1} {held[i]:.6g}" for i in range(chain.n) if i not in index)
    return Exported(
        {FILE: csv_bytes(head, np.hstack([nodes, correction]).tolist())},
        deviations=(
            _size("the flange between nodes, beside the exact correction", between),
            _size("the flange between nodes, beside where the nominal robot would stand", error),
            _size("the flange without the table", uncorrected),
        ),
        notes=(
            f"Add dq to the commanded angles; interpolate linearly in {' and '.join(names)}.",
            f"The other joints stand at {others or 'no other position'}; away from there the table is no correction.",
            "External loads are not in it: for these, correct the targets (calibration compensate).",
        ),
    )


def _checked(chain: Chain, grid: DeflectionGrid) -> tuple[Int1D, Float1D]:
    """Return indices of the running joints and (n,) where the others stand."""
    place = "export --format table"
    numbers = f"different numbers from 1 to {chain.n}"
    if not grid.joints or len(set(grid.joints)) < len(grid.joints) or not all(1 <= j <= chain.n for j in grid.joints):
        raise InputError(place, "--joints", " ".join(map(str, grid.joints)) or "nothing", numbers)
    if grid.points < 2 or grid.points ** len(grid.joints) > MOST_NODES:
        raise InputError(place, "--points", str(grid.points), f"at least 2, and at most {MOST_NODES} nodes in all")
    held = chain.limits.mean(axis=1)
    if chain.n >= 6 and not chain.prismatic[-2]:
        held[-2] = np.clip(WRIST, *chain.limits[-2])
    if grid.q is not None:
        if len(grid.q) != chain.n or not all(math.isfinite(x) for x in grid.q):
            raise InputError(place, "--q", " ".join(map(str, grid.q)), f"{chain.n} finite numbers")
        held = np.array(grid.q)
    index = np.array([j - 1 for j in grid.joints], dtype=np.int64)
    outside = [i for i in range(chain.n) if i not in index and not chain.limits[i, 0] <= held[i] <= chain.limits[i, 1]]
    if outside:
        i = outside[0]
        low, high = chain.limits[i]
        raise InputError(place, "--q", f"{held[i]:g} for {chain.joints[i]}", f"{low:g} to {high:g}, the joint's limits")
    return index, held


def _ends(chain: Chain, index: Int1D, given: tuple[float, ...]) -> Float2D:
    """Return the (k, 2) ends of the running joints."""
    place, text = "export --format table", " ".join(map(str, given))
    if len(given) != 2 * len(index) or not all(math.isfinite(x) for x in given):
        raise InputError(place, "--range", text, f"{2 * len(index)} finite numbers, two for each of --joints")
    ends = np.array(given).reshape(-1, 2)
    limits = chain.limits[index]
    if np.any(ends[:, 0] >= ends[:, 1]) or np.any(ends[:, 0] < limits[:, 0]) or np.any(ends[:, 1] > limits[:, 1]):
        shown = ", ".join(f"{low:g} to {high:g}" for low, high in limits)
        raise InputError(place, "--range", text, f"ends within the joints' limits, {shown}, the lower first")
    return ends


def corrections(robot: ExportedRobot, q: Float2D) -> Float2D:
    """Return what to add to joint positions q, (m, n), so that the calibrated robot stands as the nominal would.

    Gauss-Newton on the pose of the flange, bent by the robot's weight.  Where more joints move it than it has degrees
    of freedom, the corrections are the smallest ones; the turn of a joint counts by what it moves at the robot's reach.
    A penalty on their size keeps them small where the robot is nearly singular, and an error remains there.
    Source: minimum norm, Whitney (1969); damping by the smallest singular value, Nakamura and Hanafusa (1986).

    Raises:
        EquilibriumError: The robot cannot carry its own weight.
    """
    return np.vstack([_newton(robot, q[begin : begin + CHUNK]) for begin in range(0, len(q), CHUNK)])


def _newton(robot: ExportedRobot, q: Float2D) -> Float2D:
    target = flange_poses(posture(robot.nominal, q))
    scale = robot.chain.reach  # rad to m: a turn counts by what it moves at this distance
    sizes = np.where(robot.chain.prismatic, 1.0, scale)  # per joint, of one unit of its correction, m
    dq = np.zeros_like(q)
    penalty: Float2D | None = None
    for _ in range(ITERATIONS):
        rest = solve_equilibrium(robot.chain, q + dq, robot.parameters.compliance, None)
        here = flange_poses(rest.at)
        turn = np.einsum("mij,mkj->mik", target[:, :3, :3], here[:, :3, :3])
        vector = np.stack([turn[:, 2, 1] - turn[:, 1, 2], turn[:, 0, 2] - turn[:, 2, 0], turn[:, 1, 0] - turn[:, 0, 1]])
        error = np.hstack([target[:, :3, 3] - here[:, :3, 3], scale * vector.T / 2])
        linear = rest.point_jacobian(np.zeros(3))
        angular = by_axis(rest.at.spins)
        jacobian = np.concatenate([linear, scale * angular])
        jacobian = np.einsum("anm,njm->maj", jacobian, rest.amplification)
        left, values, right = np.linalg.svd(jacobian / sizes, full_matrices=False)
        if penalty is None:
            penalty = HELD_BACK**2 * np.clip(1 - (values[:, -1:] / NEARLY_SINGULAR) ** 2, 0.0, 1.0)
        wanted = error + np.einsum("maj,mj->ma", jacobian, dq)
        gain = values / (values**2 + penalty)  # the penalty is above zero wherever a singular value is zero
        step = np.einsum("mki,mk->mi", right, gain * np.einsum("mak,ma->mk", left, wanted)) / sizes - dq
        dq = dq + step
        if np.abs(step).max(initial=0.0) < CLOSE:
            break
    return dq


def _between(
    robot: ExportedRobot, index: Int1D, held: Float1D, axes: list[Float1D], correction: Float2D
) -> tuple[Float1D, Float1D, Float1D]:
    """Return errors of the flange, (POSTURES,) m: to the exact correction, to the nominal place, without a table."""
    from scipy.interpolate import RegularGridInterpolator

    chain = robot.chain
    shape = [len(axis) for axis in axes]
    lookup = RegularGridInterpolator(axes, correction.reshape(*shape, chain.n))
    rng = np.random.default_rng(SEED)
    q = np.tile(held, (POSTURES, 1))
    ends = np.array([axis[[0, -1]] for axis in axes])
    q[:, index] = rng.uniform(ends[:, 0], ends[:, 1], (POSTURES, len(index)))
    places = _places(robot, np.stack([q + lookup(q[:, index]), q + corrections(robot, q), q]))
    nominal = posture(robot.nominal, q).flange_origin.T
    between = np.linalg.norm(places[0] - places[1], axis=1)
    return between, np.linalg.norm(places[0] - nominal, axis=1), np.linalg.norm(places[2] - nominal, axis=1)


def _places(robot: ExportedRobot, q: Float3D) -> Float3D:
    """Return (k, m, 3) m, where the calibrated robot's flange stands at joint positions (k, m, n)."""
    compliance = robot.parameters.compliance
    return np.stack([solve_equilibrium(robot.chain, one, compliance, None).at.flange_origin.T for one in q])


def _size(what: str, error: Float1D) -> Deviation:
    return Deviation(what, len(error), float(error.max()), float(np.sqrt(np.mean(error**2))))
