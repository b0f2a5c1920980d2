"""Several recordings, each evaluated by itself first, and all of them as one."""

from __future__ import annotations

import dataclasses
import functools
from collections.abc import Mapping, Sequence

from calibration_core.cell import Cell
from calibration_core.identification.identify import fit_freed
from calibration_core.identification.result.estimate import Disagreement, Identification
from calibration_core.identification.several.merge import (
    Member,
    Merged,
    merge,
    placed,
    start_of,
    with_readmitted,
    wrench_reference,
)
from calibration_core.identification.stiffness.end_effector import accounted, without_effects
from calibration_core.identification.stiffness.fit import Key
from calibration_core.identification.stiffness.loaded import Options
from calibration_core.model.identified.gaussian import GaussianEstimate
from calibration_core.model.identified.model_file import GivenModel
from calibration_core.model.nominal import nominal_parameters
from calibration_core.model.parameters import ModelParameters
from calibration_core.observations.kinds import is_loaded
from calibration_core.timeseries import Readings

GEOMETRY = "geometry."


@dataclasses.dataclass(frozen=True, eq=False)
class Prepared:
    """Several recordings, each evaluated by itself, and all of them as one.

    Attributes:
        members: In the order of their numbers; what is known was taken off their readings.
        alone: What each shows by itself.
        named: Indices of the members in the order in which they were named.
        merged: All of them as one recording.
        options: How to evaluate that one.
        test: A recording of the first one's set-up, that is predicted and not fitted, as it stands beside those of all.
        bare: The same as in its own files, less what is known.
        known: The model that each of the recordings starts from by itself, with its own frames and end effector; None:
            what its cell file believes.
        asked: How it was asked to evaluate.
        believed: The model that was given for all; None: none was.
        with_changes: The recordings as they were measured, where these are free of what differs between them.
        changes: What differs, and is taken off.
    """

    members: tuple[Member, ...]
    alone: tuple[Identification, ...]
    named: tuple[int, ...]
    merged: Merged
    options: Options
    test: Readings | None
    bare: Readings | None
    known: tuple[GivenModel | None, ...]
    asked: Options
    believed: GivenModel | None
    with_changes: Prepared | None = None
    changes: tuple[Disagreement, ...] = ()

    @property
    def given(self) -> GivenModel | None:
        """The model to start from, with the first recording's end effector; None: the cell file's."""
        return self.known[self.first]

    @property
    def starts(self) -> tuple[ModelParameters | None, ...]:
        """The numbers that each of the recordings starts from by itself; None: what its cell file believes."""
        return tuple(None if own is None else own.start for own in self.known)

    @property
    def first(self) -> int:
        """Index of the recording that was named first: model file and test belong to its set-up."""
        return self.named[0]

    @property
    def measured(self) -> Prepared:
        """The recordings as they were measured, changes of the robot between them included."""
        return self.with_changes or self

    @property
    def corrects(self) -> bool:
        """Whether one of the recordings proves by itself that the geometry is to be corrected."""
        return any(_shows_geometry(one.estimate) for one in self.alone)

    @functools.cached_property
    def shown(self) -> tuple[GaussianEstimate, ...]:
        """What each recording shows by itself; where one proves an error of the geometry, what all know of it, too."""
        if not self.corrects:
            return tuple(one.estimate for one in self.alone)
        return tuple(
            one.estimate if _shows_geometry(one.estimate) else self._corrected(member, start)
            for one, member, start in zip(self.alone, self.members, self.starts, strict=True)
        )

    def _corrected(self, member: Member, start: ModelParameters | None) -> GaussianEstimate:
        options = Options(robust=self.options.robust, start=start, corrected=True)
        return fit_freed(member.readings, member.cell, options, None).estimate

    def placed(self, readings: Readings) -> Readings:
        """Return further readings of the first recording's set-up, as they stand beside those of all."""
        return _placed(readings, self.members, self.alone, self.first, self.merged)


def prepare(
    members: Sequence[Member],
    named: Sequence[int],
    options: Options,
    test: Readings | None = None,
    given: GivenModel | None = None,
) -> Prepared:
    """Evaluate every recording by itself, and put all of them together.

    Args:
        members: The recordings, in the order of their numbers.
        named: Their indices in the order in which they were named.
        options: How to evaluate; readings to use all the same are named and numbered as beside the others.
        test: A recording of the first one's set-up.
        given: A model to start from; its frames and points are those of none of the recordings.

    Raises:
        InputError: A recording cannot be evaluated by itself; the message names it.
    """
    known = tuple(_own(given, member) for member in members)
    freed = [
        dataclasses.replace(member, readings=_bare(member.readings, member.cell, own))
        for member, own in zip(members, known, strict=True)
    ]
    first = named[0]
    bare = None if test is None else _bare(test, members[first].cell, known[first])
    return evaluated(freed, known, named, options, bare, given, {})


def evaluated(
    members: Sequence[Member],
    known: Sequence[GivenModel | None],
    named: Sequence[int],
    options: Options,
    test: Readings | None,
    believed: GivenModel | None,
    done: Mapping[int, Identification],
) -> Prepared:
    """Evaluate recordings by themselves that are free of what is known, and put them together.

    Args:
        members: The recordings, in the order of their numbers.
        known: The model that each starts from by itself.
        named: As `prepare`.
        options: As `prepare`.
        test: As `prepare`, free of what is known, too.
        believed: The model that was given for all.
        done: Index of a recording -> what it shows by itself, where that was evaluated before.

    Raises:
        InputError: As `prepare`.
    """
    alone = [done[k] if k in done else _alone(member, known[k], options) for k, member in enumerate(members)]
    first = named[0]
    merged = merge(members, alone, first)
    start = start_of(nominal_parameters(merged.cell) if believed is None else believed.start, merged)
    return Prepared(
        members=tuple(members),
        alone=tuple(alone),
        named=tuple(named),
        merged=merged,
        options=dataclasses.replace(options, start=start),
        test=None if test is None else _placed(test, members, alone, first, merged),
        bare=test,
        known=tuple(known),
        asked=options,
        believed=believed,
    )


def _alone(member: Member, own: GivenModel | None, options: Options) -> Identification:
    """Return what one recording shows by itself, with the readings that are to be used all the same."""
    readmit = _own_keys(options.readmit, member)
    asked = dataclasses.replace(options, readmit=readmit, start=None if own is None else own.start)
    return with_readmitted(fit_freed(member.readings, member.cell, asked, None), readmit)


def _shows_geometry(estimate: GaussianEstimate) -> bool:
    return any(name.startswith(GEOMETRY) for name in estimate.names)


def _bare(readings: Readings, cell: Cell, own: GivenModel | None) -> Readings:
    return readings if own is None else without_effects(readings, cell, own)


def _placed(
    readings: Readings, members: Sequence[Member], alone: Sequence[Identification], first: int, merged: Merged
) -> Readings:
    reference = wrench_reference(members, first)
    like = dataclasses.replace(members[first], readings=readings)
    stated, differences = (members[reference], alone[reference]), merged.cell.measurements.points == "displacement"
    return placed(like, alone[first], stated, merged.readings.points, differences=differences)


def _own(given: GivenModel | None, member: Member) -> GivenModel | None:
    """Return the given model with frames and points of one recording, and its end effector."""
    if given is not None:
        cell = member.cell
        if cell.frames.tracker is None and given.parameters.effects:
            raise cell.missing("frames.tracker", "taking off the effects of the given model")
        nominal = nominal_parameters(cell)
        parameters = given.parameters.replace(
            tracker=nominal.tracker,
            points=nominal.points,
            wrench_point=nominal.wrench_point,
            force_torque=nominal.force_torque,
        )
        given = dataclasses.replace(given, parameters=parameters)
    return accounted(member.cell, given) if is_loaded(member.readings) else given


def _own_keys(keys: frozenset[Key], member: Member) -> frozenset[Key]:
    """Return the readings of one recording among those to be used all the same, as its own files number them."""
    mark = f"@{member.number}"
    return frozenset(
        (configuration - member.first_number, step, point.removesuffix(mark))
        for configuration, step, point in keys
        if point.endswith(mark)
    )
