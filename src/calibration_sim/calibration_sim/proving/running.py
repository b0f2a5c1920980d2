"""Has every recording diagnosed by the engine, and keeps what comes back: OUT/results/NAME/{run.json, result.json}.

A recording whose result is there, made from the same files, is not diagnosed again.
"""

from __future__ import annotations

import dataclasses
import json
from collections.abc import Sequence
from pathlib import Path

from tqdm import tqdm

from calibration_core.engine.cluster import Cluster, connected
from calibration_core.engine.pieces import run_all as run_pieces
from calibration_sim.proving.diagnosing import RESULT, Answer, Piece, Run, Settings, diagnose
from calibration_sim.proving.writing import folder_of, recording_digest

RUN = "run.json"


def run_all(names: Sequence[str], out: Path, settings: Settings, cluster: Cluster) -> None:
    """Diagnose all recordings that have no result yet; results stand in OUT/results/NAME.

    Raises:
        InputError: The cluster does not answer, or has gone.
    """
    folders = {name: folder_of(out, name).absolute() for name in names if not _is_done(name, out)}
    if not folders:
        return
    waiting = {str(folder): Piece(folder, settings) for folder in folders.values()}  # a scheduler may serve others too
    bar = tqdm(total=len(names), initial=len(names) - len(folders), desc="diagnosis", unit="rec", mininterval=1.0)
    with bar, connected(cluster) as client:
        for done in run_pieces(client, diagnose, waiting):
            folder = waiting[str(done.key)].folder
            answer = done.value or Answer(Run(recording_digest(folder), -1, 0.0, 0.0, done.error), b"")
            _keep(out, folder.name, answer)
            bar.update()


def read_run(out: Path, name: str) -> Run | None:
    """Return how a recording's diagnosis went; None: it was not run."""
    path = _result_folder(out, name) / RUN
    return Run(**json.loads(path.read_text(encoding="utf-8"))) if path.is_file() else None


def result_path(out: Path, name: str) -> Path:
    """Return where a recording's result stands."""
    return _result_folder(out, name) / RESULT


def _result_folder(out: Path, name: str) -> Path:
    return out / "results" / name


def _is_done(name: str, out: Path) -> bool:
    run = read_run(out, name)
    return (
        run is not None
        and run.exit == 0
        and result_path(out, name).is_file()
        and run.sha256 == recording_digest(folder_of(out, name))
    )


def _keep(out: Path, name: str, answer: Answer) -> None:
    """Write the answer; one left from before goes away first, and run.json, which says that it is whole, comes last."""
    folder = _result_folder(out, name)
    folder.mkdir(parents=True, exist_ok=True)
    for stale in (RUN, RESULT):
        (folder / stale).unlink(missing_ok=True)
    if answer.result:
        (folder / RESULT).write_bytes(answer.result)
    (folder / RUN).write_text(json.dumps(dataclasses.asdict(answer.run)), encoding="utf-8")
