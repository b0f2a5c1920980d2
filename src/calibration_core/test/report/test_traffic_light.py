"""The light is the same from `identify` and `diagnose`: a joint that the extended model determines is none to name."""

from __future__ import annotations

from typing import Any

import pytest

from calibration_core.report.results.traffic_light import with_light

LEVER = "frames.force_torque (frames.wrench_point where wrench_at is wrench_point)"


def content(**stiffness: Any) -> dict[str, Any]:
    return {"anomalies": [], "findings": [], "verdict": "consistent", "stiffness": [{"joint": "joint_5", **stiffness}]}


@pytest.mark.parametrize(
    ("stiffness", "named"),
    [
        ({"identifiable": True}, False),
        ({"identifiable": False}, True),
        ({"identifiable": False, "reason": "declared rigid in the cell file: not asked for"}, False),
        ({"identifiable": False, "extended": {"value": 18877.0, "std": 4460.0}}, False),
        ({"identifiable": False, "extended": {"value": 31664.0, "std": 36580.0}}, True),
    ],
)
def test_a_joint_is_named_where_neither_model_determines_it(stiffness: dict[str, Any], *, named: bool) -> None:
    light = with_light(content(**stiffness))
    assert ("not identifiable: joint_5" in light["reason"]) is named
    assert light["usable"] == ("with_reservations" if named else "yes")


@pytest.mark.parametrize(("command", "asked"), [("identify", True), ("diagnose", False)])
def test_a_diagnosis_that_found_nothing_does_not_ask_for_itself(command: str, *, asked: bool) -> None:
    light = with_light({**content(identifiable=True), "verdict": "unexplained", "command": command})
    assert ("run diagnose" in light["next_step"]) is asked
    assert "measure there again" in light["next_step"]


def test_causes_that_the_recording_cannot_tell_apart_are_named_together() -> None:
    base = {"effect": "base_compliance", "location": {"base": "base"}}
    bearing = {"effect": "off_axis_compliance", "location": {"joint": "joint_1"}, "cannot_be_told_from": [base]}
    light = with_light({**content(identifiable=True), "verdict": "missing_physics", "findings": [bearing]})
    assert "joint 1 tilts about an axis that is not its own or the base gives way" in light["reason"]


@pytest.mark.parametrize(
    ("effect", "alike", "field"),
    [
        ("wrench_frame_misalignment", ("wrench_crosstalk",), "frames.force_torque"),
        ("wrench_crosstalk", ("wrench_frame_misalignment",), "frames.force_torque"),
        ("tracker_frame_misalignment", (), "frames.tracker"),
        ("measurement_point_offset", ("wrench_point_offset",), f"frames.measurement_points and {LEVER}"),
        ("wrench_point_offset", (), LEVER),
        ("wrench_point_offset", ("wrench_frame_misalignment",), LEVER),
        ("base_compliance", (), ""),
    ],
)
def test_what_a_wrong_cell_file_looks_like_is_looked_for_there_first(
    effect: str, alike: tuple[str, ...], field: str
) -> None:
    where = {"sensor": "force_torque", "point": "mp1", "base": "base"}
    beside = [{"effect": one, "location": where} for one in alike]
    finding = {"effect": effect, "location": where, "cannot_be_told_from": beside}
    light = with_light({**content(identifiable=True), "verdict": "missing_physics", "findings": [finding]})
    assert light["next_step"].endswith("use the extended model that diagnose writes (model.yaml)")
    assert light["next_step"].startswith(f"hold {field} of the cell file against what is mounted" if field else "use")
