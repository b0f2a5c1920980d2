"""Who publishes the robot's joints: by what the messages carry, for the graph names publishers and not what they send.

A gripper and a linear unit publish joints of their own on the robot's topic, and nobody minds.  Of two publishers of
the same joint nobody knows which one speaks of the robot.  Every publisher numbers its messages (DDS): of one publisher
the numbers rise, and numbers that rise in two places by turns are two publishers.  A driver that was started again
begins to count anew once, and is one.
"""

from __future__ import annotations

import dataclasses
import itertools
import math
from collections.abc import Iterable

MEMORY = 3.0  # s without a message, after which a publisher has ended: joint states come at more than 1 Hz


@dataclasses.dataclass
class _Publisher:
    joints: frozenset[str]  # of ours
    number: int  # of its last message
    heard: float
    again: float = -math.inf  # when it was heard again after another one


class JointPublishers:
    """Tells joints of ours that come from two publishers; all times are s on one clock.

    Attributes:
        numbered: Whether the middleware tells the numbers; where it does not, nothing is found.
    """

    def __init__(self, joints: Iterable[str]) -> None:
        self._joints = frozenset(joints)
        self._publishers: list[_Publisher] = []
        self._last = 0
        self.numbered = True

    def hear(self, names: Iterable[str], number: int | None, now: float) -> bool:
        """Take note of a message; return whether another publisher sent it than the one before: it counts anew.

        Args:
            names: Of the joints that it carries.
            number: That its publisher gave it; None where the middleware does not tell.
            now: s.
        """
        joints = self._joints.intersection(names)
        self.numbered = number is not None
        if not joints or number is None:
            return False
        another, self._last = number <= self._last, number
        self._publishers = [one for one in self._publishers if now - one.heard <= MEMORY]
        fitting = [one for one in self._publishers if one.joints == joints and one.number < number]
        if not fitting:
            self._publishers.append(_Publisher(joints, number, now))
            return another
        sender = max(fitting, key=lambda one: (one.number, one.heard))
        if any(one.heard > sender.heard for one in self._publishers if one.joints & joints):
            sender.again = now
        sender.number, sender.heard = number, now
        return another

    def twice(self, now: float) -> tuple[str, ...]:
        """Return the joints that come from two publishers at `now`: either was heard again after the other."""
        live = [one for one in self._publishers if now - one.again <= MEMORY]
        shared = (one.joints & other.joints for one, other in itertools.combinations(live, 2))
        return tuple(sorted(frozenset[str]().union(*shared)))
