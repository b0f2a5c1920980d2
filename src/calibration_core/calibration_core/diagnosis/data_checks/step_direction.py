"""Does what jumps from step to step follow one joint?  Then it is no noise of the tracker.

The tracker errs in all directions alike, in units of its noise along each; what a joint does moves the points along one
line.  So the power of the jumps along that line is held against that across it (F test, over all configurations).
"""

from __future__ import annotations

import dataclasses

import numpy as np

from calibration_core.diagnosis.data_checks.noise import Scatter, claimed_along, step_groups
from calibration_core.identification.statistics.beyond_noise import FINEST
from calibration_core.identification.statistics.distributions import f_tail
from calibration_core.identification.statistics.offsets import Rows
from calibration_core.timeseries import Float2D, Float3D, Readings

CHANCE = 1e-4  # that jumps of a tracker follow any joint
LEAST = 1e-9  # of a movement per unit of noise: a joint that moves nothing has no line


@dataclasses.dataclass(frozen=True)
class Jumps:
    """What jumps along with one joint.

    Attributes:
        joint: Its index.
        rms: m, of the points' movement along the joint's line, the noise taken off.
        share: Of the power of all jumps, that the joint's line holds.
    """

    joint: int
    rms: float
    share: float


def jumps_along_a_joint(
    rows: Rows, residual: Float2D, readings: Readings, axes: Float3D, answer: Float3D, seen: Scatter
) -> Jumps | None:
    """Return the joint that jumps from step to step follow; None where they follow none, or steps are too few.

    Args:
        rows: Grouping and claimed noise of the m readings.
        residual: (m, 3) m, what the model leaves.
        readings: The same readings.
        axes: (m, 3, 3) directions in which the tracker errs independently.
        answer: (m, 3, n) movement of the points by each joint.
        seen: The noise.
    """
    own = np.array(seen.own)
    lines = np.einsum("mia,man->min", axes, answer) / (claimed_along(rows, axes) * own)[:, :, None]
    stated = float(np.sqrt(np.einsum("mii->m", rows.noise).mean() / 3))
    along, raw = np.zeros(answer.shape[2]), np.zeros(answer.shape[2])
    whole = whole_raw = 0.0
    count = 0
    for number, group in step_groups(rows, residual, readings, axes).items():
        line = lines[rows.configuration == number].mean(axis=0)
        length = np.linalg.norm(line, axis=0)
        line = line * (length > LEAST * length.max(initial=0.0)) / np.maximum(length, 1e-300)
        mean = group.mean / own
        white = mean / np.sqrt(1 / group.points + group.known / own**2)
        along, raw = along + ((white @ line) ** 2).sum(axis=0), raw + ((mean @ line) ** 2).sum(axis=0)
        whole, whole_raw = whole + float((white**2).sum()), whole_raw + float((mean**2).sum())
        count += group.left
    if not count or whole == 0.0:
        return None
    ratio = along / np.maximum((whole - along) / 2, 1e-300)
    joint = int(np.argmax(ratio))
    if f_tail(float(ratio[joint]), count, 2 * count) * len(ratio) >= CHANCE:
        return None
    excess = raw[joint] - (whole_raw - raw[joint]) / 2
    rms = stated * float(np.sqrt(np.mean(own**2) * max(excess, 0.0) / count))
    return None if rms < FINEST * stated else Jumps(joint, rms, float(along[joint]) / whole)
