"""How many readings are set aside is said alike everywhere: anomaly, list, table of residuals and terminal."""

from __future__ import annotations

import csv
import dataclasses
import json
import re
from pathlib import Path

import pytest
from several_cases import measured, setup

from calibration_core.cli import main
from calibration_core.diagnosis.diagnose import diagnose
from calibration_core.identification.checks.noise_audit import OUTLIERS, outlier_text, with_own_outliers
from calibration_core.identification.result.estimate import Anomaly
from calibration_core.report.diagnosis_summary import diagnosis_summary
from calibration_core.report.document import Table
from calibration_core.report.sections.diagnosis import gain_blocks

ROOT = Path(__file__).resolve().parents[4]
REAL = next((found for one in ROOT.parents if (found := one / "shared/data/real").is_dir()), ROOT / "none")


def anomaly(kind: str, text: str = "") -> Anomaly:
    return Anomaly(kind, {}, None, 0.0, "m", text)


@pytest.mark.parametrize(("count", "said"), [
    (1, "1 reading does not fit the others (configuration/step/point 1/0/mp1), by up to 0.50 mm; it is not used."),
    (2, ("2 readings do not fit the others (configuration/step/point 1/0/mp1, 2/0/mp1), by up to 0.50 mm; "
         "they are not used.")),
])  # fmt: skip
def test_numbers_and_verbs_agree(count: int, said: str) -> None:
    assert outlier_text([(k, 0, "mp1") for k in range(1, count + 1)], 5e-4, "the others") == said


def test_a_long_list_is_cut_and_counted() -> None:
    text = outlier_text([(k, 0, "mp1") for k in range(1, 16)], 5e-4, "the others")
    assert text.startswith("15 readings do not fit")
    assert "12/0/mp1 and 3 more" in text


def test_an_identification_names_its_own_outliers_where_the_search_has_some() -> None:
    searched = (anomaly("target_moved"), anomaly(OUTLIERS, "search"), anomaly("unsettled"))
    own = (anomaly("noise_understated"), anomaly(OUTLIERS, "own"))
    kinds = ["target_moved", OUTLIERS, "unsettled"]
    assert [one.kind for one in with_own_outliers(searched, own)] == kinds
    assert [one.text for one in with_own_outliers(searched, own)] == ["", "own", ""]
    assert with_own_outliers(searched, ()) == searched
    assert with_own_outliers(searched[:1], own) == searched[:1]


def test_a_diagnosis_states_what_the_readings_leave_that_were_not_set_aside(tmp_path: Path) -> None:
    """One reading is wrong by 20 mm: what all leave is far more than the noise with which the rest agrees."""
    cell = setup(tmp_path, 0)
    readings = measured(cell, 0, 7, configurations=8, rest=14)
    wrong = readings.position.copy()
    wrong[40] += [0.02, 0.0, 0.0]
    found = diagnose(dataclasses.replace(readings, position=wrong), cell)
    sigma = cell.instruments.tracker.sigma
    assert not found.rest.significant
    assert found.rms_after > 10 * sigma
    assert found.rms_used is not None
    assert found.rms_used < 1.2 * sigma
    said = f"{1e6 * found.rms_used:.1f} µm without the readings set aside"
    assert said in diagnosis_summary(found)
    (table,) = (block for block in gain_blocks(found) if isinstance(block, Table))
    assert [row[0] for row in table.rows][:2] == ["All readings", "Without the readings set aside"]
    assert diagnose(readings, cell).rms_used is None


@pytest.mark.skipif(not REAL.is_dir(), reason=f"no real recordings at {REAL}")
@pytest.mark.parametrize(("name", "count"), [("fanuc", 2), pytest.param("motoman", 1, marks=pytest.mark.slow)])
def test_all_that_identify_says_counts_the_same(
    name: str, count: int, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """The joint springs alone and the extended model set different readings of these recordings aside."""
    files = [str(REAL / f"{name}.csv"), "--cell", str(REAL / f"{name}.cell.yaml")]
    assert main(["identify", *files, "--out", str(tmp_path / "out"), "--no-report"]) == 0
    said = capsys.readouterr().out
    content = json.loads((tmp_path / "out" / "result.json").read_text("utf-8"))
    (outliers,) = (one for one in content["anomalies"] if one["kind"] == OUTLIERS)
    assert len(content["exclusions"]) == count
    assert re.match(rf"{count} reading(s do| does) not fit", outliers["text"])
    assert f"outlier readings: {outliers['text'].rstrip('.')}" in said
    assert len(re.findall(r"^excluded: ", said, re.MULTILINE)) == count
    with (tmp_path / "out" / "residuals.csv").open() as file:
        assert sum(row["excluded"] == "yes" for row in csv.DictReader(file)) == count
