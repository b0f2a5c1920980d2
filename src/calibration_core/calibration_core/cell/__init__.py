"""The cell file: robot, frames, instruments, and how a recording is to be read (contract, section 2).

`load_cell` turns YAML into frozen, validated values; whatever is wrong with the file is a `CellError` that names the
field.  Angles are rad, lengths m, masses kg, as in the file.
"""

from __future__ import annotations

import hashlib
import re
from collections.abc import Mapping
from pathlib import Path
from types import MappingProxyType
from typing import Annotated, Any, Literal, Self

import numpy as np
import yaml
from numpy.typing import NDArray
from pydantic import BaseModel, Field, ValidationError, model_validator

from calibration_core.cell.surroundings import Box, EndEffector
from calibration_core.cell.values import (
    FieldError,
    Interval,
    Name,
    NonNegative,
    Number,
    Pose,
    Positive,
    Strict,
    Vector,
    field_error,
)
from calibration_core.errors import CellError, quoted

__all__ = ["Box", "Cell", "EndEffector", "Pose", "load_cell", "too_deep"]

MAX_BYTES = 1 << 18
MAX_ALIASES = 100
MAX_NESTING = 100  # brackets; far beyond any real file, far below what stops a YAML parser
STANDARD_GRAVITY = (0.0, 0.0, -9.80665)
REDUCED_SPEED = 0.25  # m/s, safety-rated reduced speed (CWA 17384, 5.1; ISO 10218-1)


class DhRow(Strict):
    """One row of Denavit-Hartenberg parameters, standard (distal) or modified (proximal)."""

    a: Number
    alpha: Number
    d: Number
    theta: Number = 0.0


class Inertial(Strict):
    """Mass (kg) and centre of gravity (m) of one link, the latter in that link's DH frame."""

    mass: NonNegative
    com: Vector


class Robot(Strict):
    """The robot as its maker states it."""

    name: Name
    urdf: str | None = None
    base_link: str | None = None
    flange: str | None = None
    dh: tuple[DhRow, ...] | None = None
    modified_dh: bool = False
    joints: tuple[Name, ...]
    joint_limits: tuple[Interval, ...] | None = None
    inertials: tuple[Inertial, ...] | None = None
    inertials_known: bool = True
    rated_load: Positive
    stiffness: tuple[Positive, ...] | None = None
    gravity: Vector = STANDARD_GRAVITY

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
        for key in ("dh", "joint_limits", "inertials", "stiffness"):
            rows = getattr(self, key)
            if rows is not None and len(rows) != n:
                raise field_error(key, f"{len(rows)} entries", f"{n}, one per joint")
        for i, (low, high) in enumerate(self.joint_limits or ()):
            if not low < high:
                raise field_error(f"joint_limits.{i}", f"[{low:g}, {high:g}]", "lower < upper")
        return self


class Frames(Strict):
    """Frames and points that the measurement needs; nominal values."""

    tracker: Pose | None = None
    force_torque: Pose | None = None
    wrench_point: Vector | None = None
    measurement_points: Mapping[Name, Vector]
    target_normals: Mapping[Name, Vector] = Field(default_factory=dict)

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

    sigma: Positive | None = None
    sigma_range: NonNegative | None = None
    sigma_range_per_m: NonNegative = 0.0
    sigma_angle: Positive | None = None
    acceptance_angle: Annotated[Positive, Field(lt=np.pi)] | None = None
    range: Interval | None = None
    name: str = ""
    serial: str = ""
    calibrated: str = ""

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

    sigma_force: NonNegative
    sigma_torque: NonNegative
    name: str = ""
    serial: str = ""
    calibrated: str = ""


class Thermometer(Strict):
    """Standard deviation of one temperature reading, K."""

    sigma: NonNegative
    name: str = ""
    serial: str = ""
    calibrated: str = ""


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
    source: Name


class Topics(Strict):
    """Names of the topics; the defaults are the contract's.

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
    """A robot cell: everything about it that a recording does not say.

    Attributes:
        path: The file it was read from.
        sha256: Digest of that file.
    """

    name: Name
    source: str = ""
    note: str = ""
    robot: Robot
    frames: Frames
    instruments: Instruments
    topics: Topics = Field(default_factory=Topics)
    measurements: Measurements = Field(default_factory=Measurements)
    safety: Safety | None = None
    boxes: tuple[Box, ...] = ()
    end_effector: EndEffector | None = None
    path: Path = Path("cell.yaml")
    sha256: str = ""

    @property
    def points(self) -> tuple[str, ...]:
        """Names of the measurement points, in the order of the file."""
        return tuple(self.frames.measurement_points)

    @property
    def gravity(self) -> NDArray[np.float64]:
        """(3,) m/s^2, base axes."""
        return np.array(self.robot.gravity)

    @property
    def urdf_path(self) -> Path | None:
        """The URDF, resolved relative to the cell file."""
        return None if self.robot.urdf is None else (self.path.parent / self.robot.urdf).resolve()

    def missing(self, place: str, purpose: str) -> CellError:
        """Return the error for an optional field that this recording makes necessary."""
        return CellError(self.path, place, "nothing", f"a value, needed for {purpose}")


def load_cell(path: str | Path) -> Cell:
    """Read and validate a cell file.

    Raises:
        CellError: The file is missing, not YAML, or a field is missing, unknown, of wrong length or not finite.
    """
    path = Path(path)
    raw = _read(path)
    data = _parse(path, raw)
    reserved = {"path", "sha256"} & data.keys()
    if reserved:
        raise CellError(path, min(reserved), "an unknown key", _choices(Cell))
    try:
        return Cell.model_validate({**data, "path": path, "sha256": hashlib.sha256(raw).hexdigest()})
    except ValidationError as error:
        raise _first_error(path, error) from None


def _read(path: Path) -> bytes:
    try:
        if path.stat().st_size > MAX_BYTES:
            raise CellError(path, "", f"{path.stat().st_size} bytes", f"a YAML file of at most {MAX_BYTES} bytes")
        return path.read_bytes()
    except OSError as error:
        raise CellError(path, "", error.strerror or str(error), "a readable cell file (YAML)") from None


class _UniqueKeyLoader(getattr(yaml, "CSafeLoader", yaml.SafeLoader)):  # type: ignore[misc]  # the fast one, if any
    def construct_mapping(self, node: yaml.MappingNode, deep: bool = False) -> dict[Any, Any]:
        seen: set[str] = set()
        for key, _ in node.value:
            if isinstance(key, yaml.ScalarNode):
                if key.value in seen:
                    raise yaml.constructor.ConstructorError(None, None, f"key {key.value!r} twice", key.start_mark)
                seen.add(key.value)
        mapping: dict[Any, Any] = super().construct_mapping(node, deep)
        return mapping


def too_deep(text: str) -> bool:
    """Tell whether YAML text is nested so deeply that parsing it would take forever or end the process.

    Counted are open brackets, and what can open levels at the beginning of a line (indentation, `-`, `?`).
    """
    data = np.frombuffer(text.encode("utf-8", "replace"), np.uint8)
    change = np.isin(data, list(b"[{")).astype(np.int32) - np.isin(data, list(b"]}"))
    open_brackets = np.cumsum(change)
    if len(data) and int((open_brackets - np.minimum.accumulate(np.minimum(open_brackets, 0))).max()) > MAX_NESTING:
        return True
    return re.search(rf"^[ \-?]{{{4 * MAX_NESTING}}}", text, re.MULTILINE) is not None


def _parse(path: Path, raw: bytes) -> dict[str, Any]:
    try:
        text = raw.decode("utf-8")
        if too_deep(text):
            raise CellError(path, "", f"more than {MAX_NESTING} levels of nesting", "plain YAML")
        aliases = sum(isinstance(token, yaml.AliasToken) for token in yaml.scan(text, Loader=_UniqueKeyLoader))
        if aliases > MAX_ALIASES:
            raise CellError(path, "", f"{aliases} YAML aliases", f"at most {MAX_ALIASES}")
        data = yaml.load(text, Loader=_UniqueKeyLoader)
    except UnicodeDecodeError as error:
        raise CellError(path, f"byte {error.start}", quoted(raw[error.start : error.start + 1]), "UTF-8") from None
    except yaml.YAMLError as error:
        mark = getattr(error, "problem_mark", None)
        place = f"line {mark.line + 1}" if mark is not None else ""
        raise CellError(path, place, getattr(error, "problem", None) or "no YAML", "YAML") from None
    except (RecursionError, ValueError) as error:
        raise CellError(path, "", f"unreadable YAML ({type(error).__name__})", "plain YAML") from None
    if not isinstance(data, dict) or not all(isinstance(key, str) for key in data):
        raise CellError(path, "", quoted(data), f"a mapping with the keys {_choices(Cell)}")
    return data


def _first_error(path: Path, error: ValidationError) -> CellError:
    first = error.errors()[0]
    place = ".".join(str(part) for part in first["loc"])
    cause = first.get("ctx", {}).get("error")
    if isinstance(cause, FieldError):
        place = ".".join(part for part in (place, cause.place) if part)
        return CellError(path, place, cause.found, cause.expected)
    kind = first["type"]
    if kind == "extra_forbidden":
        return CellError(path, place, "an unknown key", _choices(_owner(first["loc"])))
    if kind == "missing":
        return CellError(path, place, "nothing", "a value")
    expected = str(cause) if cause is not None else first["msg"].removeprefix("Input should be ").strip()
    return CellError(path, place, quoted(first["input"]), expected)


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
