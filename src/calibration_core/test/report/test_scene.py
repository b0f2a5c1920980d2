"""What of a result can be shown in space."""

from __future__ import annotations

import json
from typing import Any

import numpy as np

from calibration_core.cell import Cell
from calibration_core.identification.result.estimate import Identification
from calibration_core.report.results.result import result_dict
from calibration_core.report.results.scene import scene_of, space_dict


def test_a_loaded_recording(loaded: Identification, cell: Cell) -> None:
    scene = scene_of(json.loads(json.dumps(result_dict(loaded, cell)))["operating_space"], scale=200.0)
    space = loaded.space
    assert list(scene.points) == list(space.points)
    for name, places in space.points.items():
        np.testing.assert_array_equal(scene.points[name], places)
    first = next(iter(space.points.values()))
    assert space.deflection is not None
    np.testing.assert_allclose(scene.arrows[:, 1] - scene.arrows[:, 0], 200.0 * space.deflection, rtol=1e-9)
    np.testing.assert_array_equal(scene.arrows[:, 0], first)
    everywhere = np.concatenate(list(space.points.values()))
    low, high = everywhere.min(axis=0), everywhere.max(axis=0)
    np.testing.assert_allclose(scene.box, [(low + high) / 2, high - low], rtol=1e-12)
    assert scene.wrench_point.shape == (len(space.q), 3)


def test_an_absolute_recording_has_no_arrows(absolute: Identification, absolute_cell: Cell) -> None:
    scene = scene_of(json.loads(json.dumps(result_dict(absolute, absolute_cell)))["operating_space"], scale=200.0)
    assert scene.arrows.shape == (0, 2, 3)


def test_a_plan_shows_the_same_without_a_file(loaded: Identification, cell: Cell) -> None:
    told = json.loads(json.dumps(result_dict(loaded, cell)))["operating_space"]
    for one, other in zip(
        vars(scene_of(space_dict(loaded.space), 3.0)).values(), vars(scene_of(told, 3.0)).values(), strict=True
    ):
        for first, second in zip(_arrays(one), _arrays(other), strict=True):
            np.testing.assert_array_equal(first, second)


def _arrays(value: Any) -> list[np.ndarray]:
    return list(value.values()) if hasattr(value, "values") else [value]
