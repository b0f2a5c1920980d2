"""The JSON Schema of the cell file is the one that the models give, and says what they say."""

from __future__ import annotations

import copy
from collections.abc import Callable
from pathlib import Path
from typing import Any

import jsonschema
import pytest

from calibration_core.cell import load_cell
from calibration_core.cell.schema import SCHEMA_FILE, cell_schema, cell_schema_text
from calibration_core.errors import CellError
from calibration_core.files.yaml_file import read_yaml, yaml_text

CELLS = Path(__file__).resolve().parents[3] / "config" / "cells"


def test_the_shipped_file_is_the_one_of_the_models() -> None:
    """To renew it: `SCHEMA_FILE.write_text(cell_schema_text())`, both of `calibration_core.cell.schema`."""
    assert SCHEMA_FILE.read_text(encoding="utf-8") == cell_schema_text()


@pytest.mark.parametrize("path", sorted(CELLS.glob("*.yaml")), ids=lambda path: path.stem)
def test_the_shipped_cells_are_valid_and_name_it_in_their_first_line(path: Path) -> None:
    jsonschema.Draft202012Validator.check_schema(cell_schema())
    jsonschema.validate(read_yaml(path, 1 << 20, "cell").data, cell_schema())
    first = path.read_text(encoding="utf-8").splitlines()[0]
    assert (path.parent / first.partition("$schema=")[2]).resolve() == SCHEMA_FILE.resolve()


def test_every_field_that_a_file_can_hold_is_described() -> None:
    schema = cell_schema()
    assert {"path", "sha256"}.isdisjoint(schema["properties"])
    silent = [name for name, field in schema["properties"].items() if "description" not in field]
    for model in ("Robot", "Frames", "Measurements"):
        silent += [n for n, field in schema["$defs"][model]["properties"].items() if "description" not in field]
    assert silent == []


CHANGES: dict[str, Callable[[Any], None]] = {
    "unknown key": lambda d: d.update(robbot=1),
    "unknown key inside": lambda d: d["frames"].update(traker={}),
    "text for a number": lambda d: d["robot"].update(rated_load="heavy"),
    "too short a vector": lambda d: d["frames"].update(wrench_point=[1, 2]),
    "missing": lambda d: d["robot"].pop("joints"),
    "negative": lambda d: d["instruments"]["tracker"].update(sigma=-1e-5),
    "no choice": lambda d: d.update(measurements={"points": "relative"}),
    "unknown topic": lambda d: d.update(topics={"/joint_stats": "/x"}),
}
GOOD: dict[str, Callable[[Any], None]] = {
    "topics by their usual names": lambda d: d.update(
        topics={"/tracker/mp1": "/a", "/joint_states": "/b", "wrench": "/c"}
    ),
    "a box": lambda d: d.update(boxes=[{"name": "b", "xyz": [0, 0, 9], "size": [1, 1, 1]}]),
}


@pytest.mark.parametrize(
    ("name", "change"), [*CHANGES.items(), *GOOD.items()], ids=lambda one: one if isinstance(one, str) else ""
)
def test_the_schema_and_the_reader_agree(name: str, change: Callable[[Any], None], tmp_path: Path) -> None:
    data = copy.deepcopy(read_yaml(CELLS / "small.cell.yaml", 1 << 20, "cell").data)
    change(data)
    valid = jsonschema.Draft202012Validator(cell_schema()).is_valid(data)
    (tmp_path / "cell.yaml").write_text(yaml_text(data))
    try:
        load_cell(tmp_path / "cell.yaml")
        read = True
    except CellError:
        read = False
    assert (valid, read) == (name in GOOD,) * 2
