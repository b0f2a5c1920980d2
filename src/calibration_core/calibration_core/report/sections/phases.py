"""One section per phase of the calibration (CWA 17384, 7.1 to 7.6), and arm and wrist apart."""

from __future__ import annotations

import numpy as np

from calibration_core.identification.circle_point.joint_axes import BaseFrame
from calibration_core.identification.result.estimate import (
    BASE_FRAME,
    GEOMETRY,
    POINTS,
    STIFFNESS,
    WRIST_CENTRE,
    Decoupled,
    Identification,
    PhaseEstimate,
)
from calibration_core.identification.standard.kinematic_phases import frame_of
from calibration_core.report.arcs import describe_arc
from calibration_core.report.document import Block, Column, Items, Paragraph, Section, Table
from calibration_core.report.rounding import STIFFNESS as UNIT
from calibration_core.report.rounding import counted, decimals, fixed, padded, significant
from calibration_core.timeseries import Float1D

TITLES = {
    BASE_FRAME: "Base coordinate system",
    GEOMETRY: "Kinematic calibration",
    WRIST_CENTRE: "Wrist centre point",
    POINTS: "Measurement and wrench points",
    STIFFNESS: "Compliance",
}
WHAT = {
    BASE_FRAME: "Pose of the tracker in the base frame, from the circles that the targets describe when joints 1 and 2 "
    "turn alone.",
    GEOMETRY: "Corrections to the nominal geometry and the tracker pose that belongs to them: first from circles, then "
    "from all sweeps and known configurations together. What the recording does not determine stays nominal and is "
    "named.",
    WRIST_CENTRE: "Wrist centre in the flange frame, by a fit of all readings of the wrist's motion, which begins "
    "where spheres and trilateration put it; the points' uncertainty is in it.",
    POINTS: "Points in the flange frame, with the actual kinematics and its uncertainty.",
    STIFFNESS: "Compliances of the joints; what the phases before left uncertain is in their uncertainty.",
}
MICRO = 1e6


def phase_sections(result: Identification) -> tuple[Section, ...]:
    """Return the sections; none for a recording of one phase."""
    sections, sigma = [], result.noise.claimed
    for phase in result.phases:
        blocks: list[Block] = [_opening(phase), _table(phase)]
        if phase.phase == BASE_FRAME and result.standard is not None and result.standard.base is not None:
            blocks += _clause(result.standard.base, sigma)
        if phase.phase == WRIST_CENTRE and result.standard is not None and result.standard.wrist is not None:
            place = ", ".join(fixed(1e3 * x, 3) for x in result.standard.wrist.trilaterated)
            blocks.append(Paragraph(f"By spheres and trilateration alone it is ({place}) mm."))
        if phase.phase == POINTS:
            blocks += _frame(phase)
        if phase.remarks:
            blocks.append(Items(phase.remarks))
        sections.append(Section(TITLES[phase.phase], phase.clause, tuple(blocks)))
    return tuple(sections)


def decoupled_blocks(found: Decoupled) -> tuple[Block, ...]:
    """Return the stiffnesses of arm and wrist identified apart, beside those identified together."""
    rows = []
    for i, joint in enumerate(found.joints):
        apart, together = 1 / found.compliance[i], 1 / found.together[i]
        share = found.difference_std[i] / abs(found.compliance[i])
        std = abs(apart) * found.std[i] / abs(found.compliance[i])
        places = decimals(UNIT.factor * std)
        rows.append(
            (
                joint,
                "arm" if i < found.arm else "wrist",
                fixed(UNIT.factor * apart, places),
                fixed(UNIT.factor * std, places),
                fixed(UNIT.factor * together, places),
                fixed(UNIT.factor * (apart - together), places),
                fixed(UNIT.factor * abs(apart) * share, places),
            )
        )
    columns = (
        Column("Joint", "left"),
        Column("Part", "left"),
        Column(f"Apart [{UNIT.name}]"),
        Column("Standard uncertainty"),
        Column("Together"),
        Column("Difference"),
        Column("Expected by chance"),
    )
    verdict = "They agree" if found.agree else "They differ by more than chance: the model leaves something out"
    place = ", ".join(fixed(1e3 * x, 3) for x in found.wrist_centre)
    text = (
        f"Through the wrist centre ({place}) mm in the flange frame, "
        f"{'as measured' if found.measured else 'as the geometry has it'}: its displacements give the arm's "
        f"stiffnesses, the rotations of the tool then the wrist's. {verdict} (chi-square {significant(found.chi2, 3)} "
        f"for {found.freedom} degrees of freedom, limit {significant(found.limit, 3)})."
    )
    note = (
        "Together: from the same displacements of the tool. One standard deviation by which both may differ by chance."
    )
    return (Paragraph(text), Table("Arm and wrist apart", columns, padded(rows), note))


def _opening(phase: PhaseEstimate) -> Paragraph:
    text = f"{WHAT[phase.phase]} {counted(phase.readings, 'reading')}."
    if phase.scale > 1:
        text += f" Residuals exceed the instruments' claim {significant(phase.scale, 3)} times; it is in the figures."
    return Paragraph(text)


def _table(phase: PhaseEstimate) -> Table:
    rows = []
    for i, name in enumerate(phase.names):
        unit = phase.unit(i)
        factor, shown = {"m": (1e3, "mm"), "rad": (1e3, "mrad")}.get(unit, (1e9, "nrad/(N·m)"))
        std = float(phase.std[i]) * factor
        places = decimals(std)
        rows.append((name, fixed(float(phase.values[i]) * factor, places), fixed(std, places), shown))
    columns = (
        Column("Parameter", "left", wide=True),
        Column("Value"),
        Column("Standard uncertainty"),
        Column("Unit", "left"),
    )
    return Table(TITLES[phase.phase], columns, padded(rows))


def _clause(base: BaseFrame, sigma: float) -> list[Block]:
    """Return origin and axes as clause 7.1 has them, and what the arcs are worth."""
    std = np.sqrt(np.diag(base.clause_covariance))
    rows = [("origin", *(fixed(1e3 * x, 3) for x in base.origin), f"{_micro(std[:3])} µm")]
    for axis, column in zip("xyz", base.axes_in_tracker.T, strict=True):
        rows.append((f"{axis} axis", *(fixed(x, 6) for x in column), f"{_micro(std[3:])} µrad"))
    columns = (Column("", "left", wide=True), Column("x"), Column("y"), Column("z"), Column("Standard uncertainty"))
    note = (
        "Tracker frame; origin in mm. x and y of the origin are those of joint 1's circle, z that of joint 2's; "
        "z is the normal of joint 1's circle, y the cross product of the normals of joints 1 and 2."
    )
    blocks: list[Block] = [Table("Base coordinate system in the tracker frame", columns, padded(rows), note)]
    texts = []
    for joint, swept in enumerate(base.axes, start=1):
        circle = max(swept.circles, key=lambda one: one.arc)
        texts.append(f"joint {joint}: {describe_arc(circle.arc, sigma, circle.points, 'readings')}")
    return [*blocks, Items(tuple(texts))]


def _micro(std: Float1D) -> str:
    """Return the length of several standard deviations in millionths."""
    return significant(MICRO * float(np.linalg.norm(std)))


def _frame(phase: PhaseEstimate) -> list[Block]:
    """Return the frame of the first three points that were fitted whole."""
    names = [name.rpartition(" ")[0] for name in phase.names]
    whole = [name for name in dict.fromkeys(names) if names.count(name) == 3][:3]
    if len(whole) < 3:
        return []
    index = [phase.names.index(f"{name} {axis}") for name in whole for axis in "xyz"]
    try:
        found = frame_of(phase.values[index].reshape(3, 3), phase.covariance[np.ix_(index, index)])
    except ValueError:  # on one line: no frame
        return []
    rows = [("origin [mm]", *(fixed(1e3 * x, 3) for x in found.pose[:3, 3]))]
    rows += [
        (f"{axis} axis", *(fixed(x, 6) for x in column))
        for axis, column in zip("xyz", found.pose[:3, :3].T, strict=True)
    ]
    columns = (Column("", "left", wide=True), Column("x"), Column("y"), Column("z"))
    note = (
        f"Flange frame. Origin in {whole[0]}, x towards {whole[1]}, {whole[2]} on the side of positive y. Standard "
        f"uncertainty {_micro(found.std[:3])} µm and "
        f"{_micro(found.std[3:])} µrad."
    )
    return [Table(f"Frame of {', '.join(whole)}", columns, padded(rows), note)]
