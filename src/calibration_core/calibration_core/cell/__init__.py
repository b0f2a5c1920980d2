"""The cell file: robot, frames, instruments, and how a recording is to be read.

`load_cell` turns YAML into frozen, validated values; whatever is wrong with the file is a `CellError` that names the
field.  Angles are rad, lengths m, masses kg, as in the file.
"""

from __future__ import annotations

import functools
import hashlib
import os
from collections.abc import Mapping
from pathlib import Path
from types import MappingProxyType
from typing import Annotated, Literal, Self

import numpy as np
from numpy.typing import NDArray
from pydantic import BaseModel, Field, ValidationError, model_validator
from pydantic_core import ErrorDetails

from calibration_core.cell.certificate import Certificate
from calibration_core.cell.surroundings import Box, EndEffector, Surroundings
from calibration_core.cell.urdf import MOST_RADIANS, RADIANS, urdf_joint_types
from calibration_core.cell.values import (
    Angle,
    FieldError,
    Gravity,
    Interval,
    Label,
    Length,
    Name,
    NonNegative,
    Number,
    Pose,
    Positive,
    Radians,
    Statement,
    Stiffness,
    Strict,
    Vector,
    field_error,
)
from calibration_core.errors import CellError, quoted
from calibration_core.files.yaml_file import YamlFile, read_yaml

__all__ = ["Box", "Cell", "Certificate", "EndEffector", "Pose", "load_cell"]

MAX_BYTES = 1 << 18
MAX_FAULTS = 100
STANDARD_GRAVITY = (0.0, 0.0, -9.80665)
MOST_CONDITION = 1e6  # of the coupling of joints
REDUCED_SPEED = 0.25  # m/s, safety-rated reduced speed (CWA 17384, 5.1; ISO 10218-1)


class DhRow(Strict):
    """One row of Denavit-Hartenberg parameters, standard (distal) or modified (proximal)."""

    a: Number
    alpha: Radians
    d: Number
    theta: Radians = 0.0


class Inertial(Strict):
    """Mass (kg) and centre of gravity (m) of one link, the latter in that link's DH frame."""

    mass: NonNegative
    com: Vector


class Robot(Strict):
    """The robot as its maker states it."""

    name: Name
    maker: Label = ""
    serial: Label = ""
    urdf: str | None = None
    base_link: Label | None = None
    flange: Label | None = None
    dh: tuple[DhRow, ...] | None = None
    modified_dh: bool = False
    joints: tuple[Name, ...]
    joint_limits: tuple[Interval, ...] | None = None
    inertials: tuple[Inertial, ...] | None = None
    inertials_known: bool = True
    rated_load: Annotated[Positive, Field(ge=1e-3, le=1e5)]
    joint_types: tuple[Literal["revolute", "prismatic"], ...] | None = None
    joint_coupling: Mapping[Name, Mapping[Name, Number]] = Field(default_factory=dict)
    stiffness: tuple[Stiffness, ...] | None = None
    gravity: Gravity = STANDARD_GRAVITY

    @model_validator(mode="after")
    def _check(self) -> Self:
        n = len(self.joints)
        if n < 3:
            raise field_error("joints", f"{n} joints", "at least 3 (an articulated robot, CWA 17384, 3.1)")
        if len(set(self.joints)) != n:
            raise field_error("joints", "repeated names", "every joint once")
        if (self.urdf is None) == (self.dh is None):
            raise field_error("", "both urdf and dh" if self.urdf else "neither urdf nor dh", "exactly one of them")
        if self.dh is not None and self.joint_limits is None:
            raise field_error("joint_limits", "nothing", "one interval per joint (needed with dh)")
        if self.urdf is not None and (self.base_link is None or self.flange is None):
            raise field_error("flange" if self.base_link else "base_link", "nothing", "a link of the URDF")
        if self.urdf is not None and self.joint_types is not None:
            raise field_error("joint_types", "joint_types beside a urdf", "the URDF's own types only")
        for key in ("dh", "joint_limits", "joint_types", "inertials", "stiffness"):
            rows = getattr(self, key)
            if rows is not None and len(rows) != n:
                raise field_error(key, f"{len(rows)} entries", f"{n}, one per joint")
        for i, (low, high) in enumerate(self.joint_limits or ()):
            if not low < high:
                raise field_error(f"joint_limits.{i}", f"[{low:g}, {high:g}]", "lower < upper")
            turns = self.urdf is None and (self.joint_types is None or self.joint_types[i] == "revolute")
            if turns and max(abs(low), abs(high)) > MOST_RADIANS:
                raise field_error(f"joint_limits.{i}", f"[{low:g}, {high:g}]", RADIANS)
        return self

    @model_validator(mode="after")
    def _check_coupling(self) -> Self:
        for name, others in self.joint_coupling.items():
            for other in (name, *others):
                if other not in self.joints or name in others:
                    expected = f"two of {', '.join(self.joints)}, and a factor"
                    raise field_error(f"joint_coupling.{name}", quoted(other), expected)
        if np.linalg.cond(self.coupling) > MOST_CONDITION:
            raise field_error("joint_coupling", "couplings that undo each other", "factors that leave every joint free")
        object.__setattr__(self, "joint_coupling", MappingProxyType(dict(self.joint_coupling)))
        return self

    @property
    def coupling(self) -> NDArray[np.float64]:
        """(n, n) what takes angles as recordings state them to those of the chain: FANUC's J3 is held against J2."""
        matrix = np.eye(len(self.joints))
        for name, others in self.joint_coupling.items():
            for other, factor in others.items():
                matrix[self.joints.index(name), self.joints.index(other)] = factor
        return matrix


class Frames(Strict):
    """Frames and points that the measurement needs; nominal values."""

    tracker: Pose | None = None
    force_torque: Pose | None = None
    tool: Pose | None = None
    wrench_point: Vector | None = None
    measurement_points: Mapping[Name, Vector]
    target_normals: Mapping[Name, Vector] = Field(default_factory=dict)
    sigma_points: Length | None = None

    @model_validator(mode="after")
    def _check(self) -> Self:
        if not self.measurement_points:
            raise field_error("measurement_points", "none", "at least one")
        for name, normal in self.target_normals.items():
            if name not in self.measurement_points:
                raise field_error("target_normals", quoted(name), f"one of {', '.join(self.measurement_points)}")
            if not any(normal):
                raise field_error(f"target_normals.{name}", "a vector of length zero", "where the target opens to")
        for key in ("measurement_points", "target_normals"):
            object.__setattr__(self, key, MappingProxyType(dict(getattr(self, key))))
        return self


class Tracker(Strict):
    """Standard deviation of one averaged tracker reading, per coordinate or in spherical coordinates.

    Besides: the angle (rad) to its normal within which a target is seen, and the nearest and farthest distance (m).
    """

    sigma: Length | None = None
    sigma_range: Annotated[NonNegative, Field(le=1.0)] | None = None
    sigma_range_per_m: Annotated[NonNegative, Field(le=1.0)] = 0.0
    sigma_angle: Angle | None = None
    acceptance_angle: Annotated[Positive, Field(lt=np.pi)] | None = None
    range: Interval | None = None
    name: Label = ""
    serial: Label = ""
    calibrated: Label = ""

    @model_validator(mode="after")
    def _check(self) -> Self:
        spherical = self.sigma_range is not None or self.sigma_angle is not None or self.sigma_range_per_m > 0
        if (self.sigma is not None) == spherical:
            raise field_error(
                "",
                "both sigma and sigma_range/sigma_angle" if spherical else "no uncertainty",
                "either sigma, or sigma_range (and sigma_range_per_m) with sigma_angle",
            )
        if self.range is not None and not 0 <= self.range[0] < self.range[1]:
            raise field_error("range", f"[{self.range[0]:g}, {self.range[1]:g}]", "two distances, the nearer first")
        if spherical and (self.sigma_angle is None or self.sigma_range is None):
            raise field_error("sigma_angle" if self.sigma_range is not None else "sigma_range", "nothing", "a number")
        return self


class ForceTorque(Strict):
    """Standard deviation of one averaged force/torque reading, N and N*m per axis."""

    sigma_force: Annotated[NonNegative, Field(le=1e5)]
    sigma_torque: Annotated[NonNegative, Field(le=1e5)]
    name: Label = ""
    serial: Label = ""
    calibrated: Label = ""


class Thermometer(Strict):
    """Standard deviation of one temperature reading, K."""

    sigma: NonNegative
    name: Label = ""
    serial: Label = ""
    calibrated: Label = ""


class Instruments(Strict):
    """The measuring equipment with its uncertainties (CWA 17384, 5.3)."""

    tracker: Tracker
    force_torque: ForceTorque | None = None
    temperature: Thermometer | None = None


class Safety(Strict):
    """What the robot's controller watches over with a safety rating, as the cell's owner declares it.

    Attributes:
        speed_limit: m/s, Cartesian speed that is not exceeded in automatic mode either.
        source: Who declares it and where it can be checked, e.g. the checksum of the safety configuration.
    """

    speed_limit: Annotated[Positive, Field(le=REDUCED_SPEED)]
    source: Statement


class Topics(Strict):
    """Names of the topics; the defaults are those of recordings.

    In the file, a key is either the role (`joint_states`, `wrench`, ...) or the default topic that is replaced
    (`/joint_states`, `/force_torque/wrench`, `/tracker/mp1`, ...).
    """

    joint_states: Name = "/joint_states"
    tracker: Mapping[Name, Name] = Field(default_factory=lambda: MappingProxyType({}))
    wrench: Name = "/force_torque/wrench"
    temperature: Name = "/cell/temperature"
    robot_description: Name = "/robot_description"
    step: Name = "/calibration/step"
    conditions: Name = "/calibration/conditions"

    @model_validator(mode="before")
    @classmethod
    def _by_default_name(cls, data: object) -> object:
        if not isinstance(data, dict):
            return data
        roles = {str(field.default): name for name, field in cls.model_fields.items() if name != "tracker"}
        named: dict[str, object] = {}
        tracker: dict[str, object] = {}
        for key, value in data.items():
            if isinstance(key, str) and key.startswith("/tracker/"):
                tracker[key.removeprefix("/tracker/")] = value
            else:
                named[roles.get(str(key), str(key))] = value
        if tracker:
            given = named.get("tracker", {})
            named["tracker"] = {**given, **tracker} if isinstance(given, dict) else given
        return named

    def point(self, name: str) -> str:
        """Return the topic of a measurement point."""
        return self.tracker.get(name, f"/tracker/{name}")


class Measurements(Strict):
    """How a recording is to be read."""

    points: Literal["absolute", "displacement"] = "absolute"
    wrench_axes: Literal["sensor", "base"] = "sensor"
    wrench_at: Literal["sensor", "wrench_point"] = "sensor"


class Cell(Strict):
    """A robot cell: everything about it that a recording does not say; m, rad, N, N*m, kg, degrees Celsius."""

    name: Name
    source: str = ""
    note: str = ""
    robot: Robot
    frames: Frames
    instruments: Instruments
    topics: Topics = Field(default_factory=Topics)
    measurements: Measurements = Field(default_factory=Measurements)
    safety: Safety | None = None
    surroundings: Surroundings = Field(default_factory=Surroundings)
    boxes: tuple[Box, ...] = ()
    end_effector: EndEffector | None = None
    certificate: Certificate = Field(default_factory=Certificate)
    path: Path = Path("cell.yaml")
    sha256: str = ""

    @model_validator(mode="after")
    def _check(self) -> Self:
        tool = self.end_effector
        if tool is not None and tool.mass >= self.robot.rated_load:
            expected = f"less than robot.rated_load, {self.robot.rated_load:g} kg"
            raise field_error("end_effector.mass", f"{tool.mass:g} kg", expected)
        return self

    @property
    def points(self) -> tuple[str, ...]:
        """Names of the measurement points, in the order of the file."""
        return tuple(self.frames.measurement_points)

    @property
    def gravity(self) -> NDArray[np.float64]:
        """(3,) m/s^2, base axes."""
        return np.array(self.robot.gravity)

    @property
    def floor(self) -> float | None:
        """Height of the floor over the base frame's origin, against gravity, m; None: no floor."""
        stated = self.surroundings.floor
        if stated == "none":
            return None
        return -float(stated) if self.gravity[2] > 0.0 else float(stated)

    @functools.cached_property
    def prismatic(self) -> tuple[bool, ...]:
        """Per joint, whether it slides; as the URDF says, or `robot.joint_types`, else all turn.

        Raises:
            CellError: The URDF cannot be used.
        """
        robot, path = self.robot, self.urdf_path
        if path is None:
            return tuple(kind == "prismatic" for kind in robot.joint_types or ("revolute",) * len(robot.joints))
        kinds = urdf_joint_types(path)
        return tuple(kinds.get(name) == "prismatic" for name in robot.joints)

    @property
    def urdf_path(self) -> Path | None:
        """The URDF, resolved relative to the cell file."""
        return None if self.robot.urdf is None else (self.path.parent / self.robot.urdf).resolve()

    @property
    def tool_weight(self) -> NDArray[np.float64]:
        """(3,) N, base axes: what tool and sensor pull besides the load; zero where their mass is not stated."""
        return np.asarray((0.0 if self.end_effector is None else self.end_effector.mass) * self.gravity)

    def missing(self, place: str, purpose: str) -> CellError:
        """Return the error for an optional field that this recording makes necessary.

        Args:
            place: The field.
            purpose: What it is needed for.
        """
        return CellError(self.path, place, "nothing", f"a value, needed for {purpose}")


def load_cell(path: str | Path, *, live: bool = False) -> Cell:
    """Read and validate a cell file.

    Args:
        path: The file, YAML; its values are m, rad, N, N*m, kg and degrees Celsius.
        live: Whether the robot is moved with it: `robot.joint_coupling`, which is for recordings, is refused.

    Raises:
        CellError: The file is missing, not YAML, or a field is missing, unknown, of wrong length or not finite; it
            names the first fault in the file with line and column, and carries the others as `further`.

    Source: what CWA 17384, clauses 5 and 7, asks to be known of robot, frames and instruments.
    """
    given: object = path
    if not isinstance(given, str | os.PathLike) or not str(given):
        raise CellError("load_cell", "path", quoted(given), "the path of a cell file")
    if not isinstance(live, bool):
        raise CellError("load_cell", "live", quoted(live), "true or false")
    path = Path(path)
    file = read_yaml(path, MAX_BYTES, "cell file (YAML)", CellError)
    if not isinstance(file.data, dict):
        raise CellError(path, "", quoted(file.data), f"a cell file: a mapping, its keys {_choices(Cell)}")
    reserved = {"path", "sha256"} & file.data.keys()
    with file.locating():
        if reserved:
            raise CellError(path, min(reserved), "an unknown key", _choices(Cell))
        if "schema" in file.data:  # which models, plans and populations have, and no cell file
            raise CellError(path, "schema", "a model, plan or other result", f"a cell file, its keys {_choices(Cell)}")
    try:
        cell = Cell.model_validate({**file.data, "path": path, "sha256": hashlib.sha256(file.raw).hexdigest()})
    except ValidationError as error:
        raise _all_faults(file, error) from None
    if live and cell.robot.joint_coupling:
        expected = "no coupling where a robot moves: its driver's angles are those of the robot file"
        with file.locating():
            raise CellError(path, "robot.joint_coupling", "a coupling", expected)
    return cell


def _all_faults(file: YamlFile, error: ValidationError) -> CellError:
    """Return the first fault of the file, with the others as `further`."""
    faults: list[CellError] = []
    for entry in error.errors()[:MAX_FAULTS]:
        fault = _fault(file.path, entry)
        mark = file.where(fault.place)
        faults.append(fault if mark is None else fault.at(*mark))
    faults.sort(key=lambda fault: (fault.line or 0, fault.column or 0))
    faults[0].further = tuple(faults[1:])
    return faults[0]


def _fault(path: Path, entry: ErrorDetails) -> CellError:
    place = ".".join(str(part) for part in entry["loc"])
    cause = entry.get("ctx", {}).get("error")
    if isinstance(cause, FieldError):
        place = ".".join(part for part in (place, cause.place) if part)
        return CellError(path, place, cause.found, cause.expected)
    kind = entry["type"]
    if kind == "extra_forbidden":
        return CellError(path, place, "an unknown key", _choices(_owner(entry["loc"])))
    if kind == "missing":
        return CellError(path, place, "nothing", "a value")
    expected = str(cause) if cause is not None else entry["msg"].removeprefix("Input should be ").strip()
    return CellError(path, place, quoted(entry["input"]), expected)


def _owner(location: tuple[int | str, ...]) -> type[BaseModel]:
    model: type[BaseModel] = Cell
    for part in location[:-1]:
        field = model.model_fields.get(str(part))
        if field is None:
            continue
        for candidate in (field.annotation, *getattr(field.annotation, "__args__", ())):
            if isinstance(candidate, type) and issubclass(candidate, BaseModel):
                model = candidate
    return model


def _choices(model: type[BaseModel]) -> str:
    return "one of " + ", ".join(name for name in model.model_fields if name not in {"path", "sha256"})
