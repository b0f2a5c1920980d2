"""Accepted hypotheses of positions, and which of them are one cause, in whatever order they were accepted."""

from __future__ import annotations

import itertools

import numpy as np
import pytest

from calibration_core.diagnosis.findings.positions import causes
from calibration_core.estimation.hypotheses import ALL, Hypothesis

JOINT, OTHER = {"joint": "joint_6"}, {"joint": "joint_2"}


def _one(effect: str, family: str, location: dict[str, str], variant: str = "", shape: object = None) -> Hypothesis:
    return Hypothesis(effect, family, location, variant, (0,), np.zeros(1, dtype=np.int64), shape=shape)


HYSTERESIS = _one("hysteresis", "joint law", JOINT, "virgin start")
ARRIVAL = _one("approach_direction", "absolute", JOINT, "sign")
HIGH, LOW = (_one("transmission_error", "absolute", JOINT, f"order {k}", k) for k in (22, 6))
BAND = _one("transmission_error", "absolute", {"joints": ALL}, "orders 1 to 32")
SPRING = _one("gravity_compensator", "structure", OTHER, "torque")
VARYING = _one("pose_dependent_stiffness", "structure", OTHER, "one turn")
GEAR = _one("transmission_error", "absolute", OTHER, "order 2", 2)


@pytest.mark.parametrize(
    ("accepted", "joined"),
    [
        pytest.param({HYSTERESIS: 80.0, ARRIVAL: 140.0, HIGH: 100.0, LOW: 30.0}, 1, id="all that friction leaves"),
        pytest.param({HYSTERESIS: 80.0, LOW: 70.0}, 2, id="a gear as loud as the friction beside it"),
        pytest.param({ARRIVAL: 220.0, HIGH: 18.0}, 1, id="friction of arrival, and what scatters by posture"),
        pytest.param({ARRIVAL: 220.0, HIGH: 90.0}, 2, id="a high wave too loud to be what arrival leaves"),
        pytest.param({ARRIVAL: 220.0, LOW: 18.0}, 2, id="a gear of low order beside a direction of arrival"),
        pytest.param({ARRIVAL: 220.0, BAND: 18.0}, 2, id="every gear, which is no single joint's"),
        pytest.param({SPRING: 900.0, VARYING: 60.0, GEAR: 40.0}, 1, id="what a spring of another shape leaves"),
        pytest.param({SPRING: 900.0, VARYING: 600.0}, 2, id="a soft joint beside a spring"),
        pytest.param({SPRING: 900.0, LOW: 40.0}, 2, id="another joint's gear"),
    ],
)
def test_what_a_law_leaves_is_part_of_it(accepted: dict[Hypothesis, float], joined: int) -> None:
    hypotheses = list(accepted)
    gained = dict(enumerate(accepted.values()))
    for order in itertools.permutations(gained):
        found = causes(hypotheses, {i: gained[i] for i in order})
        assert len(found) == joined
        assert sorted(itertools.chain(*found)) == sorted(gained)
