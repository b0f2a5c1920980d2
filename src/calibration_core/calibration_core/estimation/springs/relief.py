"""How much of the weight at a joint waves or a spring take off: what distinguishes the two.

Both turn the joint by some function of its angle.  A spring is put there to carry the arm: what it does follows the
weight, and is far more than gears are wrong by.
"""

from __future__ import annotations

import dataclasses

import numpy as np

from calibration_core.estimation.field import Trial
from calibration_core.estimation.hypotheses import typical_sizes
from calibration_core.estimation.likelihood.gains import beside
from calibration_core.estimation.rows import NullModel
from calibration_core.estimation.springs.compensator_geometry import SPRING
from calibration_core.model.effects.candidate import typical
from calibration_core.model.effects.state import State
from calibration_core.model.effects.structure.gravity_compensator import carriers
from calibration_core.timeseries import Float1D

SHARE = 0.15  # of the weight at its joint that a spring takes off at least, and in amplitudes of
AMPLITUDES = 3.0  # a usual gear: beyond both it is a spring


@dataclasses.dataclass(frozen=True)
class Relief:
    """What is taken off a joint.

    Attributes:
        share: Of the torque of the weight, as that changes with posture; negative: more weight is put on.
        amplitudes: The same movement in amplitudes of a usual gear.
    """

    share: float
    amplitudes: float

    @property
    def of_spring(self) -> bool:
        """Whether no gear does so much."""
        return self.share > SHARE and self.amplitudes > AMPLITUDES


@dataclasses.dataclass(frozen=True, eq=False)
class Weighed:
    """What the weight does at joints that a spring could help.

    Attributes:
        state: All readings' state, of the null model.
        sag: Joint -> (m,) by how much the weight turns it, about its mean, rad, at the compliance that is believed: a
            recording at rest shows deflections, whatever compliance the null model makes of them.
    """

    state: State
    sag: dict[int, Float1D]

    @staticmethod
    def of(model: NullModel) -> Weighed:
        """Return what the weight does; nothing where masses are unknown."""
        state = model.state
        torque = {j: model.believed[j] * state.gravity_torque[j] for j in carriers(state)}
        return Weighed(state, {joint: one - one.mean() for joint, one in torque.items() if np.ptp(one) > 0})

    def by(self, trial: Trial) -> tuple[Relief, ...]:
        """Return what a hypothesis, with all accepted ones of its effect, takes off each joint that it moves."""
        found = (self._at(trial, joint) for joint in self.sag)
        return tuple(one for one in found if one is not None)

    def _at(self, trial: Trial, joint: int) -> Relief | None:
        state, offered, sag = self.state, trial.field.offered, self.sag[joint]
        several = (offered.hypotheses[i] for i in (*trial.accepted, trial.index))
        members = {k for one in several if one.effect == trial.hypothesis.effect for k in one.members}
        own = sorted(k for k in members if offered.candidates[k].location["joint"] == state.chain.joints[joint])
        if not own:
            return None
        value = trial.posterior(own)[0] * np.concatenate([typical_sizes(offered.candidates[k]) for k in own])
        movement = np.concatenate([offered.candidates[k].columns(state) for k in own], axis=2) @ value
        unit = state.joint_column(joint, np.ones(state.m))
        turned = np.sum(movement * unit, axis=1) / np.sum(unit**2, axis=1)
        share = -float(turned @ sag) / float(sag @ sag)
        amplitude = share * np.sqrt(2) * float(np.std(sag))
        return Relief(share, amplitude / typical("transmission_error", state.rated_load))


def without_springs(trial: Trial) -> Trial:
    """Return the hypothesis beside the accepted ones that are no springs: what it would be in their stead."""
    hypotheses = trial.field.offered.hypotheses
    kept = [k for k, i in enumerate(trial.accepted) if hypotheses[i].effect != SPRING]
    if len(kept) == len(trial.accepted):
        return trial
    size = trial.sizes.size[[*kept, -1]]
    size[-1] = max(size[-1], AMPLITUDES)  # beside a spring little is left for it
    sizes = dataclasses.replace(trial.sizes, size=size)
    accepted = tuple(trial.accepted[k] for k in kept)
    seen = beside(trial.field.gram, trial.field.blocks(accepted), dataclasses.replace(sizes, size=size[:-1]))
    return dataclasses.replace(trial, accepted=accepted, sizes=sizes, seen=lambda: seen)
