"""What we believe about a cell: every number that a prediction depends on and a fit may change."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from types import MappingProxyType

import numpy as np

from calibration_core.timeseries import Float1D, Float2D, Float3D, Int1D, read_only


@dataclasses.dataclass(frozen=True)
class AppliedEffect:
    """An effect of the catalogue that the model contains.

    Attributes:
        location: Where, e.g. {"joint": "joint_2"}.
        variant: Which form of its law, as the catalogue calls it.
        parameters: Name -> value, SI units.
    """

    effect: str
    location: Mapping[str, str | tuple[str, ...]]
    variant: str
    parameters: Mapping[str, float]

    def __post_init__(self) -> None:
        """Freeze the mappings."""
        object.__setattr__(self, "location", MappingProxyType(dict(self.location)))
        object.__setattr__(self, "parameters", MappingProxyType(dict(self.parameters)))


@dataclasses.dataclass(frozen=True, eq=False)
class ModelParameters:
    """Parameter values of the extended kinematic model.

    Attributes:
        joints: Names of the n joints.
        compliance: (n,) rad/(N*m), one axial spring per joint (CWA 17384, 6.2); 0 is rigid.
        geometry: (n, 6) corrections x, y, z (m), rx, ry, rz (rad) of the frame before each joint (for DH rows the
            frame i-1 of joint i: x = a, rx = alpha of the row before, z = d, rz = theta of the row itself).
        tracker: (4, 4) pose of the tracker frame in the base frame.
        points: Measurement point -> (3,) m, flange frame.
        wrench_point: (3,) m, flange frame; None if no wrench acts.
        force_torque: (4, 4) pose of the sensor frame in the flange frame; None if there is no sensor.
        effects: Physics beyond joint springs and geometry, as a diagnosis found it.
        setups: (r, 4, 4) where several recordings are evaluated together: what brings the positions of each into the
            frame of `tracker`, beyond how they were brought there already; None: one recording.
    """

    joints: tuple[str, ...]
    compliance: Float1D
    geometry: Float2D
    tracker: Float2D
    points: Mapping[str, Float1D]
    wrench_point: Float1D | None = None
    force_torque: Float2D | None = None
    effects: tuple[AppliedEffect, ...] = ()
    setups: Float3D | None = None

    def __post_init__(self) -> None:
        """Copy to read-only arrays; raise ValueError on wrong shapes."""
        n = len(self.joints)
        shapes = {
            "compliance": (n,),
            "geometry": (n, 6),
            "tracker": (4, 4),
            "wrench_point": (3,),
            "force_torque": (4, 4),
            "setups": (0 if self.setups is None else len(self.setups), 4, 4),
        }
        for name, shape in shapes.items():
            value = getattr(self, name)
            if value is None:
                continue
            array = read_only(value)
            if array.shape != shape:
                msg = f"{name}: expected shape {shape}, got {array.shape}"
                raise ValueError(msg)
            object.__setattr__(self, name, array)
        points = {name: read_only(point) for name, point in self.points.items()}
        object.__setattr__(self, "points", MappingProxyType(points))

    def placed(self, position: Float2D, recording: Int1D | None) -> Float2D:
        """Return positions as they were read, (3, m) m, as the tracker at `tracker` would have read them, (3, m) m.

        Args:
            position: (3, m) m.
            recording: (m,) which recording each comes from; None: one alone.
        """
        if self.setups is None or recording is None:
            return position
        rotation, shift = self.setups[recording, :3, :3], self.setups[recording, :3, 3]
        return np.asarray(np.einsum("mij,jm->im", rotation, position) + shift.T)

    def replace(self, **changes: object) -> ModelParameters:
        """Return a copy with some values changed."""
        return dataclasses.replace(self, **changes)  # type: ignore[arg-type]
