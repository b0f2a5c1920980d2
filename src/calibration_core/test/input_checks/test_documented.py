"""The document of refused input names every kind, and every kind that blocks has a row."""

from __future__ import annotations

import re
from pathlib import Path

from calibration_core.report.results.traffic_light import BLOCKING

DOC = Path(__file__).resolve().parents[2] / "doc" / "refused_input.md"


def test_every_kind_has_a_row_with_a_remedy() -> None:
    faults = DOC.read_text("utf-8").split("## The faults")[1]
    rows = re.findall(r"^\| `([a-z_]+)` \| ([^|]+) \| ([^|]+) \| ([^|]+) \|$", faults, re.MULTILINE)
    assert {row[0] for row in rows} == BLOCKING | {"noise_overstated"}
    assert all(len(text) > 15 for row in rows for text in row[1:])
