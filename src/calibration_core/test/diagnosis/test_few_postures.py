"""Waves of many orders at all joints follow whatever goes with the posture: few configurations do not prove them."""

from __future__ import annotations

import dataclasses
from pathlib import Path

import numpy as np
import pytest
from several_cases import measured, setup

from calibration_core.diagnosis.diagnose import diagnose
from calibration_core.estimation import controls

SHIFT = 6e-5  # m
AMPLITUDE = 1e-4  # rad, standard deviation


@pytest.mark.parametrize(("proven", "found"), [(True, []), (False, [{"joints": "all"}])])
def test_something_else_that_follows_the_posture_is_not_called_a_gear(
    proven: bool, found: list[dict[str, str]], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Thirteen configurations, and a shift that is no physics of the catalogue; then the same without the control."""
    cell = setup(tmp_path, 0, sigma=2e-5)
    geometry = 4e-4 * np.random.default_rng(4).standard_normal((6, 6))
    readings = measured(cell, 0, 34, configurations=6, rest=7, geometry=geometry)
    q = readings.q.T
    shift = SHIFT * np.stack([np.sin(2 * q[0] + q[1]), np.cos(q[1] - q[2]), np.sin(q[2] + 2 * q[4])], axis=1)
    if not proven:
        monkeypatch.setattr(controls, "_following", lambda _: "")
    answer = diagnose(dataclasses.replace(readings, position=readings.position + shift), cell)
    assert [one.location for one in answer.findings] == found


def test_waves_that_gain_enough_each_are_named_whatever_they_leave(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Waves of twelve orders in every gear, sixty postures, and a control that no waves would pass."""
    monkeypatch.setattr(controls, "FOLLOWS", 0.0)
    monkeypatch.setattr(controls, "SAVED", 1.0)
    cell = setup(tmp_path, 0, sigma=2e-5)
    readings = measured(cell, 0, 33, configurations=0, rest=60)
    phase = np.arange(1, 13)[:, None, None] * readings.q
    size = AMPLITUDE * np.random.default_rng(5).standard_normal((2, 12, 1, readings.q.shape[1]))
    error = np.sum(size[0] * np.cos(phase) + size[1] * np.sin(phase), axis=0)
    found = diagnose(dataclasses.replace(readings, q=readings.q - error), cell)
    assert [(one.effect, one.location) for one in found.findings] == [("transmission_error", {"joints": "all"})]
