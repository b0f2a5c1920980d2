"""The CSV tables hold what the standard's templates ask for."""

from __future__ import annotations

import csv
import dataclasses
import io

import numpy as np
import pytest

from calibration_core.cell import Cell
from calibration_core.identification.result.estimate import Identification
from calibration_core.report.writing.tables import (
    predictions_csv,
    residuals_csv,
    table1_csv,
    table2_csv,
    table_files,
)


def rows(content: bytes) -> list[dict[str, str]]:
    return list(csv.DictReader(io.StringIO(content.decode())))


def test_table_1_is_in_degrees(loaded: Identification) -> None:
    table = rows(table1_csv(loaded.space.configuration, loaded.space.q))
    assert list(table[0]) == ["No", *(f"theta_{i}" for i in range(1, 7))]
    assert [int(row["No"]) for row in table] == list(range(1, 19))
    q = np.array([[float(row[f"theta_{i}"]) for i in range(1, 7)] for row in table])
    np.testing.assert_allclose(np.radians(q), loaded.space.q, atol=1e-8)


def test_table_2_is_in_the_standards_unit(loaded: Identification) -> None:
    table = rows(table2_csv(loaded.stiffness))
    values = [float(row["stiffness_1e5_Nm_per_rad"]) for row in table]
    np.testing.assert_allclose(values, [joint.value / 1e5 for joint in loaded.stiffness], rtol=1e-5)
    assert {row["identifiable"] for row in table} == {"yes"}


def test_table_2_leaves_cells_empty_that_have_no_value(hostile: tuple[Identification, Cell]) -> None:
    last = rows(table2_csv(hostile[0].stiffness))[5]
    assert last["stiffness_1e5_Nm_per_rad"] == ""
    assert last["interval_95_high_1e5_Nm_per_rad"] == ""
    assert last["identifiable"] == "no"
    assert last["joint"] == hostile[0].stiffness[5].joint


def test_predictions_have_the_contracts_columns(loaded: Identification) -> None:
    predicted = np.asarray(loaded.readings.position) + 1e-5
    table = rows(predictions_csv(loaded.readings, predicted))
    assert list(table[0]) == ["configuration", "step", "point", "x", "y", "z", "px", "py", "pz"]
    assert len(table) == len(loaded.readings)
    assert float(table[7]["px"]) == predicted[7, 0]
    assert table[7]["point"] == "mp2"


def test_residuals_add_up(loaded: Identification) -> None:
    table = rows(residuals_csv(loaded))
    for row in table[::37]:
        difference = float(row["measured_y"]) - float(row["predicted_y"])
        assert difference == pytest.approx(float(row["residual_y"]), abs=1e-11)
    assert [row["excluded"] for row in table].count("yes") == len(loaded.exclusions)


def test_what_is_not_finite_is_empty(loaded: Identification) -> None:
    held_out = np.full_like(loaded.residuals.held_out, np.nan)

    answer = dataclasses.replace(loaded, residuals=dataclasses.replace(loaded.residuals, held_out=held_out))
    assert {row["held_out_x"] for row in rows(residuals_csv(answer))} == {""}


def test_files_of_an_absolute_recording(absolute: Identification) -> None:
    files = table_files(absolute)
    assert set(files) == {"table1.csv", "table2.csv", "residuals.csv"}
    assert rows(files["table2.csv"]) == []
    assert len(rows(files["table1.csv"])) == 216
