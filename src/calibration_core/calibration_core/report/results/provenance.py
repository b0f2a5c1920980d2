"""What a result rests on: software versions and digests of every input file."""

from __future__ import annotations

import hashlib
import platform
from collections.abc import Mapping, Sequence
from importlib import metadata

from calibration_core.cell import Cell
from calibration_core.timeseries import Provenance

PACKAGES = ("calibration_core", "numpy", "scipy", "pin", "rosbags")


def software() -> dict[str, str]:
    """Return name -> version of the interpreter and of the packages that take part in a result."""
    versions = {"python": platform.python_version()}
    for package in PACKAGES:
        try:
            versions[package] = metadata.version(package)
        except metadata.PackageNotFoundError:
            versions[package] = "not installed as a package"
    return versions


def digests(
    cell: Cell, provenance: Provenance | None = None, further: Mapping[str, Mapping[str, str]] | None = None
) -> tuple[tuple[str, str, str], ...]:
    """Return (role, file, SHA-256) of every input file.

    Args:
        cell: The cell, with its URDF.
        provenance: The recording; None if none was read.
        further: Role -> file -> SHA-256 of further files, for example of the second recording.
    """
    rows = [] if provenance is None else [("recording", *item) for item in sorted(provenance.sha256.items())]
    rows += _cell_files(cell)
    for role, files in (further or {}).items():
        rows += [(role, *item) for item in sorted(files.items())]
    return tuple(rows)


def further_cells(cells: Sequence[Cell]) -> dict[str, Mapping[str, str]]:
    """Return the files of further cells that are not those of the first: role -> file -> SHA-256; empty without any."""
    first, *others = cells
    known = {digest for _, _, digest in _cell_files(first)}
    found: dict[str, dict[str, str]] = {}
    for cell in others:
        for role, file, digest in _cell_files(cell):
            if digest not in known:
                name = file if role == "cell" else f"{cell.path}: {file}"  # a URDF is named beside its cell file
                found.setdefault(role, {})[name] = digest
    return {**found}


def _cell_files(cell: Cell) -> list[tuple[str, str, str]]:
    """Return (role, file, SHA-256) of a cell file and of its URDF."""
    rows = [("cell", str(cell.path), cell.sha256)]
    if cell.urdf_path is not None and cell.urdf_path.is_file():
        rows.append(("robot", str(cell.robot.urdf), hashlib.sha256(cell.urdf_path.read_bytes()).hexdigest()))
    return rows
