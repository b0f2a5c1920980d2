"""`population.yaml`: what is known of the robots of every type, for the next robot of that type."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from calibration_core import __version__
from calibration_core.errors import InputError, quoted
from calibration_core.files.yaml_file import YamlFile, read_yaml, yaml_text
from calibration_core.fleet.plant import Plant
from calibration_core.fleet.pooling import Population
from calibration_core.fleet.series import STIFFNESS

SCHEMA = 1
MAX_FILE = 1 << 22
WHAT = "population file (population.yaml of calibration fleet)"


@dataclasses.dataclass(frozen=True, eq=False)
class TypePopulation:
    """The population of one type, as its file has it.

    Attributes:
        joints: Joint -> population of ln stiffness, N*m/rad (N/m where a joint slides).
        effects: Effect and place -> share of the type's robots that show it.
        source: Of which robots and recordings it was made.
    """

    file: str
    sha256: str
    type: str
    joints: Mapping[str, Population]
    effects: Mapping[str, float]
    source: str


def population_text(plant: Plant, source: str, digest: str) -> str:
    """Return the file.

    Args:
        plant: What all rows say.
        source: The manifest or folder.
        digest: SHA-256 over the keys of all results: which data set this is.
    """
    types: dict[str, Any] = {}
    for kind in plant.types:
        joints, laws = {}, {}
        for one in plant.quantities:
            if one.quantity.type != kind or one.population is None:
                continue
            found = one.population
            numbers = {
                "spread": found.spread, "mean_std": found.mean_std, "spread_std": found.spread_std,
                "robots": found.members, "repeatability": one.quantity.repeatability,
            }  # fmt: skip
            if one.quantity.kind == STIFFNESS:
                joints[one.quantity.joint] = {"stiffness": math.exp(found.mean), "log_mean": found.mean, **numbers}
            else:
                laws[one.quantity.name] = {"mean": found.mean, **numbers, **one.shares}
        robots = sum(robot.type == kind for robot in plant.robots)
        types[kind] = {"robots": robots, "joints": joints, "laws": laws, "effects": dict(plant.effects.get(kind, {}))}
    content = {
        "schema": SCHEMA,
        "provenance": {
            "source": source, "recordings": plant.rows, "failed": plant.failed, "data_set": digest,
            "version": __version__,
        },
        "types": types,
    }  # fmt: skip
    return yaml_text(content)


def read_population(path: Path, kind: str | None, joints: tuple[str, ...]) -> TypePopulation:
    """Read the population of one type.

    Args:
        path: The file.
        kind: The type; None where the file has but one.
        joints: Names of the robot's joints; each must be there.

    Raises:
        InputError: The file cannot be used, or has no such type.
    """
    import hashlib

    file = read_yaml(path, MAX_FILE, WHAT)
    if not isinstance(file.data, dict) or file.data.get("schema") != SCHEMA:
        found = file.data.get("schema") if isinstance(file.data, dict) else file.data
        raise InputError(path, "schema", quoted(found), f"{SCHEMA}, a {WHAT}")
    types = file.data.get("types")
    if not isinstance(types, dict) or not types:
        raise InputError(path, "types", quoted(types), "the populations by type")
    if kind is None:
        if len(types) > 1:
            raise InputError(path, "types", quoted(", ".join(types)), "one type, or --type to choose it")
        kind = next(iter(types))
    if kind not in types:
        raise InputError(path, "types", f"no {quoted(kind)}", f"one of {', '.join(map(str, types))}")
    of_type = _mapping(types[kind])
    members, effects = _mapping(of_type.get("joints")), _mapping(of_type.get("effects"))
    populations = {joint: _population(file, kind, joint, members.get(joint)) for joint in joints}
    shares = {str(k): float(v) for k, v in effects.items() if isinstance(v, int | float)}
    provenance = file.data.get("provenance")
    source = f"{of_type.get('robots')} robots of {provenance.get('source')}" if isinstance(provenance, dict) else ""
    return TypePopulation(str(path), hashlib.sha256(file.raw).hexdigest(), kind, populations, shares, source)


def _mapping(value: object) -> dict[str, Any]:
    return value if isinstance(value, dict) else {}


def _population(file: YamlFile, kind: str, joint: str, values: Any) -> Population:
    place = f"types.{kind}.joints.{joint}"
    if not isinstance(values, dict):
        raise InputError(file.path, place, "nothing", "the population of every joint of the robot")
    numbers = {}
    for name in ("log_mean", "spread", "mean_std", "spread_std", "robots"):
        value: Any = values.get(name)
        known = isinstance(value, int | float) and not isinstance(value, bool) and math.isfinite(value)
        if not known or (name != "log_mean" and value < 0):
            mark = file.where(f"{place}.{name}")
            raise InputError(file.path, f"{place}.{name}", quoted(value), "a finite number", *(mark or (None, None)))
        numbers[name] = float(value)
    return Population(
        numbers["log_mean"], numbers["spread"], numbers["mean_std"], numbers["spread_std"], int(numbers["robots"])
    )
