"""How the test was done: equipment, parameters, requirements, configurations, operating space (CWA 17384, 8 d to g)."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from calibration_core.cell import Cell, ForceTorque, Thermometer, Tracker
from calibration_core.identification.result.estimate import Identification, OperatingSpace, Precondition
from calibration_core.report.document import Block, Column, Facts, Figure, Paragraph, Table
from calibration_core.report.extent import configurations_text
from calibration_core.report.figures.operating_space import (
    MOST_ARMS,
    deflection_scale,
    measured_points,
    space_figure,
)
from calibration_core.report.rounding import counted, fixed, listed, significant, spread, subscript
from calibration_core.timeseries import Float1D, Float2D, Int1D

MOST_ROWS, SHOWN_ROWS = 100, 40
"""A table longer than the first is cut to the second; the whole stands in the CSV file."""

STANDARD_GRAVITY = 9.80665
NOT_STATED = "not stated"
SPEED = "limit 250 mm/s at every point (CWA 17384, 5.1; EN ISO 10218-1); averaged readings do not show the speed"
REDUCED = "manual reduced speed only, the operator confirms it by signature; the cell file declares no other limit"
_ANSWER = {True: "met", False: "not met", None: "not visible"}


def equipment(cell: Cell) -> tuple[Block, ...]:
    """Return the measuring equipment with its uncertainties (8 e, 5.3)."""
    stated: list[tuple[str, Tracker | ForceTorque | Thermometer | None, str]] = [
        ("Laser tracker", cell.instruments.tracker, _tracker(cell.instruments.tracker)),
    ]
    sensor, thermometer = cell.instruments.force_torque, cell.instruments.temperature
    force = (
        ""
        if sensor is None
        else f"force {significant(sensor.sigma_force)} N, torque {significant(sensor.sigma_torque)} N·m"
    )
    stated.append(("Force/torque sensor", sensor, force))
    stated.append(("Thermometer", thermometer, "" if thermometer is None else f"{significant(thermometer.sigma)} K"))
    rows = tuple(
        (role, item.name or NOT_STATED, item.serial or NOT_STATED, item.calibrated or NOT_STATED, uncertainty)
        if item is not None
        else (role, NOT_STATED, NOT_STATED, NOT_STATED, NOT_STATED)
        for role, item, uncertainty in stated
    )
    columns = (
        Column("Instrument", "left"),
        Column("Name", "left", wide=True),
        Column("Serial no.", "left"),
        Column("Calibrated", "left"),
        Column("Standard uncertainty of one averaged reading", "left", wide=True),
    )
    return (
        Table("Measuring equipment", columns, rows, "As stated in the cell file; one standard deviation per axis."),
    )


def parameters(result: Identification, cell: Cell) -> tuple[Block, ...]:
    """Return the test parameters (8 f)."""
    readings, space = result.readings, result.space
    configurations, steps = _counts(result)
    nearest = float(np.min(space.singularity, initial=np.inf))
    rows = [
        ("Configurations", f"{configurations_text(readings, configurations)}; the standard asks for at least 12"),
        ("Steps", f"{steps:,} in all, {steps / max(configurations, 1):.3g} per configuration"),
        ("Measurement points", f"{len(readings.points)}: {listed(readings.points)}"),
        ("Readings", f"{len(readings):,}, of which {int(np.count_nonzero(result.residuals.excluded)):,} not used"),
        ("Applied load", load_text(result, cell)),
        ("Rated load", f"{cell.robot.rated_load:g} kg ({rated_force(cell):,.0f} N)"),
        ("Temperature", _range(readings.temperature, "°C", 1)),
        ("Speed", SPEED),
        ("Safety-rated speed limit", safety_limit(cell)),
        ("Gravity in base axes", f"({', '.join(fixed(g, 3) for g in cell.robot.gravity)}) m/s²"),
        ("Distance from singularity", f"smallest scaled singular value {nearest:.3f} (0: singular)"),
    ]
    if space.k_csm_share is not None and len(space.k_csm_share):
        share = spread(float(np.max(space.k_csm_share)) * 1e6)
        rows.append(("Share of K_CSM", f"neglecting it would move a point by up to {share} µm"))
    rows.append(("Method", result.method))
    if result.noise.scale > 1:
        rows.append(
            (
                "Noise",
                f"stated standard deviations multiplied by {significant(result.noise.scale, 3)} after the noise audit",
            )
        )
    return (Facts(tuple(rows)),)


def safety_limit(cell: Cell) -> str:
    """Return what keeps the speed down besides the suite: the controller's limit as declared, or the operating mode."""
    if cell.safety is None:
        return REDUCED
    return f"{1e3 * cell.safety.speed_limit:g} mm/s, by the controller in every mode; declared by: {cell.safety.source}"


def requirements(
    preconditions: tuple[Precondition, ...],
    caption: str = "Requirements of CWA 17384, checked on the recording",
    source: str = "recording",
) -> tuple[Block, ...]:
    """Return the standard's requirements, each met, not met, or not to be told."""
    columns = (
        Column("Clause", "left"),
        Column("Requirement and limit", "left", wide=True),
        Column("Found", "left", wide=True),
        Column("Result", "left"),
    )
    rows = tuple((item.clause, item.requirement, item.found, _answer(item)) for item in preconditions)
    return (Table(caption, columns, rows, requirement_text(preconditions, source) + "."),)


def _answer(item: Precondition) -> str:
    return _ANSWER[item.met] + (f"; overridden by {item.override}" if item.override else "")


def requirement_text(preconditions: tuple[Precondition, ...], source: str = "recording") -> str:
    """Return how many requirements are met, not met, and open."""
    met, failed, unknown = (sum(item.met is answer for item in preconditions) for answer in (True, False, None))
    text = f"{met} of {len(preconditions)} met"
    if failed:
        overridden = sum(bool(item.override) for item in preconditions if item.met is False)
        text += f", {failed} not met" + (f" ({overridden} overridden by name)" if overridden else "")
    return text + (f", {unknown} not visible in the {source}" if unknown else "")


def joint_columns(prismatic: Sequence[bool]) -> tuple[Column, ...]:
    """Return the heads of the columns of joint positions: θ in degrees, d in mm where a joint slides."""
    return tuple(
        Column(f"d{subscript(i + 1)} [mm]" if slides else f"θ{subscript(i + 1)} [°]")
        for i, slides in enumerate(prismatic)
    )


def joint_values(q: Float2D | Float1D, prismatic: Sequence[bool]) -> Float2D:
    """Return joint positions, (k, n) or (n,) rad and m, in the units of `joint_columns`."""
    return np.where(prismatic, 1e3 * np.asarray(q), np.degrees(q))


def configurations(
    numbers: Int1D | Sequence[int], q: Float2D, prismatic: Sequence[bool], note: str = ""
) -> tuple[Block, ...]:
    """Return Table 1 in the template's form (8 d).

    Args:
        numbers: (k,) numbers of the configurations.
        q: (k, n) rad, m where a joint slides.
        prismatic: Per joint, whether it slides.
        note: Small print below it.
    """
    count = len(q)
    shown = count if count <= MOST_ROWS else SHOWN_ROWS
    columns = (Column("No"), *joint_columns(prismatic))
    rows = tuple(
        (f"{int(number)}", *(fixed(angle, 3) for angle in row))
        for number, row in zip(numbers[:shown], joint_values(q[:shown], prismatic), strict=True)
    )
    if shown < count:
        note = f"{note} First {shown} of {count:,}; all of them stand in table1.csv.".lstrip()
    return (Table("Manipulator measurement configurations", columns, rows, note, number=1),)


def operating_space(space: OperatingSpace) -> tuple[Block, ...]:
    """Return the operating space: extent and drawing (8 g)."""
    points = measured_points(space)
    low, high = np.min(points, axis=0), np.max(points, axis=0)
    extent = ", ".join(f"{axis} {fixed(a, 3)} to {fixed(b, 3)} m" for axis, a, b in zip("xyz", low, high, strict=True))
    caption = "Investigated operating space, base frame: arms"
    if len(space.q) > MOST_ARMS:
        caption += f" ({MOST_ARMS} of {len(space.q):,})"
    caption += ", measured points (dots), their convex outline"
    if space.force is not None:
        caption += ", largest force of each configuration (grey arrows)"
    if space.deflection is not None and deflection_scale(space) > 0:
        caption += f", deflection of the first point enlarged {deflection_scale(space):,.0f} times (blue arrows)"
    figure = Figure(
        "space", caption + ".", "Four views of the robot's operating space", space_figure(space), turnable=True
    )
    return (Paragraph(f"Extent of the measured points in the base frame: {extent}."), figure)


def load_text(result: Identification, cell: Cell) -> str:
    """Return the range of the applied forces and torques, and their share of the rated load."""
    wrench, load = result.readings.wrench, result.residuals.load
    if wrench is None or not np.any(load > 0):
        return "none besides the robot's own weight"
    largest = float(np.max(load))
    loaded = load[load > 0.02 * largest]
    torque = float(np.max(np.linalg.norm(wrench[:, 3:], axis=1)))
    share = 100 * largest / rated_force(cell)
    text = f"forces {float(np.min(loaded)):,.0f} to {largest:,.0f} N, at most {share:.0f} % of the rated load"
    return text + (f"; recorded torques up to {significant(torque)} N·m" if torque > 0 else "")


def rated_force(cell: Cell) -> float:
    """Return the weight of the rated load, N."""
    return cell.robot.rated_load * STANDARD_GRAVITY


def _counts(result: Identification) -> tuple[int, int]:
    pairs = np.unique(np.column_stack([result.readings.configuration, result.readings.step]), axis=0)
    return len(np.unique(pairs[:, 0])), len(pairs)


def counts_text(result: Identification) -> str:
    """Return configurations, steps, points and readings in one line."""
    configurations_, steps = _counts(result)
    readings = result.readings
    return (
        f"{configurations_text(readings, configurations_)}, {counted(steps, 'step')}, "
        f"{counted(len(readings.points), 'measurement point')}, {counted(len(readings), 'reading')}"
    )


def _tracker(tracker: Tracker) -> str:
    if tracker.sigma is not None:
        return f"{significant(tracker.sigma * 1e6)} µm per coordinate"
    constant, growing = (tracker.sigma_range or 0.0) * 1e6, tracker.sigma_range_per_m * 1e6
    text = f"range {significant(constant)} µm" + (f" + {significant(growing)} µm/m" if growing else "")
    return f"{text}, angles {significant((tracker.sigma_angle or 0.0) * 1e6)} µrad"


def _range(values: Float1D, unit: str, places: int) -> str:
    finite = values[np.isfinite(values)]
    if not len(finite):
        return "not recorded; the standard asks for 20 ± 2 °C"
    return f"{fixed(float(np.min(finite)), places)} to {fixed(float(np.max(finite)), places)} {unit}"
