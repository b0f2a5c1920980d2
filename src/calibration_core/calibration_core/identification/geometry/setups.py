"""Frames of several recordings of one robot: each has a tracker pose and measurement points of its own.

The positions of every recording stand in one common frame nearly; what is left of each recording's own pose is a small
motion (`ModelParameters.setups`), fitted beside everything that the recordings share.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable

import numpy as np

from calibration_core.identification.geometry.frames import FrameFit
from calibration_core.identification.geometry.terms import (
    CORRECTIONS,
    PoseSteps,
    Term,
    TermContext,
    TrackerTerm,
)
from calibration_core.model.chain import rotation_about
from calibration_core.model.parameters import ModelParameters
from calibration_core.timeseries import Float1D, Float3D, Readings


def fit_each(
    readings: Readings, believed: ModelParameters, fit: Callable[[Readings, ModelParameters], FrameFit]
) -> tuple[ModelParameters, FrameFit]:
    """Fit the frames of every recording by itself.

    Args:
        readings: Of several recordings, whose points differ in their names.
        believed: Points, and the common frame.
        fit: Fits the frames of one recording; its points are all those of `readings`, in their order.

    Returns:
        parameters: With points and set-ups.
        frames: Of all together: what the points are, and the covariance of all of them; of the tracker pose the mean
            covariance.
    """
    points = {name: believed.points[name] for name in readings.points}
    at_tracker = np.linalg.inv(believed.tracker)
    setups, squares, freedom = [], [], 0
    covariance, scatter = np.zeros((2, *(6 + 3 * len(points),) * 2))
    for rows in readings.each():
        part = readings.select(rows)
        found = fit(part, believed)
        own = np.unique(part.point)
        setups.append(at_tracker @ found.tracker)
        points |= {readings.points[k]: found.points[k] for k in own}
        index = np.concatenate([6 + 3 * k + np.arange(3) for k in own])
        for whole, part_of in ((covariance, found.covariance), (scatter, found.scatter)):
            whole[np.ix_(index, index)] = part_of[np.ix_(index, index)]
            whole[:6, :6] += part_of[:6, :6] / len(readings.each())
        squares.append(found.rms**2 * len(part))
        freedom += found.freedom
    frames = FrameFit(
        tracker=np.array(believed.tracker),
        points=np.stack(list(points.values())),
        covariance=covariance,
        rms=float(np.sqrt(np.sum(squares) / len(readings))),
        rank=6 + 3 * len(points),
        scatter=scatter,
        freedom=freedom,
    )
    return believed.replace(points={**believed.points, **points}, setups=np.stack(setups)), frames


def pose_terms(recordings: int | None) -> list[Term]:
    """Return the terms of the tracker pose; with several recordings, one term each."""
    return [TrackerTerm()] if recordings is None else [SetupTerm(number) for number in range(recordings)]


@dataclasses.dataclass(frozen=True)
class SetupTerm(PoseSteps):
    """Pose of one recording's positions in the base frame: translations, then rotations about the base axes.

    A step (v, w) makes T -> [exp(w), v] T, as of `TrackerTerm`, for the readings of this recording.

    Attributes:
        recording: Its number, from 0.
    """

    recording: int

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the six parameters."""
        return tuple(f"tracker@{self.recording + 1} {name}" for name in CORRECTIONS)

    def write(self, view: TermContext, out: Float3D) -> None:
        """Write -v and -(w x measured) for the readings of the recording, zero for the others."""
        TrackerTerm().write(view, out)
        assert view.recording is not None  # noqa: S101 - the term is for several recordings
        out[:6, :, view.recording != self.recording] = 0.0

    def moved(self, parameters: ModelParameters, step: Float1D) -> ModelParameters:
        """Apply a twist from the left, in the base frame."""
        assert parameters.setups is not None  # noqa: S101 - the term is for several recordings
        twist = np.eye(4)
        twist[:3, :3], twist[:3, 3] = rotation_about(step[3:]), step[:3]
        setups = np.array(parameters.setups)
        base = parameters.tracker
        setups[self.recording] = np.linalg.inv(base) @ twist @ base @ setups[self.recording]
        return parameters.replace(setups=setups)
