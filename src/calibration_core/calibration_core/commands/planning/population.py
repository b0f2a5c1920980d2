"""What a plan says where robots of the same type are known: how few configurations are enough for the next one."""

from __future__ import annotations

import dataclasses
from typing import Any

import numpy as np

from calibration_core.errors import InputError
from calibration_core.fleet.next_robot.planning import MOST, Needed, accuracy_with, needed
from calibration_core.fleet.next_robot.population_file import TypePopulation
from calibration_core.planning.plans.plan import Plan
from calibration_core.report.document import Items, Paragraph, Section
from calibration_core.report.rounding import spread


@dataclasses.dataclass(frozen=True, eq=False)
class Sisters:
    """What robots of the same type are worth for a plan.

    Attributes:
        population: Of the type.
        accuracy: Wanted standard deviation of ln stiffness.
        needed: How many configurations every joint needs.
        planned: Joint -> standard deviation with the configurations of the plan and the population.
        configurations: Of the plan.
    """

    population: TypePopulation
    accuracy: float
    needed: tuple[Needed, ...]
    planned: dict[str, float]
    configurations: int

    @property
    def enough(self) -> int | None:
        """Configurations that are enough for all joints; None where `MOST` are not."""
        counts = [one.together for one in self.needed]
        return None if any(count is None for count in counts) else max((c for c in counts if c is not None), default=0)


def sisters_of(plan: Plan, population: TypePopulation, accuracy: float) -> Sisters:
    """Return what a population is worth for a plan.

    Raises:
        InputError: The accuracy makes no sense, or the plan promises no stiffness.
    """
    if not 0.0 < accuracy < 1.0:
        raise InputError("--accuracy", "", f"{accuracy:g}", "a share of the stiffness above 0 and below 1, e.g. 0.01")
    expected = plan.expected
    if expected is None or expected.stiffness_std is None:
        raise InputError("--population", "", "a plan that promises no stiffness", "robot.stiffness in the cell file")
    finite = {
        joint: float(std) for joint, std in zip(plan.joints, expected.stiffness_std, strict=True) if np.isfinite(std)
    }
    count = len(plan.primary)
    planned = {joint: accuracy_with(std, count, count, population.joints[joint]) for joint, std in finite.items()}
    return Sisters(population, accuracy, needed(finite, count, population.joints, accuracy), planned, count)


def sisters_result(found: Sisters) -> dict[str, Any]:
    """Return what result.json says of it, with the provenance of the population."""
    return {
        "type": found.population.type,
        "file": found.population.file,
        "sha256": found.population.sha256,
        "source": found.population.source,
        "accuracy": found.accuracy,
        "configurations": found.enough,
        "joints": [{**dataclasses.asdict(one), "expected_std": found.planned[one.joint]} for one in found.needed],
    }


def sisters_summary(found: Sisters) -> list[str]:
    """Return it in words, a line each."""
    wanted = f"a standard deviation of {100 * found.accuracy:g} % for every joint"
    alone = [one.alone for one in found.needed]
    without = f"more than {MOST}" if None in alone else str(max((x for x in alone if x is not None), default=0))
    count = f"more than {MOST}" if found.enough is None else str(found.enough)
    known = f"with the population of type {found.population.type}"
    lines = [f"{wanted} takes {count} configurations {known}, and {without} without it"]
    if found.enough is not None and found.enough != found.configurations:
        lines.append(f"to plan so: --configurations {found.enough}")
    return lines


def sisters_section(found: Sisters) -> Section:
    """Return the section of the report."""
    items = tuple(
        f"{one.joint}: {_count(one.together)} with its sisters, {_count(one.alone)} alone; expected standard deviation "
        f"of this plan with its sisters {spread(100 * found.planned[one.joint])} %"
        for one in found.needed
    )
    source = f"{found.population.source}; {found.population.file}, SHA-256 {found.population.sha256}"
    text = (
        "Configurations that give the wanted accuracy where what is known of robots of the same type counts as well. "
        "This holds for a robot that belongs to its population; the diagnosis of its recording says whether it does."
    )
    return Section("With robots of the same type", "", (Paragraph(text), Paragraph(source), Items(items)))


def _count(count: int | None) -> str:
    return f"more than {MOST} configurations" if count is None else f"{count} configurations"
