"""Real recordings of one robot in several set-ups, evaluated together: what is named on one holds on all of them.

The data lies outside the repository (`../shared/data/real` from the project's root): series A, B and C of one UR10, the
tracker in two places and the target mounted anew.
"""

from __future__ import annotations

import functools
from pathlib import Path

import numpy as np
import pytest

from calibration_core.cell import load_cell
from calibration_core.diagnosis.diagnose import diagnose
from calibration_core.diagnosis.result.finding import Diagnosis
from calibration_core.identification.several.merge import members_of
from calibration_core.identification.stiffness.loaded import Options
from calibration_core.outcomes.together.diagnose import diagnose_together
from calibration_core.outcomes.together.prepare import Prepared, prepare
from calibration_core.recording.tables.table import read_table

REAL = Path(__file__).resolve().parents[2] / "shared" / "data" / "real"
SERIES = ("A", "B", "C")

pytestmark = [pytest.mark.slow, pytest.mark.skipif(not REAL.is_dir(), reason=f"no real recordings at {REAL}")]


@functools.cache
def _prepared() -> Prepared:
    cells = [load_cell(REAL / f"ur10_{series}.cell.yaml") for series in SERIES]
    recordings = [read_table(REAL / f"ur10_{series}.csv", cell) for series, cell in zip(SERIES, cells, strict=True)]
    members = members_of(recordings, cells)
    order = [next(k for k, one in enumerate(members) if one.readings is readings) for readings in recordings]
    return prepare(members, order, Options())


@functools.cache
def _together() -> Diagnosis:
    return diagnose_together(_prepared())


def test_what_is_named_on_one_series_is_named_on_all_together() -> None:
    first = _prepared().members[_prepared().first]
    alone = diagnose(first.readings, first.cell).findings[0]
    found = _together().findings[0]
    assert (found.effect, dict(found.location)) == (alone.effect, dict(alone.location))
    assert found.held_out_gain > 0.6


def test_what_is_found_holds_on_every_series() -> None:
    found, recording = _together(), _prepared().merged.readings.recording
    assert found.residual_before is not None
    for number in range(len(SERIES)):
        own = recording == number
        before, after = (float(np.sqrt(np.mean(r[own] ** 2))) for r in (found.residual_before, found.residual))
        assert after < 0.6 * before


def test_the_report_says_what_each_series_contributes() -> None:
    together = _together().identification.together
    assert together is not None
    assert [Path(one.file).stem for one in together.contributions] == [f"ur10_{series}" for series in SERIES]
    assert [one.readings for one in together.contributions] == [11911, 1495, 2773]
    assert together.compared
