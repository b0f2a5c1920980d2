"""CSV tables: the standard's two templates, predictions, and the residuals row by row."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence

import numpy as np

from calibration_core.files.written import csv_bytes
from calibration_core.identification.result.estimate import Identification, JointStiffness
from calibration_core.timeseries import Float1D, Float2D, Int1D, Readings

TABLE_1, TABLE_2, PREDICTIONS, RESIDUALS = "table1.csv", "table2.csv", "predictions.csv", "residuals.csv"
TABLE_1_YAML = "table1.yaml"


def table1_csv(number: Int1D | Float1D | Sequence[int], q: Float2D, prismatic: Sequence[bool] = ()) -> bytes:
    """Return Table 1 of CWA 17384: No, theta_1 ... theta_n in degrees, six decimals; d_i in mm where a joint slides.

    Args:
        number: (k,) numbers of the configurations.
        q: (k, n) rad, m where a joint slides.
        prismatic: Per joint, whether it slides; none where empty.
    """
    names, values = _table1(q, prismatic)
    return csv_bytes(
        ["No", *names], ([int(no), *(f"{x:z.6f}" for x in row)] for no, row in zip(number, values, strict=True))
    )


def table1_yaml(number: Int1D | Float1D | Sequence[int], q: Float2D, prismatic: Sequence[bool] = ()) -> bytes:
    """Return Table 1 of CWA 17384 as YAML, a mapping per configuration, with the columns and units of `table1_csv`.

    Args:
        number: (k,) numbers of the configurations.
        q: (k, n) rad, m where a joint slides.
        prismatic: Per joint, whether it slides; none where empty.
    """
    names, values = _table1(q, prismatic)
    units = "angles theta in degrees, distances d in mm" if any(prismatic) else "angles in degrees"
    lines = [f"# Table 1 of CWA 17384: manipulator measurement configurations, {units}."]
    for no, row in zip(number, values, strict=True):
        angles = ", ".join(f"{name}: {value:z.6f}" for name, value in zip(names, row, strict=True))
        lines.append(f'- {{"No": {int(no)}, {angles}}}')  # bare, No would be false in YAML 1.1
    return ("\n".join(lines) + "\n").encode()


def _table1(q: Float2D, prismatic: Sequence[bool]) -> tuple[list[str], Float2D]:
    """Return the names of the columns, and the values in degrees, in mm where a joint slides."""
    slides = prismatic or (False,) * np.shape(q)[1]
    names = [f"{'d' if slide else 'theta'}_{i + 1}" for i, slide in enumerate(slides)]
    return names, np.where(slides, 1e3 * np.asarray(q), np.degrees(q))


def table2_csv(stiffness: Sequence[JointStiffness]) -> bytes:
    """Return Table 2 of CWA 17384 with uncertainties, in 10^5 N*m/rad; an empty cell is a value that is not finite.

    Where a joint slides, the columns are in 10^5 of each row's own unit, which one more column states.  Where the
    standard's model leaves something out, the stiffness of the extended model stands in three more columns.
    """
    beside = any(joint.extended is not None for joint in stiffness)
    slides = any(joint.unit != "N*m/rad" for joint in stiffness)
    unit = "1e5_units" if slides else "1e5_Nm_per_rad"
    head = [
        "joint",
        f"stiffness_{unit}",
        f"interval_95_low_{unit}",
        f"interval_95_high_{unit}",
        f"std_{unit}",
        "identifiable",
        "reason",
        *(["unit"] if slides else []),
        *([f"extended_model_{name}{unit}" for name in ("", "low_", "high_")] if beside else []),
    ]
    return csv_bytes(
        head,
        (
            [
                joint.joint,
                *(_scaled(x) for x in (joint.value, *joint.interval, joint.std)),
                "yes" if joint.identifiable else "no",
                joint.reason,
                *([joint.unit] if slides else []),
                *(_beside(joint) if beside else []),
            ]
            for joint in stiffness
        ),
    )


def _beside(joint: JointStiffness) -> list[str]:
    own = joint.extended
    return ["", "", ""] if own is None else [_scaled(x) for x in (own.value, *own.interval)]


def predictions_csv(readings: Readings, predicted: Float2D) -> bytes:
    """Return predictions: `configuration step point x y z px py pz`, m, tracker frame.

    Args:
        readings: What was measured.
        predicted: (m, 3) m, predicted position of each reading in the tracker frame.
    """
    head = ["configuration", "step", "point", "x", "y", "z", "px", "py", "pz"]
    return csv_bytes(head, _rows(readings, np.hstack([readings.position, predicted]).tolist()))


def residuals_csv(identification: Identification) -> bytes:
    """Return measured, predicted, residual and held-out residual of every reading, m, base axes; load in N."""
    rows, axes = identification.residuals, ("x", "y", "z")
    head = [
        "configuration",
        "step",
        "point",
        "load",
        *(f"{kind}_{axis}" for kind in ("measured", "predicted", "residual", "held_out", "sigma") for axis in axes),
        "excluded",
    ]
    values = np.hstack([rows.load[:, None], rows.measured, rows.predicted, rows.residual, rows.held_out, rows.sigma])
    excluded = ("yes" if flag else "no" for flag in np.asarray(rows.excluded, dtype=bool))
    cells = ([*map(_micro, row), flag] for row, flag in zip(values.tolist(), excluded, strict=True))
    return csv_bytes(head, _rows(identification.readings, cells))


def table_files(identification: Identification, prismatic: Sequence[bool] = ()) -> dict[str, bytes]:
    """Return the tables that `identify` writes: file name -> content; `prismatic` as in `table1_csv`."""
    space = identification.space
    return {
        TABLE_1: table1_csv(space.configuration, space.q, prismatic),
        TABLE_2: table2_csv(identification.stiffness),
        RESIDUALS: residuals_csv(identification),
    }


def _rows(readings: Readings, cells: Iterable[Sequence[object]]) -> Iterable[list[object]]:
    index = zip(readings.configuration.tolist(), readings.step.tolist(), readings.point.tolist(), strict=True)
    for (configuration, step, point), row in zip(index, cells, strict=True):
        yield [configuration, step, readings.points[point], *row]


def _scaled(value: float) -> str:
    return f"{value * 1e-5:z.6g}" if math.isfinite(value) else ""


def _micro(value: float) -> str:
    return f"{value:z.9g}" if math.isfinite(value) else ""
