"""The table of the second grid: every kind beside its bars."""

from __future__ import annotations

from collections.abc import Sequence

from calibration_sim.proving.measures import (
    Case,
    Measure,
    as_table,
    both,
    costs,
    false_beside,
    first_right,
    least,
    most,
    named_right,
    of_group,
    placed,
    stiff,
    within,
)
from calibration_sim.proving.scoring import Outcome

SINGLE_CAUSES = {
    "rest": "at rest",
    "mixed": "loaded and at rest",
    "other_robot": "robots of 3, 60 and 500 kg",
    "other_names": "other names of joints and points",
    "everywhere": "every joint a little",
    "prismatic": "a first axis that slides",
}


def second_measures(cases: Sequence[Case]) -> list[Measure]:
    """Return the table; of a kind without a recording there is no line.

    A recording without a result counts as one in which nothing is right.
    """
    present = {str(case.label["group"]) for case in cases}
    rows: list[Measure] = []
    for kind, words in SINGLE_CAUSES.items():
        if kind in present:
            chosen = both(of_group(kind), _something)
            rows += [
                least(f"{words}: named first", cases, chosen, first_right, 0.95),
                least(f"{words}: place right, given the effect is right", cases, chosen, placed, 0.97),
                most(f"{words}: a false second finding", cases, chosen, false_beside, 0.02),
            ]
            if kind == "mixed":  # every recording shows all stiffnesses
                text = f"{words}: stiffnesses in their 95 % intervals, cause right"
                rows.append(within(text, cases, named_right(kind), stiff))
    if "across" in present:
        chosen = of_group("across")
        rows += [
            least("one under load and one at rest: one of them named first", cases, chosen, first_right, 0.95),
            least("one under load and one at rest: both found", cases, chosen, _all_found, 0.85),
            least("one under load and one at rest: places right", cases, chosen, placed, 0.97),
            most("one under load and one at rest: a false third finding", cases, chosen, false_beside, 0.02),
            within(
                "one under load and one at rest: stiffnesses in their 95 % intervals, a cause right",
                cases,
                named_right("across"),
                stiff,
            ),
        ]
    if "other_law" in present:
        text = "laws of other shapes: joint and kind right or unexplained, never to the noise"
        rows.append(least(text, cases, of_group("other_law"), lambda _, o: [o.kind_right], 0.95))
    if "nothing_else" in present:
        chosen = _empty
        rows.append(most("nothing missing: a finding", cases, chosen, lambda _, o: [o.found > 0], 0.01))
    return [*rows, *costs(cases, cases)]


def _something(case: Case) -> bool:
    return bool(case.label["effects"])


def _empty(case: Case) -> bool:
    return not case.label["effects"]


def _all_found(_: Case, outcome: Outcome) -> list[bool]:
    return [all(outcome.effect_right)]


def second_markdown(cases: Sequence[Case], head: str) -> str:
    """Return the table as Markdown."""
    return "\n".join([head, "", *as_table(second_measures(cases)), ""])
