"""Several recordings, each evaluated by itself first, and all of them as one."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence

from calibration_core.identification.identify import fit_freed
from calibration_core.identification.result.estimate import Identification
from calibration_core.identification.several.members import Member
from calibration_core.identification.several.merge import (
    Merged,
    merge,
    placed,
    start_of,
    with_readmitted,
    wrench_reference,
)
from calibration_core.identification.stiffness.end_effector import accounted
from calibration_core.identification.stiffness.known_effects import without_effects
from calibration_core.identification.stiffness.loaded import Options
from calibration_core.identification.stiffness.outlier_rejection import Key
from calibration_core.model.identified.given import GivenModel
from calibration_core.model.nominal import nominal_parameters
from calibration_core.model.parameters import ModelParameters
from calibration_core.observations.kinds import is_loaded
from calibration_core.timeseries import Readings


@dataclasses.dataclass(frozen=True, eq=False)
class Prepared:
    """Several recordings, each evaluated by itself, and all of them as one.

    Attributes:
        members: In the order of their numbers; what is known was taken off their readings.
        alone: What each shows by itself.
        named: Indices of the members in the order in which they were named.
        merged: All of them as one recording.
        options: How to evaluate that one.
        given: The model to start from, with the first recording's end effector; None: the cell file's.
        test: A recording of the first one's set-up, that is predicted and not fitted.
        starts: The model that each of the recordings starts from by itself; None: what its cell file believes.
    """

    members: tuple[Member, ...]
    alone: tuple[Identification, ...]
    named: tuple[int, ...]
    merged: Merged
    options: Options
    given: GivenModel | None
    test: Readings | None
    starts: tuple[ModelParameters | None, ...]

    @property
    def first(self) -> int:
        """Index of the recording that was named first: model file and test belong to its set-up."""
        return self.named[0]

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
    freed, alone, known = [], [], []
    for member in members:
        own = _own(given, member)
        readings = member.readings if own is None else without_effects(member.readings, member.cell, own)
        asked = dataclasses.replace(
            options, readmit=_own_keys(options.readmit, member), start=None if own is None else own.start
        )
        freed.append(dataclasses.replace(member, readings=readings))
        alone.append(with_readmitted(fit_freed(readings, member.cell, asked, None), asked.readmit))
        known.append(own)
    first = named[0]
    merged = merge(freed, alone, first)
    believed = nominal_parameters(merged.cell) if given is None else given.start
    if test is not None:
        own, member = known[first], freed[first]
        bare = test if own is None else without_effects(test, member.cell, own)
        test = _placed(bare, freed, alone, first, merged)
    together = dataclasses.replace(options, start=start_of(believed, merged))
    starts = tuple(None if own is None else own.start for own in known)
    return Prepared(tuple(freed), tuple(alone), tuple(named), merged, together, known[first], test, starts)


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
