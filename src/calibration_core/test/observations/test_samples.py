"""Checks of samples as they arrive: each problem alone, and gaps counted exactly."""

from __future__ import annotations

import numpy as np
import pytest

from calibration_core.observations.samples import Limits, Problem, StreamCheck

MS = 1_000_000
START = 1_700_000_000_000_000_000


def values(rng: np.random.Generator, n: int, noise: float = 1e-5) -> np.ndarray:
    return np.array([1.0, 2.0, 3.0]) + noise * rng.standard_normal((n, 3))


def test_clean_samples_pass() -> None:
    check = StreamCheck(Limits("tracker", largest=(80.0,), fastest=(1.0,), frozen=5))
    for k, one in enumerate(values(np.random.default_rng(1), 200)):
        assert check.add(START + 10 * MS * k, one, "tracker") is Problem.FINE
    assert (check.counts.received, check.counts.accepted, check.counts.gaps) == (200, 200, 0)
    assert check.interval == pytest.approx(0.01)


@pytest.mark.parametrize("interval", [0.0, 0.01])
@pytest.mark.parametrize("first", [0, 1])
def test_gaps_are_counted_exactly(interval: float, first: int) -> None:
    rng = np.random.default_rng(2)
    kept = np.ones(5000, bool)
    begins = np.sort(rng.choice(np.arange(50, 4900, 20), 40, replace=False))
    lengths = rng.integers(1, 15, 40)
    for begin, length in zip(begins, lengths, strict=True):
        kept[begin : begin + length] = False
    if first:  # while the usual interval is still being learnt
        kept[3:5] = False
    check = StreamCheck(Limits(interval=interval))
    for k in np.flatnonzero(kept):
        check.add(START + 10 * MS * int(k) + int(rng.integers(0, MS)), np.array([rng.normal(), 0.0, 0.0]))
    assert check.counts.gaps == 40 + first
    assert check.counts.missing == int(lengths.sum()) + 2 * first
    assert check.counts.accepted == int(kept.sum())


def test_gap_before_is_told_with_the_sample() -> None:
    check = StreamCheck(Limits(interval=0.01))
    told = []
    for k in (0, 1, 2, 5, 6, 13):
        check.add(START + 10 * MS * k, np.array([0.1 * k, 0.0, 0.0]))
        told.append((check.gap_before, check.break_before))
    no, gap, pause = (False, False), (True, False), (True, True)
    assert told == [no, no, no, gap, no, pause]


@pytest.mark.parametrize(
    ("sample", "frame", "rotation", "problem"),
    [
        ([np.nan, 2.0, 3.0], "tracker", None, Problem.NOT_FINITE),
        ([np.inf, 2.0, 3.0], "tracker", None, Problem.NOT_FINITE),
        ([1.0, 2.0, 3.0], "base", None, Problem.WRONG_FRAME),
        ([1000.0, 2000.0, 3000.0], "tracker", None, Problem.IMPLAUSIBLE),
        ([1.0, 2.0, 3.1], "tracker", None, Problem.JUMP),
        ([1.0, 2.0, 3.00001], "tracker", [0.0, 0.0, 0.0, 0.0], Problem.IMPLAUSIBLE),
        ([1.0, 2.0, 3.00001], "tracker", [0.0, 0.0, np.nan, 1.0], Problem.NOT_FINITE),
        ([1.0, 2.0, 3.00001], "tracker", [0.0, 0.6, 0.0, 0.8], Problem.FINE),
    ],
)
def test_each_problem_and_recovery(
    sample: list[float], frame: str, rotation: list[float] | None, problem: Problem
) -> None:
    check = StreamCheck(Limits("tracker", largest=(80.0,), fastest=(1.0,), frozen=3))
    check.add(START, np.array([1.0, 2.0, 3.0]), "tracker")
    turned = None if rotation is None else np.array(rotation)
    assert check.add(START + 10 * MS, np.array(sample), frame, turned) is problem
    assert check.counts.rejected == ({problem: 1} if problem else {})
    assert check.add(START + 20 * MS, np.array([1.0, 2.0, 3.00002]), "tracker") is Problem.FINE
    assert check.problem is Problem.FINE


def test_a_frozen_stream_is_rejected_until_it_moves() -> None:
    check = StreamCheck(Limits(frozen=3))
    same = np.array([1.0, 2.0, 3.0])
    found = [check.add(START + MS * k, same) for k in range(6)]
    assert found == [Problem.FINE] * 2 + [Problem.FROZEN] * 4
    assert check.add(START + 7 * MS, same + 1e-9) is Problem.FINE


@pytest.mark.parametrize("step", [0, -5])
def test_stamps_must_increase(step: int) -> None:
    check = StreamCheck(Limits(interval=0.01))
    check.add(START, np.zeros(3))
    assert check.add(START + step * MS, np.ones(3)) is Problem.OUT_OF_ORDER
    assert check.add(START + 10 * MS, np.ones(3)) is Problem.FINE
    assert check.counts.gaps == 0


def test_a_clock_that_goes_back_begins_anew() -> None:
    check = StreamCheck(Limits(interval=0.01, fastest=(1.0,)))
    for k in range(20):
        check.add(START + 10 * MS * k, np.full(3, 1e-3 * k))
    back = [check.add(START - 60_000 * MS + 10 * MS * k, np.full(3, 5.0)) for k in range(6)]
    assert back == [Problem.OUT_OF_ORDER] * 2 + [Problem.FINE] * 4
    assert (check.counts.gaps, check.counts.missing) == (0, 0)


def test_stragglers_do_not_set_the_clock_back() -> None:
    check = StreamCheck(Limits(interval=0.01))
    found = []
    for k in range(10):
        assert check.add(START + 10 * MS * k, np.full(3, float(k))) is Problem.FINE
        found += [check.add(START - 60_000 * MS + 10 * MS * (2 * k + m), np.zeros(3)) for m in range(2)]
    found += [check.add(START - 60_000 * MS, np.zeros(3)) for _ in range(5)]
    assert set(found) == {Problem.OUT_OF_ORDER}
    assert check.counts.gaps == 0


def test_torque_has_its_own_limit() -> None:
    check = StreamCheck(Limits(largest=(1000.0, 100.0)))
    assert check.add(START, np.array([900.0, 0, 0, 90.0, 0, 0])) is Problem.FINE
    assert check.add(START + MS, np.array([0, 0, 0, 0, 0, 101.0])) is Problem.IMPLAUSIBLE


@pytest.mark.parametrize("wrong", [{"frozen": 1}, {"gap": 1.0}, {"interval": -1.0}, {"largest": (np.nan,)}])
def test_limits_without_sense(wrong: dict[str, object]) -> None:
    with pytest.raises(ValueError, match="limits"):
        Limits(**wrong)  # type: ignore[arg-type]
