"""The settings file states every default, and a faulty one gets one line."""

from __future__ import annotations

import dataclasses
from pathlib import Path

import pytest
import yaml

from calibration_core.errors import PlanError
from calibration_core.procedure.guard import GuardRules
from calibration_core.procedure.robot_status import OperatingMode
from calibration_core.procedure.settings import ELSEWHERE, SECTIONS, ProcedureSettings, read_settings

FILE = Path(__file__).parents[4] / "config" / "procedure.yaml"


def test_the_file_states_every_default() -> None:
    assert read_settings(FILE) == ProcedureSettings()
    data = yaml.safe_load(FILE.read_text())
    for name, kind in SECTIONS.items():
        fields = {field.name for field in dataclasses.fields(kind)} - ELSEWHERE
        assert set(data[name]) == fields


def test_changes(tmp_path: Path) -> None:
    path = tmp_path / "procedure.yaml"
    path.write_text(
        "space: {floor: null, box: [[-1, 1], [0, 2], [0.5, 1]]}\n"
        "load: {levels: [0, 0.5, 1], largest_force: 500}\n"
        "motion: {margin: 0.1, joint_speed: [1, 1, 1, 2, 2, 2]}\n"
        "sequence: {startup_period: .inf, attempts: 3}\n"
        "guard: {allowed_modes: [MANUAL_REDUCED, AUTOMATIC], speed_limit: 0.2}\n"
    )
    settings = read_settings(path)
    assert settings.planning.space.floor is None
    assert settings.planning.space.box == ((-1, 1), (0, 2), (0.5, 1))
    assert settings.planning.load.levels == (0, 0.5, 1)
    assert settings.motion.joint_speed == (1, 1, 1, 2, 2, 2)
    assert settings.sequence.attempts == 3
    modes = frozenset({OperatingMode.MANUAL_REDUCED, OperatingMode.AUTOMATIC})
    assert settings.guard == GuardRules(allowed_modes=modes, speed_limit=0.2)


def test_empty_file_is_all_defaults(tmp_path: Path) -> None:
    (tmp_path / "p.yaml").write_text("")
    assert read_settings(tmp_path / "p.yaml") == ProcedureSettings()


@pytest.mark.parametrize(
    ("text", "place"),
    [
        ("speed: 1", "speed"),
        ("motion: {sped: 1}", "motion.sped"),
        ("guard: {declared_limit: 0.25}", "guard.declared_limit"),
        ("motion: {speed: 0.3}", "motion.speed"),
        ("motion: {speed: fast}", "motion.speed"),
        ("motion: {margin: .nan}", "motion.margin"),
        ("motion: {max_points: 2.5}", "motion.max_points"),
        ("motion: {joint_speed: [1, x]}", "motion.joint_speed"),
        ("motion: 3", "motion"),
        ("space: {tracker_range: [3, 1]}", "space.tracker_range"),
        ("space: {tracker_range: [1, 2, 3]}", "space.tracker_range"),
        ("space: {box: [[0, 1]]}", "space.box"),
        ("space: {box: [[1, 0], [0, 1], [0, 1]]}", "space.box"),
        ("space: {widest: .inf}", "space.widest"),
        ("load: {levels: [0.5, 1]}", "load.levels"),
        ("load: {levels: 1}", "load.levels"),
        ("load: {share: 1.5}", "load.share"),
        ("load: {directions: true}", "load.directions"),
        ("guard: {allowed_modes: [FAST]}", "guard.allowed_modes"),
        ("guard: {allowed_modes: [1]}", "guard.allowed_modes"),
        ("guard: {allowed_modes: []}", "guard.allowed_modes"),
        ("guard: {tolerance: -1}", "guard.tolerance"),
        ("guard: {speed_limit: 0.3}", "guard.speed_limit"),
        ("load: {directions: 0}", "load.directions"),
        ("planning: {space: {}}", "planning.space"),
        ("[1, 2]", ""),
        ("{", ""),
    ],
)
def test_faults(text: str, place: str, tmp_path: Path) -> None:
    path = tmp_path / "procedure.yaml"
    path.write_text(text)
    with pytest.raises(PlanError) as caught:
        read_settings(path)
    assert caught.value.place.startswith(place)
    assert "\n" not in str(caught.value)


def test_missing_file(tmp_path: Path) -> None:
    with pytest.raises(PlanError):
        read_settings(tmp_path / "none.yaml")
