"""What a recording of loads can never tell apart, in sentences that name the robot's own joints."""

from __future__ import annotations

import numpy as np

from calibration_core.model.chain import Chain
from calibration_core.model.effects.state import State
from calibration_core.model.effects.structure.gravity_compensator import carriers

NEARLY = 1e-4  # m, or sine of an angle: less is rounding in a file


def aliases(state: State, *, differences: bool) -> tuple[str, ...]:
    """Return which causes act alike on the readings, whatever their sizes.

    Args:
        state: The null model, all readings.
        differences: Whether differences to step 0 alone are used.  Absolute positions show the sag under the weight, on
            which sensor and tracker have no share, and the torque of a compensator itself.
    """
    joints, everywhere = state.chain.joints, "" if state.setups is None else " in all recordings"
    sentences: list[str] = []
    if differences:
        sentences = [
            f"{cause}{everywhere} acts like all joints being softer by the same share."
            for cause in ("A gain common to all axes of the force/torque sensor", "A wrong scale of the tracker")
        ]
    if not np.any(state.since_step_zero(state.q)):
        sentences.append(
            "A servo that gives way acts like its joint being softer: the joint angles are recorded alike at all steps "
            "of a configuration."
        )
    if differences:
        sentences += [
            f"A gravity compensator of {joints[k]} acts like a stiffness and a zero of {joints[k]} that follow its "
            "angle."
            for k in carriers(state)
        ]
    if _turns_about_the_base(state.chain):
        sentences.append(
            f"Rocking of the base acts like an off-axis compliance of {joints[0]} at the origin of the base frame."
        )
    return tuple(sentences)


def _turns_about_the_base(chain: Chain) -> bool:
    """Say whether the first joint turns, about the z axis of the base frame."""
    beside = np.concatenate([chain.rotation[0, :2, 2], chain.translation[0, :2]])
    return not chain.prismatic[0] and float(np.abs(beside).max()) < NEARLY
