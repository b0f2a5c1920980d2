"""What a reading is held against: the planned posture, the posture of the unloaded step, and the planned load.

A plan may say otherwise (`tolerances` in plan.yaml); the defaults, and why:

    posture       0.005 rad or m   two and a half times what counts as arrival; a robot that stands farther off stands
                                   somewhere that nobody planned and no one has held against collisions
    hold          0.0005 rad or m  what the evaluation of a bag counts as motion; a servo holds its joint ten times
                                   better, and what its encoder sees the evaluation corrects for
    force         0.1              share of the wanted force; the evaluation uses the force as measured, so the load
                                   need not be exact, but it must be the one that was planned
    direction     0.17 rad         ten degrees; a pull by a crane or a cable that is hooked in as planned is nearer
    force_floor   -                N, difference that never matters: 2 % of the rated load's weight, and at least five
                                   standard deviations of the sensor
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable

from calibration_core.cell import Cell
from calibration_core.errors import quoted, rounded_down

RATED_SHARE = 0.02
DEVIATIONS = 5.0
STANDARD_ACCELERATION = 9.80665  # m/s^2, turns the rated load in kg into N


@dataclasses.dataclass(frozen=True)
class Tolerances:
    """How far a reading may be from what was planned.

    Attributes:
        posture: rad (m for a sliding joint), of every joint from the plan, at any moment of the averaging windows.
        hold: rad (m), of every joint from its mean at step 0 of the configuration, likewise.
        force: Share of the wanted force, and of a wanted torque.
        direction: rad, between wanted and found.
        force_floor: N, difference that never matters; None: from rated load and sensor.
    """

    posture: float = 5e-3
    hold: float = 5e-4
    force: float = 0.1
    direction: float = 0.17
    force_floor: float | None = None

    def floor(self, cell: Cell) -> float:
        """Return the difference of force that never matters, N."""
        if self.force_floor is not None:
            return self.force_floor
        sensor = cell.instruments.force_torque
        noise = 0.0 if sensor is None else DEVIATIONS * sensor.sigma_force
        return max(noise, RATED_SHARE * cell.robot.rated_load * STANDARD_ACCELERATION)


DEFAULT_TOLERANCES = Tolerances()
LIMITS = {
    "posture": (0.0, 0.1),
    "hold": (0.0, 0.1),
    "force": (0.0, 1.0),
    "direction": (0.0, math.pi / 2),
    "force_floor": (0.0, 1e6),
}


def read_tolerances(value: object, fail: Callable[[str, str, str], Exception]) -> Tolerances:
    """Read what a plan says; what it does not say has its default.

    Args:
        value: Content of the key `tolerances`; None: nothing was said.
        fail: Makes the error of place, found and expected.
    """
    if value is None:
        return Tolerances()
    if not isinstance(value, dict):
        raise fail("tolerances", quoted(value), f"a mapping with the keys {', '.join(LIMITS)}")
    for name, number in value.items():
        if name not in LIMITS:
            raise fail(f"tolerances.{name}", "an unknown key", f"one of {', '.join(LIMITS)}")
        low, high = LIMITS[name]
        if name == "force_floor" and number is None:
            continue
        if isinstance(number, bool) or not isinstance(number, int | float) or not low < number <= high:
            raise fail(
                f"tolerances.{name}", quoted(number), f"a number above {low:g} and at most {rounded_down(high):g}"
            )
    return Tolerances(**value)
