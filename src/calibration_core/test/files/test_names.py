"""One rule for names: what would break a line, a table or a terminal is no name, wherever names are read."""

from __future__ import annotations

import csv
import io
from collections.abc import Callable
from pathlib import Path
from xml.sax.saxutils import quoteattr

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from calibration_core.cell import load_cell
from calibration_core.cell.urdf import urdf_bytes
from calibration_core.compensation.task import read_task
from calibration_core.errors import InputError
from calibration_core.files.names import is_name
from calibration_core.files.yaml_file import yaml_text
from calibration_core.fleet.recordings.manifest import read_entries

ROOT = Path(__file__).resolve().parents[4]
SMALL = ROOT / "config" / "cells" / "small.cell.yaml"
UNSEEN = st.sampled_from([*map(chr, range(0x20)), "\x7f", "\x85", "\x9b", "\u200b", "\u202e", "\u2028", "\u2029"])
ANY = st.text(st.characters(codec="utf-8"), min_size=1, max_size=12)


@given(st.one_of(ANY, st.builds("{}{}{}".format, ANY, UNSEEN, ANY)))
def test_a_name_stands_in_one_line_of_a_table_and_is_read_back(text: str) -> None:
    if not is_name(text):
        assert not text.strip() or not text.isprintable()
        return
    assert len(text.splitlines()) == 1
    stream = io.StringIO()
    csv.writer(stream, lineterminator="\n").writerow([text, "1"])
    assert stream.getvalue().count("\n") == 1
    assert next(csv.reader(io.StringIO(stream.getvalue()))) == [text, "1"]


def _cell(folder: Path, name: str, place: Callable[[dict, str], None]) -> None:
    import yaml

    content = yaml.safe_load(SMALL.read_text())
    place(content, name)
    if "urdf" in content["robot"]:
        content["robot"]["urdf"] = str((SMALL.parent / content["robot"]["urdf"]).resolve())
    (folder / "bad.cell.yaml").write_text(yaml_text(content), encoding="utf-8")
    load_cell(folder / "bad.cell.yaml")


def _joint(content: dict, name: str) -> None:
    content["robot"]["joints"][1] = name


def _point(content: dict, name: str) -> None:
    content["frames"]["measurement_points"][name] = [0.0, 0.0, 0.1]


def _box(content: dict, name: str) -> None:
    content["boxes"] = [{"name": name, "xyz": [3.0, 0.0, 0.0], "size": [1.0, 1.0, 1.0]}]


def _urdf(folder: Path, name: str) -> None:
    escaped = quoteattr(name, {c: f"&#{ord(c)};" for c in "\t\n\r\x85\u2028"})
    text = f'<robot name="r"><link name="base"/><link name={escaped}/></robot>'
    (folder / "bad.urdf").write_text(text, encoding="utf-8")
    urdf_bytes(folder / "bad.urdf")


def _task(folder: Path, name: str) -> None:
    stream = io.StringIO()
    writer = csv.writer(stream)
    writer.writerows([["x", "y", "z", "roll", "pitch", "yaw", "path"], [1, 0, 1, 0, 0, 0, name]])
    (folder / "bad.csv").write_text(stream.getvalue(), encoding="utf-8", newline="")
    read_task(folder / "bad.csv", load_cell(SMALL))


def _manifest(folder: Path, name: str) -> None:
    stream = io.StringIO()
    csv.writer(stream).writerows([["recording", "cell", "robot", "type", "date"], ["a", "b", name, "t", "2026-01-01"]])
    (folder / "bad.csv").write_text(stream.getvalue(), encoding="utf-8", newline="")
    read_entries(folder / "bad.csv")


READERS: dict[str, Callable[[Path, str], object]] = {
    "cell": lambda folder, name: _cell(folder, name, lambda content, text: content.update(name=text)),
    "robot": lambda folder, name: _cell(folder, name, lambda content, text: content["robot"].update(name=text)),
    "joint": lambda folder, name: _cell(folder, name, _joint),
    "target": lambda folder, name: _cell(folder, name, _point),
    "box": lambda folder, name: _cell(folder, name, _box),
    "link": _urdf,
    "path": _task,
    "robot of a plant": _manifest,
}


@pytest.mark.parametrize("reader", READERS)
@settings(max_examples=25, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(unseen=UNSEEN)
def test_every_reader_refuses_an_unseen_character_in_one_line(reader: str, tmp_path: Path, unseen: str) -> None:
    with pytest.raises(InputError) as caught:
        READERS[reader](tmp_path, f"x{unseen}y")
    text = str(caught.value)
    assert text.isprintable()
    assert ": found " in text
    assert ", expected " in text
