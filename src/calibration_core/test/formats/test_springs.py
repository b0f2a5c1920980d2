"""Compliances as hinges that a simulator can hold."""

from __future__ import annotations

import numpy as np
from export_cases import CELLS

from calibration_core.cell import load_cell
from calibration_core.formats.springs import springs_of
from calibration_core.model.parameters import AppliedEffect
from calibration_core.model.robot import chain_of


def test_a_tool_on_oblique_hinges_is_springs_about_its_principal_axes() -> None:
    sides = 1e-4 * np.array([[3.0, -1.0, 2.0], [0.5, 2.0, 1.0], [1.0, 1.5, -2.0]])
    matrix = sides @ sides.T
    names, places = ("x", "y", "xy", "z", "xz", "yz"), ((0, 0), (1, 1), (0, 1), (2, 2), (0, 2), (1, 2))
    values = {f"rotation_{name}": float(matrix[place]) for name, place in zip(names, places, strict=True)}
    assert min(values.values()) < 0  # between two axes
    effect = AppliedEffect("tool_compliance", {"tool": "tool"}, "oblique rotation", values)
    found = springs_of(chain_of(load_cell(CELLS / "demo.cell.yaml")), [effect])
    assert found.held == (effect,)
    assert len(found.flange) == 3
    seen = sum((one.compliance * np.outer(one.axis, one.axis) for one in found.flange), np.zeros((3, 3)))
    np.testing.assert_allclose(seen, matrix, rtol=1e-12)
