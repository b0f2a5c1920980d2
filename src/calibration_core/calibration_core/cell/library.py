"""Robots that a cell file can start from: nominal kinematics of common machines, with sources (`config/robots`)."""

from __future__ import annotations

import dataclasses
import difflib
from pathlib import Path

from calibration_core.errors import CellError
from calibration_core.files.yaml_file import read_yaml

FOLDER = Path(__file__).with_name("robots")
INDEX = FOLDER / "library.yaml"
MAX_BYTES = 1 << 18


@dataclasses.dataclass(frozen=True)
class LibraryRobot:
    """One robot of the library.

    Attributes:
        rated_load: kg.
        reach: m, from the axis of joint 1 to the wrist centre, or as the maker states it.
        source: Where its kinematics are published.
    """

    key: str
    name: str
    maker: str
    rated_load: float
    reach: float
    source: str

    @property
    def urdf(self) -> Path:
        """Return its URDF."""
        return FOLDER / f"{self.key}.urdf"


def library() -> dict[str, LibraryRobot]:
    """Return every robot by its key."""
    rows = read_yaml(INDEX, MAX_BYTES, "robot library (YAML)", CellError).data
    return {key: LibraryRobot(key=key, **row) for key, row in rows.items()}


def library_robot(key: str) -> LibraryRobot:
    """Return a robot by its key; capitals and hyphens do not matter.

    Raises:
        CellError: There is none; names the nearest.
    """
    robots = library()
    wanted = key.lower().replace("-", "_").replace(" ", "_")
    if wanted in robots:
        return robots[wanted]
    endings = [name for name in robots if name.partition("_")[2] == wanted]
    if len(endings) == 1:
        return robots[endings[0]]
    near = difflib.get_close_matches(wanted, robots, n=1, cutoff=0.5)
    hint = f"did you mean {near[0]}? " if near else ""
    raise CellError(
        key,
        "",
        "no URDF" if Path(key).exists() else "neither a file nor a robot of the library",
        f"a URDF, a bag with /robot_description, or a robot of the library; {hint}known: {', '.join(robots)}",
    )
