"""How much of the weight at a joint waves or a spring take off: what distinguishes the two.

Both turn the joint by some function of its angle.  A spring is put there to carry the arm: what it does follows the
weight, and is far more than gears are wrong by.

The triangle of a gravity compensator, fitted where one may be.

The catalogue offers a few shapes.  By what the true one differs is a wave over the joint's angle, which a transmission
error of the same joint would explain, and several orders together imitate the whole spring.  The shape is therefore
fitted without such waves and offered as one more hypothesis, which is judged as all others.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable

import numpy as np

from calibration_core.estimation.field import Accepted, Field, Trial
from calibration_core.estimation.hypotheses import WAVE, Hypothesis, typical_sizes
from calibration_core.estimation.likelihood.gains import beside
from calibration_core.estimation.rows import NullModel
from calibration_core.model.effects.candidate import Candidate, typical
from calibration_core.model.effects.state import State
from calibration_core.model.effects.structure import pose_dependent_stiffness
from calibration_core.model.effects.structure.gravity_compensator import (
    EFFECT,
    TURN,
    Triangle,
    carriers,
    pull,
    spring,
)
from calibration_core.timeseries import Float1D, Float2D, Float3D

SPRING = EFFECT.name
LIKE_SPRING = frozenset({SPRING, WAVE, pose_dependent_stiffness.EFFECT.name})  # the latter two imitate one
REACH = 30.0  # degrees about the offered anchor
LEAST, MOST = 0.05, 0.9  # of flatness and preload
SCALE = (5.0, 0.1, 0.1)  # of anchor, flatness and preload
STARTS = 3  # shapes of the catalogue from which the best one is sought
STEPS = 20  # at most, from each


def fit_compensator_geometry(
    field: Field, accepted: Accepted, state: State, weigh: Callable[[Float3D], Float2D]
) -> tuple[Candidate, ...]:
    """Return springs of fitted shape, one for every joint at which a spring or waves were accepted.

    Args:
        field: Rows and hypotheses.
        accepted: What was accepted.
        state: All readings' state.
        weigh: Turns movements (m, 3, k) of all readings into the search's whitened columns (r, k).
    """
    hypotheses = field.offered.hypotheses
    found = []
    for joint in carriers(state):
        name = state.chain.joints[joint]
        there = [i for i in accepted if hypotheses[i].location.get("joint") == name]
        near = [i for i in there if hypotheses[i].effect in LIKE_SPRING]
        if len(near) == 1 and one_wave(hypotheses[near[0]]):
            continue
        if near and any(c.effect == SPRING and c.location["joint"] == name for c in field.offered.candidates):
            others = tuple(i for i in accepted if i not in near)
            found.append(_shape(field, others, state, joint, weigh))
    return tuple(found)


def one_wave(hypothesis: Hypothesis) -> bool:
    """Say whether a hypothesis is one wave, more than once a turn: alone it is no spring, of whatever law."""
    return hypothesis.effect == WAVE and isinstance(hypothesis.shape, int) and hypothesis.shape > 1


def _shape(field: Field, others: Accepted, state: State, joint: int, weigh: Callable[[Float3D], Float2D]) -> Candidate:
    from scipy.optimize import least_squares  # slow to load, and few recordings show a compensator

    basis, residual = _without(field, others)

    def left(x: Float1D) -> Float1D:
        column = weigh(pull(state, joint, Triangle(*x))[:, :, :1])[:, 0]
        column = column - basis @ (basis.T @ column)
        return np.asarray(residual - column * (column @ residual) / max(float(column @ column), 1e-300))

    name = state.chain.joints[joint]
    offered = [c.shape for c in field.offered.candidates if c.effect == SPRING and c.location["joint"] == name]
    turned = [
        _turned(shape, weigh(pull(state, joint, shape)), basis, residual)
        for shape in offered
        if isinstance(shape, Triangle)
    ]
    starts = [start for start, _ in sorted(turned, key=lambda one: one[1])]
    fits = [least_squares(left, x, bounds=_around(x), x_scale=SCALE, max_nfev=STEPS) for x in starts[:STARTS]]
    return spring(state, joint, Triangle(*map(float, min(fits, key=lambda fit: float(fit.cost)).x)))


def _turned(shape: Triangle, columns: Float2D, basis: Float2D, residual: Float1D) -> tuple[Float1D, float]:
    """Return a shape with its anchor where its two columns put it, and the sum of squares that these leave.

    Args:
        shape: As it is offered.
        columns: (r, 2) its torque, and what a turn of the anchor changes in it.
        basis: (r, b) of the null model and other hypotheses.
        residual: (r,) beside them.
    """
    columns = columns - basis @ (basis.T @ columns)
    value, *_ = np.linalg.lstsq(columns, residual, rcond=None)
    by = np.degrees(TURN) * value[1] / value[0] if value[0] else 0.0
    start = np.array([shape.anchor + np.clip(by, -REACH, REACH), shape.flatness, shape.preload])
    return start, float(np.sum((residual - columns @ value) ** 2))


def _without(field: Field, others: Accepted) -> tuple[Float2D, Float1D]:
    """Return a basis of the null model and other hypotheses, (r, b), and the residual beside them, (r,)."""
    index = np.concatenate([np.arange(field.flat_count), *(field.flat_count + block for block in field.blocks(others))])
    wide = field.wide[:, index]
    u, s, _ = np.linalg.svd(wide / np.maximum(np.linalg.norm(wide, axis=0), 1e-300), full_matrices=False)
    basis = u[:, s > 1e-6 * s[0]]
    return basis, field.residual - basis @ (basis.T @ field.residual)


def _around(start: Float1D) -> tuple[list[float], list[float]]:
    return [float(start[0]) - REACH, LEAST, LEAST], [float(start[0]) + REACH, MOST, MOST]


# --- how much of the weight at a joint waves or a spring take off -----------------------------------------------------


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
