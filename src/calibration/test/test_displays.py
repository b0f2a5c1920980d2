"""What RViz and Foxglove are told to show exists: topics, types, fields, and how they are carried."""

from __future__ import annotations

import json
import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
import yaml

pytest.importorskip("calibration_interfaces.msg", reason="the messages are not built: run make setup")

from calibration.topics import MARKERS, PLAN_MARKERS, Quality, message_class, recorded_topics
from calibration_core.cell import load_cell

ROOT = Path(__file__).resolve().parents[3]
CELL = load_cell(ROOT / "config" / "cells" / "demo.cell.yaml")
TOPICS = {topic.name: topic for topic in (*recorded_topics(CELL), MARKERS, PLAN_MARKERS)}
OF_ROS = {"/diagnostics": "diagnostic_msgs/msg/DiagnosticArray", "/rosout": "rcl_interfaces/msg/Log"}
SHARE = ROOT / "install" / "calibration" / "share" / "calibration" / "config"


@pytest.mark.parametrize("name", ["cell.rviz", "foxglove.json"])
def test_it_is_installed(name: str) -> None:
    assert (SHARE / name).resolve() == ROOT / "config" / name


def test_rviz_shows_topics_that_exist_and_hears_who_published_before() -> None:
    shown = yaml.safe_load((ROOT / "config" / "cell.rviz").read_text("utf-8"))["Visualization Manager"]
    topics = [display.get("Topic") or display.get("Description Topic") for display in shown["Displays"]]
    heard = {f"/{topic['Value']}": topic for topic in topics if topic}
    assert set(heard) == {MARKERS.name, PLAN_MARKERS.name, CELL.topics.robot_description}
    for name, topic in heard.items():
        kept = TOPICS[name].quality in (Quality.STATE, Quality.EVENTS)
        assert (topic["Durability Policy"] == "Transient Local") == kept
    assert shown["Global Options"]["Fixed Frame"] == CELL.robot.base_link


def strings(value: Any) -> Iterator[str]:
    if isinstance(value, dict):
        for key, one in value.items():
            yield from strings(key)
            yield from strings(one)
    elif isinstance(value, list):
        for one in value:
            yield from strings(one)
    elif isinstance(value, str):
        yield value


def test_foxglove_shows_fields_that_exist() -> None:
    file = json.loads((ROOT / "config" / "foxglove.json").read_text("utf-8"))
    paths = [text for text in strings(file["configById"]) if text.startswith("/")]
    assert len(paths) > 10
    for path in paths:
        topic, *fields = path.split(".")
        kind = OF_ROS[topic] if topic in OF_ROS else TOPICS[topic].type
        for field in fields:
            types = message_class(kind).get_fields_and_field_types()
            name = field.partition("[")[0]
            assert name in types, f"{path}: {kind} has no {name}"
            kind = re.sub(r"(\w+)/(\w+)", r"\1/msg/\2", types[name])


def test_every_panel_of_foxglove_is_laid_out_and_described() -> None:
    file = json.loads((ROOT / "config" / "foxglove.json").read_text("utf-8"))
    placed = [text for text in strings(file["layout"]) if "!" in text]
    assert sorted(placed) == sorted(file["configById"])
