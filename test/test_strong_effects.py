"""A cause eight times as large as usual: the model that is written reproduces its recording, and predicts others."""

from __future__ import annotations

import functools
from pathlib import Path

import numpy as np
import pytest

from calibration_core.cell import load_cell
from calibration_core.diagnosis.diagnose import diagnose
from calibration_core.identification.stiffness import tested
from calibration_core.model.nominal import nominal_parameters
from calibration_core.timeseries import Readings
from calibration_sim.cell.truth import Spread, draw_truth
from calibration_sim.effects.effect import Label
from calibration_sim.effects.structure import Beam
from calibration_sim.scenarios.measure import Noise, look
from calibration_sim.scenarios.protocols import make_protocol
from calibration_sim.scenarios.world import World, play

CELL = load_cell(Path(__file__).resolve().parents[1] / "config" / "cells" / "demo.cell.yaml")
KNOWN_GEOMETRY = Spread(stiffness=0.15, tracker_shift=2e-3, tracker_turn=1e-4, point=2e-4)
BENDING = (2e-6, 1e-6)  # 1/(N*m^2): usual are 2.5e-7 for a robot of this size
NOISE = 20e-6  # m per coordinate
TRUTH = draw_truth(CELL, 7, spread=KNOWN_GEOMETRY)


@functools.cache
def _world() -> World:
    beam = Beam(Label("structure", "link_bending", {"link": "link_2"}), 1, BENDING, 1e-6, 0.2)
    return World(CELL, TRUTH).with_effects(beam)


def _recorded(protocol: str, seed: int) -> Readings:
    played = play(_world(), make_protocol(CELL, protocol, seed))
    return look(_world(), played, tuple(CELL.frames.measurement_points), Noise(), seed)


@pytest.mark.parametrize(("protocol", "seed"), [("L14", 1), ("L12A36", 3)], ids=["loaded", "mixed"])
def test_the_written_model_reproduces_its_recording(protocol: str, seed: int) -> None:
    recording, other = _recorded(protocol, seed), _recorded("L6", 11)
    found = diagnose(recording, CELL)
    assert [(one.effect, dict(one.location)) for one in found.findings] == [("link_bending", {"link": "link_2"})]
    assert found.model is not None
    assert found.rms_after < 1.15 * NOISE
    itself, unseen = (
        tested.tested_on(one, CELL, found.model, nominal_parameters(CELL), with_frames=False)
        for one in (recording, other)
    )
    assert {part.kind: part.rms < 1.2 * NOISE for part in itself.parts} == dict.fromkeys(
        ("loaded", "at_rest") if "A" in protocol else ("loaded",), True
    )
    assert unseen.rms < 1.4 * NOISE
    np.testing.assert_allclose(1 / found.model.compliance, TRUTH.stiffness, rtol=0.15)
