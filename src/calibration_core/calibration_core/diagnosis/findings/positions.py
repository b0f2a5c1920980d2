"""From accepted hypotheses to findings in words: one per effect and place, a family as one finding with its joints."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from calibration_core.diagnosis.result.finding import (
    OF_ANY_LAW,
    UNSETTLED,
    Alternative,
    Finding,
    FoundParameter,
    by_size,
    confounded_with,
    evidence_words,
    found_parameters,
    opening,
    separating,
)
from calibration_core.estimation.alternatives import BY_ANGLE, CONFOUNDED_SHARE, equivalents, other_places
from calibration_core.estimation.estimate import Estimate
from calibration_core.estimation.hypotheses import ALL, LAW, WAVE, Hypothesis
from calibration_core.estimation.refit import Extended
from calibration_core.estimation.shifts import FAMILY
from calibration_core.estimation.springs import SPRING
from calibration_core.identification.statistics import rms_length
from calibration_core.model.effects import effects_with, sizes_are_relative
from calibration_core.model.effects.absolute import approach_direction
from calibration_core.model.effects.candidate import Trait, number_of
from calibration_core.model.effects.structure.gravity_compensator import OPEN
from calibration_core.policy import LISTED
from calibration_core.timeseries import Float1D, Float2D

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

    Such a thing is far weaker than the law itself, as of loaded steps (`evidence/design.py`).
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


# --- from accepted hypotheses to findings in words --------------------------------------------------------------------


PRELOAD = (
    " At rest a zero offset of {joint} moves the points as the mean torque of a spring does: the two hide each other."
)
SEVERAL = 6  # terms that are listed one by one


def position_findings(found: Estimate) -> tuple[Finding, ...]:
    """Return one finding per effect and place, largest effect on the measured points first."""
    hypotheses = found.offered.hypotheses
    physics = [i for i in found.selection.accepted if hypotheses[i].family != FAMILY]
    gained = dict(zip(found.selection.accepted, found.selection.gain, strict=True))
    several = causes(hypotheses, {i: gained[i] for i in physics})
    return by_size(_finding(found, members) for members in several)


def _finding(found: Estimate, members: list[int]) -> Finding:
    hypotheses, selection, extended = found.offered.hypotheses, found.selection, found.extended
    gained = dict(zip(selection.accepted, selection.gain, strict=True))
    members = sorted(members, key=lambda i: (hypotheses[i].family != LAW, -gained[i]))  # the law explains the rest
    first = hypotheses[members[0]]
    of_first = [i for i in members if hypotheses[i].place == first.place]
    parts = sorted({part for i in members for part in found.members[i]})
    reported = sorted({part for i in of_first for part in found.members[i]})
    score = float(sum(gained[i] for i in members))
    gain = max(selection.proofs[selection.accepted.index(i)][0].share for i in members)
    magnitude = rms_length(extended.own_shift(parts))
    if len(members) == 1:
        as_well = other_places(found.search, selection, members[0])[:LISTED]
    else:
        as_well = equivalents(found.search, selection, members)
    instead = [(hypotheses[i], nats) for i, nats in as_well]
    listed = tuple(Alternative(h.effect, h.family, dict(h.location), nats) for h, nats in instead)
    laws = [i for i in members if hypotheses[i].family == LAW]
    left = any(hypotheses[i].effect in LEFT - {FROM_WHERE} and hypotheses[i].place != first.place for i in members)
    known = first.family != LAW or (len(laws) == 1 and not _other_law(found, laws[0]))
    settled = known and not left and first.variant != OPEN
    size = float(selection.sizes.size[selection.accepted.index(members[0])])
    unit = extended.parts[reported[0]].candidate.parameters[0]
    shared = FoundParameter("shared_size", size * unit.typical, 0.0, unit.unit)
    return Finding(
        effect=first.effect,
        family=first.family,
        location=dict(first.location),
        variant="; ".join(hypotheses[i].variant for i in of_first),
        parameters=_parameters(extended, reported, everywhere=first.everywhere),
        log_bayes_factor=score,
        held_out_gain=gain,
        magnitude=magnitude,
        explanation=_explanation(found, first, reported, score, gain, magnitude, listed, settled=settled),
        separate_by=separating([first.effect, *(one.effect for one in listed)]),
        cannot_be_told_from=listed,
        refinements=tuple(f"{hypotheses[i].effect} ({hypotheses[i].variant})" for i in members if i not in of_first),
        law_settled=settled,
        shared_size=shared if len(first.members) > 1 else None,
    )


def _other_law(found: Estimate, index: int) -> bool:
    """Say whether beside the accepted law another law of the same joint still asks to be let in."""
    search, one = found.search, found.offered.hypotheses[index]
    gain = search.scores(found.selection.accepted).nats
    for i, k in search.place.items():
        other = found.offered.hypotheses[i]
        same = other.family == LAW and other.location.get("joint") == one.location.get("joint")
        if same and i not in found.selection.accepted and gain[k] > search.limit:
            return True
    return False


def _parameters(extended: Extended, parts: Sequence[int], *, everywhere: bool) -> tuple[FoundParameter, ...]:
    """Return the parameters; of a few harmonics order, amplitude and phase, of many the rms per joint."""
    several = len(parts) > 1
    waves = [k for k in parts if extended.parts[k].candidate.effect == WAVE]
    found: list[FoundParameter] = []
    if len(waves) > SEVERAL:
        by_joint: dict[str, list[int]] = {}
        for k in waves:
            by_joint.setdefault(str(extended.parts[k].candidate.location["joint"]), []).append(k)
        names = {joint: f"rms_error {joint}" if everywhere else "rms_error" for joint in by_joint}
        every = (_rms(extended, some, names[joint]) for joint, some in by_joint.items())
        return tuple(sorted(every, key=lambda p: -p.value))
    for number, k in enumerate(parts, start=1):
        candidate = extended.parts[k].candidate
        value, covariance = extended.values_of(k)
        suffix = f" {candidate.location['joint']}" if everywhere else f"_{number}" if several else ""
        if candidate.effect == WAVE:
            found += _wave(number_of(candidate), value, covariance, suffix)
            continue
        found += found_parameters(candidate, value, covariance, suffix)
    if everywhere:
        found.sort(key=lambda p: -abs(p.value))
    return tuple(found)


def _rms(extended: Extended, waves: Sequence[int], name: str) -> FoundParameter:
    """Return the root mean square over a revolution of a joint's error, all its orders together, rad."""
    index = np.concatenate([np.arange(extended.block(k).start, extended.block(k).stop) for k in waves])
    value = extended.value[index]
    length = float(np.linalg.norm(value))
    along = value / max(length, 1e-300)
    wide = extended.flat + index
    spread = float(np.sqrt(along @ extended.covariance[np.ix_(wide, wide)] @ along))
    return FoundParameter(name, length / 2**0.5, spread / 2**0.5, "rad")


def _wave(order: int, value: Float1D, covariance: Float2D, suffix: str) -> list[FoundParameter]:
    """Return A and phi of s sin x + c cos x = A sin(x + phi), with standard deviations to first order."""
    amplitude = float(np.hypot(*value))
    along = value / max(amplitude, 1e-300)
    across = np.array([-along[1], along[0]])
    spread = float(np.sqrt(along @ covariance @ along))
    turn = float(np.sqrt(across @ covariance @ across)) / max(amplitude, 1e-300)
    return [
        FoundParameter(f"harmonic{suffix}", float(order), 0.0, "1"),
        FoundParameter(f"amplitude{suffix}", amplitude, spread, "rad"),
        FoundParameter(f"phase{suffix}", float(np.arctan2(value[1], value[0])), turn, "rad"),
    ]


def _explanation(
    found: Estimate,
    first: Hypothesis,
    parts: Sequence[int],
    score: float,
    gain: float,
    magnitude: float,
    alternatives: Sequence[Alternative],
    *,
    settled: bool,
) -> str:
    extended = found.extended
    everywhere = first.location.get("joints") == ALL
    shared = ", with one size that they share" if everywhere else ""
    text = (
        f"{opening(first.effect, first.location, shared)}. This moves the measured points by "
        f"{1e6 * magnitude:.0f} µm rms beyond what frames and geometry take up, and saves {100 * gain:z.0f} % of the "
        f"squared error on blocks of configurations left out; {evidence_words(score)}."
    )
    if first.effect == WAVE and len(parts) <= SEVERAL:
        terms = [(number_of(extended.parts[k].candidate), extended.values_of(k)[0]) for k in parts]
        listed = ", ".join(f"{k} per revolution: {1e3 * np.hypot(*value):.2f} mrad" for k, value in terms)
        text += f" Terms: {listed}.{_resolution(found, first)}"
    if sizes_are_relative(found.offered.candidates[first.members[0]], extended.model.state):
        text += " Its size is relative: the robot's masses are guesses or not known."
    if not settled:
        text += OF_ANY_LAW if first.variant == OPEN else UNSETTLED
    if first.effect == SPRING and not extended.model.state.loaded:
        text += PRELOAD.format(joint=first.location["joint"])
    return text + confounded_with(alternatives)


def _resolution(found: Estimate, first: Hypothesis) -> str:
    """Say how well the range of the joint's angles separates orders."""
    state = found.extended.model.state
    span = float(np.ptp(state.q[:, state.chain.joints.index(str(first.location["joint"]))]))
    apart = 2 * np.pi / span
    if apart < 1:
        return ""
    return f" The joint turned through {span:.1f} rad: orders closer than {apart:.0f} cannot be distinguished."
