"""The catalogue has all effects of the vocabulary, and those that have little to say say it."""

from __future__ import annotations

from functools import partial

import numpy as np
from states import state_at

from calibration_core.model import effects
from calibration_core.model.chain import Chain
from calibration_core.model.effects import catalogue
from calibration_core.model.effects.state import State

VOCABULARY = {
    "structure": {"off_axis_compliance", "link_bending", "base_compliance", "tool_compliance", "joint_coupling",
                  "pose_dependent_stiffness", "gravity_compensator"},
    "joint law": {"nonlinear_stiffness", "soft_zone", "backlash", "hysteresis", "creep"},
    "load chain": {"wrench_gain", "wrench_crosstalk", "wrench_drift", "wrench_frame_misalignment",
                   "wrench_point_offset", "tool_weight", "cable_force"},
    "point chain": {"tracker_frame_misalignment", "tracker_scale", "tracker_drift", "measurement_point_offset",
                    "clock_offset"},
    "absolute": {"joint_zero_offset", "geometry_error", "transmission_error", "wrist_coupling", "joint_elasticity",
                 "gravity_direction", "thermal_growth", "approach_direction"},
}  # fmt: skip
TRACKER = np.array([3.0, -1.0, 1.5])


def state(chain: Chain, m: int = 12) -> State:
    pose = np.eye(4)
    pose[:3, 3] = TRACKER
    return state_at(chain, np.random.default_rng(5).uniform(-1, 1, (m, chain.n)), 0.0, tracker=pose)


def test_an_effect_stands_where_its_family_does() -> None:
    for one in catalogue():
        law = one.candidates.func if isinstance(one.candidates, partial) else one.candidates
        home = law.__module__.removeprefix(f"{effects.__name__}.").split(".")[0]
        assert home == one.family.replace(" ", "_")


def test_every_effect_of_the_contract_has_a_file() -> None:
    found: dict[str, set[str]] = {}
    for effect in catalogue():
        found.setdefault(effect.family, set()).add(effect.name)
        assert all((effect.equation, effect.source, effect.reveal))
    assert found == VOCABULARY


def test_a_wrong_unit_of_length_stretches_everything_away_from_the_tracker(chain: Chain) -> None:
    s = state(chain)
    (candidate,) = next(effect for effect in catalogue() if effect.name == "tracker_scale").candidates(s)
    stretched = TRACKER + (1 + 2e-5) * (s.point.T - TRACKER)
    assert np.allclose(2e-5 * candidate.columns(s)[..., 0], stretched - s.point.T, atol=1e-15)


def test_clocks_do_not_matter_at_rest(chain: Chain) -> None:
    effect = next(effect for effect in catalogue() if effect.name == "clock_offset")
    assert list(effect.candidates(state(chain))) == []
