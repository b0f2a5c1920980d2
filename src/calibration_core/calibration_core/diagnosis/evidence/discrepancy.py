"""What is always a little wrong in a good cell, and no finding: part of the covariance from the start.

Strain-gauge sensors lag by a tenth of a percent of their range; geometry is off by tenths of a millimetre; frames are
known as well as they could be fitted.  Each is given its expected size, so that it is not taken for physics.
"""

from __future__ import annotations

import numpy as np

from calibration_core.estimation.noise.usual import sensor_lag, sensor_mounting
from calibration_core.identification.geometry.frames import FrameFit
from calibration_core.model.effects import effect_named
from calibration_core.model.effects.recordings import each_recording
from calibration_core.model.effects.state import State
from calibration_core.timeseries import Float3D

UNFITTED_ZERO = 3e-4  # rad, where absolute positions say nothing about the geometry


def structured_discrepancy(state: State, frames: FrameFit | None) -> Float3D:
    """Return (m, 3, k) movements of the points, each for one standard deviation of a small effect, m.

    Args:
        state: The null model.
        frames: The refitted frames; None where the recording holds displacements.
    """
    parts = [each_recording(sensor_lag, state), each_recording(sensor_mounting, state), _geometry(state, frames)]
    if frames is not None:
        parts.append(_frames(state, frames))
    return np.concatenate(parts, axis=2)


def _geometry(state: State, frames: FrameFit | None) -> Float3D:
    """Zeros of the joints stand for all errors of the geometry, as large as the absolute positions show them."""
    size = UNFITTED_ZERO if frames is None else frames.rms / max(state.chain.reach / 2, 0.1)
    zeros = effect_named("joint_zero_offset").candidates(state)
    return np.concatenate([candidate.columns(state) * size for candidate in zeros], axis=2)


def _frames(state: State, frames: FrameFit) -> Float3D:
    """What the refitted frames leave open; readings of one configuration share its geometric error."""
    steps = len(state.configuration) / max(len(np.unique(state.configuration)), 1) / len(frames.points)
    std = np.sqrt(np.clip(np.diag(frames.covariance), 0.0, None) * max(steps, 1.0))
    recordings = 1 if state.setups is None else state.setups.count
    turned = np.tile(std[3:6], recordings)
    frame = effect_named("tracker_frame_misalignment").candidates(state)
    points = np.zeros((len(state.configuration), 3, 3 * len(frames.points)))  # none where no reading shows one
    for candidate in effect_named("measurement_point_offset").candidates(state):
        first = 3 * int(str(candidate.location["point"])[1:])
        points[:, :, first : first + 3] = candidate.columns(state) * std[6 + first : 9 + first]
    return np.concatenate([points, *(each_recording(one.columns, state) * turned for one in frame)], axis=2)
