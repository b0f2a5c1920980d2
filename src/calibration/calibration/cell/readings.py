"""From the instruments' averages to confirmed readings, and to their message."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from calibration_interfaces.msg import Reading

from calibration.conversions import Mean, to_header, to_point, to_wrench
from calibration.motion.arrival import Joints
from calibration_core.observations.average import average
from calibration_core.recording.session_values import ConfirmedReading


class ReadingError(Exception):
    """No reading can be made of what was measured; the text says why.

    Attributes:
        resume: What a person has to do before the configuration begins again; empty: the reading is tried again.
    """

    resume = ""


def confirmed_readings(
    configuration: int, step: int, points: Sequence[Mean], wrench: Mean | None, joints: Joints, temperature: float
) -> list[ConfirmedReading]:
    """Return one reading per point: joint angles averaged over the point's own window.

    Args:
        configuration: Its number.
        step: Within the configuration.
        points: Averages of the measurement points, m, tracker frame.
        wrench: Average of the wrench, N and N*m; None without sensor.
        joints: The joint states.
        temperature: degrees Celsius, NaN where unknown.

    Raises:
        ReadingError: A point was measured while no joint states came.
    """
    rows = []
    for mean in points:
        _, q = joints.between(mean.begin, mean.end)
        if not len(q):
            raise ReadingError(f"no joint states while {mean.name} was measured")
        one = mean.average
        rows.append(
            ConfirmedReading(
                configuration=configuration,
                step=step,
                point=mean.name,
                time=(mean.begin + mean.end) // 2,
                q=average(q).mean,
                position=one.mean,
                position_covariance=one.covariance,
                samples=one.samples,
                wrench=None if wrench is None else wrench.average.mean,
                wrench_covariance=None if wrench is None else wrench.average.covariance,
                temperature=temperature,
            )
        )
    return rows


def to_reading(
    reading: ConfirmedReading, session: str, attempt: int, joints: Sequence[str], frame: str, tare: int
) -> Reading:
    """Return a reading as a message."""
    wrench = np.zeros(6) if reading.wrench is None else reading.wrench
    covariance = np.zeros((6, 6)) if reading.wrench_covariance is None else reading.wrench_covariance
    return Reading(
        header=to_header(reading.time, frame),
        session=session,
        configuration=reading.configuration,
        step=reading.step,
        attempt=attempt,
        point=reading.point,
        joints=list(joints),
        q=reading.q.tolist(),
        position=to_point(reading.position),
        position_covariance=reading.position_covariance.ravel(),
        has_wrench=reading.wrench is not None,
        wrench=to_wrench(wrench),
        wrench_covariance=covariance.ravel(),
        temperature=reading.temperature,
        samples=reading.samples,
        tare=tare,
    )
