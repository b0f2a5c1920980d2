"""Errors say where, what and what else, in one line."""

from __future__ import annotations

import math
import pickle
from pathlib import Path

import pytest
from hypothesis import assume, given
from hypothesis import strategies as st

from calibration_core import errors
from calibration_core.errors import (
    CalibrationError,
    EquilibriumError,
    InputError,
    RecordingError,
    apart,
    beyond,
    quoted,
    rounded_down,
    rounded_up,
)


def test_text_of_an_input_error() -> None:
    error = RecordingError(Path("a.csv"), "line 3", "'x'", "a number")
    assert str(error) == "a.csv: line 3: found 'x', expected a number"
    assert str(RecordingError("a.csv", "", "nothing", "rows")) == "a.csv: found nothing, expected rows"


def test_newlines_are_folded() -> None:
    assert len(str(InputError("f", "a\nb", "c\r\nd", "e\n\n f")).splitlines()) == 1


def test_input_errors_survive_pickling() -> None:
    error = RecordingError("a.csv", "line 3", "'x'", "a number")
    copy = pickle.loads(pickle.dumps(error))
    assert type(copy) is RecordingError
    assert (copy.file, copy.place, copy.found, copy.expected) == ("a.csv", "line 3", "'x'", "a number")
    assert str(copy) == str(error)


def test_one_root() -> None:
    leaves = [one for one in vars(errors).values() if isinstance(one, type) and issubclass(one, Exception)]
    assert len(leaves) >= 8
    assert all(issubclass(one, CalibrationError) for one in leaves)


def test_equilibrium_error() -> None:
    error = EquilibriumError(0.01, 50)
    assert "50 iterations" in str(error)
    assert (error.residual, error.iterations) == (0.01, 50)


@pytest.mark.parametrize(("value", "text"), [("a", "'a'"), (3.5, "3.5"), ("x" * 100, "'" + "x" * 58 + "…")])
def test_quoted(value: object, text: str) -> None:
    assert quoted(value) == text
    assert len(quoted(value)) <= 60


@given(st.floats(1e-12, 1e12), st.integers(1, 6))
def test_a_stated_limit_is_never_looser_than_the_limit(limit: float, digits: int) -> None:
    least, most = rounded_up(limit, digits), rounded_down(limit, digits)
    assert most <= limit <= least
    assert least - most <= 1.001 * limit * 10.0 ** (1 - digits)
    assert (rounded_up(-limit, digits), rounded_down(-limit, digits)) == (-most, -least)
    assert float(f"{least:.{digits}g}") == least


@given(st.floats(1e-9, 1e9), st.floats(1e-12, 1.0), st.booleans())
def test_what_is_beyond_a_limit_is_shown_so(limit: float, share: float, above: bool) -> None:
    value = limit * (1 + share) if above else limit / (1 + share)
    assume(abs(value - limit) > 1e-12)
    assert (float(beyond(value, limit)) > limit) == above
    assert float(beyond(value, limit)) != limit
    assert abs(float(apart(value, limit, 0.0)[0]) - float(apart(value, limit, 0.0)[1])) > 0


def test_limits_and_what_is_beyond_them() -> None:
    assert [rounded_up(x) for x in (1.0203e-4, 1.02e-4, 0.0, 999.5)] == [1.03e-4, 1.02e-4, 0.0, 1000.0]
    assert [rounded_down(x) for x in (1.0203e-4, math.pi / 2, 2353.6)] == [1.02e-4, 1.57, 2350.0]
    assert [beyond(x, 250.0, 1) for x in (250.7, 250.04, 250.0004)] == ["250.7", "250.04", "250.0004"]
    assert beyond(250.0, 250.0) == "250"
    assert apart(0.300501, 0.3, 5e-4, 5) == ("0.300501", "0.300000")
    assert apart(math.nan, 0.3, 5e-4, 5) == ("nan", "0.30000")
