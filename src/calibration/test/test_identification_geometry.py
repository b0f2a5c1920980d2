"""Services for frames, geometry, wrist centre and points: each answers with the numbers of the command line."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

pytest.importorskip("calibration_interfaces.msg", reason="the messages are not built: run make setup")

from calibration_interfaces import srv
from calibration_interfaces.action import Identify
from calibration_interfaces.msg import Outcome
from goals import GoalClient
from protocols import everywhere, record, sweeps, wrist
from rclpy.parameter import Parameter
from test_identification import BAG, CELL, ask, finish

from calibration.evaluation.identification import IdentificationNode
from calibration_core.cli import main

SIGMA = "sigma: 1.0e-5"
TRACKER = (2.5, -0.4, 0.6)
YAW = 3.0
WRIST_CENTRE = (0.0, 0.0, -0.10)
OFF = 2e-4  # m and rad: several standard deviations of what circles and spheres tell, far below what gravity bends


@pytest.fixture
def node(spinning: Any) -> IdentificationNode:
    overrides = [Parameter("cell", value=str(CELL))]
    return spinning.add(IdentificationNode(context=spinning.context, parameter_overrides=overrides))


@pytest.fixture(scope="module")
def tables(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Path]:
    folder = tmp_path_factory.mktemp("tables")
    motions = {"base": sweeps(0, 1), "axes": sweeps(*range(6)), "wrist": wrist(), "everywhere": everywhere()}
    return {name: record(folder / f"{name}.csv", CELL, q) for name, q in motions.items()}


def offline(recording: Path, out: Path, *options: str) -> dict[str, Any]:
    """What the command line makes of a recording."""
    arguments = ["identify", str(recording), "--cell", str(CELL), "--out", str(out), *options]
    assert main([*arguments, "--no-report"]) == 0
    return json.loads((out / "result.json").read_text("utf-8"))


class Live:
    """Services that are asked about one recording, and what the command line says of it."""

    def __init__(self, spinning: Any, recording: Path, out: Path, *options: str) -> None:
        self.client, self.recording, self.out = spinning.plain(), recording, out
        self.told = offline(recording, out / "offline", *options)
        self.options = dict(zip(options[::2], options[1::2], strict=True))

    def ask(self, kind: Any, name: str) -> Any:
        """Return an answer whose files are the command line's to the byte."""
        fields = {"recording": str(self.recording), "out": str(self.out / "live")}
        answer = ask(self.client, kind, name, **fields, test=self.options.get("--test", ""))
        assert answer.outcome.code == Outcome.OK, answer.outcome.text
        assert answer.result_json.encode() == (self.out / "offline" / "result.json").read_bytes()
        for file in ("result.json", "model.yaml"):
            assert (self.out / "live" / file).read_bytes() == (self.out / "offline" / file).read_bytes()
        return answer

    def by_standard(self, group: str) -> list[dict[str, Any]]:
        return self.told["standard_geometry"][group]["parameters"]

    def fitted(self, group: str) -> list[dict[str, Any]]:
        return [row for row in self.told["parameters"] if row["group"] == group and row["fitted"]]


def column(rows: list[dict[str, Any]], key: str) -> list[Any]:
    return [row[key] for row in rows]


def place_of(point: Any) -> list[float]:
    return [point.x, point.y, point.z]


def test_base_frame_and_geometry_by_circle_points(
    spinning: Any, node: Any, tables: dict[str, Path], tmp_path: Path
) -> None:
    live = Live(spinning, tables["axes"], tmp_path)
    answer = live.ask(srv.IdentifyBaseFrame, "identify_base_frame")
    rows = live.by_standard("base_frame")
    assert place_of(answer.tracker.position) == column(rows, "value")[:3]
    assert list(answer.std) == column(rows, "std")
    np.testing.assert_allclose(place_of(answer.tracker.position), TRACKER, atol=OFF)
    turned = answer.tracker.orientation
    expected = [0.0, 0.0, np.sin(YAW / 2), np.cos(YAW / 2)]
    np.testing.assert_allclose([turned.x, turned.y, turned.z, turned.w], expected, atol=OFF)
    answer = live.ask(srv.IdentifyGeometry, "identify_geometry")
    rows = live.by_standard("joint_axes")
    for field, key in (("parameters", "name"), ("values", "value"), ("std", "std"), ("units", "unit")):
        assert list(getattr(answer, field)) == column(rows, key)
    assert {"a_2", "alpha_3"} <= set(answer.parameters)
    assert np.abs(answer.values).max() < OFF


def test_frames_geometry_and_points_from_poses_everywhere(
    spinning: Any, node: Any, tables: dict[str, Path], tmp_path: Path
) -> None:
    live = Live(spinning, tables["everywhere"], tmp_path, "--test", str(tables["base"]))
    assert live.told["standard_geometry"]["base_frame"] is None
    assert live.told["test"]["readings"] == 150
    answer = live.ask(srv.IdentifyBaseFrame, "identify_base_frame")
    assert place_of(answer.tracker.position) == column(live.fitted("tracker"), "value")[:3]
    assert list(answer.std) == column(live.fitted("tracker"), "std")
    np.testing.assert_allclose(place_of(answer.tracker.position), TRACKER, atol=OFF)
    answer = live.ask(srv.IdentifyPoints, "identify_points")
    assert list(answer.points) == live.told["recording"]["points"]
    places = [coordinate for point in answer.positions for coordinate in place_of(point)]
    assert places == column(live.fitted("point"), "value")
    assert list(answer.std) == column(live.fitted("point"), "std")
    np.testing.assert_allclose(places[:3], (0.10, 0.0, 0.05), atol=OFF)
    geometry = live.fitted("geometry")
    if geometry:
        answer = live.ask(srv.IdentifyGeometry, "identify_geometry")
        assert (list(answer.parameters), list(answer.values)) == (column(geometry, "name"), column(geometry, "value"))


def test_wrist_centre_as_a_service_and_as_an_action(
    spinning: Any, node: Any, tables: dict[str, Path], tmp_path: Path
) -> None:
    live = Live(spinning, tables["wrist"], tmp_path)
    answer = live.ask(srv.IdentifyWristCentre, "identify_wrist_centre")
    rows = live.by_standard("wrist_centre")
    assert place_of(answer.centre) == column(rows, "value")
    assert list(answer.std) == column(rows, "std")
    np.testing.assert_allclose(place_of(answer.centre), WRIST_CENTRE, atol=OFF)
    client = GoalClient(live.client, Identify, "/identification/identify")
    assert client.wait_for_server(20.0)
    out = tmp_path / "action"
    goal = Identify.Goal(what=Identify.Goal.WRIST_CENTRE, recording=str(tables["base"]), out=str(out))
    result = finish(finish(client.send_goal_async(goal)).get_result_async()).result
    assert result.outcome.code == Outcome.NOT_IDENTIFIABLE
    assert "found 0 with a wrist motion" in result.outcome.text
    assert Path(result.report_path).is_file()
    assert result.result_json.encode() == (out / "result.json").read_bytes()


def test_what_a_recording_does_not_determine(spinning: Any, node: Any, tables: dict[str, Path], tmp_path: Path) -> None:
    client = spinning.plain()
    differences = tmp_path / "cell.yaml"
    text = CELL.read_text("utf-8").replace("sigma_range: 8.0e-6, sigma_range_per_m: 4.0e-7, sigma_angle: 3.0e-6", SIGMA)
    differences.write_text(f"{text}measurements: {{points: displacement}}\n", "utf-8")
    for kind, name, recording, words in (
        (srv.IdentifyStiffness, "identify_stiffness", tables["wrist"], "determines no joint stiffness"),
        (srv.IdentifyWristCentre, "identify_wrist_centre", tables["base"], "found 0 with a wrist motion"),
        (srv.IdentifyWristCentre, "identify_wrist_centre", BAG, "has loads"),
        (srv.IdentifyBaseFrame, "identify_base_frame", BAG, "determines no tracker frame"),
        (srv.IdentifyGeometry, "identify_geometry", BAG, "determines no geometry"),
        (srv.IdentifyPoints, "identify_points", BAG, "determines no measurement point"),
    ):
        cell = differences if recording == BAG else CELL
        answer = ask(client, kind, name, recording=str(recording), cell=str(cell), out=str(tmp_path / "out"))
        assert answer.outcome.code == Outcome.NOT_IDENTIFIABLE, name
        assert words in answer.outcome.text
        assert json.loads(answer.result_json)["command"] == "identify"


def test_a_loaded_recording_determines_frames_and_points_too(spinning: Any, node: Any, tmp_path: Path) -> None:
    live = Live(spinning, BAG, tmp_path)
    answer = live.ask(srv.IdentifyBaseFrame, "identify_base_frame")
    np.testing.assert_allclose(place_of(answer.tracker.position), TRACKER, atol=2e-3)
    assert list(live.ask(srv.IdentifyPoints, "identify_points").points) == ["mp1", "mp2", "mp3"]
