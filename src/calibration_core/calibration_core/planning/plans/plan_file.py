"""`plan.yaml`: what `calibration plan` writes and `calibration simulate` and the sequencer read.

    schema: 1
    robot: name of the robot
    made_for: {limits: [[lo, hi], ...], flange: [[x, y, z], ...]}   # may be missing: see `planned_robot`
    joints: [joint_1, ...]                 # the order of every q
    configurations:
      - {number: 1, q: [rad, ...], spare: false, steps: [[fx, fy, fz, tx, ty, tz], ...]}
    preparation:                           # may be missing: measured before, unloaded, phase by phase
      - {number: 1001, phase: base_frame, q: [rad, ...]}
    startup_cycle: [[rad, ...], ...]
    reference: {q: [rad, ...], every: 4}   # or null
    tolerances: {posture: rad, ...}        # may be missing: what a reading is held against, see `tolerances`
    expected: {efficiency: 0.95, ...}      # what the planner promised; passed over on reading where it is incomplete

Wrenches are in N and N*m, base axes, at the wrench point, one per load step, the first without load.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Collection, Mapping
from pathlib import Path
from typing import Any

import numpy as np

from calibration_core.cell import Cell
from calibration_core.errors import PlanError, beyond, quoted, rounded_down
from calibration_core.files.yaml_file import YamlFile, read_yaml, yaml_text
from calibration_core.model.robot import chain_of
from calibration_core.planning.plans.plan import PREPARATION, Expected, Plan, PlannedConfiguration, Reference
from calibration_core.planning.plans.planned_robot import PlannedRobot, planned_robot, read_planned_robot
from calibration_core.planning.plans.tolerances import read_tolerances
from calibration_core.timeseries import Float1D, Float2D

SCHEMA = 1
MAX_BYTES = 8 << 20
MAX_CONFIGURATIONS = 10_000
MAX_STEPS = 1000
KEYS = (
    "schema",
    "robot",
    "made_for",
    "joints",
    "configurations",
    "preparation",
    "startup_cycle",
    "reference",
    "tolerances",
    "expected",
)
EXPECTED_ARRAYS = {"compliance_std", "stiffness_std"}
EXPECTED_OPTIONAL = {"efficiency", "stiffness_std", "a_value", "e_value", "k_csm"}
EXPECTED_MAPPINGS = {"observability", "duration"}
SWEPT_KEYS = ("number", "phase", "q", "note")
ENTRY_KEYS = ("number", "q", "spare", "steps", "note")


def plan_dict(plan: Plan) -> dict[str, Any]:
    """Return the content of the file as plain values, in the order in which it is written."""
    reference, expected = plan.reference, plan.expected
    return {
        "schema": SCHEMA,
        "robot": plan.robot,
        **({} if plan.made_for is None else {"made_for": _made_for_dict(plan.made_for)}),
        "joints": list(plan.joints),
        "configurations": [
            {"number": c.number, "q": c.q.tolist(), "spare": c.spare, "steps": c.steps.tolist()}
            for c in plan.configurations
        ],
        **({"preparation": [_prepared_dict(c) for c in plan.preparation]} if plan.preparation else {}),
        "startup_cycle": plan.startup_cycle.tolist(),
        "reference": None if reference is None else {"q": reference.q.tolist(), "every": reference.every},
        "tolerances": dataclasses.asdict(plan.tolerances),
        "expected": None if expected is None else _expected_dict(expected),
    }


def _made_for_dict(robot: PlannedRobot) -> dict[str, Any]:
    return {"limits": robot.limits.tolist(), "flange": robot.flange.tolist()}


def _prepared_dict(configuration: PlannedConfiguration) -> dict[str, Any]:
    return {"number": configuration.number, "phase": configuration.phase, "q": configuration.q.tolist()}


def plan_text(plan: Plan) -> str:
    """Return the file's text; every float keeps all its digits."""
    head = "# Measurement plan: q in rad, wrenches in N and N*m in base axes at the wrench point, one per load step.\n"
    return head + yaml_text(plan_dict(plan), width=400, flow=None)


def read_plan(path: str | Path, cell: Cell) -> Plan:
    """Read a plan and check it against the cell.

    Raises:
        PlanError: It is missing, malformed, or does not fit the robot: another name, other joints, limits or
            kinematics than those that it was made for, angles beyond the joint limits,
            forces beyond the rated load, numbers that repeat.
        CellError: The robot cannot be read.
    """
    file = read_yaml(path, MAX_BYTES, "plan (YAML)", PlanError)
    with file.locating():
        return _plan(file.path, _content(file), cell)


def _plan(path: Path, data: dict[str, Any], cell: Cell) -> Plan:
    joints = data.get("joints")
    if joints is not None and joints != list(cell.robot.joints):
        raise PlanError(path, "joints", quoted(joints), f"the cell's joints {list(cell.robot.joints)}")
    robot = data.get("robot", cell.robot.name)
    if not isinstance(robot, str):
        raise PlanError(path, "robot", quoted(robot), "a name")
    limits = chain_of(cell).limits
    made_for = read_planned_robot(data.get("made_for"), len(limits), lambda *words: PlanError(path, *words))
    _check_robot(path, robot, made_for, cell)
    startup = data.get("startup_cycle") or []
    if not isinstance(startup, list) or len(startup) > MAX_STEPS:
        raise PlanError(path, "startup_cycle", quoted(startup), "a list of postures")
    configurations = _configurations(path, data.get("configurations"), cell, limits)
    return Plan(
        robot=robot,
        joints=cell.robot.joints,
        configurations=configurations,
        startup_cycle=np.array([_angles(path, f"startup_cycle.{i}", q, limits) for i, q in enumerate(startup)]),
        reference=_reference(path, data.get("reference"), limits),
        expected=_expected(data.get("expected"), len(limits)),
        preparation=_preparation(path, data.get("preparation"), {c.number for c in configurations}, limits),
        made_for=made_for,
        tolerances=read_tolerances(data.get("tolerances"), lambda *words: PlanError(path, *words)),
    )


def _check_robot(path: Path, name: str, made_for: PlannedRobot | None, cell: Cell) -> None:
    """Refuse a plan that was made for another robot than the cell's."""
    if name != cell.robot.name:
        raise PlanError(path, "robot", quoted(name), f"the cell's robot {quoted(cell.robot.name)}")
    different = () if made_for is None else made_for.differences(planned_robot(cell), cell.robot.joints)
    if different:
        raise PlanError(path, "made_for", "; ".join(different), f"a plan for this {cell.robot.name}: make one")


def _expected_dict(expected: Expected) -> dict[str, Any]:
    values = {field.name: getattr(expected, field.name) for field in dataclasses.fields(expected)}
    return {name: _plain(value) for name, value in values.items()}


def _plain(value: object) -> object:
    """Return a value as YAML and JSON know it; what is not determined (infinite) is null."""
    if isinstance(value, np.ndarray):
        return [_plain(entry) for entry in value.tolist()]
    if isinstance(value, Mapping):
        return {name: _plain(entry) for name, entry in value.items()}
    return None if isinstance(value, float) and not math.isfinite(value) else value


def _content(file: YamlFile) -> dict[str, Any]:
    """Return the mapping that a plan file holds; only its keys and its schema are checked."""
    path, data = file.path, file.data
    if not isinstance(data, dict):
        raise PlanError(path, "", quoted(data), f"a mapping with the keys {', '.join(KEYS)}")
    _known_keys(path, "", data, KEYS)
    if data.get("schema", SCHEMA) != SCHEMA:
        raise PlanError(path, "schema", quoted(data.get("schema")), str(SCHEMA))
    return data


def _configurations(path: Path, rows: object, cell: Cell, limits: Float2D) -> tuple[PlannedConfiguration, ...]:
    if not isinstance(rows, list) or not 0 < len(rows) <= MAX_CONFIGURATIONS:
        raise PlanError(path, "configurations", quoted(rows), f"a list of 1 to {MAX_CONFIGURATIONS} configurations")
    rated = cell.robot.rated_load * 9.80665 - float(np.linalg.norm(cell.tool_weight))
    found: dict[int, PlannedConfiguration] = {}
    for i, row in enumerate(rows):
        place = f"configurations.{i}"
        if not isinstance(row, dict):
            raise PlanError(path, place, quoted(row), f"a mapping with the keys {', '.join(ENTRY_KEYS)}")
        _known_keys(path, place, row, ENTRY_KEYS)
        number, spare = _number(path, place, row.get("number", i + 1), found.keys()), row.get("spare", False)
        if not isinstance(spare, bool):
            raise PlanError(path, f"{place}.spare", quoted(spare), "true or false")
        q = _angles(path, f"{place}.q", row.get("q"), limits)
        steps = row.get("steps")
        if not isinstance(steps, list) or not 0 < len(steps) <= MAX_STEPS:
            raise PlanError(path, f"{place}.steps", quoted(steps), f"a list of 1 to {MAX_STEPS} wrenches")
        wrenches = np.array([_numbers(path, f"{place}.steps.{k}", step, 6) for k, step in enumerate(steps)])
        force = float(np.linalg.norm(wrenches[:, :3], axis=1).max())
        if force > 1.001 * rated:
            most = rounded_down(rated)
            raise PlanError(
                path,
                f"{place}.steps",
                f"{beyond(force, most)} N",
                f"at most the rated load less the end effector, {most:g} N",
            )
        found[number] = PlannedConfiguration(number, q, wrenches, spare)
    configurations = tuple(found.values())
    if all(configuration.spare for configuration in configurations):
        raise PlanError(path, "configurations", "spares only", "at least one configuration to measure")
    return configurations


def _preparation(path: Path, rows: object, taken: set[int], limits: Float2D) -> tuple[PlannedConfiguration, ...]:
    """Read the sweeps and postures of the phases before the compliance, whose numbers are `taken` already."""
    if rows is None:
        return ()
    if not isinstance(rows, list) or len(rows) > MAX_CONFIGURATIONS:
        raise PlanError(path, "preparation", quoted(rows), f"a list of at most {MAX_CONFIGURATIONS} configurations")
    found: dict[int, PlannedConfiguration] = {}
    for i, row in enumerate(rows):
        place = f"preparation.{i}"
        if not isinstance(row, dict):
            raise PlanError(path, place, quoted(row), f"a mapping with the keys {', '.join(SWEPT_KEYS)}")
        _known_keys(path, place, row, SWEPT_KEYS)
        number = _number(path, place, row.get("number"), {*taken, *found})
        phase = row.get("phase")
        if phase not in PREPARATION:
            raise PlanError(path, f"{place}.phase", quoted(phase), f"one of {', '.join(PREPARATION)}")
        q = _angles(path, f"{place}.q", row.get("q"), limits)
        found[number] = PlannedConfiguration(number, q, np.zeros((1, 6)), phase=phase)
    return tuple(found.values())


def _number(path: Path, place: str, number: object, taken: Collection[int]) -> int:
    if isinstance(number, bool) or not isinstance(number, int) or not 1 <= number < 1 << 32:
        raise PlanError(path, f"{place}.number", quoted(number), "an integer of at least one")
    if number in taken:
        raise PlanError(path, f"{place}.number", f"{number} twice", "every number once")
    return number


def _reference(path: Path, value: object, limits: Float2D) -> Reference | None:
    if value is None:
        return None
    if not isinstance(value, dict):
        raise PlanError(path, "reference", quoted(value), "a mapping with the keys q, every")
    _known_keys(path, "reference", value, ("q", "every"))
    every = value.get("every")
    if isinstance(every, bool) or not isinstance(every, int) or every < 0:
        raise PlanError(path, "reference.every", quoted(every), "an integer of at least zero")
    return Reference(_angles(path, "reference.q", value.get("q"), limits), every)


def _expected(value: object, n: int) -> Expected | None:
    """Read what the planner promised; None where that is not all there (it decides nothing)."""
    fields = {field.name: field for field in dataclasses.fields(Expected)}
    needed = {name for name, field in fields.items() if field.default is field.default_factory is dataclasses.MISSING}
    if not isinstance(value, dict) or not needed <= set(value) <= set(fields):
        return None
    values: dict[str, Any] = {}
    for name, entry in value.items():
        if name in EXPECTED_ARRAYS and entry is not None:
            if not isinstance(entry, list) or len(entry) != n or not all(x is None or _finite(x) for x in entry):
                return None
            values[name] = np.array([np.inf if x is None else x for x in entry], dtype=np.float64)
        elif name == "criterion":
            values[name] = str(entry)
        elif name == "unjudged":
            if not isinstance(entry, list) or not all(isinstance(pair, str) for pair in entry):
                return None
            values[name] = tuple(entry)
        elif name in EXPECTED_MAPPINGS:
            if not isinstance(entry, dict) or not all(x is None or _finite(x) for x in entry.values()):
                return None
            values[name] = {str(k): math.inf if x is None else float(x) for k, x in entry.items()}
        elif _finite(entry) or (entry is None and name in EXPECTED_OPTIONAL):
            values[name] = entry
        elif entry is None and name == "condition":
            values[name] = math.inf
        else:
            return None
    return Expected(**values)


def _known_keys(path: Path, place: str, row: dict[Any, Any], keys: tuple[str, ...]) -> None:
    for key in row:
        if key not in keys:
            name = f"{place}.{key}" if place else str(key)
            raise PlanError(path, name, "an unknown key", f"one of {', '.join(keys)}")


def _angles(path: Path, place: str, values: object, limits: Float2D) -> Float1D:
    q = np.array(_numbers(path, place, values, len(limits)))
    outside = np.flatnonzero((q < limits[:, 0]) | (q > limits[:, 1]))
    if len(outside):
        i = int(outside[0])
        low, high = limits[i]
        raise PlanError(path, f"{place}.{i}", f"{q[i]:g} rad", f"within the joint's limits [{low:g}, {high:g}]")
    return q


def _numbers(path: Path, place: str, values: object, count: int) -> list[float]:
    if not isinstance(values, list) or len(values) != count:
        raise PlanError(path, place, quoted(values), f"{count} numbers")
    for value in values:
        if not _finite(value):
            raise PlanError(path, place, quoted(value), "a finite number")
    return [float(value) for value in values]


def _finite(value: object) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool) and math.isfinite(value)
