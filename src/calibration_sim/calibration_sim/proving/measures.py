"""The table of measures: what all outcomes together say, beside the bars that they are held against."""

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

Chosen = Callable[[Case], bool]
Flags = Callable[[Case, Outcome], Iterable[bool]]


def measures(cases: Sequence[Case]) -> list[Measure]:
    """Return the whole table.  A recording without a result counts as one in which nothing is right."""
    typical = both(of_group("single"), lambda case: case.label["effects"][0]["amplitude"] == 1.0)
    seen = both(typical, lambda case: case.outcome is not None and case.outcome.found > 0)
    loads = {kind: both(typical, _protocol(kind)) for kind in "LR"}
    cluttered = both(of_group("clutter"), lambda case: case.label["clutter"] == 3.0)
    several = of_group("pair")
    return [
        most("nothing missing: a finding", cases, of_group("nothing"), lambda _, o: [o.found > 0], 0.01),
        most("nothing missing: verdict not `consistent`", cases, of_group("nothing"), _inconsistent, None),
        most("fifty small effects, SNR 3: a finding above 10 µm", cases, cluttered, lambda _, o: [o.large > 0], 0.10),
        least("effect right, given something found, typical", cases, seen, first_right, 0.97),
        least("place right, given the effect is right, typical", cases, typical, placed, 0.95),
        least("effect right, typical, with unloading", cases, loads["L"], first_right, 0.85),
        least("effect right, typical, with reversed load", cases, loads["R"], first_right, 0.90),
        least("effect right, typical, with unloading, 240 kg", cases, both(loads["L"], _heavy), first_right, None),
        least("effect right, typical, with reversed load, 240 kg", cases, both(loads["R"], _heavy), first_right, None),
        _limit("about the most that can be told, typical, with unloading", cases, loads["L"]),
        _limit("about the most that can be told, typical, with reversed load", cases, loads["R"]),
        most("a false second finding beside a single effect", cases, of_group("single"), false_beside, None),
        least("effect right, absolute and hardly visible ones besides", cases, of_group("besides"), first_right, None),
        least("pairs: both found", cases, several, lambda _, o: [all(o.effect_right)], 0.85),
        most("pairs: a false third", cases, several, false_beside, 0.08),
        least("triples: effects found", cases, of_group("triple"), lambda _, o: o.effect_right, None),
        most("triples: a false fourth", cases, of_group("triple"), false_beside, None),
        least("outside: flagged, nothing wrongly named", cases, of_group("outside"), _outside, 0.95),
        least("outside: flagged", cases, of_group("outside"), lambda _, o: [o.flagged], None),
        least("aliases: confounded, reported as such", cases, of_group("alias"), lambda _, o: [o.aliases_named], 1.0),
        least("anomalies: found, located, no physics claimed", cases, of_group("anomaly"), _anomaly, 0.97),
        within("parameters in their 95 % intervals, same law", cases, of_group("single"), lambda _, o: o.covered),
        within("stiffnesses in their 95 % intervals, single effects", cases, named_right("single"), stiff),
        _ratio(cases),
        *costs([case for case in cases if case.label["protocol"] == "L"], cases),
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


def of_group(name: str) -> Chosen:
    """Choose the cases of a group."""
    return lambda case: bool(case.label["group"] == name)


def _protocol(first: str) -> Chosen:
    return lambda case: str(case.label["protocol"]).startswith(first)


def _heavy(case: Case) -> bool:
    return bool(case.label["robot"] == "heavy")


def both(one: Chosen, other: Chosen) -> Chosen:
    """Choose what two choices have in common."""
    return lambda case: one(case) and other(case)


def _inconsistent(_: Case, outcome: Outcome) -> list[bool]:
    return [outcome.verdict != "consistent"]


def first_right(_: Case, outcome: Outcome) -> list[bool]:
    """Say whether the first finding names a label."""
    return [bool(outcome.first_right)]


def placed(_: Case, outcome: Outcome) -> list[bool]:
    """Say of each label that is named whether its place is right."""
    return [right for right in outcome.place_right if right is not None]


def false_beside(_: Case, outcome: Outcome) -> list[bool]:
    """Say whether something is named that is not there, beside something that is."""
    return [bool(outcome.named) and any(outcome.effect_right)]


def _outside(_: Case, outcome: Outcome) -> list[bool]:
    return [outcome.flagged and outcome.found == 0]


def _anomaly(_: Case, outcome: Outcome) -> list[bool]:
    return [all(outcome.anomaly_right) and outcome.found == 0]


def named_right(group: str) -> Chosen:
    """Choose the recordings of a group of which the first finding names a label."""
    return lambda case: case.label["group"] == group and case.outcome is not None and bool(case.outcome.first_right)


def stiff(_: Case, outcome: Outcome) -> tuple[bool, ...]:
    """Say of each stiffness whether its interval holds the truth."""
    return outcome.stiffness_covered


def _share(cases: Sequence[Case], chosen: Chosen, flags: Flags, missing: bool) -> tuple[float | None, int]:
    values: list[bool] = []
    for case in cases:
        if chosen(case):
            values += [missing] if case.outcome is None else list(flags(case, case.outcome))
    return (float(np.mean(values)) if values else None), len(values)


def least(text: str, cases: Sequence[Case], chosen: Chosen, flags: Flags, bar: float | None) -> Measure:
    """Return the share of flags that are true, which shall reach a bar; without a result none is true."""
    value, count = _share(cases, chosen, flags, missing=False)
    met = None if bar is None or value is None else value >= bar - 1e-12
    return Measure(text, value, "" if bar is None else f">= {bar:g}", met, count)


def most(text: str, cases: Sequence[Case], chosen: Chosen, flags: Flags, bar: float | None) -> Measure:
    """Return the share of flags that are true, which shall not exceed a bar; without a result all are true."""
    value, count = _share(cases, chosen, flags, missing=True)
    met = None if bar is None or value is None else value <= bar + 1e-12
    return Measure(text, value, "" if bar is None else f"<= {bar:g}", met, count)


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


def within(text: str, cases: Sequence[Case], chosen: Chosen, flags: Flags) -> Measure:
    """Return the share of 95 % intervals that hold the truth, which shall be neither too small nor too large."""
    done = [case for case in cases if case.outcome is not None]
    value, count = _share(done, chosen, flags, missing=False)
    return Measure(text, value, "0.92-0.98", None if value is None else 0.92 <= value <= 0.98, count)


def _ratio(cases: Sequence[Case]) -> Measure:
    ratios = [
        case.outcome.held_out_ratio
        for case in cases
        if case.label["group"] == "single" and case.outcome is not None and case.outcome.held_out_ratio is not None
    ]
    value = float(np.median(ratios)) if ratios else None
    text = "held-out rms after / noise, single effects, median"
    return Measure(text, value, "<= 1.05", None if value is None else value <= 1.05, len(ratios))


def costs(chosen: Sequence[Case], cases: Sequence[Case]) -> list[Measure]:
    """Return what the diagnoses of chosen recordings took, and how many of all failed."""
    runs = [case.run for case in chosen if case.run is not None]
    seconds = np.array([run.seconds for run in runs])
    memory = np.array([run.megabytes for run in runs])
    count, some = len(runs), len(runs) > 0
    failed = [case.outcome is None for case in cases]
    busy = np.array([run.processor for run in runs if run.processor is not None])
    slow = float(np.quantile(seconds, 0.95)) if some else None
    busiest = float(np.quantile(busy, 0.95)) if len(busy) else None
    large = float(memory.max()) if some else None
    middle = float(np.median(seconds)) if some else None
    share = float(np.mean(failed)) if failed else None
    return [
        Measure("s per recording (18 x 9 x 3), median", middle, "", None, count),
        Measure("s per recording (18 x 9 x 3), 95 %", slow, "<= 10", None if slow is None else slow <= 10.0, count),
        Measure(
            "processor s per recording (18 x 9 x 3), 95 %",
            busiest,
            "<= 10",
            None if busiest is None else busiest <= 10.0,
            len(busy),
        ),
        Measure("MB per recording, largest", large, "<= 500", None if large is None else large <= 500.0, count),
        Measure("diagnoses that failed", share, "<= 0", None if share is None else share == 0.0, len(failed)),
    ]


def markdown(cases: Sequence[Case], head: str) -> str:
    """Return the table and the power per effect, as Markdown."""
    lines = [head, "", *as_table(measures(cases))]
    lines += ["", "Named right by amplitude (typical = 1), median signal-to-noise ratio in brackets:", ""]
    lines += ["| effect | robot | protocol | x0.5 | x1 | x2 |", "|---|---|---|---|---|---|"]
    for row in power(cases):
        shares = [
            f"{row['right'][a]:.2f} ({row['snr'][a]:.0f})" if a in row["right"] else "" for a in ("0.5", "1", "2")
        ]
        lines.append(f"| {row['effect']} | {row['robot']} | {row['protocol']} | " + " | ".join(shares) + " |")
    return "\n".join([*lines, ""])


def as_table(rows: Sequence[Measure]) -> list[str]:
    """Return the lines of a Markdown table."""
    lines = ["| measure | value | bar | met | n |", "|---|---|---|---|---|"]
    for measure in rows:
        value = "-" if measure.value is None else f"{measure.value:.3g}"
        met = "" if measure.met is None else ("yes" if measure.met else "**no**")
        lines.append(f"| {measure.text} | {value} | {measure.bar} | {met} | {measure.count} |")
    return lines
