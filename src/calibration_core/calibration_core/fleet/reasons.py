"""Why a robot stands out, in words."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from typing import TYPE_CHECKING

from calibration_core.acceptance.yearly_change import yearly_change
from calibration_core.model.effects.words import plain_name

if TYPE_CHECKING:
    from calibration_core.fleet.plant import JointState

LAW_LEAST = 3e-5  # rad: smaller changes of a backlash or hysteresis are no damage
STIFFNESS_LEAST = 0.02  # smaller changes of a stiffness are no damage


@dataclasses.dataclass(frozen=True)
class RankingReason:
    """One reason.

    Attributes:
        text: A clause without full stop.
        score: Standard deviations.
        kind: `population`, `change`, `trend` or `finding`.
    """

    text: str
    score: float
    kind: str


def stiffness_reasons(state: JointState, dates: Sequence[str], critical: float) -> list[RankingReason]:
    """Return why a joint's stiffness stands out; none where it does not.

    Args:
        state: The joint.
        dates: Of the robot's usable recordings, ISO 8601.
        critical: Standard deviations that are needed.
    """
    found, joint = [], plain_name(state.joint)
    if not state.belongs:
        side = "softer" if state.deviation < 0 else "stiffer"
        text = f"{joint} is {side} than its sisters ({abs(state.deviation):.1f} standard deviations)"
        found.append(RankingReason(text, abs(state.deviation), "population"))
    return found + _over_time(state, dates, critical, f"stiffness of {joint}", STIFFNESS_LEAST, relative=True)


def law_reasons(state: JointState, dates: Sequence[str], critical: float) -> list[RankingReason]:
    """Return why a backlash or hysteresis stands out; arguments as for `stiffness_reasons`."""
    found, joint = [], plain_name(state.joint)
    name = f"{state.kind} of {joint}"
    if not state.belongs and state.deviation > 0 and state.raw > LAW_LEAST:
        text = f"{name} is larger than that of its sisters ({1e3 * state.raw:.3f} mrad)"
        found.append(RankingReason(text, state.deviation, "population"))
    return found + _over_time(state, dates, critical, name, LAW_LEAST, relative=False)


def _over_time(
    state: JointState, dates: Sequence[str], critical: float, name: str, least: float, *, relative: bool
) -> list[RankingReason]:
    history, found = state.history, []

    def sized(size: float) -> str:
        return f"{100 * yearly_change(size):+z.1f} %" if relative else f"{1e3 * size:+z.3f} mrad"

    if history.cause == "trend" and abs(history.slope) >= least:
        text = f"{name} changes by {sized(history.slope)} a year"
        found.append(RankingReason(text, abs(history.slope) / history.slope_std, "trend"))
    for change in history.changes:
        if abs(change.size) >= least and abs(change.size) > critical * change.std:
            when = f"between {dates[change.index - 1]} and {dates[change.index]}" if len(dates) == history.dates else ""
            text = f"{name} changed by {sized(change.size)} {when}".rstrip()
            if history.cause == "change_or_trend":
                text = f"{text}, or little by little"
            found.append(RankingReason(text, abs(change.size) / change.std, "change"))
    return found
