"""Negative controls of what is easily mistaken in absolute positions: sag of elastic joints under gravity.

A compliance is believed only if (1) it is positive; (2) most of what it saves on blocks left out is lost when gravity
is turned by 90 degrees, alone and beside the other findings; (3) it still saves beside the lowest harmonics of the same
joint's transmission, which gravity's torque resembles.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence

import numpy as np

from calibration_core.diagnosis.absolute_design import AbsoluteDesign
from calibration_core.diagnosis.blocks import Blocks
from calibration_core.diagnosis.left_out import block_squares, left_out, saves
from calibration_core.model.effects.transmission_error import order_of
from calibration_core.timeseries import Float2D

COLLAPSED = 1 / 3  # share of the gain that turned gravity may keep
BESIDE = 3  # orders of the same joint's transmission


@dataclasses.dataclass(frozen=True, eq=False)
class GravityControl:
    """The controls of `joint_elasticity`, ready to be asked by the selection.

    Attributes:
        partitions: Of the design's readings.
        turned: Joint -> (3 s, 2) weighted columns of sag with gravity turned, see `joint_elasticity.turned_columns`.
    """

    partitions: Sequence[Blocks]
    turned: dict[str, Float2D]

    def __call__(self, design: AbsoluteDesign, accepted: tuple[int, ...], index: int) -> str:
        """Return why the candidate is refused; empty if it is not, or is no elasticity."""
        candidate = design.candidates[index]
        if candidate.effect != "joint_elasticity":
            return ""
        joint = str(candidate.location["joint"])
        words = f"joint_elasticity ({joint})"
        others = tuple(i for i in accepted if not _low_harmonic(design, i, joint))
        beside = (*others, *(i for i in range(len(design.candidates)) if _low_harmonic(design, i, joint)))
        own = design.columns[:, design.blocks[index]]
        single = own.shape[1] == 1  # several are compliances times moments, which have either sign
        if single and _coefficient(design.of(accepted), own, design.residual) <= 0:
            return f"{words}: the compliance would be negative"
        for partition in self.partitions:
            for context in dict.fromkeys(((), accepted)):
                kept = self._kept(design, context, joint, own, partition)
                if kept > COLLAPSED:
                    return (
                        f"{words}: {100 * kept:.0f} % of its gain remains with gravity turned by 90 degrees "
                        f"({partition.kind} blocks), so it is not gravity's"
                    )
            before, after = _squares(design, beside, own, partition)
            negative = single and _coefficient(design.of(beside), own, design.residual) <= 0
            if negative or not saves(before, after):
                return f"{words}: it cannot be told from the lowest harmonics of the joint's transmission"
        return ""

    def _kept(
        self, design: AbsoluteDesign, context: tuple[int, ...], joint: str, own: Float2D, partition: Blocks
    ) -> float:
        """Return the share of the gain beside some effects that the better of the turned gravities keeps."""
        main = _gain(design, context, own, partition)
        half = self.turned[joint].shape[1] // 2
        turned = max(_gain(design, context, self.turned[joint][:, k : k + half], partition) for k in (0, half))
        return max(turned, 0.0) / main if main > 0 else np.inf


def _low_harmonic(design: AbsoluteDesign, index: int, joint: str) -> bool:
    candidate = design.candidates[index]
    if candidate.effect != "transmission_error" or candidate.location["joint"] != joint:
        return False
    return order_of(candidate.variant) <= BESIDE


def _coefficient(base: Float2D, own: Float2D, residual: Float2D) -> float:
    solution = np.linalg.lstsq(np.column_stack([base, own]), residual, rcond=1e-9)[0]
    return float(solution[-1])


def _gain(design: AbsoluteDesign, accepted: Sequence[int], own: Float2D, partition: Blocks) -> float:
    before, after = _squares(design, accepted, own, partition)
    return float((before - after).sum())


def _squares(
    design: AbsoluteDesign, accepted: Sequence[int], own: Float2D, partition: Blocks
) -> tuple[Float2D, Float2D]:
    base = design.of(accepted)
    length = np.linalg.norm(own, axis=0)
    wide = np.column_stack([base, own / np.where(length > 0, length, 1.0)])
    before, after = (left_out(columns, design.residual, partition) for columns in (base, wide))
    return block_squares(before, partition), block_squares(after, partition)
