"""What of a result can be shown in space."""

from __future__ import annotations

import json

import numpy as np

from calibration_core.cell import Cell
from calibration_core.identification.estimate import Identification
from calibration_core.report.result import result_dict
from calibration_core.report.scene import scene_of


def test_a_loaded_recording(loaded: Identification, cell: Cell) -> None:
    content = json.loads(json.dumps(result_dict(loaded, cell)))
    scene = scene_of(content, scale=200.0)
    space = loaded.space
    assert list(scene.points) == list(space.points)
    for name, places in space.points.items():
        np.testing.assert_array_equal(scene.points[name], places)
    first = next(iter(space.points.values()))
    assert space.deflection is not None
    np.testing.assert_allclose(scene.arrows[:, 1] - scene.arrows[:, 0], 200.0 * space.deflection, rtol=1e-9)
    np.testing.assert_array_equal(scene.arrows[:, 0], first)
    everywhere = np.concatenate(list(space.points.values()))
    np.testing.assert_array_equal(scene.box, [everywhere.min(axis=0), everywhere.max(axis=0)])
    assert scene.wrench_point.shape == (len(space.q), 3)


def test_an_absolute_recording_has_no_arrows(absolute: Identification, absolute_cell: Cell) -> None:
    scene = scene_of(json.loads(json.dumps(result_dict(absolute, absolute_cell))), scale=200.0)
    assert scene.arrows.shape == (0, 2, 3)
