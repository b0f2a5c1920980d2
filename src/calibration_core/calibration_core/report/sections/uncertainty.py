"""What the uncertainties rest on: noise, condition, correlation; the ladder of stages and the other parameters."""

from __future__ import annotations

import math

import numpy as np

from calibration_core.identification.result.estimate import Identification, ParameterEstimate
from calibration_core.report.document import Block, Column, Figure, Paragraph, Table
from calibration_core.report.figures.identification import correlation_figure, normality_figure
from calibration_core.report.results.result import correlation
from calibration_core.report.rounding import DASH, decimals, fixed, length_unit, padded, shortened, significant, spread
from calibration_core.timeseries import Float2D

MOST_COLUMNS = 9
"""Parameters whose correlations are printed as a square; of more, the strongest pairs are listed."""

MOST_DRAWN = 80
MOST_PAIRS = 12


def noise_section(result: Identification) -> tuple[Block, ...]:
    """Return claimed against seen noise, and how normal the residuals are."""
    audit = result.noise
    unit = length_unit(max([audit.claimed, *(check.seen for check in audit.checks)]))
    rows = [("stated in the cell file", spread(audit.claimed * unit.factor), DASH, DASH)]
    rows += [
        (
            f"seen: {check.source}",
            spread(check.seen * unit.factor),
            significant(check.seen / audit.claimed, 3) if audit.claimed else DASH,
            f"{check.degrees_of_freedom:,}",
        )
        for check in audit.checks
    ]
    columns = (
        Column("Source", "left", wide=True),
        Column(f"Standard deviation per coordinate [{unit.name}]"),
        Column("Seen / stated"),
        Column("Degrees of freedom"),
    )
    consequence = (
        "The uncertainties of this report use the stated standard deviations multiplied by "
        f"{significant(audit.scale, 3)}."
        if audit.scale > 1
        else "The uncertainties of this report use the standard deviations as stated."
    )
    return (
        Paragraph(f"{audit.text} {consequence}"),
        Table("Noise audit", columns, padded(rows)),
        Figure(
            "normality",
            "Residuals in units of their expected standard deviation: a) normal probability plot; b) distribution with "
            "the normal density.",
            "Normal probability plot and histogram of the standardised residuals",
            normality_figure(result.residuals),
        ),
    )


def correlation_section(result: Identification) -> tuple[Block, ...]:
    """Return condition number and correlations with names."""
    matrix, names = correlation(result), result.names
    blocks: list[Block] = [
        Paragraph(
            f"Condition number of the column-scaled observation matrix: {significant(result.condition_number, 3)}. "
            "1 is best; from about 100 on, combinations of parameters are badly determined."
            if math.isfinite(result.condition_number)
            else "The observation matrix is singular: some combination of parameters is not determined at all."
        )
    ]
    if len(names) > 1:
        blocks.append(_square(names, matrix) if len(names) <= MOST_COLUMNS else _pairs(names, matrix))
    if 1 < len(names) <= MOST_DRAWN:
        blocks.append(
            Figure(
                "correlation",
                "Correlation of the estimates: the area of a square is |r|; filled: positive, hollow: negative.",
                "Correlation matrix of the estimated parameters",
                correlation_figure(names, matrix),
            )
        )
    return tuple(blocks)


def stage_blocks(result: Identification) -> tuple[Block, ...]:
    """Return the staged model selection of absolute positions: a stage is kept if configurations left out say so."""
    unit = length_unit(result.stages[-1].rms)
    rows = [
        (
            stage.name,
            f"{stage.parameters}",
            spread(stage.rms * unit.factor),
            spread(stage.held_out_rms * unit.factor),
            "yes" if stage.kept else "no",
            stage.reason,
        )
        for stage in result.stages
    ]
    columns = (
        Column("Stage", "left"),
        Column("Free parameters"),
        Column(f"rms, 3-D [{unit.name}]"),
        Column(f"rms, left out [{unit.name}]"),
        Column("Kept", "center"),
        Column("Reason", "left", wide=True),
    )
    return (
        Paragraph(
            "The recording holds absolute positions under the robot's own weight. The model was extended "
            "stage by stage; a stage "
            "is part of the result only if it predicts configurations better that were left out of its fit."
        ),
        Table("Stages of the identification", columns, padded(rows)),
    )


def parameter_section(parameters: tuple[ParameterEstimate, ...]) -> tuple[Block, ...]:
    """Return frames, points and geometry with their uncertainties."""
    rows = tuple(_parameter(parameter) for parameter in parameters)
    columns = (
        Column("Parameter", "left", wide=True),
        Column("Group", "left"),
        Column("Value"),
        Column("Standard uncertainty"),
        Column("Cell file"),
        Column("Unit", "left"),
        Column("Fitted", "center"),
    )
    note = (
        "Of geometry, the value is the correction to the nominal one. Not fitted: not identifiable here, stays nominal "
        "(CWA 17384, 7.2)."
    )
    return (Table("Frames, measurement points and geometry", columns, padded(rows), note),)


def _parameter(parameter: ParameterEstimate) -> tuple[str, ...]:
    factor, unit = 1e3, "mm" if parameter.unit == "m" else "mrad"
    places = decimals(parameter.std * factor) if parameter.fitted else 3
    value, nominal = fixed(parameter.value * factor, places), parameter.nominal
    stated = DASH if nominal is None else fixed(nominal * factor, places)
    std = fixed(parameter.std * factor, places) if parameter.fitted else DASH
    return shortened(parameter.name), parameter.group, value, std, stated, unit, "yes" if parameter.fitted else "no"


def _square(names: tuple[str, ...], matrix: Float2D) -> Table:
    heads = (Column("", "left", wide=True), *(Column(f"{i + 1}") for i in range(len(names))))
    rows = tuple(
        (f"{i + 1}  {shortened(name)}", *(fixed(float(matrix[i, j]), 2) if j <= i else "" for j in range(len(names))))
        for i, name in enumerate(names)
    )
    return Table("Correlation of the estimates", heads, rows, "C: compliance of a joint. A dash: not determined.")


def _pairs(names: tuple[str, ...], matrix: Float2D) -> Table:
    lower = np.abs(np.where(np.tri(len(names), k=-1, dtype=bool), matrix, np.nan))
    order = np.argsort(-np.nan_to_num(lower, nan=-1.0), axis=None, kind="stable")[:MOST_PAIRS]
    places = [np.unravel_index(int(k), lower.shape) for k in order if np.isfinite(lower.flat[int(k)])]
    rows = tuple((shortened(names[int(j)]), shortened(names[int(i)]), fixed(float(matrix[i, j]), 3)) for i, j in places)
    columns = (Column("Parameter", "left", wide=True), Column("Parameter", "left", wide=True), Column("Correlation"))
    pairs = len(names) * (len(names) - 1) // 2
    return Table(
        "Strongest correlations of the estimates",
        columns,
        rows,
        f"The {len(rows)} strongest of {pairs:,} pairs; the whole matrix stands in result.json.",
    )
