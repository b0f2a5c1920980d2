"""What a plan is: configurations with their loads, in the order in which they are measured."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from types import MappingProxyType
from typing import Literal

import numpy as np

from calibration_core.identification.result.observability import HARDLY
from calibration_core.planning.plans.planned_robot import PlannedRobot
from calibration_core.planning.plans.tolerances import DEFAULT_TOLERANCES, Tolerances
from calibration_core.timeseries import Float1D, Float2D, read_only

PhaseName = Literal["base_frame", "geometry", "wrist_centre", "points", "compliance"]
PREPARATION: tuple[PhaseName, ...] = ("base_frame", "geometry", "wrist_centre", "points")  # CWA 17384, 7.1 to 7.5
REFERENCE_NUMBER = 0  # configuration number under which the reference configuration is recorded, a step per visit


def placed(configuration: int, step: int) -> str:
    """Return a place of a plan as people read it, and type it."""
    numbers = f"configuration {configuration}, step {step}"
    return f"the reference ({numbers})" if configuration == REFERENCE_NUMBER else numbers


@dataclasses.dataclass(frozen=True, eq=False)
class PlannedConfiguration:
    """One configuration to measure.

    Attributes:
        number: As it is counted in recordings, from 1.
        q: (n,) rad, commanded.
        steps: (k, 6) N and N*m, base axes, at the wrench point: the wrench of every load step, the first unloaded.
        spare: Measured only in place of one that cannot be measured (CWA 17384, 5.1).
        phase: What it is measured for.
    """

    number: int
    q: Float1D
    steps: Float2D
    spare: bool = False
    phase: PhaseName = "compliance"

    def __post_init__(self) -> None:
        """Copy to read-only arrays."""
        object.__setattr__(self, "q", read_only(self.q))
        object.__setattr__(self, "steps", read_only(self.steps))


@dataclasses.dataclass(frozen=True, eq=False)
class Reference:
    """The configuration that is measured again and again, unloaded, to see drift.

    Attributes:
        q: (n,) rad.
        every: After how many configurations; 0: never.
    """

    q: Float1D
    every: int

    def __post_init__(self) -> None:
        """Copy to a read-only array."""
        object.__setattr__(self, "q", read_only(self.q))


@dataclasses.dataclass(frozen=True, eq=False)
class Expected:
    """What the plan promises before the day in the cell, for the nominal model and the claimed instrument noise.

    Attributes:
        efficiency: Share of what any choice could reach that this one has for certain, by its criterion (spares left
            out); None where nothing certifies it.
        condition: Condition number of the stacked Jacobian, parameters in units of their scale.
        compliance_std: (n,) rad/(N*m), one standard deviation of each joint compliance; infinite where the
            configurations cannot tell it.
        stiffness_std: (n,) standard deviation of each joint stiffness over its value, infinite likewise; None without
            nominal stiffness.
        a_value: Root mean square of `stiffness_std`; None likewise.
        e_value: Standard deviation of the worst combination of relative stiffnesses; None likewise.
        spacing: m, mean distance from a place of the operating space to the nearest configuration.
        travel: s, moving between configurations at the planned joint speeds.
        unclear_moves: Motions whose straight path in joint space comes too near to floor or arm.
        criterion: Name of the criterion that the configurations were chosen by.
        observability: Borm and Menq's index, smallest singular value, noise amplification index and trace of the
            sensitivity matrix (see `criteria.Observability`), by name.
        duration: s, of `moving`, `startup`, `loading` and `reading`, and the `total` of it, spares left out.
        k_csm: m, largest movement of a measurement point by the complementary stiffness K_CSM; None where not stated.
        unjudged: Pairs of bodies that were not held against each other, see `collision.CollisionModel`.
    """

    efficiency: float | None
    condition: float
    compliance_std: Float1D
    stiffness_std: Float1D | None
    a_value: float | None
    e_value: float | None
    spacing: float
    travel: float
    unclear_moves: int
    criterion: str = "D"
    observability: Mapping[str, float] = dataclasses.field(default_factory=lambda: MappingProxyType({}))
    duration: Mapping[str, float] = dataclasses.field(default_factory=lambda: MappingProxyType({}))
    k_csm: float | None = None
    unjudged: tuple[str, ...] = ()

    @property
    def unidentifiable(self) -> tuple[int, ...]:
        """Joints, counted from 0, whose stiffness these configurations cannot tell from that of a rigid one."""
        std = self.compliance_std if self.stiffness_std is None else self.stiffness_std
        limit = np.inf if self.stiffness_std is None else HARDLY
        return tuple(int(i) for i in np.flatnonzero(~(std < limit)))

    def __post_init__(self) -> None:
        """Copy to read-only arrays."""
        for name in ("observability", "duration"):
            object.__setattr__(self, name, MappingProxyType(dict(getattr(self, name))))
        for name in ("compliance_std", "stiffness_std"):
            if getattr(self, name) is not None:
                object.__setattr__(self, name, read_only(getattr(self, name)))


@dataclasses.dataclass(frozen=True, eq=False)
class Plan:
    """A plan for one robot.

    Attributes:
        joints: Names, in the order of q.
        configurations: To be measured, in order; the spares last, the most telling first.
        startup_cycle: (k, n) rad, driven through before measuring and again periodically (CWA 17384, 5.2).
        reference: Measured again and again; None: no reference.
        expected: What it promises; None for a plan that somebody else made.
        preparation: Measured before, one unloaded step each, in order: the sweeps and postures of the phases that find
            base frame, geometry, wrist centre and points (CWA 17384, 7.1 to 7.5); empty where these are known.
        tolerances: How far a reading may be from posture and load.
        made_for: What tells its robot from another; None for a plan that somebody else made.
    """

    robot: str
    joints: tuple[str, ...]
    configurations: tuple[PlannedConfiguration, ...]
    startup_cycle: Float2D
    reference: Reference | None = None
    expected: Expected | None = None
    preparation: tuple[PlannedConfiguration, ...] = ()
    tolerances: Tolerances = DEFAULT_TOLERANCES
    made_for: PlannedRobot | None = None

    def __post_init__(self) -> None:
        """Copy to a read-only array."""
        object.__setattr__(self, "startup_cycle", read_only(self.startup_cycle).reshape(-1, len(self.joints)))

    @property
    def primary(self) -> tuple[PlannedConfiguration, ...]:
        """The configurations without spares."""
        return tuple(configuration for configuration in self.configurations if not configuration.spare)

    @property
    def spares(self) -> tuple[PlannedConfiguration, ...]:
        """The spares alone."""
        return tuple(configuration for configuration in self.configurations if configuration.spare)

    @property
    def largest_force(self) -> float:
        """The size of the largest force of any step, N."""
        return float(max(np.linalg.norm(one.steps[:, :3], axis=1).max() for one in self.configurations))

    def table1(self) -> tuple[list[int], Float2D]:
        """Return numbers and (k, n) rad of all configurations, for Table 1 of the standard."""
        numbers = [configuration.number for configuration in self.configurations]
        return numbers, np.array([configuration.q for configuration in self.configurations])
