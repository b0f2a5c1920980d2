"""Cells whose controller reports nothing (KUKA's RSI alone, for one): an operator states the mode and answers for it.

The operator's word covers what the controller would otherwise report: that the drives are on and no safety stop is
active, since a robot that is held by its enabling device does not move without.  It ends at its time, and joint states
must be fresh as everywhere.
"""

from __future__ import annotations

from calibration.robot_state.adapter import Adapter, Messages
from calibration_core.motion.robot_status import Drives, RobotStatus, SafetyState


def translate(messages: Messages) -> RobotStatus:  # noqa: ARG001  # nothing is heard
    """Return the state that holds while an operator's confirmation does; the mode stays open until then."""
    return RobotStatus(drives=Drives.ON, safety=SafetyState.NORMAL)


ADAPTER = Adapter("manual_confirm", (), translate)
