"""Which hypotheses are forms of one cause: the same family at the same joint, or at neighbouring parts.

The law of what was accepted is known to a share only, and what is confounded with it may hold the rest.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from calibration_core.estimation.field import Accepted
from calibration_core.estimation.hypotheses import LAW
from calibration_core.estimation.likelihood.small_effects import visible
from calibration_core.estimation.search import Search
from calibration_core.model.effects import effects_with
from calibration_core.model.effects.candidate import Candidate, Trait, link_name
from calibration_core.model.effects.structure import pose_dependent_stiffness
from calibration_core.timeseries import Float1D

TOOL = 1 << 20  # beyond the last joint
# What is confounded with something found is the same cause under another form where it is this much weaker.
CONFOUNDED_SHARE = 0.15
# Under load, what a joint's law of another shape than the catalogue's leaves is weaker than the law, and seldom sure.
LEFT_SHARE, SURE = 0.45, 30.0  # of the law's evidence; nats
KNOWN = 0.15  # share to which the law of an effect is known
BY_ANGLE = pose_dependent_stiffness.EFFECT.name


def are_confounded(first: Candidate, second: Candidate, joints: Sequence[str]) -> bool:
    """Say whether two candidates could be one cause under two laws.

    Joint laws: the same joint, both with memory or both without.  Structure: the same or neighbouring parts.  Load
    chain and point chain: always.  What a law with memory leaves goes on in time, as a drift does.
    """
    effects, memory = {first.effect, second.effect}, effects_with(Trait.MEMORY)
    if effects & memory and effects & effects_with(Trait.DRIFT):
        return True
    if first.family != second.family:
        return False
    if first.family in {"load chain", "point chain"}:
        return True
    if first.family == LAW and (first.effect in memory) != (second.effect in memory):
        return False
    reach = 0 if first.family == LAW else 1
    return any(abs(i - j) <= reach for i in parts(first.location, joints) for j in parts(second.location, joints))


def same_deflection(first: Candidate, second: Candidate) -> bool:
    """Say whether two candidates describe how one joint deflects about its own axis.

    Where the true law has another shape than the catalogue's, such a candidate takes up what that of the joint leaves.
    """
    own = all(one.family == LAW or one.effect == BY_ANGLE for one in (first, second))
    return own and first.location == second.location


def strongest_first(search: Search, accepted: Accepted, joints: Sequence[str]) -> Accepted:
    """Return accepted hypotheses, of several laws that are one cause at a joint the strongest before the others.

    Each of them gains little beside the others: which one is the cause shows what its forms gain without them.
    """
    offered, ordered = search.field.offered, list(accepted)
    laws = ((i, offered.hypotheses[i]) for i in accepted)
    of_joints = {i: offered.candidates[one.members[0]] for i, one in laws if one.is_law_of_a_joint}
    for own in of_joints.values():
        alike = (i for i, one in of_joints.items() if one.location == own.location and are_confounded(own, one, joints))
        forms = sorted(alike, key=ordered.index)
        if len({of_joints[i].effect for i in forms}) > 1:
            law = search.strongest_law(tuple(i for i in accepted if i not in forms), own.location)
            first = next((i for i in forms if of_joints[i].effect == offered.hypotheses[law].effect), forms[0])
            place = ordered.index(forms[0])
            ordered.remove(first)
            ordered.insert(place, first)
    return tuple(ordered)


def parts(location: Mapping[str, str | tuple[str, ...]], joints: Sequence[str]) -> tuple[int, ...]:
    """Return the numbers of the joints, from 1, between which a place lies; the base is before the first joint."""
    if "base" in location:
        return (0, 1)
    if "tool" in location:
        return (TOOL,)
    if "link" in location:
        links = [link_name(index) for index in range(len(joints))]
        number = 1 + links.index(str(location["link"]))
        return (number, number + 1)
    names = location.get("joints", location.get("joint", ()))
    return tuple(1 + joints.index(name) for name in ((names,) if isinstance(names, str) else names))


def lent(search: Search, accepted: Accepted, index: int, joints: Sequence[str]) -> Float1D:
    """Return the signal-to-noise ratios, (c,), that an accepted hypothesis lends to what is confounded with it."""
    others = tuple(i for i in accepted if i != index)
    without_small_effects = search.fitted(others)[:1]
    seen = visible(without_small_effects, search.field.blocks((index,))[0])[1]
    candidates = search.field.offered.candidates
    own = candidates[search.field.offered.hypotheses[index].members[0]]
    return np.array([KNOWN * seen * are_confounded(own, one, joints) for one in candidates])
