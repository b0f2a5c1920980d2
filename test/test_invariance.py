"""What is found does not depend on what things are called, how they are counted, or where the tracker's zero points."""

from __future__ import annotations

import copy
import dataclasses
import functools
import math
import tempfile
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml

from calibration_core.cell import load_cell
from calibration_core.diagnosis.diagnose import diagnose
from calibration_core.report.results.diagnosis import diagnosis_dict
from calibration_core.timeseries import Readings
from calibration_sim.mechanics.transforms import rotation_vector
from calibration_sim.scenarios.generate import generate
from calibration_sim.scenarios.grid import Planned, Scenario
from calibration_sim.scenarios.measure import Noise
from calibration_sim.scenarios.names import renamed

RELATIVE = 1e-9
NOISE = Noise(1.1, correlated=True, spherical_claim=True)
BOTH = (Planned("backlash", 3.0, 0), Planned("nonlinear_stiffness", 4.0, 2))
# (robot, protocol, seed, effects): loaded, at rest, and both in one recording
RECORDINGS: Mapping[str, tuple[str, str, int, tuple[Planned, ...]]] = {
    "loaded": ("heavy", "R8", 11, BOTH),
    "loaded, small robot": ("tiny", "L8", 12, (Planned("off_axis_compliance", 3.0, 1),)),
    "at rest": ("light", "A40", 13, (Planned("transmission_error", 2.0, 1),)),
    "loaded and at rest": ("middle", "L8A24", 14, (Planned("base_compliance", 1.5), Planned("backlash", 2.0, 2))),
}

QUICK = ("loaded, small robot", "at rest")
SLOW = pytest.mark.slow

Content = dict[str, Any]
Change = Callable[[Readings, Content], tuple[Readings, Content]]


@functools.cache
def _recording(name: str) -> tuple[Readings, Content]:
    robot, protocol, seed, planned = RECORDINGS[name]
    made = generate(Scenario(0, "any", robot, protocol, seed, planned, 0.0, NOISE, second=True))
    return made.readings, made.cell


@functools.cache
def _unchanged(name: str) -> Content:
    return _answer(*_recording(name))


def _answer(readings: Readings, content: Content) -> Content:
    """Return what is found, without the words that are said about it."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "cell.yaml"
        path.write_text(yaml.safe_dump(content, sort_keys=False), encoding="utf-8")
        cell = load_cell(path)
    result = diagnosis_dict(diagnose(readings, cell), cell)
    places = ("effect", "location")
    return {
        "verdict": result["verdict"],
        "stiffness": [{k: row[k] for k in ("joint", "value", "std", "identifiable")} for row in result["stiffness"]],
        "fit": result["fit"],
        "findings": [
            {k: one[k] for k in ("effect", "family", "location", "evidence")}
            | {"parameters": [{k: p[k] for k in ("name", "value", "std")} for p in one["parameters"]]}
            | {"beside": [{k: other[k] for k in places} for other in one["cannot_be_told_from"]]}
            for one in result["findings"]
        ],
        "anomalies": [{k: one[k] for k in ("kind", "location", "configurations")} for one in result["anomalies"]],
        "rest": {k: result["unexplained"][k] for k in ("rms", "significant", "where")},
    }


def _same(one: Any, other: Any, place: str = "") -> None:
    """Compare two answers, numbers to rounding."""
    if isinstance(one, Mapping):
        assert isinstance(other, Mapping), place
        assert one.keys() == other.keys(), place
        for key, value in one.items():
            _same(value, other[key], f"{place}.{key}")
    elif isinstance(one, list | tuple):
        assert len(one) == len(other), (place, one, other)
        for k, (a, b) in enumerate(zip(one, other, strict=True)):
            _same(a, b, f"{place}[{k}]")
    elif isinstance(one, float) and isinstance(other, float):
        assert math.isclose(one, other, rel_tol=RELATIVE, abs_tol=1e-15), (place, one, other)
    else:
        assert one == other, place


def _named(names: str) -> Change:
    def change(readings: Readings, content: Content) -> tuple[Readings, Content]:
        return dataclasses.replace(readings, points=tuple(renamed(readings.points, names))), renamed(content, names)

    return change


def _configurations_counted_otherwise(readings: Readings, content: Content) -> tuple[Readings, Content]:
    return dataclasses.replace(readings, configuration=7 * readings.configuration + 100), content


def _points_in_another_order(readings: Readings, content: Content) -> tuple[Readings, Content]:
    """Turn the order of the points round, in the cell file and in the recording's list; the rows stay as they are."""
    content = copy.deepcopy(content)
    points = content["frames"]["measurement_points"]
    content["frames"]["measurement_points"] = dict(reversed(points.items()))
    last = len(readings.points) - 1
    return dataclasses.replace(readings, points=readings.points[::-1], point=last - readings.point), content


def _rows_of_a_step_in_another_order(readings: Readings, content: Content) -> tuple[Readings, Content]:
    """Shuffle the rows of every step, which are measured together."""
    rng = np.random.default_rng(1)
    order = np.lexsort((rng.random(len(readings)), readings.step, readings.configuration))
    arrays = {
        field.name: value[order]
        for field in dataclasses.fields(readings)
        if isinstance(value := getattr(readings, field.name), np.ndarray)
    }
    return dataclasses.replace(readings, **arrays), content


def _tracker_turned(readings: Readings, content: Content) -> tuple[Readings, Content]:
    """Turn the tracker about its own standing axis, by which it measures azimuth and elevation.

    A rotation about z at the right of a frame with fixed-axis angles (r, p, y) adds to r, p and y alone if r = p = 0,
    as in these cells.
    """
    content = copy.deepcopy(content)
    pose = content["frames"]["tracker"]
    assert pose["rpy"][:2] == [0.0, 0.0]
    pose["rpy"] = [0.0, 0.0, pose["rpy"][2] + 0.8]
    turn = rotation_vector(np.array([0.0, 0.0, 0.8]))
    return dataclasses.replace(readings, position=readings.position @ turn), content


def _base_turned(readings: Readings, content: Content) -> tuple[Readings, Content]:
    """Turn the base frame by a quarter under the robot: the first joint's zero and the tracker follow."""
    content = copy.deepcopy(content)
    first = content["robot"]["dh"][0]
    first["theta"] = first.get("theta", 0.0) - math.pi / 2
    pose = content["frames"]["tracker"]
    x, y, z = pose["xyz"]
    content["frames"]["tracker"] = {"xyz": [y, -x, z], "rpy": [0.0, 0.0, pose["rpy"][2] - math.pi / 2]}
    return readings, content


CHANGES: Mapping[str, Change] = {
    "names of UR": _named("ur"),
    "names of KUKA, counted from the flange": _named("kuka"),
    "names with digits in odd places": _named("odd"),
    "configurations counted otherwise": _configurations_counted_otherwise,
    "points in another order": _points_in_another_order,
    "rows of a step in another order": _rows_of_a_step_in_another_order,
    "tracker turned": _tracker_turned,
    "base turned": _base_turned,
}


def _expected(answer: Content, change: str) -> Content:
    """Return the unchanged recording's answer in the words of the changed one."""
    names = {"names of UR": "ur", "names of KUKA, counted from the flange": "kuka"}.get(change, "plain")
    names = "odd" if change == "names with digits in odd places" else names
    said = renamed(answer, names)
    if change == "configurations counted otherwise":
        for one in said["anomalies"]:
            one["configurations"] = [7 * k + 100 for k in one["configurations"] or ()]
        where = said["rest"]["where"]
        if "configurations" in where:
            where["configurations"] = [7 * k + 100 for k in where["configurations"]]
    return said


@pytest.mark.parametrize("change", CHANGES)
@pytest.mark.parametrize(
    "recording", [name if name in QUICK else pytest.param(name, marks=SLOW) for name in RECORDINGS]
)
def test_the_same_is_found(recording: str, change: str) -> None:
    if change == "base turned" and any("compliance" in planned.name for planned in RECORDINGS[recording][3]):
        pytest.skip("what tilts about the base's own axes is told in these axes")
    expected = _expected(copy.deepcopy(_unchanged(recording)), change)
    assert expected["findings"]
    _same(_answer(*CHANGES[change](*_recording(recording))), expected)
