"""The tables of measures, one per grid: what all outcomes together say, beside the bars that they are held against."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import Any

import numpy as np
from scipy.special import ndtr, ndtri

from calibration_sim.proving.diagnosing import Run
from calibration_sim.proving.scoring import Outcome


@dataclasses.dataclass(frozen=True)
class Case:
    """One recording with everything that is known of it.

    Attributes:
        name: Of the recording.
        label: What was in it.
        outcome: What came of it; None: no result.
        run: How the diagnosis went; None: not run.
    """

    name: str
    label: Mapping[str, Any]
    outcome: Outcome | None
    run: Run | None


@dataclasses.dataclass(frozen=True)
class Measure:
    """One line of the table.

    Attributes:
        text: What is measured.
        value: The figure; None: no recording tells.
        bar: What it is held against, as text.
        met: Whether it is met; None: no bar or no figure.
        count: Recordings (or parameters) behind the figure.
    """

    text: str
    value: float | None
    bar: str
    met: bool | None
    count: int


FALSE_ALARM = 0.01  # of the best test there can be, as of the diagnosis
PLACES = 60  # hypotheses that a loaded recording is asked about, by and large
BESIDES_LOADS = frozenset({"tracker_frame_misalignment", "measurement_point_offset"})  # seen by absolute positions, too
SHOWN = 6.0  # signal-to-noise ratio of the smallest effect that a test can name among sixty
MORE = 1.35  # times the true noise: what no verdict may call noise
COVERING = (0.92, 0.98)  # share of 95 % intervals that hold the truth

Chosen = Callable[[Case], bool]
Flags = Callable[[Outcome], Iterable[bool]]
Bounded = tuple[str, str, Chosen, Flags, float | None]  # LEAST or MOST, text, recordings, flags of each, bar
LEAST, MOST, WITHIN = "least", "most", "within"  # of the flags that are true; WITHIN: 95 % intervals, no other bar


def _group(name: str, also: Chosen = bool) -> Chosen:
    return lambda case: bool(case.label["group"] == name) and also(case)


def _named_right(group: str) -> Chosen:
    return _group(group, lambda case: case.outcome is not None and bool(case.outcome.first_right))


def _typical(case: Case) -> bool:
    return bool(case.label["group"] == "single" and case.label["effects"][0]["amplitude"] == 1.0)


def _loaded(kind: str, robot: str = "") -> Chosen:
    return lambda case: (
        _typical(case) and str(case.label["protocol"]).startswith(kind) and robot in {"", case.label["robot"]}
    )


def _something(case: Case) -> bool:
    return bool(case.label["effects"])


def _empty(case: Case) -> bool:
    return not case.label["effects"]


def _shown(case: Case) -> bool:
    return _something(case) and case.label["snr"][0] >= SHOWN


def _first(outcome: Outcome) -> list[bool]:
    return [bool(outcome.first_right)]


def _all(outcome: Outcome) -> list[bool]:
    return [all(outcome.effect_right)]


def _placed(outcome: Outcome) -> list[bool]:
    """Say of each label that is named whether its place is right."""
    return [right for right in outcome.place_right if right is not None]


def _false_beside(outcome: Outcome) -> list[bool]:
    """Say whether something is named that is not there, beside something that is."""
    return [bool(outcome.named) and any(outcome.effect_right)]


def _found(outcome: Outcome) -> list[bool]:
    return [outcome.found > 0]


def _stiff(outcome: Outcome) -> tuple[bool, ...]:
    return outcome.stiffness_covered


def _honest(outcome: Outcome) -> list[bool]:
    return [bool(outcome.first_right) or outcome.beside_first or outcome.flagged]


def _misjudged(outcome: Outcome) -> list[bool]:
    to_its_noise = outcome.verdict in {"consistent", "missing_physics"}
    return [to_its_noise and outcome.left_ratio is not None and outcome.left_ratio > MORE]


NOTHING, CLUTTERED = _group("nothing"), _group("clutter", lambda case: case.label["clutter"] == 3.0)
SEEN: Chosen = lambda case: _typical(case) and case.outcome is not None and case.outcome.found > 0  # noqa: E731
BEFORE_LIMITS: tuple[Bounded, ...] = (
    (MOST, "nothing missing: a finding", NOTHING, _found, 0.01),
    (MOST, "nothing missing: verdict not `consistent`", NOTHING, lambda o: [o.verdict != "consistent"], None),
    (MOST, "fifty small effects, SNR 3: a finding above 10 µm", CLUTTERED, lambda o: [o.large > 0], 0.10),
    (LEAST, "effect right, given something found, typical", SEEN, _first, 0.97),
    (LEAST, "place right, given the effect is right, typical", _typical, _placed, 0.95),
    (LEAST, "effect right, typical, with unloading", _loaded("L"), _first, 0.85),
    (LEAST, "effect right, typical, with reversed load", _loaded("R"), _first, 0.90),
    (LEAST, "effect right, typical, with unloading, 240 kg", _loaded("L", "heavy"), _first, None),
    (LEAST, "effect right, typical, with reversed load, 240 kg", _loaded("R", "heavy"), _first, None),
)
AFTER_LIMITS: tuple[Bounded, ...] = (
    (MOST, "a false second finding beside a single effect", _group("single"), _false_beside, None),
    (LEAST, "effect right, absolute and hardly visible ones besides", _group("besides"), _first, None),
    (LEAST, "pairs: both found", _group("pair"), _all, 0.85),
    (MOST, "pairs: a false third", _group("pair"), _false_beside, 0.08),
    (LEAST, "triples: effects found", _group("triple"), lambda o: o.effect_right, None),
    (MOST, "triples: a false fourth", _group("triple"), _false_beside, None),
    (LEAST, "outside: flagged, nothing wrongly named", _group("outside"), lambda o: [o.flagged and o.found == 0], 0.95),
    (LEAST, "outside: flagged", _group("outside"), lambda o: [o.flagged], None),
    (LEAST, "aliases: confounded, reported as such", _group("alias"), lambda o: [o.aliases_named], 1.0),
    (
        LEAST, "anomalies: found, located, no physics claimed", _group("anomaly"),
        lambda o: [all(o.anomaly_right) and o.found == 0], 0.97,
    ),
    (WITHIN, "parameters in their 95 % intervals, same law", _group("single"), lambda o: o.covered, None),
    (WITHIN, "stiffnesses in their 95 % intervals, single effects", _named_right("single"), _stiff, None),
)  # fmt: skip


def _single_cause(kind: str, words: str) -> tuple[Bounded, ...]:
    chosen = _group(kind, _something)
    return (
        (LEAST, f"{words}: named first", chosen, _first, 0.95),
        (LEAST, f"{words}: place right, given the effect is right", chosen, _placed, 0.97),
        (MOST, f"{words}: a false second finding", chosen, _false_beside, 0.02),
    )


TWO, SPARSE = "one under load and one at rest", "one target, zero and full load"
ACROSS, MINIMAL_SHOWN, MINIMAL_EMPTY = _group("across"), _group("minimal", _shown), _group("minimal", _empty)
OF_KINDS: Mapping[str, tuple[Bounded, ...]] = {
    "rest": _single_cause("rest", "at rest"),
    "mixed": (
        *_single_cause("mixed", "loaded and at rest"),  # every recording shows all stiffnesses
        (WITHIN, "loaded and at rest: stiffnesses in their 95 % intervals, cause right", _named_right("mixed"), _stiff,
         None),
    ),
    "other_robot": _single_cause("other_robot", "robots of 3, 60 and 500 kg"),
    "other_names": _single_cause("other_names", "other names of joints and points"),
    "everywhere": _single_cause("everywhere", "every joint a little"),
    "prismatic": _single_cause("prismatic", "a first axis that slides"),
    "across": (
        (LEAST, f"{TWO}: one of them named first", ACROSS, _first, 0.95),
        (LEAST, f"{TWO}: both found", ACROSS, _all, 0.85),
        (LEAST, f"{TWO}: places right", ACROSS, _placed, 0.97),
        (MOST, f"{TWO}: a false third finding", ACROSS, _false_beside, 0.02),
        (WITHIN, f"{TWO}: stiffnesses in their 95 % intervals, a cause right", _named_right("across"), _stiff, None),
    ),
    "other_law": (
        (LEAST, "laws of other shapes: joint and kind right or unexplained, never to the noise", _group("other_law"),
         lambda o: [o.kind_right], 0.95),
    ),
    "nothing_else": ((MOST, "nothing missing: a finding", _empty, _found, 0.01),),
    "minimal": (
        (LEAST, f"{SPARSE}: named first or beside it, or said to be left, SNR {SHOWN:g} and more", MINIMAL_SHOWN,
         _honest, 0.95),
        (LEAST, f"{SPARSE}: named first, SNR {SHOWN:g} and more", MINIMAL_SHOWN, _first, None),
        (MOST, f"{SPARSE}: nothing missing: a finding", MINIMAL_EMPTY, _found, 0.01),
        (WITHIN, f"{SPARSE}: stiffnesses in their 95 % intervals, nothing missing", MINIMAL_EMPTY, _stiff, None),
        (WITHIN, f"{SPARSE}: the same, cause right", _named_right("minimal"), _stiff, None),
    ),
}  # fmt: skip


def measures(cases: Sequence[Case]) -> list[Measure]:
    """Return the whole table.  A recording without a result counts as one in which nothing is right."""
    about = "about the most that can be told, typical, with"
    return [
        *(_measure(cases, *line) for line in BEFORE_LIMITS),
        _limit(f"{about} unloading", cases, _loaded("L")),
        _limit(f"{about} reversed load", cases, _loaded("R")),
        *(_measure(cases, *line) for line in AFTER_LIMITS),
        _ratio(cases),
        *costs([case for case in cases if case.label["protocol"] == "L"], cases),
    ]


def second_measures(cases: Sequence[Case]) -> list[Measure]:
    """Return the table of the second grid; of a kind without a recording there is no line.

    A recording without a result counts as one in which nothing is right.
    """
    present = {str(case.label["group"]) for case in cases}
    rows = [_measure(cases, *line) for kind, lines in OF_KINDS.items() if kind in present for line in lines]
    text = f"said to be explained to the noise, more than {MORE:g} times the true noise left"
    quiet = [case for case in cases if case.outcome is not None and case.outcome.left_ratio is not None]
    return [*rows, _measure(quiet, MOST, text, lambda _: True, _misjudged, 0.02), *costs(cases, cases)]


def _measure(cases: Sequence[Case], sense: str, text: str, chosen: Chosen, flags: Flags, bar: float | None) -> Measure:
    """Return the share of flags that are true; without a result none is that shall be, all are that shall not."""
    values: list[bool] = []
    for case in cases:
        if chosen(case) and case.outcome is not None:
            values += flags(case.outcome)
        elif chosen(case) and sense != WITHIN:
            values.append(sense == MOST)
    value = float(np.mean(values)) if values else None
    if sense == WITHIN:
        low, high = COVERING
        return Measure(text, value, f"{low:g}-{high:g}", None if value is None else low <= value <= high, len(values))
    return _held(text, value, "" if bar is None else f"{'>=' if sense == LEAST else '<='} {bar:g}", len(values))


def _held(text: str, value: float | None, bar: str, count: int) -> Measure:
    """Return a measure held against a bar: `>= number`, `<= number`, or none."""
    met = None
    if bar and value is not None:
        sign, number = 1.0 if bar.startswith(">=") else -1.0, float(bar[3:])
        met = sign * (value - number) >= -1e-12
    return Measure(text, value, bar, met, count)


def _limit(text: str, cases: Sequence[Case], chosen: Chosen) -> Measure:
    """Return about the most power that choosing among as many places allows, at the same share of false alarms.

    A test that knows noise, direction and size of every hypothesis beforehand has it, each hypothesis having its share
    of the false alarms (Neyman and Pearson 1933); one that must find these out has less.  What absolute positions show,
    too, is counted as told: the signal-to-noise ratio is that of the load steps.
    """
    threshold = -ndtri(FALSE_ALARM / PLACES)
    effects = [(case.label["effects"][0]["effect"], float(case.label["snr"][0])) for case in cases if chosen(case)]
    detected = [1.0 if effect in BESIDES_LOADS else float(ndtr(ratio - threshold)) for effect, ratio in effects]
    words = f"{text}, {100 * FALSE_ALARM:g} % false alarms among {PLACES} places"
    return Measure(words, float(np.mean(detected)) if detected else None, "", None, len(detected))


def _ratio(cases: Sequence[Case]) -> Measure:
    single = [case.outcome for case in cases if case.label["group"] == "single" and case.outcome is not None]
    ratios = [outcome.held_out_ratio for outcome in single if outcome.held_out_ratio is not None]
    value = float(np.median(ratios)) if ratios else None
    return _held("held-out rms after / noise, single effects, median", value, "<= 1.05", len(ratios))


def costs(chosen: Sequence[Case], cases: Sequence[Case]) -> list[Measure]:
    """Return what the diagnoses of chosen recordings took, and how many of all failed."""
    runs = [case.run for case in chosen if case.run is not None]
    busy = [run.processor for run in runs if run.processor is not None]
    seconds, memory = [run.seconds for run in runs], [run.megabytes for run in runs]
    failed = [float(case.outcome is None) for case in cases]

    def figure(values: Sequence[float], of: Callable[..., Any], *more: float) -> float | None:
        return float(of(values, *more)) if values else None

    usual = "s per recording (18 x 9 x 3)"
    return [
        _held(f"{usual}, median", figure(seconds, np.median), "", len(runs)),
        _held(f"{usual}, 95 %", figure(seconds, np.quantile, 0.95), "<= 10", len(runs)),
        _held(f"processor {usual}, 95 %", figure(busy, np.quantile, 0.95), "<= 10", len(busy)),
        _held("MB per recording, largest", figure(memory, max), "<= 500", len(runs)),
        _held("diagnoses that failed", figure(failed, np.mean), "<= 0", len(failed)),
    ]


def power(cases: Sequence[Case]) -> list[dict[str, Any]]:
    """Return, per effect and protocol, the share of singles named right at each amplitude, and the median SNR."""
    rows: dict[tuple[str, str, str], dict[str, Any]] = {}
    for case in cases:
        if case.label["group"] not in {"single", "besides"}:
            continue
        effect = case.label["effects"][0]
        key = (str(effect["effect"]), str(case.label["robot"]), str(case.label["protocol"]))
        row = rows.setdefault(key, {"effect": key[0], "robot": key[1], "protocol": key[2], "right": {}, "snr": {}})
        amplitude = f"{effect['amplitude']:g}"
        right = case.outcome is not None and bool(case.outcome.first_right)
        row["right"].setdefault(amplitude, []).append(right)
        row["snr"].setdefault(amplitude, []).append(float(case.label["snr"][0]))
    for row in rows.values():
        row["right"] = {key: float(np.mean(value)) for key, value in row["right"].items()}
        row["snr"] = {key: float(np.median(value)) for key, value in row["snr"].items()}
    return list(rows.values())


def wrong(cases: Sequence[Case]) -> list[dict[str, Any]]:
    """Return every recording whose diagnosis said something that was not there, failed, or missed an effect."""
    rows = []
    for case in cases:
        truth = [effect["effect"] for effect in case.label["effects"]]
        row = {"name": case.name, "group": case.label["group"], "truth": truth}
        if case.outcome is None:
            rows.append({**row, "failed": "not run" if case.run is None else case.run.error})
        elif case.outcome.named or not all(case.outcome.effect_right):
            missed = [e for e, right in zip(truth, case.outcome.effect_right, strict=True) if not right]
            rows.append({**row, "named": list(case.outcome.named), "missed": missed, "verdict": case.outcome.verdict})
    return rows


def power_table(cases: Sequence[Case]) -> list[str]:
    """Return the lines of Markdown that say what is named right, effect by effect."""
    lines = ["Named right by amplitude (typical = 1), median signal-to-noise ratio in brackets:", ""]
    lines += ["| effect | robot | protocol | x0.5 | x1 | x2 |", "|---|---|---|---|---|---|"]
    for row in power(cases):
        shares = [
            f"{row['right'][a]:.2f} ({row['snr'][a]:.0f})" if a in row["right"] else "" for a in ("0.5", "1", "2")
        ]
        lines.append(f"| {row['effect']} | {row['robot']} | {row['protocol']} | " + " | ".join(shares) + " |")
    return [*lines, ""]


def as_table(rows: Sequence[Measure]) -> list[str]:
    """Return the lines of a Markdown table."""
    lines = ["| measure | value | bar | met | n |", "|---|---|---|---|---|"]
    for measure in rows:
        value = "-" if measure.value is None else f"{measure.value:.3g}"
        met = "" if measure.met is None else ("yes" if measure.met else "**no**")
        lines.append(f"| {measure.text} | {value} | {measure.bar} | {met} | {measure.count} |")
    return lines
