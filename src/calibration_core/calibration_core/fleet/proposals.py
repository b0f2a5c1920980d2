"""What to measure next in a plant, the most urgent first."""

from __future__ import annotations

import dataclasses
import math

from calibration_core.fleet.plant import CONSPICUOUS, UNKNOWN, FleetRobot, JointState, Plant
from calibration_core.fleet.pooling import LEAST
from calibration_core.fleet.series import STIFFNESS
from calibration_core.model.effects.words import plain_name

MOST = 50
SOON = 12.0  # months: a limit that may be reached within a year
ONE_DATE = 1


@dataclasses.dataclass(frozen=True)
class Proposal:
    """One robot to be measured, and why."""

    type: str
    robot: str
    why: str


def proposals(plant: Plant) -> tuple[Proposal, ...]:
    """Return at most `MOST` robots: not measured, conspicuous, ageing, then those known least."""
    states: dict[tuple[str, str], list[JointState]] = {}
    for state in plant.states:
        states.setdefault((state.type, state.robot), []).append(state)
    ranked: list[tuple[int, float, Proposal]] = []
    sizes = {kind: sum(robot.type == kind for robot in plant.robots) for kind in plant.types}
    for robot in plant.robots:
        urgency = _urgency(robot, states.get((robot.type, robot.robot), []), sizes[robot.type])
        if urgency is not None:
            stage, size, why = urgency
            ranked.append((stage, size, Proposal(robot.type, robot.robot, why)))
    ranked.sort(key=lambda item: (item[0], item[1], item[2].type, item[2].robot))
    return tuple(proposal for _, _, proposal in ranked[:MOST])


def _urgency(robot: FleetRobot, states: list[JointState], sisters: int) -> tuple[int, float, str] | None:
    if robot.state == UNKNOWN:
        return 0, 0.0, f"nothing usable was measured: {robot.last_failure}"
    ageing = [state for state in states if state.life.known and state.life.low < SOON]
    if ageing:
        first = min(ageing, key=lambda state: state.life.low)
        late = "open" if math.isinf(first.life.high) else f"{first.life.high:.0f}"
        text = f"{first.kind} of {plain_name(first.joint)} may reach its limit in {first.life.low:.0f} to {late} months"
        return 1, first.life.low, text
    if robot.state == CONSPICUOUS:
        return 2, -robot.score, f"conspicuous: {robot.reasons[0].text}; measure again to confirm it"
    if robot.last_failure:
        return 3, 0.0, f"the last recording could not be used: {robot.last_failure}"
    if sisters < LEAST and len(robot.dates) == ONE_DATE:
        stiffness = [state for state in states if state.kind == STIFFNESS]
        width = max((math.log(one.raw_high / one.raw_low) for one in stiffness if one.raw_low > 0), default=math.inf)
        return 4, -width, f"measured once, and too few robots of its type ({sisters}) to be compared with"
    return None
