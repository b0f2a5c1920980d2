"""A spring beside a joint whose other effects hide it, because they feel what it leaves of the joint's torque.

While a spring is not in the model, a law of the same joint is written for the whole torque: the two together fit worse
than the waves and the posture-dependent stiffness that imitate them one by one.  So where several effects share a joint
beside which a spring could act, the search is made once more about that spring (`estimate.py`).
"""

from __future__ import annotations

import numpy as np

from calibration_core.estimation.hypotheses import typical_sizes
from calibration_core.estimation.search import Search, Selection
from calibration_core.estimation.springs.compensator_geometry import IMITATING, SPRING
from calibration_core.model.effects.side_torques import Acting

ALIKE = 0.75  # share of what all effects of the joint explain, in nats, that a spring must explain alone


def spring_in_question(search: Search, selection: Selection) -> Acting:
    """Return the spring that explains most of what several effects of one joint explain, and its size; else nothing."""
    hypotheses, candidates = search.field.offered.hypotheses, search.field.offered.candidates
    at_joint: dict[object, list[int]] = {}
    for i in selection.accepted:
        if set(hypotheses[i].location) == {"joint"}:
            at_joint.setdefault(hypotheses[i].location["joint"], []).append(i)
    for joint, several in at_joint.items():
        effects = {hypotheses[i].effect for i in several}
        if len(effects) < 2 or SPRING in effects or not effects & IMITATING:
            continue
        others = tuple(i for i in selection.accepted if i not in several)
        springs = [
            i for i in search.judged if hypotheses[i].effect == SPRING and hypotheses[i].location["joint"] == joint
        ]
        explained = search.sizes(selection.accepted).value - search.sizes(others).value
        for index in sorted(springs, key=lambda i: -search.score(others, i)[0]):
            if search.score(others, index)[0] < ALIKE * explained:
                break
            trial = search.trial(others, index)
            if not search.objection(trial):
                (member,) = hypotheses[index].members
                value = trial.posterior((member,))[0] * typical_sizes(candidates[member])
                return ((candidates[member], np.asarray(value)),)
    return ()
