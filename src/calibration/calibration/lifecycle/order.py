"""What a manager does next: nodes are brought up in order, taken down in the opposite one, and missed when silent.

Pure bookkeeping over what the nodes' signs of life say; times are s of the steady clock.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Sequence

from calibration.lifecycle import machine

PATIENCE = 10.0  # s, that a node which is not heard, or is being brought up, is waited for
RETRY = 5.0  # s, after which a transition that failed is asked for again
UP = {machine.UNCONFIGURED: machine.CONFIGURE, machine.INACTIVE: machine.ACTIVATE}
BUSY = (machine.CONFIGURING, machine.ACTIVATING)
DOWN = {machine.ACTIVE: machine.DEACTIVATE, machine.INACTIVE: machine.CLEANUP}


@dataclasses.dataclass
class Member:
    """One node, as its signs of life tell.

    Attributes:
        name: Of the node.
        process: Number of the process that was heard last; 0: none yet.
        state: Of its lifecycle.
        heard: When it was heard last.
        alive: Whether it is heard.
        bringing: Whether it is being brought up: a node that an operator deactivates is left alone.
        failed: When a transition of it failed.
    """

    name: str
    process: int = 0
    state: int = machine.UNKNOWN
    heard: float = -math.inf
    alive: bool = False
    bringing: bool = False
    failed: float = -math.inf


class Order:
    """The nodes of a suite, and what is to be done with them.

    Args:
        names: In the order in which they are brought up.
        lease: s without a sign of life, after which a node counts as silent.
        now: s.

    Attributes:
        members: By name, in order.
        up: Whether the nodes are to be up.
    """

    def __init__(self, names: Sequence[str], lease: float, now: float) -> None:
        self.members = {name: Member(name) for name in names}
        self.up = True
        self._lease, self._began, self._looked = lease, now, -math.inf

    def hear(self, name: str, process: int, state: int, now: float) -> bool:
        """Take a sign of life; return whether it is news: the node was not heard before, or is another process."""
        one = self.members[name]
        news = not one.alive or process != one.process
        if process != one.process:
            one.bringing, one.failed = self.up, -math.inf
        if state == machine.ACTIVE:
            one.bringing = False
        one.process, one.state, one.heard, one.alive = process, state, now, True
        return news

    def lose(self, name: str, now: float) -> bool:
        """Take notice that the sign of life has ended; return whether that is news.

        A node that has not been up yet, or is being configured or activated, may be too busy for one: it is given time.
        """
        one = self.members[name]
        if (one.bringing or one.state in BUSY) and now - one.heard <= PATIENCE:
            return False
        news, one.alive = one.alive, False
        return news

    def silent(self, now: float) -> list[str]:
        """Return the nodes that fell silent since the last look; to be called several times within a lease.

        Whoever did not look for longer was too busy itself to hear them, and hears them first.
        """
        looked, self._looked = self._looked, now
        if now - looked > 0.5 * self._lease:
            return []
        late = [one.name for one in self.members.values() if one.alive and now - one.heard > self._lease]
        return [name for name in late if self.lose(name, now)]

    def fail(self, name: str, now: float) -> None:
        """Take notice that a transition failed, or was not answered."""
        self.members[name].failed = now

    def bring(self, *, up: bool) -> None:
        """Want all nodes up, or down."""
        self.up = up
        for one in self.members.values():
            one.bringing, one.failed = up, -math.inf

    def next(self, now: float) -> tuple[str, int] | None:
        """Return the node and the transition that is to be asked for now; None: nothing, or something is waited for."""
        return self._next_up(now) if self.up else self._next_down(now)

    def _next_up(self, now: float) -> tuple[str, int] | None:
        for one in self.members.values():
            if not one.alive:
                if now - max(one.heard, self._began) < PATIENCE:
                    return None
            elif one.bringing and now - one.failed >= RETRY:
                transition = UP.get(one.state)
                return (one.name, transition) if transition is not None else None
        return None

    def _next_down(self, now: float) -> tuple[str, int] | None:
        for one in reversed(self.members.values()):
            if one.alive and one.state != machine.UNCONFIGURED:
                transition = DOWN.get(one.state)
                if transition is None or now - one.failed < RETRY:  # under way; or it must not be passed over
                    return None
                return one.name, transition
        return None

    @property
    def all_active(self) -> bool:
        """Whether every node is heard and active."""
        return all(one.alive and one.state == machine.ACTIVE for one in self.members.values())

    @property
    def all_down(self) -> bool:
        """Whether no node that is heard is configured."""
        states = (machine.UNCONFIGURED, machine.FINALIZED)
        return all(not one.alive or one.state in states for one in self.members.values())
