"""Numbers are rounded by their uncertainty and stand on their decimal points."""

from __future__ import annotations

import math

import numpy as np
import pytest

from calibration_core.diagnosis.comparison.result import ChangedNumber, WaterfallStep
from calibration_core.report.rounding import (
    DASH,
    MICROMETRE,
    MILLIMETRE,
    aligned,
    counted,
    decimals,
    fixed,
    interval_end,
    length_unit,
    listed,
    padded,
    readable_unit,
    rms,
    shortened,
    significant,
    spread,
)
from calibration_core.report.sections.diagnosis import changed_numbers


@pytest.mark.parametrize(
    ("uncertainty", "places"),
    [
        (0.11, 2),
        (0.088, 3),
        (0.0996, 2),
        (1.0, 1),
        (9.96, 0),
        (12.0, 0),
        (250.0, -1),
        (0.0, 3),
        (math.inf, 3),
        (math.nan, 3),
    ],
)
def test_two_significant_digits_of_the_uncertainty_remain(uncertainty: float, places: int) -> None:
    assert decimals(uncertainty) == places


def test_rounding_error_stays_below_a_twentieth_of_the_uncertainty() -> None:
    rng = np.random.default_rng(1)
    for value, std in zip(rng.normal(size=200), 10 ** rng.uniform(-6, 3, 200), strict=True):
        printed = float(fixed(value, decimals(std)).replace("−", "-"))
        assert abs(printed - value) <= 0.0501 * std


@pytest.mark.parametrize(
    ("value", "places", "text"),
    [
        (14.1, 2, "14.10"),
        (-0.5, 1, "−0.5"),
        (-0.001, 1, "0.0"),
        (1234.0, -2, "1200"),
        (math.nan, 2, DASH),
        (math.inf, 2, DASH),
    ],
)
def test_fixed(value: float, places: int, text: str) -> None:
    assert fixed(value, places) == text


@pytest.mark.parametrize(
    ("value", "text"),
    [(3.14159, "3.1"), (0.00123, "0.0012"), (99.7, "100"), (1234.4, "1234"), (0.0, "0"), (99.4, "99")],
)
def test_spread_keeps_two_digits_below_a_hundred(value: float, text: str) -> None:
    assert spread(value) == text


def test_significant_never_uses_exponents() -> None:
    assert significant(1.234e7, 3) == "12300000"
    assert significant(4.2e-7, 2) == "0.00000042"


def test_aligned_cells_have_their_points_at_the_same_distance_from_the_end() -> None:
    cells = aligned(["14.10", "4.200", "7", DASH, "−0.5"])
    numbers = [cell for cell in cells if cell != DASH]
    ends = {len(cell) - max(cell.find("."), cell.find("\u2008")) for cell in numbers}
    assert len(ends) == 1
    assert [cell.strip("\u2007\u2008") for cell in cells] == ["14.10", "4.200", "7", DASH, "−0.5"]


def test_padded_leaves_the_first_column_and_texts_alone() -> None:
    rows = padded([("5.1", "0.25", "a"), ("6.22", "3.5", "b")])
    assert [row[0] for row in rows] == ["5.1", "6.22"]
    assert [row[1] for row in rows] == ["0.25", "3.5\u2007"]
    assert [row[2] for row in rows] == ["a", "b"]


def test_lengths_are_read_in_micrometres_until_half_a_millimetre() -> None:
    assert length_unit(2e-5) is MICROMETRE
    assert length_unit(1.7e-3) is MILLIMETRE
    assert length_unit(math.nan) is MICROMETRE


def test_words() -> None:
    assert counted(1, "reading") == "1 reading"
    assert counted(11911, "reading") == "11,911 readings"
    assert listed(["a", "b", "c"]) == "a, b and c"
    assert listed([]) == ""
    assert listed([str(i) for i in range(9)]) == "0, 1, 2, 3, 4, 5 and 3 more"
    assert shortened("x" * 50) == "x" * 39 + "…"


def test_rms_ignores_what_is_not_finite() -> None:
    assert rms(np.array([3.0, 4.0, np.nan])) == pytest.approx(math.sqrt(12.5))
    assert math.isnan(rms(np.array([])))


@pytest.mark.parametrize(
    ("value", "places", "text"),
    [
        (13.88, 2, "13.88"),
        (28.4, -2, "28"),
        (7.18, -2, "7.2"),
        (1930.0, -2, "1900"),
        (0.0, -2, "0"),
        (0.004, 1, "0.0040"),
    ],
)
def test_the_end_of_an_interval_is_never_rounded_to_nothing(value: float, places: int, text: str) -> None:
    assert interval_end(value, places) == text


def test_small_quantities_are_read_in_units_of_their_size() -> None:
    assert (readable_unit("rad").factor, readable_unit("rad").name) == (1e6, "µrad")
    assert readable_unit("rad/year").name == "µrad/year"
    assert readable_unit("rad/(N*m)").name == "10⁻⁹ rad/(N·m)"
    assert (readable_unit("N*m").factor, readable_unit("N*m").name) == (1.0, "N·m")


def test_a_number_that_changes_by_little_of_itself_is_shown_with_the_change() -> None:
    number = ChangedNumber("tracker.z", 1.2, 1.2000251, 1.2000039, 1.2000464, "m")
    step = WaterfallStep("frames", "tracker z", 1e-4, 1e-4, math.nan, 0.1, (number,))
    assert changed_numbers([step]).rows == (("tracker.z", "1.200000", "1.200025", "1.200004", "1.200046", "m"),)
