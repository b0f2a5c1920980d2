"""An operator's word for the operating mode, where the controller does not report it or says no more than "manual".

On makes where T1 and T2 look alike, nobody sees the key switch being turned and turned back.  A word therefore holds
for what the controller reported when it was given, and no longer than somebody may be thought to mind the switch.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Mapping

from calibration.robot_state.adapter import Report
from calibration_core.errors import InputError, quoted
from calibration_core.motion.robot_status import Drives, OperatingMode, RobotStatus

LONGEST = 3600.0  # s, then somebody has to look at the key switch again
UNPOWERED = 60.0  # s, that the drives may not be on: a change of tool or target; in a longer pause the switch is free
MANUAL = frozenset({OperatingMode.MANUAL_REDUCED, OperatingMode.MANUAL_HIGH})
CONFIRMABLE: Mapping[OperatingMode, frozenset[OperatingMode]] = {  # by what the controller reports
    OperatingMode.UNKNOWN: MANUAL | {OperatingMode.AUTOMATIC, OperatingMode.EXTERNAL},
    OperatingMode.MANUAL_UNSPECIFIED: MANUAL,
}


@dataclasses.dataclass(frozen=True)
class Confirmation:
    """What an operator stated.

    Attributes:
        operator: Who answers for it.
        mode: What was stated.
        reported: The mode that the controller reported then.
        until: s, when it ends, or has ended, by the guard's clock.
        off_since: s, since when the drives are not known to be on; None: they are on.
    """

    operator: str
    mode: OperatingMode
    reported: OperatingMode
    until: float
    off_since: float | None = None

    def after(self, status: RobotStatus, now: float) -> Confirmation:
        """Return what is left of it at `now` (s), when the controller reports `status`; what has ended never returns.

        It ends with every change of the reported mode, silence included, and after `UNPOWERED` without drives.
        """
        since = now if self.off_since is None else self.off_since
        off_since = None if status.drives is Drives.ON else since
        ended = status.operating_mode is not self.reported or now - since >= UNPOWERED
        return dataclasses.replace(self, off_since=off_since, until=min(self.until, now) if ended else self.until)


def checked(operator: str, mode: int, valid_for: float, reported: OperatingMode, now: float) -> Confirmation:
    """Return a confirmation that begins at `now` (s); it lasts for an hour at most, whatever was asked for.

    Raises:
        InputError: Nobody answers for it, the controller reports a mode that leaves nothing to be confirmed, the mode
            is none that can be confirmed, or it is to last for no time.
    """
    place = "confirmation"
    if not operator.strip():
        raise InputError(place, "operator_name", quoted(operator), "the name of who answers for it")
    if reported not in CONFIRMABLE:
        expected = "a mode that it does not tell; where it is wrong, turn the key switch"
        raise InputError(place, "operating_mode", f"{reported.name}, reported by the controller", expected)
    if mode not in CONFIRMABLE[reported]:
        expected = ", ".join(f"{one.value} ({one.name})" for one in sorted(CONFIRMABLE[reported]))
        raise InputError(place, "operating_mode", str(mode), f"one of {expected}")
    if not 0.0 < valid_for < math.inf:
        raise InputError(place, "valid_for", f"{valid_for:g} s", f"above 0, at most {LONGEST:g} s")
    return Confirmation(operator.strip(), OperatingMode(mode), reported, now + min(valid_for, LONGEST))


def confirmed(report: Report, confirmation: Confirmation | None, now: float) -> Report:
    """Fill in the mode that an operator confirmed.

    An operator's word never overrules a mode that the controller reports; an ended one is kept in the report, so that
    the reason can be named.
    """
    reported = report.status.operating_mode
    if confirmation is None or confirmation.mode not in CONFIRMABLE.get(reported, frozenset()):
        return report
    status = dataclasses.replace(
        report.status,
        operating_mode=confirmation.mode if now < confirmation.until else reported,
        operator_confirmed=True,
        confirmed_until=confirmation.until,
    )
    return dataclasses.replace(report, status=status, operator=confirmation.operator)
