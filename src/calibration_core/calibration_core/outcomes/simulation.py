"""A plan as a model measures it: readings and streams."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from pathlib import Path

import numpy as np

from calibration_core.cell import Cell
from calibration_core.diagnosis.comparison.result import FormatLoss
from calibration_core.diagnosis.result.finding import Diagnosis
from calibration_core.diagnosis.waterfall import with_sound_angles
from calibration_core.files.yaml_file import yaml_text
from calibration_core.formats.calibrated import ExportedRobot, calibrated_robot
from calibration_core.formats.mjcf import FILE as MJCF
from calibration_core.formats.mjcf import mjcf_files
from calibration_core.formats.springs import springs_of
from calibration_core.formats.urdf import URDF, urdf_files
from calibration_core.identification.result.estimate import OperatingSpace
from calibration_core.identification.stiffness.predict import predict_readings
from calibration_core.model.chain import rpy_of
from calibration_core.model.effects.words import effect_sentence
from calibration_core.model.identified.model_file import GivenModel
from calibration_core.model.nominal import nominal_parameters
from calibration_core.model.parameters import AppliedEffect, ModelParameters
from calibration_core.model.simulation.simulate import Schedule, as_recording, simulate_plan
from calibration_core.outcomes.inputs import naming_model, refuse_lengths
from calibration_core.outcomes.spaces import scheduled_space
from calibration_core.planning.loaded import make_plan
from calibration_core.planning.plans.plan import Plan
from calibration_core.recording.tables.table import write_table
from calibration_core.report.writing.output import Content
from calibration_core.timeseries import Float2D, Note, Readings, Streams

BAG, TABLE = "recording", "measurements.csv"


@dataclasses.dataclass(frozen=True, eq=False)
class Simulated:
    """What was simulated, and by which model.

    Attributes:
        plan: What was measured, spares left out.
        made: Whether the plan was made here, because none was given.
        parameters: The simulated model.
        seed: Seed of the instrument noise; None: no noise.
        readings: The measurement table.
        recording: The streams of the bag.
        space: The operating space, with the deflections under the largest load.
        inputs: Role -> file -> SHA-256 of input files besides the cell's.
        notes: What must be stated of the given model.
    """

    plan: Plan
    made: bool
    parameters: ModelParameters
    seed: int | None
    readings: Readings
    recording: Streams
    space: OperatingSpace
    inputs: dict[str, dict[str, str]]
    notes: tuple[Note, ...] = ()

    @property
    def loaded(self) -> bool:
        """Whether the plan has external loads."""
        return self.space.force is not None

    @property
    def deflections(self) -> np.ndarray:
        """(k,) m, length of the first point's deflection under each configuration's largest force; zeros unloaded."""
        deflection = self.space.deflection
        return np.zeros(len(self.space.q)) if deflection is None else np.linalg.norm(deflection, axis=1)


def simulate(
    cell: Cell,
    plan: Plan | None,
    given: GivenModel | None,
    seed: int | None,
    inputs: Mapping[str, dict[str, str]] | None = None,
) -> Simulated:
    """Predict all readings and streams of a plan.

    Args:
        cell: The cell.
        plan: What is measured; None makes a plan.
        given: An identified model; None takes what the cell file believes.
        seed: Of the instrument noise; None: none.
        inputs: Role -> file -> SHA-256 of the files that the plan came from.

    Raises:
        InputError: Plan, model or cell cannot be used.
        EquilibriumError: A load is beyond what the joints can carry.
    """
    refuse_lengths(cell)
    parameters = nominal_parameters(cell) if given is None else given.parameters
    named = None if given is None else Path(given.file)
    with naming_model(named):
        chosen = make_plan(cell, parameters=parameters) if plan is None else plan
    schedule = Schedule.of(chosen.primary)
    if np.any(schedule.wrench) and not np.any(parameters.compliance):
        raise cell.missing("robot.stiffness", "simulating deflections (or an identified model, --model)")
    measured = (*chosen.preparation, *chosen.primary)
    with naming_model(named):
        readings = simulate_plan(measured, cell, parameters, seed)
    return Simulated(
        plan=chosen,
        made=plan is None,
        parameters=parameters,
        seed=seed,
        readings=readings,
        recording=as_recording(measured, for_streams(cell), parameters, seed),
        space=scheduled_space(schedule, cell, parameters),
        inputs={**(inputs or {}), **({} if given is None else given.digest)},
        notes=() if given is None else given.notes,
    )


def for_streams(cell: Cell) -> Cell:
    """Return the cell with absolute points: a tracker streams positions, also where a table holds differences."""
    if cell.measurements.points == "absolute":
        return cell
    return cell.model_copy(update={"measurements": cell.measurements.model_copy(update={"points": "absolute"})})


def as_stated(readings: Readings, cell: Cell) -> Readings:
    """Return readings with the joint angles of the cell's files, where one joint's angle is coupled to another's."""
    if not cell.robot.joint_coupling:
        return readings
    return dataclasses.replace(readings, q=readings.q @ np.linalg.inv(cell.robot.coupling).T)


# --- the simulation that a diagnosis hands over -----------------------------------------------------------------------


SIMULATION, CELL_LINES = "simulation.csv", "cell_lines.yaml"


def with_losses(found: Diagnosis, cell: Cell) -> Diagnosis:
    """Add to an improved simulation what each kind of simulator cannot hold of it, and what that costs.

    Raises:
        InputError: The model's geometry is that of no robot.
    """
    compared = next(iter(found.comparisons), None)
    if compared is None or compared.improved is None:
        return found
    improved = compared.improved
    robot = calibrated_robot(cell, found.handed_out[0])
    springs = springs_of(robot.chain, robot.further).held
    kinds: list[tuple[tuple[str, ...], tuple[AppliedEffect, ...], bool]]
    kinds = [((CELL_LINES, URDF), (), True), ((URDF,), (), False)]
    if not robot.chain.mimics:
        kinds.append(((MJCF,), springs, True))
    losses = []
    for files, held, bends in kinds:
        left = [effect for effect in robot.further if effect not in held]
        words = [effect_sentence(effect.effect, effect.location) for effect in left]
        model = robot.parameters.replace(effects=(*robot.folded, *held))
        if not bends and np.any(model.compliance):
            words.insert(0, "the springs of the joints")
            model = model.replace(compliance=np.zeros_like(model.compliance))
        more = improved.left_by(model) ** 2 - improved.rms**2 if words else 0.0
        losses.append(FormatLoss(files, tuple(dict.fromkeys(words)), max(more, 0.0) ** 0.5))
    improved = dataclasses.replace(improved, losses=tuple(losses))
    return dataclasses.replace(found, comparisons=(dataclasses.replace(compared, improved=improved),))


def improved_files(found: Diagnosis, recorded: Readings, cell: Cell, folder: Path) -> Mapping[str, Content]:
    """Return the files of the improved simulation, name -> content; none where there is none."""
    compared = next(iter(found.comparisons), None)
    if compared is None or compared.improved is None:
        return {}
    model = found.handed_out[0]
    sound = with_sound_angles(found, recorded)
    again = dataclasses.replace(sound, position=predict_readings(sound, cell, model))
    robot = calibrated_robot(cell, model)
    mujoco = {} if robot.chain.mimics else mjcf_files(robot).files
    return {
        SIMULATION: lambda path: write_table(path, as_stated(again, cell)),
        CELL_LINES: _cell_lines(robot, cell, model).encode(),
        **urdf_files(robot, folder).files,
        **mujoco,
    }


def _cell_lines(robot: ExportedRobot, cell: Cell, model: ModelParameters) -> str:
    """Return what of the cell file changes, in its own words."""
    from_dh = cell.urdf_path is None
    stiffness = [float(1 / c) if c > 0 else float("inf") for c in model.compliance]
    frames: dict[str, object] = {"measurement_points": {name: _numbers(at) for name, at in model.points.items()}}
    if cell.frames.tracker is not None:
        frames["tracker"] = _pose(model.tracker)
    if model.wrench_point is not None:
        frames["wrench_point"] = _numbers(model.wrench_point)
    if model.force_torque is not None:
        frames["force_torque"] = _pose(model.force_torque)
    links = {"base_link": "base_link", "flange": "flange"} if from_dh else {}
    lines = {"robot": {"urdf": URDF, **links, "stiffness": stiffness}, "frames": frames}
    instead = "; the URDF stands for dh, modified_dh, joint_limits, joint_types and inertials" if from_dh else ""
    head = f"# What changes in {cell.path.name}: these keys stand for those of the same name{instead}.\n"
    held = len(robot.further)
    more = f"# {held} effects of the model have no words in a cell file: --model model.yaml has them.\n" if held else ""
    return head + more + yaml_text(lines, flow=None)


def _numbers(values: np.ndarray) -> list[float]:
    return [float(value) for value in values]


def _pose(matrix: Float2D) -> dict[str, list[float]]:
    return {"xyz": _numbers(matrix[:3, 3]), "rpy": _numbers(rpy_of(matrix[:3, :3]))}
