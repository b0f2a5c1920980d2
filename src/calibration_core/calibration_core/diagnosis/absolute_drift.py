"""Negative control of drifts in absolute positions: a tracker's noise may last from one configuration to the next.

Slow noise looks like a drift, and blocks of single configurations take it for many independent witnesses.  A drift is
believed only if it convinces with blocks of several configurations as well.
"""

from __future__ import annotations

import dataclasses

from calibration_core.diagnosis.absolute_design import AbsoluteDesign
from calibration_core.diagnosis.absolute_evidence import evidence
from calibration_core.diagnosis.absolute_selection import Control
from calibration_core.diagnosis.blocks import Blocks, time_blocks
from calibration_core.timeseries import Int1D

LASTING = 3  # configurations that noise may share
MOST = 40  # blocks
CONVINCING = 6.0  # nats


@dataclasses.dataclass(frozen=True, eq=False)
class DriftControl:
    """The control of `tracker_drift`, and whatever controls there are besides.

    Attributes:
        slow: Blocks of several configurations, in the order of time.
        besides: Asked about everything else.
    """

    slow: Blocks
    besides: Control

    def __call__(self, design: AbsoluteDesign, accepted: tuple[int, ...], index: int) -> str:
        """Return why the candidate is refused; empty if it is not."""
        candidate = design.candidates[index]
        if candidate.effect != "tracker_drift":
            return self.besides(design, accepted, index)
        own = design.columns[:, design.blocks[index]]
        alone = dataclasses.replace(
            design, null=design.of(accepted), columns=own, candidates=(candidate,), blocks=(slice(0, own.shape[1]),)
        )
        if evidence(alone, (), (self.slow,), {self.slow.kind: 0.0}).weakest(0) > CONVINCING:
            return ""
        return f"tracker_drift: it does not convince where {LASTING} configurations in a row may share their noise"


def slow_blocks(configuration: Int1D) -> Blocks:
    """Part configurations, (m,) one per reading in the order of time, into blocks of at least `LASTING`."""
    count = len(set(configuration.tolist()))
    return time_blocks(configuration, max(min(MOST, count // LASTING), 1))
