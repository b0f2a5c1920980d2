"""Typical magnitudes, by robot size, from the table `priors.yaml` beside the catalogue (config/priors.yaml).

Each entry has a value for a 10 kg and for a 240 kg robot, with its source; between and beyond, the logarithm is linear
in the logarithm of the rated load, held at the ends.
"""

from __future__ import annotations

import functools
from pathlib import Path
from typing import Any

import numpy as np

from calibration_core.files.yaml_file import read_yaml

SMALL, LARGE = 10.0, 240.0  # kg
MAX_BYTES = 1 << 20
FILE = Path(__file__).with_name("priors.yaml")


@functools.cache
def typical(name: str, rated_load: float) -> float:
    """Return the typical magnitude of a parameter for a robot of this rated load (kg)."""
    entry = _table()[name]
    share = np.clip(np.log(rated_load / SMALL) / np.log(LARGE / SMALL), 0.0, 1.0)
    return float(np.exp((1 - share) * np.log(entry["small"]) + share * np.log(entry["large"])))


@functools.cache
def _table() -> dict[str, dict[str, Any]]:
    table: dict[str, dict[str, Any]] = read_yaml(FILE, MAX_BYTES, "table of typical magnitudes (YAML)").data
    return table
