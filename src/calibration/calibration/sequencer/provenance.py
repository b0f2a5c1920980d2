"""Where a session's data come from: software, parameters, cell, plan."""

from __future__ import annotations

import hashlib
import importlib.metadata
import platform
from collections.abc import Mapping

from calibration_core.cell import Cell

PACKAGES = ("calibration_core", "numpy", "scipy", "pin", "rclpy", "mcap")


def provenance(cell: Cell, plan_text: str, parameters: Mapping[str, object]) -> dict[str, str]:
    """Return everything that a later reader may ask for, as text."""
    found = {
        "cell": str(cell.path),
        "cell_sha256": cell.sha256,
        "plan_sha256": hashlib.sha256(plan_text.encode()).hexdigest(),
        "python": platform.python_version(),
        "system": platform.platform(),
    }
    if cell.urdf_path is not None and cell.urdf_path.is_file():
        found["urdf_sha256"] = hashlib.sha256(cell.urdf_path.read_bytes()).hexdigest()
    for package in PACKAGES:
        try:
            found[f"version {package}"] = importlib.metadata.version(package)
        except importlib.metadata.PackageNotFoundError:
            found[f"version {package}"] = "not installed"
    return found | {f"parameter {name}": str(value) for name, value in parameters.items()}
