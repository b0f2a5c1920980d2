"""From accepted candidates on absolute positions to findings in words."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from calibration_core.diagnosis.absolute_design import PRIOR_WIDTH, AbsoluteDesign, unweighted, weighted
from calibration_core.diagnosis.absolute_evidence import evidence
from calibration_core.diagnosis.absolute_fit import AbsoluteExtended
from calibration_core.diagnosis.absolute_selection import AbsoluteSelection, Control
from calibration_core.diagnosis.blocks import Blocks
from calibration_core.diagnosis.finding import Alternative, Finding, FoundParameter
from calibration_core.diagnosis.left_out import block_squares, left_out
from calibration_core.model.effects import catalogue
from calibration_core.model.effects.candidate import Candidate
from calibration_core.model.effects.transmission_error import order_of
from calibration_core.timeseries import Float1D, Float2D

LISTED = 5
EQUIVALENT = 5.0  # nats
PLAUSIBLE = 6.0  # typical sizes
WAVE = "transmission_error"


def absolute_findings(
    extended: AbsoluteExtended,
    design: AbsoluteDesign,
    selection: AbsoluteSelection,
    partitions: Sequence[Blocks],
    control: Control,
) -> tuple[Finding, ...]:
    """Return one finding per effect and place, largest effect on the measured points first.

    Args:
        extended: The fit of everything accepted, in the order of `selection.accepted`.
        design: The search's linear model.
        selection: What was accepted.
        partitions: Of the design's readings.
        control: As in the selection; what it refuses is no alternative.
    """
    chosen = [i for i in selection.accepted if design.candidates[i].family != "anomaly"]
    found = []
    for place in dict.fromkeys(design.candidates[i].place for i in chosen):
        members = [i for i in chosen if design.candidates[i].place == place]
        positions = [selection.accepted.index(i) for i in members]
        score = sum(selection.scores[p] for p in positions)
        first = design.candidates[members[0]]
        magnitude = float(np.sqrt(np.mean(np.sum(own_shift(extended, positions) ** 2, axis=1))))
        gain = _gain(design, selection.accepted, members, partitions[0])
        near = equivalents(design, selection.accepted, members, partitions, control)
        alternatives = tuple(_alternative(design.candidates[i], nats) for i, nats in near)
        found.append(
            Finding(
                effect=first.effect,
                family=first.family,
                location=dict(first.location),
                variant="; ".join(design.candidates[i].variant for i in members),
                parameters=_parameters(extended, positions),
                log_bayes_factor=score,
                held_out_gain=gain,
                magnitude=magnitude,
                cannot_be_told_from=alternatives,
                stiffness_change={},
                explanation=_explanation(extended, positions, score, gain, magnitude, alternatives),
                separate_by=_separate(first, alternatives),
            )
        )
    return tuple(sorted(found, key=lambda finding: -finding.magnitude))


def own_shift(extended: AbsoluteExtended, positions: Sequence[int]) -> Float2D:
    """Return (m, 3) m: what effects move the points beyond what frames and geometry would take up instead."""
    total = sum(len(candidate.parameters) for candidate in extended.candidates)
    count = extended.columns.shape[1] - total
    shift = extended.shift(extended.state, positions)
    null = extended.columns[:, :count]
    white = weighted(extended.problem, extended.parameters, shift[:, :, None])[:, 0]
    white = white - null @ np.linalg.lstsq(null, white, rcond=1e-9)[0]
    return unweighted(extended.problem, extended.parameters, white)


def _parameters(extended: AbsoluteExtended, positions: Sequence[int]) -> tuple[FoundParameter, ...]:
    """Return the parameters; of a harmonic its order, amplitude and phase."""
    several = len(positions) > 1
    found: list[FoundParameter] = []
    for number, position in enumerate(positions, start=1):
        candidate = extended.candidates[position]
        value, covariance = extended.values_of(position)
        suffix = f"_{number}" if several else ""
        if candidate.effect == WAVE:
            found += _wave(order_of(candidate.variant), value, covariance, suffix)
            continue
        std = np.sqrt(np.diag(covariance))
        found += [
            FoundParameter(p.name + suffix, float(p.sign * v), float(s), p.unit)
            for p, v, s in zip(candidate.parameters, value, std, strict=True)
        ]
    return tuple(found)


def _wave(order: int, value: Float1D, covariance: Float2D, suffix: str) -> list[FoundParameter]:
    """Return A and phi of s sin x + c cos x = A sin(x + phi), with standard deviations to first order."""
    amplitude = float(np.hypot(*value))
    along = value / amplitude
    across = np.array([-along[1], along[0]])
    spread = float(np.sqrt(along @ covariance @ along))
    turn = float(np.sqrt(across @ covariance @ across)) / amplitude
    return [
        FoundParameter(f"harmonic{suffix}", float(order), 0.0, "1"),
        FoundParameter(f"amplitude{suffix}", amplitude, spread, "rad"),
        FoundParameter(f"phase{suffix}", float(np.arctan2(value[1], value[0])), turn, "rad"),
    ]


def _gain(design: AbsoluteDesign, accepted: tuple[int, ...], members: Sequence[int], partition: Blocks) -> float:
    without = tuple(i for i in accepted if i not in members)
    before, after = (
        float(block_squares(left_out(design.of(chosen), design.residual, partition), partition).sum())
        for chosen in (without, accepted)
    )
    return 1 - after / before


def equivalents(
    design: AbsoluteDesign,
    accepted: tuple[int, ...],
    members: Sequence[int],
    partitions: Sequence[Blocks],
    control: Control,
) -> tuple[tuple[int, float], ...]:
    """Return other places that explain the data as well as a finding of one term; of several terms none can.

    Args:
        design: The search's linear model.
        accepted: Everything in the model.
        members: Those of one finding.
        partitions: Of the design's readings.
        control: What it refuses is no alternative.

    Returns:
        Index of the candidate and its log Bayes factor, nats; at most five, nearest first.
    """
    if len(members) > 1:
        return ()
    index = members[0]
    others = tuple(i for i in accepted if i != index)
    scores = evidence(design, others, partitions, dict.fromkeys((p.kind for p in partitions), 0.0), index)
    scale = min(scores.weakest(index) / scores.plain[index], 1.0) if scores.plain[index] > 0 else 1.0
    best: dict[object, tuple[int, float]] = {}
    for i in np.argsort(-scores.plain, kind="stable"):
        candidate = design.candidates[int(i)]
        behind = scale * float(scores.plain[index] - scores.plain[i])
        if behind > EQUIVALENT or len(best) == LISTED:
            break
        if candidate.place == design.candidates[index].place or candidate.place in best:
            continue
        if _plausible(design, others, int(i)) and not control(design, others, int(i)):
            best[candidate.place] = int(i), scores.weakest(index) - behind
    return tuple(best.values())


def _alternative(candidate: Candidate, score: float) -> Alternative:
    return Alternative(candidate.effect, candidate.family, dict(candidate.location), score)


def _plausible(design: AbsoluteDesign, others: tuple[int, ...], index: int) -> bool:
    own = design.columns[:, design.blocks[index]]
    value = np.linalg.lstsq(np.column_stack([design.of(others), own]), design.residual, rcond=1e-9)[0][-own.shape[1] :]
    return bool(np.sqrt(np.mean((PRIOR_WIDTH * value) ** 2)) <= PLAUSIBLE)


def _explanation(
    extended: AbsoluteExtended,
    positions: Sequence[int],
    score: float,
    gain: float,
    magnitude: float,
    alternatives: Sequence[Alternative],
) -> str:
    candidate = extended.candidates[positions[0]]
    effect = next(effect for effect in catalogue() if effect.name == candidate.effect)
    words = candidate.effect.replace("_", " ")
    place = ", ".join(str(value) for value in candidate.location.values())
    text = (
        f"{words[0].upper() + words[1:]} at {place} ({effect.equation}) moves the measured points by "
        f"{1e6 * magnitude:.0f} µm rms beyond what frames and geometry take up, and saves {100 * gain:.0f} % of the "
        f"squared error on blocks of configurations left out (log Bayes factor {score:.0f})."
    )
    if candidate.effect == WAVE:
        terms = [(order_of(extended.candidates[p].variant), extended.values_of(p)[0]) for p in positions]
        listed = ", ".join(f"{k} per revolution: {1e3 * np.hypot(*value):.2f} mrad" for k, value in terms)
        text += f" Terms: {listed}.{_resolution(extended, candidate)}"
    if candidate.relative(extended.state):
        text += " Its size is relative: the robot's masses are guesses or not known."
    if alternatives:
        names = "; ".join(
            f"{a.effect.replace('_', ' ')} at {', '.join(str(v) for v in a.location.values())}" for a in alternatives
        )
        text += f" This recording cannot tell it from: {names}."
    return text


def _resolution(extended: AbsoluteExtended, candidate: Candidate) -> str:
    """Say how well the range of the joint's angles separates orders."""
    joint = extended.state.chain.joints.index(str(candidate.location["joint"]))
    span = float(np.ptp(extended.state.q[:, joint]))
    apart = 2 * np.pi / span
    if apart < 1:
        return ""
    return f" The joint turned through {span:.1f} rad: orders closer than {apart:.0f} cannot be told apart."


def _separate(candidate: Candidate, alternatives: Sequence[Alternative]) -> str:
    reveal = {effect.name: effect.reveal for effect in catalogue()}
    names = dict.fromkeys([candidate.effect, *(a.effect for a in alternatives)])
    return "; ".join(f"{name.replace('_', ' ')}: {reveal[name]}" for name in names)
