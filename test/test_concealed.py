"""Sixty recordings with concealed effects, of a seed of their own, diagnosed by a process that sees them alone.

The whole proof is `make prove`; this is its small sister.  Sixty recordings tell shares to some ten percent, so that
it is counted how many are wrong.
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from typing import Any

import pytest

from calibration_sim.proving.cli import main

SEED, COUNT = 7077, 60  # neither a seed of development nor one that is published

Table = Mapping[str, Mapping[str, Any]]


@pytest.fixture(scope="module")
def table(tmp_path_factory: pytest.TempPathFactory) -> Table:
    out = tmp_path_factory.mktemp("concealed")
    code = main(["--seed", str(SEED), "--count", str(COUNT), "--out", str(out), "--jobs", "1", "--batch"])
    assert code == 0
    rows = json.loads((out / "table.json").read_text())["measures"]
    return {row["text"]: row for row in rows}


def test_every_recording_is_diagnosed(table: Table) -> None:
    assert table["diagnoses that failed"]["value"] == 0.0


def _wrong(row: Mapping[str, Any], *, bad: bool) -> int:
    """Return how many of a row's recordings are wrong: those that show something bad, or lack something good."""
    share = row["value"] if bad else 1.0 - row["value"]
    return round(share * row["count"])


def test_nothing_is_found_where_nothing_is_missing(table: Table) -> None:
    row = table["nothing missing: a finding"]
    assert row["count"] >= 6
    assert _wrong(row, bad=True) == 0


def test_what_is_found_is_named_and_placed(table: Table) -> None:
    assert table["effect right, given something found, typical"]["count"] >= 5
    assert _wrong(table["effect right, given something found, typical"], bad=False) == 0
    assert _wrong(table["place right, given the effect is right, typical"], bad=False) == 0


def test_several_effects_are_found_together(table: Table) -> None:
    assert table["pairs: both found"]["count"] >= 6
    assert _wrong(table["pairs: both found"], bad=False) <= 1
    assert _wrong(table["triples: effects found"], bad=False) <= 2


def test_no_effect_is_found_besides(table: Table) -> None:
    """Beside single effects, pairs and triples, at most one false finding in some forty recordings."""
    rows = ("a false second finding beside a single effect", "pairs: a false third", "triples: a false fourth")
    assert sum(table[text]["count"] for text in rows) >= 35
    assert sum(_wrong(table[text], bad=True) for text in rows) <= 1


def test_what_no_catalogue_holds_is_flagged(table: Table) -> None:
    assert table["outside: flagged, nothing wrongly named"]["count"] >= 5
    assert _wrong(table["outside: flagged, nothing wrongly named"], bad=False) <= 1


def test_aliases_are_said_and_anomalies_found(table: Table) -> None:
    assert _wrong(table["aliases: confounded, reported as such"], bad=False) == 0
    assert _wrong(table["anomalies: found, located, no physics claimed"], bad=False) == 0


def test_a_recording_takes_seconds(table: Table) -> None:
    """Processor time, for other tests keep the machine busy; the diagnosis uses one core at a time."""
    assert table["processor s per recording (18 x 9 x 3), 95 %"]["value"] <= 10.0
    assert table["MB per recording, largest"]["value"] <= 500.0
