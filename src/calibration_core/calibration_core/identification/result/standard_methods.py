"""What the standard's own methods found: base frame, joint axes, wrist centre (CWA 17384, 7.1 to 7.3)."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from types import MappingProxyType

from calibration_core.identification.circle_point.joint_axes import AxisGeometry, BaseFrame
from calibration_core.identification.wrist.centre import WristCentre


@dataclasses.dataclass(frozen=True, eq=False)
class StandardGeometry:
    """Results of the standard's methods, each where the recording follows its protocol.

    Attributes:
        base: Base coordinate system by circle points; None if joints 1 and 2 were not swept alone.
        axes: Joint axes by circle points; None if no joint beyond the second was swept as well.
        wrist: Wrist centre by spheres; None if the wrist was not moved while the arm stood.
        points_fitted: Whether the wrist centre stands on points that this recording determined, not on nominal ones.
        reasons: `base_frame`, `joint_axes`, `wrist_centre` -> why there is none.
    """

    base: BaseFrame | None
    axes: AxisGeometry | None
    wrist: WristCentre | None
    points_fitted: bool
    reasons: Mapping[str, str]

    def __post_init__(self) -> None:
        """Freeze the mapping."""
        object.__setattr__(self, "reasons", MappingProxyType(dict(self.reasons)))
