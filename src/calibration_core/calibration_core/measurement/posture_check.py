"""Whether the robot stood where it was planned to stand, all the time that a reading was averaged."""

from __future__ import annotations

import dataclasses

import numpy as np

from calibration_core.errors import apart, beyond
from calibration_core.planning.plans.tolerances import DEFAULT_TOLERANCES, Tolerances
from calibration_core.timeseries import NANOSECONDS, Float1D, Float2D, Int1D

SILENCE = 0.5  # s, joint states may be missing within a window, and at most half of it


@dataclasses.dataclass(frozen=True, eq=False)
class Stood:
    """The joint states of one stretch of time.

    Attributes:
        begin: ns, first moment of the averaging windows.
        end: ns, last moment.
        stamps: (k,) ns, of the joint states within.
        q: (k, n) rad.
    """

    begin: int
    end: int
    stamps: Int1D
    q: Float2D


def posture_fault(
    stood: Stood, planned: Float1D, first: Float1D | None, tolerances: Tolerances, joints: tuple[str, ...]
) -> str:
    """Say what is wrong with a posture: joint, found, expected, tolerance; empty if nothing is.

    Args:
        stood: Where the robot stood.
        planned: (n,) rad.
        first: (n,) rad, means at step 0 of the configuration; None: this is step 0.
        tolerances: See there.
        joints: Their names.
    """
    missing = _missing(stood)
    if missing:
        return missing
    for expected, tolerance, what in (
        (planned, tolerances.posture, "of the plan"),
        (first, tolerances.hold, "of step 0"),
    ):
        if expected is None:
            continue
        off = np.abs(stood.q - expected)
        row, joint = np.unravel_index(int(np.argmax(off)), off.shape)
        if not off[row, joint] <= tolerance:  # what is not finite is elsewhere
            found, wanted = apart(float(stood.q[row, joint]), float(expected[joint]), tolerance, 5)
            return f"{joints[joint]}: found {found} rad, expected {wanted} ± {tolerance:.5f} rad {what}"
    return ""


def movement_fault(stood: Stood, joints: tuple[str, ...]) -> str:
    """Say that the robot did not stand still, or that nobody knows; empty if it stood."""
    missing = _missing(stood)
    if missing:
        return missing
    moved = np.ptp(stood.q, axis=0)
    joint = int(np.argmax(moved))
    if not moved[joint] <= DEFAULT_TOLERANCES.hold:
        found = beyond(float(moved[joint]), DEFAULT_TOLERANCES.hold, 4)
        return f"{joints[joint]} moved by {found} rad meanwhile, expected at most {DEFAULT_TOLERANCES.hold:g} rad"
    return ""


def _missing(stood: Stood) -> str:
    """Say that nobody knows where the robot stood for a part of the time; empty if it is known."""
    if not len(stood.stamps):
        return "no joint states while it was measured"
    length = (stood.end - stood.begin) / NANOSECONDS
    gap = float(np.diff([stood.begin, *stood.stamps.tolist(), stood.end]).max()) / NANOSECONDS
    if gap > max(SILENCE, 0.5 * length):
        return f"no joint states for {gap:.2f} s of the {length:.2f} s in which it was measured"
    return ""
