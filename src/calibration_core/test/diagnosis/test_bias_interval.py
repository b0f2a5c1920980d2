"""The half width of an interval that holds the truth in 95 % although the value in its middle is biased."""

from __future__ import annotations

import math
import subprocess
import sys
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.stats import foldnorm, norm

from calibration_core.diagnosis.model_estimate import half_width

ROOT = Path(__file__).resolve().parents[4]
SLOW_TO_LOAD = ("scipy.stats", "scipy.optimize", "matplotlib")


@pytest.mark.parametrize("bias", [0.0, 1e-9, 0.1, 0.5, 1.0, 2.0, 30.0, 1e4])
def test_it_is_the_quantile_of_the_folded_normal_distribution(bias: float) -> None:
    assert half_width(bias) == pytest.approx(foldnorm.ppf(0.95, bias), rel=1e-12)


@given(st.floats(0.0, 1e200))
def test_it_is_found_for_every_bias_and_lies_between_one_side_and_two(bias: float) -> None:
    beyond = half_width(bias) - bias
    rounding = 1e-12 + 4 * math.ulp(bias)
    assert norm.ppf(0.95) - rounding <= beyond <= norm.ppf(0.975) + rounding or bias > 1e15


def test_a_diagnosis_loads_nothing_slow_that_it_does_not_need(tmp_path: Path) -> None:
    """Half a second and 40 MB of a command that takes two seconds."""
    bag = ["diagnose", str(ROOT / "bags" / "small_loaded"), "--no-report", "--out", str(tmp_path / "out")]
    cell = ["--cell", str(ROOT / "config" / "cells" / "small.cell.yaml")]
    program = (
        "import sys\nfrom calibration_core.cli import main\n"
        f"assert main({[*bag, *cell]!r}) == 0\n"
        f"loaded = [name for name in {SLOW_TO_LOAD!r} if name in sys.modules]\nassert loaded == [], loaded"
    )
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
