"""What one recording says, as one row of the data set."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from typing import Any

import numpy as np

from calibration_core.fleet.recordings.inputs import InputFile
from calibration_core.fleet.recordings.manifest import Entry
from calibration_core.timeseries import Float1D, Float2D

SCHEMA = 1  # of a row: part of the version that a result belongs to
MEASURED, FAILED = "measured", "failed"


@dataclasses.dataclass(frozen=True)
class Row:
    """One recording, evaluated or not.

    Attributes:
        cell: The same of its cell file.
        date: ISO 8601.
        status: `measured` or `failed`.
        error: Why it failed, in one line; empty where it was measured.
        key: SHA-256 of all inputs and the version.
        usable: Traffic light of its result; empty where it failed.
        reason: Why.
        verdict: Of the diagnosis.
        configurations: How many were measured.
        joints: n names.
        compliance: n values, rad/(N*m) (m/N where a joint slides), in the model with the findings.
        covariance: n x n, row after row; of (rad/(N*m))^2.
        law_names: `backlash.JOINT` and `hysteresis.JOINT`, as `calibration compare` measures them.
        law_values: Their sizes, rad (m where a joint slides).
        law_stds: Their standard deviations.
        magnitudes: Its movement of the measured points, m.
        evidence: Its log Bayes factor.
        anomalies: Kinds.
        inputs: Files with digests.
        seconds: Processor time that the evaluation took.
        megabytes: Resident memory of the worker afterwards.
        host: Where it was evaluated.
    """

    recording: str
    cell: str
    robot: str
    type: str
    date: str
    status: str
    error: str = ""
    key: str = ""
    usable: str = ""
    reason: str = ""
    verdict: str = ""
    configurations: int = 0
    joints: tuple[str, ...] = ()
    units: tuple[str, ...] = ()
    compliance: tuple[float, ...] = ()
    covariance: tuple[float, ...] = ()
    law_names: tuple[str, ...] = ()
    law_values: tuple[float, ...] = ()
    law_stds: tuple[float, ...] = ()
    effects: tuple[str, ...] = ()
    locations: tuple[str, ...] = ()
    magnitudes: tuple[float, ...] = ()
    evidence: tuple[float, ...] = ()
    anomalies: tuple[str, ...] = ()
    inputs: tuple[InputFile, ...] = ()
    seconds: float = 0.0
    megabytes: float = 0.0
    host: str = ""

    @property
    def measured(self) -> bool:
        """Whether there is a result."""
        return self.status == MEASURED

    @property
    def compliance_covariance(self) -> Float2D:
        """(n, n) of `compliance`."""
        n = len(self.joints)
        return np.array(self.covariance, dtype=np.float64).reshape(n, n)

    @property
    def log_stiffness(self) -> tuple[Float1D, Float1D]:
        """Return (n,) logarithms of the stiffnesses and their standard deviations; NaN where not known to 50 %.

        To first order in the compliance: ln K = -ln C, std(ln K) = std(C) / C.
        """
        value = np.array(self.compliance, dtype=np.float64)
        std = np.sqrt(np.diag(self.compliance_covariance)) if len(value) else np.zeros(0)
        with np.errstate(divide="ignore", invalid="ignore"):
            known = (value > 0) & np.isfinite(std) & (std > 0) & (std < LARGEST_RELATIVE * value)
            logs, relative = -np.log(value), std / value
        return np.where(known, logs, np.nan), np.where(known, relative, np.nan)

    def to_dict(self) -> dict[str, Any]:
        """Return the row as plain values for JSON and Parquet."""
        values = {field.name: getattr(self, field.name) for field in dataclasses.fields(self)}
        return {**values, "inputs": tuple(dataclasses.asdict(one) for one in self.inputs)}


LARGEST_RELATIVE = 0.5  # std over value of a compliance: beyond, its logarithm is not nearly normal


def row_of(values: dict[str, Any]) -> Row:
    """Return the row that `to_dict` was called on.

    Raises:
        TypeError: It has other fields.
    """
    plain: dict[str, Any] = {
        name: tuple(value) if isinstance(value, list | tuple) else value for name, value in values.items()
    }
    inputs = tuple(one if isinstance(one, InputFile) else InputFile(**one) for one in plain.pop("inputs", ()))
    return Row(**plain, inputs=inputs)


def failed(entry: Entry, error: str, inputs: Sequence[InputFile] = (), key: str = "", **further: Any) -> Row:
    """Return the row of a recording that could not be evaluated.

    Args:
        entry: The recording.
        error: One line that says why.
        inputs: Its files, as far as they could be read.
        key: Of the inputs and version; empty: it is tried again in the next run.
        further: Times and host.
    """
    return Row(
        recording=entry.recording, cell=entry.cell, robot=entry.robot, type=entry.type, date=entry.date,
        status=FAILED, error=" ".join(error.split()), inputs=tuple(inputs), key=key, **further,
    )  # fmt: skip
