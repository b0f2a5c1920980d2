"""What the rest of the program asks of an effect: its own file says it, no list of names elsewhere does."""

from __future__ import annotations

import enum
from collections.abc import Mapping
from types import MappingProxyType


class Trait(enum.Enum):
    """A property that an effect has or lacks."""

    OF_LARGEST_TORQUE = "its law refers to the largest torque of the recording, which a model keeps with it"
    SPRING = "it acts on its joint with a torque of its own (`Candidate.torques`), which laws of that joint feel"
    MEMORY = "what happened before shows in it, so that it goes on in time"
    LAG = "under changing loads its joint lags, and so it does on the way to a posture"
    DRIFT = "it grows with time, as noise that lasts does"
    HISTORY = "a posture alone does not tell it: from where, when or how warm it was reached does"
    PATH = "it means nothing for places that are no path"
    FRAMES = "where absolute positions fix the frames of the measurement, these take it up and are refitted"
    GEOMETRY = "where absolute positions fix the geometry of the robot, this takes it up and is refitted"
    ACTS_IN_USE = "it moves the robot in production, too, where nothing is measured"
    DAMAGE = "a robot that has it, unlike others of its type, may be damaged"
    BY_WEIGHT = "in positions at rest the robot's own weight drives it, and its size is relative to what that is"


OF_A_FAMILY: Mapping[str, frozenset[Trait]] = MappingProxyType({
    "structure": frozenset({Trait.ACTS_IN_USE, Trait.DAMAGE, Trait.BY_WEIGHT}),
    "joint law": frozenset({Trait.ACTS_IN_USE, Trait.DAMAGE, Trait.BY_WEIGHT}),
    "absolute": frozenset({Trait.ACTS_IN_USE}),
    "load chain": frozenset(),
    "point chain": frozenset(),
})  # fmt: skip
"""What all effects of a family have, without saying it."""
