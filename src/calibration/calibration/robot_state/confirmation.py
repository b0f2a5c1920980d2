"""An operator's word for the operating mode, where the controller does not report it or says no more than "manual"."""

from __future__ import annotations

import dataclasses

from calibration.robot_state.adapter import Report
from calibration_core.errors import InputError, quoted
from calibration_core.motion.robot_status import OperatingMode

LONGEST = 8 * 3600.0  # s, a shift
MANUAL = frozenset({OperatingMode.MANUAL_REDUCED, OperatingMode.MANUAL_HIGH})


@dataclasses.dataclass(frozen=True)
class Confirmation:
    """What an operator stated.

    Attributes:
        operator: Who answers for it.
        mode: What was stated.
        until: s, when it ends, by the guard's clock.
    """

    operator: str
    mode: OperatingMode
    until: float


def checked(operator: str, mode: int, valid_for: float, now: float) -> Confirmation:
    """Return a confirmation that begins at `now` (s).

    Raises:
        InputError: Nobody answers for it, the mode is none that can be confirmed, or it is to last longer than a shift.
    """
    place = "confirmation"
    if not operator.strip():
        raise InputError(place, "operator_name", quoted(operator), "the name of who answers for it")
    if mode not in set(OperatingMode) - {OperatingMode.UNKNOWN, OperatingMode.MANUAL_UNSPECIFIED}:
        raise InputError(place, "operating_mode", str(mode), "manual reduced, manual high, automatic or external")
    if not 0.0 < valid_for <= LONGEST:
        raise InputError(place, "valid_for", f"{valid_for:g} s", f"above 0, at most {LONGEST:g} s")
    return Confirmation(operator.strip(), OperatingMode(mode), now + valid_for)


def confirmed(report: Report, confirmation: Confirmation | None, now: float) -> Report:
    """Fill in the mode that an operator confirmed.

    An operator's word never overrules a mode that the controller reports, and ends at its time; an ended one is kept in
    the report, so that the reason can be named.
    """
    reported = report.status.operating_mode
    if confirmation is None or reported not in {OperatingMode.UNKNOWN, OperatingMode.MANUAL_UNSPECIFIED}:
        return report
    if reported is OperatingMode.MANUAL_UNSPECIFIED and confirmation.mode not in MANUAL:
        return report
    status = dataclasses.replace(
        report.status,
        operating_mode=confirmation.mode if now < confirmation.until else reported,
        operator_confirmed=True,
        confirmed_until=confirmation.until,
    )
    return dataclasses.replace(report, status=status, operator=confirmation.operator)
