"""Joints that a linkage, chain or gear moves with one of the robot's own: mimic joints of a URDF.

A mimic joint stands at multiplier times where its driver really stands, the driver's deflection included, plus an
offset.  Telescopic columns, parallelogram arms and palletisers are made so.
"""

from __future__ import annotations

import dataclasses

from calibration_core.timeseries import Float1D, Float2D, read_only


@dataclasses.dataclass(frozen=True, eq=False)
class Mimic:
    """One mimic joint, in the form of `Chain`.

    Attributes:
        name: Its name.
        behind: Number of the robot's own joints that stand before it in the chain.
        driver: Index of the robot's own joint that moves it.
        multiplier: Its rad, m where it slides, per rad of the driver, m where that slides.
        offset: rad, m where it slides: where it stands while its driver stands at zero.
        rotation: (3, 3) orientation of the frame before it in the body frame of the link before, z along its axis.
        translation: (3,) m, the origin of that frame there.
        prismatic: Whether it slides.
        mass: kg, of the link that it carries; None where the masses are not known.
        com: (3,) m, centre of gravity of that link in its body frame; None as `mass`.
    """

    name: str
    behind: int
    driver: int
    multiplier: float
    offset: float
    rotation: Float2D
    translation: Float1D
    prismatic: bool
    mass: float | None = None
    com: Float1D | None = None

    def __post_init__(self) -> None:
        """Copy to read-only arrays."""
        for name in ("rotation", "translation", "com"):
            if getattr(self, name) is not None:
                object.__setattr__(self, name, read_only(getattr(self, name)))
