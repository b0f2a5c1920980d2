"""The clock of messages against a steady one: what is a jump, and what is only a process that was held up."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from calibration_core.motion.clock_watch import ClockWatch, Lateness
from calibration_core.timeseries import NANOSECONDS

BEGAN = 5 * NANOSECONDS


def ns(seconds: float) -> int:
    return BEGAN + round(seconds * NANOSECONDS)


@pytest.mark.parametrize("back", [0.002, 0.5, 3.0])
def test_a_clock_that_goes_back(back: float) -> None:
    watch = ClockWatch(2.0)
    assert not watch.jumped(ns(10.0), 100.0)
    assert watch.jumped(ns(10.0 - back), 100.05)
    assert not watch.jumped(ns(10.05 - back), 100.1)  # it is said once


def test_a_clock_that_leaps() -> None:
    watch = ClockWatch(2.0)
    assert not watch.jumped(ns(0.0), 0.0)
    assert not watch.jumped(ns(1.9), 0.05)
    assert watch.jumped(ns(4.0), 0.1)
    assert not watch.jumped(ns(4.05), 0.15)


def test_a_clock_that_begins_to_run_is_no_jump() -> None:
    watch = ClockWatch(2.0)
    assert not watch.jumped(0, 0.0)
    assert not watch.jumped(ns(1e9), 0.05)


def test_a_process_that_was_held_up() -> None:
    """Twelve seconds without a look, and the first look still sees the time of before: the leap after it is none."""
    watch = ClockWatch(100.0)
    assert not watch.jumped(ns(8.0), 1.0)
    assert not watch.jumped(ns(8.0), 13.0)
    assert not watch.jumped(ns(8.0 + 12.05 * 20.0), 13.05)
    assert watch.jumped(ns(8.0 + 12.05 * 20.0 + 101.0), 13.1)


def test_a_process_that_was_held_up_after_it_had_read_the_clock() -> None:
    """The time that it had read is looked at twelve seconds later, as one that has just advanced."""
    watch = ClockWatch(100.0)
    assert not watch.jumped(ns(8.0), 1.0)
    assert not watch.jumped(ns(9.0), 1.05)
    assert not watch.jumped(ns(10.0), 13.05)
    assert not watch.jumped(ns(10.0 + 12.0 * 20.0), 13.1)
    assert watch.jumped(ns(10.0 + 12.0 * 20.0 + 101.0), 13.15)


def test_how_old_the_first_clock_is_nobody_knows() -> None:
    watch = ClockWatch(100.0)
    assert not watch.jumped(0, 0.0)
    assert not watch.jumped(ns(1.0), 9.0)
    assert not watch.jumped(ns(1.0 + 9.0 * 20.0), 9.05)
    assert watch.jumped(ns(1.0 + 9.0 * 20.0 + 101.0), 9.1)


@given(
    looks=st.lists(st.tuples(st.floats(1e-3, 20.0), st.floats(0.0, 1.0)), min_size=1, max_size=50),
    speed=st.floats(0.1, 20.0),
)
def test_a_steady_clock_never_jumps_however_old_it_is_read(looks: list[tuple[float, float]], speed: float) -> None:
    """What is looked at was taken at any moment since the look before."""
    watch, now, taken = ClockWatch(20.5), 1.0, 1.0
    assert not watch.jumped(ns(speed), now)
    for pause, share in looks:
        taken = max(taken, now + share * pause)
        now += pause
        assert not watch.jumped(ns(speed * taken), now)


# --- how late messages arrive ----------------------------------------------------------------------------------------


@given(offset=st.floats(-1e6, 1e6), delays=st.lists(st.floats(0.0, 0.05), min_size=2, max_size=200))
def test_no_message_is_called_later_than_it_is(offset: float, delays: list[float]) -> None:
    """Whatever the offset of the sender's clock, and however unsteady the delay."""
    watch = Lateness()
    for number, delay in enumerate(delays):
        late = watch.late(offset + 0.01 * number, 0.01 * number + delay)
        assert 0.0 <= late <= delay - min(delays[: number + 1]) + 1e-9


@pytest.mark.parametrize("drift", [-5e-4, 0.0, 5e-4])
@pytest.mark.parametrize("offset", [-3600.0, 0.0, 3600.0])
def test_a_drift_of_the_clocks_is_no_delay_and_a_delay_is_seen(offset: float, drift: float) -> None:
    """For an hour at 10 Hz all is well; then every message is 2 s late, at once or by 10 ms a second."""
    for growing in (1e9, 0.01):
        watch, late = Lateness(), 0.0
        for now in np.arange(0.0, 3600.0, 0.1):
            assert watch.late(offset + (1.0 + drift) * now - 5e-3, now) <= 1e-6
        for now in np.arange(3600.0, 3800.0, 0.1):
            delay = min(2.0, growing * (now - 3599.9))
            late = max(late, watch.late(offset + (1.0 + drift) * now - 5e-3 - delay, now))
        assert late == pytest.approx(2.0, abs=0.35)


def test_stamps_of_another_clock_are_learnt_anew() -> None:
    watch = Lateness()
    watch.late(10.0, 10.0)
    assert watch.late(8.5, 10.5) == pytest.approx(2.0, abs=1e-3)
    watch.forget()
    assert watch.late(9.0, 11.0) == 0.0
