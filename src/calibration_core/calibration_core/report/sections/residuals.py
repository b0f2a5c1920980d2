"""What the model leaves: residuals per configuration, axis, point and load, and predicted against measured."""

from __future__ import annotations

import dataclasses
from typing import Literal, Protocol

import numpy as np

from calibration_core.identification.result.estimate import OperatingSpace, Residuals
from calibration_core.report.document import Block, Column, Figure, Table
from calibration_core.report.figures.identification import (
    PREDICTED_MARKS,
    grouped,
    grouped_rms,
    prediction_figure,
    residual_figure,
)
from calibration_core.report.figures.style import MOST_MARKS
from calibration_core.report.rounding import Unit, decimals, fixed, length_unit, padded, rms, shortened, spread
from calibration_core.report.sections.procedure import MOST_ROWS, SHOWN_ROWS
from calibration_core.timeseries import Bool1D, Float1D, Readings


class ShownResiduals(Protocol):
    """Readings beside what was predicted for them: an identification, or a prediction by a given model."""

    @property
    def kind(self) -> Literal["loaded", "absolute"]:
        """`loaded` where the values are deflections, `absolute` where they are positions."""

    @property
    def readings(self) -> Readings:
        """What was measured."""

    @property
    def residuals(self) -> Residuals:
        """Row by row; `held_out` is NaN where nothing was left out of a fit."""

    @property
    def space(self) -> OperatingSpace:
        """The operating space."""


def residual_section(result: ShownResiduals) -> tuple[Block, ...]:
    """Return figures and tables of the residuals."""
    rows = result.residuals
    used: Bool1D = ~np.asarray(rows.excluded, dtype=bool)
    unit = length_unit(rms(rows.residual[used]))
    blocks: list[Block] = [
        Figure(
            "residuals",
            f"Residuals (measured minus predicted): a) rms per coordinate of every configuration{_fitted(rows)}; "
            "b) per base axis, box: quartiles, whiskers: 95 %, dashed: 95 % of the expected "
            f"noise; c) length of the residual.{_drawn(int(np.count_nonzero(used)))}",
            "Residuals per configuration, per axis and against load",
            residual_figure(result.readings, rows, reach_of_rows(result)),
        ),
        _fitting(_per_axis(result, used, unit), rows, 5),
        _per_point(result, used, unit),
    ]
    if np.any(rows.load > 0):
        blocks.append(_fitting(_per_load(result, used, unit), rows, -1))
    blocks.append(_fitting(_per_configuration(result, used, unit), rows, -1))
    loaded = result.kind == "loaded"
    what = "Deflection" if loaded else "Position"
    blocks.append(
        Figure(
            "prediction",
            f"{what}, base axes: a) predicted and measured, line: equality; b) what remains, dashed: twice the "
            f"expected standard deviation.{_drawn(int(np.count_nonzero(used)), PREDICTED_MARKS)}",
            "Predicted against measured values",
            prediction_figure(rows, loaded),
        )
    )
    return tuple(blocks)


def reach_of_rows(result: ShownResiduals) -> Float1D:
    """Return (m,) m, horizontal distance of the configuration's flange from the base's z axis, row by row."""
    radius = np.linalg.norm(np.asarray(result.space.flange)[:, :2], axis=1)
    order = np.argsort(result.space.configuration, kind="stable")
    sorted_numbers = np.asarray(result.space.configuration)[order]
    place = np.clip(np.searchsorted(sorted_numbers, result.readings.configuration), 0, len(order) - 1)
    return np.asarray(radius[order[place]])


def _left_out(rows: Residuals) -> bool:
    """Say whether there are predictions of configurations that were left out of a fit."""
    return bool(np.any(np.isfinite(rows.held_out)))


def _fitted(rows: Residuals) -> str:
    return ", fitted and predicted from a fit to all others" if _left_out(rows) else ""


def _fitting(table: Table, rows: Residuals, column: int) -> Table:
    """Return a table without its column of configurations left out, where there are none."""
    if _left_out(rows):
        return table
    kept = [i for i in range(len(table.columns)) if i != column % len(table.columns)]
    return dataclasses.replace(
        table,
        columns=tuple(table.columns[i] for i in kept),
        rows=tuple(tuple(row[i] for i in kept) for row in table.rows),
    )


def _drawn(rows: int, most: int = MOST_MARKS) -> str:
    """Return the sentence that says that not every reading has its mark."""
    return "" if rows <= most else f" Marks: {most:,} of {rows:,} readings, evenly spaced ones and the largest."


def _per_axis(result: ShownResiduals, used: Bool1D, unit: Unit) -> Table:
    rows = result.residuals
    places = decimals(rms(rows.residual[used]) * unit.factor)
    body = [
        (
            axis,
            _size(rms(rows.measured[used, i] - np.mean(rows.measured[used, i])), length_unit(rms(rows.measured[used]))),
            _size(rms(rows.residual[used, i]), unit),
            fixed(float(np.mean(rows.residual[used, i])) * unit.factor, places),
            _size(float(np.max(np.abs(rows.residual[used, i]), initial=0.0)), unit),
            _size(rms(rows.held_out[used, i]), unit),
            _size(rms(rows.sigma[used, i]), unit),
        )
        for i, axis in enumerate("xyz")
    ]
    coarse = length_unit(rms(rows.measured[used])).name
    columns = (
        Column("Axis", "left"),
        Column(f"Spread measured [{coarse}]"),
        Column(f"rms residual [{unit.name}]"),
        Column(f"Mean [{unit.name}]"),
        Column(f"Largest [{unit.name}]"),
        Column(f"rms, left out [{unit.name}]"),
        Column(f"Expected [{unit.name}]"),
    )
    note = "Expected: standard deviation of a residual, from " + (
        "noise after the audit and degrees of freedom left by the fit."
        if _left_out(rows)
        else "the stated uncertainty of the tracker."
    )
    return Table("Residuals per base axis", columns, padded(body), note)


def _per_point(result: ShownResiduals, used: Bool1D, unit: Unit) -> Table:
    body = []
    for i, name in enumerate(result.readings.points):
        mine = used & (result.readings.point == i)
        left = result.residuals.residual[mine]
        largest = float(np.max(np.linalg.norm(left, axis=1), initial=0.0))
        body.append((shortened(name), f"{int(np.count_nonzero(mine)):,}", _size(rms(left), unit), _size(largest, unit)))
    columns = (
        Column("Point", "left", wide=True),
        Column("Readings used"),
        Column(f"rms residual [{unit.name}]"),
        Column(f"Largest, 3-D [{unit.name}]"),
    )
    return Table("Residuals per measurement point", columns, padded(body))


def _per_load(result: ShownResiduals, used: Bool1D, unit: Unit) -> Table:
    rows = result.residuals
    load = rows.load
    group = np.full(len(load), -1)
    group[used] = grouped(load[used])
    deflections = result.kind == "loaded"
    coarse = length_unit(rms(rows.measured[used]))
    body = []
    for number in range(int(np.max(group)) + 1):
        mine = group == number
        low, high = float(np.min(load[mine])), float(np.max(load[mine]))
        span = f"{low:,.0f}" if round(low) == round(high) else f"{low:,.0f} to {high:,.0f}"
        body.append(
            (
                span,
                f"{int(np.count_nonzero(mine)):,}",
                *((_size(rms(rows.measured[mine]), coarse),) if deflections else ()),
                _size(rms(rows.residual[mine]), unit),
                _size(rms(rows.held_out[mine]), unit),
            )
        )
    columns = (
        Column("Force [N]", "left", wide=True),
        Column("Readings used"),
        *((Column(f"rms deflection [{coarse.name}]"),) if deflections else ()),
        Column(f"rms residual [{unit.name}]"),
        Column(f"rms, left out [{unit.name}]"),
    )
    relative = "Deflection: under the external load alone, relative to the equilibrium under the robot's own weight."
    note = relative if deflections else ""
    return Table("Residuals per load", columns, padded(body), note)


def _per_configuration(result: ShownResiduals, used: Bool1D, unit: Unit) -> Table:
    rows = result.residuals
    chosen = result.readings.configuration[used]
    numbers, fitted, largest = grouped_rms(chosen, rows.residual[used])
    _, held_out, _ = grouped_rms(chosen, rows.held_out[used])
    index = np.searchsorted(numbers, chosen)
    load = np.zeros(len(numbers))
    np.maximum.at(load, index, rows.load[used])
    count = np.bincount(index, minlength=len(numbers))
    order, note = np.arange(len(numbers)), ""
    if len(numbers) > MOST_ROWS:
        order = np.argsort(-fitted, kind="stable")[:SHOWN_ROWS]
        note = f"The {SHOWN_ROWS} largest of {len(numbers):,}; every reading stands in residuals.csv."
    loaded = bool(np.any(rows.load > 0))
    body = [
        (
            f"{int(numbers[i])}",
            f"{count[i]:,}",
            *((f"{load[i]:,.0f}",) if loaded else ()),
            _size(float(fitted[i]), unit),
            _size(float(largest[i]), unit),
            _size(float(held_out[i]), unit),
        )
        for i in order
    ]
    columns = (
        Column("Configuration"),
        Column("Readings used"),
        *((Column("Largest force [N]"),) if loaded else ()),
        Column(f"rms residual [{unit.name}]"),
        Column(f"Largest, 3-D [{unit.name}]"),
        Column(f"rms, left out [{unit.name}]"),
    )
    return Table("Residuals per configuration", columns, padded(body), note)


def _size(value: float, unit: Unit) -> str:
    return spread(value * unit.factor)
