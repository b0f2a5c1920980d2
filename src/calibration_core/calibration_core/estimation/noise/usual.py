"""What is always a little wrong in a good cell, and no finding: part of the covariance from the start.

Strain-gauge sensors lag by a tenth of a percent of their range, and are screwed on less exactly than a tracker is
registered.  Each is given its expected size, so that it is not taken for physics.
"""

from __future__ import annotations

import numpy as np

from calibration_core.model.effects import effect_named
from calibration_core.model.effects.joint_law.hysteresis import stop
from calibration_core.model.effects.priors import typical
from calibration_core.model.effects.recordings import each_recording
from calibration_core.model.effects.springs import largest
from calibration_core.model.effects.state import State
from calibration_core.timeseries import Float3D

LAG_RADIUS = 0.3  # of the largest load: change after which a sensor's lag has turned over
SENSOR_MOUNTING = 5.0  # times better a tracker is registered than a sensor is screwed on


def usual_errors(state: State) -> Float3D:
    """Return (m, 3, k) movements of the points, each for one standard deviation of what is usual, m."""
    if not state.loaded:
        return np.zeros((state.m, 3, 0))
    return np.concatenate([each_recording(sensor_lag, state), each_recording(sensor_mounting, state)], axis=2)


def sensor_lag(state: State) -> Float3D:
    """Return (m, 3, 6) what the lag of every axis of the sensor moves, m."""
    share = typical("wrench_hysteresis", state.rated_load)
    force = largest(np.linalg.norm(state.wrench[:, :3], axis=1))
    torque = largest(np.linalg.norm(state.wrench[:, 3:], axis=1))
    columns = []
    for axis in range(6):
        values = state.wrench[:, axis]
        span = force if axis < 3 else torque
        lag = state.along_steps(values, lambda v, span=span: stop(v, LAG_RADIUS * span, 0.0))  # type: ignore[misc]
        columns.append(state.by_wrench[:, :, axis] * (share * lag / LAG_RADIUS)[:, None])
    return np.stack(columns, axis=-1)


def sensor_mounting(state: State) -> Float3D:
    """Return (m, 3, 3) what a turn of the sensor's mounting moves, m."""
    turned = effect_named("wrench_frame_misalignment")
    size = typical("registration_rotation", state.rated_load) * SENSOR_MOUNTING
    return np.concatenate([candidate.columns(state) * size for candidate in turned.candidates(state)], axis=2)
