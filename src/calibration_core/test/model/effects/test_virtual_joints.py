"""What the points of one step have in common is worked out once: the same as reading by reading."""

from __future__ import annotations

import numpy as np
import pytest
from robots import loaded_readings, write_cell

from calibration_core.diagnosis.evidence.extended import loaded_state
from calibration_core.identification.stiffness.loaded import Options, prepare_loaded
from calibration_core.model.virtual_joints import Cut, ExternalWrench, VirtualJoints, before_joint, behind_joint

CUTS = (before_joint(0), behind_joint(1), before_joint(4), before_joint(6))


@pytest.mark.parametrize("cut", CUTS)
def test_points_of_a_step_share_wrench_and_torques_to_the_bit(
    tmp_path_factory: pytest.TempPathFactory, cut: Cut
) -> None:
    cell = write_cell(tmp_path_factory.mktemp("cell"))
    prepared = prepare_loaded(loaded_readings(cell, 4, 6, noise=0.0), cell, Options(robust=False))
    state = loaded_state(prepared.problem, cell, prepared.fit.compliance)
    load = ExternalWrench(state.force, state.moment, state.where, state.follows)
    by_torque = state.answer * state.compliance[:, None]
    assert len(np.unique(state.point_index)) == 3
    for point in np.unique(state.point_index):
        rows = np.flatnonzero(state.point_index == point)
        at, there = state.at.of_readings(rows), load.of_readings(rows)
        alone = VirtualJoints(state.chain, at, state.point[:, rows], there, by_torque[..., rows])
        np.testing.assert_array_equal(state.virtual.wrench(cut)[:, rows], alone.wrench(cut))
        np.testing.assert_array_equal(state.virtual.torque_slope(cut)[..., rows], alone.torque_slope(cut))
        assert np.abs(alone.wrench(cut)).max() > 0
