"""`procedure.yaml`: how a measurement is planned and run.  What the file leaves out has its default."""

from __future__ import annotations

import dataclasses
import math
import types
import typing
from pathlib import Path
from typing import Any

from calibration_core.errors import PlanError, TrajectoryError, quoted
from calibration_core.files.yaml_file import read_yaml
from calibration_core.procedure.agenda import SequenceRules
from calibration_core.procedure.criteria import CRITERIA
from calibration_core.procedure.guard import GuardRules
from calibration_core.procedure.loads import LoadRules
from calibration_core.procedure.planning import PlanningRules
from calibration_core.procedure.robot_status import OperatingMode
from calibration_core.procedure.space import SpaceRules
from calibration_core.procedure.trajectory import MotionLimits

MAX_BYTES = 1 << 20
MAY_BE_INFINITE = {"startup_period", "motion_limit", "settling_limit", "reading_limit"}
MAY_BE_NEGATIVE = {"floor", "box", "levels"}
MAY_BE_ZERO = {"reference_every", "startup_cycles"}
MOST = 100_000
SHARES = {"share", "kept", "limit_margin"}
ELSEWHERE = {"space", "load", "declared_limit"}  # sections of their own; declared in the cell file


@dataclasses.dataclass(frozen=True)
class ProcedureSettings:
    """Everything that decides how a measurement is planned and run."""

    planning: PlanningRules = dataclasses.field(default_factory=PlanningRules)
    motion: MotionLimits = dataclasses.field(default_factory=MotionLimits)
    sequence: SequenceRules = dataclasses.field(default_factory=SequenceRules)
    guard: GuardRules = dataclasses.field(default_factory=GuardRules)


SECTIONS: dict[str, type[Any]] = {
    "space": SpaceRules,
    "load": LoadRules,
    "planning": PlanningRules,
    "motion": MotionLimits,
    "sequence": SequenceRules,
    "guard": GuardRules,
}


def read_settings(path: str | Path) -> ProcedureSettings:
    """Read the settings.

    Raises:
        PlanError: The file is missing or malformed, a key is unknown, or a value makes no sense.
    """
    file = read_yaml(path, MAX_BYTES, "file of settings (YAML)", PlanError)
    data = {} if file.data is None else file.data
    if not isinstance(data, dict):
        raise PlanError(file.path, "", quoted(data), f"a mapping with the keys {', '.join(SECTIONS)}")
    with file.locating():
        for name in data:
            if name not in SECTIONS:
                raise PlanError(file.path, name, "an unknown key", f"one of {', '.join(SECTIONS)}")
        parts = {name: _section(file.path, name, kind, data.get(name)) for name, kind in SECTIONS.items()}
    planning = dataclasses.replace(parts["planning"], space=parts["space"], load=parts["load"])
    return ProcedureSettings(planning, parts["motion"], parts["sequence"], parts["guard"])


def _section(path: Path, name: str, kind: type[Any], values: object) -> Any:
    known = {field.name: field for field in dataclasses.fields(kind) if field.name not in ELSEWHERE}
    if values is None:
        return kind()
    if not isinstance(values, dict):
        raise PlanError(path, name, quoted(values), f"a mapping with the keys {', '.join(known)}")
    hints = typing.get_type_hints(kind)
    given = {}
    for key, value in values.items():
        if key not in known:
            raise PlanError(path, f"{name}.{key}", "an unknown key", f"one of {', '.join(known)}")
        given[key] = _value(path, f"{name}.{key}", key, hints[key], value)
    try:
        return kind(**given)
    except TrajectoryError as error:
        raise PlanError(path, f"{name}.{error.place}", error.found, error.expected) from None


def _value(path: Path, place: str, key: str, hint: Any, value: object) -> Any:
    """Return a value of the type that a field is declared with."""
    if key == "allowed_modes":
        return _modes(path, place, value)
    kinds = typing.get_args(hint) if isinstance(hint, types.UnionType) else (hint,)
    if value is None and type(None) in kinds:
        return None
    if key == "criterion":
        if not isinstance(value, str) or value not in CRITERIA:
            raise PlanError(path, place, quoted(value), f"one of {', '.join(CRITERIA)}")
        return value
    if int in kinds:
        least = 0 if key in MAY_BE_ZERO else 1
        if isinstance(value, bool) or not isinstance(value, int) or not least <= value <= MOST:
            raise PlanError(path, place, quoted(value), f"an integer from {least} to {MOST}")
        return value
    if isinstance(value, list) and any(typing.get_origin(kind) is tuple for kind in kinds):
        return _tuple(path, place, key, kinds, value)
    if float in kinds:
        return _number(path, place, key, value)
    raise PlanError(path, place, quoted(value), "a list of numbers")


def _tuple(path: Path, place: str, key: str, kinds: tuple[Any, ...], values: list[Any]) -> tuple[Any, ...]:
    if key == "box":
        if len(values) != 3 or not all(isinstance(row, list) and len(row) == 2 for row in values):
            raise PlanError(path, place, quoted(values), "three intervals [low, high]")
        box = tuple(tuple(_number(path, place, key, x) for x in row) for row in values)
        if not all(low < high for low, high in box):
            raise PlanError(path, place, quoted(values), "low < high in each")
        return box
    numbers = tuple(_number(path, place, key, x) for x in values)
    arguments = typing.get_args(next(kind for kind in kinds if typing.get_origin(kind) is tuple))
    if Ellipsis not in arguments:
        if len(numbers) != len(arguments) or not numbers[0] < numbers[1]:
            raise PlanError(path, place, quoted(values), "two numbers, the lower first")
    elif key == "levels" and (not 2 <= len(numbers) <= 1000 or numbers[0] != 0.0 or max(numbers) != 1.0):
        raise PlanError(path, place, quoted(values), "at least two fractions from -1 to 1, the first 0, the largest 1")
    elif key == "levels" and min(numbers) < -1.0:
        raise PlanError(path, place, quoted(values), "fractions of at least -1, the full pull the other way")
    return numbers


def _number(path: Path, place: str, key: str, value: object) -> float:
    if isinstance(value, bool) or not isinstance(value, int | float) or math.isnan(value):
        raise PlanError(path, place, quoted(value), "a number")
    if math.isinf(value) and key not in MAY_BE_INFINITE:
        raise PlanError(path, place, quoted(value), "a finite number")
    if value < 0 and key not in MAY_BE_NEGATIVE:
        raise PlanError(path, place, quoted(value), "a number of at least zero")
    if key in SHARES and value > 1:
        raise PlanError(path, place, quoted(value), "a share, at most 1")
    return float(value)


def _modes(path: Path, place: str, value: object) -> frozenset[OperatingMode]:
    names = {mode.name: mode for mode in OperatingMode if mode is not OperatingMode.UNKNOWN}
    if not isinstance(value, list) or not value or not all(isinstance(x, str) and x in names for x in value):
        raise PlanError(path, place, quoted(value), f"a list of {', '.join(names)}")
    return frozenset(names[name] for name in value)
