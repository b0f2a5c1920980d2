"""Measurements of one robot at different times, or of twins: what has changed, and what cannot be distinguished."""

from __future__ import annotations

import dataclasses
import datetime as dt
import json
import math
from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np

from calibration_core.acceptance.comparison import (
    COMPLIANCE,
    OF_JOINTS,
    Measurement,
    QuantityChange,
    Trend,
    compare,
    trends,
)
from calibration_core.acceptance.joint_laws import joint_laws, reference_torques
from calibration_core.cell import Cell
from calibration_core.errors import InputError, ModelFileError, RecordingError, quoted
from calibration_core.files.regular import read_regular
from calibration_core.identification.identify import identify
from calibration_core.identification.result.estimate import Identification
from calibration_core.model.effects.candidate import typical
from calibration_core.model.effects.words import listed_location
from calibration_core.model.identified.calibrated import CalibratedModel
from calibration_core.model.identified.gaussian import GaussianEstimate
from calibration_core.model.identified.model_file import read_calibrated
from calibration_core.observations.kinds import is_loaded
from calibration_core.observations.observe import observe
from calibration_core.outcomes.inputs import digest_of, look
from calibration_core.recording.source import digests_of_several
from calibration_core.report.results.provenance import further_cells
from calibration_core.report.rounding import listed, readable_unit, significant
from calibration_core.report.writing.output import MAX_RESULT, RESULT
from calibration_core.timeseries import Readings

MODEL = "model.yaml"
WORDS = {"changed": "changed", "not_changed": "not changed", "cannot_tell": "cannot tell"}
PERHAPS = "perhaps changed (certain of this one alone, not among all that were compared)"
PRACTICAL = 100  # configurations: more than two working days, and no plan measures them
SHOWN = 8  # quantities that a sentence names
NOTHING = GaussianEstimate.nothing()


@dataclasses.dataclass(frozen=True, eq=False)
class Compared:
    """What was compared, and what came out.

    Attributes:
        measurements: In the order of the command line.
        trends: Over time; empty for fewer than three.
        cells: One per measurement.
        digests: Measurement and file -> SHA-256 of every recording and model.
        remarks: What a reader must know besides, a sentence each.
        steps: Number of measured steps of the first, all configurations together; None where its result states none.
        loaded: Whether the first was measured under loads.
    """

    measurements: tuple[Measurement, ...]
    differences: tuple[tuple[QuantityChange, ...], ...]
    trends: tuple[Trend, ...]
    cells: tuple[Cell, ...]
    digests: dict[str, str]
    remarks: tuple[str, ...]
    steps: int | None
    loaded: bool

    @property
    def inputs(self) -> dict[str, Mapping[str, str]]:
        """Role -> file -> SHA-256 of all input files but those of the first cell."""
        return {"measurement": self.digests, **further_cells(self.cells)}


@dataclasses.dataclass(frozen=True, eq=False)
class ComparedSource:
    """One measurement before its laws are estimated: a recording with its identification, or a folder's model.

    Attributes:
        measurement: What is compared.
        recorded: The recording with its identification; None for a folder.
        digests: File -> SHA-256.
        steps: As in `Compared`.
        loaded: As in `Compared`.
    """

    measurement: Measurement
    recorded: tuple[Readings, Identification] | None
    digests: dict[str, str]
    steps: int | None
    loaded: bool


def source_of(path: Path, cell: Cell) -> ComparedSource:
    """Return the measurement of a recording, or of an output folder of `identify` or `diagnose`.

    Raises:
        InputError: It cannot be used.
        EquilibriumError: A load is beyond what the joints can carry.
    """
    return _folder(path, cell) if _is_folder(path) else recorded_source(observe(path, cell), cell, str(path))


def compared_sources(
    sources: Sequence[ComparedSource], cells: tuple[Cell, ...], dates: Sequence[dt.datetime | None]
) -> Compared:
    """Compare measurements of one robot, or of twins.

    Args:
        sources: Two or more.
        cells: One for each.
        dates: What stands in for the measurements' own dates; None: nothing.
    """
    with_laws, remarks = _with_laws(sources, cells)
    measurements = tuple(
        dataclasses.replace(one.measurement, date=dates[k] or one.measurement.date) for k, one in enumerate(with_laws)
    )
    if len(measurements) > 2 and any(one.date is None for one in measurements):
        remarks.append("No trend: a date is not known; give --dates, one for each measurement.")
    differences = compare(measurements, typical("backlash", cells[0].robot.rated_load))
    remarks += [
        f"Nothing to compare: {measurements[0].label} and {other.label} have no stiffness, and no law of a joint, in "
        "common."
        for other, rows in zip(measurements[1:], differences, strict=True)
        if not rows
    ]
    return Compared(
        measurements,
        differences,
        trends(measurements),
        cells,
        digests_of_several((one.measurement.label, one.digests) for one in sources),
        tuple(remarks),
        sources[0].steps,
        sources[0].loaded,
    )


def refuse_other_robots(cells: Sequence[Cell]) -> None:
    """Refuse cells that do not describe the same kind of robot.

    Raises:
        InputError: The robot's name or its joints differ.
    """
    for cell in cells[1:]:
        if cell.robot.joints != cells[0].robot.joints or cell.robot.name != cells[0].robot.name:
            found = f"{quoted(cell.robot.name)} with {', '.join(cell.robot.joints)}"
            expected = f"{quoted(cells[0].robot.name)} with {', '.join(cells[0].robot.joints)}, as in {cells[0].path}"
            raise InputError(cell.path, "robot", found, expected)


def date_of(text: object) -> dt.datetime | None:
    """Return a date written by ISO 8601, UTC where it states no zone; None where it is none."""
    try:
        date = dt.datetime.fromisoformat(str(text))
    except ValueError:
        return None
    return date if date.tzinfo is not None else date.replace(tzinfo=dt.UTC)


def _is_folder(path: Path) -> bool:
    try:
        return path.is_dir() and (path / MODEL).is_file() and (path / RESULT).is_file()
    except (OSError, ValueError):  # a name that no file system can hold: reading it says so
        return False


def _folder(path: Path, cell: Cell) -> ComparedSource:
    """Read an output folder of `identify` or `diagnose`."""
    model = read_calibrated(path / MODEL, cell)
    if model.estimate is None:
        raise ModelFileError(path / MODEL, "covariance", "none", "a model that identify or diagnose found")
    try:
        content = json.loads(read_regular(path / RESULT, MAX_RESULT, "result"))
        recording, start = content["recording"], content["input"]["recording"]["start"]
        several = content.get("recordings") or [recording]
        count = sum(int(one["configurations"]) for one in several)
        steps = [one.get("steps") for one in several]
    except (AttributeError, ValueError, KeyError, TypeError, RecursionError) as error:
        raise InputError(path / RESULT, "recording", quoted(str(error)), "the result of identify or diagnose") from None
    if count < 1:
        raise InputError(path / RESULT, "recording.configurations", str(count), "at least one")
    measurement = Measurement(str(path), date_of(start), count, _compliances(model), _effects(model))
    known = all(isinstance(one, int) for one in steps)
    loaded = any(one.get("loaded") is True for one in several)
    return ComparedSource(measurement, None, digest_of(path / MODEL), sum(steps) if known else None, loaded)


def recorded_source(readings: Readings, cell: Cell, label: str) -> ComparedSource:
    """Identify a recording.

    Raises:
        InputError: It cannot be used.
        EquilibriumError: A load is beyond what the joints can carry.
    """
    blocking = [one for one in look(readings, None, cell) if one.blocks]
    if blocking:
        raise RecordingError(label, blocking[0].kind, blocking[0].text, "a recording that calibration identify can use")
    if not is_loaded(readings):
        raise RecordingError(label, "step", "no unloaded and loaded steps", "a loaded recording, or an output folder")
    found = identify(readings, cell)
    estimate = found.estimate
    chosen = [k for k, name in enumerate(estimate.names) if name.startswith(COMPLIANCE)]
    count = len(np.unique(readings.configuration))
    measurement = Measurement(label, date_of(readings.provenance.start), count, estimate.chosen(chosen), NOTHING)
    steps = len(np.unique(np.column_stack([readings.configuration, readings.step]), axis=0))
    return ComparedSource(measurement, (readings, found), dict(readings.provenance.sha256), steps, loaded=True)


def _compliances(model: CalibratedModel) -> GaussianEstimate:
    assert model.estimate is not None  # noqa: S101 - asked for only where there is one
    estimate = model.estimate
    return estimate.chosen([k for k, name in enumerate(estimate.names) if name.startswith(COMPLIANCE)])


def _effects(model: CalibratedModel) -> GaussianEstimate:
    """Return the parameters of the model's effects, named by effect, variant and place."""
    assert model.estimate is not None  # noqa: S101 - asked for only where there is one
    estimate, names, kept = model.estimate, [], []
    for k, name in enumerate(estimate.names):
        group, _, rest = name.partition(".")
        if group != "effects":
            continue
        number, _, parameter = rest.partition(".")
        effect = model.parameters.effects[int(number)]
        place = listed_location(effect.location)
        names.append(f"{effect.effect} {parameter} ({effect.variant.replace('.', ',')}).{place}")
        kept.append(k)
    return estimate.chosen(kept).renamed(names)


def _with_laws(given: Sequence[ComparedSource], cells: Sequence[Cell]) -> tuple[list[ComparedSource], list[str]]:
    """Estimate backlash and hysteresis of all recordings, with the same torques of reference; return remarks, too."""
    sources = list(given)
    recorded = [k for k, one in enumerate(sources) if one.recorded is not None]
    remarks = []
    if len(recorded) >= 2:
        references = []
        for k in recorded:
            readings, found = sources[k].recorded or _never()
            references.append(reference_torques(readings, cells[k], found.model))
        common = np.max(references, axis=0)
        for k in recorded:
            readings, found = sources[k].recorded or _never()
            laws = joint_laws(readings, cells[k], found.model, common, found.noise.scale)
            measurement = dataclasses.replace(sources[k].measurement, laws=laws)
            sources[k] = dataclasses.replace(sources[k], measurement=measurement)
    if len(recorded) < len(sources):
        remarks.append(
            "Backlash and hysteresis of every joint are measured where recordings are compared; of an output folder "
            "only the effects that its model and the first one have in common."
        )
    return sources, remarks


def _never() -> tuple[Readings, Identification]:
    raise AssertionError


def reservations(found: Compared) -> list[tuple[str, str]]:
    """Return what speaks against taking the later measurements for the first one, in words with what to do about it."""
    rows = [one for of in found.differences for one in of]
    changed = [one for one in rows if one.verdict == "changed"]
    open_ = [one for one in rows if one.verdict == "cannot_tell" and one.quantity in OF_JOINTS]
    reasons = []
    if changed:
        step = "find out what was done to the robot, and identify it anew before the earlier model is used"
        reasons.append((f"changed: {_named(changed)}", step))
    if open_:
        needed = max((one.configurations or 0 for one in open_), default=0)
        step = f"measure {needed} configurations each time"
        if not needed:
            step = "measure again what is not known in one of two measurements"
        elif needed > PRACTICAL:
            worst = max(open_, key=lambda one: one.configurations or 0).location
            step = f"plan configurations in which the load turns {worst} more; more of the same would not tell"
        reasons.append((f"whether it has changed stays open: {_named(open_)}", step))
    if not all(found.differences):
        reasons.append(("some measurements have nothing in common with the first", "compare recordings under loads"))
    return reasons


def words_of(one: QuantityChange | Trend) -> str:
    """Return what may be said of a difference; a 95 % interval that excludes zero is never said to tell nothing."""
    outside = one.verdict == "cannot_tell" and (one.low > 0 or one.high < 0)
    return PERHAPS if outside else WORDS[one.verdict]


def needed_text(configurations: int | None) -> str:
    """Return how many configurations in each measurement would tell a change; empty where these are enough."""
    if configurations is None:
        return ""
    return f"more than {PRACTICAL}" if configurations > PRACTICAL else str(configurations)


def _named(rows: Sequence[QuantityChange]) -> str:
    return listed([*dict.fromkeys(f"{one.quantity} of {one.location}" for one in rows)], SHOWN)


def described(one: QuantityChange) -> str:
    """Return a difference in words."""
    if not math.isfinite(one.low):
        return f"{one.quantity} of {one.location}: cannot tell, not known in one of the two"
    if one.quantity == "stiffness":
        high = f"to {100 * one.high:+z.1f} %" if math.isfinite(one.high) else "% to no bound"
        size = f"{100 * one.change:+z.1f} % ({100 * one.low:+z.1f} {high})"
    else:
        size = f"{_with_unit(one.unit, one.change)} ({_ends(one)})"
    text = f"{one.quantity} of {one.location}: {size}, {words_of(one)}"
    if one.or_else:
        text += f"; the change may as well be at {' or '.join(one.or_else)}"
    if one.configurations is not None:
        limit = f"{100 * one.limit:g} %" if one.quantity == "stiffness" else _with_unit(one.unit, one.limit)
        text += f"; {needed_text(one.configurations)} configurations each would tell a change of {limit}"
    return text


def _in(unit: str, value: float) -> str:
    """Return a value of an SI unit in the one in which it is read."""
    return significant(readable_unit(unit).factor * value)


def _with_unit(unit: str, value: float) -> str:
    return f"{_in(unit, value)} {readable_unit(unit).name}"


def _ends(one: QuantityChange | Trend) -> str:
    return f"{_in(one.unit, one.low)} to {_in(one.unit, one.high)}"


def described_trend(one: Trend) -> str:
    """Return a trend in words."""
    if one.quantity == "stiffness":
        size = f"{100 * one.slope:+z.2f} % per year ({100 * one.low:+z.2f} to {100 * one.high:+z.2f} %)"
    else:
        size = f"{_with_unit(one.unit, one.slope)} ({_ends(one)})"
    return f"trend of the {one.quantity} of {one.location}: {size}, {words_of(one)}"
