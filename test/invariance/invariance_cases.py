"""Recordings of every kind with effects in them, and what is answered to them, for the tests of invariance."""

from __future__ import annotations

import copy
import dataclasses
import functools
import math
import re
import tempfile
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import yaml
from input_cases import since_step_zero

from calibration_core.cell import Cell, load_cell
from calibration_core.commands.evaluation import diagnose, identify
from calibration_core.identification.stiffness.loaded import Options
from calibration_core.timeseries import Readings
from calibration_sim.scenarios.generate import generate
from calibration_sim.scenarios.grid import Planned, Scenario
from calibration_sim.scenarios.measure import Noise

RELATIVE = 1e-9
NOISE = Noise(1.1, correlated=True, spherical_claim=True)
COMMANDS = {"identify": identify.evaluate_all, "diagnose": diagnose.evaluate_all}

Content = dict[str, Any]
# (robot, protocol, seed, effects): under load, at rest, both in one recording, and a recording in two halves
RECORDINGS: Mapping[str, tuple[str, str, int, tuple[Planned, ...]]] = {
    "loaded": ("heavy", "R8", 11, (Planned("backlash", 3.0, 0), Planned("nonlinear_stiffness", 4.0, 2))),
    "loaded, small robot": ("tiny", "L8", 12, (Planned("off_axis_compliance", 3.0, 1),)),
    "displacements": ("tiny", "L8", 12, (Planned("off_axis_compliance", 3.0, 1),)),
    "at rest": ("light", "A40", 13, (Planned("transmission_error", 2.0, 1),)),
    "loaded and at rest": ("middle", "L8A24", 14, (Planned("base_compliance", 1.5), Planned("backlash", 2.0, 2))),
    "loaded and at rest, small robot": ("tiny", "L4A14", 15, (Planned("off_axis_compliance", 4.0, 1),)),
    "two recordings": ("tiny", "L10", 12, (Planned("off_axis_compliance", 3.0, 1),)),
}


@dataclasses.dataclass(frozen=True, eq=False)
class Recorded:
    """A recording, its cell file, and what became of its names and of the numbers of configurations and steps."""

    readings: Readings
    content: Content
    names: Mapping[str, str] = dataclasses.field(default_factory=dict)
    numbers: Mapping[int, int] = dataclasses.field(default_factory=dict)
    steps: Mapping[int, int] = dataclasses.field(default_factory=dict)

    def changed(self, *, content: Content | None = None, **values: object) -> Recorded:
        """Return it with other columns."""
        readings = dataclasses.replace(self.readings, **values)
        return dataclasses.replace(self, readings=readings, content=content or self.content)


@functools.cache
def recorded_as(name: str) -> tuple[Recorded, ...]:
    robot, protocol, seed, planned = RECORDINGS[name]
    made = generate(Scenario(0, "any", robot, protocol, seed, planned, 0.0, NOISE, second=True))
    content, readings = copy.deepcopy(made.cell), made.readings
    content["robot"]["gravity"] = [0.01, -0.02, -9.8066]  # a floor that is not level
    if name == "displacements":
        content["measurements"] = {**content.get("measurements", {}), "points": "displacement"}
        content["instruments"]["tracker"] = {"sigma": 1e-5}  # a displacement shows no range
        slipped = (readings.configuration == 3) & (readings.step >= 4)  # of which no physics says anything
        moved = readings.position + slipped[:, None] * np.array([6e-5, -4e-5, 5e-5])
        readings = since_step_zero(dataclasses.replace(readings, position=moved))
    if name != "two recordings":
        return (Recorded(readings, content),)
    later = readings.configuration > np.median(readings.configuration)
    return tuple(Recorded(_of_a_day(readings.select(rows), day), content) for day, rows in ((1, ~later), (2, later)))


def _of_a_day(readings: Readings, day: int) -> Readings:
    source = dataclasses.replace(readings.provenance, path=f"{day}.csv", start=f"2026-01-0{day}T08:00:00", sha256={})
    return dataclasses.replace(readings, provenance=source)


# --- what is answered -------------------------------------------------------------------------------------------------


def _cell(content: Content) -> Cell:
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "cell.yaml"
        path.write_text(yaml.safe_dump(content, sort_keys=False), encoding="utf-8")
        return load_cell(path)


def answers_to(several: Sequence[Recorded]) -> Content:
    """Return what `identify` and `diagnose` find, without the words that are said about it."""
    readings, cells = [one.readings for one in several], [_cell(one.content) for one in several]
    return {name: _without_words(evaluate(readings, cells, Options()).content) for name, evaluate in COMMANDS.items()}


@functools.cache
def unchanged_answers(name: str) -> Content:
    return answers_to(recorded_as(name))


def _without_words(result: Content) -> Content:
    places = ("effect", "location")
    rest = result.get("unexplained", {})
    return {
        "verdict": result["verdict"],
        "usable": result["usable"],
        "stiffness": result["stiffness"],
        "fit": result["fit"],
        "findings": [
            {k: one[k] for k in ("effect", "family", "location", "evidence")}
            | {"parameters": [{k: p[k] for k in ("name", "value", "std")} for p in one["parameters"]]}
            | {"beside": [{k: other[k] for k in places} for other in one["cannot_be_told_from"]]}
            for one in result.get("findings", ())
        ],
        "anomalies": [{k: one[k] for k in ("kind", "location", "configurations")} for one in result["anomalies"]],
        "rest": {k: rest.get(k) for k in ("rms", "significant", "where")},
        "aliases": result.get("aliases"),
    }


def expected_answers(answers: Content, several: Sequence[Recorded]) -> Content:
    """Return the unchanged recording's answers in the names and numbers of the changed one."""
    names, numbers, steps = several[0].names, several[0].numbers, several[0].steps
    found: Content = called(answers, names)
    if len(several) == 1:
        for answer in found.values():
            for one in (*answer["anomalies"], answer["rest"]["where"] or {}):
                if one.get("configurations"):
                    one["configurations"] = [numbers.get(k, k) for k in one["configurations"]]
                place = one.get("location", {})
                place |= {
                    key: counted.get(place[key], place[key])
                    for key, counted in (("configuration", numbers), ("step", steps))
                    if key in place
                }
    return found


def called(value: Any, names: Mapping[str, str]) -> Any:
    """Return plain content with names replaced, keys and words within texts included."""
    if isinstance(value, str):
        return re.sub(r"\w+", lambda word: names.get(word[0], word[0]), value)
    if isinstance(value, Mapping):
        return {called(key, names): called(item, names) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [called(item, names) for item in value]
    return value


def compare_answers(one: Any, other: Any, place: str = "") -> None:
    """Compare two answers, numbers to rounding."""
    if isinstance(one, Mapping):
        assert isinstance(other, Mapping), place
        assert one.keys() == other.keys(), place
        for key, value in one.items():
            compare_answers(value, other[key], f"{place}.{key}")
    elif isinstance(one, list | tuple):
        assert len(one) == len(other), (place, one, other)
        for k, (a, b) in enumerate(zip(one, other, strict=True)):
            compare_answers(a, b, f"{place}[{k}]")
    elif isinstance(one, float) and isinstance(other, float):
        assert math.isclose(one, other, rel_tol=RELATIVE, abs_tol=1e-15), (place, one, other)
    else:
        assert one == other, place
