"""One recording in a worker: read, identify, diagnose; what comes back is a row and the content of result.json."""

from __future__ import annotations

import contextlib
import ctypes
import dataclasses
import os
import platform
import time
import warnings
from pathlib import Path
from typing import Any

import numpy as np

from calibration_core import __version__
from calibration_core.acceptance.comparison import COMPLIANCE
from calibration_core.acceptance.joint_laws import joint_laws, reference_torques
from calibration_core.cell import Cell, load_cell
from calibration_core.commands.evaluation.diagnose import Diagnosed, evaluate
from calibration_core.commands.shared.inputs import Refusal
from calibration_core.errors import CalibrationError, InputError
from calibration_core.fleet.recordings.inputs import (
    InputFile,
    description_of,
    digest_of,
    files_of,
    input_file,
    local_copies,
)
from calibration_core.fleet.recordings.manifest import Entry
from calibration_core.fleet.recordings.rows import MEASURED, SCHEMA, Row, failed
from calibration_core.identification.stiffness.loaded import Options
from calibration_core.model.effects.words import listed_location
from calibration_core.model.identified.gaussian import GaussianEstimate
from calibration_core.observations.kinds import is_loaded
from calibration_core.observations.observe import observe
from calibration_core.report.results.result import result_json

VERSION = f"{__version__} rows {SCHEMA}"
MEGABYTE = 1024.0**2


@dataclasses.dataclass(frozen=True)
class EvaluatedRecording:
    """What a worker hands back.

    Attributes:
        result: The bytes of result.json; empty where the recording failed.
    """

    row: Row
    result: bytes


def measure(entry: Entry) -> EvaluatedRecording:
    """Evaluate one recording; whatever is wrong with it becomes a row with one line of error."""
    begun = time.process_time()
    files: list[InputFile] = []
    content: dict[str, Any] = {}
    values: dict[str, Any] = {}
    error = ""
    try:
        with warnings.catch_warnings(), local_copies(entry) as (recording, cell_path):
            warnings.simplefilter("ignore")  # a warning of a library tells its users nothing that they could act on
            files += [input_file(path) for path in (*files_of(entry.recording), *files_of(entry.cell))]
            cell = load_cell(cell_path)
            files += _description(entry, cell)
            answer = evaluate(observe(recording, cell), cell, Options())
            content, values = answer.content, _values(answer)
            del answer
    except CalibrationError as fault:
        error = str(fault)
    except Exception as fault:  # noqa: BLE001 - one recording never ends the run of all; its row says what happened
        error = f"{entry.recording}: a defect of this program ({type(fault).__name__}: {fault})"
    key = digest_of(files, VERSION)
    _give_back()
    spent: dict[str, Any] = {
        "seconds": time.process_time() - begun,
        "megabytes": _resident(),
        "host": f"{platform.node()}:{os.getpid()}",
    }
    if error:
        return EvaluatedRecording(failed(entry, error, files, key, **spent), b"")
    row = Row(
        recording=entry.recording, cell=entry.cell, robot=entry.robot, type=entry.type, date=entry.date,
        status=MEASURED, key=key, inputs=tuple(files), **values, **spent,
    )  # fmt: skip
    return EvaluatedRecording(row, _named(content, entry))


def _named(content: dict[str, Any], entry: Entry) -> bytes:
    """Return result.json; it names the recording as the manifest does, not a copy of it."""
    recording = {**content["recording"], "file": entry.recording}
    return result_json({**content, "recording": recording})


def _description(entry: Entry, cell: Cell) -> list[InputFile]:
    """Return the robot description that the cell file names, as an input."""
    if cell.urdf_path is None:
        return []
    source = description_of(entry.cell, {"robot": {"urdf": str(cell.robot.urdf)}})
    return [] if source is None else [input_file(source)]


def _values(answer: Diagnosed | Refusal) -> dict[str, Any]:
    content = answer.content
    values: dict[str, Any] = {
        "usable": content["usable"],
        "reason": content["reason"],
        "verdict": content["verdict"],
        "configurations": int(content["recording"]["configurations"] or 0),
        "anomalies": tuple(sorted({str(one["kind"]) for one in content["anomalies"]})),
    }
    if isinstance(answer, Refusal):
        return values
    found = answer.diagnosis.physics
    values |= {
        "effects": tuple(one.effect for one in found),
        "locations": tuple(listed_location(one.location) for one in found),
        "magnitudes": tuple(float(one.magnitude) for one in found),
        "evidence": tuple(float(one.log_bayes_factor) for one in found),
    }
    estimate = answer.estimate
    if estimate is not None:
        values |= _compliances(estimate)
    laws = _laws(answer)
    return values | {
        "law_names": laws.names,
        "law_values": tuple(float(x) for x in laws.value),
        "law_stds": tuple(float(x) for x in laws.std),
    }


def _compliances(estimate: GaussianEstimate) -> dict[str, Any]:
    chosen = estimate.chosen([k for k, name in enumerate(estimate.names) if name.startswith(COMPLIANCE)])
    return {
        "joints": tuple(name.removeprefix(COMPLIANCE) for name in chosen.names),
        "units": chosen.units,
        "compliance": tuple(float(x) for x in chosen.value),
        "covariance": tuple(float(x) for x in np.asarray(chosen.covariance).ravel()),
    }


def _laws(answer: Diagnosed) -> GaussianEstimate:
    """Return backlash and hysteresis of every joint; nothing of a recording that shows none."""
    readings, identification = answer.readings, answer.diagnosis.identification
    if not is_loaded(readings):
        return GaussianEstimate.nothing()
    with contextlib.suppress(InputError):  # a recording without loads at known places shows no joint law
        reference = reference_torques(readings, answer.cell, identification.model)
        return joint_laws(readings, answer.cell, identification.model, reference, identification.noise.scale)
    return GaussianEstimate.nothing()


def _give_back() -> None:
    """Return freed memory to the system, where the C library can: a worker stays as small as one recording lets it."""
    with contextlib.suppress(AttributeError, OSError):
        ctypes.CDLL(None).malloc_trim(0)


def _resident() -> float:
    """Return the resident memory of this process, MB; 0 where the system does not say."""
    with contextlib.suppress(OSError, ValueError, IndexError):
        pages = int(Path("/proc/self/statm").read_text(encoding="ascii").split()[1])
        return pages * os.sysconf("SC_PAGE_SIZE") / MEGABYTE
    return 0.0
