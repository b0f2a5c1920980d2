"""The load of a step against its band: what pulls now, how far it is off, and since when it fits."""

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
        fits: Whether what is felt is within the band; where nothing is checked, it does.
    """

    wanted: float
    direction: tuple[float, ...]
    felt: float | None
    along: tuple[float, ...]
    off_force: float | None
    off_angle: float | None
    band_force: float | None
    band_angle: float | None
    fits: bool


def pull(
    wanted: Sequence[float], felt: Sequence[float] | None, band_force: float | None, band_angle: float | None
) -> Pull:
    """Return how a load stands.

    Args:
        wanted: (3,) N, base axes.
        felt: (3,) N, base axes; None: not known.
        band_force: N; None: not checked.
        band_angle: rad; None: not checked.
    """
    size = float(np.linalg.norm(wanted))
    direction = tuple(float(one) / size for one in wanted) if size > 0.0 else ()
    if felt is None:
        return Pull(size, direction, None, (), None, None, band_force, band_angle, band_force is None)
    found = float(np.linalg.norm(felt))
    along = tuple(float(one) / found for one in felt) if found > 0.0 else ()
    off_force = found - size
    off_angle = None
    if direction and along:
        off_angle = math.atan2(float(np.linalg.norm(np.cross(direction, along))), float(np.dot(direction, along)))
    fits = band_force is None or abs(off_force) <= band_force
    fits = fits and (band_angle is None or not direction or (off_angle is not None and off_angle <= band_angle))
    return Pull(size, direction, found, along, off_force, off_angle, band_force, band_angle, fits)


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
        """Return, once, whether the load has fitted for so long; again only after it has not fitted meanwhile."""
        if self._taken or self._since is None or not 0.0 < seconds <= now - self._since:
            return False
        self._taken = True
        return True
