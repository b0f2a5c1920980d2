"""What a seed gives stays the same: figures of the proof belong to recordings that anybody can make again."""

from __future__ import annotations

import hashlib
import json

import numpy as np
import pytest

from calibration_sim.scenarios.generate import generate
from calibration_sim.scenarios.grid import grid, second_grid

RECORDINGS = {
    "hysteresis": (grid, 240, "b09b63134a56"),
    "anomaly": (grid, -1, "a84bbef26618"),
    "pair": (grid, 730, "f10535a21ed1"),
    "rest": (second_grid, 3, "0f673f896a05"),
    "other law": (second_grid, 270, "223907f0b564"),
    "prismatic": (second_grid, 575, "98b0442af705"),
}


def _digest(content: object) -> str:
    return hashlib.sha256(json.dumps(content, sort_keys=True).encode()).hexdigest()[:12]


@pytest.mark.parametrize("kind", RECORDINGS)
def test_a_scenario_gives_the_recording_that_it_gave(kind: str) -> None:
    scenarios, number, digest = RECORDINGS[kind]
    made = generate(scenarios(987)[number])
    tenths = np.round(made.readings.position * 1e7).astype(int)  # of a µm, the tracker's last digit
    label = [(one["effect"], one["location"], f"{one['amplitude']:.9g}") for one in made.label["effects"]]
    assert _digest([tenths.tolist(), label]) == digest
