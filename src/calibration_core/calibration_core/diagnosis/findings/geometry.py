"""One joint's geometry that stands out: where absolute positions put it far from the cell file, or a given model.

Geometry is refitted before anything else, so it spoils no other finding; but the simulation has it wrong.  Every frame
is a little off, in some cells all by more than in others, and no finding: the fitted corrections g of all joints are
held against

    g ~ N(0, S + A U A^T),    U = diag((c u)^2, (d w)^2) for every frame,

S how well they are known, A how the distinguishable corrections answer to an error of any frame, u and w what a
cell set up with care leaves of lengths and of angles, c and d how much better or worse this cell is throughout.  A
finding is the frame before one joint, or one joint's zero, that makes g more probable; with and without it c and d are
taken where they suit best.  The threshold is what the best hypothesis exceeds in 1 % of cells in which no joint stands
out (parametric bootstrap).
Source: Kass and Raftery 1995; Westfall and Young 1993 (distribution of the maximum).
"""

from __future__ import annotations

import dataclasses
import itertools
from collections.abc import Sequence

import numpy as np

from calibration_core.diagnosis.result.finding import Alternative, Finding, found_parameters
from calibration_core.estimation.leave_out import RIDGE
from calibration_core.estimation.refit import Extended
from calibration_core.estimation.rows import null_columns, unweighted
from calibration_core.estimation.springs import SPRING
from calibration_core.identification.geometry.terms import CORRECTIONS, GeometryTerm, names_of
from calibration_core.identification.statistics import rms_length
from calibration_core.model.effects import effect_named
from calibration_core.model.effects.absolute.geometry_error import VARIANTS, frame_error
from calibration_core.model.effects.absolute.joint_zero_offset import EFFECT, zero_offset
from calibration_core.model.effects.candidate import Candidate, typical
from calibration_core.model.effects.words import listed_location
from calibration_core.model.parameters import ModelParameters
from calibration_core.policy import EQUIVALENT, FALSE_ALARM, LISTED, PLAUSIBLE, PRIOR_WIDTH
from calibration_core.timeseries import Float1D, Float2D, Int2D

ZERO_OFFSET = EFFECT.name
STEPS = tuple(0.5 * 2.0**k for k in range(9))
LEVELS = tuple(itertools.product(STEPS, STEPS))  # c and d
LEAST = 5.0  # nats: the threshold is never lower
SAMPLES = 500
SEED = 17384
MOST = 3  # joints
ZERO = 5  # which correction of a frame turns about its joint's axis


@dataclasses.dataclass(frozen=True, eq=False)
class Corrections:
    """What was fitted of the geometry.

    Attributes:
        value: (g,) m and rad, fitted minus stated.
        covariance: (g, g).
        answer: (g, 6 n) how they answer to a unit error of every frame, m and rad.
        movement: (3 m, 6 n) weighted movement of the points by those, beyond what tracker and points would take up.
        rated_load: kg.
    """

    value: Float1D
    covariance: Float2D
    answer: Float2D
    movement: Float2D
    rated_load: float


@dataclasses.dataclass(frozen=True, eq=False)
class GeometryFault:
    """One frame, or one zero, that is wrong.

    Attributes:
        rows: Which of the 6 n errors it has.
    """

    candidate: Candidate
    rows: tuple[int, ...]

    def image(self, seen: Corrections) -> Float2D:
        """Return the (g, k) answers to one standard deviation of its prior."""
        return seen.answer[:, self.rows] * self.prior

    @property
    def prior(self) -> Float1D:
        """(k,) standard deviations of its parameters."""
        return PRIOR_WIDTH * np.array([parameter.typical for parameter in self.candidate.parameters])


def geometry_findings(extended: Extended, stated: ModelParameters, gain: float) -> tuple[Finding, ...]:
    """Return the frames and zeros that are off far beyond the others, most evident first.

    Args:
        extended: The fit of frames, geometry and effects.
        stated: Where the cell file, or a given model, puts them.
        gain: Share of the squared error on configurations left out that refitting the geometry saves.
    """
    terms = extended.model.terms
    term = next((term for term in terms if isinstance(term, GeometryTerm)), None)
    if term is None:
        return ()
    seen = corrections(extended, term, stated)
    hypotheses = hypotheses_of(extended.model.state.chain.joints, seen.rated_load)
    accepted: tuple[int, ...] = ()
    found: list[Finding] = []
    while len(accepted) < MOST:
        beside = [hypotheses[index] for index in accepted]
        scores, limit = judged(seen, hypotheses, beside)
        taken = {one.candidate.location["joint"] for one in beside}
        scores[[one.candidate.location["joint"] in taken for one in hypotheses]] = -np.inf
        best = int(np.argmax(scores))
        if scores[best] <= limit:
            break
        found.append(_finding(extended, seen, hypotheses, best, beside, scores, gain))
        accepted = (*accepted, best)
    return tuple(found)


def hypotheses_of(joints: Sequence[str], rated_load: float) -> tuple[GeometryFault, ...]:
    """Return every frame shifted, turned or both, and every zero; rated load in kg."""
    found = []
    for j, name in enumerate(joints):
        for variant, kinds in VARIANTS.items():
            rows = tuple(6 * j + kind for kind in kinds)
            found.append(GeometryFault(frame_error(j, name, rated_load, variant), rows))
        found.append(GeometryFault(zero_offset(j, name, rated_load), (6 * j + ZERO,)))
    return tuple(found)


def corrections(extended: Extended, term: GeometryTerm, stated: ModelParameters) -> Corrections:
    """Return the fitted corrections, their covariance, and how they answer to errors of all frames."""
    model = extended.model
    names = names_of(model.terms)
    first = names.index(term.names[0])
    rows = slice(first, first + len(term.names))
    length = extended.length
    n = len(model.state.chain.joints)
    pairs = tuple((joint, kind) for joint in range(n) for kind in range(6))
    every = GeometryTerm(pairs, tuple(f"{CORRECTIONS[kind]} {joint}" for joint, kind in pairs))
    own_movement, _ = null_columns(model.problem, extended.parameters, [every])
    movement = np.array(extended.whitening(own_movement))
    movement[np.repeat(~model.used, 3)] = 0.0
    right = extended.linear.white.against(movement) / length[:, None]
    solved = np.linalg.solve(extended.gram + np.diag(extended.ridge + RIDGE), right)
    frames = [k for k in range(len(names)) if not rows.start <= k < rows.stop]
    base = extended.gram[np.ix_(frames, frames)] + RIDGE * np.eye(len(frames))
    taken = np.linalg.solve(base, right[frames])
    change = extended.parameters.geometry - stated.geometry
    return Corrections(
        value=np.array([change[pair] for pair in term.chosen]),
        covariance=extended.covariance[rows, rows],
        answer=solved[rows] / length[rows, None],
        movement=own_movement - extended.linear.own.flat[:, frames] @ (taken / length[frames, None]),
        rated_load=model.state.rated_load,
    )


def judged(
    seen: Corrections, hypotheses: Sequence[GeometryFault], beside: Sequence[GeometryFault]
) -> tuple[Float1D, float]:
    """Return log Bayes factors (h,) of the hypotheses beside others, and the threshold, nats."""
    usual = [_covariance(seen, level, beside) for level in LEVELS]
    best = usual[int(np.argmax([_log_densities(seen.value[:, None], covariance)[0] for covariance in usual]))]
    rng = np.random.default_rng(SEED)
    drawn = np.linalg.cholesky(best) @ rng.standard_normal((len(best), SAMPLES))
    values = np.column_stack([seen.value, drawn])
    alike = _alike(hypotheses)
    null = np.full(1 + SAMPLES, -np.inf)
    scores = np.full((len(hypotheses), 1 + SAMPLES), -np.inf)
    for covariance in usual:
        alone, beyond = _with_each(seen, alike, values, covariance)
        np.maximum(null, alone, out=null)
        np.maximum(scores, alone + beyond, out=scores)
    scores -= null
    limit = float(np.quantile(scores[:, 1:].max(axis=0), 1 - FALSE_ALARM))
    return scores[:, 0].copy(), max(limit, LEAST)


def _alike(hypotheses: Sequence[GeometryFault]) -> list[tuple[list[int], Int2D, Float2D]]:
    """Return hypotheses of equally many errors together: their places (c), rows (c, k) and priors (c, k)."""
    counts = [len(one.rows) for one in hypotheses]
    together = ([h for h, count in enumerate(counts) if count == k] for k in sorted(set(counts)))
    return [
        (members, np.array([hypotheses[h].rows for h in members]), np.stack([hypotheses[h].prior for h in members]))
        for members in together
    ]


def _with_each(
    seen: Corrections, alike: Sequence[tuple[list[int], Int2D, Float2D]], values: Float2D, covariance: Float2D
) -> tuple[Float1D, Float2D]:
    """Return the log densities of every column of (g, s) values, and by how much each hypothesis raises them.

    A hypothesis adds B B^T to the covariance L L^T: with Z = L^-1 B and y = L^-1 g the log density rises by
    1/2 y^T Z M^-1 Z^T y - 1/2 log|M|, M = I + Z^T Z (Woodbury).

    Args:
        seen: What was fitted.
        alike: The hypotheses, as `_alike` returns them.
        values: (g, s) m and rad.
        covariance: (g, g) without a hypothesis.

    Returns:
        alone: (s,) nats up to a constant.
        beyond: (h, s) nats.
    """
    white, log_root = _whitened(np.column_stack([values, seen.answer]), covariance)
    y, every = white[:, : values.shape[1]], white[:, values.shape[1] :]
    among, toward = every.T @ every, every.T @ y
    beyond = np.empty((sum(len(members) for members, _, _ in alike), values.shape[1]))
    for members, rows, prior in alike:
        own = among[rows[:, :, None], rows[:, None, :]] * prior[:, :, None] * prior[:, None, :]
        factor = np.linalg.cholesky(np.eye(rows.shape[1]) + own)
        half = np.linalg.solve(factor, toward[rows] * prior[:, :, None])
        lost = np.log(np.diagonal(factor, axis1=1, axis2=2)).sum(axis=1)
        beyond[members] = 0.5 * (half**2).sum(axis=1) - lost[:, None]
    return -0.5 * (y**2).sum(axis=0) - log_root, beyond


def _covariance(seen: Corrections, level: tuple[float, float], present: Sequence[GeometryFault]) -> Float2D:
    """Return the covariance of the fitted corrections, (g, g), at levels of lengths and angles."""
    length = level[0] * typical("registration_geometry_length", seen.rated_load)
    angle = level[1] * typical("registration_geometry_angle", seen.rated_load)
    usual = seen.answer * np.tile(np.repeat([length, angle], 3), seen.answer.shape[1] // 6)
    return np.asarray(seen.covariance + usual @ usual.T + sum(i @ i.T for i in (h.image(seen) for h in present)))


def _log_densities(values: Float2D, covariance: Float2D) -> Float1D:
    """Return the log density of every column of (g, s) values, (s,) nats up to a constant."""
    white, log_root = _whitened(values, covariance)
    return np.asarray(-0.5 * (white**2).sum(axis=0) - log_root)


def _whitened(values: Float2D, covariance: Float2D) -> tuple[Float2D, float]:
    """Return L^-1 of (g, s) values, L L^T being a covariance (g, g), and log|L|."""
    scale = np.sqrt(np.diag(covariance))
    lower = np.linalg.cholesky(covariance / np.outer(scale, scale))
    log_root = float(np.log(np.diag(lower)).sum() + np.log(scale).sum())
    return np.asarray(np.linalg.solve(lower, values / scale[:, None]), dtype=np.float64), log_root


def _level(seen: Corrections, present: Sequence[GeometryFault]) -> tuple[float, float]:
    """Return the levels of lengths and angles that suit best beside some hypotheses."""
    densities = [_log_densities(seen.value[:, None], _covariance(seen, level, present))[0] for level in LEVELS]
    return LEVELS[int(np.argmax(densities))]


def _posterior(seen: Corrections, one: GeometryFault, beside: Sequence[GeometryFault]) -> tuple[Float1D, Float2D]:
    """Return mean (k,) and covariance (k, k) of a hypothesis's parameters, in their units."""
    image, present = one.image(seen), [*beside, one]
    weighed = np.linalg.solve(_covariance(seen, _level(seen, present), present), np.column_stack([seen.value, image]))
    mean, narrower = image.T @ weighed[:, 0], image.T @ weighed[:, 1:]
    return mean * one.prior, (np.eye(len(one.rows)) - narrower) * np.outer(one.prior, one.prior)


def _finding(
    extended: Extended,
    seen: Corrections,
    hypotheses: Sequence[GeometryFault],
    best: int,
    beside: Sequence[GeometryFault],
    scores: Float1D,
    gain: float,
) -> Finding:
    one = hypotheses[best]
    candidate = one.candidate
    mean, covariance = _posterior(seen, one, beside)
    shift = unweighted(extended.model.problem, extended.parameters, seen.movement[:, one.rows] @ mean)
    magnitude = rms_length(shift)
    kind = effect_named(candidate.effect)
    springs = _preload(extended, one, float(scores[best]))
    others = (*springs, *_alternatives(seen, hypotheses, best, beside, scores))[:LISTED]
    place = str(candidate.location["joint"])
    listed = "; ".join(f"{a.effect.replace('_', ' ')} at {listed_location(a.location)}" for a in others)
    confounded = f" This recording cannot distinguish it from: {listed}." if others else ""
    return Finding(
        effect=candidate.effect,
        family=candidate.family,
        location=dict(candidate.location),
        variant=candidate.variant,
        parameters=found_parameters(candidate, mean, covariance),
        log_bayes_factor=float(scores[best]),
        held_out_gain=gain,
        magnitude=magnitude,
        cannot_be_told_from=others,
        explanation=(
            f"{candidate.effect.replace('_', ' ').capitalize()} at {place} ({kind.equation}): the absolute positions "
            f"put it elsewhere than stated, far beyond the frames of the other joints; stated as it is, it moves the "
            f"measured points by {1e6 * magnitude:.0f} µm rms that neither tracker nor points take up. It was refitted "
            f"before anything else; refitting the geometry saves {100 * gain:z.0f} % of the squared error on "
            f"configurations left out.{confounded}"
        ),
        separate_by=kind.reveal,
    )


def _preload(extended: Extended, one: GeometryFault, score: float) -> tuple[Alternative, ...]:
    """Return the spring found beside a joint whose zero is off: at rest its mean torque moves the points alike."""
    springs = (part.candidate for part in extended.parts if part.candidate.effect == SPRING)
    if extended.model.state.loaded or one.candidate.effect != ZERO_OFFSET:
        return ()
    there = {s.place: s for s in springs if s.location == one.candidate.location}
    return tuple(Alternative(s.effect, s.family, dict(s.location), score) for s in there.values())


def _alternatives(
    seen: Corrections,
    hypotheses: Sequence[GeometryFault],
    best: int,
    beside: Sequence[GeometryFault],
    scores: Float1D,
) -> tuple[Alternative, ...]:
    """Return other places that come within five nats at a plausible size, best first."""
    found: dict[object, Alternative] = {}
    for index in np.argsort(-scores, kind="stable"):
        one = hypotheses[index].candidate
        if scores[index] < scores[best] - EQUIVALENT or len(found) == LISTED:
            break
        if one.place == hypotheses[best].candidate.place or one.place in found:
            continue
        mean, _ = _posterior(seen, hypotheses[index], beside)
        if np.sqrt(np.mean((PRIOR_WIDTH * mean / hypotheses[index].prior) ** 2)) <= PLAUSIBLE:
            found[one.place] = Alternative(one.effect, one.family, dict(one.location), float(scores[index]))
    return tuple(found.values())
