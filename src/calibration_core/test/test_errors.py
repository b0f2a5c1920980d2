"""Errors say where, what and what else, in one line."""

from __future__ import annotations

import pickle
from pathlib import Path

import pytest

from calibration_core import errors
from calibration_core.errors import CalibrationError, EquilibriumError, InputError, RecordingError, quoted


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
