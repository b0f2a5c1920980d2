"""The load of a step as people see it: what pulls now, how far it is off, since when the sequencer finds it right."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Sequence

import numpy as np


@dataclasses.dataclass(frozen=True)
class Pull:
    """A load that is to be on, and what is felt.

    Attributes:
        wanted: N, size of the force.
        direction: Unit vector of the force, base axes; empty where the load is to be released.
        felt: N, size of the force that is felt; None: not known.
        along: Unit vector of what is felt, base axes; empty where hardly anything is, or it is not known.
        off_force: N, by which the size is off; None: not known.
        off_angle: rad, by which the direction is off; None: not known, or there is none.
        band_force: N, by which it may be; None: not checked.
        band_angle: rad, likewise.
        against: Code of what speaks against it; empty: nothing, or nothing is checked.
    """

    wanted: float
    direction: tuple[float, ...]
    felt: float | None
    along: tuple[float, ...]
    off_force: float | None
    off_angle: float | None
    band_force: float | None
    band_angle: float | None
    against: str

    @property
    def fits(self) -> bool:
        """Whether the sensor feels the load that is wanted: what is not felt, or not checked, does not fit."""
        return self.felt is not None and self.band_force is not None and not self.against

    @property
    def by_itself(self) -> bool:
        """Whether it may be confirmed without a hand: a release never, for the robot moves after it."""
        return self.fits and bool(self.direction)


def pull(
    wanted: Sequence[float],
    felt: Sequence[float] | None,
    band_force: float | None,
    band_angle: float | None,
    fault: str,
) -> Pull:
    """Return how a load stands.

    Args:
        wanted: (3,) N, base axes.
        felt: (3,) N, base axes; None: not known.
        band_force: N; None: not checked.
        band_angle: rad; None: not checked.
        fault: What the sequencer finds wrong with it; empty: nothing.
    """
    size = float(np.linalg.norm(wanted))
    direction = tuple(float(one) / size for one in wanted) if size > 0.0 else ()
    if felt is None:
        against = "load_not_felt" if fault or (direction and band_force is not None) else ""
        return Pull(size, direction, None, (), None, None, band_force, band_angle, against)
    found = float(np.linalg.norm(felt))
    along = tuple(float(one) / found for one in felt) if found > 0.0 else ()
    off_angle = None
    if direction and along:
        off_angle = math.atan2(float(np.linalg.norm(np.cross(direction, along))), float(np.dot(direction, along)))
    one = Pull(size, direction, found, along, found - size, off_angle, band_force, band_angle, "")
    return dataclasses.replace(one, against=_advice(one)) if fault else one


def _advice(one: Pull) -> str:
    """Say what to do about a load that the sequencer finds wrong."""
    if not one.direction:
        return "not_released"
    if one.band_force is not None and one.off_force is not None and abs(one.off_force) > one.band_force:
        return "force_too_small" if one.off_force < 0.0 else "force_too_great"
    if one.band_angle is not None and one.off_angle is not None and one.off_angle > one.band_angle:
        return "direction_off"
    return "load_differs"


class Held:
    """Since when the load of one step has fitted without a break; times are s of a steady clock."""

    def __init__(self) -> None:
        self._place: tuple[object, ...] = ()
        self._since: float | None = None
        self._taken = False

    def look(self, place: tuple[object, ...], now: float, *, fits: bool) -> float:
        """Return for how long, s, the load of a place (run, configuration, attempt, step, force) has fitted."""
        if place != self._place or not fits:
            self._place, self._since, self._taken = place, now if fits else None, False
        elif self._since is None:
            self._since = now
        return 0.0 if self._since is None else now - self._since

    def take(self, now: float, seconds: float) -> bool:
        """Return, once, whether the load has fitted for so long; again only after `refused`, or a break."""
        if self._taken or self._since is None or not 0.0 < seconds <= now - self._since:
            return False
        self._taken = True
        return True

    def refused(self, now: float) -> None:
        """Begin anew: what was taken did not count."""
        self._since, self._taken = None if self._since is None else now, False
