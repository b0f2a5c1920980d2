"""What can be shown in space of a plan or a result: points, deflections under load, operating space; base frame, m."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from types import MappingProxyType
from typing import TYPE_CHECKING, Any

import numpy as np

from calibration_core.timeseries import Float2D

if TYPE_CHECKING:  # numerics that whoever only shows a result can do without
    from calibration_core.identification.result.estimate import OperatingSpace


@dataclasses.dataclass(frozen=True, eq=False)
class Scene:
    """Places and arrows in the base frame.

    Attributes:
        points: Measurement point -> (k, 3) m, one row per configuration.
        wrench_point: (k, 3) m; no rows where no wrench acts.
        arrows: (k, 2, 3) m, from the first measurement point to where it goes under the largest load, enlarged; no rows
            for a recording without loads.
        box: (2, 3) m, centre and edge lengths of the box around all measurement points: the operating space.
    """

    points: Mapping[str, Float2D]
    wrench_point: Float2D
    arrows: np.ndarray[Any, np.dtype[np.float64]]
    box: Float2D

    def __post_init__(self) -> None:
        """Freeze the mapping."""
        object.__setattr__(self, "points", MappingProxyType(dict(self.points)))


def space_dict(space: OperatingSpace) -> dict[str, Any]:
    """Return the operating space as a part of result.json: base frame, SI units, one row per configuration."""
    return {
        "configuration": space.configuration,
        "points": dict(space.points),
        "wrench_point": space.wrench_point,
        "force": space.force,
        "deflection": space.deflection,
    }


def scene_of(space: Mapping[str, Any], scale: float) -> Scene:
    """Return what an operating space shows."""
    points = {name: _rows(rows) for name, rows in space["points"].items()}
    everywhere = np.concatenate(list(points.values()))
    low, high = everywhere.min(axis=0), everywhere.max(axis=0)
    deflection = _rows(space["deflection"])
    start = next(iter(points.values()))[: len(deflection)]
    return Scene(
        points=points,
        wrench_point=_rows(space["wrench_point"]),
        arrows=np.stack([start, start + scale * deflection], axis=1),
        box=np.stack([(low + high) / 2, high - low]),
    )


def _rows(values: Any) -> Float2D:
    return np.zeros((0, 3)) if values is None else np.asarray(values, dtype=np.float64).reshape(-1, 3)
