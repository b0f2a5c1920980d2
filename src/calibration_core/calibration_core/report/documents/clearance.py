"""What is said of a plan's motions: how many come too near to something, and what was not looked at."""

from __future__ import annotations

from collections.abc import Sequence

from calibration_core.report.rounding import counted


def clearance(unclear_moves: int, unjudged: Sequence[str]) -> str:
    """Return one sentence, without its full stop.

    Args:
        unclear_moves: Motions that cannot be proven clear on the straight path in joint space.
        unjudged: Pairs of bodies that were not held against each other, see `CollisionModel`.
    """
    text = "every motion is clear of robot, floor and boxes all the way"
    if unclear_moves:
        moves = counted(unclear_moves, "motion comes", "motions come")
        text = f"{moves} too near to robot, floor or boxes on the straight path in joint space: lead it by hand"
    if unjudged:
        text += f"; not judged, for they touch by their shape alone: {', '.join(unjudged)}"
    return text
