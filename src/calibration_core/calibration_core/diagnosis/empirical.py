"""An empirical law for a rest that no physics explains: few terms of a dictionary, under the same gate as physics.

The rest is what the null model, the accepted effects and the structured discrepancy leave.  A term is judged by its
Bayes factor with the variance of the rest unknown (g-prior of unit information); the threshold is what the best of all
terms reaches in 1 % of recordings whose rest has the same size in every configuration, but no common law: the rest of
whole configurations with random signs.  And the law must predict configurations left out, the search for its terms
repeated without them.
Source: Zellner 1986, Liang et al. 2008 (g-prior); Cameron, Gelbach and Miller 2008 (wild cluster bootstrap).

A term of the dictionary is an extra deflection of one joint, in parts of its deflection at its largest torque:

    C tau_r * g(t) * (a f_1(q) + b f_2(q)),    t = tau / tau_r,

with g a function of what changes within a configuration (torque, loading direction, step, time, temperature) and f of
the joint angles, which hardly change within it: a term is the column of g times one number per configuration.
Source: sparse regression over a library of functions (Brunton, Proctor and Kutz 2016).
"""

from __future__ import annotations

import dataclasses
import itertools
from collections.abc import Iterable, Iterator, Sequence

import numpy as np

from calibration_core.diagnosis.evidence.design import LoadedSelection
from calibration_core.diagnosis.evidence.extended import ExtendedLoadedModel
from calibration_core.diagnosis.result.finding import EMPIRICAL, Alternative, Finding, FoundParameter
from calibration_core.estimation.alternatives import BY_ANGLE
from calibration_core.estimation.hypotheses import LAW
from calibration_core.estimation.refit import Extended
from calibration_core.identification.statistics import rms_length, whitened
from calibration_core.model.effects import effects_with
from calibration_core.model.effects.absolute import approach_direction
from calibration_core.model.effects.applied import largest
from calibration_core.model.effects.candidate import Candidate, Trait
from calibration_core.model.effects.state import State
from calibration_core.policy import EQUIVALENT, FALSE_ALARM
from calibration_core.timeseries import Bool1D, Float1D, Float2D, Float3D, Int1D, Readings

HARMONICS = 3  # cycles per turn of a joint, at most
SIZE, SQUARE = "the size of the torque", "the square of the torque"
WHOLE_SIZE = "the size of the torque with the weight"
EVEN = frozenset({SIZE, SQUARE, WHOLE_SIZE})  # what a joint follows that gives way more on one flank than on the other
KNEES = (0.5, 0.7, 0.85)  # of the largest torque, where a joint begins to give way more, or less
SLIGHT = 0.02  # of the largest torque: a smaller change is neither loading nor unloading


@dataclasses.dataclass(frozen=True, eq=False)
class Within:
    """What changes within a configuration.

    Attributes:
        deflection: (m,) rad for a coefficient of one.
    """

    joint: int
    words: str
    deflection: Float1D

    def column(self, state: State) -> Float2D:
        """Return the (m, 3) m that the points move for a coefficient of one."""
        return state.joint_column(self.joint, self.deflection)


@dataclasses.dataclass(frozen=True, eq=False)
class DictionaryTerm:
    """One entry of the dictionary.

    Attributes:
        within: Index of its function within a configuration.
        words: What the joint follows, for a person.
        names: Its one or two functions of the angles; their coefficients are the term's parameters.
        factors: (c, k) value of those functions in every configuration.
    """

    within: int
    joint: int
    words: str
    names: tuple[str, ...]
    factors: Float2D

    def columns(self, state: State, withins: tuple[Within, ...]) -> Float3D:
        """Return the (m, 3, k) m that the points move for coefficients of one."""
        column = withins[self.within].column(state)
        return np.asarray(column[:, :, None] * self.factors[state.configuration][:, None, :])


def dictionary(state: State) -> tuple[tuple[Within, ...], tuple[DictionaryTerm, ...]]:
    """Return all functions within a configuration, and all terms made of them, for m readings of a robot."""
    withins: list[Within] = []
    terms: list[DictionaryTerm] = []
    angles = _angles(state)
    ones = np.ones((len(angles), 1))
    for joint, name in enumerate(state.chain.joints):
        if state.compliance[joint] <= 0 or not np.any(state.load_torque[joint]):
            continue
        unit = state.compliance[joint] * state.largest_torque(joint)
        share = state.load_torque[joint] / state.largest_torque(joint)
        own = len(withins)
        withins.append(Within(joint, f"torque of {name}", unit * share))
        terms += [
            DictionaryTerm(own, joint, words, names, factors)
            for words, names, factors in _modulations(state, angles, joint)
        ]
        whole = state.torque[joint] / largest(state.torque[joint])
        for words, values in _laws(state, share, whole):
            terms.append(DictionaryTerm(len(withins), joint, words, (words,), ones))
            withins.append(Within(joint, words, unit * values))
    return tuple(withins), tuple(terms)


def _angles(state: State) -> Float2D:
    """Return the (c, n) mean angles of every configuration, rad."""
    count = int(state.configuration.max()) + 1
    size = np.maximum(np.bincount(state.configuration, minlength=count), 1)
    sums = [np.bincount(state.configuration, state.q[:, j], minlength=count) for j in range(state.chain.n)]
    return np.asarray(np.stack(sums, axis=1) / size[:, None])


def _modulations(state: State, angles: Float2D, joint: int) -> list[tuple[str, tuple[str, ...], Float2D]]:
    """Return how a joint's compliance may follow one angle, or its own with another one: words, names, (c, 2)."""
    joints = state.chain.joints
    own = np.eye(len(joints))
    waves = [
        (_multiple(times, joints[other]), times * own[other])
        for other, times in itertools.product(range(len(joints)), range(1, HARMONICS + 1))
    ]
    for other in range(len(joints)):
        if other == joint:
            continue
        for mine, its, sign in itertools.product(range(1, HARMONICS + 1), range(1, HARMONICS + 1), (1, -1)):
            words = f"{_multiple(mine, joints[joint])} {'+' if sign > 0 else '-'} {_multiple(its, joints[other])}"
            waves.append((words, mine * own[joint] + sign * its * own[other]))
    phases = np.stack([weights for _, weights in waves]) @ angles.T
    factors = np.stack([np.cos(phases), np.sin(phases)], axis=2)
    return [
        (f"the angle {words}", (f"cos({words})", f"sin({words})"), one)
        for (words, _), one in zip(waves, factors, strict=True)
    ]


def _multiple(times: int, joint: str) -> str:
    return joint if times == 1 else f"{times} {joint}"


def _laws(state: State, share: Float1D, whole: Float1D) -> list[tuple[str, Float1D]]:
    """Return functions (m,) of torque, loading direction, step, time and temperature; those that are none left out."""
    direction = state.along_steps(share, _direction)
    laws = [
        (SIZE, np.abs(share)),
        (WHOLE_SIZE, np.abs(whole)),
        ("the sign of the torque", np.where(np.abs(share) > SLIGHT, np.sign(share), 0.0)),
        (SQUARE, share**2),
        ("the square of the torque with its sign", share * np.abs(share)),
        ("the cube of the torque", share**3),
        *((f"the torque beyond {100 * knee:.0f} %", _beyond(share, knee)) for knee in KNEES),
        *((f"the torque with the weight beyond {100 * knee:.0f} %", _beyond(whole, knee)) for knee in KNEES),
        ("the loading direction", direction),
        ("torque times loading direction", np.abs(share) * direction),
        ("the number of the step", state.step / largest(state.step.astype(np.float64))),
        ("torque times the number of the step", share * state.step / largest(state.step.astype(np.float64))),
    ]
    for words, values in (("time", state.time), ("temperature", state.temperature)):
        if np.isfinite(values).all() and np.ptp(values) > 0:
            laws.append((f"torque times {words}", share * 2 * (values - values.mean()) / np.ptp(values)))
    return laws


def _beyond(share: Float1D, knee: float) -> Float1D:
    return np.asarray(np.sign(share) * np.clip(np.abs(share) - knee, 0.0, None) / (1.0 - knee))


def _direction(share: Float2D) -> Float2D:
    """Return +1 after the size of the torque grew last, -1 after it fell last, 0 before any load; (s, k)."""
    size = np.abs(share)
    result = np.zeros_like(share)
    for step in range(1, share.shape[1]):
        change = size[:, step] - size[:, step - 1]
        result[:, step] = np.where(np.abs(change) > SLIGHT, np.sign(change), result[:, step - 1])
    return result


MOST = 3  # terms
SAMPLES = 500
LEAST = 6.0  # nats: the threshold is never lower
FEWEST = 5  # configurations, below which nothing is searched
FOLDS = 20  # groups of whole configurations, at most, that are left out in turn
LEAST_GAIN = 0.05  # of the squared error on configurations left out
FREE = 1e-9  # prior precision of what has none, columns being of length one
ALIASED = 1e-4  # of a column's square: less of it is left beside the model


@dataclasses.dataclass(frozen=True, eq=False)
class LawTerm:
    """An accepted term.

    Attributes:
        coefficient: (k,) shares of the joint's deflection at its largest torque.
        std: (k,).
        log_bayes_factor: Beside the others, nats.
        shift: (m, 3) m, what it moves.
        rivals: Terms at other joints within five nats: (term, log Bayes factor), best first.
    """

    term: DictionaryTerm
    coefficient: Float1D
    std: Float1D
    log_bayes_factor: float
    shift: Float2D
    rivals: tuple[tuple[DictionaryTerm, float], ...]


@dataclasses.dataclass(frozen=True, eq=False)
class Law:
    """A sparse law.

    Attributes:
        terms: Strongest first.
        explained: Share of the rest's excess over the noise that it explains.
        held_out_gain: Share by which the squared error on configurations left out falls, the search repeated.
        threshold: nats, of the first term.
    """

    terms: tuple[LawTerm, ...]
    explained: float
    held_out_gain: float
    threshold: float


@dataclasses.dataclass(frozen=True, eq=False)
class Rival:
    """The term that describes best what accepted candidates stand for.

    Attributes:
        log_bayes_factor: Of the term in place of the candidates, nats.
        own: Of the candidates by the same measure, nats.
    """

    term: DictionaryTerm
    log_bayes_factor: float
    own: float


@dataclasses.dataclass(frozen=True, eq=False)
class _Rest:
    """The recording as the search sees it, r whitened rows in c configurations.

    Attributes:
        value: (r,) measured - null model.
        known: (r, p) columns that the law stands beside: null model, accepted effects, structured discrepancy.
        precision: (p,) prior precision of their coefficients.
        functions: (r, w) functions within a configuration.
        place: (r,) index of the configuration, 0 ... c-1.
        terms: The t terms.
        within: (t,) the function of each.
        factors: (t, c, 2) their factors; the second is zero where a term has one.
        count: (t,) number of functions of the angles.
    """

    extended: ExtendedLoadedModel
    value: Float1D
    known: Float2D
    precision: Float1D
    functions: Float2D
    place: Int1D
    terms: tuple[DictionaryTerm, ...]
    within: Int1D
    factors: Float3D
    count: Int1D

    def columns(self, chosen: Sequence[int]) -> Float2D:
        """Return the (r, k) columns of terms."""
        parts = [self.functions[:, [self.within[t]]] * self.factors[t][self.place][:, : self.count[t]] for t in chosen]
        return np.column_stack([np.zeros((len(self.value), 0)), *parts])

    def model(self, chosen: Sequence[int]) -> tuple[Float2D, Float1D]:
        """Return (r, p + k) columns of length one of what is known and of chosen terms, and their precisions."""
        more = self.columns(chosen)
        columns = np.column_stack([self.known, more])
        length = np.linalg.norm(columns, axis=0)
        length = np.where(length > 0, length, 1.0)
        precision = np.concatenate([self.precision / length[: len(self.precision)] ** 2, np.zeros(more.shape[1])])
        return columns / length, precision + FREE


def empirical_law(extended: ExtendedLoadedModel) -> Law | None:
    """Search the rest of an extended model for a sparse law; None where none passes."""
    rest = _rest(extended)
    if rest is None:
        return None
    everywhere = np.ones(len(rest.value), dtype=bool)
    accepted: tuple[int, ...] = ()
    limits: list[float] = []
    while len(accepted) < MOST:
        scores, limit = _scores(rest, accepted, everywhere, bootstrap=True)
        best = int(np.argmax(scores))
        if scores[best] <= max(limit, LEAST):
            break
        limits.append(max(limit, LEAST))
        accepted = _refined(rest, (*accepted, best))
    while accepted:
        gain = _held_out_gain(rest, len(accepted))
        if gain is not None:
            return _law(rest, accepted, gain, limits[0])
        accepted = accepted[:-1]
    return None


def rival(extended: ExtendedLoadedModel, candidates: Sequence[int]) -> Rival | None:
    """Search for the term that does best in place of accepted candidates; None where nothing can be searched.

    What a candidate's own joint follows by load, direction or time alone is no rival: physics of the catalogue says
    such things too, and the term may be its image.  But memory is no image of what the size of the load says at once.

    Args:
        extended: The extended model.
        candidates: Indices of those that the term replaces; all others stay in the model.
    """
    others = tuple(index for index in extended.accepted if index not in candidates)
    rest = _rest(dataclasses.replace(extended, accepted=others))
    if rest is None:
        return None
    everywhere = np.ones(len(rest.value), dtype=bool)
    scores, _ = _scores(rest, (), everywhere)
    design, joints = extended.design, extended.state.chain.joints
    own = set().union(*(_named(design.candidates[index].location.values()) for index in candidates))
    effects = {design.candidates[index].effect for index in candidates}
    never_images = EVEN if effects <= effects_with(Trait.MEMORY) else frozenset()
    by_angle = effects == {BY_ANGLE}  # no function of the torque is its image
    image = [
        len(term.names) == 1 and joints[term.joint] in own and term.words not in never_images and not by_angle
        for term in rest.terms
    ]
    best = int(np.argmax(np.where(image, -np.inf, scores)))
    columns = np.column_stack([design.columns[:, design.blocks[index]] for index in candidates])
    return Rival(rest.terms[best], float(scores[best]), _score_of(rest, columns))


def _named(places: Iterable[str | tuple[str, ...]]) -> set[str]:
    """Return the names in the values of a location."""
    return {name for place in places for name in ((place,) if isinstance(place, str) else place)}


def _score_of(rest: _Rest, columns: Float2D) -> float:
    """Return the log Bayes factor of any whitened columns, (r, k), by the measure of the terms."""
    model, inverse, left = _left(rest, (), np.ones(len(rest.value), dtype=bool))
    model_left = model.T @ left
    columns = columns / np.linalg.norm(columns, axis=0)
    cross = columns.T @ model
    projected = columns.T @ columns - cross @ inverse @ cross.T
    right = columns.T @ left - cross @ inverse @ model_left
    gain = float(right @ np.linalg.pinv(projected, rcond=ALIASED, hermitian=True) @ right)
    total = float(left @ left - model_left @ inverse @ model_left)
    share = np.clip(np.array([gain / total]), 0.0, 1.0 - 1e-12)
    return float(_log_bayes_factor(share, columns.shape[1], max(len(left) - model.shape[1], 1))[0])


def _log_bayes_factor(share: Float2D | Float1D, count: Int1D | int, freedom: int) -> Float2D:
    """Return log Bayes factors, by the g-prior of unit information, of what explains a share of the rest."""
    return np.asarray(0.5 * ((freedom - count) * np.log1p(freedom) - freedom * np.log1p(freedom * (1.0 - share))))


def _rest(extended: ExtendedLoadedModel) -> _Rest | None:
    design, state = extended.design, extended.state
    withins, terms = dictionary(state)
    if not terms or len(np.unique(design.configuration)) < FEWEST:
        return None
    raw = np.stack([within.column(state) for within in withins], axis=-1)
    functions, _ = whitened(extended.rows, raw[extended.used])
    numbers, place = np.unique(design.configuration, return_inverse=True)
    known = design.known(extended.accepted)
    factors = np.zeros((len(terms), len(numbers), 2))
    for t, term in enumerate(terms):
        factors[t, :, : term.factors.shape[1]] = term.factors[numbers]
    return _Rest(
        extended=extended,
        value=design.residual,
        known=known,
        precision=np.where(np.arange(known.shape[1]) < design.n, 0.0, 1.0),
        functions=functions,
        place=place,
        terms=terms,
        within=np.array([term.within for term in terms]),
        factors=factors,
        count=np.array([term.factors.shape[1] for term in terms]),
    )


def _scores(rest: _Rest, accepted: tuple[int, ...], used: Bool1D, *, bootstrap: bool = False) -> tuple[Float1D, float]:
    """Return log Bayes factors (t,) beside the accepted terms, and the threshold of their maximum.

    Args:
        rest: The recording.
        accepted: Terms in the law.
        used: (r,) rows that may be fitted.
        bootstrap: Whether to find the threshold; it is zero otherwise.
    """
    model, inverse, left = _left(rest, accepted, used)
    functions, place = rest.functions[used], rest.place[used]
    count = rest.factors.shape[1]
    signs = np.ones((count, 1))
    if bootstrap:
        random = np.random.default_rng(0).choice((-1.0, 1.0), (count, SAMPLES))
        signs = np.concatenate([signs, random], axis=1)
    parts = [(model[place == c], functions[place == c], left[place == c]) for c in range(count)]
    by_model = np.stack([g.T @ m for m, g, _ in parts])  # (c, w, p)
    square = np.stack([(g**2).sum(axis=0) for _, g, _ in parts])  # (c, w)
    by_left = np.stack([g.T @ r for _, g, r in parts])  # (c, w)
    model_left = np.stack([m.T @ r for m, _, r in parts]).T @ signs  # (p, s)
    cross = np.empty((len(rest.terms), 2, model.shape[1]))
    block = np.empty((len(rest.terms), 2, 2))
    right = np.empty((len(rest.terms), 2, signs.shape[1]))
    for within in np.unique(rest.within):
        some = np.flatnonzero(rest.within == within)
        factors = rest.factors[some].transpose(0, 2, 1)  # (t, 2, c)
        cross[some] = factors @ by_model[:, within]
        block[some] = (factors * square[:, within]) @ factors.transpose(0, 2, 1)
        right[some] = factors @ (by_left[:, [within]] * signs)
    taken = cross @ inverse
    projected = block - taken @ cross.transpose(0, 2, 1)
    right -= taken @ model_left
    usable, half = _roots(block, projected, rest.count)
    gain = ((half @ right) ** 2).sum(axis=1)
    total = float(left @ left) - (model_left * (inverse @ model_left)).sum(axis=0)
    freedom = max(len(left) - model.shape[1], 1)
    share = np.clip(gain / total, 0.0, 1.0 - 1e-12)
    scores = _log_bayes_factor(share, rest.count[:, None], freedom)
    scores[~usable] = -np.inf
    places = {rest.terms[t].words + str(rest.terms[t].joint) for t in accepted}
    scores[[term.words + str(term.joint) in places for term in rest.terms]] = -np.inf
    limit = float(np.quantile(scores[:, 1:].max(axis=0), 1 - FALSE_ALARM)) if bootstrap else 0.0
    return scores[:, 0], limit


def _left(rest: _Rest, accepted: tuple[int, ...], used: Bool1D) -> tuple[Float2D, Float2D, Float1D]:
    """Return the model with accepted terms, (r, p), its inverse normal matrix, (p, p), and what it leaves, (r,).

    Args:
        rest: The recording.
        accepted: Terms in the law.
        used: (m,) rows that are fitted, r of them.
    """
    model, precision = rest.model(accepted)
    model, value = model[used], rest.value[used]
    inverse = np.asarray(np.linalg.inv(model.T @ model + np.diag(precision)), dtype=np.float64)
    return model, inverse, value - model @ (inverse @ (model.T @ value))


def _roots(block: Float3D, projected: Float3D, count: Int1D) -> tuple[Bool1D, Float3D]:
    """Return which terms the model leaves something of, (t,), and L^-1 of their projected blocks L L', (t, 2, 2)."""
    result = np.zeros_like(projected)
    first, second = projected[:, 0, 0], projected[:, 1, 1]
    one = first > ALIASED * block[:, 0, 0]
    safe = np.where(one, first, 1.0)
    result[:, 0, 0] = 1 / np.sqrt(safe)
    remaining = second - projected[:, 0, 1] ** 2 / safe
    two = one & (remaining > ALIASED * block[:, 1, 1]) & (count == 2)
    root = np.sqrt(np.where(two, remaining, 1.0))
    result[:, 1, 1] = np.where(two, 1 / root, 0.0)
    result[:, 1, 0] = np.where(two, -projected[:, 0, 1] / (safe * root), 0.0)
    return one & (two | (count == 1)), result


def _refined(rest: _Rest, accepted: tuple[int, ...]) -> tuple[int, ...]:
    """Let every term but the last be replaced by a better one, given the others."""
    everywhere = np.ones(len(rest.value), dtype=bool)
    for position in range(len(accepted) - 1):
        others = accepted[:position] + accepted[position + 1 :]
        best = int(np.argmax(_scores(rest, others, everywhere)[0]))
        accepted = (*accepted[:position], best, *accepted[position + 1 :])
    return accepted


def _held_out_gain(rest: _Rest, size: int) -> float | None:
    """Return the share of squared error saved where the law is searched without what it predicts; None: too little."""
    folds = rest.place % min(FOLDS, rest.factors.shape[1])
    before, after = [], []
    for fold in np.unique(folds):
        used = folds != fold
        accepted: tuple[int, ...] = ()
        before.append(_predicted(rest, accepted, used))
        for _ in range(size):
            accepted = (*accepted, int(np.argmax(_scores(rest, accepted, used)[0])))
        after.append(_predicted(rest, accepted, used))
    saved = np.array(before) - np.array(after)
    gain = float(saved.sum() / np.sum(before))
    return gain if gain > LEAST_GAIN and saved.sum() > saved.max() else None


def _predicted(rest: _Rest, accepted: tuple[int, ...], used: Bool1D) -> float:
    """Return the sum of squares of the prediction error of the rows not used."""
    model, precision = rest.model(accepted)
    fitted = model[used]
    value = np.linalg.solve(fitted.T @ fitted + np.diag(precision), fitted.T @ rest.value[used])
    error = rest.value[~used] - model[~used] @ value
    return float(error @ error)


def _law(rest: _Rest, accepted: tuple[int, ...], gain: float, limit: float) -> Law:
    everywhere = np.ones(len(rest.value), dtype=bool)
    state = rest.extended.state
    withins, _ = dictionary(state)
    model, inverse, left = _left(rest, accepted, everywhere)
    solution = inverse @ (model.T @ rest.value)
    freedom = max(len(left) - model.shape[1], 1)
    before = _left(rest, (), everywhere)[2]
    length = np.linalg.norm(rest.columns(accepted), axis=0)
    start = rest.known.shape[1]
    value = solution[start:] / length
    std = np.sqrt(np.diag(inverse)[start:] * float(left @ left) / freedom) / length
    terms, at = [], 0
    for position, index in enumerate(accepted):
        term = rest.terms[index]
        k = term.factors.shape[1]
        others = accepted[:position] + accepted[position + 1 :]
        scores, _ = _scores(rest, others, everywhere)
        moved = state.since_step_zero(term.columns(state, withins) @ value[at : at + k])
        terms.append(
            LawTerm(
                term, value[at : at + k], std[at : at + k], float(scores[index]), moved, _rivals(rest, scores, index)
            )
        )
        at += k
    excess = float(before @ before) - len(before)
    explained = float((before @ before - left @ left) / max(excess, 1e-12))
    return Law(tuple(terms), min(explained, 1.0), gain, limit)


def _rivals(rest: _Rest, scores: Float1D, chosen: int) -> tuple[tuple[DictionaryTerm, float], ...]:
    """Return the best term of every other joint that comes within five nats."""
    found: dict[int, tuple[DictionaryTerm, float]] = {}
    for index in np.argsort(-scores, kind="stable"):
        term = rest.terms[index]
        if scores[index] < scores[chosen] - EQUIVALENT:
            break
        if term.joint != rest.terms[chosen].joint and term.joint not in found:
            found[term.joint] = (term, float(scores[index]))
    return tuple(found.values())


EFFECT = "empirical_law"
WORST = 3  # configurations that are listed


def law_findings(law: Law, joints: Sequence[str], readings: Readings) -> tuple[Finding, ...]:
    """Return one finding for every joint of a law.

    Args:
        law: The law.
        joints: Their names.
        readings: The recording, of which the law holds a shift for every reading.
    """
    by_joint: dict[int, list[LawTerm]] = {}
    for term in law.terms:
        by_joint.setdefault(term.term.joint, []).append(term)
    return tuple(_finding(law, joints, number, terms, readings) for number, terms in by_joint.items())


def law_sentence(law: Law) -> str:
    """Return what the law does to the rest, in one sentence."""
    return (
        f"An empirical law, which is no physics and not in the extended model, describes {100 * law.explained:z.0f} % "
        "of it: see the findings."
    )


def _finding(law: Law, joints: Sequence[str], number: int, terms: list[LawTerm], readings: Readings) -> Finding:
    shift = np.sum([term.shift for term in terms], axis=0)
    magnitude = rms_length(shift)
    parameters = tuple(
        FoundParameter(name, float(value), float(std), "1")
        for term in terms
        for name, value, std in zip(term.term.names, term.coefficient, term.std, strict=True)
    )
    evidence = max(term.log_bayes_factor for term in terms)
    rivals = {other.joint: (other, score) for term in terms for other, score in term.rivals}
    alternatives = tuple(
        Alternative(EFFECT, EMPIRICAL, {"joint": joints[other.joint]}, score)
        for other, score in sorted(rivals.values(), key=lambda rival: -rival[1])
    )
    words = " and ".join(term.term.words for term in terms)
    parts = " + ".join(f"{p.value:z.3f} {p.name}" for p in parameters)
    listed = ", ".join(map(str, _largest(shift, readings.configuration)))
    text = (
        f"Empirical, not physics: how far {joints[number]} gives way follows {words}; beside the model it turns by "
        f"{parts}, in parts of its deflection at its largest torque (functions of angles: times torque over largest "
        f"torque). It moves the measured points by {1e6 * magnitude:.0f} µm rms, most in configurations {listed}. The "
        f"law describes {100 * law.explained:z.0f} % of what remains beyond the noise; on configurations left out, the "
        f"search repeated without them, it saves {100 * law.held_out_gain:z.0f} % of the squared error. It says where "
        "to look, not why, and stands in no model file."
    )
    return Finding(
        effect=EFFECT,
        family=EMPIRICAL,
        location={"joint": joints[number]},
        variant=words,
        parameters=parameters,
        log_bayes_factor=evidence,
        held_out_gain=law.held_out_gain,
        magnitude=magnitude,
        cannot_be_told_from=alternatives,
        explanation=text,
        separate_by=f"more configurations that differ in {words}, at the same torque of {joints[number]}",
    )


def _largest(shift: Float2D, configuration: Int1D) -> list[int]:
    """Return the numbers of the configurations that a shift (m, 3) moves most."""
    numbers = np.unique(configuration)
    squares = [float(np.mean(np.sum(shift[configuration == number] ** 2, axis=1))) for number in numbers]
    return [int(numbers[k]) for k in np.argsort(-np.array(squares), kind="stable")[:WORST]]


def with_open_laws(extended: ExtendedLoadedModel, selection: LoadedSelection, law: Law | None) -> ExtendedLoadedModel:
    """Return the model with compliances as uncertain as the laws of their joints are open.

    Args:
        extended: The extended model.
        selection: What was accepted; a law that needs refinements is of another form than the catalogue's.
        law: An empirical law for what no physics explains; None: there is none.
    """
    open_ones = (*_unsettled(extended, selection), *_empirical(law))
    if not open_ones:
        return extended
    state, compliance = extended.state, extended.compliance
    columns = extended.problem.linearise(extended.base_compliance).columns
    more = np.zeros(len(compliance))
    for joint, shift in open_ones:
        moved = rms_length(state.since_step_zero(columns[:, :, joint] * compliance[joint]))
        if moved > 0:
            more[joint] = max(more[joint], compliance[joint] * rms_length(shift) / moved)
    covariance = extended.covariance.copy()
    n = len(compliance)
    covariance[np.arange(n), np.arange(n)] += more**2
    return dataclasses.replace(extended, covariance=covariance)


def with_open_joints(extended: Extended, findings: Sequence[Finding]) -> Extended:
    """Return the model of positions with compliances as uncertain as the laws of their joints are open.

    A joint that lags under changing loads stands elsewhere by the direction from which it came, too.

    Args:
        extended: The extended model, loads and postures at rest in one.
        findings: What was found; of some the form of the law is not settled.
    """
    compliances = [str(one.location["joint"]) for one in extended.model.fitted_compliances]
    covariance = extended.covariance.copy()
    for one in findings:
        joint = one.location.get("joint")
        if one.law_settled or not _is_law(one) or joint not in compliances:
            continue
        column = extended.flat - len(compliances) + compliances.index(joint)
        law = [
            k
            for k, part in enumerate(extended.parts)
            if _is_law(part.candidate) and part.candidate.location == one.location
        ]
        compliance = float(extended.parameters.compliance[extended.parameters.joints.index(joint)])
        by_load = extended.model.state.since_step_zero(extended.moved_by(column) * compliance)
        loaded = np.any(by_load != 0, axis=1)
        if loaded.any():
            share = rms_length(extended.shift(law)[loaded]) / rms_length(by_load[loaded])
            covariance[column, column] += (compliance * share) ** 2
    return dataclasses.replace(extended, covariance=covariance)


def _is_law(one: Finding | Candidate) -> bool:
    return one.family == LAW or one.effect == approach_direction.EFFECT.name


def _unsettled(extended: ExtendedLoadedModel, selection: LoadedSelection) -> Iterator[tuple[int, Float2D]]:
    """Yield the joint and the (m, 3) m of each law that was found there with refinements."""
    for choice in selection.choices:
        own = extended.design.candidates[choice.candidate]
        if own.family == LAW and choice.refinements:
            joint = extended.state.chain.joints.index(str(own.location["joint"]))
            yield joint, extended.moved((choice.candidate, *choice.refinements))


def _empirical(law: Law | None) -> Iterator[tuple[int, Float2D]]:
    """Yield the joint and the (m, 3) m of each term of an empirical law."""
    for one in () if law is None else law.terms:
        yield one.term.joint, one.shift
