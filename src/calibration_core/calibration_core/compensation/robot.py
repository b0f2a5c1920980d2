"""The calibrated robot under load: where its tool stands, effects of the extended model included."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator

import numpy as np

from calibration_core.cell import Cell
from calibration_core.model.chain import Chain, pose_matrix
from calibration_core.model.effects import effects_with
from calibration_core.model.effects.applied import REFERENCE, restored, side_springs, with_side_torques
from calibration_core.model.effects.candidate import Candidate, Trait
from calibration_core.model.effects.state import State, state_of
from calibration_core.model.equilibrium import Equilibrium, solve_equilibrium
from calibration_core.model.kinematics import cross, turned
from calibration_core.model.parameters import AppliedEffect, ModelParameters
from calibration_core.model.robot import chain_of
from calibration_core.model.statics import Load
from calibration_core.timeseries import Float1D, Float2D, Float3D, Int1D

LEVER = 0.5  # m, from the tool's origin to the three points by which effects turn it


@dataclasses.dataclass(frozen=True, eq=False)
class Conditions:
    """What is known of m places besides angles and load.

    Attributes:
        time: (m,) s, NaN where unknown.
        temperature: (m,) degrees Celsius, NaN where unknown.
        path: (m,) number of the path, rows of one in order of travel; -1: a place of its own.
    """

    time: Float1D
    temperature: Float1D
    path: Int1D

    @staticmethod
    def unknown(m: int) -> Conditions:
        """Return the conditions of m places of which nothing is known."""
        return Conditions(np.full(m, np.nan), np.full(m, np.nan), np.full(m, -1))

    def rows(self, rows: Int1D) -> Conditions:
        """Return those of some places."""
        return Conditions(self.time[rows], self.temperature[rows], self.path[rows])


@dataclasses.dataclass(frozen=True, eq=False)
class CalibratedRobot:
    """A calibrated robot with its tool.

    Attributes:
        chain: With corrected geometry and the payload.
        tool: (4, 4) pose of the tool in the flange frame.
        point: Measurement point that the tool's origin is, and whose uncertainty is therefore its own; None: none.
        payload: kg, mass of what it carries besides what the cell file says.
    """

    cell: Cell
    parameters: ModelParameters
    chain: Chain
    tool: Float2D
    point: str | None = None
    payload: float = 0.0

    @staticmethod
    def of(cell: Cell, parameters: ModelParameters, payload: tuple[float, ...] | None = None) -> CalibratedRobot:
        """Return the robot.

        Args:
            cell: The cell.
            parameters: The model.
            payload: Mass (kg) and centre of gravity (m, flange frame) of what it carries besides; None: nothing.

        Raises:
            CellError: The robot cannot be read.
        """
        chain = chain_of(cell).corrected(parameters.geometry)
        mass = 0.0 if payload is None else payload[0]
        return CalibratedRobot(cell, parameters, with_payload(chain, payload), tool_frame(cell), payload=mass)

    def at_point(self, point: str) -> CalibratedRobot:
        """Return the same robot with its tool's origin at a measurement point, as it was identified."""
        tool = self.tool.copy()
        tool[:3, 3] = self.parameters.points[point]
        return dataclasses.replace(self, tool=tool, point=point)

    def load(self, wrench: Float2D, axes: str = "base") -> Load | None:
        """Return the external load of (m, 6) N and N*m at the wrench point; None where there is none.

        Args:
            wrench: (m, 6), base axes or tool axes.
            axes: `base` or `tool`.

        Raises:
            CellError: There is a load, and the cell file has no wrench point.
        """
        if not np.any(wrench):
            return None
        point = self.cell.frames.wrench_point
        if point is None:
            raise self.cell.missing("frames.wrench_point", "an external load")
        rotation = self.tool[:3, :3] if axes == "tool" else None
        return Load(wrench[:, :3].T, wrench[:, 3:].T, np.array(point), rotation)

    def stand(self, q: Float2D, load: Load | None) -> Equilibrium:
        """Return the equilibrium at encoder angles (m, n) rad, effects left aside."""
        return solve_equilibrium(self.chain, q, self.parameters.compliance, load)

    def places(self, rest: Equilibrium) -> tuple[Float2D, Float3D]:
        """Return origin (3, m) m and axes (3, 3, m), columns, of the tool, base frame, effects left aside."""
        return rest.at.point(self.tool[:3, 3]), turned(rest.at.flange, self.tool[:3, :3])


def tool_frame(cell: Cell) -> Float2D:
    """Return the (4, 4) pose of the tool in the flange frame: as the cell file says, else at the wrench point."""
    tool, point = cell.frames.tool, cell.frames.wrench_point
    if tool is not None:
        return pose_matrix(np.array(tool.xyz), np.array(tool.rpy))
    pose = np.eye(4)
    if point is not None:
        pose[:3, 3] = point
    return pose


def with_payload(chain: Chain, payload: tuple[float, ...] | None) -> Chain:
    """Return the chain that carries a payload: mass (kg) and centre of gravity (m, flange frame)."""
    if payload is None:
        return chain
    extra, centre = payload[0], chain.flange_translation + chain.flange_rotation @ np.array(payload[1:])
    mass = np.zeros(chain.n) if chain.mass is None else chain.mass.copy()
    com = np.zeros((chain.n, 3)) if chain.com is None else chain.com.copy()
    weights = [
        (0.0, np.zeros(3)) if one.mass is None or one.com is None else (one.mass, one.com) for one in chain.mimics
    ]
    if chain.mimics and chain.mimics[-1].behind == chain.n:  # the flange is on its link
        weights[-1] = _together(*weights[-1], extra, centre)
    else:
        mass[-1], com[-1] = _together(mass[-1], com[-1], extra, centre)
    mimics = tuple(
        dataclasses.replace(one, mass=weight, com=middle)
        for one, (weight, middle) in zip(chain.mimics, weights, strict=True)
    )
    return dataclasses.replace(chain, mass=mass, com=com, mimics=mimics)


def _together(mass: float, com: Float1D, extra: float, centre: Float1D) -> tuple[float, Float1D]:
    """Return mass (kg) and centre of gravity (3,) m of a link and what it carries besides."""
    total = mass + extra
    return total, (mass * com + extra * centre) / total if total > 0 else com


@dataclasses.dataclass(frozen=True, eq=False)
class LocalEffects:
    """Effects at some of the places: those of one path, or all that are no path.

    Attributes:
        rows: (k,) which places.
        states: The robot there, at the tool's origin and at three points beside it.
        effects: Position in the model, candidate, and the torque that its law refers to, for every effect that applies.
    """

    rows: Int1D
    states: tuple[State, ...]
    effects: tuple[tuple[int, Candidate, float | None], ...]

    def columns(self, index: int) -> Float3D:
        """Return how the tool moves and turns with the parameters of one of `effects`, (k, 6, p) m and rad per unit."""
        _, candidate, reference = self.effects[index]
        moved = [candidate.columns(_referred(state, reference)) for state in self.states]
        if len(moved) == 1:
            return moved[0]
        turn = np.zeros_like(moved[0])
        for k in range(3):
            arm = (self.states[k + 1].point - self.states[0].point) / LEVER
            for p in range(turn.shape[2]):
                turn[:, :, p] += cross(arm, (moved[k + 1][:, :, p] - moved[0][:, :, p]).T).T / (2 * LEVER)
        return np.concatenate([moved[0], turn], axis=1)


def parts_of(
    robot: CalibratedRobot,
    q: Float2D,
    load: Load | None,
    rest: Equilibrium,
    conditions: Conditions,
    *,
    turns: bool = True,
) -> Iterator[LocalEffects]:
    """Yield the effects of the model place by place.

    Args:
        robot: The robot.
        q: (m, n) rad.
        load: External load of every place.
        rest: The equilibrium there.
        conditions: Times, temperatures, paths.
        turns: Whether the tool's rotation is asked for, too.
    """
    if not robot.parameters.effects:
        return
    for number in np.unique(conditions.path):
        rows = np.flatnonzero(conditions.path == number)
        states = tuple(_states(robot, q, load, rest, conditions, rows, turns=turns))
        springs = side_springs(robot.parameters.effects, states[0])
        states = tuple(with_side_torques(state, springs) for state in states)
        effects = tuple(_applying(robot.parameters.effects, states[0], ordered=bool(number >= 0)))
        yield LocalEffects(rows, states, effects)


def left_aside(robot: CalibratedRobot, parts: tuple[LocalEffects, ...]) -> tuple[AppliedEffect, ...]:
    """Return the effects that apply nowhere: of the measurement, or lacking times, temperatures or a path."""
    used = {index for part in parts for index, _, _ in part.effects}
    return tuple(effect for k, effect in enumerate(robot.parameters.effects) if k not in used)


def _states(
    robot: CalibratedRobot,
    q: Float2D,
    load: Load | None,
    rest: Equilibrium,
    conditions: Conditions,
    rows: Int1D,
    *,
    turns: bool,
) -> Iterator[State]:
    k = len(rows)
    travelled = bool(conditions.path[rows[0]] >= 0)
    part = rows_of(rest, rows)
    own = None if load is None else load.rows(rows)
    wrench = None if own is None else np.vstack([own.force, own.torque]).T
    origin = robot.tool[:3, 3]
    points = [origin, *(origin + LEVER * robot.tool[:3, axis] for axis in range(3))] if turns else [origin]
    steps = np.arange(k)
    for point in points:
        yield state_of(
            robot.chain,
            q[rows],
            robot.parameters.compliance,
            own,
            np.tile(point[:, None], (1, k)),
            point_index=np.zeros(k, dtype=np.int64),
            wrench=wrench,
            configuration=np.zeros(k, dtype=np.int64) if travelled else steps,
            step=steps if travelled else np.zeros(k, dtype=np.int64),
            time=conditions.time[rows],
            temperature=conditions.temperature[rows],
            tracker=robot.parameters.tracker,
            rated_load=robot.cell.robot.rated_load,
            rest=part,
        )


def rows_of(rest: Equilibrium, rows: Int1D) -> Equilibrium:
    """Return the equilibrium of some of the places."""
    if len(rows) == rest.deflection.shape[1]:
        return rest
    return rest.of_readings(rows)


def _applying(
    effects: tuple[AppliedEffect, ...], state: State, *, ordered: bool
) -> Iterator[tuple[int, Candidate, float | None]]:
    acting = effects_with(Trait.ACTS_IN_USE)
    if not ordered:
        acting -= effects_with(Trait.PATH)
    for k, effect in enumerate(effects):
        if effect.effect not in acting:
            continue
        try:
            candidate = restored(effect, state)
        except ValueError:  # it needs times or temperatures that the task does not have: `left_aside` names it
            continue
        yield k, candidate, effect.parameters.get(REFERENCE)


def _referred(state: State, reference: float | None) -> State:
    if reference is None:
        return state
    return dataclasses.replace(state, reference_torque=np.full((2, state.chain.n), reference))
