"""Where a spring beside a joint is asked about: several effects of the joint explain what it could explain alone."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest

from calibration_core.estimation.blocks import Blocks
from calibration_core.estimation.estimate import spring_in_question
from calibration_core.estimation.field import Field, Trial
from calibration_core.estimation.hypotheses import offer
from calibration_core.estimation.search import Search
from calibration_core.model.effects.candidate import Candidate, Parameter
from calibration_core.model.effects.state import State
from calibration_core.timeseries import Float3D

READINGS, BLOCKS = 120, 10
WAVE, SOFT, LAW, SPRING, ELSEWHERE = range(5)
OFFERED = (
    ("transmission_error", "absolute", "joint_2", "order 1"),
    ("pose_dependent_stiffness", "structure", "joint_2", "one turn"),
    ("soft_zone", "joint law", "joint_2", "below 30 %"),
    ("gravity_compensator", "structure", "joint_2", "torque"),
    ("transmission_error", "absolute", "joint_3", "order 1"),
)


def _nothing(state: State) -> Float3D:
    return np.zeros((state.m, 3, 0))


def _search(share: float, control: Callable[[Trial], str] = lambda _: "") -> Search:
    """Return a search in which a spring of size 2 is what two effects imitate; share: of it that the spring has."""
    rng = np.random.default_rng(4)
    columns = rng.standard_normal((3 * READINGS, len(OFFERED)))
    both = columns[:, WAVE] + 0.6 * columns[:, SOFT]
    truth = 2.0 * both + 0.8 * columns[:, ELSEWHERE] + rng.standard_normal(3 * READINGS)
    columns[:, SPRING] = share * both + np.sqrt(1 - share**2) * columns[:, SPRING]
    candidates = [
        Candidate(effect, family, {"joint": joint}, variant, (Parameter("size", "1", 0.5),), _nothing, shape=1)
        for effect, family, joint, variant in OFFERED
    ]
    partitions = tuple(Blocks(kind, np.arange(READINGS) * BLOCKS // READINGS) for kind in ("time", "posture"))
    flat, usual = rng.standard_normal((3 * READINGS, 3)), np.zeros((3 * READINGS, 0))
    return Search(Field.of(truth, flat, usual, [columns], offer(candidates), partitions), control)


def test_the_spring_is_returned_with_its_size() -> None:
    search = _search(1.0)
    ((candidate, value),) = spring_in_question(search, search.result((WAVE, SOFT, ELSEWHERE)))
    assert candidate.effect == "gravity_compensator"
    assert value == pytest.approx([2.0 * 0.5], rel=0.05)  # of columns per typical size


@pytest.mark.parametrize(
    ("accepted", "share", "why"),
    [
        ((WAVE, ELSEWHERE), 1.0, "one effect of the joint"),
        ((LAW, ELSEWHERE), 1.0, "nothing that a spring resembles"),
        ((WAVE, SOFT, SPRING), 1.0, "the spring is found already"),
        ((WAVE, SOFT, ELSEWHERE), 0.5, "a spring that explains half of it"),
        ((), 1.0, "nothing found"),
    ],
)
def test_nothing_is_asked_otherwise(accepted: tuple[int, ...], share: float, why: str) -> None:
    search = _search(share)
    assert spring_in_question(search, search.result(accepted)) == (), why


def test_a_spring_that_physics_forbids_is_not_asked_about() -> None:
    search = _search(1.0, lambda trial: "no" if trial.hypothesis.effect == "gravity_compensator" else "")
    assert spring_in_question(search, search.result((WAVE, SOFT, ELSEWHERE))) == ()
