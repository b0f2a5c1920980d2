"""Writes the recordings under neutral names, and seals what is in them.

OUT/recordings/r0001/{measurements.csv, cell.yaml}    what the diagnosis sees
OUT/sealed/r0001.json                                      what it is to find; `labels.json` holds them all
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Iterable, Sequence
from concurrent.futures import ProcessPoolExecutor
from pathlib import Path
from typing import Any

from tqdm import tqdm

from calibration_core.files.yaml_file import yaml_text
from calibration_core.recording.tables.table import write_table
from calibration_sim.scenarios.generate import generate
from calibration_sim.scenarios.grid import Scenario, recording_name

TABLE, CELL, LABELS = "measurements.csv", "cell.yaml", "labels.json"


def write_recordings(scenarios: Sequence[Scenario], total: int, out: Path, *, jobs: int) -> tuple[list[str], str]:
    """Write what is missing of the recordings, and all labels into one file.

    Returns:
        Names of the recordings in the order of their names, and the SHA-256 of the file of labels.
    """
    sealed = out / "sealed"
    sealed.mkdir(parents=True, exist_ok=True)
    names = {recording_name(scenario, total): scenario for scenario in scenarios}
    missing = [
        (name, scenario, out) for name, scenario in sorted(names.items()) if not _is_written(name, scenario, out)
    ]
    if missing:
        _all(missing, jobs)
    labels = {name: json.loads((sealed / f"{name}.json").read_text(encoding="utf-8")) for name in sorted(names)}
    text = json.dumps(labels, indent=1, sort_keys=True) + "\n"
    (out / LABELS).write_text(text, encoding="utf-8")
    return sorted(names), hashlib.sha256(text.encode()).hexdigest()


def open_labels(out: Path, digest: str) -> dict[str, dict[str, Any]]:
    """Read the labels back.

    Raises:
        ValueError: They are not those that were sealed.
    """
    content = (out / LABELS).read_bytes()
    found = hashlib.sha256(content).hexdigest()
    if found != digest:
        msg = f"{out / LABELS}: SHA-256 {found}, sealed as {digest}"
        raise ValueError(msg)
    labels: dict[str, dict[str, Any]] = json.loads(content)
    return labels


def recording_digest(folder: Path) -> str:
    """Return the SHA-256 of a recording's table and cell file together."""
    digest = hashlib.sha256()
    for name in (TABLE, CELL):
        digest.update((folder / name).read_bytes())
    return digest.hexdigest()


def folder_of(out: Path, name: str) -> Path:
    """Return the folder of a recording."""
    return out / "recordings" / name


def _all(tasks: list[tuple[str, Scenario, Path]], jobs: int) -> None:
    bar = tqdm(total=len(tasks), desc="recordings", unit="rec", smoothing=0.05, mininterval=1.0)
    with bar:
        for _ in _mapped(tasks, jobs):
            bar.update()


def _mapped(tasks: list[tuple[str, Scenario, Path]], jobs: int) -> Iterable[None]:
    if jobs == 1:
        yield from map(_write, tasks)
        return
    with ProcessPoolExecutor(jobs) as pool:
        yield from pool.map(_write, tasks)


def _is_written(name: str, scenario: Scenario, out: Path) -> bool:
    label = out / "sealed" / f"{name}.json"
    if not label.is_file() or not (folder_of(out, name) / CELL).is_file():
        return False
    known = json.loads(label.read_text(encoding="utf-8"))
    return bool(known["seed"] == scenario.seed and known["sha256"] == recording_digest(folder_of(out, name)))


def _write(task: tuple[str, Scenario, Path]) -> None:
    name, scenario, out = task
    made = generate(scenario)
    folder = folder_of(out, name)
    folder.mkdir(parents=True, exist_ok=True)
    write_table(folder / TABLE, made.readings)
    (folder / CELL).write_text(yaml_text(made.cell), encoding="utf-8")
    label = {**made.label, "sha256": recording_digest(folder)}
    (out / "sealed" / f"{name}.json").write_text(json.dumps(label, sort_keys=True), encoding="utf-8")
