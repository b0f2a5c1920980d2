"""Whether anything pulls before a robot moves: what is kept of the load between runs, and the sensor's proven zero.

A load that a stopped or killed run has left on outlives the run, the nodes and the computer's memory, and a new run
would take it for zero.  So one file for each cell and sensor keeps two things.  It says whether a load may be on: it
is written before a load is asked for, and again once its release is confirmed.  And it keeps what the untared sensor
said, and in which postures, while it was proven that nothing pulled:

    F = m g + R b

F (3,) N is the force in base axes, m kg the mass that hangs on the sensor (the tool), g gravity, R turns from the
sensor's to base axes, and b (3,) N is the sensor's bias.  One zero determines F in its own posture; m and b follow from
zeros in a few postures, by least squares with a wide prior.  What the sensor says beyond F is what pulls.
"""

from __future__ import annotations

import dataclasses
import hashlib
import json
import os
import re
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from calibration_core.cell import Cell
from calibration_core.errors import OutputError, SessionError, beyond, quoted, rounded_down, storage_fault
from calibration_core.measurement.load_check import Felt, LoadCheck
from calibration_core.measurement.session import sync_directory, write_durably
from calibration_core.planning.plans.tolerances import DEVIATIONS, STANDARD_ACCELERATION
from calibration_core.timeseries import Float1D, Float2D, read_only

SCHEMA = 1
KEPT = 20  # zeros, the newest: a plan's worth of postures; a sensor that drifts over more is followed
COVERAGE = 3.0  # standard deviations of the expected force that count as unloaded besides the plan's `force_floor`
EXPECTED = "what the sequencer keeps of the load; remove the file, and an operator says what pulls"


@dataclasses.dataclass(frozen=True, eq=False)
class ProvenZero:
    """What the sensor said while nothing pulled.

    Attributes:
        time: ns.
        q: (n,) rad.
        wrench: (6,) N and N*m, untared, axes as on the wrench topic.
        proof: Who or what says that nothing pulled.
    """

    time: int
    q: Float1D
    wrench: Float1D
    proof: str

    def __post_init__(self) -> None:
        """Copy to read-only arrays."""
        object.__setattr__(self, "q", read_only(self.q))
        object.__setattr__(self, "wrench", read_only(self.wrench))


class Unloaded:
    """What the sensor should say when nothing pulls.

    Args:
        check: Turns what the sensor says to base axes.
        cell: Gravity, rated load.
        zeros: Proven ones; without any, nothing can be told.
    """

    def __init__(self, check: LoadCheck, cell: Cell, zeros: Sequence[ProvenZero]) -> None:
        self._check, self._gravity = check, cell.gravity
        self._weight = cell.robot.rated_load * STANDARD_ACCELERATION
        # A tool weighs up to the rated load, and a bias is as large as what the sensor is there for.  A zero holds to
        # the force that never matters, as five standard deviations: the sensor's noise, and its drift between runs.
        prior = np.diag(np.array([cell.robot.rated_load, *[self._weight] * 3]) ** -2.0)
        sigma = check.floor / DEVIATIONS
        rows = np.vstack([np.zeros((0, 4)), *[self._design(zero.q) for zero in zeros]])
        force = np.concatenate([np.zeros(0), *[self._force(zero.q, zero.wrench) for zero in zeros]])
        self._covariance = np.linalg.inv(prior + rows.T @ rows / sigma**2)
        self._estimate = self._covariance @ (rows.T @ force) / sigma**2

    def _design(self, q: Float1D) -> Float2D:
        axes = [self._force(q, unit) for unit in np.eye(3, 6)]  # of the sensor, in base axes
        return np.column_stack([self._gravity, *axes])

    def _force(self, q: Float1D, wrench: Float1D) -> Float1D:
        return self._check.pulls(Felt(q, wrench))[:3]

    def pulling(self, q: Float1D, wrench: Float1D) -> tuple[Float1D, float]:
        """Return the force that pulls and up to which size it counts as none.

        Args:
            q: (n,) rad.
            wrench: (6,) N and N*m, untared.

        Returns:
            (3,) N, base axes, and N; NaN where the zeros do not tell what the sensor should say in this posture.
        """
        design = self._design(q)
        spread = COVERAGE * float(np.sqrt(np.linalg.eigvalsh(design @ self._covariance @ design.T)[-1]))
        force = self._force(q, wrench) - design @ self._estimate
        # a band that is mostly uncertainty would let a load pass
        return force, self._check.floor + spread if spread <= self._check.floor else np.nan

    def fault(self, q: Float1D, wrench: Float1D, most: float = 0.0) -> str:
        """Say that too much pulls in all, and what to do; empty: it does not, or the zeros do not tell.

        Args:
            q: (n,) rad.
            wrench: (6,) N and N*m, untared.
            most: N, that may pull; 0: nothing may.
        """
        force, band = self.pulling(q, wrench)
        size = float(np.linalg.norm(force))
        if np.isnan(band) or size <= max(most, band):
            return ""
        limit = rounded_down(max(most, band))
        pull = f"{beyond(size, limit)} N pull at the tool in all, ({', '.join(f'{value:z.0f}' for value in force)}) N"
        if most:
            return f"{pull}, expected at most the rated load and its tolerance, {limit:g} N: take load off"
        return f"{pull}, expected at most {limit:g} N unloaded: release the load, or look at the sensor"


class LoadMemory:
    """What is kept of the load between runs; read once, written at every change.

    Attributes:
        left: Where a load may be on; empty: it was released; None: nothing is known.
        zeros: Proven ones, the newest last.
    """

    def __init__(self, path: Path) -> None:
        """Read the file; without one nothing is known.

        Raises:
            SessionError: It cannot be read, or holds something else.
        """
        self.path = path
        self.left: str | None = None
        self.zeros: tuple[ProvenZero, ...] = ()
        try:
            text = path.read_text(encoding="utf-8")
        except FileNotFoundError:
            return
        except (OSError, UnicodeDecodeError) as error:
            raise SessionError(path, "", str(error), EXPECTED) from None
        try:
            self.left, self.zeros = _read(json.loads(text))
        except (ValueError, TypeError, KeyError, AttributeError):
            raise SessionError(path, "", quoted(text), EXPECTED) from None

    def loading(self, place: str) -> None:
        """Keep that a load may be on from now on; on the disk when this returns.

        Raises:
            OutputError: It cannot be written.
        """
        if not self.left:
            self._keep(place, self.zeros)

    def released(self) -> None:
        """Keep that nothing pulls any more; on the disk when this returns.

        Raises:
            OutputError: It cannot be written.
        """
        if self.left != "":
            self._keep("", self.zeros)

    def proven(self, zero: ProvenZero, *, anew: bool = False) -> None:
        """Keep a zero, and that nothing pulls.

        Args:
            zero: The newest.
            anew: Forget the others, for they are contradicted.

        Raises:
            OutputError: It cannot be written.
        """
        self._keep("", (*(() if anew else self.zeros), zero)[-KEPT:])

    def _keep(self, left: str, zeros: tuple[ProvenZero, ...]) -> None:
        rows = [
            {"time": zero.time, "q": zero.q.tolist(), "wrench": zero.wrench.tolist(), "proof": zero.proof}
            for zero in zeros
        ]
        text = json.dumps({"schema": SCHEMA, "left": left, "zeros": rows}, indent=1)
        unfinished = self.path.with_name(f".{self.path.name}")
        try:
            self.path.parent.mkdir(parents=True, exist_ok=True)
            write_durably(unfinished, text)
            unfinished.replace(self.path)
            sync_directory(self.path.parent)
        except OSError as error:
            raise OutputError(self.path, "", *storage_fault(self.path, error, "a file to write to")) from None
        self.left, self.zeros = left, zeros


def _read(data: Any) -> tuple[str, tuple[ProvenZero, ...]]:
    """Return the content of the file; raise ValueError, TypeError or KeyError where it is another one's."""
    if data["schema"] != SCHEMA or not isinstance(data["left"], str):
        raise ValueError
    zeros = tuple(
        ProvenZero(int(row["time"]), np.array(row["q"], float), np.array(row["wrench"], float), str(row["proof"]))
        for row in data["zeros"]
    )
    if any(len(zero.wrench) != 6 or not np.isfinite([*zero.wrench, *zero.q]).all() for zero in zeros):
        raise ValueError
    return data["left"], zeros


def memory_file(cell: Cell, namespace: str, given: str = "", home: Path | None = None) -> Path:
    """Return where it is kept what is known of the load.

    Args:
        cell: Another robot or sensor, or one that is mounted otherwise, has another file: its zero is another one.
        namespace: Of the cell's nodes.
        given: A path that is wanted; empty: in `calibration/` of `home`.
        home: None: `$ROS_HOME`, or `~/.ros` where it is not set.
    """
    if given:
        return Path(given).expanduser()
    sensor = cell.instruments.force_torque
    mounted = [cell.robot.name, cell.robot.serial, cell.topics.wrench, repr(cell.frames.force_torque), namespace]
    mounted += [] if sensor is None else [sensor.name, sensor.serial]
    digest = hashlib.sha256("\0".join(mounted).encode()).hexdigest()[:12]
    home = home or Path(os.environ.get("ROS_HOME") or Path.home() / ".ros")
    return home / "calibration" / f"load-{re.sub(r'[^A-Za-z0-9]+', '-', cell.robot.name)}-{digest}.json"
