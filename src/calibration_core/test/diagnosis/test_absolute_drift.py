"""A drift is believed only where noise that lasts cannot be taken for it."""

from __future__ import annotations

import numpy as np

from calibration_core.diagnosis.absolute_design import AbsoluteDesign
from calibration_core.diagnosis.absolute_drift import DriftControl, slow_blocks
from calibration_core.model.effects.candidate import Candidate, Parameter

POSES = 60
PARAMETERS = (Parameter("velocity_x", "m/s", 1.0),)
DRIFT = Candidate("tracker_drift", "point chain", {"tracker": "tracker"}, "linear", PARAMETERS, lambda _: np.zeros(0))
OTHER = Candidate("backlash", "joint law", {"joint": "joint_1"}, "any", PARAMETERS, lambda _: np.zeros(0))


def refused(residual: np.ndarray, candidate: Candidate = DRIFT) -> str:
    """Return why a drift along x is refused beside free offsets."""
    x = np.tile([1.0, 0.0, 0.0], POSES)
    time = np.repeat(np.linspace(-1, 1, POSES), 3)
    null = np.tile(np.eye(3), (POSES, 1))
    design = AbsoluteDesign(residual, null, 10 * (x * time)[:, None], (candidate,), (slice(0, 1),), np.arange(POSES))
    return DriftControl(slow_blocks(np.arange(POSES)), lambda *_: "asked besides")(design, (), 0)


def test_a_clear_drift_is_believed() -> None:
    time = np.repeat(np.linspace(-1, 1, POSES), 3)
    noise = np.random.default_rng(1).standard_normal(3 * POSES)
    assert refused(noise + 4 * time * np.tile([1.0, 0.0, 0.0], POSES)) == ""


def test_noise_that_lasts_is_no_drift() -> None:
    believed = 0
    for seed in range(40):
        rng = np.random.default_rng(seed)
        slow = np.zeros((POSES, 3))
        for k in range(1, POSES):
            slow[k] = 0.6 * slow[k - 1] + 0.8 * rng.standard_normal(3)
        believed += refused(slow.reshape(-1)) == ""
    assert believed <= 2


def test_other_effects_are_asked_elsewhere() -> None:
    assert refused(np.ones(3 * POSES), OTHER) == "asked besides"


def test_blocks_hold_several_configurations_where_there_are_few() -> None:
    assert slow_blocks(np.repeat(np.arange(54), 3)).count == 18
    assert slow_blocks(np.arange(1000)).count == 40
