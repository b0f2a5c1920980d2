"""The tracker's clock is ahead of the other instruments' by dt: moving points are seen where they are not.

d = v dt, v the velocity of the point.  Source: clocks that nobody synchronised, 10 to 500 ms.

Readings are averages at rest, where v is zero: no hypothesis about them can be formed.  In streams the offset is found
on the ramps of the load, and taken out before anything is averaged (`observations.clock`).
"""

from __future__ import annotations

from collections.abc import Iterator

from calibration_core.model.effects.candidate import Candidate, Effect, Trait
from calibration_core.model.effects.state import State


def _candidates(state: State) -> Iterator[Candidate]:  # noqa: ARG001  # at rest whatever the state
    yield from ()


EFFECT = Effect(
    name="clock_offset",
    family="point chain",
    equation="d = v dt",
    source="clocks that nobody synchronised, 10 to 500 ms",
    reveal="streams through load ramps instead of averages at rest",
    candidates=_candidates,
    sentence="the clocks of tracker and robot differ",
    traits=frozenset({Trait.HISTORY}),
)
