"""Which hypotheses are forms of one cause: the same family at the same joint, or at neighbouring parts."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from calibration_core.estimation.hypotheses import LAW
from calibration_core.model.effects import effects_with
from calibration_core.model.effects.candidate import Candidate, link_name
from calibration_core.model.effects.structure import pose_dependent_stiffness
from calibration_core.model.effects.traits import Trait

TOOL = 1 << 20  # beyond the last joint
# What is confounded with something found is the same cause under another form where it is this much weaker.
CONFOUNDED_SHARE = 0.15
# Under load, what a joint's law of another shape than the catalogue's leaves is weaker than the law, and seldom sure.
LEFT_SHARE, SURE = 0.45, 30.0  # of the law's evidence; nats
BY_ANGLE = pose_dependent_stiffness.EFFECT.name


def are_confounded(first: Candidate, second: Candidate, joints: Sequence[str]) -> bool:
    """Say whether two candidates could be one cause under two laws.

    Joint laws: the same joint, both with memory or both without.  Structure: the same or neighbouring parts.  Load
    chain and point chain: always.  What a law with memory leaves goes on in time, as a drift does.

    Args:
        first: A candidate.
        second: Another.
        joints: Names of the robot's joints, from the base on.
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
