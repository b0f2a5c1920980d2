"""The tables of a plant: rows of plain values, as CSV and Parquet."""

from __future__ import annotations

import functools
import math
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from calibration_core.acceptance.yearly_change import yearly_change
from calibration_core.files.written import csv_bytes, unsigned_zeros
from calibration_core.fleet.plant import JointState, Plant
from calibration_core.fleet.series import STIFFNESS
from calibration_core.report.writing.output import Content

Record = dict[str, Any]


def tables_of(plant: Plant) -> dict[str, list[Record]]:
    """Return name -> records: `ranking` of the robots, `joints` of all robots over time, `populations` of all types."""
    return {"ranking": ranking(plant), "joints": joints(plant), "populations": populations(plant)}


def ranking(plant: Plant) -> list[Record]:
    """Return the robots, the most conspicuous first."""
    return [
        {
            "rank": rank, "type": robot.type, "robot": robot.robot, "state": robot.state, "score": robot.score,
            "reasons": "; ".join(reason.text for reason in robot.reasons), "measurements": len(robot.dates),
            "last_date": robot.dates[-1] if robot.dates else "", "failures": robot.failures,
            "last_failure": robot.last_failure,
        }
        for rank, robot in enumerate(plant.robots, start=1)
    ]  # fmt: skip


def joints(plant: Plant) -> list[Record]:
    """Return every quantity of every robot; N*m/rad (N/m) of a stiffness, rad (m) of a backlash or hysteresis.

    `per_year` is that of `acceptance.yearly_change`: relative of a stiffness (unit 1/year), else in rad/year.
    """
    return [_joint(state) for state in plant.states]


def _joint(state: JointState) -> Record:
    found = state.history
    yearly = (found.slope, *found.slope_interval)
    slope, low, high = map(yearly_change, yearly) if state.kind == STIFFNESS else yearly
    return {
        "type": state.type, "robot": state.robot, "quantity": state.kind, "joint": state.joint,
        "raw": state.raw, "raw_low": state.raw_low, "raw_high": state.raw_high,
        "pooled": state.pooled, "pooled_low": state.pooled_low, "pooled_high": state.pooled_high,
        "is_pooled": state.is_pooled, "belongs": state.belongs, "deviation": state.deviation,
        "dates": found.dates, "cause": found.cause, "changes": len(found.changes),
        "per_year": slope, "per_year_low": low, "per_year_high": high,
        "per_year_unit": "1/year" if state.kind == STIFFNESS else "rad/year",
        "months_to_limit": state.life.months if state.life.known else math.nan,
        "months_low": state.life.low if state.life.known else math.nan,
        "months_high": state.life.high if state.life.known else math.nan,
        "life": "stated" if state.life.known else "cannot tell yet",
    }  # fmt: skip


def populations(plant: Plant) -> list[Record]:
    """Return the population of every quantity of every type; logarithms of a stiffness in N*m/rad."""
    records = []
    for one in plant.quantities:
        found = one.population
        records.append({
            "type": one.quantity.type, "quantity": one.quantity.kind, "joint": one.quantity.joint,
            "robots": len(one.quantity.series), "members": 0 if found is None else found.members,
            "mean": math.nan if found is None else found.mean,
            "mean_std": math.nan if found is None else found.mean_std,
            "spread": math.nan if found is None else found.spread,
            "spread_std": math.nan if found is None else found.spread_std,
            "repeatability": one.quantity.repeatability,
            "share_above_0.1_mrad": next(iter(one.shares.values()), math.nan),
        })  # fmt: skip
    return records


def table_files(plant: Plant) -> dict[str, Content]:
    """Return every table as CSV and Parquet: file name -> content."""
    files: dict[str, Content] = {}
    for name, records in tables_of(plant).items():
        files[f"{name}.csv"] = _csv(records)
        files[f"{name}.parquet"] = functools.partial(_write_parquet, records)
    return files


def _csv(records: Sequence[Record]) -> bytes:
    names = list(records[0]) if records else []
    return csv_bytes(names, ([record[name] for name in names] for record in records)) if records else b""


def _write_parquet(records: Sequence[Record], path: Path) -> None:
    import pyarrow as pa
    import pyarrow.parquet as pq

    pq.write_table(pa.Table.from_pylist(unsigned_zeros(records)), path)
