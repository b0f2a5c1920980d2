"""Tables of `config` that say how other makers' drivers and programs speak: where they stand, and how they are read."""

from __future__ import annotations

from pathlib import Path
from typing import Any, TypeVar

from pydantic import BaseModel, ConfigDict, ValidationError

from calibration_core.cell.values import FieldError
from calibration_core.errors import InputError, quoted
from calibration_core.files.yaml_file import read_yaml

LARGEST_FILE = 100_000  # bytes


class Strict(BaseModel):
    """A part of a table: no unknown keys, values never change."""

    model_config = ConfigDict(extra="forbid", frozen=True)


T = TypeVar("T", bound=Strict)


def shipped(folder: str) -> Path:
    """Return a folder of `config`: beside the sources, or where the package was installed to."""
    for above in Path(__file__).resolve().parents:
        for config in (above / "config", above / "share" / "calibration" / "config"):
            if (config / folder).is_dir():
                return config / folder
    raise InputError(f"config/{folder}", "", "nothing", "a folder beside the sources, or installed with the package")


def read_table(path: str | Path, kind: type[T], what: str, **stated: Any) -> T:
    """Read a table.

    Args:
        path: The file, YAML.
        kind: What it describes.
        what: The same in words.
        stated: Values that hold where the file states none.

    Raises:
        InputError: It cannot be used; with line and column.
    """
    file = read_yaml(path, LARGEST_FILE, f"table of {what} (YAML)")
    if not isinstance(file.data, dict):
        raise InputError(file.path, "", quoted(file.data), f"a table of {what}: a mapping")
    with file.locating():
        try:
            return kind.model_validate({**stated, **file.data})
        except ValidationError as faults:
            fault = faults.errors()[0]
        place, cause = ".".join(str(part) for part in fault["loc"]), fault.get("ctx", {}).get("error")
        if isinstance(cause, FieldError):
            raise InputError(file.path, ".".join(filter(None, (place, cause.place))), cause.found, cause.expected)
        expected = fault["msg"].removeprefix("Input should be ")
        found = {"missing": "nothing", "extra_forbidden": "an unknown key"}.get(fault["type"], quoted(fault["input"]))
        raise InputError(
            file.path, place, found, {"nothing": "a value", "an unknown key": "a key of a table"}.get(found, expected)
        )
