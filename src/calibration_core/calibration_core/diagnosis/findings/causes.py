"""Which hypotheses that a search of positions accepted are one cause: forms of one law, and what that law leaves."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from calibration_core.estimation.alternatives.confounding import BY_ANGLE, CONFOUNDED_SHARE
from calibration_core.estimation.hypotheses import LAW, WAVE, Hypothesis
from calibration_core.estimation.springs.compensator_geometry import SPRING
from calibration_core.model.effects import effects_with
from calibration_core.model.effects.absolute import approach_direction
from calibration_core.model.effects.candidate import Trait

LOW = 8  # orders of waves that are a gear's, whatever else its joint does
FROM_WHERE = approach_direction.EFFECT.name
LEFT = frozenset({BY_ANGLE, WAVE, FROM_WHERE})


def causes(hypotheses: Sequence[Hypothesis], gained: Mapping[int, float]) -> list[list[int]]:
    """Join accepted hypotheses to causes."""
    lags = effects_with(Trait.LAG)
    lagging = {hypotheses[i].location.get("joint") for i in gained if hypotheses[i].effect in lags} - {None}
    groups: dict[object, list[int]] = {}
    for index in gained:
        one = hypotheses[index]
        joint = one.location.get("joint")
        way = one.effect == FROM_WHERE or _is_high(one)
        law = joint is not None and (one.family == LAW or (way and joint in lagging))
        cause = (LAW, joint) if law else _arrival(hypotheses, gained, index) or one.place
        groups.setdefault(cause, []).append(index)
    return _with_what_is_left(hypotheses, gained, list(groups.values()))


def _is_high(one: Hypothesis) -> bool:
    """Say whether a hypothesis is a single wave of high order.

    A joint that lags under changing loads lags on the way to a posture, too: it stands elsewhere by the direction from
    which it came, and posture by posture elsewhere, which such waves take up.
    """
    return one.effect == WAVE and isinstance(one.shape, int) and one.shape > LOW


def _arrival(hypotheses: Sequence[Hypothesis], gained: Mapping[int, float], index: int) -> object:
    """Return the place of a far stronger direction of approach of the joint whose high wave this is; None: none is."""
    one = hypotheses[index]
    if not _is_high(one):
        return None
    there = [i for i in gained if hypotheses[i].effect == FROM_WHERE and hypotheses[i].location == one.location]
    return next((hypotheses[i].place for i in there if gained[index] < CONFOUNDED_SHARE * gained[i]), None)


def _with_what_is_left(
    hypotheses: Sequence[Hypothesis], gained: Mapping[int, float], groups: list[list[int]]
) -> list[list[int]]:
    """Join to the law of a joint, or to a spring beside it, what it leaves there because its shape is another.

    Such a thing is far weaker than the law itself, as of loaded steps (`evidence/selection.py`).
    """
    score = {tuple(group): sum(gained[i] for i in group) for group in groups}
    laws = [group for group in score if any(hypotheses[i].family == LAW for i in group)]
    hosts = laws + [group for group in score if hypotheses[group[0]].effect == SPRING]
    joined = {group: list(group) for group in score}
    for group, own in score.items():
        one = hypotheses[group[0]]
        at_joint = [g for g in hosts if hypotheses[g[0]].location.get("joint") == one.location.get("joint")]
        stronger = [g for g in at_joint if own < CONFOUNDED_SHARE * score[g]]
        if stronger and group not in laws and one.effect in LEFT and not one.everywhere:
            joined[stronger[0]] += joined.pop(group)
    return list(joined.values())
