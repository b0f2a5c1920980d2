"""From the simulation to the noise: how much of the difference to a recording each step of the model takes away.

The steps stand in the order in which a person would put a simulation right: where tracker and targets stand, the shape
of the robot, its joint stiffnesses, then one finding after the other.  Each step fits its own numbers and those of the
steps before it; later ones keep what the cell file says.  Deflections are compared without one offset per configuration
and point; configurations with a single step by their positions.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator, Sequence

import numpy as np

from calibration_core.cell import Cell
from calibration_core.diagnosis.comparison.result import (
    ChangedNumber,
    Comparison,
    ImprovedSimulation,
    WaterfallStep,
    Witness,
)
from calibration_core.diagnosis.comparison.witnesses import judged
from calibration_core.diagnosis.location import locate
from calibration_core.diagnosis.result.finding import Diagnosis, Finding
from calibration_core.errors import EquilibriumError
from calibration_core.identification.stiffness.predict import predict_readings
from calibration_core.model.effects.applied import applied_shift
from calibration_core.model.effects.state import recorded_state
from calibration_core.model.effects.words import effect_sentence, plain_name
from calibration_core.model.identified.gaussian import GaussianEstimate
from calibration_core.model.identified.named_values import value_of, with_values
from calibration_core.model.nominal import nominal_parameters
from calibration_core.model.parameters import AppliedEffect, ModelParameters
from calibration_core.model.robot import chain_of
from calibration_core.model.statics import load_of
from calibration_core.timeseries import Bool1D, Float1D, Float2D, Float3D, Int1D, Readings

STIFFNESS = "stiffness"
STIFF = {"rad/(N*m)": "N*m/rad", "m/N": "N/m"}
ANGLES = "joint angles"
TAKEN = "All else is found with those of the simulation."
NAMED = 2  # numbers of a step that are named in words
TWICE = 2  # refinements of a step's fit by its exact prediction: what is left of curvature is below 1 % of the noise
ELSEWHERE = 1e4  # standard deviations that tracker and targets of a test may stand elsewhere
PLAIN = 1.3  # times what is left at the end: a difference below shows no pattern


class ComparedRows:
    """What of a recording is compared: deflections, or positions where a configuration has one step."""

    def __init__(self, readings: Readings, rows: Int1D, cell: Cell, *, positions: bool = False) -> None:
        self._readings, self._rows, self._cell = readings, rows, cell
        kept = readings.select(rows)
        keys = np.column_stack([kept.configuration, kept.point])
        self._group = np.unique(keys, axis=0, return_inverse=True)[1].reshape(-1)
        self._size = np.bincount(self._group)
        steps = np.unique(np.column_stack([readings.configuration, readings.step]), axis=0)[:, 0]
        numbers, count = np.unique(steps, return_counts=True)
        self.still: Bool1D = np.isin(kept.configuration, numbers[(count == 1) | positions])
        shows = self.still | (self._size[self._group] > 1)
        self._weight = shows[:, None].astype(float)
        self._shown = 3 * int(shows.sum())
        self.configurations = [np.flatnonzero(kept.configuration == c) for c in np.unique(kept.configuration)]

    def compared(self, position: Float2D) -> Float2D:
        """Return (m, 3) m less one offset per configuration and point; zero where a reading shows nothing."""
        mean = np.zeros((len(self._size), 3))
        np.add.at(mean, self._group, position)
        offset = np.where(self.still[:, None], 0.0, (mean / self._size[:, None])[self._group])
        return np.asarray((position - offset) * self._weight)

    def predicted(self, model: ModelParameters) -> Float2D:
        """Return (m, 3) m, what a model says, as it is compared."""
        return self.compared(predict_readings(self._readings, self._cell, model)[self._rows])

    def left(self, model: ModelParameters) -> Float2D:
        """Return (m, 3) m, what a model leaves."""
        return self.compared(self._readings.position[self._rows]) - self.predicted(model)

    def columns(self, model: ModelParameters, names: Sequence[str], step: Float1D) -> Float3D:
        """Return (m, 3, p), derivatives by numbers of the model, by differences of (p,) steps in their units.

        Each effect is looked at by itself: what it does to what others do is of second order.
        """
        readings, moved = self._readings, np.zeros((len(self._rows), 3, len(names)))
        bare, turned = model.replace(effects=()), model.tracker[:3, :3]
        chain = chain_of(self._cell).corrected(model.geometry)
        load = None if readings.wrench is None else load_of(readings, self._cell, model)
        state = recorded_state(readings, self._cell, chain, model, load) if model.effects else None
        before = self.predicted(bare)
        for k, (name, size) in enumerate(zip(names, map(float, step), strict=True)):
            group, _, rest = name.partition(".")
            number, _, last = rest.partition(".")
            if group == "effects" and state is not None:
                effect = model.effects[int(number)]
                more = dataclasses.replace(
                    effect, parameters={**effect.parameters, last: effect.parameters[last] + size}
                )
                shift = applied_shift([more], state) - applied_shift([effect], state)
                change = self.compared((shift @ turned)[self._rows])
            else:
                change = self.predicted(with_values(bare, {name: value_of(bare, name) + size})) - before
            moved[:, :, k] = change / size
        return moved

    def arrows(self, left: Float2D, tracker: Float2D) -> dict[tuple[int, str], Float1D]:
        """Return what is left, (m, 3) m of the tracker's axes, as arrows of a step; `tracker` is its pose."""
        kept, ways = self._readings.select(self._rows), left @ tracker[:3, :3].T
        load = np.zeros(len(kept)) if kept.wrench is None else np.linalg.norm(kept.wrench[:, :3], axis=1)
        shown: dict[tuple[int, str], Float1D] = {}
        for group in range(len(self._size)):
            rows = np.flatnonzero(self._group == group)
            most, least = rows[np.argmax(load[rows])], rows[np.argmin(load[rows])]
            way = ways[most] if self.still[most] else ways[most] - ways[least]
            shown[int(kept.configuration[most]), kept.points[kept.point[most]]] = way
        return shown

    def rms(self, left: Float2D) -> float:
        """Return the root mean square per coordinate of what is compared, m."""
        return float(np.sqrt(np.sum(left**2) / max(self._shown, 1)))


@dataclasses.dataclass(frozen=True)
class ModelPart:
    """What of a model is put in by one step.

    Attributes:
        name: `frames`, `geometry`, `stiffness`, or a finding's effect.
        what: In words, what and where.
        heads: First words of its numbers' names.
        effects: Places of its effects in the model.
    """

    name: str
    what: str
    heads: tuple[str, ...] = ()
    effects: tuple[int, ...] = ()

    def holds(self, name: str) -> bool:
        """Tell whether a number of the model, by its name, belongs to this part."""
        head, _, rest = name.partition(".")
        return head in self.heads or (head == "effects" and int(rest.partition(".")[0]) in self.effects)


FRAMES = ModelPart(
    "frames", "where tracker and targets stand", ("tracker", "measurement_points", "wrench_point", "force_torque")
)
GEOMETRY = ModelPart("geometry", "the shape of the robot", ("geometry",))


class _StagedModel:
    """The model with some of its parts, fitted to what is compared."""

    def __init__(self, rows: ComparedRows, found: Diagnosis, believed: ModelParameters) -> None:
        self.rows, self._believed, self._noise = rows, believed, found.noise_known
        self._model, estimate = found.handed_out
        # Deflections hardly show where tracker and targets stand: the positions that showed it are not compared.
        fixed = () if rows.still.any() else FRAMES.heads
        known = [k for k in _finite(estimate) if estimate.names[k].partition(".")[0] not in fixed]
        self._names, self._std = [estimate.names[k] for k in known], estimate.std[known]
        self._columns = rows.columns(self._model, self._names, self._std) * self._std

    def with_parts(self, parts: Sequence[ModelPart]) -> tuple[ModelParameters, Float2D, Float2D]:
        """Return the model with these parts, fitted, what it leaves, and what it leaves of configurations left out.

        Both are (m, 3) m; the second is the fit's influence to first order (Cook and Weisberg 1982, Residuals and
        Influence in Regression, 2.2).
        """
        mine = [k for k, name in enumerate(self._names) if any(part.holds(name) for part in parts)]
        flat = self._columns[:, :, mine].reshape(3 * len(self._columns), len(mine))
        model, names = self._with(parts, [self._names[k] for k in mine])
        # In standard deviations, what these readings show has directions of at least the noise over the root of their
        # count.  What shows less, as the numbers of two causes that do the same, stays as it was found.
        size, axes = np.linalg.eigh(flat.T @ flat)
        shown = size * len(mine) > self._noise**2
        spread = axes[:, shown] / size[shown] @ axes[:, shown].T @ flat.T
        left = self.rows.left(model)
        for _ in range(TWICE if mine else 0):
            moved = self._std[mine] * (spread @ left.ravel())
            value = {name: value_of(model, name) + float(by) for name, by in zip(names, moved, strict=True)}
            nearer = with_values(model, value)
            leaves = self.rows.left(nearer)
            if self.rows.rms(leaves) > self.rows.rms(left):  # beyond where the model is straight
                break
            model, left = nearer, leaves
        out = left.copy()
        for rows in self.rows.configurations:
            own = (3 * rows[:, None] + np.arange(3)).ravel()
            share = flat[own] @ spread[:, own]
            out[rows] = np.linalg.solve(np.eye(len(own)) - share, left[rows].ravel()).reshape(-1, 3)
        return model, left, out

    def _with(self, parts: Sequence[ModelPart], names: Sequence[str]) -> tuple[ModelParameters, list[str]]:
        """Return the model with these parts as they were found, and names as they are called in it."""
        whole, believed = self._model, self._believed
        kept = sorted(k for part in parts for k in part.effects)
        heads = {head for part in parts for head in part.heads}
        place = {f"effects.{k}": f"effects.{i}" for i, k in enumerate(kept)}
        model = whole.replace(
            effects=tuple(whole.effects[k] for k in kept),
            compliance=whole.compliance if "compliance" in heads else believed.compliance,
            geometry=whole.geometry if "geometry" in heads else believed.geometry,
        )
        if "tracker" not in heads:
            model = model.replace(
                tracker=believed.tracker,
                points=believed.points,
                wrench_point=believed.wrench_point,
                force_torque=believed.force_torque,
            )
        split = [name.split(".") for name in names]
        called = [".".join([place.get(".".join(one[:2]), ".".join(one[:2])), *one[2:]]) for one in split]
        return model, called


def _finite(estimate: GaussianEstimate) -> list[int]:
    """Return the places of the numbers of which something, and not everything, is known."""
    return [k for k, std in enumerate(estimate.std) if np.isfinite(std) and std > 0]


def with_waterfall(found: Diagnosis, recorded: Readings, cell: Cell, test: Readings | None = None) -> Diagnosis:
    """Add to a diagnosis how the difference of its recording and a simulation becomes the noise.

    Raises:
        InputError: A recording cannot be predicted with the model.
        EquilibriumError: A load is beyond what the joints can carry.
    """
    (compared,) = found.comparisons
    if compared.steps is None or found.recording_spoiled:
        return found
    rows, simulated = compared.rows, compared.simulated.position
    used = ~found.identification.residuals.excluded if found.used is None else found.used
    # What the standard's model alone cannot explain may be physics: set aside are readings that the diagnosis names.
    if len(used) == len(recorded) and any(one.kind == "outlier_readings" for one in found.anomalies):
        rows, simulated = rows[used[rows]], simulated[used[rows]]
    whole = recorded.position[rows] - simulated
    if found.moved is not None:
        recorded = dataclasses.replace(recorded, position=recorded.position - found.moved)
    return dataclasses.replace(found, comparisons=(_with_steps(found, (recorded, rows), whole, cell, test),))


def _with_steps(
    found: Diagnosis, recorded: tuple[Readings, Int1D], difference: Float2D, cell: Cell, test: Readings | None
) -> Comparison:
    """Return the comparison with its steps.

    Args:
        found: The diagnosis.
        recorded: The recording, less what moved of tracker and targets, and its rows that correspond.
        difference: (m, 3) m, recording minus simulation, as both are.
        cell: The cell file.
        test: A recording that was not fitted.
    """
    (compared,), unknown = found.comparisons, float("nan")
    ours = ComparedRows(*recorded, cell)
    model, estimate = found.handed_out
    same, believed = compared.reproduction, nominal_parameters(cell)
    if same.compliance is not None:
        believed = believed.replace(compliance=same.compliance)
    staged = _StagedModel(ours, found, believed)
    tested = None if test is None else _Tested(test, model, estimate, cell, found.noise_known)
    left = difference = ours.compared(difference)
    whole = before = ours.rms(left)
    # Where the model says what the simulation says, it stands for it on the test recording.
    alike = same.reproduced or same.compliance is not None
    at_first = tested.rms(believed) if tested is not None and alike else unknown
    ways = ours.arrows(left, believed.tracker)
    steps = [WaterfallStep("simulation", "as it is", whole, unknown, at_first, 0.0, arrows=ways)]
    parts: tuple[ModelPart, ...] = ()
    rigid = whole
    heard = {one.text: _heard(one, found, recorded, cell, believed) for one in compared.witnesses}
    texts = {before: "" if one is None else one.text for before, one in heard.items()}
    sentences = tuple(text for text in (texts.get(one, one) for one in compared.sentences) if text)
    witnesses = tuple(one for one in heard.values() if one is not None)
    loads = any(one.what == "wrench" for one in witnesses)
    for part in (FRAMES, GEOMETRY, *_parts(found, model)):
        parts = (*parts, part)
        fitted, left, left_out = staged.with_parts(parts)
        after = ours.rms(left)
        first = unknown
        if part.name == GEOMETRY.name:
            rigid = after
        elif part.effects and part.name != STIFFNESS:
            first = (
                (rigid**2 - ours.rms(staged.with_parts((FRAMES, GEOMETRY, part))[1]) ** 2) / whole**2 if whole else 0.0
            )
        changed = tuple(_changes(part, estimate, believed))
        steps.append(
            WaterfallStep(
                part.name,
                f"{'the recorded loads; ' if loads and part is FRAMES else ''}{_in_words(part, changed)}",
                after,
                ours.rms(left_out),
                unknown if tested is None else tested.rms(fitted),
                (before**2 - after**2) / whole**2 if whole else 0.0,
                changed,
                first,
                ours.arrows(left, believed.tracker),
            )
        )
        before = after
    share, last = (before / whole) ** 2 if whole else 0.0, steps[-1]
    words = f"what is left; noise alone would leave {1e6 * found.noise_known:.1f} µm"
    steps.append(WaterfallStep("noise", words, before, last.held_out_rms, last.test_rms, share))
    again = unknown if tested is None else tested.rms(model)
    improved = ImprovedSimulation(ours.rms(ours.left(model)), again, lambda other: ours.rms(ours.left(other)))
    turned = difference @ believed.tracker[:3, :3].T
    where = locate(recorded[0].select(recorded[1]), turned, cell, believed) if whole > PLAIN * before else None
    pattern = "" if where is None else where.strongest
    return dataclasses.replace(
        compared,
        waterfall=tuple(steps),
        improved=improved,
        pattern=pattern,
        witnesses=witnesses,
        sentences=sentences,
    )


def _heard(
    stated: Witness, found: Diagnosis, recorded: tuple[Readings, Int1D], cell: Cell, believed: ModelParameters
) -> Witness | None:
    """Let the positions judge what the two say differently; None where it stays open and moves the points within noise.

    What was found wrong with the sensor itself, and beside doubtful angles whatever was found, stays out of the model:
    it would put right the one that is wrong.  Where the simulation decides nothing, the sensor's finding decides.
    """
    (compared,), (readings, rows), model = found.comparisons, recorded, found.handed_out[0]
    if stated.what == "wrench" and readings.wrench is not None and compared.simulated.wrench is not None:
        wrench = readings.wrench.copy()
        wrench[compared.rows] = compared.simulated.wrench
        other = dataclasses.replace(readings, wrench=wrench)
    elif stated.what == ANGLES:
        other = _with_angles(readings, compared)
    else:
        return stated
    angles = stated.what == ANGLES
    positions = angles and cell.measurements.points == "absolute"
    at_sensor = {k for k, effect in enumerate(model.effects) if "sensor" in effect.location}
    sound = [part for part in _parts(found, model)[: 1 if angles else None] if at_sensor.isdisjoint(part.effects)]
    both = [ComparedRows(one, rows, cell, positions=positions) for one in (readings, other)]
    try:
        fits = [_StagedModel(one, found, believed).with_parts((FRAMES, GEOMETRY, *sound)) for one in both]
        moved = both[0].rms(both[0].predicted(fits[0][0]) - both[1].predicted(fits[0][0]))
    except EquilibriumError:  # such loads bend no robot: no positions can judge them
        return stated
    heard = judged(stated, fits[0][2], fits[1][2], readings.configuration[rows])
    own = [effect_sentence(f.effect, f.location) for f in found.findings if "sensor" in f.location]
    if heard.wrong == "either" and own and stated.what == "wrench":
        text = f"{stated.text[:-1]}; by itself the recording shows {', '.join(own)}: that of the recording is wrong."
        return dataclasses.replace(heard, wrong="recording", text=text)
    return heard if heard.wrong != "either" or moved > found.noise_known else None


def _with_angles(recorded: Readings, compared: Comparison) -> Readings:
    angles = recorded.q.copy()
    angles[compared.rows] = compared.simulated.q
    return dataclasses.replace(recorded, q=angles)


def with_sound_angles(found: Diagnosis, recorded: Readings) -> Readings:
    """Return a recording with the simulation's joint angles where the positions contradict its own, else as it is."""
    for compared in found.comparisons:
        wrong = any(one.what == ANGLES and one.wrong == "recording" for one in compared.witnesses)
        if wrong and len(compared.rows) == len(recorded):
            return _with_angles(recorded, compared)
    return recorded


def beside_wrong_angles(found: Diagnosis, before: Diagnosis) -> Diagnosis:
    """Add to what is found with the simulation's joint angles what was said of the recorded ones."""
    (compared,), (doubted,) = found.comparisons, before.comparisons
    contradicted = (
        dataclasses.replace(one, text=f"{one.text} {TAKEN}") for one in doubted.witnesses if one.what == ANGLES
    )
    witnesses = (*contradicted, *compared.witnesses)
    sentences = (*(one.text for one in witnesses if one.what == ANGLES), *compared.sentences)
    return dataclasses.replace(
        found, comparisons=(dataclasses.replace(compared, witnesses=witnesses, sentences=sentences),)
    )


def _parts(found: Diagnosis, model: ModelParameters) -> tuple[ModelPart, ...]:
    """Return stiffness and findings with the effects of the model that each stands for; given effects are known."""
    given = found.identification.given
    known = 0 if given is None else len(given.parameters.effects)
    findings = [f for f in found.findings if any(f.effect == e.effect for e in model.effects[known:])]
    places = range(known if findings else len(model.effects), len(model.effects))
    owner = {k: max(range(len(findings)), key=lambda i: _likeness(findings[i], model.effects[k])) for k in places}
    named = (
        ModelPart(f.effect, effect_sentence(f.effect, f.location), (), tuple(k for k in places if owner[k] == i))
        for i, f in enumerate(findings)
    )
    words = "the springs of the joints" + (", with the effects of the given model" if known else "")
    return (ModelPart(STIFFNESS, words, ("compliance",), tuple(range(places.start))), *named)


def _likeness(finding: Finding, effect: AppliedEffect) -> tuple[bool, bool]:
    """Tell how near an effect of the model is to a finding: it is it, or it refines what acts at the same place."""
    named, same = finding.effect == effect.effect, dict(finding.location) == dict(effect.location)
    return named, same


class _Tested:
    """A recording that was not fitted; where it holds postures at rest, with its own tracker and targets."""

    def __init__(
        self, test: Readings, model: ModelParameters, estimate: GaussianEstimate, cell: Cell, noise: float
    ) -> None:
        self._rows = ComparedRows(test, np.arange(len(test)), cell)
        self._at_rest = np.repeat(self._rows.still, 3)
        own = [k for k in _finite(estimate) if FRAMES.holds(estimate.names[k])] if self._at_rest.any() else []
        std = estimate.std[own]
        columns = self._rows.columns(model, [estimate.names[k] for k in own], std)
        self._columns = columns.reshape(3 * len(test), len(own))
        self._weight = np.diag((noise / (ELSEWHERE * std)) ** 2)

    def rms(self, model: ModelParameters) -> float:
        """Return what a model leaves, m per coordinate."""
        left = self._rows.left(model)
        flat = self._columns[self._at_rest]
        found = np.linalg.solve(flat.T @ flat + self._weight, flat.T @ left.ravel()[self._at_rest])
        return self._rows.rms(left - (self._columns @ found).reshape(-1, 3))


def _changes(part: ModelPart, estimate: GaussianEstimate, believed: ModelParameters) -> Iterator[ChangedNumber]:
    """Yield the numbers of a part, stiffnesses instead of compliances."""
    for name, unit, after, std in zip(estimate.names, estimate.units, estimate.value, estimate.std, strict=True):
        if not part.holds(name):
            continue
        before = 0.0 if name.startswith("effects.") else value_of(believed, name)
        low, high = after - 1.96 * std, after + 1.96 * std
        if name.startswith("compliance."):
            was, now, least, most = (1 / c if c > 0 else np.inf for c in (before, after, high, low))
            yield ChangedNumber(f"stiffness.{name.partition('.')[2]}", was, now, least, most, STIFF[unit])
        else:
            yield ChangedNumber(name, before, float(after), float(low), float(high), unit)


def _in_words(part: ModelPart, changed: Sequence[ChangedNumber]) -> str:
    """Say which numbers of a part changed, those of which it is surest first."""
    if part.effects and part.name != STIFFNESS:
        return part.what
    other = sorted(
        (one for one in changed if one.changed), key=lambda one: -abs(one.after - one.before) / (one.high - one.low)
    )
    if not other:
        return f"{part.what}: as the cell file says"
    listed = ", ".join(_changed_words(one) for one in other[:NAMED])
    return f"{listed}{f', and {len(other) - NAMED} more' if len(other) > NAMED else ''}"


def _changed_words(one: ChangedNumber) -> str:
    group, _, rest = one.name.partition(".")
    if group == "stiffness":
        return f"{plain_name(rest)} {1e-6 * one.before:.3g} -> {1e-6 * one.after:.3g} M{one.unit.replace('*', '·')}"
    place, _, axis = (rest if group in {"measurement_points", "geometry"} else one.name).rpartition(".")
    return f"{plain_name(place)} {axis} {1e3 * (one.after - one.before):+.3g} {'mm' if one.unit == 'm' else 'mrad'}"
