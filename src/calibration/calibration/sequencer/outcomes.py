"""How the procedure ended, as a result code."""

from __future__ import annotations

from calibration_interfaces.msg import Outcome

from calibration_core.measurement import messages as m

OUTCOMES = {
    m.Outcome.COMPLETED: Outcome.OK,
    m.Outcome.INCOMPLETE: Outcome.BLOCKED,
    m.Outcome.STOPPED: Outcome.STOPPED,
    m.Outcome.FAULT: Outcome.FAULT,
}
