"""What an identification says on the terminal: of what its errors are, and with which geometry."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from calibration_core.identification.result.estimate import Identification
from calibration_core.report.summary import summary


@pytest.mark.parametrize(("kind", "what"), [("loaded", "deflections"), ("absolute", "positions")])
def test_what_was_predicted_of_configurations_left_out_is_said(
    kind: str, what: str, request: pytest.FixtureRequest
) -> None:
    found: Identification = request.getfixturevalue(kind)
    size = f"mean {1e3 * found.fit.held_out_mean_after:.3f} mm"
    assert f"error of {what} on configurations left out, as a distance: {size}" in summary(found)


@pytest.mark.parametrize(("correction", "said"), [(0.0, "as stated"), (1e-4, "identified")])
def test_absolute_positions_are_said_with_the_geometry_that_they_have(
    correction: float, said: str, loaded: Identification
) -> None:
    model = loaded.model.replace(geometry=np.full((6, 6), correction))
    found = dataclasses.replace(loaded, fit=dataclasses.replace(loaded.fit, positions=1.5e-4), model=model)
    expected = f"positions, with tracker and targets fitted and the geometry {said}: 0.150 mm rms per coordinate"
    assert expected in summary(found)
    assert "geometry" not in summary(loaded)
