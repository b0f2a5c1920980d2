"""What a hypothesis must pass besides likelihood and blocks left out.

Compliances are positive.  Sag under the robot's own weight resembles what geometry and gears do to a posture: it is
believed only if gravity turned by 90 degrees explains far less.  A spring takes weight off its joint; waves that do so,
and are far larger than those of gears, are a spring.  Waves of many orders at all joints follow whatever goes with the
posture where configurations are few: they must say something of configurations left out.  Noise that lasts resembles a
drift, of the tracker or of the sensor.  A step must matter.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence

import numpy as np

from calibration_core.estimation.field import Trial
from calibration_core.estimation.hypotheses import SAG, WAVE, typical_sizes
from calibration_core.estimation.noise.whitening import Whitening
from calibration_core.estimation.rows import NullModel, weighted
from calibration_core.estimation.shifts import FAMILY, MOVED
from calibration_core.estimation.springs import SPRING, Relief, Weighed, one_wave, without_springs
from calibration_core.model.effects import effects_with
from calibration_core.model.effects.absolute.joint_elasticity import turned_columns
from calibration_core.model.effects.candidate import Candidate, Trait, number_of
from calibration_core.model.effects.possible import forbidden, nearest, out_of_bounds
from calibration_core.model.effects.structure.gravity_compensator import OPEN, OPEN_ORDERS
from calibration_core.policy import EQUIVALENT
from calibration_core.timeseries import Float2D, Int1D

COLLAPSED = 1 / 3  # share of the gain that turned gravity may keep
SECOND_ORDER = 5e-3  # of the movement that is accepted: complementary stiffness and turned levers
FOLLOWS = 2.0  # times the noise: waves of all joints that leave more of blocks left out, and
SAVED = 2 / 3  # save less of their squares, follow the readings; other causes may yet be missing beside them
EACH = 3.0  # nats each, on the average: waves that gain more are shown by more than a few readings
LASTING = 3.0  # configurations that noise may share: a drift needs as many times the evidence
CHANCE = 10.0  # nats: more than the best of all gains by chance where the noise does not last
LEAST_STEP = 5e-5  # m; smaller steps are not worth a word
STEP_SHARE = 0.1  # of the squared residual on blocks left out, that a step must explain


@dataclasses.dataclass(frozen=True, eq=False)
class Controls:
    """The controls of one recording.

    Attributes:
        turned: Joint -> (r, 2) whitened columns of sag with gravity turned, per typical size.
        weighed: What the weight does at joints that a spring could help; None: nobody asks for springs.
    """

    turned: dict[str, Float2D]
    weighed: Weighed | None = None

    def __call__(self, trial: Trial) -> str:
        """Return why a hypothesis is refused beside the accepted ones; empty if it is not."""
        one = trial.hypothesis
        if one.family == FAMILY:
            return _small(trial)
        if trial.movement < SECOND_ORDER * trial.movement_of_others:
            return "it is no larger than what second order leaves of larger effects"
        if one.effect in effects_with(Trait.DRIFT):
            return _lasting(trial)
        if one.effect == SPRING:
            return self._as_spring(trial)
        if one.effect == WAVE:
            return self._as_gear(trial) or (_following(trial) if one.everywhere else "")
        return self._turned(trial) if one.effect == SAG else ""

    def _as_spring(self, trial: Trial) -> str:
        others = (trial.field.offered.hypotheses[i] for i in trial.accepted)
        beside_gear = any(one.effect == WAVE and one.location == trial.hypothesis.location for one in others)
        if trial.hypothesis.variant != OPEN and not beside_gear:
            return ""
        for relief in self._relief(trial):
            if not relief.of_spring:
                share = 100 * relief.share
                return f"it would take {share:z.0f} % of the weight off its joint, no more than gears seem to"
        return ""

    def _as_gear(self, trial: Trial) -> str:
        low = min(number_of(trial.field.offered.candidates[k]) for k in trial.hypothesis.members) <= OPEN_ORDERS
        trial = without_springs(trial) if low else trial
        if _beyond_springs(trial):
            return ""
        for relief in self._relief(trial):
            if relief.of_spring:
                return (
                    f"it takes {100 * relief.share:z.0f} % of the weight off its joint, as a spring does, "
                    f"and {relief.amplitudes:.0f} times as much as a gear usually does"
                )
        return ""

    def _relief(self, trial: Trial) -> tuple[Relief, ...]:
        return () if self.weighed is None else self.weighed.by(trial)

    def _turned(self, trial: Trial) -> str:
        joints = [str(trial.field.offered.candidates[k].location["joint"]) for k in trial.hypothesis.members]
        for axis in range(2):  # the first half of the columns is of gravity turned about one axis, the other about two
            halves = (np.split(self.turned[joint], 2, axis=1)[axis] for joint in joints)
            columns = np.concatenate(list(halves), axis=1)
            columns = np.pad(columns, ((0, len(trial.field.residual) - len(columns)), (0, 0)))
            ridge = np.full(columns.shape[1], trial.sizes.variance / float(trial.sizes.size[-1]) ** 2)
            other = trial.field.in_blocks(trial.model().beside(columns, ridge))
            for before, true, false in zip(*trial.left_out, other, strict=True):
                kept = (before - false).sum() / max((before - true).sum(), 1e-12)
                if kept > COLLAPSED:
                    return f"{100 * kept:z.0f} % of its gain remains with gravity turned by 90 degrees"
        return ""


def controls(model: NullModel, rows: Int1D, whitening: Whitening, catalogue: Sequence[Candidate]) -> Controls:
    """Return the controls of some readings of a recording, of what the catalogue offers for it."""
    if model.fitted_compliances:  # sag is part of the null model, no hypothesis
        return Controls({}, Weighed.of(model))
    state, part = model.state.of_rows(rows), model.problem.select(rows)
    typicals = {str(c.location["joint"]): c.parameters[0].typical for c in catalogue if c.effect == SAG}
    joints = ((name, state.chain.joints.index(name)) for name in typicals)
    moved = {name: turned_columns(state, joint) * typicals[name] for name, joint in joints}
    return Controls(
        {name: whitening(weighted(part, model.parameters, one)) for name, one in moved.items()}, Weighed.of(model)
    )


def _beyond_springs(trial: Trial) -> bool:
    """Say whether one wave, more than once a turn, explains as much as any spring of its joint: no spring is one."""
    if not one_wave(trial.hypothesis):
        return False
    several, own = enumerate(trial.field.offered.hypotheses), trial.score(trial.accepted, trial.index)
    springs = (i for i, one in several if one.effect == SPRING and one.location == trial.hypothesis.location)
    return all(own > trial.score(trial.accepted, i) - EQUIVALENT for i in springs)


def _following(trial: Trial) -> str:
    if trial.gain > EACH * len(trial.hypothesis.members):
        return ""
    noise = FOLLOWS**2 * trial.sizes.variance * len(trial.field.residual)
    for after, proof in zip(trial.left_out[1], trial.proofs, strict=True):
        if after.sum() > noise and proof.share < SAVED:
            share = 100 * (1 - proof.share)
            return f"it follows the readings, and leaves {share:z.0f} % of the squared error of those left out"
    return ""


def _small(trial: Trial) -> str:
    mean, _ = trial.posterior(trial.hypothesis.members)
    share = min(one.share for one in trial.proofs)
    enough = share > STEP_SHARE and float(np.linalg.norm(MOVED * mean[:3])) > LEAST_STEP
    return "" if enough else "the step is too small to matter"


def _lasting(trial: Trial) -> str:
    if min(trial.gain, *(one.nats for one in trial.proofs)) > LASTING * CHANCE:
        return ""
    return f"it does not convince where {LASTING:g} configurations in a row may share their noise"


def impossible(trial: Trial) -> str:
    """Return what physics forbids of a hypothesis beside the accepted ones; empty if nothing.

    Compliances are not negative, neither its own nor, because of it, those of the others: what is left of the gain at
    the nearest values that physics allows for all of them together?
    """
    candidates = trial.field.offered.candidates
    own = [k for k in trial.hypothesis.members if any(p.bounded for p in candidates[k].parameters)]
    for k in own:
        sizes = typical_sizes(candidates[k])
        value, spread = trial.posterior([k])
        if why := out_of_bounds(candidates[k].parameters, value * sizes, spread * np.outer(sizes, sizes)):
            return why
    nats = _beyond(trial) - _beyond(trial, alone=True)
    return "a compliance would be negative" if forbidden(nats, trial.gain) else ""


def _beyond(trial: Trial, *, alone: bool = False) -> float:
    """Return by how many nats all hypotheses together, or the accepted ones alone, are beyond what physics allows."""
    offered = trial.field.offered
    chosen = trial.accepted if alone else (*trial.accepted, trial.index)
    members = sorted({k for i in chosen for k in offered.hypotheses[i].members})
    bound = [k for k in members if any(p.positive for p in offered.candidates[k].parameters)]
    if not bound:
        return 0.0
    mean, covariance = trial.posterior(bound, alone=alone)
    sizes = np.concatenate([typical_sizes(offered.candidates[k]) for k in bound])
    several = [offered.candidates[k].parameters for k in bound]
    return nearest(several, mean * sizes, covariance * np.outer(sizes, sizes)).nats
