"""What is to be done next: start-up cycle, reference, configurations, spares in place of what was given up."""

from __future__ import annotations

import dataclasses
import itertools
import math
from collections.abc import Iterable, Sequence

import numpy as np

from calibration_core.planning.plans.plan import REFERENCE_NUMBER, PhaseName, Plan, PlannedConfiguration
from calibration_core.planning.plans.remaining_time import RemainingTime
from calibration_core.timeseries import Float1D, Float2D

PACE_KNOWN = 0.2  # share of a run, after which the pace of what is done is that of what is left


@dataclasses.dataclass(frozen=True)
class SequenceRules:
    """How the procedure runs.

    Attributes:
        attempts: Times that a configuration is tried at most.
        readings: Times that one reading is tried at most before the attempt is given up.
        startup_cycles: Times that the start-up cycle is driven through before measuring.
        startup_period: s, after which it is driven through once more (CWA 17384, 5.2); inf: never.
        motion_limit: s, after which a motion counts as blocked; settling and reading likewise below.
        settling_limit: s.
        reading_limit: s.
        joint_speed: rad/s, for the estimate of the time left; the durations below likewise.
        load_seconds: s, to change a load.
        reading_seconds: s, to settle and to read.
    """

    attempts: int = 2
    readings: int = 2
    startup_cycles: int = 1
    startup_period: float = 3600.0
    motion_limit: float = 180.0
    settling_limit: float = 60.0
    reading_limit: float = 120.0
    joint_speed: float = 0.15
    load_seconds: float = 5.0
    reading_seconds: float = 5.0


@dataclasses.dataclass(frozen=True, eq=False)
class Item:
    """One thing to do: drive somewhere and, if there are steps, measure there.

    Attributes:
        number: Configuration number; `REFERENCE_NUMBER` for the reference, the next configuration's for start-up.
        q: (n,) rad.
        steps: (k, 6) wrenches; empty: only drive there.
        first_step: Number of the first step (for the reference, of the visit).
        kind: `startup`, `reference` or `configuration`.
    """

    number: int
    q: Float1D
    steps: Float2D
    first_step: int
    kind: str
    phase: PhaseName = "compliance"


class MeasurementQueue:
    """The order of things.

    Args:
        plan: What is planned.
        rules: How it runs.
        completed: Numbers of configurations measured in an earlier run of the same session.
        given_up: Numbers of those that were given up.
        visits: Visits to the reference so far.

    Attributes:
        completed: Numbers of the configurations measured; likewise `given_up`.
        visits: Visits to the reference at which a reading was asked for, kept or not; the number of the next one.
        target: How many configurations are to be measured.
        warmed_up: When the start-up cycle was last driven through, s of the caller's clock; None: not yet.
    """

    def __init__(
        self, plan: Plan, rules: SequenceRules, completed: frozenset[int], given_up: frozenset[int], visits: int
    ) -> None:
        self.plan, self._rules = plan, rules
        self.completed, self.given_up, self.visits = set(completed), set(given_up), visits
        over = completed | given_up
        first = [*plan.preparation, *plan.primary]  # the phases before the compliance have no spares
        self._pending = [c for c in first if c.number not in over]
        self._spares = [c for c in plan.spares if c.number not in over]
        self.target = len(first)
        lost = sum(c.number in given_up for c in plan.preparation)
        while len(self.completed) + len(self._pending) + lost < self.target and self._spares:
            self._pending.append(self._spares.pop(0))
        self._startup_left = list(plan.startup_cycle) * rules.startup_cycles if self._pending else []
        self._startup_due = math.inf
        self.warmed_up: float | None = None
        self._warming = False
        self._phase: PhaseName | None = None
        self._since_reference = plan.reference.every if plan.reference is not None and self._pending else 0
        self._total = self._nominal_left()
        self._time = RemainingTime(self._expected_pace(), PACE_KNOWN * self._total)

    def next(self, now: float) -> Item | None:
        """Return what is to be done next, None if nothing is left; the same again until it is done or given up."""
        if self._pending and now >= self._startup_due:
            self._startup_left, self._startup_due = list(self.plan.startup_cycle), math.inf
        if self._startup_left:
            self._warming = True
            number = self._pending[0].number if self._pending else REFERENCE_NUMBER
            return Item(number, self._startup_left[0], np.empty((0, 6)), 0, "startup")
        if math.isinf(self._startup_due) and len(self.plan.startup_cycle):
            self._startup_due = now + self._rules.startup_period
        if self._warming:
            self.warmed_up, self._warming = now, False
        reference = self.plan.reference
        swept = bool(self._pending) and self._pending[0].phase != "compliance"  # nothing else within a sweep
        if reference is not None and reference.every and not swept:
            last = not self._pending and self._since_reference > 0
            if last or (self._pending and self._since_reference >= reference.every):
                return Item(REFERENCE_NUMBER, reference.q, np.zeros((1, 6)), self.visits, "reference")
        if self._pending:
            configuration = self._pending[0]
            return Item(
                configuration.number, configuration.q, configuration.steps, 0, "configuration", configuration.phase
            )
        return None

    def reading_asked(self, item: Item) -> None:
        """Use the number of a visit to the reference up: its reading may reach the disk even after it was given up."""
        if item.kind == "reference":
            self.visits = item.first_step + 1

    def again(self, item: Item) -> Item:
        """Return the item for its next attempt; a visit to the reference whose number is used up gets the next one."""
        return dataclasses.replace(item, first_step=self.visits) if item.kind == "reference" else item

    def done(self, item: Item) -> None:
        """Strike off what was done."""
        before = self._nominal_left()
        if item.kind == "startup":
            del self._startup_left[0]
        elif item.kind == "reference":
            self._since_reference = 0
        else:
            del self._pending[0]
            self.completed.add(item.number)
            self._since_reference += item.phase == "compliance"
        self._time.count(before - self._nominal_left())

    def give_up(self, item: Item) -> PlannedConfiguration | None:
        """Strike off what cannot be done; return the spare that takes the place of a configuration."""
        if item.kind == "startup":
            del self._startup_left[0]
            return None
        if item.kind == "reference":
            self._since_reference = 0
            return None
        del self._pending[0]
        self.given_up.add(item.number)
        if not self._spares or item.phase != "compliance":
            return None
        spare = self._spares.pop(0)
        self._pending.append(spare)
        return spare

    def enough(self, item: Item | None) -> None:
        """Strike off everything but what is under way, as not needed any more."""
        present = item is not None and item.kind == "configuration"
        self._pending, self._spares = self._pending[:1] if present else [], []
        self.target = len(self.completed) + len(self._pending)

    def phase_begins(self, item: Item) -> bool:
        """Tell whether a configuration is the first of its phase, in a plan that has several; once."""
        begins = bool(self.plan.preparation) and item.phase != self._phase
        self._phase = item.phase
        return begins

    @property
    def share_done(self) -> float:
        """Share of the work that is done, 0 ... 1, by nominal durations."""
        return max(0.0, 1.0 - self._nominal_left() / self._total) if self._total > 0 else 1.0

    @property
    def seconds_left(self) -> float:
        """Estimate of the time left, s, without pauses; NaN where nothing is known yet."""
        return self._time.of(self._nominal_left())

    def pass_time(self, now: float, *, working: bool) -> None:
        """Take the time, s of the caller's clock, and whether work was done since it was taken last."""
        self._time.pass_to(now, working=working)

    def _expected_pace(self) -> float:
        """Return how many seconds the plan expects for a nominal one; NaN: it expects nothing."""
        plan = self.plan
        total = math.nan if plan.expected is None else plan.expected.duration.get("total", math.nan)
        nominal = self._nominal(plan.startup_cycle, [*plan.preparation, *plan.primary])
        return total / nominal if nominal > 0.0 and 0.0 < total < math.inf else math.nan

    def _nominal_left(self) -> float:
        return self._nominal(self._startup_left, self._pending)

    def _nominal(self, startup: Iterable[Float1D], configurations: Sequence[PlannedConfiguration]) -> float:
        """Return the nominal seconds of a start-up cycle and configurations."""
        way = [*startup, *(c.q for c in configurations)]
        rules = self._rules
        driven = sum(float(np.abs(b - a).max()) for a, b in itertools.pairwise(way)) / rules.joint_speed
        steps = sum(len(c.steps) for c in configurations)
        return driven + steps * (rules.load_seconds + rules.reading_seconds)
