"""Two targets under each other's name at one step are set aside, and nothing else: they spoil the first fit of all.

Readings elsewhere look bad under that fit, and must not be set aside in the stead of the second of the two.  Some ask
for a robot so soft that it could not stand under its load.
"""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from robots import STIFFNESS, loaded_readings

from calibration_core.cell import Cell
from calibration_core.identification.identify import identify
from calibration_core.report.summary import summary

APART = np.array([0.6, -0.5, 0.4])  # m, from one target to the other


@pytest.mark.parametrize(
    ("seed", "configuration", "step"), [(0, 8, 3), (1, 5, 3), (2, 8, 2), (6, 5, 3), (10, 7, 4), (0, 5, 2), (14, 6, 2)]
)
def test_swapped_targets_are_set_aside_and_nothing_else(cell: Cell, seed: int, configuration: int, step: int) -> None:
    every = loaded_readings(cell, seed, 9)
    readings = every.select(np.flatnonzero(every.point > 0))
    position = readings.position.copy()
    swapped = np.flatnonzero((readings.configuration == configuration) & (readings.step == step))
    position[swapped] += [APART, -APART]
    found = identify(dataclasses.replace(readings, position=position), cell)
    assert [(e.configuration, e.step, e.point) for e in found.exclusions] == [
        (configuration, step, point) for point in ("mp2", "mp3")
    ]
    for joint, true in zip(found.stiffness, STIFFNESS, strict=True):
        assert joint.identifiable
        assert abs(joint.value - true) < 4 * joint.std
    assert found.fit.rms_used < 1e-4 < 1e-2 < found.fit.rms_after
    assert f"{1e6 * found.fit.rms_used:.1f} µm without the readings set aside" in summary(found)
